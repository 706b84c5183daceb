"""Where multi-step errors used to be; `hil.identify.multistep` has them."""

from hil.identify.multistep import MultiStep, both, each, simulate

__all__ = ["MultiStep", "both", "each", "simulate"]
