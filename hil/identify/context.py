"""What effects refer to and the fit itself finds: sign resolution, surface, transmitted load.

Load and states of friction are made of the solution that refers to them: they are found again and
again until they settle.

How the fitted model's effort answers a small error of position or acceleration.

Evaluated twenty times a second along the run and interpolated: it changes with the posture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.errors import FitError
from hil.identify.design import Term, block, by_run
from hil.identify.problem import Problem
from hil.identify.screening import CLOSE
from hil.identify.shape_search import search_shapes
from hil.identify.solve import solve, solved
from hil.models.effect import SOLID, Trait
from hil.models.model import RobotModel
from hil.models.motion import Motion

if TYPE_CHECKING:
    from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
#: Share of a load's range within which two loads are the same.
SAME_LOAD = 1e-3
#: Instants of a run at which columns are compared.
PROBED = 200
#: Rounds in which load and states of friction settle for shapes that are known.
SETTLING = 3
#: Most rounds in which a load and what refers to it settle, and the change of the residual's scale
#: from which on they have.
LOADS, SAME_SCALE = 8, 0.01
#: Rise of a joint's error from which a round of the shape search is taken back: it counted on
#: coefficients that their bounds deny.  A rise of a hundredth: rounds that the last steps mend are
#: taken back, too, and bristles that come to nothing stay (leaking spring); half or double the
#: tenth: nothing known moves, for what bounds deny rose by two thirds and more.
DENIED = 1.1
#: Most rounds in which states of friction come to be those of the solution that is made of them.
STATES = 12


def impossible(term: Term, problem: Problem, reason: str) -> FitError:
    """Error for an effect that these data cannot be fitted with."""
    joint = problem.joints[term.joint]
    return FitError(f"effect {term.effect.name!r} cannot be fitted to {joint}: {reason}")


def find_surface(problem: Problem, terms: list[Term], sigma: FloatArray) -> None:
    """Set the surface that contact laws refer to before any of them is evaluated."""
    motion = problem.motions[0]
    ready = [t for t in terms if not t.effect.scope.lacks(motion, t.joint)]
    if len(ready) < len(terms):
        set_context(problem, search_shapes(problem, ready, sigma))
    for t in terms:
        reason = t.effect.scope.lacks(problem.motions[0], t.joint)
        if reason and not np.all(np.isfinite(block(problem, t))):
            raise impossible(t, problem, reason)


def references(terms: Sequence[Term], v0: FloatArray, contact: FloatArray) -> dict[str, FloatArray]:
    """Sign resolution (d,) and surface (d, 2) that the terms' shapes set; the others stay."""
    v0, contact = v0.copy(), contact.copy()
    for t in terms:
        names = [p.name for p in t.effect.shape]
        if "v0" in names:
            v0[t.joint] = t.shape[names.index("v0")]
        if Trait.SURFACE in t.effect.traits:
            contact[t.joint] = t.shape
    return {"v0": v0, "contact": contact}


def set_context(problem: Problem, terms: Sequence[Term]) -> None:
    """Tell the effects the sign resolution and the surface that the fit has found."""
    old = problem.motions[0]
    new = references(terms, old.v0, old.contact)
    same = np.array_equal(new["contact"], old.contact, equal_nan=True)
    if not same or not np.array_equal(new["v0"], old.v0):
        problem.set_context(**new)


def update_load(
    problem: Problem, terms: list[Term], theta: FloatArray, slices: list[slice]
) -> None:
    """Transmitted load = rigid-body effort less external effort; what masses and springs hold."""
    loads, still = _loads(problem, terms, theta, slices)
    problem.set_context(load=np.concatenate(loads), static=np.concatenate(still))
    motions = _responding(problem.motions, terms, theta, slices)
    problem.motions = [_sliding(m, terms, theta, slices) for m in motions]
    if problem.explains == "motor":
        parts = zip(problem.motions, drives(problem, terms, theta, slices), strict=True)
        problem.motions = [_driving(m, x) for m, x in parts]


