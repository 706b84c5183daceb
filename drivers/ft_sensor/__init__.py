"""ATI Nano17 and Nano25 force/torque sensors: gauge words in, wrench in the base frame out."""

from drivers.ft_sensor.config import FtSensorConfig
from drivers.ft_sensor.driver import FtSensor

Config = FtSensorConfig
open_device = FtSensor

__all__ = ["Config", "FtSensor", "FtSensorConfig", "open_device"]
