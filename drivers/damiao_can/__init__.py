"""Damiao actuators on one CAN bus: a box whose channels are their identifiers."""

from hil.drivers.damiao_can.driver import DamiaoBus, DamiaoBusConfig, open_box

BUS = "can"
Config = DamiaoBusConfig

__all__ = ["BUS", "Config", "DamiaoBus", "DamiaoBusConfig", "open_box"]
