"""How a NETCANOEM board is addressed and polled."""

from __future__ import annotations

from dataclasses import dataclass

from hil.drivers.netcanoem import codec
from hil.errors import ConfigError, unknown


@dataclass(frozen=True)
class NetCanOemConfig:
    """Options of the driver ``netcanoem``.

    Parameters
    ----------
    interface : str
        python-can's interface on hardware, e.g. ``socketcan``, ``pcan``, ``udp_multicast``.
    base : int
        Base identifier of the board (0..127) where the box's address does not say it; two
        boards on one bus need different ones.
    bit_rate : int
        Of the bus [bit/s]; the board's own default is 250000, and 1 kHz needs 1000000.
    calibration : int
        Slot 0..15 of the transducer in the board; after every reset the board is at slot 0.
    serial : str
        Serial number that the slot must hold; empty takes any.
    force_unit, torque_unit : str
        Units of the calibration; needed with firmware before 3.7 alone, which cannot tell.
    answer_ms, stale_ms, lost_ms : float
        Wait for an answer before it is asked for again, longer where the sensors on the bus
        need longer for one answer each; age of a sample from which it is STALE; age from which
        the sensor is lost and the device goes to FAULT [ms].
    """

    interface: str = "socketcan"
    base: int = 0x20
    bit_rate: int = 1_000_000
    calibration: int = 0
    serial: str = ""
    force_unit: str = ""
    torque_unit: str = ""
    answer_ms: float = 0.9
    stale_ms: float = 1.5
    lost_ms: float = 50.0

    def __post_init__(self) -> None:
        if not 0 <= self.base <= 0x7F:
            raise ConfigError(f"base = {self.base:#x}: 0 to 0x7f is needed.")
        if not 0 <= self.calibration < codec.SLOTS:
            raise ConfigError(f"calibration = {self.calibration}: a slot 0 to 15 is needed.")
        if not 0 < self.stale_ms <= self.lost_ms or self.answer_ms <= 0:
            raise ConfigError("0 < stale_ms <= lost_ms and answer_ms > 0 are needed.")
        _known("force_unit", self.force_unit, [n for n, _ in codec.FORCE_UNITS.values()])
        _known("torque_unit", self.torque_unit, [n for n, _ in codec.TORQUE_UNITS.values()])


def _known(kind: str, name: str, names: list[str]) -> None:
    if name and name not in names:
        raise ConfigError(unknown(kind, name, names))
