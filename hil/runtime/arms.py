"""Exchange with all arms in one tick: measured and examined values in, limited efforts out.

No array is allocated, nothing is logged, no lock is taken.
"""

from __future__ import annotations

import numpy as np

from hil.runtime import safety, watch
from hil.runtime.conditions import BITS
from hil.runtime.frame import FrameLayout
from hil.runtime.port import ArmPort
from hil.signals.device import FloatArray, Status
from hil.signals.state import OperatingState

_LIMITED, _INVALID = BITS["effort-limited"], BITS["effort-invalid"]
_REFUSED, _OUT = BITS["motor-refused"], BITS["workspace"]
_OK = int(Status.OK)
_ENABLED, _FAULT = OperatingState.ENABLED, OperatingState.FAULT


class Arms:
    """The arms of a loop, with their parts of its row.

    Parameters
    ----------
    ports : list of ArmPort
        Arms in the order of the controller.
    layout : FrameLayout
        Where everything stands in a row.
    frame : ndarray
        The row: measured values, efforts sent and words are written into it.
    period_ns : int
        Tick [ns].

    Attributes
    ----------
    efforts : ndarray (arms, 3)
        What the law commands [N m]; limited in place.
    worst : int
        Worst status of the tick.
    hottest : float
        Hottest winding [degC].
    """

    def __init__(
        self, ports: list[ArmPort], layout: FrameLayout, frame: FloatArray, period_ns: int
    ) -> None:
        self.efforts = np.zeros((len(ports), 3))
        self.worst, self.hottest = _OK, 0.0
        self._arms = [
            (p, *layout.arm(frame, i), self.efforts[i], np.zeros(watch.MEMORY), np.zeros(3))
            for i, p in enumerate(ports)
        ]
        self._period_ns, self._steps = period_ns, 1

    def forget(self) -> None:
        """No effort, and no memory of what was measured."""
        self.efforts[:] = 0.0
        for *_, memory, _tip in self._arms:
            memory[:] = 0.0

    def read(self, t_ns: int, steps: int) -> int:
        """Measured joint states and forces of all arms; the conditions that they show.

        Parameters
        ----------
        t_ns : int
            Time of the devices [ns].
        steps : int
            Periods since the last tick.
        """
        mask, worst, hot = 0, _OK, 0.0
        single = steps == 1 and self._steps == 1
        dt, self._steps = steps * self._period_ns * 1e-9, steps
        for port, q, qd, wrench, sent, _words, _y, memory, tip in self._arms:
            js = int(port.joints.measured_js(t_ns, q, qd))
            force = port.force
            cf = _OK if force is None else int(force.measured_cf(t_ns, q, wrench))
            mask |= watch.examine(
                dt, single, js, cf, q, qd, wrench, sent, memory, port.limits
            )  # fmt: skip
            if port.tip is not None:
                port.tip(q, tip)
                if watch.outside(tip, port.box):
                    mask |= _OUT
            if js > worst or cf > worst:
                worst = max(js, cf)
            hot = max(hot, memory.item(watch.HOTTEST))
        self.worst, self.hottest = worst, hot
        return mask

    def write(self, state: OperatingState) -> int:
        """Limited efforts to all arms, words into the row; the conditions found on the way."""
        # plain integers: an enumeration beside a number of numpy costs a microsecond
        mask, worst = 0, self.worst
        enabled, faulted = state is _ENABLED, state is _FAULT
        for port, _q, qd, _wrench, sent, words, y, _memory, _tip in self._arms:
            safe = safety.limit(y, qd, port.torque_limit, port.speed_limit)
            if safe == safety.INVALID:
                port.efforts.fault()
                mask |= _INVALID if enabled else 0
            said = int(port.efforts.servo_jf(y, sent))
            if safe == safety.CLAMPED or said == safety.CLAMPED:
                mask |= _LIMITED
            elif said >= safety.INVALID and safe != safety.INVALID and not faulted:
                mask |= _REFUSED
            if said > worst or safe > worst:
                worst = max(said, safe)
            watch.leave(sent, port.counts, port.codes, port.gauges, words)
        self.worst = worst
        return mask

    def let_go(self) -> None:
        """FAULT in every arm, and no effort sent."""
        self.efforts[:] = 0.0
        for port, _q, _qd, _wrench, sent, words, y, *_ in self._arms:
            port.efforts.fault()
            port.efforts.servo_jf(y, sent)
            words[3:6] = port.codes
