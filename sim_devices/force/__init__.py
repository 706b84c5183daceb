"""Simulated force/torque sensors: transducer, and the boards that put it on a wire."""
