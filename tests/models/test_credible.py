"""What cannot be physics is no finding, whatever it explains: for every effect of the catalogue."""

import numpy as np
import pytest

from hil.diagnosis.residuals import interval
from hil.models import catalogue
from hil.models.effect import Trait, refused
from hil.models.motion import Motion
from hil.models.robots import IndependentAxes

#: Effect -> shape and coefficients that no machine has.
IMPOSSIBLE = {
    "stribeck": ((0.1, 1.0), (-0.2,)),
    "load-friction": ((0.0, 0.0), (-0.1,)),
    "load-viscous": ((0.0,), (-0.1,)),
    "coupled-load-friction": ((2.0, 0.0), (-0.1,)),
    "coupled-friction": ((2.0, 1.0), (-0.3, 0.0)),
    "friction-drift": ((0.2, 0.0), (0.1, 0.0)),
    "offset-drift": ((0.2, 0.0), (0.1,)),
    "gain-drift": ((10.0, 0.0), (0.9,)),
    "presliding": ((0.01, 0.0), (1.0, -0.5, 0.2, 0.1)),
    "elastic-transmission": ((5.0, 0.3, 0.0, 0.0), (-0.5,)),
    "hardening-cable": ((3.0, 0.5, 0.1, 0.0, 0.0), (-0.5,)),
    "backlash": ((0.01, 0.0, 0.01, 0.0), (0.1,)),
    "coupled-transmission": ((2.0, 1.0), (0.1, -0.3, 0.0)),
    "differential": ((2.0, 1.0), (0.1, 0.3, 0.0, 0.1, -0.3, 0.0)),
    "torque-gain": ((), (-1.5,)),
    "torque-saturation": ((1.5, 0.0), (0.3,)),
    "dead-zone": ((0.3,), (0.3,)),
    "asymmetric-gain": ((), (1.2,)),
    "varying-gain": ((0.0, 1.0), (1.5,)),
    "cogging": ((0.1,), (0.1, 0.0, 0.0, 0.0)),
    "second-cogging": ((0.1,), (0.1, 0.0, 0.0, 0.0)),
    "torque-crosstalk": ((2.0,), (1.5,)),
    "torque-ripple": ((3.0,), (0.0, 1.2, 0.0, 0.0)),
    "actuator-lag": ((0.01, 1.0), (0.3,)),
    "delay": ((0.01,), (2.0,)),
    "record-delay": ((1e-4,), (1.0,)),
    "filter-lag": ((0.01, 1.0), (0.3,)),
    "end-stop": ((0.3, 1.0), (0.0, 0.0, 5.0)),
    "two-stops": ((0.3, -0.3), (1.0, 0.0, 0.0, -1.0, 0.0, 0.0)),
    "missed-counts": ((1.0,), (0.8,)),
    "local-friction": ((0.0, 0.5), (0.1, 0.0)),
    "spring": ((), (-1.0, 0.2)),
    "coupled-spring": ((-0.1, 2.0), (1.0, 0.0, 0.0)),
    "relaxation": ((0.5,), (-1.0,)),
    "payload-change": ((1.0, 0.0, 0.0, 0.0, 0.0), (0.2, 0.2, 0.0, 0.0)),
    "vibration-mode": ((5.0, 0.3), (-0.1,)),
    "quadratic-drag": ((), (-0.1,)),
    "sublinear-viscous": ((0.2,), (0.1,)),
    "base-tilt": ((), (1.0, 0.0)),
    "joint-zero": ((), (0.5,)),
    "joint-ratio": ((), (-0.3,)),
    "tip-impedance": ((), (-1.0, 2.0, 0.0, 0.0, 0.0)),
    "force-gain": ((0.0,), (0.0, 0.7)),
    "force-crosstalk": ((0.0,), (1.5, 0.0)),
    "contact-stiffness": ((0.0, 1.0), (-3.0,)),
    "contact-damping": ((), (-1.0,)),
    "contact-hardening": ((2.0,), (-1.0,)),
    "contact-hysteresis": ((0.1,), (-1.0,)),
    "contact-inclusion": ((0.1,), (-1.0,)),
}
#: Effects of which either sign and any size can be.
ANY = {
    "asymmetric-coulomb",
    "asymmetric-viscous",
    "position-friction",
    "posture-friction",
    "capstan-friction",
    "torque-offset",
    "payload",
    "unbalance",
    "variable-inertia",
    "position-torque",
    "periodic-disturbance",
    "force-bias",
    "force-drift",
    "encoder-eccentricity",
}


