"""Least squares from products of columns: as from the columns themselves, rows left out or not."""

from __future__ import annotations

import numpy as np
import pytest

from hil.identify.normal import Normal
from hil.identify.regression import basis


def columns(noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two joints, 400 instants, 5 columns: the fourth is the sum of two but for a little noise."""
    rng = np.random.default_rng(4)
    x = rng.normal(size=(2, 400, 5))
    x[..., 3] = x[..., 0] + x[..., 1] + noise * rng.normal(size=(2, 400))
    x[..., 4] = 0.0
    y = x @ np.array([1.0, -2.0, 0.5, 0.3, 0.0]) + 0.1 * rng.normal(size=(2, 400))
    return x, y, np.array([0.1, 0.3])


@pytest.mark.parametrize(("noise", "rank"), [(0.1, 4), (1e-9, 3), (0.0, 3)])
def test_products_without_a_part_of_the_rows_solve_as_the_other_rows_do(
    noise: float, rank: int
) -> None:
    x, y, sigma = columns(noise)
    step, b = (Normal.of(x, y, sigma) - Normal.of(x[:, :80], y[:, :80], sigma)).solved(1e-3)
    rows = (x[:, 80:] / sigma[:, None, None]).reshape(-1, 5)
    target = (y[:, 80:] / sigma[:, None]).reshape(-1)
    direct = basis(rows, 1e-3)
    assert b.rank == direct.rank == rank
    assert b.s == pytest.approx(direct.s, rel=1e-9)
    assert step == pytest.approx(direct.solve(target, np.zeros(5), np.zeros(target.size)), rel=1e-7)
