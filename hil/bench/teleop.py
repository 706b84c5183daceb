"""Teleoperation over delay on the simulated rig: drag, stiffness that arrives, and walls.

A machine moves the leader up and down by 8 mm at 1 Hz, in free space and then with the follower in
a gel; from forces and speeds at that frequency

    drag = Re(f_m / v_m) in free space,   stiffness = Re(j w f_m / v_m) in contact,

beside Re(j w f_s / v_s), what the gel is.  A hand then does the same for six seconds: is the
session still ENABLED at its end?  Nothing of the simulator is read.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from tqdm import tqdm

from hil import terminal
from hil.controllers.fixtures import FixtureConfig
from hil.controllers.lawrence_config import LawrenceConfig
from hil.errors import ConfigError, DeviceError, HilError
from hil.experiments.pages import line_chart
from hil.models.phantom import Premium
from hil.record.mcap_read import load
from hil.rig.config import ControllerConfig, RigConfig, load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.teleop import hybrid, law_parameters
from hil.teleop.architecture import Design
from hil.teleop.gate import GROWTH
from hil.teleop.sampled_loop import SampledLoop, dominant_mode
from hil.terminal import Found
from hil.toml import parse
from hil.userfile import write_text

FloatArray = NDArray[np.float64]
_HZ, SETTLING_S, MEASURED_PERIODS, _PERIOD = 1.0, 3.0, 3, 1e-3
_UP, _GEL, _ABOVE = 0.008, 400.0, -0.02
_HAND_SECONDS = 6.0


@dataclass(frozen=True)
class CommunicationLink:
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


LINKS = (
    CommunicationLink(0.0),
    CommunicationLink(0.01),
    CommunicationLink(0.03),
    CommunicationLink(0.1),
    CommunicationLink(0.3),
    CommunicationLink(0.1, 0.05, 0.1),
)
#: Four channels without accelerations: c4 = -c8 and c2 = c3 = 1 are transparent at low frequencies.
FOUR_CHANNEL_PARAMETERS: Mapping[str, Any] = {
    "c1": [250.0, 1.5, 0.0], "c2": [1.0], "c3": [1.0], "c4": [0.0, -0.3, 0.0],
    "c7": [250.0, 1.5, 0.0], "c8": [0.0, 0.3, 0.0], "force_hz": 100.0,
}  # fmt: skip
#: Disturbance observers that the cables of the rig bear.
OBSERVED: Mapping[str, Any] = {"disturbance": 1.0, "observer_hz": 5.0}
#: Laws: name, controller, parameters.
COMPARED_LAWS: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("position-force, share 0.5 (no protection)", "lawrence", {}),
    ("position-force, disturbance observers", "lawrence", OBSERVED),
    ("four-channel (no protection)", "lawrence", FOUR_CHANNEL_PARAMETERS),
    ("four-channel, disturbance observers", "lawrence", {**FOUR_CHANNEL_PARAMETERS, **OBSERVED}),
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


def rig_of_law(
    controller: str, parameters: Mapping[str, Any], operator: Mapping[str, Any], gel: float | None
) -> RigConfig:
    """Rig with a law, an operator, and a gel above home or none."""
    below = 1.0 if gel is None else _ABOVE
    simulation = {"operator": dict(operator), "gel": {"below_home": below, "stiffness": gel}}
    config = load_rig(rig_path("lawrence"), {"simulation": simulation})
    given = dict(config.controller.parameters) if controller == "lawrence" else {}
    law = ControllerConfig(controller, config.controller.arms, {**given, **parameters})
    return dataclasses.replace(config, controller=law)


def measured_impedances(path: Path) -> tuple[complex, complex]:
    """f_m / v_m and f_s / v_s on the vertical axis at the motion's frequency [N s/m]."""
    n, arm, found = round(MEASURED_PERIODS / _HZ / _PERIOD), Premium(()), []
    tone = np.exp(-2j * np.pi * _HZ * np.arange(n) * _PERIOD)
    for name, sign in (("leader", 1.0), ("follower", -1.0)):
        r = load(path, name)
        if r.wrench is None:
            raise RuntimeError("a session of this rig has forces")
        speed = np.gradient(arm.tip(r.q)[:, 2], _PERIOD)[-n:]
        found.append(complex(tone @ (sign * r.wrench[-n:, 2])) / complex(tone @ speed))
    return found[0], found[1]


