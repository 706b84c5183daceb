"""What sensors and filters do to a residual: errors that are no missing physics.

**Reversals that the filter of the positions blurs.**
Dry friction turns at once, and the acceleration jumps with it.  The filter rounds that corner, so
that its speed crosses zero some milliseconds away from where the joint did, and for so long the
model's friction has the wrong sign.  Where efforts are clean that is what is left.  With s the
sign of the filtered speed and s' that of a speed behind a wider filter, both as the rows see them,

    r ~ b (s' - s),   b > 0

lowers the error then; friction that builds up after a reversal, as before sliding, has b < 0.
No filter rounds more than the whole step: b is at most the model's friction.  Nor does it round
for longer than a period of its cut-off: a sign that is blunt beyond that is friction's own.

Friction that a rigid-body engine computes turns early as well: its stick is a joint that creeps,
held by an acceleration -v / T, so that with a the acceleration

    s' = tanh((v + T a) / v0).

**Laws of a transmission that do no more than smooth the noise of the measured positions.**
The model's load is made of measured positions, and takes their noise times the inertia with it.
What passes an elastic transmission is a smoother load, so that such a law lowers the error of any
joint whose encoder is coarse, on held-out runs, too.  A smoother without any delay does that
better than a spring, which also rings and lags:

    s = smoothed load - load,   gain(s, law) - gain(s) < TENTH gain(law)  =>  it smooths,

if there is as much noise.  With noise e of the size that the positions show, behind their filter,
the model predicts  y(q + e, ..) - y(q, ..)  more.  A law that lowers the squared error by no more
than about the square of that explains nothing, and what lowers it by a hundred times as much
smooths no noise, however smooth it is.

Source: errors in variables, Soederstroem, Automatica 43(6), 2007.

**Efforts that are rounded after they were recorded.**
A converter sends the motor the effort that was asked for, u, in whole steps h.  Where u is
recorded, what is left is what the rounding took,

    r = u - h round(u / h),

a saw over the effort whose height is its period: nothing of the motion does that.  A slow motion
stays within a step for long, so that the error is no noise there.
Source: Widrow, Kollar, Quantization Noise, 2008, ch. 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hil.diagnosis.constants import (
    ADEQUATE,
    COARSE_COUNTS,
    FLOOR_SHARE,
    HALF,
    LEAD,
    OPEN,
    RESPONSE,
    STIRRED,
    TENTH,
    UNSTIRRED,
    WHOLE,
)
from hil.diagnosis.floor import stir
from hil.diagnosis.types import Candidate, Evidence, Step
from hil.identify import bands
from hil.identify.design import Term
from hil.identify.fit import in_units
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.regression import least_squares
from hil.identify.result import FitResult
from hil.identify.slow_motion import real_delay
from hil.models.effect import Trait
from hil.models.motion import Motion
from hil.record.consistency import Note, notes_of

FloatArray = NDArray[np.float64]
BLURRED = "blurred"
#: Wider cut-offs of the positions, in units of the present one, and in units of the sample rate.
_WIDER, _WIDEST = (2.0, 4.0), 0.35


# ------------------------------------------------------------ what candidates are artefacts


def mark(found: list[Candidate], result: FitResult, projector: Projector) -> None:
    """Say of candidates whether they explain no more than sensors and filters do.

    Parameters
    ----------
    found : list of Candidate
        Those of which it matters: `smoother` and `blurred` are set.
    result : FitResult
        The fit that they were tried beside.
    projector : Projector
        Of that fit.
    """
    _mark_smoothers(found, result, projector)
    _mark_blurred(found, result, projector)


# ------------------------------------------------------------ reversals that a filter blurs


@dataclass(frozen=True)
class Blur:
    """What blurred or early reversals explain on one joint.

    Parameters
    ----------
    column : ndarray (n,)
        Weighted column s' - s on the joint's rows, times the largest b that friction allows; zeros
        where it explains nothing.
    effort : ndarray (n,)
        What it takes from the residual [N m or N].
    gain : float
        Fall of the weighted residual sum of squares.
    early : bool
        Whether it is a sign that turns early, which a motion that is measured late shows as well:
        then only a law that does less explains no more than that.
    open : bool
        Whether more friction than the model has would explain more: then it is not all.
    """

    column: FloatArray
    effort: FloatArray
    gain: float
    early: bool = False
    open: bool = False


def blur(result: FitResult, projector: Projector, j: int) -> Blur:
    """The other sign that explains most of joint j's residual, with a positive coefficient."""
    term = next((t for t in result.terms if Trait.DRY in t.effect.traits and t.joint == j), None)
    if term is None:
        return Blur(np.zeros(result.problem.n), np.zeros(result.problem.n), 0.0)
    key = ("blur", j, term.shape)
    if key not in projector.memo:
        projector.memo[key] = _best(result.problem, term, projector, _friction(result, j))
    found: Blur = projector.memo[key]
    return found


