"""Recordings from whatever a path names: a session, a ROS bag, or a folder of them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from hil.errors import DataError, plural
from hil.record.bags import BagChoice, is_bag, read_bag
from hil.record.locked import locked_urdf
from hil.record.mcap_read import arms, load
from hil.record.recording import LOCKED, Recording

#: A joint that stands elsewhere by more [rad or m] makes another robot of a run.
ELSEWHERE = 0.05
_ENDINGS = (".mcap", ".bag", ".db3")


def find(paths: Iterable[str | Path]) -> list[Path]:
    """Files and bags of some paths; a folder stands for the sessions and bags in it, by name.

    Raises
    ------
    DataError
        If a folder holds none.
    """
    out: list[Path] = []
    for path in map(Path, paths):
        if not path.is_dir() or is_bag(path):
            out.append(path)
            continue
        inside = [p for p in sorted(path.iterdir()) if is_bag(p) or _is_file(p)]
        if not inside:
            raise DataError(
                f"folder {path} holds no session and no ROS bag ({', '.join(_ENDINGS)}); tables "
                "are brought in by hil import"
            )
        out += inside
    return out


def _is_file(path: Path) -> bool:
    return path.suffix.lower() in _ENDINGS and path.is_file() and not path.name.startswith(".")


def load_source(
    path: str | Path, arm: str | None = None, choice: BagChoice | None = None
) -> Recording:
    """Recording of one arm of a session or a bag.

    Parameters
    ----------
    path : str or Path
        Session or bag.
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
    if not is_bag(path):
        found = load(path, arm)
        return subset(found, chosen) if chosen.joints else found
    bag = read_bag(path, replace(chosen, arm=arm or chosen.arm))
    if len(bag) > 1:
        bag[0].metadata["note"] += (
            f"; the arms are {', '.join(r.arm for r in bag)} (choose with --arm)"
        )
    return bag[0]


def load_sources(
    paths: Sequence[str | Path], arm: str | None = None, choice: BagChoice | None = None
) -> list[Recording]:
    """Recordings of one robot: the joints that the first bag chooses are those of all.

    Raises
    ------
    DataError, ConfigError
        As `load_source`.
    """
    chosen = choice or BagChoice()
    out: list[Recording] = []
    for path in paths:
        out.append(load_source(path, arm, chosen))
        if not chosen.joints and is_bag(path):
            chosen = replace(chosen, joints=out[0].joints)
    return out


def every_arm(path: str | Path, choice: BagChoice | None = None) -> list[Recording]:
    """Recordings of all arms of a session or a bag.

    Raises
    ------
    DataError, ConfigError
        As `load_source`.
    """
    if is_bag(path):
        return read_bag(path, choice)
    return [load_source(path, arm, choice) for arm in arms(path)]


def subset(recording: Recording, choice: BagChoice) -> Recording:
    """Some joints of a recording; those of its URDF that are left out are locked.

    Raises
    ------
    DataError
        If the recording has not all of the joints.
    ConfigError
        If the URDF has not.
    """
    lost = [n for n in choice.joints if n not in recording.joints]
    if lost:
        raise DataError(
            f"recording {recording.name!r} has no joint {', '.join(lost)}; it has "
            f"{', '.join(recording.joints)}"
        )
    keep = [k for k, n in enumerate(recording.joints) if n in choice.joints]
    arrays = {
        key: value[:, keep]
        for key in ("q", "tau", "qd", "tau_ext", "current", "temperature")
        if (value := getattr(recording, key)) is not None
    }
    robot, locked = recording.robot, json.loads(recording.metadata.get(LOCKED, "{}"))
    if robot.urdf:
        names = [recording.joints[k] for k in keep]
        stood = {
            n: float(sorted(recording.q[:, k])[recording.n // 2])
            for k, n in enumerate(recording.joints)
            if k not in keep
        }
        text, more = locked_urdf(robot.urdf, names, {**stood, **choice.lock})
        robot, locked = replace(robot, urdf=text), {**locked, **more}
    said = {LOCKED: json.dumps(locked)} if locked else {}
    return replace(
        recording,
        joints=tuple(recording.joints[k] for k in keep),
        robot=robot,
        metadata={**recording.metadata, **said},
        **arrays,
    )


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
