"""What a tick costs on simulated wires, driver by driver, and how fast lockstep runs.

Every call that belongs to a driver, its background work included, is timed without what it calls
of the others; the world that the simulated boxes stand in is a row of its own.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil import terminal
from hil.record.schema import read_fields
from hil.rig.config import RigConfig, load_rig
from hil.rig.open import Rig, bench_of, open_rig
from hil.rigs import rig_path
from hil.runtime.board import Ring
from hil.runtime.clock import VirtualClock
from hil.runtime.loop import Loop
from hil.runtime.realtime import arranged
from hil.runtime.runner import run_session
from hil.signals.bus import BackgroundStep, Bus
from hil.signals.device import FloatArray
from hil.signals.frame import FrameLayout
from hil.terminal import Found

#: Ticks that are measured, after as many that are not; length of a lockstep session [s].
_TICKS, _WARM_UP, _SECONDS = 5000, 500, 20.0
#: Longest tick at the 99th percentile [us], and least speeds [times real time].
TICK_US = 250.0
_SPEEDS = {"sim": 20.0, "sim-wire": 5.0}
#: After so many ticks the processor is left to others for a while [s]: ticks here do not wait for
#: each other, and the operating system takes the real-time class from who never rests.
_BREATH, _REST_S = 1000, 0.02
#: Rows of what stands at the far end of the wires, and of processor time.
WORLD, _PROCESSOR = "simulated world and boxes", "whole tick, processor time"
#: Row and length [s] of a session in real time.
SESSION, _REAL_S = "tick of a session in real time", 10.0
#: Time that passes, whatever the processor does [ns].
_PASSING = time.perf_counter_ns


class Stopwatch:
    """Times of named calls, without those of named calls within them.

    Parameters
    ----------
    clock : callable
        Time [ns].

    Attributes
    ----------
    now : dict of str to int
        Time of this tick [ns].
    """

    def __init__(self, clock: Callable[[], int] = _PASSING) -> None:
        self.now: dict[str, int] = {}
        self._inner, self._clock = [0], clock

    def timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """`call`, timed under `name`."""
        self.now[name] = 0
        clock, inner, now = self._clock, self._inner, self.now

        def measured(*args: Any) -> Any:
            begin = clock()
            inner.append(0)
            try:
                return call(*args)
            finally:
                whole = clock() - begin
                now[name] += whole - inner.pop()
                inner[-1] += whole

        return measured


@dataclass(frozen=True)
class Cost:
    """Cost of one part of a tick.

    Parameters
    ----------
    name : str
        Device, box, or `WORLD`.
    median, p99 : float
        [us].
    """

    name: str
    median: float
    p99: float


@dataclass(frozen=True)
class Speed:
    """Speed of a lockstep session.

    Parameters
    ----------
    backend : str
        ``"sim"`` or ``"sim-wire"``.
    wall, cpu : float
        Seconds of the session per second on the clock, and per second of processor time.
    """

    backend: str
    wall: float
    cpu: float


def costs(rig_name: str = "teleop", ticks: int = _TICKS) -> list[Cost]:
    """Costs of every driver on its simulated wire; the last row is the whole tick.

    The ticks follow each other without a pause, in a thread that is arranged as the loop of a
    session in real time, see `hil.runtime.realtime`.
    The row before it is the processor time of whole ticks: what other programs on the same
    processors take is not in it.
    """
    config = load_rig(rig_path(rig_name), {"backend": "sim-wire"})
    watch = Stopwatch()
    bench = bench_of(config, 0)
    _time_the_far_end(bench, watch)
    rig = open_rig(config, 0, bench)
    try:
        _time_the_devices(rig, watch)
        parts = _measure(_loop(rig, config), watch, ticks)[:, :-1]
    finally:
        rig.close()
    # whole ticks once more, without what timing their parts costs
    rows = np.column_stack(
        [parts, _whole(config, ticks, time.thread_time_ns), _whole(config, ticks, _PASSING)]
    )
    names = [*watch.now, _PROCESSOR, "whole tick"]
    middle, most = np.median(rows, axis=0) * 1e-3, np.percentile(rows, 99, axis=0) * 1e-3
    return [Cost(n, float(m), float(p)) for n, m, p in zip(names, middle, most, strict=True)]


def _whole(config: RigConfig, ticks: int, clock: Callable[[], int]) -> FloatArray:
    """Times [ns] of whole ticks by a clock; (ticks,)."""
    rig = open_rig(config, 0)
    try:
        return _measure(_loop(rig, config), Stopwatch(), ticks, clock)[:, -1]
    finally:
        rig.close()


def _time_the_far_end(bench: Any, watch: Stopwatch) -> None:
    """Time the world, and the background work of the boxes that it calls once a tick."""
    real = bench.buses

    def buses(plan: Any) -> dict[str, Bus]:
        def timed_run(bus: Bus) -> Callable[[str, BackgroundStep], Callable[[], None]]:
            return lambda name, step: bus.run(name, watch.timed(f"box {name}", step))

        return {kind: replace(bus, run=timed_run(bus)) for kind, bus in real(plan).items()}

    bench.advance = watch.timed(WORLD, bench.advance)
    bench.buses = buses


def _time_the_devices(rig: Rig, watch: Stopwatch) -> None:
    for name, device in rig.devices.items():
        for call in ("measured_js", "measured_cf", "servo_jf"):
            if hasattr(device, call):
                setattr(device, call, watch.timed(f"{name} {call}", getattr(device, call)))


def _loop(rig: Rig, config: RigConfig) -> Loop:
    layout = FrameLayout(len(rig.ports), len(rig.controller.state_names))
    period = config.loop.period_ns
    ring = Ring(16 * _TICKS, layout.width)
    loop = Loop(
        rig.ports, rig.controller, VirtualClock(period), ring, layout, period, rig.origin_ns
    )
    loop.rehearse()
    rig.enable()
    loop.begin()
    return loop


def _measure(
    loop: Loop, watch: Stopwatch, ticks: int, clock: Callable[[], int] = _PASSING
) -> FloatArray:
    """Times [ns] of every part and of the whole tick; (ticks, parts + 1)."""
    names = list(watch.now)
    rows = np.zeros((ticks, len(names) + 1))
    with arranged():  # as a session in real time is
        for k in range(-_WARM_UP, ticks):
            for name in names:
                watch.now[name] = 0
            begin = clock()
            loop.step()
            whole = clock() - begin
            if k >= 0:
                rows[k, :-1] = [watch.now[name] for name in names]
                rows[k, -1] = whole
            if k % _BREATH == 0:
                time.sleep(_REST_S)
    return rows


def _tick_times(rig_name: str = "teleop", seconds: float = _REAL_S) -> Cost:
    """Whole ticks of a session in real time, as it recorded them: between them the loop sleeps."""
    config = load_rig(rig_path(rig_name), {"backend": "sim-wire"})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s.mcap"
        run_session(config, seconds, clock="real", output=path)
        busy = read_fields(path, "/loop/timing")[1]["busy"] * 1e-3
    return Cost(SESSION, float(np.median(busy)), float(np.percentile(busy, 99)))


def session_speed(backend: str, rig_name: str = "teleop", seconds: float = _SECONDS) -> Speed:
    """Speed of a whole session, opening and recording included, compiled code loaded before."""
    config = load_rig(rig_path(rig_name), {"backend": backend, "loop": {"clock": "lockstep"}})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s.mcap"
        run_session(config, 0.5, output=path)
        wall, cpu = time.perf_counter(), time.process_time()
        run_session(config, seconds, output=path)
        return Speed(
            backend, seconds / (time.perf_counter() - wall), seconds / (time.process_time() - cpu)
        )


def command(args: argparse.Namespace) -> Found:
    """Microseconds a tick of every driver on its simulated wire; speed of lockstep sessions."""
    ticks = [*costs(), _tick_times()]
    speeds = [session_speed(backend) for backend in _SPEEDS]
    rows = [[c.name, f"{c.median:.1f}", f"{c.p99:.1f}"] for c in ticks]
    whole, real = ticks[-2].p99, ticks[-1].p99
    text = terminal.table(["a tick of rigs/teleop.toml, sim-wire", "median us", "p99 us"], rows)
    with arranged() as found:
        text += f"\n  arranged as a session in real time: {found.as_text()}"
    text += (
        f"\n  p99 of the whole tick: {_met(whole <= TICK_US)} ({TICK_US:g} us), after a "
        f"sleep: {_met(real <= TICK_US)}\n\n"
    )
    rows = [
        [
            s.backend,
            f"{s.wall:.1f}",
            f"{s.cpu:.1f}",
            f"{_SPEEDS[s.backend]:g}",
            _met(s.wall >= _SPEEDS[s.backend]),
        ]
        for s in speeds
    ]
    head = [f"lockstep, {_SECONDS:g} s", "x real time", "x processor time", "wanted", ""]
    data = {
        "costs": [vars(c) for c in ticks],
        "speeds": [vars(s) for s in speeds],
        "tick_us_wanted": TICK_US,
        "speeds_wanted": _SPEEDS,
    }
    return text + terminal.table(head, rows), data


def _met(reached: bool) -> str:
    return "met" if reached else "NOT met"
