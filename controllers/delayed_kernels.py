"""Kernels of the law over a channel with delay: what each side commands, and the energy it counts.

Per axis of the workspace; `T` is the period, `f` the force of the coupling ON the tip it acts on,
`W` the energy that a side may still give out.  Every packet carries sums, not increments, so that
a lost packet loses nothing and a late one adds nothing: both ends count what the other has sent.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numba as nb

from hil.controllers import geometry

#: Of an axis of an arm, in the state: where it started; the follower's goal; energies into and out
#: of the channel; sums of what is sent and of what of the other's is used; tank; force; local
#: stiffness and force at the start of the environment, the three numbers of their covariance, the
#: direction of the contact; place at the last tick.
ORIGIN, GOAL, INTO, OUT, SENT, SENT_POWER, USED, USED_POWER = 0, 1, 2, 3, 4, 5, 6, 7
TANK, FORCE, STIFFNESS, PUSH, P11, P12, P22, TOUCH, LAST = 8, 9, 10, 11, 12, 13, 14, 15, 16
FIELDS = 17
#: Variance of a force sensor's noise [N^2], and speed from which the tip moves [m/s].
NOISE, MOVES = 2.5e-3, 2e-3
#: Stiffness in units of the expected one below which there is no wall, and how a packet says so.
SOFTEST, NO_WALL = 0.3, 2.0
#: The state before the axes: started, tick of the start.
HEAD = 2
#: Of a packet, per axis: position, speed, force, sum sent, sum of its square, energy put into the
#: channel, stiffness, force at the start, direction of the contact.
X, V, F, SUM, POWER, ENERGY, K, C, SIDE = 0, 1, 2, 3, 4, 5, 6, 7, 8
PACKET = 9
PASSIVITY, WAVES, TANKS, MODEL = 0, 1, 2, 3


@nb.njit(cache=True, nogil=True)
def drive(goal: float, rate: float, x: float, v: float, p: Any) -> float:
    """Force of the follower's spring and damper: f = K (goal - x) + B (rate - v)."""
    return float(p.stiffness * (goal - x) + p.damping * (rate - v))


@nb.njit(cache=True, nogil=True)
def allowed(room: float, reserve: float) -> float:
    """Share of a force that the energy left allows: 1 from the reserve on, 0 where none is left.

    It fades with the energy, not with the sign of a noisy speed: the force stays continuous.
    """
    return min(max(room / reserve, 0.0), 1.0)


@nb.njit(cache=True, nogil=True)
def observed(a: int, x: float, v: float, h: Any, s: Any, n: Any, p: Any) -> float:
    """Passivity observer and controller of one side.

    Leader    E_out(k) = sum max(f(k-1) (x(k) - x(k-1)), 0) <= E_in,follower(k - delay) + reserve
    Follower  the same for the steps of its goal.  The goal follows the leader's place, not its
              speed, so that what is withheld is made up for as energy arrives.
    """
    if a == 0:
        work = s[FORCE] * (x - s[LAST])
        n[OUT], n[INTO] = s[OUT] + max(work, 0.0), s[INTO] + max(-work, 0.0)
        return float(-h[F] * allowed(h[ENERGY] + p.reserve - n[OUT], p.reserve))
    step, rate = h[X] - s[GOAL], h[V]
    f = drive(s[GOAL], rate, x, v, p)
    if f * step > 0.0:
        part = allowed(h[ENERGY] + p.reserve - s[OUT], p.reserve)
        step, rate = part * step, part * rate
        f = drive(s[GOAL] + step, rate, x, v, p)
    work = f * step
    n[OUT], n[INTO] = s[OUT] + max(work, 0.0), s[INTO] + max(-work, 0.0)
    n[GOAL] = s[GOAL] + step
    return f


@nb.njit(cache=True, nogil=True)
def arrived(h: Any, s: Any, n: Any, p: Any) -> float:
    """Wave out of the channel: all that has arrived, as far as its energy allows.

    u = (sum sent - sum used) / smooth,  T sum u^2 <= what was sent, for any jitter and loss: what
    arrives at once after a gap is given out within `smooth` seconds.
    """
    wave = (h[SUM] - s[USED]) / max(p.smooth, p.period)
    room = max((h[POWER] - s[USED_POWER]) / p.period, 0.0)
    if wave * wave > room:
        wave = sqrt(room) if wave > 0.0 else -sqrt(room)
    n[USED] = s[USED] + wave * p.period
    n[USED_POWER] = s[USED_POWER] + wave * wave * p.period
    return float(wave)


