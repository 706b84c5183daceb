"""Every effect keeps the contract, and its columns are what its equation says."""

import re
from collections.abc import Callable
from dataclasses import replace
from math import cos, exp, pi, sin, tanh
from typing import Any

import numpy as np
import pytest

from hil.models import catalogue, formula
from hil.models.effect import Doc, Effect, Grid, Limit, Param, Relations, Scope, Twin, terms_of
from hil.models.motion import Motion
from hil.models.phantom import Premium
from hil.models.robots import IndependentAxes, Robot
from hil.testing import ConformanceError, check_effect
from hil.testing.effects import sample_motions

EFFECTS = sorted(catalogue.table())
DESIGN = """coulomb viscous stribeck asymmetric-coulomb asymmetric-viscous quadratic-drag presliding
position-friction load-friction coupled-friction torque-gain torque-offset cogging delay rigid-body
armature payload spring position-torque end-stop contact-stiffness contact-damping
contact-hardening contact-hysteresis""".split()


def motion_of(robot: Robot, n: int = 40, seed: int = 0) -> Motion:
    rng, d = np.random.default_rng(seed), len(robot.joints)
    q, qd, qdd, tau, ext, load, static = rng.normal(size=(7, n, d))
    qd[3] = 0.0
    return Motion(
        t=np.arange(n) * 0.01,
        q=q,
        qd=qd,
        qdd=qdd,
        tau=tau,
        tau_ext=ext,
        load=load,
        static=static,
        v0=np.linspace(0.02, 0.05, d),
        resolution=np.full(d, 0.01),
        span=np.stack([q.min(axis=0), q.max(axis=0)], axis=1),
        contact=np.array([[0.1, 1.0], [-0.2, -1.0], [0.0, 1.0]])[:d],
        robot=robot,
    )


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_conforms(name: str) -> None:
    check_effect(catalogue.get(name))


def test_catalogue_holds_the_names_of_the_design() -> None:
    assert set(DESIGN) <= set(catalogue.table())
    assert all(e.name == name for name, e in catalogue.table().items())


def test_confusions_and_replacements_name_no_typing_errors() -> None:
    planned = {"backlash", "elastic-transmission", "actuator-lag"}
    for effect in catalogue.table().values():
        assert set(effect.doc.confused_with) <= set(EFFECTS) | planned, effect.name
        assert set(effect.relations.replaces) <= set(EFFECTS), effect.name


Row = Callable[[Motion, int, int, tuple[float, ...]], list[float]]


def waves(x: float, p: float) -> list[float]:
    k = 2 * pi * p
    return [sin(k * x), cos(k * x), sin(2 * k * x), cos(2 * k * x)]


def relative_speed(m: Motion, i: int, j: int, s: tuple[float, ...]) -> list[float]:
    other = m.qd[i, int(s[0]) - 1]
    w = m.qd[i, j] + s[1] * other if s[1] else other
    # as sharp as the speeds are known, each in units of the sum
    mine, theirs = float(m.v0[j]), float(m.v0[int(s[0]) - 1])
    v0 = max(mine, abs(s[1]) * theirs) if s[1] else theirs
    return [tanh(w / v0), w]


def bent(m: Motion, i: int, j: int, s: tuple[float, ...]) -> list[float]:
    away = m.q[i, int(s[1]) - 1] - s[0]
    return [tanh(m.qd[i, j] / V0[j]) * x for x in (abs(away), away**2)]


def chebyshev(m: Motion, i: int, j: int, s: tuple[float, ...]) -> list[float]:
    low, high = min(m.q[:, j]), max(m.q[:, j])
    angle = np.arccos(np.clip((m.q[i, j] - (low + high) / 2) / ((high - low) / 2), -1, 1))
    return [cos(k * angle) for k in range(7)]


def stop(m: Motion, i: int, j: int, s: tuple[float, ...]) -> list[float]:
    x = m.q[i, j] - s[0]
    d = max(0.0, x) if s[1] > 0 else min(0.0, x)
    return [d, d * abs(d), abs(d) * m.qd[i, j]]


def depth(m: Motion, i: int, j: int) -> float:
    q0, side = m.contact[j]
    return max(0.0, side * (m.q[i, j] - q0))


