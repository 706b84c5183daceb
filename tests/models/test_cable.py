"""A cable that is soft about zero tension: its state against a dense solution, and its limits."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfiltfilt

from hil.models import catalogue
from hil.models.effect import refused
from hil.models.kernels import softened, sprung
from hil.models.motion import Motion
from hil.models.robots import IndependentAxes

INERTIA, STEP = 0.004, 2e-3
CABLE = catalogue.get("hardening-cable")


def load_at(t):
    return 0.02 * np.sin(5.7 * t) + 0.012 * np.sin(17.0 * t + 1) + 0.006 * np.sin(37.7 * t)


def dense(t, stretch, tension, lag):
    """P of  I d'' + P = L,  P = T + c T',  T' = d' dT/dd,  dT/dd = (T0 / s)(1 + |T| / T0)^2."""

    def stiffness(pull):
        return tension / stretch * (1 + np.abs(pull) / tension) ** 2

    def rates(now, state):
        pull, v = state
        rise = stiffness(pull) * v
        return [rise, (load_at(now) - pull - lag * rise) / INERTIA]

    start = [load_at(0.0), 0.0]
    found = solve_ivp(rates, (0, t[-1]), start, "LSODA", t, rtol=1e-8, atol=1e-10, max_step=5e-4)
    pull, v = found.y
    return pull + lag * stiffness(pull) * v


def rms(x):
    """Root mean square of what the effort filter passes, transients at the ends left out."""
    sos = butter(4, 25.0, fs=1 / STEP, output="sos")
    return float(np.std(sosfiltfilt(sos, x)[200:-200]))


@pytest.mark.parametrize(
    ("f", "tension", "zeta"), [(3.0, 0.003, 0.2), (6.0, 0.01, 0.1), (8.0, 0.02, 0.1)]
)
def test_the_kernel_solves_its_equation(f: float, tension: float, zeta: float) -> None:
    t = np.arange(3000) * STEP
    lag, stretch = zeta / (np.pi * f), tension / (INERTIA * (2 * np.pi * f) ** 2)
    exact, load, one = dense(t, stretch, tension, lag), load_at(t), np.ones(t.size)
    still = 0 * one, STEP, stretch, tension, lag * one, 0.0, 1.0
    misses = [
        rms(softened(load, t, INERTIA * one, *still, n)[0] - exact) / rms(exact - load)
        for n in (1, 2, 4)
    ]
    assert misses[0] < 0.05
    # what is left at last is that of a difference of speeds two samples apart
    assert misses[2] < 0.012
    assert misses[1] < misses[0]


@pytest.mark.parametrize("heavy", [0.0, 0.3])
def test_with_much_tension_to_take_up_it_is_an_elastic_transmission(heavy: float) -> None:
    t = np.arange(3000) * STEP
    load, inertia, f, zeta = load_at(t), np.full(t.size, INERTIA), 6.0, 0.1
    stiffness, lag = INERTIA * (2 * np.pi * f) ** 2, np.full(t.size, zeta / (np.pi * f))
    weight = heavy * stiffness * np.cos(3 * t)
    spring, _, _ = sprung(load, inertia, weight, STEP, stiffness, zeta)
    cable = softened(load, t, inertia, weight, STEP, 1e3 / stiffness, 1e3, lag, 0.0, 1.0, 4)[0]
    # the cable begins at rest and the spring within a motion: after 2 s both have forgotten it
    settled = slice(1000, None)
    assert rms((cable - spring)[settled]) < 0.02 * rms((spring - load)[settled])


@pytest.mark.parametrize("size", [0.0, 1e-6, 1e6])
@pytest.mark.parametrize("tension", [1e-12, 0.01, 1e6])
def test_a_blow_s_momentum_arrives_and_no_step_gains_any(size: float, tension: float) -> None:
    t = np.arange(2000) * STEP
    load, inertia = size * load_at(t), np.full(t.size, INERTIA)
    lag = np.full(t.size, 0.01)
    passed = softened(load, t, inertia, 0 * t, STEP, 1e-3, tension, lag, 0.0, 1.0, 1)[0]
    # I d'' = L - P, so that the sum of both is the link's own momentum, twice that of the sample
    momentum = np.cumsum(load - passed) * STEP
    assert np.all(np.isfinite(passed))
    fastest = np.max(np.abs(load)) * t[-1]
    assert np.max(np.abs(momentum)) <= fastest
    if tension < size:  # within the play: half of it, at most at the speed that the load gives
        reach = np.sqrt(2 * np.max(np.abs(load)) * 2e-3 / INERTIA) * INERTIA
        assert np.max(np.abs(momentum)) < 1.5 * reach


def stiffness(f: float) -> float:
    """Of a spring on which the link swings at a frequency [Hz]."""
    return INERTIA * (2 * np.pi * f) ** 2


def swing(n: int = 4000) -> Motion:
    t = np.arange(n) * STEP
    q = np.stack([0.3 * np.sin(3 * t) + 0.05 * np.sin(11 * t)], axis=1)
    qd, qdd = np.gradient(q, STEP, axis=0), np.gradient(np.gradient(q, STEP, axis=0), STEP, axis=0)
    load, zero = INERTIA * qdd, np.zeros_like(q)
    return Motion(
        t=t,
        q=q,
        qd=qd,
        qdd=qdd,
        tau=load,
        tau_ext=zero,
        load=load,
        static=zero,
        v0=np.full(1, 0.01),
        resolution=np.full(1, 0.01),
        span=np.array([[-1.0, 1.0]]),
        contact=np.full((1, 2), np.nan),
        robot=IndependentAxes(("a",)),
    )


def test_the_friction_of_the_link_slows_it_in_its_flight() -> None:
    motion = swing()
    size, fastest = (float(f(motion.load)) for f in (np.std, np.max))
    # a play in all but name: in flight nothing arrives, and the load lacks its friction, too
    free, rubbed = (
        CABLE.columns(motion, 0, (stiffness(2.0), 1e-3 * size, 0.05, r, 0.0))[:, 0]
        for r in (0.0, 0.3 * size)
    )
    assert np.max(np.abs(rubbed - free)) > 0.2 * fastest
    # driven by the motor both lie at the flank: what is passed differs by friction, which is known
    carried = np.abs(motion.load[:, 0]) > 0.9 * fastest
    assert np.median(np.abs(rubbed[carried])) < 0.05 * fastest


def test_what_is_hardly_soft_or_hardly_carries_is_another_effect() -> None:
    motion = swing()
    size = float(np.std(motion.load))
    assert not refused(CABLE, motion, 0, (stiffness(5.0), 0.3 * size, 0.1, 0.0, 0.0), (0.8,))
    for tension in (0.01 * size, 4.0 * size):  # a play, an elastic transmission
        assert refused(CABLE, motion, 0, (stiffness(5.0), tension, 0.1, 0.0, 0.0), (0.8,))
    assert refused(CABLE, motion, 0, (stiffness(5.0), 0.3 * size, 0.1, 0.0, 0.0), (0.1,))
    assert refused(CABLE, motion, 0, (stiffness(60.0), 0.3 * size, 0.1, 0.0, 0.0), (0.8,))
