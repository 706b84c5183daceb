"""Run a session: open a rig, loop, record, close; the one place that knows all parts.

A signal that ends the program unwinds the session first, so that the motors get zero.
"""

from __future__ import annotations

import contextlib
import json
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

from hil import registry
from hil.errors import ConfigError, DeviceError, HilError
from hil.interrupt import Ended, interrupts
from hil.rig import estimators
from hil.rig.config import RigConfig
from hil.rig.open import Rig, open_rig
from hil.rig.operator import Shop
from hil.rig.safety import BITS, LOOKED_BACK, alternates, lamps, sentence, violations
from hil.runtime import commands, session
from hil.runtime.board import Ring
from hil.runtime.clock import Clock, MonotonicClock, VirtualClock
from hil.runtime.guard import Watchdog, guarded_session
from hil.runtime.loop import Loop
from hil.runtime.realtime import Arrangement, accompany, arranged
from hil.runtime.recorder import SlowSide, SlowThread
from hil.runtime.session import Operator, Summary, cut_short
from hil.runtime.statistics import Statistics
from hil.runtime.watchdog import WATCHDOG, report_in_words

CLOCKS: dict[str, Callable[[int], Clock]] = {"lockstep": VirtualClock, "real": MonotonicClock}
#: Ticks that a session goes on after a FAULT, with the motors at zero: the record shows it.
AFTERMATH = 20
#: Faults that a law may make by itself, shaking an arm.
_SHAKES = BITS["encoder-jump"] | BITS["overspeed"]


