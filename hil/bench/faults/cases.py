"""The faults: what is done, the state it must lead to, and within how many ticks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil.bench.faults.fault_injection import (
    STRIKE_TICK,
    FaultySession,
    add,
    box,
    counts,
    delayed,
    failing,
    fill,
    frozen,
    gauges,
    hook,
    late_every_tick,
    nothing,
    put,
    replugged,
    shake,
    times,
    turn,
)
from hil.signals.device import Status

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
    Fault("encoder reading delivered twice", hook("js", lambda: delayed(1)), "ENABLED", "",
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
