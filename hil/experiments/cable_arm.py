"""Filters and wavelet networks together on the cable-driven arm of three joints, in the loop.

The thesis treats unscented filter and network apart and leaves their combination to future work.
Here all run beside one law on the simulated follower, from the same motor angles and torques: a
hand moves the arm for a minute, freely and over a gel.  Parameters and networks are learnt while
nothing touches the arm in the first part; in the second part nothing is learnt any more, and the
estimated force on the tip is compared with the sensor's.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil import registry, terminal
from hil.diagnosis.verbs import fit
from hil.estimate import compensation_tables
from hil.experiments.pages import Means, PageData, SeedMean, StudyPage, TableRows
from hil.models.model import RobotModel, base_model
from hil.record.container import read
from hil.record.mcap_read import load
from hil.record.schema import decode_numbers
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.teleop.hybrid import FloatArray
from hil.terminal import Found

_PERIOD, _CORNER = 1e-3, 10.0
#: Length of a session and of its first part [s], and of the identifying session.
_SECONDS, _LEARN, _IDENTIFY = 60.0, 40.0, 15.0
#: Part of a session, and of its first part, that ``--quick`` takes.
_QUICK = 0.5
#: Force that counts as touch [N]; an instant near one is neither free nor touched.
_TOUCH = 0.05
_ARM = "follower"
#: What the simulated arm hides in each condition.
CONDITIONS: dict[str, list[dict[str, Any]]] = {
    "friction as the thesis assumes it": [],
    "cables over other joints' pulleys, Stribeck": [
        {"effect": "coupled-friction", "arm": _ARM, "joint": "all"},
        {"effect": "stribeck", "arm": _ARM, "joint": "all", "amplitude": 0.5},
    ],
}
_NETWORK = {"nodes": 80, "gain": 0.02}


@dataclass(frozen=True)
class CableArmRow:
    """One estimator in one condition.

    Parameters
    ----------
    condition, estimator : str
        Which.
    free : float
        rms of the estimated force where nothing touches the tip [N], mean of the three axes.
    touched : float
        rms error of the force where something does [N]; the sensor's seen through the same
        low-pass.
    size : float
        rms of that force [N].
    nodes : int
        Wavelets in use at the end.
    """

    condition: str
    estimator: str
    free: float
    touched: float
    size: float
    nodes: int


@dataclass(frozen=True)
class CableArmStudy:
    """Result of the experiment.

    Parameters
    ----------
    rows : list of Row
        All estimators in all conditions.
    stiffness : dict of str to list of float
        Condition and estimator -> cables' stiffness of the joints by the filters [N m/rad].
    learnt : dict of str to float
        Condition -> share of the first part in which something could be learnt.
    """

    rows: list[CableArmRow]
    stiffness: dict[str, list[float]]
    learnt: dict[str, float]


def _estimators(model: RobotModel, learn: float = _LEARN) -> dict[str, dict[str, Any]]:
    """Tables ``[estimators]`` of the study, all with the identified rigid body of `model`."""
    pi = [float(x) for x in compensation_tables.rigid_parameters(model)]
    common = {"model": pi, "corner_hz": _CORNER}
    late = {**common, "learn_until": learn}
    kinds = {
        "observer": ("force", common),
        "fitted": ("force", {**common, "effects": compensation_tables.compensated_values(model)}),
        "network": ("friction-network", {**late, "network": _NETWORK}),
        "filters": ("elastic-ukf", late),
        "both": ("elastic-ukf", {**late, "network": {**_NETWORK, "backbone": False}}),
    }
    return {n: {"name": k, "arm": _ARM, "parameters": p} for n, (k, p) in kinds.items()}


#: Estimator -> what it is, for people.
SAID = {
    "observer": "momentum observer, no friction",
    "fitted": "momentum observer, friction fitted off line",
    "network": "networks alone, learnt in the loop",
    "filters": "filters alone, learnt in the loop",
    "both": "filters and networks, learnt in the loop",
}


def study(
    seed: int = 1, report: Callable[[str], None] = lambda _: None, part: float = 1.0
) -> CableArmStudy:
    """All conditions, with sessions of a part of their length."""
    seconds, learn = part * _SECONDS, part * _LEARN
    rows: list[CableArmRow] = []
    stiffness: dict[str, list[float]] = {}
    learnt: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        for condition, hidden in CONDITIONS.items():
            report(condition)
            path = _session(Path(name), hidden, seed, seconds, learn)
            rows += estimator_errors(condition, path, learn)
            for e in ("filters", "both"):
                stiffness[f"{condition}: {SAID[e]}"] = cables(path, e)
            learnt[condition] = float(_column(path, "both", "learning")[: _tick(learn)].mean())
    return CableArmStudy(rows, stiffness, learnt)


def _tick(seconds: float) -> int:
    return round(seconds / _PERIOD)


def _session(
    folder: Path,
    hidden: Sequence[Mapping[str, Any]],
    seed: int,
    seconds: float = _SECONDS,
    learn: float = _LEARN,
) -> Path:
    """Identify the arm, then run all estimators beside the rig's own law."""
    first, path = folder / "identify.mcap", folder / "s.mcap"
    simulation: dict[str, Any] = {"hidden": list(hidden)}
    identify = load_rig(rig_path("identify"), {"simulation": simulation})
    runner.run_session(identify, _IDENTIFY, seed, "lockstep", first).enabled()
    run = load(first, _ARM)
    model = fit([run], base_model(run.robot, _ARM) - "torque-offset").model
    hand = {"kind": "hand", "frequency": 0.5, "size": [0.05, 0.05, 0.05]}
    simulation |= {"operator": hand, "gel": {"below_home": 0.01}}
    over = {"simulation": simulation, "estimators": _estimators(model, learn)}
    runner.run_session(
        load_rig(rig_path("lawrence"), over), seconds, seed + 1, "lockstep", path
    ).enabled()
    return path


