"""A body that a link carries in some runs and not in others.

A rigid body on a link acts through its ten parameters, mass m, first moments h = m c and inertia I,
linearly.  They are those of a real body where the pseudo-inertia

    J = [[Sigma, h], [h', m]] >= 0,    Sigma = tr(I) / 2 1 - I,

which holds the mass, the triangle inequality of the moments of inertia and the place of the centre
in one condition.

Source: Atkeson, An, Hollerbach, Int. J. Robotics Research 5(3), 1986 (load of a manipulator);
Wensing, Kim, Slotine, IEEE Robotics and Automation Letters 3(1), 2018 (pseudo-inertia).

A load that was picked up or put down in the middle of a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import scipy.optimize

from hil.models.bodies import parameters, pseudo_inertia
from hil.models.effect import (
    AT_AN_INSTANT,
    VALUE_DEVIATIONS,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Of,
    Param,
    Relations,
    Scope,
    Shape,
    Shapes,
    Trait,
    Variation,
    instants,
)
from hil.models.motion import FloatArray, Motion
from hil.models.parts import JOINT

#: Share of its squared effort by which a body may miss being a real one, and other runs seem to
#: carry something, whatever the errors: by so much the laws of a library miss their effects.
MISSES = 0.0125
#: Instants of a run that show which parameters a motion determines, and the share of the largest
#: direction below which it does not.
SOME, UNSEEN = 400, 1e-5
#: Rounding of an eigenvalue, and the least one that a search starts from, in the largest.
_EXACT, _NEAR = 1e-12, 1e-4
#: Columns below this share of the largest are zero but for rounding.
NULL_ROUNDING = 1e-11
_MOMENTS = (("mx", "x"), ("my", "y"), ("mz", "z"))
_INERTIAS = ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def _payload_lacks(motion: Motion, j: int) -> str:
    """Needs links."""
    return "" if motion.robot.links else "the robot has no geometry, so no links and no tip"


def _payload_grid(motion: Motion, j: int) -> Shapes:
    """Links that can carry a load: of equals the tip's, else the one nearest to the base."""
    return [(float(k),) for k in motion.robot.links]


def _payload_foils(motion: Motion, j: int, shape: Shape) -> Sequence[FloatArray]:
    """Other inertias of all links at once: a description that is a bit wrong everywhere."""
    return [motion.robot.regressor(motion.q, motion.qd, motion.qdd)]


def _payload_real(f: Fitted) -> bool:
    """Whether a run exists against which all others carry a real body, or none.

    The coefficients are the differences (runs - 1, 10) to the first run, or one body.
    """
    if not f.motion.robot.links:
        return True
    seen = _seen(f.motion, f.effect.columns(f.motion, f.j, f.shape))
    each = np.concatenate([np.zeros((1, 10)), np.reshape(f.beta, (-1, 10))])
    sizes = f.error if len(f.error) == len(f.beta) else np.zeros(len(f.beta))
    noise = _noise(seen, np.reshape(sizes, (-1, 10)))
    return any(
        all(real(seen, more, max(noise, MISSES * most)) for more in apart)
        for apart, most in _differences(seen, each)
    )


def _differences(seen: FloatArray, each: FloatArray) -> Iterator[tuple[FloatArray, float]]:
    """What all other runs carry more than each of them, and the largest squared effort of that."""
    for k in range(len(each)):
        apart = np.delete(each, k, axis=0) - each[k]
        yield apart, float(np.max(np.sum((apart @ seen.T) ** 2, axis=1), initial=0.0))


