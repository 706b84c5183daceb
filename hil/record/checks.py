"""Data faults of a recording, before anyone fits it: time base, missing and frozen values, motion.

An ``"error"`` means that any fit would be worthless.  Warnings come from the motion: jumps,
clipping, wrong scales, signs and units, efforts that the motion does not explain, and places beyond
the limits that the URDF states.  `hil.record.consistency` has the tests that need the laws of
motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from hil.errors import DataError, plural
from hil.record import consistency as physics
from hil.record.consistency import DataFault, check_spikes, smooth
from hil.record.jumps import TURN, described, wraps
from hil.record.recording import STATED, UNIT_SAID, Recording
from hil.record.urdf_checks import UrdfJoint, urdf_joints


@dataclass(frozen=True)
class Balance:
    """Joint effort explained by its own motion.

    Parameters
    ----------
    inertia, friction : float
        Coefficients of acceleration and of the direction of motion.
    work : float
        Net work of the effort over the work without regard to sign, -1 to 1.
    external : float
        Coefficient of the external effort (-1 where all is right); NaN without one.
    certainty : float
        Partial correlation of the external effort.
    """

    inertia: float
    friction: float
    work: float
    external: float
    certainty: float


def balance(t: FloatArray, q: FloatArray, tau: FloatArray, ext: FloatArray | None) -> Balance:
    """Regress the effort of a joint on its own motion and the external effort.

    Parameters
    ----------
    t, q, tau : ndarray (n,)
        Time, position and motor effort.
    ext : ndarray (n,) or None
        External effort on the robot.
    """
    period = float(np.median(np.diff(t)))
    width = max(int(0.02 / period), 3)
    position, effort = smooth(q, width), smooth(tau, width)
    speed = physics.rate_of(t, q, width)
    acceleration = physics.rate_of(t, speed, width)
    scale = 0.1 * float(np.sqrt(np.mean(speed**2))) or 1.0
    direction = smooth(np.tanh(speed / scale), width)
    trim = slice(3 * width, -3 * width, max(width // 2, 1))
    y, v, x = effort[trim], speed[trim], position[trim]
    terms = [acceleration[trim], direction[trim], np.ones_like(x), x, np.sin(x), np.cos(x)]
    known = np.stack(terms, axis=1)
    work = float(np.sum(y * v) / (np.sum(np.abs(y * v)) or 1.0))
    external, certainty = float("nan"), 0.0
    if ext is not None and np.ptp(ext) > 0:
        other = smooth(ext, width)[trim]
        rest = other - known @ np.linalg.lstsq(known, other, rcond=None)[0]
        left = y - known @ np.linalg.lstsq(known, y, rcond=None)[0]
        norm = float(np.sqrt(np.sum(rest**2) * np.sum(left**2)))
        certainty = float(np.sum(rest * left)) / norm if norm else 0.0
        external = float(np.sum(rest * left) / (np.sum(rest**2) or 1.0))
        y = y - external * other
    fitted = np.linalg.lstsq(known, y, rcond=None)[0]
    return Balance(float(fitted[0]), float(fitted[1]), work, external, certainty)


#: Share of the range by which a position, and of the limit by which a speed or an effort, must be
#: beyond it; and samples that must be: a limit is a round number, a single sample is noise.
ROOM, BEYOND, FEW = 0.02, 0.05, 3
#: A speed so many times beyond its limit is in another unit: the least factor between two units of
#: a position or a time is that of a turn to a radian.  A share of the samples that is most of them.
OTHER_UNIT, MOST = 2 * math.pi, 0.5
#: An effort so many times beyond its limit, but not a thousand times, is in milli-units.
MILLI = 20.0
#: Width [s] over which a speed is averaged, so that encoder counts are not taken for speed.
_WIDTH_S = 0.01


def position(r: Recording, k: int, joint: UrdfJoint) -> Iterator[DataFault]:
    """Position beyond the range of a joint.

    Parameters
    ----------
    r : Recording
        Finite values.
    k : int
        Index of the joint in the recording.
    joint : UrdfJoint
        What the URDF says of it.
    """
    q, room = r.q[:, k], ROOM * (joint.upper - joint.lower)
    out = int(np.count_nonzero((q > joint.upper + room) | (q < joint.lower - room)))
    if math.isfinite(room) and out >= FEW:
        yield DataFault(
            "limits",
            "warning",
            r.joints[k],
            f"q{k + 1} runs from {q.min():.4g} to {q.max():.4g} {joint.unit}, beyond the limits of "
            f"the URDF ({joint.lower:.4g} to {joint.upper:.4g}) in {_share(out, r.n)} of the "
            "samples; check sign, unit and zero of this joint",
        )


def speed_and_effort(r: Recording, k: int, joint: UrdfJoint) -> Iterator[DataFault]:
    """Speed and effort beyond what a joint is said to be capable of; parameters as `position`."""
    effort = "N m" if joint.unit == "rad" else "N"
    q = r.q[:, k]
    # no mean over steps is faster than the fastest of them
    if float(np.abs(np.diff(q)).max()) > joint.velocity * float(np.diff(r.t).min()):
        yield from _speed(r, k, joint)
    most = float(np.abs(r.tau[:, k]).max())
    milli = MILLI * joint.effort < most <= 1000 * joint.effort
    yield from _beyond(
        "effort-limit",
        f"tau{k + 1}",
        r.tau[:, k],
        joint.effort,
        effort,
        r.joints[k],
        f"is it in m{effort}? Then scale it by 0.001 in a map when importing. Of a current in mA "
        f'write tau = {{ unit = "mA", torque_constant = ... }} under [units], of per cent or per '
        f"mille of a rated effort scale = that effort at the joint [{effort}] / 100 or 1000"
        if milli
        else f"check that it is the effort at the joint in {effort} (after the gear, no current, "
        "no per cent of a rated one), and that the URDF is of this robot",
    )


def _speed(r: Recording, k: int, joint: UrdfJoint) -> Iterator[DataFault]:
    """Speed beyond its limit, which is a nominal one: a unit is in doubt only far beyond it."""
    width = max(round(_WIDTH_S / r.period), 1)
    whole = ~maximum_filter1d(np.diff(r.t, append=r.t[-1]) > _GAP * r.period, 2 * width + 3)
    speed = physics.rate_of(r.t, r.q[:, k], width)[whole]
    size = np.abs(speed) / joint.velocity
    most = np.count_nonzero(size > 1 + BEYOND) > MOST * size.size
    doubted = most or np.count_nonzero(size > OTHER_UNIT) >= FEW
    yield from _beyond(
        "velocity-limit" if doubted else NOMINAL_SPEED,
        f"the speed of q{k + 1}",
        speed,
        joint.velocity,
        f"{joint.unit}/s",
        r.joints[k],
        "check the unit of this position and of the time"
        if doubted
        else "this limit is a nominal one, so that the unit is not in doubt",
    )


def _beyond(
    code: str, name: str, values: FloatArray, limit: float, unit: str, joint: str, advice: str
) -> Iterator[DataFault]:
    size = np.abs(values)
    out = int(np.count_nonzero(size > (1 + BEYOND) * limit))
    if out >= FEW:
        yield DataFault(
            code,
            "warning",
            joint,
            f"{name} reaches {size.max():.5g} {unit}, beyond the limit of the URDF ({limit:.4g}) "
            f"in {_share(out, size.size)} of the samples; {advice}",
        )


def _share(count: int, n: int) -> str:
    share = max(100 * count / n, 0.01)
    return f"{share:.0f} %" if share > 10 else f"{share:.2g} %"


_KNOWN_FACTORS = (
    (180 / math.pi, "the velocity is in degrees"),
    (math.pi / 180, "the position is in degrees"),
    (1e-3, "the time is in milliseconds, or the position in milli-units"),
    (1e3, "the velocity is in milli-units"),
    (60 / (2 * math.pi), "the velocity is in revolutions a minute"),
)


def check_motion(recording: Recording) -> Iterator[DataFault]:
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


def _units(r: Recording) -> Iterator[DataFault]:
    listed = described_joints(r)
    described = bool(listed)
    stated = r.metadata.get(STATED, "").split()
    for k, name in enumerate(r.joints):
        joint = listed[k] if described else UrdfJoint(name, r.units[k])
        q = r.q[:, k]
        doubted = str(k + 1) not in stated and UNIT_SAID not in r.metadata
        if doubted and physics.unit_doubt(q, joint, described):
            what = " or in ".join(physics.other_units(q, joint))
            yield DataFault(
                "unit",
                "warning",
                name,
                f"q{k + 1} runs from {q.min():.4g} to {q.max():.4g} {joint.unit}; is it in {what}? "
                "Scale it in a map when importing",
            )
        elif str(k + 1) not in stated and physics.counts_doubt(q):
            yield DataFault(
                "unit",
                "warning",
                name,
                f"q{k + 1} holds whole numbers only, {q.min():.6g} to {q.max():.6g} {joint.unit}: "
                "encoder counts? Scale it in a map when importing",
            )
        elif described:
            yield from position(r, k, joint)
            yield from speed_and_effort(r, k, joint)


def _position(r: Recording, k: int, joint: str) -> Iterator[DataFault]:
    q = r.q[:, k]
    if found := wraps(r.t, q, [TURN]) if joint_units(r)[k] == "rad" else None:
        yield DataFault(
            "wrap",
            "warning",
            joint,
            f"{found.text(f'q{k + 1}', False)}: effects over the position, and the speed at each "
            "wrap, are wrong; leave unwrap = false out of the map, or unwrap the column before",
        )
    frozen = list(physics.stuck(r.t, q))
    jumps = [j for j in physics.steps(r.t, q) if not _ends(frozen, float(r.t[j]))]
    if frozen:
        start, length = max(frozen, key=lambda x: x[1])
        yield DataFault(
            "stuck",
            "warning",
            joint,
            f"q{k + 1} freezes {len(frozen)} times while moving, the longest for {length:.3g} s at "
            f"{start:.6g} s, and catches up in one sample; samples were lost before recording",
        )
    lost = r.jumps[k]
    # what is less than the fastest ordinary step may be a sample that came late
    if lost.at.size and np.abs(lost.size).max() > np.quantile(np.abs(np.diff(q)), 0.99):
        yield DataFault("step", "warning", joint, f"q{k + 1} {described(r.t, lost)}")
    elif jumps:
        size = float(q[jumps[0] + 1] - q[jumps[0]])
        yield DataFault(
            "step",
            "warning",
            joint,
            f"q{k + 1} jumps {len(jumps)} times within a sample, first by {size:.3g} at "
            f"{r.t[jumps[0]]:.6g} s; missed counts or an encoder fault: leave that part out",
        )


def _ends(frozen: list[tuple[float, float]], at: float) -> bool:
    return any(start <= at <= start + 1.5 * length for start, length in frozen)


def _effort(r: Recording, k: int, joint: str) -> Iterator[DataFault]:
    moving = partial(physics.moves, r.t, r.q[:, k])
    for clip in physics.clipping(r.tau[:, k], moving):
        yield _clipped(f"tau{k + 1}", joint, clip)
    if r.tau_ext is not None:
        for clip in physics.clipping(r.tau_ext[:, k], moving):
            yield _clipped(f"tauext{k + 1}", joint, clip)


def _clipped(name: str, joint: str, clip: physics.Clipping) -> DataFault:
    return DataFault(
        "saturation",
        "warning",
        joint,
        f"{name} is cut off at {clip.level:.4g} for {100 * clip.share:.2g} % of the samples; "
        "the true values there were not recorded: move more gently or leave this part out",
    )


def _velocity(r: Recording, k: int, joint: str) -> Iterator[DataFault]:
    if r.qd is None:
        return
    if not np.any(r.qd[:, k]) and physics.swings(r.q[:, k]):
        yield DataFault(
            "velocity-empty",
            "warning",
            joint,
            f"qd{k + 1} is zero throughout though q{k + 1} moves: it was never filled. It is "
            "ignored; speeds are derivatives of the positions",
        )
        return
    factor, correlation = physics.velocity_factor(r.t, r.q[:, k], r.qd[:, k])
    if not abs(correlation) > 0.95:
        return
    if factor < 0:
        yield DataFault(
            "velocity-sign",
            "warning",
            joint,
            f"qd{k + 1} is {factor:.3g} times the derivative of q{k + 1}: opposite signs; "
            "change the sign of one of them in a map",
        )
    elif not 0.8 < factor < 1.25:
        guess = [f" ({text})" for f, text in _KNOWN_FACTORS if abs(factor / f - 1) < 0.1]
        yield DataFault(
            "velocity-scale",
            "warning",
            joint,
            f"qd{k + 1} is {factor:.4g} times the derivative of q{k + 1}"
            f"{guess[0] if guess else ''}; scale one of them in a map",
        )


def _signs(r: Recording) -> Iterator[DataFault]:
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
            yield DataFault(
                "sign",
                "warning",
                name,
                f"tauext{k + 1} acts with the motor's resistance instead of against it: it should "
                "be the effort ON the robot; change its sign in a map",
            )
        alone = r.wrench is None and r.tau_ext is None
        if backward and ((alone and b.work < -0.3 and total < -0.3) or (known and b.external > 0)):
            yield DataFault(
                "sign",
                "warning",
                name,
                f"tau{k + 1} only takes energy out of the motion (net work {100 * b.work:.0f} %) "
                "and inertia and friction come out negative: change the sign of the effort or the "
                "position in a map, unless someone moved the joint by hand",
            )


FloatArray = NDArray[np.float64]

#: Warnings under which all values of a fit may be in a wrong unit or of a wrong sign.
OF_UNITS = frozenset(
    (
        "unit",
        "limits",
        "velocity-limit",
        "effort-limit",
        "effort-scale",
        "velocity-scale",
        "velocity-sign",
        "sign",
    )
)
#: Code of a speed somewhat beyond a limit.
NOMINAL_SPEED = "nominal-speed"
#: Below these rates [Hz] an identification is doubtful, or hopeless (with room for stamps of a
#: nominal 10 Hz: slow motion of a large robot, as benchmarks are thinned out to).
SLOW_HZ, HOPELESS_HZ = 100.0, 9.7
#: Share of a rate that counts as that rate: stamps that stray, and rows that are missing, tell one
#: of nominal 100 Hz a little lower.
_AS_GOOD_AS = 0.95
#: Samples that a motion must last to be resolved.
RESOLVED = 10
#: Above it [Hz] the time is in another unit: filters and grids would take any memory.
FASTEST_HZ = 1e6
#: A run from which alone no effect is named (`hil.diagnosis.preconditions`) [s], and no fit made.
SHORT_S, HOPELESS_SAMPLES = 4.0, 20
_GAP, _LOST, _JITTER = 3.0, 1.5, 0.5
#: No measured quantity reaches this in any unit; NaN and infinity do not pass it either.
_ABSURD = 1e50

__all__ = ["OF_UNITS", "DataFault", "check", "column_unit", "columns", "joint_units"]


@np.errstate(all="ignore")  # sums of values near the absurd are infinite, and no finding
def check(recording: Recording) -> list[DataFault]:
    """Find the faults of a recording.

    Parameters
    ----------
    recording : Recording
        One run of one arm.

    Returns
    -------
    list of DataFault
        Errors first; empty if nothing is wrong.  Never raises for bad data.
    """
    found = [*_values(recording)]
    if not found and np.all(np.diff(recording.t) >= 0):
        t, burst = physics.arrivals(recording)
        if burst:
            found.append(_queued(recording, t, burst))
            recording = replace(recording, t=t)
    found += _time(recording)
    if not any(f.severity == "error" for f in found):
        found += [*_frozen(recording), *_doubled(recording), *check_motion(recording)]
    return sorted(found, key=lambda f: f.severity)


def columns(recording: Recording) -> Iterator[tuple[str, str, FloatArray]]:
    """Every column of a recording: its table name (``tau2``), its joint or ``""``, its values."""
    for key, stem in _STEMS.items():
        values = getattr(recording, key)
        for k in range(0 if values is None else values.shape[1]):
            yield f"{stem}{k + 1}", recording.joints[k], values[:, k]
    if recording.wrench is not None:
        for k, name in enumerate(("fx", "fy", "fz", "tx", "ty", "tz")):
            yield name, "", recording.wrench[:, k]


def joint_units(recording: Recording) -> tuple[str, ...]:
    """Unit of each joint, ``"rad"`` or ``"m"``: of the URDF, else what the recording says."""
    listed = described_joints(recording)
    if listed:
        return tuple(j.unit for j in listed)
    return recording.units


def column_unit(column: str, axis: str) -> str:
    """SI unit of a column by its table name, of a joint in ``"rad"`` or ``"m"``."""
    effort = "N" if axis == "m" or column[0] == "f" else "N m"
    units = {"q": axis, "qd": f"{axis}/s", "i": "A", "temp": "degC"}
    return units.get(column.rstrip("0123456789"), effort)


_STEMS = {
    "q": "q",
    "qd": "qd",
    "tau": "tau",
    "tau_ext": "tauext",
    "current": "i",
    "temperature": "temp",
}


def _values(r: Recording) -> Iterator[DataFault]:
    for name, joint, values in [("t", "", r.t), *columns(r)]:
        bad = np.flatnonzero(~(np.abs(values) < _ABSURD))
        if bad.size:
            yield DataFault(
                "not-finite",
                "error",
                joint,
                f"{name}: {bad.size} of {r.n} values are NaN, infinite or absurd, first at sample "
                f"{bad[0]}; cut or repair them before importing",
            )


def _time(r: Recording) -> Iterator[DataFault]:
    t = r.t[np.isfinite(r.t)]
    if t.size < HOPELESS_SAMPLES:
        yield DataFault(
            "too-short", "error", "", f"{r.n} samples; at least {HOPELESS_SAMPLES} are needed"
        )
        return
    dt = np.diff(t)
    period = float(np.median(dt))
    back, same = np.flatnonzero(dt < 0), np.flatnonzero(dt == 0)
    if back.size:
        yield DataFault(
            "time-backward",
            "error",
            "",
            f"time runs backward {back.size} times, first after {t[back[0]]:.6g} s; "
            "sort the rows or import each run by itself",
        )
    if same.size:
        yield DataFault(
            "time-repeated",
            "error" if period <= 0 else "warning",
            "",
            f"{same.size} repeated time stamps, first at {t[same[0]]:.6g} s; "
            "rows that repeat all values, too, are left out of an analysis",
        )
    if period > 0:
        yield from _rate(t, dt[dt > 0], period)


def _queued(r: Recording, t: FloatArray, burst: int) -> DataFault:
    """Stamps of a queue, and the clock behind it."""
    late = float(np.max(r.t - t))
    return DataFault(
        "irregular-time",
        "warning",
        "",
        f"up to {burst} rows come at once, as from a queue: their stamps say when they arrived, up "
        f"to {late * 1e3:.3g} ms later than the least late ones. An analysis takes them as evenly "
        f"spaced, {1 / np.median(np.diff(t)):.6g} Hz; to have more, log the time of measurement",
    )


def _rate(t: FloatArray, dt: FloatArray, period: float) -> Iterator[DataFault]:
    rate, gaps = 1 / period, dt > _GAP * period
    if rate > FASTEST_HZ:
        yield DataFault(
            "sample-rate",
            "error",
            "",
            f"the time advances by {period:.4g} s a sample; no rig samples faster than "
            f"{FASTEST_HZ:g} Hz. Scale the time to seconds in a map when importing",
        )
    if rate < _AS_GOOD_AS * SLOW_HZ:
        severity = "error" if rate < HOPELESS_HZ else "warning"
        hint = "; is the time in milliseconds? Scale it by 0.001 in a map"
        text = (
            f"{rate:.4g} Hz is slow for dynamics: what lasts less than {RESOLVED / rate:.2g} s is "
            f"hardly resolved, and may look like an effect. Record at {SLOW_HZ:.0f} Hz or more"
        )
        text += hint if severity == "error" else ""
        yield DataFault("sample-rate", severity, "", text)
    low, high = np.quantile(dt[~gaps], (0.05, 0.95)) if not gaps.all() else (period, period)
    uneven = high - low > _JITTER * period
    if t[-1] - t[0] < SHORT_S:
        text = (
            f"{t[-1] - t[0]:.3g} s of data: parameters will be uncertain, and no effect is named "
            f"from less than {SHORT_S:g} s; record longer, or give several runs together"
        )
        yield DataFault("too-short", "warning", "", text)
    if gaps.any():
        # of even rows, a step of one row and a half is a lost row, too
        lost = np.diff(t) > (_GAP if uneven else _LOST) * period
        first = t[np.flatnonzero(lost)[0]]
        yield DataFault(
            "gap",
            "warning",
            "",
            f"{plural(int(lost.sum()), 'gap')}, the longest {dt.max():.3g} s, the first after "
            f"{first:.6g} s; an analysis bridges short ones and splits the run at long ones: "
            "nothing is differentiated across them",
        )
    if uneven:
        yield DataFault(
            "irregular-time",
            "warning",
            "",
            f"period varies from {low * 1e3:.4g} to {high * 1e3:.4g} ms (5 to 95 %); "
            "an analysis resamples where the positions follow the stamps",
        )


#: Code of the warning that a joint has no effort.
SILENT = "silent-joint"


#: Share of a joint's range by which another one moves differently.
APART = 0.1


def _doubled(r: Recording) -> Iterator[DataFault]:
    """Efforts of two joints that are equal in every row, though the joints move differently.

    Two drives of one axis may have the same command; those move alike.
    """
    moves = np.ptp(r.tau, axis=0) > 0
    for a, b in combinations(np.flatnonzero(moves).tolist(), 2):
        if not np.array_equal(r.tau[:, a], r.tau[:, b]):
            continue
        if np.ptp(r.q[:, a] - r.q[:, b]) > APART * max(np.ptp(r.q[:, a]), np.ptp(r.q[:, b])):
            text = (
                f"tau{b + 1} ({r.joints[b]}) holds the values of tau{a + 1} ({r.joints[a]}) in "
                "every row: one channel was recorded twice. Name the right column in a map, or "
                "leave the joint out"
            )
            yield DataFault("doubled", "error", r.joints[b], text)


def _frozen(r: Recording) -> Iterator[DataFault]:
    still = np.ptp(r.q, axis=0) == 0
    idle = np.ptp(r.tau, axis=0) == 0
    if still.all() and idle.all():
        text = "no position and no effort changes in the whole recording: the sensors were stuck"
        yield DataFault("stuck", "error", "", text)
        return
    if idle.all() and not np.any(r.tau) and r.wrench is None and r.tau_ext is None:
        text = (
            "no effort is recorded: every tau is zero, and there is no measured force; "
            "name the effort columns in a map"
        )
        yield DataFault("no-effort", "error", "", text)
        return
    span = np.ptp(r.tau, axis=0)
    for k, joint in enumerate(r.joints):
        if still[k] and not idle[k] and (still.all() or span[k] > 0.8 * float(np.max(span))):
            text = (
                f"q{k + 1} never changes while tau{k + 1} varies by {span[k]:.3g}; "
                "is the joint locked, or its encoder dead?"
            )
            yield DataFault("stuck", "warning", joint, text)
        if idle[k] and not still[k] and (r.tau[0, k] != 0 or not idle.all()):
            text = (
                f"tau{k + 1} never changes while q{k + 1} moves: nothing is fitted to {joint}. "
                "Is the channel dead? A joint without a motor has no effort"
            )
            yield DataFault(SILENT, "warning", joint, text)
