"""Runs that are alike but for their states are simulated at once; others are not."""

from dataclasses import replace

import numpy as np
import plants

from hil.identify.multistep import groups, joined, runs_of
from hil.identify.problem import Problem


def test_runs_are_joined_where_they_are_alike() -> None:
    runs = [plants.coulomb_axes(k, 4000, d=2, drag=0.1) for k in range(3)]
    motions = Problem(runs, runs[0].robot).motions
    assert groups(motions, {"q", "qd", "v0"}) == [[0, 1, 2]]
    other = replace(motions[1], v0=2 * motions[1].v0)
    assert groups([motions[0], other, motions[2]], {"qd", "v0"}) == [[0, 2], [1]]
    assert groups([motions[0], other], {"qd"}) == [[0, 1]]


def test_a_joined_run_holds_the_states_of_all() -> None:
    runs = [plants.coulomb_axes(k, 4000, d=2, drag=0.1) for k in range(2)]
    motions = Problem(runs, runs[0].robot).motions
    both = joined(motions)
    assert runs_of(both) == tuple(motions)
    assert joined(motions[:1]) is motions[0]
    assert np.array_equal(both.q, np.concatenate([m.q for m in motions]))
    assert both.dt == motions[0].dt
