"""A fit refined on its simulated motion: right where one-step errors mislead, never worse."""

from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.errors import ConfigError, DataError
from hil.identify.fit import fit
from hil.identify.multistep import Windows, _braked, _Forward, forward
from hil.identify.problem import Problem
from hil.identify.simulated import SimulationErrors, alike, refine
from hil.models.model import Band, RobotModel, base_model
from hil.record.recording import RobotSource

AXIS = RobotSource("single-axis")


def wide() -> RobotModel:
    """The base model with a band that lets the noise of the positions through."""
    return replace(base_model(AXIS), band=Band(40.0, 20.0))


@pytest.mark.slow
def test_simulation_is_right_where_noise_of_the_positions_biases_the_one_step_fit() -> None:
    model = wide()
    run, other = (plants.pushed_axes(seed, 2e-3, seconds=12.0) for seed in (1, 2))
    result = fit(Problem([run], AXIS, band=model.band), model)
    found = refine(result, [other], window=1.0)
    mass = [abs(r.values["rigid-body.m"].value / plants.MASS - 1) for r in (result, found.result)]
    assert found.better and mass[0] > 0.1 and mass[1] < 0.03
    assert found.official is not None
    before, after = found.official
    assert after.simulated[0] < 0.5 * before.simulated[0]
    assert found.heldout[1].simulated[0] < found.heldout[0].simulated[0]
    told = found.as_dict()
    assert told["refined"] is True and {"heldout", "official", "tried"} <= set(told)
    assert found.result.model.values()["rigid-body.m"] == found.result.values["rigid-body.m"]


def test_what_is_kept_is_never_worse_on_held_out_windows() -> None:
    result = fit(Problem([plants.pushed_axes(3, 1e-5, seconds=12.0)], AXIS), base_model(AXIS))
    found = refine(result, window=0.25)
    kept = found.heldout[int(found.better)]
    assert np.all(kept.simulated <= found.heldout[0].simulated)
    assert found.result is (found.refined if found.better else result)


def test_a_held_out_run_of_another_robot_is_refused() -> None:
    result = fit(Problem([plants.pushed_axes(3, 1e-5, seconds=12.0)], AXIS), base_model(AXIS))
    with pytest.raises(DataError, match=r"has joints .*give sessions of one robot"):
        refine(result, plants.spatial(1, 6.0))


@pytest.mark.slow
def test_three_joints_in_windows() -> None:
    model = wide()
    result = fit(Problem([plants.pushed_axes(4, 2e-3, 3, 12.0)], AXIS, band=model.band), model)
    found = refine(result, window=0.5)
    before, after = found.heldout
    assert found.better and after.simulated.shape == (3,)
    assert np.all(after.simulated < before.simulated)
    masses = [v.value for k, v in found.result.values.items() if k.endswith(".m")]
    assert masses == pytest.approx([plants.MASS] * len(masses), rel=0.05)


def test_a_joint_that_sticks_stays_and_one_that_turns_loses_what_friction_takes() -> None:
    problem = Problem([plants.pushed_axes(5, 0.0)], AXIS)
    result = fit(problem, base_model(AXIS))
    values = {"rigid-body.m": plants.MASS, "j1.coulomb.fc": plants.DRY}
    theta = np.array([values.get(name, 0.0) for name in result.names])
    sharp = [t.reshaped((1e-9,)) if t.effect.name == "coulomb" else t for t in result.terms]
    model, motion = replace(result, theta=theta, terms=sharp), problem.motions[0]
    one = np.array([0])
    forward_ = _Forward([Windows(model, one, 1)], motion, one)
    q, load, mass = np.zeros((1, 1)), np.zeros((1, 3, 1)), np.full((1, 1, 1), plants.MASS)

    def after(v: float, tau: float) -> float:
        speed = np.array([[v]])
        push = tau - forward_.drag(q, speed, load)
        far = speed + motion.dt * push / plants.MASS
        return float(_braked(forward_, (q, speed, load), mass, push, far)[0, 0])

    for tau in (-0.4, 0.3, 0.45):
        v = 1e-4
        for _ in range(200):
            v = after(v, tau)
        assert abs(v) < 0.05 * motion.dt * abs(tau) / plants.MASS
    # from v through zero: -dt (|tau| - fc) / m + v
    reached = after(1e-5, -3.0)
    assert reached == pytest.approx(1e-5 - motion.dt * (3.0 - plants.DRY) / plants.MASS, rel=1e-2)


def test_simulated_from_other_first_states() -> None:
    problem = Problem([plants.pushed_axes(6, 0.0, seconds=12.0)], AXIS)
    result, starts = fit(problem, base_model(AXIS)), np.array([200, 900])
    offset = np.array([[[0.01], [0.02]], [[0.0], [0.0]]])
    plain, moved = forward(
        problem.motions[0],
        [Windows(result, starts, 50), Windows(result, starts, 50, 0.0, None, offset)],
    )
    shift = np.broadcast_to(offset[0][:, None], plain[0].shape)
    assert moved[0] - plain[0] == pytest.approx(shift, rel=1e-6)


def errors(*each: float) -> SimulationErrors:
    square = np.array(each)[:, None]
    return SimulationErrors(np.zeros(1), np.sqrt(square.mean(axis=0)), square)


def test_models_within_one_standard_error_of_the_best_are_alike() -> None:
    found = [errors(1.0, 1.1, 0.9), errors(1.1, 0.95, 1.05), errors(2.0, 2.2, 1.8)]
    assert alike(found, "abc") == ["a", "b"]


def test_what_cannot_be_simulated_is_refused() -> None:
    problem = Problem([plants.pushed_axes(7, 0.0, seconds=12.0)], AXIS)
    result = fit(problem, base_model(AXIS))
    with pytest.raises(ConfigError, match="third of the shortest run"):
        refine(result, window=20.0)
    outside = replace(result, model=replace(result.model, explains="external"))
    with pytest.raises(ConfigError, match="motor's effort"):
        refine(outside)
