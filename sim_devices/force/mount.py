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
from sim_devices.bench import Bench
from sim_devices.canbus.line import LINES, CanLine
from sim_devices.force.netcanoem import DEFAULT_BASE, NetCanOemBoard
from sim_devices.force.transducer import Transducer
from sim_devices.simtime import VirtualTime

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


class SimCan:
    """CAN lines of a bench, one a channel; the boards on them read the world.

    What goes over the bus in a tick sees the world of the tick's start: a sample that a board
    takes 50 us after the request is not of the end of the tick.

    Attributes
    ----------
    handle : dict
        For the driver: python-can's interface, and what stands before the name of a channel.
    lines : dict of str to CanLine
        By channel.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self.time = VirtualTime()
        self.handle = {"interface": "hil-sim", "prefix": f"bench{next(_NUMBER)}:"}
        self.lines: dict[str, CanLine] = {}

    def line(self, channel: str) -> CanLine:
        """Line of a channel, made when it is first wanted."""
        if channel not in self.lines:
            if not self.lines:
                self._bench.before.append(self._run)
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

    def netcanoem(self, address: str, options: dict[str, Any], arm: str) -> NetCanOemBoard:
        """Board with the sensor of an arm at ``CHANNEL/BASE``, set as the driver expects it."""
        channel, _, base = (address or "can0").partition("/")
        try:
            number = int(base, 0) if base else int(options.get("base", DEFAULT_BASE))
        except ValueError:
            raise ConfigError(f"simulated board: {address!r} is not CHANNEL/BASE.") from None
        bench = self._bench
        index = bench.names.index(arm)
        transducer = Transducer(bench.sensors[arm], [bench.seed, index], press(bench, arm))
        board = NetCanOemBoard(
            transducer,
            number,
            options.get("bit_rate", 1_000_000),
            slot=options.get("calibration", 0),
        )  # fmt: skip
        self.line(channel).attach(board)
        return board
