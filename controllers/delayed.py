"""Teleoperation over a channel with delay, jitter and loss, kept passive in one of four ways.

operator -> leader --place, speed, energy--> follower -> environment
              ^------- force, energy ------'

`"passivity"`: observer and controller of the channel's energy (Ryu, Artigas & Preusche 2010), with
the goal's drift made up for (Coelho, Singh, Kanoulas & Hulin 2018).  `"waves"`: wave variables as
sums (Niemeyer & Slotine 2004), limited to the energy that arrived (Yokokohji, Imaida & Yoshikawa
1999).  `"tanks"`: two layers with energy tanks (Franken et al. 2011).  `"model"`: model-mediated
(Mitra & Niemeyer 2008), the environment identified at the follower, rendered at the leader.  A
virtual fixture, a wall that the leader must not pass, can stand beside any of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil.controllers import delayed_kernels as kernels
from hil.controllers import geometry
from hil.controllers.lawrence_config import AXES, ChannelConfig, schedule
from hil.errors import ConfigError, unknown
from hil.signals.device import FloatArray
from hil.signals.settable import SettableRange

SCHEMES = ("passivity", "waves", "tanks", "model")
#: Beside the jitter, time in which what has gathered in a channel is given out [s].
GATHERED = 0.02
_F = np.float64


@dataclass(frozen=True)
class WallConfig:
    """Virtual fixture: a plane that the leader must not pass.

    Parameters
    ----------
    normal : tuple of 3 floats
        Out of the wall, in the base frame; any length but 0.
    place : float
        Distance of the plane behind the tip's start along the normal [m].
    stiffness, damping : float
        [N/m], [N s/m]; stiffness 0: no wall.
    """

    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    place: float = 0.01
    stiffness: float = 0.0
    damping: float = 0.0


@dataclass(frozen=True)
class DelayedConfig:
    """Parameters of the law.

    Parameters
    ----------
    scheme : str
        ``"passivity"``, ``"waves"``, ``"tanks"`` or ``"model"``.
    stiffness, damping : float
        Of the follower's drive to its goal [N/m], [N s/m].
    force_scale : float
        Share of the coupling's force that the leader feels.
    leader_damping : float
        Added joint damping of the leader [N m s/rad].
    forward, backward : table
        Channels leader -> follower and back: delay, jitter [s], loss.
    seed : int
        Of jitter and loss.
    reserve : float
        Energy that the channel may give out before any has come in, an axis and side [J]
        (``"passivity"``).
    wave, smooth : float
        Impedance of the waves [N s/m], what free motion feels; time in which what has gathered
        behind lost and late packets is given out [s]; 0: as long as the channel's jitter and 20 ms
        more, at once on a channel without delay (``"waves"``).
    level, share, fill : float
        Energy that a tank should hold [J], share of it that goes to the other side [1/s], and the
        leader's brake while less is in its tank [N s/m an J] (``"tanks"``).
    touch, forget, expected, blend, stiffest, brake : float
        Force from which there is contact [N], forgetting factor of a tick, stiffness that a new
        contact begins with [N/m], time in which the leader's model follows the follower's [s], and
        the stiffest that it renders [N/m] and the damping beside it [N s/m] (``"model"``).
    wall : table
        A virtual fixture.
    lengths : tuple of 2 floats
        Nominal l1, l2 [m].
    leader_gravity, follower_gravity : tuple of 2 floats
        Nominal gravity: g2 cos th2, g3 sin th3 [N m].
    """

    scheme: str = "passivity"
    stiffness: float = 200.0
    damping: float = 1.5
    force_scale: float = 1.0
    leader_damping: float = 0.004
    forward: ChannelConfig = field(default_factory=ChannelConfig)
    backward: ChannelConfig = field(default_factory=ChannelConfig)
    seed: int = 0
    reserve: float = 5e-3
    wave: float = 1.5
    smooth: float = 0.0
    level: float = 0.004
    share: float = 10.0
    fill: float = 250.0
    touch: float = 0.15
    forget: float = 0.998
    expected: float = 100.0
    blend: float = 0.05
    stiffest: float = 500.0
    brake: float = 1.0
    wall: WallConfig = field(default_factory=WallConfig)
    lengths: tuple[float, float] = geometry.LENGTHS
    leader_gravity: tuple[float, float] = (0.12, 0.03)
    follower_gravity: tuple[float, float] = (0.0, -0.06)

    def __post_init__(self) -> None:
        if self.scheme not in SCHEMES:
            raise ConfigError(unknown("scheme", self.scheme, SCHEMES))
        positive = (
            "reserve",
            "stiffness",
            "damping",
            "wave",
            "level",
            "share",
            "expected",
            "blend",
            "stiffest",
        )
        for name in positive:
            _need(name, getattr(self, name), getattr(self, name) > 0.0, "above 0")
        for name in ("force_scale", "leader_damping", "smooth", "fill", "touch", "brake", "seed"):
            _need(name, getattr(self, name), getattr(self, name) >= 0.0, "0 or more")
        _need("forget", self.forget, 0.9 <= self.forget < 1.0, "within 0.9 and 1")
        _need("lengths", min(self.lengths), min(self.lengths) > 0.0, "above 0")
        wall = self.wall
        _need("wall.normal", max(map(abs, wall.normal)), any(wall.normal), "a direction")
        for name in ("stiffness", "damping"):
            value = getattr(wall, name)
            _need(f"wall.{name}", value, value >= 0.0, "0 or more")

    def settable(self) -> dict[str, SettableRange]:
        """What an operator may set; the coupling stays passive for all of it."""
        return {
            "force_scale": SettableRange(0.0, 1.0),
            "leader_damping": SettableRange(0.0, 0.05, "N m s/rad"),
        }


def _need(name: str, value: float, fine: bool, wanted: str) -> None:
    if not (fine and math.isfinite(value)):
        raise ConfigError(f"delayed: {name} = {value:g}; {wanted} is needed.")


def constants(config: DelayedConfig, period: float) -> Any:
    """Record of what does not change, for the kernels."""
    numbers = (
        "stiffness damping leader_damping reserve wave smooth level share fill touch forget "
        "expected blend stiffest brake"
    ).split()
    kind = np.dtype(
        [(name, _F) for name in numbers]
        + [("scheme", np.int64), ("scale", _F), ("period", _F), ("lengths", _F, (2,))]
        + [("wall_normal", _F, (3,))]
        + [(name, _F) for name in ("wall_place", "wall_stiffness", "wall_damping")]
    )
    c = np.zeros(1, kind)[0]
    for name in numbers:
        c[name] = getattr(config, name)
    ways = config.forward, config.backward
    if config.smooth == 0.0 and any(way != ChannelConfig() for way in ways):
        c["smooth"] = max(way.jitter for way in ways) + GATHERED
    c["scheme"], c["scale"] = SCHEMES.index(config.scheme), config.force_scale
    c["period"], c["lengths"] = period, config.lengths
    c["wall_normal"] = np.asarray(config.wall.normal) / np.linalg.norm(config.wall.normal)
    c["wall_place"] = config.wall.place
    c["wall_stiffness"], c["wall_damping"] = config.wall.stiffness, config.wall.damping
    return c


#: Scratch of one tick.
WORK = np.dtype(
    [
        ("place", _F, (2, 3)),
        ("speed", _F, (2, 3)),
        ("jacobian", _F, (2, 3, 3)),
        ("force", _F, (2, 3)),
        ("gravity", _F, (2, 3)),
        ("heard", _F, (3, kernels.PACKET)),
        ("past", _F, (kernels.FIELDS,)),
    ]
)
_NAMES = (
    "origin goal energy_in energy_out sent sent_power used used_power tank force "
    "environment_stiffness environment_push p11 p12 p22 contact place"
).split()


class Delayed:
    """The law with its parameters; see `delayed_kernels.law`.

    Parameters
    ----------
    config : DelayedConfig
        Parameters.
    arms : tuple of str
        Two names: leader, follower.
    period : float
        Of the loop [s].

    Raises
    ------
    ConfigError
        If there are not two arms, or a spring and damper of the law is too much for the period.
    """

    state_names = (
        "started",
        "start",
        *(f"{arm}_{axis}_{n}" for arm in ("leader", "follower") for axis in AXES for n in _NAMES),
    )
    #: What a drive's encoder sees at once: the rotor before its cable [kg], 10.3 g cm^2 behind
    #: gears of 11 to 13 at 0.2 m.
    ROTOR = 0.0035

    def __init__(self, config: DelayedConfig, arms: tuple[str, ...], period: float) -> None:
        if len(arms) != 2:
            raise ConfigError(f"delayed needs leader and follower, not {len(arms)} arms.")
        # a sampled spring and damper on a mass: K T + 2 B < 2 m / T (Colgate & Schenkel 1997)
        most, model = 2.0 * self.ROTOR / period, config.scheme == "model"
        for what, k, b in (
            ("stiffness and damping", config.stiffness, config.damping),
            ("wave, the leader's damper,", 0.0, config.wave if config.scheme == "waves" else 0.0),
            ("fill level, the leader's brake,", 0.0, config.fill * config.level),
            ("stiffest and brake", *((config.stiffest, config.brake) if model else (0.0, 0.0))),
            ("wall.stiffness and wall.damping", config.wall.stiffness, config.wall.damping),
        ):
            if k * period + 2.0 * b >= most:
                raise ConfigError(
                    f"delayed: {what} ask for K T + 2 B = {k * period + 2.0 * b:.3g} N s/m at a "
                    f"period of {1e3 * period:g} ms; below {most:g} N s/m is needed, or a shorter "
                    "period"
                )
        self.config, self.period = config, period
        ways = enumerate((config.backward, config.forward))
        self._ages = np.stack([schedule(way, period, config.seed + k) for k, way in ways])
        self._line = np.zeros((2, int(self._ages.max()) + 2, 3, kernels.PACKET))
        self._c = constants(config, period)
        self._w = np.zeros(1, WORK)[0]
        self._gravity = np.array([config.leader_gravity, config.follower_gravity])

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`.

        The channel's memory is filled by tick number: the same call gives the same answer.
        """
        gravity = self._w["gravity"]
        gravity[:, 1] = self._gravity[:, 0] * np.cos(u[:, 1])
        gravity[:, 2] = self._gravity[:, 1] * np.sin(u[:, 2])
        kernels.law(
            round(t / self.period), x, u, self._c, self._line, self._ages, self._w, x_next, y
        )


Config = DelayedConfig
build = Delayed
