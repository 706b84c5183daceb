"""Joint torque regressor of a tree of bodies, for many states at once; bodies that can be.

With spatial velocity v and acceleration a of body i in its joint's frame (gravity as an
acceleration of the base), the force on it is linear in its mass, first and second moments,

    f = m (a + w x v) + (alpha x + w x w x) mc,      n = mc x (a + w x v) + I alpha + w x I w,

and joint k of the chain below feels J_k' [f; n], J_k being its axis seen from body i.

Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 5; Atkeson, An, Hollerbach,
Int. J. Robotics Research 5(3), 1986 (linearity in the ten parameters).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import scipy.optimize
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Tree:
    """Bodies behind joints, as `regressor` takes them, and what of them is free.

    Parameters
    ----------
    joints : tuple of str
        Names of all moving joints (b,), those that follow another one included.
    parent, turn, place, axis, gravity
        As of `regressor`, for b bodies.
    follow, shift : ndarray (b, d), (b,)
        All joints' positions of the d own ones: A q + b.
    spread : ndarray (10 b, p)
        The bodies' parameters of the robot's own ones.
    """

    joints: tuple[str, ...]
    parent: IntArray
    turn: FloatArray
    place: FloatArray
    axis: FloatArray
    gravity: FloatArray
    follow: FloatArray
    shift: FloatArray
    spread: FloatArray

    @property
    def alone(self) -> bool:
        """Whether no joint follows another one."""
        return len(self.follow) == len(self.follow.T)

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Efforts (n, d, 10 b) of unit parameters of the bodies."""
        a = self.follow
        states = (q @ a.T + self.shift, qd @ a.T, qdd @ a.T)
        known = (self.parent, self.turn, self.place, self.axis, self.gravity)
        every: FloatArray = regressor(*known, *states)
        out: FloatArray = a.T @ every
        return out


@numba.njit(cache=True, nogil=True)
def _rotation(axis: FloatArray, angle: float, out: FloatArray) -> None:
    """Rodrigues' formula."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis
    u = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + u * x * x, u * x * y - s * z, u * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = u * x * y + s * z, c + u * y * y, u * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = u * x * z - s * y, u * y * z + s * x, c + u * z * z


@numba.njit(cache=True, nogil=True)
def _into(r: FloatArray, p: FloatArray, old: FloatArray, new: FloatArray) -> None:
    """Motion vector [linear, angular] of the parent's frame, seen from (R, p) within it."""
    x = old[0] + old[4] * p[2] - old[5] * p[1]
    y = old[1] + old[5] * p[0] - old[3] * p[2]
    z = old[2] + old[3] * p[1] - old[4] * p[0]
    for k in range(3):
        new[k] = r[0, k] * x + r[1, k] * y + r[2, k] * z
        new[k + 3] = r[0, k] * old[3] + r[1, k] * old[4] + r[2, k] * old[5]


@numba.njit(cache=True, nogil=True)
def _wrenches(v: FloatArray, a: FloatArray, out: FloatArray) -> None:
    """Force and moment (6, 10) of unit parameters m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz.

    What is zero for any motion, moments of m and forces of I, is left as it is.
    """
    x, y, z, bx, by, bz = v[3], v[4], v[5], a[3], a[4], a[5]
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    # of m: a + w x v
    fx, fy, fz = a[0] + y * v[2] - z * v[1], a[1] + z * v[0] - x * v[2], a[2] + x * v[1] - y * v[0]
    out[0, 0], out[1, 0], out[2, 0] = fx, fy, fz
    # of mc: the force [alpha x] + [w x]^2, the moment -[(a + w x v) x]
    out[0, 1], out[0, 2], out[0, 3] = -yy - zz, xy - bz, xz + by
    out[1, 1], out[1, 2], out[1, 3] = xy + bz, -xx - zz, yz - bx
    out[2, 1], out[2, 2], out[2, 3] = xz - by, yz + bx, -xx - yy
    out[3, 1], out[3, 2], out[3, 3] = 0.0, fz, -fy
    out[4, 1], out[4, 2], out[4, 3] = -fz, 0.0, fx
    out[5, 1], out[5, 2], out[5, 3] = fy, -fx, 0.0
    # of I: the moment E alpha + w x E w, with E = e_i e_k' (+ e_k e_i')
    out[3, 4], out[4, 4], out[5, 4] = bx, xz, -xy
    out[3, 5], out[4, 5], out[5, 5] = by - xz, bx + yz, xx - yy
    out[3, 6], out[4, 6], out[5, 6] = -yz, by, xy
    out[3, 7], out[4, 7], out[5, 7] = bz + xy, zz - xx, bx - yz
    out[3, 8], out[4, 8], out[5, 8] = yy - zz, bz - xy, by + xz
    out[3, 9], out[4, 9], out[5, 9] = yz, -xz, bz


