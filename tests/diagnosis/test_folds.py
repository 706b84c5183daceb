"""The one splitter: blocks, guards, folds, and what would be extrapolation."""

from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.diagnosis.constants import FOLDS, GUARD
from hil.diagnosis.grams import split
from hil.identify.problem import Problem


@pytest.fixture(scope="module")
def problem():
    run = plants.smooth_axis(seconds=20.0)
    return Problem([run], run.robot)


def test_every_instant_is_in_one_block_and_blocks_are_contiguous(problem):
    s = split(problem)
    assert s.block.size == problem.n
    assert np.array_equal(np.unique(s.block), np.arange(s.blocks))
    assert np.all(np.diff(s.block) >= 0)
    assert sum(b - a for a, b in s.edges()) == problem.n


def test_what_is_tested_is_a_guard_away_from_what_is_fitted(problem):
    s = split(problem)
    guard = int(np.ceil(GUARD * problem.rate / problem.rates.effort))
    fold = s.fold[s.block]
    for k in range(s.folds):
        tested = np.flatnonzero(s.tested & (fold == k))
        fitted = np.flatnonzero(fold != k)
        near = np.min(np.abs(tested[:, None] - fitted[None]), axis=1)
        assert near.min() > guard


def test_each_fold_is_spread_over_the_whole_run(problem):
    s = split(problem)
    assert s.folds == FOLDS
    for k in range(s.folds):
        blocks = np.flatnonzero(s.fold == k)
        assert np.ptp(blocks) > 0.6 * s.blocks


def test_the_same_seed_deals_the_same(problem):
    assert np.array_equal(split(problem, 3).fold, split(problem, 3).fold)
    assert not np.array_equal(split(problem, 3).fold, split(problem, 4).fold)


def test_three_runs_are_folds_of_their_own():
    runs = [replace(plants.smooth_axis(seed=k, seconds=8.0), name=f"run{k}") for k in range(3)]
    problem = Problem(runs, runs[0].robot)
    s = split(problem)
    first = [a for a, _ in s.edges()]
    assert s.by_run and s.folds == 3
    assert np.array_equal(s.fold, problem.run[first])
    assert not split(problem, whole_runs=False).by_run


def test_where_no_other_fold_has_been_nothing_is_tested():
    run = plants.smooth_axis(seconds=20.0)
    # one short excursion far beyond the rest
    bump = 3.0 * np.exp(-(((run.t - 10.0) / 0.15) ** 2))[:, None]
    problem = Problem([replace(run, q=run.q + bump)], run.robot)
    s = split(problem)
    far = problem.q[0] > np.quantile(problem.q[0], 0.999) - 0.3
    assert np.any(s.extrapolated) and not np.any(s.tested & s.extrapolated)
    assert not np.any(s.tested[far])
    assert np.mean(s.tested) > 0.5
