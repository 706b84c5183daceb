"""The fit recovers what made the data; the data are made by Pinocchio, not by the library."""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import plants
import pytest
import scipy.optimize

from hil.errors import ConfigError, DataError, FitError
from hil.identify.context import update_load
from hil.identify.fit import fit, predict, time_blocks
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.effect import Doc, Effect, Param
from hil.models.model import RobotModel, Use, Value, base_model
from hil.models.motion import FloatArray, Motion
from hil.record.recording import RobotSource

GUESS = RobotSource("", plants.spatial_urdf((2.0, 2.0, 2.0)))
ARM = RobotModel(GUESS, (Use("rigid-body"), Use("coulomb"), Use("viscous")))
AXIS = base_model(RobotSource("single-axis"))


@pytest.fixture(scope="module")
def fitted() -> FitResult:
    return fit(Problem([plants.spatial(1)], GUESS), ARM)


# --- a known arm ----------------------------------------------------------------------------


def truth() -> dict[str, float]:
    model = pin.buildModelFromXML(plants.spatial_urdf())
    names = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    out = {}
    for joint, inertia in zip(plants.JOINTS, list(model.inertias)[1:], strict=True):
        for name, value in zip(names, inertia.toDynamicParameters(), strict=True):
            out[f"rigid-body.{joint}.{name}"] = value
    for k in range(3):
        out |= {
            f"j{k + 1}.coulomb.fc": plants.SPATIAL_FC[k],
            f"j{k + 1}.viscous.fv": plants.SPATIAL_FV[k],
        }
    return out


def test_identifiable_parameters_are_recovered_within_their_errors(fitted: FitResult) -> None:
    true = truth()
    known = [n for n in fitted.names if fitted.values[n].identifiable]
    assert len(known) >= 14
    values = [fitted.values[n] for n in known]
    z = np.array([(v.value - true[n]) / v.stderr for n, v in zip(known, values, strict=True)])
    assert np.abs(z).max() < 4, dict(zip(known, z, strict=True))
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.8


def test_the_arm_s_dynamics_are_recovered(fitted: FitResult) -> None:
    """Base parameters: many do not show one by one, but the efforts they make do."""
    rng = np.random.default_rng(5)
    q, qd, qdd = rng.normal(size=(3, 200, 3))
    model = pin.buildModelFromXML(plants.spatial_urdf())
    data = model.createData()
    true = np.array([pin.rnea(model, data, *x).copy() for x in zip(q, qd, qdd, strict=True)])
    body = fitted.theta[fitted.slices[0]]
    got = fitted.problem.robot.regressor(q, qd, qdd) @ body
    assert np.all(np.std(got - true, axis=0) < 2e-3 * np.std(true, axis=0))


def test_what_the_data_do_not_hold_stays_at_the_prior(fitted: FitResult) -> None:
    assert fitted.values["rigid-body.base.m"].value == pytest.approx(2.0, abs=1e-12)
    assert not fitted.values["rigid-body.base.m"].identifiable
    assert "rigid-body.base.m" in fitted.not_identifiable()
    b = fitted.basis
    moved = (fitted.theta - fitted.prior) * b.scale
    outside = moved - b.v @ (b.v.T @ moved)
    assert np.abs(outside).max() < 1e-9 * np.abs(moved).max()
    assert b.rank == 15 + 6  # base parameters of this arm (gravity, three axes) and friction


def test_residual_is_the_noise(fitted: FitResult) -> None:
    expected = plants.NOISE * np.sqrt(fitted.problem.rates.effort / 250.0)
    assert np.all(fitted.rms < 1.5 * expected)
    assert np.all(fitted.relative < 1.0)


def test_prediction_of_a_new_run_is_as_good(fitted: FitResult) -> None:
    problem = fitted.problem
    new = Problem([plants.spatial(2)], GUESS, rates=problem.rates, span=problem.span)
    residual = predict(fitted, new)
    assert residual.shape == (3, new.n)
    assert np.all(np.sqrt(np.mean(residual**2, axis=1)) < 1.3 * fitted.rms)
    again = Problem([plants.spatial(1)], GUESS, rates=problem.rates, span=problem.span)
    np.testing.assert_allclose(predict(fitted, again), fitted.residual, atol=1e-9)


def test_what_a_model_foretells_does_not_depend_on_which_one_was_asked_before() -> None:
    """Of a motor at its limit a held-out run said 30 % after the base model, and 0.3 by itself."""
    train, other = (plants.axis(k, gives=lambda u: 1.5 * np.tanh(u / 1.5)) for k in (3, 4))
    base = fit(Problem([train], train.robot), AXIS)
    bent = fit(Problem([train], train.robot), AXIS + Use("torque-saturation", ("joint1",)))
    first = base.problem
    asked = [Problem([other], train.robot, rates=first.rates, span=first.span) for _ in range(2)]
    predict(base, asked[0])
    twice = [predict(bent, asked[0]) for _ in range(2)]
    once = predict(bent, asked[1])
    for residual in twice:
        np.testing.assert_array_equal(residual, once)
    assert np.sqrt(np.mean(once**2)) < 1.5 * bent.rms[0] < 0.5 * base.rms[0]


