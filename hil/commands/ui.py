"""`hil ui`: the operator's page of a rig: commands, forces, tracking, health of the loop.

What the page draws beside the plots: arms in space, and the margin of the gains in force.

Both are computed in the page's program, from what the session shows; the loop knows of neither.
"""

from __future__ import annotations

import argparse
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hil import outputs, registry, terminal
from hil.commands.common import add_page, tell_page
from hil.commands.run import add_rearm
from hil.errors import ConfigError, HilError
from hil.models.robots import bare_robot
from hil.report.data import rounded
from hil.rig.config import RigConfig, load_rig, robot_source
from hil.teleop import gate, law_parameters
from hil.toml import parse
from hil.ui.desk import Desk
from hil.web.site import LOOPBACK, Hosts, serve_until_interrupt, site

EXAMPLE = "hil ui teleop -o sessions"
#: How often the page that commands is looked after [s].
_WATCHED = 0.2
#: Law -> the loops of its axes, for margins.
LOOPS: dict[str, Callable[[Any], list[Any]]] = {"lawrence": law_parameters.loops_of}


class Scene:
    """Places of the arms and margins of the law of one rig.

    Parameters
    ----------
    config : RigConfig
        The rig.

    Attributes
    ----------
    gel : dict or None
        What an arm presses into: its ``arm``, the ``centre`` of its surface and its ``size`` along
        x, y and down [m], in the base frame of the arm.
    """

    def __init__(self, config: RigConfig) -> None:
        self._config = config
        self._robots = {name: _robot(config, name) for name in config.controller.arms}
        self.gel = _gel(config, self._robots)
        self._lock = threading.Lock()
        self._asked: Any = None
        self._margin: dict[str, Any] = {"level": "", "text": "", "axes": []}
        self._busy = False

    def arms(self, session: Mapping[str, Any]) -> dict[str, Any]:
        """Points of every arm from its base to its tip [m], in its base frame."""
        out = {}
        for name, arm in session.get("arms", {}).items():
            robot = self._robots.get(name)
            if robot is None or not hasattr(robot, "places") or None in arm["position"]:
                continue
            places = robot.places(np.array(arm["position"], dtype=np.float64))
            out[name] = [[rounded(float(x), 5) for x in row] for row in places]
        return out

    def joints(self) -> list[dict[str, str]]:
        """Names of the joints of the first arm, with the units of positions and efforts."""
        arm = self._config.controller.arms[0]
        names = self._config.arms[arm].joints
        known = getattr(self._robots[arm], "units", ("rad",) * len(names))
        each = zip(names, known, strict=True)
        return [{"name": n, "unit": u, "effort": "N" if u == "m" else "N m"} for n, u in each]

    def margin(self, session: Mapping[str, Any]) -> dict[str, Any]:
        """Margin of the gains in force; computed beside, the last one until it is there."""
        law = self._config.controller.name
        if law not in LOOPS:
            text = f"No margin is computed for the law {law!r}, only for 'lawrence'."
            return {"level": "", "text": text, "axes": []}
        asked = _parameters(self._config, law, session.get("values") or {})
        with self._lock:
            if asked != self._asked and not self._busy:
                self._asked, self._busy = asked, True
                threading.Thread(target=self._compute, args=(law, asked), daemon=True).start()
            return self._margin | {"busy": self._busy}

    def _compute(self, law: str, asked: Any) -> None:
        try:
            found = margins_of(law, asked, self._config.loop.period_ns * 1e-9)
        except HilError as error:
            found = {"level": "bad", "text": str(error), "axes": []}
        with self._lock:
            self._margin, self._busy = found, False


def _parameters(config: RigConfig, law: str, values: Mapping[str, list[float]]) -> Any:
    """Parameters of a law with what an operator set; equal where the law is the same."""
    kind = registry.load("hil.controllers", law).Config
    now = parse(kind, config.controller.parameters, "controller.parameters")
    set_ = {n: tuple(v) if isinstance(getattr(now, n), tuple) else v[0] for n, v in values.items()}
    return replace(now, **set_)


def margins_of(law: str, parameters: Any, period: float) -> dict[str, Any]:
    """Margins of the axes of a law.

    Parameters
    ----------
    law, parameters : str, object
        The law and its parameters.
    period : float
        Of the loop [s].
    """
    found = [gate.axis_margins(loop, period) for loop in LOOPS[law](parameters)]
    worst = max(found, key=lambda m: m.radius)
    delay = min(m.delay_s for m in found)
    stable = delay > 0.0
    borne = "with any delay" if np.isinf(delay) else f"with up to {1e3 * delay:.3g} ms of delay"
    text = (
        f"Stable with all declared operators and environments, {borne}."
        if stable
        else f"Unstable on axis {worst.axis}: {worst.pair}."
    )
    return {
        "level": "good" if stable else "bad",
        "text": text,
        "axes": [
            {
                "axis": m.axis,
                "radius": rounded(m.radius, 6),
                "delay_ms": rounded(1e3 * m.delay_s, 3),
            }
            for m in found
        ],
    }


def _gel(config: RigConfig, robots: Mapping[str, Any]) -> dict[str, Any] | None:
    """The gel that the rig file declares, else that of the simulation; None without any.

    A simulated one is an endless plane under the place where its arm begins; a block of the usual
    size under that place is drawn.
    """
    declared, table = config.gel, config.simulation.get("gel", {})
    if declared.arm:
        return {"arm": declared.arm, "centre": [*declared.centre], "size": [*declared.size]}
    arm, below = table.get("arm"), table.get("below_home")
    robot, home = robots.get(arm), config.simulation.get("home")
    if (
        robot is None
        or not hasattr(robot, "places")
        or not isinstance(below, int | float)
        or not home
    ):
        return None
    x, y, z = robot.places(np.array(home, dtype=np.float64))[-1]
    centre = [rounded(float(v), 5) for v in (x, y, z - below)]
    return {"arm": arm, "centre": centre, "size": [*declared.size]}


def _robot(config: RigConfig, name: str) -> Any:
    """Robot of an arm; None where it has no geometry that is known here."""
    table = config.arms[name]
    try:
        return bare_robot(robot_source(table), tuple(table.joints))
    except HilError:
        return None


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("rig", metavar="RIG.toml", help="rig file")
    parser.add_argument(
        "-o",
        "--output",
        default=".",
        metavar="FOLDER",
        help="where sessions are written, made if it does not exist (default: here)",
    )
    parser.add_argument(
        "--seconds", type=float, default=3600.0, help="longest session [s] (default 3600)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulation (default 0)")
    add_page(parser, LOOPBACK)
    add_rearm(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C; a session that runs is ended properly."""
    config, folder = load_rig(args.rig), outputs.make_folder(args.output)
    # a page is for people: time is real
    words = [args.rig, "--clock", "real", "--seconds", f"{args.seconds:g}"]
    words += ["--seed", str(args.seed), *(["--rearm"] if args.rearm else [])]
    desk = Desk(words, lambda: _next(folder, config.name))
    token = secrets.token_urlsafe(24)
    done = threading.Event()
    threading.Thread(target=_watch, args=(desk, done), daemon=True).start()

    app = desk_application(desk, token, config.name, Scene(config), Hosts(args.host))

    def told(here: str, there: str) -> None:
        power = "can move the arms"
        tell_page("The operator's page", here, there, power, not args.no_browser)
        terminal.out("Ctrl-C ends the page and the session")

    try:
        serve_until_interrupt(app, args.host, args.port, told, token)
    finally:
        done.set()
        desk.close()
    return 0


def desk_application(
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
