"""A load picked up in the middle of a run: its instant, its mass and where its centre lies."""

import numpy as np
import plants
import pytest

import hil
from hil.record.recording import Recording
from hil.report.html import diagnosis_report


def answer(fitted: Recording, held: list[Recording] | None = None):
    return hil.diagnose([fitted], hil.base_model(fitted.robot), held)


@pytest.mark.parametrize(
    "held",
    [
        pytest.param([], id="fifths", marks=pytest.mark.slow),
        pytest.param(["load"], id="both", marks=pytest.mark.slow),
        pytest.param(["none"], id="bare"),
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


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("gain", "scale of all efforts"),
        pytest.param("offset", "effort at rest", marks=pytest.mark.slow),
    ],
)
def test_what_changes_on_one_joint_is_no_load_and_nothing_that_imitates_it(change, says):
    d = answer(plants.pickup(1, change))
    assert d.verdict == "unexplained" and not d.findings
    (found,) = d.last.changes
    assert (found.joint, found.what) == ("joint2", says)
    assert found.at == pytest.approx(plants.INSTANT, abs=0.3)


@pytest.mark.parametrize("seed", plants.seeds(1, 2))
def test_an_arm_that_carries_the_same_all_the_time_lacks_nothing(seed):
    assert answer(plants.pickup(seed, "none")).verdict == "adequate"
