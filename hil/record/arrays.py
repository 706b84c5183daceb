"""From what a program holds to a recording, and from what a caller gave to a list of recordings.

Arrays, data frames and dictionaries of columns pass the checks that a table of a file passes.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hil.errors import ConfigError, DataError, listed_names, plural, unknown
from hil.record.recording import GROUPS, PRESETS, WRENCH, Recording, RobotSource, refuse_names

if TYPE_CHECKING:  # the reader of tables, only where arrays come as such
    from hil.record.mapfile import TableMap

FloatArray = NDArray[np.float64]
#: One run, or several.
Runs = Recording | Sequence[Recording]


def from_arrays(
    t: Any,
    q: ArrayLike | None = None,
    tau: ArrayLike | None = None,
    *,
    robot: str | Path | RobotSource = "",
    qd: ArrayLike | None = None,
    wrench: ArrayLike | None = None,
    tau_ext: ArrayLike | None = None,
    current: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    joints: Sequence[str] = (),
    lock: Mapping[str, float] | None = None,
    map: str | Path | TableMap | Mapping[str, Any] | None = None,
    tip: str = "",
    unit: str = "",
    missing: str = "",
    rate: float | None = None,
    arm: str = "",
    name: str = "arrays",
) -> Recording:
    """Make a recording of arrays, or of a data frame; nothing is written.

    Parameters
    ----------
    t : array_like (n,), or a frame
        Time [s], increasing.  In its place, with neither `q` nor `tau`, a pandas or polars frame
        or a mapping of columns, with the names that `hil import` knows: t, q1.., tau1.., qd1..,
        tauext1.., i1.., temp1.., fx, fy, fz, tx, ty, tz.  The time may be the index of a pandas
        frame, and dates or time spans.
    q, tau : array_like (n, d), or (n,) for one joint
        Joint positions [rad or m] and motor efforts at the joint [N m or N].
    robot : str, Path or RobotSource
        URDF file or text, the name of a preset, or ``run.robot`` of another recording; by default
        independent axes.
    qd, tau_ext, current, temperature : array_like (n, d), optional
        Velocities, external efforts ON the robot, motor currents [A] and temperatures [degC].
    wrench : array_like (n, 3 or 6), optional
        Force and torque ON the robot at the tip, base frame [N, N m].
    joints : sequence of str, or one name
        Names of the joints of the columns, in their order.  The other moving joints of the URDF
        are locked; without `joints` those beyond an arm that the columns fill, as of a gripper.
        ``metadata["note"]`` of the recording says which, and `print` shows it.
    lock : mapping of str to float, optional
        Where joints are locked [rad or m]; by default at 0, or the limit next to it.
    map : str, Path, TableMap or dict, optional
        Map file, the name of a built-in one, or what stands in one as a dictionary, for columns of
        other names and units: ``{"columns": {"q1": {"from": "angle", "unit": "deg"}}}``.
    tip, unit, arm, name : str
        Frame of the wrench, unit of the axes without a URDF (``"rad"``, ``"m"``, one a
        joint as ``"rad m"``, or ``"deg"`` for positions in degrees), names of the arm and of the
        run.
    missing : str
        What becomes of rows with missing values: ``"refuse"``, ``"drop"`` or ``"interpolate"``.
    rate : float
        Sample rate [Hz] of a frame without times.  Beside a column that says another one,
        ``metadata["note"]`` tells so.

    Returns
    -------
    Recording
        Checked as a table is that `hil import` reads.

    Raises
    ------
    DataError
        If shapes do not fit, values are missing or infinite, or the time does not increase.
    ConfigError
        If an argument is of another kind, or the map names what is not there.
    """
    joints = listed_names(joints, "joints")
    more = {"qd": qd, "tau_ext": tau_ext, "current": current, "temperature": temperature}
    if (q is None) != (tau is None):
        lacking = "q" if q is None else "tau"
        raise ConfigError(f"hil.from_arrays(t, q, tau) lacks {lacking}; give positions and efforts")
    if q is None:
        if extra := [k for k, v in {**more, "wrench": wrench}.items() if v is not None]:
            raise ConfigError(
                f"hil.from_arrays takes all columns from the frame; put {extra[0]} into it"
            )
        found = _frame_columns(t)
    else:
        found = _array_columns(t, {"q": q, "tau": tau, **more}, wrench)
    from hil.record.table_files import ForeignTable
    from hil.record.tables import read_columns
    from hil.record.units import axes_unit

    given = replace(_map(map), tip=tip or _map(map).tip).within(axes_unit(unit, ["deg"]), ())
    given = replace(given, missing=_known("missing", missing, _MISSING) or given.missing)
    given = replace(given, rate_hz=sample_rate(rate) or given.rate_hz)
    lock = lock_positions(lock)
    source = _robot(robot)
    described = bool(source.urdf if isinstance(source, RobotSource) else str(source) or given.urdf)
    if described:
        named = joints or given.joints
        given = replace(given, joints=named, lock={**given.lock, **lock})
    elif lock:
        raise ConfigError("lock is of the joints of a URDF; give it with robot=...")
    table = ForeignTable(
        Path(str(name)),
        tuple(found),
        lambda w: {k: found[k] for k in w},
        0,
        str(name),
        in_memory=True,
    )
    imported = read_columns(table, given, source, arm)
    if len(imported.recordings) > 1:
        arms = ", ".join(r.arm for r in imported.recordings)
        raise ConfigError(f"the map makes the arms {arms}; choose one with arm=...")
    run = _noted(imported.recordings[0], imported.notes)
    return run if described else _named(run, joints)


_MISSING = ("refuse", "drop", "interpolate")


def lock_positions(lock: Mapping[str, float] | None) -> dict[str, float]:
    """Positions by joint that an argument gives; none for None.

    Raises
    ------
    ConfigError
        If it is no mapping of names to numbers.
    """
    given = {} if lock is None else lock
    if not isinstance(given, Mapping) or not all(
        isinstance(x, int | float | np.number) for x in given.values()
    ):
        raise ConfigError(f"lock is {lock!r}; expected positions by joint, as {{'finger': 0.0}}")
    return {str(name): float(x) for name, x in given.items()}


def sample_rate(rate: float | None) -> float:
    """A sample rate [Hz] that an argument gives, or 0 for none.

    Raises
    ------
    ConfigError
        If it is no number above 0.
    """
    if rate is None:
        return 0.0
    if not isinstance(rate, int | float | np.number) or not 0 < rate < np.inf:
        raise ConfigError(f"rate is {rate!r}; expected samples per second, e.g. 500")
    return float(rate)


def _known(what: str, value: str, known: Sequence[str]) -> str:
    """A word that an argument may be, or none."""
    if value and value not in known:
        raise ConfigError(unknown(what, str(value), known))
    return value


def _map(given: str | Path | TableMap | Mapping[str, Any] | None) -> TableMap:
    """A map, from wherever it is said."""
    from hil.record.mapfile import TableMap, parse_map, read_map

    if isinstance(given, TableMap):
        return given
    if isinstance(given, Mapping):
        try:
            return parse_map(given)
        except ConfigError as error:
            raise ConfigError(f"map of hil.from_arrays: {error}") from error
    if given and not isinstance(given, str | Path):
        raise ConfigError(
            f"map is {_kind(given)}; expected a map file, the name of a built-in map, or a "
            "dictionary as {'columns': {'q1': 'angle'}}"
        )
    return read_map(given) if given else TableMap()


def _array_columns(
    t: Any, groups: Mapping[str, Any], wrench: ArrayLike | None
) -> dict[str, FloatArray]:
    """Columns by name of arrays, after checking that their shapes belong together."""
    stems = {key: stem for stem, key in GROUPS.items()}
    out = {"t": _numbers("t", t)}
    n = out["t"].size
    if out["t"].ndim != 1:
        raise DataError(f"t has shape {out['t'].shape}; expected (n,), the time of each sample [s]")
    d = 0
    for key, value in groups.items():
        if value is None:
            continue
        x = _numbers(key, value)
        x = x[:, None] if x.ndim == 1 else x
        d = d or (x.shape[1] if x.ndim == 2 else 0)
        if x.shape != (n, d):
            turned = "; give its transpose" if x.ndim == 2 and x.shape[1] == n != x.shape[0] else ""
            wide = f"{n}, {d}" if d and not turned else f"{n}, d"
            raise DataError(
                f"{key} has shape {x.shape}; expected ({wide}), a row a time and a column a joint"
                f"{turned}"
            )
        out |= {f"{stems[key]}{k + 1}": x[:, k] for k in range(d)}
    if wrench is not None:
        w = _numbers("wrench", wrench)
        if w.shape not in ((n, 3), (n, 6)):
            raise DataError(f"wrench has shape {w.shape}; expected ({n}, 3) or ({n}, 6)")
        out |= {WRENCH[k]: w[:, k] for k in range(w.shape[1])}
    return out


def _numbers(what: str, value: Any) -> FloatArray:
    """An array of real numbers; `DataError` names what is none."""
    try:
        masked = isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "biuf"
        array = np.ma.filled(value.astype(float), np.nan) if masked else np.asarray(value)
        if array.dtype.kind in "Mm":  # dates as seconds since 1970, and spans in seconds
            seconds = array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64) / 1e9
            return np.where(np.isnat(array), np.nan, seconds)
        if array.dtype == np.float32 and what in _TIMES and float(np.max(array, initial=0)) > 1e8:
            raise DataError(
                f"{what} is of type float32, which holds times since 1970 to 128 s; give it as "
                "float64"
            )
        if array.dtype.kind in "biuf":
            return array.astype(np.float64)
        if array.dtype.kind == "O":  # a column of a frame that holds numbers and None
            if all(hasattr(x, "timestamp") for x in array.ravel()):  # dates with a time zone
                return np.array([_date(x) for x in array.ravel()]).reshape(array.shape)
            return np.array([np.nan if x is None else x for x in array.ravel()], float).reshape(
                array.shape
            )
    except (TypeError, ValueError) as error:
        raise DataError(f"{what} is no array of numbers: {error}") from error
    raise DataError(f"{what} is of type {array.dtype}; expected real numbers")


#: What the time is called in messages.
_TIMES = ("t", "column 't'", "column 'time'", "column 'timestamp'", "column 'stamp'")


def _date(value: Any) -> float:
    """Seconds since 1970 of a date; UTC where it says no zone."""
    return float((value if value.tzinfo else value.replace(tzinfo=UTC)).timestamp())


def _index(frame: Any, names: Sequence[str]) -> dict[str, FloatArray]:
    """The index of a pandas frame where it is the time, or has a name of its own."""
    from hil.record.units import time_unit

    index = getattr(frame, "index", None)
    dtype = getattr(index, "dtype", None)
    if not isinstance(dtype, np.dtype) and "datetime" not in str(dtype):
        return {}
    name = str(getattr(index, "name", None) or "t")
    kind = getattr(dtype, "kind", "M")
    timed = any(time_unit(n) is not None for n in names)
    if name in names or (timed and not getattr(index, "name", None)):
        return {}
    if kind in "Mm" or getattr(index, "name", None):
        try:
            return {name: _numbers(f"the index {name!r}", index)}
        except DataError:
            return {}
    plain = kind == "f" and bool(np.all(np.diff(np.asarray(index)) > 0))
    return {name: np.asarray(index, float)} if plain else {}


def _frame_columns(frame: Any) -> dict[str, FloatArray]:
    """Columns of a pandas or polars frame, or of a mapping, that hold numbers."""
    if type(frame).__name__ == "LazyFrame":  # of polars: nothing is read yet
        frame = frame.collect()
    names = _column_names(frame)
    if not names:
        raise ConfigError(
            "hil.from_arrays takes (t, q, tau) or one frame with columns t, q1.., tau1..; "
            f"it got {_kind(frame)} alone"
        )
    flat = [_flat(n) for n in names]
    if twice := [n for k, n in enumerate(flat) if n in flat[:k]]:
        raise DataError(f"column {twice[0]!r} stands twice in the frame; give each its own name")
    out = _index(frame, flat)
    for name in names:
        called = _flat(name)
        try:
            values = _numbers(f"column {called!r}", _whole(frame[name]))
        except DataError:
            if re.fullmatch(r"t|[a-z]+[0-9]+|[ft][xyz]|q|qd|tau", called):
                raise
            continue
        if values.ndim == 2 and values.shape[1] <= _WIDEST:  # of all joints
            out |= {f"{called}{k + 1}": values[:, k] for k in range(values.shape[1])}
        else:
            out[called] = values
    return out


#: A column of lists or a 2-D array has no more numbers in a row than this.
_WIDEST = 99


def _flat(name: Any) -> str:
    """Name of a column; of one with several levels, these with points between them."""
    parts = name if isinstance(name, tuple) else (name,)
    return ".".join(str(p) for p in parts if str(p))


def _whole(column: Any) -> Any:
    """A column as an array; one whose cells are lists of one length as (n, k)."""
    array = np.asarray(column)
    listed = array.dtype == object and array.size and isinstance(array[0], list | np.ndarray)
    try:
        return np.stack([np.asarray(x, float) for x in array]) if listed else array
    except (TypeError, ValueError):  # of several lengths, or no numbers
        return array


def _column_names(frame: Any) -> list[Any]:
    """Names of the columns of a frame, a mapping, a structured array or an Arrow table."""
    if isinstance(frame, Mapping):
        return list(frame)
    if isinstance(frame, np.ndarray):
        return list(frame.dtype.names or ())
    return list(getattr(frame, "column_names", getattr(frame, "columns", ())))


def _robot(given: str | Path | RobotSource) -> str | Path | RobotSource:
    """A URDF file by its path; a robot, the text of a URDF, or a preset as a source."""
    if isinstance(given, RobotSource):
        if given.preset and not given.urdf and given.preset not in PRESETS:
            raise ConfigError(unknown("robot preset", given.preset, PRESETS))
        return given
    if not isinstance(given, str | Path):
        raise ConfigError(
            f"robot is {_kind(given)}; expected a URDF file, the text of one, the name of a "
            "preset, or run.robot of a recording"
        )
    text = str(given)
    if text.lstrip().startswith("<"):
        return RobotSource("", text)
    is_file = isinstance(given, Path) or re.search(r"[/\\.](urdf|xml)$|[/\\]", text.lower())
    if not text or is_file or Path(text).is_file():
        return text
    if text not in PRESETS:
        raise ConfigError(unknown("robot preset", text, PRESETS) + ", or give a URDF file")
    return RobotSource(text)


def _noted(run: Recording, notes: Sequence[str]) -> Recording:
    """A recording that says what was guessed and left out, in the words of Python's arguments."""
    said = "; ".join(notes).replace("(--joints and --lock)", "(joints=[...] and lock={...})")
    return replace(run, metadata={**run.metadata, "note": said}) if said else run


