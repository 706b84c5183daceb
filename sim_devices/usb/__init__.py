"""Simulated USB devices: a back end for the unmodified pyusb, firmware with its own codec."""
