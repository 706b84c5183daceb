"""The studio: compare a model with measurements, see where it fails, add what is missing."""