def estimator_errors(condition: str, path: Path, learn: float = _LEARN) -> list[CableArmRow]:
    """Errors of all estimators after what was learnt."""
    run = load(path, _ARM)
    if run.wrench is None:
        raise RuntimeError("a session of this rig has forces")
    force = run.wrench[:, :3]
    seen = _through(force)
    # near a touch: within a fifth of a second
    size = np.abs(force).max(axis=1)
    near = np.convolve(size > _TOUCH, np.ones(400), "same") > 0.5
    late = np.arange(len(force)) >= _tick(learn)
    free, touched = late & ~near, late & (size > _TOUCH)
    rows = []
    for name, said in SAID.items():
        values = decode_numbers(read(path).topics[f"/estimate/{name}"])
        error = values[:, :3] - seen
        nodes = values[-1, -1] if name in ("network", "both") else 0
        rows.append(
            CableArmRow(
                condition,
                said,
                _rms(error[free]),
                _rms(error[touched]),
                _rms(seen[touched]),
                int(nodes),
            )
        )
    return rows


def _column(path: Path, estimator: str, name: str) -> FloatArray:
    """One column of an elastic-ukf's channel, (n,)."""
    names = registry.load("hil.estimators", "elastic-ukf").build.names
    out: FloatArray = decode_numbers(read(path).topics[f"/estimate/{estimator}"])
    return out[:, names.index(name)]


def cables(path: Path, estimator: str) -> list[float]:
    """Stiffness of the three cables at the end [N m/rad]."""
    return [float(_column(path, estimator, f"stiffness{j}")[-1]) for j in (1, 2, 3)]


def _through(force: FloatArray) -> FloatArray:
    """Force through the estimators' low-pass, implicit first order."""
    share = 2 * np.pi * _CORNER * _PERIOD
    share, out = share / (1 + share), np.zeros_like(force)
    for k in range(1, len(force)):
        out[k] = out[k - 1] + share * (force[k] - out[k - 1])
    return out


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


# ------------------------------------------------------------ the command, and the page


def command(args: argparse.Namespace) -> Found:
    """Force on the tip without a sensor: filters and networks together on the cable arm."""
    part = _QUICK if args.quick else 1.0
    s = study(args.seed, terminal.log, part)
    lines = [
        f"Force on the tip without a sensor, {_ARM} of the simulated rig, after "
        f"{part * _LEARN:g} s of learning in the loop"
    ]
    for condition in CONDITIONS:
        rows = [r for r in s.rows if r.condition == condition]
        cells = [
            [r.estimator, f"{1e3 * r.free:.1f}", f"{1e3 * r.touched:.1f}", str(r.nodes)]
            for r in rows
        ]
        head = ["estimator", "free, rms mN", "touching, rms error mN", "nodes"]
        lines += ["", f"{condition}:", terminal.table(head, cells)]
        lines.append(
            f"  force where it touches: {1e3 * rows[0].size:.0f} mN rms; learnt during "
            f"{100 * s.learnt[condition]:.0f} % of the first part"
        )
    lines += ["", "Cables' stiffness by the filters [N m/rad], from a first guess of 150"]
    lines += [f"  {k}: {', '.join(f'{x:.1f}' for x in v)}" for k, v in s.stiffness.items()]
    return "\n".join(lines), asdict(s)


def _page_rows(data: PageData) -> TableRows:
    return {
        f"{r['estimator']} ({r['condition']})": (
            1e3 * r["free"],
            1e3 * r["touched"],
            float(r["nodes"]),
        )
        for r in data["rows"]
    }


def _page_read(found: Means) -> list[str]:
    by: dict[str, dict[str, Sequence[SeedMean]]] = {}
    for name, values in found.items():
        estimator, _, condition = name.rstrip(")").partition(" (")
        by.setdefault(condition, {})[estimator] = values
    out = []
    for condition, rows in by.items():
        free, touching = (_least(rows, k) for k in (0, 1))
        both = rows["filters and networks, learnt in the loop"]
        out.append(
            f"With {condition}: least error in free motion has *{free}*, {rows[free][0].mean:.0f} "
            f"mN (filters and networks together {both[0].mean:.0f}); least where it touches has "
            f"*{touching}*, {rows[touching][1].mean:.0f} mN (together {both[1].mean:.0f})."
        )
    return out


def _least(rows: Means, k: int) -> str:
    """Row with the smallest mean in a column."""
    return min(rows, key=lambda name: rows[name][k].mean)


PAGE = StudyPage(
    "Filters and networks together on the cable arm",
    "Force at the tip without a sensor, on the simulated arm with elastic cables, after the "
    "estimators have learnt in the loop.",
    "Section 3.1: filters for the cables (paper III) and networks for the friction (paper I) "
    "are proposed to be used together; no result is given.",
    ("estimator", "free, rms mN", "touching, error mN", "nodes"),
    _page_rows,
    _page_read,
    "Error of the force where it touches [mN]",
    (1,),
    quick=f"sessions of {_QUICK * _SECONDS:g} s in place of {_SECONDS:g}",
)
