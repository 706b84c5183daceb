"""Identification: from recordings and a model to parameters with honest errors."""
