"""Extended Lawrence Architecture in the workspace: c1..c8 per axis over computed torque.

operator -> leader --c1 motion, c3 force--> follower -> environment
              ^---- c4 motion, c2 force ----'

Constants, friction tables and scratch are set up here for the compiled kernels.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numba as nb
import numpy as np

from hil.controllers import dynamics, fixtures, lawrence_config
from hil.controllers.lawrence_config import (
    FIRST_ESTIMATE,
    FIRST_FILTER,
    FIRST_OBSERVED,
    FIRST_SLIP,
    MASS_SHAPES,
    LawrenceConfig,
)
from hil.errors import ConfigError
from hil.estimate import compensation, compensation_tables
from hil.models import catalogue
from hil.signals.device import FloatArray
from hil.teleop import lawrence_filters
from hil.teleop.gate import refuse
from hil.teleop.law_parameters import loops_of

#: Numbers that the observer of one arm remembers.
_OBSERVER = 12
# Kernels of the Lawrence law: both arms measured, heard, commanded, and turned into torques.
#
# `c`, `w` and `tables` are made by `hil.controllers.lawrence`; `x` is laid out by
# `hil.controllers.lawrence_config`.


@nb.njit(cache=True, nogil=True)
def _measure(a: int, q: Any, v: Any, wrench: Any, x: Any, c: Any, w: Any, x_next: Any) -> None:
    """Tip of arm `a` into w.jacobian, w.tip, and its filtered signals into w.signals (3, 4)."""
    dynamics.forward_kinematics(q, c.lengths, w.tip[a])
    dynamics.jacobian(q, c.lengths, w.jacobian[a])
    for i in range(3):
        at = FIRST_FILTER + 18 * a + 6 * i
        speed = 0.0
        for j in range(3):
            speed += w.jacobian[a, i, j] * v[j]
        x_next[at] = x[at] if x[0] > 0.0 else w.tip[a, i]
        # f_m = +F, f_s = -F with F ON the robot
        force = wrench[i] if a == 0 else -wrench[i]
        lawrence_filters.filtered_axis(
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
    dynamics.premium_inverse_dynamics(q, w.goal, w.goal, c.models[a], w.bend)
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
        dynamics.solve_jacobian(w.jacobian[a], w.bend, w.goal)
    else:
        w.goal[:] = 0.0
    dynamics.premium_inverse_dynamics(q, v, w.goal, c.models[a], y)
    for j in range(3):
        for i in range(3):
            y[j] += w.jacobian[a, i, j] * w.push[i]


@nb.njit(cache=True, nogil=True)
def _believe(u: Any, c: Any, w: Any) -> None:
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
            dynamics.solve_jacobian(w.jacobian[a], w.bend, w.goal)
            dynamics.premium_momentum(q, w.goal, c.models[a], w.room[:2], w.impulse)
            dynamics.solve_transposed(w.jacobian[a], w.impulse, w.square, w.pull[a])
    for i in range(3):
        w.signals[0, i, 3], w.signals[1, i, 3] = lawrence_filters.believe(
            c.gains[i], w.signals[0, i], w.signals[1, i], w.pull[0, i], w.pull[1, i]
        )


@nb.njit(cache=True, nogil=True)
def observe(
    a: int, q: Any, v: Any, wrench: Any, x: Any, c: Any, w: Any, y: Any, x_next: Any
) -> None:
    """Momentum observer of arm `a`: the force ON its tip without a sensor.

    F = J^-T r with r of `hil.controllers.dynamics`.  Memory per arm: integral (3,),
    torque sent (3,), force (3,), measured force behind the same low-pass (3,); the torque of this
    tick is written by `law`.  What r holds beyond the measured force is a disturbance: its share
    is taken from `y` (3,) [N m].
    """
    at = FIRST_OBSERVED + _OBSERVER * a
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
    # f <- (f + K T F) / (1 + K T), as r
    rise = c.observer * c.period / (1.0 + c.observer * c.period)
    for i in range(3):
        past = x[at + 9 + i] if x[0] > 0.0 else 0.0
        x_next[at + 9 + i] = past + rise * (wrench[i] - past)
    for j in range(3):
        left = w.bend[j]
        for i in range(3):
            left -= w.jacobian[a, i, j] * x_next[at + 9 + i]
        y[j] -= c.disturbance * left
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
def command(a: int, c: Any, walls: Any, w: Any, x_next: Any) -> None:
    """Tip force that arm `a` is to have, into w.force; the force that the law believes, kept."""
    for i in range(3):
        if a == 0:
            w.force[i] = lawrence_filters.master(c.gains[i], w.signals[0, i], w.heard[i])
        else:
            w.force[i] = lawrence_filters.slave(c.gains[i], w.heard[i], w.signals[1, i])
    if a == 0:
        fixtures.fixture_force(walls, w.signals[0, :, 0], w.signals[0, :, 1], w.bend, w.force)
    for i in range(3):
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
    walls: Any,
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
    walls : ndarray (k, fixtures.SIZE)
        Virtual fixtures of the leader.
    line : ndarray (2, length, 3, 4)
        What each arm has sent; slot tick % length.
    ages : ndarray (2, CYCLE)
        Age in ticks of what the follower, the leader acts on.
    """
    x_next[0] = 1.0
    for a in range(2):
        _measure(a, u[a, :3], u[a, 3:6], u[a, 6:9], x, c, w, x_next)
    if c.estimated:
        _believe(u, c, w)
    for a in range(2):
        line[a, tick % line.shape[1]] = w.signals[a]
    for a in range(2):
        hear(a, tick, line, ages, w)
        command(a, c, walls, w, x_next)
        torque(a, u[a, :3], u[a, 3:6], w.force, c, w, y[a])
        rub(a, u[a, :3], u[a, 3:6], tick * c.period, x, c, tables, w, y[a], x_next)
        observe(a, u[a, :3], u[a, 3:6], u[a, 6:9], x, c, w, y[a], x_next)
        for j in range(3):
            x_next[FIRST_OBSERVED + _OBSERVER * a + 3 + j] = y[a, j]


