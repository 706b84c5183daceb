"""Fault injection into a session: where faults get in, and what can be done there.

Faults get in through the answers of the devices, the law, the clock and the simulated boxes.  The
functions below `FaultySession` make, or are, what a fault does when it strikes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from hil.rig.config import RigConfig
from hil.rig.open import Rig, open_rig
from hil.runtime.clock import Clock, MonotonicClock, VirtualClock
from hil.signals.device import Controller, FloatArray, Status

#: When faults strike [tick].
STRIKE_TICK = 400


class FaultySession:
    """A session under attack; a fault sets hooks here, or reaches into `rig`.

    Attributes
    ----------
    rig : Rig
        Open.
    js, cf, jf : callable or None
        Called with (arrays..., status) of arm 0 after the driver; return the status to give.
    law : callable or None
        Called with (y,) after the law.
    words : callable or None
        Called with (counts, gauges) (arms, 3), (arms, 6) after every tick of the simulation.
    skip : int
        Periods by which the clock jumps before the next tick.
    sources : Sources or None
        Where a `steered` session has its time from, through the clock of real sessions.
    """

    def __init__(
        self, strike: Callable[[FaultySession], None], at: int = STRIKE_TICK, steered: bool = False
    ) -> None:
        self._strike, self.at = strike, at
        self.sources = Sources() if steered else None
        self.rig: Rig
        self.js: Callable[[FloatArray, FloatArray, Status], Status] | None = None
        self.cf: Callable[[FloatArray, Status], Status] | None = None
        self.jf: Callable[[FloatArray, Status], Status] | None = None
        self.law: Callable[[FloatArray], None] | None = None
        self.words: Callable[[Any, Any], None] | None = None
        self.skip = 0
        self.struck = 0
        self.tick = 0

    def open(self, config: RigConfig, seed: int) -> Rig:
        """`hil.rig.open.open_rig` with the hooks in place."""
        rig = open_rig(config, seed)
        rig.controller = _Law(self, rig.controller)
        port = rig.ports[0]
        rig.ports[0] = dataclasses.replace(
            port,
            joints=_Joints(self, port.joints),
            efforts=_Efforts(self, port.efforts),
            force=_Force(self, port.force),
        )
        if rig.bench is not None:
            rig.bench.after.append(self._after)
        self.rig = rig
        return rig

    def timer(self, period_ns: int) -> Clock:
        """Clock that tells this of its ticks: a virtual one, or the real one on other sources."""
        if self.sources is None:
            return _Jumping(self, period_ns)
        return _Steered(self, period_ns, self.sources)

    def begin(self, tick: int) -> None:
        """A tick begins: strike when it is time."""
        self.tick = tick
        if tick >= self.at and not self.struck:
            self.struck = tick
            self._strike(self)

    def _after(self, now_ns: int) -> None:
        if self.words is not None:
            self.words(self.rig.bench.counts, self.rig.bench.gauges)


class _Jumping(VirtualClock):
    def __init__(self, faulty: FaultySession, period_ns: int) -> None:
        super().__init__(period_ns)
        self._faulty = faulty

    def wait(self, tick: int) -> int:
        self._faulty.begin(tick)
        skipped, self._faulty.skip = self._faulty.skip, 0
        self.missed += skipped
        return super().wait(tick + skipped)


class Sources:
    """Monotonic time and time of day of a machine, in virtual time: asking takes 5 us.

    Attributes
    ----------
    mono_ns, wall_ns : int
        What its clocks show.
    """

    def __init__(self) -> None:
        self.mono_ns, self.wall_ns = 10**12, 1_800_000_000 * 10**9

    def now(self) -> int:
        """Monotonic time [ns]."""
        self.mono_ns += 5000
        self.wall_ns += 5000
        return self.mono_ns

    def sleep(self, seconds: float) -> None:
        """Pass."""
        self.mono_ns += round(seconds * 1e9)
        self.wall_ns += round(seconds * 1e9)

    def wall(self) -> int:
        """Time of day [ns]."""
        return self.wall_ns


class _Steered(MonotonicClock):
    def __init__(self, faulty: FaultySession, period_ns: int, sources: Sources) -> None:
        super().__init__(period_ns, sources.now, sources.sleep, sources.wall)
        self._faulty = faulty

    def wait(self, tick: int) -> int:
        self._faulty.begin(tick)
        return super().wait(tick)


class _Proxy:
    """A device with one answer changed; the rest is its own."""

    def __init__(self, faulty: FaultySession, inner: Any) -> None:
        self._faulty, self._inner = faulty, inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


class _Joints(_Proxy):
    def measured_js(self, t_ns: int, position: FloatArray, velocity: FloatArray) -> Status:
        status: Status = self._inner.measured_js(t_ns, position, velocity)
        hook = self._faulty.js
        return hook(position, velocity, status) if hook else status


class _Force(_Proxy):
    def measured_cf(self, t_ns: int, position: FloatArray, wrench: FloatArray) -> Status:
        status: Status = self._inner.measured_cf(t_ns, position, wrench)
        hook = self._faulty.cf
        return hook(wrench, status) if hook else status


class _Efforts(_Proxy):
    def servo_jf(self, effort: FloatArray, sent: FloatArray) -> Status:
        status: Status = self._inner.servo_jf(effort, sent)
        hook = self._faulty.jf
        return hook(sent, status) if hook else status

    def fault(self) -> None:
        self._inner.fault()


class _Law:
    def __init__(self, faulty: FaultySession, inner: Controller) -> None:
        self._faulty, self._inner = faulty, inner
        self.state_names = inner.state_names

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        self._inner.update(t, x, u, x_next, y)
        if self._faulty.law is not None:
            self._faulty.law(y)


def times(n: int, status: Status) -> Callable[..., Status]:
    """Answer with `status` for `n` calls, then with what the device says."""
    left = [n]

    def answer(*said: Any) -> Status:
        left[0] -= 1
        return status if left[0] >= 0 else said[-1]

    return answer


def fill(value: float, status: Status | None = None) -> Callable[..., Any]:
    """Write `value` over the first array of an answer."""

    def answer(*said: Any) -> Any:
        said[0][:] = value
        return status if status is not None else said[-1]

    return answer


def delayed(n: int) -> Callable[..., Status]:
    """For `n` calls give the position and speed of the call before the first once more."""
    kept: list[Any] = []
    left = [n]

    def answer(position: Any, velocity: Any, said: Status) -> Status:
        if not kept:
            kept.append((np.array(position), np.array(velocity)))
        elif left[0] > 0:
            left[0] -= 1
            position[:], velocity[:] = kept[0]
        return said

    return answer


def frozen(arm: int) -> Callable[[Any, Any], None]:
    """Counts of an arm stay where they are."""
    kept: list[Any] = []

    def words(counts: Any, gauges: Any) -> None:
        if not kept:
            kept.append(np.array(counts[arm]))
        counts[arm] = kept[0]

    return words


def hook(name: str, make: Callable[[], Any]) -> Callable[[FaultySession], None]:
    """Set a hook of the session."""
    return lambda t: setattr(t, name, make())


def counts(change: Callable[[Any], None]) -> Callable[[FaultySession], None]:
    """Change the counts (arms, 3) after every tick of the simulation from now on."""
    return hook("words", lambda: lambda counts, gauges: change(counts))


def gauges(change: Callable[[Any], None]) -> Callable[[FaultySession], None]:
    """Change the gauge words (arms, 6) after every tick of the simulation from now on."""
    return hook("words", lambda: lambda counts, gauges: change(gauges))


def add(row: int, column: int, value: int) -> Callable[[Any], None]:
    """Add to one word."""

    def change(words: Any) -> None:
        words[row, column] += value

    return change


def put(row: int, column: int | slice, value: int) -> Callable[[Any], None]:
    """Write over words of one arm."""

    def change(words: Any) -> None:
        words[row, column] = value

    return change


def shake(words: Any) -> None:
    """Move the counts of the first arm to and fro."""
    words[0] += np.array([60, -60, 60]) * (1 if words[0, 0] % 2 else -1)


def failing(t: FaultySession) -> None:
    """The law raises an exception."""

    def broken(y: Any) -> None:
        raise ZeroDivisionError("the law divides by zero")

    t.law = broken


def late_every_tick(t: FaultySession) -> None:
    """The law takes longer than a period, in every tick."""

    def slow(y: Any) -> None:
        t.skip = 1

    t.law = slow


def box(name: str, **attributes: Any) -> Callable[[FaultySession], None]:
    """Set attributes of a simulated box, or of its faults (``faults.mute``)."""

    def strike(t: FaultySession) -> None:
        for key, value in attributes.items():
            target = t.rig.bench.wired.boxes[name]
            if not hasattr(target, key):
                target = target.faults
            setattr(target, key, value)

    return strike


def replugged(t: FaultySession) -> None:
    """Unplug the encoder box for 50 ticks."""
    encoders = t.rig.bench.wired.boxes["encoders"]
    encoders.plugged = False
    t.words = lambda counts, gauges: setattr(encoders, "plugged", t.tick > t.struck + 50)


def turn(**clocks: int) -> Callable[[FaultySession], None]:
    """Add to what the machine's clocks show [ns]."""

    def strike(t: FaultySession) -> None:
        for name, by in clocks.items():
            setattr(t.sources, name, getattr(t.sources, name) + by)

    return strike


def nothing(t: FaultySession) -> None:
    """What goes wrong is in the rig file."""
