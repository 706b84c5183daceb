"""What a fit finds on a joint does not depend on how many others the robot has."""

import numpy as np
import pytest

from hil.diagnosis import verbs
from hil.diagnosis.engine import diagnose
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.model import base_model
from hil.record.recording import Recording, RobotSource

AXES = base_model(RobotSource("single-axis"))
FS = 500.0
#: True width of the sign of friction [rad/s].
SIGN = 0.01


def axes(
    d: int,
    seed: int = 1,
    lingering: bool = False,
    noise: float = 0.02,
    speed: float = 0.15,
) -> Recording:
    """Axes with inertia, smooth dry friction and viscous friction; the first is always the same.

    lingering: the first nearly comes to a halt now and then, at speeds well below SIGN.
    """
    t = np.arange(0, 20.0, 1 / FS)
    q, v, tau = [], [], []
    for j in range(d):
        rng = np.random.default_rng((seed, j))
        w = 2 * np.pi * rng.uniform(0.1, 0.9, 5)
        angle = t[:, None] * w + rng.uniform(0, 6, 5)
        pace = np.ones(t.size)
        if lingering and j == 0:
            pace = np.clip(1.2 + 1.5 * np.sin(2 * np.pi * 0.15 * t), 3e-3, 1.0)
            angle = np.cumsum(pace)[:, None] / FS * w + rng.uniform(0, 6, 5)
        size = speed / w
        q.append((size * np.sin(angle)).sum(axis=1))
        v.append(pace * (size * w * np.cos(angle)).sum(axis=1))
        a = np.gradient(v[-1], 1 / FS)
        noise = noise * rng.normal(size=t.size)
        tau.append(0.2 * a + 0.9 * np.tanh(v[-1] / SIGN) + 0.3 * v[-1] + noise)
    names = tuple(f"a{j + 1}" for j in range(d))
    return Recording("axes", "arm", names, t, np.stack(q, axis=1), np.stack(tau, axis=1))


@pytest.mark.parametrize("d", [1, 7])
def test_the_sign_of_friction_is_as_wide_among_seven_joints_as_alone(d: int) -> None:
    run = axes(d)
    found = fit(Problem([run], AXES.robot), AXES).values["j1.coulomb.v0"].value
    assert found == pytest.approx(SIGN, rel=0.15)


def test_seven_joints_with_smooth_friction_lack_nothing() -> None:
    d = diagnose([axes(7)], AXES, [axes(7, 2)])
    assert d.verdict == "adequate", [(f.effect, f.joint, f.confidence) for f in d.findings]
    assert np.all(d.ladder[0].heldout.rms < 1.1 * d.noise)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_run_that_lingers_shows_how_blunt_a_sign_is_that_fast_runs_hardly_see(seed: int) -> None:
    fast = axes(1, seed, noise=0.05, speed=1.0)
    slow = axes(1, seed + 10, lingering=True, noise=0.05)
    alone = fit(Problem([fast], AXES.robot), AXES).values["j1.coulomb.v0"].value
    assert alone < 0.3 * SIGN
    d = diagnose([fast], AXES, [slow])
    assert d.verdict == "adequate", [(f.effect, f.joint, f.confidence) for f in d.findings]
    found = d.ladder[0].result.values["j1.coulomb.v0"].value
    assert found == pytest.approx(SIGN, rel=0.15)
    assert d.ladder[0].heldout.rms[0] < 1.4 * d.ladder[0].result.rms[0]
    # compare and add start from the very same model
    before, _ = verbs.add([fast], AXES, "quadratic-drag", holdout=[slow])
    for heldout in (verbs.compare([fast], AXES, [slow]).heldout, before.step.heldout):
        np.testing.assert_allclose(heldout.rms, d.ladder[0].heldout.rms, rtol=1e-6)
