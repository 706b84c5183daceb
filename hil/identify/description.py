"""The robot's description as a prior of the masses: how far to trust it is learnt from the data.

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

Source: Lee, Wensing, Park, IEEE Trans. Robotics 36(1), 2020 (the metric); MacKay, Neural
Computation 4, 1992 (the evidence).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.regression import Basis, basis, decomposed, inflation
from hil.models.bodies import pseudo_inertia
from hil.models.effect import Trait

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


def described(problem: Problem, terms: Sequence[Term], places: Sequence[slice]) -> FloatArray:
    """Rows R (m, p) of the metric for some terms' coefficients; m = 0 without a description."""
    size = places[-1].stop if places else 0
    tree, known = problem.robot.tree, problem.robot.prior
    for t, where in zip(terms, places, strict=True):
        if tree is None or t.fixed or Trait.BODY not in t.effect.traits:
            continue
        bodies = (tree.spread @ known).reshape(-1, 10)
        own = _metric(bodies) @ tree.spread
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


def drawn(
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
