"""Identification sessions of one arm in one compiled call: plant, sensors and control loop.

The plant is that of `hil.sim_devices.plants`, with further hidden effects; what is new is that the
joint controller and the encoders run inside the same kernel, so that 25 s take a fraction of a
second.  The library reaches it by entry point only (group ``hil.sim_sessions``).
"""