def swing(n: int = 2000, length: float = 20.0) -> Motion:
    """Two joints that swing over +-1 rad."""
    t = np.linspace(0, length, n)
    w = np.array([1.3, 2.1])
    q, qd, qdd = (
        np.sin(w * t[:, None]),
        w * np.cos(w * t[:, None]),
        -(w**2) * np.sin(w * t[:, None]),
    )
    zero = np.zeros_like(q)
    return Motion(
        t=t,
        q=q,
        qd=qd,
        qdd=qdd,
        tau=qdd,
        tau_ext=zero,
        load=qdd,
        static=zero,
        v0=np.full(2, 0.01),
        resolution=np.full(2, 0.001),
        span=np.array([[-1.0, 1.0]] * 2),
        contact=np.array([[0.0, 1.0]] * 2),
        robot=IndependentAxes(("a", "b")),
    )


def allowed(name, shape, beta, error=()):
    return not refused(catalogue.get(name), swing(), 0, shape, beta, error)


def test_every_effect_says_what_it_cannot_be() -> None:
    names = {e.name for e in catalogue.table().values() if Trait.GIVEN not in e.traits}
    assert names <= set(IMPOSSIBLE) | ANY
    assert not set(IMPOSSIBLE) & ANY


@pytest.mark.parametrize("name", sorted(IMPOSSIBLE))
def test_the_impossible_is_not_credible(name: str) -> None:
    assert not allowed(name, *IMPOSSIBLE[name])


def test_errors_excuse_a_small_violation() -> None:
    assert not allowed("stribeck", (0.1, 1.0), (-0.02,), (0.005,))
    assert allowed("stribeck", (0.1, 1.0), (-0.02,), (0.05,))
    assert not allowed("end-stop", (0.3, 1.0), (5.0, 0.0, -2.5), (0.1, 0.1, 0.1))
    assert allowed("end-stop", (0.3, 1.0), (5.0, 0.0, -2.5), (0.1, 0.1, 1.4))
    assert allowed("end-stop", (0.3, 1.0), (5.0, 0.0, -0.1), (0.1, 0.1, 0.01))  # next to nothing


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_stop_pushes_and_friction_at_the_end_of_the_range_is_none(side: float) -> None:
    q0 = 0.5 * side
    assert allowed("end-stop", (q0, side), (4.0, 3.0, 0.5))
    assert allowed("end-stop", (q0, side), (0.0, 8.0, 0.5))  # Hertz: no stiffness at first touch
    assert not allowed("end-stop", (q0, side), (0.0, 0.1, 4.0))  # a brake that pulls on leaving
    assert not allowed("end-stop", (q0, side), (1.0, -9.0, 0.0))  # pulls beyond a depth


def test_a_spring_returns_to_its_rest() -> None:
    """A hose over two joints had a stiffness of -0.5 N m/rad on one of them, beside gravity."""
    assert allowed("spring", (), (1.0, 0.2))
    assert not allowed("spring", (), (-1.0, 0.2), (0.1, 0.1))
    assert allowed("spring", (), (-0.1, 0.0), (0.1, 0.1))  # next to nothing


def test_a_spring_between_joints_pushes_none_of_them_away() -> None:
    """A force sensor's offset looks like such a spring, but for its sign."""
    errors = (0.1, 0.1, 0.1)
    assert allowed("coupled-spring", (-1.0, 2.0), (1.0, 0.0, 0.0))
    assert not allowed("coupled-spring", (-1.0, 2.0), (-1.0, 0.0, 0.0), errors)
    assert allowed("coupled-spring", (-1.0, 2.0), (-0.1, 0.0, 0.0), errors)  # next to nothing
    # slack in the middle, and stiff to both sides; a stretch of +-2
    assert allowed("coupled-spring", (-1.0, 2.0), (-0.5, 0.0, 1.0), errors)


def test_viscous_friction_that_joints_share_with_two_motors_is_no_drive() -> None:
    shape, beta = (2.0, 1.0), (0.1, 0.3, -5.0, 0.1, 0.3, -5.0)
    sure, shared = (0.01,) * 6, (0.01, 0.01, np.nan) * 2
    assert not allowed("differential", shape, beta, sure)
    assert allowed("differential", shape, beta, shared)
    beta = (0.1, -0.3, 5.0, 0.1, 0.3, 5.0)
    assert not allowed("differential", shape, beta, shared)


def test_a_structure_rings() -> None:
    assert allowed("vibration-mode", (5.0, 0.3), (0.1,))
    assert not allowed("vibration-mode", (5.0, 0.5), (0.1,))


