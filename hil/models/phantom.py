"""PHANTOM arms in closed form: Premium 1.5 (parallelogram) and Omni.

theta1 turntable, theta2 upper link from horizontal, theta3 forearm measured from the base
(theta3 = 0: it hangs straight down).  Sources: Cavusoglu, Feygin and Tendick, Presence 11(6),
2002 (form and values; their C32 has the wrong sign, skew symmetry of M' - 2C demands minus);
public Simulink code for the Omni's ten parameters.

Rigid bodies of the PHANTOM arms, compiled: one state, and what is made of many.

One row is the only place where their equations stand; the regressor and the balance of a
simulation are loops over it.  Sources as of `hil.models.phantom`.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from hil.models import bodies

FloatArray = NDArray[np.float64]
G = 9.81
#: The links as a tree, for what they carry: joints before, poses, axes [linear, angular], gravity.
_BEFORE, _UPRIGHT, _DOWN = np.array([-1, 0, 1]), np.stack([np.eye(3)] * 3), np.array([0.0, 0.0, -G])
_AXES = np.array([[0, 0, 0, 0, 0, 1], [0, 0, 0, 0, -1, 0], [0, 0, 0, 0, -1, 0]], dtype=np.float64)
#: Angles of the tree from theta: the forearm's is theta3 - theta2.
FOLLOW = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 1.0]])


class _Phantom:
    """Geometry that both arms share: link lengths, tip Jacobian, a mass at the tip."""

    l1: float
    l2: float
    #: pi1, pi5, pi6 (k1, k6, k7) already hold the rotors' inertias.
    has_armature = False
    units: tuple[str, ...] = ("rad", "rad", "rad")
    names: tuple[str, ...]
    #: Whether the equations are the Omni's.
    omni = False
    links: tuple[int, ...] = (3, 1, 2)
    #: The parameters are sums over several bodies.
    tree = None

    def __init__(self, joints: tuple[str, ...]) -> None:
        self.joints: tuple[str, ...] = (
            joints if len(joints) == 3 else ("joint1", "joint2", "joint3")
        )

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Minimal regressor Y (n, 3, p), tau = Y pi."""
        x, v, a = (np.ascontiguousarray(x, dtype=np.float64) for x in (q, qd, qdd))
        out: FloatArray = _regressor(self.omni, x, v, a, len(self.names))
        return out

    def balance(
        self, q: FloatArray, qd: FloatArray, pi: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Effort without acceleration (n, 3) and mass matrix (n, 3, 3) for parameters (n, p)."""
        x, v, p = (np.ascontiguousarray(x, dtype=np.float64) for x in (q, qd, pi))
        found: tuple[FloatArray, FloatArray] = _balance(self.omni, x, v, p)
        return found

    def tip(self, q: FloatArray) -> FloatArray:
        """Tip position p = (r c1, r s1, l1 s2 - l2 c3), r = l1 c2 + l2 s3, shape (n, 3) [m]."""
        (s1, s2, s3), (c1, c2, c3) = np.sin(q).T, np.cos(q).T
        r = self.l1 * c2 + self.l2 * s3
        return np.stack([r * c1, r * s1, self.l1 * s2 - self.l2 * c3], axis=1)

    def places(self, q: FloatArray) -> FloatArray:
        """Base, elbow and tip for angles (3,), shape (3, 3) [m]."""
        elbow = self.l1 * np.array(
            [np.cos(q[1]) * np.cos(q[0]), np.cos(q[1]) * np.sin(q[0]), np.sin(q[1])]
        )
        return np.stack([np.zeros(3), elbow, self.tip(q[None])[0]])

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Tip Jacobian of p = (r c1, r s1, l1 s2 - l2 c3), shape (n, 3, 3)."""
        (s1, s2, s3), (c1, c2, c3) = np.sin(q).T, np.cos(q).T
        r = self.l1 * c2 + self.l2 * s3
        zero = np.zeros_like(r)
        rows = [
            [-s1 * r, -self.l1 * c1 * s2, self.l2 * c1 * c3],
            [c1 * r, -self.l1 * s1 * s2, self.l2 * s1 * c3],
            [zero, self.l1 * c2, self.l2 * s3],
        ]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)

    def tip_axes(self, q: FloatArray) -> FloatArray | None:
        """Axes of the last link: across it in its plane, normal to that plane, along it."""
        (s1, _, s3), (c1, _, c3) = np.sin(q).T, np.cos(q).T
        zero = np.zeros_like(s1)
        rows = [[c1 * c3, -s1, c1 * s3], [s1 * c3, c1, s1 * s3], [s3, zero, -c3]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)

    def external(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """tau_ext = J^T F, shape (n, 3); a pen tip transmits no torque."""
        effort: FloatArray = np.einsum("nkd,nk->nd", self.jacobian(q), wrench[:, :3])
        return effort

    def tip_mass(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray | None:
        """Effort J^T (J q'' + J' q' + g e_z) of one kilogram at the tip, shape (n, 3)."""
        return self.body_load(q, qd, qdd, 3)[:, :, 0]

    def body_load(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, link: int) -> FloatArray:
        """Effort of a body on the turntable (1), the upper link (2) or the forearm (3), (n, 3, 10).

        Axes of the upper link: along it, across, up; of the forearm, hanging down: forwards,
        across, up.  On the forearm about the tip, else about the joint.
        """
        # angles of the tree: the forearm's is counted from the upper link there
        states = tuple(np.ascontiguousarray(x @ FOLLOW.T, dtype=np.float64) for x in (q, qd, qdd))
        place = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [self.l1, 0.0, 0.0]])
        tree = (_BEFORE, _UPRIGHT, place, _AXES, _DOWN, *states)
        out: FloatArray = FOLLOW.T @ bodies.regressor(*tree, link - 1)  # type: ignore[call-arg, arg-type]
        return np.asarray(out @ bodies.about(np.array([0.0, 0.0, -self.l2])) if link == 3 else out)

    def tip_load(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray | None:
        """Of one kilogram alone, shape (n, 3, 1)."""
        mass = self.tip_mass(q, qd, qdd)
        return None if mass is None else mass[:, :, None]


class Premium(_Phantom):
    """PHANTOM Premium 1.5: eight parameters, tau = Y pi."""

    l1, l2 = 0.215, 0.170
    names: tuple[str, ...] = tuple(f"pi{k}" for k in range(1, 9))
    param_units: tuple[str, ...] = ("kg m^2",) * 6 + ("N m",) * 2
    prior = np.array(
        [2.8328e-3, 1.1319e-3, -3.9120e-4, 9.1230e-4, 2.4264e-3, 9.3189e-4, -1.6298e-2, -7.3755e-2]
    )


class Omni(_Phantom):
    """PHANTOM Omni: ten parameters k1..k10, with the balance spring k10."""

    l1, l2 = 0.135, 0.135
    names: tuple[str, ...] = tuple(f"k{k}" for k in range(1, 11))
    param_units: tuple[str, ...] = ("kg m^2",) * 7 + ("N m", "N m", "N m/rad")
    prior = 1e-3 * np.array(
        [1.798, 0.864, 0.486, 2.766, 0.308, 2.526, 0.652, 164.458, 94.050, 117.294]
    )
    omni = True


@numba.njit(cache=True, nogil=True)
def _row(omni: bool, q: FloatArray, v: FloatArray, a: FloatArray, y: FloatArray) -> None:
    """Regressor (3, p) of one state; what is zero for any motion is left as it is.

    M11 = pi1 + pi2 cos 2th2 + pi3 cos 2th3 + pi4 cos th2 sin th3,  M23 = -(pi4 / 2) sin(th2 - th3)
    and the Coriolis terms that follow from them; Premium and Omni share these four parameters.
    """
    s2, c2, s3, c3 = np.sin(q[1]), np.cos(q[1]), np.sin(q[2]), np.cos(q[2])
    s22, c22, s23, c23 = 2 * s2 * c2, c2 * c2 - s2 * s2, 2 * s3 * c3, c3 * c3 - s3 * s3
    sd, cd = s2 * c3 - c2 * s3, c2 * c3 + s2 * s3
    y[0, 0] = a[0]
    y[0, 1] = a[0] * c22 - 2 * v[0] * v[1] * s22
    y[0, 2] = a[0] * c23 - 2 * v[0] * v[2] * s23
    y[0, 3] = a[0] * c2 * s3 - v[0] * v[1] * s2 * s3 + v[0] * v[2] * c2 * c3
    y[1, 1] = v[0] ** 2 * s22
    y[2, 2] = v[0] ** 2 * s23
    y[1, 3] = (v[0] ** 2 * s2 * s3 + v[2] ** 2 * cd - a[2] * sd) / 2
    y[2, 3] = (-(v[0] ** 2) * c2 * c3 - v[1] ** 2 * cd - a[1] * sd) / 2
    if omni:
        # M12 = k5 sin th2,  N2 = k8 cos th2 + k10 (th2 - pi/2),  N3 = k9 sin th3
        y[0, 4], y[1, 4] = s2 * a[1] + c2 * v[1] ** 2, s2 * a[0]
        y[1, 5], y[2, 6] = a[1], a[2]
        y[1, 7], y[2, 8], y[1, 9] = c2, s3, q[1] - np.pi / 2
    else:
        # N = [0, pi7 cos th2, pi8 sin th3]
        y[1, 4], y[2, 5] = a[1], a[2]
        y[1, 6], y[2, 7] = c2, s3


@numba.njit(cache=True, nogil=True)
def _regressor(omni: bool, q: FloatArray, qd: FloatArray, qdd: FloatArray, p: int) -> FloatArray:
    """Regressor (n, 3, p) at states (n, 3)."""
    out = np.zeros((len(q), 3, p))
    for k in range(len(q)):
        _row(omni, q[k], qd[k], qdd[k], out[k])
    return out


@numba.njit(cache=True, nogil=True)
def _balance(
    omni: bool, q: FloatArray, qd: FloatArray, pi: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Effort (n, 3) without acceleration and mass matrix (n, 3, 3) of parameters pi (n, p).

    h = Y(q, qd, 0) pi,  M e_j = Y(q, 0, e_j) pi - Y(q, 0, 0) pi
    """
    n, p = pi.shape
    rest, mass = np.zeros((n, 3)), np.zeros((n, 3, 3))
    still, unit, y = np.zeros(3), np.zeros(3), np.zeros((3, p))
    hold = np.zeros(3)
    for k in range(n):
        _row(omni, q[k], qd[k], still, y)
        _times(y, pi[k], rest[k])
        _row(omni, q[k], still, still, y)
        _times(y, pi[k], hold)
        for j in range(3):
            unit[j] = 1.0
            _row(omni, q[k], still, unit, y)
            unit[j] = 0.0
            for i in range(3):
                for c in range(p):
                    mass[k, i, j] += y[i, c] * pi[k, c]
                mass[k, i, j] -= hold[i]
    return rest, mass


@numba.njit(cache=True, nogil=True)
def _times(y: FloatArray, pi: FloatArray, out: FloatArray) -> None:
    """Y pi, to out (3,)."""
    for i in range(3):
        out[i] = 0.0
        for c in range(pi.size):
            out[i] += y[i, c] * pi[c]
