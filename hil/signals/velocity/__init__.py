"""Velocity and acceleration from encoder counts: a family of estimators under one registry."""

from hil.signals.velocity.acceleration import FilteredAcceleration
from hil.signals.velocity.methods import VelocityEstimator, estimator, names

__all__ = ["FilteredAcceleration", "VelocityEstimator", "estimator", "names"]
