"""Coefficients of bound terms: weighted least squares within the parameters' bounds.

Least squares within bounds, on a problem that is already reduced to p columns.

From the unbounded solution theta_0 the squared residual grows by |R (theta - theta_0)|^2 with
R = S V' D, so the N rows of the regressor are not needed again.

Basis of a model's regressor from the factors of its joints, most of them made once.

The rows of joint j hold few of all columns.  With X_j = Q_j R_j for each joint,

    X = diag(Q_1 .. Q_d) [R_1; ..; R_d],

so the N rows are needed for the few columns that have changed, and scales by joint only weigh the
small R_j.  What depends on the motion alone is factored once for a problem.

The robot's description is a prior of the masses: how far to trust it is learnt from the data.

Runs that are short or move little leave combinations of masses, centres and inertias to the noise;
a least-squares fit then foretells another motion badly.  Here the bodies P_i of the fit are drawn
towards those of the description, P_i0 (pseudo-inertias, 4 x 4), with

    |R (pi - pi_0)|^2 = sum_i tr((P_i0^-1 (P_i - P_i0))^2) / 2,

which is the squared relative change and does not depend on frames or units, and prior

    pi ~ N(pi_0, rho^2 (R'R)^-1).

The relative error rho of the description is where the marginal likelihood of the efforts is
largest: a description that the data contradict is hardly used, and what the data determine hardly
moves.  Noise that is coloured counts as the independent instants that it is worth.  It serves only
where contiguous parts that were left out are foretold clearly better with it.

What no effort of the runs depends on is the description's in any case: of all bodies with the same
efforts those are taken that are nearest to it in this metric.  In the metric of efforts, that of
least squares of least norm, a link of 60 kg near an axis would be as near as a small inertia about
it; and an effort that these runs do not show, of gravity from another side, would be made of it.

Source: Lee, Wensing, Park, IEEE Trans. Robotics 36(1), 2020 (the metric); MacKay, Neural
Computation 4, 1992 (the evidence).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from hil.errors import DataError, FitError
from hil.identify.design import Term, block, coefficients, known_values, stack
from hil.identify.problem import Problem
from hil.identify.regression import (
    Basis,
    Nearness,
    basis,
    decomposed,
    inflation,
    least_squares,
    of_factors,
)
from hil.models.bodies import pseudo_inertia
from hil.models.effect import Trait
from hil.models.model import RobotModel

FloatArray = NDArray[np.float64]
#: Relative errors of a description that are tried: as well as a body can be drawn and weighed, to
#: worth nothing.
ERRORS = np.geomspace(1e-2, 1e2, 41)
#: Least second moments of a body along its main axes, in shares of their sum: a rod or a plate of
#: a description is not known to be infinitely thin.
THIN = 0.01
#: Contiguous parts of a recording that are left out in turn.  Fewer: less data for each fit; more:
#: parts that lie close to what was fitted.
PARTS = 8
#: Least fall of the rms error of parts left out for which a description counts: what an effect must
#: bring, too.  Half: rich recordings are drawn by descriptions that they need not; double: short
#: ones keep what noise says of their masses.
WORTH = 0.03
#: Share of a posterior variance from which a value is said to come of the description.
MOSTLY = 0.5
#: What the source of a fitted value that is the description's says.
DESCRIBED = "robot description"


@dataclass(frozen=True)
class Pull:
    """What draws coefficients towards the description.

    Parameters
    ----------
    rows : ndarray (m, p)
        Rows L beside the weighted regressor: |L (theta - centre)|^2 is added to the squares.
    centre : ndarray (p,)
        Values of the description; zero where it says nothing.
    error : float
        Relative error rho that the data ascribe to the description.
    """

    rows: FloatArray
    centre: FloatArray
    error: float

    def precision(self, where: slice) -> FloatArray:
        """L'L of some coefficients (m, m)."""
        own = self.rows[:, where]
        return np.asarray(own.T @ own)

    def said(self, b: Basis) -> NDArray[np.bool_]:
        """Coefficients (p,) whose value is the description's more than the data's."""
        both = basis(np.concatenate([b.s[:, None] * b.v.T * b.scale, self.rows]))
        # (X'X + L'L)^-1 L'L, in columns of length one
        rows = self.rows / both.scale
        inverse = (both.v / both.s**2) @ both.v.T
        share = np.einsum("ij,ji->i", inverse @ rows.T, rows)
        return np.asarray(share > MOSTLY)


