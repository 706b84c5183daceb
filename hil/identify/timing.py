"""Alignment of effort and position within one sample, and of efforts that were recorded late.

A command that is held over its period acts half a period late, and position and effort of one
row are rarely taken at the same instant.  Up to one sample that is how the recording was made,
not a physical delay; left in, it imitates small effects at every reversal.

Efforts that are early by more may be a delay of the drive.  Efforts that are late by more cannot be
one: no joint moves before its motor pushes.  They came by a slower bus, or through a filter.  Slow
motion shows both as the same lateness L; the error over the whole band says how much of it is a
filter's (`hil.identify.problem.Alignment`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.identify.context import renew
from hil.identify.fit import fit
from hil.identify.problem import Alignment, Problem
from hil.identify.result import FitResult
from hil.identify.slow_motion import (
    CLEAR,
    FINEST,
    LATEST,
    LESS,
    common_lateness,
    lateness_line,
    left_free,
    longest_shift,
    recorded_late,
    sample_shift,
)
from hil.models.model import RobotModel

FloatArray = NDArray[np.float64]
#: Gauss-Newton steps for the shift, and share of a sample from which another one is taken.
STEPS, AGAIN = 3, 0.25

#: Standard errors from which a lateness grows: twice those of one test in a hundred.
CERTAINLY = 4.65
#: How often late efforts are shifted: they blunt the sign of friction, which then asks for too
#: small a shift.
TURNS = 8
#: Poles of the filters that are tried; 0: a moving average.
SHAPES = (1, 2, 0)
#: Shares of a lateness that are tried as a filter's, and how often their neighbours are.
FILTERED, CLOSER = (0.5, 1.0), 3
#: Share of a filter's lateness to which it is known well enough.
SETTLED = 0.005
#: Relative error of no model at all [%].
NOTHING = 100.0
#: Share of the squared error that a delay must take where it is asked for beside a model that has
#: grown, and the model is sought again with it: how a recording was made takes nearly all, a
#: delay in the place of a first-order filter about three quarters (pendulum, 7 Hz).  With 0.95
#: delays beside a second missing effect are not found.
DELAYED = 0.9


def fit_as_stated(
    problem: Problem, model: RobotModel, scale: FloatArray | None = None
) -> FitResult:
    """Fit with the alignment that the model or the recording states, and no other one.

    `scale` as in `fit`.
    """
    given = problem.given_shift
    known = problem.given_lag.lag or problem.given_lag.rate
    stated = problem.given_lag if known else problem.alignment
    stated = replace(stated, shift=problem.shift if given is None else given)
    if stated != problem.alignment:
        problem.align_effort(stated)
    return fit(problem, model, scale=scale)


def fit_aligned(problem: Problem, model: RobotModel, scale: FloatArray | None = None) -> FitResult:
    """Fit, align the effort, fit again; leaves the problem aligned.

    Within one sample, and beyond it where efforts are late and the error falls with it: how a
    recording was made, which the first model that is fitted to it decides.  `scale` as in `fit`.
    """
    result = fit_as_stated(problem, model, scale)
    if problem.given_shift is not None or problem.aligned:
        return result
    start, at_first, longest = problem.alignment, result.relative, longest_shift(problem)
    ask = not problem.asked_late and not start.lag and model.explains == "motor"
    slack = None
    if ask:
        problem.asked_late = True
        slack = left_free(result, bristles=True)
        result = _taken_earlier(problem, model, result, scale)
    result = _in_time(problem, model, result, scale)
    if ask and problem.shift < -longest:
        result = _filter_undone(problem, model, result, scale)
    late = problem.alignment.late > longest >= start.late
    built_up = late and slack is not None and bool(np.mean(np.log(left_free(result) / slack)) > 0.0)
    if built_up or (late and _ratio(result, at_first) > 1 - LESS):
        # what bends before it slides looks late, and leaves less where nothing is shifted
        problem.align_effort(start)
        result = fit(problem, model, scale=scale)
    return _in_step(problem, model, result, scale) if ask and not start.rate else result


def _in_step(
    problem: Problem, model: RobotModel, result: FitResult, scale: FloatArray | None
) -> FitResult:
    """The fit with efforts whose lateness grows taken earlier by more and more.

    As it was where that is not sure, less than half a sample in all, or does not take `LESS` of the
    error.
    """
    start, error = problem.alignment, result.relative
    length = max(float(m.since[-1]) for m in problem.motions)
    for _ in range(STEPS):
        middle, rate, known = lateness_line(result)
        now = problem.alignment
        little = now == start and abs(rate) * length < longest_shift(problem) / 2
        if little or abs(rate) < CERTAINLY * known:
            break
        # tau(t) = r(t - s + c t); with two clocks no lateness is a part of a sample
        shift = now.shift - middle + rate * length / 2
        problem.align_effort(replace(now, rate=now.rate + rate, shift=shift))
        result = _in_time(problem, model, fit(problem, model, scale=scale), scale)
    if problem.alignment.rate == start.rate or _ratio(result, error) < 1 - LESS:
        return result
    problem.align_effort(start)
    return fit(problem, model, scale=scale)


def _in_time(
    problem: Problem, model: RobotModel, result: FitResult, scale: FloatArray | None
) -> FitResult:
    """The fit with efforts and positions aligned to a part of a sample."""
    longest = longest_shift(problem)
    least = -longest if problem.shift >= -longest else -LATEST
    for _ in range(STEPS):
        shift, error = sample_shift(result)
        if not shift or not least <= problem.shift + shift <= longest:
            break
        before = result.relative
        problem.shift_effort(shift)  # tau(t) = model(t) + T tau'(t)
        result = fit(problem, model, scale=scale)
        if abs(shift) < CLEAR * error and _ratio(result, before) > 1.0:
            # neither the slow motion is sure of it nor does the whole band want it
            problem.shift_effort(-shift)
            result = fit(problem, model, scale=scale)
            break
        if abs(shift) < AGAIN * longest:
            break
    return result


def late_beside(result: FitResult) -> bool:
    """Whether efforts prove late by more than a sample beside a model with further effects.

    Or by more and more; or, if they are known to be late, to have passed a filter.  A large effect
    that the given model lacks hides it there.  Leaves the problem aligned for good if so, and the
    model to be sought again; else everything as it was.
    """
    problem = result.problem
    before, longest, error = problem.alignment, longest_shift(problem), result.relative
    known = problem.given_shift is not None or problem.aligned or result.model.explains != "motor"
    if known or before.lag:
        return False
    found = result
    if problem.shift >= -longest and recorded_late(result):
        found = _taken_earlier(problem, result.model, result, result.sigma)
        found = _in_time(problem, result.model, found, result.sigma)
    if problem.shift < -longest:
        found = _filter_undone(problem, result.model, found, result.sigma)
    if not before.rate:
        found = _in_step(problem, result.model, found, result.sigma)
    now = problem.alignment
    changed = now.lag > 0.0 or now.late > before.late + longest or now.rate != before.rate
    problem.aligned = changed and _ratio(found, error) ** 2 < 1 - DELAYED
    if not problem.aligned:
        problem.align_effort(before)
        renew(result)
    return problem.aligned


def late_after_all(result: FitResult) -> bool:
    """Whether the last model leaves less with efforts taken by another lateness of all joints.

    What the given model lacks may hide a lateness of a sample or two; what leaves a tenth less over
    the whole band, beside free laws of friction that look late, is how the recording was made.
    Leaves the problem aligned for good if so, with other models of it to be fitted anew; else
    everything as it was.
    """
    problem = result.problem
    before, settled, error = problem.alignment, problem.aligned, result.relative
    known = problem.given_shift is not None or (settled and before != Alignment())
    other = result.model.explains != "motor" or before.lag or before.rate
    if known or other or common_lateness(result)[1] > 1 - LESS:
        return False
    free = left_free(result, bristles=True)
    longest, found = longest_shift(problem), result
    for _ in range(STEPS):
        late, _ = common_lateness(found)
        if not -LATEST < problem.shift + late <= longest:
            break
        problem.shift_effort(late)
        found = fit(problem, result.model, scale=result.sigma)
        if abs(late) < longest / FINEST:
            break
    now = left_free(found, bristles=True) / free
    less = float(np.exp(np.mean(np.log(now)))) < 1 - LESS and np.all(now < 1 + LESS)
    if less and _ratio(found, error) < 1.0:
        problem.aligned = True
        return True
    problem.align_effort(before)
    renew(result)
    return False


def _taken_earlier(
    problem: Problem, model: RobotModel, result: FitResult, scale: FloatArray | None
) -> FitResult:
    """The fit with late efforts taken earlier; as it was where no shift up to `LATEST` is best."""
    start = problem.shift, result
    for _ in range(TURNS):
        late = recorded_late(result)
        if not late:
            return result
        if problem.shift + late <= -LATEST:
            break
        problem.shift_effort(late)
        result = fit(problem, model, scale=scale)
    if problem.shift == start[0]:
        return start[1]
    problem.shift_effort(start[0] - problem.shift)
    return fit(problem, model, scale=scale)


def _filter_undone(
    problem: Problem, model: RobotModel, result: FitResult, scale: FloatArray | None
) -> FitResult:
    """The fit of late efforts with a low-pass undone in the place of a part of their shift.

    As it was where that does not take `LESS` of the squared error.
    """
    start, error = problem.alignment, result.relative
    tried: dict[tuple[int, float], float] = {}

    def fitted(poles: int, share: float) -> FitResult:
        shift, lag = -(1 - share) * start.late, share * start.late
        problem.align_effort(replace(start, shift=shift, lag=lag, poles=poles))
        return fit(problem, model, scale=scale)

    def best(more: Iterable[tuple[int, float]]) -> tuple[int, float]:
        for one in more:
            if one not in tried and one[1] > 0.0:
                tried[one] = _ratio(fitted(*one), error)
        return min(tried, key=tried.__getitem__)

    poles, share = best((n, x) for n in SHAPES for x in FILTERED)
    for k in range(CLOSER):
        step = 0.25 / 2**k
        poles, share = best([(poles, share - step), (poles, share + step)])
    if tried[poles, share] ** 2 > 1 - LESS:
        problem.align_effort(start)
        renew(result)
        return result
    return _to_the_end(problem, model, _in_time(problem, model, fitted(poles, share), scale), scale)


def _to_the_end(
    problem: Problem, model: RobotModel, result: FitResult, scale: FloatArray | None
) -> FitResult:
    """The same with all that is still late given to the filter, as long as the error falls by it.

    A filter is late by less where it is fast, so that the slow motion first says too little.
    """
    for _ in range(TURNS):
        last, error = problem.alignment, result.relative
        share = last.late / max(last.lag, 1e-300)
        if abs(share - 1) < SETTLED or last.late > LATEST:
            break
        problem.align_effort(replace(last, shift=0.0, lag=last.late))
        longer = _in_time(problem, model, fit(problem, model, scale=scale), scale)
        if _ratio(longer, error) > 1.0:
            problem.align_effort(last)
            return fit(problem, model, scale=scale)
        result = longer
    return result


def _ratio(result: FitResult, before: FloatArray) -> float:
    """Relative error of the joints that move over what it was before (d,), their geometric mean.

    Relative to the effort as each of them has it: a filter that is undone makes it larger.  What
    foretells worse than no model at all is no better where it is less bad: `NOTHING` at most.
    """
    moves = ~result.problem.holds
    now, then = (np.clip(x[moves], 1e-300, NOTHING) for x in (result.relative, before))
    return float(np.exp(np.mean(np.log(now / then))))


#: Codes of notes on the alignment: within a sample, and efforts that were recorded later than that.
ALIGNED, RECORDED_LATE = "late-effort", "recorded-late"


def filter_text(a: Alignment) -> str:
    """A filter that was undone: its poles and half-power frequency, or its length."""
    if not a.poles:
        return f"a moving average over {2e3 * a.lag:.3g} ms"
    poles = "one pole" if a.poles == 1 else "two poles"
    return f"a low-pass of {poles} at {np.sqrt(a.poles) / (2 * np.pi * a.lag):.3g} Hz"


def growing(problem: Problem) -> str:
    """In words how late the efforts are at both ends of a run, where their clock is another one."""
    a, length = problem.alignment, max(float(m.since[-1]) for m in problem.motions)
    first, last = (_lateness_text(a.late + a.rate * t) for t in (0.0, length))
    return (
        f"{first} at the start and {last} at the end: their clock and that of the positions differ "
        f"by {abs(1e6 * a.rate):.3g} ppm"
    )


def _lateness_text(seconds: float) -> str:
    """A lateness in words, to a hundredth of a millisecond."""
    if abs(seconds) < 1e-5:
        return "in time"
    return f"{abs(seconds) * 1e3:.3g} ms {'late' if seconds > 0 else 'early'}"


def late_effort(problem: Problem) -> list[tuple[str, str]]:
    """Note (code, sentence) on the lateness of the effort that was taken out; none for none."""
    a, longest = problem.alignment, longest_shift(problem)
    stated = problem.given_shift is not None or problem.given_lag.lag > 0.0
    if a.rate:
        return [
            (
                RECORDED_LATE,
                f"the efforts are {growing(problem)}. They were shifted by that. To use another "
                "value, set clock_ppm and shift_s under [signal]; to change nothing, set shift_s "
                "to 0",
            )
        ]
    if a.lag:
        rest = (
            f" (and the efforts shifted by {a.shift * 1e3:.3g} ms)" if abs(a.shift) > 1e-5 else ""
        )
        why = "No drive moves a joint before it pushes, so this is how they were recorded"
        why = "The model or map file says so" if stated else why
        return [
            (
                RECORDED_LATE,
                f"the efforts are {a.lag * 1e3:.3g} ms late, as behind {filter_text(a)}. "
                f"{why}: the filter was undone{rest}. To use another one, set "
                "lag_s, lag_poles and shift_s under [signal]; to change nothing, set shift_s to 0",
            )
        ]
    if abs(a.shift) < longest / FINEST:
        return []
    later, share = ("late" if a.shift < 0 else "early"), abs(a.shift) * min(problem.sources)
    size = f"the efforts are {abs(a.shift) * 1e3:.3g} ms {later} against the positions"
    said = f"{size} ({share:.2g} samples) and were shifted"
    if a.shift >= -longest or stated:
        return [(ALIGNED, f"{said} (to change it, set shift_s under [signal])")]
    return [
        (
            RECORDED_LATE,
            f"{said}. No drive moves a joint before it pushes, so they were recorded late: by a "
            "slower bus, or through a filter. To use another value, set shift_s under [signal]; "
            "to change nothing, set it to 0",
        )
    ]
