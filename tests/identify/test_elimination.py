"""Small linear systems against LAPACK's answers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.identify.multistep import eliminated


@given(st.integers(0, 2**32 - 1), st.integers(1, 7))
def test_as_lapack_solves(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(20, d, d)), rng.normal(size=(20, d))
    a[3] = a[3][::-1] * (1 - np.eye(d)[::-1]) + np.eye(d)[::-1]  # pivots that are not in place
    kept = a.copy(), b.copy()
    theirs = np.linalg.solve(a, b[..., None])[..., 0]
    size = np.linalg.cond(a)[:, None] * np.abs(theirs).max(axis=1, keepdims=True)
    assert np.all(np.abs(eliminated(a, b) - theirs) <= 1e-13 * size)
    assert np.array_equal(a, kept[0]) and np.array_equal(b, kept[1])


def test_a_zero_on_the_diagonal_needs_another_row() -> None:
    a = np.array([[[0.0, 2.0], [3.0, 0.0]]])
    assert eliminated(a, np.array([[4.0, 9.0]])) == pytest.approx(np.array([[3.0, 2.0]]))


@pytest.mark.parametrize("bad", [np.zeros((2, 2)), np.ones((2, 2)), np.full((2, 2), np.nan)])
def test_a_singular_system_alone_has_no_solution(bad: np.ndarray) -> None:
    a = np.stack([np.eye(2), bad, 2 * np.eye(2)])
    found = eliminated(a, np.array([[1.0, 2.0]] * 3))
    assert not np.isfinite(found[1]).all()
    assert np.array_equal(found[[0, 2]], [[1.0, 2.0], [0.5, 1.0]])