@numba.njit(cache=True, nogil=True)
def _pose(
    turn: FloatArray,
    place: FloatArray,
    s: FloatArray,
    q: float,
    spin: FloatArray,
    r: FloatArray,
    p: FloatArray,
) -> None:
    """Pose (R, p) of a joint's frame within its parent's at position q."""
    turns = s[3] != 0.0 or s[4] != 0.0 or s[5] != 0.0
    _rotation(s[3:], q if turns else 0.0, spin)
    for x in range(3):
        p[x] = place[x]
        for y in range(3):
            r[x, y] = 0.0
            for z in range(3):
                r[x, y] += turn[x, z] * spin[z, y]
            p[x] += turn[x, y] * s[y] * q


@numba.njit(cache=True, nogil=True)
def _own(s: FloatArray, qd: float, qdd: float, v: FloatArray, a: FloatArray) -> None:
    """Add the joint's own motion: v += S qd, a += S qdd + v x S qd."""
    for x in range(6):
        v[x] += s[x] * qd
    w, u = v[3:], v[:3]
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        linear = w[y] * s[z] - w[z] * s[y] + u[y] * s[3 + z] - u[z] * s[3 + y]
        turning = w[y] * s[3 + z] - w[z] * s[3 + y]
        a[x] += s[x] * qdd + linear * qd
        a[3 + x] += s[3 + x] * qdd + turning * qd


@numba.njit(cache=True, nogil=True)
def regressor(
    parent: IntArray,
    turn: FloatArray,
    place: FloatArray,
    axis: FloatArray,
    gravity: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
    only: int = -1,
) -> FloatArray:
    """Regressor (n, d, 10 d) of d bodies, one behind each joint; (n, d, 10) of one of them.

    Parameters
    ----------
    parent : ndarray of int (d,)
        Joint before each one, -1 for the base; parents come first.
    turn, place : ndarray (d, 3, 3), (d, 3)
        Pose of each joint's frame within its parent's, at zero.
    axis : ndarray (d, 6)
        Motion [linear, angular] of each joint in its own frame.
    gravity : ndarray (3,)
        In base axes [m/s^2].
    q, qd, qdd : ndarray (n, d)
        States [rad or m and their derivatives].
    only : int
        Number of the one body that is asked for, from 0 on; -1 = all of them.
    """
    n, d = q.shape
    out = np.zeros((n, d, 10 * d if only < 0 else 10))
    v, a, seen = np.zeros((d, 6)), np.zeros((d, 6)), np.zeros((d, d, 6))
    base, spin, r, p = np.zeros(6), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    forces, still = np.zeros((6, 10)), np.zeros(6)
    for k in range(3):
        base[k] = -gravity[k]
    for k in range(n):
        for i in range(d):
            before = parent[i]
            _pose(turn[i], place[i], axis[i], q[k, i], spin, r, p)
            _into(r, p, v[before] if before >= 0 else still, v[i])
            _into(r, p, a[before] if before >= 0 else base, a[i])
            _own(axis[i], qd[k, i], qdd[k, i], v[i], a[i])
            above = before
            while above >= 0:
                _into(r, p, seen[before, above], seen[i, above])
                above = parent[above]
            seen[i, i] = axis[i]
            if only >= 0 and i != only:
                continue
            _wrenches(v[i], a[i], forces)
            first = 10 * i if only < 0 else 0
            above = i
            while above >= 0:
                for x in range(6):
                    for c in range(10):
                        out[k, above, first + c] += seen[i, above, x] * forces[x, c]
                above = parent[above]
    return out


