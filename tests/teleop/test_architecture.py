"""Theory: hybrid matrix, transparency theorem and families, poles and margins."""

from dataclasses import replace
from itertools import combinations

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from teleop_designs import anchor, designs, positive, robots

from hil.errors import ConfigError
from hil.teleop import architecture, hybrid
from hil.teleop.architecture import Design, MotionTerm, Realisation, RobotImpedance
from hil.teleop.hybrid import GEL, HAND, Impedance

W = 2 * np.pi * np.geomspace(0.05, 50, 40)
REAL = Realisation(velocity_hz=60, acceleration_hz=30, force_hz=80)


def laws(d, s, f, v):
    """Both robots' equations from the two control laws as they stand in the thesis; zero."""
    (fm, fs), (vm, vs) = f, v
    fcm = d.c6 * fm - d.c2 * fs - d.c4(s) * vs - d.c8(s) * vm
    fcs = d.c1(s) * vm + d.c3 * fm - d.c5 * fs - d.c7(s) * vs
    return d.master.term(s) * vm - fcm - fm, d.slave.term(s) * vs - fcs + fs


@settings(max_examples=40, deadline=None)
@given(designs(), st.floats(0.1, 300), st.complex_numbers(max_magnitude=3, allow_nan=False))
def test_hybrid_matrix_solves_the_two_laws(d, w, fs):
    s = np.array([1j * w])
    e = hybrid.blocks(d, s)
    if abs((e.a * e.Zs - e.c * e.c4)[0]) < 1e-3:
        return
    h, vm = hybrid.hybrid(d, s)[0], 1.0 - 0.3j
    fm, minus_vs = h @ np.array([vm, fs])
    scale = max(1.0, np.abs(h).max()) * (1 + abs(d.c4(1j * w)) + abs(d.c7(1j * w)) + 10)
    for rest in laws(d, 1j * w, (fm, fs), (vm, -minus_vs)):
        assert abs(rest) < 1e-9 * scale


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(sorted(architecture.DESIGNS)),
    positive,
    positive,
    robots(),
    robots(),
    st.floats(0, 0.5),
    st.floats(0, 0.5),
)
def test_the_theorem_and_the_hybrid_matrix_agree(name, kp, kf, master, slave, c5, c6):
    wish = architecture.Wish(
        motion_scale=kp, force_scale=kf, master=master, slave=slave, slave_force=c5, master_force=c6
    )
    d = architecture.named_design(name, wish)
    h = hybrid.hybrid(d, hybrid.jw(W))
    goal = np.array([[0, kf], [-kp, 0]])
    near = np.abs(h - goal).max() < 1e-8 * max(1.0, kp, kf)
    assert architecture.is_transparent(d) == near
    assert near == (name not in ("position-error", "position-force"))


@pytest.mark.parametrize("missed", ["c1", "c2", "c3", "c4"])
def test_the_checker_names_the_condition_that_fails(missed):
    d = architecture.named_design("four-channel")
    value = getattr(d, missed)
    wrong = value + MotionTerm(b=0.5) if isinstance(value, MotionTerm) else value + 0.5
    found = {c.name: c for c in architecture.conditions(replace(d, **{missed: wrong}))}
    assert [n for n, c in found.items() if not c.holds] == [missed]
    assert missed in found[missed].text and "should be" in found[missed].text


def test_a_controller_whose_channels_cancel_is_not_transparent():
    d = architecture.named_design(
        "four-channel", architecture.Wish(master=RobotImpedance(0.2), slave=RobotImpedance(0.2))
    )
    # (1 + c6)(z_cs + c7) = -(1 + c5)(z_cm + c8)
    d = replace(d, c8=-(d.slave.term + d.c7) + -d.master.term)
    d = replace(d, c4=-(d.master.term + d.c8))
    assert [c.name for c in architecture.conditions(d) if not c.holds] == ["rank"]


def rank_of(d, s):
    e = hybrid.blocks(d, s)
    qr = np.array([[e.a, -e.b, -e.Zm, e.c4], [e.c, -e.d, e.c1, e.Zs]])
    return np.linalg.matrix_rank(qr / max(np.abs(qr).max(), 1e-12), tol=1e-9)


