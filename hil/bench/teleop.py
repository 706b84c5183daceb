"""Teleoperation over delay on the simulated rig: drag, stiffness that arrives, and walls.

A machine moves the leader up and down by 8 mm at 1 Hz, in free space and then with the follower in
a gel; from forces and speeds at that frequency

    drag = Re(f_m / v_m) in free space,   stiffness = Re(j w f_m / v_m) in contact,

beside Re(j w f_s / v_s), what the gel is.  A hand then does the same for six seconds: is the
session still ENABLED at its end?  Nothing of the simulator is read.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import ConfigError, DeviceError, HilError
from hil.models.phantom import Premium
from hil.record.mcap_read import load
from hil.rig.config import ControllerConfig, RigConfig, load_rig
from hil.rigs import rig_path
from hil.runtime import runner

HZ, SETTLE, PERIODS, PERIOD = 1.0, 3.0, 3, 1e-3
_UP, _GEL, _ABOVE = 0.008, 400.0, -0.02
_HAND_SECONDS = 6.0


@dataclass(frozen=True)
class Link:
    """A channel, the same in both directions.

    Parameters
    ----------
    delay, jitter : float
        [s], one way.
    loss : float
        Share of the packets.
    """

    delay: float
    jitter: float = 0.0
    loss: float = 0.0

    @property
    def name(self) -> str:
        """In words."""
        extra = f" + {1e3 * self.jitter:.0f} ms, {100 * self.loss:.0f} % lost" * bool(
            self.jitter or self.loss
        )
        return f"{1e3 * self.delay:.0f} ms{extra}"


LINKS = (Link(0.0), Link(0.01), Link(0.03), Link(0.1), Link(0.3), Link(0.1, 0.05, 0.1))
#: Four channels without accelerations: c4 = -c8 and c2 = c3 = 1 are transparent at low frequencies.
FOUR: Mapping[str, Any] = {
    "c1": [250.0, 1.5, 0.0], "c2": [1.0], "c3": [1.0], "c4": [0.0, -0.3, 0.0],
    "c7": [250.0, 1.5, 0.0], "c8": [0.0, 0.3, 0.0], "force_hz": 100.0,
}  # fmt: skip
#: Disturbance observers that the cables of the rig bear.
OBSERVED: Mapping[str, Any] = {"disturbance": 1.0, "observer_hz": 5.0}
#: Laws: name, controller, parameters.
LAWS: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("position-force, share 0.5 (no protection)", "lawrence", {}),
    ("position-force, disturbance observers", "lawrence", OBSERVED),
    ("four-channel (no protection)", "lawrence", FOUR),
    ("four-channel, disturbance observers", "lawrence", {**FOUR, **OBSERVED}),
    ("passivity observer", "delayed", {"scheme": "passivity"}),
    ("wave variables", "delayed", {"scheme": "waves"}),
    ("energy tanks", "delayed", {"scheme": "tanks"}),
    ("model-mediated", "delayed", {"scheme": "model"}),
)


@dataclass(frozen=True)
class DelayRow:
    """One law over one channel.

    Parameters
    ----------
    law, link : str
        Which.
    drag : float
        Force that moving in free space takes, over speed [N s/m]; the bare arm's included.
    stiffness, environment : float
        Felt at the leader, and measured at the follower [N/m].
    hand : str
        How a hand's session in contact ended.
    why : str
        Why there is no figure.
    """

    law: str
    link: str
    drag: float = float("nan")
    stiffness: float = float("nan")
    environment: float = float("nan")
    hand: str = ""
    why: str = ""

    @property
    def share(self) -> float:
        """Share of the environment's stiffness that is felt."""
        return self.stiffness / self.environment


def config_of(
    controller: str, parameters: Mapping[str, Any], operator: Mapping[str, Any], gel: float | None
) -> RigConfig:
    """Rig with a law, an operator, and a gel above home or none."""
    below = 1.0 if gel is None else _ABOVE
    simulation = {"operator": dict(operator), "gel": {"below_home": below, "stiffness": gel}}
    config = load_rig(rig_path("lawrence"), {"simulation": simulation})
    given = dict(config.controller.parameters) if controller == "lawrence" else {}
    law = ControllerConfig(controller, config.controller.arms, {**given, **parameters})
    return dataclasses.replace(config, controller=law)


