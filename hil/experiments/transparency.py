"""Transparency on the simulated rig: the hybrid matrix that sessions show against the prediction.

A machine moves the leader up and down on a sine; the follower moves in free space, or in contact
with gels of two stiffnesses.  Both arms are identified first, and the law computes torques and
compensates friction with those models.  The prediction is that of the sampled loop with the
cable (`hil.teleop.sampled_loop.hybrid_at`); nothing of the simulator is read.

Beside the two classic designs run three that are transparent by the thesis' conditions, but for
their terms of acceleration, with the whole force handed over (c2 = kf (1 + c6), kf c3 = 1 + c5):
four channels with two sets of gains, which the redundancy of these conditions leaves free, and
three channels (c4 = 0 by the local gain c8).
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from hil import registry, terminal
from hil.diagnosis.verbs import fit
from hil.experiments.pages import Means, PageData, StudyPage, TableRows
from hil.models.files import write_model
from hil.models.model import base_model
from hil.models.phantom import Premium
from hil.record.mcap_read import load
from hil.rig.config import ControllerConfig, RigConfig, load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.teleop import hybrid, law_parameters, rig_designs, sampled_loop
from hil.teleop.hybrid import ComplexArray, Experiment, FloatArray
from hil.teleop.rig_designs import ArmImpedances
from hil.terminal import Found
from hil.toml import parse

PERIOD = 1e-3
#: Frequencies of the leader's motion [Hz]; whole numbers of samples a period.
_HZ, _QUICK_HZ = (0.5, 1.0, 2.0, 4.0), (1.0, 4.0)
CUT_PERIODS, SETTLE = 5, 2.0
#: Gel under the tip: none, then two stiffnesses [N/m^1.3], 20 mm above the tip's rest.
_GELS: tuple[float | None, ...] = (None, 250.0, 500.0)
_UP, VERTICAL = 0.008, 2
HYBRID_ENTRIES = ("h11", "h12", "h21", "h22")
#: 95 % bound of a complex error over its standard error estimated from few periods:
#: |e|^2 / s^2 ~ F(2, 2 (periods - 1)).
_CONFIDENCE = float(np.sqrt(stats.f.ppf(0.95, 2, 2 * (CUT_PERIODS - 1))))


@dataclass(frozen=True)
class TransparencyRow:
    """One entry of H at one frequency.

    Parameters
    ----------
    design, entry : str
        Which.
    hz : float
        Frequency.
    predicted, measured, std : float
        Magnitudes and standard error, in the unit of the entry: h11 N s/m, h22 m/(N s).
    scale : float
        What `error` and `bound` are relative to: |predicted|, or the entry's natural unit where
        that is larger (see `_scales`).
    difference : float
        |measured - predicted| of the complex numbers, in the unit of the entry.
    error : float
        The same over `scale`.
    bound : float
        What the data's scatter allows `error` to be, 95 %, over `scale`; see `_CONFIDENCE`.
    """

    design: str
    entry: str
    hz: float
    predicted: float
    measured: float
    std: float
    scale: float
    difference: float
    error: float
    bound: float

    @property
    def own(self) -> float:
        """Difference over the entry's own size, |predicted|."""
        return self.difference / self.predicted if self.predicted else float("inf")

    @property
    def inside(self) -> bool:
        """Whether the data's scatter alone explains the difference."""
        return self.error <= self.bound


def identified_arms(folder: Path, seed: int) -> dict[str, str]:
    """Model files of both arms from one identifying session of the simulated rig."""
    session = folder / "identify.mcap"
    runner.run_session(load_rig(rig_path("identify")), 15.0, seed, "lockstep", session).enabled()
    out = {}
    for arm in ("leader", "follower"):
        run = load(session, arm)
        out[arm] = str(folder / f"{arm}.toml")
        write_model(fit([run], base_model(run.robot, arm)).model, out[arm])
    return out


def arm_parameters(
    models: Mapping[str, str], settings: Mapping[str, Any]
) -> tuple[dict[str, Any], ArmImpedances]:
    """Parameters of the law for the identified arms, and the masses of the axes."""
    given = rig_designs.models(models, load_rig(rig_path("lawrence"))) | dict(settings)
    law_type = registry.load("hil.controllers", "lawrence").Config
    return given, ArmImpedances.of(
        parse(law_type, {"c1": [0.0] * 3, "c7": [0.0] * 3} | given, "experiment")
    )


