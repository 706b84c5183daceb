"""Amplifiers: what a limit takes away, and what one motor's command leaves in another."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.models.actuator import KNEES, TorqueCrosstalk, TorqueSaturation
from hil.models.actuator import given as gives
from hil.models.catalogue import get
from hil.models.effect import refused, strict
from hil.models.motion import Motion
from hil.models.robots import IndependentAxes


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
    assert strict(TorqueSaturation()), (
        "of a gain, a small share of a low limit would be an imitation"
    )


def made(q: np.ndarray, tau: np.ndarray | None = None) -> Motion:
    """A motion of two axes through positions (n, 2) with efforts (n, 2)."""
    zero, one = np.zeros(q.shape), np.ones(2)
    return Motion(
        t=np.arange(len(q)) / 100.0,
        q=q,
        qd=zero,
        qdd=zero,
        tau=zero if tau is None else tau,
        tau_ext=zero,
        load=zero,
        static=zero,
        v0=one,
        resolution=one,
        contact=np.array([[0.0, 1.0]] * 2),
        span=np.stack([q.min(axis=0), q.max(axis=0)], axis=1),
        robot=IndependentAxes(("a", "b")),
    )


@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_a_leak_of_less_than_a_percent_of_what_it_reaches_is_none(unit: float) -> None:
    """Whatever the units, and however much stronger the other motor is."""
    t = np.linspace(0, 9, 300)
    motion = made(np.stack([t, t], axis=1), np.stack([np.sin(t), 20 * np.cos(t)], axis=1) * unit)
    leak = TorqueCrosstalk()

    def credible(j: int, share: float) -> bool:
        return not refused(leak, motion, j, (2.0 - j,), (share,), (1e-6,))

    assert credible(0, 0.0006) and credible(0, -0.0006) and not credible(0, 0.0004)
    assert credible(1, 0.21) and not credible(1, 0.19)
    assert not credible(1, 1.5), "that is another channel"


def test_what_a_leak_is_set_against_knows_no_zero_and_no_unit_of_the_positions() -> None:
    n = 200
    q = np.random.default_rng(1).uniform(-0.4, 0.7, (n, 2))

    def law(scale: float, shift: float) -> np.ndarray:
        (columns,) = TorqueCrosstalk.relations.foils(made(scale * q + shift), 0, (2.0,))
        return columns

    assert law(1.0, 0.0).shape == (n, 9)
    np.testing.assert_allclose(law(1e-3, 3.0), law(1.0, 0.0), atol=1e-9)