def impedances(path: Path) -> tuple[complex, complex]:
    """f_m / v_m and f_s / v_s on the vertical axis at the motion's frequency [N s/m]."""
    n, arm, found = round(PERIODS / HZ / PERIOD), Premium(()), []
    tone = np.exp(-2j * np.pi * HZ * np.arange(n) * PERIOD)
    for name, sign in (("leader", 1.0), ("follower", -1.0)):
        r = load(path, name)
        if r.wrench is None:
            raise RuntimeError("a session of this rig has forces")
        speed = np.gradient(arm.tip(r.q)[:, 2], PERIOD)[-n:]
        found.append(complex(tone @ (sign * r.wrench[-n:, 2])) / complex(tone @ speed))
    return found[0], found[1]


def row(
    law: str, controller: str, parameters: Mapping[str, Any], link: Link, folder: Path, seed: int
) -> DelayRow:
    """Three sessions of a law over a channel."""
    way = {"delay": link.delay, "jitter": link.jitter, "loss": link.loss}
    given = {**parameters, "forward": way, "backward": way, "seed": seed}
    machine = {"kind": "mechanical", "frequency": HZ, "size": [0.0, 0.0, _UP], "onset": 1.0}
    path, z = folder / "run.mcap", []
    try:
        for gel in (None, _GEL):
            config = config_of(controller, given, machine, gel)
            runner.run(config, SETTLE + PERIODS / HZ, seed, "lockstep", path).enabled()
            z.append(impedances(path))
    except (ConfigError, DeviceError, HilError) as error:
        return DelayRow(law, link.name, why=_short(error))
    (free, _), (felt, there) = z
    w = 2 * np.pi * HZ
    return DelayRow(
        law,
        link.name,
        free.real,
        (1j * w * felt).real,
        (1j * w * there).real,
        _by_hand(controller, given, path, seed),
    )


def _by_hand(controller: str, given: Mapping[str, Any], path: Path, seed: int) -> str:
    """State in which a hand's session in contact ended."""
    config = config_of(controller, given, {"kind": "hand", "arm": "leader"}, _GEL)
    try:
        return runner.run(config, _HAND_SECONDS, seed, "lockstep", path).state
    except DeviceError:
        return "FAULT"


def _short(error: HilError) -> str:
    """What an error comes to, for a cell."""
    if isinstance(error, ConfigError):
        return "refused: not stable"
    return "FAULT" if "FAULT" in str(error) else "PAUSED"


#: Dampings of the virtual wall [N s/m], and stiffnesses that are tried [N/m].
WALL_DAMPING = (0.0, 0.5, 1.0, 1.5)
WALL_STIFFNESS = (100.0, 200.0, 400.0, 700.0, 1000.0, 1400.0, 2000.0, 2800.0, 4000.0)
#: Speed beyond which a tip that a hand presses against a wall vibrates: rms above 10 Hz [m/s].
_VIBRATES = 0.02


@dataclass(frozen=True)
class WallRow:
    """Stiffest wall at one damping.

    Parameters
    ----------
    damping : float
        Of the wall [N s/m].
    stiffness : float
        Stiffest that is rendered calmly [N/m]; 0 where none is.
    next : float
        Next stiffer one that was tried [N/m]; nan where all are calm.
    limit : str
        What happens there.
    """

    damping: float
    stiffness: float
    next: float
    limit: str


def walls(folder: Path, seed: int = 1) -> list[WallRow]:
    """Stiffest wall that a hand can press against, for every damping."""
    return [_stiffest(damping, folder, seed) for damping in WALL_DAMPING]


def _stiffest(damping: float, folder: Path, seed: int) -> WallRow:
    calm = 0.0
    for stiffness in WALL_STIFFNESS:
        why = _pressed(stiffness, damping, folder / "wall.mcap", seed)
        if why:
            return WallRow(damping, calm, stiffness, why)
        calm = stiffness
    return WallRow(damping, calm, float("nan"), "none of those tried")


