"""Models that are simulated together move as each of them alone."""

import numpy as np
import pytest

from hil.identify.fit import fit
from hil.identify.forward import Windows, _Forward, looked_at
from hil.identify.multistep import each, simulate
from hil.identify.problem import Problem
from hil.models.model import base_model
from hil.record.recording import Recording, RobotSource


def recording(seed: int) -> Recording:
    """Two axes of 2 kg m^2 with Coulomb 0.5, viscous 0.3 and quadratic friction, white noise."""
    rng, t = np.random.default_rng(seed), np.arange(4000) / 500.0
    w, phase = 2 * np.pi * np.array([0.3, 0.7, 1.1]), rng.uniform(0, 6, (2, 3))
    angle = t[:, None, None] * w + phase
    q, qd = 0.2 * np.sin(angle).sum(axis=2), 0.2 * (w * np.cos(angle)).sum(axis=2)
    qdd = -0.2 * (w**2 * np.sin(angle)).sum(axis=2)
    tau = 2 * qdd + 0.5 * np.sign(qd) + 0.3 * qd + 0.1 * qd * np.abs(qd)
    tau = tau + 0.05 * rng.normal(size=q.shape)
    return Recording(f"axes{seed}", "arm", ("joint1", "joint2"), t, q, tau)


@pytest.mark.parametrize("runs", [1, 2])
def test_together_as_alone(runs: int) -> None:
    problem = Problem([recording(k) for k in range(runs)], RobotSource("single-axis"))
    small = base_model(problem.source)
    models = [small, small + "quadratic-drag", small + "asymmetric-viscous"]
    results = [fit(problem, m) for m in models]
    together = each(results, problem)
    for result, found in zip(results, together, strict=True):
        alone, closed = simulate(result, problem), each([result], problem)[0].closed_loop
        assert found.windows == alone.windows > 0
        assert found.rms == pytest.approx(alone.rms, rel=1e-6)
        assert found.closed_loop is not None and closed is not None
        assert found.closed_loop.rms == pytest.approx(closed.rms, rel=1e-6)
    worse, better = together[0], together[1]
    assert np.all(better.rms < worse.rms)


def test_several_accelerations_of_a_state_as_each_of_them_alone() -> None:
    problem = Problem([recording(1)], RobotSource("single-axis"))
    motion = problem.motions[0]
    result = fit(problem, base_model(problem.source) + "quadratic-drag")
    starts = np.arange(0, 500, 100)
    model = _Forward([Windows(result, starts, 10)], motion, np.zeros(starts.size, dtype=int))
    q, qd = motion.q[starts], motion.qd[starts]
    qdd = np.random.default_rng(2).normal(size=(3, *q.shape))
    load = np.stack([motion.load[starts], motion.static[starts]], axis=1)
    alone = np.concatenate([model.effort(q, qd, row[None], load) for row in qdd])
    assert model.effort(q, qd, qdd, load) == pytest.approx(alone, rel=1e-12)
    seen = {t.effect.name: looked_at(t, motion) for t in result.terms}
    assert "qdd" not in seen["viscous"] | seen["torque-offset"]
    assert "qd" not in seen["torque-offset"]
    assert {"qd"} <= seen["viscous"] & seen["quadratic-drag"] & seen["coulomb"]
