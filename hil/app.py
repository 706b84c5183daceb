"""Run a session: open a rig, loop, record, close; the one place that knows all parts."""

from __future__ import annotations

import errno
import gc
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from hil import session
from hil.config import LoopConfig, RigConfig
from hil.errors import ConfigError, DataError, DeviceError
from hil.record.reader import summary
from hil.record.ring import Ring
from hil.rig import Rig, open_rig
from hil.runtime.clock import Clock, MonotonicClock, VirtualClock
from hil.runtime.frame import FrameLayout
from hil.runtime.loop import Loop
from hil.runtime.slow import SlowSide, SlowThread

CLOCKS: dict[str, Callable[[int], Clock]] = {"lockstep": VirtualClock, "real": MonotonicClock}

#: Why an arm is in FAULT where no box says that it is lost.
RUNAWAY = "an arm is in FAULT, because an effort was not a number or a joint passed its speed_limit"

#: What the operating system says where no more can be written.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)


@dataclass(frozen=True)
class Summary:
    """What a session turned out to be.

    Parameters
    ----------
    path : str
        Session file.
    clock : str
        ``"lockstep"`` or ``"real"``.
    seed : int
        Of the noise, and of what the rig file leaves open.
    ticks, missed, dropped, limited : int
        Ticks run, periods skipped, rows lost, ticks with a limited command.
    seconds, wall_seconds : float
        Length of the session, and how long it took [s].
    longest_tick_us : float
        Longest time from wake-up to the last command [us]; 0 in virtual time.
    """

    path: str
    clock: str
    seed: int
    ticks: int
    missed: int
    dropped: int
    limited: int
    seconds: float
    wall_seconds: float
    longest_tick_us: float

    def as_dict(self) -> dict[str, object]:
        """Plain dictionary for JSON."""
        return {"schema": "hil.run/1", **asdict(self)}


def run(
    config: RigConfig,
    seconds: float | None = None,
    seed: int = 0,
    clock: str | None = None,
    output: str | Path = "session.mcap",
    progress: Callable[[int], None] | None = None,
) -> Summary:
    """Run a session of a rig and record it.

    Parameters
    ----------
    config : RigConfig
        From `hil.config.load_rig`.
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

    Raises
    ------
    DeviceError
        An arm went to FAULT; what was recorded until then is kept.
    ConfigError
        The session could not be written on, e.g. for a full disk; the same holds.
    """
    config = session.with_run_options(config, seconds, seed, clock)
    began = time.perf_counter()
    rig = open_rig(config, seed)
    try:
        loop, timer = _record(rig, config, seed, Path(output), progress)
    except OSError as error:
        if error.errno not in FULL:
            raise
        raise ConfigError(_cut_short(Path(output), error)) from error
    finally:
        rig.close()
    if loop.unsafe:
        raise DeviceError(
            f"session stopped at tick {loop.tick}: {rig.trouble() or RUNAWAY}; {output} holds what "
            "was recorded."
        )
    period = config.loop.period_ns * 1e-9
    return Summary(
        path=str(output), clock=config.loop.clock, seed=seed, ticks=loop.tick - timer.missed,
        missed=timer.missed, dropped=loop.dropped, limited=loop.clamped,
        seconds=loop.tick * period, wall_seconds=time.perf_counter() - began,
        longest_tick_us=loop.longest_ns * 1e-3,
    )  # fmt: skip


def _cut_short(output: Path, error: OSError) -> str:
    """What is left of a session that could not be written on."""
    try:
        longest = max((c.last_s for c in summary(output).channels if c.count), default=0.0)
    except DataError:
        longest = 0.0
    kept = (
        f"the first {longest:.3g} s are kept; once there is room, 'hil info {output} --recover "
        "NEW.mcap' writes them as a proper session"
        if longest
        else "nothing of it was kept; make room and run it again"
    )
    return f"session {output} was cut short, the arms are released: {error.strerror}; {kept}"


def _record(
    rig: Rig, config: RigConfig, seed: int, output: Path,
    progress: Callable[[int], None] | None,
) -> tuple[Loop, Clock]:  # fmt: skip
    """Loop and slow side over an open rig until the time is up or an arm faults."""
    layout = FrameLayout(len(rig.ports), len(rig.controller.state_names))
    ring = Ring(config.loop.ring_rows, layout.width)
    timer = CLOCKS[config.loop.clock](config.loop.period_ns)
    loop = Loop(
        rig.ports, rig.controller, timer, ring, layout, config.loop.period_ns, rig.origin_ns
    )
    ticks = round(config.loop.seconds * config.loop.rate_hz)
    with session.open_writer(output, config, rig, seed) as writer:
        slow = SlowSide(ring, writer, session.topics(config, layout))
        loop.rehearse()
        rig.enable()
        timer.start()
        writer.event(0, timer.epoch_ns, "enabled", {})
        if config.loop.clock == "lockstep":
            _lockstep(loop, slow, ticks, config.loop, progress)
        else:
            _real(loop, slow, ticks, config.loop, progress)
        name = "fault" if loop.unsafe else "done"
        end_ns = timer.epoch_ns + loop.tick * config.loop.period_ns
        writer.event(loop.tick, end_ns, name, {"missed": timer.missed, "dropped": loop.dropped})
    return loop, timer


def _lockstep(
    loop: Loop, slow: SlowSide, ticks: int, config: LoopConfig,
    progress: Callable[[int], None] | None,
) -> None:  # fmt: skip
    """Both loops in this thread: the slow side after every tenth tick, say."""
    ratio = max(1, round(config.rate_hz / config.slow_hz))
    while loop.tick < ticks and not loop.unsafe:
        burst = min(ratio, ticks - loop.tick)
        for _ in range(burst):
            loop.step()
        slow.step()
        if progress is not None:
            progress(burst)


def _real(
    loop: Loop, slow: SlowSide, ticks: int, config: LoopConfig,
    progress: Callable[[int], None] | None,
) -> None:  # fmt: skip
    """Fast loop in this thread, slow side in its own, garbage collector held back."""
    thread = SlowThread(slow, 1.0 / config.slow_hz)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(5e-5)
    gc.collect()
    gc.disable()
    thread.start()
    try:
        while loop.tick < ticks and not loop.unsafe:
            loop.step()
    finally:
        gc.enable()
        sys.setswitchinterval(interval)
        thread.stop()
    if progress is not None:
        progress(ticks)
