"""Simulated arms of any URDF: own physics, drives on simulated CAN buses."""
