"""Masses and inertias that real bodies can have, and the nearest ones to those that were fitted.

A body of positive density has a positive definite pseudo-inertia

    J = [[S, h], [h', m]],    S = tr(I) / 2 1 - I,

with mass m, first moments h and inertia I about the frame's origin.  A recording determines only
combinations of the parameters, so the nearest feasible ones are those whose efforts differ least:

    min |R (pi - pi_0)|^2 + small |pi - prior|^2,    J_i = S_i (V_i V_i' + e 1) S_i',

S_i S_i' being the pseudo-inertia of the description: every body stays by e within what is feasible.

Source: Wensing, Kim, Slotine, IEEE Robotics and Automation Letters 3(1), 2018; Rucker, Wensing,
the same 7(2), 2022 (parameters without constraints).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Least eigenvalue of a pseudo-inertia, in shares of its trace.
LEAST = 1e-9
#: Relative change of the efforts up to which it is the data that leave the bodies open.
SAME = 1e-6
#: Weight of the description where the efforts say nothing, and of its floor in each parameter.
PULL, FLOOR = 1e-4, 1e-3
#: Least pseudo-inertia in shares of the description's, and most evaluations of a search.
MARGIN, MOST = 1e-4, 400
#: Largest factor of the description's pseudo-inertia's root.
FARTHEST = 1e4
_ROWS, _COLUMNS = np.tril_indices(4)


def pseudo_inertia(body: FloatArray) -> FloatArray:
    """Pseudo-inertia (4, 4) of m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = body
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    out = np.empty((4, 4))
    out[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    out[:3, 3] = out[3, :3] = x, y, z
    out[3, 3] = m
    return out


def _parameters(j: FloatArray) -> FloatArray:
    """Inverse of `pseudo_inertia`, linear."""
    s = j[:3, :3]
    i = np.trace(s) * np.eye(3) - s
    return np.array([j[3, 3], *j[:3, 3], i[0, 0], i[0, 1], i[1, 1], i[0, 2], i[1, 2], i[2, 2]])


def infeasible(bodies: FloatArray) -> list[int]:
    """Numbers of the bodies (b, 10) that no density makes."""
    out = []
    for k, body in enumerate(bodies):
        j = pseudo_inertia(body)
        if np.linalg.eigvalsh(j)[0] <= LEAST * max(float(np.trace(j)), 0.0):
            out.append(k)
    return out


@dataclass(frozen=True)
class Nearest:
    """The nearest feasible bodies.

    Parameters
    ----------
    bodies : ndarray (b, 10)
        They.
    change : float
        Root mean square change of the efforts over that of the efforts.
    """

    bodies: FloatArray
    change: float

    @property
    def same(self) -> bool:
        """Whether what the data leave open made them feasible, so that no effort had to change."""
        return self.change < SAME


def nearest(bodies: FloatArray, prior: FloatArray, rows: FloatArray) -> Nearest:
    """Feasible bodies whose efforts differ least from those of some others.

    Parameters
    ----------
    bodies : ndarray (b, 10)
        As fitted.
    prior : ndarray (b, 10)
        Of the description; where no body at all, a ball takes its place.
    rows : ndarray (n, 10 b)
        Regressor at the states that matter, each row weighted.
    """
    wanted = bodies.reshape(-1)
    r = np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
    start = np.array([_possible(p, b) for p, b in zip(prior, bodies, strict=True)])
    search = _Search(r, wanted, start)
    u = np.tile(np.eye(4)[_ROWS, _COLUMNS], len(start))
    # the description gives way step by step, so that the efforts decide wherever they say anything
    for pull in (1.0, 1e-2, 1e-4):
        u = search.optimum(u, pull)
    found = _exact(search.bodies(u), wanted, r)
    change = float(np.linalg.norm(r @ (found.reshape(-1) - wanted))) / search.size
    return Nearest(found, change)


class _Search:
    """Least squares over the factors of all bodies."""

    def __init__(self, r: FloatArray, wanted: FloatArray, start: FloatArray) -> None:
        self.r, self.wanted, self.near, self.count = r, wanted, start.reshape(-1), len(start)
        self.size = float(np.linalg.norm(r @ wanted)) or 1.0
        most = np.abs(start).max(axis=1, keepdims=True)
        roots = [np.linalg.cholesky(pseudo_inertia(b)) for b in start]
        self.roots: list[FloatArray] = [np.asarray(x, dtype=np.float64) for x in roots]
        self.ease: FloatArray = PULL / (np.abs(start) + FLOOR * most).reshape(-1)

    def bodies(self, u: FloatArray) -> FloatArray:
        """Bodies (b, 10) of parameters (10 b,)."""
        each = zip(u.reshape(self.count, 10), self.roots, strict=True)
        return np.array([_made(x, root)[0] for x, root in each])

    def optimum(self, u: FloatArray, pull: float) -> FloatArray:
        """Best parameters with so much of the description's pull."""
        found = scipy.optimize.least_squares(
            self._residual, u, self._slope, method="lm", max_nfev=MOST, args=(pull,)
        )
        return np.asarray(found.x, dtype=np.float64)

    def _residual(self, u: FloatArray, pull: float) -> FloatArray:
        pi = self.bodies(u).reshape(-1)
        return np.concatenate(
            [self.r @ (pi - self.wanted) / self.size, pull * self.ease * (pi - self.near)]
        )

    def _slope(self, u: FloatArray, pull: float) -> FloatArray:
        n = len(self.r)
        out = np.zeros((n + u.size, u.size))
        for k, x in enumerate(u.reshape(self.count, 10)):
            own, at = _made(x, self.roots[k])[1], slice(10 * k, 10 * k + 10)
            out[:n, at] = self.r[:, at] @ own / self.size
            out[n + 10 * k : n + 10 * k + 10, at] = pull * self.ease[at][:, None] * own
        return out


def _exact(found: FloatArray, wanted: FloatArray, r: FloatArray) -> FloatArray:
    """The same moved to where the efforts are those that were wanted, if that is feasible."""
    scale = np.repeat(np.abs(found).max(axis=1), 10)
    step = np.linalg.lstsq(r * scale, r @ (wanted - found.reshape(-1)), rcond=1e-12)[0]
    moved = found + (scale * step).reshape(found.shape)
    return found if infeasible(moved) else moved


def _possible(prior: FloatArray, body: FloatArray) -> FloatArray:
    """The description's body where it is one; else a ball of about the fitted mass."""
    if not infeasible(prior[None]):
        return prior
    m = max(abs(float(body[0])), 1e-3)
    i = max(float(np.abs(body[[4, 6, 9]]).mean()), 1e-4 * m)
    return np.array([m, 0, 0, 0, i, 0, i, 0, 0, i])


def _made(x: FloatArray, root: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Body of the parameters of a factor V, and how it changes with them (10, 10)."""
    v = np.zeros((4, 4))
    # a trial step along what no effort sees may go anywhere; it is refused, but must be a number
    v[_ROWS, _COLUMNS] = np.clip(x, -FARTHEST, FARTHEST)
    body = _parameters(root @ (v @ v.T + MARGIN * np.eye(4)) @ root.T)
    slope = np.zeros((10, 10))
    for k, (a, b) in enumerate(zip(_ROWS, _COLUMNS, strict=True)):
        d = np.zeros((4, 4))
        d[a] = v[:, b]  # of V V': e_a v_b' + v_b e_a'
        slope[:, k] = _parameters(root @ (d + d.T) @ root.T)
    return body, slope
