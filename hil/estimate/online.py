"""Any effect of the catalogue, or a user's own, made ready for the loop as tables.

Nothing is looked up by name: the effect itself is tried.  Which of the loop's quantities it
depends on, and whether it has a memory, shows when rows of a made-up motion are changed and
exchanged; a function of one or two of them becomes a table, fine enough for what lies between
knots.  Presliding has a memory and a kernel of its own.  All others are refused by name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.controllers.compensation import SLIP, TERM, VARIABLES
from hil.estimate.knots import sampled
from hil.estimate.part import Part, refusal
from hil.estimate.probe import ENDS, made_up
from hil.models import catalogue
from hil.models.effect import Effect, terms_of
from hil.models.presliding import Presliding

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Tables:
    """What the loop's kernels take for one arm; see `hil.controllers.compensation`.

    Parameters
    ----------
    terms : ndarray of TERM
        Functions of one or two quantities.
    slips : ndarray of SLIP
        Presliding.
    values : ndarray (n,)
        Torques at the knots [N m].
    """

    terms: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, TERM))
    slips: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, SLIP))
    values: FloatArray = field(default_factory=lambda: np.zeros(1))


def tables(values: Mapping[str, float], span: Sequence[float] = ()) -> Tables:
    """Tables of the effects whose values a model file gives.

    Parameters
    ----------
    values : mapping
        Full name of a parameter, as ``j2.stribeck.fs``, to its value [SI].
    span : sequence of 6 floats, or empty
        Lowest and highest position of each joint that the model was identified on [rad].

    Raises
    ------
    ConfigError
        Naming an effect that the loop cannot evaluate, and why.
    """
    terms: list[Any] = []
    slips: list[Any] = []
    flat: list[FloatArray] = []
    ends = np.reshape(span, (3, 2)) if len(span) else np.tile(ENDS["q"], (3, 1))
    for j, effect, given in _groups(values):
        part = Part(effect, j, *_numbers(effect, j, given), ends, bool(len(span)))
        theta = part.theta
        if isinstance(effect, Presliding):
            if part.shape[0] <= 0.0:
                raise refusal(effect, "its displacement s is not positive")
            if part.shape[1] > 1.0:
                raise refusal(effect, "LuGre's form has no kernel there")
            slips.append((j, part.shape[0], int(part.shape[1] != 0.0), theta[1:4]))
            part = replace(part, theta=np.array([theta[0], 0.0, 0.0, 0.0]))
        axes = part.axes()
        if axes or part.torque(made_up(part.ends)).any():
            sheet = sampled(part, axes)
            rows = [(VARIABLES.index(n), *limits) for n, limits in zip(axes, sheet[1], strict=True)]
            terms.append((j, *(rows + 2 * [(0, 0.0, 1.0, 1)])[:2], sum(x.size for x in flat)))
            flat.append(sheet[0].reshape(-1))
    out = np.concatenate(flat) if flat else np.zeros(1)
    return Tables(np.array(terms, TERM), np.array(slips, SLIP), out)


def _groups(values: Mapping[str, float]) -> list[tuple[int, Effect, dict[str, float]]]:
    """Joint from 0, effect and its values, in the order of the mapping."""
    found: dict[tuple[int, str], dict[str, float]] = {}
    for name, value in values.items():
        words = name.split(".")
        if len(words) != 3 or words[0] not in ("j1", "j2", "j3"):
            effect = catalogue.get(words[-2] if len(words) > 1 else name)
            raise refusal(effect, f"{name} is no parameter of a joint; j1 to j3 are")
        found.setdefault((int(words[0][1]) - 1, words[1]), {})[words[2]] = float(value)
    return [(j, catalogue.get(name), given) for (j, name), given in found.items()]


def _numbers(
    effect: Effect, j: int, given: Mapping[str, float]
) -> tuple[tuple[float, ...], FloatArray]:
    """Shape and coefficients of an effect on joint j, in the order of its columns."""
    motion = made_up(np.tile(ENDS["q"], (3, 1)))
    shapes = [p.name for p in effect.shape]
    names = [p.name for p in terms_of(effect, motion, j)]
    missing = [n for n in (*shapes, *names) if not math.isfinite(given.get(n, math.nan))]
    if missing:
        raise refusal(effect, f"its {', '.join(missing[:6])} on joint {j + 1} are unknown")
    return tuple(given[n] for n in shapes), np.array([given[n] for n in names])
