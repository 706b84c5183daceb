"""Measurement Computing USB-3101, 3103, 3105, 3110, 3112, 3114: analog outputs over HID."""

from hil.drivers.links.uldaq import ULDAQ, UldaqVolts
from hil.drivers.usb_31xx.driver import Usb31xx, Usb31xxConfig, attached
from hil.signals.bus import Bus

Config = Usb31xxConfig
BUS = "hid"


def open_box(
    name: str, bus: Bus, address: str, config: Usb31xxConfig, channels: tuple[int, ...]
) -> Usb31xx | UldaqVolts:
    """Open a box by the route of its options."""
    if config.route == ULDAQ:
        return UldaqVolts(name, bus, address, config, channels)
    return Usb31xx(name, bus, address, config, channels)


__all__ = ["BUS", "Config", "Usb31xx", "Usb31xxConfig", "attached", "open_box"]
