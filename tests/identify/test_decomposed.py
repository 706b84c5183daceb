"""Decompositions where the usual algorithm of LAPACK gives up."""

import numpy as np
import pytest

from hil.errors import FitError
from hil.identify import regression


@pytest.fixture
def gives_up(monkeypatch):
    def refuse(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(regression.np.linalg, "svd", refuse)
    monkeypatch.setattr(regression.np.linalg, "lstsq", refuse)


def test_the_slower_algorithm_decomposes_too(gives_up):
    rng = np.random.default_rng(0)
    a = rng.normal(size=(40, 7)) * np.logspace(0, -12, 7)
    u, s, vt = regression.decomposed(a)
    assert u.shape == (40, 7) and s.shape == (7,) and vt.shape == (7, 7)
    np.testing.assert_allclose(u * s @ vt, a, atol=1e-14)
    np.testing.assert_allclose(u.T @ u, np.eye(7), atol=1e-12)
    b = regression.basis(a)
    x = b.solve(a @ np.arange(7.0), np.zeros(7), np.zeros(40))
    np.testing.assert_allclose(a @ x, a @ np.arange(7.0), atol=1e-8)


def test_least_squares_of_least_norm(gives_up):
    a = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    np.testing.assert_allclose(regression.least_squares(a, a @ [1.0, 3.0], 1e-9), [2.0, 2.0])


def test_what_is_not_finite_is_refused(gives_up):
    with pytest.raises(FitError, match="infinite or none"):
        regression.decomposed(np.array([[np.nan, 1.0], [0.0, 1.0]]))
    with pytest.raises(FitError, match="infinite or none"):
        regression.least_squares(np.eye(2), np.array([np.inf, 0.0]))
