"""Motions: what to move so that a model is identified or rival effects come apart."""
