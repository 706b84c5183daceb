"""Hidden effects: simulated sessions with one effect inside, named from the recording alone.

The simulator's laws are not the library's (see `sim_devices`), and the session carries no
trace of what was hidden.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from tqdm import tqdm

from hil import terminal
from hil.diagnosis.engine import diagnose
from hil.diagnosis.types import Diagnosis
from hil.models.model import base_model
from hil.record.mcap_read import load
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.terminal import Found

#: Ten effects that motion in free space can show, and the joint each is hidden in.
EFFECTS: tuple[tuple[str, str], ...] = (
    ("stribeck", "joint2"),
    ("asymmetric-viscous", "joint1"),
    ("quadratic-drag", "joint3"),
    ("presliding", "joint2"),
    ("position-friction", "joint1"),
    ("coupled-friction", "joint2"),
    ("position-torque", "joint1"),
    ("end-stop", "joint3"),
    ("cogging", "joint2"),
    ("delay", "joint2"),
)


@dataclass(frozen=True)
class HiddenCase:
    """One session with a hidden effect (or none) and what was said of it."""

    effect: str
    joint: str
    seed: int
    verdict: str
    named: tuple[str, ...]
    confidence: float
    before: float
    after: float
    seconds: float

    @property
    def right(self) -> bool:
        """Named right: this effect on this joint and nothing else; or rightly nothing."""
        if not self.effect:
            return self.verdict == "adequate"
        return self.verdict == "missing-effect" and self.named == (f"{self.effect}@{self.joint}",)

    @property
    def undecided(self) -> bool:
        """The effect first, but with a rival that the data do not refute."""
        return self.verdict == "ambiguous" and self.named == (f"{self.effect}@{self.joint}",)

    @property
    def false_alarm(self) -> bool:
        """Something was named where nothing is."""
        return not self.effect and self.verdict != "adequate"


def identification_session(
    rig: Path,
    folder: Path,
    seed: int,
    motion: int,
    effect: str,
    joint: str,
    amplitude: float = 1.0,
    seconds: float | None = None,
) -> Path:
    """Record one identification session, as long as the rig says or `seconds`, with an effect."""
    row = {"effect": effect, "arm": "follower", "joint": joint, "amplitude": amplitude}
    hidden = [row] if effect else []
    config = load_rig(
        rig,
        {"simulation": {"hidden": hidden}, "controller": {"parameters": {"seed": motion}}},
    )
    path = folder / f"{effect or 'none'}-{joint}-{seed}-{motion}.mcap"
    runner.run_session(config, seconds, seed, "lockstep", path)
    return path


def hidden_case(
    rig: Path,
    folder: Path,
    effect: str,
    joint: str,
    seed: int,
    amplitude: float = 1.0,
    length: float | None = None,
) -> HiddenCase:
    """Record two sessions and a held-out one, each on its own motion; diagnose; judge."""
    began = time.perf_counter()
    paths = [
        identification_session(
            rig, folder, 10 * seed + k, 3 * seed + k, effect, joint, amplitude, length
        )
        for k in range(3)
    ]
    runs = [load(path, "follower") for path in paths]
    d = diagnose(runs[:2], base_model(runs[0].robot), runs[2:])
    for path in paths:
        path.unlink()
    return verdict(d, effect, joint, seed, time.perf_counter() - began)


def verdict(d: Diagnosis, effect: str, joint: str, seed: int, seconds: float) -> HiddenCase:
    """What a diagnosis said of a known truth."""
    named = tuple(f"{f.effect}@{f.joint}" for f in d.findings)
    ratio = [float(np.max(s.heldout.rms / d.noise)) for s in d.ladder]
    confidence = min((f.confidence for f in d.findings), default=1.0)
    return HiddenCase(
        effect, joint, seed, d.verdict, named, confidence, ratio[0], ratio[-1], seconds
    )


def run(
    rig: Path,
    seeds: Sequence[int] = (1, 2, 3),
    effects: Sequence[tuple[str, str]] = EFFECTS,
    report: Callable[[HiddenCase], None] | None = None,
) -> list[HiddenCase]:
    """All effects and none, each with several seeds."""
    out: list[HiddenCase] = []
    with tempfile.TemporaryDirectory() as folder:
        for effect, joint in (*effects, ("", "joint1")):
            for seed in seeds:
                out.append(hidden_case(rig, Path(folder), effect, joint, seed))
                if report:
                    report(out[-1])
    return out


def command(args: argparse.Namespace) -> Found:
    """Effects hidden in the simulated arms, named from the session alone."""
    count = args.seeds or 3
    seeds = range(1, count + 1)
    total = (len(EFFECTS) + 1) * count
    with tqdm(total=total, unit="session", disable=not sys.stderr.isatty()) as bar:
        found = run(Path(rig_path("identify")), list(seeds), report=lambda _: bar.update())
    rows = [
        [
            f"{c.effect or 'none'}{'@' + c.joint if c.effect else ''}",
            str(c.seed),
            c.verdict,
            ", ".join(c.named) or "-",
            f"{c.confidence:.2f}",
            f"{c.before:.2f}",
            f"{c.after:.2f}",
            "right" if c.right else "undecided" if c.undecided else "WRONG",
        ]
        for c in found
    ]
    head = ["hidden", "seed", "verdict", "named", "confidence", "before/floor", "after/floor", ""]
    data = {"cases": [vars(c) | {"right": c.right, "undecided": c.undecided} for c in found]}
    return terminal.table(head, rows) + _named_right(found), dict(data)


def _named_right(found: Sequence[HiddenCase]) -> str:
    """How many were named right, and what of the error is left."""
    present = [c for c in found if c.effect]
    right = sum(c.right for c in present)
    alarms = sum(c.false_alarm for c in found)
    return (
        f"\n  {right} of {len(present)} hidden effects named right "
        f"({100 * right / len(present):.0f} %), {sum(c.undecided for c in present)} named first of "
        f"two that the data cannot tell apart, {alarms} false alarms in "
        f"{len(found) - len(present)} sessions with none\n"
        f"  held-out error over its noise floor, worst joint: median "
        f"{median([c.before for c in present]):.2f} before, "
        f"{median([c.after for c in present]):.2f} after, "
        f"worst {max(c.after for c in present):.2f}"
    )
