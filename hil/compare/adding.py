"""The commands that a report suggests: how to add what was found."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from hil.compare.material import Material


@dataclass(frozen=True)
class Files:
    """What a diagnosis was made from, as it was typed, for the commands that a report suggests.

    Parameters
    ----------
    sessions, holdout : tuple of str
        Sessions that were fitted, and those that were judged on.
    model : str
        Model file; empty for the base model of the session's robot.
    arm : str
        Arm, if one was named.
    """

    sessions: tuple[str, ...] = ("SESSION.mcap",)
    holdout: tuple[str, ...] = ()
    model: str = "MODEL.toml"
    arm: str = ""

    def options(self) -> list[str]:
        """Words of a command line behind the model."""
        held = [w for h in self.holdout for w in ("--holdout", h)]
        return [*(["--arm", self.arm] if self.arm else []), "--session", *self.sessions, *held]

    def better(self, k: int) -> str:
        """Name of the k-th improved model, beside the model or the first session."""
        return str(Path(self.model or self.sessions[0]).with_suffix(f".plus{k}.toml"))


def command(m: Material, files: Files | None = None) -> str:
    """Commands that add the findings; empty if there is nothing to add."""
    if m.verdict != "missing-effect":
        return ""
    names = files or Files()
    lines, source = [], names.model
    for k, f in enumerate(m.findings, 1):
        words = ["hil", "add", f.effect, *(["--joint", f.joint] if f.joint else [])]
        words += ["--model", source] if source else []
        source = names.better(k)
        lines.append(shlex.join([*words, *names.options(), "-o", source]))
    return "\n".join(lines)