class Payload(Effect):
    """A body on a link, in some runs and not in others.

    Within one run the links' own inertias contain it, and a mass at the tip is all that is tried.
    Of several runs the difference to the first one is fitted, and the lightest one comes first.
    Parameters are in axes of the link, about the tip on the link that holds it, else about
    the joint's frame.
    """

    name, family = "payload", "mass"
    doc = Doc(
        equation="tau = Y_k(q, qd, qdd) [m, m c, I],  the body on link k",
        signature="gravity and inertia of all joints up to the link change together",
        confused_with=("rigid-body", "load-friction"),
        shown_by="one recording with and one without the mass",
        source="Atkeson, An, Hollerbach, Int. J. Robotics Research 5(3), 1986",
        caveat="what is marked as not identifiable acts in combinations with the others alone",
    )
    params = (
        Param("m", "kg", "mass, with several runs more than in the first one"),
        *(Param(n, "kg m", f"first moment, {axis} axis of the link") for n, axis in _MOMENTS),
        *(Param(n, "kg m^2", "moment of inertia, in axes of the link") for n in _INERTIAS),
    )
    shape = (Param(JOINT, "1", "number of the joint whose link carries it", 0.0, choice=True),)
    scope = Scope(Of.ROBOT, lacks=_payload_lacks)
    variation = Variation(per_run=True, relative=True, single=(0.0,))
    relations = Relations(foils=_payload_foils)
    search = Grid(_payload_grid, refine=False)
    limits = (
        Limit("real-body", _payload_real, says="no body has such a mass, centre and inertia"),
    )
    traits = Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort of unit parameters, shape (n, d, 10); without a link of a point mass at the tip.

        What is nothing but rounding is zero, so that it is not scaled up to a direction of its own.
        """
        link = int(shape[0]) if shape else 0
        first = link or next(iter(motion.robot.links), 0)
        out = motion.robot.body_load(motion.q, motion.qd, motion.qdd, first)
        size = np.abs(out).max(axis=(0, 1), initial=0.0)
        acts = size > NULL_ROUNDING * size.max(initial=0.0)
        return np.where(acts if link else acts & (np.arange(10) == 0), out, 0.0)


#: The same of a pseudo-inertia's sixteen entries, (10, 16).
_PARAMETERS = np.stack([parameters(e) for e in np.eye(16).reshape(16, 4, 4)], axis=1)


def _seen(motion: Motion, columns: FloatArray) -> FloatArray:
    """Triangle R (10, 10) of columns (n, d, 10), each joint's rows over its rms effort."""
    size = np.sqrt(np.mean(motion.tau**2, axis=0))
    few = columns[:: max(1, motion.n // SOME)] / np.where(size > 0, size, 1.0)[:, None]
    out = np.linalg.qr(few.reshape(-1, columns.shape[2]), mode="r")
    return np.asarray(np.concatenate([out, np.zeros((max(10 - len(out), 0), 10))]))


def _noise(seen: FloatArray, errors: FloatArray) -> float:
    """Most squared effort, as `seen` measures it, that errors (runs - 1, 10) account for.

    Standard errors s_k of parameters are  s^2 diag((R'R)^+)_k;  chance is s^2 (r + 2 sqrt(2 r)) for
    r parameters that are determined.
    """
    scale, inverse = _inverse(seen)
    known = np.diag(inverse @ inverse.T) / scale**2
    live = np.isfinite(scale) & np.isfinite(errors).all(axis=0) & (known > 0)
    if not np.any(live):
        return 0.0
    rank = float(np.linalg.matrix_rank(seen / scale, tol=UNSEEN))
    s2 = float(np.median(np.max(errors[:, live] ** 2, axis=0) / known[live]))
    return float(s2 * (rank + VALUE_DEVIATIONS * np.sqrt(2 * rank)))


def _inverse(seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lengths of columns (10,), infinite where there is next to nothing, and (R D^-1)^+ of R."""
    scale = np.linalg.norm(seen, axis=0)
    scale = np.where(scale > UNSEEN * max(float(scale.max()), 1e-300), scale, np.inf)
    return scale, np.asarray(np.linalg.pinv(seen / scale, rcond=UNSEEN))


def real(seen: FloatArray, pi: FloatArray, allowed: float) -> bool:
    """Whether some real body, or none, has the effort of parameters (10,) but for what is allowed.

    The least |R (pi(L L') - pi)|^2 over lower triangles L (4, 4): directions that no motion shows
    are free.
    """
    return _apart(seen, pi) <= allowed


def _apart(seen: FloatArray, pi: FloatArray) -> float:
    """Squared effort between parameters (10,) and those of the nearest real body."""
    scale, inverse = _inverse(seen)
    at, unit = np.tril_indices(4), max(float(np.linalg.norm(seen @ pi)), 1e-300)
    # parameters are linear in J = L L'
    per = (seen @ _PARAMETERS) / unit
    goal, twice = seen @ pi / unit, per.reshape(-1, 4, 4) + per.reshape(-1, 4, 4).transpose(0, 2, 1)
    low = np.zeros((4, 4))

    def left(x: FloatArray) -> FloatArray:
        low[at] = x
        return np.asarray(per @ (low @ low.T).ravel() - goal)

    def slope(x: FloatArray) -> FloatArray:
        low[at] = x
        return np.asarray((twice @ low)[:, at[0], at[1]])

    # from the values as they are, and without what no motion shows
    least = float(np.inf)
    for start in (pi, inverse @ (seen @ pi) / scale):
        value, vector = np.linalg.eigh(pseudo_inertia(start))
        size = max(float(np.abs(value).max()), 1e-300)
        if value[0] >= -_EXACT * size:
            return 0.0
        begin = np.linalg.cholesky((vector * np.maximum(value, _NEAR * size)) @ vector.T)[at]
        # not scaled by the slopes: what no motion shows has none, and the search would stand still
        found = scipy.optimize.least_squares(left, begin, slope, max_nfev=200)
        least = min(least, float(2 * found.cost))
    return float(least * unit**2)


#: Farthest that a load's centre lies from the tip [m].
PAYLOAD_REACH = 0.5
MASS = Param("m", "kg", "mass at the tip from then on, more than before")
MOMENTS = tuple(
    Param(name, "kg m", f"its first moment about the tip, {axis} axis of the last link")
    for name, axis in (("mx", "x"), ("my", "y"), ("mz", "z"))
)
_LOAD = (MASS, *MOMENTS)


#: Runs that may have an instant of their own, beside the first; more share the first one's.  Half:
#: three sessions in which a load is picked up get no name; double: the search of an instant takes
#: as many times longer.
OTHERS = 4
#: Steps about a found instant, in what lies between two of those that are tried.
_STEPS = (-0.5, -0.25, -0.12, -0.06, -0.03, 0.03, 0.06, 0.12, 0.25, 0.5)


def _payload_change_grid(motion: Motion, j: int) -> Shapes:
    """Instants of the first run, the others' being the same."""
    return [(t, *[0.0] * OTHERS) for t in instants(motion.since[-1])]


def _payload_change_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Another instant in one of the runs, the first among them; the present shape first.

    At the end of a run nothing is picked up in it.
    """
    if not motion.lengths:
        return []
    out = [tuple(shape)]
    for k, length in enumerate(motion.lengths[: OTHERS + 1]):
        every, now = instants(length), shape[k]
        near = [now + x * (every[1] - every[0]) for x in _STEPS] if k and now else []
        out += [(*shape[:k], t, *shape[k + 1 :]) for t in (*every, *near, length) if t > 0]
    return out


def _payload_change_terms(motion: Motion, j: int) -> tuple[Param, ...]:
    """The mass; where the last link is described, its moments, too."""
    load = motion.robot.tip_load(motion.q[:2], motion.qd[:2], motion.qdd[:2])
    return _LOAD if load is None else _LOAD[: load.shape[2]]


def _payload_change_near(f: Fitted) -> bool:
    """The load's centre lies within reach of the tip."""
    return float(np.linalg.norm(f.beta[1:])) <= PAYLOAD_REACH * abs(f.beta[0])


def _payload_change_within(f: Fitted) -> bool:
    """Of several runs one changes on its way: what whole runs carry is a payload of theirs."""
    own = [t or f.shape[0] for t in f.shape[: len(f.motion.lengths)]]
    every = [instants(length) for length in f.motion.lengths]
    inside = (some[0] < t < some[-1] for t, some in zip(own, every, strict=False))
    return len(every) < 2 or any(inside)


def _payload_change_lacks(motion: Motion, j: int) -> str:
    """Needs a tip."""
    none = motion.robot.tip_load(motion.q[:2], motion.qd[:2], motion.qdd[:2]) is None
    return "the robot has no geometry, so no tip" if none else ""


def _payload_change_after(motion: Motion, shape: Shape) -> FloatArray:
    """What is 0 before the instant of its run and 1 after it, shape (n,)."""
    own = shape[motion.run] if motion.run < len(shape) else 0.0
    return motion.after(float(own or shape[0]))


def _payload_change_foils(motion: Motion, j: int, shape: Shape) -> Sequence[FloatArray]:
    """An offset or a gain of one joint that is another one from the same instant on."""
    after = _payload_change_after(motion, shape)
    out = []
    for k in range(motion.d):
        for column in (after, after * motion.driven(k)):
            every = np.zeros((motion.n, motion.d, 1))
            every[:, k, 0] = column
            out.append(every)
    return out


class PayloadChange(Effect):
    """A load picked up or put down at an instant of the run.

    Of a load that a whole run carries the links' own inertias take account (`payload`); one that
    changes shows on all joints at once, and belongs to its run.
    """

    name, family = "payload-change", "mass"
    doc = Doc(
        equation="tau = m J' (p'' + g e_z) for t > t0, its centre m c apart from the tip",
        signature="gravity and inertia of all joints change at one instant",
        confused_with=("missed-counts", "payload", "torque-offset", "gain-drift"),
        shown_by="one recording before and one after, given as two sessions",
        source=(
            "Atkeson, An, Hollerbach, Int. J. Robotics Research 5(3), 1986 (load of a manipulator)"
        ),
    )
    params = _LOAD
    shape = (
        Param("t0", "s", "instant, since the start of the run; at its end: no load there", 0.0),
        *(
            Param(
                f"t0_{k}",
                "s",
                f"the same in run number {k}; 0: as in the first one",
                0.0,
                codes=((0.0, "as in the first one"),),
                tuned=True,
                usual=0.0,
            )
            for k in range(2, OTHERS + 2)
        ),
    )
    scope = Scope(Of.TIP, lacks=_payload_change_lacks, terms=_payload_change_terms)
    variation = AT_AN_INSTANT
    relations = Relations(foils=_payload_change_foils)
    search = Grid(_payload_change_grid, across=_payload_change_across, rounds=4 * OTHERS)
    limits = (
        Limit(
            "within",
            _payload_change_within,
            says="it acts in whole runs and changes within none: a payload",
        ),
        Limit("reach", _payload_change_near, says="the centre of the load lies far from the tip"),
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort of a unit mass and of unit moments after t0, shape (n, d, 1 or 4)."""
        load = motion.robot.tip_load(motion.q, motion.qd, motion.qdd)
        if load is None:
            return np.zeros((motion.n, motion.d, len(self.params)))
        return load * _payload_change_after(motion, shape)[:, None, None]


EFFECTS = (
    Payload(),
    PayloadChange(),
)
