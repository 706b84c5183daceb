"""Few evaluations to the maximum, also where parabolas close in from one side only."""

import numpy as np
import pytest

from hil.identify.shape_search import line_search


def counted(f):
    known = {}

    def g(x):
        if x not in known:
            known[x] = f(x)
        return known[x]

    return g, known


@pytest.mark.parametrize("top", [0.11, 0.5, 0.73, 0.98])
def test_smooth_maximum_in_few_steps(top):
    g, known = counted(lambda x: 1 / (1 + (x - top) ** 2))
    at = min((0.3, 0.5, 0.7), key=lambda x: abs(x - top))
    x, value = line_search(g, (0.0, at, 1.0), 1e-6)
    assert x == pytest.approx(top, abs=2e-3) and value > 1 - 1e-5
    assert len(known) <= 3 + 8


def test_maximum_next_to_an_end_is_found_and_an_end_is_kept():
    g, _ = counted(lambda x: -((x - 0.2) ** 2))
    assert line_search(g, (0.0, 0.0, 1.0), 1e-9)[0] == pytest.approx(0.2, abs=1e-3)
    g, known = counted(lambda x: -x)
    assert line_search(g, (0.0, 0.0, 1.0), 1e-9) == (0.0, 0.0)
    assert len(known) <= 3


def test_a_kink_is_reached():
    g, _ = counted(lambda x: -((x - 0.05) ** 2) - 30.0 * max(x - 0.05, 0.0) ** 2)
    assert line_search(g, (-0.12, 0.0, 0.12), 1e-9)[0] == pytest.approx(0.05, abs=2e-3)


def test_flat_function_costs_nothing():
    g, known = counted(lambda x: 1.0)
    assert line_search(g, (0.0, 0.5, 1.0), 1e-6) == (0.5, 1.0) and len(known) == 3
    assert np.isfinite(list(known)).all()


def test_a_parabola_whose_vertex_is_in_the_middle_by_chance_ends_nothing():
    """Of three uneven points it says nothing: a sign stayed blunter than the data say."""
    at, value = [0.485, 0.8, 1.0, 1.4, 2.06], [0.735, 1.6, 1.0, 0.3, -0.124]
    g, _ = counted(lambda x: float(np.interp(x, at, value)))
    assert line_search(g, (0.485, 1.0, 2.06), 1e-2)[0] == pytest.approx(0.8, abs=0.05)