@nb.njit(cache=True, nogil=True)
def waved(a: int, x: float, v: float, h: Any, s: Any, n: Any, p: Any) -> float:
    """Wave variables of one side; b is the impedance of the waves [N s/m].

    Leader    u = sqrt(2 b) v - w,  f = sqrt(2 b) w - b v
    Follower  sqrt(2 b) u = b v_d + f_d,  w = u - sqrt(2/b) f_d,  f_d = K (x_d - x) + B (v_d - v)
    """
    b, root = p.wave, sqrt(2.0 * p.wave)
    wave = arrived(h, s, n, p)
    if a == 0:
        f, back = root * wave - b * v, root * v - wave
    else:
        rate = (root * wave - p.stiffness * (s[GOAL] - x) + p.damping * v) / (b + p.damping)
        f = drive(s[GOAL], rate, x, v, p)
        n[GOAL] = s[GOAL] + rate * p.period
        back = wave - sqrt(2.0 / b) * f
    n[SENT] = s[SENT] + back * p.period
    n[SENT_POWER] = s[SENT_POWER] + back * back * p.period
    return float(f)


@nb.njit(cache=True, nogil=True)
def tanked(a: int, x: float, v: float, h: Any, s: Any, n: Any, p: Any) -> float:
    """Energy tank of one side: what moves the arm is taken from it, what brakes the arm fills it.

    Each side hands a share of its tank to the other; the leader brakes a little while its tank is
    below the level that is wanted.
    """
    tank = s[TANK] + h[SUM] - s[USED] - s[FORCE] * (x - s[LAST])
    n[USED] = h[SUM]
    f = -h[F] if a == 0 else drive(h[X], h[V], x, v, p)
    f *= allowed(tank, 0.5 * p.level)
    if a == 0 and tank < p.level:
        f -= p.fill * (p.level - max(tank, 0.0)) * v
    share = max(min(p.share * p.period, 1.0) * tank, 0.0)
    # what is more is given away: a full tank is a licence to be unstable for long
    n[TANK] = min(tank - share, p.level)
    n[SENT] = s[SENT] + share
    return float(f)


@nb.njit(cache=True, nogil=True)
def learn(x: float, v: float, force: float, s: Any, n: Any, p: Any) -> None:
    """Environment of the follower by recursive least squares with forgetting: f = c - k x.

    Only in contact, and only while it moves.  A contact begins anew, from a surface where the
    force was first felt, so that one wall is not the last one.
    """
    if abs(force) < p.touch:
        n[TOUCH] = 0.0
        return
    if s[TOUCH] == 0.0:
        n[STIFFNESS], n[PUSH] = p.expected, force + p.expected * x
        # of a prior as wide as the stiffness, over the sensor's noise
        n[P11], n[P12], n[P22] = p.expected**2 / NOISE, 0.0, 0.1 / NOISE
    n[TOUCH] = 1.0 if force > 0.0 else -1.0
    if abs(v) < MOVES:
        return
    # r = (-x, 1):  g = P r / (lambda + r' P r),  theta += g (f - r' theta),  P = (P - g r' P) / l
    a, b, c = n[P11], n[P12], n[P22]
    r1, r2 = -x * a + b, -x * b + c
    scale = p.forget + (-x * r1 + r2)
    miss = force - (n[PUSH] - n[STIFFNESS] * x)
    n[STIFFNESS] += r1 / scale * miss
    n[PUSH] += r2 / scale * miss
    # without forgetting where that would let the covariance grow beyond the prior's
    keep = p.forget if a < p.expected**2 / NOISE and c < 0.1 / NOISE else 1.0
    n[P11] = (a - r1 * r1 / scale) / keep
    n[P12] = (b - r1 * r2 / scale) / keep
    n[P22] = (c - r2 * r2 / scale) / keep


@nb.njit(cache=True, nogil=True)
def modelled(a: int, x: float, v: float, force: float, h: Any, s: Any, n: Any, p: Any) -> float:
    """Model-mediated: the leader feels the environment's model at once, the follower follows.

    The model changes at the leader within `blend` seconds, where that gives it no energy.
    """
    if a == 1:
        learn(x, v, force, s, n, p)
        return drive(h[X], h[V], x, v, p)
    if h[SIDE] == NO_WALL:
        n[STIFFNESS] = s[STIFFNESS] * (1.0 - p.period / p.blend)
    elif h[SIDE] != 0.0:
        known, stiffness, surface = n[TOUCH] != 0.0, min(h[K], p.stiffest), h[C] / h[K]
        part = p.period / p.blend if known else 1.0
        n[STIFFNESS] = s[STIFFNESS] + part * (stiffness - s[STIFFNESS])
        n[PUSH] = s[PUSH] + part * (surface - s[PUSH])
        n[TOUCH] = h[SIDE]
    f = n[STIFFNESS] * (n[PUSH] - x)
    if f * n[TOUCH] <= 0.0:
        return 0.0
    f -= p.brake * v
    return float(f) if f * n[TOUCH] > 0.0 else 0.0


