"""Least squares that says what the data determine."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.identify.regression import basis, cluster_covariance, inflation, reweighted


def regressor(n: int = 200, p: int = 5, seed: int = 0) -> np.ndarray:
    scale = 10.0 ** np.arange(-3, p - 3)
    return np.random.default_rng(seed).normal(size=(n, p)) * scale


def test_full_rank_is_ordinary_least_squares() -> None:
    x, y = regressor(), np.random.default_rng(1).normal(size=200)
    b = basis(x)
    expected = np.linalg.lstsq(x, y, rcond=None)[0]
    prior = np.arange(5.0)
    np.testing.assert_allclose(b.solve(y, prior, x @ prior), expected, rtol=1e-9)
    assert b.rank == 5 and b.identifiable().all() and b.condition < 2


@given(seed=st.integers(0, 10**6))
def test_undetermined_directions_stay_at_the_prior(seed: int) -> None:
    """Fourth column = first + second: the fit is unique in effort, the prior decides the rest."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(60, 4))
    x[:, 3] = x[:, 0] + x[:, 1]
    truth, prior = rng.normal(size=4), rng.normal(size=4)
    b = basis(x)
    theta = b.solve(x @ truth, prior, x @ prior)
    assert b.rank == 3
    assert b.identifiable().tolist() == [False, False, True, False]
    np.testing.assert_allclose(x @ theta, x @ truth, atol=1e-9)
    null = np.array([1.0, 1.0, 0.0, -1.0])  # x @ null = 0
    scaled = null * b.scale  # the direction in scaled parameters
    assert np.abs(b.v.T @ scaled).max() < 1e-9 * np.linalg.norm(scaled)
    np.testing.assert_allclose(theta - truth, null * (theta - truth)[0], atol=1e-9)
    # minimal change in scaled parameters: orthogonal to the null direction
    assert abs((theta - prior) * b.scale @ scaled) < 1e-8 * (scaled @ scaled)


def test_consistent_prior_is_returned_unchanged() -> None:
    x = regressor()
    x[:, 4] = 2 * x[:, 2]
    prior = np.array([3.0, -1.0, 2.0, 0.5, 7.0])
    np.testing.assert_allclose(basis(x).solve(x @ prior, prior, x @ prior), prior, rtol=1e-12)


def test_zero_columns_are_not_identifiable() -> None:
    x = regressor()
    x[:, 1] = 0.0
    b = basis(x)
    theta = b.solve(x[:, 2], np.full(5, 9.0), x @ np.full(5, 9.0))
    assert b.identifiable().tolist() == [True, False, True, True, True]
    np.testing.assert_allclose(theta, [0, 9, 1, 0, 0], atol=1e-6)


def test_columns_of_rounding_are_zero() -> None:
    """A link's first moment about an axis that cannot feel it: 1e-17, not a parameter of 1e12."""
    x = regressor(p=3)
    x[:, 1] = 1e-16 * np.random.default_rng(1).normal(size=200)
    b = basis(x)
    assert b.identifiable().tolist() == [True, False, True]
    assert b.solve(x[:, 0], np.array([0.0, 5.0, 0.0]), 5 * x[:, 1])[1] == 5.0


def test_a_regressor_of_zeros_determines_nothing() -> None:
    b = basis(np.zeros((10, 3)))
    assert b.rank == 0 and not b.identifiable().any() and b.condition == np.inf
    np.testing.assert_array_equal(b.solve(np.ones(10), np.arange(3.0), np.zeros(10)), [0, 1, 2])


def test_what_moves_less_than_the_noise_is_left_out() -> None:
    x = regressor(p=2) / [1e-3, 1e-2]
    x[:, 1] = x[:, 0] + 1e-3 * x[:, 1]
    assert basis(x, 1e-9).rank == 2
    assert basis(x, 1e-2).rank == 1
    assert not basis(x, 1e-2).identifiable().any()


