"""Sensitivity-optimised design: constraints kept, optimum real, reasons right, fast re-design."""

from dataclasses import replace

import numpy as np
import pytest

from hil.errors import ConfigError
from hil.teleop import force_sensor_free, hybrid, optimise, passivity
from hil.teleop.architecture import Realisation
from hil.teleop.hybrid import Impedance
from hil.teleop.optimise import ORDER, DesignProblem, DesignSearch
from hil.teleop.summary import tracking, weighted

REAL = Realisation(velocity_hz=32, acceleration_hz=30, force_hz=32)
PROBLEM = DesignProblem(real=REAL)


@pytest.fixture(scope="module")
def found():
    return optimise.optimise(PROBLEM, starts=3)


@pytest.mark.slow
def test_the_optimum_keeps_every_constraint_on_a_finer_grid(found):
    d, w = found.design, np.geomspace(0.1, 1000, 1777)
    h = hybrid.hybrid(d, hybrid.jw(w), REAL)
    largest = np.abs(PROBLEM.largest(hybrid.jw(w)))
    assert passivity.half_disc(h, largest).min() > -0.02
    slow = 2 * np.pi * np.geomspace(0.05, 1, 50)
    hs = hybrid.hybrid(d, hybrid.jw(slow), REAL)
    assert tracking(hs, 0.0, 1.0).max() < 0.2 * 1.01
    assert tracking(hs, PROBLEM.environment(hybrid.jw(slow)), 1.0).max() < 0.6 * 1.01
    assert force_sensor_free.conditioning(d) < 1.5 * 1.001
    assert hybrid.poles(d, PROBLEM.operator, PROBLEM.environment, REAL).real.max() < 0
    for name in ORDER:
        value = getattr(d, name)
        size = value if isinstance(value, float) else value.b * (-1 if name == "c4" else 1)
        assert -1e-9 <= size <= PROBLEM.bounds()[ORDER.index(name)] + 1e-9


def test_nothing_near_it_is_better(found):
    """The corners beat the anchor of the theory, and random neighbours do not beat the optimum."""
    search, rng = DesignSearch(PROBLEM), np.random.default_rng(0)
    x = np.array(found.theta) / search.top
    assert found.sensitivity > 0.489
    better = 0
    for _ in range(400):
        y = np.clip(x + 0.05 * rng.normal(size=8), 0, 1)
        if search.worst(y)[1] > 0 and search.sensitivity(y) > 1.01 * found.sensitivity:
            better += 1
    assert better == 0
    assert found.agreeing >= 2


@pytest.mark.parametrize(
    ("name", "relaxed"),
    [
        ("stability", {"largest": Impedance(0.0, 6.0, 1300.0)}),
        ("c8 upper", {"stiffness": 330.0}),
    ],
)
def test_an_active_constraint_is_one_whose_relaxation_helps(found, name, relaxed):
    active = {a.name: a for a in found.active}
    assert active[name].price > 0
    assert active[name].text
    more = optimise.optimise(replace(PROBLEM, **relaxed), start=found.theta)
    assert more.sensitivity > found.sensitivity * 1.002


def test_the_price_of_the_estimation_singularity():
    soft = replace(PROBLEM, environment=Impedance(0, 3, 600.0), stiffness=240.0, contact=0.8)
    tight = optimise.optimise(soft, starts=2)
    (fsf_price,) = [a.price for a in tight.active if a.name == "fsf"]
    wide = optimise.optimise(replace(soft, kappa=1.6), start=tight.theta)
    assert fsf_price > 0
    assert wide.sensitivity > tight.sensitivity * 1.002


def test_a_neighbouring_design_from_a_warm_start_is_as_good_as_from_afar(found):
    near = replace(PROBLEM, environment=Impedance(0.0, 1.7, 340.0))
    warm = optimise.optimise(near, start=found.theta)
    cold = optimise.optimise(near, starts=2)
    assert warm.starts == 1
    assert warm.sensitivity > 0.99 * cold.sensitivity


def test_stage_two_needs_no_force_and_is_the_same_two_port(found):
    so, free = found.design, force_sensor_free.transform(found.design)
    assert (free.c2, free.c3, free.c5, free.c6) == (0, 0, 0, 0)
    s = hybrid.jw()
    h = hybrid.hybrid(so, s)
    np.testing.assert_allclose(hybrid.hybrid(free, s), h, atol=1e-9 * np.abs(h).max())


@pytest.mark.slow
def test_what_cannot_be_met_is_said():
    with pytest.raises(ConfigError, match=r"no design meets all.*contact tracking"):
        optimise.optimise(replace(PROBLEM, contact=0.02, stiffness=60.0), starts=2)
    with pytest.raises(ConfigError, match="kappa"):
        DesignProblem(kappa=1.0)


def test_the_sensitivity_is_that_of_the_whole_band(found):
    """What the search reports is what a dense grid over 0.2 to 5 Hz gives, for any weight."""
    w = 2 * np.pi * np.linspace(0.2, 5.0, 4000)
    search, x = DesignSearch(PROBLEM), np.array(found.theta) / PROBLEM.bounds()
    size = hybrid.sensitivity(
        hybrid.hybrid(found.design, hybrid.jw(w), REAL), PROBLEM.environment(hybrid.jw(w))
    )
    assert search.w[[0, -1]] == pytest.approx(2 * np.pi * np.array([0.2, 5.0]))
    for weight in (0.0, -1.0, 1.0):
        there = np.sqrt((np.abs(size) ** 2 * w**weight).sum() / (w**weight).sum())
        got = DesignSearch(replace(PROBLEM, weight=weight)).sensitivity(x)
        assert got == pytest.approx(there, rel=0.02)
        assert weighted(size, w, weight) == pytest.approx(there, rel=1e-3)


def test_a_weight_that_is_no_number_is_refused():
    with pytest.raises(ConfigError, match="weight = nan"):
        replace(PROBLEM, weight=float("nan"))


def test_scales_are_a_change_of_units_of_the_leader(found):
    """With v_m' = kp v_m and f_m' = f_m / kf the two-port is the one without scales."""
    kp, kf = 2.0, 0.5  # kp kf = 1: the leader's impedance is the same in the other units
    one = DesignSearch(PROBLEM)
    two = DesignSearch(replace(PROBLEM, motion_scale=kp, force_scale=kf))
    x = np.clip(np.array(found.theta) / one.top, 0.0, 1.0)
    a, b = one.design(x), two.design(x)
    assert (b.motion_scale, b.force_scale) == (kp, kf)
    s = hybrid.jw(np.geomspace(0.1, 300, 50))
    h, scaled = hybrid.hybrid(a, s, REAL), hybrid.hybrid(b, s, REAL)
    np.testing.assert_allclose(scaled * np.array([[1, 1 / kf], [1 / kp, 1]]), h, rtol=1e-9)
    assert two.sensitivity(x) == pytest.approx(one.sensitivity(x))
    for name, slack in one.constraints(x).items():
        if name != "fsf":  # Q has the other gains
            np.testing.assert_allclose(two.constraints(x)[name], slack, rtol=1e-6, atol=1e-9)
    with pytest.raises(ConfigError, match="force_scale = 0"):
        replace(PROBLEM, force_scale=0.0)
