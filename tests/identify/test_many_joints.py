"""What a fit finds on a joint does not depend on how many others the robot has."""

import numpy as np
import plants
import pytest

from hil.diagnosis import verbs
from hil.diagnosis.engine import diagnose
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.model import base_model
from hil.record.recording import RobotSource

AXES = base_model(RobotSource("single-axis"))


@pytest.mark.parametrize("d", [1, 7])
def test_the_sign_of_friction_is_as_wide_among_seven_joints_as_alone(d: int) -> None:
    run = plants.smooth_friction_axes(d)
    found = fit(Problem([run], AXES.robot), AXES).values["j1.coulomb.v0"].value
    assert found == pytest.approx(plants.SIGN, rel=0.15)


@pytest.mark.slow
def test_seven_joints_with_smooth_friction_lack_nothing() -> None:
    d = diagnose([plants.smooth_friction_axes(7)], AXES, [plants.smooth_friction_axes(7, 2)])
    assert d.verdict == "adequate", [(f.effect, f.joint, f.confidence) for f in d.findings]
    assert np.all(d.ladder[0].heldout.rms < 1.1 * d.noise)


@pytest.mark.parametrize("seed", plants.seeds(1, 2, 3))
@pytest.mark.slow
def test_a_run_that_lingers_shows_how_blunt_a_sign_is_that_fast_runs_hardly_see(seed: int) -> None:
    fast = plants.smooth_friction_axes(1, seed, noise=0.05, speed=1.0)
    slow = plants.smooth_friction_axes(1, seed + 10, lingering=True, noise=0.05)
    alone = fit(Problem([fast], AXES.robot), AXES).values["j1.coulomb.v0"].value
    assert alone < 0.3 * plants.SIGN
    d = diagnose([fast], AXES, [slow])
    assert d.verdict == "adequate", [(f.effect, f.joint, f.confidence) for f in d.findings]
    found = d.ladder[0].result.values["j1.coulomb.v0"].value
    assert found == pytest.approx(plants.SIGN, rel=0.15)
    assert d.ladder[0].heldout.rms[0] < 1.4 * d.ladder[0].result.rms[0]
    # compare and add start from the very same model
    before, _ = verbs.add([fast], AXES, "quadratic-drag", holdout=[slow])
    for heldout in (verbs.compare([fast], AXES, [slow]).heldout, before.step.heldout):
        np.testing.assert_allclose(heldout.rms, d.ladder[0].heldout.rms, rtol=1e-6)