def _named(run: Recording, joints: tuple[str, ...]) -> Recording:
    if not joints or joints == run.joints:
        return run
    if len(joints) != run.d:
        raise ConfigError(f"{plural(len(joints), 'name')} in joints, but {run.d} columns of q")
    refuse_names(joints)
    return replace(run, joints=joints)


# ------------------------------------------------------------ what a verb is given


def _kind(x: object) -> str:
    return "None" if x is None else type(x).__name__


def as_runs(given: object, verb: str) -> list[Recording]:
    """Recordings that a verb was given: one run stands for a list of one.

    One that holds the samples of another would count twice; it is left out.

    Parameters
    ----------
    given : object
        A recording, or several.
    verb : str
        Name of the verb, for messages, e.g. ``"hil.fit"``.

    Raises
    ------
    ConfigError
        If it is something else; the sentence says what makes a recording of it.
    """
    several = isinstance(given, Iterable) and _instead(given) is None
    each = list(given) if several and isinstance(given, Iterable) else [given]
    runs = [run for run in each if isinstance(run, Recording)]
    if each and len(runs) == len(each):
        return once(runs, _twice)
    wrong = [run for run in each if not isinstance(run, Recording)]
    found = _kind(wrong[0]) if wrong else "an empty list"
    how = (_instead(wrong[0]) if wrong else None) or "hil.load('run1.mcap') reads one"
    raise ConfigError(f"{verb} takes a recording or a list of them, not {found}; {how}")


