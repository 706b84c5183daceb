"""What pushed an arm and was recorded by nobody: for some moments, or at its tip all the time.

A push of a second in half a minute may be most of what is left of an effort.  Where the rest of the
error is small, its moments stand out by themselves (`touches`).  Where effects are missing, too,
they do not, and the push hides what is missing: the stretch that holds most of the error in little
of the time (`suspects`) is left out, all is sought again, and the better model tells whether
anything pushed there (`confirmed`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_propagation
from scipy.spatial import cKDTree

from hil.diagnosis.constants import (
    ADEQUATE,
    BEATEN,
    CERTAIN,
    FEWEST,
    HALF,
    PERIODS,
    SURE,
    TENTH,
    WHOLE,
    WORTH,
)
from hil.diagnosis.floor import free_columns, practical
from hil.diagnosis.residual_tests import NAMED_INSTANTS
from hil.identify.fit import in_units
from hil.identify.problem import Problem
from hil.identify.regression import reweighted
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
TOUCHED = "touched"


# ------------------------------------------------------------ what acts for a moment


@dataclass(frozen=True)
class Touch:
    """What acted on one joint for some moments of a run.

    Parameters
    ----------
    joint, name, unit : str
        Joint, run, and unit of its effort.
    run : int
        Number of the run.
    spans : list of (float, float)
        First and last times [s], as the run counts them.
    began : float
        When the run began [s], by the same clock.
    size : float
        Largest effort that the model does not explain.
    early : bool
        Whether it acts at the beginning of the run alone.
    """

    joint: str
    name: str
    unit: str
    run: int
    spans: list[tuple[float, float]]
    began: float
    size: float
    early: bool = False

    @property
    def text(self) -> str:
        """One sentence without its full stop, and what was done."""
        start = ", or was a spring or a mass not at rest when the run began" if self.early else ""
        when = [f"{a - self.began:.1f} to {b - self.began:.1f} s" for a, b in self.spans]
        size = f"{self.size:.2g} {self.unit}"
        return (
            f"{self.joint}: an effort of up to {size} that the motion does not explain acts at "
            f"{', '.join(when)} of {self.name}, and at no other time. Did a hand or an object push "
            f"there{start}? These times are left out of the fit, of the errors and of the noise "
            "floor"
        )


def touches(result: FitResult) -> list[Touch]:
    """Moments in which something other than the motion acts, run by run and joint by joint.

    A push lasts for a moment, is slow, and comes where the joint has been in the same motion
    without it: blocks of time whose residual is beyond what all others have, few in number, and
    with instants elsewhere of the same position, speed and predicted effort.  With the powers p of
    the blocks,

        z = (log p - median) / s,   s = 1.4826 median |log p - median|,

    a touch is a block of z > `CERTAIN` with its neighbours of z > `SURE`.  The residual is that of
    a fit to which blocks far above the others count less (`reweighted`).
    """
    return _moments(result, _struck)


def suspects(result: FitResult) -> list[Touch]:
    """Moments in which something may have acted: few of the time hold most of what is left.

    As `touches`, but that the joint was in each position, at each speed and under each effort at
    other times is enough.  Where no block stands out by itself, they are the stretch of blocks that
    a variance of its own suits best,

        max over stretches of  N log P - m log P_in - (N - m) log P_out,

    m of N blocks, with the mean powers P of all, inside and outside; `NAMED_INSTANTS` of them at
    most, as long as each has ten times the power of the rest.
    """
    return _moments(result, _either, together=False)


def confirmed(result: FitResult, told: Sequence[Touch]) -> list[Touch]:
    """What a better model of the same runs, moments included, shows to have acted then.

    That the joint was in each position, at each speed and under each effort elsewhere is enough.

    Parameters
    ----------
    result : FitResult
        The model that was found without these moments, fitted to the runs with them.
    told : sequence of Touch
        What is suspected.

    Returns
    -------
    list of Touch
        The same, with the times that are confirmed alone.
    """
    out, sure = [], suspects(result)
    for t in told:
        there = [x for s in sure if (s.joint, s.run) == (t.joint, t.run) for x in s.spans]
        spans = [(a, b) for a, b in t.spans if any(a < d and c < b for c, d in there)]
        out += [replace(t, spans=spans)] if spans else []
    return out


#: Which instants (n,) of the residual (n,) of joint j, dealt into blocks (n,), something acted at.
Which = Callable[[Problem, int, FloatArray, NDArray[np.int_]], NDArray[np.bool_]]


def _moments(result: FitResult, which: Which, together: bool = True) -> list[Touch]:
    """Moments that `which` picks, if they are slow, and elsewhere the same motion was without.

    `together`: as of `_elsewhere_alike`.
    """
    problem, out = result.problem, list[Touch]()
    measured = any(r.wrench is not None or r.tau_ext is not None for r in problem.recordings)
    if result.model.explains != "motor" or measured:
        return []
    # of time, also where a motion comes again
    at = (problem.t * problem.rates.effort / PERIODS).astype(int)
    blocks = at + problem.run * (int(at.max()) + 2)
    felt = result.rms > practical(problem) * problem.rms(problem.effort)
    joints = np.flatnonzero(~problem.holds & felt).tolist()
    if not joints:
        return out
    columns = free_columns(result).reshape(problem.d, problem.n, -1)
    sigma = result.sigma[:, None]
    residual = sigma * reweighted(
        columns, np.where(problem.live, result.residual / sigma, 0.0), blocks
    )
    for j in joints:
        r = np.where(problem.live[j], residual[j], 0.0)
        struck = _not_at_turns(problem, j, which(problem, j, r, blocks), r)
        slow = _slow_share(problem, np.where(struck, r, 0.0)[:, None])
        if slow > HALF and _elsewhere_alike(problem, j, struck, r, blocks, together):
            out += _touches_of(result, j, struck, r)
    return out


def _not_at_turns(
    problem: Problem, j: int, struck: NDArray[np.bool_], r: FloatArray
) -> NDArray[np.bool_]:
    """Of some instants (n,) the stretches whose residual r (n,) is not mostly that of slow moments.

    What friction does as a joint turns comes in bursts, and not at every turn alike.  The filter of
    the efforts spreads it over its period.
    """
    speed, wide = np.abs(problem.qd[j]), round(HALF * problem.rate / problem.rates.effort)
    turns = speed < TENTH * float(np.sqrt(np.mean(speed[problem.live[j]] ** 2)))
    turns = binary_dilation(turns, iterations=max(wide, 1))
    ends = np.flatnonzero(np.diff(np.r_[0, struck * (problem.run + 1), 0]))
    out = np.zeros_like(struck)
    for a, b in pairwise(ends.tolist()):
        power = r[a:b] ** 2
        out[a:b] = struck[a:b] & (float(power[turns[a:b]].sum()) <= HALF * float(power.sum()))
    return out


def _either(problem: Problem, j: int, r: FloatArray, blocks: NDArray[np.int_]) -> NDArray[np.bool_]:
    """Instants (n,) beyond all others, else those of few stretches with most of the residual."""
    struck = _struck(problem, j, r, blocks)
    return struck if np.any(struck) else _heaviest(problem, j, r, blocks)


def _heaviest(
    problem: Problem, j: int, r: FloatArray, blocks: NDArray[np.int_]
) -> NDArray[np.bool_]:
    """Instants (n,) of few stretches with most of a residual r (n,), with a block at each side."""
    power, full = _powers(problem, j, r, blocks)
    rest, none = full.copy(), np.zeros(problem.n, dtype=bool)
    if int(full.sum()) < FEWEST:
        return none
    run = np.full(power.size, -1)
    run[blocks] = problem.run
    most = int(BEATEN * full.sum())
    while (full & ~rest).sum() < most and _stretches(full & ~rest) < NAMED_INSTANTS:
        first, last = _stretch(np.where(rest, power, 0.0), rest, run, most)
        inside = rest.copy()
        inside[:first] = inside[last:] = False
        if float(np.mean(power[inside])) < float(np.mean(power[rest & ~inside])) / TENTH:
            break
        rest &= ~inside
    gone = full & ~rest
    if int(gone.sum()) > most or float(power[gone].sum()) < HALF * float(power[full].sum()):
        return none
    return np.asarray(binary_dilation(gone)[blocks])


def _stretches(some: NDArray[np.bool_]) -> int:
    """How many stretches of blocks there are."""
    return int(np.sum(np.diff(some.astype(int), prepend=0) > 0))


def _stretch(
    power: FloatArray, rest: NDArray[np.bool_], run: NDArray[np.int_], most: int
) -> tuple[int, int]:
    """First block, and the one after the last, of the stretch that a variance of its own suits."""
    total, count = np.r_[0.0, np.cumsum(power)], np.r_[0, np.cumsum(rest)]
    whole, n = float(total[-1]), int(count[-1])
    best, where = -np.inf, (0, 1)
    for width in range(1, most + 1):
        inside, m = total[width:] - total[:-width], count[width:] - count[:-width]
        same = run[width - 1 :] == run[: run.size - width + 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = -m * np.log(inside / m) - (n - m) * np.log((whole - inside) / (n - m))
        denser = inside * n > whole * m
        gain = np.where(same & denser & (m == width) & np.isfinite(gain), gain, -np.inf)
        k = int(np.argmax(gain))
        if gain[k] > best:
            best, where = float(gain[k]), (k, k + width)
    return where


def _powers(
    problem: Problem, j: int, r: FloatArray, blocks: NDArray[np.int_]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Power of a residual r (n,) by block, and which of them are at least half full."""
    live = problem.live[j]
    count = np.bincount(blocks, live, minlength=int(blocks.max()) + 1)
    power = np.bincount(blocks, np.where(live, r**2, 0.0)) / np.maximum(count, 1.0)
    return power, count > HALF * float(count.max())


