"""Standard errors of all shape values, for what is printed.

`spread` counts the first shape value of a term, by which the search goes.  An exponent, a damping
ratio or a sign resolution that was picked beside it is as uncertain, and widens what trades off
with it.  With J the derivatives by all of them, beside the free coefficients,

    var = sandwich of [X, J] over blocks of time  +  d^2,

d the Gauss-Newton step that is left to the joint optimum: a value that was picked from a few is
not at it.  Nothing is fitted again, and no verdict rests on these errors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term, prefix
from hil.identify.fit import derivative, end_of_range, searched
from hil.identify.regression import Basis, basis, cluster_covariance, extended, time_blocks
from hil.identify.result import FitResult
from hil.identify.solve import noise_to_signal
from hil.models.model import RobotModel, Value

FloatArray = NDArray[np.float64]
#: Multiple of a shape value from which its error says only that nothing is known of it.
OPEN = 10.0
#: A shape value: number of its term, and which of the term's shape values it is.
Place = tuple[int, int]


def complete(result: FitResult) -> FitResult:
    """The same fit with standard errors of every shape value that is a quantity."""
    places = _quantities(result)
    if all(i == 0 for _, i in places):
        return result
    free = np.array([not result.values[n].at_bound for n in result.names])
    stderr, known = _errors(result, free, places)
    count = int(free.sum())
    names = [n for n, ok in zip(result.names, free, strict=True) if ok]
    pairs = zip(names, stderr[:count].tolist(), strict=True)
    new = {n: _wider(result.values[n], e) for n, e in pairs}
    for place, e, ok in zip(places, stderr[count:], known[count:], strict=True):
        name = _name(result, place)
        new[name] = _wider(result.values[name], float(e) if ok else float("nan"), place[1] > 0)
    return replace(result, values=result.values | new, model=_renewed(result.model, new))


def _quantities(result: FitResult) -> list[Place]:
    """Shape values that are quantities, of terms that do anything, away from the range's ends."""
    out = []
    for k, (t, where) in enumerate(zip(result.terms, result.slices, strict=True)):
        if t.fixed or t.fixed_shape or not np.any(result.theta[where]):
            continue
        for i, (p, value) in enumerate(zip(t.effect.shape, t.shape, strict=True)):
            if not p.choice and value and (i > 0 or _inside(result, t)):
                out.append((k, i))
    return out


def _inside(result: FitResult, t: Term) -> bool:
    return searched(result.problem, t) and not end_of_range(result.problem, t)


def _name(result: FitResult, place: Place) -> str:
    term = result.terms[place[0]]
    return f"{prefix(term, result.problem.joints)}.{term.effect.shape[place[1]].name}"


def _errors(
    result: FitResult, free: NDArray[np.bool_], places: list[Place]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Errors of the free coefficients and of shape values, and whether the data determine them."""
    problem, sigma = result.problem, result.sigma
    least = noise_to_signal(problem.y / sigma[:, None])
    x = basis(result.x[:, free] * np.repeat(1.0 / sigma, problem.n)[:, None], least)
    columns = [derivative(problem, result.terms, result.theta, result.slices, *p) for p in places]
    j = np.stack([(c / sigma[:, None]).reshape(-1) for c in columns], axis=1)
    r = (result.residual / sigma[:, None]).reshape(-1)
    b = extended(x, j, least)
    blocks = np.tile(time_blocks(problem), problem.d)
    variance = np.diag(cluster_covariance(r, b, blocks))
    step = _step(result, x, j, r, places, least)
    return np.sqrt(variance + step**2), b.identifiable()


def _step(
    result: FitResult, x: Basis, j: FloatArray, r: FloatArray, places: list[Place], least: float
) -> FloatArray:
    """Gauss-Newton step to the joint optimum; a shape value on its bound does not go beyond."""
    count, inside = x.scale.size, np.ones(len(places), dtype=bool)
    for _ in range(len(places) + 1):
        b = extended(x, j * inside, least)
        step = b.solve(r, np.zeros(b.scale.size), np.zeros(r.size))
        beyond = [
            inside[n] and not _allowed(result, p, float(step[count + n]))
            for n, p in enumerate(places)
        ]
        if not any(beyond):
            break
        inside &= ~np.array(beyond)
    return step


def _allowed(result: FitResult, place: Place, step: float) -> bool:
    """Whether a shape value that moves by `step` stays within its bounds."""
    k, i = place
    p, value = result.terms[k].effect.shape[i], result.terms[k].shape[i]
    return p.lower <= value + step <= p.upper


def _wider(v: Value, stderr: float, own: bool = False) -> Value:
    """The value with an error that is no smaller than the one it had; `own`: it had none."""
    if own:
        size = min(OPEN * abs(v.value), v.upper - v.lower)
        return replace(v, stderr=stderr if stderr < size else float("nan"))
    return replace(v, stderr=max(v.stderr, stderr)) if v.stderr == v.stderr else v


def _renewed(model: RobotModel, new: dict[str, Value]) -> RobotModel:
    """The model with these values in place of its own."""
    effects = tuple(
        replace(u, values={n: new.get(n, v) for n, v in u.values.items()}) for u in model.effects
    )
    return replace(model, effects=effects)
