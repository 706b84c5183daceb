"""`hil studio`: compare, see where the model fails, add what is missing, by mouse."""

from __future__ import annotations

import argparse
import secrets
import webbrowser
from collections.abc import Mapping
from typing import Any

from hil.commands import common
from hil.studio.workbench import Inputs
from hil.studio.worker import Worker
from hil.web.site import serve, site

# The studio's page and requests, for one user on this machine.


def application(worker: Worker, token: str, hosts: list[str]) -> Any:
    """ASGI application of the studio; see `hil.web.site.site`.

    Parameters
    ----------
    worker : Worker
        Computes.
    token, hosts : str, list of str
        As `hil.web.site.site`.
    """

    def ask(given: Mapping[str, Any]) -> dict[str, int]:
        words = dict(given)
        return {"number": worker.ask(str(words.pop("verb", "")), words)}

    def cancel(_: Mapping[str, Any]) -> Any:
        worker.cancel()
        return worker.status()

    questions = {"status": lambda _: worker.status(), "state": lambda _: worker.state}
    requests = {"ask": ask, "cancel": cancel}
    return site("hil.studio", ("studio.js",), questions, requests, token, hosts)


EXAMPLE = "hil studio run1.mcap --holdout run2.mcap --model arm.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("sessions", nargs="+", metavar="S.mcap", help="sessions to fit")
    parser.add_argument(
        "--model",
        metavar="M.toml",
        help="model file; without, the base model of the session's robot",
    )
    parser.add_argument("--arm", help="arm of the session, e.g. follower")
    common.add_holdout(parser)
    common.add_sources(parser)
    parser.add_argument("--port", type=int, default=0, help="port; default: a free one")
    parser.add_argument(
        "--no-browser", action="store_true", help="print the address, and open no browser"
    )


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    runs, held, model = common.load(args)
    inputs = Inputs(
        tuple(runs),
        tuple(held),
        model,
        tuple(args.sessions),
        tuple(args.holdout),
        args.model or "",
        args.arm or "",
    )
    worker, token = Worker(inputs), secrets.token_urlsafe(24)
    app = application(worker, token, ["127.0.0.1", "localhost"])

    def told(address: str) -> None:
        common.out(f"The studio is open at {address}")
        common.out("Ctrl-C ends it; models are saved on request only")
        if not args.no_browser:
            webbrowser.open(address)

    worker.ask("start", {})
    try:
        serve(app, args.port, told, token)
    finally:
        worker.close()
    return 0
