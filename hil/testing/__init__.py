"""Public conformance checks for what users add: effects and drivers of their own."""

from hil.testing.driver import Checked, check_driver
from hil.testing.effects import ConformanceError, check_effect
from hil.testing.far import FarEnd, Tolerance

__all__ = [
    "Checked", "ConformanceError", "FarEnd", "Tolerance", "check_driver", "check_effect",
]  # fmt: skip
