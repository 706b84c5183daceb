"""Diagnosis: where a model fails on held-out data, and which physical effect it lacks."""