#: Where the metric of a robot's own bodies is kept: it is asked for at every solution.
_DESCRIBED_ROWS = ("described rows",)


def described(problem: Problem, terms: Sequence[Term], places: Sequence[slice]) -> FloatArray:
    """Rows R (m, p) of the metric for some terms' coefficients; m = 0 without a description."""
    size = places[-1].stop if places else 0
    tree, known = problem.robot.tree, problem.robot.prior
    for t, where in zip(terms, places, strict=True):
        if tree is None or t.fixed or Trait.BODY not in t.effect.traits:
            continue
        own = problem.memo.get(_DESCRIBED_ROWS)
        if own is None:
            bodies = (tree.spread @ known).reshape(-1, 10)
            own = problem.memo[_DESCRIBED_ROWS] = _metric(bodies) @ tree.spread
        out = np.zeros((len(own), size))
        out[:, where] = own
        return out
    return np.zeros((0, size))


def _metric(bodies: FloatArray) -> FloatArray:
    """Rows (m, 10 b) whose squared length is the squared relative change of bodies (b, 10)."""
    found = [(k, own) for k, body in enumerate(bodies) if (own := _of_body(body)) is not None]
    out = np.zeros((10 * len(found), bodies.size))
    for row, (k, own) in enumerate(found):
        out[10 * row : 10 * row + 10, 10 * k : 10 * k + 10] = own
    return out


def _of_body(body: FloatArray) -> FloatArray | None:
    """Square root (10, 10) of a body's metric; None where the description has no such body."""
    mass = float(body[0])
    if not mass > 0.0:
        return None
    centre, p = body[1:4] / mass, pseudo_inertia(body)
    value, turn = np.linalg.eigh(p[:3, :3] - mass * np.outer(centre, centre))
    if not value.sum() > 0.0:
        return None
    value = np.maximum(value, THIN * value.sum())
    # P = A A', so that A^-1 dP A^-T is the relative change
    root = np.zeros((4, 4))
    root[:3, :3], root[:3, 3], root[3, 3] = turn * np.sqrt(value), centre * mass**0.5, mass**0.5
    inner = np.linalg.inv(root)
    change = [inner @ pseudo_inertia(one) @ inner.T for one in np.eye(10)]
    upper = np.triu_indices(4)
    # off the diagonal every entry counts twice in the trace of the square
    weight = np.where(upper[0] == upper[1], 0.5, 1.0) ** 0.5
    return np.stack([c[upper] * weight for c in change], axis=1)


def pull_of(
    problem: Problem,
    metric: FloatArray,
    centre: FloatArray,
    b: Basis,
    residual: FloatArray,
    target: FloatArray,
) -> Pull | None:
    """How hard the description draws; None where there is none, or the data think nothing of it.

    Parameters
    ----------
    problem : Problem
        The runs.
    metric : ndarray (m, p)
        Rows R, see `described`.
    centre : ndarray (p,)
        Values of the description.
    b : Basis
        Of the weighted regressor.
    residual : ndarray (d, n)
        What least squares leave [N m or N].
    target : ndarray (d n,)
        Weighted target less what the description foretells.
    """
    if not len(metric) or not b.rank:
        return None
    colour = colouring(problem, residual)
    rho = _likeliest(metric / b.scale, b, target, colour)
    return None if rho is None else Pull(metric * (colour**0.5 / rho), centre, rho)


def colouring(problem: Problem, residual: FloatArray) -> float:
    """Instants that one independent instant takes, over all joints."""
    each = [inflation(r, problem.run) for r in residual]
    return float(problem.count.sum() / np.sum(problem.count / np.array(each)))