def hardening(m: Motion, i: int, j: int, s: tuple[float, ...]) -> list[float]:
    deepest = max(depth(m, k, j) for k in range(m.n))
    return [-m.contact[j, 1] * (depth(m, i, j) / deepest) ** s[0]]


def hysteresis(m: Motion, i: int, j: int, s: tuple[float, ...]) -> list[float]:
    z = 0.0
    for k in range(1, i + 1):
        z = min(max(z + depth(m, k, j) - depth(m, k - 1, j), -s[0]), s[0])
    return [-m.contact[j, 1] * z]


def dahl(m: Motion, i: int, j: int, s: tuple[float, ...]) -> list[float]:
    out = [tanh(m.qd[i, j] / s[2])]
    written = re.findall(r"z\((\d*) ?s\)", catalogue.get("presliding").doc.equation)
    for length in (float(ratio or 1) * s[0] for ratio in written):
        z = 0.0
        for k in range(1, i + 1):
            step = m.q[k, j] - m.q[k - 1, j]
            goal = 1.0 if step > 0 else -1.0
            z = goal + (z - goal) * exp(-abs(step) / length)
        out.append(z)
    return out


V0 = (0.02, 0.05)
FORMULAS: dict[str, tuple[tuple[float, ...], Row]] = {
    "coulomb": ((0.03,), lambda m, i, j, s: [tanh(m.qd[i, j] / s[0])]),
    "viscous": ((), lambda m, i, j, s: [m.qd[i, j]]),
    "stribeck": (
        (0.4, 1.3),
        lambda m, i, j, s: [
            exp(-(abs(m.qd[i, j] / s[0]) ** (*s, 2.0)[1])) * tanh(m.qd[i, j] / V0[j])
        ],
    ),
    "asymmetric-coulomb": ((), lambda m, i, j, s: [abs(tanh(m.qd[i, j] / V0[j]))]),
    "asymmetric-viscous": ((), lambda m, i, j, s: [abs(m.qd[i, j])]),
    "quadratic-drag": ((), lambda m, i, j, s: [m.qd[i, j] * abs(m.qd[i, j])]),
    "sublinear-viscous": (
        (0.6,),
        lambda m, i, j, s: [tanh(m.qd[i, j] / V0[j]) * abs(m.qd[i, j]) ** s[0]],
    ),
    "position-friction": (
        (1.7,),
        lambda m, i, j, s: [tanh(m.qd[i, j] / V0[j]) * x for x in waves(m.q[i, j], s[0])],
    ),
    "local-friction": (
        (0.2, 0.3),
        lambda m, i, j, s: [
            x * exp(-(((m.q[i, j] - s[0]) / s[1]) ** 2))
            for x in (tanh(m.qd[i, j] / V0[j]), m.qd[i, j])
        ],
    ),
    "load-friction": (
        (0.0, 0.4),
        lambda m, i, j, s: [abs(m.load[i, j] - s[1] * m.qdd[i, j]) * tanh(m.qd[i, j] / V0[j])],
    ),
    "load-viscous": ((1.0,), lambda m, i, j, s: [abs(m.static[i, j]) * m.qd[i, j]]),
    "coupled-load-friction": (
        (2.0, 1.0),
        lambda m, i, j, s: [abs(m.static[i, int(s[0]) - 1]) * tanh(m.qd[i, j] / V0[j])],
    ),
    "coupled-friction": ((2.0, -1.0), relative_speed),
    "posture-friction": ((0.2, 2.0), bent),
    "capstan-friction": (
        (0.2, 2.0, 1.0),
        lambda m, i, j, s: [abs(m.static[i, j]) * x for x in bent(m, i, j, s)],
    ),
    "presliding": ((0.3, 1.0, 0.04, 0.0), dahl),
    "armature": ((), lambda m, i, j, s: [m.qdd[i, j]]),
    "spring": (
        (),
        lambda m, i, j, s: [m.q[i, j] - (min(m.q[:, j]) + max(m.q[:, j])) / 2, 1.0],
    ),
    "unbalance": ((), lambda m, i, j, s: [sin(m.q[i, j]), cos(m.q[i, j])]),
    "position-torque": ((), chebyshev),
    "end-stop": ((0.5, -1.0), stop),
    "two-stops": (
        (0.5, -0.4),
        lambda m, i, j, s: stop(m, i, j, (s[0], 1.0)) + stop(m, i, j, (s[1], -1.0)),
    ),
    "dead-zone": ((0.3,), lambda m, i, j, s: [min(max(m.tau[i, j], -s[0]), s[0])]),
    "torque-offset": ((), lambda m, i, j, s: [1.0]),
    "torque-gain": ((), lambda m, i, j, s: [m.load[i, j]]),
    "cogging": ((2.3,), lambda m, i, j, s: waves(m.q[i, j], s[0])),
    "second-cogging": ((2.3,), lambda m, i, j, s: waves(m.q[i, j], s[0])),
    "asymmetric-gain": ((), lambda m, i, j, s: [abs(m.tau[i, j])]),
    "gain-drift": ((0.3, 0.0), lambda m, i, j, s: [(1 - exp(-m.t[i] / s[0])) * m.tau[i, j]]),
    "varying-gain": ((0.4, 1.0), lambda m, i, j, s: [(m.q[i, j] - s[0]) ** 2 * m.tau[i, j]]),
    "contact-stiffness": (
        (0.3, -1.0),
        lambda m, i, j, s: [-s[1] * max(0.0, s[1] * (m.q[i, j] - s[0]))],
    ),
    "contact-damping": (
        (),
        lambda m, i, j, s: [-m.qd[i, j] if depth(m, i, j) > 0 else 0.0],
    ),
    "contact-hardening": ((2.5,), hardening),
    "contact-hysteresis": ((0.4,), hysteresis),
}


