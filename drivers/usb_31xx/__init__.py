"""Measurement Computing USB-3101, 3103, 3105, 3110, 3112, 3114: analog outputs over HID."""

from hil.drivers.usb_31xx.box import Usb31xx
from hil.drivers.usb_31xx.config import Usb31xxConfig
from hil.drivers.usb_31xx.link import attached

Config = Usb31xxConfig
BUS = "hid"
open_box = Usb31xx

__all__ = ["BUS", "Config", "Usb31xx", "Usb31xxConfig", "attached", "open_box"]
