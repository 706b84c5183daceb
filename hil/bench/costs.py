"""What single computations cost: the compiled filter beside filterpy, and searches for designs."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil import registry, terminal
from hil.errors import ConfigError
from hil.estimate.elastic_ukf import ElasticUkf, N, UkfConfig
from hil.experiments.elastic_transmission import PERIOD, FloatArray, TwoMassPlant, record_arm
from hil.teleop import optimise
from hil.teleop.architecture import Realisation
from hil.teleop.force_sensor_free import conditioning
from hil.teleop.hybrid import Impedance
from hil.teleop.optimise import DesignProblem
from hil.terminal import Found
from hil.toml import parse


@dataclass(frozen=True)
class FilterFigures:
    """What was measured.

    Parameters
    ----------
    compiled_us, reference_us : float
        Time of a step of ten states [us], the best of several repetitions.
    worst : float
        Largest difference of any corrected state from the reference's, in standard deviations.
    steps : int
        Steps compared.
    loop_us : dict of str to float
        What estimators cost a tick in the loop, beside a law [us].
    """

    compiled_us: float
    reference_us: float
    worst: float
    steps: int
    loop_us: dict[str, float]


def _rates(x: FloatArray, u: float, c: UkfConfig) -> FloatArray:
    """Time derivative of the ten states, plainly."""
    k1, k3, fcm, fvm, fcl, fvl = np.exp(x[4:])
    d = x[0] - x[2]
    cable = k1 * d + k3 * d**3
    motor = (u - fcm * np.tanh(x[1] / c.soft) - fvm * x[1] - cable) / c.motor_inertia
    link = (cable - fcl * np.tanh(x[3] / c.soft) - fvl * x[3]) / c.link_inertia
    return np.array([x[1], motor, x[3], link, 0, 0, 0, 0, 0, 0])


def reference_cost(config: UkfConfig, position: float) -> Any:
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
        a = _rates(x, u, config)
        b = _rates(x + dt / 2 * a, u, config)
        c = _rates(x + dt / 2 * b, u, config)
        d = _rates(x + dt * c, u, config)
        return x + dt / 6 * (a + 2 * b + 2 * c + d)

    points = MerweScaledSigmaPoints(N, config.alpha, config.beta, config.kappa)
    ukf = UnscentedKalmanFilter(N, 1, PERIOD, lambda x: x[:1], move, points)
    ukf.x = np.array([position, 0.0, position, 0.0, *np.log(config.start)])
    ukf.P = np.diag([1e-6, 1e-2, 1e-6, 1e-2, *[config.spread] * 6])
    ukf.Q, ukf.R = np.diag(config.variances()), np.array([[config.resolution**2 / 12]])
    # it begins with a prediction, ours with a correction: give it its points at the start
    ukf.sigmas_f = points.sigma_points(ukf.x, ukf.P)
    return ukf


def measure_cost(steps: int = 2000) -> FilterFigures:
    """Time both and compare them on the same record."""
    config, run = UkfConfig(), record_arm(TwoMassPlant(), 20.0, 1)
    mine = ElasticUkf(config)
    mine.run(run.y[:10], run.u[:10], PERIOD)
    times = []
    for _ in range(15):
        fresh = ElasticUkf(config)
        start = time.perf_counter()
        fresh.run(run.y, run.u, PERIOD)
        times.append((time.perf_counter() - start) / run.y.size)
    mine, theirs, slow, worst = ElasticUkf(config), reference_cost(config, 0.0), [], 0.0
    for k in range(steps):
        mine.step(float(run.y[k]), float(run.u[k]), PERIOD)
        start = time.perf_counter()
        theirs.update(run.y[k])
        x, spread = theirs.x.copy(), np.sqrt(np.diag(theirs.P))
        theirs.predict(u=run.u[k])
        slow.append(time.perf_counter() - start)
        worst = max(worst, float(np.abs((mine.state - x) / spread).max()))
    blocks = np.array(slow)[: steps // 100 * 100].reshape(-1, 100).mean(1)
    return FilterFigures(1e6 * min(times), 1e6 * float(blocks.min()), worst, steps, _in_the_loop())


#: What runs beside a law: name of the estimator and its parameters.
_LOOP: dict[str, tuple[str, dict[str, Any]]] = {
    "momentum observer": ("force", {}),
    "friction network, 60 nodes": ("friction-network", {}),
    "three filters": ("elastic-ukf", {}),
    "three filters and network, 60 nodes": ("elastic-ukf", {"network": {"nodes": 60}}),
}


def _in_the_loop(ticks: int = 4000) -> dict[str, float]:
    """Cost of a tick of each estimator of `_LOOP` on a moving arm, best of five runs [us]."""
    t = PERIOD * np.arange(ticks)
    q = 0.3 + 0.2 * np.sin(2 * np.pi * np.outer(t, [0.7, 0.9, 1.1]))
    u = np.zeros((ticks, 12))
    u[:, :3], u[:, 3:6] = q, np.gradient(q, PERIOD, axis=0)
    sent, found = 0.02 * np.sign(u[:, 3:6]), {}
    for said, (name, given) in _LOOP.items():
        kind = registry.load("hil.estimators", name)
        made = kind.build(parse(kind.Config, given, "bench"), PERIOD)
        times = []
        for _ in range(5):
            past, now, out = np.zeros(made.memory), np.zeros(made.memory), np.zeros(len(made.names))
            made.update(0, past, u[0], sent[0], now, out)
            start = time.perf_counter()
            for k in range(1, ticks):
                past, now = now, past
                made.update(2, past, u[k], sent[k - 1], now, out)
            times.append((time.perf_counter() - start) / (ticks - 1))
        found[said] = 1e6 * min(times)
    return found


def ukf(args: argparse.Namespace) -> Found:
    """Compiled elastic-transmission filter against filterpy."""
    f = measure_cost()
    rows = [["compiled", f"{f.compiled_us:.2f}"], ["filterpy", f"{f.reference_us:.0f}"]]
    text = terminal.table(["filter of ten states", "us a step"], rows)
    text += f"\n  largest difference over {f.steps} steps: {f.worst:.1e} standard deviations\n\n"
    beside = [[said, f"{us:.1f}"] for said, us in f.loop_us.items()]
    text += terminal.table(["in the loop, one arm", "us a tick"], beside)
    return text, dict(vars(f))


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


def redesign(args: argparse.Namespace) -> Found:
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