def _struck(problem: Problem, j: int, r: FloatArray, blocks: NDArray[np.int_]) -> NDArray[np.bool_]:
    """Instants (n,) of a residual r (n,) of blocks beyond all others, with a block at each side.

    None where these are many, or less than a tenth of the error.
    """
    none = np.zeros(problem.n, dtype=bool)
    power, full = _powers(problem, j, r, blocks)
    if int(full.sum()) < FEWEST:
        return none
    level = np.log(np.maximum(power, 1e-300))
    middle = float(np.median(level[full]))
    z = (level - middle) / max(1.4826 * float(np.median(np.abs(level[full] - middle))), 1e-300)
    z = np.where(full, z, 0.0)
    beyond = binary_propagation(z > CERTAIN, mask=z > SURE)
    rest = float(np.mean(power[full & ~beyond]))
    most, wide = BEATEN * float(full.sum()), binary_dilation(beyond)
    if float(np.sum(beyond)) > most or float(np.mean(power[full])) < ADEQUATE**2 * rest:
        return none
    if _often(wide & full, full, blocks, problem):
        return none
    return np.asarray(wide[blocks])


def _often(
    struck: NDArray[np.bool_], full: NDArray[np.bool_], blocks: NDArray[np.int_], problem: Problem
) -> bool:
    """Whether blocks make up many moments, and much of the time, of some run: it is the motion."""
    run = np.full(struck.size, -1)
    run[blocks] = problem.whole[problem.run]
    for k in range(problem.runs):
        own = struck[run == k]
        moments = int(np.sum(np.diff(own.astype(int), prepend=0) > 0))
        if moments > NAMED_INSTANTS and float(own.sum()) > BEATEN * float(full[run == k].sum()):
            return True
    return False


