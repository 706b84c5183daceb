"""`hil export`: a model for another program, refitted within what that can express.

Of a session it writes the samples as a table of text.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from hil import outputs, terminal, work
from hil.commands import common
from hil.errors import ConfigError
from hil.export import target
from hil.export.target import Job, Made
from hil.models import catalogue
from hil.record.bags import is_bag
from hil.record.mcap_read import arms
from hil.record.sources import find, load_sources
from hil.userfile import write_text

EXAMPLE = "hil export arm.toml --to mjcf -o arm.xml --data run1.mcap --holdout run2.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("model", metavar="M.toml", help="model file, or a session for --to csv")
    parser.add_argument(
        "--to",
        required=True,
        metavar="TARGET",
        choices=[*target.names(), _TABLE],
        help=f"{_told()}; {_TABLE}: the samples of a session as a table, one per arm",
    )
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="write it here")
    parser.add_argument(
        "--data",
        action="append",
        nargs="+",
        default=[],
        metavar="S.mcap",
        help="sessions to refit to; without, the values are only translated",
    )
    common.add_holdout(parser)
    common.add_sources(parser)
    common.add_tables(parser)
    parser.add_argument("--arm", help="arm of the session, e.g. follower")
    parser.add_argument(
        "--feasible",
        action="store_true",
        help="if no real body has these masses or inertias, take the nearest feasible ones",
    )
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def _told() -> str:
    rows = "; ".join(f"{name}: {target.get(name).what}" for name in target.names())
    return rows.replace("%", "%%")


def run(args: argparse.Namespace) -> int:
    """Refit, write, and print errors before and after and what is lost; or write a table."""
    if args.to == _TABLE:
        return _tables(args)
    if args.model.lower().endswith(".mcap"):
        raise ConfigError(f"--to {args.to} takes a model, and {args.model} is a session; --to csv")
    paths, others = find(s for group in args.data for s in group), find(args.holdout)
    if args.holdout and not paths:
        raise ConfigError("--holdout judges a refit, which needs --data; give the sessions to fit")
    kind, place = target.get(args.to), Path(args.output)
    outputs.check(place, kind.ending, [args.model, *paths, *others], _ours, "an export of hil")
    catalogue.load_installed()
    model = common.model_file(args.model)
    arm = args.arm or model.arm or None
    choice = replace(common.bag_choice(args), described=model.robot.urdf)
    runs, held = load_sources(paths, others, arm, choice)
    if runs and not (model.robot.preset or model.robot.urdf):
        model = replace(model, robot=runs[0].robot)
    job = Job(model, Path(args.model), place.stem, runs, held, args.feasible)
    work.at("refit within the target", 0.0)
    made = kind.make(job)
    written = [place.with_suffix(ending) for ending in made.texts]
    for path in written[1:]:
        outputs.check(path, path.suffix, [args.model, *paths, *others], _ours, "an export of hil")
    for path, text in zip(written, made.texts.values(), strict=True):
        with outputs.writing(path):
            write_text(path, text)
    if args.json:
        terminal.emit(as_dict(made, written))
    else:
        terminal.out(text_of(made, written))
    return 0


#: The target that takes a session.
_TABLE = "csv"


def _tables(args: argparse.Namespace) -> int:
    """Samples of a session as text, a file an arm."""
    if args.data or args.holdout:
        raise ConfigError(
            "--to csv writes the samples of a session; --data and --holdout refit a model"
        )
    source, place = Path(args.model), Path(args.output)
    if source.suffix.lower() == ".toml":
        raise ConfigError(f"--to csv takes a session, and {source} is a model; give S.mcap")
    names = [args.arm] if args.arm or is_bag(source) else list(arms(source))
    made = {n: place if len(names) == 1 else place.with_stem(f"{place.stem}-{n}") for n in names}
    for path in made.values():
        outputs.check(path, f".{_TABLE}", [source], _ours, "an export of hil")
    for name, path in made.items():
        (run,), _ = load_sources([source], [], name, common.bag_choice(args))
        with outputs.writing(path), path.open("w", encoding="utf-8", newline="") as file:
            file.write(f"# written by hil export: arm {run.arm} of {source.name}, SI units, ")
            file.write(f"joints {', '.join(run.joints)}\n")
            table = run.columns()
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(table)
            rows.writerows(np.stack(list(table.values()), axis=1).tolist())
    if args.json:
        terminal.emit(
            {
                "schema": "hil.export/1",
                "files": [str(path) for path in made.values()],
                "held_out": [],
                "lost": [],
                "notes": [],
            }
        )
    else:
        terminal.out("\n".join(f"written: {path}" for path in made.values()))
    return 0


#: What stands in the first lines of every export.
_SIGNS = ("written by hil export", "# Model card: ")
_HEAD = 2000


def _ours(path: Path) -> bool:
    """Whether a file is an export of hil, or empty."""
    with path.open("rb") as file:
        head = file.read(_HEAD).decode("utf-8", "replace")
    return not head.strip() or any(sign in head for sign in _SIGNS)


def text_of(made: Made, written: list[Path]) -> str:
    """The answer for a terminal."""
    lines = []
    if made.steps:
        joints = made.steps[0].result.problem.joints
        rows = [(s.label, [[f"{x:.2f}" for x in s.heldout.relative]]) for s in made.steps]
        lines += [terminal.of_joints("held-out error", joints, rows), ""]
    lines += [f"  lost: {x}" for x in made.lost]
    lines += [f"  {x}" for x in made.notes]
    if lines:
        lines.append("")
    return "\n".join([*lines, *(f"written: {path}" for path in written)])


def as_dict(made: Made, written: list[Path]) -> dict[str, object]:
    """The same as JSON."""
    joints = made.steps[0].result.problem.joints if made.steps else ()
    return {
        "schema": "hil.export/1",
        "files": [str(path) for path in written],
        "held_out": [
            {
                "model": s.label,
                "relative": dict(zip(joints, map(float, s.heldout.relative), strict=True)),
            }
            for s in made.steps
        ],
        "lost": list(made.lost),
        "notes": list(made.notes),
    }
