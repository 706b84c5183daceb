"""Without force sensors: identities, the singularity, sampled data."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from teleop_designs import anchor, designs

from hil.errors import ConfigError
from hil.teleop import architecture, force_sensor_free, hybrid
from hil.teleop.architecture import MotionTerm, Realisation, RobotImpedance
from hil.teleop.hybrid import GEL, HAND

W = 2 * np.pi * np.geomspace(0.05, 50, 30)


@settings(max_examples=40, deadline=None)
@given(designs())
def test_the_transformed_controller_is_the_same_seen_from_both_ports(d):
    assume(d.D > 0.05 and force_sensor_free.conditioning(d) < 50)
    new = force_sensor_free.transform(d, limit=50)
    assert (new.c2, new.c3, new.c5, new.c6) == (0, 0, 0, 0)
    s = hybrid.jw(W)
    e = hybrid.blocks(d, s)
    assume(np.abs(e.a * e.Zs - e.c * e.c4).min() > 1e-2)
    h = hybrid.hybrid(d, s)
    np.testing.assert_allclose(hybrid.hybrid(new, s), h, atol=1e-7 * np.abs(h).max())
    # chi' D = chi
    old, now = (hybrid.characteristic(x, HAND, GEL)(s) for x in (d, new))
    np.testing.assert_allclose(now * d.D, old, rtol=1e-7, atol=1e-7 * np.abs(old).max())
    again = force_sensor_free.transform(new)
    for c in ("c1", "c4", "c7", "c8"):
        assert (getattr(again, c) + -getattr(new, c)).size() < 1e-9 * (1 + getattr(new, c).size())


def test_the_acceleration_gains_are_those_of_the_thesis():
    d = anchor()
    assert RobotImpedance(0.3).term == MotionTerm(0, 0, 0.3)
    new = force_sensor_free.transform(d)
    # A1' = c3 m_m/D, A4' = -c2 m_s/D, A7' = m_s((1 + c6)/D - 1), A8' = m_m((1 + c5)/D - 1)
    got = [new.c1.a, new.c4.a, new.c7.a, new.c8.a]
    want = [0.1 * 0.3, -0.4 * 0.3, 0.3 * (1 - 1.06), 0.3 * (1.1 - 1.06)]
    np.testing.assert_allclose(got, np.array(want) / 1.06, atol=1e-12)
    assert force_sensor_free.conditioning(d) == pytest.approx(1.633, abs=1e-3)


@pytest.mark.parametrize("name", sorted(architecture.DESIGNS))
def test_every_transparent_controller_is_singular_and_refused(name):
    d = architecture.named_design(name)
    if not architecture.is_transparent(d):
        assert force_sensor_free.transform(d).c2 == 0.0
        return
    assert d.D == pytest.approx(0.0, abs=1e-12)
    assert force_sensor_free.conditioning(d) == np.inf
    with pytest.raises(ConfigError, match=r"singularity.*nearest design that works"):
        force_sensor_free.transform(d)


def test_the_nearest_design_is_the_nearest():
    rng = np.random.default_rng(1)
    d = replace(anchor(), c2=1.2, c3=0.95)
    near = force_sensor_free.nearest(d, 9.0)
    assert force_sensor_free.conditioning(near) == pytest.approx(9.0, rel=1e-6)
    assert near.D > 0
    q = force_sensor_free.q_matrix(d)
    best = np.linalg.norm(force_sensor_free.q_matrix(near) - q)
    for _ in range(4000):
        step = rng.normal(size=4) * best / 2
        other = replace(
            d, c2=d.c2 + step[0], c3=d.c3 + step[1], c5=d.c5 + step[2], c6=d.c6 + step[3]
        )
        if np.linalg.norm(step) < best * (1 - 1e-6):
            assert other.D <= 0 or force_sensor_free.conditioning(other) > 9.0
    assert force_sensor_free.nearest(anchor()) == replace(
        anchor(), **{c: pytest.approx(getattr(anchor(), c)) for c in ("c2", "c3", "c5", "c6")}
    )


def test_conditioning_is_the_distance_to_the_singularity():
    rng = np.random.default_rng(2)
    q = force_sensor_free.q_matrix(anchor())
    distance = np.linalg.norm(q, 2) / force_sensor_free.conditioning(anchor())
    for _ in range(3000):
        e = rng.normal(size=(2, 2))
        e *= 0.999 * distance / np.linalg.norm(e, 2)
        assert abs(np.linalg.det(q + e)) > 0
    u, s, vt = np.linalg.svd(q)
    assert abs(np.linalg.det(q - s[1] * np.outer(u[:, 1], vt[1]))) < 1e-12


def test_class_two_estimate_recovers_the_forces_of_nonlinear_robots():
    rng = np.random.default_rng(3)
    d = anchor()
    vm, vs, am, als, fm, fs = rng.normal(size=(6, 50))
    # d_m, d_s: inertia that depends on the motion, and cubic drag; motion part of the laws
    dm, ds = (0.3 + 0.1 * np.sin(vm)) * am + 0.2 * vm**3, 0.3 * als + 0.5 * np.abs(vs) * vs
    q = force_sensor_free.q_matrix(d)
    # whatever moves them, Q f + R(v) = 0 holds: choose the motion part so
    r = -(q @ np.stack([fm, fs])).T
    got = force_sensor_free.estimate(q, r)
    np.testing.assert_allclose(got, np.stack([fm, fs], -1), atol=1e-12)
    # the same from the robots' equations: R = (f_cm0 - d_m, f_cs0 - d_s)
    fcm0 = dm - fm - (d.c6 * fm - d.c2 * fs)
    fcs0 = ds + fs - (d.c3 * fm - d.c5 * fs)
    np.testing.assert_allclose(
        force_sensor_free.estimate(q, np.stack([fcm0 - dm, fcs0 - ds], -1)), got, atol=1e-12
    )


def accelerations(gains, alpha, steps=1500):
    """a_k = m^-1 (f - (M_app - M) a_f,k-1) in units of M: bounded or not."""
    back, af, a = np.linalg.inv(gains) - np.eye(2), np.zeros(2), np.zeros(2)
    for _ in range(steps):
        af = af + alpha * (a - af)
        a = np.array([1.0, 0.3]) - back @ af
        if np.abs(a).max() > 1e6:
            return False
    return True


@pytest.mark.parametrize("hz", [0.0, 20.0, 60.0])
def test_the_sampled_condition_is_the_border_of_the_delayed_loop(hz):
    rng = np.random.default_rng(4)
    seen = set()
    for _ in range(60):
        c = dict(
            zip(
                ("c2", "c3", "c5", "c6"), rng.uniform([0, 0, -0.9, -0.9], [1, 1, 1, 1]), strict=True
            )
        )
        d = replace(anchor(), **c)
        found = force_sensor_free.sampled_condition(d, hz, 1e-3)
        if abs(found.smallest - found.bound) < 0.01 or force_sensor_free.loop_gains(d).imag.any():
            continue
        a = np.array([[1 + d.c6, d.c2], [d.c3, 1 + d.c5]])
        alpha = 1 - np.exp(-2 * np.pi * hz * 1e-3) if hz else 1.0
        assert accelerations(a, alpha) == found.stable
        seen.add(found.stable)
    assert seen == {True, False}


def test_filters_break_the_equivalence_as_predicted():
    # |m_eff / m_app - 1| = |1 - lambda| |1 - G|
    d = replace(anchor(), c2=0.0, c3=0.0, c5=0.5, c6=0.5)
    new = force_sensor_free.transform(d)
    s, real = hybrid.jw(W), Realisation(acceleration_hz=20.0)
    ideal, filtered = (hybrid.blocks(new, s, r) for r in (Realisation(), real))
    m_app = (ideal.Zs - new.c7(s, 1.0, 0.0)) / s
    m_eff = (filtered.Zs - new.c7(s, 1.0, 0.0)) / s
    low = 1 / (1 + s / (2 * np.pi * 20))
    np.testing.assert_allclose(np.abs(m_eff / m_app - 1), 0.5 * np.abs(1 - low), rtol=1e-9)


def test_gains_that_are_no_numbers_and_no_forces_at_all_are_told():
    for made in (
        force_sensor_free.transform,
        force_sensor_free.nearest,
        force_sensor_free.conditioning,
    ):
        with pytest.raises(ConfigError, match="c2 = nan is not finite"):
            made(replace(anchor(), c2=float("nan")))
    none = replace(anchor(), c5=-1.0, c6=-1.0, c2=0.0, c3=0.0)
    for made in (force_sensor_free.nearest, force_sensor_free.transform):
        with pytest.raises(ConfigError, match=r"Q = 0 .* choose c5 and c6 above -1"):
            made(none)
    assert force_sensor_free.nearest(replace(none, c5=-0.9)).D > 0.0
