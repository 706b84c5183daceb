"""The named designs, one table: what each asks for and the c1..c8 it gives.

Scaled goals f_m = kf f_s and v_s = kp v_m: c2 = kf (1 + c6), kf c3 = 1 + c5,
c1 = kp (z_cs + c7), kp c4 = -(z_cm + c8) (transparency theorem, thesis 4.2.1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from hil.errors import ConfigError, unknown
from hil.teleop.design import Design, Robot, Term


@dataclass(frozen=True)
class Wish:
    """What a named design is made from.

    Parameters
    ----------
    stiffness, damping : float
        Position loop of the slave, K [N/m] and B [N s/m].
    master_stiffness, master_damping : float
        The same of the master, where the design has one.
    share : float
        Factor on the force channels c2, c3 of the transparent designs: 1 is transparent.
    slave_force, master_force : float
        Local force gains c5, c6 where the design leaves them free.
    motion_scale, force_scale : float
        kp and kf.
    master, slave : Robot
        Controlled robots.
    """

    stiffness: float = 200.0
    damping: float = 1.0
    master_stiffness: float = 200.0
    master_damping: float = 1.0
    share: float = 1.0
    slave_force: float = 0.0
    master_force: float = 0.0
    motion_scale: float = 1.0
    force_scale: float = 1.0
    master: Robot = field(default_factory=Robot)
    slave: Robot = field(default_factory=Robot)

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping", "master_stiffness", "master_damping"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"{name} = {getattr(self, name)} must not be negative")
        if self.motion_scale <= 0.0 or self.force_scale <= 0.0:
            raise ConfigError("motion_scale and force_scale must be positive")


def position_error(w: Wish) -> Design:
    """Both robots pulled to each other; no force is used."""
    pull = Term(w.stiffness, w.damping)
    back = Term(w.master_stiffness, w.master_damping)
    return Design(c1=pull * w.motion_scale, c4=-(back * (1 / w.motion_scale)), c7=pull, c8=back)


def position_force(w: Wish) -> Design:
    """Slave follows the master's position, master feels the slave's force."""
    pull = Term(w.stiffness, w.damping)
    return Design(
        c1=pull * w.motion_scale, c2=w.force_scale * w.share, c7=pull, c8=Term(0, w.master_damping)
    )


def _transparent(w: Wish, c5: float, c6: float, c7: Term, c8: Term) -> Design:
    """Channels that the theorem demands for given local loops."""
    kp, kf = w.motion_scale, w.force_scale
    return Design(
        c1=(w.slave.term + c7) * kp,
        c2=kf * (1 + c6) * w.share,
        c3=(1 + c5) / kf * w.share,
        c4=-(w.master.term + c8) * (1 / kp),
        c5=c5, c6=c6, c7=c7, c8=c8,
    )  # fmt: skip


def _loops(w: Wish) -> tuple[float, float, Term, Term]:
    return (
        w.slave_force, w.master_force, Term(w.stiffness, w.damping),
        Term(w.master_stiffness, w.master_damping),
    )  # fmt: skip


def four_channel(w: Wish) -> Design:
    """All four channels; local loops free."""
    return _transparent(w, *_loops(w))


def three_channel_1(w: Wish) -> Design:
    """Without v_m -> slave: c7 = -z_cs."""
    c5, c6, _, c8 = _loops(w)
    return _transparent(w, c5, c6, -w.slave.term, c8)


def three_channel_2(w: Wish) -> Design:
    """Without f_s -> master: c6 = -1."""
    c5, _, c7, c8 = _loops(w)
    return _transparent(w, c5, -1.0, c7, c8)


def three_channel_3(w: Wish) -> Design:
    """Without f_m -> slave: c5 = -1."""
    _, c6, c7, c8 = _loops(w)
    return _transparent(w, -1.0, c6, c7, c8)


def three_channel_4(w: Wish) -> Design:
    """Without v_s -> master: c8 = -z_cm."""
    c5, c6, c7, _ = _loops(w)
    return _transparent(w, c5, c6, c7, -w.master.term)


def motion_forward(w: Wish) -> Design:
    """Two channels, velocity forward and force back: c3 = c4 = 0, c5 = -1, c8 = -z_cm."""
    _, c6, c7, _ = _loops(w)
    return _transparent(w, -1.0, c6, c7, -w.master.term)


def force_forward(w: Wish) -> Design:
    """Two channels, force forward and velocity back: c1 = c2 = 0, c6 = -1, c7 = -z_cs."""
    c5, _, _, c8 = _loops(w)
    return _transparent(w, c5, -1.0, -w.slave.term, c8)


#: name -> maker.
DESIGNS: dict[str, Callable[[Wish], Design]] = {
    "position-error": position_error,
    "position-force": position_force,
    "four-channel": four_channel,
    "three-channel-1": three_channel_1,
    "three-channel-2": three_channel_2,
    "three-channel-3": three_channel_3,
    "three-channel-4": three_channel_4,
    "motion-forward": motion_forward,
    "force-forward": force_forward,
}


def design(name: str, wish: Wish | None = None) -> Design:
    """Named design for a wish.

    Raises
    ------
    ConfigError
        If there is no design of this name.
    """
    if name not in DESIGNS:
        raise ConfigError(unknown("design", name, DESIGNS))
    w = wish or Wish()
    return replace(
        DESIGNS[name](w), name=name, master=w.master, slave=w.slave,
        motion_scale=w.motion_scale, force_scale=w.force_scale,
    )  # fmt: skip