def test_a_hysteresis_of_a_surface_slips_both_ways_in_every_press() -> None:
    """One that never slipped was a spring counted from where each run began."""
    motion = motion_of(IndependentAxes(("a", "b")), n=81)
    press = np.interp(np.arange(81), [0, 40, 80], [-3.0, 1.0, -3.0])
    q = np.stack([press, press], axis=1)
    motion = replace(
        motion, q=q, span=np.array([[-3.0, 1.0]] * 2), contact=np.array([[0.5, 1.0]] * 2)
    )
    effect = catalogue.get("contact-hysteresis")
    for shape in effect.search.grid(motion, 0):
        force = effect.columns(motion, 0, shape)
        assert force.min() == -shape[0] and force.max() == pytest.approx(shape[0])


@pytest.mark.parametrize("name", sorted(FORMULAS))
@pytest.mark.parametrize("j", [0, 1])
def test_columns_are_the_equation(name: str, j: int) -> None:
    motion = motion_of(IndependentAxes(("a", "b")))
    shape, row = FORMULAS[name]
    shape = shape[: len(catalogue.get(name).shape)]
    if name == "coupled-friction":
        shape = (2.0 - j, shape[1])
    got = catalogue.get(name).columns(motion, j, shape)
    expected = np.array([row(motion, i, j, shape) for i in range(motion.n)])
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)


def test_a_gain_varies_with_the_speed_where_it_has_no_place() -> None:
    motion = motion_of(IndependentAxes(("a", "b")))
    got = catalogue.get("varying-gain").columns(motion, 1, (0.0, 0.0))
    np.testing.assert_allclose(got[:, 0], np.abs(motion.qd[:, 1]) * motion.tau[:, 1])


@pytest.mark.parametrize("mode", [0.0, 1.0, -0.72, 0.075])
def test_coupled_friction_of_the_other_joint_alone_or_with_it(mode: float) -> None:
    motion = motion_of(IndependentAxes(("a", "b")))
    got = catalogue.get("coupled-friction").columns(motion, 0, (2.0, mode))
    expected = [relative_speed(motion, i, 0, (2.0, mode)) for i in range(motion.n)]
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_a_spring_over_two_joints_is_the_slope_of_its_energy() -> None:
    """tau_i = dU/dq_i with U = d^(p + 1) / (p + 1), d = q_1 + r q_3 about mid-range."""
    motion, r = motion_of(IndependentAxes(("a", "b", "c"))), -0.7
    x = catalogue.get("coupled-spring").columns(motion, 0, (r, 3.0))
    q = motion.q - motion.span.mean(axis=1)

    def energy(q: np.ndarray, p: int) -> np.ndarray:
        return (q[:, 0] + r * q[:, 2]) ** (p + 1) / (p + 1)

    for p, i in ((p, i) for p in (1, 2, 3) for i in range(3)):
        step = 1e-5 * (np.arange(3) == i)
        slope = (energy(q + step, p) - energy(q - step, p)) / 2e-5
        np.testing.assert_allclose(x[:, i, p - 1], slope, atol=1e-8)


