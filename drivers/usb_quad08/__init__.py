"""Measurement Computing USB-QUAD08: eight quadrature counters over USB (pyusb)."""

from hil.drivers.links.uldaq import ULDAQ, UldaqCounts
from hil.drivers.usb_quad08.driver import Quad08, Quad08Config, ScanClock
from hil.drivers.usb_quad08.link import attached
from hil.signals.bus import Bus

Config = Quad08Config
BUS = "usb"


def open_box(
    name: str, bus: Bus, address: str, config: Quad08Config, channels: tuple[int, ...]
) -> Quad08 | UldaqCounts:
    """Open a box by the route of its options."""
    if config.route == ULDAQ:
        return UldaqCounts(name, bus, address, config, channels, ScanClock)
    return Quad08(name, bus, address, config, channels)


__all__ = ["BUS", "Config", "Quad08", "Quad08Config", "attached", "open_box"]
