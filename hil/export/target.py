"""Targets of an export: their table, what each declares, how a model becomes a file of theirs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from hil import registry
from hil.diagnosis.types import Step
from hil.errors import printable
from hil.export.content import Content, Vocabulary
from hil.export.within import Within, within
from hil.models.model import RobotModel
from hil.record.recording import Recording


@dataclass(frozen=True)
class Job:
    """What is to be exported.

    Parameters
    ----------
    model : RobotModel
        The model.
    source : Path
        Its file.
    name : str
        Stem of the output, for names in it.
    runs, holdout : list of Recording
        Recordings to refit to and to judge on; may be empty.
    mended : bool
        Whether infeasible bodies are replaced by the nearest feasible ones.
    """

    model: RobotModel
    source: Path
    name: str
    runs: list[Recording] = field(default_factory=list)
    holdout: list[Recording] = field(default_factory=list)
    mended: bool = False


@dataclass(frozen=True)
class Made:
    """What came of it.

    Parameters
    ----------
    texts : dict of str to str
        Texts by ending; the first is that of the output, others stand beside it.
    steps : tuple of Step
        Whole model and what is left of it, with held-out errors.
    lost, notes : tuple of str
        Effects that are lost; what else the user should know.
    """

    texts: dict[str, str]
    steps: tuple[Step, ...] = ()
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class Exporter(Protocol):
    """A program, or a reader, that takes models."""

    #: What it is, for help, and the ending of its file, e.g. ``".urdf"``.
    what: str
    ending: str

    def make(self, job: Job) -> Made:
        """Files of a model."""


@dataclass(frozen=True)
class Program:
    """A target that gets what it can express of a model, refitted within that.

    Parameters
    ----------
    what, ending : str
        As of `Exporter`.
    words : Vocabulary
        What it can express.
    write : callable (Content, name, head) -> dict of str to str
        Texts by ending, with the lines of the head as comments.
    cost : callable (text, Content) -> str, optional
        What one call of the written program costs, measured here; in words.
    """

    what: str
    ending: str
    words: Vocabulary
    write: Callable[[Content, str, tuple[str, ...]], dict[str, str]]
    cost: Callable[[str, Content], str] | None = None

    def make(self, job: Job) -> Made:
        """Refit, write, and measure the cost of a call."""
        found = within(job.model, self.words, job.runs, job.holdout, job.mended)
        lost = tuple(x.text for x in found.content.lost)
        texts = self.write(found.content, job.name, head(job, found, lost))
        cost = self.cost(texts[self.ending], found.content) if self.cost else ""
        return Made(texts, found.steps, lost, (*found.notes, *([cost] if cost else [])))


def head(job: Job, found: Within, lost: tuple[str, ...]) -> tuple[str, ...]:
    """Lines at the head of a file: source, held-out errors, what is lost."""
    joints = found.content.robot.joints
    errors = [
        f"held-out error, {step.label}: "
        + ", ".join(f"{j} {x:.2f} %" for j, x in zip(joints, step.heldout.relative, strict=True))
        for step in found.steps
    ]
    said = errors or ["translated without a recording: not refitted, error unknown"]
    lines = (f"written by hil export from {job.source.name}", *said, *(f"lost: {x}" for x in lost))
    return tuple(" ".join(printable(x).split()) for x in lines)


def names() -> list[str]:
    """Names of all targets."""
    return sorted(registry.names("hil.exports"))


def get(name: str) -> Exporter:
    """Target by name.

    Raises
    ------
    ConfigError
        If there is none.
    """
    found: Exporter = registry.load("hil.exports", name)
    return found