def test_a_hysteresis_without_a_name_is_none_in_steady_sliding() -> None:
    t = np.arange(400) * 0.01
    motion = motion_of(IndependentAxes(("a",)), n=400)
    away = np.full((1, 2), np.nan)
    slide = motion.with_(t=t, q=2.0 * t[:, None], qd=np.full((400, 1), 2.0), contact=away)
    columns = catalogue.get("correction-hysteresis").columns(slide, 0, (0.01,))
    np.testing.assert_allclose(columns[20:], 0.0, atol=1e-12)  # the dry friction stays the model's
    assert np.all(np.abs(columns[0]) > 0.9)


def test_a_turn_and_a_slide_are_coupled_at_the_ratio_of_their_speeds() -> None:
    both = IndependentAxes(("a", "b"))
    motion = motion_of(both)
    mixed = IndependentAxes(("a", "b"))
    mixed.units = ("m", "rad")
    slow = motion.with_(qd=motion.qd * np.array([1.0, 250.0]), robot=mixed)
    grid = catalogue.get("coupled-transmission").search.grid
    assert [r for _, r in grid(motion, 0)] == [1.0, -1.0]
    assert [r for _, r in grid(slow, 0)] == pytest.approx([0.004, -0.004], rel=0.3)


def test_load_friction_of_the_static_load_alone() -> None:
    motion = motion_of(IndependentAxes(("a", "b")))
    got = catalogue.get("load-friction").columns(motion, 1, (1.0, 0.0))[:, 0]
    expected = np.abs(motion.static[:, 1]) * np.tanh(motion.qd[:, 1] / 0.05)
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_delay_is_the_late_command() -> None:
    t = np.arange(400) * 0.005
    motion = motion_of(IndependentAxes(("a",)), n=400).with_(t=t, tau=np.sin(30 * t)[:, None])
    for late in (1e-3, 5e-3, 1.23e-2):
        column = catalogue.get("delay").columns(motion, 0, (late,))[:, 0]
        expected = np.sin(30 * t) - np.sin(30 * (t - late))
        np.testing.assert_allclose(column[6:-2], expected[6:-2], atol=1e-4)
        # the record's is the other way round, and of one joint beside others alone
        column = catalogue.get("record-delay").columns(motion, 0, (late,))[:, 0]
        expected = np.sin(30 * t) - np.sin(30 * (t + late))
        np.testing.assert_allclose(column[2:-6], expected[2:-6], atol=1e-4)
    assert "single joint" in catalogue.get("record-delay").scope.lacks(motion, 0)


def test_a_torque_over_position_goes_straight_on_beyond_the_range_and_then_stays() -> None:
    """T_k'(1) = k^2, T_k'(-1) = (-1)^(k - 1) k^2, for a fifth of the half range."""
    motion, effect = motion_of(IndependentAxes(("a",)), n=400), catalogue.get("position-torque")
    low, high = motion.span[0]
    half, k = (high - low) / 2, np.arange(7)
    for end, sign in ((high, 1.0), (low, -1.0)):
        out = np.array([0.0, 0.1, 0.2, 0.5])
        q = np.full((400, 1), end)
        q[:4, 0] = end + sign * half * out
        x = effect.columns(motion.with_(q=q), 0, ())[:4]
        expected = sign**k + k**2 * sign**k * np.minimum(out, 0.2)[:, None]
        np.testing.assert_allclose(x, expected, atol=1e-9)
        texts = [
            formula.evaluate(t, {"q": q[:4, 0], "low": low, "high": high})
            for t in effect.doc.formulas
        ]
        np.testing.assert_allclose(np.stack([t + 0 * out for t in texts], 1), x, atol=1e-9)


