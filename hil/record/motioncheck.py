"""Warnings from the motion of a recording: jumps, clipping, wrong scales, signs and units."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from hil.errors import DataError
from hil.record import consistency as physics
from hil.record import limitcheck
from hil.record.balance import balance
from hil.record.finding import Finding
from hil.record.jumps import described
from hil.record.recording import Recording
from hil.record.spikes import check_spikes
from hil.record.urdf_joints import UrdfJoint, urdf_joints

_KNOWN_FACTORS = (
    (180 / math.pi, "the velocity is in degrees"),
    (math.pi / 180, "the position is in degrees"),
    (1e-3, "the time is in milliseconds, or the position in milli-units"),
    (1e3, "the velocity is in milli-units"),
    (60 / (2 * math.pi), "the velocity is in revolutions a minute"),
)


def check_motion(recording: Recording) -> Iterator[Finding]:
    """Warnings that follow from the motion; the values and the time must be sound.

    Parameters
    ----------
    recording : Recording
        At least 20 samples of finite values.
    """
    if np.any(np.diff(recording.t) <= 0):
        return
    yield from _units(recording)
    yield from check_spikes(recording)
    for k, joint in enumerate(recording.joints):
        if np.ptp(recording.q[:, k]) > 0:
            yield from _position(recording, k, joint)
            yield from _effort(recording, k, joint)
            yield from _velocity(recording, k, joint)
    if recording.wrench is not None:
        always = np.ones(recording.n, dtype=np.bool_)
        for k, name in enumerate(("fx", "fy", "fz", "tx", "ty", "tz")):
            for clip in physics.clipping(recording.wrench[:, k], lambda: always):
                yield _clipped(name, "", clip)
    yield from _signs(recording)


def described_joints(recording: Recording) -> tuple[UrdfJoint, ...]:
    """Joints of the recording's URDF; empty without one, or if it is of another robot."""
    try:
        listed = urdf_joints(recording.robot.urdf) if recording.robot.urdf else ()
    except DataError:
        return ()
    return listed if len(listed) == recording.d else ()


def _units(r: Recording) -> Iterator[Finding]:
    listed = described_joints(r)
    described = bool(listed)
    unit = r.metadata.get("unit", "rad")
    for k, name in enumerate(r.joints):
        joint = listed[k] if described else UrdfJoint(name, unit)
        q = r.q[:, k]
        if physics.unit_doubt(q, joint, described):
            what = "degrees" if joint.unit == "rad" else "millimetres"
            yield Finding(
                "unit", "warning", name,
                f"q{k + 1} runs from {q.min():.4g} to {q.max():.4g} {joint.unit}; is it in {what}? "
                "Scale it in a map when importing",
            )  # fmt: skip
        elif described:
            yield from limitcheck.position(r, k, joint)
            yield from limitcheck.speed_and_effort(r, k, joint)


def _position(r: Recording, k: int, joint: str) -> Iterator[Finding]:
    q = r.q[:, k]
    frozen = list(physics.stuck(r.t, q))
    jumps = [j for j in physics.steps(r.t, q) if not _ends(frozen, float(r.t[j]))]
    if frozen:
        start, length = max(frozen, key=lambda x: x[1])
        yield Finding(
            "stuck", "warning", joint,
            f"q{k + 1} freezes {len(frozen)} times while moving, the longest for {length:.3g} s at "
            f"{start:.6g} s, and catches up in one sample; samples were lost before recording",
        )  # fmt: skip
    lost = r.jumps[k]
    # what is less than the fastest ordinary step may be a sample that came late
    if lost.at.size and np.abs(lost.size).max() > np.quantile(np.abs(np.diff(q)), 0.99):
        yield Finding("step", "warning", joint, f"q{k + 1} {described(r.t, lost)}")
    elif jumps:
        size = float(q[jumps[0] + 1] - q[jumps[0]])
        yield Finding(
            "step", "warning", joint,
            f"q{k + 1} jumps {len(jumps)} times within a sample, first by {size:.3g} at "
            f"{r.t[jumps[0]]:.6g} s; missed counts or an encoder fault: leave that part out",
        )  # fmt: skip


def _ends(frozen: list[tuple[float, float]], at: float) -> bool:
    return any(start <= at <= start + 1.5 * length for start, length in frozen)


def _effort(r: Recording, k: int, joint: str) -> Iterator[Finding]:
    moving = partial(physics.moves, r.t, r.q[:, k])
    for clip in physics.clipping(r.tau[:, k], moving):
        yield _clipped(f"tau{k + 1}", joint, clip)
    if r.tau_ext is not None:
        for clip in physics.clipping(r.tau_ext[:, k], moving):
            yield _clipped(f"tauext{k + 1}", joint, clip)


def _clipped(name: str, joint: str, clip: physics.Clipping) -> Finding:
    return Finding(
        "saturation", "warning", joint,
        f"{name} is cut off at {clip.level:.4g} for {100 * clip.share:.2g} % of the samples; "
        "what acted there is not what was recorded: move more gently or leave it out",
    )  # fmt: skip


def _velocity(r: Recording, k: int, joint: str) -> Iterator[Finding]:
    if r.qd is None:
        return
    factor, correlation = physics.velocity_factor(r.t, r.q[:, k], r.qd[:, k])
    if not abs(correlation) > 0.95:
        return
    if factor < 0:
        yield Finding(
            "velocity-sign", "warning", joint,
            f"qd{k + 1} is {factor:.3g} times the derivative of q{k + 1}: opposite signs; "
            "change the sign of one of them in a map",
        )  # fmt: skip
    elif not 0.8 < factor < 1.25:
        guess = [f" ({text})" for f, text in _KNOWN_FACTORS if abs(factor / f - 1) < 0.1]
        yield Finding(
            "velocity-scale", "warning", joint,
            f"qd{k + 1} is {factor:.4g} times the derivative of q{k + 1}"
            f"{guess[0] if guess else ''}; scale one of them in a map",
        )  # fmt: skip


def _signs(r: Recording) -> Iterator[Finding]:
    """Efforts that take energy out where the motor is the only one to put it in."""
    found = {}
    for k in range(r.d):
        if physics.swings(r.q[:, k]) >= 2 and np.ptp(r.tau[:, k]) > 0:
            ext = None if r.tau_ext is None else r.tau_ext[:, k]
            found[k] = balance(r.t, r.q[:, k], r.tau[:, k], ext)
    power = np.diff(r.q, axis=0) * r.tau[:-1]
    total = float(power.sum() / (np.abs(power).sum() or 1.0))
    for k, b in found.items():
        name = r.joints[k]
        backward = b.inertia < 0 and b.friction < 0
        known = abs(b.certainty) > 0.8 and 0.6 < abs(b.external) < 1.7
        if known and b.external > 0 and not backward and b.inertia > 0 and b.friction > 0:
            yield Finding(
                "sign", "warning", name,
                f"tauext{k + 1} acts with the motor's resistance instead of against it: it should "
                "be the effort ON the robot; change its sign in a map",
            )  # fmt: skip
        alone = r.wrench is None and r.tau_ext is None
        if backward and ((alone and b.work < -0.3 and total < -0.3) or (known and b.external > 0)):
            yield Finding(
                "sign", "warning", name,
                f"tau{k + 1} only takes energy out of the motion (net work {100 * b.work:.0f} %) "
                "and inertia and friction come out negative: change the sign of the effort or the "
                "position in a map, unless someone moved the joint by hand",
            )  # fmt: skip
