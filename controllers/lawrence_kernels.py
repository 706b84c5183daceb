"""Kernels of the Lawrence law: both arms measured, heard, commanded, and turned into torques.

`c`, `w` and `tables` are made by `hil.controllers.lawrence`; `x` is laid out by
`hil.controllers.lawrence_config`.
"""

from __future__ import annotations

from typing import Any

import numba as nb

from hil.controllers import dynamics, geometry
from hil.controllers.lawrence_config import FIRST_ESTIMATE, FIRST_FILTER, FIRST_OBSERVED, FIRST_SLIP
from hil.estimate import compensation
from hil.teleop import lawrence_filters


@nb.njit(cache=True, nogil=True)
def measure(a: int, q: Any, v: Any, wrench: Any, x: Any, c: Any, w: Any, x_next: Any) -> None:
    """Tip of arm `a` into w.jacobian, w.tip, and its filtered signals into w.signals (3, 4)."""
    geometry.forward(q, c.lengths, w.tip[a])
    geometry.jacobian(q, c.lengths, w.jacobian[a])
    for i in range(3):
        at = FIRST_FILTER + 18 * a + 6 * i
        speed = 0.0
        for j in range(3):
            speed += w.jacobian[a, i, j] * v[j]
        x_next[at] = x[at] if x[0] > 0.0 else w.tip[a, i]
        # f_m = +F, f_s = -F with F ON the robot
        force = wrench[i] if a == 0 else -wrench[i]
        lawrence_filters.sense(
            w.tip[a, i] - x_next[at],
            speed,
            force,
            c.shares,
            c.period,
            x[at + 1 : at + 6],
            x_next[at + 1 : at + 6],
            w.signals[a, i],
        )


@nb.njit(cache=True, nogil=True)
def rub(
    a: int, q: Any, v: Any, t: float, x: Any, c: Any, tables: Any, w: Any, y: Any, x_next: Any
) -> None:
    """Friction of arm `a` by its models into w.rub[a], and its share added to `y` (3,) [N m].

    `y` holds the torque before, which is the load that a joint transmits.
    """
    w.goal[:] = 0.0
    dynamics.inverse_dynamics(q, w.goal, w.goal, c.models[a], w.bend)
    for j in range(3):
        w.known[j], w.known[3 + j], w.known[6 + j], w.known[9 + j] = q[j], v[j], y[j], w.bend[j]
        w.rub[a, j] = dynamics.interpolate(v[j], c.speeds, c.friction[a, j])
    w.known[12] = t
    at = FIRST_SLIP + compensation.MEMORY * a
    terms, slips, values = tables[a]
    compensation.friction(
        x[0] > 0.0,
        w.known,
        terms,
        slips,
        values,
        x[at : at + compensation.MEMORY],
        x_next[at : at + compensation.MEMORY],
        w.rub[a],
    )
    for j in range(3):
        y[j] += c.share * w.rub[a, j]


@nb.njit(cache=True, nogil=True)
def torque(a: int, q: Any, v: Any, force: Any, c: Any, w: Any, y: Any) -> None:
    """Joint torques (3,) of arm `a` that give the commanded tip force (3,) [N]; friction apart.

    natural        tau = J^T F_c + C q' + N
    force          tau = M J^-1 (Mw^-1 (F_c + F_s) - J' q') + C q' + N - J^T F_s
    acceleration   tau = M q'' + C q' + N - J^T (Mw p'' - F_c)
    """
    sign = 1.0 if a == 0 else -1.0
    for i in range(3):
        w.push[i] = force[i]
        w.goal[i] = 0.0
        if c.shape == 1:
            w.push[i] = -sign * w.signals[a, i, 3]
            w.goal[i] = (force[i] + sign * w.signals[a, i, 3]) / c.masses[a, i]
        elif c.shape == 2:
            w.push[i] = force[i] - c.masses[a, i] * w.signals[a, i, 2]
            w.goal[i] = w.signals[a, i, 2]
        w.bend[i] = 0.0
    if c.shape > 0:
        dynamics.drift(q, v, c.lengths, w.bend)
        for i in range(3):
            w.bend[i] = w.goal[i] - w.bend[i]
        dynamics.solve(w.jacobian[a], w.bend, w.goal)
    else:
        w.goal[:] = 0.0
    dynamics.inverse_dynamics(q, v, w.goal, c.models[a], y)
    for j in range(3):
        for i in range(3):
            y[j] += w.jacobian[a, i, j] * w.push[i]