def sessions(law: Mapping[str, Any], hz: float, folder: Path, seed: int) -> list[Experiment]:
    """Runs in free space and on the gels."""
    out = []
    for k, gel in enumerate(_GELS):
        config = rig_of_design(law, hz, gel)
        path = folder / f"{hz:g}-{k}.mcap"
        runner.run_session(config, SETTLE + CUT_PERIODS / hz, seed + k, "lockstep", path).enabled()
        out.append(last_periods(path, hz))
    return out


def rig_of_design(law: Mapping[str, Any], hz: float, gel: float | None) -> RigConfig:
    """Rig with a machine on the leader and a gel of this stiffness, or none, 20 mm above home."""
    operator = {"kind": "mechanical", "frequency": hz, "size": [0.0, 0.0, _UP], "onset": 1.0}
    below = 1.0 if gel is None else -0.02
    simulation = {"operator": operator, "gel": {"below_home": below, "stiffness": gel}}
    config = load_rig(rig_path("lawrence"), {"simulation": simulation})
    controller = ControllerConfig("lawrence", config.controller.arms, dict(law))
    return dataclasses.replace(config, controller=controller)


def last_periods(path: Path, hz: float, axis: int = VERTICAL) -> Experiment:
    """Last periods of a session on one axis of the workspace."""
    n = round(CUT_PERIODS / hz / PERIOD)
    arm, signals = Premium(()), []
    for name, sign in (("leader", 1.0), ("follower", -1.0)):
        run = load(path, name)
        if run.wrench is None or run.qd is None:
            raise RuntimeError("a session of this rig has forces and speeds")
        q, force = run.q[-n:], sign * run.wrench[-n:, axis]
        # speed of the tip from positions: the driver's estimate lags
        place = arm.tip(run.q)[:, axis]
        speed = np.gradient(place, PERIOD)[-n:]
        signals += [speed, force - force.mean()]
        if len(q) != n:
            raise RuntimeError("the session is shorter than its periods")
    vm, fm, vs, fs = signals
    return Experiment(vm, fm, vs, fs, CUT_PERIODS, PERIOD)


def predicted(law: Mapping[str, Any], hz: FloatArray) -> ComplexArray:
    """Hybrid matrix of the sampled loop on the vertical axis, (n, 2, 2)."""
    config = parse(registry.load("hil.controllers", "lawrence").Config, law, "experiment")
    loop = law_parameters.loops_of(config)[VERTICAL]
    return sampled_loop.hybrid_at(loop, 2 * np.pi * hz, PERIOD, encoders=True)


def relative_errors(h: ComplexArray, goal: ComplexArray) -> FloatArray:
    """Entrywise |h - goal| over |goal|, each entry's own size, (n, 2, 2)."""
    return np.asarray(np.abs(h - goal) / np.abs(goal), np.float64)


def _scales(goal: ComplexArray) -> FloatArray:
    """The larger of |goal| and the entry's natural unit, (n, 2, 2).

    h12 and h21 count against 1; h11 and h22 against their own size or, where that is small,
    10 N s/m and its inverse: what a soft hand and a gel offer at these frequencies.
    """
    unit = np.array([[10.0, 1.0], [1.0, 0.1]])
    return np.asarray(np.maximum(np.abs(goal), unit), np.float64)


@dataclass(frozen=True)
class ShownDesign:
    """A design of the study.

    Parameters
    ----------
    name : str
        Of `hil.teleop.architecture.DESIGNS`.
    wish : dict
        What it is made from, as ``--set`` takes it.
    law : dict
        Of the law, beside the rig file's.
    accelerations : bool
        Whether its motion terms keep their accelerations.
    hz : tuple of float
        Frequencies of the leader's motion.
    """

    name: str
    wish: Mapping[str, float]
    law: Mapping[str, float] = field(default_factory=dict)
    accelerations: bool = True
    hz: tuple[float, ...] = _HZ

    @classmethod
    def whole(cls, name: str, stiffness: float, damping: float, local: float) -> ShownDesign:
        """One that hands over the whole force, from 1 Hz on; forces through a quick filter."""
        wish, law = _both(stiffness, damping, local), {"force_hz": 100.0}
        return cls(name, wish, law, accelerations=False, hz=_HZ[1:])


def _both(stiffness: float, damping: float, local: float) -> dict[str, float]:
    """A wish with the same terms at both arms; `local` is c5 = c6."""
    motion = {"stiffness": stiffness, "damping": damping}
    return {
        **motion,
        **{f"master_{k}": v for k, v in motion.items()},
        "slave_force": local,
        "master_force": local,
    }


