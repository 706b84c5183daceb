"""Screening of orders: the adjoint filter is exact, and the best order is among the promising."""

from __future__ import annotations

import numpy as np
import plants
import pytest

from hil.identify.design import Term
from hil.identify.prepare import Decimator
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.screening import EXACT_FEW, _overtone, promising, screen
from hil.identify.shape_search import best_shape
from hil.models import catalogue


def test_adjoint_of_the_decimator() -> None:
    rng = np.random.default_rng(1)
    f = Decimator(1024, 200.0, 15.0)
    x, y = rng.normal(size=1024), rng.normal(size=f.times.size)
    assert f(x) @ y == pytest.approx(x @ f.adjoint(y), rel=1e-9)


@pytest.mark.parametrize("name", ["cogging", "position-friction"])
@pytest.mark.parametrize("order", [1.3, 4.2, 9.7])
def test_the_best_order_is_promising_and_its_gain_is_close(name: str, order: float) -> None:
    run = plants.wave_over_position(order, name == "position-friction")
    problem = Problem([run], run.robot)
    projector = Projector(problem, [], np.ones(1))
    term = Term(catalogue.get(name), 0)
    grid = term.effect.search.grid(problem.motions[0], 0)
    exact = np.array([projector.gain(term.reshaped(s)) for s in grid])
    waves = screen(problem, term, grid)
    assert waves is not None
    gains = waves.gains(problem.back(projector.residual, 0))
    best = int(np.argmax(exact))
    assert best in promising(gains)
    assert len(promising(gains)) <= EXACT_FEW + 9
    assert gains[best] == pytest.approx(exact[best], rel=0.15)


def test_flipped_signs_give_the_noise_that_exact_columns_give() -> None:
    run = plants.wave_over_position(3.0, False)
    problem = Problem([run], run.robot)
    term = Term(catalogue.get("cogging"), 0)
    grid = term.effect.search.grid(problem.motions[0], 0)
    noise = np.random.default_rng(5).normal(size=problem.n)
    blocks = np.arange(problem.n) // 30
    signs = np.random.default_rng(6).choice([-1.0, 1.0], size=(60, int(blocks.max()) + 1))
    waves = screen(problem, term, grid)
    assert waves is not None
    near = waves.flipped(problem.back(noise, 0), problem.spread(blocks), signs)
    exact = np.zeros(60)
    for shape in grid:
        c = problem.columns(term.effect, 0, shape)
        q, _ = np.linalg.qr(c)
        flipped = (signs[:, blocks] * noise) @ q
        exact = np.maximum(exact, np.sum(flipped**2, axis=1))
    assert np.quantile(near, 0.95) == pytest.approx(np.quantile(exact, 0.95), rel=0.25)


def test_overtones_lie_at_twice_and_three_times_an_order_where_the_grid_has_them() -> None:
    orders = np.arange(3, 21) / 2  # 1.5, 2, ... 10
    assert orders[_overtone(orders, 2)[:4]].tolist() == [3.0, 4.0, 5.0, 6.0]
    assert orders[_overtone(orders, 3)[:3]].tolist() == [4.5, 6.0, 7.5]
    assert set(_overtone(orders, 2)[orders > 5.0]) == {orders.size}


def test_no_order_over_position_leaves_less_than_the_one_that_is_found() -> None:
    run = plants.wave_over_position(4.2, True)
    problem = Problem([run], run.robot)
    projector = Projector(problem, [], np.ones(1))
    term = Term(catalogue.get("position-friction"), 0)
    grid = term.effect.search.grid(problem.motions[0], 0)
    exact = max(projector.gain(term.reshaped(s)) for s in grid)
    found, gain = best_shape(projector, term)
    assert gain >= exact
    assert found.shape[0] == pytest.approx(4.2, abs=0.05)
