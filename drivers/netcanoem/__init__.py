"""ATI 9105-NETCANOEM: strain gauges over CAN, calibrated by the matrix that the board holds."""

from drivers.netcanoem.config import NetCanOemConfig
from drivers.netcanoem.driver import NetCanOem, open_device

Config = NetCanOemConfig

__all__ = ["Config", "NetCanOem", "NetCanOemConfig", "open_device"]
