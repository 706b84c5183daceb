"""Public conformance checks for what users add: effects of their own."""

from hil.testing.effects import ConformanceError, check_effect

__all__ = ["ConformanceError", "check_effect"]
