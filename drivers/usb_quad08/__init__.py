"""Measurement Computing USB-QUAD08: eight quadrature counters over USB (pyusb)."""
