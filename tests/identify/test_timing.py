"""How late efforts are: what counts as an error that falls."""

from types import SimpleNamespace

import numpy as np
import pytest

from hil.identify.timing import _ratio


@pytest.mark.parametrize(
    ("now", "before", "ratio"),
    [
        ([2.0, 8.0], [4.0, 4.0], 1.0),
        ([50.0, 20.0], [200.0, 20.0], 0.5**0.5),
        ([300.0, 90.0], [4000.0, 70.0], (90 / 70) ** 0.5),
        ([1e-3, 50.0], [1e-3, 100.0], 0.5**0.5),
    ],
)
def test_what_foretells_worse_than_nothing_is_no_better_where_it_is_less_bad(now, before, ratio):
    """Of a leg on the ground 4000 % became 300, and the other joint lost: a filter was undone."""
    result = SimpleNamespace(
        problem=SimpleNamespace(holds=np.array([False, False])), relative=np.array(now)
    )
    assert _ratio(result, np.array(before)) == pytest.approx(ratio)
