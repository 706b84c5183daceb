"""Models that are simulated together move as each of them alone."""

import numpy as np
import plants
import pytest

from hil.identify.fit import fit
from hil.identify.forward import Windows, _Forward, looked_at
from hil.identify.multistep import each, simulate
from hil.identify.problem import Problem
from hil.models.model import base_model
from hil.record.recording import RobotSource


@pytest.mark.parametrize("runs", [1, 2])
def test_together_as_alone(runs: int) -> None:
    problem = Problem(
        [plants.coulomb_axes(k, 4000, d=2, drag=0.1) for k in range(runs)],
        RobotSource("single-axis"),
    )
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
    problem = Problem([plants.coulomb_axes(1, 4000, d=2, drag=0.1)], RobotSource("single-axis"))
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
