"""Two arms of six joints or more coupled at their tips by forces and torques, through an incision.

The goal of the follower's tip is the leader's motion from the start, its translation scaled by s:

    p_d = p_f0 + s (p_l - p_l0),      R_d = R_l R_l0^T R_f0
    f = K (p_d - p) + D (p_d' - p'),  m = Kr e + Dr (w_d - w),  e the rotation vector of R_d R^T

The leader feels -s f and -m, times `share`, so that springs give back what they took.

With an incision the tip has four freedoms.  c is the point of the shaft at `incision_depth` behind
the tip at the start, and p_d says where the shaft points: a = r / |r|, r = p_d - c.  R_d is the
smallest turning that points the shaft along a, after the handle's turning about its own axis.  The
leader's force then holds what the springs of turning do over that lever,

    w_d = a x p_d' / |r|,   so that  -m  is felt as  -s (m x a) / |r|,

and a guide turns the handle to where the shaft points, of energy G (1 - a_l a).  With a lateral
displacement d and speed of the shaft at c, Jc its Jacobian, the efforts are

    tau = Jc^T (-Kc d - Dc d') + N^T J^T [f, m] + g(q),
    N^T = 1 - Jc^T (Jc M^-1 Jc^T + l^2 1)^-1 Jc M^-1,

so that what the tip does leaves c alone (Khatib 1987; damped as of Nakamura & Hanafusa 1986).
Near a singularity J^T asks for nothing large; joint damping rises as sqrt(det J J^T) falls.
Every force and torque has its bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from math import atan2, cos, sin, sqrt, tanh
from typing import Any

import numba as nb
import numpy as np

from hil.controllers.joint_space import EDGE, Chain, JointSpaceLaw, per_joint
from hil.errors import ConfigError
from hil.models.bodies import inverse_dynamics
from hil.models.robots import bare_robot
from hil.record.recording import RobotSource
from hil.signals.device import FloatArray
from hil.signals.settable import ArmDescription, SettableRange
from hil.teleop import gate

#: Parameters with an entry a joint.
_JOINTS = ("leader_armature", "follower_armature", "leader_friction", "follower_friction")


@dataclass(frozen=True)
class CartesianCouplingConfig:
    """Parameters of ``cartesian-coupling``.

    Parameters
    ----------
    motion_scale : float
        s, the follower's translation over the leader's.
    share : float
        Of the coupling's force and torque that the leader feels, 0 to 1.
    stiffness, damping : float
        K [N/m], D [N s/m], of the tip.
    turn_stiffness, turn_damping : float
        Kr [N m/rad], Dr [N m s/rad].
    incision_depth : float
        Length of the shaft within the body at the start [m]; 0: no incision.
    incision_stiffness, incision_damping : float
        Kc [N/m], Dc [N s/m]; 0 stiffness: the goal respects the incision, no force guards it.
    guide : float
        G [N m/rad], which turns the leader's handle to where the shaft points.
    least_depth : float
        The goal comes no closer to the incision [m].
    most_tilt : float
        Nor does it tilt the shaft further from its start [rad].
    most_force, most_torque : float
        Bounds on what the coupling does to either tip [N], [N m].
    most_incision_force : float
        Bound on what holds the shaft at the incision [N].
    singular_share, singular_damping : float
        Below that share of the start's sqrt(det J J^T), joints are damped by up to so much [N m s].
    leader_armature, follower_armature : tuple of float
        Guess at the rotors' inertia at the joints [kg m^2]; empty: nothing.
    leader_friction, follower_friction : tuple of float
        Coulomb friction that is fed forward by the measured speed [N m]; empty: none.
    velocity_filter : float
        Time constant of the first-order filter on the joint speeds [s].
    """

    motion_scale: float = 0.5
    share: float = 1.0
    stiffness: float = 1500.0
    damping: float = 15.0
    turn_stiffness: float = 12.0
    turn_damping: float = 0.2
    incision_depth: float = 0.0
    incision_stiffness: float = 3000.0
    incision_damping: float = 20.0
    guide: float = 3.0
    least_depth: float = 0.03
    most_tilt: float = 0.9
    most_force: float = 15.0
    most_torque: float = 1.5
    most_incision_force: float = 15.0
    singular_share: float = 0.3
    singular_damping: float = 1.0
    leader_armature: tuple[float, ...] = ()
    follower_armature: tuple[float, ...] = ()
    leader_friction: tuple[float, ...] = ()
    follower_friction: tuple[float, ...] = ()
    velocity_filter: float = 0.002

    def __post_init__(self) -> None:
        several = [getattr(self, name) for name in _JOINTS]
        one = {f.name: getattr(self, f.name) for f in fields(self)}
        numbers = {k: v for k, v in one.items() if not isinstance(v, tuple)}
        for name, value in numbers.items():
            if not (math.isfinite(value) and value >= 0.0):
                raise ConfigError(f"{name} = {value:g}; a number from 0 on is needed.")
        for name in ("motion_scale", "velocity_filter", "least_depth", "most_tilt"):
            if not numbers[name]:
                raise ConfigError(f"{name} = 0; it is above 0.")
        if self.share > 1.0 or self.singular_share >= 1.0:
            raise ConfigError("share is from 0 to 1, singular_share below 1.")
        if self.most_tilt > 1.4:
            raise ConfigError(f"most_tilt = {self.most_tilt:g} rad; it is at most 1.4.")
        if 0.0 < self.incision_depth <= self.least_depth:
            raise ConfigError(
                f"incision_depth = {self.incision_depth:g} m: the tip starts no deeper than "
                f"least_depth = {self.least_depth:g} m; insert it further, or lower that."
            )
        if any(value < 0.0 or not math.isfinite(value) for row in several for value in row):
            raise ConfigError(f"{', '.join(_JOINTS)} are from 0 on.")

    def settable(self) -> dict[str, SettableRange]:
        """What an operator may set: nothing of the geometry, which would jump."""
        return {
            "share": SettableRange(0.0, 1.0),
            "stiffness": SettableRange(0.0, 3000.0, "N/m"),
            "turn_stiffness": SettableRange(0.0, 15.0, "N m/rad"),
            "guide": SettableRange(0.0, 5.0, "N m/rad"),
        }


#: Parameters as the kernels take them: numbers of the config by name, then what is made of them.
_NAMES = tuple(
    f.name for f in fields(CartesianCouplingConfig) if f.name not in (*_JOINTS, "velocity_filter")
)
_P = np.dtype([(name, np.float64) for name in (*_NAMES, "filter")])
#: State before the filtered speeds: started, then place (3) and turning (9) of both tips' start.
_FIRST = 25
#: What of a tick stands last in the state.
_SHOWN = (
    *(f"{what}.{axis}" for what in ("error", "turn_error", "lateral") for axis in "xyz"),
    "inside",
    *(f"{arm}.{what}{axis}" for arm in ("leader", "follower") for what in "ft" for axis in "xyz"),
)
_LAMBDA2 = 1e-3


@nb.njit(cache=True, nogil=True)
def cross(a: Any, b: Any, out: Any) -> None:
    """A x b into `out` (3,)."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@nb.njit(cache=True, nogil=True)
