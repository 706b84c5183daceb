"""Standard errors of shapes and coefficients against the scatter over many noise samples."""

import numpy as np
import plants
import pytest

from hil.identify.design import Term
from hil.identify.fit import fit
from hil.identify.gauss_newton import complete, derivative
from hil.identify.problem import Problem
from hil.identify.regression import basis, extended
from hil.identify.result import FitResult
from hil.models.files import read_model, write_model
from hil.models.model import RobotModel, Use, Value, base_model, in_words
from hil.record.recording import Recording, RobotSource

AXIS = base_model(RobotSource("single-axis"))
TRUE = {"j1.coulomb.fc": 0.5, "j1.viscous.fv": 0.3, "j1.stribeck.fs": 0.4, "j1.stribeck.vs": 0.15}


def fitted(run: Recording, model: RobotModel) -> FitResult:
    return fit(Problem([run], model.robot), model)


@pytest.mark.parametrize(
    ("noise", "rho"),
    [(0.05, 0.95), *(pytest.param(x, 0.0, marks=pytest.mark.slow) for x in (0.05, 0.2))],
)
def test_stated_errors_are_the_scatter(noise: float, rho: float) -> None:
    results = [
        fitted(plants.stribeck_axis(s, noise, rho), AXIS + "stribeck").values for s in range(40)
    ]
    for name, true in TRUE.items():
        values = np.array([r[name].value for r in results])
        stated = np.sqrt(np.mean([r[name].stderr ** 2 for r in results]))
        assert 1 / 1.5 < stated / np.std(values) < 1.5, name
        assert abs(np.mean(values) - true) < stated, name
        assert not any(r[name].at_bound for r in results)


@pytest.mark.slow
def test_a_coefficient_on_its_bound_does_not_widen_its_shape() -> None:
    # the whole effort is late: share and delay trade off until the share's bound holds it
    def late(seed: int) -> dict[str, Value]:
        run = plants.stribeck_axis(seed, noise=0.2)
        moved = Recording("axis", "arm", run.joints, run.t[:-3], run.q[:-3], run.tau[3:])
        return fitted(moved, AXIS + "stribeck" + "delay").values

    results = [late(s) for s in range(20)]
    assert sum(r["j1.delay.a"].at_bound for r in results) > 15
    held = [r["j1.delay.T"] for r in results if r["j1.delay.a"].at_bound]
    stated = np.sqrt(np.mean([v.stderr**2 for v in held]))
    assert 1 / 1.5 < stated / np.std([v.value for v in held]) < 2.0


def test_an_uncertain_shape_widens_the_coefficients() -> None:
    free = fitted(plants.stribeck_axis(0), AXIS + "stribeck").values
    held = {n: Value(free[n].value) for n in ("j1.stribeck.vs", "j1.stribeck.n")}
    use = Use("stribeck", options={"fixed_shape": True}, values=held)
    known = fitted(plants.stribeck_axis(0), AXIS + use).values
    assert free["j1.coulomb.fc"].stderr > 1.15 * known["j1.coulomb.fc"].stderr
    assert free["j1.stribeck.fs"].stderr > 1.15 * known["j1.stribeck.fs"].stderr
    vs = known["j1.stribeck.vs"]
    assert np.isnan(vs.stderr) and not vs.at_bound and vs.identifiable


def test_a_shape_at_the_end_of_its_range_is_flagged_and_has_no_error() -> None:
    values = fitted(plants.stribeck_axis(1, vs=0.5), AXIS + "stribeck").values
    vs = values["j1.stribeck.vs"]
    assert vs.at_bound and np.isnan(vs.stderr) and vs.identifiable
    sharp = values["j1.coulomb.v0"]  # as sharp as the speed resolves: that is no bound
    assert np.isnan(sharp.stderr) and not sharp.at_bound


def test_one_of_a_few_forms_has_no_error() -> None:
    values = fitted(plants.stribeck_axis(2), AXIS + "stribeck").values
    n = values["j1.stribeck.n"]
    assert n.value == 2.0 and np.isnan(n.stderr) and not n.at_bound and n.identifiable


@pytest.mark.parametrize("effect", ["stribeck", "presliding", "position-friction", "cogging"])
def test_jacobian_is_the_derivative_of_the_columns(effect: str) -> None:
    result = fitted(plants.stribeck_axis(3), AXIS + effect)
    k = next(i for i, t in enumerate(result.terms) if t.effect.name == effect)
    where = result.slices[k]
    theta = np.ones_like(result.theta)
    got = derivative(result.problem, result.terms, theta, result.slices, k, 0)
    term, h = result.terms[k], 1e-5 * result.terms[k].shape[0]

    def columns(s: float) -> np.ndarray:
        new = Term(term.effect, term.joint, (s, *term.shape[1:]))
        return result.problem.columns(new.effect, 0, new.shape) @ theta[where]

    expected = (columns(term.shape[0] + h) - columns(term.shape[0] - h)) / (2 * h)
    assert np.linalg.norm(got[0] - expected) < 0.02 * np.linalg.norm(expected)


