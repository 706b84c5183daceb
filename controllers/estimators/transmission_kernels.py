"""Kernels of the transmission's estimator: loads of the links, a filter a joint, what is left.

The equations are those of `hil.controllers.estimators.transmission`, which makes the records
`c`, `n`, `f` and `w`.
"""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np

from hil.controllers import dynamics, geometry
from hil.controllers.estimators import network, wavelets
from hil.controllers.estimators.transmission_config import NAMES
from hil.estimate.elastic_ukf import N, correct, foresee

#: Memory: filters (3 x (N + N^2)), network's friction (3), residuals (3), time, last touch.
_EACH_JOINT = N + N * N
_FILTERS = 3 * _EACH_JOINT
FIRST = _FILTERS + 8
#: Variance of a logarithm that counts as known; Runge-Kutta steps a tick.
SURE = 1e-12
PARTS = 4


@nb.njit(cache=True, nogil=True)
def links(q: Any, c: Any, w: Any) -> None:
    """L(q) = M - diag(Jm) into w.matrix (3, 3) [kg m^2]; joint 1 stands alone (M12 = M13 = 0)."""
    w.goal[:] = 0.0
    dynamics.inverse_dynamics(q, w.goal, w.goal, c.model, w.flow)
    for k in range(3):
        w.room[:] = 0.0
        w.room[k] = 1.0
        dynamics.inverse_dynamics(q, w.goal, w.room, c.model, w.seen)
        for j in range(3):
            w.matrix[j, k] = w.seen[j] - w.flow[j]
    for j in range(3):
        w.matrix[j, j] = max(w.matrix[j, j] - c.rotor[j], 0.2 * w.matrix[j, j])
    # what is left stays positive, whatever the parameters
    most = 0.9 * np.sqrt(w.matrix[1, 1] * w.matrix[2, 2])
    w.matrix[1, 2] = w.matrix[2, 1] = min(max(w.matrix[1, 2], -most), most)


@nb.njit(cache=True, nogil=True)
def loads(m: Any, q: Any, c: Any, w: Any) -> None:
    """Links' inertias 1 / (L^-1)_jj, and known torques ON the links (3,) [N m].

    L q'' = b  =>  (det / L33) q_2'' = b_2 - (L23 / L33) b_3, and 2, 3 exchanged.
    """
    links(q, c, w)
    for j in range(3):
        w.speed[j], w.goal[j] = m[_EACH_JOINT * j + 3], 0.0
    dynamics.inverse_dynamics(q, w.speed, w.goal, c.model, w.flow)
    for j in range(3):
        x = m[_EACH_JOINT * j : _EACH_JOINT * j + N]
        stretch = x[0] - x[2]
        w.load[j] = -w.flow[j] - m[_FILTERS + j]
        pull = np.exp(x[4]) * stretch + np.exp(x[5]) * stretch**3
        rub = np.exp(x[8]) * np.tanh(x[3] / c.soft) + np.exp(x[9]) * x[3]
        w.goal[j] = pull - rub + w.load[j]
    a, b, s = w.matrix[1, 1], w.matrix[2, 2], w.matrix[1, 2]
    w.link[0], w.link[1], w.link[2] = w.matrix[0, 0], a - s * s / b, b - s * s / a
    w.load[1] -= s / b * w.goal[2]
    w.load[2] -= s / a * w.goal[1]


@nb.njit(cache=True, nogil=True)
def begin(j: int, y: float, f: Any, c: Any) -> None:
    """First guess of joint j at motor angle y [rad]."""
    for r in range(N):
        f.x[r] = c.start[j, r - 4] if r >= 4 else (y if r in (0, 2) else 0.0)
        for s in range(N):
            f.p[r, s] = c.spread[r] if r == s else 0.0


@nb.njit(cache=True, nogil=True)
def hold(f: Any) -> None:
    """Take the parameters for known; their own covariance is kept in the memory meanwhile."""
    for r in range(N):
        for s in range(N):
            if r >= 4 or s >= 4:
                f.p[r, s] = SURE if r == s else 0.0


