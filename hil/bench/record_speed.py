"""What recording costs, and what damage does: size, speed, rows lost to a bit or to a cut."""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from hil.record.container import read
from hil.record.mcap_read import load_arms
from hil.record.mcap_write import SessionWriter
from hil.record.schema import Channel
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.terminal import Found


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


def _measure(seconds: float) -> RecordSpeed:
    """Run the teleoperation rig for so long in lockstep, and read it back."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.mcap"
        config = load_rig(rig_path("teleop"))
        runner.run_session(config, 0.05, 1, "lockstep", path)
        done = runner.run_session(config, seconds, 1, "lockstep", path)
        size = path.stat().st_size
        began = time.perf_counter()
        load_arms(path)
        reading = time.perf_counter() - began
    return RecordSpeed(
        seconds, size, size / seconds * 600e-6, seconds / done.wall_seconds, seconds / reading
    )


#: Length of the session that is damaged [s], and bits of it that are flipped, one at a time.
_DAMAGED_SECONDS, _FLIPS = 1.2, 5000


@dataclass(frozen=True)
class Damage:
    """What one flipped bit, and a cut anywhere in the last second, cost at most.

    Parameters
    ----------
    flips, cuts : int
        Files read.
    flip_lost, cut_lost : float
        Most that one of them lost: of all that was written, and of what was written before the
        cut [ms].
    unreadable : int
        Files that could not be read at all, or lost their metadata.
    """

    flips: int
    cuts: int
    flip_lost: float
    cut_lost: float
    unreadable: int


def damage(flips: int = _FLIPS, stride: int = 1) -> Damage:
    """Flip bits of a session, and cut it at every byte of its last second."""
    channels = [
        Channel("/arm/measured_js", "joint_state", ("a", "b"), ("position",)),
        Channel("/arm/setpoint_jf", "joint_state", ("a", "b"), ("effort",)),
    ]
    rng = np.random.default_rng(0)
    ticks = round(_DAMAGED_SECONDS * 1000)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "whole.mcap"
        sizes = np.zeros(ticks, np.int64)
        with SessionWriter(path, channels, {"session": {"seed": "1"}}) as writer:
            for k in range(ticks):
                for c in channels:
                    writer.write(c.topic, k + 1, k * 10**6, rng.normal(size=2).tolist())
                sizes[k] = path.stat().st_size
        raw, bad = path.read_bytes(), Path(folder) / "bad.mcap"

        def rows(data: bytes) -> int:
            bad.write_bytes(data)
            box = read(bad)
            if "session" not in box.metadata or len(box.topics) != len(channels):
                return -1
            return min(len(t) for t in box.topics.values())

        kept = []
        for at in rng.integers(0, len(raw), flips).tolist():
            flipped = bytearray(raw)
            flipped[at] ^= 1 << int(rng.integers(8))
            kept.append(rows(bytes(flipped)))
        cuts = range(int(sizes[-1000]), int(sizes[-1]), stride)
        # a row written when the file was this long is not among what a cut there can keep
        left = [(rows(raw[:n]), int(np.searchsorted(sizes, n, "right"))) for n in cuts]
    return Damage(
        flips,
        len(cuts),
        float(max(ticks - n for n in kept)),
        float(max(written - n for n, written in left)),
        sum(n < 0 for n in kept) + sum(n < 0 for n, _ in left),
    )


def _text_table(m: RecordSpeed, d: Damage) -> str:
    """Table for the terminal."""
    return "\n".join(
        [
            f"  one bit flipped    {d.flip_lost:.0f} ms lost at most, of {d.flips} places",
            f"  cut off            {d.cut_lost:.0f} ms lost at most, at {d.cuts} places of the "
            "last second",
            f"  unreadable         {d.unreadable} of those files",
            f"  session            {m.seconds:g} s, {m.bytes_ / 1e6:.1f} MB",
            f"  ten minutes        {m.megabytes_ten_minutes:.0f} MB",
            f"  run and written at {m.write_ratio:.1f} x real time (lockstep)",
            f"  read back at       {m.read_ratio:.0f} x real time (both arms into arrays)",
        ]
    )


def command(args: argparse.Namespace) -> Found:
    """What recording costs, and what a flipped bit or a cut file loses."""
    found, lost = _measure(args.seconds), damage()
    return _text_table(found, lost), {**asdict(found), "damage": asdict(lost)}
