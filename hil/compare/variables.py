"""Which variable shows an effect best, and what the fitted effect contributes to the effort."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.compare.learnt import Learnt
from hil.identify.design import Term
from hil.identify.result import FitResult
from hil.models.contact import penetration

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Variable:
    """What an effect is drawn against.

    Parameters
    ----------
    x : ndarray (n,)
        Values.
    label : str
        Axis label with unit.
    edges : ndarray
        Bins for averages.
    split : ndarray (n,) of bool or None
        Two groups that the effect treats differently.
    groups : tuple of str
        Their names, first that of ``split`` true.
    sign : ndarray (n,) or None
        Effort is multiplied by it, e.g. the direction of motion.
    log : bool
        Logarithmic axis.
    """

    x: FloatArray
    label: str
    edges: FloatArray
    split: BoolArray | None = None
    groups: tuple[str, str] = ("forward", "backward")
    sign: FloatArray | None = None
    log: bool = False


def variable_of(result: FitResult, fit: Learnt) -> Variable:
    """The variable that suits the effect; for a user's effect the one that orders it best."""
    chosen = CHOICE.get(fit.term.effect.name)
    if chosen is not None:
        return chosen(result, fit)
    options = [speed(result, fit), position(result, fit), load(result, fit)]
    return max(options, key=lambda v: _ordered(v, fit.effort))


def _ordered(v: Variable, effort: FloatArray) -> float:
    """Share of the effort's variance that lies between the bins of a variable."""
    where = np.digitize(v.x, v.edges)
    count = np.maximum(np.bincount(where), 1)
    mean = np.bincount(where, effort) / count
    return float(1 - np.mean((effort - mean[where]) ** 2) / max(float(np.var(effort)), 1e-300))


def _unit(result: FitResult, j: int) -> str:
    return result.problem.robot.units[j]


def dense_at_zero(x: FloatArray, count: int = 41) -> FloatArray:
    """Bins over a signed variable, narrow near zero where friction changes fastest."""
    top = max(float(np.quantile(np.abs(x), 0.998)), 1e-12)
    u = np.linspace(-1, 1, count)
    edges: FloatArray = top * np.sign(u) * u**2
    return edges


def _even(x: FloatArray, count: int) -> FloatArray:
    low, high = np.quantile(x, [0.001, 0.999])
    return np.linspace(low, max(high, low + 1e-12), count + 1)


def speed(result: FitResult, fit: Learnt) -> Variable:
    """Own speed."""
    x, j = result.problem.qd[fit.joint], fit.joint
    return Variable(
        x, f"speed of {result.problem.joints[j]} [{_unit(result, j)}/s]", dense_at_zero(x)
    )


def _direction(result: FitResult, j: int) -> BoolArray:
    forward: BoolArray = result.problem.qd[j] > 0
    return forward


def position(result: FitResult, fit: Learnt) -> Variable:
    """Own position; bins fine enough for the effect's period where it has one."""
    x, j = result.problem.q[fit.joint], fit.joint
    periods = fit.term.shape[0] * float(np.ptp(x)) if _periodic(fit.term) else 4.0
    edges = _even(x, int(np.clip(12 * periods, 40, 300)))
    label = f"position of {result.problem.joints[j]} [{_unit(result, j)}]"
    split = _direction(result, j) if fit.term.effect.name == "position-friction" else None
    return Variable(x, label, edges, split)


def _periodic(term: Term) -> bool:
    return [p.name for p in term.effect.shape] == ["p"] and term.shape[0] > 0


def phase(result: FitResult, fit: Learnt) -> Variable | None:
    """Position within one period of a periodic effect; None for the others."""
    if not _periodic(fit.term):
        return None
    j, length = fit.joint, 1 / fit.term.shape[0]
    x = np.mod(result.problem.q[j], length)
    label = f"position within one period of {length:.3g} {_unit(result, j)} [{_unit(result, j)}]"
    v = position(result, fit)
    return Variable(x, label, np.linspace(0, length, 25), v.split)


def load(result: FitResult, fit: Learnt) -> Variable:
    """Transmitted load."""
    problem, j = result.problem, fit.joint
    x = problem.filtered([m.load for m in problem.motions])[:, j]
    split = _direction(result, j) if fit.term.effect.family == "friction" else None
    unit = "N" if _unit(result, j) == "m" else "N m"
    return Variable(x, f"load on {problem.joints[j]} [{unit}]", _even(x, 40), split)


def other_speed(result: FitResult, fit: Learnt) -> Variable:
    """Speed of the other joint, alone or combined with the own one."""
    problem, j = result.problem, fit.term.joint
    k, mode = int(fit.term.shape[0]) - 1, float(fit.term.shape[1])
    own, other = problem.joints[j], problem.joints[k]
    unit = f"[{_unit(result, k)}/s]"
    if fit.term.effect.name == "coupled-transmission":
        x, sign = problem.qd[j] + mode * problem.qd[k], "+" if mode > 0 else "\u2212"
        return Variable(
            x, f"speed of {own} {sign} {abs(mode):g} x speed of {other} {unit}", dense_at_zero(x)
        )
    if not mode:
        return Variable(problem.qd[k], f"speed of {other} {unit}", dense_at_zero(problem.qd[k]))
    x, sign = problem.qd[j] + mode * problem.qd[k], "+" if mode > 0 else "\u2212"
    return Variable(x, f"speed of {own} {sign} speed of {other} {unit}", dense_at_zero(x))


