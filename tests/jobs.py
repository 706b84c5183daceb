"""Runs for other processes: they import next to nothing, so that a new process is there soon."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import numpy as np

from hil.errors import DataError


def digits(name, seed):
    """Digits that only the same arithmetic gives."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(60, 60))
    return {"name": name, "seed": seed, "value": float(np.linalg.norm(np.linalg.inv(a) @ a.T))}


def lost_once(name, seed):
    """Ends its process the first time that it runs with seed 2; `name` is a folder."""
    mark = Path(name) / f"seen{seed}"
    if seed == 2 and not mark.exists():
        mark.write_text("")
        os._exit(1)
    return {"seed": seed}


def lost_always(name, seed):
    """Ends its process with seed 2."""
    if seed == 2:
        os._exit(1)
    return {"seed": seed}


def process(seed):
    """Which process runs it."""
    return os.getpid()


def odd(name, seed):
    """Fails with seed 2."""
    if seed == 2:
        raise DataError("the session ended PAUSED")
    return {"seed": seed}


def for_ever(name, seed):
    """Kills the process that is named, and never ends by itself."""
    if seed == 1:
        os.write(1, b"at work")
        os.kill(int(name), signal.SIGKILL)
    threading.Event().wait()
