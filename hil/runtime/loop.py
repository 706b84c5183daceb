"""The fast loop: read, examine, update, limit, write, one row into the ring; nothing else.

In a tick no array is allocated, nothing is logged, no lock is taken.  Of all arms at once, measured
and examined values come in and limited efforts go out.  Periods that were missed are counted over
the last second.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from hil.rig import estimators, safety
from hil.rig.open import ArmPort
from hil.rig.safety import BITS, FAULTING, PAUSING
from hil.runtime.board import Ring
from hil.runtime.clock import Clock
from hil.runtime.commands import OperatorCommand
from hil.signals.device import (
    Controller,
    FloatArray,
    OperatingState,
    StateCommand,
    StateMachine,
    Status,
)
from hil.signals.frame import FrameLayout


class Overload:
    """Counts missed periods in ten slots of a tenth of a second.

    Parameters
    ----------
    limit : int
        More than so many missed within a second are too many.
    ticks : int
        Per second; the first second does not count (cold caches).
    """

    def __init__(self, limit: int, ticks: int) -> None:
        self._limit, self._ticks = limit, ticks
        self._slot = max(1, ticks // 10)
        self._counts = np.zeros(10, np.int64)
        self._at = 0
        self._sum = 0

    def over(self, tick: int, missed: int) -> bool:
        """Count what was `missed` before `tick`; whether the last second had too many."""
        at = tick // self._slot
        if at != self._at:
            for k in range(self._at + 1, min(at, self._at + 10) + 1):
                self._sum -= int(self._counts[k % 10])
                self._counts[k % 10] = 0
            if at - self._at >= 10:
                self._counts[:] = 0
                self._sum = 0
            self._at = at
        if missed and tick > self._ticks:
            self._counts[at % 10] += missed
            self._sum += missed
        return self._sum > self._limit


_HELD_BACK, _INVALID = BITS["effort-limited"], BITS["effort-invalid"]
_REFUSED, _OUT = BITS["motor-refused"], BITS["workspace"]
_EXCEEDED, _RANGE = BITS["effort-exceeded"], BITS["position"]
_OK = int(Status.OK)


def _tip() -> tuple[FloatArray, FloatArray]:
    """Place of a tip, and how far it may be outside of the workspace [m]."""
    return np.zeros(3), np.zeros(3)


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
    efforts : ndarray (arms, d)
        What the law commands [N m]; limited in place.
    worst : int
        Worst status of the tick.
    hottest : float
        Hottest winding [degC].
    acute : int
        Of the conditions that last while something is outside of its range those that are new: it
        left the range, or got further out than it may.
    """

    def __init__(
        self, ports: list[ArmPort], layout: FrameLayout, frame: FloatArray, period_ns: int
    ) -> None:
        self.efforts = np.zeros((len(ports), layout.joints))
        self.worst, self.hottest, self.acute = _OK, 0.0, 0
        self._arms = [
            (p, *layout.arm(frame, i), self.efforts[i], safety.memory(p.limits), _tip())
            for i, p in enumerate(ports)
        ]
        self._period_ns, self._steps = period_ns, 1

    def forget(self) -> None:
        """No effort, and no memory of what was measured."""
        self.efforts[:] = 0.0
        for *_, memory, (_, may) in self._arms:
            memory[:] = may[:] = 0.0

    def allow(self) -> None:
        """What is outside of its range may be as far outside as it is: it may be driven back in."""
        for port, q, _qd, _wrench, _sent, _words, _y, memory, (tip, may) in self._arms:
            safety.out_of_range(q, memory, port.limits, True)
            if port.tip is not None:
                safety.outside(tip, port.box, may, True)

    def read(self, t_ns: int, steps: int) -> int:
        """Measured joint states and forces of all arms; the conditions that they show.

        Parameters
        ----------
        t_ns : int
            Time of the devices [ns].
        steps : int
            Periods since the last tick.
        """
        mask, worst, hot, acute = 0, _OK, 0.0, 0
        single = steps == 1 and self._steps == 1
        dt, self._steps = steps * self._period_ns * 1e-9, steps
        for port, q, qd, wrench, sent, _words, _y, memory, (tip, may) in self._arms:
            js = int(port.joints.measured_js(t_ns, q, qd))
            force = port.force
            cf = _OK if force is None else int(force.measured_cf(t_ns, q, wrench))
            mask |= safety.examine(dt, single, js, cf, q, qd, wrench, sent, memory, port.limits)
            if memory.item(safety.ACUTE):
                acute |= _RANGE
            if port.tip is not None:
                port.tip(q, tip)
                out = safety.outside(tip, port.box, may, False)
                mask |= _OUT if out else 0
                acute |= _OUT if out > 1 else 0
            if js > worst or cf > worst:
                worst = max(js, cf)
            hot = max(hot, memory.item(safety.HOTTEST))
        self.worst, self.hottest, self.acute = worst, hot, acute
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
                mask |= _HELD_BACK
            elif said >= safety.INVALID and safe != safety.INVALID and not faulted:
                mask |= _REFUSED
            if safety.exceeded(sent, port.torque_limit):
                port.efforts.fault()
                mask |= 0 if faulted else _EXCEEDED
            if said > worst or safe > worst:
                worst = max(said, safe)
            safety.leave(sent, port.counts, port.codes, port.gauges, words)
        self.worst = worst
        return mask

    def let_go(self) -> None:
        """FAULT in every arm, and no effort sent."""
        self.efforts[:] = 0.0
        for port, _q, _qd, _wrench, sent, words, y, *_ in self._arms:
            port.efforts.fault()
            port.efforts.servo_jf(y, sent)
            words[y.size : 2 * y.size] = port.codes


