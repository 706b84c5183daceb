"""Drivers: the host's side of the wire, from counts and codes to SI units and back."""
