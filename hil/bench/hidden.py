"""Hidden effects: simulated sessions with one effect inside, named from the recording alone.

The simulator's laws are not the library's (see `sim_devices`), and the session carries no
trace of what was hidden.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.diagnosis.engine import diagnose
from hil.diagnosis.types import Diagnosis
from hil.models.model import base_model
from hil.record.mcap_read import load
from hil.rig.config import load_rig
from hil.runtime import runner

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


def session(
    rig: Path, folder: Path, seed: int, motion: int, effect: str, joint: str, amplitude: float = 1.0
) -> Path:
    """Record one identification session with a hidden effect in the follower."""
    row = {"effect": effect, "arm": "follower", "joint": joint, "amplitude": amplitude}
    hidden = [row] if effect else []
    config = load_rig(
        rig,
        {"simulation": {"hidden": hidden}, "controller": {"parameters": {"seed": motion}}},
    )
    path = folder / f"{effect or 'none'}-{joint}-{seed}-{motion}.mcap"
    runner.run(config, seed=seed, clock="lockstep", output=path)
    return path


def case(
    rig: Path, folder: Path, effect: str, joint: str, seed: int, amplitude: float = 1.0
) -> HiddenCase:
    """Record two sessions and a held-out one, each on its own motion; diagnose; judge."""
    began = time.perf_counter()
    paths = [
        session(rig, folder, 10 * seed + k, 3 * seed + k, effect, joint, amplitude)
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
                out.append(case(rig, Path(folder), effect, joint, seed))
                if report:
                    report(out[-1])
    return out
