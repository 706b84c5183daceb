"""A load picked up in the middle of a run: its instant, its mass and where its centre lies."""

import numpy as np
import plants
import pytest

import hil
from hil.identify.design import bind
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.effect import refused
from hil.models.model import Use, Value
from hil.record.recording import Recording
from hil.report.data import from_diagnosis
from hil.report.html import diagnosis_report
from hil.report.text import EACH_ALONE, next_steps


def answer(fitted: Recording, held: list[Recording] | None = None):
    return hil.diagnose([fitted], hil.base_model(fitted.robot), held)


@pytest.mark.parametrize(
    "held",
    [
        plants.further([], id="fifths"),
        plants.further(["load"], id="both"),
        plants.further(["none"], id="bare"),
    ],
)
def test_a_load_that_is_picked_up_is_named_with_mass_centre_and_instant(held, tmp_path):
    d = answer(plants.pickup(1), [plants.pickup(2, change, "other") for change in held])
    (found,) = d.findings
    assert (d.verdict, found.effect, found.joint) == ("missing-effect", "payload-change", None)
    assert found.confidence > 0.95
    values = {k.rsplit(".")[-1]: v.value for k, v in found.parameters.items()}
    assert values["m"] == pytest.approx(plants.LOAD, rel=0.05)
    assert values["t0"] == pytest.approx(plants.INSTANT, abs=0.05)
    moments = [values[k] for k in ("mx", "my", "mz")]
    np.testing.assert_allclose(moments, plants.LOAD * plants.LOAD_AT, atol=0.005)
    last = d.ladder[-1]
    assert np.all(last.result.rms < 1.1 * d.floor)
    assert np.all(last.heldout.rms < 1.15 * d.noise)
    diagnosis_report(d, tmp_path / "r.html")


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [9.0, 20.0])
def test_every_run_picks_the_load_up_at_a_time_of_its_own(seconds, tmp_path):
    instants = np.array([0.3, 0.65, 0.45]) * seconds
    *runs, held = (
        plants.pickup(k, name=f"run{k}", at=at, seconds=seconds) for k, at in enumerate(instants)
    )
    d = hil.diagnose(runs, hil.base_model(held.robot), [held])
    assert [f.effect for f in d.findings] == ["payload-change"]
    assert d.findings[0].confidence > 0.95
    values = {k.rsplit(".")[-1]: v.value for k, v in d.findings[0].parameters.items()}
    assert values["m"] == pytest.approx(plants.LOAD, rel=0.02)
    assert values["t0"] == pytest.approx(instants[0], abs=0.05)
    assert values["t0_2"] == pytest.approx(instants[1], abs=0.05)
    assert "t0_3" not in values  # there is no third run
    moments = [values[k] for k in ("mx", "my", "mz")]
    np.testing.assert_allclose(moments, plants.LOAD * plants.LOAD_AT, atol=0.005)
    diagnosis_report(d, tmp_path / "r.html")
    # the held-out run has an instant that no other run has
    assert np.all(d.ladder[-1].heldout.rms < 1.15 * d.noise)
    # three moments, the mass and the instant of the held-out run are its own
    assert any("payload-change (5 values a run)" in text for _, text in d.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "says"), [("gain", "scale of all efforts"), ("offset", "effort at rest")]
)
def test_what_changes_on_one_joint_is_no_load_and_nothing_that_imitates_it(change, says):
    d = answer(plants.pickup(1, change))
    assert d.verdict == "unexplained" and not d.findings
    (found,) = d.last.changes
    assert (found.joint, found.what) == ("joint2", says)
    assert found.at == pytest.approx(plants.INSTANT, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", plants.seeds(1, 2))
def test_an_arm_that_carries_the_same_all_the_time_lacks_nothing(seed):
    assert answer(plants.pickup(seed, "none")).verdict == "adequate"


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1])
def test_one_of_two_runs_picks_nothing_up(first):
    runs = [
        plants.pickup(0, "none", "bare", seconds=12.0),
        plants.pickup(1, name="loads", at=5.0, seconds=12.0),
    ]
    held = plants.pickup(2, "none", "held", seconds=12.0)
    d = hil.diagnose([runs[first], runs[1 - first]], hil.base_model(held.robot), [held])
    (found,) = d.findings
    assert found.effect == "payload-change" and found.confidence > 0.95
    values = {k.rsplit(".")[-1]: v.value for k, v in found.parameters.items()}
    assert values["m"] == pytest.approx(plants.LOAD, rel=0.02)
    assert values["t0" if first else "t0_2"] == pytest.approx(5.0, abs=0.05)
    assert values["t0_2" if first else "t0"] == pytest.approx(12.0, abs=0.05)
    assert np.all(d.ladder[-1].heldout.rms < 1.15 * d.noise)


@pytest.mark.parametrize("change", [plants.further("gain"), "offset"])
@pytest.mark.slow
def test_what_one_joint_changes_in_every_run_at_a_time_of_its_own_is_no_load(change):
    """It has no name; the answer says where to look."""
    runs = [plants.pickup(k, change, f"run{k}", at=at) for k, at in enumerate((6.0, 13.0))]
    d = hil.diagnose(runs, hil.base_model(runs[0].robot))
    assert d.verdict == "unexplained" and not d.findings
    if change == "offset":
        assert next_steps(from_diagnosis(d, simulated=False))[0] == EACH_ALONE


def test_a_model_of_one_instant_has_it_in_all_runs():
    """Files from before runs had instants of their own hold `t0` alone."""
    run = plants.pickup(1)
    use = Use("payload-change", ("*",), {}, {"payload-change.t0": Value(plants.INSTANT)})
    term = bind(hil.base_model(run.robot) + use, Problem([run], run.robot))[-1]
    assert term.shape == (plants.INSTANT, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("own", "within"), [((6.0, 11.99), True), ((0.5, 11.99), False), ((11.99, 0.3), False)]
)
def test_what_one_of_two_runs_carries_throughout_is_a_payload_and_no_change(own, within):
    """It was a change at 0.5, with the end of the one run and the start of the other."""
    runs = [plants.serial_arm(2, k, seconds=12.0) for k in (1, 2)]
    motion = Problem(runs, hil.base_model(runs[0].robot).robot).motions[0]
    effect = catalogue.get("payload-change")
    code = refused(effect, motion, 0, (*own, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    assert code == ("" if within else "within")