def test_the_enumeration_is_what_brute_force_finds():
    rng = np.random.default_rng(0)
    for count in range(5):
        found = {f.channels for f in architecture.families(count)}
        for used in combinations(architecture.LOCAL, count):
            possible = False
            for _ in range(5):
                c5, c6 = rng.uniform(0, 1, 2)
                t = [MotionTerm(*rng.uniform(1, 9, 3)) for _ in range(2)]
                master, slave = (
                    RobotImpedance(rng.uniform(0.1, 1)),
                    RobotImpedance(rng.uniform(0.1, 1)),
                )
                c5, c6 = c5 if "c3" in used else -1.0, c6 if "c2" in used else -1.0
                c7 = t[0] if "c1" in used else -slave.term
                c8 = t[1] if "c4" in used else -master.term
                d = Design(c1=slave.term + c7, c2=1 + c6, c3=1 + c5, c4=-(master.term + c8),
                           c5=c5, c6=c6, c7=c7, c8=c8, master=master, slave=slave)  # fmt: skip
                zero = [c for c in architecture.LOCAL if not _there(getattr(d, c))]
                assert set(zero) == set(architecture.LOCAL) - set(used)
                possible |= rank_of(d, 2j) == 2
            assert possible == (used in found), used
    assert [f.channels for f in architecture.families(2)] == [
        ("c1", "c2"),
        ("c3", "c4"),
    ]
    assert len(architecture.families(3)) == 4


def _there(value) -> bool:
    return (value.size() if isinstance(value, MotionTerm) else abs(value)) > 0.0


def test_a_local_gain_replaces_a_channel():
    assert architecture.LOCAL["c4"] == ("c8", "-z_cm")
    without = architecture.named_design("three-channel-4")
    assert without.c4.size() == 0.0 and architecture.is_transparent(without)


def of_control(d, zh, ze, real=REAL):
    """Closed loop in python-control, wired from the laws with their filters; from f_h* to v_m."""
    s = control.tf("s")

    def low(hz):
        return 1 / (1 + s / (2 * np.pi * hz)) if hz else control.tf([1], [1])

    def term(c):
        return c.k / s + c.b * low(real.velocity_hz) + c.a * s * low(real.acceleration_hz)

    gf = low(real.force_hz)
    a = 1 + d.c6 * gf
    zm, zs = (r.m * s + r.b for r in (d.master, d.slave))
    h, e = zh.m * s + zh.b + zh.k / s, ze.m * s + ze.b + ze.k / s
    # v_s from v_m and f_h*, then v_m from f_h*
    below = zs + term(d.c7) + (1 + d.c5 * gf) * e
    from_v = (term(d.c1) - d.c3 * gf * h) / below
    from_f = d.c3 * gf / below
    back = d.c2 * gf * e + term(d.c4)
    return (a - back * from_f) / (a * h + zm + term(d.c8) + back * from_v)


@pytest.mark.parametrize("real", [hybrid.IDEAL, REAL])
def test_closed_loop_agrees_with_python_control(real):
    d = replace(anchor(), c8=MotionTerm(240, 16, 0.05))
    loop = control.minreal(of_control(d, HAND, GEL, real), tol=1e-5, verbose=False)
    mine = hybrid.poles(d, HAND, GEL, real)
    # faster poles are the filters', several at one place
    slow = [[p for p in found if abs(p) < 200] for found in (mine, loop.poles())]
    assert len(slow[0]) == len(slow[1]) >= 4
    for p in slow[1]:
        assert np.abs(np.array(slow[0]) - p).min() < 1e-3 * abs(p)
    assert len(mine) == 4 or real is REAL
    h = hybrid.hybrid(d, hybrid.jw(W), real)
    zt = hybrid.transmitted(h, GEL(hybrid.jw(W)))
    np.testing.assert_allclose(1 / (HAND(hybrid.jw(W)) + zt), loop(1j * W), rtol=1e-6)


def test_the_delay_margin_is_that_of_python_control_and_of_the_poles():
    d = architecture.named_design(
        "position-force",
        architecture.Wish(
            stiffness=400,
            damping=12,
            share=0.8,
            master=RobotImpedance(0.1),
            slave=RobotImpedance(0.1),
        ),
    )
    margin = hybrid.delay_margin(d, HAND, GEL, REAL)
    s = control.tf("s")
    e = hybrid.blocks(d, hybrid.jw(W), REAL)
    gv, gf = (1 / (1 + s / (2 * np.pi * hz)) for hz in (60, 80))
    zh, ze = 0.4 * s + 4 + 150 / s, 1.5 + 300 / s
    left = (zh + 0.1 * s + d.c8.b * gv) * (ze + 0.1 * s + d.c7.k / s + d.c7.b * gv)
    loop = control.minreal(d.c2 * gf * ze * (d.c1.k / s + d.c1.b * gv) / left, verbose=False)
    _, pm, _, _, wcp, _ = control.stability_margins(loop)
    assert e.Zm.size == W.size
    assert margin == pytest.approx(np.deg2rad(pm % 360) / wcp, rel=1e-3)
    for share, stable in ((0.95, True), (1.05, False)):
        late = replace(REAL, forward_s=share * margin / 2, backward_s=share * margin / 2)
        assert (hybrid.poles(d, HAND, GEL, late)[0].real < 0) == stable