def _likeliest(metric: FloatArray, b: Basis, target: FloatArray, colour: float) -> float | None:
    """The error of a description with the largest marginal likelihood; None where it is no use.

    With columns Z that the description says nothing of projected out, eigenvalues d_i of X'X in
    the metric, and z_i the projections of the target,

        2 log p(y | rho) = sum_i z_i^2 / (d_i + rho^-2) - log(1 + d_i rho^2).
    """
    mine = np.any(metric != 0.0, axis=0)
    x, y = b.s[:, None] * b.v.T / colour**0.5, b.q.T @ target / colour**0.5
    z, _, _ = decomposed(x[:, ~mine])
    rank = int(np.linalg.matrix_rank(x[:, ~mine])) if (~mine).any() else 0
    keep = z[:, :rank]
    own, y = x[:, mine] - keep @ (keep.T @ x[:, mine]), y - keep @ (keep.T @ y)
    # in coordinates w = R pi: own pi = (own R^+) w, the prior of w is white
    u, s, _ = decomposed(own @ np.linalg.pinv(metric[:, mine]))
    d, shown = s**2, (s * (u.T @ y)) ** 2
    rho = ERRORS[:, None] ** 2
    evidence = np.sum(shown / (d + 1 / rho) - np.log1p(d * rho), axis=1)
    best = int(np.argmax(evidence))
    return float(ERRORS[best]) if best < len(ERRORS) - 1 else None


def serves(problem: Problem, pull: Pull, x: FloatArray, target: FloatArray) -> bool:
    """Whether contiguous parts are foretold better with the description, by more than `WORTH`.

    The marginal likelihood takes the model for right.  Where effects are still missing it may ask
    a description for what these do, and then other motions are foretold worse.  Decided once for a
    problem, by its first model.

    Parameters
    ----------
    problem : Problem
        The runs.
    pull : Pull
        The description, at its likeliest error.
    x, target : ndarray (d n, p), (d n,)
        Weighted regressor, zero where coefficients are held or lie on a bound; and target.
    """
    key = ("description serves",)
    if key not in problem.memo:
        own = np.sum(target.reshape(problem.d, -1) ** 2, axis=1)
        alone, with_it = _left_out(problem, pull, x, target)
        better = with_it.sum() < (1 - WORTH) ** 2 * alone.sum()
        if np.any(alone > own):
            # worse than no model at all somewhere: by joints, for its error is as large as may be
            alone, with_it = np.maximum(alone, 1e-300), np.maximum(with_it, 1e-300)
            better = np.mean(np.log(with_it / alone)) < 2 * np.log(1 - WORTH)
        problem.memo[key] = better
    return bool(problem.memo[key])


