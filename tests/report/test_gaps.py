"""A law is drawn wherever anything was recorded, and nowhere else."""

import numpy as np

from hil.report.effects import FEWEST, _means
from hil.report.html import _simulated


def test_means_leave_gaps_where_nothing_is_and_draw_the_law_where_little_is():
    """A line went straight from one end of a sparse stretch to the other, through no point."""
    edges = np.arange(6.0)
    x = np.array([0.5] * FEWEST + [1.5] * 2 + [3.5] * FEWEST)
    law = x**2
    found = _means(x, law + 1.0, law, edges)
    assert found["x"] == [0.5, 1.5, 2.5, 3.5]
    assert found["law"] == [0.25, 2.25, None, 12.25]
    assert found["data"] == [1.25, None, None, 13.25]
    assert _means(np.array([9.0]), np.ones(1), np.ones(1), edges) == {
        "x": [],
        "data": [],
        "law": [],
    }


def test_a_simulation_that_left_everything_is_said_to_diverge():
    """A table of the report had 1.6e+08 %."""
    assert _simulated(1.6e8) == _simulated(float("inf")) == "diverged"
    assert _simulated(87.4) == "87.4 %" and _simulated(float("nan")) == "-"
