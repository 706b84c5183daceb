"""Recordings from whatever a path names: a session, a ROS bag, a table, or a folder of them.

The columns of a table have the names and units of `hil import`, or a map says what they are.
"""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hil.errors import ConfigError, DataError, families, listed_names, plural
from hil.record import mcap_read
from hil.record.arrays import lock_positions, sample_rate
from hil.record.bags import BagChoice, TableChoice, is_bag, read_bag
from hil.record.container import MAGIC
from hil.record.locked import arm_joints, free_joints, locked_urdf, refuse_beyond
from hil.record.recording import BEGAN, EFFORT_STEP, LOCKED, SIGNAL, STATED, Recording, RobotSource
from hil.userfile import is_dataset, read_text

#: A joint that stands elsewhere by more [rad or m] makes another robot of a run.
ELSEWHERE = 0.05
#: Joints from which on they are counted, not named.
_MANY = 5
_ENDINGS = (".mcap", ".bag", ".db3")


def find(paths: Iterable[str | Path]) -> list[Path]:
    """Files and bags of some paths; a folder stands for the sessions and bags in it, by name.

    Where it holds none itself, those of the folders in it are taken: of days, of robots.  Where
    there are none of these either, it stands for its tables.

    Raises
    ------
    DataError
        If a folder holds none.
    """
    out: list[Path] = []
    for path in map(Path, paths):
        if not path.is_dir() or is_bag(path) or is_dataset(path):
            out.append(path)
            continue
        inside = _inside(path) or [p for place in _folders(path) for p in _inside(place)]
        inside = inside or _tables(path)
        if not inside:
            lacks = f"folder {path} holds no session and no ROS bag ({', '.join(_ENDINGS)})"
            raise DataError(f"{lacks}, and no table").about("tables", lacks)
        out += inside
    return out


def passed_over(paths: Iterable[str | Path]) -> list[str]:
    """Sentences on sessions that `find` leaves out: those in folders below one that has some."""
    out = []
    for path in map(Path, paths):
        if path.is_dir() and not is_bag(path) and _inside(path):
            below_it = [p for place in _folders(path) for p in _inside(place)]
            if below_it:
                out.append(
                    f"{path}: {plural(len(below_it), 'session')} in the folders below it left out, "
                    "because it has sessions itself; name these folders, or give --by robot"
                )
    return out


def _inside(folder: Path) -> list[Path]:
    """Sessions and bags that stand in a folder itself."""
    return [p for p in sorted(folder.iterdir()) if is_bag(p) or _is_file(p)]


def _tables(folder: Path) -> list[Path]:
    """Tables that stand in a folder itself: files of numbers, and not the notes beside them."""
    from hil.record.table_files import FORMATS, ending

    named = [p for p in sorted(folder.iterdir()) if p.is_file() and not p.name.startswith(".")]
    tables = [p for p in named if ending(p) in FORMATS]
    return [p for p in tables if ending(p) not in _NOTES] or tables


def importable(folder: Path) -> list[Path]:
    """ROS bags and tables that stand in a folder itself, and no sessions.

    Raises
    ------
    DataError
        If there is none.
    """
    out = [p for p in _inside(folder) if is_bag(p)]
    out += [p for p in _tables(folder) if p not in out]
    if not out:
        raise DataError(f"folder {folder} holds no table and no ROS bag")
    return out


#: Endings of tables that notes have, too.
_NOTES = (".txt", ".json")


def _folders(path: Path) -> list[Path]:
    """Folders below one, but for bags."""
    inside = sorted(p for p in path.rglob("*") if p.is_dir())
    return [p for p in inside if not is_bag(p) and not is_bag(p.parent)]


def below(paths: Iterable[str | Path]) -> list[Path]:
    """Sessions and bags of folders and of the folders in them, in the order of their names.

    A folder without any stands for the tables in it and in the folders below.

    Raises
    ------
    DataError
        If there is none, or no such folder.
    """
    given, out = list(map(Path, paths)), []
    for path in given:
        if not path.exists():
            raise DataError(f"{path}: no such folder or file")
        if path.is_dir() and not (is_bag(path) or is_dataset(path)):
            places = (path, *_folders(path))
            inside = [p for place in places for p in _inside(place)]
            out += inside or [p for place in places for p in _tables(place)]
        else:
            out.append(path)
    if not out:
        lacks = "holds no session and no ROS bag, and no table"
        raise DataError(f"{', '.join(map(str, given))} {lacks}")
    return out


