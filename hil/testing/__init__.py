"""Public conformance checks for what users add: effects and drivers of their own."""

from hil.testing.driver import Checked, FarEnd, Tolerance, check_driver
from hil.testing.effects import ConformanceError, check_effect

__all__ = [
    "Checked",
    "ConformanceError",
    "FarEnd",
    "Tolerance",
    "check_driver",
    "check_effect",
]
