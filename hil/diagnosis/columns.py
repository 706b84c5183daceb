"""Columns that are not what they are said to be: signs, order, zeros of joints, axes of a force.

A model that cannot follow its own recording at all is fitted again to the same recording with an
effort turned round, with two of them exchanged, or with a joint's position turned round or counted
from another zero.  No missing effect makes one of these fit.

*Efforts.*  Which error no fit of the base model can go below, whatever its shapes and bounds?  Its
columns are those of the motion.  With all of them, in all shapes that a fit tries, as free columns
X_j of each joint's rows, and efforts y_j of rms size s_j,

    min over theta of  sum_j |y_j - X_j theta|^2 / (N_j s_j^2)

is no more than what any fit leaves.  X_j = Q_j R_j is made once for any number of efforts that the
same motion may have had.

Joints that are counted otherwise than the description has it: `hil.diagnosis.joint_zeros`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, pairwise

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from hil.diagnosis.attribution import as_use
from hil.diagnosis.candidates import tried
from hil.diagnosis.constants import (
    HALF,
    LITTLE,
    MATTERS,
    NEAR_FLOOR,
    OPEN,
    TENTH,
    WHOLE,
    WORTH,
)
from hil.diagnosis.evidence import terms_to_try
from hil.diagnosis.grams import Reach
from hil.diagnosis.joint_zeros import (
    LENGTHS,
    TIMES,
    Counting,
    Sense,
    countings,
    exchanged,
    nearest_zeros,
    of_zeros,
    ordered,
    orthogonal_part,
    other_zeros,
    scale_factor,
    with_senses,
)
from hil.diagnosis.preconditions import GRAVITY_WARNING, driven, weighed
from hil.diagnosis.types import Candidate
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.effect import Trait
from hil.models.robots import IndependentAxes
from hil.record.locked import in_base_axes
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]
#: Codes of faults that an effect may look like: columns exchanged, coupled, scaled or shifted,
#: another gravity, and other lengths.
LIKE_EFFECTS = ("swapped", "order", "coupled", "scale", "posture", GRAVITY_WARNING, LENGTHS)
#: What a correction is said to do, until a fit has told by how much.
FITS = "the model fits"


def mistaken(result: FitResult, recordings: list[Recording]) -> list[tuple[str, str]]:
    """Faults (code, sentence) of columns that the base fit shows; empty if there are none.

    Only where the motors alone act: beside a measured force, it may be the force that is wrong.

    Parameters
    ----------
    result : FitResult
        Base model fitted to the runs as they are.
    recordings : list of Recording
        The runs.
    """
    pushed = any(r.wrench is not None or r.tau_ext is not None for r in recordings)
    worst, doubtful = float(np.max(result.relative)) / 100, _doubtful(result)
    if doubtful and pushed and result.model.explains == "motor":
        return _of_tip(result, recordings)
    # what would be of no size once it fits is no mistake
    if result.model.explains != "motor" or pushed or OPEN * worst < MATTERS:
        return []
    best = _corrected(result, recordings, doubtful)
    if best and best.text:
        return [(best.code, best.text)]
    return [] if best else _in_some_runs(result, recordings)


def _corrected(result: FitResult, recordings: list[Recording], doubtful: bool) -> _Answer | None:
    """The correction that does most; none where effects do as much."""
    found = _other_posture(result, recordings)
    if doubtful:
        found += _by_motors(result, recordings)
        found += _other_efforts(result, recordings, found)
    best = _best(found)
    if best and best.code in LIKE_EFFECTS and _effects_do_as_much(result, best):
        best = _best([x for x in found if x.code not in LIKE_EFFECTS])
    return best


def _in_some_runs(result: FitResult, recordings: list[Recording]) -> list[tuple[str, str]]:
    """Faults (code, sentence) of some runs, and not of the others.

    Where a run alone leaves less than half of what it leaves beside the others.  What fits twice as
    badly alone as most others is looked at by itself: what is missing in all runs is no mistake of
    one.  What is found must also let all of them fit together.
    """
    if len(recordings) < 2:
        return []
    problem, squared = result.problem, result.residual**2
    own = [fit(_again(result, [r]), result.model, sweeps=1) for r in recordings]

    def beside(k: int) -> float:
        at = problem.whole[problem.run] == k
        effort = np.mean(own[k].problem.effort ** 2, axis=1)
        share = np.mean(squared[:, at], axis=1) / np.maximum(effort, 1e-300)
        return 100 * float(np.sqrt(np.mean(share[~problem.holds])))

    if not any(_size(x) < HALF * beside(k) for k, x in enumerate(own)):
        return []
    usual = sorted(map(_size, own))[(len(own) - 1) // 2]
    odd = [
        k
        for k, x in enumerate(own)
        if HALF * _size(x) > usual and _doubtful(x) and not x.problem.holds.all()
    ]
    some = {k: _corrected(own[k], [recordings[k]], True) for k in odd}
    told = {k: x for k, x in some.items() if x and x.text and x.runs}
    mended = [told[k].runs[0] if k in told else r for k, r in enumerate(recordings)]
    if told:
        after = fit(_again(result, mended), result.model, sweeps=1)
        if _fall(after.relative, result) <= HALF:
            return [(x.code, f"in {recordings[k].name} alone, {x.text}") for k, x in told.items()]
    zeros = _of_zeros(result, recordings, usual)
    return [(zeros.code, zeros.text)] if zeros else []


def _of_zeros(result: FitResult, recordings: list[Recording], alone: float) -> _Answer | None:
    """Zeros of one run that are others than in the rest, as an incremental encoder starts anew.

    All runs must fit together nearly as most fit alone (error [%]).  None where effects
    do as much that differ between runs: a payload, an offset.
    """
    problem = result.problem
    if isinstance(problem.robot, IndependentAxes) or problem.d < 2:
        return None
    found = []
    for k in range(len(recordings)):
        runs, senses = other_zeros(result, recordings, k)
        if any(x.shift for x in senses):
            found.append((fit(_again(result, runs), result.model, sweeps=1), k, senses))
    if not found:
        return None
    coarse, k, senses = min(found, key=lambda x: _size(x[0]))
    if not _fits(coarse, _size(result), WHOLE):
        return None

    def read(senses: Sequence[Sense]) -> FitResult:
        return fit(_again(result, with_senses(recordings, senses, k)), result.model, sweeps=1)

    senses = nearest_zeros(senses, lambda some: _size(read(some)))
    after, names = read(senses), [r.name for r in recordings]
    text = of_zeros(problem, senses, names[k], [n for n in names if n != names[k]])
    text = f"{text}: the model's error {_falls(after, result)}"
    changes = 2 * sum(bool(x.shift) for x in senses)
    answer = _Answer(_size(after), after, "posture", text, changes, _off(after), True)
    if HALF * answer.size > alone or not _fits(after, _size(result), OPEN):
        return None
    return None if _effects_do_as_much(result, answer, True) else answer


def _doubtful(result: FitResult) -> bool:
    """Whether a model cannot follow its own recording at all."""
    return bool(np.max(result.relative) >= 100 * TENTH) or driven(result)


@dataclass(frozen=True)
class _Answer:
    """A correction of the columns that fits.

    Parameters
    ----------
    size : float
        Error that it leaves [%]; half of it where efforts alone are read in another way, which is
        less to assume than a posture.
    after : FitResult
        The fit with it.
    code, text : str
        What is said; no text where an effect of the catalogue says the same.
    changes : int
        How many entries of a map it changes.
    off : float
        How far the gravity that it gives is from the described one.
    fitted : bool
        Whether its numbers were fitted, and are no sign, order or quarter of a turn.
    runs : list of Recording
        The runs with it; empty where it is the robot that is otherwise.
    """

    size: float
    after: FitResult
    code: str
    text: str
    changes: int = 1
    off: float = 0.0
    fitted: bool = False
    runs: list[Recording] = field(default_factory=list)


def _best(found: Sequence[_Answer]) -> _Answer | None:
    """Of what leaves as little, the fewest changes, and masses like the described ones."""
    least = min((x.size for x in found), default=0.0)
    near = [x for x in found if x.size <= (1 + WORTH) * least]
    return min(near, key=lambda x: (x.changes, round(x.off, 1), x.size), default=None)


def _effects_do_as_much(result: FitResult, best: _Answer, per_run: bool = False) -> bool:
    """Whether effects leave less of the columns as they are than of corrected ones.

    As little is enough against a correction whose numbers were fitted too, if these are no fewer
    than the effects: two springs did as much as one length.  A gain is no other explanation of a
    scale: of twice and more it is a unit.
    """
    same = Trait.GAIN if best.code == "scale" else Trait.NONE
    corrected = min(_beside_effects(best.after, same))
    few = best.changes if best.fitted else -1
    return any(
        left < (1 + WORTH if k <= few else 1.0) * corrected
        for k, left in enumerate(_beside_effects(result, same, per_run))
    )


def _beside_effects(result: FitResult, but: Trait, per_run: bool = False) -> list[float]:
    """Errors [%] that are left where joints have the effect that does most, but for some kinds.

    Without any, with the one that does most of all, then with the next joint's beside it, and so
    on.  Columns are in another order only if less is left so in that order: an arm whose last
    joint hardly needs an effort but for a spring looked like the same arm with its columns
    exchanged, and one spring over two joints like gravity from another side.  What differs between
    runs is among them if `per_run`.
    """
    problem, model = result.problem, result.model
    terms = [
        t
        for t in terms_to_try(result)[0]
        if (per_run or not t.per_run) and not t.effect.traits & but
    ]
    best: dict[int, Candidate] = {}
    for c in sorted(tried(result, terms)[1], key=lambda c: c.gain):
        if not c.term.effect.scope.of_robot:
            best[c.joint] = c
    left = [_size(result)]
    with problem.aside():
        for c in sorted(best.values(), key=lambda c: -c.gain):
            model = model + as_use(c, problem)
            left.append(_size(fit(problem, model, sweeps=1)))
    return left


def _off(result: FitResult) -> float:
    """How far fitted gravity is from the described one: sum of |log| of its ratios."""
    return sum(abs(float(np.log(max(w.ratio, LITTLE)))) for w in weighed(result))


def _other_efforts(
    result: FitResult, recordings: list[Recording], known: Sequence[_Answer]
) -> list[_Answer]:
    """Efforts that fit turned round or exchanged, but for what must leave more than `known` ones.

    What comes nearest by a lower bound is fitted first.
    """
    before, found, known = _size(result), list[tuple[int, _Answer]](), list(known)
    for bound, rank, change in _promising(result):
        if HALF * bound > (1 + WORTH) * min((x.size for x in known), default=np.inf):
            continue
        runs = change.of(recordings)
        after = fit(change.problem(result, runs), result.model, sweeps=1)
        fits, text = _fits(after, before, OPEN), change.text
        if fits or _freed(after, result):
            if not fits:
                text = text.replace(FITS, f"the model's error {_falls(after, result)}")
            size, code = HALF * _size(after), change.code
            off, changes = _off(after), change.entries
            known.append(_Answer(size, after, code, text, changes, off, runs=runs))
            found.append((rank, known[-1]))
    answers = [x for _, x in sorted(found, key=lambda x: x[0])]
    if either := _out_of_order(result, recordings):
        answers = [x for x in answers if x.code != "swapped"]
    return answers + either


def _promising(result: FitResult) -> list[tuple[float, int, _Change]]:
    """Least error [%] that any fit may leave, place in the order of asking, and change of efforts.

    The least error first; without changes that cannot help.
    """
    reach, before, out = Reach(result), _size(result), []
    y, effort = result.problem.as_recorded
    for rank, x in enumerate(_changes(result)):
        signs = x.signs[:, None]
        least = reach.by_joint(y[x.order] * signs, effort[x.order] * signs)
        bound = float(np.sqrt(np.mean(least**2)))
        if not x.turned:  # standstill is that of the joints whose efforts they were
            least, bound = HALF * least, HALF * bound
        # in one fit; friction alone feels that every sign is another one
        every = bool(np.all(x.signs < 0))
        if every or bound <= NEAR_FLOOR * OPEN * before or _fall(least, result, False) <= HALF:
            out.append((bound, rank, x))
    return sorted(out, key=lambda x: x[:2])


def _out_of_order(result: FitResult, recordings: list[Recording]) -> list[_Answer]:
    """Efforts that stand in another order than their positions.

    Either ones may be in the wrong columns: what fits is offered, both where both do.
    """
    order = _followed(result.problem)
    if order == sorted(order):
        order = _exchanged_positions(result, recordings)
    if order == sorted(order):
        return []
    back, before = [order.index(k) for k in range(len(order))], _size(result)
    efforts = [replace(r, tau=r.tau[:, back]) for r in recordings]
    motions = _with_positions(recordings, order)
    fits = []
    for stem, columns, runs in (("tau", back, efforts), ("q", order, motions)):
        after = fit(_again(result, runs), result.model, sweeps=1)
        if _fits(after, before, OPEN) or _freed(after, result):
            fits.append((_size(after), stem, columns, after, runs))
    if not fits:
        return []
    least, *_, best, read = min(fits, key=lambda x: x[0])
    joints = result.problem.joints
    said = [_exchange(stem, x, joints) for e, stem, x, *_ in fits if HALF * e < least]
    text = f"{said[0][0]}; name the columns in a map ({said[0][1]})"
    if least > OPEN * before:
        text = text.replace(FITS, f"{FITS} better, though not all is explained")
    if len(said) > 1:
        text += (
            f". With the positions in another order it fits as well ({said[1][1]}): the program "
            "that wrote the table knows which of the two it exchanged; change only one of them"
        )
    return [_Answer(HALF * least, best, "swapped", text, 2, runs=read)]


def _with_positions(recordings: list[Recording], order: list[int]) -> list[Recording]:
    """The runs with the positions, and speeds, of joints in another order."""
    return [replace(ordered(r, order), tau=r.tau) for r in recordings]


def _exchanged_positions(result: FitResult, recordings: list[Recording]) -> list[int]:
    """Order with two positions exchanged that leaves least, of joints that fit worst; else as is.

    An effort that is mostly another joint's weight follows no position by itself.  Of two wrong
    positions both joints are predicted badly.
    """
    error, same = result.relative / 100, list(range(result.problem.d))
    bad = np.flatnonzero(~result.problem.holds & (error > TENTH)).tolist()
    orders = [exchanged(same, a, b) for a, b in combinations(bad, 2)]
    if not orders:
        return same
    left = [
        _size(fit(_again(result, _with_positions(recordings, x)), result.model, sweeps=1))
        for x in orders
    ]
    return orders[int(np.argmin(left))]


def _by_motors(result: FitResult, recordings: list[Recording]) -> list[_Answer]:
    """Joints that are counted from another link than the one before, as motors in a base are.

    Positions alone, or efforts, too.
    """
    if isinstance(result.problem.robot, IndependentAxes):
        return []
    return [x for efforts in (True, False) for x in _as_motors(result, recordings, efforts)]


def _as_motors(result: FitResult, recordings: list[Recording], efforts: bool) -> Iterator[_Answer]:
    """What fits if neighbours are counted together: one after another, as long as less is left."""
    known: tuple[_Link, ...] = ()
    best = result
    while True:
        found = []
        for link in _links(best):
            if all(x.joint != link.joint for x in known):
                runs = [_by_joints(r, (*known, link), efforts) for r in recordings]
                found.append((link, fit(_again(result, runs), result.model, sweeps=1)))
        if not found:
            break
        link, after = min(found, key=lambda x: _size(x[1]))
        if _size(after) > WHOLE * _size(best):
            break
        known, best = (*known, link), after
    if known and (_fits(best, _size(result), OPEN) or _freed(best, result)):
        text = _as_counted(known, efforts, result.problem.joints)
        text = f"{text}: the model's error {_falls(best, result)}"
        runs = [_by_joints(r, known, efforts) for r in recordings]
        yield _Answer(_size(best), best, "coupled", text, 2 * len(known), _off(best), runs=runs)


@dataclass(frozen=True)
class _Link:
    """Motor of a joint that turns with another joint, too: m_j = q_j + sign q_k."""

    joint: int
    other: int
    sign: float


def _links(result: FitResult) -> Iterator[_Link]:
    """What neighbours may be counted together, of which one fits badly."""
    moves = np.flatnonzero(~result.problem.holds).tolist()
    for k, j in pairwise(moves):
        if max(result.relative[[j, k]]) > 100 * TENTH:
            yield from (_Link(j, k, sign) for sign in (1.0, -1.0))


def _turned(links: Sequence[_Link], d: int) -> FloatArray:
    """Joints (d, d) of motors, q = T m."""
    turn = np.eye(d)
    for x in links:
        turn[x.joint, x.other] -= x.sign
    return turn


def _by_joints(run: Recording, links: Sequence[_Link], efforts: bool) -> Recording:
    """A run of motors as one of joints; with `efforts` those are of the motors, too.

    The power is the same, n' dm/dt = tau' dq/dt with q = T m, so that n = T' tau.
    """
    turn = _turned(links, run.q.shape[1])
    speeds = None if run.qd is None else run.qd @ turn.T
    tau = run.tau @ np.linalg.inv(turn) if efforts else run.tau
    return replace(run, q=run.q @ turn.T, qd=speeds, tau=tau)


def _as_counted(links: Sequence[_Link], efforts: bool, joints: tuple[str, ...]) -> str:
    """What is counted from where, and what a map says of it."""
    with_others = [
        f"q{x.joint + 1} ({joints[x.joint]}) also turns with q{x.other + 1} ({joints[x.other]})"
        for x in links
    ]
    turn = _turned(links, len(joints))
    rows = [("q", turn)] + ([("tau", np.linalg.inv(turn).T)] if efforts else [])
    lines = []
    for stem, matrix in rows:
        for k in np.flatnonzero(np.any(matrix != np.eye(len(joints)), axis=1)):
            terms = (f"{stem}{i + 1} = {matrix[k, i]:g}" for i in np.flatnonzero(matrix[k]))
            lines.append(f"{stem}{k + 1} = {{ sum = {{ {', '.join(terms)} }} }}")
    whose = (
        "positions and efforts seem to be those of motors that count from another link"
        if efforts
        else "positions seem to be counted from another link"
    )
    entries = "; ".join(lines)
    return f"{' and '.join(with_others)}: {whose}. Say so under [columns] in a map ({entries})"


def _exchange(stem: str, order: Sequence[int], joints: tuple[str, ...]) -> tuple[str, str]:
    """What columns are taken in another order, and what a map says of them."""
    moved = [k for k, column in enumerate(order) if k != column]
    names = [f"{stem}{k + 1}" for k in moved]
    how = "swapped" if len(moved) == 2 else "in the wrong columns"
    what = f"{', '.join(names[:-1])} and {names[-1]} ({', '.join(joints[k] for k in moved)})"
    taken = [f"{stem}{k + 1} from the column of {stem}{order[k] + 1}" for k in moved]
    return f"{what} are {how}: in the other order {FITS}", ", ".join(taken)


def _followed(problem: Problem) -> list[int]:
    """Position that each joint's effort follows best, each taken once: column of q by joint.

    By what a joint's own acceleration, speed, direction and posture leave of an effort; counted
    from the efforts: position order[k] belongs with effort k.
    """
    moves = np.flatnonzero(~problem.holds)
    order = list(range(problem.d))
    left = np.zeros((moves.size, moves.size))
    for a, j in enumerate(moves):
        at = problem.live[j]
        y = problem.effort[j, at]
        for b, k in enumerate(moves):
            q, v = problem.q[k, at], problem.qd[k, at]
            sign = np.tanh(v / max(float(problem.speed_noise[k]), 1e-300))
            one = np.ones(q.size)
            own = np.stack([problem.qdd[k, at], v, sign, one, q, np.sin(q), np.cos(q)], axis=1)
            basis = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
            left[a, b] = float(np.linalg.norm(orthogonal_part(y, basis)))
    left = np.log(np.maximum(left, 1e-300))
    rows, taken = scipy.optimize.linear_sum_assignment(left)
    gain = float(np.trace(left) - left[rows, taken].sum())
    moved = int(np.sum(rows != taken))
    if moved and gain > -moved * np.log(WHOLE):
        for row, column in zip(rows, taken, strict=True):
            order[int(moves[row])] = int(moves[column])
    return order


def _again(
    result: FitResult, changed: list[Recording], robot: RobotSource | None = None
) -> Problem:
    """The problem of a fit with changed runs, or of another robot."""
    problem = result.problem
    source = robot or problem.source
    return Problem(changed, source, result.model.explains, rates=problem.rates)


def _falls(after: FitResult, before: FitResult) -> str:
    """How an error falls: over all joints where it does so much, else of the joint that gains."""
    b, a = _size(before), _size(after)
    if _fits(after, b, OPEN) or before.problem.d == 1:
        return f"falls from {b:.3g} to {a:.3g} % of the effort"
    j = int(
        np.argmin(np.maximum(after.relative, 100 * MATTERS) / np.maximum(before.relative, 1e-9))
    )
    return (
        f"falls from {before.relative[j]:.3g} to {after.relative[j]:.3g} % of the effort on "
        f"{before.problem.joints[j]}; more is missing, which a diagnosis of the mended recording "
        "may name"
    )


def _fits(after: FitResult, before: float, share: float) -> bool:
    """Whether a model that left so much over all joints [%] leaves less than a share of it now."""
    return _size(after) < share * before and float(np.max(after.relative)) < 100 * HALF


def _fall(after: FloatArray, before: FitResult, one_by_one: bool = True) -> float:
    """What is left of errors (d,) [%] in their geometric mean; 1 and more where they rise.

    What is hidden beside a wrong column stays on its own joints, and may be most of their error:
    log s_j summed over the joints is what a likelihood counts that knows no s_j.  A fall beside a
    rise on another joint counts less, by `OPEN` for `HALF`.
    """
    moves = ~before.problem.holds & ~before.problem.silent
    if not moves.any():
        return 1.0
    least = 100 * MATTERS
    ratio = (np.maximum(after, least) / np.maximum(before.relative, least))[moves]
    fall = float(np.exp(np.mean(np.log(ratio))))
    return fall * HALF / OPEN if one_by_one and np.any(ratio > 1 + WORTH) else fall


def _freed(after: FitResult, before: FitResult) -> bool:
    """Whether a correction without a free zero takes most of the error, beside what is hidden.

    It may not lead away from the described gravity; one that mends a gravity of another order need
    not take most.  What leaves more than half of an effort that it changes says nothing.
    """
    changed = np.abs(after.relative - before.relative) > WORTH * before.relative
    if np.any(after.relative[changed] >= 100 * HALF):
        return False
    nearer, fall = _off(before) - _off(after), _fall(after.relative, before)
    return nearer > -WORTH and fall < (1 - TENTH if nearer > -np.log(TENTH) else HALF)


def _of_tip(result: FitResult, recordings: list[Recording]) -> list[tuple[str, str]]:
    """Fault (code, sentence) of a force in the axes of its sensor at the tip; none where it is not.

    Told where the base model fits with the force turned into axes of the base, and not without.
    """
    robot, source = result.problem.robot, result.problem.source
    if robot.tree is None or any(r.wrench is None for r in recordings):
        return []
    changed = []
    for r in recordings:
        axes = robot.tip_axes(r.q)
        if axes is None or r.wrench is None:
            return []
        changed.append(replace(r, wrench=in_base_axes(r.wrench, axes)))
    before = _size(result)
    after = fit(_again(result, changed), result.model, sweeps=1)
    if _size(after) >= OPEN * before:
        return []
    link = source.tip or "LINK"
    return [
        (
            "force-axes",
            "the measured force (fx, fy, fz) is in the axes of its sensor at the tip and not in "
            f"those of the base: turned, the model's error falls from {before:.3g} to "
            f'{_size(after):.3g} % of the effort. Say force_axes = "{link}" under [robot] in a '
            "map, with the link that carries the sensor, and import again",
        )
    ]


def _size(result: FitResult) -> float:
    """Relative error over all joints [%]."""
    return float(np.sqrt(np.mean(result.relative**2)))


@dataclass(frozen=True)
class _Change:
    """Efforts read in another way: code, sentence, column and sign of each joint's effort."""

    code: str
    text: str
    order: list[int]
    signs: FloatArray

    @property
    def turned(self) -> bool:
        """Whether only signs change."""
        return self.order == sorted(self.order)

    @property
    def entries(self) -> int:
        """How many entries of a map it changes."""
        return int(np.sum(self.signs < 0)) + sum(k != x for k, x in enumerate(self.order))

    def of(self, recordings: Sequence[Recording]) -> list[Recording]:
        """The runs with the efforts read in this way."""
        return [replace(r, tau=r.tau[:, self.order] * self.signs) for r in recordings]

    def problem(self, result: FitResult, changed: list[Recording]) -> Problem:
        """The problem of a fit to these runs."""
        if self.turned:
            return result.problem.with_signs(changed, self.signs)
        return _again(result, changed)