@nb.njit(cache=True, nogil=True)
def joint(
    j: int, phase: int, y: float, u: float, free: bool, f: Any, c: Any, w: Any, m: Any, at: int
) -> None:
    """Filter of one joint over one period; into w what it corrects a second.

    Memory m from `at`: state (N,), covariance (N, N).
    """
    if phase == 0:
        begin(j, y, f, c)
    else:
        for r in range(N):
            f.x[r] = m[at + r]
            for s in range(N):
                f.p[r, s] = m[at + N + N * r + s]
        if phase == 1:
            # the arm was moved meanwhile; its parameters were not
            f.x[0], f.x[1], f.x[2], f.x[3] = y, 0.0, y, 0.0
    if not free and phase > 0:
        hold(f)
    f.noise[4:] = c.wander if free else 0.0
    f.c[0], f.c[1], f.c[2], f.c[3] = 1.0 / c.rotor[j], 1.0 / w.link[j], 1.0 / c.soft, w.load[j]
    if phase == 2 and not (foresee(f, u, c.period, PARTS) and np.isfinite(f.x[0])):
        begin(j, y, f, c)
    w.innovation[j] = correct(f.x, f.p, y, f.variance, f.gain)
    for r in range(N):
        m[at + r] = f.x[r]
        for s in range(N):
            if free or phase == 0 or r < 4 or s < 4:
                m[at + N + N * r + s] = f.p[r, s]
    w.motor[j] = c.rotor[j] * f.gain[1] * w.innovation[j] / c.period
    w.slope[j] = f.gain[3] * w.innovation[j] / c.period


@nb.njit(cache=True, nogil=True)
def unexplained(phase: int, c: Any, w: Any, now: Any) -> None:
    """Torque that no filter foresaw, through a low-pass, into w.r (3,) [N m]."""
    for j in range(3):
        push = w.motor[j]
        for k in range(3):
            push += w.matrix[j, k] * w.slope[k]
        # r <- r + share (momentum a second - r)
        at = _FILTERS + 3 + j
        now[at] += c.share * ((push if phase == 2 else 0.0) - now[at])
        w.r[j] = now[at]


@nb.njit(cache=True, nogil=True)
def rub(free: bool, n: Any, nets: Any, psi: Any, w: Any, now: Any) -> None:
    """Friction by the networks into w.rub (3,) [N m]; while the arm is free, they learn."""
    wavelets.predict(w.speed, n, nets, psi, w.rub, w.seen)
    for j in range(3):
        now[_FILTERS + j] = w.rub[j]
        # what is left is learnt on top of what is known
        w.goal[j] = w.seen[j] - w.r[j]
    if free and nets.size > wavelets.HEAD:
        wavelets.learn(w.goal, w.seen, n, nets)
        wavelets.adapt(w.speed, n, nets)


@nb.njit(cache=True, nogil=True)
def estimate(
    phase: int, u: Any, sent: Any, c: Any, n: Any, psi: Any, f: Any, w: Any, past: Any, now: Any,
    out: Any,
) -> None:  # fmt: skip
    """One period; see `hil.controllers.estimators.transmission.Transmission.update`."""
    now[:] = past
    free = network.untouched(phase, u[6:9], c, past, now, FIRST - 2)
    nets = now[FIRST:]
    if phase == 0:
        wavelets.clear(nets)
        for j in range(3):
            begin(j, u[j], f[j], c)
            now[_EACH_JOINT * j : _EACH_JOINT * j + N] = f[j].x
    loads(now, u[:3], c, w)
    for j in range(3):
        joint(j, phase, u[j], sent[j], free, f[j], c, w, now, j * _EACH_JOINT)
        w.speed[j] = f[j].x[3]
    unexplained(phase, c, w, now)
    rub(free, n, nets, psi, w, now)
    geometry.jacobian(u[:3], c.lengths, w.jacobian)
    dynamics.solve_transposed(w.jacobian, w.r, w.square, out)
    tell(f, w, out)
    out[NAMED - 2], out[NAMED - 1] = free, network.count(nets)


NAMED = len(NAMES)


@nb.njit(cache=True, nogil=True)
def tell(f: Any, w: Any, out: Any) -> None:
    """Estimates of the joints into `out`, in the order of NAMES."""
    for j in range(3):
        x = f[j].x
        stretch, k1, k3 = x[0] - x[2], np.exp(x[4]), np.exp(x[5])
        out[3 + j], out[6 + j], out[9 + j] = w.r[j], x[2], x[3]
        out[12 + j] = k1 * stretch + k3 * stretch**3
        out[15 + j], out[18 + j] = w.rub[j], w.innovation[j]
        for e in range(6):
            out[21 + 3 * e + j] = np.exp(x[4 + e])
