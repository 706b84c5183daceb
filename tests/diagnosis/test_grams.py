"""Held-out errors from block-wise products are those of fits to the rows."""

import numpy as np
import plants
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.diagnosis.grams import GramTable, Group, split
from hil.identify.problem import Problem


@pytest.fixture(scope="module")
def made():
    run = plants.smooth_axis(seconds=20.0)
    problem = Problem([run], run.robot)
    return problem, split(problem)


def group(key, columns, lower=-np.inf, upper=np.inf, shrink=0.0):
    m = columns.shape[1]
    return Group(key, 0, columns, np.full(m, lower), np.full(m, upper), np.zeros(m), shrink)


def columns(problem, *names):
    parts = {
        "a": lambda m: m.qdd,
        "v": lambda m: m.qd,
        "s": lambda m: m.sign(0)[:, None],
        "1": lambda m: np.ones((m.n, 1)),
        "q": lambda m: m.q,
    }
    return [group(n, problem.gated([parts[n](m) for m in problem.motions], 0)) for n in names]


def by_rows(problem, folds, x):
    """Squared error of every block by plain least squares over the rows of the other folds."""
    out, fold = np.zeros(folds.blocks), folds.fold[folds.block]
    for k in range(folds.folds):
        theta = np.linalg.lstsq(x[fold != k], problem.y[0][fold != k], rcond=None)[0]
        left = (problem.y[0] - x @ theta) ** 2 * (folds.tested & problem.live[0])
        out += np.bincount(folds.block, np.where(fold == k, left, 0.0), minlength=folds.blocks)
    return out


@given(st.sets(st.sampled_from("avs1q"), min_size=1))
def test_any_subset_of_columns_gives_what_the_rows_give(made, names):
    problem, folds = made
    groups = columns(problem, *"avs1q")
    table = GramTable(problem, folds, np.array([0.01]), groups)
    keys = sorted(names)
    x = np.concatenate([g.columns for g in groups if g.key in keys], axis=1)
    expected = by_rows(problem, folds, x)
    found = table.errors([g.key for g in groups if g.key in keys]).squared[:, 0]
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-6 * expected.sum())


def test_models_that_are_judged_together_have_the_errors_that_each_has_alone(made):
    problem, folds = made
    own, more = columns(problem, *"av1"), columns(problem, *"sq")
    table = GramTable(problem, folds, np.array([0.01]), own, more)
    models = [list("av1"), list("av1s"), list("a1q"), list("av1q")]
    together = table.each(models)
    for keys, found in zip(models, together, strict=True):
        alone = table.errors(keys)
        assert found.squared == pytest.approx(alone.squared, rel=1e-9)
        assert np.array_equal(found.count, alone.count)


def test_left_out_rows_give_the_same_errors(made):
    problem, folds = made
    table = GramTable(problem, folds, np.array([0.01]), columns(problem, *"avs1"))
    left = table.left_out(list("avs1"))[0] * problem.live[0]
    each = np.bincount(folds.block, left**2, minlength=folds.blocks)
    assert each == pytest.approx(table.errors(list("avs1")).squared[:, 0], rel=1e-6, abs=1e-12)


def test_a_coefficient_that_leaves_its_bound_lies_on_it(made):
    problem, folds = made
    a, v, s, one = columns(problem, *"avs1")
    bounded = Group("v", 0, v.columns, np.array([0.2]), np.array([np.inf]), np.zeros(1))
    table = GramTable(problem, folds, np.array([0.01]), [a, bounded, s, one])
    found = table.coefficients(["a", "v", "s", "1"])
    assert found["v"][0] == pytest.approx(0.2)  # the truth is 0.1
    free = GramTable(problem, folds, np.array([0.01]), [a, v, s, one]).coefficients(list("avs1"))
    assert free["v"][0] == pytest.approx(0.1, abs=0.02)
    assert found["s"][0] < free["s"][0]  # the others make up for it


def test_what_no_row_sees_stays_at_its_prior(made):
    problem, folds = made
    nothing = Group(
        "x", 0, np.zeros((problem.n, 1)), np.array([-9.0]), np.array([9.0]), np.array([3.0])
    )
    table = GramTable(problem, folds, np.array([0.01]), [*columns(problem, *"avs1"), nothing])
    assert table.coefficients([*"avs1", "x"])["x"][0] == 3.0


def test_a_column_of_noise_costs_on_left_out_blocks(made):
    problem, folds = made
    noise = np.random.default_rng(0).normal(size=(problem.n, 30))
    table = GramTable(
        problem, folds, np.array([0.01]), [*columns(problem, *"avs1"), group("n", noise)]
    )
    assert table.errors([*"avs1", "n"]).power[0] > table.errors(list("avs1")).power[0]


def test_a_group_apart_gives_what_it_gives_among_the_others(made):
    problem, folds = made
    every = columns(problem, *"avs1q")
    whole = GramTable(problem, folds, np.array([0.01]), every)
    apart = GramTable(problem, folds, np.array([0.01]), every[:3], every[3:])
    for keys in ("avs", "avs1", "avsq", "as1"):
        one, other = whole.errors(list(keys)), apart.errors(list(keys))
        assert one.squared == pytest.approx(other.squared, rel=1e-9)
        assert whole.residual(list(keys), 0) == pytest.approx(apart.residual(list(keys), 0))
    with pytest.raises(ValueError, match="one at a time"):
        apart.errors(list("avs1q"))


def test_a_candidate_whose_state_runs_away_says_nothing_of_the_others(made):
    """A link that swings up behind a soft spring had made every other column rounding."""
    problem, folds = made
    every = columns(problem, *"avs1q")
    away = group("x", np.exp(np.linspace(0.0, 60.0, problem.n))[:, None])
    alone = GramTable(problem, folds, np.array([0.01]), every[:3], every[3:])
    beside = GramTable(problem, folds, np.array([0.01]), every[:3], [*every[3:], away])
    for keys in ("avs", "avs1", "avsq"):
        one, other = alone.errors(list(keys)), beside.errors(list(keys))
        assert one.squared == pytest.approx(other.squared, rel=1e-9)
    assert np.isfinite(beside.errors([*"avs", "x"]).squared).all()
