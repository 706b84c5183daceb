"""Which physical effect is missing."""

from __future__ import annotations

from hil.diagnosis.engine import diagnose

__all__ = ["diagnose"]