def test_result_is_json_and_holds_everything(fitted: FitResult) -> None:
    data = json.loads(json.dumps(fitted.as_dict(), allow_nan=False))
    assert data["schema"] == "hil.fit/1"
    assert data["rank"] == fitted.basis.rank and data["columns"] == len(fitted.names)
    fc = data["parameters"]["j2.coulomb.fc"]
    assert fc["unit"] == "N m" and fc["at_bound"] is False and fc["identifiable"] is True
    assert fc["stderr"] == pytest.approx(fitted.values["j2.coulomb.fc"].stderr)
    assert data["parameters"]["rigid-body.base.m"]["identifiable"] is False
    assert set(data["relative"]) == set(plants.JOINTS)


def test_model_holds_the_values_and_the_source(fitted: FitResult) -> None:
    values = fitted.model.values()
    assert values == fitted.values
    assert values["j1.viscous.fv"].source == "fit of run1"
    assert values["j1.viscous.fv"].lower == 0.0
    assert fitted.model.names() == ARM.names()


def test_fit_is_repeatable_on_one_problem_and_on_a_fresh_one(fitted: FitResult) -> None:
    same = fit(fitted.problem, ARM)
    np.testing.assert_allclose(same.residual, fitted.residual, atol=1e-10)
    fresh = fit(Problem([plants.spatial(1)], GUESS), ARM)
    np.testing.assert_array_equal(fresh.theta, fit(Problem([plants.spatial(1)], GUESS), ARM).theta)


def test_json_of_a_fit_that_determines_nothing() -> None:
    run = plants.coulomb_axes()
    result = fit(Problem([replace(run, tau=0 * run.tau)], AXIS.robot), AXIS)
    assert json.loads(json.dumps(result.as_dict(), allow_nan=False))["rank"] >= 0


# --- options --------------------------------------------------------------------------------


def test_per_run_offsets_belong_to_their_runs() -> None:
    runs = [
        replace(plants.coulomb_axes(k), tau=plants.coulomb_axes(k).tau + offset)
        for k, offset in ((0, 0.7), (1, -0.4))
    ]
    model = (AXIS - "torque-offset") + Use("torque-offset", options={"per_run": True})
    result = fit(Problem(runs, AXIS.robot), model)
    for run, true in (("axis0", 0.7), ("axis1", -0.4)):
        value = result.values[f"j1.torque-offset.t0[{run}]"]
        assert abs(value.value - true) < 4 * value.stderr < 0.05
    third = replace(plants.coulomb_axes(2), tau=plants.coulomb_axes(2).tau + 3.0)
    problem = Problem([third], AXIS.robot, rates=result.problem.rates, span=result.problem.span)
    assert np.sqrt(np.mean(predict(result, problem) ** 2)) < 1.5 * result.rms[0]


def test_a_model_as_it_is_foretells_a_run_by_its_name_and_any_other_by_the_median() -> None:
    """A model with a value a run was taken with none for a run that came alone, or was new."""
    offsets = (0.7, -2.4, 0.5)
    runs = [
        replace(plants.coulomb_axes(k), tau=plants.coulomb_axes(k).tau + offset)
        for k, offset in enumerate(offsets)
    ]
    model = (AXIS - "torque-offset") + Use("torque-offset", options={"per_run": True})
    result = fit(Problem(runs, AXIS.robot), model)
    for run in runs:
        known = fit(Problem([run], AXIS.robot), result.model.as_it_is([run.name]))
        assert known.relative[0] < 1.2 * result.relative[0]
    new = replace(runs[0], name="new", tau=runs[0].tau - offsets[0] + 0.5)
    asked = fit(Problem([new], AXIS.robot), result.model.as_it_is(["new"]))
    assert asked.values["j1.torque-offset.t0[new]"].value == pytest.approx(0.5, abs=0.02)
    assert asked.relative[0] < 1.2 * result.relative[0]


def test_fixed_values_stay_and_the_others_move() -> None:
    given = {"j1.viscous.fv": Value(0.9)}
    model = (AXIS - "viscous") + Use("viscous", options={"fixed": True}, values=given)
    result = fit(Problem([plants.coulomb_axes()], AXIS.robot), model)
    value = result.values["j1.viscous.fv"]
    assert value.value == 0.9 and value.source == "given" and np.isnan(value.stderr)
    assert result.relative[0] > fit(Problem([plants.coulomb_axes()], AXIS.robot), AXIS).relative[0]


