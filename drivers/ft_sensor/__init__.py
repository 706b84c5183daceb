"""ATI Nano17 and Nano25 force/torque sensors: gauge words in, wrench in the base frame out."""

from hil.drivers.ft_sensor.driver import ForceSensor, FtSensor, FtSensorConfig, open_device

Config = FtSensorConfig

__all__ = ["Config", "ForceSensor", "FtSensor", "FtSensorConfig", "open_device"]