def _friction(result: FitResult, j: int) -> float:
    """The model's friction of joint j about its reversals [N m or N]: of the slowest tenth."""
    problem, total = result.problem, np.zeros(1)
    speed = np.concatenate([np.abs(m.qd[:, j]) for m in problem.motions])
    for t, where in zip(result.terms, result.slices, strict=True):
        if (
            t.joint == j
            and t.effect.family == "friction"
            and not (t.per_run or t.effect.scope.whole)
        ):
            raw = problem.raw(t.effect, j, t.shape)
            total = total + np.concatenate([x @ result.theta[where] for x in raw])
    return float(np.max(np.abs(total[speed <= np.quantile(speed, TENTH)]), initial=0.0))


def _best(problem: Problem, term: Term, projector: Projector, most: float) -> Blur:
    """The other sign that explains most; `most`: the model's friction [N m or N]."""
    best = Blur(np.zeros(problem.n), np.zeros(problem.n), 0.0)
    j = term.joint
    rows, sigma = projector.rows(term), float(projector.sigma[j])
    r = projector.residual[rows]
    for early, other in _signs(problem, j):
        c = _column(problem, term, other, early) / sigma
        known = projector.inner(rows, c[:, None])
        new = c - projector.spanned(known)[rows][:, 0]
        along, size = float(new @ r), float(new @ new)
        if along <= 0.0 or size <= 1e-12 * float(c @ c):
            continue
        largest = ADEQUATE * most
        b = min(along / size, largest)
        gain = b * (2 * along - b * size)
        if gain > best.gain:
            more = along > largest * size
            best = Blur(largest * c, b * new * sigma, gain, early > 0.0, more)
    return best


def _signs(problem: Problem, j: int) -> Iterator[tuple[float, list[FloatArray]]]:
    """Signs of joint j's speed behind wider filters, and signs that turn early by some seconds.

    Run by run, each behind the time by which it turns early.
    """
    for wider in _WIDER:
        yield 0.0, _sharp(problem, j, wider)
    for early in (LEAD / 4, LEAD / 2, LEAD):
        signs = [
            m.sign_of(m.qd[:, j] + early * m.qdd[:, j], m.qdd[:, j], float(m.resolution[j]))
            for m in problem.motions
        ]
        yield early, signs


def _column(problem: Problem, term: Term, other: list[FloatArray], early: float) -> FloatArray:
    """Difference of another sign and the model's about its turns, as the rows see it (n,)."""
    j, raw = term.joint, []
    for sharp, m in zip(other, problem.motions, strict=True):
        apart = sharp - term.effect.columns(m, j, term.shape)[:, 0]
        lasts = RESPONSE / problem.rates.position + early
        near = _turning(sharp, np.abs(m.qdd[:, j]) * lasts > m.v0[j], round(lasts / m.dt))
        raw.append((apart * near)[:, None])
    out: FloatArray = problem.gated(raw, j)[:, 0]
    return out


