"""Size and reading speed of a session: bytes for ten minutes, and times real time."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from hil.record.mcap_read import load_arms
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner


@dataclass(frozen=True)
class RecordSpeed:
    """One session.

    Parameters
    ----------
    seconds : float
        Its length [s].
    bytes_ : int
        Its size.
    megabytes_ten_minutes : float
        Size of ten minutes at that rate [10^6 byte].
    write_ratio, read_ratio : float
        Length over the time to run and write it in lockstep, and to read both arms.
    """

    seconds: float
    bytes_: int
    megabytes_ten_minutes: float
    write_ratio: float
    read_ratio: float


def measure(seconds: float) -> RecordSpeed:
    """Run the teleoperation rig for so long in lockstep, and read it back."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.mcap"
        config = load_rig(rig_path("teleop"))
        runner.run(config, 0.05, 1, "lockstep", path)
        done = runner.run(config, seconds, 1, "lockstep", path)
        size = path.stat().st_size
        began = time.perf_counter()
        load_arms(path)
        reading = time.perf_counter() - began
    return RecordSpeed(
        seconds, size, size / seconds * 600e-6, seconds / done.wall_seconds, seconds / reading
    )


def table(m: RecordSpeed) -> str:
    """Table for the terminal."""
    return "\n".join(
        [
            f"  session            {m.seconds:g} s, {m.bytes_ / 1e6:.1f} MB",
            f"  ten minutes        {m.megabytes_ten_minutes:.0f} MB",
            f"  run and written at {m.write_ratio:.1f} x real time (lockstep)",
            f"  read back at       {m.read_ratio:.0f} x real time (both arms into arrays)",
        ]
    )