def measured_row(
    law: str,
    controller: str,
    parameters: Mapping[str, Any],
    link: CommunicationLink,
    folder: Path,
    seed: int,
) -> DelayRow:
    """Three sessions of a law over a channel."""
    way = {"delay": link.delay, "jitter": link.jitter, "loss": link.loss}
    given = {**parameters, "forward": way, "backward": way, "seed": seed}
    machine = {"kind": "mechanical", "frequency": _HZ, "size": [0.0, 0.0, _UP], "onset": 1.0}
    path, z = folder / "run.mcap", []
    try:
        for gel in (None, _GEL):
            config = rig_of_law(controller, given, machine, gel)
            runner.run_session(
                config, SETTLING_S + MEASURED_PERIODS / _HZ, seed, "lockstep", path
            ).enabled()
            z.append(measured_impedances(path))
    except (ConfigError, DeviceError, HilError) as error:
        return DelayRow(law, link.name, why=_short(error))
    (free, _), (felt, there) = z
    w = 2 * np.pi * _HZ
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
    config = rig_of_law(controller, given, {"kind": "hand", "arm": "leader"}, _GEL)
    try:
        return runner.run_session(config, _HAND_SECONDS, seed, "lockstep", path).state
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
#: A tip rings that moves so many times as fast as without a wall, above this frequency [Hz], within
#: a quarter of a second.  A hand, and its impact, are slower; an encoder's counts make the rest.
_RINGS, _FAST_HZ, _WINDOW = 2.0, 60.0, 250


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


def walls(folder: Path, seed: int = 1, dampings: Sequence[float] = WALL_DAMPING) -> list[WallRow]:
    """Stiffest wall that a hand can press against, for every damping."""
    path = folder / "wall.mcap"
    _pressed(0.0, 0.0, path, seed)
    free, _ = ringing(path)
    return [_stiffest(damping, free, path, seed) for damping in dampings]


def _stiffest(damping: float, free: float, path: Path, seed: int) -> WallRow:
    calm = 0.0
    for stiffness in WALL_STIFFNESS:
        why = _pressed(stiffness, damping, path, seed)
        if not why:
            speed, hz = ringing(path)
            why = f"it rings at {hz:.0f} Hz" if speed > _RINGS * free else ""
        if why:
            return WallRow(damping, calm, stiffness, why)
        calm = stiffness
    return WallRow(damping, calm, float("nan"), "none of those tried")


def _pressed(stiffness: float, damping: float, path: Path, seed: int) -> str:
    """Why a session ends in which a hand presses the leader onto a wall; empty: it does not."""
    wall = {"normal": [0.0, 0.0, 1.0], "place": 0.005, "stiffness": stiffness, "damping": damping}
    law = {"scheme": "model", "wall": wall, "seed": seed}
    try:
        config = rig_of_law("delayed", law, {"kind": "hand", "arm": "leader"}, None)
        state = runner.run_session(config, _HAND_SECONDS, seed, "lockstep", path).state
    except ConfigError:
        return "K T + 2 B is too much for the period"
    except DeviceError:
        return "it rings until an encoder is too fast"
    return "" if state == "ENABLED" else f"{state}: torque or speed at its limit"


def ringing(path: Path) -> tuple[float, float]:
    """Largest fast speed (rms) of the leader's tip up and down [m/s], and its tone [Hz]."""
    place = Premium(()).tip(load(path, "leader").q)[:, 2]
    high = signal.butter(4, _FAST_HZ, "high", fs=1.0 / _PERIOD, output="sos")
    fast = signal.sosfiltfilt(high, np.gradient(place, _PERIOD))[100:-100]
    rms = np.sqrt(np.convolve(fast**2, np.full(_WINDOW, 1.0 / _WINDOW), "valid"))
    worst = fast[rms.argmax() : rms.argmax() + _WINDOW] * np.hanning(_WINDOW)
    tone = np.abs(np.fft.rfft(worst)).argmax() / (_WINDOW * _PERIOD)
    return float(rms.max()), float(tone)


