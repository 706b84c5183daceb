"""ATI Net F/T box over CAN, basic protocol, short form."""

from hil.drivers.netft_can.driver import NetFtCan, NetFtCanConfig, open_box

BUS = "can"
Config = NetFtCanConfig

__all__ = ["BUS", "Config", "NetFtCan", "NetFtCanConfig", "open_box"]
