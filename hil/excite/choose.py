"""The motion of the menu that answers a question best, and whether any can.

A question is made from names of effects, with and without a recording.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.excite import menu
from hil.excite.limits import Margin
from hil.excite.question import (
    Question,
    Rival,
    Verdict,
    against,
    complete,
    gram,
    imitations,
    nominal,
    sharp,
)
from hil.excite.stage import Stage, fitted
from hil.excite.trajectory import Trajectory
from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.solve import slices_of
from hil.models import catalogue
from hil.models.model import BASE_EFFECTS, RobotModel

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Option:
    """One motion of the menu with what it would say.

    Parameters
    ----------
    motion : Trajectory
        The motion, within all limits.
    verdict : Verdict
        On the hardest pair, together with what is recorded already.
    margins : list of Margin
        To each limit.
    """

    motion: Trajectory
    verdict: Verdict
    margins: list[Margin]


@dataclass(frozen=True)
class Choice:
    """The menu, best first.

    Parameters
    ----------
    options : list of Option
        Best first.
    now : Verdict or None
        Of what is recorded already.
    everything : Verdict
        Of the whole menu together.
    never : tuple of str
        Rivals that no motion of the menu, nor all together, could ever separate from the first.
    structural : bool
        Whether that is all of them.
    """

    options: list[Option]
    now: Verdict | None
    everything: Verdict
    never: tuple[str, ...]
    structural: bool

    @property
    def best(self) -> Option:
        """The best motion."""
        return self.options[0]


@dataclass(frozen=True)
class Survey:
    """Every motion of the menu with the Gram matrix of what it would record.

    Parameters
    ----------
    motions : list of (Trajectory, list of Margin)
        Within all limits.
    grams : list of ndarray (p, p)
        Of the question's columns, for the stage's length.
    known : ndarray (p, p) or None
        Of what is recorded already.
    """

    motions: list[tuple[Trajectory, list[Margin]]]
    grams: list[FloatArray]
    known: FloatArray | None


#: A motion that takes so many times as long as was asked for is none to propose: foreseeing it
#: takes that much longer, too.
LONGEST = 20.0


def survey(
    question: Question,
    stage: Stage,
    joint: int | None,
    known: FloatArray | None = None,
    names: tuple[str, ...] = tuple(menu.MENU),
) -> Survey:
    """Foresee the motions of the menu.

    Parameters
    ----------
    question : Question
        Base, rivals, noise.
    stage : Stage
        Robot, limits, band, length.
    joint : int or None
        Joint that is to move; None: all of them in turn.
    known : ndarray (p, p), optional
        Gram matrix of what is recorded already.
    names : tuple of str
        Motions to look at; what would last `LONGEST` times the stage's length is left out, so that
        there may be none.
    """
    lone = menu.SEVERAL if stage.space.center.size == 1 else ()
    out = Survey([], [], known)
    for name in (n for n in names if n not in lone):
        try:
            wanted = menu.MENU[name](stage.space, joint, stage.seconds)
        except ConfigError:  # longer than any trajectory may be
            continue
        if wanted.period > LONGEST * stage.seconds:
            continue
        motion, problem, found = fitted(wanted, stage, question)
        out.motions.append((motion, found))
        # as long as the others: information per time counts
        out.grams.append(gram(problem, question) * (stage.seconds / motion.period))
    return out


def decide(seen: Survey, question: Question, names: tuple[str, ...]) -> Choice:
    """The motion that separates the first of some rivals from the others best; () means all.

    Rivals that no motion separates from it stay out of the score, unless all are such.

    Raises
    ------
    ConfigError
        If there is no motion to choose from.
    """
    if not seen.motions:
        raise ConfigError(
            f"every motion would take more than {LONGEST:g} times as long as asked for: the joints "
            "are too slow for their ranges; give narrower limits, or a longer motion"
        )

    def say(g: FloatArray) -> dict[str, Verdict]:
        return against(g, question, names)

    start = np.zeros_like(seen.grams[0]) if seen.known is None else seen.known
    single = [say(start + g) for g in seen.grams]
    union = say(start + np.sum(seen.grams, axis=0))
    never = tuple(n for n in union if not any(v[n].possible for v in (union, *single)))
    open_ = [n for n in union if n not in never] or list(union)

    def least(found: dict[str, Verdict]) -> Verdict:
        return min((found[n] for n in open_), key=lambda v: v.odds)

    pairs = zip(seen.motions, single, strict=True)
    ranked = [
        (least(v).odds, sum(v[n].odds for n in open_), Option(x, least(v), found))
        for (x, found), v in pairs
    ]
    # where the worst pair is hopeless everywhere, the others decide
    ranked.sort(key=lambda r: (-round(r[0], 1), -r[1]))
    options = [option for _, _, option in ranked]
    now = None if seen.known is None else least(say(seen.known))
    return Choice(options, now, least(union), never, len(never) == len(union))


#: Noise of the effort where none was measured, as a share of the torque limit.
NOISE = 1e-3
#: Size of an effect of which nothing is known, as a share of the torque limit.
SIZE = 5e-3
#: Share of the noise power that an effect must exceed to be noticed: the 4 % of the error that
#: `hil diagnose` asks of every effect (1 - 0.96^2).
NOTICED_SHARE = 0.08


def question(
    model: RobotModel, effects: tuple[str, ...], joint: int | None, stage: Stage
) -> Question:
    """Question about rivals (or one effect) of which nothing has been measured.

    Each gets the middle of its shapes and coefficients that make it 0.5 % of the torque limit
    (rms, on strokes at all speeds), or what the model has fitted; the noise is 0.1 % of it.

    Raises
    ------
    ConfigError
        If an effect is unknown, part of every model, or cannot show in free motion.
    """
    space = stage.space
    motion = menu.speed_ladder(space, joint, stage.seconds)
    problem = stage.foresee(motion)
    problem.motions = [replace(m, span=space.alone) for m in problem.motions]
    base, theta = nominal(model, problem, space.limits)
    first = problem.motions[0]
    problem.set_context(v0=first.v0, contact=first.contact)
    complete(problem, base, theta)
    torque = _scale(space.limits.torque, problem)
    j = 0 if joint is None else joint
    unknown = {name: _unknown(name, j, problem, SIZE * float(torque[j])) for name in effects}
    known, base, theta = _of_model(base, theta, set(effects) - set(BASE_EFFECTS), j, problem)
    rivals = [known.get(name, rival) for name, rival in unknown.items()]
    _lacking(base, rivals)
    asked = _question(base, theta, _near(rivals, problem), NOISE * torque, problem)
    instants = problem.n * stage.seconds / motion.period
    return replace(asked, floor=NOTICED_SHARE * instants)


def _of_model(
    base: list[Term], theta: FloatArray, effects: set[str], j: int, problem: Problem
) -> tuple[dict[str, Rival], list[Term], FloatArray]:
    """Effects on joint j that the model has fitted, as rivals, and the model without them."""
    known, rest, left = {}, [], []
    for term, where in zip(base, slices_of(problem, base), strict=True):
        if term.effect.name in effects and term.joint == j and np.any(theta[where]):
            known[term.effect.name] = Rival(term, theta[where])
        else:
            rest.append(term)
            left.append(theta[where])
    return known, rest, np.concatenate([np.zeros(0), *left])


def _lacking(base: list[Term], rivals: list[Rival]) -> None:
    """Refuse an effect that the model has already."""
    there = {t.key for t in base} & {(r.name, r.term.joint) for r in rivals}
    if there:
        raise ConfigError(
            f"{', '.join(sorted(n for n, _ in there))}: already in the model; name effects that it "
            "lacks, or none, to identify the model as it is"
        )


def _scale(torque: FloatArray, problem: Problem) -> FloatArray:
    """Torque limits; where there is none, ten times the foreseen effort."""
    foreseen = 10 * np.sqrt(np.mean(problem.motions[0].tau ** 2, axis=0))
    out: FloatArray = np.where(np.isfinite(torque), torque, np.maximum(foreseen, 1e-9))
    return out


def _unknown(name: str, j: int, problem: Problem, size: float) -> Rival:
    """A rival with the middle of its shapes and coefficients of a given rms effort."""
    effect = catalogue.get(name)
    if "motor" not in effect.scope.explains:
        raise ConfigError(
            f"effect {name!r} shows in contact only; no free motion can tell: press on the object "
            f"instead ({effect.doc.shown_by})"
        )
    if reason := effect.scope.lacks(problem.motions[0], j):
        raise ConfigError(f"effect {name!r}: {reason}; no motion of this rig can show it")
    grid = effect.search.grid(problem.motions[0], j)
    term = Term(effect, j, grid[len(grid) // 2] if grid else ())
    columns = problem.columns(effect, j, term.shape)
    flat = columns[j] if columns.ndim == 3 else columns
    power = np.sqrt(np.mean(flat**2, axis=0))
    theta = size / np.maximum(power, 1e-12 + 1e-6 * power.max()) / np.sqrt(power.size)
    # alternate the signs, so that no sum over the columns cancels or doubles by design
    return Rival(term, theta * np.where(np.arange(theta.size) % 3 == 1, -1.0, 1.0))


def _near(rivals: list[Rival], problem: Problem) -> list[Rival]:
    """Rivals with the shapes by which they may imitate each other."""
    out = []
    for r in rivals:
        alike = [
            x.term.shape
            for x in rivals
            if x is not r
            and [p.name for p in x.term.effect.shape] == [p.name for p in r.term.effect.shape]
        ]
        out.append(replace(r, shapes=imitations(r.term, problem, alike)))
    return out


def measured(
    base: list[Term], theta: FloatArray, rivals: list[Rival], noise: FloatArray, problem: Problem
) -> Question:
    """Question about rivals as a recording, in its context, shows them."""
    first = problem.motions[0]
    return Question(base, theta, _near(rivals, problem), noise, first.v0, first.contact, first.span)


def _question(
    base: list[Term], theta: FloatArray, rivals: list[Rival], noise: FloatArray, problem: Problem
) -> Question:
    first = problem.motions[0]
    terms, v0 = sharp(base, first.resolution)
    return Question(terms, theta, rivals, noise, v0, first.contact, first.span)