def _elsewhere_alike(
    problem: Problem,
    j: int,
    struck: NDArray[np.bool_],
    r: FloatArray,
    blocks: NDArray[np.int_],
    together: bool = True,
) -> bool:
    """Whether joint j was in the same motion as at most of some instants (n,) at other times, too.

    By the power of what is left, r (n,): where position, speed and predicted effort are as near to
    those of another time as those of seven in ten of the other instants are, all of them together;
    or each by itself as near as that, or as `WORTH` of its spread.
    """
    x = np.stack([problem.q[j], problem.qd[j], problem.y[j] - r], axis=1)
    x = x / np.maximum(x.std(axis=0), 1e-300)
    quiet, at = problem.live[j] & ~struck, struck & problem.live[j]
    if not np.any(at):
        return False
    some = [x] if together else list(x.T[:, :, None])
    power = r[at] ** 2
    least = 0.0 if together else WORTH
    near = [float(power[_near(v, quiet, at, blocks, least)].sum()) for v in some]
    return min(near) > HALF * float(power.sum())


def _near(
    x: FloatArray,
    quiet: NDArray[np.bool_],
    at: NDArray[np.bool_],
    blocks: NDArray[np.int_],
    least: float,
) -> NDArray[np.bool_]:
    """Which of the instants `at` are as near in x (n, m) to quiet ones as most of those are.

    Or nearer than `least`.
    """
    apart = []
    for b in np.unique(blocks[quiet]).tolist():
        other = quiet & (np.abs(blocks - b) > 1)
        if np.any(other):
            apart.append(cKDTree(x[other]).query(x[quiet & (blocks == b)])[0])
    usual = float(np.quantile(np.concatenate(apart), WHOLE)) if apart else 0.0
    return np.asarray(cKDTree(x[quiet]).query(x[at])[0] < max(usual, least))


