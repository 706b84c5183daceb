"""`hil run`: run a session of a rig and record it.

Errors in a rig file start with its name, also those that only opening it shows.
"""

from __future__ import annotations

import argparse
import contextlib
import glob
import json
import math
import re
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader
from tqdm import tqdm

from hil import outputs, terminal
from hil.commands import common, view
from hil.errors import ConfigError, HilError
from hil.excite import trajectory
from hil.interrupt import saying
from hil.record import mcap_read
from hil.rig.config import RigConfig, load_rig
from hil.rig.open import Rig, open_rig
from hil.runtime import runner
from hil.runtime.board import BoardWriter
from hil.runtime.commands import OPERATOR_COMMANDS, scheduled
from hil.toml import merge
from hil.ui import desk


@contextlib.contextmanager
def with_rig_name(path: str) -> Iterator[None]:
    """Put the name of the rig file in front of a `ConfigError`."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error.__cause__


def opener(path: str) -> Callable[[RigConfig, int], Rig]:
    """`hil.rig.open.open_rig` whose mistakes have the name of the rig file."""

    def opened(config: RigConfig, seed: int) -> Rig:
        with with_rig_name(path):
            return open_rig(config, seed)

    return opened


EXAMPLE = "hil run teleop --clock lockstep --seconds 10 -o s.mcap"
#: Exit code of a session at whose end the motors were without torque.
ENDED_PAUSED = 4
#: How long a session stays PAUSED that nobody can command any more, before it ends [s].
LEFT_ALONE = 5.0
#: A short trajectory is repeated to fill about this time [s].
_MEASURED = 30.0
_SHARES = (("p50", "p50"), ("p99", "p99"), ("p99.9", "p999"), ("most", "most"))


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("rig", metavar="RIG.toml", help="rig file")
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="S.mcap",
        help="session to write; a session that is there is kept under another name",
    )
    parser.add_argument(
        "--trajectory",
        metavar="TRAJ.toml",
        help="motion to play, from 'hil excite'; the rig's controller must be one "
        "that plays it: joint-tracking, joint-pd, computed-torque",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        help="length [s]; default: of the rig file, or once through the trajectory",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulation (default 0)")
    parser.add_argument(
        "--clock",
        choices=("real", "lockstep"),
        help="real time, or virtual time as fast as it goes; default: of the rig file",
    )
    parser.add_argument(
        "--at",
        action="append",
        default=[],
        metavar="'S COMMAND'",
        help="give a command at a time, e.g. '2.5 pause', '3 set force_scale 0.5'; repeatable",
    )
    parser.add_argument(
        "--operator",
        action="store_true",
        help=f"take commands from the terminal, a line each: {', '.join(OPERATOR_COMMANDS)}",
    )
    parser.add_argument(
        "--wait", action="store_true", help="begin without torque and wait for the command start"
    )
    parser.add_argument("--model", metavar="M.toml", help="model file to attach to the session")
    parser.add_argument(
        "--split",
        metavar="SIZE",
        help="continue in a new file after a time or size: '10 min', '90 s', '500 MB', '2 GB'",
    )
    parser.add_argument(
        "--sync",
        type=float,
        metavar="S",
        help="write to the disk at least every S seconds, for a loss of power; default: when the "
        "operating system does",
    )
    parser.add_argument(
        "--plain", action="store_true", help="no live screen: a progress bar and plain lines"
    )
    view.add_live(parser, "stream the session by the Foxglove WebSocket protocol")
    common.add_tags(parser)
    # for 'hil ui' and the live screen: shows the session; it pauses where who shows it is gone
    parser.add_argument("--board", help=argparse.SUPPRESS)
    add_rearm(parser)
    parser.add_argument("--json", action="store_true", help="summary as JSON on stdout")


def add_rearm(parser: argparse.ArgumentParser) -> None:
    """Declare --rearm."""
    parser.add_argument(
        "--rearm",
        action="store_true",
        help="start although the watchdog has cut the power of this rig before",
    )


def run(args: argparse.Namespace) -> int:
    """Run the session and print what it turned out to be; 4 where it ended PAUSED."""
    config = load_rig(args.rig, merge(_played(args), {"record": _recorded(args)}))
    if args.seed < 0:
        raise ConfigError(f"--seed {args.seed}: a number from 0 on is needed.")
    if args.seconds is not None and not 0.0 < args.seconds < math.inf:
        raise ConfigError(f"--seconds {args.seconds:g}: a length above 0 s is needed.")
    outputs.check(args.output, ".mcap", [args.rig, *([args.trajectory] if args.trajectory else [])])
    real = (args.clock or config.clock) == "real"
    if real and not (args.json or args.board or args.plain) and desk.is_terminal():
        return desk.run_behind_screen(_typed(args))
    before, began_ns = _stamp(args.output), time.time_ns()
    with saying(lambda: _broken_off(args, before, began_ns)):
        summary = _with_bar(config, args)
    # totals are in the last file, which may have been taken away as any other
    last = [path for path in (summary.path, *summary.parts) if Path(path).exists()][-1:]
    for line in (line for path in last for line in replay_differences(path)):
        sys.stderr.write(line + "\n")
    if args.json:
        sys.stdout.write(json.dumps(summary.as_dict()) + "\n")
    else:
        sys.stdout.write(_closing_table(summary) + "\n")
    return ENDED_PAUSED if summary.paused else 0


def _typed(args: argparse.Namespace) -> list[str]:
    """Words that say the same to a session behind the screen."""
    out = [args.rig, "-o", args.output, "--clock", "real", "--seed", str(args.seed)]
    for name in ("trajectory", "seconds", "model", "split", "sync", "live"):
        value = getattr(args, name)
        out += [] if value is None else [f"--{name}", str(value)]
    out += [w for text in args.at for w in ("--at", text)]
    out += [w for tag in args.tag for w in ("--tag", tag)]
    return out + [f"--{name}" for name in ("wait", "rearm") if getattr(args, name)]


def _stamp(path: str) -> tuple[int, int] | None:
    """What tells a new file at a place from the one before; None where there is none."""
    place = Path(path)
    return (place.stat().st_ino, place.stat().st_mtime_ns) if place.exists() else None


def _broken_off(args: argparse.Namespace, before: tuple[int, int] | None, began_ns: int) -> str:
    """Print what a session was that is broken off; where its record is."""
    found = records(args.output, before, began_ns)
    if not found:
        return "it had not begun to record"
    if not (args.json or args.board):
        with contextlib.suppress(OSError, HilError):
            sys.stdout.write(until_then(found))
            sys.stdout.flush()
    return f"what was recorded until then is in {', '.join(found)}"


def records(path: str, before: tuple[int, int] | None, began_ns: int) -> list[str]:
    """Files of the record of an interrupted session, all parts; those without a row go."""
    now, place = _stamp(path), Path(path)
    found = [] if now is None or now == before else [path]
    parts = place.parent.glob(f"{glob.escape(place.stem)}.part*{glob.escape(place.suffix)}")
    found += sorted(str(p) for p in parts if p.stat().st_mtime_ns > began_ns)
    kept = [name for name in found if not _without_rows(name)]
    for name in set(found) - set(kept):
        Path(name).unlink(missing_ok=True)
    return kept


def until_then(files: Sequence[str]) -> str:
    """Closing table of a session that was broken off; empty where it could not be closed.

    Parameters
    ----------
    files : sequence of str
        Its parts; the last one holds the totals.

    Raises
    ------
    DataError
        If that cannot be read.
    """
    end = mcap_read.read_metadata(files[-1]).get("end", {})
    if not end:
        return ""
    rows = [
        *(("" if k else "session", path) for k, path in enumerate(files)),
        ("clock", end["clock"]),
        ("ticks", f"{end['ticks']} in {end['seconds']} s, then {end['how']}"),
        ("missed deadlines", end["missed"]),
        ("rows dropped", f"{end['dropped']} of the ring"),
    ]
    return "".join(f"{name:<17} {value}\n" for name, value in rows)


def _without_rows(path: str) -> bool:
    """Whether a session that was closed holds no row: it ended before the first one was written."""
    with contextlib.suppress(McapError, OSError, ValueError, struct.error):
        with open(path, "rb") as file:
            told = make_reader(file).get_summary()
        if told is not None and told.statistics is not None:
            counts = told.statistics.channel_message_counts
            named = {k for k, c in told.channels.items() if c.topic.endswith("/measured_js")}
            return bool(named) and not any(counts.get(k) for k in named)
    return False  # it was not closed properly, and is not judged


def replay_differences(path: str) -> list[str]:
    """Where the drivers asked something else than in the recording that answered for a box."""
    lines = []
    for name, told in mcap_read.read_metadata(path).items():
        if name.startswith("replay/") and told["other"] != "0":
            box = name.removeprefix("replay/")
            lines.append(
                f"box {box}: {told['other']} of {told['asked']} frames sent are others than in "
                f"{told['session']}; first: {told['first']}"
            )
    return lines


def _played(args: argparse.Namespace) -> dict[str, Any]:
    """Tables that --trajectory puts over the rig file: the motion, and once through it."""
    if not args.trajectory:
        return {}
    period = trajectory.read_trajectory(args.trajectory).period
    return {
        "controller": {"parameters": {"trajectory": args.trajectory}},
        # a second before it to go to its start
        "loop": {"seconds": period * max(1, round(_MEASURED / period)) + 1.0},
    }


#: Units of --split: field of ``[record]``, and how much of its unit.
_SPLITS = {
    "s": ("split_seconds", 1.0),
    "min": ("split_seconds", 60.0),
    "h": ("split_seconds", 3600.0),
    "MB": ("split_megabytes", 1.0),
    "GB": ("split_megabytes", 1000.0),
}


def _recorded(args: argparse.Namespace) -> dict[str, Any]:
    """Table ``[record]`` of --split, --sync and --tag."""
    table: dict[str, Any] = {} if args.sync is None else {"sync": args.sync}
    table |= {"tags": args.tag} if args.tag else {}
    if args.split is None:
        return table
    found = re.fullmatch(r"\s*([0-9]+\.?[0-9]*)\s*([A-Za-z]+)\s*", args.split)
    if found is None or found[2] not in _SPLITS:
        raise ConfigError(
            f"--split {args.split!r}: a number and a unit are needed, of {', '.join(_SPLITS)}; "
            "e.g. --split '10 min'"
        )
    name, unit = _SPLITS[found[2]]
    return {**table, name: float(found[1]) * unit}


def _with_bar(config: RigConfig, args: argparse.Namespace) -> runner.Summary:
    seconds = config.loop.seconds if args.seconds is None else args.seconds
    total = round(seconds * config.loop.rate_hz)
    stream = None if args.live is None else view.Streamer(args.live)
    with tqdm(total=total, unit="tick", disable=None, leave=False, file=sys.stderr) as bar:
        live = bar.set_postfix_str if not bar.disable else None
        board = BoardWriter(args.board) if args.board else None
        lines = (lambda take: _lines(take, board is not None)) if args.operator else None
        operator = runner.Operator(
            scheduled(args.at), bar_writer(bar), live, lines, args.wait, board
        )
        # before the first tick nothing else would be said for as long as that takes
        compilation = terminal.Compilation(lambda: bar.set_description_str(terminal.COMPILES))
        compilation.watch()

        def ticked(done: int) -> None:
            if not bar.disable and bar.desc:
                bar.set_description_str("")  # drawn at once, however soon the compiler was done
            bar.update(done)

        try:
            return runner.run_session(
                config,
                args.seconds,
                args.seed,
                args.clock,
                args.output,
                ticked,
                operator,
                args.model,
                opener(args.rig),
                aside=lambda path: _aside(bar, path, stream),
                source=args.rig,
                rearm=args.rearm,
            )
        finally:
            compilation.end()
            if stream is not None:
                stream.end()


def _aside(bar: Any, path: Path, stream: view.Streamer | None) -> None:
    """Keep an old session, now that the new one will be written; have that one streamed."""
    bar.clear()
    outputs.keep_old(path)
    if stream is not None:
        stream.begin(path)
        bar_writer(bar)(f"live stream on {stream.address}, for Foxglove and Lichtblick")


def bar_writer(bar: Any) -> Callable[[str], None]:
    """Sentences for the operator, above the bar."""
    return lambda text: bar.write(f"hil run: {text}", file=sys.stderr)


def _lines(take: Callable[[str], None], shown: bool = False) -> None:
    """Give every line of the standard input to the slow side, from a thread of its own.

    A session that is `shown` by another program pauses when that is gone, and ends soon after: no
    other program can command it, and it would keep its devices.
    """

    def read() -> None:
        for line in sys.stdin:
            if line.strip():
                take(line)
        if shown:
            take("pause")
            time.sleep(LEFT_ALONE)
            take("stop")

    threading.Thread(target=read, name="operator", daemon=True).start()


def _closing_table(summary: runner.Summary) -> str:
    """Closing table of a session."""
    speed = summary.seconds / max(summary.wall_seconds, 1e-9)
    rows = [
        *(
            (
                "" if k else "session",
                path + ("" if Path(path).exists() else " (not there any more)"),
            )
            for k, path in enumerate((summary.path, *summary.parts))
        ),
        ("clock", f"{summary.clock}, seed {summary.seed}"),
        ("ticks", f"{summary.ticks} in {summary.seconds:.3f} s"),
        ("wall time", f"{summary.wall_seconds:.2f} s ({speed:.1f} x real time)"),
        ("state at the end", summary.state + (f": {summary.reason}" if summary.reason else "")),
        ("missed deadlines", str(summary.missed)),
        *_times(summary),
        ("limited commands", limited(summary.limited, summary.ticks)),
        ("hottest winding", f"{summary.figures['winding_most']:.0f} degC"),
        *([("not recorded", f"{summary.left_out} rows: record off")] if summary.left_out else []),
        ("rows dropped", f"{summary.dropped} of the ring, at most {_ring(summary)} waited"),
    ]
    return "\n".join(f"{name:<17} {value}" for name, value in rows)


#: Share of the ticks from which commands at the motors' limit are no brief bump.
_OFTEN = 0.005


def limited(count: int, ticks: int) -> str:
    """How many commands the torque limit cut, and what that means where they are many.

    Parameters
    ----------
    count, ticks : int
        Ticks with such a command, and all.
    """
    share = count / max(ticks, 1)
    if share < _OFTEN:
        return str(count)
    return (
        f"{count}, {100 * share:.1f} % of the ticks: the law asks for more than torque_limit, and "
        "does not act as designed there; lower its stiffness, or press less"
    )


def _ring(summary: runner.Summary) -> str:
    return f"{summary.figures['ring_most']:.0f}"


def _times(summary: runner.Summary) -> list[tuple[str, str]]:
    """Rows about time, which does not pass within a tick of a virtual clock."""
    if summary.clock == "lockstep":
        return [("longest tick", "no time passes within a tick")]
    f = summary.figures
    named = [
        (label, ", ".join(f"{p} {f[f'{key}_{q}']:.1f}" for p, q in _SHARES) + " us")
        for label, key in (("wake-up late", "late"), ("tick takes", "busy"))
    ]
    return [
        *named,
        ("longest gap", f"{f['longest_gap']:.0f} us between two ticks"),
        ("arranged", ", ".join(summary.granted) or "nothing was granted"),
    ]