def times(a: Any, b: Any, out: Any) -> None:
    """A b into `out` (3, 3), which is neither."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@nb.njit(cache=True, nogil=True)
def times_back(a: Any, b: Any, out: Any) -> None:
    """A b^T into `out` (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@nb.njit(cache=True, nogil=True)
def dot(a: Any, b: Any) -> float:
    """Of two vectors (3,)."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@nb.njit(cache=True, nogil=True)
def turn_by(axis: Any, angle: float, out: Any) -> None:
    """Rotation about a unit vector into `out` (3, 3); Rodrigues."""
    s, u = sin(angle), 1.0 - cos(angle)
    x, y, z = axis[0], axis[1], axis[2]
    for i in range(3):
        for j in range(3):
            out[i, j] = u * axis[i] * axis[j]
        out[i, i] += 1.0 - u
    out[0, 1], out[1, 0] = out[0, 1] - s * z, out[1, 0] + s * z
    out[0, 2], out[2, 0] = out[0, 2] + s * y, out[2, 0] - s * y
    out[1, 2], out[2, 1] = out[1, 2] - s * x, out[2, 1] + s * x


@nb.njit(cache=True, nogil=True)
def _quaternion(r: Any, out: Any) -> None:
    """Unit quaternion [w, x, y, z], w >= 0, of a rotation; from its largest entry on (Shepperd)."""
    best, top = 0, r[0, 0] + r[1, 1] + r[2, 2]
    for i in range(3):
        if r[i, i] > top:
            best, top = i + 1, r[i, i]
    if best == 0:
        out[0] = sqrt(max(1.0 + top, 0.0)) / 2.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            out[1 + i] = (r[k, j] - r[j, k]) / (4.0 * out[0])
    else:
        i, j, k = best - 1, best % 3, (best + 1) % 3
        out[best] = sqrt(max(1.0 + r[i, i] - r[j, j] - r[k, k], 0.0)) / 2.0
        out[0] = (r[k, j] - r[j, k]) / (4.0 * out[best])
        out[1 + j] = (r[j, i] + r[i, j]) / (4.0 * out[best])
        out[1 + k] = (r[k, i] + r[i, k]) / (4.0 * out[best])
    if out[0] < 0.0:
        for i in range(4):
            out[i] = -out[i]


@nb.njit(cache=True, nogil=True)
def rotation_vector(r: Any, four: Any, out: Any) -> None:
    """Rotation vector [rad] of a rotation into `out` (3,); `four` (4,) is scratch."""
    _quaternion(r, four)
    size = sqrt(four[1] ** 2 + four[2] ** 2 + four[3] ** 2)
    factor = 2.0 if size < 1e-9 else 2.0 * atan2(size, four[0]) / size
    for i in range(3):
        out[i] = factor * four[1 + i]


@nb.njit(cache=True, nogil=True)
def bound(v: Any, most: float) -> None:
    """Shorten `v` (3,) to `most`."""
    size = sqrt(dot(v, v))
    if size > most:
        for i in range(3):
            v[i] *= most / size


@nb.njit(cache=True, nogil=True)
def tip_of(arm: Any, q: Any, place: Any, turn: Any, jacobian: Any, gravity: Any, s: Any) -> None:
    """Place (3,), axes (3, 3) and Jacobian (6, d) of the tip in base axes, and g(q) (d,).

    Parameters
    ----------
    arm : tuple
        The chain, its room, zeros (d,), and place and axes of the tip in the last body.
    s : ndarray (d + 1, 3, 3)
        Scratch.
    """
    chain, room, none, tip_place, tip_turn = arm
    a, b, c, axis, e, f = chain
    inverse_dynamics(a, b, c, axis, e, f, q, none, none, room, gravity)
    # poses of all joints within their parents' frames are left in the room
    local, step, d = room[3], room[4], q.size
    for n in range(d):
        if n == 0:
            s[0, :, :] = local[0]
            for i in range(3):
                jacobian[i, 0] = step[0, i]
        else:
            times(s[n - 1], local[n], s[n])
            for i in range(3):
                jacobian[i, n] = jacobian[i, n - 1] + dot(s[n - 1, i], step[n])
    for i in range(3):
        place[i] = jacobian[i, d - 1] + dot(s[d - 1, i], tip_place)
    times(s[d - 1], tip_turn, turn)
    lever, moved, spin = s[d, 0], s[d, 1], s[d, 2]
    for n in range(d):
        for i in range(3):
            # from the joint to the tip
            lever[i] = place[i] - jacobian[i, n]
            spin[i] = jacobian[3 + i, n] = dot(s[n, i], axis[n, 3:])
        cross(spin, lever, moved)
        for i in range(3):
            jacobian[i, n] = moved[i] + dot(s[n, i], axis[n, :3])


@nb.njit(cache=True, nogil=True)
def factor(m: Any, out: Any) -> float:
    """Cholesky factor of `m` (n, n) into `out`; product of its diagonal, 0 if it has none."""
    whole = 1.0
    for i in range(m.shape[0]):
        for j in range(i + 1):
            total = m[i, j]
            for k in range(j):
                total -= out[i, k] * out[j, k]
            if i == j:
                if total <= 0.0:
                    return 0.0
                out[i, i] = sqrt(total)
                whole *= out[i, i]
            else:
                out[i, j] = total / out[j, j]
    return float(whole)


@nb.njit(cache=True, nogil=True)
def _solved(low: Any, v: Any) -> None:
    """Solve L L^T x = v in place, v (n,)."""
    n = v.size
    for i in range(n):
        for k in range(i):
            v[i] -= low[i, k] * v[k]
        v[i] /= low[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            v[i] -= low[k, i] * v[k]
        v[i] /= low[i, i]


@nb.njit(cache=True, nogil=True)
def reach(jacobian: Any, square: Any, low: Any) -> float:
    """Sqrt(det J J^T); `square`, `low` (6, 6) are scratch."""
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(jacobian.shape[1]):
                total += jacobian[i, k] * jacobian[j, k]
            square[i, j] = square[j, i] = total
    return factor(square, low)


@nb.njit(cache=True, nogil=True)
def through(p: Any, start: Any, place: Any, turn: Any, w: Any, m: Any) -> float:
    """Make a goal go through the incision; its distance from there [m].

    Parameters
    ----------
    start : ndarray (24,)
        Place and axes of both tips at the start, the leader's first.
    place : ndarray (3,)
        Goal of the tip; moved where it is too close to the incision or tilts too far.
    turn : ndarray (3, 3)
        Turning of the handle from its start; then the goal's.
    w : ndarray (8, 3)
        Scratch; written: the incision, a, the shaft's start, the handle's axis in rows 0 to 3.
    m : ndarray (2, 3, 3)
        Scratch.
    """
    c, a, a0, own, axis, four = w[0], w[1], w[2], w[3], w[4], w[5:7].reshape(6)
    along = 0.0
    for i in range(3):
        a0[i] = start[15 + 3 * i + 2]
    for i in range(3):
        own[i] = dot(turn[i], a0)
        c[i] = start[12 + i] - p.incision_depth * a0[i]
        a[i] = place[i] - c[i]
        along += a[i] * a0[i]
    long = max(sqrt(dot(a, a)), p.least_depth)
    cross(a0, a, axis)
    across = sqrt(dot(axis, axis))
    for i in range(3):
        axis[i] /= max(across, 1e-12)
    turn_by(axis, min(atan2(across, along), p.most_tilt), m[0])
    # of the handle's turning, what is about its own axis
    _quaternion(turn, four)
    turn_by(a0, 2.0 * atan2(dot(four[1:4], a0), four[0]), m[1])
    times(m[0], m[1], turn)
    for i in range(3):
        a[i] = dot(m[0, i], a0)
    for i in range(3):
        place[i] = c[i] + long * a[i]
    return float(long)


@nb.njit(cache=True, nogil=True)
def off_line(c: Any, place: Any, axes: Any, lateral: Any) -> float:
    """Displacement (3,) of the shaft from point c [m]; where along it, from the tip on [m]."""
    at = 0.0
    for i in range(3):
        at += axes[i, 2] * (c[i] - place[i])
    for i in range(3):
        lateral[i] = place[i] + at * axes[i, 2] - c[i]
    return float(at)


@nb.njit(cache=True, nogil=True)
def guard(
    p: Any, at: float, lateral: Any, axes: Any, jac: Any, v: Any, mass: Any, low: Any, w: Any,
    tau: Any,
) -> None:  # fmt: skip
    """Project `tau` (d,) so that it leaves the incision alone, and add what holds the shaft there.

    Parameters
    ----------
    at, lateral : float, ndarray (3,)
        From `off_line`.
    axes, jac, v : ndarray (3, 3), (6, d), (d,)
        Axes and Jacobian of the tip, joint speeds.
    mass, low, w : ndarray (d, d), (d, d), (4, d)
        Mass matrix, and scratch.
    """
    d = tau.size
    rows, back = w[0:2], w[2:4]
    if factor(mass, low) <= 0.0:
        return
    for j in range(2):
        for k in range(d):
            rows[j, k] = 0.0
            for i in range(3):
                i1, i2 = (i + 1) % 3, (i + 2) % 3
                # v + w x (at a)
                lever = jac[3 + i1, k] * axes[i2, 2] - jac[3 + i2, k] * axes[i1, 2]
                rows[j, k] += axes[i, j] * (jac[i, k] + at * lever)
            back[j, k] = rows[j, k]
        _solved(low, back[j])
    # Jc M^-1 Jc^T + l^2, Jc M^-1 tau, place and speed across
    xx, xy, yy, tx, ty, ex, ey, vx, vy = _LAMBDA2, 0.0, _LAMBDA2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(d):
        xx += rows[0, k] * back[0, k]
        xy += rows[0, k] * back[1, k]
        yy += rows[1, k] * back[1, k]
        tx += back[0, k] * tau[k]
        ty += back[1, k] * tau[k]
        vx += rows[0, k] * v[k]
        vy += rows[1, k] * v[k]
    for i in range(3):
        ex += axes[i, 0] * lateral[i]
        ey += axes[i, 1] * lateral[i]
    fx = -p.incision_stiffness * ex - p.incision_damping * vx
    fy = -p.incision_stiffness * ey - p.incision_damping * vy
    size = sqrt(fx * fx + fy * fy)
    if size > p.most_incision_force:
        fx *= p.most_incision_force / size
        fy *= p.most_incision_force / size
    whole = xx * yy - xy * xy
    fx -= (yy * tx - xy * ty) / whole
    fy -= (xx * ty - xy * tx) / whole
    for k in range(d):
        tau[k] += rows[0, k] * fx + rows[1, k] * fy


@nb.njit(cache=True, nogil=True)
def inertia(arm: Any, q: Any, rotors: Any, mass: Any, unit: Any, still: Any) -> None:
    """Mass matrix (d, d) at `q`, row by row; `unit` (d,) is scratch, `still` (3,) zeros."""
    chain, room, none, _, _ = arm
    a, b, c, e, _, f = chain
    for k in range(q.size):
        for i in range(q.size):
            unit[i] = 1.0 if i == k else 0.0
        inverse_dynamics(a, b, c, e, still, f, q, none, unit, room, mass[k])
        mass[k, k] += rotors[k]


@nb.njit(cache=True, nogil=True)
def begin(p: Any, u: Any, x: Any, r: Any, x_next: Any) -> None:
    """Start's places and axes, and filtered speeds, into `x_next`; twists of both tips."""
    d = r.grav.shape[1]
    x_next[0] = 1.0
    for a in range(2):
        for i in range(3):
            n = 1 + 12 * a + i
            x_next[n] = x[n] if x[0] > 0.0 else r.place[a, i]
            for j in range(3):
                n = 4 + 12 * a + 3 * i + j
                x_next[n] = x[n] if x[0] > 0.0 else r.turn[a, i, j]
        for i in range(d):
            n = _FIRST + a * d + i
            before = x[n] if x[0] > 0.0 else u[a, d + i]
            x_next[n] = before + p.filter * (u[a, d + i] - before)
        for i in range(6):
            r.twist[a, i] = 0.0
            for k in range(d):
                r.twist[a, i] += r.jac[a, i, k] * x_next[_FIRST + a * d + k]


@nb.njit(cache=True, nogil=True)
def couple(p: Any, start: Any, r: Any) -> None:
    """Forces and torques of the coupling at both tips, into `r.wrench` (2, 6)."""
    v, m, wrench, s = r.v, r.m, r.wrench, p.motion_scale
    raw, goal, e, turned, spin, shown = v[8], v[9], v[10], v[11], v[12], r.shown
    linear, angular = r.twist[:, :3], r.twist[:, 3:]
    # turning of the handle from its start: R_l R_l0^T
    times_back(r.turn[0], start[3:12].reshape(3, 3), m[2])
    for i in range(3):
        raw[i] = goal[i] = start[12 + i] + s * (r.place[0, i] - start[i])
        spin[i] = angular[0, i]
    long, c, a, own = 0.0, v[0], v[1], v[3]
    if p.incision_depth > 0.0:
        long = through(p, start, goal, m[2], v, m[0:2])
        roll = dot(angular[0], own)
        cross(a, linear[0], spin)
        for i in range(3):
            spin[i] = s * spin[i] / long + roll * a[i]
    times(m[2], start[15:24].reshape(3, 3), m[3])
    times_back(m[3], r.turn[1], m[4])
    rotation_vector(m[4], v[13:15].reshape(6), turned)
    force, torque = wrench[1, :3], wrench[1, 3:]
    for i in range(3):
        e[i] = goal[i] - r.place[1, i]
        force[i] = p.stiffness * e[i] + p.damping * (s * linear[0, i] - linear[1, i])
        torque[i] = p.turn_stiffness * turned[i] + p.turn_damping * (spin[i] - angular[1, i])
    bound(force, p.most_force)
    bound(torque, p.most_torque)
    felt, twisted = wrench[0, :3], wrench[0, 3:]
    for i in range(3):
        felt[i] = -p.share * s * (force[i] + p.stiffness * (raw[i] - goal[i]))
        twisted[i] = -p.share * torque[i]
        shown[i], shown[3 + i] = e[i], turned[i]
    if long > 0.0:
        guided, lever, other = v[13], v[14], v[15]
        cross(own, a, guided)
        about, along = dot(torque, a), dot(spin, a)
        rolled = dot(angular[0], own)
        for i in range(3):
            handle, wanted = angular[0, i] - rolled * own[i], spin[i] - along * a[i]
            guided[i] = p.guide * guided[i] - p.turn_damping * (handle - wanted)
            other[i] = p.share * torque[i] + guided[i]
        cross(other, a, lever)
        for i in range(3):
            felt[i] -= s * lever[i] / long
            twisted[i] = guided[i] - p.share * about * own[i]
        r.at[0] = off_line(c, r.place[1], r.turn[1], shown[6:9])
        shown[9] = -r.at[0]
    bound(felt, p.most_force)
    bound(twisted, p.most_torque)


@nb.njit(cache=True, nogil=True)
def drive(p: Any, a: int, v: Any, r: Any, tau: Any) -> None:
    """J^T [f, m] into `tau` (d,)."""
    for k in range(tau.size):
        tau[k] = 0.0
        for i in range(6):
            tau[k] += r.jac[a, i, k] * r.wrench[a, i]


@nb.njit(cache=True, nogil=True)
def settle(p: Any, a: int, v: Any, r: Any, tau: Any) -> None:
    """Add weight, friction and the damping near a singularity to `tau` (d,)."""
    near = reach(r.jac[a], r.six[0], r.six[1]) / max(r.reach[a], 1e-12)
    damp = 0.0
    if near < p.singular_share:
        damp = p.singular_damping * (1.0 - near / p.singular_share) ** 2
    for k in range(tau.size):
        tau[k] += r.grav[a, k] + r.rub[a, k] * tanh(v[k] / EDGE) - damp * v[k]


@nb.njit(cache=True, nogil=True)
def law(p: Any, arms: Any, u: Any, x: Any, r: Any, x_next: Any, y: Any) -> None:
    """Efforts of both arms into `y` (2, d); see the module."""
    d = y.shape[1]
    for a in range(2):
        tip_of(arms[a], u[a, :d], r.place[a], r.turn[a], r.jac[a], r.grav[a], r.s)
    begin(p, u, x, r, x_next)
    r.shown[:] = 0.0
    couple(p, x_next[1:_FIRST], r)
    for a in range(2):
        v = x_next[_FIRST + a * d : _FIRST + (a + 1) * d]
        drive(p, a, v, r, y[a])
        if a == 1 and p.incision_depth > 0.0 and p.incision_stiffness > 0.0:
            inertia(arms[1], u[1, :d], r.rotors, r.mass, r.unit, r.still)
            guard(p, r.at[0], r.shown[6:9], r.turn[1], r.jac[1], v, r.mass, r.low, r.w, y[1])
        settle(p, a, v, r, y[a])
    last = x_next[_FIRST + 2 * d :]
    for i in range(10):
        last[i] = r.shown[i]
    for a in range(2):
        for i in range(6):
            last[10 + 6 * a + i] = r.wrench[a, i]


@nb.njit(cache=True, nogil=True)
def _tick(p: Any, arms: Any, u: Any, x: Any, r: Any, x_next: Any, y: Any) -> None:
    """`law` with its records as arrays of one, for which no object is made at a call."""
    law(p[0], arms, u, x, r[0], x_next, y)


class _Tip:
    """An arm for `tip_of`: its chain, and where the tip is in its last body."""

    def __init__(self, arm: ArmDescription, rotors: FloatArray) -> None:
        chain = Chain(arm)
        d = arm.d
        if d < 6 or tuple(chain.known[0]) != tuple(range(-1, d - 1)):
            raise ConfigError(
                f"cartesian-coupling moves a tip in six freedoms: six joints or more in a row are "
                f"needed, and this arm has {d}; take joint-coupling for other arms."
            )
        robot = bare_robot(RobotSource("", arm.urdf))
        zero, at = np.zeros(d), np.zeros((3,))
        turn, jac, grav = np.zeros((3, 3)), np.zeros((6, d)), np.zeros(d)
        scratch = np.zeros((d + 1, 3, 3))
        bare = (chain.known, chain.room, zero, np.zeros(3), np.eye(3))
        tip_of(bare, zero, at, turn, jac, grav, scratch)
        tip, axes = robot.tip(zero[None]), robot.tip_axes(zero[None])
        if tip is None or axes is None:
            raise ConfigError("cartesian-coupling needs the frame 'tip' in the arm's URDF.")
        self.known = (
            chain.known,
            chain.room,
            zero,
            np.ascontiguousarray(turn.T @ (tip[0] - at)),
            np.ascontiguousarray(turn.T @ axes[0]),
        )
        middle, mass = np.array(arm.center), np.zeros((d, d))
        tip_of(self.known, middle, at, turn, jac, grav, scratch)
        self.reach = reach(jac, np.zeros((6, 6)), np.zeros((6, 6)))
        inertia(self.known, middle, rotors, mass, np.zeros(d), np.zeros(3))
        self._jac, self._mass, self._shaft = jac, mass, turn[:, 2].copy()

    def mobility(self, behind: float = 0.0) -> tuple[float, float]:
        """Largest 1 / mass [1/kg] of the shaft `behind` [m] the tip, 1 / inertia of turning."""
        lever = np.cross(self._jac[3:], -behind * self._shaft, axis=0)
        rows = (self._jac[:3] + lever, self._jac[3:])
        x, y = (np.linalg.eigvalsh(j @ np.linalg.solve(self._mass, j.T))[-1] for j in rows)
        return float(x), float(y)


class CartesianCoupling:
    """The law with its parameters; see `law`.

    Parameters
    ----------
    config : CartesianCouplingConfig
        Parameters.
    arms : tuple of str
        Leader and follower.
    period : float
        Of the loop [s].
    robots : tuple of ArmDescription
        What the arms are.
    judged : bool
        Whether it is refused where it is unstable over the set of `hil.teleop.gate`.

    Raises
    ------
    ConfigError
        If the law must not run.
    """

    def __init__(
        self,
        config: CartesianCouplingConfig,
        arms: tuple[str, ...],
        period: float,
        robots: tuple[ArmDescription, ...],
        judged: bool = True,
    ) -> None:
        if len(arms) != 2:
            raise ConfigError(f"cartesian-coupling ties two arms to each other, not {len(arms)}.")
        self.config, d = config, robots[0].d
        rotors = [per_joint(getattr(config, name), d, name) for name in _JOINTS[:2]]
        tips = [_Tip(robot, own) for robot, own in zip(robots, rotors, strict=True)]
        _bear(config, arms, tips, config.velocity_filter + 1.5 * period)
        if judged:
            gate.refuse_coupled(
                margin(config, arms, period, robots, gate.USUAL_DELAY_TICKS), period
            )
        self._arms = (tips[0].known, tips[1].known)
        known, room = np.zeros(1, _P), np.zeros(1, _room(d))
        for name in _NAMES:
            known[name] = getattr(config, name)
        known["filter"] = 1.0 - math.exp(-period / config.velocity_filter)
        room["reach"] = [tip.reach for tip in tips]
        room["rotors"] = rotors[1]
        room["rub"] = [per_joint(getattr(config, name), d, name) for name in _JOINTS[2:]]
        self._known, self._room = known, room
        places = [
            f"{arm}.start_{what}"
            for arm in arms
            for what in (*"xyz", *(f"{i}{j}" for i in "xyz" for j in "xyz"))
        ]
        speeds = [f"{arm}.speed{i + 1}" for arm in arms for i in range(d)]
        self.state_names = ("started", *places, *speeds, *_SHOWN)

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`."""
        _tick(self._known, self._arms, u, x, self._room, x_next, y)


#: What damping times mobility times the delay of the loop may come to: half of what makes a body
#: without friction unstable (a lag of the filter and a delay of a tick and a half).
_MOST_LAG = 1.3


def _bear(
    config: CartesianCouplingConfig, arms: tuple[str, ...], tips: list[_Tip], lag: float
) -> None:
    """Refuse dampings and stiffnesses that the loop is too slow for, arm by arm.

    Raises
    ------
    ConfigError
        Names the parameter, and what would do.
    """
    rows = []
    for arm, tip in zip(arms, tips, strict=True):
        across, turning = tip.mobility()
        rows.append((arm, "", config.stiffness, config.damping, across, "N s/m"))
        rows.append(
            (arm, "turn_", config.turn_stiffness, config.turn_damping, turning, "N m s/rad")
        )
    if config.incision_depth and config.incision_stiffness:
        k, b = config.incision_stiffness, config.incision_damping
        at = tips[1].mobility(config.incision_depth)[0]
        rows.append((arms[1], "incision_", k, b, at, "N s/m"))
    for arm, name, k, b, mobility, unit in rows:
        least, most = lag * k, _MOST_LAG / (lag * mobility)
        if least > most:
            raise ConfigError(
                f"{name}stiffness = {k:g} is too stiff for the {arm} at this rate: up to "
                f"{most / lag:.3g} can be damped; lower it, velocity_filter, or raise rate_hz."
            )
        if not least <= b <= most:
            raise ConfigError(
                f"{name}damping = {b:g} {unit} does not damp {name}stiffness = {k:g} at the {arm} "
                f"at this rate; {least:.3g} to {most:.3g} {unit} does."
            )


def margin(
    config: CartesianCouplingConfig,
    arms: tuple[str, ...],
    period: float,
    robots: tuple[ArmDescription, ...],
    latest: float = gate.LONGEST_DELAY_TICKS,
) -> gate.CoupledMargin:
    """How the law stands over the set of `hil.teleop.gate.coupled`.

    Parameters
    ----------
    config, arms, period, robots
        As of `CartesianCoupling`.
    latest : float
        Longest delay that is tried [ticks].
    """
    return _margin(replace(config, **_BARE), arms, period, robots, latest)


#: Friction that is fed forward counts neither way: the arms are judged without any.
_BARE: dict[str, Any] = {"leader_friction": (), "follower_friction": ()}


@lru_cache(maxsize=16)
def _margin(
    config: CartesianCouplingConfig,
    arms: tuple[str, ...],
    period: float,
    robots: tuple[ArmDescription, ...],
    latest: float,
) -> gate.CoupledMargin:
    """As `margin`, for a law that feeds no friction forward."""
    law, d = CartesianCoupling(config, arms, period, robots, judged=False), robots[0].d
    rotors = [per_joint(getattr(config, name), d, name) for name in _JOINTS[:2]]
    return gate.coupled(law, robots, rotors, period, config.incision_depth, latest)


def _room(d: int) -> np.dtype[Any]:
    """Scratch of `law` for two arms of d joints, and what of them is known."""
    f = np.float64
    shapes = {
        "place": (2, 3), "turn": (2, 3, 3), "jac": (2, 6, d), "grav": (2, d), "twist": (2, 6),
        "wrench": (2, 6), "s": (d + 1, 3, 3), "v": (16, 3), "m": (5, 3, 3), "six": (2, 6, 6),
        "mass": (d, d), "low": (d, d), "w": (4, d), "unit": (d,), "still": (3,), "at": (1,),
        "shown": (10,), "rotors": (d,), "rub": (2, d), "reach": (2,),
    }  # fmt: skip
    return np.dtype([(name, f, shape) for name, shape in shapes.items()])


CARTESIAN_COUPLING = JointSpaceLaw(CartesianCouplingConfig, CartesianCoupling, margin=margin)

__all__ = ["CARTESIAN_COUPLING", "CartesianCoupling", "CartesianCouplingConfig", "margin"]
