"""Data faults: each is found, and clean recordings have none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plants
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from record_tables import URDF, columns

from hil.record import consistency
from hil.record.checks import OF_UNITS, check, joint_units, speed_and_effort
from hil.record.consistency import other_units, smooth, unit_doubt
from hil.record.recording import Recording, RobotSource
from hil.record.urdf_checks import UrdfJoint


def faults(r: Recording) -> list[tuple[str, str, str]]:
    return [(f.code, f.severity, f.joint) for f in check(r)]


@settings(deadline=None, max_examples=60)
@given(
    d=st.integers(1, 7),
    seed=st.integers(0, 10_000),
    rate=st.sampled_from([200.0, 500.0, 1000.0]),
    unit=st.sampled_from(["rad", "m"]),
    count=st.sampled_from([0.0, 1e-5, 1e-3]),
    delay=st.integers(0, 5),
    still=st.booleans(),
    slow=st.sampled_from([1.0, 0.1]),
)
def test_clean_recordings_have_no_fault(d, seed, rate, unit, count, delay, still, slow):
    r = plants.joints(d, 6.0, rate, seed, unit)
    q, tau = r.q, r.tau
    if still and slow == 1:  # stands still for the first and last second
        ramp = np.clip(np.minimum(r.t, r.t[-1] - r.t) - 1.0, 0, 1)[:, None]
        q = q * (3 * ramp**2 - 2 * ramp**3)
    if slow < 1:  # the same motion ten times slower, sampled as often: friction alone counts
        q = np.stack([np.interp(r.t * slow, r.t, column) for column in q.T], axis=1)
        qd = np.gradient(q, r.t, axis=0)
        tau = 0.1 * qd + 0.3 * np.tanh(qd / 0.02)
    elif still:
        qd = np.gradient(q, r.t, axis=0)
        tau = 0.05 * np.gradient(qd, r.t, axis=0) + 0.1 * qd + 0.3 * np.tanh(qd / 0.02)
    q = np.round(q / count) * count if count else q
    tau = np.concatenate([np.repeat(tau[:1], delay, axis=0), tau[: r.n - delay]])
    assert faults(replace(r, q=q, tau=tau, qd=None)) == []


def test_nan_is_an_error():
    r = plants.joints()
    tau = r.tau.copy()
    tau[7:9, 1] = np.nan
    (found,) = check(replace(r, tau=tau))
    assert (found.code, found.severity, found.joint) == ("not-finite", "error", "joint2")
    assert "tau2: 2 of 3000" in found.text
    assert "first at sample 7" in found.text


def with_time(change) -> Recording:
    r = plants.joints()
    t = r.t.copy()
    change(t)
    return replace(r, t=t)


def test_backward_time_is_an_error():
    assert ("time-backward", "error", "") in faults(with_time(lambda t: t.__setitem__(50, 0.0)))


def test_repeated_time():
    r = with_time(lambda t: t.__setitem__(50, t[49]))
    assert faults(r) == [("time-repeated", "warning", "")]


def test_constant_time_is_an_error():
    r = with_time(lambda t: t.fill(1.0))
    assert ("time-repeated", "error", "") in faults(r)


def test_gap():
    r = with_time(lambda t: t.__setitem__(slice(900, None), t[900:] + 0.5))
    (found,) = check(r)
    assert found.code == "gap"
    assert "1 gap, the longest 0.502 s, the first after 1.798 s" in found.text


def test_a_position_that_changes_across_a_gap_alone():
    r = with_time(lambda t: t.__setitem__(slice(900, None), t[900:] + 0.5)).slice(0, 1800)
    q = np.repeat([[0.0, 0.0], [0.1, 0.1]], 900, axis=0)
    assert ("gap", "warning", "") in faults(replace(r, q=q, qd=None))


def test_rows_from_a_queue_are_told_once_and_checked_on_their_even_clock():
    r = plants.queued(plants.joints(), (20, 21))
    (found,) = check(r)
    assert found.code == "irregular-time" and "up to 20 rows come at once" in found.text
    assert r.rate == pytest.approx(500.0, rel=1e-4)
    # stamps cut to hundredths of a second, five rows in each
    cut = plants.joints()
    cut = replace(cut, t=np.floor(cut.t * 100 + 1e-6) / 100)
    assert faults(cut) == [("irregular-time", "warning", "")]


def test_irregular_time():
    def change(t):
        t += np.random.default_rng(0).uniform(0, 0.0015, t.size)

    assert ("irregular-time", "warning", "") in faults(with_time(change))


@pytest.mark.parametrize(
    ("rate", "severity"), [(50.0, "warning"), (10.0, "warning"), (8.0, "error")]
)
def test_slow_rate(rate, severity):
    assert ("sample-rate", severity, "") in faults(plants.joints(rate=rate))


def test_a_nominal_rate_with_stamps_that_stray_is_as_good_as_it():
    """A log of 100 Hz whose stamps strayed was told that 99.3 Hz is slow."""
    assert not [f for f in faults(plants.joints(rate=99.3)) if f[0] == "sample-rate"]
    assert [f for f in faults(plants.joints(rate=90.0)) if f[0] == "sample-rate"]


def test_milliseconds_are_named():
    (found,) = check(with_time(lambda t: t.__imul__(1000)))
    assert found.severity == "error"
    assert "milliseconds" in found.text


def test_too_short():
    assert ("too-short", "warning", "") in faults(plants.joints(seconds=0.5))
    assert faults(plants.joints().slice(0, 10)) == [("too-short", "error", "")]
    assert faults(plants.joints().slice(0, 1)) == [("too-short", "error", "")]


def test_nothing_moves_is_no_error():
    r = plants.joints()
    assert all(s == "warning" for _, s, _ in faults(replace(r, q=np.zeros_like(r.q), qd=None)))


def test_everything_stuck_is_an_error():
    r = plants.joints()
    zero = np.zeros_like(r.q)
    assert faults(replace(r, q=zero, tau=zero, qd=None)) == [("stuck", "error", "")]


def one(r: Recording, key: str, change) -> Recording:
    values = getattr(r, key).copy()
    values[:, 0] = change(values[:, 0])
    return replace(r, **{key: values})


def test_no_effort_anywhere_is_an_error():
    r = plants.joints(d=1)
    silent = replace(r, tau=np.zeros_like(r.tau), qd=None)
    assert faults(silent) == [("no-effort", "error", "")]
    by_hand = replace(silent, tau_ext=r.tau)  # motors off, moved by hand
    assert faults(by_hand) == []


def test_dead_effort_channel():
    r = one(plants.joints(), "tau", lambda x: 0 * x)
    assert faults(r) == [("silent-joint", "warning", "joint1")]


def test_frozen_encoder_that_catches_up():
    def freeze(q):
        at = int(np.argmax(np.abs(np.gradient(q))[200:-200])) + 200
        q[at : at + 40] = q[at]
        return q

    assert faults(one(replace(plants.joints(), qd=None), "q", freeze)) == [
        ("stuck", "warning", "joint1")
    ]


def test_position_step():
    def jump(q):
        q[1500:] += 0.05
        return q

    found = check(one(replace(plants.joints(), qd=None), "q", jump))
    assert [(f.code, f.joint) for f in found] == [("step", "joint1")]
    assert "jumps once within a sample" in found[0].text and "+0.05 at 3 s" in found[0].text


def test_clipped_effort():
    r = one(plants.joints(d=1), "tau", lambda x: np.clip(3 * x, -0.9, 0.9))
    assert {c for c, _, _ in faults(r)} == {"saturation"}


@pytest.mark.parametrize(
    ("factor", "code", "text"),
    [
        (57.3, "velocity-scale", "degrees"),
        (-1.0, "velocity-sign", "opposite signs"),
        (0.001, "velocity-scale", "milliseconds"),
        (2.0, "velocity-scale", "is 2"),
    ],
)
def test_velocity_that_is_not_the_derivative(factor, code, text):
    found = check(one(plants.joints(), "qd", lambda x: factor * x))
    assert [(f.code, f.joint) for f in found] == [(code, "joint1")]
    assert text in found[0].text


def test_degrees():
    r = one(replace(plants.joints(), qd=None), "q", lambda x: 57.3 * x)
    assert faults(r) == [("unit", "warning", "joint1")]


def test_beyond_the_limits_of_the_urdf():
    r = replace(one(plants.joints(), "q", lambda x: x + 3.0), robot=RobotSource("", URDF), qd=None)
    assert [f[0] for f in faults(replace(r, joints=("shoulder", "elbow")))] == ["limits"]


def test_inverted_effort():
    found = check(replace(plants.joints(), tau=-plants.joints().tau))
    assert [(f.code, f.severity) for f in found] == [("sign", "warning")] * 2
    assert "only takes energy out" in found[0].text


def test_inverted_external_effort():
    r = plants.joints(d=1)
    push = 2 * np.sin(5 * r.t[:, None]) ** 3
    right = replace(r, tau=r.tau - push, tau_ext=push)
    assert faults(right) == []
    (found,) = check(replace(right, tau_ext=-push))
    assert (found.code, found.joint) == ("sign", "joint1")
    assert "tauext1" in found.text


def test_units_come_from_the_urdf():
    urdf = URDF.replace('name="elbow" type="revolute"', 'name="elbow" type="prismatic"')
    r = replace(plants.joints(), robot=RobotSource("", urdf))
    assert joint_units(r) == ("rad", "m")
    assert joint_units(replace(r, robot=RobotSource("", "nonsense"))) == ("rad", "rad")
    assert columns(r)["q1"].shape == (r.n,)


@settings(deadline=None, max_examples=100)
@given(
    n=st.integers(1, 70),
    d=st.integers(1, 3),
    kinds=st.tuples(*[st.integers(0, 5)] * 4),
    power=st.integers(-320, 300),
    seed=st.integers(0, 10**6),
)
def test_a_check_never_raises(n, d, kinds, power, seed):
    """Whatever the values; pytest turns every warning of NumPy into an error."""
    rng = np.random.default_rng(seed)
    scale = float(f"1e{power}")

    def values(kind: int) -> np.ndarray:
        walk = np.cumsum(rng.normal(size=(n, d)), axis=0)
        constant, noise = np.full((n, d), rng.normal()), rng.normal(size=(n, d))
        holes = np.where(rng.random((n, d)) < 0.1, np.nan, walk)
        return [0 * walk, constant, noise, walk, scale * noise, holes][kind]

    t = np.arange(n) * 1e-3 if seed % 3 else rng.random(n)
    q, tau, qd, ext = (values(k) for k in kinds)
    names = tuple("abc"[:d])
    r = Recording("r", "arm", names, t, q, tau, qd if seed % 2 else None, None, ext)
    assert all(f.severity in ("error", "warning") and f.text for f in check(r))


def of_arm(change) -> list:
    """Faults of two joints of the URDF (limits 2 rad, 9 rad/s, 9 N m), changed."""
    r = replace(plants.joints(), joints=("shoulder", "elbow"), robot=RobotSource("", URDF), qd=None)
    return check(replace(r, **change(r)))


@pytest.mark.parametrize(
    ("change", "code", "value", "limit"),
    [
        (lambda r: {"tau": r.tau * [1, 30]}, "effort-limit", "tau2 reaches 14.8", "(9)"),
        (lambda r: {"tau": r.tau * 1000}, "effort-limit", "is it in mN m?", "(9)"),
        (lambda r: {"t": r.t * 0.03}, "velocity-limit", "of q2 reaches 32.127 rad/s", "(9)"),
        (lambda r: {"q": np.add(r.q, [0, 2])}, "limits", "to 2.315 rad", "(-2 to 2)"),
    ],
)
def test_beyond_a_limit_names_joint_value_and_limit(change, code, value, limit):
    found = [f for f in of_arm(change) if f.code == code][-1]
    assert (found.severity, found.joint) == ("warning", "elbow")
    assert value in found.text
    assert limit in found.text


def test_efforts_far_beyond_their_limit_may_be_a_current_or_a_share_of_the_rated_one():
    (told,) = {f.text.partition(";")[2] for f in of_arm(lambda r: {"tau": r.tau * 1000})}
    for way in ("is it in mN m?", 'unit = "mA", torque_constant = ...', "[N m] / 100 or 1000"):
        assert way in told


def test_a_length_in_doubt_is_in_centimetres_where_its_limits_allow_them():
    slide = UrdfJoint("lift", "m", 0.0, 0.4)
    for reach, units in ((35.0, ["centimetres", "millimetres"]), (350.0, ["millimetres"])):
        q = np.linspace(0.0, reach, 100)
        assert unit_doubt(q, slide, True)
        assert list(other_units(q, slide)) == units
    assert list(other_units(np.linspace(0, 90, 9), UrdfJoint("elbow", "rad"))) == ["degrees"]


def test_limits_of_zero_are_no_limits():
    blank = URDF.replace('effort="9" velocity="9"', 'effort="0" velocity="0"')
    assert of_arm(lambda r: {"tau": 50 * r.tau, "robot": RobotSource("", blank)}) == []


def test_a_single_sample_beyond_a_limit_is_noise():
    def spike(r):
        tau = r.tau.copy()
        tau[700, 0] = 12.0
        return {"tau": tau}

    assert [f.code for f in of_arm(spike) if "limit" in f.code] == []


@given(st.data())
def test_what_is_passed_over_at_a_cheap_look_has_no_fault(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    r = plants.joints(2, 6.0, 500.0, int(rng.integers(1000)))
    q, tau = np.array(r.q), np.array(r.tau)
    for name in data.draw(st.sets(st.sampled_from(["counts", "spike", "step", "stuck", "cut"]))):
        at, size = int(rng.integers(200, r.n - 200)), 10.0 ** rng.uniform(-5, 0)
        if name == "counts":
            q = np.round(q / size) * size
        elif name == "spike":
            q[at, 0] += size
        elif name == "step":
            q[at:, 1] += size
        elif name == "stuck":
            q[at : at + 50, 0] = q[at, 0]
        else:
            tau = np.clip(tau, -size * np.max(tau), size * np.max(tau))
    broken = replace(r, q=q, tau=tau)
    with pytest.MonkeyPatch.context() as patch:
        found = check(broken)
        patch.setattr(consistency, "reached", lambda *_: False)
        assert check(broken) == found


@pytest.mark.parametrize("joint", [0, 1])
def test_a_speed_just_beyond_its_limit_is_seen(joint):
    r = plants.joints(2, 6.0, 500.0, 1)
    fastest = float(np.abs(np.gradient(smooth(r.q[:, joint], 5), r.t)).max())
    for share, beyond in ((0.9, True), (0.97, False), (1.1, False)):
        listed = UrdfJoint("j", "rad", velocity=share * fastest)
        found = [f.code for f in speed_and_effort(r, joint, listed)]
        assert ("nominal-speed" in found) == beyond and "velocity-limit" not in found


@pytest.mark.parametrize(
    ("speed", "share", "code"),
    [
        (1.3, 0.01, "nominal-speed"),
        (3.0, 0.2, "nominal-speed"),
        (3.0, 0.8, "velocity-limit"),
        (57.3, 0.01, "velocity-limit"),
    ],
)
def test_a_unit_is_in_doubt_only_far_beyond_a_limit_of_speed(speed, share, code):
    """A joint that swings at half of its limit of 1 rad/s, and faster for a share of the time."""
    t = np.arange(4000) * 2e-3
    v = np.where(np.arange(4000) < 4000 * share, speed, 0.5) * np.sign(np.sin(9 * t))
    q = np.cumsum(v)[:, None] * 2e-3
    r = Recording("r", "arm", ("j",), t, q, np.sin(9 * t)[:, None])
    found = list(speed_and_effort(r, 0, UrdfJoint("j", "rad", velocity=1.0)))
    assert [f.code for f in found] == [code]
    assert ("check the unit" in found[0].text) == (found[0].code in OF_UNITS)


@pytest.mark.parametrize("lost", [(700, 705), (700, 709), (300, 301)])
def test_lost_rows_are_no_speed(lost):
    """A gap of some rows, and a slower row within the usual jitter: no row is faster than 9."""
    r = plants.joints(2, 6.0, 250.0, 1)
    fastest = np.abs(np.diff(r.q, axis=0) / np.diff(r.t)[:, None]).max(axis=0)
    r = replace(r, **{n: np.delete(getattr(r, n), slice(*lost), 0) for n in ("t", "q", "tau")})
    for joint in (0, 1):
        listed = UrdfJoint("j", "rad", velocity=float(fastest[joint]) / 1.05)
        assert list(speed_and_effort(r, joint, listed)) == []
        middle = float(np.median(np.abs(np.diff(r.q[:, joint]) / np.diff(r.t))))
        told = [f.text for f in speed_and_effort(r, joint, UrdfJoint("j", "rad", velocity=middle))]
        said = float(told[0].split("reaches ")[1].split()[0])
        assert said <= 1.001 * fastest[joint]