@dataclass(frozen=True)
class RobotName:
    """By what the robots of recordings are told apart.

    Parameters
    ----------
    joints : tuple of str
        Names.
    name : str
        Preset, or name in the URDF; empty where neither is known.
    by_motion : bool
        Whether the joints are those that a bag shows moving, which another bag need not show.
    """

    joints: tuple[str, ...]
    name: str = ""
    by_motion: bool = False

    def same(self, other: RobotName) -> bool:
        """Whether two recordings can be of one robot."""
        if self.name and self.name == other.name and (self.by_motion or other.by_motion):
            return True
        unknown = not (self.name and other.name)
        return self.joints == other.joints and (unknown or self.name == other.name)

    def __str__(self) -> str:
        joints = ", ".join(self.joints) if len(self.joints) < _MANY else ""
        return f"{self.name or 'robot'}: {joints or plural(len(self.joints), 'joint')}"


def robot_of(
    path: str | Path, arm: str | None = None, choice: BagChoice | None = None
) -> RobotName:
    """Robot of a session or a bag; samples are read only where nothing else says it.

    Parameters
    ----------
    path, arm, choice
        As in `load_source`.

    Raises
    ------
    DataError, ConfigError
        As `load_source`.
    """
    chosen = choice or BagChoice()
    if not is_session(path) or chosen.joints or chosen.robot or chosen.lock:
        found = load_source(path, arm, chosen)
        joints, robot = found.joints, found.robot
    else:
        joints, robot = mcap_read.robot_of(path, arm)
    named = re.search(r"<robot\b[^>]*?\bname\s*=\s*[\"']([^\"']*)", robot.urdf)
    preset = "" if robot.preset == "single-axis" and len(joints) > 1 else robot.preset
    return RobotName(joints, named[1] if named else preset, is_bag(path) and not chosen.joints)


def _is_file(path: Path) -> bool:
    return path.suffix.lower() in _ENDINGS and path.is_file() and not path.name.startswith(".")


def load_source(
    path: str | Path, arm: str | None = None, choice: BagChoice | None = None
) -> Recording:
    """Recording of one arm of a session, a bag or a table.

    Parameters
    ----------
    path : str or Path
        Session, bag or table.
    arm : str, optional
        Arm; default the only one, else the first, which ``metadata["note"]`` tells.
    choice : BagChoice, optional
        What is taken of a bag; its joints and locked positions are applied to a session, too.

    Raises
    ------
    DataError
        If it cannot be read, or has not what is needed.
    ConfigError
        If what was named is not there.
    """
    chosen = choice or BagChoice()
    if is_session(path):
        found = mcap_read.load(path, arm)
        return subset(found, chosen) if chosen.joints or chosen.robot or chosen.lock else found
    chosen = replace(chosen, arm=arm or chosen.arm)
    arms = read_bag(path, chosen) if is_bag(path) else _of_table(Path(path), chosen)
    if len(arms) > 1:
        arms[0].metadata["note"] += (
            f"; the arms are {', '.join(r.arm for r in arms)} (choose with --arm)"
        )
    return arms[0]


def is_session(path: str | Path) -> bool:
    """Whether a path is a session's or none; else it is that of a bag or of a table."""
    name = Path(path)
    if is_bag(name) or is_dataset(name):
        return False
    if name.suffix.lower() in _ENDINGS or not name.is_file():
        return True
    with name.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def refuse_table_words(paths: Sequence[str | Path], words: TableChoice) -> None:
    """Refuse what is said of tables where there is none.

    Raises
    ------
    ConfigError
        If something is said.
    """
    given = {
        "map": words.map,
        "unit": words.unit,
        "rate": words.rate_hz,
        "missing": words.missing,
        "run": words.run,
        "torque-constant": words.torque_constant,
    }
    named = [name for name, value in given.items() if value]
    if named and not any(_is_table(path) for path in paths):
        raise ConfigError(f"--{named[0]} is of tables; {', '.join(map(str, paths))} is none")


def _is_table(path: str | Path) -> bool:
    """Whether a path is that of a table; one where nothing is may be."""
    return not (is_bag(path) or is_session(path)) or not Path(path).exists()