def drives(
    problem: Problem,
    terms: Sequence[Term],
    theta: FloatArray,
    slices: Sequence[slice],
    motions: Sequence[Motion] | None = None,
) -> list[FloatArray]:
    """Motor effort that the terms foretell (n, d), run by run, of these motions or the fitted."""
    out = [-m.tau_ext for m in motions or problem.motions]
    for t, where in zip(terms, slices, strict=True):
        if where.start == where.stop:  # a difference between runs, of which there is one
            continue
        each = by_run(t, theta[where], problem.runs)[problem.whole] if t.per_run else None
        parts = [theta[where]] * len(out) if each is None else list(each)
        at = slice(None) if t.effect.scope.whole else t.joint
        if motions is None:
            raw = problem.raw(t.effect, t.joint, t.shape)
        else:
            raw = [t.effect.columns(m, t.joint, t.shape) for m in motions]
        for total, columns, part in zip(out, raw, parts, strict=True):
            total[:, at] += columns @ part
    return out


def _driving(motion: Motion, drive: FloatArray) -> Motion:
    """The motion with what the model foretells of its motors; the same if it hardly differs."""
    old = motion.drive
    if old.shape == drive.shape:
        near = np.max(np.abs(old - drive), axis=0) < SAME_LOAD * np.max(np.abs(drive), axis=0)
        if np.all(near):
            return motion
    return replace(motion, drive=drive)


def _sliding(
    motion: Motion, terms: Sequence[Term], theta: FloatArray, slices: Sequence[slice]
) -> Motion:
    """The motion with the friction's states that the terms have; the same if they are as before."""
    states: list[FloatArray | None] = [None] * motion.d
    for t, where in zip(terms, slices, strict=True):
        if not (t.effect.scope.whole or t.per_run):
            made = t.effect.relations.state(motion, t.joint, t.shape, theta[where].tolist())
            states[t.joint] = made if made is not None else states[t.joint]
    if all(s is None for s in states):
        return replace(motion, friction=()) if motion.friction else motion
    old = motion.friction or (None,) * motion.d
    kept = tuple(
        b if a is not None and b is not None and np.max(np.abs(a - b)) < SAME_LOAD else a
        for a, b in zip(states, old, strict=True)
    )
    return replace(motion, friction=kept)


def _half_way(problem: Problem, terms: list[Term], theta: FloatArray, slices: list[slice]) -> bool:
    """States of friction and motor efforts half-way to those of a solution; whether they differed.

    Laws that scale a state, or an effort, and those that make it may take turns: where the state is
    a sign, the solution has bristles, and where it is theirs, a sign.  Between them lies one that
    is its own.
    """
    before = problem.motions
    update_load(problem, terms, theta, slices)
    pairs = list(zip(before, problem.motions, strict=True))
    if not any(_slid(a.friction, b.friction) for a, b in pairs):
        return False
    problem.motions = [
        replace(
            b,
            friction=tuple(map(_middle, a.friction or (None,) * a.d, b.friction)),
            drive=b.drive if a.drive.shape != b.drive.shape else 0.5 * (a.drive + b.drive),
        )
        for a, b in pairs
    ]
    return True


def _middle(a: FloatArray | None, b: FloatArray | None) -> FloatArray | None:
    """The mean of two states; the second one where one of them is none, or they are the same."""
    return b if a is None or b is None or a is b else 0.5 * (a + b)


# ------------------------------------------------------------ settling


@dataclass(frozen=True)
class Settled:
    """A model on the way of a fit: its shapes, and the load and states that belong to them."""

    terms: list[Term]
    motions: list[Motion]
    sigma: FloatArray
    idle: set[tuple[str, int]]

    def or_less(self, other: Settled | None, problem: Problem) -> Settled:
        """The other one where that leaves clearly less, far less on a joint, else this."""
        if other is None or float(np.max(self.sigma / other.sigma)) < DENIED:
            return self
        return other if _clearly_more(self.sigma, other.sigma, problem) else self

    def or_better(
        self, problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
    ) -> tuple[list[Term], FloatArray]:
        """Terms and scales to go on with: those found, or these where they leave less.

        What terms refer to is found beside all others, and may lead away from where they began.
        A shape that explains more with a negative friction beside it explains less without one.
        """
        now = problem.rms(solve(problem, terms, model, sigma)[-1])
        if not _clearly_more(now, self.sigma, problem):
            return terms, sigma
        problem.motions = self.motions
        set_context(problem, self.terms)
        problem.set_context()  # what was made beside the other load is forgotten
        return self.terms, self.sigma


def _clearly_more(now: FloatArray, then: FloatArray, problem: Problem) -> bool:
    """Whether errors (d,) are larger than others in the geometric mean of the joints that move."""
    moves = ~problem.holds
    ratio = np.maximum(now, 1e-300)[moves] / then[moves]
    return bool(ratio.size) and float(np.sum(np.log(ratio))) >= ratio.size * np.log(CLOSE)


