"""Estimators: friction for compensation, external force without a sensor, states and parameters."""