def _left_out(
    problem: Problem, pull: Pull, x: FloatArray, target: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squared errors of each joint (d,) on parts left out, without and with the description."""
    scale = np.linalg.norm(x, axis=0)
    scale = np.where(scale > 1e-11 * float(scale.max(initial=0.0)), scale, 1.0)
    each = (x / scale).reshape(problem.d, problem.n, -1), target.reshape(problem.d, problem.n)
    part = np.arange(problem.n) * PARTS // problem.n
    some = [(each[0][:, part == k], each[1][:, part == k]) for k in range(PARTS)]
    gram = np.stack([a.transpose(0, 2, 1) @ a for a, _ in some])
    right = np.stack([(y[:, None] @ a)[:, 0] for a, y in some])
    own = np.sum(each[1] ** 2, axis=1)
    held = np.eye(scale.size) / max(float(target @ target), 1.0)
    rows, centre = pull.rows / scale, pull.centre * scale
    errors = []
    for precision in (held, held + rows.T @ rows):
        others = right.sum(axis=(0, 1)) - right.sum(axis=1) + precision @ centre
        rest = gram.sum(axis=(0, 1)) - gram.sum(axis=1) + precision
        theta = np.linalg.solve(rest, others[..., None])[..., 0]
        both = np.einsum("kp,kjpq,kq->j", theta, gram, theta, optimize=True)
        errors.append(own + both - 2 * np.einsum("kjp,kp->j", right, theta))
    return errors[0], errors[1]


def drawn_to(
    pull: Pull, b: Basis, target: FloatArray, start: FloatArray, known: FloatArray
) -> tuple[FloatArray, Basis]:
    """Coefficients (p,) that the data and the description give together, and their basis.

    Parameters
    ----------
    pull : Pull
        The description.
    b : Basis
        Of the weighted regressor X.
    target : ndarray (N,)
        What X is to give, weighted.
    start : ndarray (p,)
        Where directions stay that neither determines.
    known : ndarray (N,)
        X @ start.
    """
    rows = np.concatenate([b.s[:, None] * b.v.T * b.scale, pull.rows])
    right = np.concatenate([b.q.T @ (target - known), pull.rows @ (pull.centre - start)])
    both = basis(rows)
    return both.solve(right, start, np.zeros(right.size)), both


def fit_of(problem: Problem) -> str:
    """Source of the values that a fit of these runs has found."""
    return "fit of " + ", ".join(r.name for r in problem.recordings)


def nearness(
    problem: Problem,
    terms: Sequence[Term],
    places: Sequence[slice],
    model: RobotModel,
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> Nearness:
    """Which bodies are known beforehand: those of the model, else of the description.

    Values that a fit of the same runs has found hold nothing else: there the description stands.

    Parameters
    ----------
    problem, terms, places : Problem, sequence of Term, sequence of slice
        Whose coefficients.
    model : RobotModel
        Holds values and where they come from.
    start : ndarray (p,)
        Values of the model, else of the description.
    bounds : tuple of ndarray (p,)
        Of the coefficients.
    """
    metric, values, found = described(problem, terms, places), model.values(), fit_of(problem)
    centre, moves = start.copy(), np.ones(start.size, dtype=bool)
    for t, where in zip(terms, places, strict=True):
        if Trait.BODY in t.effect.traits:
            known = [values[n].source for n, _ in coefficients(t, problem) if n in values]
            if all(source in (found, DESCRIBED) for source in known):
                centre[where] = problem.robot.prior
            moves[where] = np.any(metric[:, where] != 0.0, axis=0)
    return Nearness(metric, centre, moves, *bounds)


@dataclass(frozen=True)
class Drawn:
    """What draws coefficients besides the rows of a problem.

    Parameters
    ----------
    pull : Pull or None
        The robot's description.
    rows, target : ndarray (m, p), (m,)
        Rows beside the weighted regressor, and what they are to give: corrections are small.
    basis : Basis
        Of the weighted regressor and these rows.
    """

    pull: Pull | None
    rows: FloatArray
    target: FloatArray
    basis: Basis


def solve(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, Basis, list[slice], FloatArray]:
    """Weighted least squares of bound terms: theta, X, basis, slices, residual (d, n)."""
    return solved(problem, terms, model, sigma, False)[:5]


def solved(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray, drawing: bool
) -> tuple[FloatArray, FloatArray, Basis, list[slice], FloatArray, Drawn]:
    """The same, and what drew the coefficients besides."""
    x, slices = stack(problem, terms)
    names = [n for t in terms for n, _ in coefficients(t, problem)]
    start = prior(problem, terms, model, names)
    w = np.repeat(1.0 / sigma, problem.n)
    y = problem.y.reshape(-1)
    if not np.all(np.isfinite(x)):
        raise DataError("a column of the model is not finite; check the recording (hil info)")
    free = _free(terms, problem)
    held = x @ np.where(free, 0.0, start)
    target = (y - held) * w
    b = factored(problem, terms, sigma, noise_to_signal(target), free)
    known = (x @ (start * free)) * w
    low, high = limits(terms, problem)
    nearest = nearness(problem, terms, slices, model, start, (low, high))
    theta = b.solve(target, start * free, known) + np.where(free, 0.0, start)
    theta = nearest(bounded(theta, b, low, high), b)
    residual = (y - x @ theta).reshape(problem.d, problem.n)
    pull = _pull(problem, terms, slices, b, residual, (target, x, w)) if drawing else None
    if pull is not None:
        moves = free * ~((theta <= low) | (theta >= high))
        pull = pull if serves(problem, pull, x * (w[:, None] * moves), target) else None
    held_back = _held_back(problem, terms, slices, b, (target, x, w)) if drawing else None
    draws = [p for p in (pull, held_back) if p is not None]
    if draws:
        rows, centre = np.concatenate([p.rows for p in draws]), sum(p.centre for p in draws)
        both = Pull(rows, np.asarray(centre), draws[0].error)
        theta, together = drawn_to(both, b, target, start * free, known)
        theta = bounded(theta + np.where(free, 0.0, start), together, low, high)
        theta = nearest(theta, together)
        residual = (y - x @ theta).reshape(problem.d, problem.n)
    if held_back is None:
        return theta, x, b, slices, residual, Drawn(pull, np.zeros((0, theta.size)), np.zeros(0), b)
    wide = basis(np.concatenate([x * (w[:, None] * free), held_back.rows]))
    wanted = held_back.rows @ held_back.centre
    return theta, x, b, slices, residual, Drawn(pull, held_back.rows, wanted, wide)


def _held_back(
    problem: Problem,
    terms: list[Term],
    slices: list[slice],
    b: Basis,
    equations: tuple[FloatArray, FloatArray, FloatArray],
) -> Pull | None:
    """What keeps corrections, and what they change, as small as what is left without them.

    A free function of the speed, say, holds columns that the model has, too, or nearly: an offset
    while the joint moves, a viscous friction.  The values of the model are to keep their meaning,
    and a program that leaves the correction out is to lose no more than what it explains.  With r
    what the model leaves of a joint without any correction and theta_0 its values there, each
    coefficient of a column c of that joint is drawn to its value in theta_0, those of corrections
    to zero, as N(theta_0, (|r| / |c|)^2).  Masses, which belong to all joints, are not.
    """
    kind = [
        not t.fixed and t.effect.traits & (Trait.CORRECTION | Trait.GEOMETRY) == Trait.CORRECTION
        for t in terms
    ]
    if not any(kind) or not b.rank:
        return None
    touched = {t.joint for t, is_free in zip(terms, kind, strict=True) if is_free}
    own = [
        not (t.fixed or t.effect.scope.whole or t.effect.traits & Trait.GEOMETRY)
        and t.joint in touched
        for t in terms
    ]
    target, x, w = equations
    free, drawn, joint = (
        np.concatenate([np.full(s.stop - s.start, v) for s, v in zip(slices, each, strict=True)])
        for each in (kind, own, [t.joint for t in terms])
    )
    reduced = b.s[:, None] * b.v.T * b.scale
    theta = np.zeros(x.shape[1])
    theta[~free] = least_squares(reduced[:, ~free], b.q.T @ target)
    left = (target - (x @ theta) * w).reshape(problem.d, problem.n)
    size = np.maximum(np.linalg.norm(left, axis=1), 1e-300)
    columns = np.flatnonzero(drawn)
    rows = np.zeros((columns.size, x.shape[1]))
    norm = np.linalg.norm(x[:, columns] * w[:, None], axis=0)
    weight = colouring(problem, left) ** 0.5
    rows[np.arange(columns.size), columns] = weight * norm / size[joint[columns]]
    return Pull(rows, np.where(drawn, theta, 0.0), float("nan"))


def _pull(
    problem: Problem,
    terms: list[Term],
    slices: list[slice],
    b: Basis,
    residual: FloatArray,
    equations: tuple[FloatArray, FloatArray, FloatArray],
) -> Pull | None:
    """What the robot's description adds to equations (target, X, weights)."""
    metric = described(problem, terms, slices)
    if not len(metric):
        return None
    target, x, w = equations
    centre = np.zeros(x.shape[1])
    for t, where in zip(terms, slices, strict=True):
        if Trait.BODY in t.effect.traits:
            centre[where] = problem.robot.prior
    return pull_of(problem, metric, centre, b, residual, target - (x @ centre) * w)


def noise_to_signal(target: FloatArray) -> float:
    """What a column-scaled direction must move a weighted target by, to be determined by it."""
    return 1.0 / max(float(np.linalg.norm(target)), 1.0)


def _free(terms: list[Term], problem: Problem) -> FloatArray:
    return np.concatenate(
        [np.full(len(coefficients(t, problem)), 0.0 if t.fixed else 1.0) for t in terms]
    )


def prior(problem: Problem, terms: list[Term], model: RobotModel, names: list[str]) -> FloatArray:
    """Where undetermined directions stay: the model's values, the robot's, else zero."""
    values = np.nan_to_num(known_values(model, names))
    for t, where in zip(terms, slices_of(problem, terms), strict=True):
        if Trait.BODY in t.effect.traits and not values[where].any():
            values[where] = problem.robot.prior
    return values


def slices_of(problem: Problem, terms: list[Term]) -> list[slice]:
    """Where each term's coefficients lie in theta."""
    widths = [len(coefficients(t, problem)) for t in terms]
    edges = np.concatenate([[0], np.cumsum(widths)]).astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


#: Weight of what the data do not determine, in the smallest determined singular value.
WEAK = 1e-3


def limits(terms: Sequence[Term], problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bound of every coefficient (p,); infinite where it is held at its value."""
    free = [p if not t.fixed else None for t in terms for _, p in coefficients(t, problem)]
    low = [-np.inf if p is None else p.lower for p in free]
    high = [np.inf if p is None else p.upper for p in free]
    return np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)


def bounded(theta: FloatArray, b: Basis, low: FloatArray, high: FloatArray) -> FloatArray:
    """Coefficients within their bounds that leave the smallest residual.

    Directions that the data determine decide first; among what they leave open the solution
    stays as close as it can to `theta` (which lies at the prior there).

    Parameters
    ----------
    theta : ndarray (p,)
        Unbounded solution, `b.solve(...)`.
    b : Basis
        Basis of the weighted regressor (N, p) that theta was solved with.
    low, high : ndarray (p,)
        Bounds; infinite where there is none.

    Returns
    -------
    ndarray (p,)
        `theta` itself where it keeps its bounds.
    """
    if np.all((theta >= low) & (theta <= high)):
        return theta
    tied = np.isfinite(low) | np.isfinite(high)
    order = np.concatenate([np.flatnonzero(~tied), np.flatnonzero(tied)])
    first = int(np.sum(~tied))
    # free coefficients first: their part of the triangle can always be brought to zero
    r = np.asarray(np.linalg.qr(_reduced(b)[:, order], mode="r"), dtype=np.float64)
    lowest: FloatArray = ((low - theta) * b.scale)[tied]
    highest: FloatArray = ((high - theta) * b.scale)[tied]
    step, side = _active_set(r[first:, first:], lowest, highest)
    moved = np.zeros_like(theta)
    moved[tied] = step
    moved[~tied] = -scipy.linalg.solve_triangular(r[:first, :first], r[:first, first:] @ step)
    out: FloatArray = theta + moved / b.scale
    out[tied] = np.where(side < 0, low[tied], np.where(side > 0, high[tied], out[tied]))
    return np.clip(out, low, high)


def _reduced(b: Basis) -> FloatArray:
    """[S V'; w N'] (p, p): N spans what the data do not determine, w is small beside S."""
    p = b.v.shape[0]
    complement = np.linalg.qr(b.v, mode="complete")[0][:, b.rank :] if b.rank else np.eye(p)
    weight = WEAK * float(b.s[-1]) if b.rank else 1.0
    out: FloatArray = np.concatenate([b.s[:, None] * b.v.T, weight * complement.T])
    return out


def _active_set(
    r: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, NDArray[np.int_]]:
    """Step within [low, high] that minimises |r step|, and the side (-1, 0, 1) it ends on."""
    found = scipy.optimize.lsq_linear(
        r, np.zeros(len(r)), (low, high), method="bvls", tol=1e-14, max_iter=50 + 10 * len(r)
    )
    if not found.success:
        raise FitError(
            f"bounded least squares of {low.size} coefficients ended with {found.message!r}, "
            "expected a solution; fix the values of some effects (fixed = true)"
        )
    return found.x, found.active_mask


Pair = tuple[FloatArray, FloatArray]
#: Factors of a joint's rows that are kept.
LAST = 2


def factored(
    problem: Problem,
    terms: Sequence[Term],
    sigma: FloatArray,
    least: float,
    free: FloatArray | None = None,
) -> Basis:
    """Basis of the weighted regressor (d n, p) of some terms.

    Parameters
    ----------
    problem, terms : Problem, sequence of Term
        Whose columns.
    sigma : ndarray (d,)
        Scale of each joint's rows.
    least : float
        Noise to signal, as in `basis`.
    free : ndarray (p,), optional
        0 where a column does not count.
    """
    return of_factors(*factors(problem, terms, sigma, free), least)


def factors(
    problem: Problem, terms: Sequence[Term], sigma: FloatArray, free: FloatArray | None = None
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Q_j (n, k_j), orthonormal, and R_j (k_j, p) of every joint's weighted rows."""
    blocks = [block(problem, t) for t in terms]
    edges = np.concatenate([[0], np.cumsum([b.shape[-1] for b in blocks])]).astype(int)
    places = [np.arange(a, b) for a, b in pairwise(edges)]
    q, r = [], []
    for j in range(problem.d):
        here = [k for k, t in enumerate(terms) if blocks[k].ndim == 3 or t.joint == j]
        once = [k for k in here if _once(terms[k])]
        rest = [k for k in here if k not in once]
        pair = _kept(problem, j, [terms[k] for k in once], [_rows(blocks[k], j) for k in once])
        if rest:
            pair = _extended(problem, j, pair, [blocks[k] for k in rest])
        wide = np.zeros((len(pair[1]), int(edges[-1])))
        if here:
            wide[:, np.concatenate([places[k] for k in (*once, *rest)])] = pair[1] / sigma[j]
        q.append(pair[0])
        r.append(wide if free is None else wide * free)
    return q, r


def _once(term: Term) -> bool:
    return Trait.MOTION in term.effect.traits and not term.effect.shape


def _rows(values: FloatArray, j: int) -> FloatArray:
    return values[j] if values.ndim == 3 else values


def _kept(problem: Problem, j: int, terms: list[Term], blocks: list[FloatArray]) -> Pair:
    """Factors of what depends on the motion alone, made at first use."""
    key = ("factors", j, tuple((*t.key, t.per_run) for t in terms))
    if key not in problem.memo:
        x = np.concatenate([np.zeros((problem.n, 0)), *blocks], axis=1)
        problem.memo[key] = scipy.linalg.qr(x, mode="economic", check_finite=False)
    q, r = problem.memo[key]
    return q, r


def _extended(problem: Problem, j: int, pair: Pair, blocks: list[FloatArray]) -> Pair:
    """Factors of [X, C] for the rows of joint j, of X's and of the blocks of C.

    The last few are kept: a search leaves out one term after the other, each of its own joint.
    """
    key = ("extended", j)
    made: list[tuple[FloatArray, list[FloatArray], Pair]] = problem.memo.get(key, [])
    found = next((m for m in made if m[0] is pair[0] and _same(m[1], blocks)), None)
    if found is None:
        out = _appended(pair, np.concatenate([_rows(b, j) for b in blocks], axis=1))
        found = (pair[0], blocks, out)
    # a list of its own: another thread may go through the present one
    problem.memo[key] = [*(m for m in made if m is not found), found][-LAST:]
    return found[2]


def _same(a: list[FloatArray], b: list[FloatArray]) -> bool:
    return len(a) == len(b) and all(x is y for x, y in zip(a, b, strict=True))


def _appended(pair: Pair, c: FloatArray) -> Pair:
    """Factors of [X, C]; twice orthogonalised, for once loses what nearly lies in X."""
    q, r = pair
    inner = q.T @ c
    left = c - q @ inner
    again = q.T @ left
    p, t = scipy.linalg.qr(left - q @ again, mode="economic", check_finite=False)
    top = np.concatenate([r, inner + again], axis=1)
    bottom = np.concatenate([np.zeros((len(t), r.shape[1])), t], axis=1)
    return np.concatenate([q, p], axis=1), np.concatenate([top, bottom])
