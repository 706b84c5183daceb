"""Why effects cannot be told apart, structure or this excitation, and the motion that would.

Computed for this robot and model with the fitted values: see `hil.excite.separate`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.compare.candidate import Candidate
from hil.compare.evidence import Evidence
from hil.errors import ConfigError
from hil.excite import menu
from hil.excite.ask import measured
from hil.excite.choose import Choice, Survey, decide, survey
from hil.excite.question import Question, Rival, in_context, sharp
from hil.excite.recorded import room, stage_of
from hil.excite.separate import gram
from hil.excite.stage import Stage
from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
#: Share of an effect's columns from which the base model is said to absorb it.
ABSORBED = 0.9999
#: Size in units of the noise that an effect gets which the base model absorbs.
PROBE = 10.0
#: Motions that decide whether what the whole robot does to the base can be seen at all.
RICH = ("multisine", "postures", "fast-strokes")
#: Rivals on one joint that are looked at together.
MOST = 6


@dataclass
class Planner:
    """Finds the motion for any set of rivals beside one fit; each joint's menu is foreseen once.

    Parameters
    ----------
    result : FitResult
        The fit.
    evidence : Evidence
        Candidates beside it.
    """

    result: FitResult
    evidence: Evidence

    def __post_init__(self) -> None:
        self._seen: dict[tuple[tuple[str, int], ...], tuple[Survey, Question]] = {}
        self._stage = _stage(self.result)

    def plan(self, among: tuple[Candidate, ...], pair: tuple[str, ...]) -> Choice | None:
        """Choice for a set of rivals among the candidates of one joint; None without a menu."""
        # a planned motion meets no force, so it says nothing of a force sensor
        among = tuple(c for c in among if not c.term.effect.jointless)
        if self._stage is None or not among or not set(pair) <= {c.name for c in among}:
            return None
        key = tuple((c.name, c.term.joint) for c in among)
        if key not in self._seen:
            self._seen[key] = self._look(among, self._stage)
        seen, question = self._seen[key]
        return decide(seen, question, pair)

    def _look(self, among: tuple[Candidate, ...], stage: Stage) -> tuple[Survey, Question]:
        result = self.result
        terms, theta = _base(result)
        base, v0 = sharp(terms, result.problem.motions[0].resolution)
        alone = stage.space.alone
        span = np.stack(
            [np.minimum(result.problem.span[:, 0], alone[:, 0]),
             np.maximum(result.problem.span[:, 1], alone[:, 1])], axis=1,
        )  # fmt: skip
        context = in_context(result.problem, v0, result.problem.motions[0].contact, span)
        question = _question(context, base, theta, result, self.evidence, among)
        known = gram(context, question)
        whole = all(c.term.effect.whole_robot for c in among)
        names = tuple(n for n in menu.MENU if not whole or n in RICH)
        joint = None if whole else among[0].term.joint
        return survey(question, stage, joint, known, names), question


def _stage(result: FitResult) -> Stage | None:
    """Where a motion could be played: within the robot's limits, else what was recorded."""
    if result.model.explains != "motor" or not room(result.problem):
        return None
    try:
        return stage_of(result.problem)
    except ConfigError:
        return None


def _base(result: FitResult) -> tuple[list[Term], FloatArray]:
    """Terms of the fit with their coefficients, but for those of single runs."""
    kept = [
        (t, result.theta[s])
        for t, s in zip(result.terms, result.slices, strict=True) if not t.per_run
    ]  # fmt: skip
    return [t for t, _ in kept], np.concatenate([x for _, x in kept] or [np.zeros(0)])


def _question(
    context: Problem, base: list[Term], theta: FloatArray, result: FitResult,
    evidence: Evidence, among: tuple[Candidate, ...],
) -> Question:  # fmt: skip
    """Question about some candidates with the coefficients that the data give them."""
    floor = evidence.floor
    # coloured noise: one independent instant in `inflation`
    noise = np.maximum(floor.scale * np.sqrt(floor.inflation), 1e-12)
    projector = Projector(context, base, result.sigma)
    rivals = [_rival(c, projector, noise) for c in among]
    return measured(base, theta, rivals, noise, context)


def _rival(c: Candidate, projector: Projector, noise: FloatArray) -> Rival:
    """A candidate with its coefficients; ten times the noise where the base absorbs it.

    Directions of which less than a thousandth is new are left out: what the recording hardly
    shows must not be extrapolated.
    """
    term = replace(c.term, per_run=False)
    columns = projector.weighted(term)
    size = np.linalg.norm(columns, axis=0)
    if c.absorbed > ABSORBED:
        rms = size / np.sqrt(len(columns)) * projector.sigma[term.joint]
        return Rival(term, PROBE * noise[term.joint] / np.maximum(rms, 1e-300))
    unit = columns / np.maximum(size, 1e-300)
    rows = projector.rows(term)
    inner = projector.inner(rows, unit)
    value, vector = np.linalg.eigh(unit.T @ unit - inner.T @ inner)
    keep = value > 1e-3
    right = vector[:, keep].T @ (unit.T @ projector.residual[rows])
    return Rival(term, (vector[:, keep] @ (right / value[keep])) / np.maximum(size, 1e-300))