class Session:
    """Loop, slow side and file over an open rig; see `run_session`."""

    ring_type = Ring

    def __init__(
        self,
        rig: Rig,
        config: RigConfig,
        seed: int,
        output: Path,
        operator: Operator,
        model: str | Path | None,
        timer: Callable[[int], Clock] | None,
        aside: Callable[[Path], None],
    ) -> None:
        self.config, self.output, self.operator, self.rig = config, output, operator, rig
        joints = rig.ports[0].torque_limit.size
        layout = estimators.layout(len(rig.ports), joints, rig.controller)
        loop = config.loop
        self.ring = ring = self.ring_type(loop.ring_rows, layout.width)
        self.timer = (timer or CLOCKS[loop.clock])(loop.period_ns)
        self.loop = Loop(
            rig.ports,
            rig.controller,
            self.timer,
            ring,
            layout,
            loop.period_ns,
            rig.origin_ns,
            config.safety.missed_limit,
        )
        self.statistics = Statistics(loop.period_ns)
        self.arrangement = Arrangement()
        self.ticks = round(loop.seconds * loop.rate_hz)
        self.writer = session.open_writer(output, config, rig, seed, model, aside, operator.say)
        self.slow = SlowSide(
            self.loop,
            ring,
            self.writer,
            session.topics(config, layout, rig.controller),
            session.slow_topics(layout),
            layout,
            self.statistics,
            Shop(rig, config),
            operator.schedule,
            operator.say,
            lambda tick: self.timer.epoch_ns + tick * loop.period_ns,
        )
        self.left, self.shown, self.posted = 0.0, 0, 0.0
        self.layout = layout
        self.watchdog: Watchdog | None = None
        self.trip: dict[str, object] = {}
        self.began = time.perf_counter()

    def run(self, progress: Callable[[int], None] | None, watchdog: Watchdog | None) -> None:
        """Until the time is up, an arm faults, or the operator stops."""
        loop = self.loop
        loop.heart = None if watchdog is None else watchdog.beat
        self.watchdog = watchdog
        told: dict[str, object] = {}
        name = "broken off"
        try:
            loop.rehearse()
            self.slow.rehearse()
            self.began = time.perf_counter()  # what was compiled is no part of the session
            if self.operator.lines is not None:
                self.operator.lines(self.slow.inbox.append)
                self.operator.say(commands.usage_lines(self.slow.shop.settable()))
            (self._lockstep if self.config.loop.clock == "lockstep" else self._real)(progress)
            name = "fault" if loop.unsafe else "done"
        except BaseException as error:
            told = {"error": _why(error)}
            raise
        finally:
            if watchdog is not None:  # nothing ticks any more, and closing a file may take long
                watchdog.end()
            self._finish(name, told)

    def _enable(self) -> None:
        """Devices and loop ENABLED, unless the operator is waited for; tick 0 is now."""
        waits = self.operator.wait
        if not waits:
            # from here on a loop that hangs is a loop with power
            self._feel()
            self.rig.enable()
            self._feel()
            self.loop.begin()
        self.timer.start()
        self.slow.note(0, self.timer.epoch_ns, "waiting" if waits else "enabled")

    def _feel(self) -> None:
        """Beat before the first tick; refuse to go on with a watchdog that is gone."""
        found = self.watchdog.beat(0) if self.watchdog is not None else 0
        if found:
            raise DeviceError(f"the rig is not enabled: {sentence(found)}")

    def over(self) -> bool:
        """Whether this tick was the last."""
        loop = self.loop
        if loop.unsafe:
            return loop.tick >= min(loop.since + AFTERMATH, self.ticks)
        return loop.finished or loop.tick >= self.ticks

    def _lockstep(self, progress: Callable[[int], None] | None) -> None:
        """Both loops in this thread: the slow side after every tenth tick, say."""
        config, loop = self.config.loop, self.loop
        self._enable()
        ratio = max(1, round(config.rate_hz / config.slow_hz))
        while not self.over():
            done = 0
            while done < ratio and not self.over():
                loop.step()
                done += 1
            self._live(loop.tick / config.rate_hz)
            self.slow.step(loop.tick / config.rate_hz)
            if progress is not None:
                progress(done)

    def _real(self, progress: Callable[[int], None] | None) -> None:
        """Fast loop in this thread, arranged for real time; the slow side in its own."""
        config, loop = self.config.loop, self.loop
        thread = SlowThread(
            self.slow,
            self.timer,
            1.0 / config.slow_hz,
            1.0 / config.rate_hz,
            lambda seconds: self._live(seconds, progress),
            lambda: accompany(self.arrangement),
        )
        try:
            with arranged(config.realtime) as self.arrangement:
                for text in self.arrangement.refused:
                    self.operator.say(text)
                # no tick may be missing between the amplifiers' power and the loop
                thread.start()
                self._enable()
                thread.go()
                while not self.over():
                    loop.step()
        finally:
            # motors off first: the slow side may need long to drain to a slow disk
            try:
                self._release()
            finally:
                thread.stop()
        if progress is not None:
            progress(loop.tick - self.shown)

    def _release(self) -> None:
        """Torque and power off; the watchdog has nothing to watch any more."""
        try:
            self.rig.close()
        finally:
            if self.watchdog is not None:
                self.watchdog.end()

    def _live(self, seconds: float, progress: Callable[[int], None] | None = None) -> None:
        """Live figures a few times a second, from the slow side; `progress` since the last time."""
        if self.operator.board is not None and seconds >= self.posted:
            self.posted = seconds + 0.05
            self.operator.board.publish(self.snapshot())
        if seconds < self.left:
            return
        self.left, loop = seconds + 0.25, self.loop
        if progress is not None:
            now = loop.tick
            progress(now - self.shown)
            self.shown = now
        if self.operator.live is not None:
            why = f" {sentence(loop.conditions)}" if loop.conditions else ""
            self.operator.live(f"{loop.machine.state.name}{why}; {self.statistics.line()}")

    def snapshot(self) -> dict[str, object]:
        """The session now, as plain data: state, arms, forces, loop, record."""
        loop, row, arms = self.loop, self.slow.row, {}
        if row.size:
            for i, name in enumerate(self.config.controller.arms):
                q, qd, wrench, effort, _ = self.layout.arm(row, i)
                arms[name] = {
                    "position": q.tolist(),
                    "velocity": qd.tolist(),
                    "force": wrench[:3].tolist(),
                    "effort": effort.tolist(),
                    "sensed": self.rig.ports[i].force is not None,
                    "lamps": list(lamps(self.rig.ports[i].limits)),
                }
        figures = self.statistics.figures().as_dict()
        return {
            "state": loop.machine.state.name,
            "why": sentence(loop.conditions) if loop.conditions else "",
            "tick": loop.tick,
            "seconds": loop.tick * self.config.loop.period_ns * 1e-9,
            "arms": arms,
            "late_p99_us": figures["late_p99"],
            "missed": self.timer.missed,
            "dropped": loop.dropped,
            "ring": figures["ring_most"],
            "winding": figures["winding_most"],
            "record": str(self.writer.paths[-1]),
            "unwritten": self.slow.unwritten,
            "recording": self.slow.recording,
            "left_out": self.slow.left_out,
            "reason": sentence(loop.reason) if loop.reason else "",
            "devices": self.rig.states(self.config.devices, self._why()),
            "controller": self.config.controller.name,
            "values": self.slow.shop.values(),
            "settable": {
                name: {"low": r.low, "high": r.high, "unit": r.unit, "entries": r.entries}
                for name, r in self.slow.shop.settable().items()
            },
        }

    def _why(self) -> str:
        """Why the loop let go of the arms; empty where it did not."""
        return sentence(self.loop.reason) if self.loop.unsafe else ""

    def _reason(self) -> str:
        """Why the loop let go, with the joints that it is of and what may help."""
        loop, which = self.loop, []
        if not loop.reason:
            return ""
        arms = self.config.controller.arms
        for i, arm in enumerate(arms):
            q, qd, *_ = self.layout.arm(loop.seen, i)
            joints, lim = self.config.arms[arm].joints, self.rig.ports[i].limits
            names = [f"{arm} {name}" for name in joints] if len(arms) > 1 else joints
            which += violations(loop.reason, names, q, qd, lim)
        said = sentence(loop.reason) + (f" ({', '.join(which)})" if which else "")
        plays = self.config.controller.parameters.get("trajectory")
        if which and plays and loop.unsafe:
            said += (
                "; a motion of 'hil excite' is slower than that, so the law does not follow it: "
                "see to its gains (a rotor's inertia guessed too small in armature leaves a joint "
                "undamped), or take computed-torque"
            )
        return said + self._shaken()

    def _shaken(self) -> str:
        """What is likely where a law shook an arm from tick to tick before a fault."""
        loop, arms = self.loop, self.config.controller.arms
        if not loop.reason & _SHAKES or not loop.unsafe:
            return ""
        rows = self.ring.before(loop.since, LOOKED_BACK)
        found = []
        for i, arm in enumerate(arms):
            turns = alternates(rows[:, self.layout.part("jf", i)])
            names = self.config.arms[arm].joints
            found += [f"{arm} {n}" for n, x in zip(names, turns, strict=True) if x]
        if not found:
            return ""
        rate = self.config.loop.rate_hz
        return (
            f"; before, the law's own efforts ({', '.join(found)}) went up and down in turn from "
            f"tick to tick and grew, an oscillation at half of rate_hz = {rate:g}: more likely "
            "than a broken encoder is that the rate is too low for the gains of the law; raise "
            "rate_hz, or lower its stiffness and damping"
        )

    def _finish(self, name: str, told: dict[str, object]) -> None:
        """Close the file with what the session was; it may be that it takes nothing more."""
        loop, timer = self.loop, self.timer
        self.trip = self.watchdog.trip() if self.watchdog is not None else {}
        if self.operator.board is not None:  # what it ended with, e.g. the fault
            self.operator.board.publish(self.snapshot())
        if self.slow.trouble is not None:
            return
        end_ns = timer.epoch_ns + loop.tick * self.config.loop.period_ns
        said = {"missed": timer.missed, "dropped": loop.dropped, **told}
        if timer.set_back:
            said["clock_set_back"] = timer.set_back
        try:
            if self.trip:
                self.writer.event(loop.tick, end_ns, "power-cut", self.trip)
                self.writer.metadata(WATCHDOG, {"report": json.dumps(self.trip)})
            self.writer.event(loop.tick, end_ns, name, said)
            self.writer.metadata("end", self._totals(name))
            session.conclude(self.writer, self.statistics, self.arrangement)
            self.writer.close()
        except OSError as error:
            self.slow.trouble = error
            self.writer.abandon()

    def _totals(self, name: str) -> dict[str, str]:
        """How a session ended and what it was until then, as the loop counts it."""
        loop, config = self.loop, self.config.loop
        return {
            "how": name,
            "clock": config.clock,
            "ticks": str(loop.tick - self.timer.missed),
            "seconds": f"{loop.tick * config.period_ns * 1e-9:.3f}",
            "missed": str(self.timer.missed),
            "dropped": str(loop.dropped),
        }

    def figures(self) -> dict[str, float]:
        """Of the ticks so far."""
        return self.statistics.figures().as_dict()

    def summary(self, seed: int, wall: float) -> Summary:
        """What it was; raises where it ended badly."""
        loop, config = self.loop, self.config.loop
        reason = self._reason()
        if self.slow.trouble is not None:
            raise ConfigError(
                cut_short(self.output, self.slow.trouble, self.slow.unwritten)
            ) from self.slow.trouble
        if loop.unsafe:
            ended = self.rig.outrun(loop.since)
            if ended:
                raise ConfigError(
                    f"session stopped at tick {loop.since}: {reason}; {ended}, take --seconds no "
                    f"longer than that. {self.output} holds what was replayed until then."
                )
            told = report_in_words(self.trip) if self.trip else self.rig.trouble()
            raise DeviceError(
                f"session stopped at tick {loop.since}: FAULT, because {reason}"
                f"{f' ({told})' if told else ''}; the motors got no torque from that tick on, and "
                f"{self.output} holds what was recorded."
            )
        return Summary(
            path=str(self.output),
            clock=config.clock,
            seed=seed,
            ticks=loop.tick - self.timer.missed,
            missed=self.timer.missed,
            dropped=loop.dropped,
            limited=loop.clamped,
            seconds=loop.tick * config.period_ns * 1e-9,
            wall_seconds=wall,
            longest_tick_us=loop.longest_ns * 1e-3,
            state=loop.machine.state.name,
            reason=reason,
            unwritten=self.slow.unwritten,
            left_out=self.slow.left_out,
            figures=self.figures(),
            granted=self.arrangement.granted,
            refused=self.arrangement.refused,
            parts=[str(path) for path in self.writer.paths[1:]],
        )


