"""PHANTOM Premium 1.5: three joints, motor encoders, motor DACs."""

from hil.drivers.premium.driver import PremiumArm, PremiumConfig

Config = PremiumConfig
open_device = PremiumArm

__all__ = ["Config", "PremiumArm", "PremiumConfig", "open_device"]
