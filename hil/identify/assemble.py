"""The result of a fit: values with errors, bounds and identifiability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term, coefficients, prefix
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.identify.solve import prior, solve
from hil.identify.spread import ShapeError, spread
from hil.identify.validity import identified
from hil.models.model import RobotModel, Use, Value

FloatArray = NDArray[np.float64]


def assemble(
    problem: Problem, model: RobotModel, terms: list[Term], sigma: FloatArray
) -> FitResult:
    """Final solution with errors, bounds and identifiability."""
    theta, x, b, slices, residual = solve(problem, terms, model, sigma)
    found = spread(problem, terms, theta, slices, b, residual, sigma)
    # what no row sees stays at the prior; lying on a bound there says nothing
    seen = np.linalg.norm(b.v, axis=1) > 1e-9
    values: dict[str, Value] = {}
    uses: dict[int, dict[str, Value]] = {}
    source = "fit of " + ", ".join(r.name for r in problem.recordings)
    for t, where, shapes in zip(terms, slices, found.shapes, strict=True):
        part = _linear(
            problem, t, theta[where], found.stderr[where], found.known[where], seen[where], source
        )
        part |= _shapes(problem, t, shapes, source)
        values |= part
        uses.setdefault(t.use, {}).update(part)
    effects = tuple(
        Use(u.type, u.joints, u.options, uses.get(k, {})) for k, u in enumerate(model.effects)
    )
    names = [n for t in terms for n, _ in coefficients(t, problem)]
    return FitResult(
        replace(model, effects=effects, valid=identified(problem)), problem, terms, theta, names,
        values, residual, sigma, b, prior(problem, terms, model, names), x, slices,
    )  # fmt: skip


def _linear(
    problem: Problem, term: Term, theta: FloatArray, stderr: FloatArray,
    known: NDArray[np.bool_], seen: NDArray[np.bool_], source: str,
) -> dict[str, Value]:  # fmt: skip
    """Coefficients of a term."""
    out: dict[str, Value] = {}
    named = coefficients(term, problem)
    rows = zip(named, theta, stderr, known, seen, strict=True)
    for (name, p), value, err, ok, moves in rows:
        out[name] = Value(
            float(value),
            float(err) if ok and not term.fixed else float("nan"),
            in_units(p.unit, problem, term.joint), p.lower, p.upper,
            at_bound=bool(moves and (value <= p.lower or value >= p.upper)),
            identifiable=bool(ok) or term.fixed,
            source="given" if term.fixed else source,
        )  # fmt: skip
    return out


def _shapes(
    problem: Problem, term: Term, found: Sequence[ShapeError], source: str
) -> dict[str, Value]:
    """Shape values of a term."""
    head = prefix(term, problem.joints)
    return {
        f"{head}.{p.name}": Value(
            float(value), error.stderr, in_units(p.unit, problem, term.joint), p.lower, p.upper,
            error.at_bound, error.identifiable, source,
        )
        for p, value, error in zip(term.effect.shape, term.shape, found, strict=True)
    }  # fmt: skip


def in_units(unit: str, problem: Problem, j: int) -> str:
    """A unit with joint j's own for {F} and {x}, e.g. N s/m for {F} s/{x}."""
    linear = problem.robot.units[j] == "m"
    return unit.replace("{F}", "N" if linear else "N m").replace("{x}", "m" if linear else "rad")