def _pressed(stiffness: float, damping: float, path: Path, seed: int) -> str:
    """What speaks against a wall when a hand presses the leader onto it; empty: nothing."""
    wall = {"normal": [0.0, 0.0, 1.0], "place": 0.005, "stiffness": stiffness, "damping": damping}
    law = {"scheme": "model", "wall": wall, "seed": seed}
    try:
        config = config_of("delayed", law, {"kind": "hand", "arm": "leader"}, None)
        state = runner.run(config, _HAND_SECONDS, seed, "lockstep", path).state
    except ConfigError:
        return "K T + 2 B is too much for the period"
    except DeviceError:
        return "it vibrates until an encoder is too fast"
    if state != "ENABLED":
        return f"{state}: torque or speed at its limit"
    place = Premium(()).tip(load(path, "leader").q)[:, 2]
    speed = np.gradient(place, PERIOD)
    slow = np.convolve(speed, np.full(100, 0.01), "same")
    parts = (speed - slow)[100:-100]
    rms = np.sqrt(np.convolve(parts**2, np.full(250, 1 / 250), "valid"))
    return "it vibrates" if float(rms.max()) > _VIBRATES else ""


def study(
    seed: int = 1, quick: bool = False, report: Callable[[int], object] = lambda n: None
) -> tuple[list[DelayRow], list[WallRow]]:
    """All laws over all channels, and the walls; `quick`: three channels, one damping."""
    links = (LINKS[0], LINKS[3], LINKS[5]) if quick else LINKS
    with tempfile.TemporaryDirectory() as name:
        folder, rows = Path(name), []
        for law in LAWS:
            for link in links:
                rows.append(row(*law, link, folder, seed))
                report(1)
        found = [_stiffest(1.0, folder, seed)] if quick else walls(folder, seed)
        report(1)
    return rows, found


def steps(quick: bool) -> int:
    """How often `study` reports."""
    return len(LAWS) * (3 if quick else len(LINKS)) + 1


HEAD = ("law", "one way", "drag [N s/m]", "felt [N/m]", "there [N/m]", "share", "by hand")
WALL_HEAD = ("damping [N s/m]", "stiffest calm wall [N/m]", "next [N/m]", "what happens there")


def cells(rows: list[DelayRow]) -> list[list[str]]:
    """Cells of the table of laws."""
    return [
        [r.law, r.link, r.why, "-", "-", "-", "-"]
        if r.why
        else [
            r.law,
            r.link,
            f"{r.drag:.1f}",
            f"{r.stiffness:.0f}",
            f"{r.environment:.0f}",
            f"{r.share:.2f}",
            r.hand,
        ]
        for r in rows
    ]


def wall_cells(rows: list[WallRow]) -> list[list[str]]:
    """Cells of the table of walls."""
    return [
        [
            f"{r.damping:g}",
            f"{r.stiffness:.0f}",
            "-" if r.next != r.next else f"{r.next:.0f}",
            r.limit,
        ]
        for r in rows
    ]


def page(rows: list[DelayRow], found: list[WallRow], command: str) -> str:
    """Page for the documentation."""

    def table(head: tuple[str, ...], body: list[list[str]]) -> list[str]:
        return [
            "| " + " | ".join(head) + " |",
            "|" + "---|" * len(head),
            *("| " + " | ".join(line) + " |" for line in body),
        ]

    return "\n".join(
        [
            "# Teleoperation over delay",
            "",
            f"Printed by `{command}` on the simulated rig. A machine moves the leader by 8 mm at "
            "1 Hz; the",
            "follower moves in free space (drag, that of the bare arm included), then in a gel "
            "(stiffness that is felt,",
            "and that is there). *By hand*: how six seconds of a soft hand in contact end. The "
            "first law has no protection",
            "against delay: where it would be unstable, the check in front of the motors refuses "
            "it.",
            "",
            *table(HEAD, cells(rows)),
            "",
            "## Walls",
            "",
            "Virtual walls at the leader (`wall` of the controller `delayed`): the stiffest that a "
            "hand can press against",
            "without vibration, at 1 kHz with the encoders, drives and cables of the rig.",
            "",
            *table(WALL_HEAD, wall_cells(found)),
            "",
        ]
    )
