"""A device under test: its time, its far end, and one period as the loop does it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.signals.device import (
    Device,
    FloatArray,
    MeasuredCf,
    MeasuredJs,
    ServoJf,
    Status,
    Tareable,
)
from hil.testing.effects import ConformanceError
from hil.testing.far import FarEnd, Tolerance

#: Within this time a lost or silent device must be noticed [s].
NOTICED = 0.2


class Bench:
    """A device under test with its time."""

    def __init__(
        self, again: Callable[[], Device], far: FarEnd, period: float, settle: float,
        tolerance: Tolerance,
    ) -> None:  # fmt: skip
        self.device, self.again, self.far, self.tol = again(), again, far, tolerance
        self.step_ns, self.period = round(period * 1e9), period
        self.settle = max(1, round(settle / period))
        self.t_ns = far.now_ns
        self.q, self.qd = np.zeros(far.joints), np.zeros(far.joints)
        self.wrench, self.sent = np.zeros(6), np.zeros(far.joints)
        self.effort = np.zeros(far.joints)
        if isinstance(self.device, Tareable):
            self.t_ns = self.device.tare(self.t_ns)

    def require(self, held: bool, text: str) -> None:
        """Raise with the name of the device where a rule is broken."""
        if not held:
            raise ConformanceError(f"device {self.device.name!r}: {text}")

    def tick(self, effort: FloatArray | None = None) -> Status:
        """One period as the loop does it; the worst status."""
        self.t_ns += self.step_ns
        self.far.advance(self.t_ns)
        status, device = Status.OK, self.device
        try:
            if isinstance(device, MeasuredJs):
                status = max(status, device.measured_js(self.t_ns, self.q, self.qd))
            if isinstance(device, MeasuredCf):
                at = self.q if isinstance(device, MeasuredJs) else self.far.pose
                status = max(status, device.measured_cf(self.t_ns, at, self.wrench))
            if isinstance(device, ServoJf):
                self.effort[:] = 0.0 if effort is None else effort
                status = max(status, device.servo_jf(self.effort, self.sent))
        except Exception as error:
            raise ConformanceError(
                f"device {device.name!r}: a call of the fast path raised {error!r}; it must "
                "answer with a Status"
            ) from error
        self.require(isinstance(status, Status), f"returned {status!r}, expected a Status")
        return status

    def ticks(self, n: int, effort: FloatArray | None = None) -> Status:
        """Worst status of some ticks."""
        return max(self.tick(effort) for _ in range(n))

    def reopen(self) -> None:
        """Open the device anew, after which the far end's time holds if it is later."""
        self.device = self.again()
        self.t_ns = max(self.t_ns, self.far.now_ns)

    def enable(self) -> None:
        """Enable, after some ticks in which the driver may fill its windows."""
        self.ticks(self.settle)
        self.device.enable()
        self.ticks(self.settle)

    def notices(self) -> Status:
        """Run until a trouble shows in the status, at most `NOTICED`."""
        for _ in range(round(NOTICED / self.period)):
            status = self.tick()
            if status >= Status.STALE:
                return status
        return Status.OK
