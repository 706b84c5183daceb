"""How an object of the library shows itself at a prompt, in a notebook and to other libraries.

What it shows is made in `hil.report`, above everything that is shown; it is looked up by name when
it is asked for, so that no package depends on what lies above it.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

#: Where `text`, `markup`, `frame`, `figures` and `write` of any object live.
_MAKER = "hil.report.objects"


class Shown:
    """Printed it is a table, in a notebook too; `to_frame()` gives the table to pandas."""

    __slots__ = ()

    def __str__(self) -> str:
        return str(_maker("text")(self))

    def _repr_html_(self) -> str:
        return str(_maker("markup")(self))

    def to_frame(self) -> Any:
        """The table as a pandas frame, numbers unrounded.

        Raises
        ------
        ConfigError
            If pandas is not installed.
        """
        return _maker("frame")(self)


class Plotted(Shown):
    """What has figures and a report of its own, too."""

    __slots__ = ()

    def plot(self) -> dict[str, Any]:
        """Plotly figures of the report by name, e.g. ``answer.plot()["ladder"].show()``."""
        return dict(_maker("figures")(self))

    def report(self, path: str | Path) -> Path:
        """Write the report, one HTML file that needs nothing else; an older report is replaced.

        Raises
        ------
        ConfigError
            If the name does not end in .html, the folder is not there, or the file there is no
            report.
        """
        out: Path = _maker("write")(self, path)
        return out


def _maker(name: str) -> Any:
    return getattr(importlib.import_module(_MAKER), name)
