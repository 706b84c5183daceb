"""Elastic transmission seen from the motor alone: identify on line, then vary what was fixed.

Thesis section 3.1 and paper III: link inertia, cable tension, interaction force.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hil.estimate.elastic_ukf import NAMES, ElasticUkf, UkfConfig
from hil.experiments.elastic_plant import PERIOD, FloatArray, Plant, Run, record

#: First guess as a multiple of the truth.
GUESS = (0.6, 1.8, 1.6, 0.6, 0.6, 1.6)
FROZEN = (1e-12, 1e-4, 1e-12, 1e-4, 0.0)
INERTIAS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
TENSIONS = (1.3, 1.0, 0.8, 0.6, 0.4)
FORCES = (0.0, 0.02, 0.04, 0.08, 0.12)


@dataclass(frozen=True)
class Row:
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
class Study:
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
    rows: list[Row]
    slope: float
    departure: float


def identify(plant: Plant, seconds: float = 25.0, seed: int = 1) -> tuple[FloatArray, ElasticUkf]:
    """Parameters (6,) after `seconds` [s] of motion from a wrong guess, and the filter.

    The sign of friction of the plant differs from the filter's, so that the Coulomb terms are
    estimates of a like quantity.
    """
    true = truth(plant)
    config = UkfConfig(plant.motor, plant.link, tuple(true * np.array(GUESS)))
    run = record(plant, seconds, seed)
    ukf = ElasticUkf(config, float(run.y[0]))
    states, _ = ukf.run(run.y, run.u, PERIOD)
    return np.exp(states[-3000:, 4:].mean(0)), ukf


def truth(plant: Plant) -> FloatArray:
    """k1, k3, Fcm, Fvm, Fcl, Fvl of a plant."""
    (fcm, fcl), (fvm, fvl) = plant.coulomb, plant.viscous
    return np.array([plant.k1, plant.k3, fcm, fvm, fcl, fvl])


def study(seed: int = 1) -> Study:
    """Identify, freeze the parameters, then vary inertia, tension and interaction force."""
    plant = Plant(tension_friction=0.8)
    found, ukf = identify(plant, seed=seed)
    frozen = UkfConfig(plant.motor, plant.link, tuple(found), noise=FROZEN, spread=1e-12)
    rows = [
        *(_row("link inertia", f, frozen, replace(plant, link=plant.link * f)) for f in INERTIAS),
        *(_row("cable tension", f, frozen, plant.slackened(f)) for f in TENSIONS),
        *(_row("interaction", f, frozen, plant, f, 0.6) for f in FORCES),
    ]
    force = np.array([r.value for r in rows[-len(FORCES) :]])
    mean = np.array([r.innovation for r in rows[-len(FORCES) :]])
    slope = float(force @ (mean - mean[0]) / (force @ force))
    off = float(np.abs(mean - mean[0] - slope * force).max() / np.abs(mean - mean[0]).max())
    p = ukf.covariance[4:, 4:]
    unit = p / np.sqrt(np.outer(np.diag(p), np.diag(p)))
    pairs = {"fcm, fcl": float(unit[2, 4]), "fvm, fvl": float(unit[3, 5])}
    ratio = dict(zip(NAMES, (found / truth(plant)).tolist(), strict=True))
    return Study(ratio, pairs, rows, slope, off)


def _row(
    name: str, value: float, config: UkfConfig, plant: Plant, load: float = 0.0, size: float = 1.0
) -> Row:
    run = record(plant, 6.0, 5, load, size)
    states, innovation = ElasticUkf(config, float(run.y[0])).run(run.y, run.u, PERIOD)
    return measures(name, value, run, states, innovation)


def measures(name: str, value: float, run: Run, states: FloatArray, innovation: FloatArray) -> Row:
    """Errors after the first two seconds."""
    s = slice(2000, None)
    return Row(
        name, value, rms(states[s, 2] - run.q[s]), rms(run.y[s] - run.q[s]),
        rms(states[s, 3] - run.v[s]) / rms(run.v[s]), float(innovation[s].mean()),
        float(np.mean(states[s, 2] - run.q[s])),
    )  # fmt: skip


def rms(x: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x**2)))