_F = np.float64
#: Scratch of one tick.
WORK = np.dtype(
    [
        ("tip", _F, (2, 3)),
        ("jacobian", _F, (2, 3, 3)),
        ("signals", _F, (2, 3, lawrence_filters.SIGNALS)),
        ("heard", _F, (3, lawrence_filters.SIGNALS)),
        ("force", _F, (3,)),
        ("push", _F, (3,)),
        ("goal", _F, (3,)),
        ("bend", _F, (3,)),
        ("impulse", _F, (3,)),
        ("room", _F, (6, 3)),
        ("pull", _F, (2, 3)),
        ("square", _F, (3, 3)),
        ("rub", _F, (2, 3)),
        ("known", _F, (len(compensation.VARIABLES),)),
    ]
)


def constants(config: LawrenceConfig, period: float) -> Any:
    """Record of what does not change, for the kernels."""
    n = len(config.friction_speeds)
    kind = np.dtype(
        [
            ("gains", _F, (3, lawrence_filters.GAINS)),
            ("masses", _F, (2, 3)),
            ("models", _F, (2, 8)),
            ("shares", _F, (3,)),
            ("lengths", _F, (2,)),
            ("period", _F),
            ("shape", np.int64),
            ("observer", _F),
            ("disturbance", _F),
            ("share", _F),
            ("estimated", np.int64),
            ("speeds", _F, (max(n, 1),)),
            ("friction", _F, (2, 3, max(n, 1))),
        ]
    )
    c = np.zeros(1, kind)[0]
    c["gains"], c["masses"] = config.gains(), config.masses()
    c["models"] = np.stack([config.leader_model, config.follower_model])
    c["shares"], c["lengths"], c["period"] = config.shares(period), config.lengths, period
    c["observer"] = 2 * np.pi * config.observer_hz
    c["disturbance"] = config.disturbance
    c["share"], c["estimated"] = config.friction_share, config.forces == "estimated"
    c["shape"] = MASS_SHAPES.index(config.shape)
    if n:
        c["speeds"] = config.friction_speeds
        c["friction"][0] = np.reshape(config.leader_friction, (3, n))
        c["friction"][1] = np.reshape(config.follower_friction, (3, n))
    return c


def friction_of(config: LawrenceConfig) -> tuple[tuple[Any, Any, Any], ...]:
    """Terms, presliding and table values of leader and follower, for the kernels."""
    catalogue.load_files(config.plugins)
    both = (
        (config.leader_effects, config.leader_span),
        (config.follower_effects, config.follower_span),
    )
    found = (compensation_tables.cached_tables(tuple(e.items()), tuple(span)) for e, span in both)
    return tuple((t.terms, t.slips, t.values) for t in found)


class Lawrence:
    """The law with its parameters; see `law`.

    Parameters
    ----------
    config : LawrenceConfig
        Parameters.
    arms : tuple of str
        Two names: leader, follower.
    period : float
        Of the loop [s].

    Raises
    ------
    ConfigError
        If the design must not run: improper gains, an unstable loop, a delay beyond the margin.
    """

    state_names = lawrence_config.LAWRENCE_STATE

    def __init__(self, config: LawrenceConfig, arms: tuple[str, ...], period: float) -> None:
        if len(arms) != 2:
            raise ConfigError(f"lawrence needs leader and follower, not {len(arms)} arms.")
        refuse(loops_of(config), period)
        self.config = config
        self.period = period
        self.needs_force = config.needs_force()
        self._ages = np.stack(
            [
                lawrence_config.schedule(way, period, config.seed + k)
                for k, way in enumerate((config.backward, config.forward))
            ]
        )
        self._line = np.zeros((2, int(self._ages.max()) + 2, 3, lawrence_filters.SIGNALS))
        self._c = constants(config, period)
        self._tables = friction_of(config)
        self._walls = fixtures.fixture_records(config.fixtures)
        self._w = np.zeros(1, WORK)[0]

    def judge(self, corner_hz: float) -> None:
        """Refuse the law if it is not stable with forces that are seen through one more low-pass.

        Both filters count as one whose time constant is their sum.

        Raises
        ------
        ConfigError
            Naming axis, condition and margin.
        """
        own = 1.0 / self.config.force_hz if self.config.force_hz else 0.0
        seen = replace(self.config, force_hz=1.0 / (own + 1.0 / corner_hz))
        refuse(loops_of(seen), self.period)

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`.

        The channel's memory is filled by tick number: the same call gives the same answer.
        """
        tick = round(t / self.period)
        law(
            tick,
            x,
            u,
            self._c,
            self._tables,
            self._walls,
            self._w,
            self._line,
            self._ages,
            x_next,
            y,
        )


Config = LawrenceConfig
build = Lawrence
#: `refuse` judges its design, so it may be one outside of what an operator sets.
JUDGED = True
