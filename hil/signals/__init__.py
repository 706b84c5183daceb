"""Signals: capabilities of devices by CRTK name, operating states, the wire to a device."""