def settled_as_given(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
) -> Settled | None:
    """The model as it was given, with all its shapes; None where there is nothing to settle.

    A load that an earlier fit of the same runs has found stands already.
    """
    if problem.motions[0].drive.size:
        return None
    for _ in range(SETTLING):
        motions = problem.motions
        sigma, idle = scales(problem, terms, model, sigma)
    return Settled(terms, motions, sigma, idle)


def settled_load(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
) -> FloatArray:
    """Residual scales (d,) once the load that laws refer to is that of the fitted masses.

    A law that scales the load, or turns it, moves the masses that the load is made of.
    """
    for _ in range(LOADS):
        before = sigma
        sigma, _ = scales(problem, terms, model, sigma)
        if np.max(np.abs(np.log(sigma / before))) < SAME_SCALE:
            break
    return sigma


def own_states(problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray) -> None:
    """Give the problem the states of friction that are those of the solution made of them."""
    for _ in range(STATES if scaled_states(problem, terms) else 0):
        theta, _, _, slices, _, _ = solved(problem, terms, model, sigma, True)
        if not _half_way(problem, terms, theta, slices):
            break


def scaled_states(problem: Problem, terms: list[Term]) -> bool:
    """Whether a joint has a state of friction of its own, and a law that scales it by the load."""
    states = problem.motions[0].friction
    scaling = [t for t in terms if Trait.LOAD in t.effect.traits and t.effect.family == "friction"]
    return bool(states) and any(states[t.joint] is not None for t in scaling)


def scales(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
) -> tuple[FloatArray, set[tuple[str, int]]]:
    """Residual scale by joint, the load, and the terms that their bounds keep at zero."""
    # a load is made of the masses that the fit will end with, the description's part included
    drawing = any(Trait.LOAD in t.effect.traits for t in terms)
    for _ in range(2):
        theta, _, _, slices, residual, _ = solved(problem, terms, model, sigma, drawing)
        floor = 1e-6 * np.std(problem.y, axis=1) + 1e-15
        sigma = np.maximum(problem.rms(residual), floor)
    update_load(problem, terms, theta, slices)
    parts = zip(terms, slices, strict=True)
    return sigma, {t.key for t, s in parts if not t.effect.shape and not np.any(theta[s])}


# ------------------------------------------------------------ of other fits


def carrying(result: FitResult, problem: Problem) -> list[Motion]:
    """Motions of a problem with the load of a fit, where a term of it asks for the load.

    Parameters
    ----------
    result : FitResult
        The fit.
    problem : Problem
        Its own, or one of other runs; stays as it is.
    """
    if not any(Trait.LOAD in t.effect.traits for t in result.terms):
        return problem.motions
    return carried_by(problem, result.terms, result.theta, result.slices)


def carried_by(
    problem: Problem,
    terms: list[Term],
    theta: FloatArray,
    slices: list[slice],
    anew: bool = True,
) -> list[Motion]:
    """Motions of a problem with the load of some terms' masses; the problem stays as it is.

    `anew`: with their inertia and friction, too, and not those that the problem has.
    """
    fitted = terms, theta, slices
    parts = zip(problem.motions, *_loads(problem, *fitted), strict=True)
    motions = [m.with_(load=x, static=z) for m, x, z in parts]
    if not anew:
        return motions
    return [_sliding(m, *fitted) for m in _responding(motions, *fitted)]


def lend_load(result: FitResult) -> None:
    """Give the problem of a fit the load and the response of its masses, and nothing else.

    Signs and states of friction stay those of another fit.
    """
    problem, fitted = result.problem, (result.terms, result.theta, result.slices)
    problem.motions = _responding(carried_by(problem, *fitted, anew=False), *fitted)
    problem.set_context()  # what was made beside the other load is forgotten


def renew(result: FitResult) -> None:
    """Give the problem of a fit what that fit found, where other fits have been tried since."""
    problem, fitted = result.problem, (result.terms, result.theta, result.slices)
    set_context(problem, result.terms)
    loads, _ = _loads(problem, *fitted)
    now = zip(loads, problem.motions, strict=True)
    moved = any(np.ptp(x - m.load) > SAME_LOAD * max(float(np.ptp(x)), 1e-300) for x, m in now)
    slid = any(_slid(m.friction, _sliding(m, *fitted).friction) for m in problem.motions)
    if moved or slid:
        update_load(problem, *fitted)


