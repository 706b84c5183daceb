"""Extended Lawrence Architecture in the workspace: c1..c8 per axis over computed torque.

operator -> leader --c1 motion, c3 force--> follower -> environment
              ^---- c4 motion, c2 force ----'
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numba as nb
import numpy as np

from controllers import channel, dynamics, ela, geometry
from controllers.channel import ChannelConfig
from hil.errors import ConfigError, unknown
from hil.signals.device import FloatArray
from hil.teleop.files import loops_of
from hil.teleop.refuse import refuse

#: How the robots become point masses: not at all, with measured forces, with accelerations.
SHAPES = ("natural", "force", "acceleration")
#: Cavusoglu's parameters of the bare arm [kg m^2 x6, N m x2].
PREMIUM = (
    2.8328e-3, 1.1319e-3, -3.9120e-4, 9.1230e-4, 2.4264e-3, 9.3189e-4, -1.6298e-2, -7.3755e-2,
)  # fmt: skip
AXES = ("x", "y", "z")
#: Where the momentum observer's memory starts in the state.
FIRST_OBSERVED = 43


@dataclass(frozen=True)
class LawrenceConfig:
    """Parameters of the law; `hil design` writes them.

    Parameters
    ----------
    c1, c4, c7, c8 : tuple of 3 or 9 floats
        k [N/m], b [N s/m], a [kg]; once for all axes, or of x, of y, of z.
    c2, c3, c5, c6 : tuple of 1 or 3 floats
        Force gains.
    leader_mass, follower_mass : tuple of 1 or 3 floats
        Masses m of z = m s for which the gains were made [kg].
    shape : str
        How the arms become these masses: ``"natural"`` not at all (their own tip mass),
        ``"force"`` with the measured force, ``"acceleration"`` without a sensor.
    velocity_hz, acceleration_hz, force_hz : float
        Corners of the filters; 0 = none.
    observer_hz : float
        Corner of the momentum observer, which is recorded beside the law's own estimates.
    forward, backward : table
        Channels leader -> follower and back: delay, jitter [s], loss.
    seed : int
        Of jitter and loss.
    leader_model, follower_model : tuple of 8 floats
        Rigid-body parameters pi.
    friction_speeds : tuple of floats
        Knots of the friction tables [rad/s]; empty = no compensation.
    leader_friction, follower_friction : tuple of floats
        Friction of joint 1, 2, 3 at the knots [N m].
    lengths : tuple of 2 floats
        l1, l2 [m].
    operator, environment, free : tuple of 3 floats
        m [kg], b [N s/m], k [N/m] for which stability is demanded before a motor moves; `free`
        is the operator that holds the leader loosely.
    pose : tuple of 3 floats
        Joint angles [rad] at which stability is judged; the tip's mass depends on them.
    cable : tuple of 3 floats, or empty
        Elastic transmission seen at the tip, for the check before the start: stiffness [N/m],
        damping [N s/m], mass of the motor side [kg].  Data sheet: 3.5 N/mm; rotor of 10.3 g cm^2
        behind gears of 11 to 13 at 0.2 m.
    motion_scale, force_scale : float
        Scales for which the gains were made; for reports.
    """

    c1: tuple[float, ...]
    c7: tuple[float, ...]
    c4: tuple[float, ...] = (0.0, 0.0, 0.0)
    c8: tuple[float, ...] = (0.0, 0.0, 0.0)
    c2: tuple[float, ...] = (0.0,)
    c3: tuple[float, ...] = (0.0,)
    c5: tuple[float, ...] = (0.0,)
    c6: tuple[float, ...] = (0.0,)
    leader_mass: tuple[float, ...] = (0.1,)
    follower_mass: tuple[float, ...] = (0.1,)
    shape: str = "natural"
    velocity_hz: float = 80.0
    acceleration_hz: float = 30.0
    force_hz: float = 60.0
    forward: ChannelConfig = field(default_factory=ChannelConfig)
    backward: ChannelConfig = field(default_factory=ChannelConfig)
    observer_hz: float = 10.0
    seed: int = 0
    leader_model: tuple[float, ...] = PREMIUM
    follower_model: tuple[float, ...] = PREMIUM
    friction_speeds: tuple[float, ...] = ()
    leader_friction: tuple[float, ...] = ()
    follower_friction: tuple[float, ...] = ()
    lengths: tuple[float, float] = (0.215, 0.170)
    operator: tuple[float, float, float] = (0.4, 4.0, 150.0)
    free: tuple[float, float, float] = (0.0, 1.0, 0.0)
    environment: tuple[float, float, float] = (0.0, 1.5, 300.0)
    pose: tuple[float, float, float] = (0.0, 0.4, 0.3)
    cable: tuple[float, ...] = (3500.0, 0.5, 0.0035)
    motion_scale: float = 1.0
    force_scale: float = 1.0

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ConfigError(unknown("shape", self.shape, SHAPES))
        for name, sizes in _SIZES.items():
            if len(getattr(self, name)) not in sizes:
                allowed = " or ".join(map(str, sizes))
                raise ConfigError(f"lawrence: {name} needs {allowed} numbers.")
        n = len(self.friction_speeds)
        for name in ("leader_friction", "follower_friction"):
            if len(getattr(self, name)) != 3 * n:
                raise ConfigError(f"lawrence: {name} needs 3 x {n} numbers, one a joint and knot.")
        if n == 1 or any(np.diff(self.friction_speeds) <= 0):
            raise ConfigError("lawrence: friction_speeds must rise, two knots at least.")
        if min(self.leader_mass + self.follower_mass) <= 0.0:
            raise ConfigError("lawrence: leader_mass and follower_mass must be positive.")

    def gains(self) -> FloatArray:
        """Gains per axis in the order of `ela.GAINS`, shape (3, 16)."""
        g = np.zeros((3, ela.GAINS))
        for at, name in enumerate(("c1", "c4", "c7", "c8")):
            g[:, 3 * at : 3 * at + 3] = np.resize(getattr(self, name), 9).reshape(3, 3)
        for at, name in enumerate(("c2", "c3", "c5", "c6")):
            g[:, 12 + at] = np.resize(getattr(self, name), 3)
        return g

    def masses(self) -> FloatArray:
        """Masses of leader and follower, shape (2, 3) [kg]."""
        return np.stack([np.resize(self.leader_mass, 3), np.resize(self.follower_mass, 3)])

    def shares(self, period: float) -> FloatArray:
        """1 - exp(-2 pi f T) of velocity, acceleration and force filter; 1 without, (3,)."""
        corners = np.array([self.velocity_hz, self.acceleration_hz, self.force_hz])
        return np.where(corners > 0.0, 1.0 - np.exp(-2 * np.pi * corners * period), 1.0)


_SIZES = {
    **dict.fromkeys(("c1", "c4", "c7", "c8"), (3, 9)),
    **dict.fromkeys(("c2", "c3", "c5", "c6", "leader_mass", "follower_mass"), (1, 3)),
    **dict.fromkeys(("leader_model", "follower_model"), (8,)),
    "cable": (0, 3),
}


@nb.njit(cache=True, nogil=True)
def measure(a: int, q: Any, v: Any, wrench: Any, x: Any, c: Any, w: Any, x_next: Any) -> None:
    """Tip of arm `a` into w.jacobian, w.tip, and its filtered signals into w.signals (3, 4)."""
    geometry.forward(q, c.lengths, w.tip[a])
    geometry.jacobian(q, c.lengths, w.jacobian[a])
    for i in range(3):
        at = 1 + 18 * a + 6 * i
        speed = 0.0
        for j in range(3):
            speed += w.jacobian[a, i, j] * v[j]
        x_next[at] = x[at] if x[0] > 0.0 else w.tip[a, i]
        # f_m = +F, f_s = -F with F ON the robot
        force = wrench[i] if a == 0 else -wrench[i]
        ela.sense(
            w.tip[a, i] - x_next[at], speed, force, c.shares, c.period,
            x[at + 1 : at + 6], x_next[at + 1 : at + 6], w.signals[a, i],
        )  # fmt: skip


@nb.njit(cache=True, nogil=True)
def torque(a: int, q: Any, v: Any, force: Any, c: Any, w: Any, y: Any) -> None:
    """Joint torques (3,) of arm `a` that give the commanded tip force (3,) [N].

    natural        tau = J^T F_c + C q' + N + tau_f
    force          tau = M J^-1 (Mw^-1 (F_c + F_s) - J' q') + C q' + N + tau_f - J^T F_s
    acceleration   tau = M q'' + C q' + N + tau_f - J^T (Mw p'' - F_c)
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
        y[j] += dynamics.interpolate(v[j], c.speeds, c.friction[a, j])