def test_fixed_shape_stays_and_its_coefficient_is_fitted() -> None:
    values = {"j1.coulomb.v0": Value(0.123)}
    use = Use("coulomb", options={"fixed_shape": True}, values=values)
    result = fit(Problem([plants.coulomb_axes()], AXIS.robot), (AXIS - "coulomb") + use)
    assert result.values["j1.coulomb.v0"].value == 0.123
    assert result.values["j1.coulomb.fc"].value == pytest.approx(0.5, rel=0.2)


def test_presliding_takes_coulomb_s_place() -> None:
    result = fit(Problem([plants.coulomb_axes()], AXIS.robot), AXIS + "presliding")
    names = {t.effect.name for t in result.terms}
    assert "presliding" in names and "coulomb" not in names


def test_units_follow_the_joint() -> None:
    linear = replace(plants.coulomb_axes(), metadata={"unit": "m"})
    values = fit(Problem([linear], AXIS.robot), AXIS).values
    assert values["rigid-body.m"].unit == "kg" and values["j1.viscous.fv"].unit == "N s/m"
    values = fit(Problem([plants.coulomb_axes()], AXIS.robot), AXIS).values
    assert values["rigid-body.m"].unit == "kg m^2" and values["j1.viscous.fv"].unit == "N m s/rad"


def test_a_bound_is_held_and_the_others_are_refitted() -> None:
    result = fit(Problem([plants.coulomb_axes(fv=-0.2)], AXIS.robot), AXIS)
    value = result.values["j1.viscous.fv"]
    assert value.value == 0.0 and value.at_bound
    assert not result.values["j1.coulomb.fc"].at_bound
    x, y = result.x, result.problem.y.reshape(-1)
    lower = [-np.inf, 0.0, 0.0, -np.inf]
    expected = scipy.optimize.lsq_linear(x, y, (lower, [np.inf] * 4), tol=1e-14).x
    np.testing.assert_allclose(result.theta, expected, rtol=1e-6, atol=1e-9)


def test_bounds_of_many_joints_at_once() -> None:
    result = fit(Problem([plants.coulomb_axes(fv=-0.2, d=7)], AXIS.robot), AXIS)
    for k in range(7):
        assert result.values[f"j{k + 1}.viscous.fv"].value == 0.0


# --- contact --------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_contact_laws_in_any_order(order: tuple[int, ...]) -> None:
    laws = ("contact-stiffness", "contact-damping", "contact-hardening")
    uses = (Use("torque-offset"), *(Use(laws[k]) for k in order))
    model = RobotModel(AXIS.robot, uses, explains="external")
    result = fit(Problem([plants.touching_axis()], AXIS.robot, explains="external"), model)
    assert result.values["j1.contact-stiffness.q0"].value == pytest.approx(0.05, abs=3e-3)
    assert result.values["j1.contact-damping.c"].value == pytest.approx(3.0, rel=0.02)
    again = fit(Problem([plants.touching_axis()], AXIS.robot, explains="external"), result.model)
    np.testing.assert_allclose(again.relative, result.relative, rtol=0.05)


def test_a_contact_law_without_a_surface_is_refused() -> None:
    model = RobotModel(AXIS.robot, (Use("contact-hardening"),), explains="external")
    with pytest.raises(FitError, match="needs 'contact-stiffness' in the model"):
        fit(Problem([plants.touching_axis()], AXIS.robot, explains="external"), model)


# --- refusals -------------------------------------------------------------------------------


def test_unknown_joints_and_foreign_effects_are_refused() -> None:
    problem = Problem([plants.coulomb_axes()], AXIS.robot)
    with pytest.raises(ConfigError, match="unknown joint 'joint9'"):
        fit(problem, AXIS + Use("spring", ("joint9",)))
    with pytest.raises(ConfigError, match=r"'contact-stiffness' explains external effort, but"):
        fit(problem, AXIS + "contact-stiffness")


def test_coupled_effects_on_all_joints_take_the_joints_that_can() -> None:
    result = fit(Problem([plants.coulomb_axes(d=2)], AXIS.robot), AXIS + "coupled-transmission")
    assert "j1.coupled-transmission.i" in result.values
    assert "j2.coupled-transmission.i" not in result.values
    with pytest.raises(FitError, match="cannot be fitted to joint1: the robot has one joint"):
        fit(Problem([plants.coulomb_axes()], AXIS.robot), AXIS + "coupled-friction")
    with pytest.raises(FitError, match="cannot be fitted to joint2: no later joint"):
        fit(
            Problem([plants.coulomb_axes(d=2)], AXIS.robot),
            AXIS + Use("coupled-transmission", ("joint2",)),
        )


