"""Elastic transmission seen from the motor alone: identify on line, then vary what was fixed.

Thesis section 3.1 and paper III: link inertia, cable tension, interaction force.  The plant is one
joint with its own equations and its own integrator: motor and link joined by a cable that stiffens,
friction on both sides that warms with the load's tension.  Semi-implicit Euler at 20 substeps,
encoder counts; nothing of the filter is used.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import atan, fabs, pi
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil import terminal
from hil.estimate.elastic_ukf import ELASTIC_PARAMETERS, ElasticUkf, UkfConfig
from hil.experiments.pages import Means, PageData, SeedMean, StudyPage, TableRows
from hil.terminal import Found

FloatArray = NDArray[np.float64]
_SUBSTEPS = 20
PERIOD = 1e-3


@dataclass(frozen=True)
class TwoMassPlant:
    """What the joint is made of.

    Parameters
    ----------
    motor, link : float
        Inertias [kg m^2], on the link's side.
    k1, k3 : float
        Cable [N m/rad], [N m/rad^3].
    coulomb, viscous : tuple of 2 floats
        Motor and link side [N m], [N m s/rad].
    tension_friction : float
        Share of the Coulomb friction of the link that follows the cable's tension.
    counts : float
        Per turn of the motor.
    """

    motor: float = 2e-4
    link: float = 1e-3
    k1: float = 50.0
    k3: float = 2e5
    coulomb: tuple[float, float] = (0.012, 0.010)
    viscous: tuple[float, float] = (1.5e-3, 1.0e-3)
    tension_friction: float = 0.0
    counts: float = 20000.0

    def slackened(self, tension: float) -> TwoMassPlant:
        """The same joint with `tension` times its cable tension: stiffness and pulley friction."""
        fall = 1.0 + self.tension_friction * (tension - 1.0)
        return replace(
            self,
            k1=self.k1 * tension,
            k3=self.k3 * tension,
            coulomb=(self.coulomb[0], self.coulomb[1] * fall),
        )


@dataclass(frozen=True)
class FilterRun:
    """One record at 1 kHz.

    Parameters
    ----------
    y, u : ndarray (n,)
        Motor angle as counted [rad], motor torque [N m].
    q, v : ndarray (n,)
        True angle and speed of the link [rad], [rad/s].
    """

    y: FloatArray
    u: FloatArray
    q: FloatArray
    v: FloatArray


@nb.njit(cache=True)
def _simulate(u: Any, load: Any, c: Any, out: Any) -> None:
    a, b, q, v = 0.0, 0.0, 0.0, 0.0
    h = PERIOD / _SUBSTEPS
    for k in range(u.size):
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = a, b, q, v
        push = u[k] - 0.02 * a
        out[k, 4] = push
        for _ in range(_SUBSTEPS):
            d = a - q
            pull = c[2] * d + c[3] * d**3
            # friction turns over at a twentieth of a rad/s, with an arc tangent
            rub_m = c[4] * atan(b / 0.032) * 2 / pi + c[6] * b
            rub_l = c[5] * atan(v / 0.032) * 2 / pi + c[7] * v
            b += h * (push - rub_m - pull) / c[0]
            v += h * (pull - rub_l + load[k]) / c[1]
            a += h * b
            q += h * v
            if fabs(a) > 1e3:
                return


def record_arm(
    plant: TwoMassPlant, seconds: float, seed: int, load: float = 0.0, size: float = 1.0
) -> FilterRun:
    """Run the joint on six sines of torque with a light spring to the middle.

    Parameters
    ----------
    plant : Plant
        The joint.
    seconds : float
        Length [s].
    seed : int
        Of the sines, 0.4 to 9 Hz.
    load : float
        External torque ON the link from 1 s on [N m].
    size : float
        Factor on the sines' 0.05 N m.
    """
    rng, n = np.random.default_rng(seed), round(seconds / PERIOD)
    t = np.arange(n) * PERIOD
    phase, rate = rng.uniform(0, 2 * np.pi, 6), rng.uniform(0.4, 9.0, 6)
    u = size * 0.05 * np.sin(2 * np.pi * rate * t[:, None] + phase).sum(1)
    out = np.zeros((n, 5))
    c = np.array([plant.motor, plant.link, plant.k1, plant.k3, *plant.coulomb, *plant.viscous])
    _simulate(u, np.where(t > 1.0, load, 0.0), c, out)
    grain = 2 * np.pi / plant.counts
    return FilterRun(np.round(out[:, 0] / grain) * grain, out[:, 4], out[:, 2], out[:, 3])


#: First guess as a multiple of the truth.
_GUESS = (0.6, 1.8, 1.6, 0.6, 0.6, 1.6)
_FROZEN = (1e-12, 1e-4, 1e-12, 1e-4, 0.0)
_INERTIAS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
_TENSIONS = (1.3, 1.0, 0.8, 0.6, 0.4)
_FORCES = (0.0, 0.02, 0.04, 0.08, 0.12)


@dataclass(frozen=True)
class ElasticTransmissionRow:
    """One condition.

    Parameters
    ----------
    study, value : str, float
        What was varied, and to what.
    angle, motor_angle : float
        rms error of the link's angle: of the filter, and of taking the motor's for it [rad].
    speed : float
        rms error of the link's speed relative to its rms.
    innovation : float
        Mean innovation [rad].
    offset : float
        Mean error of the link's angle [rad].
    """

    study: str
    value: float
    angle: float
    motor_angle: float
    speed: float
    innovation: float
    offset: float


@dataclass(frozen=True)
class TransmissionStudy:
    """Result of the experiment.

    Parameters
    ----------
    parameters : dict
        Name -> estimate over truth.
    correlation : dict
        Pair -> correlation of the two estimates at the end: -1 means only the sum is known.
    rows : list of Row
        The three studies.
    slope : float
        Mean innovation per interaction torque [rad/(N m)], and the largest departure from that
        line relative to the largest innovation.
    departure : float
        See `slope`.
    """

    parameters: dict[str, float]
    correlation: dict[str, float]
    rows: list[ElasticTransmissionRow]
    slope: float
    departure: float


def identify_transmission(
    plant: TwoMassPlant, seconds: float = 25.0, seed: int = 1
) -> tuple[FloatArray, ElasticUkf]:
    """Parameters (6,) after `seconds` [s] of motion from a wrong guess, and the filter.

    The sign of friction of the plant differs from the filter's, so that the Coulomb terms are
    estimates of a like quantity.
    """
    true = true_parameters(plant)
    config = UkfConfig(plant.motor, plant.link, tuple(true * np.array(_GUESS)))
    run = record_arm(plant, seconds, seed)
    ukf = ElasticUkf(config, float(run.y[0]))
    states, _ = ukf.run(run.y, run.u, PERIOD)
    return np.exp(states[-3000:, 4:].mean(0)), ukf


def true_parameters(plant: TwoMassPlant) -> FloatArray:
    """k1, k3, Fcm, Fvm, Fcl, Fvl of a plant."""
    (fcm, fcl), (fvm, fvl) = plant.coulomb, plant.viscous
    return np.array([plant.k1, plant.k3, fcm, fvm, fcl, fvl])


def study(seed: int = 1) -> TransmissionStudy:
    """Identify, freeze the parameters, then vary inertia, tension and interaction force."""
    plant = TwoMassPlant(tension_friction=0.8)
    found, ukf = identify_transmission(plant, seed=seed)
    frozen = UkfConfig(plant.motor, plant.link, tuple(found), noise=_FROZEN, spread=1e-12)
    rows = [
        *(_row("link inertia", f, frozen, replace(plant, link=plant.link * f)) for f in _INERTIAS),
        *(_row("cable tension", f, frozen, plant.slackened(f)) for f in _TENSIONS),
        *(_row("interaction", f, frozen, plant, f, 0.6) for f in _FORCES),
    ]
    force = np.array([r.value for r in rows[-len(_FORCES) :]])
    mean = np.array([r.innovation for r in rows[-len(_FORCES) :]])
    slope = float(force @ (mean - mean[0]) / (force @ force))
    off = float(np.abs(mean - mean[0] - slope * force).max() / np.abs(mean - mean[0]).max())
    p = ukf.covariance[4:, 4:]
    unit = p / np.sqrt(np.outer(np.diag(p), np.diag(p)))
    pairs = {"fcm, fcl": float(unit[2, 4]), "fvm, fvl": float(unit[3, 5])}
    ratio = dict(zip(ELASTIC_PARAMETERS, (found / true_parameters(plant)).tolist(), strict=True))
    return TransmissionStudy(ratio, pairs, rows, slope, off)


def _row(
    name: str,
    value: float,
    config: UkfConfig,
    plant: TwoMassPlant,
    load: float = 0.0,
    size: float = 1.0,
) -> ElasticTransmissionRow:
    run = record_arm(plant, 6.0, 5, load, size)
    states, innovation = ElasticUkf(config, float(run.y[0])).run(run.y, run.u, PERIOD)
    return _measures(name, value, run, states, innovation)


def _measures(
    name: str, value: float, run: FilterRun, states: FloatArray, innovation: FloatArray
) -> ElasticTransmissionRow:
    """Errors after the first two seconds."""
    s = slice(2000, None)
    return ElasticTransmissionRow(
        name,
        value,
        rms(states[s, 2] - run.q[s]),
        rms(run.y[s] - run.q[s]),
        rms(states[s, 3] - run.v[s]) / rms(run.v[s]),
        float(innovation[s].mean()),
        float(np.mean(states[s, 2] - run.q[s])),
    )


def rms(x: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x**2)))


# ------------------------------------------------------------ the command, and the page


def command(args: argparse.Namespace) -> Found:
    """An elastic transmission seen from the motor alone, identified on line."""
    s = study(args.seed)
    rows = [[k, f"{v:.3f}"] for k, v in s.parameters.items()]
    lines = [
        "Parameters after 25 s, from guesses 40 % low to 80 % high",
        terminal.table(["parameter", "estimate / truth"], rows),
    ]
    lines += [
        f"  correlation of {k}: {v:.2f} (-1: only the sum is known)"
        for k, v in s.correlation.items()
    ]
    cells = [
        [
            f"{r.study} {r.value:g}",
            f"{1e3 * r.angle:.3f}",
            f"{1e3 * r.motor_angle:.3f}",
            f"{100 * r.speed:.2f}",
            f"{1e3 * r.innovation:+.3f}",
        ]
        for r in s.rows
    ]
    head = ["parameters frozen, then", "link mrad", "motor for link", "speed %", "innovation mrad"]
    lines += ["", terminal.table(head, cells)]
    lines.append(
        f"  interaction torque moves the mean innovation by {1e3 * s.slope:.2f} mrad/(N m), "
        f"straight within {100 * s.departure:.1f} %"
    )
    return "\n".join(lines), asdict(s)


def _page_rows(data: PageData) -> TableRows:
    return {
        f"{r['study']} {r['value']:g}": (
            1e3 * r["angle"],
            1e3 * r["motor_angle"],
            100 * r["speed"],
            1e3 * r["innovation"],
        )
        for r in data["rows"]
    }


def _page_read(found: Means) -> list[str]:
    def of(study: str) -> dict[float, Sequence[SeedMean]]:
        own = {k: v for k, v in found.items() if k.startswith(study)}
        return {float(k.rpartition(" ")[2]): v for k, v in own.items()}

    inertia, tension, force = of("link inertia"), of("cable tension"), of("interaction")
    grows = inertia[2.5][0].mean / inertia[1.0][0].mean
    first = (inertia[1.5][0].mean - inertia[1.0][0].mean) / (
        inertia[2.5][0].mean - inertia[1.0][0].mean
    )
    slack = tension[0.4][0].mean / tension[1.0][0].mean
    x = np.array(sorted(force))
    y = np.array([force[k][3].mean for k in sorted(force)])
    line = np.polyfit(x, y, 1)
    off = float(np.abs(np.polyval(line, x) - y).max() / np.ptp(y))
    better = sum(v[0].mean < v[1].mean for v in found.values())
    return [
        "The thesis: almost constant up to 2.5 times the inertia. Here the error of the angle at "
        f"2.5 times is {grows:.1f} times that at the nominal inertia, with {100 * first:.0f} % "
        "of the rise at 1.5 times already: the filter's parameters are frozen, and it does not "
        "know of the inertia.",
        "The thesis: constant or better with less tension. Here the error at 0.4 of the tension "
        f"is {slack:.1f} times the nominal one: the cable loses stiffness with its tension, and "
        "the filter takes it for stiff.",
        "The thesis: errors nearly linear in the interaction force. Here the mean innovation is, "
        f"within {100 * off:.1f} % of its span: a force can be read from it at steady state.",
        f"The thesis: the estimate of the link's angle beats the motor's angle. Here it does in "
        f"{better} of {len(found)} conditions.",
    ]


PAGE = StudyPage(
    "An elastic transmission seen from its motor",
    "An unscented Kalman filter sees the motor alone. It first identifies the transmission; "
    "then its parameters are frozen, and the plant changes.",
    "Paper III: link states and parameters are found; robust up to 2.5 times the inertia, and "
    "for less cable tension; errors nearly linear in the interaction force.",
    (
        "condition",
        "link angle, mrad",
        "motor's for the link's, mrad",
        "link speed %",
        "mean innovation, mrad",
    ),
    _page_rows,
    _page_read,
    "Error of the link's angle [mrad]",
    (0, 1),
    lambda name: not name.startswith("interaction"),
)