def _changes(result: FitResult) -> Iterator[_Change]:
    """What columns may be meant.

    A joint whose effort is another one's fits badly, and so does the other one's.
    """
    joints, error = result.problem.joints, result.relative
    d, bad = len(joints), error > 100 * TENTH
    order, fits = list(range(d)), f"with the other sign {FITS}; change it in a map"
    for k, joint in ((k, x) for k, x in enumerate(joints) if bad[k]):
        signs = np.where(np.arange(d) == k, -1.0, 1.0)
        text = f"tau{k + 1} ({joint}) has the wrong sign: {fits}"
        yield _Change("sign", text, order, signs)
    if d > 1:
        text = f"all efforts have the wrong sign: with the other one {FITS}; change it in a map"
        yield _Change("sign", text, order, np.full(d, -1.0))
    for a, b in combinations(np.flatnonzero(bad).tolist(), 2):
        swapped = exchanged(order, a, b)
        text, taken = _exchange("tau", swapped, joints)
        text = f"{text}; name the columns in a map ({taken})"
        yield _Change("swapped", text, swapped, np.ones(d))
        if d > 2:
            signs = np.where(np.isin(np.arange(d), (a, b)), -1.0, 1.0)
            both = f"tau{a + 1} and tau{b + 1} ({joints[a]}, {joints[b]}) have the wrong sign"
            yield _Change("sign", f"{both}: {fits}", order, signs)


