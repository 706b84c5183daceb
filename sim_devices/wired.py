"""A bench seen through simulated buses: boxes cabled to its encoders, motors and amplifiers."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from math import cos, sin
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.signals.bus import Bus, Step
from hil.sim_devices.bench import Bench
from hil.sim_devices.canbus.line import LINES, CanLine
from hil.sim_devices.force.netcanoem import DEFAULT_BASE, NetCanOemBoard
from hil.sim_devices.force.netft import NetFtCanBox, RdtBox
from hil.sim_devices.force.transducer import Transducer
from hil.sim_devices.hid.module import SimHid
from hil.sim_devices.hid.usb31xx import Sim31xx
from hil.sim_devices.simtime import VirtualTime
from hil.sim_devices.usb.backend import SimUsb
from hil.sim_devices.usb.quad08 import SimQuad08

# Force sensors of a bench on their buses: the world's force in the sensor's frame, and time.

_NUMBER = itertools.count()


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
    hosts : dict of str to RdtBox
        By address on the network.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self.time = VirtualTime()
        self.handle = {"interface": "hil-sim", "prefix": f"bench{next(_NUMBER)}:"}
        self.lines: dict[str, CanLine] = {}
        self.hosts: dict[str, RdtBox] = {}
        bench.before.append(self._run)

    def socket(self, host: str, port: int) -> RdtBox:
        """Stand-in for a socket connected to a box."""
        if f"{host}:{port}" not in self.hosts:
            raise OSError(113, f"No route to host {host}:{port}")
        return self.hosts[f"{host}:{port}"].open(host, port)

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

    def netcanoem(self, address: str, options: dict[str, Any], arm: str) -> NetCanOemBoard:
        """Board with the sensor of an arm at ``CHANNEL/BASE``, set as the driver expects it."""
        channel, base = place(address, int(options.get("base", DEFAULT_BASE)))
        board = NetCanOemBoard(
            self._transducer(arm),
            base,
            options.get("bit_rate", 1_000_000),
            slot=options.get("calibration", 0),
        )
        self.line(channel).attach(board)
        return board

    def netft_can(self, address: str, options: dict[str, Any], arm: str) -> NetFtCanBox:
        """Net F/T box with the sensor of an arm on a CAN line."""
        channel, base = place(address, int(options.get("base", 0x1B0)))
        factors = tuple(float(f) for f in options.get("scale_factors", (1.0,) * 6))
        rate = options.get("bit_rate", 1_000_000)
        box = NetFtCanBox(self._transducer(arm), base, rate, factors)
        self.line(channel).attach(box)
        return box

    def netft_rdt(self, address: str, options: dict[str, Any], arm: str) -> RdtBox:
        """Net F/T box with the sensor of an arm on the network."""
        host, _, port = address.partition(":")
        box = RdtBox(self._transducer(arm), self.time)
        self.hosts[f"{host}:{port or 49152}"] = box
        return box

    def _transducer(self, arm: str) -> Transducer:
        bench = self._bench
        seed = [bench.seed, bench.names.index(arm)]
        return Transducer(bench.sensors[arm], seed, press(bench, arm))


def place(address: str, base: int) -> tuple[str, int]:
    """Channel and base of ``CHANNEL/BASE``.

    Raises
    ------
    ConfigError
        If the base is not a number.
    """
    channel, _, text = (address or "can0").partition("/")
    try:
        return channel, int(text, 0) if text else base
    except ValueError:
        raise ConfigError(f"simulated board: {address!r} is not CHANNEL/BASE.") from None


#: An amplifier switches off when its heartbeat line has not changed for so long [ns].
WATCHDOG_NS = 60_000_000
#: Channel of a box, role, arm, number in the role, sign.
Cable = tuple[int, str, str, int, int]


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
        self._pumps: dict[str, Step] = {}
        self.usb, self.hid = SimUsb(), SimHid(self._wait)
        self.force = SimForce(bench)
        self.buses = {"usb": self._bus("usb", self.usb), "hid": self._bus("hid", self.hid)}
        for kind, handle in (("can", self.force.handle), ("udp", self.force.socket)):
            self.buses[kind] = replace(self._bus(kind, handle), advance=self.force.at)
        self.boxes: dict[str, Any] = {}
        self._alive: dict[int, dict[str, int]] = {}
        self._parked = bench.state["parked"]
        for name, row in plan.items():
            if row["driver"] not in BUILDERS:
                missing = unknown("simulated box", row["driver"], BUILDERS)
                raise ConfigError(f"box {name!r}: {missing}")
            self.boxes[name] = BUILDERS[row["driver"]](self, name, row)
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

    def _run(self, name: str, step: Step) -> Callable[[], None]:
        """In virtual time, background work is done once a tick."""
        self._pumps[name] = step
        return lambda: self._pumps.pop(name, None) and None

    def _pump(self, now_ns: int) -> None:
        for step in list(self._pumps.values()):
            step()

    # cables

    def encoders(self, cables: list[Cable]) -> Callable[[NDArray[np.float64]], None]:
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

    def motors(self, cables: list[Cable], box: Sim31xx) -> Callable[[int], None]:
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

    def watch(self, cables: list[Cable], box: str) -> Callable[[int, int, int], None]:
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


def _quad08(wired: WiredBench, name: str, row: dict[str, Any]) -> SimQuad08:
    box = SimQuad08(row["address"] or f"SIM-{name}", wired.encoders(row["cables"]))
    wired.usb.devices.append(box)
    wired.bench.after.append(box.tick)
    return box


def _usb31xx(wired: WiredBench, name: str, row: dict[str, Any]) -> Sim31xx:
    cables, model = row["cables"], row["options"].get("model", "usb-3101")
    box = Sim31xx(model, row["address"] or f"SIM-{name}", wired.watch(cables, name))
    wired.hid.devices.append(box)
    wired.bench.before.append(wired.motors(cables, box))
    if wired.amplifiers not in wired.bench.before:
        wired.bench.before.append(wired.amplifiers)
    return box


def _sensor(kind: str) -> Callable[[WiredBench, str, dict[str, Any]], Any]:
    """Builder of a force sensor, by its method of `SimForce`."""

    def build(wired: WiredBench, name: str, row: dict[str, Any]) -> Any:
        return getattr(wired.force, kind)(
            row["address"], row["options"], arm_of(name, row["cables"])
        )

    return build


def arm_of(name: str, cables: list[Cable]) -> str:
    """The one arm that a force sensor is mounted on."""
    arms = {arm for _, role, arm, *_ in cables if role == "gauges"}
    if len(arms) != 1:
        raise ConfigError(f"box {name!r}: a force sensor is mounted on one arm, not {len(arms)}.")
    return arms.pop()


#: Driver of a box -> what stands at the other end of its cable.
BUILDERS: dict[str, Callable[[WiredBench, str, dict[str, Any]], Any]] = {
    "usb-quad08": _quad08,
    "usb-31xx": _usb31xx,
    "netcanoem": _sensor("netcanoem"),
    "netft-can": _sensor("netft_can"),
    "netft-rdt": _sensor("netft_rdt"),
}
