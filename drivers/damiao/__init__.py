"""An arm whose joints are Damiao actuators."""

from hil.drivers.damiao.driver import DamiaoArm, DamiaoArmConfig, open_device

Config = DamiaoArmConfig

__all__ = ["Config", "DamiaoArm", "DamiaoArmConfig", "open_device"]
