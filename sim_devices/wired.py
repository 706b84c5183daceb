"""A bench seen through simulated buses: boxes cabled to its encoders, motors and amplifiers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.signals.bus import Bus, Step
from hil.sim_devices.bench import Bench
from hil.sim_devices.force.mount import SimForce
from hil.sim_devices.hid.module import SimHid
from hil.sim_devices.hid.usb31xx import Sim31xx
from hil.sim_devices.usb.backend import SimUsb
from hil.sim_devices.usb.quad08 import SimQuad08

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