@pytest.mark.parametrize("poles", [1, 2])
def test_lag_is_the_answer_of_its_poles(poles: int) -> None:
    t, w, time = np.arange(2000) * 0.002, 20.0, 5e-3
    motion = motion_of(IndependentAxes(("a",)), n=2000).with_(t=t, tau=np.sin(w * t)[:, None])
    column = catalogue.get("actuator-lag").columns(motion, 0, (time, poles))[:, 0]
    answer = 1 / (1 + 1j * w * time) ** poles
    expected = np.sin(w * t) - np.imag(answer * np.exp(1j * w * t))
    np.testing.assert_allclose(column[200:], expected[200:], atol=1e-3)


def test_relaxation_is_the_answer_of_a_spring_behind_a_damper() -> None:
    t, w, time = np.arange(4000) * 0.002, 6.0, 0.2
    motion = motion_of(IndependentAxes(("a",)), n=4000).with_(t=t, q=np.sin(w * t)[:, None])
    column = catalogue.get("relaxation").columns(motion, 0, (time,))[:, 0]
    answer = 1j * w * time / (1 + 1j * w * time)  # of stiffness one
    np.testing.assert_allclose(
        column[1000:], np.imag(answer * np.exp(1j * w * t))[1000:], atol=1e-3
    )


def test_coupled_transmission_obeys_virtual_work() -> None:
    motion = motion_of(IndependentAxes(("a", "b", "c")))
    x = catalogue.get("coupled-transmission").columns(motion, 0, (3.0, -1.0))
    w = motion.qd[:, 0] - motion.qd[:, 2]
    slope = motion.qdd[:, 0] - motion.qdd[:, 2]
    parts = np.stack([slope, np.tanh(w / 0.05), w], axis=1)
    power = np.einsum("njm,nj->nm", x, motion.qd)
    np.testing.assert_allclose(power, parts * w[:, None], rtol=1e-12)
    assert not x[:, 1].any()


def test_a_differential_is_two_motors_that_turn_with_sum_and_difference() -> None:
    motion = motion_of(IndependentAxes(("a", "b", "c")))
    each = [catalogue.get("coupled-transmission").columns(motion, 0, (3.0, x)) for x in (1.2, -1.2)]
    got = catalogue.get("differential").columns(motion, 0, (3.0, 1.2))
    np.testing.assert_array_equal(got, np.concatenate(each, axis=2))
    # the sum of both turns with joint a alone, and their difference with joint c
    np.testing.assert_allclose(got[:, 0, 0] + got[:, 0, 3], 2 * motion.qdd[:, 0], rtol=1e-12)
    np.testing.assert_allclose(got[:, 2, 0] + got[:, 2, 3], 2.88 * motion.qdd[:, 2], rtol=1e-12)


def test_whole_robot_effects_are_the_robot_s_own_columns() -> None:
    robot = Premium(("joint1", "joint2", "joint3"))
    motion = motion_of(robot)
    arguments = (motion.q, motion.qd, motion.qdd)
    body = catalogue.get("rigid-body").columns(motion, 0, ())
    np.testing.assert_array_equal(body, robot.regressor(*arguments))
    tip = catalogue.get("payload").columns(motion, 0, ())
    np.testing.assert_array_equal(tip[:, :, 0], robot.tip_mass(*arguments))
    assert [p.name for p in terms_of(catalogue.get("rigid-body"), motion, 0)] == list(robot.names)


def test_presliding_has_dahl_s_slope_after_a_reversal() -> None:
    """Just after a reversal out of sliding the slope is twice the initial one: 2 fc / s."""
    q = np.concatenate([np.linspace(0, 1, 2001), 1 - np.linspace(0, 0.001, 101)[1:]])
    motion = motion_of(IndependentAxes(("a",)), n=q.size).with_(q=q[:, None])
    z = catalogue.get("presliding").columns(motion, 0, (0.01, 1.0, 0.02, 0.0))[:, 1]
    assert z[2000] == pytest.approx(1.0)
    assert (z[2001] - z[2000]) / (q[2001] - q[2000]) == pytest.approx(2 / 0.01, rel=1e-3)


