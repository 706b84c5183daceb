"""Run a session: open a rig, loop, record, close; the one place that knows all parts."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from hil import session
from hil.config import RigConfig
from hil.exits import unwinding_signals
from hil.rig import Rig, open_rig
from hil.running import CLOCKS, Session
from hil.runtime import commands
from hil.runtime.clock import Clock
from hil.runtime.watchdog import guarded
from hil.shop import Shop
from hil.summary import Operator, Summary

__all__ = ["CLOCKS", "Operator", "Session", "Summary", "run"]


def run(
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

    Raises
    ------
    DeviceError
        An arm went to FAULT; what was recorded until then is kept.
    ConfigError
        The session could not be written on, e.g. for a full disk; the loop ran to its end.
        Or the recording in place of the boxes ended before it.
    """
    config = session.with_run_options(config, seconds, seed, clock)
    operator = operator or Operator()
    commands.rehearse(operator.schedule, config.loop.seconds, Shop(None, config))
    began = time.perf_counter()
    with unwinding_signals(), guarded(config.safety, Path(output)) as watchdog:
        rig = opener(config, seed)
        try:
            made = (kind or Session)(rig, config, seed, Path(output), operator, model, timer, aside)
            made.run(progress, watchdog)
        finally:
            rig.close()
    return made.summary(seed, time.perf_counter() - began)
