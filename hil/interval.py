"""An interval in words that rounding does not close."""

from __future__ import annotations

import math


def interval(low: float, high: float, digits: int = 2) -> str:
    """E.g. ``2.35 to 2.41``: significant digits enough that a tenth of the width still shows.

    Parameters
    ----------
    low, high : float
        Ends, in the same unit.
    digits : int
        Significant digits at least.
    """
    largest, width = max(abs(low), abs(high)), abs(high - low)
    if 0.0 < width < largest and math.isfinite(largest):
        digits = max(digits, min(math.ceil(math.log10(largest / width)) + 2, 15))
    return f"{low:.{digits}g} to {high:.{digits}g}"