def _of_table(path: Path, choice: BagChoice) -> list[Recording]:
    """Recordings of a table, one an arm; ``metadata["note"]`` tells what was taken.

    Raises
    ------
    DataError, ConfigError
        If it cannot be taken in this way.
    """
    from hil.record.mapfile import TableMap, read_map
    from hil.record.table_files import open_table
    from hil.record.tables import BY_JOINTS, read_columns
    from hil.record.units import axes_unit

    words = choice.table
    name = words.map or ("lerobot" if is_dataset(path) else "")
    given = read_map(name, words.torque_constant) if name else TableMap()
    text = choice.robot or ("" if given.urdf else choice.described)
    robot = RobotSource("", text, choice.tip or given.tip) if text else ""
    mapping = replace(
        given,
        tip=choice.tip or given.tip,
        missing=words.missing or given.missing,
        rate_hz=words.rate_hz or given.rate_hz,
    ).within(axes_unit(words.unit, ["deg"]), words.torque_constant)
    described = bool(robot or mapping.urdf)
    if described:
        named, locked = choice.joints or given.joints, {**given.lock, **choice.lock}
        mapping = replace(mapping, joints=named, lock=locked)
    try:
        table = open_table(path, mapping.array, mapping.columns, words.run, mapping.header_row)
        found = read_columns(table, mapping, robot, choice.arm)
    except (DataError, ConfigError) as error:
        if words.map or not re.search(r"\bmap\b|has no column", str(error)):
            raise
        propose = shlex.join(["hil", "import", str(path), "--propose-map", "MAP.toml"])
        writes = "" if "--propose-map" in str(error) else f". '{propose}' writes a map"
        raise type(error)(f"{error}{writes}, and --map MAP.toml takes it") from error
    unused = [n for n in found.unused if n]
    left = f"; not used: {', '.join(families(unused))}" if unused else ""
    units = "with positions in degrees" if words.unit == "deg" else "in SI units"
    how = f"by the map {name}" if name else f"by their names, {units}"
    if any(n.startswith(BY_JOINTS) for n in found.notes):
        how = "by their names"
    unsaid = all(STATED not in r.metadata for r in found.recordings)
    if unsaid and not (name or described or mapping.unit):
        how += " (joints that turn are assumed; unit m is for axes that slide)"
    note = "; ".join([f"{path.name}: columns {how}", *found.notes]) + left
    runs = [replace(r, metadata={**r.metadata, "note": note}) for r in found.recordings]
    some = bool(choice.joints or choice.lock) and not described
    return [subset(r, choice) for r in runs] if some else runs


def load(
    path: str | Path,
    arm: str | None = None,
    *,
    robot: str | Path = "",
    joints: Sequence[str] = (),
    lock: Mapping[str, float] | None = None,
    topic: str = "",
    effort_topic: str = "",
    force_topic: str = "",
    tip: str = "",
    map: str | Path = "",
    unit: str = "",
    rate: float | None = None,
    missing: str = "",
    run: str = "",
) -> Recording:
    """Load one arm of a session, a ROS bag or a table.

    Parameters
    ----------
    path : str or Path
        Session, or a bag: ROS 1, ROS 2 folder, or a file of one (MCAP, SQLite); or a table of
        `hil import`.
    arm : str, optional
        Arm; default the only one, else the first.
    robot : str or Path
        URDF file or text; default that of the session or bag.
    joints : sequence of str, or one name
        Joints to keep; the others of the URDF are locked.
    lock : mapping of str to float, optional
        Where joints are locked [rad or m]; default where they stood.
    topic, effort_topic, force_topic, tip : str
        Topics of a bag, and frame of its force; chosen where only one choice is possible.
    map, unit, rate, missing, run
        As --map, --unit, --rate [Hz], --missing and --run of `hil import`, for a table.

    Raises
    ------
    DataError
        If it cannot be read, or has not what is needed.
    ConfigError
        If what was named is not there.
    """
    if not isinstance(path, str | os.PathLike):
        raise ConfigError(
            f"hil.load takes the path of one session or bag, not {type(path).__name__}; "
            "hil.from_arrays makes a recording of arrays or a frame, [hil.load(p) for p in paths] "
            "a list of several"
        )
    named = str(robot)
    text = named if named.lstrip().startswith("<") else urdf_text(named)
    kept = listed_names(joints, "joints")
    chosen = BagChoice(
        topic,
        effort_topic,
        force_topic,
        text,
        kept,
        lock_positions(lock),
        tip,
        arm or "",
        TableChoice(str(map), unit, sample_rate(rate), missing, run),
    )
    refuse_table_words([path], chosen.table)
    return load_source(path, arm, chosen)


