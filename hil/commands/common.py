"""What the analysis commands share: their options, loading, and terminal output."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hil.errors import ConfigError
from hil.models.files import read_model
from hil.models.model import RobotModel, base_model
from hil.record.reader import load_all
from hil.record.recording import Recording


def add_sessions(parser: argparse.ArgumentParser, model: bool = True) -> None:
    """Options of every command that looks at sessions with a model."""
    parser.add_argument("sessions", nargs="+", metavar="S.mcap", help="sessions to fit")
    add_model(parser)
    if not model:
        return
    parser.add_argument(
        "--holdout", action="append", default=[], metavar="H.mcap",
        help="session to judge on (repeatable); without, contiguous fifths of the same sessions",
    )  # fmt: skip


def add_model(parser: argparse.ArgumentParser) -> None:
    """--model, --arm, --json."""
    parser.add_argument(
        "--model", metavar="M.toml",
        help="model file; without, the base model of the session's robot",
    )  # fmt: skip
    parser.add_argument("--arm", help="arm of the session, e.g. follower")
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def load(
    args: argparse.Namespace, sessions: Sequence[str] | None = None
) -> tuple[list[Recording], list[Recording], RobotModel]:
    """Sessions, held-out sessions and model of a command line.

    A model without a robot takes the session's; a session without a model gets the base model.
    """
    paths = list(sessions if sessions is not None else args.sessions)
    model = read_model(args.model) if args.model else None
    arm = args.arm or (model.arm if model else "") or None
    runs = load_all(paths, arm)
    held = load_all(getattr(args, "holdout", []), arm or runs[0].arm)
    if note := runs[0].metadata.get("note"):
        log(note)
    robot = runs[0].robot
    if model is None:
        model = base_model(robot, runs[0].arm)
        log(f"no --model given: base model ({' + '.join(model.names())}) of the session's robot")
    elif not (model.robot.preset or model.robot.urdf):
        model = replace(model, robot=robot)
    for path, run in zip(paths, runs, strict=True):
        model.check_joints(run.joints)
        _same_joints(path, run, runs[0])
    return _distinct(runs), _distinct(held), model


def _same_joints(path: str, run: Recording, first: Recording) -> None:
    if run.joints != first.joints:
        raise ConfigError(
            f"session {path} has the joints {', '.join(run.joints)}, the first session has "
            f"{', '.join(first.joints)}; give sessions of one robot"
        )


def _distinct(runs: list[Recording]) -> list[Recording]:
    """Runs with distinct names, for per-run parameters."""
    names = [r.name for r in runs]
    return [
        r if names.count(r.name) == 1 else replace(r, name=f"{r.name}#{k + 1}")
        for k, r in enumerate(runs)
    ]


def log(text: str) -> None:
    """One line to stderr."""
    sys.stderr.write(text + "\n")


def out(text: str) -> None:
    """Text to stdout."""
    sys.stdout.write(text + "\n")


def emit(data: dict[str, Any]) -> None:
    """JSON to stdout."""
    out(json.dumps(data, indent=2, allow_nan=False))


def writable(path: str | None, ending: str) -> None:
    """Refuse early an output without its folder or its ending, which guards inputs of other kinds.

    Raises
    ------
    ConfigError
        Before any work is done.
    """
    if path and not Path(path).resolve().parent.is_dir():
        raise ConfigError(f"cannot write {path}: its folder does not exist; make it first")
    if path and Path(path).suffix.lower() != ending:
        raise ConfigError(
            f"cannot write {path}: this output must end in {ending}; nothing was touched"
        )


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned text table; first column left, others right."""
    cells = [list(head), *map(list, rows)]
    widths = [max(len(r[k]) for r in cells) for k in range(len(head))]
    lines = [
        "  ".join(
            c.ljust(w) if k == 0 else c.rjust(w)
            for k, (c, w) in enumerate(zip(r, widths, strict=True))
        )
        for r in cells
    ]
    return "\n".join(
        ["  " + x.rstrip() for x in [lines[0], "  ".join("-" * w for w in widths), *lines[1:]]]
    )
