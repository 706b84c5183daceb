"""Bounds hold, whatever the data determine, and the rest is the best that they allow."""

import numpy as np
import plants
import pytest
import scipy.optimize

from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.identify.projector import _kept
from hil.identify.regression import basis
from hil.identify.solve import bounded
from hil.models import catalogue
from hil.models.model import base_model
from hil.record.recording import RobotSource

INF = np.inf


def problem(seed: int, p: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(60, p)) @ (np.eye(p) + 0.9 * rng.normal(size=(p, p)))
    return x, x @ rng.normal(size=p) + rng.normal(size=60)


def solved(x: np.ndarray, y: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    b, p = basis(x), x.shape[1]
    return bounded(b.solve(y, np.zeros(p), np.zeros(len(y))), b, low, high)


@pytest.mark.parametrize("seed", range(20))
def test_solution_is_optimal_for_correlated_columns(seed: int) -> None:
    """Moving what left its bounds onto them is not enough: others must be let go again."""
    x, y = problem(seed)
    got = solved(x, y, np.zeros(5), np.full(5, INF))
    np.testing.assert_allclose(got, scipy.optimize.nnls(x, y)[0], atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_solution_beside_free_columns_and_between_two_bounds(seed: int) -> None:
    x, y = problem(seed, 6)
    low = np.array([-INF, 0.0, -0.2, -INF, 0.1, -INF])
    high = np.array([INF, INF, 0.3, -0.1, 0.4, INF])
    got = solved(x, y, low, high)
    assert np.all((got >= low) & (got <= high))
    expected = scipy.optimize.lsq_linear(x, y, (low, high), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(got, expected, atol=1e-7)


@pytest.mark.parametrize("seed", range(10))
def test_undetermined_coefficients_keep_their_bounds_at_no_cost(seed: int) -> None:
    """Two columns with one sum: the negative one goes to zero, the other takes its share."""
    x, y = problem(seed, 4)
    x = np.concatenate([x, x[:, :1], 1e-3 * x[:, 1:2], np.zeros((60, 1))], axis=1)
    y = y - 3 * x[:, 0]
    low = np.array([-INF, -INF, -INF, -INF, 0.0, 0.0, 0.5])
    free = basis(x).solve(y, np.zeros(7), np.zeros(60))
    got = solved(x, y, low, np.full(7, INF))
    assert np.all(got >= low) and got[6] == 0.5
    np.testing.assert_allclose(x @ got, x @ free, atol=1e-4)


def test_bounds_that_hold_already_change_nothing() -> None:
    x, y = problem(0)
    b = basis(x)
    theta = b.solve(y, np.zeros(5), np.zeros(60))
    assert bounded(theta, b, theta - 1e-9, np.full(5, INF)) is theta


def test_undetermined_armature_is_not_negative() -> None:
    """On the arm's first axes the rotor's inertia is one with the links'."""
    guess = RobotSource("", plants.spatial_urdf((2.0, 2.0, 2.0)))
    model = base_model(guess)
    result = fit(Problem([plants.spatial(1)], guess), model)
    free = fit(Problem([plants.spatial(1)], guess), model - "armature")
    armature = [result.values[f"j{k}.armature.ia"] for k in (1, 2, 3)]
    assert all(v.value >= 0 for v in armature)
    tied = [v for v in armature if not v.identifiable]
    assert tied and all(v.at_bound == (v.value == 0) for v in armature)
    assert any(v.at_bound for v in tied)
    np.testing.assert_allclose(result.rms, free.rms, rtol=1e-2)


def test_coefficients_of_which_the_base_knows_all_are_none() -> None:
    """No column is left for them to be fitted by."""
    effect = catalogue.get("presliding")
    size = len(effect.params)
    assert size > 1 and all(p.lower == 0 for p in effect.params)
    vector, nothing = np.eye(size), np.zeros(size)
    for _ in range(50):
        assert not np.any(_kept(effect, np.ones(size), vector, nothing, np.ones(size)))
