"""The faults: how they get in, what is done, the state it must lead to, and within how many ticks.

Faults get in through the answers of the devices, the law, the clock and the simulated boxes.  The
functions below `FaultySession` make, or are, what a fault does when it strikes; the list of all
faults follows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
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


def _delayed(n: int) -> Callable[..., Status]:
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


_OK, _STALE, _INVALID, _CLAMPED = Status.OK, Status.STALE, Status.INVALID, Status.CLAMPED
#: No limit on how soon: the fault shows only by what it does to the arm.
EVER = 100_000
#: After the first second, in which missed periods do not count [tick].
_WARM = 1300


@dataclass(frozen=True)
class Fault:
    """One fault of the campaign.

    Parameters
    ----------
    name : str
        What happens.
    strike : callable
        Does it to a session.
    state : str
        Operating state that must follow; ``"ENABLED"``: the loop goes on.
    condition : str
        What the record must call it; empty: nothing.
    within : int
        Ticks from the strike to that state, that of the strike included.
    wire : bool
        On simulated buses instead of ideal wires.
    rig : str
        Rig file.
    over : mapping
        Tables over the rig file.
    exit : str
        How the session must end: ``"done"``, ``"fault"`` or ``"broken off"``.
    note : str
        What the reader should know.
    at : int
        Tick of the strike; 1 where the fault is in the rig file.
    steered : bool
        With the clock of real sessions, on sources of time that the fault can turn.
    """

    name: str
    strike: Callable[[FaultySession], None]
    state: str
    condition: str
    within: int = 2
    wire: bool = False
    rig: str = "teleop"
    over: Mapping[str, Any] = field(default_factory=dict)
    exit: str = ""
    note: str = ""
    at: int = STRIKE_TICK
    steered: bool = False

    @property
    def ends(self) -> str:
        """Last event of the session."""
        return self.exit or ("fault" if self.state == "FAULT" else "done")


def _limit(arm: str = "leader", **table: Any) -> dict[str, Any]:
    return {"arms": {arm: table}}


_SENSORS = (
    Fault("encoder reading late once", hook("js", lambda: times(1, _STALE)), "ENABLED",
          "sensor-late"),
    Fault("encoder readings stay late", hook("js", lambda: times(EVER, _STALE)), "PAUSED",
          "joint-stale"),
    Fault("encoder reading delivered twice", hook("js", lambda: _delayed(1)), "ENABLED", "",
          note="as an arm that stands still for a tick"),
    Fault("encoders lost", hook("js", lambda: times(EVER, _INVALID)), "FAULT", "joint-lost"),
    Fault("encoders lost for one tick", hook("js", lambda: times(1, _INVALID)), "FAULT",
          "joint-lost", note="latched"),
    Fault("position is not a number", hook("js", lambda: fill(np.nan)), "FAULT", "not-a-number"),
    Fault("encoder jumps by 1000 counts", counts(add(0, 1, 1000)), "FAULT", "encoder-jump"),
    Fault("encoder jumps by 100 counts", counts(add(1, 2, 100)), "FAULT", "encoder-jump"),
    Fault("encoder word wraps at 16 bits", counts(add(0, 0, -65536)), "FAULT", "encoder-jump"),
    Fault("encoder counts flip back and forth", counts(shake), "FAULT", "encoder-jump"),
    Fault("encoder stands still in motion", hook("words", lambda: frozen(0)), "FAULT",
          "encoder-stuck", EVER, rig="identify", over={"loop": {"seconds": 4.0}},
          note="seen when the servo pushes against it"),
    Fault("encoder loses 5 counts", counts(add(0, 0, 5)), "ENABLED", "",
          note="below the floor; 'hil diagnose' names missed-counts"),
    Fault("force reading late once", hook("cf", lambda: times(1, _STALE)), "ENABLED",
          "sensor-late"),
    Fault("force readings stay late", hook("cf", lambda: times(EVER, _STALE)), "PAUSED",
          "force-stale"),
    Fault("force sensor lost", hook("cf", lambda: times(EVER, _INVALID)), "FAULT", "force-lost"),
    Fault("force is not a number", hook("cf", lambda: fill(np.nan)), "FAULT", "not-a-number"),
    Fault("one gauge saturated", gauges(put(1, 0, 32767)), "PAUSED", "force-saturated"),
    Fault("all gauges saturated", gauges(put(1, slice(0, 6), 32767)), "PAUSED",
          "force-saturated"),
    Fault("force above the red lamp", hook("cf", lambda: fill(70.0, _OK)), "PAUSED", "force-red"),
    Fault("force at the yellow lamp", hook("cf", lambda: fill(50.0, _OK)), "ENABLED",
          "force-yellow"),
)  # fmt: skip
_LAW = (
    Fault("law gives not a number", hook("law", lambda: fill(np.nan)), "FAULT", "effort-invalid"),
    Fault("law gives infinity", hook("law", lambda: fill(np.inf)), "FAULT", "effort-invalid"),
    Fault("law gives not a number for one joint",
          hook("law", lambda: lambda y: y.__setitem__((1, 2), np.nan)), "FAULT",
          "effort-invalid"),
    Fault("law asks for 100 times the torque", hook("law", lambda: lambda y: y.__imul__(100)),
          "FAULT", "effort-limited", EVER, note="limited at once; then the arm swings"),
    Fault("law pushes one way with all it has", hook("law", lambda: fill(5.0)), "FAULT",
          "overspeed", EVER, note="runs away until the speed limit"),
    Fault("law raises an exception", failing, "ENABLED", "", exit="broken off",
          note="unwound: torque and power off, file closed"),
    Fault("motor driver refuses", hook("jf", lambda: times(EVER, _INVALID)), "FAULT",
          "motor-refused"),
    Fault("motor driver refuses once", hook("jf", lambda: times(1, _INVALID)), "FAULT",
          "motor-refused", note="latched"),
    Fault("motor driver sends more than its limit", hook("jf", lambda: fill(5.0)), "FAULT",
          "effort-exceeded"),
    Fault("motor driver says it sent what is not a number", hook("jf", lambda: fill(np.nan)),
          "FAULT", "effort-exceeded"),
    Fault("motor driver limits", hook("jf", lambda: times(EVER, _CLAMPED)), "ENABLED",
          "effort-limited"),
    Fault("speed above its limit", nothing, "FAULT", "overspeed", EVER,
          rig="identify", over=_limit(speed_limit=[0.2, 0.2, 0.2]), at=1),
    Fault("joint leaves its range", nothing, "PAUSED", "position", EVER, rig="identify",
          over=_limit(position_min=[-0.05, 0.3, 0.2], position_max=[0.05, 0.5, 0.4]), at=1),
    Fault("tip leaves the workspace", nothing, "PAUSED", "workspace", EVER, rig="identify",
          over=_limit(workspace_min=[0.0, -0.01, -1.0], workspace_max=[1.0, 0.01, 1.0]), at=1),
    Fault("winding too hot", nothing, "PAUSED", "winding-red", EVER, rig="identify",
          over=_limit(winding={"yellow": 25.02, "red": 25.05}), at=1),
)  # fmt: skip
_CLOCK = (
    Fault("law takes 5 ms once", hook("skip", lambda: 4), "ENABLED", ""),
    Fault("law takes 300 ms", hook("skip", lambda: 300), "PAUSED", "overrun", at=_WARM),
    Fault("clock jumps by 10 s", hook("skip", lambda: 10_000), "PAUSED", "overrun",
          over={"loop": {"seconds": 12.0}}),
    Fault("clock jumps back by 10 s", turn(mono_ns=-10 * 10**9), "ENABLED", "", steered=True,
          note="counted; the grid follows, the next tick comes a period later"),
    Fault("clock jumps back by half a period", turn(mono_ns=-500_000), "ENABLED", "",
          steered=True),
    Fault("clock jumps ahead by 300 ms", turn(mono_ns=300 * 10**6), "PAUSED", "overrun",
          steered=True, at=_WARM),
    Fault("time of day set back by an hour", turn(wall_ns=-3600 * 10**9), "ENABLED", "",
          steered=True, note="asked once, at the start; stamps go on"),
    Fault("every second period is missed", late_every_tick, "PAUSED", "overrun", 250, at=_WARM,
          note="more than 100 within a second"),
    Fault("ring full", nothing, "ENABLED", "", over={"loop": {"ring_rows": 8}},
          note="two of ten rows lost, counted in the record"),
)  # fmt: skip
_PATIENCE = "asked again after 2 ms; one reading is STALE"
_WIRE = (
    Fault("encoder box unplugged", box("encoders", plugged=False), "FAULT", "joint-lost"),
    Fault("encoder box unplugged for 50 ms", replugged, "FAULT", "joint-lost",
          note="latched"),
    Fault("encoder box silent", box("encoders", muted=True), "FAULT", "joint-lost"),
    Fault("encoder frame spoilt", box("encoders", garbled=1), "FAULT", ""),
    Fault("motor box unplugged", box("leader-motor2", plugged=False), "FAULT", "joint-lost",
          200),
    Fault("motor box silent", box("leader-motor1", muted=True), "FAULT", "joint-lost", 200,
          note="its heartbeat is asked for every 100 ms"),
    Fault("force request not answered once", box("follower-ft", mute=1), "ENABLED",
          "sensor-late", note=_PATIENCE),
    Fault("force board silent", box("follower-ft", mute=EVER), "PAUSED", "force-stale", 3,
          exit="fault"),
    Fault("force board silent, stale_ms = 0.9", box("follower-ft", mute=EVER), "PAUSED",
          "force-stale", over={"boxes": {"follower-ft": {"options": {"stale_ms": 0.9}}}},
          exit="fault", note="the price: one lost frame pauses too"),
    Fault("force board: second frame lost once", box("follower-ft", lose_second=1), "ENABLED",
          "sensor-late", note=_PATIENCE),
    Fault("force board: second frames lost", box("follower-ft", lose_second=EVER), "PAUSED",
          "force-stale", 3,
          exit="fault"),
    Fault("force board: first frames lost", box("follower-ft", lose_first=EVER), "PAUSED",
          "force-stale", 3,
          exit="fault"),
    Fault("force board: frames 4 ms late", box("follower-ft", delay_second=EVER), "PAUSED",
          "force-stale", 3,
          exit="fault"),
    Fault("force board: second frames sent twice", box("follower-ft", twice_second=EVER),
          "ENABLED", ""),
    Fault("force board: first frames sent twice", box("follower-ft", twice_first=EVER),
          "ENABLED", ""),
    Fault("force board: frames too short", box("follower-ft", short=EVER), "PAUSED",
          "force-stale", 3,
          exit="fault"),
    Fault("force board: one short frame", box("follower-ft", short=1), "ENABLED",
          "sensor-late", note=_PATIENCE),
    Fault("force board: gauge cable broken", box("follower-ft", stuck={3: 32767}), "PAUSED", "",
          exit="fault"),
    Fault("force board bus-off", box("follower-ft", failures=256), "PAUSED", "force-stale", 3,
          exit="fault"),
    Fault("force board without power", box("follower-ft", powered=False), "PAUSED",
          "force-stale", 3,
          exit="fault"),
)  # fmt: skip


def _wired(fault: Fault) -> Fault:
    return Fault(**{**vars(fault), "wire": True})


FAULTS: tuple[Fault, ...] = (*_SENSORS, *_LAW, *_CLOCK, *map(_wired, _WIRE))