_LIMITED, _OVERRUN = BITS["effort-limited"], BITS["overrun"]
_UNLAWFUL = BITS["law-invalid"]
_ENABLED, _FAULT = OperatingState.ENABLED, OperatingState.FAULT
#: These pause when they begin, and when they get worse; a command may go on while they last.
_LASTING = BITS["position"] | BITS["workspace"]


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
    missed_limit : int
        Periods missed within a second that pause the loop.

    Attributes
    ----------
    mailbox : deque of Command
        What the slow side wants done, applied before the next tick.
    applied : deque of (int, str, OperatingState, OperatingState)
        Tick and text of every command applied, state before and after.
    heart : callable or None
        The watchdog's: called with every tick, gives the conditions that it finds.
    """

    def __init__(
        self,
        ports: list[ArmPort],
        controller: Controller,
        clock: Clock,
        ring: Ring,
        layout: FrameLayout,
        period_ns: int,
        origin_ns: int,
        missed_limit: int = 100,
    ) -> None:
        self._controller, self._clock, self._ring = controller, clock, ring
        self._period_ns, self._origin_ns = period_ns, origin_ns
        self.frame = layout.zeros()
        self._u, self._state, self._timing = layout.views(self.frame)
        self._arms = Arms(ports, layout, self.frame, period_ns)
        self._y = self._arms.efforts
        self._x = np.zeros(len(controller.state_names))
        self._x_next = np.zeros_like(self._x)
        self._shown = self._state.size
        self._overload = Overload(missed_limit, round(1e9 / period_ns))
        self.machine = StateMachine("the loop")
        self.mailbox: deque[OperatorCommand] = deque()
        self.applied: deque[tuple[int, str, OperatingState, OperatingState]] = deque()
        self.tick = self._zero_ns = 0
        self.since = self.reason = 0
        #: Row of the tick in which it let go.
        self.seen = self.frame.copy()
        self.conditions = 0
        self.longest_ns = 0
        self.clamped = 0
        self.finished = False
        self.heart: Callable[[int], int] | None = None

    def rehearse(self) -> None:
        """Do once all that a tick does, with the devices not enabled and nothing recorded.

        Loads compiled code before the first deadline; leaves no trace in the controller.
        """
        self._arms.read(self._origin_ns, 1)
        self._arms.write(self.machine.state)
        self._controller.update(0.0, self._x, self._u, self._x_next, self._y)
        safety.all_finite(self._x)
        self._arms.allow()
        self._arms.forget()

    def step(self) -> None:
        """One tick."""
        clock, last = self._clock, self.tick
        self.tick = tick = clock.wait(last + 1)
        t_ns = tick * self._period_ns
        woken = clock.since_start()
        while self.mailbox:
            self._obey(self.mailbox.popleft())
        steps = tick - last
        mask = self._arms.read(t_ns + self._origin_ns, steps)
        if self._overload.over(tick, steps - 1):
            mask |= _OVERRUN
        if self.heart is not None:
            mask |= self.heart(tick)
        # who was outside at a `resume` may be driven back in
        acute = (mask & ~_LASTING) | self._arms.acute
        if acute & (PAUSING | FAULTING):
            self._react(acute)
        if self.machine.state is _ENABLED:
            law_s = (t_ns - self._zero_ns) * 1e-9
            self._controller.update(law_s, self._x, self._u, self._x_next, self._y)
            self._x, self._x_next = self._x_next, self._x
            if not safety.all_finite(self._x):
                mask |= _UNLAWFUL
                self._y[:] = 0.0
        else:
            self._y[:] = 0.0
        mask |= self._arms.write(self.machine.state)
        if mask & FAULTING and self.machine.state is not _FAULT:
            self._react(mask)
        done = clock.since_start()
        self._leave(tick, t_ns, woken, done, mask)

    def _leave(self, tick: int, t_ns: int, woken: int, done: int, mask: int) -> None:
        """The row of this tick."""
        timing = self._timing
        self._state[: self._shown] = self._x[: self._shown]
        timing[0] = woken - t_ns
        timing[1] = done - woken
        timing[2] = self._clock.missed
        timing[3] = self._ring.dropped
        timing[4] = self._arms.worst
        timing[5] = self.machine.state
        timing[6] = self.conditions = mask
        timing[7] = len(self._ring)
        timing[8] = self._arms.hottest
        self._ring.push(tick, t_ns + self._clock.epoch_ns, self.frame)
        if done - woken > self.longest_ns:
            self.longest_ns = done - woken
        if mask & _LIMITED:
            self.clamped += 1

    def _react(self, mask: int) -> None:
        """Let go: FAULT is latched in every arm and sent again, PAUSED needs a command."""
        state = self.machine.state
        if mask & FAULTING:
            if state is not OperatingState.FAULT:
                self.machine.command(StateCommand.FAULT)
                self.since, self.reason = self.tick, mask & FAULTING
                self.seen = self.frame.copy()
            self._arms.let_go()
        elif state is OperatingState.ENABLED:
            self.machine.command(StateCommand.PAUSE)
            self.since, self.reason = self.tick, mask & PAUSING
            self.seen = self.frame.copy()

    def _obey(self, command: OperatorCommand) -> None:
        before = self.machine.state
        command.apply(self)
        self.applied.append((self.tick, command.text, before, self.machine.state))

    def begin(self) -> None:
        """To ENABLED, from DISABLED or PAUSED; in FAULT nothing happens."""
        state = self.machine.state
        if state is OperatingState.DISABLED:
            self.machine.command(StateCommand.ENABLE)
            self._zero_ns = max(0, self.tick - 1) * self._period_ns
        elif state is OperatingState.PAUSED:
            self.machine.command(StateCommand.RESUME)
            self._arms.allow()
        self.reason = 0

    def pause(self) -> None:
        """To PAUSED, if ENABLED."""
        if self.machine.state is OperatingState.ENABLED:
            self.machine.command(StateCommand.PAUSE)
            self.since, self.reason = self.tick, 0

    def finish(self) -> None:
        """End the session after this tick, with the motors at zero."""
        self.finished = True
        if self.powered:
            self.machine.command(StateCommand.DISABLE)

    def follow(self, controller: Controller, restart: bool) -> None:
        """Take another law; `restart` begins it anew, at the time and the pose of this tick."""
        before, self._controller = self._controller, controller
        size = len(controller.state_names)
        if restart or size != len(self._x):
            self._x = estimators.anew(controller, before, self._x)
            self._x_next = np.zeros(size)
            self._zero_ns = (self.tick - 1) * self._period_ns
            self._shown = min(size, self._state.size)
            self._state[:] = 0.0

    @property
    def powered(self) -> bool:
        """ENABLED or PAUSED: the devices are enabled and none has failed."""
        return self.machine.state in (OperatingState.ENABLED, OperatingState.PAUSED)

    @property
    def dropped(self) -> int:
        """Rows that the ring could not take."""
        return self._ring.dropped

    @property
    def unsafe(self) -> bool:
        """The loop is in FAULT."""
        return self.machine.state is OperatingState.FAULT
