"""Measurement Computing USB-3101, 3103, 3105, 3110, 3112, 3114: analog outputs over HID."""

from hil.drivers.usb_31xx.driver import Usb31xx, Usb31xxConfig, attached

Config = Usb31xxConfig
BUS = "hid"
open_box = Usb31xx

__all__ = ["BUS", "Config", "Usb31xx", "Usb31xxConfig", "attached", "open_box"]
