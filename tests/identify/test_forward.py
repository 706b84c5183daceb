"""Models that are simulated together move as each of them alone."""

import numpy as np
import plants
import pytest

import hil
from hil.identify.fit import fit
from hil.identify.multistep import Windows, _Forward, each, looked_at, simulate
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.effect import Trait
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
    load = np.stack([x[starts] for x in (motion.load, motion.static, motion.tau)], axis=1)
    alone = np.concatenate([model.effort(q, qd, row[None], load) for row in qdd])
    assert model.effort(q, qd, qdd, load) == pytest.approx(alone, rel=1e-12)
    seen = {t.effect.name: looked_at(t, motion) for t in result.terms}
    assert "qdd" not in seen["viscous"] | seen["torque-offset"]
    assert "qd" not in seen["torque-offset"]
    assert {"qd"} <= seen["viscous"] & seen["quadratic-drag"] & seen["coulomb"]


def test_a_simulation_sees_of_every_effect_what_the_fit_sees() -> None:
    """At the recorded states and efforts, an effect's columns are those along the run."""
    problem = Problem([plants.coulomb_axes(1, 4000, d=2, drag=0.1)], RobotSource("single-axis"))
    fit(problem, base_model(problem.source))
    motion = problem.motions[0].with_(average=0.0, friction=())
    motion = motion.with_(drive=motion.tau)
    states = [getattr(motion, x) for x in ("q", "qd", "qdd", "load", "static", "tau")]
    followed = {
        name: e
        for name, e in catalogue.table().items()
        if Trait.REPLAYED not in e.traits and not e.scope.lacks(motion, 0)
    }
    assert {"load-friction", "coulomb", "rigid-body", "torque-gain"} <= set(followed)
    for name, e in followed.items():
        for shape in problem.grid(e, 0):
            along = e.columns(motion, 0, shape)
            off = np.abs(e.columns(motion.at_states(*states), 0, shape) - along)
            # as pytest.approx, of which a million numbers take ten seconds
            assert np.all(off <= np.maximum(1e-6 * np.abs(along), 1e-12)), name


def test_friction_of_a_gear_takes_part_in_a_simulation() -> None:
    """Friction in proportion to the motor's effort brakes the simulated joint, too."""
    run = plants.stiction_axis(3, gear=0.15, spring=3.0)
    before, after = hil.add([run], base_model(run.robot) + "spring", "load-friction")
    assert before.multi_step is not None and after.multi_step is not None
    assert after.multi_step.relative[0] < 0.5 * before.multi_step.relative[0]
    assert not after.multi_step.diverged
