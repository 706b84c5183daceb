"""`hil ui`: the operator's page of a rig: commands, forces, tracking, health of the loop."""

from __future__ import annotations

import argparse
import secrets
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil import terminal
from hil.commands.common import add_page, tell_page
from hil.commands.run import add_rearm
from hil.errors import ConfigError
from hil.rig.config import load_rig
from hil.ui.desk import Desk
from hil.ui.scene import Scene
from hil.web.site import LOOPBACK, Hosts, serve, site

EXAMPLE = "hil ui teleop -o sessions"
#: How often the page that commands is looked after [s].
_WATCHED = 0.2


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("rig", metavar="RIG.toml", help="rig file")
    parser.add_argument(
        "-o", "--output", default=".", metavar="FOLDER", help="where sessions are written"
    )
    parser.add_argument(
        "--seconds", type=float, default=3600.0, help="longest session [s] (default 3600)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulation (default 0)")
    add_page(parser, LOOPBACK)
    add_rearm(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C; a session that runs is ended properly."""
    config, folder = load_rig(args.rig), Path(args.output)
    if not folder.is_dir():
        raise ConfigError(f"--output {folder}: no such folder; make it first")
    # a page is for people: time is real
    words = [args.rig, "--clock", "real", "--seconds", f"{args.seconds:g}"]
    words += ["--seed", str(args.seed), *(["--rearm"] if args.rearm else [])]
    desk = Desk(words, lambda: _next(folder, config.name))
    token = secrets.token_urlsafe(24)
    done = threading.Event()
    threading.Thread(target=_watch, args=(desk, done), daemon=True).start()

    app = application(desk, token, config.name, Scene(config), Hosts(args.host))

    def told(here: str, there: str) -> None:
        power = "can move the arms"
        tell_page("The operator's page", here, there, power, not args.no_browser)
        terminal.out("Ctrl-C ends the page and the session")

    try:
        serve(app, args.host, args.port, told, token)
    finally:
        done.set()
        desk.close()
    return 0


def application(
    desk: Desk, token: str, rig: str, scene: Scene | None = None, hosts: Hosts | None = None
) -> Any:
    """ASGI application of the operator's page.

    Parameters
    ----------
    desk : Desk
        Session and its commands.
    token : str
        As `hil.web.site.site`.
    rig : str
        Name of the rig.
    scene : Scene, optional
        What is drawn of it.
    hosts : Hosts, optional
        As `hil.web.site.site`; without, this machine alone.
    """

    def page(given: Mapping[str, Any]) -> str:
        name = given.get("page")
        if not isinstance(name, str) or not 8 <= len(name) <= 64:
            raise ConfigError("a page has a name of 8 to 64 characters")
        return name

    def view(given: Mapping[str, Any]) -> dict[str, Any]:
        seen = desk.view(page(given), time.monotonic()) | {"rig": rig}
        if scene is not None:
            session = seen["session"]
            seen |= {"places": scene.arms(session), "margin": scene.margin(session)}
            seen |= {"joints": scene.joints(), "gel": scene.gel}
        return seen

    def take(given: Mapping[str, Any]) -> dict[str, Any]:
        desk.take(page(given), time.monotonic())
        return {}

    def begin(given: Mapping[str, Any]) -> dict[str, Any]:
        desk.begin(page(given), time.monotonic())
        return {}

    def command(given: Mapping[str, Any]) -> dict[str, Any]:
        return desk.command(page(given), given, time.monotonic())

    requests = {"take": take, "begin": begin, "command": command}
    own = ("ui.js", "ui.css", "space.js")
    return site("hil.ui", own, {"view": view}, requests, token, hosts or Hosts())


def _watch(desk: Desk, done: threading.Event) -> None:
    while not done.wait(_WATCHED):
        desk.watch(time.monotonic())


def _next(folder: Path, name: str) -> Path:
    """File of the next session: the rig's name and the time of day, free."""
    stamp = time.strftime("%Y%m%d-%H%M%S")
    path, k = folder / f"{name}-{stamp}.mcap", 1
    while path.exists():
        k += 1
        path = folder / f"{name}-{stamp}-{k}.mcap"
    return path
