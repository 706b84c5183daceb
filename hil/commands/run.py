"""`hil run`: run a session of a rig and record it."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hil import app
from hil.commands import outputs
from hil.config import RigConfig, load_rig
from hil.errors import ConfigError
from hil.excite import files

HELP = "run a session of a rig and record it"
EXAMPLE = "hil run rigs/teleop.toml --clock lockstep --seconds 10 -o s.mcap"
#: A short trajectory is repeated to fill about this time [s].
MEASURED = 30.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("rig", metavar="RIG.toml", help="rig file")
    parser.add_argument(
        "-o", "--output", required=True, metavar="S.mcap",
        help="session to write; a session that is there is kept under another name",
    )  # fmt: skip
    parser.add_argument(
        "--trajectory", metavar="TRAJ.toml",
        help="motion to play, from 'hil excite'; the rig's controller must be joint-tracking",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=float,
        help="length [s]; default: of the rig file, or once through the trajectory",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulation (default 0)")
    parser.add_argument(
        "--clock", choices=("real", "lockstep"),
        help="real time, or virtual time as fast as it goes; default: of the rig file",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="summary as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Run the session and print what it turned out to be."""
    config = load_rig(args.rig, _played(args))
    if args.seed < 0:
        raise ConfigError(f"--seed {args.seed}: a number from 0 on is needed.")
    outputs.check(args.output, ".mcap", [args.rig, *([args.trajectory] if args.trajectory else [])])
    outputs.keep_old(Path(args.output))
    summary = _with_bar(config, args)
    if args.json:
        sys.stdout.write(json.dumps(summary.as_dict()) + "\n")
    else:
        sys.stdout.write(table(summary) + "\n")
    return 0


def _played(args: argparse.Namespace) -> dict[str, Any]:
    """Tables that --trajectory puts over the rig file: the motion, and once through it."""
    if not args.trajectory:
        return {}
    period = files.read(args.trajectory).period
    return {
        "controller": {"parameters": {"trajectory": args.trajectory}},
        # a second before it to go to its start
        "loop": {"seconds": period * max(1, round(MEASURED / period)) + 1.0},
    }


def _with_bar(config: RigConfig, args: argparse.Namespace) -> app.Summary:
    seconds = config.loop.seconds if args.seconds is None else args.seconds
    total = round(seconds * config.loop.rate_hz)
    with tqdm(total=total, unit="tick", disable=None, leave=False, file=sys.stderr) as bar:
        return app.run(config, args.seconds, args.seed, args.clock, args.output, bar.update)


def table(summary: app.Summary) -> str:
    """Closing table of a session."""
    speed = summary.seconds / max(summary.wall_seconds, 1e-9)
    rows = [
        ("session", summary.path),
        ("clock", f"{summary.clock}, seed {summary.seed}"),
        ("ticks", f"{summary.ticks} in {summary.seconds:.3f} s"),
        ("wall time", f"{summary.wall_seconds:.2f} s ({speed:.1f} x real time)"),
        ("missed deadlines", str(summary.missed)),
        ("longest tick", _longest(summary)),
        ("limited commands", str(summary.limited)),
        ("rows dropped", str(summary.dropped)),
    ]
    return "\n".join(f"{name:<17} {value}" for name, value in rows)


def _longest(summary: app.Summary) -> str:
    if summary.clock == "lockstep":
        return "no time passes within a tick"
    return f"{summary.longest_tick_us:.0f} us"
