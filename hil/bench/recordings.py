"""Real recordings: what the published sets give, end to end, with every figure printed."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil import terminal
from hil.diagnosis.engine import diagnose
from hil.diagnosis.heldout import Examiner
from hil.diagnosis.types import Diagnosis
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.identify.result import relative
from hil.identify.simulated import SimulatedFit, chosen, free_run, refine
from hil.models.model import Band, RobotModel, Use, Value, base_model
from hil.record import datasets
from hil.record.recording import Recording, RobotSource
from hil.terminal import Found

#: Janot, Gautier, Brunot 2019: identified values of the EMPS.
PUBLISHED = {
    "rigid-body.m": 95.11,
    "j1.viscous.fv": 203.5,
    "j1.coulomb.fc": 20.39,
    "j1.torque-offset.t0": -3.17,
}
PUBLISHED_ERROR = 4.12
_AXIS = RobotSource("single-axis")


def _emps_model() -> RobotModel:
    """The published model: M qdd + Fv v + Fc sgn v + offset, with a sharp sign and its filter.

    Position filter 100 Hz (4th order, forward and backward) as published; their decimation by
    a Chebyshev filter with a 40 Hz pass band edge is met by a half-power frequency of 50 Hz.
    """
    sharp = Use("coulomb", options={"fixed_shape": True}, values={"j1.coulomb.v0": Value(1e-6)})
    parts = (Use("rigid-body"), sharp, Use("viscous"), Use("torque-offset"))
    return RobotModel(_AXIS, parts, band=Band(100.0, 50.0))


@dataclass(frozen=True)
class Published:
    """EMPS with the published model."""

    values: dict[str, float]
    error: float
    heldout: float


def emps_published() -> Published:
    """Reproduce the published identification; held-out error on the record with pulses."""
    train, other = datasets.load_emps(), datasets.load_emps(pulses=True)
    model = _emps_model()
    problem = Problem([train], model.robot, band=model.band)
    result = fit(problem, model)
    held = Examiner(problem, [other])(result)
    values = {k: result.values[k].value for k in PUBLISHED}
    return Published(values, float(result.relative[0]), float(held.relative[0]))


@dataclass(frozen=True)
class Emps:
    """EMPS diagnosed: errors of every rung on the record with pulses.

    Parameters
    ----------
    diagnosis : Diagnosis
        On the first record.
    heldout : list of float
        Force error of every rung [%].
    other : Recording
        The record with pulses.
    """

    diagnosis: Diagnosis
    heldout: list[float]
    other: Recording

    def free_run_mm(self, rung: int) -> float:
        """Rms position error of a rung, simulated from the first state to the end [mm]."""
        found = free_run(self.diagnosis.ladder[rung].result, [self.other])
        return 1e3 * float(found.simulated[0])


#: Rms position error of free runs on the record with pulses, as given in issue 21 [mm]; the
#: benchmark is that of nonlinearbenchmark.org (Janot, Gautier, Brunot 2019).
REFERENCES = {"linear state space": 5.53, "polynomial NARX": 5.17}
#: What may be refined beside the base model with an offset; the first record chooses.
_STRUCTURES: tuple[tuple[str, ...], ...] = (
    (),
    ("asymmetric-viscous",),
    ("asymmetric-viscous", "spring"),
    ("asymmetric-viscous", "position-torque"),
)


def emps_diagnosed() -> Emps:
    """Start from the published effects, let the tool name what is missing."""
    train, other = datasets.load_emps(), datasets.load_emps(pulses=True)
    model = base_model(_AXIS)
    d = diagnose([train], model, [other])
    return Emps(d, [float(s.heldout.relative[0]) for s in d.ladder], other)


@dataclass(frozen=True)
class Refined:
    """EMPS refined on the simulated motion: every structure, and which one the first record takes.

    Parameters
    ----------
    labels : list of str
        Structures.
    fits : list of SimulatedFit
        Their refinements on the first record; `official` is the record with pulses.
    taken : int
        Number of the one that the held-out thirds of the first record take, see `chosen`.
    """

    labels: list[str]
    fits: list[SimulatedFit]
    taken: int


def emps_refined(structures: Sequence[tuple[str, ...]] = _STRUCTURES) -> Refined:
    """Refine several structures on free runs of the first record; it alone chooses."""
    train, other = datasets.load_emps(), datasets.load_emps(pulses=True)
    fits = []
    for effects in structures:
        model = base_model(_AXIS)
        for effect in effects:
            model = model + effect
        result = fit(Problem([train], _AXIS), model)
        fits.append(refine(result, [other], free_run=True))
    labels = [" + ".join(["base + offset", *effects]) for effects in structures]
    return Refined(labels, fits, chosen(fits))


@dataclass(frozen=True)
class Contact:
    """One run of the one-degree-of-freedom rig against an object."""

    run: str
    verdict: str
    spring: float
    final: float
    named: tuple[str, ...]
    hysteresis: float
    damping: float


def contact_runs(kind: str) -> list[str]:
    """Runs of the second series against foam, spring or rigid (the first's sensors disagree)."""
    return [r for r in datasets.tue_runs() if r.startswith("m2") and kind in r]


def contact(run: str) -> Contact:
    """Diagnose the contact law of one run: first half fits, second half tests.

    `spring` is the held-out error of one linear spring over the whole run (free motion
    included), the naive law to improve on.
    """
    recording = datasets.load_tue(run)["follower"]
    half = recording.n // 2
    first, second = recording.slice(0, half), recording.slice(half, recording.n)
    base = RobotModel(_AXIS, (Use("contact-stiffness"), Use("torque-offset")), explains="external")
    d = diagnose([first], base, [second])
    law = [f.effect for f in (*d.findings, *d.partial)]
    candidates = {c.name: c.score for c in d.first.candidates}
    return Contact(
        run,
        d.verdict,
        _linear_spring(first, second),
        float(d.ladder[-1].heldout.relative[0]),
        tuple(law),
        candidates.get("contact-hysteresis", 0.0),
        candidates.get("contact-damping", 0.0),
    )


def _linear_spring(first: Recording, second: Recording) -> float:
    """Held-out relative error of tau_ext = -k q + t0 [%]."""
    train = Problem([first], _AXIS, "external")
    other = Problem([second], _AXIS, "external", rates=train.rates, span=train.span)
    x = np.stack([train.q[0], np.ones(train.n)], axis=1)
    theta = np.linalg.lstsq(x, train.y[0], rcond=None)[0]
    left = other.y[0] - np.stack([other.q[0], np.ones(other.n)], axis=1) @ theta
    return float(relative(left, other.effort[0]))


@dataclass(frozen=True)
class Wrist:
    """TX40: held-out error of every joint before and after."""

    diagnosis: Diagnosis
    split: str


def wrist(split: str = "fifths") -> Wrist:
    """Diagnose the TX40; `split` is ``"fifths"`` or ``"halves"`` (first fits, second tests)."""
    recording = datasets.load_tx40()
    model = base_model(recording.robot)
    if split == "fifths":
        return Wrist(diagnose([recording], model), split)
    half = recording.n // 2
    runs = recording.slice(0, half), recording.slice(half, recording.n)
    return Wrist(diagnose([runs[0]], model, [runs[1]]), split)


def _median_of(values: Sequence[float]) -> float:
    """Median."""
    return float(np.median(list(values)))


# ------------------------------------------------------------ the commands


def emps_command(args: argparse.Namespace) -> Found:
    """Public recording of the EMPS drive: identification, and what is missing."""
    p, e, r = emps_published(), emps_diagnosed(), emps_refined()
    free = [e.free_run_mm(k) for k in range(len(e.heldout))]
    lines = ["Published identification", *_published(p), "", "What is missing", *_missing(e, free)]
    lines += ["", "Refined on free runs of the first record", *_refined(r)]
    data: dict[str, object] = {
        "published": p.values,
        "error": p.error,
        "heldout": e.heldout,
        "free_run_mm": free,
        "models": [s.label for s in e.diagnosis.ladder],
        "simulated": {k: f.as_dict() for k, f in zip(r.labels, r.fits, strict=True)},
        "taken": r.labels[r.taken],
        "references_mm": REFERENCES,
    }
    return "\n".join(lines), data


def _published(p: Published) -> list[str]:
    """Parameters beside those of the publication."""
    rows = []
    for name, value in p.values.items():
        told = PUBLISHED[name]
        rows.append([name, f"{value:.3f}", f"{told:.2f}", f"{100 * (value / told - 1):+.2f} %"])
    return [
        terminal.table(["parameter", "here", "published", ""], rows),
        f"  relative force error {p.error:.2f} % (published {PUBLISHED_ERROR} %), "
        f"on the record with pulses {p.heldout:.2f} %",
    ]


def _missing(e: Emps, free: list[float]) -> list[str]:
    """Both errors of every rung, and where one rises as the other falls."""
    steps = zip(e.diagnosis.ladder, e.heldout, free, strict=True)
    table = [[s.label, f"{h:.2f}", f"{mm:.1f}"] for s, h, mm in steps]
    lines = [
        "Fitted on the first record, both errors on the record with pulses, which is simulated",
        "from its first state to its end",
        terminal.table(["model", "force %", "free run mm"], table),
    ]
    gain = 100 * (1 - e.heldout[-1] / e.heldout[0])
    lines.append(f"  held-out force error falls by {gain:.0f} %")
    for k in range(1, len(table)):
        if free[k] > 1.05 * free[k - 1]:
            lines.append(
                f"  warning: {table[k][0]} lowers the force error, but the free run's position "
                f"error rises from {free[k - 1]:.1f} to {free[k]:.1f} mm"
            )
    return lines


def _refined(r: Refined) -> list[str]:
    """Every structure before and after, on the first record's thirds and on the other record."""
    rows = []
    for label, f in zip(r.labels, r.fits, strict=True):
        before, after = f.official or f.heldout
        held = [f"{1e3 * e.simulated[0]:.2f}" for e in f.heldout]
        force = [f"{e.one_step[0]:.2f}" for e in (before, after)]
        mm = [f"{1e3 * e.simulated[0]:.2f}" for e in (before, after)]
        rows.append([label, *held, *force, *mm])
    rows += [[f"published: {k}", *["-"] * 5, f"{x:.2f}"] for k, x in REFERENCES.items()]
    head = ["model", "thirds mm", "refined", "force %", "refined", "free run mm", "refined"]
    return [
        "Held-out thirds of the first record, then both errors on the record with pulses",
        terminal.table(head, rows),
        f"  the first record takes {r.labels[r.taken]}",
    ]


def contact_command(args: argparse.Namespace) -> Found:
    """Public recordings of a teleoperation rig against foam, springs and walls."""
    lines, data = [], {}
    for kind in ("foam", "spring", "rigid"):
        found = [contact(r) for r in contact_runs(kind)]
        rows = [
            [
                c.run,
                c.verdict,
                f"{c.spring:.1f}",
                f"{c.final:.1f}",
                ", ".join(c.named) or "-",
                f"{c.hysteresis - c.damping:+.0f}",
            ]
            for c in found
        ]
        head = ["run", "verdict", "spring %", "final %", "named", "hysteresis - damping"]
        lines += [kind, terminal.table(head, rows)]
        spring, final = (_median_of([getattr(c, x) for c in found]) for x in ("spring", "final"))
        lines.append(
            f"  median held-out error {spring:.1f} % with a linear spring, "
            f"{final:.1f} % with the law found\n"
        )
        data[kind] = [vars(c) | {"named": list(c.named)} for c in found]
    return "\n".join(lines), dict(data)


def wrist_command(args: argparse.Namespace) -> Found:
    """Public recording of the Staubli TX40: the coupling of its wrist."""
    lines, data = [], {}
    for split in ("fifths", "halves"):
        w = wrist(split)
        joints = w.diagnosis.result.problem.joints
        rows = [[s.label, *(f"{x:.1f}" for x in s.heldout.relative)] for s in w.diagnosis.ladder]
        what = {
            "fifths": "Blocks of the whole recording, held out",
            "halves": "First half fits, second half tests",
        }[split]
        lines += [f"{what}: held-out error %", terminal.table(["model", *joints], rows), ""]
        data[split] = {s.label: s.heldout.relative.tolist() for s in w.diagnosis.ladder}
    return "\n".join(lines), dict(data)
