"""What the page draws beside the plots: arms in space, and the margin of the gains in force.

Both are computed in the page's program, from what the session shows; the loop knows of neither.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hil import registry
from hil.errors import HilError
from hil.models.robots import bare_robot
from hil.report.data import rounded
from hil.rig.config import RigConfig, robot_source
from hil.teleop import gate, law_parameters
from hil.toml import parse

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
            text = f"No margin is computed for the law {law!r}; that of 'lawrence' is."
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
    found = [gate.margins(loop, period) for loop in LOOPS[law](parameters)]
    worst = max(found, key=lambda m: m.radius)
    delay = min(m.delay_s for m in found)
    stable = delay > 0.0
    borne = "no delay matters" if np.isinf(delay) else f"{1e3 * delay:.3g} ms of delay are borne"
    text = (
        f"Stable with all declared operators and environments; {borne}."
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