@dataclass(frozen=True)
class WallLimit:
    """Stiffest wall by the sampled loop, with one thing of the rig changed.

    Parameters
    ----------
    what : str
        What is changed.
    stiffness : float
        Stiffest that is stable for every operator of the check before the start [N/m].
    hz : float
        Mode that grows beyond it [Hz].
    """

    what: str
    stiffness: float
    hz: float


#: Damping of the wall whose limits are told [N s/m], and stiffest that is looked at [N/m].
_TOLD, _STIFFEST = 1.0, 1e5


def wall_limits() -> list[WallLimit]:
    """Why a wall ends where it does: the vertical axis of the rig's leader, alone, linear."""
    law = parse(LawrenceConfig, dict(load_rig("lawrence").controller.parameters), "lawrence")
    axis = law_parameters.loops_of(law)[2]
    alone = Design(master=axis.design.master, slave=axis.design.slave)
    loop = dataclasses.replace(axis, design=alone, environments=(hybrid.FREE_MOTION,))
    quick = dataclasses.replace(loop.real, velocity_hz=0.0)
    changed = (
        ("the rig as it is", loop, _PERIOD),
        ("rigid in place of the cables", dataclasses.replace(loop, cable=None), _PERIOD),
        ("a period of 0.25 ms", loop, _PERIOD / 4),
        ("damping from speeds without a filter", dataclasses.replace(loop, real=quick), _PERIOD),
        ("no friction in the arm", dataclasses.replace(loop, friction=(0.0, 0.0)), _PERIOD),
    )
    return [WallLimit(what, *_limit(one, period)) for what, one, period in changed]


def _limit(loop: SampledLoop, period: float) -> tuple[float, float]:
    """Stiffest wall that is stable [N/m], and the mode beyond it [Hz]."""
    low, high, hz = 0.0, _STIFFEST, float("nan")
    while high - low > 1e-3 * high:
        middle = 0.5 * (low + high)
        within = dataclasses.replace(loop, fixture=(middle, _TOLD)).within()
        size, mode = max(
            dominant_mode(within, zh, hybrid.FREE_MOTION, period) for zh in loop.operators
        )
        if size <= 1.0 + GROWTH:
            low = middle
        else:
            high, hz = middle, mode
    return low, hz


def motors_hold() -> float:
    """Force that the leader's motors hold downwards at home [N], by their torque limits."""
    config = load_rig("lawrence")
    lever = np.abs(Premium(()).jacobian(np.asarray([config.simulation["home"]], float))[0][2])
    limits = np.asarray(config.arms["leader"].torque_limit)
    return float(np.min(limits[lever > 1e-9] / lever[lever > 1e-9]))


LIMIT_HEAD = ("changed", "stiffest stable wall [N/m]", "beyond it a mode of [Hz]")


def limit_cells(rows: list[WallLimit]) -> list[list[str]]:
    """Cells of the table of reasons."""
    return [[r.what, f"{r.stiffness:.0f}", f"{r.hz:.0f}"] for r in rows]


#: Virtual fixtures by name: a guide along y, a region and a half-space that are forbidden.
FIXTURES: Mapping[str, FixtureConfig] = {
    "line along y": FixtureConfig("line", direction=(0.0, 1.0, 0.0)),
    "ball of 10 mm": FixtureConfig("ball", (0.012, -0.01, 0.005), radius=0.01),
    "wall 10 mm below": FixtureConfig("wall", (0.0, 0.0, -0.01)),
}
#: Laws that they are shown with: name, controller, parameters.
GUIDED: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("position-force", "lawrence", {}),
    (
        "model-mediated, 100 ms",
        "delayed",
        {"scheme": "model", "forward": {"delay": 0.1}, "backward": {"delay": 0.1}},
    ),
)


@dataclass(frozen=True)
class FixtureRow:
    """What a virtual fixture does to a hand that does not know of it.

    Parameters
    ----------
    law, fixture : str
        Which.
    without, guided : tuple of 2 floats
        How far leader and follower are beyond it, rms of a guide and most of a region [m],
        without it and with it.
    state : str
        In which the session ended.
    """

    law: str
    fixture: str
    without: tuple[float, float]
    guided: tuple[float, float]
    state: str


