"""`hil studio`: compare, see where the model fails, add what is missing, by mouse."""

from __future__ import annotations

import argparse
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil import terminal
from hil.commands import common
from hil.errors import ConfigError, DataError
from hil.record.table_files import FORMATS, ending
from hil.studio.intake import TEMPLATE
from hil.studio.workbench import Inputs
from hil.studio.worker import Worker
from hil.web.site import LOOPBACK, Hosts, serve, site

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
    runs, held, model = common.load(args)
    named = tuple(args.sessions), tuple(args.holdout)
    return Inputs(tuple(runs), tuple(held), model, *named, args.model or "", args.arm or ""), ""


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    worker, token = Worker(*_begin(args)), secrets.token_urlsafe(24)
    app = application(worker, token, Hosts(args.host), Path.cwd())

    def told(here: str, there: str) -> None:
        power = "can read and write files here, and run programs with your rights"
        common.tell_page("The studio", here, there, power, not args.no_browser)
        terminal.out("Ctrl-C ends it; models are saved on request only")

    worker.ask("start", {})
    try:
        serve(app, args.host, args.port, told, token)
    finally:
        worker.close()
    return 0


#: Files of the page.
OWN = ("studio.js", "studio.css", "page.js", "intake.js")


def application(worker: Worker, token: str, hosts: Hosts, folder: Path | None = None) -> Any:
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
    return site("hil.studio", OWN, questions, requests, token, hosts, folder)
