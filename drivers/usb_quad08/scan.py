"""Which scan of a stream stands for which time: the newest whole one, on an even grid."""

from __future__ import annotations

#: Clocks of host and box differ by at most this, by which the estimated delay may grow [ns/ns].
DRIFT = 200e-6


class ScanClock:
    """Relates the loop's time to numbers of scans.

    Packets arrive at their own rate, so that the newest scan is up to one packet old, by another
    age at every tick.  A speed from such counts would be wrong by the change of age: hence the
    newest scan that is there *at every tick*, one packet behind the shortest delay seen.

    Parameters
    ----------
    period_ns : float
        Time between scans.
    packet_ns : float
        Time that a packet takes to fill.
    """

    def __init__(self, period_ns: float, packet_ns: float) -> None:
        self._period, self._packet = period_ns, packet_ns
        self._delay = float("inf")
        self._then = 0

    def choose(self, t_ns: int, newest: int) -> int:
        """Number of the scan for time `t_ns` when scan `newest` has arrived whole."""
        # scan k was taken at k period + delay, delay = min over time of t - newest period
        delay = t_ns - newest * self._period
        if delay < self._delay:
            self._delay = delay
        else:
            self._delay = min(delay, self._delay + DRIFT * (t_ns - self._then))
        self._then = t_ns
        wanted = int((t_ns - self._delay - self._packet) // self._period)
        return min(wanted, newest)