@nb.njit(cache=True, nogil=True)
def believe(u: Any, c: Any, w: Any) -> None:
    """Forces of both arms in w.signals replaced by those that their motion betrays (class II).

    p = J^-T M(q) J^-1 (p'' - J' q') of the natural arm, in its pose and with all its axes; of the
    shaped one the point masses.
    """
    for a in range(2):
        q, v = u[a, :3], u[a, 3:6]
        for i in range(3):
            w.pull[a, i] = c.masses[a, i] * w.signals[a, i, 2]
        if c.shape == 0:
            dynamics.drift(q, v, c.lengths, w.bend)
            for i in range(3):
                w.bend[i] = w.signals[a, i, 2] - w.bend[i]
            dynamics.solve(w.jacobian[a], w.bend, w.goal)
            dynamics.momentum(q, w.goal, c.models[a], w.room[:2], w.impulse)
            dynamics.solve_transposed(w.jacobian[a], w.impulse, w.square, w.pull[a])
    for i in range(3):
        w.signals[0, i, 3], w.signals[1, i, 3] = lawrence_filters.believe(
            c.gains[i], w.signals[0, i], w.signals[1, i], w.pull[0, i], w.pull[1, i]
        )


@nb.njit(cache=True, nogil=True)
def observe(a: int, q: Any, v: Any, x: Any, c: Any, w: Any, x_next: Any) -> None:
    """Momentum observer of arm `a`: the force ON its tip without a sensor.

    F = J^-T r with r of `hil.controllers.dynamics`.  Memory per arm: integral (3,),
    torque sent (3,), force (3,); the torque of this tick is written by `law`.
    """
    at = FIRST_OBSERVED + 9 * a
    dynamics.advance(
        x[0] > 0.0,
        q,
        v,
        x[at + 3 : at + 6],
        w.rub[a],
        c.models[a],
        c.observer,
        c.period,
        x[at : at + 3],
        x_next[at : at + 3],
        w.room,
        w.impulse,
        w.goal,
        w.bend,
    )
    dynamics.solve_transposed(w.jacobian[a], w.bend, w.square, x_next[at + 6 : at + 9])


@nb.njit(cache=True, nogil=True)
def hear(a: int, tick: int, line: Any, ages: Any, w: Any) -> None:
    """What has arrived of the other arm's signals at arm `a`, into w.heard; nothing yet is zero."""
    age = ages[a, tick % ages.shape[1]]
    if tick - age < 1:
        w.heard[:] = 0.0
    else:
        w.heard[:] = line[1 - a, (tick - age) % line.shape[1]]


@nb.njit(cache=True, nogil=True)
def command(a: int, c: Any, w: Any, x_next: Any) -> None:
    """Tip force that arm `a` is to have, into w.force; the force that the law believes, kept."""
    for i in range(3):
        if a == 0:
            w.force[i] = lawrence_filters.master(c.gains[i], w.signals[0, i], w.heard[i])
        else:
            w.force[i] = lawrence_filters.slave(c.gains[i], w.heard[i], w.signals[1, i])
        # what the law believes: f_m = m a_m - f_cm, f_s = f_cs - m a_s
        pull = c.masses[a, i] * w.signals[a, i, 2] - w.force[i]
        at = FIRST_ESTIMATE + 3 * a + i
        x_next[at] = pull if a == 0 else -pull
        if c.estimated:
            x_next[at] = w.signals[a, i, 3]


@nb.njit(cache=True, nogil=True)
def law(
    tick: int,
    x: Any,
    u: Any,
    c: Any,
    tables: Any,
    w: Any,
    line: Any,
    ages: Any,
    x_next: Any,
    y: Any,
) -> None:
    """One period of `hil.controllers.lawrence.Lawrence`.

    Parameters
    ----------
    tick : int
        Number of the tick, from 1.
    tables : tuple of (terms, slips, values)
        Friction of leader, follower; see `hil.estimate.compensation`.
    line : ndarray (2, length, 3, 4)
        What each arm has sent; slot tick % length.
    ages : ndarray (2, CYCLE)
        Age in ticks of what the follower, the leader acts on.
    """
    x_next[0] = 1.0
    for a in range(2):
        measure(a, u[a, :3], u[a, 3:6], u[a, 6:9], x, c, w, x_next)
    if c.estimated:
        believe(u, c, w)
    for a in range(2):
        line[a, tick % line.shape[1]] = w.signals[a]
    for a in range(2):
        hear(a, tick, line, ages, w)
        command(a, c, w, x_next)
        torque(a, u[a, :3], u[a, 3:6], w.force, c, w, y[a])
        rub(a, u[a, :3], u[a, 3:6], tick * c.period, x, c, tables, w, y[a], x_next)
        observe(a, u[a, :3], u[a, 3:6], x, c, w, x_next)
        for j in range(3):
            x_next[FIRST_OBSERVED + 9 * a + 3 + j] = y[a, j]