@nb.njit(cache=True, nogil=True)
def observe(a: int, q: Any, v: Any, x: Any, c: Any, w: Any, x_next: Any) -> None:
    """Momentum observer of arm `a`: the force ON its tip without a sensor.

    r = K (M q' - int(tau_c + C^T q' - N - tau_f + r) dt), F = J^-T r: the external torque
    through a first-order low-pass of corner K.  Memory per arm: integral (3,), torque sent (3,),
    force (3,); the torque of this tick is written by `law`.
    """
    at = FIRST_OBSERVED + 9 * a
    dynamics.momentum(q, v, c.models[a], w.room[:2], w.impulse)
    dynamics.push(q, v, c.models[a], w.room, w.goal)
    for i in range(3):
        flow = x[at + 3 + i] + w.goal[i] - dynamics.interpolate(v[i], c.speeds, c.friction[a, i])
        known = x[at + i] + c.period * flow if x[0] > 0.0 else w.impulse[i]
        # implicit in r: stable for any K
        w.bend[i] = c.observer * (w.impulse[i] - known) / (1.0 + c.observer * c.period)
        x_next[at + i] = known + c.period * w.bend[i]
    dynamics.solve_transposed(w.jacobian[a], w.bend, w.square, x_next[at + 6 : at + 9])