@nb.njit(cache=True, nogil=True)
def side(a: int, i: int, u: Any, heard: Any, s: Any, n: Any, p: Any, w: Any) -> float:
    """Force that arm `a` gets along axis `i`."""
    x, v, h = w.place[a, i], w.speed[a, i], heard[i]
    if p.scheme == PASSIVITY:
        return observed(a, x, v, h, s, n, p)
    if p.scheme == WAVES:
        return waved(a, x, v, h, s, n, p)
    if p.scheme == TANKS:
        return tanked(a, x, v, h, s, n, p)
    return modelled(a, x, v, u[a, 6 + i], h, s, n, p)


@nb.njit(cache=True, nogil=True)
def fixture(p: Any, w: Any) -> None:
    """Wall that the leader must not pass: f = n (K d - B n v) where its depth d is positive."""
    depth, speed = -p.wall_place, 0.0
    for i in range(3):
        depth -= p.wall_normal[i] * w.place[0, i]
        speed += p.wall_normal[i] * w.speed[0, i]
    if depth <= 0.0 or p.wall_stiffness == 0.0:
        return
    push = max(p.wall_stiffness * depth - p.wall_damping * speed, 0.0)
    for i in range(3):
        w.force[0, i] += p.wall_normal[i] * push


@nb.njit(cache=True, nogil=True)
def law(
    tick: int,
    x: Any,
    u: Any,
    p: Any,
    line: Any,
    ages: Any,
    w: Any,
    x_next: Any,
    y: Any,
) -> None:
    """One period of `hil.controllers.delayed.Delayed`.

    Parameters
    ----------
    tick : int
        Number of the tick, from 1.
    x, x_next : ndarray (HEAD + 6 FIELDS,)
        State: started, tick of the start, then the fields of every axis of leader and follower.
    u : ndarray (2, 12)
        Leader, follower.
    line : ndarray (2, length, 3, PACKET)
        What each arm has sent; slot tick % length.
    ages : ndarray (2, CYCLE)
        Age in ticks of what leader and follower act on.
    """
    x_next[0] = 1.0
    x_next[1] = x[1] if x[0] > 0.0 else tick
    for a in range(2):
        geometry.forward(u[a], p.lengths, w.place[a])
        geometry.jacobian(u[a], p.lengths, w.jacobian[a])
        for i in range(3):
            at = HEAD + FIELDS * (3 * a + i)
            x_next[at : at + FIELDS] = x[at : at + FIELDS]
            if x[0] == 0.0:
                x_next[at + ORIGIN] = w.place[a, i]
                x_next[at + TANK] = p.level
            w.place[a, i] -= x_next[at + ORIGIN]
            w.speed[a, i] = 0.0
            for j in range(3):
                w.speed[a, i] += w.jacobian[a, i, j] * u[a, 3 + j]
    for a in range(2):
        age = ages[a, tick % ages.shape[1]]
        # what was sent before the start counts from another origin
        if tick - age < x_next[1] + 1.0:
            w.heard[:] = 0.0
        else:
            w.heard[:] = line[1 - a, (tick - age) % line.shape[1]]
        for i in range(3):
            at = HEAD + FIELDS * (3 * a + i)
            n = x_next[at : at + FIELDS]
            # the state of the last tick, with what the start has set
            w.past[:] = n
            f = side(a, i, u, w.heard, w.past, n, p, w)
            n[FORCE], n[LAST] = f, w.place[a, i]
            w.force[a, i] = p.scale * f if a == 0 else f
    for a in range(2):
        for i in range(3):
            at = HEAD + FIELDS * (3 * a + i)
            n, out = x_next[at : at + FIELDS], line[a, tick % line.shape[1], i]
            out[X], out[V], out[F] = w.place[a, i], w.speed[a, i], n[FORCE]
            out[SUM], out[POWER], out[ENERGY] = n[SENT], n[SENT_POWER], n[INTO]
            out[K], out[C], out[SIDE] = n[STIFFNESS], n[PUSH], n[TOUCH]
            # what hardly grows with the depth is friction along a wall, and has no surface
            if n[TOUCH] != 0.0 and n[STIFFNESS] < SOFTEST * p.expected:
                out[SIDE] = NO_WALL
    fixture(p, w)
    for a in range(2):
        for j in range(3):
            y[a, j] = w.gravity[a, j] - (p.leader_damping * u[0, 3 + j] if a == 0 else 0.0)
            for i in range(3):
                y[a, j] += w.jacobian[a, i, j] * w.force[a, i]
