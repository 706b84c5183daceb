"""Re-run the law of a session on what it measured, and compare what it commanded, bit by bit.

The loop's decisions (operating state, commands of the operator) are taken from the record; the
law, the limits and the conversion of the driver are run again.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hil.played import Played, played
from hil.record.container import Container, read
from hil.rerun import Run
from hil.session import source_revision
from hil.signals.device import FloatArray


@dataclass(frozen=True)
class Difference:
    """Where record and replay part.

    Parameters
    ----------
    tick : int
        First tick that differs.
    arm, what : str
        Arm, and ``effort`` or ``code`` with the number of the joint.
    recorded, replayed : float
        Values.
    """

    tick: int
    arm: str
    what: str
    recorded: float
    replayed: float


@dataclass
class Replayed:
    """Outcome.

    Parameters
    ----------
    path : str
        Session.
    ticks, compared, differ : int
        Rows there are, rows compared, and rows that differ.
    first : Difference or None
        The first one.
    notes : list of str
        What limits the comparison, or explains a difference.
    rms : dict of str to list of float
        Arm -> rms of replayed minus recorded effort per joint [N m].
    """

    path: str
    ticks: int
    compared: int = 0
    differ: int = 0
    first: Difference | None = None
    notes: list[str] = field(default_factory=list)
    rms: dict[str, list[float]] = field(default_factory=dict)

    def as_dict(self) -> dict[str, object]:
        """Plain dictionary for JSON."""
        return {"schema": "hil.replay/1", "identical": not self.differ, **dataclasses.asdict(self)}


def replay(path: str | Path, changes: Mapping[str, float] | None = None) -> Replayed:
    """Re-run the law of a session.

    Parameters
    ----------
    path : str or Path
        Session of `hil run`.
    changes : mapping, optional
        Parameters of the law that are to be others: what would it have commanded?

    Raises
    ------
    DataError
        If the session holds no rig file, or misses a channel.
    """
    box = read(path)
    with tempfile.TemporaryDirectory() as folder:
        record = played(box, Path(folder))
        out = Replayed(str(path), record.ticks.size)
        _judge(record, *Run(record, dict(changes or {})).all(), out)
    _explain(box, out, changes)
    return out


def _judge(r: Played, sent: FloatArray, codes: FloatArray, known: Any, out: Replayed) -> None:
    """Compare bit by bit."""
    worse = (sent != r.sent) | (codes != r.codes)
    worse &= known[:, None, None]
    out.compared, out.differ = int(known.sum()), int(worse.any(axis=(1, 2)).sum())
    for a, arm in enumerate(r.config.controller.arms):
        error = (sent[:, a] - r.sent[:, a])[known]
        out.rms[arm] = np.sqrt(np.mean(error**2, axis=0)).tolist() if error.size else [0.0] * 3
    if out.differ:
        k, a, j = (int(v[0]) for v in np.nonzero(worse))
        told = ("effort", r.sent, sent), ("code", r.codes, codes)
        name, old, new = told[int(r.sent[k, a, j] == sent[k, a, j])]
        out.first = Difference(
            int(r.ticks[k]), r.config.controller.arms[a], f"{name}{j + 1}", float(old[k, a, j]),
            float(new[k, a, j]),
        )  # fmt: skip
    if out.compared < out.ticks:
        out.notes.append(
            f"{out.ticks - out.compared} rows follow rows that the ring dropped: the state of the "
            "law was unknown until the record gave it again"
        )


def _explain(box: Container, out: Replayed, changes: Mapping[str, float] | None) -> None:
    """Reasons why record and replay may differ."""
    told = box.metadata.get("session", {})
    if changes:
        changed = ", ".join(f"{k} = {v:g}" for k, v in changes.items())
        out.notes.append(f"the law was run with {changed}")
    if changes or not out.differ:
        return
    revision, dirty = source_revision()
    if told.get("git_revision") != revision:
        out.notes.append(
            f"recorded by revision {told.get('git_revision', 'unknown')[:12]}, replayed by "
            f"{revision[:12]}"
        )
    if "true" in (dirty, told.get("git_dirty")):
        out.notes.append("one of the two had uncommitted changes")