def coloured(rng: np.random.Generator, n: int, rho: float) -> np.ndarray:
    out = rng.normal(size=n)
    for k in range(1, n):
        out[k] = rho * out[k - 1] + np.sqrt(1 - rho**2) * out[k]
    return out


def test_cluster_covariance_covers_under_coloured_noise() -> None:
    n, trials = 1500, 200
    t = np.arange(n)
    x = np.stack([np.ones(n), np.sin(t / 60.0), np.cos(t / 97.0), 1e-3 * t / n], axis=1)
    b, blocks, rng = basis(x), t // 50, np.random.default_rng(7)
    estimates, errors = [], []
    for _ in range(trials):
        y = coloured(rng, n, 0.85)
        theta = b.solve(y, np.zeros(4), np.zeros(n))
        cov = cluster_covariance(y - x @ theta, b, blocks)
        estimates.append(theta)
        errors.append(np.sqrt(np.diag(cov)))
    spread, stated = np.std(estimates, axis=0), np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all((stated / spread > 0.7) & (stated / spread < 1.3)), stated / spread
    inside = np.mean(np.abs(np.array(estimates)) < 1.96 * np.array(errors))
    assert 0.86 < inside < 0.97
    white = np.sqrt(np.diag(np.linalg.inv(x.T @ x)))
    assert np.all(spread > 2.5 * white)  # what the usual formula would have claimed


def test_covariance_is_symmetric_and_semidefinite() -> None:
    x = regressor()
    x[:, 4] = x[:, 0] / 1e-3
    r = np.random.default_rng(2).normal(size=200)
    cov = cluster_covariance(r, basis(x), np.arange(200) // 10)
    scale = np.sqrt(np.outer(np.diag(cov), np.diag(cov)))
    np.testing.assert_allclose(cov, cov.T, rtol=1e-12)
    assert np.linalg.eigvalsh(cov / scale).min() > -1e-9


def test_inflation_measures_colour_within_runs() -> None:
    rng = np.random.default_rng(3)
    run = np.repeat([0, 1], 4000)
    assert inflation(rng.normal(size=8000), run) == pytest.approx(1.0, abs=0.15)
    rho = 0.8  # (1 + rho) / (1 - rho) = 9
    assert inflation(coloured(rng, 8000, rho), run) == pytest.approx(9.0, rel=0.25)
    assert inflation(np.zeros(100), np.zeros(100, int)) == 1.0


def test_blocks_far_above_the_others_count_less():
    """A push of a tenth of the time bends a fit of squares, and hides in what it leaves."""
    rng, blocks = np.random.default_rng(0), np.repeat(np.arange(40), 50)
    x = rng.standard_normal((2, 2000, 3))
    x[1, 500:600] = 0.0  # rows that do not count
    theta, r = np.array([1.0, -2.0, 0.5]), 0.1 * rng.standard_normal((2, 2000))
    r[1, 500:600] = 0.0
    pushed = r + x @ theta
    pushed[:, 1000:1200] += 3.0 * x[:, 1000:1200, 0]
    rows, y = x.reshape(-1, 3), pushed.reshape(-1)
    plain = y - rows @ np.linalg.lstsq(rows, y, rcond=None)[0]
    left = reweighted(x, pushed, blocks)
    quiet = np.r_[0:500, 600:1000, 1200:2000]
    assert np.std(plain.reshape(2, -1)[:, quiet]) > 0.2
    assert np.std(left[:, quiet]) == pytest.approx(0.1, rel=0.05)
    assert left[:, 1000:1200] == pytest.approx(
        pushed[:, 1000:1200] - x[:, 1000:1200] @ theta, abs=0.1
    )
    # without anything to count less it is the fit of squares
    bare = r + x @ theta
    y = bare.reshape(-1)
    same = y - rows @ np.linalg.lstsq(rows, y, rcond=None)[0]
    assert reweighted(x, bare, blocks).reshape(-1) == pytest.approx(same, abs=5e-3)
    assert not np.any(reweighted(0.0 * x, 0.0 * r, blocks))
