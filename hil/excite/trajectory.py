"""A periodic joint motion, a path through via points plus a Fourier series; and its limits.

Its file is TOML of schema ``hil.trajectory/1``; reading checks everything.  For a rig that is not
run by this package it is written as a table: t, q, qd, qdd, SI, a header line.

It begins and ends at rest:  r(t) = q0 + s(t) (q(t) - q0),  s from 0 to 1 by

    s = 10 u^3 - 15 u^4 + 6 u^5,

u the share of the lead-in that has passed, and back again behind the last period; between them the
motion is played as it was planned.

Its margins to the limits of a robot are checked before it is played.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.models.robots import Robot
from hil.record.recording import RobotSource
from hil.record.urdf_checks import urdf_joints
from hil.userfile import parse_toml, read_text, write_text

FloatArray = NDArray[np.float64]
INF = float("inf")


@dataclass(frozen=True)
class Trajectory:
    """Motion of d joints that repeats after `period`.

    q(t) = path(t) + sum_k S_k sin(k w t) + C_k cos(k w t),  w = 2 pi / period.

    Parameters
    ----------
    joints, units : tuple of str
        Names and ``"rad"`` or ``"m"``, length d.
    period : float
        [s]
    times : ndarray (m,)
        Of the via points, from 0 to the period [s].
    via : ndarray (m, d)
        Positions there; the last is the first [rad or m].
    blend : ndarray (m,)
        Time over which the speed changes around each via point [s].
    series : ndarray (d, h, 2)
        Factors of sin(k w t) and cos(k w t), k = 1..h [rad or m].
    name : str
        Of the motion.
    purpose : tuple of str
        Effects that it is for.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    period: float
    times: FloatArray
    via: FloatArray
    blend: FloatArray
    series: FloatArray
    name: str = "motion"
    purpose: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        for text in _faults(self):
            raise ConfigError(text)

    @property
    def d(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def shrunk(self, factor: float, center: FloatArray) -> Trajectory:
        """The same motion, smaller by `factor` about a posture (d,)."""
        return replace(self, via=center + factor * (self.via - center), series=factor * self.series)


def sample(x: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, speed and acceleration (n, d) at times t (n,) [s]."""
    t = np.mod(t, x.period)
    q, qd, qdd = _path(x, t)
    for total, part in zip((q, qd, qdd), _series(x, t), strict=True):
        total += part
    return q, qd, qdd


def _series(x: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fourier series and its two derivatives (n, d); by FFT on a grid over one period."""
    w, h = 2 * np.pi / x.period, x.series.shape[1]
    if h == 0:
        none = np.zeros((t.size, x.d))
        return none, none, none
    k = np.arange(1, h + 1)
    even = t.size > 2 * h and np.allclose(t, np.arange(t.size) * (x.period / t.size), atol=1e-9)
    if even:
        spectrum = np.zeros((3, t.size // 2 + 1, x.d), dtype=np.complex128)
        part = (x.series[..., 1] - 1j * x.series[..., 0]).T * (t.size / 2)
        for order in range(3):
            spectrum[order, 1 : h + 1] = part * (1j * w * k[:, None]) ** order
        out = np.asarray(np.fft.irfft(spectrum, n=t.size, axis=1), dtype=np.float64)
        return out[0], out[1], out[2]
    angle = w * np.outer(t, k)
    s, c = np.sin(angle), np.cos(angle)
    a, b, kw = x.series[..., 0].T, x.series[..., 1].T, w * k[:, None]
    return s @ a + c @ b, c @ (kw * a) - s @ (kw * b), -s @ (kw**2 * a) - c @ (kw**2 * b)


def _path(x: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Straight lines through the via points, each corner rounded over its blend time.

    A corner where the speed changes by dv adds dv r(t - tk), with u = (t - tk) / b + 1/2:
    r'' = (1 - cos 2 pi u) / b,  r' = u - sin(2 pi u) / 2 pi,
    r = b (u^2 / 2 - (1 - cos 2 pi u) / 4 pi^2)  for 0 < u < 1.
    """
    slope = np.diff(x.via, axis=0) / np.diff(x.times)[:, None]
    piece = np.clip(np.searchsorted(x.times, t, side="right") - 1, 0, len(slope) - 1)
    q = x.via[piece] + (t - x.times[piece])[:, None] * slope[piece]
    qd, qdd = slope[piece].copy(), np.zeros_like(q)
    before = np.concatenate([slope[-1:], slope])
    after = np.concatenate([slope, slope[:1]])
    ordered = bool(np.all(np.diff(t) >= 0))
    for k, (tk, b) in enumerate(zip(x.times, x.blend, strict=True)):
        low, high = np.searchsorted(t, [tk - b / 2, tk + b / 2]) if ordered else (0, t.size)
        part = t[low:high] - tk
        u = part / b + 0.5
        inside = (u > 0) & (u < 1)
        dv = (after[k] - before[k]) * inside[:, None]
        turn = 2 * np.pi * u
        # what the sharp corner max(0, t - tk) has already
        sharp = np.maximum(part, 0.0)
        r = b * (u**2 / 2 - (1 - np.cos(turn)) / (4 * np.pi**2)) - sharp
        q[low:high] += dv * r[:, None]
        qd[low:high] += dv * (u - np.sin(turn) / (2 * np.pi) - (part >= 0))[:, None]
        qdd[low:high] += dv * ((1 - np.cos(turn)) / b)[:, None]
    return q, qd, qdd


def period_times(x: Trajectory, rate: float) -> FloatArray:
    """Times over one period at about `rate` [s]."""
    n = max(2, round(x.period * rate))
    out: FloatArray = np.arange(n, dtype=np.float64) * (x.period / n)
    return out


def _faults(x: Trajectory) -> list[str]:
    """What is wrong with a trajectory, one sentence each; empty if nothing is."""
    d, m = len(x.joints), x.times.size
    if d == 0 or len(x.units) != d or any(u not in ("rad", "m") for u in x.units):
        return ["joints and units need one entry a joint, units 'rad' or 'm'"]
    if not 0.01 <= x.period <= 3600:
        return [f"period = {x.period:g} s; 0.01 to 3600 s is needed"]
    if m < 2 or x.via.shape != (m, d) or x.blend.shape != (m,):
        return [f"path: t, blend and q need as many entries, two at least, q {d} in each"]
    if x.series.ndim != 3 or x.series.shape[0] != d or x.series.shape[2] != 2:
        return [f"fourier: sin and cos need {d} rows, one a joint, all of one length"]
    arrays = (x.times, x.via, x.blend, x.series)
    if not all(np.all(np.isfinite(a)) for a in arrays):
        return ["a number of the trajectory is not finite"]
    gaps = np.diff(x.times)
    if x.times[0] != 0 or abs(x.times[-1] - x.period) > 1e-9 * x.period or np.any(gaps <= 0):
        return ["path: t must increase from 0 to the period"]
    if np.any(np.abs(x.via[-1] - x.via[0]) > 1e-9):
        return ["path: the last point must be the first one, for the motion repeats"]
    return _blends(x, gaps)


def _blends(x: Trajectory, gaps: FloatArray) -> list[str]:
    half = x.blend / 2
    if np.any(x.blend <= 0) or np.any(half[:-1] + half[1:] > gaps * (1 + 1e-9)):
        return ["path: each blend must be positive, and two neighbours end before they meet"]
    if x.blend[0] != x.blend[-1]:
        return ["path: the first and the last blend are of one corner and must agree"]
    return []


_SCHEMA = "hil.trajectory/1"
_KEYS = ("schema", "name", "for", "joints", "units", "period", "path", "fourier")


def is_trajectory(path: Path) -> bool:
    """Whether a file is a trajectory file, or empty."""
    try:
        text = read_text(path)
        return not text.strip() or str(parse_toml(text).get("schema")).startswith("hil.trajectory/")
    except (OSError, ValueError):
        return False


def read_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory file.

    Raises
    ------
    ConfigError
        If it is missing, of another kind, or wrong.
    """
    try:
        table = parse_toml(read_text(path))
    except FileNotFoundError:
        raise ConfigError(f"trajectory {path}: no such file") from None
    except (OSError, ValueError) as error:
        raise ConfigError(f"trajectory {path} is not a readable TOML file: {error}") from error
    if table.get("schema") != _SCHEMA:
        raise ConfigError(
            f"trajectory {path} is no trajectory file: its schema is {table.get('schema')!r}, "
            f"{_SCHEMA!r} is needed; 'hil excite' writes one"
        )
    try:
        return _parse(table)
    except ConfigError as error:
        raise ConfigError(f"trajectory {path}: {error}") from error


def _parse(table: Mapping[str, Any]) -> Trajectory:
    _only(table, _KEYS)
    path, fourier = _table(table, "path"), _table(table, "fourier")
    _only(path, ("t", "blend", "q"))
    _only(fourier, ("sin", "cos"))
    joints = _names(table, "joints", ())
    units = _names(table, "units", ("rad",) * len(joints))
    period = float(_array(table, "period", 0))
    series = [_array(fourier, k, 2) if k in fourier else None for k in ("sin", "cos")]
    shapes = {s.shape for s in series if s is not None}
    if len(shapes) > 1:
        raise ConfigError("fourier: sin and cos must have the same shape")
    shape = shapes.pop() if shapes else (len(joints), 0)
    parts = [np.zeros(shape) if s is None else s for s in series]
    return Trajectory(
        joints,
        units,
        period,
        _array(path, "t", 1),
        _array(path, "q", 2),
        _array(path, "blend", 1),
        np.stack(parts, axis=-1),
        str(table.get("name", "motion")),
        _names(table, "for", ()),
    )


def _only(table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            raise ConfigError(unknown("key", key, known))


def _table(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, Mapping):
        raise ConfigError(f"{key} must be a table, not {value!r}")
    return value


def _names(table: Mapping[str, Any], key: str, default: tuple[str, ...]) -> tuple[str, ...]:
    value = table.get(key, list(default))
    if not isinstance(value, list) or not all(isinstance(x, str) for x in value):
        raise ConfigError(f"{key} must be a list of words, not {value!r}")
    return tuple(value)


def _array(table: Mapping[str, Any], key: str, ndim: int) -> FloatArray:
    """Numbers under `key` as an array of `ndim` dimensions."""
    if key not in table:
        raise ConfigError(f"the key {key!r} is missing")
    try:
        out = np.asarray(table[key], dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"{key} must hold numbers, all rows of one length") from None
    if out.ndim != ndim or _mixed(table[key]):
        raise ConfigError(f"{key} must be {('a number', 'a list', 'a list of rows')[ndim]}")
    return out


def _mixed(value: object) -> bool:
    """Whether anything in nested lists is not a number (a word that reads as one, a truth)."""
    if isinstance(value, list):
        return any(_mixed(x) for x in value)
    return isinstance(value, bool) or not isinstance(value, int | float)


def text(x: Trajectory, note: str = "") -> str:
    """TOML text of a trajectory."""
    lines = [f"# {line}" for line in note.splitlines()]
    words = {
        "schema": _SCHEMA,
        "name": x.name,
        "for": list(x.purpose),
        "joints": list(x.joints),
        "units": list(x.units),
        "period": x.period,
    }
    lines += [f"{k} = {json.dumps(v)}" for k, v in words.items()]
    lines += ["", "[path] # straight lines through q [rad or m] at t [s], corners rounded"]
    lines += [f"t = {_row(x.times)}", f"blend = {_row(x.blend)}", f"q = {_rows(x.via)}"]
    if x.series.shape[1]:
        lines += ["", "[fourier] # rows: joints; columns: multiples of 1 / period"]
        lines += [f"sin = {_rows(x.series[..., 0])}", f"cos = {_rows(x.series[..., 1])}"]
    return "\n".join([*lines, ""])


def _row(values: FloatArray) -> str:
    return "[" + ", ".join(repr(float(f"{v:.12g}")) for v in values) + "]"


def _rows(values: FloatArray) -> str:
    return "[\n" + "".join(f"  {_row(v)},\n" for v in values) + "]"


def write_trajectory(x: Trajectory, path: str | Path, note: str = "") -> None:
    """Write a trajectory file."""
    write_text(path, text(x, note))


#: Lengths of the lead-in that are tried [s].
LEADS = (2.0, 4.0, 8.0, 16.0, 32.0)


@dataclass(frozen=True)
class Played:
    """Samples of a motion from rest to rest.

    Parameters
    ----------
    t : ndarray (n,)
        From 0 [s].
    q, qd, qdd : ndarray (n, d)
        Position, speed, acceleration [rad or m, per s, per s^2].
    lead : float
        Length of the lead-in, and of the way back to rest [s].
    rounds : int
        Whole periods between them.
    """

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    lead: float
    rounds: int


def played_back(x: Trajectory, seconds: float, rate: float, speed: FloatArray) -> Played:
    """As many whole periods as `seconds` hold, one at least, from rest to rest.

    Parameters
    ----------
    x : Trajectory
        The motion.
    seconds : float
        Wanted length without lead-in [s].
    rate : float
        Rows a second [Hz].
    speed : ndarray (d,)
        Limits that the lead-in keeps to as well [rad/s or m/s].
    """
    for lead in LEADS:
        out = _from_rest(x, rounds(x.period, seconds), lead, rate)
        if np.all(np.abs(out.qd) <= speed):
            break
    return out


def rounds(period: float, seconds: float) -> int:
    """Whole periods [s] that so many seconds hold, one at least."""
    return max(1, int(seconds / period + 1e-9))


def _from_rest(x: Trajectory, times: int, lead: float, rate: float) -> Played:
    whole = times * x.period + 2 * lead
    t = np.arange(int(whole * rate + 1e-6) + 1) / rate
    q, qd, qdd = sample(x, t - lead)
    at = sample(x, np.zeros(1))[0]
    up, down = np.clip(t / lead, 0.0, 1.0), np.clip((whole - t) / lead, 0.0, 1.0)
    u, sign = np.minimum(up, down)[:, None], np.where(up < down, 1.0, -1.0)[:, None] / lead
    s = u**3 * (10 - 15 * u + 6 * u**2)
    ds = 30 * u**2 * (1 - u) ** 2 * sign
    dds = 60 * u * (1 - u) * (1 - 2 * u) / lead**2
    # r = q0 + s (q - q0) and its derivatives
    return Played(
        t,
        at + s * (q - at),
        ds * (q - at) + s * qd,
        dds * (q - at) + 2 * ds * qd + s * qdd,
        lead,
        times,
    )


def header(d: int) -> list[str]:
    """Names of the columns for d joints."""
    return ["t", *(f"{kind}{j + 1}" for kind in ("q", "qd", "qdd") for j in range(d))]


def write_csv(p: Played, path: str | Path) -> None:
    """Write the table."""
    rows = np.column_stack([p.t, p.q, p.qd, p.qdd])
    names = ",".join(header(p.q.shape[1]))
    with open(path, "w", encoding="utf-8", newline="") as file:
        np.savetxt(file, rows, fmt="%.9g", delimiter=",", header=names, comments="")


def is_table(path: Path) -> bool:
    """Whether a file is such a table, or empty: never a recording, which has efforts."""
    try:
        with path.open(encoding="utf-8") as file:
            names = file.readline().strip().split(",")
    except (OSError, ValueError):
        return False
    return names == [""] or names == header((len(names) - 1) // 3)


@runtime_checkable
class HasTip(Protocol):
    """A robot that knows where its tip is."""

    def tip(self, q: FloatArray) -> FloatArray:
        """Tip position (n, 3) [m]."""
        ...


@dataclass(frozen=True)
class Limits:
    """What a motion of d joints must keep to.

    Parameters
    ----------
    low, high : ndarray (d,)
        Positions [rad or m].
    speed, torque : ndarray (d,)
        Largest magnitudes [rad/s or m/s], [N m or N]; infinite where none is known.
    center : ndarray (d,)
        A safe posture in the middle.
    folds : tuple of (int, int, float, float)
        Joints i, k and the range of q_i - q_k that the mechanism allows.
    box : ndarray (2, 3) or None
        Lowest and highest tip coordinates in the base frame [m].
    source : str
        Where they come from.
    unstated : tuple of (str, int)
        ``"position"`` or ``"speed"``, and the joint of which the robot does not state it.
    """

    low: FloatArray
    high: FloatArray
    speed: FloatArray
    torque: FloatArray
    center: FloatArray
    folds: tuple[tuple[int, int, float, float], ...] = ()
    box: FloatArray | None = None
    source: str = ""
    unstated: tuple[tuple[str, int], ...] = ()


#: Premium 1.5: th1 +-90, th2 -124..119, th3 -29..214, th2 - th3 -55..65 degrees (Cavusoglu et
#: al. 2002), less 1 degree; the workspace of the data sheet (191 x 381 x 267 mm) about the tip at
#: the posture (0, 0.4, 0.3); speed that the drives track and torque of the rig's default.
_PREMIUM = Limits(
    np.radians([-89.0, -123.0, -28.0]),
    np.radians([89.0, 118.0, 213.0]),
    np.full(3, 3.0),
    np.full(3, 0.8),
    np.array([0.0, 0.4, 0.3]),
    ((1, 2, -0.95, 1.13),),
    np.array([[0.152, -0.190, -0.212], [0.344, 0.190, 0.055]]),
    "PHANTOM Premium 1.5",
)
#: Omni: workspace 160 x 120 x 70 mm of the data sheet within 1.8 rad/s, centred likewise.
_OMNI = Limits(
    np.radians([-45.0, 0.0, -20.0]),
    np.radians([45.0, 90.0, 60.0]),
    np.full(3, 1.8),
    np.full(3, 0.3),
    np.array([0.0, 0.6, 0.3]),
    source="PHANTOM Omni",
)
_PRESETS = {"phantom-premium-1.5": _PREMIUM, "phantom-omni": _OMNI}
#: Range to either side of 0 [rad or m] and speed [rad/s or m/s] of a joint whose URDF states none.
UNSTATED_RANGE, UNSTATED_SPEED = np.pi / 2, 1.0


def of_robot(source: RobotSource) -> Limits | None:
    """Limits that come with a robot; None where it brings none (independent axes)."""
    return _of_urdf(source.urdf) if source.urdf else _PRESETS.get(source.preset)


def _of_urdf(text: str) -> Limits:
    """Limits of a URDF, and what is assumed where it states none; see `Assumed`."""
    joints = urdf_joints(text)
    low = np.array([j.lower if math.isfinite(j.lower) else -UNSTATED_RANGE for j in joints])
    high = np.array([j.upper if math.isfinite(j.upper) else UNSTATED_RANGE for j in joints])
    speed = np.array([j.velocity if math.isfinite(j.velocity) else UNSTATED_SPEED for j in joints])
    torque = np.array([j.effort for j in joints])
    none = [not (math.isfinite(j.lower) and math.isfinite(j.upper)) for j in joints]
    unstated = tuple(
        (what, k)
        for k, j in enumerate(joints)
        for what, lacks in (("position", none[k]), ("speed", math.isinf(j.velocity)))
        if lacks
    )
    return Limits(low, high, speed, torque, (low + high) / 2, source="the URDF", unstated=unstated)


@dataclass(frozen=True)
class Assumed:
    """A limit that nobody stated, and what stands for it.

    Parameters
    ----------
    what : str
        E.g. ``"speed joint2"``, as in `Margin`.
    values : tuple of float
        Lowest and highest position, or the largest speed.
    unit : str
        SI unit.
    """

    what: str
    values: tuple[float, ...]
    unit: str


def assumed(limits: Limits, robot: Robot) -> list[Assumed]:
    """What is assumed: limits that the robot does not state, and that no rig file has set."""
    out = []
    for what, j in limits.unstated:
        name, unit = robot.joints[j], robot.units[j]
        ends = float(limits.low[j]), float(limits.high[j])
        if what == "position" and UNSTATED_RANGE in (-ends[0], ends[1]):
            out.append(Assumed(f"position {name}", ends, unit))
        if what == "speed" and limits.speed[j] == UNSTATED_SPEED:
            out.append(Assumed(f"speed {name}", (UNSTATED_SPEED,), f"{unit}/s"))
    return out


def of_data(q: FloatArray, qd: FloatArray, tau: FloatArray) -> Limits:
    """What a recording itself shows to be safe: its range, twice its speed, twice its effort."""
    low, high = q.min(axis=0), q.max(axis=0)
    speed, torque = 2 * np.abs(qd).max(axis=0), 2 * np.abs(tau).max(axis=0)
    return Limits(low, high, speed, torque, (low + high) / 2, source="the recording")


def places(limits: Limits, robot: Robot, q: FloatArray) -> dict[str, FloatArray]:
    """Distance of each posture (n, d) to every position limit: positive inside, (n,) each."""
    out: dict[str, FloatArray] = {}
    for j, name in enumerate(robot.joints):
        out[f"position {name}"] = np.minimum(q[:, j] - limits.low[j], limits.high[j] - q[:, j])
    for i, k, low, high in limits.folds:
        fold = q[:, i] - q[:, k]
        name = f"fold {robot.joints[i]} - {robot.joints[k]}"
        out[name] = np.minimum(fold - low, high - fold)
    if limits.box is not None and isinstance(robot, HasTip):
        p = robot.tip(q)
        for axis, name in enumerate("xyz"):
            inside = np.minimum(p[:, axis] - limits.box[0, axis], limits.box[1, axis] - p[:, axis])
            out[f"workspace {name}"] = inside
    return out


def allowed(limits: Limits, robot: Robot, q: FloatArray) -> NDArray[np.bool_]:
    """Whether postures (n, d) keep to every position limit."""
    return np.asarray(np.min(list(places(limits, robot, q).values()), axis=0) >= -1e-9)


#: Share of the speed and torque limits that a planned motion may use.
HEADROOM = 0.8
#: A motion is looked at this often [Hz].
CHECK_RATE = 250.0


@dataclass(frozen=True)
class Margin:
    """Distance to one limit.

    Parameters
    ----------
    what : str
        E.g. ``"speed joint2"``.
    used, limit : float
        Largest magnitude and limit; for positions the smallest distance and zero.
    unit : str
        SI unit.
    """

    what: str
    used: float
    limit: float
    unit: str

    @property
    def broken(self) -> bool:
        """Whether the limit is passed."""
        if self.what.startswith(("speed", "torque")):
            return self.used > self.limit * (1 + 1e-9)
        return self.used < -1e-9


def exceeds(m: Margin) -> bool:
    """Whether a planned motion passes a limit, or its share of speed and torque."""
    planned = m.what.startswith(("speed", "torque"))
    return m.used > HEADROOM * m.limit * (1 + 1e-6) if planned else m.broken


def motion_margins(x: Trajectory, limits: Limits, robot: Robot) -> list[Margin]:
    """Margins of a motion to each limit of position and speed; `torques` has the others.

    Parameters
    ----------
    x : Trajectory
        The motion.
    limits : Limits
        The limits.
    robot : Robot
        Geometry and units.
    """
    q, qd, _ = sample(x, period_times(x, CHECK_RATE))
    units = dict(zip(robot.joints, robot.units, strict=True))
    out = [
        Margin(
            name,
            float(np.min(d)),
            0.0,
            "m" if name.startswith("work") else units.get(name.split()[1], "rad"),
        )
        for name, d in places(limits, robot, q).items()
    ]
    for j, (name, unit) in enumerate(units.items()):
        speed = float(np.max(np.abs(qd[:, j])))
        out.append(Margin(f"speed {name}", speed, float(limits.speed[j]), f"{unit}/s"))
    return out


def torques(limits: Limits, robot: Robot, effort: FloatArray) -> list[Margin]:
    """Margins of predicted efforts (n, d) [N m or N] to each torque limit."""
    out = []
    for j, (name, unit) in enumerate(zip(robot.joints, robot.units, strict=True)):
        peak = float(np.max(np.abs(effort[:, j])))
        torque = float(limits.torque[j])
        out.append(Margin(f"torque {name}", peak, torque, "N" if unit == "m" else "N m"))
    return out


def check_fits_arm(x: Trajectory, limits: Limits, robot: Robot, rate: float) -> None:
    """Refuse a motion that does not fit the arm that is to play it.

    Raises
    ------
    ConfigError
        For other joints, a limit that is passed, or a motion too quick for the loop's rate.
    """
    if x.joints != robot.joints:
        raise ConfigError(
            f"trajectory {x.name!r} moves {', '.join(x.joints)}, the arm has "
            f"{', '.join(robot.joints)}; make one for this arm with 'hil excite'"
        )
    quick = min(float(np.min(x.blend)), x.period / max(x.series.shape[1], 1) / 2)
    if quick * rate < 10:
        raise ConfigError(
            f"trajectory {x.name!r} changes within {1e3 * quick:.3g} ms; at {rate:g} Hz at least "
            f"{1e4 / rate:.3g} ms are needed"
        )
    broken = [m for m in motion_margins(x, limits, robot) if m.broken]
    if broken:
        m = broken[0]
        text = (
            f"{m.used:.3g} {m.unit} against {m.limit:.3g}"
            if m.limit
            else f"{-m.used:.3g} {m.unit} beyond the limit"
        )
        raise ConfigError(
            f"trajectory {x.name!r} leaves the limits of {limits.source or 'the arm'}: {m.what} is "
            f"{text}; nothing was moved"
        )
