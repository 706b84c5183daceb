"""A servo on a coarse encoder: what it answers to the counts is no missing physics."""

import plants
import pytest

import hil
from hil.diagnosis.artefacts import POSITION_NOISE, coarsely_encoded
from hil.identify.problem import Problem


@pytest.mark.parametrize("counts", plants.seeds(2000, 4000))
@pytest.mark.parametrize("seed", plants.seeds(1, 2))
def test_nothing_is_missing_behind_a_coarse_encoder(counts, seed):
    run, other = plants.counted_loop(seed, counts), plants.counted_loop(seed + 10, counts)
    assert counts > 2000 or coarsely_encoded(Problem([run], run.robot)).all()
    for held in ([], [other]):
        d = hil.diagnose([run], hil.base_model(run.robot), held)
        assert d.verdict == "adequate" and not d.findings, (d, d.warnings)
        assert not [text for code, text in d.warnings if code == "unlike-noise"]


def test_a_fine_encoder_is_not_coarse():
    run = plants.counted_loop(1, 100_000)
    assert not coarsely_encoded(Problem([run], run.robot)).any()
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert d.verdict == "adequate" and POSITION_NOISE not in [code for code, _ in d.warnings]
