"""The simulated bench: arms, operator and gel in one world, and what devices see of it.

An ideal wire answers at signal level: encoder counts and gauge words in, DAC codes out.  Simulated
buses carry boxes that are cabled to encoders, motors and amplifiers.  Encoders may be emulated as
edges, with what their decoder gets wrong.  The world advances by whole ticks when a device is read
at a later time, whatever the clock.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from math import cos, sin
from typing import Any, Protocol

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.signals.bus import BackgroundStep, Bus
from hil.signals.device import Status
from hil.sim_devices.canbus.line import LINES, CanLine
from hil.sim_devices.force.transducer import SimulatedTransducer
from hil.sim_devices.hid.module import SimHid
from hil.sim_devices.plants import build, world
from hil.sim_devices.plants.layout import GEL_DTYPE, NOISES, OPERATOR, SUBSTEPS
from hil.sim_devices.simtime import VirtualTime

#: Ticks whose random numbers are drawn at once: few, so that no tick is much longer than others.
_BLOCK = 16


class Bench:
    """World of one session.

    Parameters
    ----------
    arms : dict of str to str
        Name of every arm -> name of its force sensor.
    section : dict
        Table ``[simulation]`` of the rig file.
    period_ns : int
        Tick of the loop [ns].
    seed : int
        Noise of this session; `hidden_seed` in `section` chooses random hidden effects.
    """

    def __init__(
        self, arms: dict[str, str], section: dict[str, Any], period_ns: int, seed: int
    ) -> None:
        self.names, self.sensors, self.seed = list(arms), dict(arms), seed
        self.period_ns = period_ns
        self.now_ns = 0
        plan = build.plan_bench(arms, section, seed)
        self.parameters, self.state = plan.parameters, plan.state
        self.operators, self.gels = plan.operators, plan.gels
        if self.operators.dtype != OPERATOR or self.gels.dtype != GEL_DTYPE:
            raise ConfigError("[simulation]: operator or gel has another layout.")
        n = len(self.names)
        self.codes = np.zeros((n, 3), np.int64)
        self.counts = np.zeros((n, 3), np.int64)
        self.gauges = np.zeros((n, 6), np.int64)
        self._rng = np.random.default_rng([seed, 0x5EED])
        self._noise = np.zeros((_BLOCK, n, NOISES))
        self._left = 0
        #: Called with the time [ns] before and after every tick: devices at wire level.
        self.before: list[Callable[[int], None]] = []
        self.after: list[Callable[[int], None]] = []
        for i in range(n):
            world.read_sensors(
                self.parameters[i],
                self.state[i],
                0.0,
                np.zeros(NOISES),
                self.counts[i],
                self.gauges[i],
            )
        self.encoders = self._bad_encoders(dict(section.get("quadrature", {})))
        if self.encoders:
            self.after.append(self._read_encoders)

    def _bad_encoders(self, table: dict[str, Any]) -> dict[int, Quadrature]:
        """Arm -> encoders as edges, from ``[simulation.quadrature]``; none where it is empty."""
        if not table:
            return {}
        keys = {"arm": "", "lines": 1024, "phase_error": 0.0, "dirty": [], "decoder_hz": 1e7}
        table = build.with_defaults("simulation.quadrature", table, keys)
        arm = table.pop("arm")
        if arm and arm not in self.names:
            raise ConfigError(f"[simulation.quadrature]: {unknown('arm', arm, self.names)}")
        found = {i: Quadrature(3, **table) for i, n in enumerate(self.names) if arm in ("", n)}
        for i, encoder in found.items():
            encoder.reset(self.place(i))
        return found

    def place(self, i: int) -> NDArray[np.float64]:
        """Where the encoders of arm i stand (3,) [quarter lines]."""
        return np.asarray(self.state["qm"][i] * self.parameters["encoder"][i])

    def _read_encoders(self, now_ns: int) -> None:
        """What the decoders of encoders that are emulated as edges make of the tick."""
        for i, encoder in self.encoders.items():
            encoder.advance(self.place(i), self.period_ns * 1e-9)
            self.counts[i] = encoder.counts

    def wire(self, arm: str) -> IdealWire:
        """Wire to the devices of one arm."""
        if arm not in self.names:
            raise ConfigError(unknown("simulated arm", arm, self.names))
        return IdealWire(self, self.names.index(arm))

    def buses(self, plan: dict[str, dict[str, Any]]) -> dict[str, Bus]:
        """Simulated buses, by kind, with the boxes of `plan` on them."""
        self.wired = WiredBench(self, plan)
        return self.wired.buses

    def park(self, arm: int, still: bool) -> None:
        """Hold an arm where it is, as its dock does, or let it go."""
        self.state["parked"][arm] = int(still)
        if still:
            self.state["v"][arm] = self.state["vm"][arm] = 0.0

    def advance(self, t_ns: int) -> None:
        """Run the world up to `t_ns`, in whole ticks."""
        while self.now_ns + self.period_ns <= t_ns:
            for act in self.before:
                act(self.now_ns)
            if self._left == 0:
                self._rng.standard_normal(out=self._noise)
                self._left = _BLOCK
            world.run_plant(
                self.parameters,
                self.state,
                self.operators,
                self.gels,
                self.now_ns * 1e-9,
                self.period_ns * 1e-9,
                SUBSTEPS,
                self.codes,
                self._noise[_BLOCK - self._left],
                self.counts,
                self.gauges,
            )
            self._left -= 1
            self.now_ns += self.period_ns
            for act in self.after:
                act(self.now_ns)


class IdealWire:
    """Ideal wire to one arm: what arrives is what was sent.

    Attributes
    ----------
    counts, gauges : ndarray (3,), (6,) of int
        Last answer; the arrays stay the same objects.
    trouble : str
        Empty: an ideal wire is never lost.
    """

    trouble = ""

    def __init__(self, bench: Bench, index: int) -> None:
        self._bench = bench
        self._index = index
        self.counts = bench.counts[index]
        self.gauges = bench.gauges[index]
        self._codes = bench.codes[index]

    def home(self, counts: NDArray[np.int64]) -> None:
        """Nothing to do: an ideal encoder is absolute."""

    def receive(self, t_ns: int) -> Status:
        """Refresh `counts` and `gauges` for time `t_ns`."""
        self._bench.advance(t_ns)
        return Status.OK

    def send(self, codes: NDArray[np.int64]) -> None:
        """Set the DAC codes (3,) that hold until the next call."""
        self._codes[:] = codes

    def power(self, on: bool) -> None:
        """Switch the amplifiers; without power the arm rests in its dock."""
        self._bench.park(self._index, not on)
        self._codes[:] = 0

    def close(self) -> None:
        """Nothing to release."""


def open_bench(arms: dict[str, Any], section: dict[str, Any], period_ns: int, seed: int) -> Any:
    """Open the simulated bench (entry point ``ideal`` of ``hil.sim_devices``).

    `arms` are the names of force sensors on arms that the bench knows, or descriptions of others.
    """
    if not all(isinstance(arm, str) for arm in arms.values()):
        from hil.sim_devices.joints.bench import JointBench  # its physics, where an arm needs them

        return JointBench(arms, section, period_ns, seed)
    return Bench(arms, section, period_ns, seed)


# Buses of a bench: the world's force in the sensor's frame, time, boxes and cables.

_NUMBER = itertools.count()
#: Channel of a box, role, arm, number in the role, sign.
BoxConnection = tuple[int, str, str, int, int]
#: Driver of a box -> function that puts up what stands at the other end of its cable: of the
#: `WiredBench`, the box's name, and its row of the plan.
BOXES = {
    "usb-quad08": "hil.sim_devices.usb.quad08:put",
    "usb-31xx": "hil.sim_devices.hid.usb31xx:put",
    "netcanoem": "hil.sim_devices.force.netcanoem:put",
    "netft-can": "hil.sim_devices.force.netft:put_on_can",
    "netft-rdt": "hil.sim_devices.force.netft:put_on_network",
}


@nb.njit(cache=True, nogil=True)
def tip_load(q: Any, force: Any, out: Any) -> None:
    """Force ON the tip in axes of the sensor: x normal to the forearm, y across, z outwards."""
    s1, c1, s3, c3 = sin(q[0]), cos(q[0]), sin(q[2]), cos(q[2])
    radial = c1 * force[0] + s1 * force[1]
    out[0] = c3 * radial + s3 * force[2]
    out[1] = s1 * force[0] - c1 * force[1]
    out[2] = s3 * radial - c3 * force[2]


def press(bench: Bench, arm: str) -> Callable[[NDArray[np.float64]], None]:
    """Function that writes the load of the sensor on an arm."""
    state = bench.state[bench.names.index(arm)]
    q, force = state["q"], state["force"]
    return lambda out: tip_load(q, force, out)


class Host(Protocol):
    """Box on the network of a bench."""

    def open(self, host: str, port: int) -> Any:
        """Stand-in for a socket that is connected to it."""

    def run(self) -> None:
        """Work through the tick."""


class Outputs(Protocol):
    """Box with analogue outputs [V]."""

    volts: NDArray[np.float64]

    def tick(self, now_ns: int) -> bool:
        """Let a tick pass; whether the outputs were looked at."""


class SimForce:
    """CAN lines and network of a bench; the boards and boxes on them read the world.

    What goes over a bus in a tick sees the world of the tick's start: a sample that a board
    takes 50 us after the request is not of the end of the tick.

    Attributes
    ----------
    handle : dict
        For CAN drivers: python-can's interface, and what stands before the name of a channel.
    lines : dict of str to CanLine
        By channel.
    hosts : dict of str to Host
        By address on the network.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self.time = VirtualTime()
        self.handle = {"interface": "hil-sim", "prefix": f"bench{next(_NUMBER)}:"}
        self.lines: dict[str, CanLine] = {}
        self.hosts: dict[str, Host] = {}
        bench.before.append(self._run)

    def socket(self, host: str, port: int) -> Any:
        """Stand-in for a socket connected to a box."""
        if f"{host}:{port}" not in self.hosts:
            raise OSError(113, f"No route to host {host}:{port}")
        box: Any = self.hosts[f"{host}:{port}"].open(host, port)
        return box

    def line(self, channel: str) -> CanLine:
        """Line of a channel, made when it is first wanted."""
        if channel not in self.lines:
            self.lines[channel] = CanLine(self.time)
            LINES[self.handle["prefix"] + channel] = self.lines[channel]
        return self.lines[channel]

    def at(self, t_ns: int) -> None:
        """It is `t_ns` by the loop."""
        self._bench.advance(t_ns)
        self.time.at(t_ns)

    def _run(self, now_ns: int) -> None:
        """The bus works through the tick that begins, before the world moves on."""
        self.time.at(now_ns + self._bench.period_ns - 1)
        for line in self.lines.values():
            line.run(self.time.now_ns)
        for box in self.hosts.values():
            box.run()

    def transducer(self, name: str, cables: list[BoxConnection]) -> SimulatedTransducer:
        """Sensor of box `name`, mounted on the one arm of its cables.

        Raises
        ------
        ConfigError
            If the cables lead to no arm or to more than one.
        """
        bench, arms = self._bench, {arm for _, role, arm, *_ in cables if role == "gauges"}
        if len(arms) != 1:
            raise ConfigError(
                f"box {name!r}: a force sensor is mounted on one arm, not {len(arms)}."
            )
        arm = arms.pop()
        seed = [bench.seed, bench.names.index(arm)]
        return SimulatedTransducer(bench.sensors[arm], seed, press(bench, arm))


