"""Measurement Computing USB-QUAD08: eight quadrature counters over USB (pyusb)."""

from hil.drivers.usb_quad08.driver import Quad08, Quad08Config
from hil.drivers.usb_quad08.link import attached

Config = Quad08Config
BUS = "usb"
open_box = Quad08

__all__ = ["BUS", "Config", "Quad08", "Quad08Config", "attached", "open_box"]