#: Transparent, and stable with every operator and environment of the check before the start.
FOUR_CHANNELS, OTHER, THREE_CHANNELS = (
    "four channels",
    "four channels, other gains",
    "three channels",
)
SHOWN_DESIGNS: dict[str, ShownDesign] = {
    "position-error": ShownDesign("position-error", _both(200.0, 1.0, 0.0)),
    "position-force": ShownDesign(
        "position-force",
        {"stiffness": 300.0, "damping": 1.2, "share": 0.5, "master_damping": 0.5},
    ),
    FOUR_CHANNELS: ShownDesign.whole("four-channel", 250.0, 1.0, -0.5),
    OTHER: ShownDesign.whole("four-channel", 120.0, 1.0, -0.5),
    THREE_CHANNELS: ShownDesign.whole("three-channel-4", 250.0, 1.5, 0.0),
}


def law_of_design(shown: ShownDesign, models: Mapping[str, str]) -> dict[str, Any]:
    """Parameters of the law of a design for the identified arms."""
    given, axes = arm_parameters(models, shown.law)
    made = rig_designs.axis_designs(shown.name, shown.wish, axes)
    if not shown.accelerations:
        made = [rig_designs.without_accelerations(d) for d in made]
    return given | law_parameters.law_table(made)


def study(
    seed: int = 1, report: Callable[[str], None] = lambda _: None, hz: tuple[float, ...] = _HZ
) -> list[TransparencyRow]:
    """All designs at those of the frequencies that they are for."""
    rows: list[TransparencyRow] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        models = identified_arms(folder, seed)
        for design, shown in SHOWN_DESIGNS.items():
            report(design)
            at = tuple(f for f in shown.hz if f in hz)
            rows += compare_hybrid(design, law_of_design(shown, models), at, folder, seed)
    return rows


def compare_hybrid(
    design: str, law: Mapping[str, Any], hz: tuple[float, ...], folder: Path, seed: int
) -> list[TransparencyRow]:
    """Measured against predicted at some frequencies."""
    goal, rows = predicted(law, np.array(hz)), []
    for k, f in enumerate(hz):
        found = hybrid.estimate_hybrid(sessions(law, f, folder, seed))
        off = np.abs(found.h - goal[k]).reshape(4)
        for i, entry in enumerate(HYBRID_ENTRIES):
            h, g, unit = (x.reshape(4)[i] for x in (found.h, goal[k], _scales(goal[k])))
            std = float(found.std.reshape(4)[i])
            rows.append(
                TransparencyRow(
                    design,
                    entry,
                    f,
                    float(abs(g)),
                    float(abs(h)),
                    std,
                    float(unit),
                    float(off[i]),
                    float(off[i] / unit),
                    _CONFIDENCE * std / float(unit),
                )
            )
    return rows


def worst(rows: list[TransparencyRow], entry: str) -> float:
    """Largest error of an entry over its own size."""
    return max(r.own for r in rows if r.entry == entry)


# ------------------------------------------------------------ the command, and the page


def command(args: argparse.Namespace) -> Found:
    """The hybrid matrix that sessions show, against the prediction."""
    rows = study(args.seed, terminal.log, _QUICK_HZ if args.quick else _HZ)
    cells = [
        [
            f"{r.design} {r.entry}",
            f"{r.hz:g}",
            f"{r.predicted:.4g}",
            f"{r.measured:.4g}",
            f"{r.difference:.3g}",
            f"{100 * r.own:.1f}",
            f"{100 * r.bound * r.scale / r.predicted:.1f}",
            "yes" if r.inside else "no",
        ]
        for r in rows
    ]
    head = [
        "entry",
        "Hz",
        "|predicted|",
        "|measured|",
        "difference",
        "of |predicted| %",
        "scatter 95 % %",
        "inside",
    ]
    text = "Hybrid matrix of sessions against the prediction (vertical axis, encoder side)\n"
    text += terminal.table(head, cells)
    largest = {e: worst(rows, e) for e in HYBRID_ENTRIES}
    told = ", ".join(f"{e} {100 * x:.1f} %" for e, x in largest.items())
    inside = sum(r.inside for r in rows)
    text += (
        "\n  difference: |measured - predicted| of the complex numbers, in N s/m (h11), 1 (h12,"
        "\n  h21), m/(N s) (h22), and in % of the entry's own size"
        "\n  scatter: 95 % bound of what the scatter of the sessions' periods allows, same scale"
        f"\n  inside: {inside} of {len(rows)} differ by no more than the scatter; what is beyond"
        "\n  it is the model's error (friction that is left, fitted parameters), not the data's"
        f"\n  worst difference, of the entry's own size: {told}"
    )
    return text, {
        "rows": [dataclasses.asdict(r) | {"inside": r.inside} for r in rows],
        "worst": largest,
        "inside": inside,
    }


