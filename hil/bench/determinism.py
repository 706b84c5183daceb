"""One lockstep session by several interpreters: the same bytes, or the first difference."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from hil import terminal
from hil.errors import ConfigError
from hil.record.difference import Difference, first_difference
from hil.rigs import rig_path
from hil.terminal import Found

#: Packages whose versions decide about the last bit of a number.
_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "pin", "mcap", "zstandard")
RIGS = ("teleop", "identify", "mechanical-operator", "lawrence")
_ASK = (
    "import json, platform; from importlib.metadata import version;"
    f"print(json.dumps([platform.python_version(), [version(n) for n in {_PACKAGES!r}]]))"
)


@dataclass(frozen=True)
class Same:
    """A session of one interpreter beside that of the first.

    Parameters
    ----------
    rig : str
        Rig file.
    python : str
        Version.
    packages : dict of str to str
        Versions.
    difference : Difference or None
        The first one; None: the same bytes.
    """

    rig: str
    python: str
    packages: dict[str, str]
    difference: Difference | None


def compare_interpreters(pythons: Sequence[str], seconds: float, seed: int = 1) -> list[Same]:
    """Run every rig on every interpreter; the first of `pythons` is what the others are held to.

    Raises
    ------
    ConfigError
        If an interpreter cannot be run or lacks this package.
    """
    told = {python: _versions(python) for python in pythons}
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for rig in RIGS:
            paths = [
                _record(p, rig, seconds, seed, Path(folder) / f"{rig}{k}.mcap")
                for k, p in enumerate(pythons)
            ]
            for python, path in zip(pythons, paths, strict=True):
                found.append(Same(rig, *told[python], first_difference(paths[0], path)))
    return found


def _versions(python: str) -> tuple[str, dict[str, str]]:
    version, packages = json.loads(_run([python, "-c", _ASK]))
    return version, dict(zip(_PACKAGES, packages, strict=True))


def _record(python: str, rig: str, seconds: float, seed: int, path: Path) -> Path:
    words = ["run", str(rig_path(rig)), "--clock", "lockstep", "--seed", str(seed)]
    _run([python, "-m", "hil.cli", *words, "--seconds", str(seconds), "-o", str(path)])
    return path


def _run(words: Sequence[str]) -> str:
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except OSError as error:
        raise ConfigError(f"cannot run {words[0]}: {error.strerror}") from error
    if done.returncode != 0:
        why = (done.stderr.strip() or "no message").splitlines()[-1]
        raise ConfigError(f"{words[0]} cannot run a session: {why}; install this package there")
    return done.stdout


_HEAD = ("rig", "Python", "libraries", "against the first")


def rows(found: Sequence[Same]) -> list[list[str]]:
    """Cells of the table."""
    first = found[0].packages
    cells = []
    for s in found:
        other = [f"{n} {v}" for n, v in s.packages.items() if s is found[0] or v != first[n]]
        verdict = "the same bytes" if s.difference is None else str(s.difference)
        cells.append([s.rig, s.python, ", ".join(other) or "the same", verdict])
    return cells


def page(found: Sequence[Same], command: str) -> str:
    """Page for the documentation."""
    same = sum(s.difference is None for s in found)
    return "\n".join(
        [
            "# One session by several interpreters",
            "",
            f"Printed by `{command}`, each PYTHON an interpreter that has this package; "
            "sessions in",
            "lockstep, each recorded in a process of its own, compared to the byte.",
            "",
            "| " + " | ".join(_HEAD) + " |",
            "|" + "---|" * len(_HEAD),
            *("| " + " | ".join(r) + " |" for r in rows(found)),
            "",
            f"{same} of {len(found)} sessions have the bytes of the first interpreter's.",
            "",
        ]
    )


def command(args: argparse.Namespace) -> Found:
    """Lockstep sessions by several Pythons: the same bytes, or the first difference."""
    terminal.check_page(args.report)
    found = compare_interpreters([sys.executable, *args.python], args.seconds)
    others = " --python PYTHON" * len(args.python)
    terminal.write_page(
        args.report,
        page(found, f"hil bench determinism --seconds {args.seconds:g}{others}"),
    )
    text = terminal.table(list(_HEAD), rows(found))
    return text, {"sessions": [asdict(s) for s in found]}
