"""What is smaller than the accuracy of the efforts gets no name and is not unexplained."""

from dataclasses import replace

import plants
import pytest

import hil
from hil.diagnosis.floor import known_to, practical
from hil.errors import ConfigError
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.files import read_model, write_model
from hil.models.model import Band, base_model
from hil.record.recording import SIGNAL


@pytest.mark.slow
def test_an_effect_within_the_accuracy_of_the_efforts_is_not_named():
    run = plants.smooth_axis(3, seconds=20.0, extra=lambda t, q, v, a: 0.03 * v * abs(v))
    model = base_model(run.robot)
    sharp = hil.diagnose([run], model)
    assert [f.effect for f in sharp.findings] == ["quadratic-drag"]
    coarse = replace(model, band=Band(accuracy=0.05))
    found = hil.diagnose([run], coarse)
    assert found.verdict == "adequate" and not found.findings


def test_a_map_or_a_model_says_it_and_a_file_keeps_it(tmp_path):
    run = plants.smooth_axis(3, seconds=5.0)
    said = replace(run, metadata={**run.metadata, SIGNAL + "accuracy": "0.02"})
    model = base_model(run.robot)
    problem = Problem([said], model.robot, model.explains, model.band)
    assert practical(problem) == 0.02 == known_to(fit(problem, model))
    path = tmp_path / "m.toml"
    write_model(replace(model, band=Band(accuracy=0.01)), path)
    assert read_model(path).band.accuracy == 0.01
    path.write_text(path.read_text().replace("accuracy = 0.01", "accuracy = 3"))
    with pytest.raises(ConfigError, match="share of the rms effort"):
        read_model(path)