#: An amplifier switches off when its heartbeat line has not changed for so long [ns].
WATCHDOG_NS = 60_000_000


class WiredBench:
    """Simulated buses of a bench.

    Parameters
    ----------
    bench : Bench
        The world.
    plan : dict
        Box -> driver, address, options and cables.

    Attributes
    ----------
    buses : dict of str to Bus
        Kind -> bus.
    boxes : dict of str to object
        Name -> simulated box, for tests that pull its plug.
    """

    def __init__(self, bench: Bench, plan: dict[str, dict[str, Any]]) -> None:
        self.bench = bench
        self._pumps: dict[str, BackgroundStep] = {}
        from hil.sim_devices.usb.backend import SimUsb  # its library, where a rig has buses

        self.usb, self.hid = SimUsb(), SimHid(self._wait)
        self.force = SimForce(bench)
        self.buses = {"usb": self._bus("usb", self.usb), "hid": self._bus("hid", self.hid)}
        for kind, handle in (("can", self.force.handle), ("udp", self.force.socket)):
            self.buses[kind] = replace(self._bus(kind, handle), advance=self.force.at)
        self.boxes: dict[str, Any] = {}
        self._alive: dict[int, dict[str, int]] = {}
        self._parked = bench.state["parked"]
        for name, row in plan.items():
            if row["driver"] not in BOXES:
                missing = unknown("simulated box", row["driver"], BOXES)
                raise ConfigError(f"box {name!r}: {missing}")
            module, _, put = BOXES[row["driver"]].partition(":")
            self.boxes[name] = getattr(import_module(module), put)(self, name, row)
        bench.after.append(self._pump)

    def _bus(self, kind: str, handle: Any) -> Bus:
        return Bus(kind, handle, self._run, self._pause, self._now, self.bench.advance, True)

    def _now(self) -> int:
        return self.bench.now_ns

    def _pause(self, seconds: float) -> None:
        ticks = max(1, round(seconds * 1e9 / self.bench.period_ns))
        self.bench.advance(self.bench.now_ns + ticks * self.bench.period_ns)

    def _wait(self, milliseconds: int) -> None:
        self._pause(milliseconds * 1e-3)

    def _run(self, name: str, step: BackgroundStep) -> Callable[[], None]:
        """In virtual time, background work is done once a tick."""
        self._pumps[name] = step
        return lambda: self._pumps.pop(name, None) and None

    def _pump(self, now_ns: int) -> None:
        for step in list(self._pumps.values()):
            step()

    # cables

    def encoders(self, cables: list[BoxConnection]) -> Callable[[NDArray[np.float64]], None]:
        """Function that writes where the encoders on these cables stand [quarter lines]."""
        bench, rows = self.bench, []
        for channel, role, arm, motor, sign in cables:
            if role == "encoders":
                a = bench.names.index(arm)
                angle, scale = bench.state["qm"][a], bench.parameters["encoder"][a]
                rows.append((channel, angle, motor, sign * float(scale[motor])))

        def write(out: NDArray[np.float64]) -> None:
            for channel, angle, motor, scale in rows:
                out[channel] = angle.item(motor) * scale

        def write_counted(out: NDArray[np.float64]) -> None:
            """Encoders that are emulated as edges: what their decoder has counted."""
            write(out)
            for channel, role, arm, motor, sign in cables:
                bad = bench.encoders.get(bench.names.index(arm))
                if role == "encoders" and bad is not None:
                    out[channel] = sign * (bad.counts[motor] + 0.5)

        return write_counted if bench.encoders else write

    def motors(self, cables: list[BoxConnection], box: Outputs) -> Callable[[int], None]:
        """Function that hands the voltages of a box to the amplifiers, once a tick."""
        rows = [
            (c, self.bench.codes[self.bench.names.index(arm)], motor, sign)
            for c, role, arm, motor, sign in cables
            if role == "motors"
        ]

        volts = box.volts

        def drive(now_ns: int) -> None:
            if box.tick(now_ns):
                for channel, codes, motor, sign in rows:
                    codes[motor] = round(sign * volts.item(channel) * 3276.8)

        return drive

    def watch(self, cables: list[BoxConnection], box: str) -> Callable[[int, int, int], None]:
        """Watchdog of the amplifiers of these arms, fed by one box."""
        arms = {self.bench.names.index(arm) for _, role, arm, *_ in cables if role == "motors"}

        def edge(bit: int, level: int, now_ns: int) -> None:
            for a in arms:
                self._alive.setdefault(a, {})[box] = now_ns

        return edge

    def amplifiers(self, now_ns: int) -> None:
        """Power where every heartbeat that was ever seen goes on; parked in the dock otherwise."""
        parked = self._parked
        for a, beats in self._alive.items():
            on = now_ns - min(beats.values()) <= WATCHDOG_NS
            if bool(parked.item(a)) is on:
                self.bench.park(a, not on)


