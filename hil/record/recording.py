"""A recording in memory: what every analysis reads, whatever wrote it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError
from hil.record.jumps import TURN, Jumps, jumps, wraps
from hil.shown import Shown

FloatArray = NDArray[np.float64]


#: Share of a typical step below which the next row came at once, and share of such rows from which
#: stamps are those of a queue.  Half: queues read within a tenth of a period are missed; double:
#: rows that stray by half a period count as queued.
AT_ONCE = 0.1
#: Longest step [s] by which the rows of a queue are told: what is longer is a pause.  Half: queues
#: that are emptied once a second are missed; double: nothing but pauses in a run that has many.
EMPTIED_S = 1.0
#: Typical steps of a queue from which a step is a pause.  Half: queues of all lengths lose their
#: longest steps; double: short pauses lengthen the period.
PAUSE = 3.0


def queue(dt: FloatArray) -> tuple[float, NDArray[np.bool_]]:
    """Typical step [s] between rows that were stamped as they were taken from a queue.

    Half of the time passes in shorter steps.  Zero where the stamps are others.

    Parameters
    ----------
    dt : ndarray (n,)
        From one stamp to the next [s].

    Returns
    -------
    typical : float
        The step.
    at_once : ndarray (n,) of bool
        Where the next row came at once.
    """
    short = np.sort(dt[dt <= EMPTIED_S])
    if short.size < 50 or not short[-1] > 0:
        return 0.0, np.zeros(dt.size, dtype=np.bool_)
    half = int(np.searchsorted(np.cumsum(short), np.sum(short) / 2))
    typical = float(short[min(half, short.size - 1)])
    at_once = dt < AT_ONCE * typical
    return (typical if np.mean(at_once) >= AT_ONCE else 0.0), at_once


def spacing(t: FloatArray, place: NDArray[np.intp], typical: float) -> float:
    """Slope of stamps from a queue over their places, one for all stretches between pauses."""
    stretch = np.cumsum(np.append(False, np.diff(t) > PAUSE * typical)).astype(np.intp)
    middle = np.bincount(stretch, place) / np.bincount(stretch)
    k = place - middle[stretch]
    return float(np.sum(k * t) / np.sum(k * k))


def usual_step(dt: FloatArray) -> float:
    """Median step between stamps [s]; of rows from a queue the mean one, without pauses."""
    typical, _ = queue(dt)
    if not typical:
        return float(np.median(dt))
    return spacing(np.cumsum(np.append(0.0, dt)), np.arange(dt.size + 1), typical)


def tag_record(tags: Sequence[str]) -> dict[str, str]:
    """Metadata record of tags, in the order of the alphabet, each once.

    Raises
    ------
    ConfigError
        If one is empty or holds a comma.
    """
    for tag in tags:
        if not tag.strip() or "," in tag or len(tag) > 100:
            raise ConfigError(f"tag {tag!r}: a word or a few are needed, without a comma")
    return {TAGS: ",".join(sorted({tag.strip() for tag in tags}))}


def tags_of(record: Mapping[str, str]) -> tuple[str, ...]:
    """Tags of a metadata record."""
    return tuple(t for t in record.get(TAGS, "").split(",") if t)


@dataclass(frozen=True)
class RobotSource:
    """Which robot a recording is of: URDF text or the name of a preset.

    Parameters
    ----------
    preset : str
        Name of a built-in robot (``"single-axis"``, ``"phantom-premium-1.5"``, ...) or ``""``.
    urdf : str
        URDF text, or ``""``.
    tip : str
        Frame at which the external force acts; ``""`` = the frame named ``tip``, or the last.
    """

    preset: str = "single-axis"
    urdf: str = ""
    tip: str = ""


#: Robots that need no URDF; `hil.models.robots` builds them.
PRESETS = ("single-axis", "phantom-premium-1.5", "phantom-omni")
#: Key of a recording's metadata: the ROS bag that it was read from.
BAG = "bag"
#: Key of a recording's metadata, and of a session's record of its import: when the first sample
#: was taken [s since 1970]; where that is not known, `BEGAN_BY` says what the time is of.
BEGAN, BEGAN_BY = "began_s", "began_by"
#: Key of a recording's metadata: joints that are locked, and where, as JSON.
LOCKED = "locked"
#: Metadata: numbers of the joints whose unit was said, so that nobody doubts it.
STATED = "units_stated"
#: ... and the unit of all of them that the user has said when importing.
UNIT_SAID = "unit_said"
#: Metadata: what was said of positions that wrap and were unwrapped, and the numbers of the joints
#: whose positions were to be left as they are.
UNWRAPPED, AS_IS = "unwrapped", "wraps_kept"
#: Metadata: times of the run that enter no equation, as first and last ones [s].
LEFT_OUT = "left_out_s"
#: Start of the metadata that hold the [signal] of a map.
SIGNAL = "signal_"
#: ... of which this one is one number a joint.
EFFORT_STEP = "effort_step"
#: Metadata record of a session: the tags that it was given.
TAGS = "tags"
#: Columns of a table: of a force and of a torque at the tip; and stem of the others -> field here.
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
GROUPS = {
    "q": "q",
    "tau": "tau",
    "qd": "qd",
    "tauext": "tau_ext",
    "i": "current",
    "temp": "temperature",
}
#: Measured channels, a column a joint or component.
COLUMNS = ("q", "tau", "qd", "wrench", "tau_ext", "current", "temperature")


def refuse_names(joints: Sequence[str]) -> None:
    """Refuse names of joints that no file gives back: empty, not printable, or there twice.

    Raises
    ------
    DataError
        With the first one.
    """
    for k, name in enumerate(joints):
        if not name.strip() or not name.isprintable():
            raise DataError(
                f"joint {k + 1} has the name {name[:80]!r}; expected a word of printable characters"
            )
        if name in joints[:k]:
            raise DataError(
                f"joints {joints.index(name) + 1} and {k + 1} have the same name, {name[:80]!r}; "
                "give each its own"
            )


@dataclass(frozen=True, repr=False, eq=False)
class Recording(Shown):
    """One run of one arm, n samples of d joints, SI units throughout.

    Parameters
    ----------
    name : str
        Name of the run (file stem) for tables and messages.
    arm : str
        Name of the arm within the session (``"leader"``, ``"follower"``, ``"arm"``).
    joints : tuple of str
        Joint names, length d.
    t : ndarray (n,)
        Time [s], increasing.
    q : ndarray (n, d)
        Joint positions [rad or m].
    tau : ndarray (n, d)
        Commanded or measured motor effort at the joint [N m or N].
    qd : ndarray (n, d) or None
        Measured joint velocities, where the recording has them.
    wrench : ndarray (n, 6) or None
        Force and torque ON the robot at the tip, in the base frame [N, N m].
    tau_ext : ndarray (n, d) or None
        External joint effort ON the robot [N m or N], where it was measured directly.
    current, temperature : ndarray (n, d) or None
        Motor current [A] and temperature [degC].
    robot : RobotSource
        The robot.
    metadata : dict
        What the session says of itself.
    """

    name: str
    arm: str
    joints: tuple[str, ...]
    t: FloatArray
    q: FloatArray
    tau: FloatArray
    qd: FloatArray | None = None
    wrench: FloatArray | None = None
    tau_ext: FloatArray | None = None
    current: FloatArray | None = None
    temperature: FloatArray | None = None
    robot: RobotSource = field(default_factory=RobotSource)
    metadata: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # nearly all that looks at a recording goes through one column after the other
        for key in COLUMNS:
            if (value := getattr(self, key)) is not None:
                object.__setattr__(self, key, np.asfortranarray(value))

    def __repr__(self) -> str:
        length = f"{self.t[-1] - self.t[0]:.4g} s" if self.n else "empty"
        return f"Recording({self.name!r}, {', '.join(self.joints)}: {length}, {self.n} samples)"

    @property
    def n(self) -> int:
        """Number of samples."""
        return int(self.t.size)

    @property
    def d(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each joint, ``"rad"`` or ``"m"``, as the recording says it."""
        said = self.metadata.get("unit", "rad").split()
        return tuple(said) if len(said) == self.d else (*said, "rad")[:1] * self.d

    @cached_property
    def period(self) -> float:
        """Median time from one sample to the next [s].

        The mean one where most stamps repeat, and of rows from a queue.
        """
        median = float(np.median(np.diff(self.t)))
        if median > 0:
            return usual_step(np.diff(self.t))
        return float(self.t[-1] - self.t[0]) / max(self.n - 1, 1)

    @cached_property
    def rate(self) -> float:
        """Sample rate [Hz] from the median period."""
        return float(np.divide(1.0, self.period))

    @cached_property
    def jumps(self) -> tuple[Jumps, ...]:
        """Jumps that each joint's position cannot have made (`hil.record.jumps`)."""
        return tuple(jumps(self.t, self.q[:, k]) for k in range(self.d))

    def unwrapped(self, joints: Sequence[int] | None = None) -> Recording:
        """The recording with positions that wrap at a turn made continuous, which is said.

        Parameters
        ----------
        joints : sequence of int, optional
            Joints that turn; by default all, where the unit is rad.
        """
        turning = [k for k, unit in enumerate(self.units) if unit == "rad"]
        kept = self.metadata.get(AS_IS, "").split()
        columns, said = {}, [x for x in [self.metadata.get(UNWRAPPED)] if x]
        for k in turning if joints is None else joints:
            found = None if str(k + 1) in kept else wraps(self.t, self.q[:, k], [TURN])
            if found is not None:
                columns[k] = found.values
                said.append(found.text(f"q{k + 1}"))
        if not columns:
            return self
        q = np.stack([columns.get(k, self.q[:, k]) for k in range(self.d)], axis=1)
        stated = {*self.metadata.get(STATED, "").split(), *(str(k + 1) for k in columns)}
        more = {UNWRAPPED: "; ".join(said), STATED: " ".join(sorted(stated, key=int))}
        return replace(self, q=q, metadata={**self.metadata, **more})

    @property
    def left_out(self) -> list[tuple[float, float]]:
        """First and last times [s] of what enters no equation.

        Raises
        ------
        DataError
            If the metadata hold no pairs of times.
        """
        said = self.metadata.get(LEFT_OUT, "")
        try:
            x = [float(t) for t in said.split()]
            return list(zip(x[::2], x[1::2], strict=True))
        except ValueError:
            raise DataError(
                f"recording {self.name!r}: {LEFT_OUT} = {said!r} in its metadata is no list of "
                "first and last times [s]; take this entry out and read the recording again"
            ) from None

    def leaving_out(self, spans: Sequence[tuple[float, float]]) -> Recording:
        """The recording, of which some times enter no equation."""
        told = " ".join(f"{t!r}" for span in [*self.left_out, *spans] for t in span)
        return replace(self, metadata={**self.metadata, LEFT_OUT: told}) if told else self

    def columns(self) -> dict[str, FloatArray]:
        """The samples as columns (n,) by the names that an import knows.

        ``pandas.DataFrame(run.columns())`` makes a frame, and `hil.from_arrays` a recording of it.

        Returns
        -------
        dict
            ``t`` [s], ``q1``.. [rad or m], ``tau1``.. [N m or N], where there are any ``qd1``..,
            ``tauext1``.., ``i1``.. [A], ``temp1``.. [degC], and ``fx`` to ``tz`` [N, N m] ON the
            robot at the tip, in the base frame.
        """
        names = {key: [f"{stem}{k + 1}" for k in range(self.d)] for stem, key in GROUPS.items()}
        out = {"t": self.t}
        for key, called in {**names, "wrench": list(WRENCH)}.items():
            if (value := getattr(self, key)) is not None:
                out |= {n: value[:, k] for k, n in enumerate(called)}
        return out

    def slice(self, start: int, stop: int) -> Recording:
        """Samples start..stop as a recording of their own."""
        arrays = {
            key: value[start:stop]
            for key in ("t", *COLUMNS)
            if (value := getattr(self, key)) is not None
        }
        return replace(self, **arrays)