def urdf_text(path: str) -> str:
    """Text of a URDF file; empty without a path.

    Raises
    ------
    ConfigError
        If it cannot be read.
    """
    if not path:
        return ""
    try:
        return read_text(Path(path))
    except (OSError, UnicodeDecodeError) as error:
        why = (error.strerror or str(error)) if isinstance(error, OSError) else "it is not text"
        raise ConfigError(f"robot {path} cannot be read: {why}") from error


def load_sources(
    paths: Sequence[str | Path],
    held: Sequence[str | Path] = (),
    arm: str | None = None,
    choice: BagChoice | None = None,
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit and to judge on, of one arm of one robot.

    The joints that the first bag chooses are those of all; what is judged on is of the arm that
    is fitted.

    Parameters
    ----------
    paths, held : sequence of str or Path
        Sessions and bags.
    arm : str, optional
        Arm; default as in `load_source`.
    choice : BagChoice, optional
        As in `load_source`.

    Raises
    ------
    DataError, ConfigError
        As `load_source`.
    """
    chosen = choice or BagChoice()
    refuse_table_words([*paths, *held], chosen.table)
    out: list[Recording] = []
    for k, path in enumerate((*paths, *held)):
        wanted = arm or (out[0].arm if k >= len(paths) and out else None)
        out.append(load_source(path, wanted, chosen))
        if not chosen.joints and is_bag(path):
            chosen = replace(chosen, joints=out[0].joints)
    return out[: len(paths)], out[len(paths) :]


def every_arm(path: str | Path, choice: BagChoice | None = None) -> list[Recording]:
    """Recordings of all arms of a session, a bag or a table.

    Parameters
    ----------
    path, choice
        As in `load_source`.

    Raises
    ------
    DataError, ConfigError
        As `load_source`.
    """
    chosen = choice or BagChoice()
    if is_session(path):
        arms = mcap_read.load_arms(path)
        some = chosen.joints or chosen.robot or chosen.lock
        return [subset(r, chosen) for r in arms] if some else arms
    return read_bag(path, chosen) if is_bag(path) else _of_table(Path(path), chosen)


def recorded(path: Path, runs: Sequence[Recording]) -> tuple[float, str]:
    """When a bag or a table began [s since 1970], and by what that is known.

    Returns
    -------
    seconds : float
        Of the first sample, else of the last change of the file.
    by : {"stamps", "file"}
        Which of the two it is.
    """
    from hil.record.units import epoch_unit

    own = [float(r.metadata[BEGAN]) for r in runs if BEGAN in r.metadata]
    own += [float(r.t[0]) for r in runs if BEGAN not in r.metadata and epoch_unit(r.t[0]) == "s"]
    return (min(own), "stamps") if own else (mcap_read.changed(path), "file")


def subset(recording: Recording, choice: BagChoice) -> Recording:
    """Some joints of a recording, or another robot; joints of the URDF that are left are locked.

    Raises
    ------
    DataError
        If the recording has not all of the joints.
    ConfigError
        If the URDF has not.
    """
    recording = _of_robot(recording, choice)
    _refuse_locks(recording, choice)
    wanted = choice.joints or tuple(n for n in recording.joints if n not in choice.lock)
    lost = [n for n in wanted if n not in recording.joints]
    if lost:
        raise DataError(
            f"recording {recording.name!r} has no joint {', '.join(lost)}; it has "
            f"{', '.join(recording.joints)}"
        )
    if not wanted:
        raise DataError(f"recording {recording.name!r}: --lock leaves no joint; leave one free")
    keep = [k for k, n in enumerate(recording.joints) if n in wanted]
    stood = {
        n: float(np.median(recording.q[:, k]))
        for k, n in enumerate(recording.joints)
        if k not in keep
    }
    arrays = {
        key: value[:, keep]
        for key in ("q", "tau", "qd", "tau_ext", "current", "temperature")
        if (value := getattr(recording, key)) is not None
    }
    robot, locked = recording.robot, json.loads(recording.metadata.get(LOCKED, "{}"))
    if robot.urdf:
        names = [recording.joints[k] for k in keep]
        text, more = locked_urdf(robot.urdf, names, {**stood, **choice.lock})
        robot, locked = replace(robot, urdf=text), {**locked, **more}
    said = {LOCKED: json.dumps(locked)} if locked else {}
    if steps := json.loads(recording.metadata.get(SIGNAL + EFFORT_STEP, "[]")):
        said[SIGNAL + EFFORT_STEP] = json.dumps([steps[k] for k in keep])
    if moved := _moved(recording, keep, locked):
        said["note"] = "; ".join([x for x in [recording.metadata.get("note")] if x] + moved)
    return replace(
        recording,
        joints=tuple(recording.joints[k] for k in keep),
        robot=robot,
        metadata={**recording.metadata, **said},
        **arrays,
    )


def _refuse_locks(recording: Recording, choice: BagChoice) -> None:
    """Refuse to lock joints where the recording shows that they did not stand, or cannot."""
    if urdf := choice.robot or recording.robot.urdf:
        refuse_beyond(free_joints(urdf), choice.lock)
    for k, name in enumerate(recording.joints):
        low, high = float(np.min(recording.q[:, k])), float(np.max(recording.q[:, k]))
        at = choice.lock.get(name, low)
        if not low - ELSEWHERE <= at <= high + ELSEWHERE:
            raise ConfigError(
                f"recording {recording.name!r} holds joint {name!r} between {low:.4g} and "
                f"{high:.4g} {recording.units[k]}, it cannot be locked at {at:.4g}; leave --lock "
                "out, or leave the joint out with --joints: it is locked where it stood then"
            )


def _moved(recording: Recording, keep: Sequence[int], at: Mapping[str, float]) -> list[str]:
    """What is said of joints that are left out although they move."""
    out = []
    for k, name in enumerate(recording.joints):
        low, high = float(np.min(recording.q[:, k])), float(np.max(recording.q[:, k]))
        if k not in keep and high - low > ELSEWHERE:
            where = f", and is locked at {at[name]:.4g}" if name in at else ""
            out.append(
                f"{name} is left out although it moves from {low:.4g} to {high:.4g} "
                f"{recording.units[k]}{where}: the model lacks what its motion does to the others"
            )
    return out


def _of_robot(recording: Recording, choice: BagChoice) -> Recording:
    """A recording with the robot of the choice; joints without names take those of its arm."""
    if not choice.robot:
        return recording
    tip = choice.tip or recording.robot.tip
    source = RobotSource("", choice.robot, tip)
    known = [j.name for j in free_joints(choice.robot)]
    if set(recording.joints) <= set(known):
        text, locked = locked_urdf(choice.robot, recording.joints, _others(recording, choice))
    else:
        named = not all(re.fullmatch(r"joint\d+", n) for n in recording.joints)
        arm = arm_joints(choice.robot, recording.d) or tuple(known)
        if named or len(arm) != recording.d:
            raise DataError(
                f"recording {recording.name!r} is of another robot than the URDF: its joints are "
                f"{', '.join(recording.joints)}, those of the URDF {', '.join(known)}"
            )
        recording = replace(recording, joints=arm)
        text, locked = locked_urdf(choice.robot, arm, _others(recording, choice))
    order = [j.name for j in free_joints(text) if j.name in recording.joints]
    if order != list(recording.joints):
        raise DataError(
            f"recording {recording.name!r} has its joints in the order "
            f"{', '.join(recording.joints)}, the URDF in the order {', '.join(order)}; import the "
            "table again with --robot and --joints"
        )
    said = {LOCKED: json.dumps(locked)} if locked else {}
    metadata = {k: v for k, v in recording.metadata.items() if k != LOCKED} | said
    return replace(recording, robot=replace(source, urdf=text), metadata=metadata)


def _others(recording: Recording, choice: BagChoice) -> dict[str, float]:
    """Where joints stand that the recording does not hold."""
    stood = json.loads(recording.metadata.get(LOCKED, "{}"))
    return {n: v for n, v in {**stood, **choice.lock}.items() if n not in recording.joints}


def stand_elsewhere(runs: Sequence[Recording]) -> list[str]:
    """Locked joints that stand elsewhere in a run than in the first, a sentence a run."""
    out = []
    first = json.loads(runs[0].metadata.get(LOCKED, "{}")) if runs else {}
    for run in runs[1:]:
        own = json.loads(run.metadata.get(LOCKED, "{}"))
        away = [n for n in first if n in own and abs(own[n] - first[n]) > ELSEWHERE]
        if away:
            what = ", ".join(f"{n} at {own[n]:.4g}, not {first[n]:.4g}" for n in away)
            out.append(
                f"run {run.name} has {plural(len(away), 'locked joint')} elsewhere than run "
                f"{runs[0].name} ({what}); its weights act differently there"
            )
    return out
