"""ATI Net F/T box over UDP, Raw Data Transfer."""

from hil.drivers.netft_rdt.driver import NetFtRdt, NetFtRdtConfig, open_box

BUS = "udp"
Config = NetFtRdtConfig

__all__ = ["BUS", "Config", "NetFtRdt", "NetFtRdtConfig", "open_box"]
