"""A force sensor that is asked over CAN and answers in two frames: one request at a time.

The tick collects the answer to the request of the tick before and asks again, so that the bus
works while the loop waits for its next tick.  The price is one period of delay.  Request and
answer may share an identifier, so nothing is asked while an answer may still be on its way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.drivers.links.can import CanLink, can_frame
from hil.errors import DeviceError, DeviceTimeoutError
from hil.signals.device import IntArray, Status

#: What the time moves on by for one sample of a tare, and how long it waits at least [ns].
PACE_NS, CALM_NS = 1_000_000, 3_000_000


@dataclass(frozen=True)
class Patience:
    """How long what may take [ns]: an answer, until a sample is STALE, until it is LOST."""

    answer: int
    stale: int
    lost: int


class PolledGauges:
    """Words that are asked for; a sensor derives from it and fills in `_take` and `unusable_text`.

    Parameters
    ----------
    name : str
        Name of the box.
    link : CanLink
        Bus that it hangs on.
    request : tuple of int and bytes
        Identifier and data that ask for a sample.
    patience : Patience
        Times.

    Attributes
    ----------
    gauges : ndarray (6,) of int
        Words of the last good sample.
    unusable : bool
        The last sample could not be used.
    trouble : str
        Why the sensor is lost; empty while it is not.
    timeouts, halves, malformed : int
        Requests without a whole answer, second frames without a first, frames of a wrong length.
    """

    def __init__(
        self, name: str, link: CanLink, request: tuple[int, bytes], patience: Patience
    ) -> None:
        self.name = name
        self.gauges: IntArray = np.zeros(6, np.int64)
        self.unusable, self.trouble = False, ""
        self.timeouts = self.halves = self.malformed = 0
        self._link, self._request, self._patience = link, can_frame(*request), patience
        self._pending: IntArray = np.zeros(6, np.int64)
        self._got = 0
        self._asked_ns: int | None = None
        #: Time of the last sample; negative = counted from the next tick on.
        self._fresh_ns = -1

    def _take(self) -> bool:
        """Judge the whole sample in `_pending`; keep it in `gauges` if it is good."""
        raise NotImplementedError

    def unusable_text(self) -> str:
        """Why the last sample could not be used."""
        raise NotImplementedError

    def receive(self, t_ns: int) -> Status:
        """Take the sample that has arrived, ask for the next one; never waits or raises."""
        link = self._link
        link.advance(t_ns)
        link.poll()
        if self._fresh_ns < 0:
            self._fresh_ns = t_ns
        good = False
        if self._got == 2:
            good = self._take()
            self.unusable = not good
            self._asked_ns = None
        elif self._asked_ns is not None and t_ns - self._asked_ns >= self._wait_ns():
            # what comes late belongs to the old request: one more tick for it to come, in which
            # nothing is asked that it could be mistaken for
            self.timeouts += 1
            self._asked_ns = None
            return self._age(t_ns, False)
        if good:
            self._fresh_ns = t_ns
        if self._asked_ns is None:
            self._got = 0
            link.post(self._request)
            self._asked_ns = t_ns
        return self._age(t_ns, good)

    def _wait_ns(self) -> int:
        """How long an answer may take: on a slow bus, until all sensors on it have had theirs."""
        return max(self._patience.answer, self._link.round_ns)

    def _age(self, t_ns: int, good: bool) -> Status:
        """Status of the last good sample by its age; a sample that is not usable ages it."""
        age = t_ns - self._fresh_ns
        if age >= self._patience.lost:
            if not self.trouble:
                self.trouble = f"box {self.name!r}: {self._why(age)}."
            return Status.LOST
        if good or (age < self._patience.stale and not self.unusable):
            return Status.OK
        return Status.STALE

    def _why(self, age: int) -> str:
        """Why there has been no good sample for so long."""
        if self.unusable:
            return self.unusable_text().removeprefix(f"{self.name}: ")
        refused = f" (the bus refused: {self._link.trouble})" if self._link.trouble else ""
        return f"no sample for {age * 1e-6:.0f} ms{refused}"

    def sample(self, t_ns: int) -> int:
        """Ask for a sample, wait for it, and keep it.

        Raises
        ------
        DeviceTimeoutError
            If no answer comes in time, three times.
        DeviceError
            If the sample is not usable.
        """
        self._asked_ns, self._fresh_ns, self.trouble = None, -1, ""
        patience = max(CALM_NS, self._wait_ns())
        for _ in range(3):
            self._link.advance(t_ns)
            self._link.poll()
            self._got = 0
            self._link.post(self._request)
            if self._link.wait(patience * 1e-9, self._whole):
                self._got = 0
                self.unusable = not self._take()
                if self.unusable:
                    raise DeviceError(self.unusable_text())
                return t_ns + PACE_NS
            t_ns += patience
            self.timeouts += 1
        raise DeviceTimeoutError(
            f"{self.name}: no whole sample within {patience * 1e-6:g} ms, three times"
            + (f" (the bus refused: {self._link.trouble})" if self._link.trouble else "")
        )

    def _whole(self) -> bool:
        return self._got == 2

    def check(self) -> None:
        """Refuse while the sensor cannot be used; the age of its sample starts anew."""
        if self._link.trouble:
            raise DeviceError(f"{self.name}: the CAN bus refused: {self._link.trouble}")
        if self.unusable:
            raise DeviceError(self.unusable_text())
        self._fresh_ns = -1
