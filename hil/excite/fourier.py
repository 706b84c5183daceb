"""Periodic band-limited motion that identifies a model as well as its limits allow.

The Fourier coefficients are chosen so that

    J = ln cond(X D) - ln det(X' W X) / 2 p,   D scaling the columns to unit norm,

is small: base parameters of the rigid body and friction are told apart (first term) and
determined with little variance (second term, D-optimality).

Sources: Swevers et al., IEEE Trans. Robotics and Automation 13(5), 1997 (Fourier series, D-
optimality); Gautier and Khalil, Int. J. Robotics Research 11(4), 1992 (condition number).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from hil.excite.question import nominal
from hil.excite.stage import Space, Stage
from hil.excite.trajectory import Trajectory, grid, sample
from hil.identify.design import Term
from hil.models.model import RobotModel
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
#: Fundamental period [s] and highest frequency [Hz].
PERIOD, HIGHEST = 10.0, 1.2
#: Instants a period, random starts, and evaluations of J for closed-form and URDF robots.
INSTANTS, STARTS, BUDGET, BUDGET_URDF = 160, 40, 6000, 3000


@dataclass(frozen=True)
class FourierDesign:
    """What an identifying motion must determine.

    Parameters
    ----------
    space : Space
        Room and limits.
    terms : list of Term
        Parts of the model.
    noise : ndarray (d,)
        Weights of the joints' rows [N m or N].
    columns : ndarray of int
        Columns that are independent of each other (base parameters).
    frame : Motion
        What does not depend on the motion: robot and sign resolution.
    """

    space: Space
    terms: list[Term]
    noise: FloatArray
    columns: NDArray[np.int_]
    frame: Motion


@dataclass(frozen=True)
class Identifying:
    """An identifying motion, and a naive one to compare with."""

    motion: Trajectory
    condition: float
    naive: float
    columns: int


def optimise(model: RobotModel, stage: Stage, seed: int = 0) -> Identifying:
    """Best motion of several random starts, each refined by L-BFGS-B."""
    design = _design(model, stage)
    rng = np.random.default_rng(seed)
    d, h = stage.space.center.size, int(HIGHEST * PERIOD)
    low = 1.0 / np.sqrt(np.arange(1, h + 1))[None, :, None]
    starts = [rng.normal(size=(d, h, 2)) * low for _ in range(STARTS)]
    starts.sort(key=lambda c: cost(c, design))
    budget = BUDGET_URDF if stage.source.urdf else BUDGET
    best = min(
        (_refined(c, design, budget // 2) for c in starts[:2]), key=lambda c: cost(c, design)
    )
    motion = shaped(best, stage.space, "identify")
    x = regressor(motion, design)
    naive = regressor(_naive(stage.space), design)
    return Identifying(motion, _condition(x), _condition(naive), x.shape[1])


def _refined(c: FloatArray, design: FourierDesign, budget: int) -> FloatArray:
    def objective(z: FloatArray) -> float:
        return cost(z.reshape(c.shape), design)

    found = scipy.optimize.minimize(
        objective, c.ravel(), method="L-BFGS-B", options={"maxfun": budget, "eps": 1e-4}
    )
    return np.asarray(found.x, dtype=np.float64).reshape(c.shape)


def cost(c: FloatArray, design: FourierDesign) -> float:
    """J of raw coefficients (d, h, 2)."""
    x = regressor(shaped(c, design.space, "try"), design)
    norm = np.linalg.norm(x, axis=0)
    if np.any(norm < 1e-12):
        return 1e6
    s = np.linalg.svd(x / norm, compute_uv=False)
    # ln det(X'X) = 2 sum ln(norm) + 2 sum ln(s)
    spread = np.sum(np.log(norm)) + np.sum(np.log(np.maximum(s, 1e-12)))
    return float(np.log(s[0] / max(float(s[-1]), 1e-12)) - spread / norm.size)


def shaped(c: FloatArray, space: Space, name: str) -> Trajectory:
    """Motion of raw coefficients, scaled to fill the common range within the speed limits."""
    t = np.arange(INSTANTS) * (PERIOD / INSTANTS)
    k = np.arange(1, c.shape[1] + 1)
    angle = 2 * np.pi / PERIOD * np.outer(t, k)
    s, o, w = np.sin(angle), np.cos(angle), 2 * np.pi / PERIOD * k[:, None]
    place = s @ c[..., 0].T + o @ c[..., 1].T
    rate = o @ (w * c[..., 0].T) - s @ (w * c[..., 1].T)
    # 2 % for what happens between the instants
    room = 0.98 * np.ptp(space.together, axis=1)
    scale = np.minimum(
        room / np.maximum(np.ptp(place, axis=0), 1e-12),
        0.98 * space.speed / np.maximum(np.abs(rate).max(axis=0), 1e-12),
    )
    middle = space.together.mean(axis=1) - scale * (place.max(axis=0) + place.min(axis=0)) / 2
    robot = space.robot
    return Trajectory(
        tuple(robot.joints),
        tuple(robot.units),
        PERIOD,
        np.array([0.0, PERIOD]),
        np.stack([middle, middle]),
        np.ones(2),
        scale[:, None, None] * c,
        name,
    )


def _naive(space: Space) -> Trajectory:
    """One sine a joint over the same range: 0.2 Hz, neighbours a quarter period apart."""
    c = np.zeros((space.center.size, 2, 2))
    phase = np.arange(space.center.size) * np.pi / 2
    c[:, 1] = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    return shaped(c, space, "naive")


def _design(model: RobotModel, stage: Stage) -> FourierDesign:
    space = stage.space
    rng = np.random.default_rng(0)
    probe = shaped(rng.normal(size=(space.center.size, 8, 2)), space, "probe")
    problem = stage.foresee(probe)
    terms, _ = nominal(model, problem, space.limits)
    torque = np.where(np.isfinite(space.limits.torque), space.limits.torque, 1.0)
    every = FourierDesign(space, terms, torque, np.arange(0), problem.motions[0])
    x = regressor(probe, every)
    norm = np.linalg.norm(x, axis=0)
    live = np.flatnonzero(norm > 1e-9 * norm.max())
    _, r, order = scipy.linalg.qr(x[:, live] / norm[live], mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    columns = np.sort(live[order[: int(np.sum(size > 1e-6 * size[0]))]])
    return FourierDesign(space, terms, torque, columns, problem.motions[0])


def regressor(x: Trajectory, design: FourierDesign) -> FloatArray:
    """Weighted columns of the design on one period, shape (n d, p)."""
    q, qd, qdd = sample(x, grid(x, INSTANTS / PERIOD))
    n, d = q.shape
    nothing = np.zeros_like(q)
    motion = design.frame.with_(
        t=np.arange(n) * (PERIOD / n),
        q=q,
        qd=qd,
        qdd=qdd,
        tau=nothing,
        tau_ext=nothing,
        load=nothing,
        static=nothing,
    )
    blocks = []
    for t in design.terms:
        columns = t.effect.columns(motion, t.joint, t.shape)
        if columns.ndim == 2:
            full = np.zeros((n, d, columns.shape[1]))
            full[:, t.joint] = columns
            columns = full
        blocks.append(columns / design.noise[:, None])
    out = np.concatenate(blocks, axis=2).reshape(n * d, -1)
    return out[:, design.columns] if design.columns.size else out


def _condition(x: FloatArray) -> float:
    """Condition number of the columns scaled to unit norm; infinite where one is zero."""
    norm = np.linalg.norm(x, axis=0)
    if np.any(norm < 1e-12):
        return float("inf")
    s = np.linalg.svd(x / norm, compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 1e-15 else float("inf")
