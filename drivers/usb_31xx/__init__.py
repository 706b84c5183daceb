"""Measurement Computing USB-3101, 3103, 3105, 3110, 3112, 3114: analog outputs over HID."""
