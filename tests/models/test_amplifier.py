"""Amplifiers: what a limit takes away, and what one motor's command leaves in another."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.models.amplifier import KNEES, TorqueCrosstalk, TorqueSaturation
from hil.models.amplifier import given as gives
from hil.models.catalogue import get


@given(st.floats(0.1, 10.0), st.sampled_from(sorted(KNEES)))
def test_a_limit_is_odd_never_passed_and_unfelt_far_below(limit: float, order: float) -> None:
    u = np.linspace(-5, 5, 101) * limit
    s = gives(u, limit, order)
    np.testing.assert_allclose(s, -gives(-u, limit, order))
    assert np.abs(s).max() <= limit * (1 + 1e-12)
    assert np.all(np.diff(s) >= 0)
    small = np.abs(u) < 0.11 * limit
    np.testing.assert_allclose(s[small], u[small], rtol=6e-3, atol=1e-12)


@pytest.mark.parametrize(
    ("order", "at_limit"), [(0.0, 1.0), (2.0, 1 / np.sqrt(2)), (4.0, 2.0 ** (-1 / 4))]
)
def test_knees_at_their_limit(order: float, at_limit: float) -> None:
    assert gives(np.array([3.0]), 3.0, order)[0] == pytest.approx(3.0 * at_limit)


def test_the_catalogue_has_them() -> None:
    assert isinstance(get("torque-saturation"), TorqueSaturation)
    assert isinstance(get("torque-crosstalk"), TorqueCrosstalk)
    assert TorqueSaturation.strict, "of a gain, a small share of a low limit would be an imitation"
