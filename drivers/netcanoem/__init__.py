"""ATI 9105-NETCANOEM: strain gauges over CAN, calibrated by the matrix that the board holds."""

from hil.drivers.netcanoem.driver import NetCanOem, NetCanOemConfig, attached, open_box

BUS = "can"
Config = NetCanOemConfig

__all__ = ["BUS", "Config", "NetCanOem", "NetCanOemConfig", "attached", "open_box"]