def _why(error: BaseException) -> str:
    """What broke a session off, for its record."""
    if isinstance(error, KeyboardInterrupt):
        return "Ctrl-C"
    if isinstance(error, (Ended, HilError)):
        return str(error)
    return f"{type(error).__name__}: {error}"


#: Ctrl-C unwinds already, as KeyboardInterrupt.
_SIGNALS = ("SIGTERM", "SIGHUP")


def _unwind(number: int, frame: FrameType | None) -> None:
    if not interrupts.waits(lambda: _end(number)):
        _end(number)


def _end(number: int) -> None:
    raise Ended(number)


@contextlib.contextmanager
def unwinding_signals() -> Iterator[None]:
    """Turn the signals that would kill the process at once into `hil.interrupt.Ended`.

    Outside of the main thread, where Python takes no signals, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    found = [getattr(signal, name) for name in _SIGNALS if hasattr(signal, name)]
    old = {number: signal.signal(number, _unwind) for number in found}
    try:
        yield
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _kept(made: Session) -> Iterator[None]:
    """Add to an error in mid-session where the record is, and which plug-in it is of."""
    try:
        yield
    except HilError as error:
        if str(made.output) not in str(error):
            error.args = (_with_record(str(error), made.output),)
        raise
    except Exception as error:
        blamed = registry.culprit(error)
        if not blamed:
            raise
        raise DeviceError(_with_record(blamed, made.output)) from error


def _with_record(said: str, output: Path) -> str:
    kept = f"{output} holds what was recorded until then."
    return f"{said.rstrip('.')}. {kept}" if output.exists() else said


__all__ = ["CLOCKS", "Operator", "Session", "Summary", "run_session"]


def run_session(
    config: RigConfig,
    seconds: float | None = None,
    seed: int = 0,
    clock: str | None = None,
    output: str | Path = "session.mcap",
    progress: Callable[[int], None] | None = None,
    operator: Operator | None = None,
    model: str | Path | None = None,
    opener: Callable[[RigConfig, int], Rig] = open_rig,
    timer: Callable[[int], Clock] | None = None,
    kind: type[Session] | None = None,
    aside: Callable[[Path], None] = lambda path: None,
    source: str = "RIG.toml",
    rearm: bool = False,
) -> Summary:
    """Run a session of a rig and record it.

    Parameters
    ----------
    config : RigConfig
        From `hil.rig.config.load_rig`.
    seconds : float, optional
        Length [s]; default: of the rig file.
    seed : int
        Noise of the simulation; also the hidden effect and the motion, where the rig file
        does not fix them (``simulation.hidden_seed``, ``controller.parameters.seed``).
    clock : str, optional
        ``"lockstep"`` or ``"real"``; default: of the rig file.
    output : str or Path
        Session file.
    progress : callable, optional
        Called with the number of ticks done since its last call.
    operator : Operator, optional
        Who watches and commands.
    model : str or Path, optional
        Model file that is attached.
    opener, timer : callable
        Open the rig, and make the clock for a period [ns]; the fault bench puts its faults in.
    kind : type of Session, optional
        Another arrangement of loop and slow side, for the bench of the loop.
    aside : callable
        Called with `output` when the rig is open, before the file is written.
    source : str
        Rig file, as messages name it.
    rearm : bool
        Start although the watchdog cut the power of this rig before.

    Raises
    ------
    DeviceError
        An arm went to FAULT; what was recorded until then is kept.  Or the watchdog does not
        answer, or its last cut is latched.
    ConfigError
        The model is none of this rig.  The program of ``[safety] cut`` cannot be run, or the user
        has not agreed to it (`hil.trusted_code`).  The session could not be written on, e.g. for a
        full disk; the loop ran to its end.  Or the recording in place of the boxes ended before it.
    """
    config = session.with_run_options(config, seconds, seed, clock)
    if model is not None:
        session.refuse_model(model, config)
    operator = operator or Operator()
    commands.rehearse(operator.schedule, config.loop.seconds, Shop(None, config))
    with (
        unwinding_signals(),
        guarded_session(config.safety, Path(output), source, rearm) as watchdog,
    ):
        rig = opener(config, seed)
        try:
            made = (kind or Session)(rig, config, seed, Path(output), operator, model, timer, aside)
            with _kept(made):
                try:
                    made.run(progress, watchdog)
                finally:
                    rig.close()
        finally:
            rig.close()
    return made.summary(seed, time.perf_counter() - made.began)
