"""Sensitivity-optimised designs: what they reach, and how long the searches take."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

from hil import terminal
from hil.teleop import optimise
from hil.teleop.architecture import Realisation
from hil.teleop.force_sensor_free import conditioning
from hil.teleop.hybrid import Impedance
from hil.teleop.optimise import DesignProblem
from hil.terminal import Found

#: Tasks: name -> what differs from the default problem.
_TASKS: dict[str, DesignProblem] = {
    "gel 300 N/m": DesignProblem(real=Realisation(32.0, 30.0, 32.0)),
    "gel 300 N/m, k <= 225": DesignProblem(real=Realisation(32.0, 30.0, 32.0), stiffness=225.0),
    "gel 600 N/m, k <= 240": DesignProblem(
        real=Realisation(32.0, 30.0, 32.0),
        environment=Impedance(0.0, 3.0, 600.0),
        stiffness=240.0,
        contact=0.8,
    ),
    "condition of Q to 3": DesignProblem(real=Realisation(32.0, 30.0, 32.0), kappa=3.0, force=2.0),
}


@dataclass(frozen=True)
class RedesignRow:
    """One task.

    Parameters
    ----------
    task : str
        Name.
    sensitivity, kappa : float
        Of the optimum.
    agreeing, starts : int
        Searches within 1 % of the best.
    cold_s, warm_s : float
        Time of all searches; of one search after the gel has become 10 % stiffer.
    """

    task: str
    sensitivity: float
    kappa: float
    agreeing: int
    starts: int
    cold_s: float
    warm_s: float


def redesigned() -> list[RedesignRow]:
    """Design every task from afar, then again from a neighbouring solution."""
    rows = []
    for name, problem in _TASKS.items():
        start = time.perf_counter()
        found = optimise.optimise(problem)
        cold = time.perf_counter() - start
        ze = problem.environment
        near = replace(problem, environment=Impedance(ze.m, ze.b, 1.1 * ze.k))
        start = time.perf_counter()
        optimise.optimise(near, start=found.theta)
        warm = time.perf_counter() - start
        rows.append(
            RedesignRow(
                name,
                found.sensitivity,
                conditioning(found.design),
                found.agreeing,
                found.starts,
                cold,
                warm,
            )
        )
    return rows


def command(args: argparse.Namespace) -> Found:
    """Sensitivity-optimised designs: what they reach, and how long they take."""
    rows = redesigned()
    cells = [
        [
            r.task,
            f"{r.sensitivity:.3f}",
            f"{r.kappa:.2f}",
            f"{r.agreeing} of {r.starts}",
            f"{r.cold_s:.2f}",
            f"{r.warm_s:.2f}",
        ]
        for r in rows
    ]
    head = ["task", "sensitivity", "condition of Q", "agree", "from afar s", "re-design s"]
    return terminal.table(head, cells), {"rows": [vars(r) for r in rows]}
