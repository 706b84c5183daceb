"""Held-out sessions: what is refused, and effects that every run has for itself."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.heldout import Examiner
from hil.errors import DataError
from hil.identify.problem import Problem
from hil.models.files import read_model, write_model
from hil.models.model import Band, Use
from hil.record.recording import RobotSource


def test_a_fitted_session_is_no_held_out_one() -> None:
    run = plants.axis(1)
    with pytest.raises(DataError, match="holds the same data as the fitted session"):
        hil.diagnose([run], hil.base_model(run.robot), [replace(run, name="copy")])
    with pytest.raises(DataError, match="give another one, or none"):
        hil.compare([run], hil.base_model(run.robot), [replace(run, name="copy")])


@pytest.mark.slow
def test_lost_counts_of_a_fitted_run_do_not_upset_a_held_out_run() -> None:
    """An effect of the whole robot with its own coefficients in every run."""
    runs = plants.arm(1), plants.arm(2)
    shift = np.where(runs[0].t > 8.0, 0.05, 0.0)[:, None] * np.array([0, 1, 0])[: runs[0].d]
    lost = replace(runs[0], q=runs[0].q + shift)
    base = hil.base_model(lost.robot)
    model = base + Use("missed-counts", ("joint2",), {"per_run": True})
    before, after = (hil.compare([lost], m, [runs[1]]).heldout.rms for m in (base, model))
    assert after[1] < before[1]


def bad(run, where="tau"):
    values = getattr(run, where).copy()
    values[100] = np.nan
    return replace(run, **{where: values})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda r: replace(r, joints=("elbow",)), "give sessions of one robot"),
        (bad, "has faults, nothing can be judged on it: .*NaN"),
    ],
)
def test_the_api_refuses_a_held_out_session_as_the_program_does(change, says) -> None:
    run, other = plants.axis(1), change(plants.axis(2))
    for verb in (hil.diagnose, hil.compare):
        with pytest.raises(DataError, match=says):
            verb([run], hil.base_model(run.robot), [other])
    with pytest.raises(DataError, match=says):
        hil.add([run], hil.base_model(run.robot), "stribeck", holdout=[other])


def test_a_held_out_session_of_another_known_robot_is_refused() -> None:
    run = replace(plants.arm(1), robot=RobotSource("phantom-premium-1.5"))
    other = replace(plants.arm(2), robot=RobotSource("phantom-omni"))
    with pytest.raises(DataError, match="robot 'phantom-omni', the fitted ones of 'phantom-prem"):
        Examiner(Problem([run], RobotSource("single-axis")), [other])


def test_a_diagnosis_of_bad_data_says_that_it_has_no_model() -> None:
    run = bad(plants.axis(1))
    found = hil.diagnose([run], hil.base_model(run.robot))
    assert found.verdict == "bad-data" and hil.ladder(found) == []
    for name in ("model", "result"):
        with pytest.raises(DataError, match=r"holds no model: its verdict is 'bad-data'.*NaN"):
            getattr(found, name)


def test_a_written_model_keeps_the_band_and_the_shift_of_its_fit(tmp_path) -> None:
    fitted, other = plants.axis(1).slice(0, 3000), plants.axis(2)
    late = replace(fitted, tau=np.roll(fitted.tau, 1, axis=0)).slice(5, 2990)
    base = replace(hil.base_model(late.robot), band=Band(effort_hz=9.0))
    found = hil.compare([late], base, [other], simulate=False)
    write_model(replace(found.result.model, band=Band()), tmp_path / "m.toml")
    model = read_model(tmp_path / "m.toml")
    kept = hil.compare([other], model.as_it_is(), simulate=False)
    assert found.result.problem.shift != 0.0
    assert kept.result.problem.taken == found.result.problem.taken
    assert kept.heldout.rms == pytest.approx(found.heldout.rms, rel=1e-9)
    # what the file says under [signal] goes first, and a refit chooses again
    own = replace(model, band=Band(effort_hz=11.0)).as_it_is()
    assert hil.compare([other], own, simulate=False).result.problem.rates.effort == 11.0
    assert hil.fit([other], model).model.fitted.effort_hz not in (9.0, 11.0)
