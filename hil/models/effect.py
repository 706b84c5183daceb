"""One physical effect: an equation, its parameters, and the parts that say how it behaves.

An effect says which effort the motor must supply because of it,

    tau_j = sum_k  theta_k  x_k(motion; shape),

linear in the coefficients theta and non-linear in at most a few *shape* parameters (a speed,
a length, an order, a delay).  Identification eliminates theta and searches the shape.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import ClassVar

import numpy as np

from hil.models.motion import FloatArray, Motion
from hil.models.parts import (
    AT_AN_INSTANT,
    BOUNDS,
    FIXED,
    INF,
    NEVER,
    PER_RUN,
    RELATIVE,
    SOLID,
    STRICT,
    VALUE_DEVIATIONS,
    Doc,
    Fitted,
    Grid,
    Limit,
    Lines,
    Of,
    Over,
    Param,
    Relations,
    Scope,
    Shape,
    Shapes,
    ShapeSearch,
    Sight,
    Trait,
    Twin,
    Variation,
    Waves,
    brakes,
)

__all__ = [
    "AT_AN_INSTANT",
    "BOUNDS",
    "FIXED",
    "INF",
    "NEVER",
    "PER_RUN",
    "RELATIVE",
    "RIPPLES",
    "SOLID",
    "STRICT",
    "VALUE_DEVIATIONS",
    "Doc",
    "Effect",
    "Fitted",
    "Grid",
    "Limit",
    "Lines",
    "Of",
    "Over",
    "Param",
    "Relations",
    "Scope",
    "Shape",
    "ShapeSearch",
    "Shapes",
    "Sight",
    "Trait",
    "Twin",
    "Variation",
    "Waves",
    "alone",
    "are_twins",
    "brakes",
    "broken",
    "instants",
    "log_grid",
    "motor_inertias",
    "position_orders",
    "refused",
    "strict",
    "terms_of",
    "turning_orders",
    "typical_speed",
]


class Effect(ABC):
    """Base class of every effect, built in or a user's own.

    A subclass states its name, family, documentation and parameters and writes `columns`; with
    shape parameters also `search`.  All else has a default that most effects keep.

    Attributes
    ----------
    name : str
        Name in the catalogue.
    family : str
        ``friction``, ``actuator``, ``mass``, ``stiffness``, ``transmission``, ``contact``,
        ``sensor``, ``structure``.
    doc : Doc
        For people: what it is, how it shows, what it is mistaken for, which motion shows it.
    params : tuple of Param
        The linear coefficients, one a column.
    shape : tuple of Param
        The non-linear parameters.
    scope : Scope
        What it belongs to (joint, robot, tip), which effort it is part of, what it needs.
    variation : Variation
        How its coefficients vary between runs: `NEVER`, `PER_RUN`, `RELATIVE`, `AT_AN_INSTANT`.
    relations : Relations
        What it is to others: what it replaces, its twins, its limit, its causes, its foils.
    search : Search
        How its shape is found: `FIXED`, `Grid`, `Waves` over position, `Lines` in time.
    limits : tuple of Limit
        What values that fit must meet to be physics.
    traits : Trait
        What shared code has to know of it, whatever its name.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    doc: ClassVar[Doc]
    params: ClassVar[tuple[Param, ...]] = ()
    shape: ClassVar[tuple[Param, ...]] = ()
    scope: ClassVar[Scope] = Scope()
    variation: ClassVar[Variation] = NEVER
    relations: ClassVar[Relations] = Relations()
    search: ClassVar[ShapeSearch] = FIXED
    limits: ClassVar[tuple[Limit, ...]] = (BOUNDS,)
    traits: ClassVar[Trait] = Trait.NONE

    @abstractmethod
    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort of unit coefficients on joint j.

        Parameters
        ----------
        motion : Motion
            The run.
        j : int
            Joint index (ignored by effects of the whole robot).
        shape : sequence of float
            Values of the shape parameters, in the order of `shape`.

        Returns
        -------
        ndarray (n, m), or (n, d, m) where `scope` is not one joint
        """


# ------------------------------------------------------------ questions to an effect


def terms_of(effect: Effect, motion: Motion, j: int) -> tuple[Param, ...]:
    """Coefficients of an effect for joint j of a motion's robot."""
    made = effect.scope.terms
    return effect.params if made is None else made(motion, j)


def strict(effect: Effect) -> bool:
    """Whether the search keeps all coefficients within their bounds."""
    return any(limit.strict for limit in effect.limits)


def refused(
    effect: Effect,
    motion: Motion,
    j: int,
    shape: Sequence[float],
    beta: Sequence[float],
    error: Sequence[float] = (),
) -> str:
    """Code of the first limit that values break; empty where they can be physics.

    Parameters
    ----------
    effect : Effect
        The effect.
    motion, j, shape, beta, error
        As of `Fitted`.
    """
    limit = broken(effect, Fitted(effect, motion, j, shape, beta, error))
    return "" if limit is None else limit.code


def continuous(effect: Effect) -> bool:
    """Whether the first shape value of an effect is sought between the places of its grid, too."""
    return effect.search.refine and bool(effect.shape) and not effect.shape[0].choice


def broken(effect: Effect, values: Fitted) -> Limit | None:
    """The first limit that values break; None where they can be physics."""
    return next((limit for limit in effect.limits if not limit.met(values)), None)