def test_maxwell_slip_is_a_spring_between_reversals_that_slips_after_its_displacement() -> None:
    q = np.array([0.0, 0.004, 0.02, 0.016, 0.008, 0.0, -0.01])
    motion = motion_of(IndependentAxes(("a",)), n=q.size).with_(q=q[:, None])
    z = catalogue.get("presliding").columns(motion, 0, (0.01, 0.0, 0.02, 0.0))[:, 1]
    np.testing.assert_allclose(z, [0, 0.4, 1.0, 0.6, -0.2, -1.0, -1.0], atol=1e-12)


@pytest.mark.parametrize("rise", [0.0, 1.0])
def test_lugre_s_bristles_obey_their_equation(rise: float) -> None:
    """z' = v / s - |v| z / (s g(v)), g = 1 + r exp(-(v / vs)^2), in steps of a hundredth."""
    s, vs, fine, step = 0.02, 0.3, 100, 1e-3
    t = np.arange(2000 * fine) * step / fine
    q, v = 0.1 * np.sin(7 * t), 0.7 * np.cos(7 * t)
    z, expected = 0.0, []
    for k, speed in enumerate(v):
        if k % fine == 0:
            expected.append(z)
        g = 1.0 + rise * exp(-((speed / vs) ** 2))
        z += step / fine * (speed / s - abs(speed) / s * z / g)
    pick = slice(None, None, fine)
    motion = motion_of(IndependentAxes(("a",)), n=2000)
    motion = motion.with_(t=t[pick], q=q[pick, None], qd=v[pick, None], qdd=-49 * q[pick, None])
    columns = catalogue.get("presliding").columns(motion, 0, (s, 2.0, 0.02, vs))
    found = columns @ np.array([0.0, 1.0, rise, 0.0])
    np.testing.assert_allclose(found, expected, atol=0.02)
    if rise:
        rate = s / vs * np.gradient(expected, step)
        np.testing.assert_allclose(columns[2:-2, 3], rate[2:-2], atol=0.02 * rate.max())


@pytest.mark.parametrize("form", [0.0, 1.0])
def test_loops_of_presliding_do_not_depend_on_speed(form: float) -> None:
    effect, q = catalogue.get("presliding"), np.sin(np.linspace(0, 9, 400))
    one = motion_of(IndependentAxes(("a",)), n=400).with_(q=q[:, None])
    fast = one.with_(qd=5 * one.qd, qdd=25 * one.qdd, t=one.t / 5)
    here, there = (effect.columns(m, 0, (0.1, form, 0.02, 0.0))[:, 1:] for m in (one, fast))
    np.testing.assert_array_equal(here, there)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("torque-gain", "without a measured external force"),
        ("payload", "no geometry"),
        ("armature", "already contains it"),
        ("coupled-friction", "one joint"),
        ("coupled-transmission", "no later joint"),
        ("coupled-spring", "no later joint"),
        ("differential", "no later joint"),
        ("contact-damping", "needs 'contact-stiffness'"),
        ("contact-hardening", "needs 'contact-stiffness'"),
        ("contact-hysteresis", "needs 'contact-stiffness'"),
    ],
)
def test_unavailable_effects_say_why(name: str, text: str) -> None:
    _, motion = next(sample_motions())
    assert text in catalogue.get(name).scope.lacks(motion, 0)


DOC = Doc("tau = a s v", signature="odd", shown_by="any motion", source="a book")
WRONG: Any = None


class Good(Effect):
    """Small correct effect, made wrong one attribute at a time."""

    name, family = "good-effect", "friction"
    doc = DOC
    params: Any = (Param("a", "1", "size"),)
    shape: Any = (Param("s", "1", "scale", 0.0, 2.0),)
    search = Grid(lambda motion, j: [(0.5,), (1.0,)])

    def columns(self, motion: Motion, j: int, shape: Any) -> Any:
        return motion.qd[:, j : j + 1] * shape[0]


def test_a_correct_effect_passes() -> None:
    check_effect(Good())


def spoil(self: Effect, motion: Motion, j: int, shape: Any) -> Any:
    motion.qd[:, j] *= 2
    return motion.qd[:, j : j + 1]