# Optical encoders as edges: two tracks, a decoder that samples them, and what it gets wrong.
#
# The tracks A and B run through 00 01 11 10 in the forward direction.  A decoder that sees both
# change between two samples cannot tell the direction: it counts nothing and raises a flag.  Two
# samples three edges apart look like one edge back, and no flag tells.  A dirty line is a track A
# that stays dark over one line: four counts are lost in either direction, and none is illegal.

#: Steps in which a slow motion is looked at [quarter lines].
_FINE = 0.25
_STEP = np.zeros((4, 4), np.int64)
for _before, _after in ((0, 1), (1, 3), (3, 2), (2, 0)):
    _STEP[_before, _after], _STEP[_after, _before] = 1, -1
for _before, _after in ((0, 3), (3, 0), (1, 2), (2, 1)):
    _STEP[_before, _after] = 2  # illegal


class Quadrature:
    """Encoders of some motors with their decoders.

    Parameters
    ----------
    channels : int
        Encoders.
    lines : int
        Lines a turn.
    phase_error : float
        How far track A is out of place against B [quarter lines], below 1.
    dirty : sequence of int
        Lines on which A stays dark.
    decoder_hz : float
        Samples of the decoder per second.

    Attributes
    ----------
    counts, illegal : ndarray (channels,) of int
        What the decoder has counted, and how often it saw an illegal transition.

    Raises
    ------
    ConfigError
        For values out of range.
    """

    def __init__(
        self,
        channels: int,
        lines: int = 1024,
        phase_error: float = 0.0,
        dirty: Sequence[int] = (),
        decoder_hz: float = 1e7,
    ) -> None:
        if not abs(phase_error) < 1.0 or decoder_hz <= 0 or lines < 1:
            raise ConfigError("quadrature: |phase_error| < 1, decoder_hz > 0, lines > 0 needed.")
        if any(not isinstance(line, int) or not 0 <= line < lines for line in dirty):
            raise ConfigError(f"quadrature: dirty lines are 0 to {lines - 1}.")
        self._dark = np.zeros(lines, np.bool_)
        self._dark[list(dirty)] = True
        self._phase, self._rate = phase_error, decoder_hz
        self.counts, self.illegal = np.zeros(channels, np.int64), np.zeros(channels, np.int64)
        self._at = np.zeros(channels)

    def reset(self, place: NDArray[np.float64]) -> None:
        """The encoders stand at `place` (channels,) [quarter lines], and the counts agree."""
        self._at[:] = place
        self.counts[:], self.illegal[:] = np.floor(place).astype(np.int64), 0

    def advance(self, place: NDArray[np.float64], seconds: float) -> None:
        """The encoders go evenly to `place` (channels,) [quarter lines] within `seconds`."""
        _advance(
            self._at,
            place,
            seconds * self._rate,
            self._phase,
            self._dark,
            _STEP,
            self.counts,
            self.illegal,
        )


@nb.njit(cache=True, nogil=True)
def tracks(x: float, phase: float, dark: Any) -> int:
    """State 2 A + B of the tracks at `x` quarter lines."""
    b = 1 if 1.0 <= x % 4.0 < 3.0 else 0
    a = 1 if (x - phase) % 4.0 >= 2.0 else 0
    if dark[int(x // 4.0) % dark.size]:
        a = 0
    return 2 * a + b


@nb.njit(cache=True, nogil=True)
def _advance(
    at: Any,
    place: Any,
    samples: float,
    phase: float,
    dark: Any,
    step: Any,
    counts: Any,
    illegal: Any,
) -> None:
    for i in range(at.size):
        way = place[i] - at[i]
        if way == 0.0:
            continue
        # a fast motion is seen once a sample of the decoder, a slow one in fine steps
        n = max(1, int(np.ceil(min(abs(way) / _FINE, samples))))
        seen = tracks(at[i], phase, dark)
        for k in range(1, n + 1):
            now = tracks(at[i] + way * k / n, phase, dark)
            moved = step[seen, now]
            if moved == 2:
                illegal[i] += 1
            else:
                counts[i] += moved
            seen = now
        at[i] = place[i]
