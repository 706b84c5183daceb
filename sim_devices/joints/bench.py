"""Bench of simulated arms of any URDF: ideal wires, drives on CAN lines, or a WebSocket."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.signals.bus import BackgroundStep, Bus
from hil.signals.device import Status
from hil.sim_devices.canbus.line import LINES, CanLine
from hil.sim_devices.joints import motion, touch
from hil.sim_devices.plants.build import hidden_rows, same_type, with_defaults
from hil.sim_devices.plants.layout import ELEMENTS
from hil.sim_devices.simtime import VirtualTime

Ints = NDArray[np.int64]
#: Largest words of a drive: position; speed and effort.
TOP_POSITION, TOP_WORD = 65535, 4095
#: Steps of the physics a second at least, and parts of a tick in which buses and physics alternate.
STEPS, PARTS_PER_TICK = 8000.0, 4
#: Ticks whose random numbers are drawn at once.
_BLOCK = 16
#: Keys of ``[simulation]``, with their defaults.
_DEFAULTS: dict[str, Any] = {
    "bench": "ideal", "home": {}, "hidden": [], "truth_seed": 0,
    "operator": {}, "incision": {}, "tissue": {},
}  # fmt: skip
#: Driver of a box -> module whose `put` sets up what stands at the other end of its cable, and the
#: extra that brings its libraries.
BOXES = {
    "damiao-can": ("hil.sim_devices.joints.damiao", "can"),
    "haply-inverse": ("hil.sim_devices.joints.haply", "haply"),
}
#: Tables of what touches an arm, with who it is.
TOUCHING = ("operator", "incision", "tissue")


@dataclass(frozen=True)
class Kind:
    """A type of Damiao drive: ranges of position [rad], speed [rad/s] and torque [N m]."""

    name: str
    ranges: tuple[float, float, float]


#: As they leave the works, by torque.
_KINDS = (
    Kind("DM4310", (12.5, 30.0, 10.0)),
    Kind("DM4340", (12.5, 10.0, 28.0)),
    Kind("DM8009", (12.5, 45.0, 54.0)),
    Kind("DM10010L", (12.5, 25.0, 200.0)),
)


def kind_of(torque: float) -> Kind:
    """Smallest type that gives `torque` [N m]; the largest gives what it can."""
    return next((k for k in _KINDS if k.ranges[2] >= torque), _KINDS[-1])


class Described(Protocol):
    """What the bench is told of an arm."""

    joints: tuple[str, ...]
    urdf: str
    center: tuple[float, ...]
    torque_limit: tuple[float, ...]


#: Steps of a linear motor with its scale: position [m], speed [m/s], force [N]; mass of its forcer
#: by its force [kg/N].
LINEAR_STEPS, FORCER = (1e-6, 1e-5, 1e-4), 0.06
#: Hidden effect -> fields of `motion.JOINT_DTYPE`: shares of the torque limit, then values as
#: they are.
HIDDEN_FIELDS: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    "stribeck": ({"stribeck": 0.06}, {"stribeck_speed": 0.12}),
    "quadratic-drag": ({"drag": 0.05}, {}),
    "cogging": ({"cogging": 0.04}, {"cogging_cycles": 14.0}),
    "spring": ({"spring": 0.12}, {"spring_rest": 0.2}),
    "torque-gain": ({}, {"gain": 0.12}),
}


class SimArm:
    """One arm: bodies, joints, drives.

    Attributes
    ----------
    codes, counts, rates : ndarray (d,) of int
        Efforts asked for, positions and speeds, in half steps of the drives.
    scales : ndarray (d, 3)
        Size of a half step: position [rad], speed [rad/s], effort [N m].
    powered : ndarray (d,) of bool
        Drives that are on; the brakes hold an arm of which one is off.
    """

    def __init__(self, name: str, arm: Described, home: Sequence[float], seed: int) -> None:
        d = len(arm.joints)
        self.name, self.joints = name, arm.joints
        built, self._pull = (
            motion.arm_of_urdf(arm.urdf, arm.joints, seed),
            motion.described_gravity(arm.urdf),
        )
        self._bodies = tuple(getattr(built, f) for f in built.__dataclass_fields__)
        self.kinds = [kind_of(t) for t in arm.torque_limit]
        ranges = np.array([k.ranges for k in self.kinds])
        self.scales = ranges / (TOP_POSITION, TOP_WORD, TOP_WORD)
        self._slides = built.slides.astype(np.bool_)
        self.scales[self._slides] = LINEAR_STEPS
        self.p, self.x = np.zeros(d, motion.JOINT_DTYPE), np.zeros(d, motion.JOINT_STATE_DTYPE)
        self._set_up(np.array(arm.torque_limit), np.random.default_rng([seed, 0xD21]))
        self._rotor = np.ascontiguousarray(self.p["rotor"])
        self.x["q"] = home
        self._room = (*motion.motion_scratch(d), *(np.zeros(d) for _ in range(4)))
        self.codes, self.counts, self.rates = (np.zeros(d, np.int64) for _ in range(3))
        self.powered = np.zeros(d, np.bool_)
        self.touched = np.zeros(1, touch.TOUCH)
        self._touch_room, self._shake = touch.touch_scratch(), np.zeros(3)
        self._urdf, self._rng = arm.urdf, np.random.default_rng(0)
        self.sense()

    def slide(self, masses: Sequence[float], steps: Sequence[float]) -> None:
        """Its axes move so much [kg] whatever the posture; `steps` are those of its words."""
        self.p["rotor"] = self._rotor[:] = masses
        self.scales[:] = steps
        self.p["count"], self.p["rate"], self.p["code"] = self.scales.T

    def _set_up(self, most: NDArray[np.float64], rng: np.random.Generator) -> None:
        """Drives and friction by the torque limits, each its own."""
        p, d = self.p, most.size

        def near(value: float) -> NDArray[np.float64]:
            return value * rng.uniform(0.75, 1.35, d)

        p["rotor"], p["coulomb"] = most * near(1.3e-3), most * near(0.03)
        p["viscous"], p["thin"] = most * near(0.018), near(2.5)
        p["limit"] = near(1e-3)[:, None] * np.array([0.5, 1.0, 2.0, 4.0])
        p["weight"] = rng.dirichlet(np.full(ELEMENTS, 20.0), d)
        p["lag"], p["noise"], p["top"] = (
            near(6e-4),
            most * near(1.5e-3),
            self.scales[:, 2] * TOP_WORD,
        )
        # a linear motor moves its own weight, and gives more than its limit for a moment
        p["rotor"][self._slides] = (most * near(FORCER))[self._slides]
        p["top"][self._slides] = 2.0 * most[self._slides]
        p["count"], p["rate"], p["code"] = self.scales.T

    def hide(self, row: Mapping[str, Any], most: Sequence[float]) -> None:
        """Put in an effect of ``[[simulation.hidden]]``.

        Raises
        ------
        ConfigError
            For a joint that is not known.
        """
        where = "[[simulation.hidden]]"
        name, joint = row["effect"], row.get("joint", "")
        if not joint:
            raise ConfigError(
                f"{where} {name}: the key 'joint' is missing; there are {', '.join(self.joints)}"
            )
        if joint not in self.joints:
            raise ConfigError(f"{where} {name}: {unknown('joint', joint, self.joints)}")
        i, amplitude = self.joints.index(joint), float(row.get("amplitude", 1.0))
        shares, values = HIDDEN_FIELDS[name]
        for key, value in shares.items():
            self.p[key][i] += amplitude * value * most[i]
        for key, value in values.items():
            self.p[key][i] = value * (1.0 if shares else amplitude)

    def meet(self, table: str, given: Mapping[str, Any], seed: int) -> None:
        """Let something touch the tip or the shaft; see `touch`."""
        t = self.touched
        t["turn"], t["place"] = motion.link_tip(self._urdf, self.joints[-1])
        d = len(self.joints)
        motion.outward(self._bodies, self.x["q"].copy(), np.zeros(d), self._room[:4])
        touch.touch_poses(self._bodies, self._room[0], self._room[2], t[0], self._touch_room)
        self._rng = np.random.default_rng([seed, 0x7A2D])
        touch.attach_touch(t, table, given, t["tip"][0].copy(), t["axes"][0].copy(), self._rng)

    def rehearse(self) -> None:
        """Do on copies what a tick does: compiled code is there before anything is enabled."""
        met = self.touched.copy()
        self._advance(self.x.copy(), np.zeros(len(self.joints)), 1.0 / STEPS, met)
        if met["hand"][0]:
            touch.aim(met[0], 0.0, 1.0 / STEPS, self._shake, self._touch_room)

    def live(self, t: float, tick: float) -> None:
        """The hand goes on at the start of a tick; `t` [s]."""
        if self.touched["hand"][0]:
            self._rng.standard_normal(out=self._shake)
            touch.aim(self.touched[0], t, tick, self._shake, self._touch_room)

    def run(self, random: NDArray[np.float64], span: float) -> None:
        """Advance by `span` [s]."""
        if not self.powered.all():
            self.x["v"] = 0.0
            return
        self._advance(self.x, random, span, self.touched)

    def _advance(
        self, x: NDArray[Any], random: NDArray[np.float64], span: float, touched: NDArray[Any]
    ) -> None:
        touches = bool(touched["any"][0])
        motion.run_arm(
            self._bodies,
            self.p,
            x,
            self._room,
            self._rotor,
            self.codes,
            random,
            self._pull,
            span,
            max(1, round(span * STEPS)),
            touched[0] if touches else None,
            self._touch_room if touches else None,
        )

    def sense(self) -> None:
        """Words of all drives: whole steps, odd numbers of half steps."""
        np.floor(self.x["q"] / self.p["count"] / 2.0, out=self._odd)
        self.counts[:] = 2 * self._odd + 1
        np.floor(self.x["v"] / self.p["rate"] / 2.0, out=self._odd)
        self.rates[:] = 2 * self._odd + 1

    @property
    def _odd(self) -> NDArray[np.float64]:
        found: NDArray[np.float64] = self._room[4]
        return found


class JointBench:
    """World of one session.

    Parameters
    ----------
    arms : mapping of str to Described
        Name -> robot.
    section : mapping
        Table ``[simulation]`` of the rig file.
    period_ns : int
        Tick of the loop [ns].
    seed : int
        Noise of this session; `truth_seed` in `section` chooses the arms.

    Attributes
    ----------
    now_ns : int
        Time of the world [ns].
    arms : dict of str to SimArm
        Name -> arm.
    after : list of callable
        Called with the time [ns] after every tick.
    """

    _number = itertools.count()

    def __init__(
        self,
        arms: Mapping[str, Described],
        section: Mapping[str, Any],
        period_ns: int,
        seed: int,
    ) -> None:
        table = with_defaults("simulation", dict(section), _DEFAULTS)
        self.period_ns, self.now_ns = period_ns, 0
        self.arms: dict[str, SimArm] = {}
        for k, (name, arm) in enumerate(arms.items()):
            home = _home(name, arm, table["home"])
            self.arms[name] = SimArm(name, arm, home, 1000 * int(table["truth_seed"]) + k)
        for row in hidden_rows(table["hidden"], {name: {} for name in HIDDEN_FIELDS}):
            name = row.get("arm", next(iter(arms)))
            if name not in self.arms:
                raise ConfigError(f"[[simulation.hidden]]: {unknown('arm', name, arms)}")
            self.arms[name].hide(row, arms[name].torque_limit)
        for what in TOUCHING:
            if table[what]:
                name = str(table[what].get("arm", ""))
                if name not in self.arms:
                    raise ConfigError(f"[simulation.{what}] arm: {unknown('arm', name, self.arms)}")
                self.arms[name].meet(what, table[what], seed)
        for one in self.arms.values():
            one.rehearse()
        self.after: list[Callable[[int], None]] = []
        self._rng = np.random.default_rng([seed, 0x5EED])
        most = max(len(a.joints) for a in arms.values())
        self._noise, self._left = np.zeros((_BLOCK, len(arms), most)), 0
        self._time = VirtualTime()
        self._prefix = f"joints{next(self._number)}:"
        self.lines: dict[str, CanLine] = {}
        self.drives: dict[str, list[Any]] = {}
        #: Inverse Services by HOST:PORT.
        self.services: dict[str, Any] = {}
        self._pumps: dict[str, BackgroundStep] = {}

    def wire(self, arm: str) -> JointWire:
        """Ideal wire to the drives of one arm."""
        if arm not in self.arms:
            raise ConfigError(unknown("simulated arm", arm, self.arms))
        return JointWire(self, self.arms[arm])

    def buses(self, plan: Mapping[str, Mapping[str, Any]]) -> dict[str, Bus]:
        """Simulated buses with what `plan` has on them.

        Raises
        ------
        ConfigError
            For a box that is not known, whose library is missing, or whose cables do not fit.
        """
        for name, row in plan.items():
            if row["driver"] not in BOXES:
                missing = unknown("simulated box", row["driver"], BOXES)
                raise ConfigError(f"box {name!r}: {missing}")
            module, extra = BOXES[row["driver"]]
            try:
                box = import_module(module)
            except ImportError as error:
                raise ConfigError(
                    f"box {name!r}: its simulation needs the library {_library(error)}; "
                    f"pip install 'hil-teleop[{extra}]'"
                ) from error
            box.put(self, name, row)
        can = {"interface": "hil-sim", "prefix": self._prefix}
        return {"can": self._bus("can", can), "ws": self._bus("ws", self._socket)}

    def _bus(self, kind: str, handle: Any) -> Bus:
        return Bus(kind, handle, self._run, self._pause, lambda: self.now_ns, self.at, True)

    def _socket(self, host: str, port: int) -> Any:
        """Stand-in of a connection to a service."""
        if f"{host}:{port}" not in self.services:
            raise OSError(111, "Connection refused")
        return self.services[f"{host}:{port}"].open()

    def line(self, channel: str) -> CanLine:
        """CAN line of a channel, made when it is first wanted."""
        if channel not in self.lines:
            self.lines[channel] = LINES[self._prefix + channel] = CanLine(self._time)
        return self.lines[channel]

    def _run(self, name: str, step: BackgroundStep) -> Callable[[], None]:
        self._pumps[name] = step
        return lambda: self._pumps.pop(name, None) and None

    def _pause(self, seconds: float) -> None:
        ticks = max(1, round(seconds * 1e9 / self.period_ns))
        self.advance(self.now_ns + ticks * self.period_ns)

    def at(self, t_ns: int) -> None:
        """It is `t_ns` by the loop."""
        self.advance(t_ns)
        self._time.at(t_ns)

    def advance(self, t_ns: int) -> None:
        """Run the world up to `t_ns`, in whole ticks."""
        parts = PARTS_PER_TICK if self.lines or self.services else 1
        while self.now_ns + self.period_ns <= t_ns:
            if self._left == 0:
                self._rng.standard_normal(out=self._noise)
                self._left = _BLOCK
            noise = self._noise[_BLOCK - self._left]
            for arm in self.arms.values():
                arm.live(self.now_ns * 1e-9, self.period_ns * 1e-9)
            for part in range(parts):
                self._part(noise, self.now_ns + self.period_ns * (part + 1) // parts, parts)
            self._left -= 1
            self.now_ns += self.period_ns
            for step in list(self._pumps.values()):
                step()
            for act in self.after:
                act(self.now_ns)

    def _part(self, noise: NDArray[np.float64], end_ns: int, parts: int) -> None:
        """Buses up to `end_ns`, then the arms."""
        if self.lines:
            self._time.at(end_ns - 1)
            for line in self.lines.values():
                line.run(self._time.now_ns)
            for row in self.drives.values():
                for drive in row:
                    drive.tick(self._time.now_ns)
        for service in self.services.values():
            service.tick(end_ns - 1)
        for k, arm in enumerate(self.arms.values()):
            arm.run(noise[k], self.period_ns * 1e-9 / parts)
            arm.sense()


def _library(error: ImportError) -> str:
    """Name of the package that could not be imported."""
    return (error.name or str(error)).partition(".")[0]


def _home(name: str, arm: Described, table: Mapping[str, Any]) -> Sequence[float]:
    home = table.get(name, arm.center)
    numbers = isinstance(home, (list, tuple)) and all(same_type(q, 0.0) for q in home)
    if not numbers or len(home) != len(arm.joints):
        raise ConfigError(
            f"[simulation] home.{name}: {len(arm.joints)} joint positions [rad] are needed"
        )
    return [float(q) for q in home]


class JointWire:
    """Ideal wire to the drives of one arm: what arrives is what was sent."""

    trouble = ""

    def __init__(self, bench: JointBench, arm: SimArm) -> None:
        self._bench, self._arm = bench, arm
        self.counts, self.rates, self.scales = arm.counts, arm.rates, arm.scales
        self.gauges = np.zeros(6, np.int64)

    def home(self, counts: Ints) -> None:
        """Nothing to do: drives know where they stand."""

    def receive(self, t_ns: int) -> Status:
        """Refresh `counts` and `rates` for time `t_ns`."""
        self._bench.advance(t_ns)
        return Status.OK

    def send(self, codes: Ints) -> None:
        """Efforts (d,) that hold until the next call."""
        self._arm.codes[:] = codes

    def rest(self) -> None:
        """Drives off."""
        self.power(False)

    def power(self, on: bool) -> None:
        """Switch the drives; without power the brakes hold the arm."""
        self._arm.powered[:] = on
        self._arm.codes[:] = 0

    def close(self) -> None:
        """Nothing to release."""


__all__ = ["HIDDEN_FIELDS", "JointBench", "JointWire", "SimArm"]
