"""Options of a USB-31xx, and the rate that they give."""

from __future__ import annotations

from dataclasses import dataclass

from hil.drivers.usb_31xx import codec
from hil.errors import ConfigError, unknown

#: Frames of full-speed USB, one report each [1/s]; seen on hardware by users of the family.
REPORTS_PER_S = 1000.0
#: Reports that ask whether the box is alive, per second.
QUERIES_PER_S = 20.0


@dataclass(frozen=True)
class Usb31xxConfig:
    """Options of the box ``usb-31xx``.

    Parameters
    ----------
    model : str
        Of `codec.MODELS`.
    staged : bool
        All channels change at once: they are staged and then updated by a further report.
    heartbeat_bit : int
        Digital line that is turned over while all is well, for the watchdog of an amplifier.
    heartbeat_ms : float
        Time between its edges; 0 = no heartbeat from this box [ms].
    """

    model: str = "usb-3101"
    staged: bool = True
    heartbeat_bit: int = 0
    heartbeat_ms: float = 20.0

    def __post_init__(self) -> None:
        if self.model not in codec.MODELS:
            raise ConfigError(unknown("model", self.model, codec.MODELS))
        if not 0 <= self.heartbeat_bit <= 7:
            raise ConfigError(f"heartbeat_bit = {self.heartbeat_bit}: 0 to 7 is needed.")
        if self.heartbeat_ms != 0 and not 2.0 <= self.heartbeat_ms <= 1000.0:
            raise ConfigError(f"heartbeat_ms = {self.heartbeat_ms}: 0, or 2 to 1000 is needed.")

    def reports(self, channels: int) -> int:
        """Reports per update of so many channels."""
        return channels + (1 if self.staged and channels > 1 else 0)

    def rate_hz(self, channels: int) -> float:
        """Updates per second that so many channels get."""
        beats = 1e3 / self.heartbeat_ms if self.heartbeat_ms else 0.0
        return (REPORTS_PER_S - beats - QUERIES_PER_S) / self.reports(channels)
