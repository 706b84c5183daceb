"""Where the words of a force/torque sensor come from: a protocol, and the ideal one."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from hil.drivers.ft_sensor import convert
from hil.signals.device import FloatArray, IntArray, Status, Wire


@runtime_checkable
class GaugeSource(Protocol):
    """Six words of a sensor, and what they mean.

    Attributes
    ----------
    gauges : ndarray (6,) of int
        Words of the last whole sample; stays the same array.
    calibration : ndarray (6, 6)
        Wrench in the sensor frame per word [N, N m].
    certificate : dict of str to str
        What the sensor said of itself: serial number, matrix and so on.
    """

    gauges: IntArray
    calibration: FloatArray
    certificate: dict[str, str]

    def receive(self, t_ns: int) -> Status:
        """Take what has arrived by `t_ns` and ask for the next sample; never waits or raises.

        STALE: `gauges` hold the last good sample.  LOST: there has been none for too long.
        """
        ...

    def sample(self, t_ns: int) -> int:
        """Wait for one new sample from `t_ns` on; return the time then [ns].

        Raises
        ------
        DeviceError
            If none comes, or it is not usable.
        """
        ...

    def check(self) -> None:
        """Refuse with a `DeviceError` while the sensor cannot be used."""
        ...

    def close(self) -> None:
        """Release what the source holds."""
        ...


#: Largest word of a converter with 16 bits.
FULL_SCALE = 32767
_OK = Status.OK


class IdealGauges:
    """Words of the ideal wire: every reading is there, whole and of now.

    Parameters
    ----------
    wire : Wire
        Wire to the gauges.
    calibration : ndarray (6, 6)
        Wrench per word [N, N m].
    period : float
        Sample period [s].
    """

    def __init__(self, wire: Wire, calibration: FloatArray, period: float) -> None:
        self._wire = wire
        self._period_ns = round(period * 1e9)
        self.gauges, self.calibration = wire.gauges, calibration
        self.certificate: dict[str, str] = {}

    def receive(self, t_ns: int) -> Status:
        """Refresh the words; CLAMPED where one stands at the end of its converter."""
        status = self._wire.receive(t_ns)
        if status is _OK and convert.at_end(self.gauges, FULL_SCALE):
            return Status.CLAMPED
        return status

    def sample(self, t_ns: int) -> int:
        """Words of one period later."""
        self._wire.receive(t_ns + self._period_ns)
        return t_ns + self._period_ns

    def check(self) -> None:
        """Always usable."""

    def close(self) -> None:
        """Release the wire."""
        self._wire.close()
