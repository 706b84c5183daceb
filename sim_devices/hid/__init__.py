"""Simulated HID devices: an object with the interface of hidapi's module, and firmware."""
