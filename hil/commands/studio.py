"""`hil studio`: compare, see where the model fails, add what is missing, by mouse."""

from __future__ import annotations

import argparse
import secrets
import socket
import webbrowser

from hil.commands import common
from hil.errors import ConfigError
from hil.studio.server import application
from hil.studio.workbench import Inputs
from hil.studio.worker import Worker

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
    parser.add_argument("--port", type=int, default=0, help="port; default: a free one")
    parser.add_argument(
        "--no-browser", action="store_true", help="print the address, and open no browser"
    )


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    if not 0 <= args.port <= 65_535:
        raise ConfigError(f"--port {args.port}: a number from 0 to 65535 is needed")
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
    import uvicorn

    try:
        listening = socket.create_server(("127.0.0.1", args.port))
    except OSError as error:
        raise ConfigError(
            f"--port {args.port}: {error.strerror}; choose another one, or none"
        ) from error
    address = f"http://127.0.0.1:{listening.getsockname()[1]}/?token={token}"
    common.out(f"The studio is open at {address}\nCtrl-C ends it; models are saved on request only")
    worker.ask("start", {})
    if not args.no_browser:
        webbrowser.open(address)
    config = uvicorn.Config(app, log_level="warning", lifespan="off")
    try:
        uvicorn.Server(config).run(sockets=[listening])
    finally:
        worker.close()
    return 0