def _touches_of(result: FitResult, j: int, struck: NDArray[np.bool_], r: FloatArray) -> list[Touch]:
    """What acts on joint j at some instants (n,), run by run: of what is left there, r (n,)."""
    problem, out = result.problem, list[Touch]()
    unit = in_units("{F}", problem, j)
    for k in np.unique(problem.run[struck]).tolist():
        own = np.flatnonzero(problem.run == k)
        at = np.flatnonzero(struck[own])
        ends = np.flatnonzero(np.diff(at) > 1)
        first, last = at[np.r_[0, ends + 1]], at[np.r_[ends, at.size - 1]]
        part = problem.recordings[k]
        t, began = problem.t[own] + float(part.t[0]), float(part.t[0]) - problem.motions[k].began
        spans = [(float(t[a]), float(t[b])) for a, b in zip(first, last, strict=True)]
        size = float(np.max(np.abs(r[own[at]])))
        early = last[0] == last[-1] and t[first[0]] - t[0] < TENTH * (t[-1] - t[0])
        of = (problem.joints[j], part.name, unit, int(problem.whole[k]))
        out.append(Touch(*of, spans, began, size, bool(early)))
    return out


PUSHED = "pushed"
#: Components of a force.
_FORCE = 3


def pushed(result: FitResult, felt: NDArray[np.bool_]) -> list[tuple[str, str]]:
    """Note (code, sentence) that what is left is a slow force at the tip; none where it is not.

    With the tip's Jacobian J the residual r of the d joints that leave more than efforts are known
    to, `felt`, is split at every instant,

        r = J' F + e,   F the force in base axes that leaves least e,

    each joint in units of its rms.  Noise gives each of the d - 3 values of e as much power as each
    of the 3 of F.  Noise of the positions may act on several joints, too; it is fast.  Beside a
    measured force nothing is said: what is left may be that sensor's.
    """
    problem = result.problem
    if any(r.wrench is not None or r.tau_ext is not None for r in problem.recordings):
        return []
    robot, moves = problem.motions[0].robot, np.flatnonzero(~problem.holds & felt)
    free = moves.size - _FORCE
    q = np.ascontiguousarray(problem.q.T)
    if free < 1 or result.model.explains != "motor" or robot.tip_axes(q[:1]) is None:
        return []
    scale = np.maximum(result.rms, 1e-300)
    of_unit = [robot.external(q, np.tile(np.eye(6)[k], (len(q), 1))) for k in range(_FORCE)]
    r, x = (result.residual / scale[:, None]).T, np.stack(of_unit, axis=2) / scale[:, None]
    r, x = r[:, moves], x[:, moves]
    force = np.einsum("nkj,nj->nk", np.linalg.pinv(x), r)
    along = np.einsum("njk,nk->nj", x, force)
    tip, rest = float(np.sum(along**2)), float(np.sum((r - along) ** 2))
    if tip / _FORCE < CERTAIN * rest / free or _slow_share(problem, along) < HALF:
        return []
    taken = tip / max(tip + rest, 1e-300)
    size = float(np.sqrt(np.mean(np.sum(force**2, axis=1))))
    return [
        (
            PUSHED,
            f"an unmeasured force at the tip explains {100 * taken:.0f} % of the remaining error "
            f"on {moves.size} joints (noise: {100 * _FORCE / moves.size:.0f} %). It is slow and "
            f"has an rms of {size:.3g} N: a hand, a cable, a contact? Record it (fx, fy, fz), or "
            "leave those times out",
        )
    ]


def _slow_share(problem: Problem, x: FloatArray) -> float:
    """Share of the power of columns (n, m) below a quarter of the effort filter's cut-off."""
    low = total = 0.0
    for k in range(len(problem.recordings)):
        part = x[problem.run == k]
        power = np.abs(np.fft.rfft(part * np.hanning(len(part))[:, None], axis=0)) ** 2
        f = np.fft.rfftfreq(len(part), 1.0 / problem.rate)
        low += float(np.sum(power[f < problem.rates.effort / 4]))
        total += float(np.sum(power))
    return low / max(total, 1e-300)
