"""Parameters of the Lawrence law as a rig file holds them, its state, and its channel.

The state goes from tick to tick; here are its names, and where each part starts.  The kernels are
compiled with these offsets, and the cache of numba looks at their own file alone: who changes
something here deletes controllers/__pycache__.

The channel says which sample has arrived by which tick; its delay is constant or varies, and
packets are lost.  Every tick one packet leaves; it arrives after its own delay or never.  It is
used from the first tick on at which it is there, and the receiver holds the newest packet that it
has.  The schedule is drawn once from a seed and repeats.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from hil.controllers.fixtures import FixtureConfig
from hil.errors import ConfigError, unknown
from hil.estimate import compensation_tables
from hil.models import catalogue
from hil.signals.device import FloatArray
from hil.signals.settable import SettableRange
from hil.teleop import lawrence_filters
from hil.teleop.architecture import ticks

#: Ticks after which a schedule repeats.
CYCLE = 8192


@dataclass(frozen=True)
class ChannelConfig:
    """One direction of the link.

    Parameters
    ----------
    delay : float
        Shortest delay [s].  A packet is used from the first tick on by which it has arrived.
    jitter : float
        Packets take up to so much longer [s], uniformly distributed.
    loss : float
        Share of packets that never arrive, 0 to below 1.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0

    def __post_init__(self) -> None:
        if not (self.delay >= 0.0 and self.jitter >= 0.0 and 0.0 <= self.loss < 1.0):
            raise ConfigError("channel: delay and jitter must not be negative, 0 <= loss < 1.")
        if self.delay + self.jitter > 2.0:
            raise ConfigError("channel: at most 2 s of delay and jitter.")

    def told(self, period: float, least: int = 0) -> str:
        """Ticks of a period [s] that a packet takes, `least` at least, for people."""
        soonest = self.delay + min(self.jitter, 1e-3 * period)  # none varies by nothing
        ends = [max(ticks(x, period), least) for x in (soonest, self.delay + self.jitter)]
        both = sorted(set(ends))
        times = " to ".join(f"{1e3 * n * period:g}" for n in both)
        lost = f", {100 * self.loss:g} % lost" if self.loss else ""
        return f"{times} ms ({' to '.join(map(str, both))} ticks){lost}"


def schedule(config: ChannelConfig, period: float, seed: int) -> NDArray[np.int64]:
    """Age in ticks of the newest packet that has arrived, per tick of a cycle (CYCLE,).

    Parameters
    ----------
    config : ChannelConfig
        The link.
    period : float
        Tick [s].
    seed : int
        Of jitter and loss.
    """
    rng = np.random.default_rng([seed, 0xC4A])
    # two cycles, so that the second one starts with packets under way
    n = 2 * CYCLE
    takes = config.delay + rng.uniform(0.0, config.jitter, n)
    travel = np.array([ticks(x, period) for x in takes])
    arrives = np.where(rng.uniform(size=n) < config.loss, n + CYCLE, np.arange(n) + travel)
    newest = np.full(n, -1, np.int64)
    sent = np.flatnonzero(arrives < n)
    np.maximum.at(newest, arrives[sent], sent)
    newest = np.maximum.accumulate(newest)
    age: NDArray[np.int64] = (np.arange(n) - newest)[CYCLE:]
    return age