def fixture_rows(
    folder: Path, seed: int = 1, laws: Sequence[tuple[str, str, Mapping[str, Any]]] = GUIDED
) -> list[FixtureRow]:
    """A hand's sessions in free space, without and with each fixture."""
    rows = []
    for law, controller, parameters in laws:
        free, _ = _by_fixture(controller, parameters, folder, seed)
        for name, fixture in FIXTURES.items():
            plain = dataclasses.asdict(fixture)
            with_it = {**parameters, "fixtures": [{**plain, "place": list(plain["place"])}]}
            guided, state = _by_fixture(controller, with_it, folder, seed)
            rows.append(
                FixtureRow(law, name, beyond(fixture, free), beyond(fixture, guided), state)
            )
    return rows


def _by_fixture(
    controller: str, parameters: Mapping[str, Any], folder: Path, seed: int
) -> tuple[list[FloatArray], str]:
    """Places of leader and follower from the start (n, 3) [m], and how the session ended."""
    path = folder / "fixture.mcap"
    config = rig_of_law(controller, parameters, {"kind": "hand", "arm": "leader"}, None)
    state = runner.run_session(config, _HAND_SECONDS, seed, "lockstep", path).state
    tips = [Premium(()).tip(load(path, arm).q) for arm in ("leader", "follower")]
    return [tip - tip[0] for tip in tips], state


def beyond(fixture: FixtureConfig, places: Sequence[FloatArray]) -> tuple[float, float]:
    """How far tips are beyond a fixture [m]: rms of a guide, most of a region."""
    out = []
    for x in places:
        r, n = x - fixture.place, np.asarray(fixture.direction) / np.linalg.norm(fixture.direction)
        along = r @ n
        if fixture.kind == "line":
            out.append(float(np.sqrt(np.mean(np.sum((r - np.outer(along, n)) ** 2, axis=1)))))
        else:
            deep = -along if fixture.kind == "wall" else fixture.radius - np.linalg.norm(r, axis=1)
            out.append(float(max(deep.max(), 0.0)))
    return out[0], out[1]


FIXTURE_HEAD = ("law", "fixture", "leader beyond it [mm]", "follower beyond it [mm]", "by hand")


def fixture_cells(rows: list[FixtureRow]) -> list[list[str]]:
    """Cells of the table of fixtures."""
    ends = [zip(r.without, r.guided, strict=True) for r in rows]
    both = [[f"{1e3 * a:.1f} -> {1e3 * b:.1f}" for a, b in pairs] for pairs in ends]
    return [[r.law, r.fixture, *far, r.state] for r, far in zip(rows, both, strict=True)]


@dataclass(frozen=True)
class TeleopStudy:
    """Everything that `hil bench teleop` prints."""

    laws: list[DelayRow]
    walls: list[WallRow]
    limits: list[WallLimit]
    holds: float
    fixtures: list[FixtureRow]


def study(
    seed: int = 1, quick: bool = False, report: Callable[[int], object] = lambda n: None
) -> TeleopStudy:
    """Laws over channels, walls, fixtures; `quick`: three channels, one damping, one law."""
    links = (LINKS[0], LINKS[3], LINKS[5]) if quick else LINKS
    with tempfile.TemporaryDirectory() as name:
        folder, rows = Path(name), []
        for law in COMPARED_LAWS:
            for link in links:
                rows.append(measured_row(*law, link, folder, seed))
                report(1)
        found = walls(folder, seed, (1.0,) if quick else WALL_DAMPING)
        report(1)
        guided = fixture_rows(folder, seed, GUIDED[: 1 if quick else 2])
        report(1)
    return TeleopStudy(rows, found, wall_limits(), motors_hold(), guided)


def steps(quick: bool) -> int:
    """How often `study` reports."""
    return len(COMPARED_LAWS) * (3 if quick else len(LINKS)) + 2


_HEAD = ("law", "one way", "drag [N s/m]", "felt [N/m]", "there [N/m]", "share", "by hand")
WALL_HEAD = ("damping [N s/m]", "stiffest calm wall [N/m]", "next [N/m]", "what happens there")


