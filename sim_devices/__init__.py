"""Simulated devices: the firmware's side of the wire, with physics of their own.

Nothing that ships imports this package; the registry finds it by the entry point group
``hil.sim_devices``.  It shares neither code nor parameter files with the models that are
fitted to its sessions.

Not simulated: time-outs and lost frames of a real bus, amplifier fold-back, winding
temperature, encoder eccentricity, cable slack, and the weight of the tool beyond the sensor.
"""