def _slid(old: tuple[FloatArray | None, ...], new: tuple[FloatArray | None, ...]) -> bool:
    """Whether any state of a joint's friction is another one now."""
    return len(old) != len(new) or any(a is not b for a, b in zip(old, new, strict=True))


def bearing(terms: Sequence[Term], slices: Sequence[slice]) -> list[tuple[Term, slice]]:
    """Terms that the load is made of, and where their coefficients are.

    A motor's rotor lies before the gear or cable, which transmits none of its inertia: it is left
    out where the links' own is known apart.
    """
    apart = any(Trait.BODY in t.effect.traits for t in terms)
    return [
        (t, where)
        for t, where in zip(terms, slices, strict=True)
        if t.effect.family in SOLID
        and not t.per_run
        and not (apart and Trait.ROTOR in t.effect.traits)
    ]


def _loads(
    problem: Problem, terms: list[Term], theta: FloatArray, slices: list[slice]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Transmitted load, and what masses and springs hold at rest (n, d), run by run.

    A spring beside a law of what lies behind the motor may be on either side of it.
    """
    solid = [(t, theta[where]) for t, where in bearing(terms, slices)]
    mass = [(t, own) for t, own in solid if t.effect.family == "mass"]
    solid += _alike(problem, [t for t, _ in solid], terms, theta, slices)
    moving, still = _carried(problem, mass, False), _carried(problem, solid, True)
    return [x - m.tau_ext for x, m in zip(moving, problem.motions, strict=True)], still


def _alike(
    problem: Problem,
    solid: Sequence[Term],
    terms: Sequence[Term],
    theta: FloatArray,
    slices: Sequence[slice],
) -> list[tuple[Term, FloatArray]]:
    """Terms that no motion tells from a part of the load, and what is theirs.

    A motor's offset and the constant of a spring are one value, however a fit divides it: all of it
    is taken to be the spring's.  Of offsets by run that is their mean.
    """
    own = [t for t in solid if not t.effect.scope.whole]
    out = []
    for t, where in zip(terms, slices, strict=True):
        beside = [x for x in own if x.joint == t.joint]
        simple = Trait.MOTION in t.effect.traits and not (t.effect.scope.whole or t.effect.shape)
        if not beside or not simple or t.effect.family in SOLID:
            continue
        if _held_by(problem, t, beside):
            part = theta[where]
            mean = np.mean(by_run(t, part, problem.runs), axis=0) if t.per_run else part
            out.append((t, mean))
    return out


def _held_by(problem: Problem, term: Term, others: Sequence[Term]) -> bool:
    """Whether the columns of other terms of its joint hold those of a term."""
    few = [slice(None, None, max(1, m.n // PROBED)) for m in problem.motions]

    def rows(t: Term) -> FloatArray:
        raw = zip(problem.raw(t.effect, t.joint, t.shape), few, strict=True)
        return np.concatenate([x[k] for x, k in raw])

    one, more = rows(term), np.concatenate([rows(t) for t in others], axis=1)
    left = one - more @ np.linalg.lstsq(more, one, rcond=None)[0]
    return bool(np.linalg.norm(left) < SAME_LOAD * np.linalg.norm(one))


def _responding(
    motions: list[Motion], terms: list[Term], theta: FloatArray, slices: list[slice]
) -> list[Motion]:
    """Motions with what the terms say of the joints' response."""
    solid = [
        (t, theta[where])
        for t, where in zip(terms, slices, strict=True)
        if (t.effect.family in SOLID or Trait.VISCOUS in t.effect.traits) and not t.per_run
    ]
    more = [
        (t, theta[where])
        for t, where in zip(terms, slices, strict=True)
        if t.effect.family == "friction"
        and not (t.per_run or t.effect.traits & (Trait.VISCOUS | Trait.REPLAYED | Trait.LOAD))
    ]
    return [replace(m, response=EffortResponse(m, solid, more)) for m in motions]


def _carried(
    problem: Problem, solid: list[tuple[Term, FloatArray]], rest: bool
) -> list[FloatArray]:
    """Effort of masses and springs along the motion, or at rest in its postures: (n, d) a run."""
    out = [np.zeros_like(m.q) for m in problem.motions]
    for t, theta in solid:
        where = slice(None) if t.effect.scope.whole else t.joint
        every = np.arange(theta.size)
        if rest:
            parts = problem.at_rest(t.effect, t.joint, t.shape)
        else:
            parts = [(every, x) for x in problem.raw(t.effect, t.joint, t.shape)]
        for total, (some, columns) in zip(out, parts, strict=True):
            total[:, where] += columns @ theta[some]
    return out


#: Evaluations a second, and the step of the difference [rad or m].
RATE, STEP = 20.0, 1e-5


class EffortResponse:
    """Inertia and static stiffness of a model along one run.

    Parameters
    ----------
    motion : Motion
        The run.
    parts : sequence of (Term, ndarray (m,))
        Mass, stiffness and viscous terms with their coefficients.
    more : sequence of (Term, ndarray (m,))
        Further terms that depend on nothing but the motion.
    """

    def __init__(
        self,
        motion: Motion,
        parts: Sequence[tuple[Term, FloatArray]],
        more: Sequence[tuple[Term, FloatArray]] = (),
    ) -> None:
        # without the response of an earlier fit: it would hold that of the one before, and so on
        self._motion, self._parts, self._more = replace(motion, response=None), parts, more
        self._unslipped: dict[int, FloatArray] = {}
        self._coriolis: dict[int, FloatArray] = {}
        self._slope: dict[int, FloatArray] = {}
        self._weight: dict[int, FloatArray] = {}
        stride = max(1, int(1 / RATE / motion.dt))
        self._pick = np.unique(np.append(np.arange(0, motion.n, stride), motion.n - 1))

    @cached_property
    def inertia(self) -> FloatArray:
        """M(q) with M[i, j] = d tau_i / d qdd_j, shape (n, d, d)."""
        rest, one = self._effort(0.0, 0.0), np.eye(self._motion.d)
        return self._along([self._effort(0.0, row) - rest for row in one])

    @cached_property
    def gradient(self) -> FloatArray:
        """G(q) with G[i, j] = d tau_i / d q_j at rest, shape (n, d, d)."""
        rest, step = self._effort(0.0, 0.0), STEP * np.eye(self._motion.d)
        return self._along([(self._effort(row, 0.0) - rest) / STEP for row in step])

    def weight(self, j: int) -> FloatArray:
        """Derivative of joint j's load at rest by its own position, of masses alone, shape (n,)."""
        if j not in self._weight:
            mass = [(t, x) for t, x in self._parts if t.effect.family == "mass"]
            aside = STEP * (np.arange(self._motion.d) == j)
            rest, moved = (self._effort(x, 0.0, parts=mass)[:, j] for x in (0.0, aside))
            self._weight[j] = np.ascontiguousarray(
                self._along([(moved - rest)[:, None] / STEP]).ravel()
            )
        return self._weight[j]

    def slope(self, j: int) -> FloatArray:
        """Derivative of tau_i by q_j along the motion, with its speeds, shape (n, d)."""
        if j not in self._slope:
            m = self._motion
            aside = replace(m, q=m.q + STEP * (np.arange(m.d) == j), response=None)
            self._slope[j] = (self._solid(aside) - self._along_it) / STEP
        return self._slope[j]

    @cached_property
    def _along_it(self) -> FloatArray:
        """Effort of masses and springs along the motion, shape (n, d)."""
        return self._solid(self._motion)

    def _solid(self, motion: Motion) -> FloatArray:
        """Effort of masses and springs along a motion, shape (n, d)."""
        out = np.zeros_like(motion.q)
        for t, theta in self._parts:
            if t.effect.family in SOLID:
                where = slice(None) if t.effect.scope.whole else t.joint
                out[:, where] += _effort_of(t, theta, motion)
        return out

    def coriolis(self, j: int) -> FloatArray:
        """Derivative of tau_i by joint j's speed, of masses alone, shape (n, d).

        The efforts are a quadratic form of the speeds:  f(a + b) - f(a) - f(b) + f(0) = 2 B(a, b),
        and  d tau_i / d qd_j = sum_k 2 B_i(j, k) qd_k.
        """
        if j not in self._coriolis:
            one, (rest, *each) = np.eye(self._motion.d), self._at_unit_speeds
            both = [self._effort(0.0, 0.0, one[j] + x) for x in one]
            parts = [f - g - each[j] + rest for f, g in zip(both, each, strict=True)]
            self._coriolis[j] = np.einsum("nik,nk->ni", self._along(parts), self._motion.qd)
        return self._coriolis[j]

    @cached_property
    def _at_unit_speeds(self) -> list[FloatArray]:
        """Efforts (picked, d) at rest, and with a speed of one of each joint."""
        return [self._effort(0.0, 0.0, x) for x in (0.0, *np.eye(self._motion.d))]

    @cached_property
    def damping(self) -> FloatArray:
        """Viscous coefficient of each joint, shape (d,)."""
        out = np.zeros(self._motion.d)
        for t, theta in self._parts:
            if Trait.VISCOUS in t.effect.traits:
                out[t.joint] += float(theta[0])
        return out

    @cached_property
    def rotor(self) -> FloatArray:
        """Reflected inertia of each rotor, where the links' is known apart; else 0, shape (d,)."""
        out = np.zeros(self._motion.d)
        if any(Trait.BODY in t.effect.traits for t, _ in self._parts):
            for t, theta in self._parts:
                if Trait.ROTOR in t.effect.traits:
                    out[t.joint] += float(theta[0])
        return out

    @cached_property
    def tilt(self) -> FloatArray:
        """Derivative of tau_i by a turn of the base about its x and y axes, shape (n, d, 2).

        A base that is turned by r within a field of gravity g sees g - r x g.
        """
        m, tree = self._motion, self._motion.robot.tree
        body = next((x for t, x in self._parts if Trait.BODY in t.effect.traits), None)
        if tree is None or body is None:
            return np.zeros((m.n, m.d, 2))
        q = m.q[self._pick]
        zero, (_, _, z) = np.zeros_like(q), tree.gravity
        along = [np.array([0.0, z, 0.0]), np.array([-z, 0.0, 0.0])]  # -e_x x g, -e_y x g
        parts = [replace(tree, gravity=g).regressor(q, zero, zero) for g in along]
        return self._along([x @ (tree.spread @ body) for x in parts])

    def unslipped(self, j: int) -> FloatArray:
        """f(q - e, q' - e', q'' - e'') - f(q, q', q''), e the jumps of joint j, shape (n, d)."""
        if j not in self._unslipped:
            m, only = self._motion, np.arange(self._motion.d) == j
            e = m.slips * only if m.slips.size else np.zeros((3, *m.q.shape))
            true = replace(m, q=m.q - e[0], qd=m.qd - e[1], qdd=m.qdd - e[2])
            out = np.zeros_like(m.q)
            for t, theta in (*self._parts, *self._more) if np.any(e) else ():
                where = slice(None) if t.effect.scope.whole else t.joint
                moved = t.effect.columns(true, t.joint, t.shape)
                out[:, where] += (moved - t.effect.columns(m, t.joint, t.shape)) @ theta
            self._unslipped[j] = out
        return self._unslipped[j]

    def _along(self, columns: list[FloatArray]) -> FloatArray:
        values = np.stack(columns, axis=2)
        if len(self._pick) < 4:
            return np.broadcast_to(values[:1], (self._motion.n, *values.shape[1:])).copy()
        spline = scipy.interpolate.CubicSpline(self._motion.t[self._pick], values, axis=0)
        return np.asarray(spline(self._motion.t), dtype=np.float64)

    def _effort(
        self,
        aside: FloatArray | float,
        qdd: FloatArray | float,
        qd: FloatArray | float = 0.0,
        parts: Sequence[tuple[Term, FloatArray]] | None = None,
    ) -> FloatArray:
        """Effort in the postures, moved aside, at a speed and an acceleration; (picked, d)."""
        m, zero = self._motion, np.zeros((len(self._pick), self._motion.d))
        posed = replace(
            m,
            t=m.t[self._pick],
            q=m.q[self._pick] + aside,
            qd=zero + qd,
            qdd=zero + qdd,
            response=None,
        )
        out = np.zeros_like(zero)
        for t, theta in self._parts if parts is None else parts:
            where = slice(None) if t.effect.scope.whole else t.joint
            out[:, where] += _effort_of(t, theta, posed)
        return out


def _effort_of(t: Term, theta: FloatArray, m: Motion) -> FloatArray:
    """Effort of a term along a motion: (n, d) of the whole robot, else (n,) of its joint.

    Of rigid bodies without their regressor,  M(q) qdd + h(q, qd).
    """
    if Trait.BODY not in t.effect.traits:
        return np.asarray(t.effect.columns(m, t.joint, t.shape) @ theta)
    rest, mass = m.robot.balance(m.q, m.qd, np.tile(theta, (m.n, 1)))
    return np.asarray(rest + np.einsum("nij,nj->ni", mass, m.qdd))
