"""Rig files: which devices, which law, which simulation."""