@cache
def alone(effect: Effect) -> Effect:
    """An effect that all joints feel, as its own joint feels it: columns (n, m)."""

    def columns(self: Effect, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        own: FloatArray = effect.columns(motion.of_one(), j, shape)[:, j]
        return own

    scope = replace(effect.scope, of=Of.JOINT, sought_alone=False)
    named = {"name": f"{effect.name} alone", "scope": scope, "columns": columns}
    made: Effect = type("Alone", (type(effect),), named)()
    return made


def are_twins(a: Effect, b: Effect, motion: Motion) -> bool:
    """Whether two effects have the same columns on such data."""
    return any(
        t.name == other.name and t.when(motion)
        for one, other in ((a, b), (b, a))
        for t in one.relations.twins
    )


# ------------------------------------------------------------ for grids


#: Ratios of a gear or a pulley that are tried once a joint is found, and steps about a found one.
RATIOS = (0.1, 0.15, 0.22, 0.33, 0.5, 0.7, 1.4, 2.0, 3.0, 4.5, 6.7, 10.0)
FINER = (0.75, 0.85, 0.92, 0.96, 0.98, 0.99, 1.01, 1.02, 1.04, 1.08, 1.17, 1.33)


def even_ratio(motion: Motion, j: int, k: int) -> float:
    """Ratio r at which v_j and r v_k are alike: 1, or between a turn and a slide that of speeds."""
    units = motion.robot.units
    if units[j] == units[k]:
        return 1.0
    return float(f"{typical_speed(motion, j) / typical_speed(motion, k):.2g}")


def other_ratios(r: float, even: float) -> list[float]:
    """Ratios that are worth trying beside one: of all sizes beside the even one, else near it."""
    if abs(r) == even:
        return [even * x * s for x in RATIOS for s in (1.0, -1.0)]
    return [x * r for x in FINER]


#: Shares of a joint's inertia that may be its motor's.
_PARTS = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0)


def motor_inertias(motion: Motion, j: int, own: float) -> list[float]:
    """Inertias of the motor within the model's masses that are worth trying beside one.

    Of all sizes beside none, else near it.
    """
    if motion.response is None:
        return []
    size = float(np.mean(motion.response.inertia[:, j, j]))
    return [own * x for x in FINER] if own else [s * size * x for x in _PARTS for s in (1, -1)]


def one_joint(motion: Motion, j: int) -> str:
    """Why an effect of two joints cannot be tried; empty where there are two."""
    return "" if motion.d > 1 else "the robot has one joint"


def log_grid(low: float, high: float, count: int) -> Shapes:
    """`count` logarithmically spaced one-parameter shapes from low to high."""
    return [(float(x),) for x in np.geomspace(low, max(high, low * 1.001), count)]


#: Instants of a run at which what happens once is sought; a climb follows.  Half: two loads
#: of a run lie between the same two; double: twice the time, and the climb finds the same one.
_INSTANTS = 15


def instants(length: float) -> list[float]:
    """Instants from 5 to 95 % of a run of some length [s]."""
    return [float(t) for t in np.linspace(0.05, 0.95, _INSTANTS) * length]


def typical_speed(motion: Motion, j: int) -> float:
    """Root mean square speed of joint j, never zero [rad/s or m/s]."""
    return max(float(np.sqrt(np.mean(motion.qd[:, j] ** 2))), 1e-9)


# ------------------------------------------------------------ waves over the position

#: Highest order of a motor's or gear's waves that is sought, in periods a turn of the joint.  Half:
#: motors of 14 poles behind small gears go unnamed on axes that turn on; double: the search takes
#: longer, and what is found lies beyond the band of most efforts.
TURN_ORDER = 100
#: Turns of a slide's screw over the recorded range that are sought.  Half: a screw of 5 mm over a
#: metre goes unnamed; double: twice the time, and finer threads than are built.
SCREW_TURNS = 200.0


def position_orders(
    motion: Motion, j: int, highest: float = 60.0, lowest: float = 1.5, motor: bool = False
) -> Shapes:
    """Wave numbers [periods per rad or m]: `lowest` to `highest` over the span in steps of 0.5.

    `motor`: also of what drives the joint, beyond that: of an axis that turns what comes as a whole
    number of times a turn, of a slide `SCREW_TURNS` turns of a screw.
    """
    low, high = motion.span[j]
    length, turns = max(float(high - low), 1e-9), motion.robot.units[j] == "rad"
    most = highest if turns or not motor else SCREW_TURNS
    orders = [float(k) / length for k in np.arange(lowest, most + 0.25, 0.5)]
    if motor and turns:
        whole = np.arange(1, TURN_ORDER + 1) / (2 * np.pi)
        orders += [float(p) for p in whole if p * length > highest + 0.5]
    return [(p,) for p in orders]


def turning_orders(motion: Motion, j: int, highest: float, lowest: float) -> Shapes:
    """Those of `position_orders`; of an axis that turns as far, once and twice a turn, too."""
    over = position_orders(motion, j, highest, lowest)
    turn = 1 / (2 * np.pi)
    turns = over[0][0] <= turn and motion.robot.units[j] == "rad"
    return sorted({*over, (turn,), (2 * turn,)}) if turns else over


def _ripple_grid(motion: Motion, j: int) -> Shapes:
    """Every half order over the span, and those of the motor's turns."""
    return position_orders(motion, j, motor=True)


def _ripple_carrier(motion: Motion, j: int) -> FloatArray:
    """1."""
    return np.ones(motion.n)


#: Search of a wave over the position that depends on nothing else.
RIPPLES = Waves(_ripple_grid, carrier=_ripple_carrier)


class Correction(Effect):
    """Base of the corrections: a free function of some variables of the recording."""

    family = "correction"
    scope = Scope(explains=("motor", "external"))
    traits = Trait.GIVEN | Trait.CORRECTION
