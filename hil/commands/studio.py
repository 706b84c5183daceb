"""`hil studio`: compare, see where the model fails, add what is missing, by mouse."""

from __future__ import annotations

import argparse
import secrets
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil import outputs, terminal
from hil.commands import common
from hil.errors import ConfigError, DataError
from hil.models.model import base_model
from hil.record.table_files import FORMATS, ending
from hil.revision import machine
from hil.studio.intake import TEMPLATE
from hil.studio.workbench import Inputs, Workbench
from hil.studio.worker import Worker
from hil.terminal import Found
from hil.userfile import write_text
from hil.web.site import LOOPBACK, Hosts, serve_until_interrupt, site

EXAMPLE = "hil studio run1.mcap --holdout run2.mcap --model arm.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument(
        "sessions",
        nargs="*",
        metavar="S.mcap",
        help="sessions to fit; or a table, whose "
        "columns are picked on the page; without any, files are dropped there",
    )
    parser.add_argument(
        "--model",
        metavar="M.toml",
        help="model file; without, the base model of the session's robot",
    )
    parser.add_argument("--arm", help="arm of the session, e.g. follower")
    common.add_holdout(parser)
    common.add_sources(parser)
    common.add_page(parser, LOOPBACK)


def _begin(args: argparse.Namespace) -> tuple[Inputs | None, str]:
    """Sessions and model of the command line, or the table whose columns are to be picked."""
    table = args.sessions[0] if len(args.sessions) == 1 else ""
    if table and ending(table) in FORMATS:
        if not Path(table).is_file():
            raise DataError(f"table {table}: no such file")
        return None, table
    if not args.sessions:
        for option, value in (("--model", args.model), ("--holdout", args.holdout)):
            if value:
                raise ConfigError(f"{option} goes with sessions; name them, or leave it out")
        return None, ""
    runs, held, model = common.load_inputs(args)
    named = tuple(args.sessions), tuple(args.holdout)
    return Inputs(tuple(runs), tuple(held), model, *named, args.model or "", args.arm or ""), ""


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    worker, token = Worker(*_begin(args)), secrets.token_urlsafe(24)
    app = studio_application(worker, token, Hosts(args.host), Path.cwd())

    def told(here: str, there: str) -> None:
        power = "can read and write files here, and run programs with your rights"
        common.tell_page("The studio", here, there, power, not args.no_browser)
        terminal.out("Ctrl-C ends it; models are saved on request only")

    worker.ask("start", {})
    try:
        serve_until_interrupt(app, args.host, args.port, told, token)
    finally:
        worker.close()
    return 0


#: Files of the page.
_OWN = ("studio.js", "studio.css", "page.js", "intake.js")


def studio_application(worker: Worker, token: str, hosts: Hosts, folder: Path | None = None) -> Any:
    """ASGI application of the studio; see `hil.web.site.site`.

    Parameters
    ----------
    worker : Worker
        Computes.
    token, hosts, folder : str, Hosts, Path
        As `hil.web.site.site`.
    """

    def ask(given: Mapping[str, Any]) -> dict[str, int]:
        words = dict(given)
        return {"number": worker.ask(str(words.pop("verb", "")), words)}

    def cancel(_: Mapping[str, Any]) -> Any:
        worker.cancel()
        return worker.status()

    questions = {
        "status": lambda _: worker.status(),
        "look": lambda _: worker.look,
        "state": lambda _: worker.state,
        "files": lambda _: worker.files,
        "template": lambda _: {"text": TEMPLATE, "path": "my_effects.py"},
    }
    requests = {"ask": ask, "cancel": cancel}
    return site("hil.studio", _OWN, questions, requests, token, hosts, folder)


# ------------------------------------------------------------ how long its answers take

#: Longest that an answer may take [s], by the number of joints.
ANSWER_S = {3: 1.0, 7: 3.0}


@dataclass(frozen=True)
class StudioRow:
    """How long the studio takes from *Add* to its answers, medians of some turns.

    Parameters
    ----------
    joints : int
        Joints of the recording.
    recorded : float
        Its length [s].
    first : float
        From opening it to everything that the page shows of the base model [s].
    ladder : float
        From *Add* until the ladder falls [s].
    whole : float
        From *Add* to everything, ranked candidates included [s].
    """

    joints: int
    recorded: float
    first: float
    ladder: float
    whole: float


def studio_row(d: int, seconds: float, turns: int) -> StudioRow:
    """Open a recording whose model lacks Stribeck friction, and add it, some turns.

    Parameters
    ----------
    d : int
        Joints: 3 or 7.
    seconds : float
        Length [s].
    turns : int
        Turns after one to warm up.
    """
    from hil.bench import identify  # the studio itself needs none of it

    arm = identify.ARMS[d]
    found: list[tuple[float, float, float]] = []
    for _ in range(1 + turns):
        run = identify.simulate_run(seconds, 1, True, arm).recording("run", arm)
        fell: list[float] = []
        start = time.perf_counter()
        work = Workbench(Inputs((run,), (), base_model(run.robot), ("run.mcap",)))
        work.start()
        shown = time.perf_counter()
        work.early = lambda look, fell=fell: fell.append(time.perf_counter())  # type: ignore[misc]
        work.add("stribeck", "")
        done = time.perf_counter()
        found.append((shown - start, fell[0] - shown, done - shown))
    medians = (float(np.median(x)) for x in zip(*found[1:], strict=True))
    return StudioRow(d, seconds, *medians)


def studio_text(rows: list[StudioRow]) -> str:
    """Table and goals."""
    head = ["joints", "recorded s", "first answer s", "Add: ladder s", "Add: all s", "goal s", ""]
    cells = [
        [
            str(r.joints),
            f"{r.recorded:g}",
            *(f"{x:.2f}" for x in (r.first, r.ladder, r.whole)),
            f"{ANSWER_S[r.joints]:g}",
            "met" if r.whole <= ANSWER_S[r.joints] else "missed",
        ]
        for r in rows
    ]
    return (
        f"{terminal.table(head, cells)}\n\nWall clock, median of the turns, on a {machine()}; "
        "Stribeck friction is added on all joints at once."
    )


_STUDIO_TITLE = "# Speed of the studio's answers"


def _is_studio_page(path: Path) -> bool:
    text = path.read_text(encoding="utf-8", errors="replace")
    return not text.strip() or text.startswith(_STUDIO_TITLE)


def bench(args: argparse.Namespace) -> Found:
    """How long the studio takes from *Add* to its answer, on three and on seven joints."""
    if args.turns < 1 or not 5.0 <= args.seconds <= 3600.0:
        raise ConfigError(
            f"--turns {args.turns} --seconds {args.seconds:g}: at least one turn of 5 s is needed"
        )
    outputs.check(args.report, ".md", (), _is_studio_page, "a page of this benchmark")
    rows = []
    for d in ANSWER_S:
        terminal.log(f"measuring {d} joints")
        rows.append(studio_row(d, args.seconds, args.turns))
    text = studio_text(rows)
    if args.report:
        page = f"{_STUDIO_TITLE}\n\nPrinted by `hil bench studio`.\n\n```\n{text}\n```\n"
        with outputs.writing(args.report):
            write_text(args.report, page)
    return text, {"rows": [asdict(r) for r in rows]}