def signal_value(key: str, value: Any, what: str) -> float | tuple[float, ...]:
    """A value of the [signal] of a model or map.

    Parameters
    ----------
    key : str
        Its name.
    value : object
        As it stands in the file.
    what : str
        What to call it.

    Raises
    ------
    ConfigError
        If it is no number, or none that it can be.
    """
    if key == EFFORT_STEP:
        return _steps(value, what)
    found = number(value, what)
    least = -math.inf if key in ("shift_s", "clock_ppm") else 0.0
    most = 1.0 if key == "accuracy" else math.inf
    if key == "lag_poles" and found not in (0.0, 1.0, 2.0):
        raise ConfigError(
            f"{what} = {found:g}: expected 1 or 2, the poles of a low-pass, or 0, a moving "
            "average over twice lag_s"
        )
    if not (least <= found < most and math.isfinite(found)):
        expected = "a frequency in Hz" if key.endswith("_hz") else "a time in s"
        expected = "a share of the rms effort, e.g. 0.01" if key == "accuracy" else expected
        expected = "microseconds a second" if key == "clock_ppm" else expected
        raise ConfigError(f"{what} = {found:g}: expected {expected}, or 0 = choose")
    return found


def number(value: Any, what: str) -> float:
    """A number of a file.

    Raises
    ------
    ConfigError
        If it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{what} = {value!r}: expected a number")
    return float(value)


def _steps(value: Any, what: str) -> tuple[float, ...]:
    """Steps of a converter, one a joint; 0 = none."""
    given = value if isinstance(value, list) else [value]
    found = tuple(number(x, what) for x in given)
    if not isinstance(value, list) or not all(0.0 <= x < math.inf for x in found):
        raise ConfigError(f"{what} = {value!r}: expected one step a joint, e.g. [0.05, 0.0, 0.02]")
    return found