def once(
    runs: Iterable[Recording], said: Callable[[Recording, Recording], None]
) -> list[Recording]:
    """Runs without those that hold the samples of another.

    Parameters
    ----------
    runs : iterable of Recording
        The runs.
    said : callable
        Gets each that is left out, and the one that holds its samples.
    """
    out: list[Recording] = []
    for run in runs:
        same = [r for r in out if r.n == run.n and r.arm == run.arm and _same(r, run)]
        if same:
            said(run, same[0])
        else:
            out.append(run)
    return out


def _twice(run: Recording, other: Recording) -> None:
    """Warn of a run that is left out, which would count twice."""
    warnings.warn(f"{run.name} holds the same data as {other.name}; left out", stacklevel=4)


def _same(one: Recording, other: Recording) -> bool:
    """Whether two recordings hold the same samples."""
    names = ("t", "q", "tau")
    return all(np.array_equal(getattr(one, n), getattr(other, n)) for n in names)


def held_out(given: object, verb: str) -> list[Recording]:
    """Held-out recordings that a verb was given, as `as_runs`; none at all is an empty list."""
    none = given is None or (isinstance(given, list | tuple) and not given)
    return [] if none else as_runs(given, f"holdout of {verb}")


def _instead(given: object) -> str | None:
    """What makes a recording of something that is none; None where nobody knows."""
    if isinstance(given, str | Path):
        if Path(given).suffix in (".mcap", ""):
            return f"hil.load({str(given)!r}) reads a session"
        return f"hil.load({str(given)!r}, robot=...) reads a table"
    if hasattr(given, "columns") or isinstance(given, Mapping):
        return "hil.from_arrays(frame, robot=...) makes one of a frame"
    if isinstance(given, np.ndarray):
        return "hil.from_arrays(t, q, tau, robot=...) makes one of arrays"
    return None
