"""Parameters of the Lawrence law, as a rig file holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hil.controllers import ela
from hil.controllers.channel import ChannelConfig
from hil.errors import ConfigError, unknown
from hil.signals.device import FloatArray
from hil.signals.settable import Range

#: How the robots become point masses: not at all, with measured forces, with accelerations.
SHAPES = ("natural", "force", "acceleration")
#: Where the law takes its forces from.
SOURCES = ("measured", "estimated")
#: Cavusoglu's parameters of the bare arm [kg m^2 x6, N m x2].
PREMIUM = (
    2.8328e-3, 1.1319e-3, -3.9120e-4, 9.1230e-4, 2.4264e-3, 9.3189e-4, -1.6298e-2, -7.3755e-2,
)  # fmt: skip
AXES = ("x", "y", "z")
#: Gains on measured forces.
FORCES = ("c2", "c3", "c5", "c6")


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
    forces: str = "measured"
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
    leader_effects: Mapping[str, float] = field(default_factory=dict)
    follower_effects: Mapping[str, float] = field(default_factory=dict)
    leader_span: tuple[float, ...] = ()
    follower_span: tuple[float, ...] = ()
    plugins: tuple[str, ...] = ()
    friction_share: float = 1.0
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
        if min(self.leader_mass + self.follower_mass) <= 0.0:
            raise ConfigError("lawrence: leader_mass and follower_mass must be positive.")

    def settable(self) -> dict[str, Range]:
        """What an operator may set: force gains, filters, share; the rest is 'hil design's."""
        force = {name: Range(-2.0, 2.0, "", len(getattr(self, name))) for name in FORCES}
        corners = ("velocity_hz", "acceleration_hz", "force_hz", "observer_hz")
        share = {"friction_share": Range(0.0, 1.0)}
        return {**force, **share, **dict.fromkeys(corners, Range(1.0, 400.0, "Hz"))}

    def _both_at_once(self) -> bool:
        """Whether both sites know each other's motion at once, and no shape needs a sensor."""
        plain = ChannelConfig()
        return self.forward == plain and self.backward == plain and self.shape != "force"

    def gains(self) -> FloatArray:
        """Gains per axis in the order of `ela.GAINS`, shape (3, 16)."""
        g = np.zeros((3, ela.GAINS))
        for at, name in enumerate(("c1", "c4", "c7", "c8")):
            g[:, 3 * at : 3 * at + 3] = np.resize(getattr(self, name), 9).reshape(3, 3)
        for at, name in enumerate(FORCES):
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
    **dict.fromkeys(("leader_span", "follower_span"), (0, 6)),
}