@numba.njit(cache=True, nogil=True)
def balance(
    parent: IntArray,
    turn: FloatArray,
    place: FloatArray,
    axis: FloatArray,
    gravity: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    pi: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Effort (n, d) without acceleration, and mass matrix (n, d, d), for parameters pi (n, 10 d).

        M = sum_i J_i' I_i J_i,

    with J_i the axes of the chain below body i, seen from it, and I_i its spatial inertia.  The
    rest as of `regressor`.
    """
    n, d = q.shape
    rest, mass = np.zeros((n, d)), np.zeros((n, d, d))
    v, a, seen = np.zeros((d, 6)), np.zeros((d, 6)), np.zeros((d, d, 6))
    base, spin, r, p = np.zeros(6), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    forces, still, own = np.zeros((6, 10)), np.zeros(6), np.empty(6)
    for k in range(3):
        base[k] = -gravity[k]
    for k in range(n):
        for i in range(d):
            before, mine = parent[i], pi[k, 10 * i : 10 * i + 10]
            _pose(turn[i], place[i], axis[i], q[k, i], spin, r, p)
            _into(r, p, v[before] if before >= 0 else still, v[i])
            _into(r, p, a[before] if before >= 0 else base, a[i])
            _own(axis[i], qd[k, i], 0.0, v[i], a[i])
            above = before
            while above >= 0:
                _into(r, p, seen[before, above], seen[i, above])
                above = parent[above]
            seen[i, i] = axis[i]
            _wrenches(v[i], a[i], forces)
            for x in range(6):
                own[x] = 0.0
                for c in range(10):
                    own[x] += forces[x, c] * mine[c]
            _felt(parent, i, seen[i], own, rest[k])
            above = i
            while above >= 0:
                _moved(seen[i, above], mine, own)
                _felt(parent, i, seen[i], own, mass[k, above])
                above = parent[above]
    return rest, mass


@numba.njit(cache=True, nogil=True)
def _moved(s: FloatArray, pi: FloatArray, out: FloatArray) -> None:
    """Force and moment (6,) of an acceleration [b, alpha]: m b + alpha x mc, mc x b + I alpha."""
    b, u, mc = s[:3], s[3:], pi[1:4]
    out[0] = pi[0] * b[0] + u[1] * mc[2] - u[2] * mc[1]
    out[1] = pi[0] * b[1] + u[2] * mc[0] - u[0] * mc[2]
    out[2] = pi[0] * b[2] + u[0] * mc[1] - u[1] * mc[0]
    out[3] = mc[1] * b[2] - mc[2] * b[1] + pi[4] * u[0] + pi[5] * u[1] + pi[7] * u[2]
    out[4] = mc[2] * b[0] - mc[0] * b[2] + pi[5] * u[0] + pi[6] * u[1] + pi[8] * u[2]
    out[5] = mc[0] * b[1] - mc[1] * b[0] + pi[7] * u[0] + pi[8] * u[1] + pi[9] * u[2]


@numba.njit(cache=True, nogil=True)
def _felt(parent: IntArray, i: int, seen: FloatArray, own: FloatArray, out: FloatArray) -> None:
    """Add what the chain below body i feels of a force and moment on it, to out (d,)."""
    above = i
    while above >= 0:
        for x in range(6):
            out[above] += seen[above, x] * own[x]
        above = parent[above]


@numba.njit(cache=True, nogil=True)
def frame_motion(
    parent: IntArray,
    turn: FloatArray,
    place: FloatArray,
    axis: FloatArray,
    q: FloatArray,
    body: int,
    at: FloatArray,
    held: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place (n, 3), axes (n, 3, 3) and Jacobian (n, 6, d), linear rows first, of a frame.

    It is held by body number `body`, at `at` (3,) with axes `held` (3, 3) in that body's frame; the
    base holds it where that is -1.  All in base axes; the rest as of `regressor`.
    """
    n, d = q.shape
    places, axes, jacobian = np.empty((n, 3)), np.empty((n, 3, 3)), np.zeros((n, 6, d))
    origin, own = np.zeros((d + 1, 3)), np.zeros((d + 1, 3, 3))
    spin, r, p = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    # the base comes last, so that it is number -1
    own[d] = np.eye(3)
    for k in range(n):
        for i in range(body + 1):
            _pose(turn[i], place[i], axis[i], q[k, i], spin, r, p)
            origin[i] = origin[parent[i]] + own[parent[i]] @ p
            own[i] = own[parent[i]] @ r
        places[k] = origin[body] + own[body] @ at
        axes[k] = own[body] @ held
        above = body
        while above >= 0:
            along, about = own[above] @ axis[above, :3], own[above] @ axis[above, 3:]
            jacobian[k, :3, above] = along + np.cross(about, places[k] - origin[above])
            jacobian[k, 3:, above] = about
            above = parent[above]
    return places, axes, jacobian


def about(p: FloatArray) -> FloatArray:
    """Parameters of a body about its frame's origin (10, 10) of unit ones about a point p (3,).

    With m and h the mass and the first moments about p and I the inertia about p,

        m,    m p + h,    I + tr(S) 1 - S  with  S = m p p' + p h' + h p'.
    """
    out = np.eye(10)
    for k in range(4):
        m, h = float(k == 0), np.eye(4)[k, 1:]
        s = m * np.outer(p, p) + np.outer(p, h) + np.outer(h, p)
        i = np.trace(s) * np.eye(3) - s
        out[:, k] = m, *(m * p + h), i[0, 0], i[0, 1], i[1, 1], i[0, 2], i[1, 2], i[2, 2]
    return out


def pseudo_inertia(pi: FloatArray) -> FloatArray:
    """Pseudo-inertia (4, 4) of parameters m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz (10,)."""
    m, h, (xx, xy, yy, xz, yz, zz) = pi[0], pi[1:4], pi[4:]
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    sigma = np.trace(about) / 2 * np.eye(3) - about
    return np.block([[sigma, h[:, None]], [h[None, :], np.array([[m]])]])


def parameters(j: FloatArray) -> FloatArray:
    """Parameters (10,) of a pseudo-inertia (4, 4)."""
    i = np.trace(j[:3, :3]) * np.eye(3) - j[:3, :3]
    return np.array([j[3, 3], *j[:3, 3], i[0, 0], i[0, 1], i[1, 1], i[0, 2], i[1, 2], i[2, 2]])


def loop_room(d: int) -> tuple[FloatArray, ...]:
    """Room for `inverse_dynamics` of d bodies."""
    shapes = ((d, 6), (d, 6), (d, 6), (d, 3, 3), (d, 3), (3, 3), (6, 10), (6,), (6,))
    return tuple(np.zeros(shape) for shape in shapes)


@numba.njit(cache=True, nogil=True)
def inverse_dynamics(
    parent: IntArray,
    turn: FloatArray,
    place: FloatArray,
    axis: FloatArray,
    gravity: FloatArray,
    pi: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
    room: tuple[FloatArray, ...],
    out: FloatArray,
) -> None:
    """Efforts of d bodies in one state into `out` (d,), without allocation: for control loops.

    Parameters
    ----------
    parent, turn, place, axis, gravity
        As of `regressor`.
    pi : ndarray (d, 10)
        Parameters of the bodies.
    q, qd, qdd : ndarray (d,)
        State.
    room : tuple
        From `loop_room`.
    """
    v, a, f, r, p, spin, forces, still, base = room
    d = q.size
    for k in range(3):
        base[k] = -gravity[k]
    for i in range(d):
        before = parent[i]
        _pose(turn[i], place[i], axis[i], q[i], spin, r[i], p[i])
        _into(r[i], p[i], v[before] if before >= 0 else still, v[i])
        _into(r[i], p[i], a[before] if before >= 0 else base, a[i])
        _own(axis[i], qd[i], qdd[i], v[i], a[i])
        _wrenches(v[i], a[i], forces)
        for x in range(6):
            f[i, x] = 0.0
            for k in range(10):
                f[i, x] += forces[x, k] * pi[i, k]
    for i in range(d - 1, -1, -1):
        out[i] = 0.0
        for x in range(6):
            out[i] += axis[i, x] * f[i, x]
        before = parent[i]
        if before < 0:
            continue
        fx, fy, fz = 0.0, 0.0, 0.0
        for k in range(3):
            fx += r[i, 0, k] * f[i, k]
            fy += r[i, 1, k] * f[i, k]
            fz += r[i, 2, k] * f[i, k]
            for x in range(3):
                f[before, 3 + x] += r[i, x, k] * f[i, 3 + k]
        f[before, 0] += fx
        f[before, 1] += fy
        f[before, 2] += fz
        f[before, 3] += p[i, 1] * fz - p[i, 2] * fy
        f[before, 4] += p[i, 2] * fx - p[i, 0] * fz
        f[before, 5] += p[i, 0] * fy - p[i, 1] * fx


# ---------------------------------------------------------------------- feasible bodies

# Masses and inertias that real bodies can have, and the nearest ones to those that were fitted.
#
# A body of positive density has a positive definite pseudo-inertia
#
# J = [[S, h], [h', m]],    S = tr(I) / 2 1 - I,
#
# with mass m, first moments h and inertia I about the frame's origin.  A recording determines only
# combinations of the parameters, so the nearest feasible ones are those whose efforts differ least:
#
# min |R (pi - pi_0)|^2 + small |pi - prior|^2,    J_i = S_i (V_i V_i' + e 1) S_i',
#
# S_i S_i' being the pseudo-inertia of the description: every body stays by e within what is
# feasible.
#
# Source: Wensing, Kim, Slotine, IEEE Robotics and Automation Letters 3(1), 2018; Rucker, Wensing,
# the same 7(2), 2022 (parameters without constraints).

#: Least eigenvalue of a pseudo-inertia, in shares of its trace.
LEAST_EIGENVALUE = 1e-9
#: Relative change of the efforts up to which it is the data that leave the bodies open.
UNCHANGED = 1e-6
#: Weight of the description where the efforts say nothing, and of its floor in each parameter.
_DESCRIBED, _DESCRIBED_FLOOR = 1e-4, 1e-3
#: Least pseudo-inertia in shares of the description's, and most evaluations of a search.
_INSIDE, _EVALUATIONS = 1e-4, 400
#: Largest factor of the description's pseudo-inertia's root.
FARTHEST_FACTOR = 1e4
_ROWS, _COLUMNS = np.tril_indices(4)


def infeasible(bodies: FloatArray) -> list[int]:
    """Numbers of the bodies (b, 10) that no density makes."""
    out = []
    for k, body in enumerate(bodies):
        j = pseudo_inertia(body)
        if np.linalg.eigvalsh(j)[0] <= LEAST_EIGENVALUE * max(float(np.trace(j)), 0.0):
            out.append(k)
    return out


@dataclass(frozen=True)
class NearestBodies:
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
        return self.change < UNCHANGED


def nearest_feasible(bodies: FloatArray, prior: FloatArray, rows: FloatArray) -> NearestBodies:
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
    search = _BodySearch(r, wanted, start)
    u = np.tile(np.eye(4)[_ROWS, _COLUMNS], len(start))
    # the description gives way step by step, so that the efforts decide wherever they say anything
    for pull in (1.0, 1e-2, 1e-4):
        u = search.optimum(u, pull)
    found = _exact(search.bodies(u), wanted, r)
    change = float(np.linalg.norm(r @ (found.reshape(-1) - wanted))) / search.size
    return NearestBodies(found, change)


class _BodySearch:
    """Least squares over the factors of all bodies."""

    def __init__(self, r: FloatArray, wanted: FloatArray, start: FloatArray) -> None:
        self.r, self.wanted, self.near, self.count = r, wanted, start.reshape(-1), len(start)
        self.size = float(np.linalg.norm(r @ wanted)) or 1.0
        most = np.abs(start).max(axis=1, keepdims=True)
        roots = [np.linalg.cholesky(pseudo_inertia(b)) for b in start]
        self.roots: list[FloatArray] = [np.asarray(x, dtype=np.float64) for x in roots]
        self.ease: FloatArray = _DESCRIBED / (np.abs(start) + _DESCRIBED_FLOOR * most).reshape(-1)

    def bodies(self, u: FloatArray) -> FloatArray:
        """Bodies (b, 10) of parameters (10 b,)."""
        each = zip(u.reshape(self.count, 10), self.roots, strict=True)
        return np.array([_made(x, root)[0] for x, root in each])

    def optimum(self, u: FloatArray, pull: float) -> FloatArray:
        """Best parameters with so much of the description's pull."""
        found = scipy.optimize.least_squares(
            self._residual, u, self._slope, method="lm", max_nfev=_EVALUATIONS, args=(pull,)
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
    v[_ROWS, _COLUMNS] = np.clip(x, -FARTHEST_FACTOR, FARTHEST_FACTOR)
    body = parameters(root @ (v @ v.T + _INSIDE * np.eye(4)) @ root.T)
    slope = np.zeros((10, 10))
    for k, (a, b) in enumerate(zip(_ROWS, _COLUMNS, strict=True)):
        d = np.zeros((4, 4))
        d[a] = v[:, b]  # of V V': e_a v_b' + v_b e_a'
        slope[:, k] = parameters(root @ (d + d.T) @ root.T)
    return body, slope