def test_the_secant_identity_and_the_slope():
    h = hybrid.hybrid(anchor(), hybrid.jw(W))
    a, b = GEL(hybrid.jw(W)), Impedance(0, 2, 450)(hybrid.jw(W))
    secant = (hybrid.transmitted(h, b) - hybrid.transmitted(h, a)) / (b - a)
    np.testing.assert_allclose(hybrid.sensitivity(h, a, b), secant, rtol=1e-9)
    step = 1e-4
    slope = (hybrid.transmitted(h, a + step) - hybrid.transmitted(h, a - step)) / (2 * step)
    np.testing.assert_allclose(hybrid.sensitivity(h, a), slope, rtol=1e-5)
    still = hybrid.hybrid(anchor(), np.array([1e-5j]))
    assert abs(hybrid.sensitivity(still, GEL(np.array([1e-5j])))[0]) == pytest.approx(
        0.207, abs=1e-3
    )


def test_undetermined_ports_are_refused():
    d = Design(c7=MotionTerm(-0.0, 0.0, -0.1), slave=RobotImpedance(0.1))
    with pytest.raises(ConfigError, match="not determined"):
        hybrid.hybrid(d, hybrid.jw(W))


def test_unknown_designs_and_bad_wishes_are_refused():
    with pytest.raises(ConfigError, match="Did you mean 'four-channel'"):
        architecture.named_design("four-chanel")
    with pytest.raises(ConfigError, match="stiffness"):
        architecture.Wish(stiffness=-1.0)
    with pytest.raises(ConfigError, match="positive"):
        RobotImpedance(0.0)


# ------------------------------------------------------------ loops with a delay


def roots_right(d, zh, ze, real, radius=4000.0):
    """Roots right of the axis by the argument principle, with the exact exponential; and chi."""
    gv, ga, gf = (
        (lambda s, hz=hz: 1.0 / (1.0 + s / (2 * np.pi * hz)) if hz else 1.0 + 0.0 * s)
        for hz in (real.velocity_hz, real.acceleration_hz, real.force_hz)
    )

    def term(c, s):
        return c.k + c.b * gv(s) * s + c.a * ga(s) * s * s

    def chi(s):
        """Characteristic equation times s^2."""
        h, n = zh.m * s * s + zh.b * s + zh.k, ze.m * s * s + ze.b * s + ze.k
        zm, zs = (r.m * s * s + r.b * s for r in (d.master, d.slave))
        a, b, c, e = 1 + d.c6 * gf(s), d.c2 * gf(s), d.c3 * gf(s), 1 + d.c5 * gf(s)
        ahead = (a * h + zm + term(d.c8, s)) * (e * n + zs + term(d.c7, s))
        around = (b * n + term(d.c4, s)) * (c * h - term(d.c1, s))
        return ahead - around * np.exp(-s * (real.forward_s + real.backward_s))

    y = np.concatenate([np.linspace(0, 100, 60001), np.linspace(100, radius, 60001)[1:]])
    edge = 1e-4 + 1j * np.concatenate([-y[:0:-1], y])
    arc = 1e-4 + radius * np.exp(1j * np.linspace(np.pi / 2, -np.pi / 2, 8001))
    turns = np.unwrap(np.angle(chi(np.concatenate([edge, arc[1:]]))))
    return -round((turns[-1] - turns[0]) / (2 * np.pi)), chi


def drawn(rng, k):
    """Random design, with filters or without."""
    name = ("position-force", "position-error", "four-channel")[k % 3]
    wish = architecture.Wish(
        stiffness=rng.uniform(50, 800),
        damping=rng.uniform(0.5, 10),
        master_stiffness=rng.uniform(50, 800),
        master_damping=rng.uniform(0.5, 12),
        share=rng.uniform(0.1, 1.0),
        motion_scale=rng.uniform(0.5, 2.0),
        force_scale=rng.uniform(0.5, 2.0),
        master=RobotImpedance(0.1),
        slave=RobotImpedance(0.07),
    )
    filtered = name == "four-channel" or k % 2
    real = replace(REAL, acceleration_hz=3.0) if filtered else hybrid.IDEAL
    return architecture.named_design(name, wish), real