def depth(result: FitResult, fit: Learnt) -> Variable:
    """Penetration; pressing and releasing apart."""
    problem, j = result.problem, fit.joint
    if not np.isfinite(problem.motions[0].contact[j]).all():
        return position(result, fit)
    parts = [penetration(m, j)[0][:, None] for m in problem.motions]
    x, side = problem.filtered(parts)[:, 0], float(problem.motions[0].contact[j, 1])
    edges = np.linspace(0, max(float(x.max()), 1e-12), 19)
    edges[0] = 0.01 * edges[-1]
    split = side * problem.qd[j] > 0
    return Variable(x, f"penetration [{_unit(result, j)}]", edges, split, ("pressing", "releasing"))


def reversals(result: FitResult, j: int) -> tuple[FloatArray, NDArray[np.int_]]:
    """Direction of motion and instant of the last reversal, for every instant.

    A reversal counts when the speed exceeds its resolution again; it took place where the
    speed last had the old sign.
    """
    problem = result.problem
    v, v0 = problem.qd[j], float(problem.motions[0].v0[j])
    direction, start = np.sign(v), np.zeros(v.size, dtype=int)
    begin, now = 0, 0.0
    for k in range(v.size):
        if k and problem.run[k] != problem.run[k - 1]:
            begin, now = k, 0.0
        if abs(v[k]) > v0 and np.sign(v[k]) != now:
            new = float(np.sign(v[k]))
            first = k
            while first > begin and np.sign(v[first - 1]) == new:
                first -= 1
            begin, now = first, new
            direction[first:k], start[first:k] = now, first
        direction[k], start[k] = now or direction[k], begin
    return direction, start


def displacement(result: FitResult, fit: Learnt) -> Variable:
    """Displacement since the last reversal, effort along the motion; logarithmic."""
    problem, j = result.problem, fit.joint
    q, direction, start = problem.q[j], *reversals(result, j)
    x = np.abs(q - q[start])
    low = max(float(fit.term.shape[0]), 1e-3 * float(x.max()), 1e-12)
    edges = np.geomspace(low, max(float(x.max()), 2 * low), 25)
    label = f"displacement since reversal [{_unit(result, j)}]"
    return Variable(np.where(x < low, np.nan, x), label, edges, sign=direction, log=True)


def effort_rate(result: FitResult, fit: Learnt) -> Variable:
    """Rate of change of the motor effort."""
    problem, j = result.problem, fit.joint
    x = problem.filtered([np.gradient(m.tau[:, j], m.dt)[:, None] for m in problem.motions])[:, 0]
    unit = "N/s" if _unit(result, j) == "m" else "N m/s"
    return Variable(x, f"rate of the motor effort [{unit}]", dense_at_zero(x, 31))


def elapsed(result: FitResult, fit: Learnt) -> Variable:
    """Time since the start of the run; friction along the motion."""
    problem, j = result.problem, fit.joint
    along = fit.term.effect.family == "friction"
    sign = np.sign(problem.qd[j]) if along else None
    return Variable(
        problem.t, "time since the start of the run [s]", _even(problem.t, 40), sign=sign
    )


def turn(result: FitResult, fit: Learnt) -> Variable:
    """Time within one period of a disturbance, of the longest run."""
    problem, length = result.problem, 1.0 / max(float(fit.term.shape[0]), 1e-9)
    run = np.argmax(np.bincount(problem.run))
    x = np.where(problem.run == run, np.mod(problem.t, length), np.nan)
    label = f"time within one period of {length:.3g} s [s]"
    return Variable(x, label, np.linspace(0, length, 25))


CHOICE: dict[str, Callable[[FitResult, Learnt], Variable]] = {
    **dict.fromkeys(
        ("coulomb", "viscous", "stribeck", "asymmetric-coulomb", "asymmetric-viscous",
         "quadratic-drag"), speed,
    ),
    **dict.fromkeys(
        ("position-friction", "cogging", "position-torque", "spring", "end-stop",
         "contact-stiffness"), position,
    ),
    **dict.fromkeys(("contact-damping", "contact-hardening", "contact-hysteresis"), depth),
    **dict.fromkeys(("load-friction", "torque-gain"), load),
    **dict.fromkeys(("coupled-friction", "coupled-transmission"), other_speed),
    **dict.fromkeys(("friction-drift", "force-drift", "missed-counts"), elapsed),
    "contact-inclusion": depth,
    "periodic-disturbance": turn,
    "presliding": displacement,
    "delay": effort_rate,
    "filter-lag": effort_rate,
}  # fmt: skip