counter = iter(range(10**6))
BROKEN: list[tuple[str, dict[str, Any], str]] = [
    ("empty", {"doc": replace(DOC, equation=" ")}, "equation must be a non-empty text"),
    ("name", {"name": "Good_Effect"}, "kebab-case"),
    ("family", {"family": "magic"}, "expected one of friction"),
    ("explains", {"scope": Scope(explains=("mind",))}, "'motor', 'external' or both"),
    ("list", {"params": [Param("a", "1", "x")]}, "must be a tuple"),
    ("itself", {"relations": Relations(replaces=("good-effect",))}, "confused with itself"),
    ("param", {"params": ("a",)}, "is not a Param"),
    ("unit", {"params": (Param("a", "", "size"),)}, "has no unit"),
    ("text", {"params": (Param("a", "1", ""),)}, "no text"),
    ("dots", {"params": (Param("a.b", "1", "x"),)}, "without spaces, dots"),
    ("twice", {"params": (Param("s", "1", "x"),)}, "declared twice"),
    ("bounds", {"params": (Param("a", "1", "x", 2.0, 1.0),)}, "lower < upper"),
    ("none", {"params": ()}, "no coefficients"),
    ("grid", {"search": Grid(lambda *_: [])}, "grid is empty"),
    ("nan", {"search": Grid(lambda *_: [(float("nan"),)])}, "is not finite"),
    ("outside", {"search": Grid(lambda *_: [(3.0,)])}, "outside the declared"),
    ("length", {"search": Grid(lambda *_: [(1.0, 1.0)])}, "2 values for 1 shape"),
    ("available", {"scope": Scope(lacks=lambda *_: WRONG)}, "expected a text"),
    ("never", {"scope": Scope(lacks=lambda *_: "no")}, "not available on any"),
    ("flat", {"columns": lambda s, m, j, x: m.qd[:, j]}, "columns have shape (2000,)"),
    ("count", {"columns": lambda s, m, j, x: np.ones((m.n, 2))}, "for 1 coefficients"),
    ("dtype", {"columns": lambda s, m, j, x: np.ones((m.n, 1), int)}, "expected float64"),
    ("inf", {"columns": lambda s, m, j, x: np.full((m.n, 1), np.inf)}, "not finite"),
    ("warn", {"columns": lambda s, m, j, x: 1 / m.qd[:, j : j + 1]}, "fails with FloatingPoint"),
    ("bug", {"columns": lambda s, m, j, x: m.nothing}, "fails with AttributeError"),
    ("spoil", {"columns": spoil}, "different columns"),
    (
        "random",
        {"columns": lambda s, m, j, x: np.full((m.n, 1), float(next(counter)))},
        "different columns",
    ),
    ("part", {"search": WRONG}, "search is None, expected Grid"),
    ("limit", {"limits": (Limit("odd", lambda f: WRONG),)}, "limit 'odd' returned None"),
    (
        "bound",
        {"params": (Param("a", "1", "size", 0.0),), "limits": (Limit("any", lambda f: True),)},
        "limits of your own stand beside BOUNDS",
    ),
    ("twin", {"relations": Relations(twins=(Twin("stribek"),))}, "Did you mean 'stribeck'"),
    ("time", {"columns": lambda s, m, j, x: m.t[:, None] + 0.0}, "time axis is shifted"),
]


@pytest.mark.parametrize(("label", "change", "text"), BROKEN, ids=[b[0] for b in BROKEN])
def test_each_breach_is_named(label: str, change: dict[str, Any], text: str) -> None:
    with pytest.raises(ConformanceError) as caught:
        check_effect(type("Bad", (Good,), change)())
    assert text in str(caught.value)
    assert isinstance(caught.value, AssertionError)


def test_changed_input_is_named() -> None:
    def constant(self: Effect, motion: Motion, j: int, shape: Any) -> Any:
        motion.tau[0, 0] = 7.0
        return np.ones((motion.n, 1))

    with pytest.raises(ConformanceError, match=r"modifies its input motion\.tau"):
        check_effect(type("Bad", (Good,), {"columns": constant})())


def test_a_class_instead_of_an_instance_is_named() -> None:
    with pytest.raises(ConformanceError, match="not an instance"):
        check_effect(Good)  # type: ignore[arg-type]


def test_grid_is_demanded_of_effects_with_a_shape() -> None:
    class NoGrid(Good):
        search = Effect.search

    with pytest.raises(ConformanceError, match="no grid"):
        check_effect(NoGrid())