def test_jacobian_of_the_sign_resolution_holds_what_refers_to_it() -> None:
    result = fitted(plants.stribeck_axis(4), AXIS + "stribeck")
    k = next(i for i, t in enumerate(result.terms) if t.effect.name == "coulomb")
    alone = np.array([float(n == "j1.coulomb.fc") for n in result.names])
    both = alone + np.array([float(n == "j1.stribeck.fs") for n in result.names])
    one, two = (
        derivative(result.problem, result.terms, theta, result.slices, k, 0)
        for theta in (alone, both)
    )
    np.testing.assert_allclose(two, 2 * one, rtol=0.1, atol=0.02 * np.abs(one).max())


def test_an_extended_basis_is_that_of_all_columns() -> None:
    rng = np.random.default_rng(0)
    x, more = rng.normal(size=(80, 5)), rng.normal(size=(80, 3))
    more[:, 1] = 0.0
    more[:, 2] += x[:, 0]
    y, zero = rng.normal(size=80), np.zeros(80)
    got = extended(basis(x), more)
    want = basis(np.concatenate([x, more], axis=1))
    np.testing.assert_allclose(
        got.solve(y, np.zeros(8), zero), want.solve(y, np.zeros(8), zero), atol=1e-10
    )
    assert got.identifiable().tolist() == [True] * 6 + [False, True]
    np.testing.assert_allclose(got.q.T @ got.q, np.eye(7), atol=1e-12)


def test_shape_of_an_effect_that_is_zero_is_not_determined() -> None:
    values = fitted(plants.stribeck_axis(1, vs=1.5), AXIS + "stribeck").values
    fs, vs = values["j1.stribeck.fs"], values["j1.stribeck.vs"]
    assert fs.value == 0.0 and fs.at_bound
    assert np.isnan(vs.stderr) and not vs.identifiable and not vs.at_bound


@pytest.mark.parametrize("n", [2.0, 1.4, 1.0])
def test_an_exponent_that_was_picked_widens_what_trades_off_with_it(n: float) -> None:
    true = TRUE | {"j1.stribeck.n": n}
    early, late = [], []
    for seed in range(8):
        result = fitted(plants.stribeck_axis(seed, 0.02, 0.9, n=n), AXIS + "stribeck")
        told = complete(result)
        assert {k: v.value for k, v in told.values.items()} == {
            k: v.value for k, v in result.values.items()
        }
        for z, r in ((early, result), (late, told)):
            z.append([(r.values[k].value - x) / r.values[k].stderr for k, x in true.items()])
        for name, v in result.values.items():
            assert np.isnan(v.stderr) or told.values[name].stderr >= v.stderr
    rms = dict(zip(true, np.sqrt(np.mean(np.square(late), axis=0)), strict=True))
    assert all(x < 2.5 for x in rms.values()), rms
    if n == 1.4:  # between the exponents that are tried: without its error far too sure
        assert np.sqrt(np.nanmean(np.square(early)[:, 3])) > 0 and np.abs(early)[:, 2].min() > 4


def test_shapes_that_are_no_quantity_get_no_error() -> None:
    model = base_model(RobotSource("single-axis")) + "presliding"
    told = complete(fitted(plants.stribeck_axis(0, rho=0.5), model))
    name = "j1.presliding.form"
    assert np.isnan(told.values[name].stderr) and in_words(name, told.values[name].value)
    assert (
        complete(fitted(plants.stribeck_axis(0), AXIS)).values.keys()
        == fitted(plants.stribeck_axis(0), AXIS).values.keys()
    )


def test_told_errors_are_plain_numbers_that_a_file_holds(tmp_path) -> None:
    told = complete(fitted(plants.stribeck_axis(0, 0.02, 0.9, n=1.4), AXIS + "stribeck"))
    assert all(type(v.stderr) is float for v in told.values.values())
    write_model(told.model, tmp_path / "m.toml")
    again = read_model(tmp_path / "m.toml").values()
    assert {n: v.value for n, v in again.items()} == {n: v.value for n, v in told.values.items()}
    assert again["j1.stribeck.n"].stderr == told.values["j1.stribeck.n"].stderr


def test_an_error_that_says_nothing_is_none() -> None:
    model = base_model(RobotSource("single-axis")) + "presliding"
    for name, v in complete(fitted(plants.stribeck_axis(0, vs=0.02), model)).values.items():
        assert not v.stderr > 10 * abs(v.value) or not name.startswith("j1.presliding.v")