#: How the robots become point masses: not at all, with measured forces, with accelerations.
MASS_SHAPES = ("natural", "force", "acceleration")
#: Where the law takes its forces from.
SOURCES = ("measured", "estimated")
#: Cavusoglu's parameters of the bare arm [kg m^2 x6, N m x2].
PREMIUM = (
    2.8328e-3,
    1.1319e-3,
    -3.9120e-4,
    9.1230e-4,
    2.4264e-3,
    9.3189e-4,
    -1.6298e-2,
    -7.3755e-2,
)
AXES = ("x", "y", "z")
#: Gains on measured forces.
FORCES = ("c2", "c3", "c5", "c6")
_GAINS = ("c1", "c4", "c7", "c8", *FORCES)


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
    forces : str
        ``"measured"`` by the sensors, or ``"estimated"``: solved from the motion of both arms and
        their nonlinear models, in every tick (class II); no sensor is read.
    velocity_hz, acceleration_hz, force_hz : float
        Corners of the filters; 0 = none.
    observer_hz : float
        Corner of the momentum observer, which is recorded beside the law's own estimates.
    disturbance : float
        Share, 0 to 1, of what the observer finds beyond the measured force that the motors take
        away (disturbance observers of both arms): friction that no model holds, wrong gravity.
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
    leader_effects, follower_effects : mapping
        Further effects that are compensated, as a model file gives their values: full name, as
        ``j2.position-friction.p``, to value.  What can be is decided by
        `hil.estimate.compensation_tables`.
    leader_span, follower_span : tuple of 6 floats, or empty
        Lowest and highest position of each joint on which these were identified [rad].
    plugins : tuple of str
        Files with a user's own effects.
    friction_share : float
        Share of all this friction that is compensated.
    fixtures : list of tables
        Virtual fixtures of the leader, see `hil.controllers.fixtures`.
    lengths : tuple of 2 floats
        l1, l2 [m].
    operator, environment, free : tuple of 3 floats
        m [kg], b [N s/m], k [N/m] for which stability is demanded before a motor moves; `free`
        is the operator that holds the leader loosely.
    pose : tuple of 3 floats
        Joint angles [rad] for which the design is made, and about which stability is judged; the
        tip's mass depends on them.
    workspace : tuple of 3 floats, or empty
        Half of the sides of a box about the tip at `pose` over which stability is demanded [m];
        empty = at `pose` alone.
    cable : tuple of 3 floats, or empty
        Elastic transmission seen at the tip, for the check before the start: stiffness [N/m],
        damping [N s/m], mass of the motor side [kg].  Data sheet: 3.5 N/mm; rotor of 10.3 g cm^2
        behind gears of 11 to 13 at 0.2 m.
    friction_damping : tuple of 2 floats
        What the own friction of leader and follower damps at the tip for certain [N s/m], for the
        check before the start: Coulomb friction over the speed up to which it shall hold, and
        viscous friction.  Friction of `leader_effects`, `follower_effects` counts beside it.
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
    forces: str = "measured"
    velocity_hz: float = 80.0
    acceleration_hz: float = 30.0
    force_hz: float = 60.0
    forward: ChannelConfig = field(default_factory=ChannelConfig)
    backward: ChannelConfig = field(default_factory=ChannelConfig)
    observer_hz: float = 10.0
    disturbance: float = 0.0
    seed: int = 0
    leader_model: tuple[float, ...] = PREMIUM
    follower_model: tuple[float, ...] = PREMIUM
    friction_speeds: tuple[float, ...] = ()
    leader_friction: tuple[float, ...] = ()
    follower_friction: tuple[float, ...] = ()
    leader_effects: Mapping[str, float] = field(default_factory=dict)
    follower_effects: Mapping[str, float] = field(default_factory=dict)
    leader_span: tuple[float, ...] = ()
    follower_span: tuple[float, ...] = ()
    plugins: tuple[str, ...] = ()
    friction_share: float = 1.0
    fixtures: tuple[FixtureConfig, ...] = ()
    lengths: tuple[float, float] = (0.215, 0.170)
    operator: tuple[float, float, float] = (0.4, 4.0, 150.0)
    free: tuple[float, float, float] = (0.0, 1.0, 0.0)
    environment: tuple[float, float, float] = (0.0, 1.5, 300.0)
    pose: tuple[float, float, float] = (0.0, 0.4, 0.3)
    workspace: tuple[float, ...] = (0.05, 0.06, 0.05)
    cable: tuple[float, ...] = (3500.0, 0.5, 0.0035)
    friction_damping: tuple[float, float] = (0.0, 0.0)
    motion_scale: float = 1.0
    force_scale: float = 1.0

    def __post_init__(self) -> None:
        if self.shape not in MASS_SHAPES:
            raise ConfigError(unknown("shape", self.shape, MASS_SHAPES))
        if self.forces not in SOURCES:
            raise ConfigError(unknown("forces", self.forces, SOURCES))
        if self.forces == "estimated" and not self._both_at_once():
            raise ConfigError(
                'lawrence: forces = "estimated" solves both sites at once; it needs channels '
                'without delay, jitter and loss, and another shape than "force"'
            )
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
        if not 0.0 <= self.friction_share <= 1.0:
            raise ConfigError("lawrence: friction_share must lie within 0 and 1.")
        if not 0.0 <= self.disturbance <= 1.0:
            raise ConfigError(
                f"lawrence: disturbance = {self.disturbance:g}; a share within 0 and 1 is needed."
            )
        if self.fixtures and self.forces == "estimated":
            raise ConfigError(
                "lawrence: a fixture's force is none of the gains from which forces are estimated; "
                'with fixtures, forces = "measured" is needed.'
            )
        if self.disturbance and (self.forces == "estimated" or not self.observer_hz):
            raise ConfigError(
                "lawrence: a disturbance is what is beyond the measured force: it needs "
                'forces = "measured" and an observer_hz above 0.'
            )
        self._physical()

    def _physical(self) -> None:
        """Refuse numbers that no arm, cable, hand or channel has."""
        for f in fields(self):
            values = getattr(self, f.name)
            numbers = values if isinstance(values, tuple) else (values,)
            # of the gains 'hil.teleop.sampled_loop' names the axis
            if f.name not in _GAINS and not all(
                math.isfinite(x) for x in numbers if isinstance(x, float)
            ):
                raise ConfigError(f"lawrence: {f.name} has a number that is not finite.")
        for name in ("leader_mass", "follower_mass", "lengths", "motion_scale", "force_scale"):
            if np.min(getattr(self, name)) <= 0.0:
                raise ConfigError(f"lawrence: {name} must be positive.")
        for name in ("velocity_hz", "acceleration_hz", "force_hz", "observer_hz"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"lawrence: {name} must not be negative; 0 is no filter.")
        for name in ("operator", "environment", "free", "friction_damping"):
            if min(getattr(self, name)) < 0.0:
                raise ConfigError(
                    f"lawrence: {name} must not be negative: mass, damping, stiffness."
                )
        if self.seed < 0:
            raise ConfigError(f"lawrence: seed = {self.seed}; a number from 0 on is needed.")
        if self.cable and (min(self.cable[::2]) <= 0.0 or self.cable[1] < 0.0):
            raise ConfigError(
                f"lawrence: cable = {list(self.cable)}; stiffness and mass of the motor side must "
                "be positive and damping not negative; [] is a rigid transmission."
            )

    def settable(self) -> dict[str, SettableRange]:
        """What an operator may set: force gains, filters, share; the rest is 'hil design's."""
        force = {name: SettableRange(-2.0, 2.0, "", len(getattr(self, name))) for name in FORCES}
        corners = ("velocity_hz", "acceleration_hz", "force_hz", "observer_hz")
        share = {"friction_share": SettableRange(0.0, 1.0)}
        return {**force, **share, **dict.fromkeys(corners, SettableRange(1.0, 400.0, "Hz"))}

    def needs_force(self) -> tuple[int, ...]:
        """Arms (0 leader, 1 follower) whose measured force the law reads."""
        if self.forces == "estimated":
            return ()
        every = self.shape == "force" or self.disturbance > 0.0
        leader, follower = any(self.c3) or any(self.c6), any(self.c2) or any(self.c5)
        return tuple(k for k, used in enumerate((leader, follower)) if used or every)

    def fixture(self) -> tuple[float, float]:
        """Stiffness and damping of all fixtures at once, for the check before the start."""
        return sum(f.stiffness for f in self.fixtures), sum(f.damping for f in self.fixtures)

    def _both_at_once(self) -> bool:
        """Whether both sites know each other's motion at once, and no shape needs a sensor."""
        plain = ChannelConfig()
        return self.forward == plain and self.backward == plain and self.shape != "force"

    def gains(self) -> FloatArray:
        """Gains per axis in the order of `lawrence_filters.GAINS`, shape (3, 16)."""
        g = np.zeros((3, lawrence_filters.GAINS))
        for at, name in enumerate(("c1", "c4", "c7", "c8")):
            g[:, 3 * at : 3 * at + 3] = np.resize(getattr(self, name), 9).reshape(3, 3)
        for at, name in enumerate(FORCES):
            g[:, 12 + at] = np.resize(getattr(self, name), 3)
        return g

    def friction(self, arm: int, speed: float) -> FloatArray:
        """Declared friction of the joints, each moving alone at `speed` [rad/s], (3,) [N m].

        Half of the difference of both directions: what is odd in the speed.
        """
        named = (self.leader_effects, self.leader_span), (self.follower_effects, self.follower_span)
        effects, span = named[arm]
        table = np.reshape((self.leader_friction, self.follower_friction)[arm], (3, -1))
        catalogue.load_files(self.plugins)
        out = np.zeros(3)
        for j in range(3):
            for sign in (0.5, -0.5):
                v = 2.0 * sign * speed
                if self.friction_speeds:
                    out[j] += sign * np.interp(v, self.friction_speeds, table[j])
                if effects:
                    q, qd = np.asarray(self.pose), v * np.eye(3)[j]
                    torque = compensation_tables.steady(tuple(effects.items()), tuple(span), q, qd)
                    out[j] += sign * torque[j]
        return out

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
    "workspace": (0, 3),
    **dict.fromkeys(("leader_span", "follower_span"), (0, 6)),
}