def _other_posture(result: FitResult, recordings: list[Recording]) -> list[_Answer]:
    """Postures that fit in another way; none where none does."""
    arm = result.problem.d > 1 and not isinstance(result.problem.robot, IndependentAxes)
    if not arm or np.all(result.problem.holds):
        return []
    before, out = _size(result), []
    for x in countings(result, recordings):
        after = _counted(result, x)
        if x.lengths and _size(after) < WHOLE * before:
            x = x.tuned(partial(_left_of, result, x))
            after = _counted(result, x)
        if _fits(after, before, x.share) or (x.fixed and _freed(after, result)):
            what = f"the model's error {_falls(after, result)}"
            said = f"{x.text}, and import again: {what}" if x.text else ""
            if TIMES in said:
                said = said.replace(TIMES, f"{scale_factor(x, after):.2g}")
            off, runs = _off(after), x.runs if x.robot is result.problem.source else []
            out.append(
                _Answer(_size(after), after, x.code, said, x.changes, off, not x.fixed, runs)
            )
    return out


def _counted(result: FitResult, x: Counting) -> FitResult:
    """The model fitted to runs, or for a robot, that are otherwise."""
    model = replace(result.model, robot=x.robot)
    return fit(_again(result, x.runs, x.robot), model, sweeps=1)


def _left_of(result: FitResult, x: Counting, robot: RobotSource) -> float:
    """Error [%] that is left of another robot."""
    return _size(_counted(result, replace(x, robot=robot)))
