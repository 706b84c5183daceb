"""Force sensors of a bench on their buses: the world's force in the sensor's frame, and time."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from math import cos, sin
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.sim_devices.bench import Bench
from hil.sim_devices.canbus.line import LINES, CanLine
from hil.sim_devices.force.netcanoem import DEFAULT_BASE, NetCanOemBoard
from hil.sim_devices.force.netft import NetFtCanBox, RdtBox
from hil.sim_devices.force.transducer import Transducer
from hil.sim_devices.simtime import VirtualTime

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
