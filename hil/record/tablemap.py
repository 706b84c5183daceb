"""What a map file says: rules from the columns of a table to those of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Start of the metadata that hold a map's [signal].
SIGNAL = "signal_"


@dataclass(frozen=True)
class Rule:
    """One column of the recording from those of the table: sum of weight * source, + shift."""

    terms: Mapping[str, float]
    shift: float = 0.0

    def apply(self, columns: Mapping[str, FloatArray], n: int) -> FloatArray:
        """Values (n,) of the column."""
        out = np.full(n, self.shift)
        for source, weight in self.terms.items():
            out += weight * columns[source]
        return out


@dataclass(frozen=True)
class TableMap:
    """A map file, or what stands for it when there is none.

    Parameters
    ----------
    arms : mapping of str to mapping of str to Rule
        Rules by arm and target column; the arm ``""`` is the only one and unnamed.
    preset, urdf, tip : str
        The robot; `urdf` is a file name.
    unit : str
        Unit of the axes, ``"rad"`` or ``"m"``; ``""`` = not said (rad is taken and doubted).
    array, columns : str, tuple of str
        Which 2-D array, and the names of its columns.
    rate_hz : float
        Sample rate where the table has no time column; 0 otherwise.
    join : mapping of str to str
        Further tables beside the first by the prefix of their columns.
    gaps, repeated : str
        ``"keep"`` what was recorded, or ``"refuse"`` it; ``"drop"`` the repeated rows.
    signal : mapping of str to float
        What is said of the analysis, as in a model's [signal].
    offsets : mapping
        Offset by run and target column (``arm.column`` where there are several arms).
    extras, units : mapping
        Further columns to take along by field name, and their units.
    folder : Path or None
        Folder of the map file.
    """

    arms: Mapping[str, Mapping[str, Rule]] = field(default_factory=lambda: {"": {}})
    preset: str = "single-axis"
    urdf: str = ""
    tip: str = ""
    unit: str = ""
    array: str = ""
    columns: tuple[str, ...] = ()
    rate_hz: float = 0.0
    join: Mapping[str, str] = field(default_factory=dict)
    gaps: str = "keep"
    repeated: str = "keep"
    signal: Mapping[str, float] = field(default_factory=dict)
    offsets: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    extras: Mapping[str, Rule] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None