@pytest.mark.parametrize(
    "each", [0.05, *(pytest.param(x, marks=pytest.mark.slow) for x in (0.002, 0.2, 0.3, 0.5, 1.5))]
)
def test_poles_and_margins_at_any_delay_are_those_of_the_argument_principle(each):
    rng, verdicts = np.random.default_rng(3), []
    for k in range(9):
        d, real = drawn(rng, k)
        late = replace(real, forward_s=each, backward_s=0.7 * each)
        count, chi = roots_right(d, HAND, GEL, late)
        found = hybrid.poles(d, HAND, GEL, late)
        assert np.sum(found.real > 1e-4) == count, (k, d.name)
        top = found[0]
        assert abs(chi(top)) < 1e-6 * abs(chi(top * (1 + 1e-3)) - chi(top * (1 - 1e-3)))
        margin = hybrid.delay_margin(d, HAND, GEL, late)
        assert (margin == 0.0) == (count > 0)
        verdicts.append(count > 0)
        if 0.0 < margin < 5.0:
            for share, unstable in ((0.98, 0), (1.02, 2)):
                more = replace(late, forward_s=each + share * margin)
                assert roots_right(d, HAND, GEL, more)[0] == unstable
    assert any(verdicts) == (each > 0.01)


def test_a_loop_that_bears_no_delay_at_all_is_told():
    """Without filters, a gain of more than 1 at the highest frequencies."""
    d = replace(anchor(), c3=8.0, c4=MotionTerm(-180, -12, -0.5))
    assert hybrid.delay_margin(d) == 0.0
    with pytest.raises(ConfigError, match=r"no end of unstable poles .* 1 is needed; give the"):
        hybrid.poles(d, HAND, GEL, Realisation(forward_s=0.1))
    with pytest.raises(ConfigError, match="no rational function of s"):
        hybrid.characteristic(d, HAND, GEL, Realisation(forward_s=0.1))


def test_one_way_and_free_loops_have_their_poles_over_a_delay():
    late = Realisation(forward_s=0.2, backward_s=0.3)
    d = replace(anchor(), c2=0.0, c4=MotionTerm())  # nothing comes back
    np.testing.assert_allclose(hybrid.poles(d, HAND, GEL, late), hybrid.poles(d), atol=1e-6)
    assert hybrid.delay_margin(d, HAND, GEL, late) == float("inf")
    free = architecture.named_design("position-error")  # its place drifts
    damper = Impedance(0.0, 5.0, 0.0)
    found = hybrid.poles(free, damper, damper, late)
    assert np.abs(found).min() == 0.0
    assert np.sum(found.real > 1e-4) == roots_right(free, damper, damper, late)[0]


NAN = float("nan")


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda d: hybrid.poles(replace(d, c2=NAN)), "c2 = nan is not finite"),
        (lambda d: hybrid.delay_margin(replace(d, c2=NAN)), "c2 = nan is not finite"),
        (lambda d: hybrid.hybrid(replace(d, c2=NAN), 1j), "c2 = nan is not finite"),
        (lambda d: hybrid.hybrid(replace(d, c1=MotionTerm(NAN)), 1j), "c1 = .*is not finite"),
        (lambda d: hybrid.hybrid(d, 0.0), "at s = 0"),
        (lambda d: hybrid.poles(d, Impedance(NAN)), "operator: m = nan kg"),
        (lambda d: hybrid.delay_margin(d, HAND, Impedance(0, np.inf)), "environment: .*b = inf"),
        (lambda d: architecture.families(-1), "families of -1 channels"),
        (lambda d: architecture.families(7), "families of 7 channels"),
    ],
)
def test_what_is_no_design_is_refused_by_name(ask, said):
    with pytest.raises(ConfigError, match=said):
        ask(anchor())


def test_nothing_has_no_sign():
    d = architecture.named_design(
        "position-error", architecture.Wish(master_stiffness=0.0, master_damping=0.0)
    )
    assert [np.copysign(1.0, x) for x in (d.c4.k, d.c4.b, d.c4.a)] == [1.0, 1.0, 1.0]
