"""The motion of the menu that answers a question best, and whether any can."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.excite import menu
from hil.excite.margins import Margin
from hil.excite.question import Question, Verdict
from hil.excite.separate import against, gram
from hil.excite.stage import Stage, fitted
from hil.excite.trajectory import Trajectory

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
        Motions to look at.
    """
    lone = menu.SEVERAL if stage.space.center.size == 1 else ()
    out = Survey([], [], known)
    for name in (n for n in names if n not in lone):
        wanted = menu.MENU[name](stage.space, joint, stage.seconds)
        motion, problem, found = fitted(wanted, stage, question)
        out.motions.append((motion, found))
        # as long as the others: information per time counts
        out.grams.append(gram(problem, question) * (stage.seconds / motion.period))
    return out


def decide(seen: Survey, question: Question, names: tuple[str, ...]) -> Choice:
    """The motion that separates the first of some rivals from the others best; () means all.

    Rivals that no motion separates from it stay out of the score, unless all are such.
    """

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