def _page_rows(data: PageData) -> TableRows:
    return {
        f"{r['design']}, {r['entry']}, {r['hz']:g} Hz": (
            r["predicted"],
            r["measured"],
            100 * r["difference"] / r["predicted"],
        )
        for r in data["rows"]
    }


def _page_read(found: Means) -> list[str]:
    classic = ("position-error", "position-force")
    whole = (FOUR_CHANNELS, OTHER, THREE_CHANNELS)

    def worst(entry: str, designs: Sequence[str] = (*classic, *whole)) -> float:
        names = [k for k in found if k.startswith(tuple(f"{d}, {entry}, " for d in designs))]
        return max(found[k][2].mean for k in names)

    def sizes(design: str, entry: str) -> list[float]:
        return [v[1].mean for k, v in found.items() if k.startswith(f"{design}, {entry}, ")]

    def span(design: str, entry: str) -> str:
        return f"{min(sizes(design, entry)):.3g} to {max(sizes(design, entry)):.3g}"

    def apart(entry: str) -> float:
        pairs = zip(sizes(FOUR_CHANNELS, entry), sizes(OTHER, entry), strict=True)
        return max(100.0 * abs(a / b - 1.0) for a, b in pairs)

    shown = "; ".join(
        f"{name}: h12 {span(name, 'h12')}, h21 {span(name, 'h21')}, h11 {span(name, 'h11')} N s/m"
        for name in (FOUR_CHANNELS, THREE_CHANNELS)
    )
    lost = max(max(sizes(name, "h22")) for name in whole)
    return [
        "The thesis proves what a transparent design must satisfy and measures none. Here the "
        "hybrid matrix of sessions on the simulated rig stands beside the prediction: the largest "
        f"difference is {worst('h12'):.1f} % of h12 and {worst('h21'):.1f} % of h21; for the "
        f"classic designs {worst('h22', classic):.1f} % of h22 and {worst('h11', classic):.0f} % "
        "of h11.",
        f"Transparent is h12 = 1, |h21| = 1, h11 = h22 = 0. Measured from {_HZ[1]:g} to "
        f"{_HZ[-1]:g} Hz, with the whole force handed over: {shown}; h22 at most {lost:.2g} "
        f"m/(N s), for {max(sizes(classic[0], 'h22')):.2g} of position-error. So little is "
        f"left of h22 that its prediction is off by up to {worst('h22', whole):.0f} % of it.",
        "What keeps them from 1 and 0: their terms of acceleration are left out, since the cables "
        "bear them behind a slow filter only. What is missed grows with frequency.",
        "Redundancy: the thesis' conditions leave the local gains free. Two sets of them, with "
        f"{SHOWN_DESIGNS[FOUR_CHANNELS].wish['stiffness']:g} and "
        f"{SHOWN_DESIGNS[OTHER].wish['stiffness']:g} N/m between "
        f"the arms, differ by at most {apart('h12'):.1f} % in h12 and {apart('h21'):.1f} % in h21.",
        "h11 is what the operator feels in free space. Its prediction is small where the law "
        "compensates the arm, so that friction that no model holds is large beside it.",
    ]


PAGE = StudyPage(
    "The hybrid matrix of sessions",
    "Designs of the extended Lawrence architecture run on the simulated rig: two classic ones, "
    "and three that hand over the whole force and are transparent but for their terms of "
    "acceleration. A machine moves the leader at one frequency, in free space and on two gels; "
    "the hybrid matrix of these sessions, as magnitudes, stands beside the prediction.",
    "Paper IV: conditions for transparency, their solutions, and the redundancy of the "
    "communication gains, as theory.",
    ("entry", "predicted", "measured", "difference %"),
    _page_rows,
    _page_read,
    "h12 and |h21| at 1 Hz, where 1 is transparent",
    (0, 1),
    lambda name: name.endswith((", h12, 1 Hz", ", h21, 1 Hz")),
    quick=f"{len(_QUICK_HZ)} frequencies of {len(_HZ)}",
)