def test_a_mode_faster_than_the_efforts_show_is_none() -> None:
    seen = swing().with_(band=4.0)
    effect = catalogue.get("vibration-mode")
    assert not refused(effect, seen, 0, (4.2, 0.3), (0.1,), ())
    assert refused(effect, seen, 0, (5.0, 0.3), (0.1,), ())


@pytest.mark.parametrize(
    ("f", "foreign"), [(0.207, False), (0.621, False), (1.9, True), (3.1, True)]
)
def test_a_frequency_of_the_motion_is_no_disturbance(f: float, foreign: bool) -> None:
    # 1.3 rad/s are 0.207 Hz, and 0.621 Hz three times that
    assert allowed("periodic-disturbance", (f,), (0.1, 0.1)) == foreign


def test_loops_without_a_part_of_the_friction_are_a_blunt_sign() -> None:
    shape = (4e-4, 0.0, 0.01, 0.0)
    assert not allowed("presliding", shape, (0.9, 0.0, 0.0, 0.002), (0.004, 0.008, 0.006, 0.001))
    assert not allowed("presliding", shape, (0.5, 0.3, 0.0, 0.0), (0.2, 0.3, 0.2, 0.1))
    assert allowed("presliding", shape, (0.5, 0.3, 0.0, 0.0), (0.02, 0.03, 0.02, 0.01))
    # what builds up within the least displacement that is tried is a sign that turns late
    stiff = (2e-4, 0.0, 0.01, 0.0)
    assert not allowed("presliding", stiff, (0.5, 0.3, 0.0, 0.0), (0.02, 0.03, 0.02, 0.01))


def test_a_transient_at_the_start_is_no_drift() -> None:
    assert allowed("friction-drift", (8.0, 0.0), (-0.2, 0.0))
    assert allowed("friction-drift", (60.0, 0.0), (-0.2, 0.0))
    assert not allowed("friction-drift", (2.0, 0.0), (-0.2, 0.0))
    assert not allowed("gain-drift", (2.0, 0.0), (0.1,))


def test_a_gain_drifts_by_what_warming_makes_of_it() -> None:
    assert allowed("gain-drift", (8.0, 0.0), (0.1,))
    assert allowed("gain-drift", (60.0, 0.0), (-0.3,))
    assert not allowed("gain-drift", (8.0, 0.0), (0.01,), (1e-4,))
    # a linear one of which the run shows a quarter
    assert allowed("gain-drift", (60.0, 0.0), (1.2,))
    assert not allowed("gain-drift", (60.0, 0.0), (0.03,), (1e-4,))
    assert not allowed("gain-drift", (8.0, 0.0), (0.7,), (0.01,))
    assert allowed("gain-drift", (8.0, 0.0), (0.7,), (0.2,))


def test_a_gain_varies_by_more_than_chance_and_leaves_something() -> None:
    """Places lie within 1 rad, speeds within 1.3 rad/s."""
    assert allowed("varying-gain", (0.0, 1.0), (-0.3,))
    assert allowed("varying-gain", (0.0, 0.0), (0.1,))
    assert not allowed("varying-gain", (0.0, 1.0), (0.01,), (1e-4,))
    assert not allowed("varying-gain", (-1.0, 1.0), (0.3,))


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ((2.3, 2.4), "2.3 to 2.4"),
        ((2.351, 2.412), "2.351 to 2.412"),
        ((0.0, 3.0), "0 to 3"),
        ((1.96, 2.04), "1.96 to 2.04"),
        ((100.2, 101.4), "100.2 to 101.4"),
        ((2.0, 2.0), "2 to 2"),
        ((-np.inf, 2.0), "-inf to 2"),
        ((1e-4, 1.2e-4), "0.0001 to 0.00012"),
    ],
)
def test_rounding_does_not_close_an_interval(ends, words) -> None:
    assert interval(*ends) == words


@pytest.mark.parametrize(
    ("effect", "some", "all_of_it"), [("load-friction", 0.7, 1.0), ("load-viscous", 0.5, 0.9)]
)
def test_friction_of_the_motors_effort_leaves_some_of_it(effect, some, all_of_it) -> None:
    """tau = |tau| sgn(v) holds of whatever brakes; of a load it says something."""
    others = (0.0,) if effect == "load-friction" else ()
    assert allowed(effect, (2.0, *others), (some,))
    assert not allowed(effect, (2.0, *others), (all_of_it,))
    assert allowed(effect, (0.0, *others), (all_of_it,))
