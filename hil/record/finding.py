"""One fault of a recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One fault of a recording.

    Parameters
    ----------
    code : str
        Stable name, e.g. ``"gap"``.
    severity : str
        ``"error"`` (any fit would be worthless) or ``"warning"``.
    joint : str
        Joint concerned, or ``""``.
    text : str
        What was found, and what to do.
    """

    code: str
    severity: str
    joint: str
    text: str

    @property
    def sentence(self) -> str:
        """What was found, with the joint in front where there is one."""
        return f"{self.joint}: {self.text}" if self.joint else self.text