_ARMS = ("leader", "follower")
_JOINTS = (1, 2, 3)
#: Of one axis: where it started, and the memory of `lawrence_filters.filtered_axis`.
_FILTERS = ("origin", "velocity", "raw", "acceleration", "force", "on")
#: Of one arm: the momentum observer of `hil.controllers.dynamics`, the sensor behind its corner.
_OBSERVER = (
    *(f"impulse{j}" for j in _JOINTS),
    *(f"sent{j}" for j in _JOINTS),
    *(f"observed_{axis}" for axis in AXES),
    *(f"sensed_{axis}" for axis in AXES),
)
#: Of one arm: friction with a state, `hil.estimate.compensation`.
_SLIP = (
    *(f"last{j}" for j in _JOINTS),
    *(f"slip{j}_{e}" for j in _JOINTS for e in (1, 2, 3)),
)
LAWRENCE_STATE = (
    "started",
    *(f"{arm}_{what}_{axis}" for arm in _ARMS for axis in AXES for what in _FILTERS),
    *(f"{arm}_estimate_{axis}" for arm in _ARMS for axis in AXES),
    *(f"{arm}_{what}" for arm in _ARMS for what in _OBSERVER),
    *(f"{arm}_{what}" for arm in _ARMS for what in _SLIP),
)
#: Where the filters, the law's estimates of the forces, the momentum observer's memory and the
#: memory of friction with a state start; the leader's, then the follower's.
FIRST_FILTER = LAWRENCE_STATE.index("leader_origin_x")
FIRST_ESTIMATE = LAWRENCE_STATE.index("leader_estimate_x")
FIRST_OBSERVED = LAWRENCE_STATE.index("leader_impulse1")
FIRST_SLIP = LAWRENCE_STATE.index("leader_last1")