def test_an_armature_beside_an_axis_only_inertia_is_left_out() -> None:
    assert "j1.armature.ia" not in fit(Problem([plants.coulomb_axes()], AXIS.robot), AXIS).values


@pytest.mark.parametrize("n", [60, 70, 90, 110])
def test_short_runs_are_refused(n: int) -> None:
    with pytest.raises(DataError, match=r"'axis0' of .* too short for a filter of .* record"):
        Problem([plants.coulomb_axes(n=n)], AXIS.robot)


def test_a_run_without_motion_is_refused() -> None:
    run = plants.coulomb_axes()
    with pytest.raises(FitError, match="hold no motion"):
        fit(Problem([replace(run, q=0 * run.q)], AXIS.robot), AXIS)


def test_runs_of_different_robots_and_no_runs_are_refused() -> None:
    with pytest.raises(DataError, match="'axis1' has 2 joints but 'axis0' has 1"):
        Problem([plants.coulomb_axes(0), plants.coulomb_axes(1, d=2)], AXIS.robot)
    with pytest.raises(DataError, match="no recording given"):
        Problem([], AXIS.robot)
    with pytest.raises(DataError, match="'axis0' has no external effort"):
        Problem([plants.coulomb_axes()], AXIS.robot, explains="external")


def test_time_blocks_keep_runs_apart() -> None:
    problem = Problem([plants.coulomb_axes(0), plants.coulomb_axes(1, n=4000)], AXIS.robot)
    blocks = time_blocks(problem)
    assert np.all(np.diff(blocks) >= 0)
    assert not set(blocks[problem.run == 0]) & set(blocks[problem.run == 1])
    lengths = np.bincount(blocks) / problem.rate
    assert lengths.max() == pytest.approx(1.0, abs=0.05)


def test_the_regressor_is_made_once_for_all_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Moving and at rest, whatever the sign resolution and the load become."""
    problem, calls = Problem([plants.spatial(1)], GUESS), []
    whole = problem.robot.regressor

    def counted(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        calls.append(bool(np.any(qd)))
        return whole(q, qd, qdd)

    monkeypatch.setattr(problem.robot, "regressor", counted)
    first = fit(problem, ARM + Use("load-friction", ("fore",)))
    problem.shift_effort(1e-4)
    fit(problem, ARM)
    assert sorted(calls) == [False, True]
    load = np.concatenate([m.load for m in problem.motions])
    y = np.concatenate([whole(m.q, m.qd, m.qdd) for m in problem.motions])
    body = fit(problem, ARM).theta[first.slices[0]]
    np.testing.assert_allclose(load, y @ body, rtol=1e-3, atol=1e-3 * np.abs(load).max())


class Broken(Effect):
    """An effect with a fault in its equation."""

    name, family = "broken", "friction"
    doc = Doc("tau = b", signature="none", shown_by="none", source="this test")
    params = (Param("b", "{F}", "coefficient"),)

    def __init__(self, columns: FloatArray) -> None:
        self._columns = columns

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        return np.resize(self._columns, (motion.n, self._columns.size))


@pytest.mark.parametrize(
    ("columns", "text"),
    [
        ([np.nan], "hold NaN or infinity on joint 1"),
        ([np.inf], "hold NaN or infinity on joint 1"),
        ([1.0, 2.0], r"expected \(.*, 1\): one for each of its 1 params"),
    ],
)
def test_faulty_columns_of_an_own_effect_are_refused(columns: list[float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        Problem([plants.coulomb_axes()], AXIS.robot).columns(Broken(np.array(columns)), 0, ())


def test_a_rotor_is_no_load_of_its_transmission():
    """Where the links are known apart; of an axis without a description all inertia is one."""
    problem = Problem([plants.spatial(1)], GUESS)
    result = fit(problem, ARM + "armature")
    (where,) = [
        s
        for t, s in zip(result.terms, result.slices, strict=True)
        if t.effect.name == "armature" and t.joint == 1
    ]
    before = np.concatenate([m.load for m in problem.motions])
    theta = result.theta.copy()
    theta[where] += 5.0
    update_load(problem, result.terms, theta, result.slices)
    now = np.concatenate([m.load for m in problem.motions])
    np.testing.assert_allclose(now, before, atol=1e-6 * np.abs(before).max())
    axis = plants.smooth_axis(1, seconds=8.0)
    lone = Problem([axis], axis.robot)
    fit(lone, base_model(axis.robot))
    load = np.concatenate([m.load for m in lone.motions])[:, 0]
    qdd = np.concatenate([m.qdd for m in lone.motions])[:, 0]
    assert np.corrcoef(load, qdd)[0, 1] > 0.99
