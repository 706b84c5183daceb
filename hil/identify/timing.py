"""Alignment of effort and position within one sample, and of efforts that were recorded late.

A command that is held over its period acts half a period late, and position and effort of one
row are rarely taken at the same instant.  Up to one sample that is how the recording was made,
not a physical delay; left in, it imitates small effects at every reversal.

Efforts that are early by more may be a delay of the drive.  Efforts that are late by more cannot be
one: no joint moves before its motor pushes.  They came by a slower bus, or through a filter.  Slow
motion shows both as the same lateness L; the error over the whole band says how much of it is a
filter's (`hil.identify.problem.Alignment`).

Measured velocities that are f times the derivative of the positions say that one of the two is
wrong: the velocities by f, the clock by 1 / f, or the positions by f.  Gravity depends on the
posture alone and inertia on the square of the clock, and both hold the same first moments, so
that a rigid body's effort tells them apart wherever a joint lifts something:

    tau = M(q) qdd + c(q, qd) + g(q);    t -> t / f:  qdd -> f^2 qdd,  g as it was.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.errors import HilError
from hil.identify.bands import Rates
from hil.identify.context import renew
from hil.identify.fit import fit
from hil.identify.problem import Alignment, Problem
from hil.identify.result import FitResult
from hil.identify.slow_motion import (
    CLEAR,
    FINEST,
    KNOWN,
    LATEST,
    LESS,
    common_lateness,
    lateness_line,
    left_free,
    longest_shift,
    recorded_late,
    sample_shift,
    slow_delay,
)
from hil.models.model import RobotModel, base_model
from hil.record.consistency import velocity_factor
from hil.record.recording import Recording

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
    first = result = fit_as_stated(problem, model, scale)
    if problem.given_shift is not None or problem.aligned:
        return result
    start, error, longest = problem.alignment, first.relative, longest_shift(problem)
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
    if built_up or (late and _ratio(result, error) > 1 - LESS):
        # what bends before it slides looks late, and leaves less where nothing is shifted
        result = _back(start, first)
    return _in_step(problem, model, result, scale) if ask and not start.rate else result


def _in_step(
    problem: Problem, model: RobotModel, result: FitResult, scale: FloatArray | None
) -> FitResult:
    """The fit with efforts whose lateness grows taken earlier by more and more.

    As it was where that is not sure, less than half a sample in all, or does not take `LESS` of the
    error.
    """
    start, first, error = problem.alignment, result, result.relative
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
    return _back(start, first)


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
        start, before, left = problem.alignment, result, result.relative
        problem.shift_effort(shift)  # tau(t) = model(t) + T tau'(t)
        result = fit(problem, model, scale=scale)
        most = 1.0 if abs(shift) < CLEAR * error else 1 + LESS
        if _ratio(result, left) > most:
            # the slow motion is not sure of it, or wrong: the whole band does not want it
            return _back(start, before)
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
        _back(before, result)
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
    _back(before, result)
    return False


def _taken_earlier(
    problem: Problem, model: RobotModel, result: FitResult, scale: FloatArray | None
) -> FitResult:
    """The fit with late efforts taken earlier; as it was where no shift up to `LATEST` is best."""
    start, first = problem.alignment, result
    for _ in range(TURNS):
        late = recorded_late(result)
        if not late:
            return result
        if problem.shift + late <= -LATEST:
            break
        problem.shift_effort(late)
        result = fit(problem, model, scale=scale)
    return first if problem.alignment == start else _back(start, first)


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
        return _back(start, result)
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
            return _back(last, result)
        result = longer
    return result


def _back(alignment: Alignment, result: FitResult) -> FitResult:
    """The fit of before, whose problem is as it was then; another fit would say the same again."""
    result.problem.align_effort(alignment)
    renew(result)
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
        why = "No joint moves before its motor pushes, so the recording itself is late"
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
            f"{said}. No joint moves before its motor pushes: they were recorded late (a slower "
            "bus, a filter), or an effect acts that the catalogue does not have. To use another "
            "value, set shift_s under [signal]; to change nothing, set it to 0",
        )
    ]


# ------------------------------------------------------------ what is said of a recording


@dataclass(frozen=True)
class Lateness:
    """By how much the efforts of a recording are late, as a diagnosis with the base model has it.

    Parameters
    ----------
    seconds : float or None
        Lateness against the positions [s], negative where they are early; None = not known.  Where
        it grows, that at the start.
    samples : float or None
        The same in samples.
    text : str
        One sentence without its full stop.
    """

    seconds: float | None
    samples: float | None
    text: str


def lateness(recording: Recording) -> Lateness:
    """Lateness of the efforts within one sample, by a fit of the base model.

    Parameters
    ----------
    recording : Recording
        With its robot; several joints without a description have no model to tell it by.
    """
    source = recording.robot
    if recording.d > 1 and not source.urdf and source.preset in ("", "single-axis"):
        return Lateness(
            None,
            None,
            "the delay between efforts and positions is unknown without the robot's geometry: "
            "give --robot ARM.urdf",
        )
    try:
        problem = Problem([recording], source)
        result = fit_aligned(problem, base_model(source))
    except HilError as error:
        return Lateness(None, None, f"the delay between efforts and positions is unknown: {error}")
    longest, samples = longest_shift(problem), min(problem.sources)
    if problem.given_shift is not None:
        given = problem.given_shift
        said = f"the efforts are shifted by {given * 1e3:.3g} ms, as [signal] in the map file says"
        return Lateness(-given, -given * samples, said)
    known = [
        slow_delay(result, j, friction=True)[1] for j in np.flatnonzero(~problem.holds).tolist()
    ]
    proven = problem.alignment.late > longest
    if not proven and min(known, default=np.inf) >= KNOWN * longest:
        return Lateness(
            None,
            None,
            "this motion does not determine the delay between efforts and positions to half a "
            "sample; to measure it, record a minute of strokes that take about one second each and "
            "need much effort",
        )
    late = problem.alignment.late
    if problem.alignment.rate:
        said = f"efforts against positions: {growing(problem)}, by a fit of the base model"
        fix = "a diagnosis corrects it (to change it, set clock_ppm and shift_s under [signal])"
        return Lateness(late, late * samples, f"{said}; {fix}")
    size, side = abs(late), "late" if late > 0 else "early"
    side += f", through {filter_text(problem.alignment)}" if problem.alignment.lag else ""
    if size < longest / FINEST:
        return Lateness(late, late * samples, "efforts against positions: in time, as far as seen")
    return Lateness(
        late,
        late * samples,
        f"efforts against positions: {size * 1e3:.3g} ms {side} ({size * samples:.2g} samples), by "
        "a fit of the base model; a diagnosis corrects it (to change it, set shift_s under "
        "[signal])",
    )


#: Correlation of measured velocity and derivative from which a factor is believed, and the factor
#: up to which nothing is said (as in `hil.record.checks`).
SURE, ALIKE = 0.95, 1.25
#: Factors of different joints that are one, as a ratio: the clock is common to all of them.
COMMON = 1.05
#: Base-model error of one reading over that of the other from which the dynamics decide.  On
#: simulated arms with gravity the wrong reading leaves several times as much; half a per cent
#: either way is chance.
DECIDES = 1.1


@dataclass(frozen=True)
class Reading:
    """One explanation of a factor between velocities and positions.

    Parameters
    ----------
    what : str
        ``"velocity"``, ``"clock"`` or ``"position"``: what is wrong.
    text : str
        The same as the part of a sentence.
    error : float
        What the base model leaves over under it, over the effort, geometric mean of the joints.
    """

    what: str
    text: str
    error: float


def factors(r: Recording) -> FloatArray:
    """Measured velocity over derivative of the position (d,); 1 where it is not to be told."""
    out = np.ones(r.d)
    if r.qd is None:
        return out
    for k in range(r.d):
        factor, correlation = velocity_factor(r.t, r.q[:, k], r.qd[:, k])
        if correlation > SURE and factor > 0:
            out[k] = factor
    return out


def readings(r: Recording) -> list[Reading]:
    """Explanations of a factor between velocities and positions, best first; none without one."""
    found = factors(r)
    off = np.flatnonzero((found > ALIKE) | (found < 1 / ALIKE))
    if not off.size or r.qd is None:
        return []
    f = float(np.median(found[off]))
    who = ", ".join(r.joints[k] for k in off)
    tried = [("velocity", f"the velocities of {who} are {f:.4g} times too large", r)]
    moved = np.flatnonzero(found != 1.0)
    common = off.size == moved.size and np.ptp(np.log(found[off])) < np.log(COMMON)
    if common:
        t = r.t[0] + (r.t - r.t[0]) / f
        tried.append(("clock", f"the time advances {f:.4g} times too fast", replace(r, t=t)))
    scale = np.ones(r.d)
    scale[off] = found[off]
    if not common or r.d == 1:
        text = f"the positions of {who} are {1 / f:.4g} times too large"
        tried.append(("position", text, replace(r, q=r.q * scale)))
    rates = Problem([r], r.robot).rates
    # the same filters in samples, so that the same rows are compared
    by = {"clock": replace(rates, position=f * rates.position, effort=f * rates.effort)}
    out = [Reading(what, text, _error(x, by.get(what, rates))) for what, text, x in tried]
    return sorted(out, key=lambda x: x.error)


def _error(r: Recording, rates: Rates) -> float:
    """Geometric mean over the joints of the base model's error over the effort; inf without."""
    try:
        problem = Problem([r], r.robot, rates=rates)
        result = fit(problem, base_model(r.robot))
    except HilError:
        return float("inf")
    left = problem.y - (result.x @ result.theta).reshape(problem.y.shape)
    share = problem.rms(left) / np.maximum(problem.rms(problem.effort), 1e-300)
    return float(np.exp(np.mean(np.log(np.maximum(share[~problem.holds], 1e-12)))))


def reading_notes(r: Recording) -> list[tuple[str, str]]:
    """Both readings and which one the dynamics support: (code, sentence); none if all agrees."""
    found = readings(r)
    if len(found) < 2:
        return [("velocity-scale", x.text) for x in found]
    either = " or ".join(x.text for x in found)
    first, second = found[0], found[1]
    if second.error > DECIDES * first.error:
        decided = (
            f"the dynamics fit better if {first.text} (base model error {100 * first.error:.3g} % "
            f"against {100 * second.error:.3g} %)"
        )
    else:
        decided = "the dynamics fit both equally well"
    return [("velocity-scale", f"either {either}; {decided}. Set its scale in a map file")]
