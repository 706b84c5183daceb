"""Cost and agreement of the compiled filter, with filterpy as the reference."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.errors import ConfigError
from hil.estimate.ukf import ElasticUkf, UkfConfig
from hil.estimate.ukf_kernels import N
from hil.experiments.elastic_plant import PERIOD, FloatArray, Plant, record


@dataclass(frozen=True)
class Figures:
    """What was measured.

    Parameters
    ----------
    compiled_us, reference_us : float
        Time of a step of ten states [us], the best of several repetitions.
    worst : float
        Largest difference of any corrected state from the reference's, in standard deviations.
    steps : int
        Steps compared.
    """

    compiled_us: float
    reference_us: float
    worst: float
    steps: int


def rates(x: FloatArray, u: float, c: UkfConfig) -> FloatArray:
    """Time derivative of the ten states, plainly."""
    k1, k3, fcm, fvm, fcl, fvl = np.exp(x[4:])
    d = x[0] - x[2]
    cable = k1 * d + k3 * d**3
    motor = (u - fcm * np.tanh(x[1] / c.soft) - fvm * x[1] - cable) / c.motor_inertia
    link = (cable - fcl * np.tanh(x[3] / c.soft) - fvl * x[3]) / c.link_inertia
    return np.array([x[1], motor, x[3], link, 0, 0, 0, 0, 0, 0])


def reference(config: UkfConfig, position: float) -> Any:
    """Build the same filter with filterpy.

    Raises
    ------
    ConfigError
        If filterpy is not installed.
    """
    try:
        from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
    except ImportError as error:
        raise ConfigError("the reference needs filterpy: pip install 'hil-teleop[test]'") from error

    def move(x: FloatArray, dt: float, u: float = 0.0) -> FloatArray:
        a = rates(x, u, config)
        b = rates(x + dt / 2 * a, u, config)
        c = rates(x + dt / 2 * b, u, config)
        d = rates(x + dt * c, u, config)
        return x + dt / 6 * (a + 2 * b + 2 * c + d)

    points = MerweScaledSigmaPoints(N, config.alpha, config.beta, config.kappa)
    ukf = UnscentedKalmanFilter(N, 1, PERIOD, lambda x: x[:1], move, points)
    ukf.x = np.array([position, 0.0, position, 0.0, *np.log(config.start)])
    ukf.P = np.diag([1e-6, 1e-2, 1e-6, 1e-2, *[config.spread] * 6])
    ukf.Q, ukf.R = np.diag(config.variances()), np.array([[config.resolution**2 / 12]])
    # it begins with a prediction, ours with a correction: give it its points at the start
    ukf.sigmas_f = points.sigma_points(ukf.x, ukf.P)
    return ukf


def measure(steps: int = 2000) -> Figures:
    """Time both and compare them on the same record."""
    config, run = UkfConfig(), record(Plant(), 20.0, 1)
    mine = ElasticUkf(config)
    mine.run(run.y[:10], run.u[:10], PERIOD)
    times = []
    for _ in range(15):
        fresh = ElasticUkf(config)
        start = time.perf_counter()
        fresh.run(run.y, run.u, PERIOD)
        times.append((time.perf_counter() - start) / run.y.size)
    mine, theirs, slow, worst = ElasticUkf(config), reference(config, 0.0), [], 0.0
    for k in range(steps):
        mine.step(float(run.y[k]), float(run.u[k]), PERIOD)
        start = time.perf_counter()
        theirs.update(run.y[k])
        x, spread = theirs.x.copy(), np.sqrt(np.diag(theirs.P))
        theirs.predict(u=run.u[k])
        slow.append(time.perf_counter() - start)
        worst = max(worst, float(np.abs((mine.state - x) / spread).max()))
    blocks = np.array(slow)[: steps // 100 * 100].reshape(-1, 100).mean(1)
    return Figures(1e6 * min(times), 1e6 * float(blocks.min()), worst, steps)
