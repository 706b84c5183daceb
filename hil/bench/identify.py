"""`hil bench identify`: how long identification and diagnosis take, beside peers, in one run.

A three-joint arm, 60 s at 1 kHz, 42 parameters; once complete, once with a Stribeck effect that
the fitted models lack.  Times are processor seconds on one thread (on an idle core: wall clock),
medians after a warm-up; peers take turns, so that a busy machine slows all of them alike.  Longer
recordings are diagnosed as a user would, by the wall clock and with both threads.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hil.bench import arm, peers
from hil.diagnosis.verbs import fit
from hil.models.model import base_model
from hil.record.export import write_recordings

LENGTHS = (60, 120, 300, 600)
REFERENCE = "numpy + Pinocchio (reference)"
#: What the data sets are called, by whether there is an effect that the model lacks.
DATA = {False: "complete", True: "Stribeck missing"}


@dataclass(frozen=True)
class Row:
    """One peer on one data set.

    Parameters
    ----------
    peer, data : str
        Who, on which data.
    seconds, wall : float
        Medians of processor time and wall clock [s]; NaN where it did not run.
    ratio : float
        Seconds over the reference's of the same run.
    floor : tuple of float
        Held-out rms error over the noise floor, joint by joint.
    note : str
        What else there is to say.
    """

    peer: str
    data: str
    seconds: float
    wall: float
    ratio: float
    floor: tuple[float, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class Length:
    """One diagnosis of a longer recording in its own process."""

    recorded: float
    seconds: float
    wall: float
    peak_mib: float
    verdict: str
    data: str


@dataclass(frozen=True)
class Report:
    """All rows of one run of the benchmark."""

    recorded: float
    repeats: int
    rows: list[Row]
    lengths: list[Length]


def run(
    seconds: float = 60.0, repeats: int = 3, lengths: Sequence[float] = LENGTHS,
    figaroh: str = "", report: Callable[[str], None] | None = None,
) -> Report:  # fmt: skip
    """Measure everything.

    Parameters
    ----------
    seconds : float
        Length of the common problem.
    repeats : int
        Repeats after the warm-up.
    lengths : sequence of float
        Recordings for growth and peak memory [s].
    figaroh : str
        Interpreter of an environment with FIGAROH; empty: this one.
    report : callable, optional
        Told what is measured now.
    """
    tell = report or (lambda _: None)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name, threadpool_limits(limits=1):
        folder = Path(name)
        for stribeck, data in DATA.items():
            tell(data)
            train, test = (arm.simulate(seconds, seed, stribeck) for seed in (1, 2))
            own = _in_process(train, test, data, repeats)
            own.append(_figaroh(folder, train, test, data, repeats, figaroh, own[0].seconds))
            own += _diagnoses(folder, train, test, data, repeats, own[0].seconds)
            rows += own
        grown = []
        for length, missing in [(x, True) for x in lengths] + [(x, False) for x in lengths[-1:]]:
            tell(f"{length:g} s, {DATA[missing]}")
            grown.append(_length(folder, length, missing))
    return Report(seconds, repeats, rows, grown)


def _in_process(train: arm.Data, test: arm.Data, data: str, repeats: int) -> list[Row]:
    """Reference and `hil.fit`, taking turns."""
    recording = train.recording("train")
    model = base_model(recording.robot)
    calls: dict[str, Callable[[], Any]] = {
        REFERENCE: lambda: peers.reference(train),
        # a recording keeps what was found in it: each fit gets one that no other has looked at
        "hil.fit": lambda: fit([replace(recording)], model),
    }
    times: dict[str, list[tuple[float, float]]] = {k: [] for k in calls}
    for _ in range(1 + repeats):
        for peer, call in calls.items():
            times[peer].append(peers.timed(call))
    errors = {
        REFERENCE: peers.heldout_of_reference(peers.reference(train), test),
        "hil.fit": peers.heldout_of_fit(fit([recording], model), test),
    }
    cpu, wall = ({k: median(x[c] for x in t[1:]) for k, t in times.items()} for c in (0, 1))
    return [
        Row(k, data, cpu[k], wall[k], cpu[k] / cpu[REFERENCE], tuple(errors[k] / arm.NOISE))
        for k in calls
    ]


def _figaroh(
    folder: Path, train: arm.Data, test: arm.Data, data: str, repeats: int, python: str,
    reference: float,
) -> Row:  # fmt: skip
    (folder / "arm.urdf").write_text(arm.urdf(), encoding="utf-8")
    np.savez(folder / "train.npz", **vars(train))
    np.savez(folder / "test.npz", **vars(test))
    found = peers.figaroh(folder, repeats, python)
    if isinstance(found, str):
        return Row("FIGAROH", data, np.nan, np.nan, np.nan, (), found)
    cpu, wall = median(found["seconds"]), median(found["wall"])
    ratio = tuple(float(x) / arm.NOISE for x in found["rms"])
    note = f"and {found['import']:.1f} s to import"
    return Row(f"FIGAROH {found['version']}", data, cpu, wall, cpu / reference, ratio, note)


def _diagnoses(
    folder: Path, train: arm.Data, test: arm.Data, data: str, repeats: int, reference: float
) -> list[Row]:
    """From the file to the report, judged on fifths of the recording or on the other one."""
    paths = [str(folder / f"{name}.mcap") for name in ("train", "test")]
    for path, run_ in zip(paths, (train, test), strict=True):
        write_recordings(path, [run_.recording(Path(path).stem)])
    rows = []
    for peer, used in (("hil diagnose", paths[:1]), ("hil diagnose --holdout", paths)):
        found = _oneshot(folder, repeats, used)
        cpu, wall = median(found["seconds"]), median(found["wall"])
        note = f"{found['candidates']} candidates, {found['rungs']} models: {found['verdict']}"
        rows.append(Row(peer, data, cpu, wall, cpu / reference, tuple(found["ratio"]), note))
    return rows


def _oneshot(
    folder: Path, repeats: int, paths: list[str], limits: dict[str, str] = peers.ONE_THREAD
) -> dict[str, Any]:
    words = ["-m", "hil.bench.oneshot", str(repeats), str(folder / "report.html"), *paths]
    return peers.child(words, limits=limits)


def _length(folder: Path, seconds: float, stribeck: bool) -> Length:
    """One diagnosis of a recording, with the missing effect or without: time and peak memory."""
    path = str(folder / "long.mcap")
    write_recordings(path, [arm.simulate(seconds, 1, stribeck).recording("long")])
    # a long recording gets as many threads as a user's would
    found = _oneshot(folder, 0, [path], {"OPENBLAS_NUM_THREADS": "1"})
    times, peak = (found["seconds"][0], found["wall"][0]), found["peak"] / 2**20
    return Length(seconds, *times, peak, found["verdict"], DATA[stribeck])