def _cells(rows: list[DelayRow]) -> list[list[str]]:
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


#: What the figures show of every law over every channel: name of the file, title, value.
FIGURES: tuple[tuple[str, str, Callable[[DelayRow], float]], ...] = (
    ("stiffness", "Share of the gel's stiffness that is felt", lambda r: r.share),
    ("drag", "Drag in free motion at 1 Hz [N s/m]", lambda r: r.drag),
)


def figures(rows: Sequence[DelayRow]) -> dict[str, str]:
    """Figures as SVG by name: every law over the channels; a gap where it was refused or ended.

    A channel that is more than a delay stands apart.
    """
    even = {r.link: "," not in r.link for r in rows}
    links = [x for x in even if even[x]]
    links += [x for name in even if not even[name] for x in ("", name)]
    laws = list(dict.fromkeys(r.law for r in rows))
    by = {(r.law, r.link): r for r in rows} | {(law, ""): DelayRow(law, "") for law in laws}
    return {
        name: line_chart(title, links, {law: [value(by[law, x]) for x in links] for law in laws})
        for name, title, value in FIGURES
    }


def page(found: TeleopStudy, command: str, stem: str = "teleop") -> str:
    """Page for the documentation; its figures are beside it under names that begin with `stem`."""

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
            *(f"![{title}]({stem}-{name}.svg)\n" for name, title, _ in FIGURES),
            "In the figures a line ends where a law is refused; a share below 0 is drawn as 0.",
            "",
            *table(_HEAD, _cells(found.laws)),
            "",
            "## Walls",
            "",
            "Virtual walls at the leader (`wall` of the controller `delayed`): the stiffest that a "
            "hand can press against",
            "without ringing, at 1 kHz with the encoders, drives and cables of the rig. It rings "
            "where the tip moves",
            f"{_RINGS:g} times as fast as without a wall, above {_FAST_HZ:g} Hz.",
            "",
            *table(WALL_HEAD, wall_cells(found.walls)),
            "",
            "Why they end there: the vertical axis of the leader alone, sampled as it runs, with "
            f"{_TOLD:g} N s/m of damping, for",
            "every operator of the check before the start; then with one thing changed. The "
            f"motors hold {found.holds:.1f} N at home, so that",
            f"a wall of 1000 N/m gives way {found.holds:.1f} mm behind its surface, a stiffer one "
            "sooner.",
            "",
            *table(LIMIT_HEAD, limit_cells(found.limits)),
            "",
            "## Virtual fixtures",
            "",
            "A soft hand moves in free space for six seconds and knows nothing of the fixture at "
            "the leader (400 N/m, 0.5",
            "N s/m). How far each tip is beyond it, without and with it: rms of the distance from "
            "the line, deepest place in",
            "the ball or behind the wall.",
            "",
            *table(FIXTURE_HEAD, fixture_cells(found.fixtures)),
            "",
        ]
    )


def command(args: argparse.Namespace) -> Found:
    """Teleoperation over delay: drag, stiffness that is felt, stiffest walls, virtual fixtures."""
    terminal.check_page(args.report)
    total = steps(args.quick)
    with tqdm(total=total, unit="row", disable=not sys.stderr.isatty()) as bar:
        found = study(quick=args.quick, report=bar.update)
    command = "hil bench teleop" + " --quick" * args.quick
    if args.report:
        place = Path(args.report)
        told = f"{command} --report {place.name}"
        terminal.write_page(args.report, page(found, told, place.stem))
        for name, figure in figures(found.laws).items():
            write_text(place.with_name(f"{place.stem}-{name}.svg"), figure)
    tables = (
        (_HEAD, _cells(found.laws)),
        (WALL_HEAD, wall_cells(found.walls)),
        (LIMIT_HEAD, limit_cells(found.limits)),
        (FIXTURE_HEAD, fixture_cells(found.fixtures)),
    )
    text = "\n\n".join(terminal.table(list(head), body) for head, body in tables)
    text += f"\n\n  the motors of the leader hold {found.holds:.1f} N at home"
    return text, terminal.json_value(asdict(found))