def _turning(sign: FloatArray, quick: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Instants (n,) within some of those quick ones between which a sign turns."""
    turns = np.append(np.diff(np.sign(sign)) != 0, False)
    turns[1:] |= turns[:-1]
    turns &= quick
    return np.asarray(maximum_filter1d(turns.astype(np.int8), 2 * reach + 1) > 0)


def _sharp(problem: Problem, j: int, wider: float) -> list[FloatArray]:
    """Sign of the speed behind a wider filter, averaged over each evaluation period, run by run."""
    key = ("sharp", j, wider)
    if key not in problem.memo:
        out = []
        for r, m in zip(problem.recordings, problem.motions, strict=True):
            cut = min(wider * problem.rates.position, _WIDEST * r.rate)
            speed = bands.derivatives(r.q[:, j : j + 1], r.rate, cut)[1][:, 0]
            rows = m.dt * r.rate
            sharp = np.sign(bands.every(speed, min(rows, 1.0)))
            stride = max(round(rows), 1)
            out.append(uniform_filter1d(sharp, stride)[::stride][: m.n])
        problem.memo[key] = out
    found: list[FloatArray] = problem.memo[key]
    return found


def _mark_blurred(found: list[Candidate], result: FitResult, projector: Projector) -> None:
    """Say of every candidate whether it explains no more than blurred reversals."""
    own = [c for c in found if c.score > 0 and not c.term.effect.scope.of_robot]
    for j in {c.term.joint for c in own}:
        blurred = blur(result, projector, j)
        for c in own:
            if blurred.gain > 0.0 and c.term.joint == j:
                law = projector.weighted(c.term)
                column = _felt(blurred.column, j, projector, len(law))
                more = projector.gain_beside(c.term, law, column) - blurred.gain
                less = c.gain < blurred.gain if blurred.early else not blurred.open
                c.blurred = less and more < OPEN * c.gain
                c.smoother &= not c.blurred


def blurred_parts(evidence: Evidence, result: FitResult) -> FloatArray:
    """Part of the squared error (d,) that is blurred reversals.

    Parameters
    ----------
    evidence : Evidence
        What was tried beside the fit.
    result : FitResult
        The fit.
    """
    problem = result.problem
    out = np.zeros(problem.d)
    if evidence.projector is not None and result.model.explains == "motor":
        for j in range(problem.d):
            gain = blur(result, evidence.projector, j).gain
            out[j] = gain * evidence.projector.sigma[j] ** 2 / max(problem.count[j], 1.0)
    return out


def blurred_above(warnings: Sequence[tuple[str, str]], ratio: Mapping[str, float]) -> bool:
    """Whether a joint of which warnings (code, sentence) say so is above its floor.

    Parameters
    ----------
    warnings : sequence of (str, str)
        Of a diagnosis.
    ratio : mapping of str to float
        Error over the noise floor, by joint.
    """
    return any(ratio.get(n.joint, 0.0) > ADEQUATE for n in notes_of(warnings, BLURRED))


def at_reversals(step: Step, evidence: Evidence, floor: FloatArray) -> bool:
    """Whether blurred reversals are most of the error of every joint that is above its floor.

    Parameters
    ----------
    step : Step
        The last model with names.
    evidence : Evidence
        Beside it.
    floor : ndarray (d,)
        Noise floor of its left-out error [N m or N].
    """
    over = ~step.result.problem.holds & (step.heldout.rms > ADEQUATE * floor)
    share = blurred_parts(evidence, step.result) / np.maximum(step.result.rms**2, 1e-300)
    return bool(np.any(over) and np.all(share[over] > HALF))


def blur_notes(evidence: Evidence, result: FitResult) -> list[tuple[str, str]]:
    """Warnings (code, sentence) for joints where that is a good part of the error."""
    share = blurred_parts(evidence, result) / np.maximum(result.rms**2, 1e-300)
    return [
        Note(
            BLURRED,
            f"{joint}: {100 * share[j]:.0f} % of the squared error comes from the filter at "
            "reversals, not from a missing effect: dry friction changes there faster than the "
            "position filter can follow. A wider filter lowers it (position_hz above "
            f"{result.problem.rates.position:.3g} under [signal] in the model file)",
            joint,
        )
        for j, joint in enumerate(result.problem.joints)
        if share[j] > FLOOR_SHARE
    ]


# ------------------------------------------------------------ efforts rounded after recording


ROUNDED = "rounded-efforts"
#: Steps that are tried, in units of the one whose rounding leaves the residual: a filter lets less
#: of it pass.
_STEPS = (0.7, 8.0)
#: Steps within the effort's range, at least: of few, the rounding is most of the effort itself.
_LEAST = 10
#: Lines of the search to one over the effort's range, how many at most, and sines of a saw.
_FINE, _MOST, _OVERTONES = 16, 2**12, 12
#: Peaks of the search that are fitted, those of them that are looked at closely, and values about
#: one.
HILLS, PEAKS, ABOUT = 90, 6, 17


def converter(result: FitResult, asked: NDArray[np.bool_]) -> tuple[float, ...]:
    """Steps (d,) of the converter that sends the efforts [N m or N], 0 where there are none.

    Empty where no joint shows any, or where the model says them already.

    Parameters
    ----------
    result : FitResult
        A fit of recorded efforts.
    asked : ndarray (d,)
        Whether a joint is asked for: the search takes some time.  The others are asked where one of
        these has steps.
    """
    problem = result.problem
    if problem.effort_step or result.model.explains != "motor":
        return ()
    projector = Projector(problem, result.terms, result.sigma)
    moves = ~problem.holds & ~problem.silent
    found: dict[int, float] = {}
    for joints in (asked & moves, ~asked & moves):
        # motors of one rig mostly have one kind of converter
        found |= {
            j: step for j in np.flatnonzero(joints).tolist() if (step := _rounding(projector, j))
        }
        if not found:
            return ()
    return tuple(found.get(j, 0.0) for j in range(problem.d))


def _rounding(projector: Projector, j: int) -> float:
    """The step whose rounding explains most of joint j's residual; 0 where that is little."""
    problem = projector.problem
    own = slice(j * problem.n, (j + 1) * problem.n)
    r, sigma = projector.residual[own], float(projector.sigma[j])

    def gain(step: float) -> float:
        c = _taken(problem, step, j) / sigma
        known = projector.inner(own, c[:, None])
        along, size = float(c @ r), float(c @ c) - float(known[:, 0] @ known[:, 0])
        # what rounding takes, and not what is as high as it likes
        b = along / max(size, 1e-300)
        return b * along if WHOLE < b < 1.0 / WHOLE else 0.0

    hills, apart = _steps(projector, j)
    peaks = sorted(hills, key=lambda f: -gain(1.0 / f))[:PEAKS]
    near = [1.0 / (f + x) for f in peaks for x in apart * np.linspace(-1.0, 1.0, ABOUT)]
    best = max(near, key=gain, default=0.0)
    return float(best) if best and gain(best) > HALF * float(r @ r) else 0.0


def _steps(projector: Projector, j: int) -> tuple[list[float], float]:
    """Steps a unit of effort that may be the converter's, and how far apart such are.

    What rounding to steps of 1 / f takes from an effort u is a saw of sines,

        u - round(f u) / f = sum_k (-1)^(k + 1) sin(2 pi k f u) / (pi k f),

    so that its product with the residual r is a sum of sine transforms S of what r weighs at each
    effort, g = F' r with the transpose of the filter.  Its size is about 1 / f.
    """
    problem = projector.problem
    r, sigma = projector.residual[j * problem.n : (j + 1) * problem.n], float(projector.sigma[j])
    effort = [
        _windows(x.tau[:, j], m, x.rate)
        for x, m in zip(problem.recordings, problem.motions, strict=True)
    ]
    u = np.concatenate([x.ravel() for x in effort])
    span, left = float(np.ptp(u)), float(np.sqrt(12.0 * np.mean(r**2))) * sigma
    if span <= 0.0 or left <= 0.0:
        return [], 0.0
    apart = 1.0 / (_FINE * span)
    first, last = (1.0 / (x * left * apart) for x in _STEPS[::-1])
    tried = np.arange(max(int(first), _LEAST * _FINE), min(int(last), _MOST) + 2)
    if tried.size < 3:
        return [], 0.0
    each = np.split(problem.back(r, j), np.cumsum([len(x) for x in effort])[:-1])
    g = np.concatenate(
        [np.repeat(w / x.shape[1], x.shape[1]) for w, x in zip(each, effort, strict=True)]
    )
    bins = _OVERTONES * int(tried[-1])
    place = (u - u.min()) * (bins / span)
    low = np.minimum(place.astype(np.int64), bins - 1)
    share = place - low  # between two bins
    heights = np.bincount(low, g * (1.0 - share), bins + 1)
    heights += np.bincount(low + 1, g * share, bins + 1)
    spectrum = np.fft.rfft(heights, _FINE * bins)
    along = np.zeros(tried.size)
    for k in range(1, _OVERTONES + 1):
        turn = np.exp(-2j * np.pi * apart * u.min() * k * tried)
        along += (-1) ** k / k * (turn * spectrum[k * tried]).imag
    score = np.maximum(along, 0.0) ** 2
    high = 1 + np.flatnonzero((score[1:-1] >= score[:-2]) & (score[1:-1] > score[2:]))
    return (apart * tried[high[np.argsort(score[high])[::-1][:HILLS]]]).tolist(), apart


def _taken(problem: Problem, step: float, j: int) -> FloatArray:
    """What rounding to whole steps takes from joint j's effort, as the rows see it (n,)."""
    each = zip(problem.recordings, problem.motions, strict=True)
    raw = [_saw(_windows(r.tau[:, j], m, r.rate), np.array([step])) for r, m in each]
    out: FloatArray = problem.gated(raw, j)[:, 0]
    return out


def _windows(effort: FloatArray, motion: Motion, rate: float) -> FloatArray:
    """Recorded efforts about each instant of a motion (n, k)."""
    if motion.dt * rate < bands.AS_RECORDED:
        return np.asarray(bands.nearest(effort, motion.dt * rate)[: motion.n, None])
    k = max(round(motion.dt * rate), 1)
    wide = np.concatenate([np.repeat(effort[:1], k // 2), effort, np.repeat(effort[-1:], k)])
    return wide[: motion.n * k].reshape(motion.n, k)


def _saw(effort: FloatArray, steps: FloatArray) -> FloatArray:
    """Mean over k of u - h round(u / h), of efforts u (n, k), for steps h (s,): (n, s)."""
    out = np.zeros((len(effort), steps.size))
    for u in effort.T:
        turns = u[:, None] / steps
        turns -= np.round(turns)
        out += turns
    out *= steps / effort.shape[1]
    return out


def rounded_notes(problem: Problem) -> list[tuple[str, str]]:
    """Warning (code, sentence) where the efforts are taken as a converter sends them."""
    told = [
        f"{step:.3g} {in_units('{F}', problem, j)} on {problem.joints[j]}"
        for j, step in enumerate(problem.effort_step)
        if step
    ]
    if not told:
        return []
    return [
        (
            ROUNDED,
            "The motors get the recorded efforts rounded to steps of a converter: "
            f"{', '.join(told)}. This is taken into account (effort_step under [signal] in the "
            "model file; [0.0] to switch it off)",
        )
    ]


POSITION_NOISE = "position-noise"
#: Cut-offs of smoothers [Hz].
_CUTS = (1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)


# ------------------------------------------------------------ noise of the positions


def _mark_smoothers(found: list[Candidate], result: FitResult, projector: Projector) -> None:
    """Say of every candidate whether all it does is to smooth."""
    own = [c for c in found if Trait.SMOOTHS in c.term.effect.traits and c.score > 0]
    stirred = stir(result) if own else np.zeros(0)
    for j in {c.term.joint for c in own}:
        smoothers = _smoothers(projector, j)
        for c in own:
            if c.term.joint == j:
                c.stirred = float(stirred[j])
                alike = _left(c, projector, smoothers) < TENTH * c.gain
                c.smoother = c.gain < (UNSTIRRED if alike else STIRRED) * c.stirred


def _left(c: Candidate, projector: Projector, smoothers: FloatArray) -> float:
    """Gain of a law beside the best of the smoothers (n, k) of its joint."""
    rows, law = projector.rows(c.term), projector.weighted(c.term)
    r = projector.residual[rows]
    smoothers = _felt(smoothers, c.term.joint, projector, len(r))
    best, more = 0.0, c.gain
    for k in range(smoothers.shape[1]):
        x = np.column_stack([smoothers[:, k], law])
        known = projector.inner(rows, x)
        gram, along = x.T @ x - known.T @ known, x.T @ r
        alone = float(along[0] ** 2 / max(gram[0, 0], 1e-300))
        # one with a negative sign would sharpen
        if along[0] > 0.0 and alone > best:
            both = float(along @ least_squares(gram, along))
            best, more = alone, both - alone
    return more


def _felt(own: FloatArray, j: int, projector: Projector, rows: int) -> FloatArray:
    """Columns (n, k) of joint j alone, beside a law of its rows or of those of all joints."""
    n, columns = projector.problem.n, own.reshape(len(own), -1)
    if rows == n:
        return columns
    out = np.zeros((rows, columns.shape[1]))
    out[j * n : (j + 1) * n] = columns
    return out


def _smoothers(projector: Projector, j: int) -> FloatArray:
    """What smoothers without delay take from joint j's load, weighted rows (n, k)."""
    problem = projector.problem
    raw = [
        np.stack([_smoothed(m.load[:, j], 1 / m.dt, cut) for cut in _CUTS], axis=1)
        for m in problem.motions
    ]
    return np.asarray(problem.gated(raw, j) / projector.sigma[j], dtype=np.float64)


def _smoothed(load: FloatArray, fs: float, cut: float) -> FloatArray:
    sos = scipy.signal.butter(2, min(cut / (fs / 2), 0.9), output="sos")
    out: FloatArray = scipy.signal.sosfiltfilt(sos, load) - load
    return out


def smoothed(evidence: Evidence, result: FitResult) -> FloatArray:
    """Part of the squared error (d,) that the positions' noise makes.

    Of a joint where a law does no more than smooth it: what that takes away, or what the noise
    makes of the predicted effort, if that is more.
    """
    out = np.zeros(result.problem.d)
    for c in evidence.candidates:
        if c.smoother:
            j = c.term.joint
            power = result.sigma[j] ** 2 / max(result.problem.count[j], 1.0)
            made = power * max(float(c.parts[j]), c.stirred)
            out[j] = max(out[j], min(made, float(result.rms[j]) ** 2))
    return out


def coarsely_encoded(problem: Problem) -> NDArray[np.bool_]:
    """Joints (d,) that mostly move by less than COUNTS steps of their encoder from row to row."""
    if ("coarse",) not in problem.memo:
        out = np.zeros(problem.d, dtype=bool)
        for m, r in zip(problem.motions, problem.recordings, strict=True):
            moved = np.median(np.abs(m.qd), axis=0) * max(m.dt, r.period)
            out |= moved < COARSE_COUNTS * bands.quanta(r.q)
        problem.memo["coarse",] = out
    found: NDArray[np.bool_] = problem.memo["coarse",]
    return found


def returned(evidence: Evidence, result: FitResult) -> FloatArray:
    """Part of the squared error (d,) that a lateness takes away which the slow motion denies.

    A controller answers the noise of a coarse encoder a little later: so a delay of the effort
    lowers the error, though nothing is late.
    """
    out, rough = np.zeros(result.problem.d), coarsely_encoded(result.problem)
    for c in evidence.candidates:
        j = c.term.joint
        if not (rough[j] and Trait.LATE in c.term.effect.traits and c.detected):
            continue
        if not real_delay(result, j, c.late):
            power = c.parts[j] * result.sigma[j] ** 2 / max(result.problem.count[j], 1.0)
            out[j] = max(out[j], float(power))
    return out


def shaken_joints(evidence: Evidence, result: FitResult) -> list[tuple[str, str]]:
    """Warnings (code, sentence) for joints where that is a good part of the error."""
    power = np.maximum(smoothed(evidence, result), returned(evidence, result))
    share = power / np.maximum(result.rms**2, 1e-300)
    return [
        (
            POSITION_NOISE,
            f"{joint}: {100 * share[j]:.0f} % of the squared error comes from the noise of the "
            "measured positions, not from a missing effect. A finer encoder, more motion or a "
            "narrower band ([signal] in the model file) lowers it",
        )
        for j, joint in enumerate(result.problem.joints)
        if share[j] > FLOOR_SHARE
    ]
