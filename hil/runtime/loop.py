"""The fast loop: read, update, limit, write, one row into the ring; nothing else.

No array is allocated, nothing is logged, no lock is taken per tick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.record.ring import Ring
from hil.runtime import safety
from hil.runtime.clock import Clock
from hil.runtime.frame import FrameLayout
from hil.signals.device import Controller, FloatArray, IntArray, MeasuredCf, MeasuredJs, ServoJf


@dataclass(frozen=True)
class ArmPort:
    """What the loop needs of one arm: capabilities and words, whoever provides them.

    Parameters
    ----------
    joints : MeasuredJs
        Joint state.
    efforts : ServoJf
        Takes joint efforts.
    force : MeasuredCf or None
        Force at the tip.
    counts, codes : ndarray (3,) of int
        Words of the last exchange.
    gauges : ndarray (6,) of int
        Words of the force sensor.
    torque_limit, speed_limit : ndarray (3,)
        [N m], [rad/s].
    """

    joints: MeasuredJs
    efforts: ServoJf
    force: MeasuredCf | None
    counts: IntArray
    codes: IntArray
    gauges: IntArray
    torque_limit: FloatArray
    speed_limit: FloatArray


class Loop:
    """Fast loop over some arms.

    Parameters
    ----------
    ports : list of ArmPort
        Arms in the order of the controller.
    controller : Controller
        The law.
    clock : Clock
        Virtual or monotonic.
    ring : Ring
        Takes one row per tick, laid out by `layout`.
    layout : FrameLayout
        Where everything stands in a row.
    period_ns, origin_ns : int
        Tick, and device time of tick 0 [ns].
    """

    def __init__(
        self, ports: list[ArmPort], controller: Controller, clock: Clock, ring: Ring,
        layout: FrameLayout, period_ns: int, origin_ns: int,
    ) -> None:  # fmt: skip
        self._controller, self._clock, self._ring = controller, clock, ring
        self._period_ns, self._origin_ns = period_ns, origin_ns
        self.frame = layout.zeros()
        self._u, self._state, self._timing = layout.views(self.frame)
        self._y = np.zeros((len(ports), 3))
        self._arms = [(p, *layout.arm(self.frame, i), self._y[i]) for i, p in enumerate(ports)]
        self._x = np.zeros(len(controller.state_names))
        self._x_next = np.zeros(len(controller.state_names))
        self.tick = 0
        self.longest_ns = 0
        self.worst = safety.OK
        self.clamped = 0

    def rehearse(self) -> None:
        """Do once all that a tick does, with the devices not enabled and nothing recorded.

        Loads compiled code before the first deadline; leaves no trace in the controller.
        """
        self._read(self._origin_ns)
        self._write()
        self._controller.update(0.0, self._x, self._u, self._x_next, self._y)
        self._y[:] = 0.0

    def step(self) -> None:
        """One tick."""
        clock, timing = self._clock, self._timing
        self.tick = tick = clock.wait(self.tick + 1)
        t_ns = tick * self._period_ns
        woken = clock.since_start()
        self._read(t_ns + self._origin_ns)
        self._controller.update(t_ns * 1e-9, self._x, self._u, self._x_next, self._y)
        self._x, self._x_next = self._x_next, self._x
        status = self._write()
        self._state[:] = self._x
        done = clock.since_start()
        timing[0] = woken - t_ns
        timing[1] = done - woken
        timing[2] = clock.missed
        timing[3] = self._ring.dropped
        timing[4] = status
        self._ring.push(tick, t_ns + clock.epoch_ns, self.frame)
        if done - woken > self.longest_ns:
            self.longest_ns = done - woken
        if status > safety.OK:
            self.clamped += 1
            self.worst = max(self.worst, status)

    def _read(self, t_ns: int) -> None:
        """Measured joint states and forces of all arms."""
        for port, q, qd, wrench, _sent, _words, _y in self._arms:
            port.joints.measured_js(t_ns, q, qd)
            if port.force is not None:
                port.force.measured_cf(t_ns, q, wrench)

    def _write(self) -> int:
        """Limited efforts to all arms, words into the row; the worst status."""
        status = safety.OK
        for port, _q, qd, _wrench, sent, words, y in self._arms:
            safe = safety.limit(y, qd, port.torque_limit, port.speed_limit)
            if safe == safety.INVALID:
                port.efforts.fault()
            status = max(status, safe, port.efforts.servo_jf(y, sent))
            words[0:3] = port.counts
            words[3:6] = port.codes
            words[6:12] = port.gauges
        return status

    @property
    def dropped(self) -> int:
        """Rows that the ring could not take."""
        return self._ring.dropped

    @property
    def unsafe(self) -> bool:
        """An arm went to FAULT: an effort or a speed was not acceptable."""
        return self.worst == safety.INVALID
