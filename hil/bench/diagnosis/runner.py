"""All cases in several processes; results line by line, so that a run can be resumed."""

from __future__ import annotations

import json
import multiprocessing
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hil.bench.diagnosis import amplitudes, cases, judge, session, testcases
from hil.errors import DataError
from hil.identify.parallel import alone

Row = dict[str, Any]


def read(path: Path) -> list[Row]:
    """Rows of an earlier run; a last line that a killed run left half is passed over."""
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = []
    for k, line in enumerate(lines):
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError as error:
            if k + 1 < len(lines):
                raise DataError(f"{path}, line {k + 1}: not a result of this benchmark") from error
    return rows


def run(
    todo: Sequence[Any], jobs: int, path: Path | None,
    work: Callable[[Any], Row] = judge.judge, key: str = "case",
) -> list[Row]:  # fmt: skip
    """Rows of `todo`, those in `path` not done again; new ones are appended to it.

    Parameters
    ----------
    todo : sequence
        Cases, or other things with a name.
    jobs : int
        Processes.
    path : Path or None
        File of the rows.
    work : callable
        Makes the row of one of them.
    key : str
        Where a row has the name.
    """
    done = {r[key]: r for r in (read(path) if path else [])}
    left = [c for c in todo if c.name not in done]
    if path and path.is_file() and not path.read_bytes().endswith(b"\n"):
        path.write_text("".join(json.dumps(r) + "\n" for r in done.values()), encoding="utf-8")
    made_by = revision()
    for row in spread(work, left, jobs, "session"):
        row["revision"] = made_by
        done[row[key]] = row
        if path:
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    return [done[c.name] for c in todo]


def spread(
    work: Callable[[Any], Any], todo: list[Any], jobs: int, unit: str
) -> Iterator[Any]:  # fmt: skip
    """Results of `work` in any order, with progress on stderr: a bar, or in a file ten lines."""
    terminal = sys.stderr.isatty()
    bar = tqdm(total=len(todo), unit=unit, disable=not terminal)
    with bar, multiprocessing.get_context("spawn").Pool(max(1, min(jobs, len(todo) or 1))) as pool:
        for k, result in enumerate(pool.imap_unordered(partial(_alone, work), todo), 1):
            bar.update()
            if not terminal and 10 * k // len(todo) > 10 * (k - 1) // len(todo):
                sys.stderr.write(f"{k} of {len(todo)} {unit}s\n")
            yield result


def _alone(work: Callable[[Any], Any], thing: Any) -> Any:
    """One of several processes: the others have the other processors."""
    with alone():
        return work(thing)


def revision() -> str:
    """Revision of the source tree, ``-dirty`` where files differ from it."""
    words = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()


def _calibrated(key: tuple[str, int, str, str]) -> tuple[str, list[float]]:
    return amplitudes.name(*key), amplitudes.calibrate(*key)


def keys(plant: str) -> list[tuple[str, int, str, str]]:
    """Effect, joint, robot and excitation of every amplitude that a plan needs."""
    if plant == "test":
        every = testcases.plan(seeds=cases.SEEDS)
        return sorted({(h.effect, h.joint, c.robot, c.excitation) for c in every for h in c.hidden})
    return [
        (effect, joint, robot, excitation)
        for effect, (needs, *_) in session.kinds().items()
        for robot, joint in (("arm", 0), ("arm", 1), ("arm", 2), ("axis", 0))
        for excitation in cases.EXCITATIONS
        if robot == "arm" or not needs
    ]


def calibrate(plant: str, jobs: int, todo: list[tuple[str, int, str, str]] | None = None) -> None:
    """Find the amplitudes of `todo` (all of a plant's) and write them to its file."""
    known = amplitudes.table(plant) if todo is not None else {}
    work = keys(plant) if todo is None else todo
    found = dict(sorted((known | dict(spread(_calibrated, work, jobs, "effect"))).items()))
    lines = [f"{json.dumps(k)}: {json.dumps(v)}" for k, v in found.items()]
    Path(amplitudes.__file__).with_name(amplitudes.FILES[plant]).write_text(
        "{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8"
    )


if __name__ == "__main__":
    for plant in sys.argv[1:] or amplitudes.FILES:
        calibrate(plant, 2)