@nb.njit(cache=True, nogil=True)
def law(
    tick: int, x: Any, u: Any, c: Any, w: Any, line: Any, ages: Any, x_next: Any, y: Any
) -> None:
    """One period; see `Lawrence`.

    Parameters
    ----------
    tick : int
        Number of the tick, from 1.
    line : ndarray (2, length, 3, 4)
        What each arm has sent; slot tick % length.
    ages : ndarray (2, CYCLE)
        Age in ticks of what the follower, the leader acts on.
    """
    x_next[0] = 1.0
    length = line.shape[1]
    for a in range(2):
        measure(a, u[a, :3], u[a, 3:6], u[a, 6:9], x, c, w, x_next)
        line[a, tick % length] = w.signals[a]
    for a in range(2):
        age = ages[a, tick % ages.shape[1]]
        if tick - age < 1:
            w.heard[:] = 0.0
        else:
            w.heard[:] = line[1 - a, (tick - age) % length]
        for i in range(3):
            if a == 0:
                w.force[i] = ela.master(c.gains[i], w.signals[0, i], w.heard[i])
            else:
                w.force[i] = ela.slave(c.gains[i], w.heard[i], w.signals[1, i])
            # what the law believes: f_m = m a_m - f_cm, f_s = f_cs - m a_s
            pull = c.masses[a, i] * w.signals[a, i, 2] - w.force[i]
            x_next[37 + 3 * a + i] = pull if a == 0 else -pull
        torque(a, u[a, :3], u[a, 3:6], w.force, c, w, y[a])
        observe(a, u[a, :3], u[a, 3:6], x, c, w, x_next)
        for j in range(3):
            x_next[FIRST_OBSERVED + 9 * a + 3 + j] = y[a, j]


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

    state_names = (
        "started",
        *(
            f"{arm}_{what}_{axis}"
            for arm in ("leader", "follower")
            for axis in AXES
            for what in ("origin", "velocity", "raw", "acceleration", "force", "on")
        ),
        *(f"{arm}_estimate_{axis}" for arm in ("leader", "follower") for axis in AXES),
        *(
            f"{arm}_{what}"
            for arm in ("leader", "follower")
            for what in (
                *(f"impulse{j}" for j in (1, 2, 3)),
                *(f"sent{j}" for j in (1, 2, 3)),
                *(f"observed_{axis}" for axis in AXES),
            )
        ),
    )

    def __init__(self, config: LawrenceConfig, arms: tuple[str, ...], period: float) -> None:
        if len(arms) != 2:
            raise ConfigError(f"lawrence needs leader and follower, not {len(arms)} arms.")
        refuse(loops_of(config), period)
        self.config = config
        self.period = period
        self._ages = np.stack([
            channel.schedule(way, period, config.seed + k)
            for k, way in enumerate((config.backward, config.forward))
        ])  # fmt: skip
        self._line = np.zeros((2, int(self._ages.max()) + 2, 3, ela.SIGNALS))
        self._c = constants(config, period)
        self._w = np.zeros(1, _WORK)[0]

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`.

        The channel's memory is filled by tick number: the same call gives the same answer.
        """
        tick = round(t / self.period)
        law(tick, x, u, self._c, self._w, self._line, self._ages, x_next, y)


_F = np.float64
_WORK = np.dtype([
    ("tip", _F, (2, 3)), ("jacobian", _F, (2, 3, 3)), ("signals", _F, (2, 3, ela.SIGNALS)),
    ("heard", _F, (3, ela.SIGNALS)), ("force", _F, (3,)), ("push", _F, (3,)),
    ("goal", _F, (3,)), ("bend", _F, (3,)), ("impulse", _F, (3,)), ("room", _F, (6, 3)),
    ("square", _F, (3, 3)),
])  # fmt: skip


def constants(config: LawrenceConfig, period: float) -> Any:
    """Record of what does not change, for the kernels."""
    n = len(config.friction_speeds)
    kind = np.dtype([
        ("gains", _F, (3, ela.GAINS)), ("masses", _F, (2, 3)), ("models", _F, (2, 8)),
        ("shares", _F, (3,)), ("lengths", _F, (2,)), ("period", _F), ("shape", np.int64),
        ("observer", _F),
        ("speeds", _F, (max(n, 1),)), ("friction", _F, (2, 3, max(n, 1))),
    ])  # fmt: skip
    c = np.zeros(1, kind)[0]
    c["gains"], c["masses"] = config.gains(), config.masses()
    c["models"] = np.stack([config.leader_model, config.follower_model])
    c["shares"], c["lengths"], c["period"] = config.shares(period), config.lengths, period
    c["observer"] = 2 * np.pi * config.observer_hz
    c["shape"] = SHAPES.index(config.shape)
    if n:
        c["speeds"] = config.friction_speeds
        c["friction"][0] = np.reshape(config.leader_friction, (3, n))
        c["friction"][1] = np.reshape(config.follower_friction, (3, n))
    return c


Config = LawrenceConfig
build = Lawrence
