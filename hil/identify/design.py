"""From a model to a stacked regressor: bound terms and their columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.effect import Effect, Param, Trait, terms_of
from hil.models.model import RobotModel, Use, Value
from hil.models.parts import JOINT

FloatArray = NDArray[np.float64]
#: Effect and joint.
Key = tuple[str, int]
OPTIONS = ("per_run", "fixed", "fixed_shape")


@dataclass(frozen=True)
class Term:
    """One effect on one joint (or on the whole robot, then `joint` is its first joint or 0).

    Parameters
    ----------
    effect : Effect
        The physics.
    joint : int
        Joint index.
    shape : tuple of float
        Current shape values; empty where the effect has none.
    per_run, fixed, fixed_shape : bool
        Own coefficients for every run; coefficients, or shape, kept at the model's values.
    use : int
        Index of the model's `Use` it belongs to.
    """

    effect: Effect
    joint: int
    shape: tuple[float, ...] = ()
    per_run: bool = False
    fixed: bool = False
    fixed_shape: bool = False
    use: int = -1

    @property
    def key(self) -> Key:
        """Effect name and joint."""
        return self.effect.name, self.joint

    @property
    def other(self) -> int:
        """The joint that its shape names, counted from 0; its own where it names none."""
        named = zip(self.effect.shape, self.shape, strict=False)
        return next((int(x) - 1 for p, x in named if p.name == JOINT and x > 0), self.joint)

    @property
    def first(self) -> int:
        """First run with coefficients: the second of differences, unless they are given values."""
        return int(self.effect.variation.relative and not self.fixed)

    def reshaped(self, shape: tuple[float, ...]) -> Term:
        """Copy with other shape values."""
        return replace(self, shape=shape)


def replaced(term: Term) -> set[Key]:
    """Effects of its joint that a term takes the place of.

    Values of every run take that of one value for all.
    """
    gone = {(name, term.joint) for name in term.effect.relations.replaces}
    return gone | {term.key} if term.per_run and not term.effect.variation.relative else gone


def comes_back(term: Term, model: RobotModel, joints: Sequence[str]) -> bool:
    """Whether a model holds what a term takes the place of, and has it again without the term."""
    gone = replaced(term)
    rest = [u for u in model.effects if u.type != term.effect.name or not u.options.get("per_run")]
    there = [(u, j) for u in rest for name, j in gone if u.type == name]
    return any(u.joints == ("*",) or joints[j] in u.joints for u, j in there)


def head(effect: Effect, j: int) -> str:
    """Start of the full names of an effect's parameters on joint j."""
    return effect.name if effect.scope.of_robot else f"j{j + 1}.{effect.name}"


def prefix(term: Term, joints: tuple[str, ...]) -> str:
    """Start of the full name of a term's parameters, e.g. ``j2.stribeck``."""
    return head(term.effect, term.joint)


def coefficients(term: Term, problem: Problem) -> list[tuple[str, Param]]:
    """Full names and declarations of a term's linear coefficients, one a column."""
    start = prefix(term, problem.joints)
    params = terms_of(term.effect, problem.motions[0], term.joint)
    if not term.per_run:
        named = ((f"{start}.{p.name}", p) for p in params)
        bound = problem.positive
        return [(n, replace(p, lower=max(p.lower, 0.0)) if n in bound else p) for n, p in named]
    firsts = np.unique(problem.whole, return_index=True)[1]
    names = [problem.recordings[k].name for k in firsts][term.first :]
    return [(f"{start}.{p.name}[{run}]", p) for run in names for p in params]


def by_run(term: Term, theta: FloatArray, runs: int) -> FloatArray:
    """Coefficients (runs, m) of a term with its own ones in every run."""
    first = term.first
    each = theta.reshape(runs - first, -1) if runs > first else np.zeros((0, theta.size))
    return np.concatenate([np.zeros((first, each.shape[1])), each])


def bind(model: RobotModel, problem: Problem) -> list[Term]:
    """Terms of a model for the joints of a problem.

    Effects that cannot act on this robot (a rotor inertia beside an axis' only inertia) are
    left out, and so are joints without anything to try (the last one of a coupled pair) and
    differences between runs where there is one run; an effect that another one replaces on a joint
    is left out there, and so is one value for all runs beside those of every run.

    Raises
    ------
    ConfigError
        For an unknown joint, or an effect that explains another kind of effort.
    """
    model.check_joints(problem.joints)
    motion = problem.motions[0]
    terms: list[Term] = []
    for index, use in enumerate(model.effects):
        effect = catalogue.get(use.type)
        if model.explains not in (efforts := effect.scope.explains):
            raise ConfigError(
                f"effect {use.type!r} explains {' and '.join(efforts)} effort, but the "
                f"model explains {model.explains!r} effort; set robot.explains or remove it"
            )
        joints = _joints(use, effect, problem)
        if use.joints == ("*",) and any(effect.search.grid(motion, j) for j in joints):
            joints = [j for j in joints if effect.search.grid(motion, j)]
        for j in joints:
            if effect.scope.lacks(motion, j) and Trait.GIVEN in effect.traits:
                continue
            options = {k: bool(use.options.get(k, False)) for k in OPTIONS}
            term = Term(effect, j, stored_shape(use, effect, j, problem), use=index, **options)
            if term.per_run and term.first >= problem.runs:
                continue  # one run alone shows no difference between runs
            terms.append(term)
    return [t for t in terms if not any(t.key in replaced(x) for x in terms if x is not t)]


def _joints(use: Use, effect: Effect, problem: Problem) -> list[int]:
    if effect.scope.of_robot:
        return [0]
    if use.joints == ("*",):
        return list(range(problem.d))
    for name in use.joints:
        if name not in problem.joints:
            raise ConfigError(unknown("joint", name, problem.joints))
    return [problem.joints.index(name) for name in use.joints]


def stored_shape(use: Use, effect: Effect, j: int, problem: Problem) -> tuple[float, ...]:
    """Shape values that the model file holds for joint j, else an empty tuple (= search)."""
    found = {p.name: use.values.get(f"{head(effect, j)}.{p.name}") for p in effect.shape}
    values = [p.usual if (v := found[p.name]) is None else v.value for p in effect.shape]
    said = [x for x in values if x is not None]
    any_said = any(v is not None for v in found.values())
    return tuple(said) if any_said and len(said) == len(values) else ()


def block(problem: Problem, term: Term) -> FloatArray:
    """Columns of a term on the rows of its joint (n, m), or of all joints (d, n, m)."""
    return problem.columns(term.effect, term.joint, term.shape, term.per_run, every=term.fixed)


def stack(problem: Problem, terms: list[Term]) -> tuple[FloatArray, list[slice]]:
    """Regressor X (d n, p) of all terms, and each term's columns in it."""
    blocks = [block(problem, t) for t in terms]
    widths = [b.shape[-1] for b in blocks]
    edges = np.concatenate([[0], np.cumsum(widths)]).astype(int)
    x = np.zeros((problem.d, problem.n, int(edges[-1])))
    slices = [slice(int(a), int(b)) for a, b in pairwise(edges)]
    for term, values, where in zip(terms, blocks, slices, strict=True):
        if values.ndim == 3:
            x[:, :, where] = values
        else:
            x[term.joint, :, where] = values
    return x.reshape(problem.d * problem.n, -1), slices


def known_values(model: RobotModel, names: list[str]) -> FloatArray:
    """Values that the model holds for parameters, NaN where it holds none."""
    values: dict[str, Value] = model.values()
    return np.array([values[n].value if n in values else np.nan for n in names])
