"""Alignment of effort and position within one sample, and of efforts that were recorded late.

A command that is held over its period acts half a period late, and position and effort of one
row are rarely taken at the same instant.  Up to one sample that is how the recording was made,
not a physical delay; left in, it imitates small effects at every reversal.

Efforts that are early by more may be a delay of the drive.  Efforts that are late by more cannot be
one: no joint moves before its motor pushes.  They came by a slower bus, or through a filter.  Slow
motion shows both as the same lateness L; the error over the whole band says how much of it is a
filter's (`hil.identify.problem.Alignment`).

Stamps, positions or velocities wrong by a factor: both readings, and which the dynamics support.

Measured velocities that are f times the derivative of the positions say that one of the two is
wrong: the velocities by f, the clock by 1 / f, or the positions by f.  Gravity depends on the
posture alone and inertia on the square of the clock, and both hold the same first moments, so
that a rigid body's effort tells them apart wherever a joint lifts something:

    tau = M(q) qdd + c(q, qd) + g(q);    t -> t / f:  qdd -> f^2 qdd,  g as it was.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.errors import HilError
from hil.identify.bands import Rates
from hil.identify.context import renew
from hil.identify.design import Term, block
from hil.identify.fit import fit
from hil.identify.problem import Alignment, Problem
from hil.identify.regression import basis
from hil.identify.result import FitResult
from hil.models.effect import Doc, Effect, Param, Trait
from hil.models.model import RobotModel, base_model
from hil.models.motion import Motion
from hil.models.presliding import SLIPS, slip_state
from hil.record.consistency import velocity_factor
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: The slow motion: below this fraction of the effort filter's cut-off.
SLOW = 4
#: Gauss-Newton steps for the shift, and share of a sample from which another one is taken.
STEPS, AGAIN = 3, 0.25
#: Share of a sample to which a joint's lateness must be known to count.
KNOWN = 0.5
#: Parts of a sample below which there is no lateness, and below which one joint's is not better
#: known than another's.
FINEST = 20
#: Standard errors beyond which a lateness is one.
CLEAR = 3.0
#: Parts of a recording that each say how late it is, so that their scatter tells the error.
PIECES = 6
#: Time by which friction turns early in the column that keeps its turns out of the lateness [s].
TURN = 0.005
#: Speed below which friction may be larger, over the rms speed.
LOW_SPEED = 0.1

#: Largest lateness of recorded efforts that is looked for [s]: a filter of 2 Hz, messages missed.
LATEST = 0.1
#: Shifts that are tried up to it, at most, and how often: late efforts blunt the sign of friction,
#: which then asks for too small a shift.
MOST_SHIFTS, TURNS = 25, 8
#: Poles of the filters that are tried; 0: a moving average.
SHAPES = (1, 2, 0)
#: Shares of a lateness that are tried as a filter's, and how often their neighbours are.
FILTERED, CLOSER = (0.5, 1.0), 3
#: Share of a filter's lateness to which it is known well enough.
SETTLED = 0.005
#: Share by which the error must fall where efforts are taken earlier by more than a sample, or a
#: filter is undone, and by which that of one joint may rise.
LESS = 0.1
#: Relative error of no model at all [%].
NOTHING = 100.0
#: Share of the squared error that a delay must take where it is asked for beside a model that has
#: grown, and the model is sought again with it: how a recording was made takes nearly all, a
#: delay in the place of a first-order filter about three quarters (pendulum, 7 Hz).  With 0.95
#: delays beside a second missing effect are not found.
DELAYED = 0.9


class _Rate(Effect):
    """A short lateness of the effort: its first-order term in T."""

    name, family = "effort-rate", "actuator"
    doc = Doc("tau(t) = model(t) + T dtau/dt", "late", "any motion", "Taylor's series")
    params = (Param("T", "s", "lateness"),)
    traits = Trait.GIVEN
    #: Of motor and external effort together.
    whole = False

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """dtau/dt, of motor and external effort where `whole`."""
        effort = motion.tau[:, j] + (motion.tau_ext[:, j] if self.whole else 0.0)
        return np.gradient(effort, motion.dt)[:, None]


class _WholeRate(_Rate):
    """The same of motor and external effort together, as a late measured motion shows it."""

    name = "whole-effort-rate"
    whole = True


class _OtherFriction(Effect):
    """What another law of friction adds: a turn before the speed's or after it, a bent curve."""

    name, family = "other-friction", "friction"
    doc = Doc(
        "tau = c (tanh((v + T a) / v0) - tanh(v / v0)) + s tanh(v / v0) exp(-|v| / vs) + d v |v|"
        ",  T = 5 ms, vs a tenth of the rms speed",
        "friction that leads the speed, is larger at low speed, or grows with its square",
        "reversals, and strokes at several speeds",
        "Taylor's series; Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
    )
    params = (
        Param("c", "{F}", "friction that turns early"),
        Param("s", "{F}", "friction at low speed"),
        Param("d", "{F}", "drag at the rms speed"),
    )
    traits = Trait.GIVEN

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """A sign that turns early less the sign, and two curves over the speed."""
        v, a, v0 = motion.qd[:, j], motion.qdd[:, j], float(motion.resolution[j])
        sign, size = motion.sign_of(v, a, v0), max(float(np.sqrt(np.mean(v**2))), 1e-300)
        turn = motion.sign_of(v + TURN * a, a, v0) - sign
        low = sign * np.exp(-np.abs(v) / (LOW_SPEED * size))
        return np.stack([turn, low, v / size * np.abs(v / size)], axis=1)


class _Bristles(Effect):
    """Friction that builds up over a displacement, of several widths."""

    name, family = "bristles", "friction"
    doc = Doc(
        "tau = sum_k f_k z_k,  z_k <- clip(z_k + dq / w_k, -1, 1)",
        "friction that lags the speed",
        "reversals",
        "Al-Bender, Lampaert, Swevers, IEEE Trans. Automatic Control 50(11), 2005",
    )
    params = tuple(Param(f"f{k + 1}", "{F}", "friction that builds up") for k in range(len(SLIPS)))
    traits = Trait.GIVEN

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """States of elements that slip."""
        low, high = motion.span[j]
        q, length = np.ascontiguousarray(motion.q[:, j]), max(float(high - low), 1e-9)
        return np.stack([slip_state(q, length * share) for share in SLIPS], axis=1)


def longest_shift(problem: Problem) -> float:
    """What counts as alignment and not as delay: a twentieth more than one sample [s]."""
    return 1.05 * max(1.0 / rate for rate in problem.sources)


def slow_delay(
    result: FitResult, j: int, whole: bool = False, friction: bool = False
) -> tuple[float, float]:
    """Delay of joint j's effort [s] and its standard error, from the slow motion alone.

    `whole`: of motor and external effort together; `friction`: told from another law
    of friction, which turns early or is bent over the speed.

    In a closed loop the controller answers the very disturbances that the model leaves over, so
    noise looks like a delay of several milliseconds where it is fast.  Below a quarter of the
    effort filter's cut-off the commanded motion dominates: y and all columns are low-passed
    once more, and  y = X theta + T dtau/dt  is solved there.
    """
    made_of = [result.x, result.problem.y]
    return result.problem.remembered(
        ("slow delay", j, whole, friction), made_of, lambda: _slow_delay(result, j, whole, friction)
    )


def _slow_delay(result: FitResult, j: int, whole: bool, friction: bool) -> tuple[float, float]:
    problem = result.problem
    x = result.x.reshape(problem.d, problem.n, -1)[j]
    late = block(problem, Term(_WholeRate() if whole else _Rate(), j))
    more = [block(problem, Term(_OtherFriction(), j))] if friction else []
    own = [x[:, np.any(x != 0, axis=0)], *more]
    rows = np.concatenate([*own, late, problem.y[j][:, None]], axis=1)
    rows = _slow_runs(rows, problem)
    dealt = _dealt(rows[:, -2])
    columns = np.concatenate([rows[:, :-2], dealt], axis=1)
    b = basis(columns)
    nothing = np.zeros(columns.shape[1])
    theta = b.solve(rows[:, -1], nothing, np.zeros(len(rows)))
    left = rows[:, -1] - columns @ theta
    # one independent value in SLOW times the filter's own oversampling
    scale = np.sqrt(np.mean(left**2) * SLOW)
    own_rows = slice(-dealt.shape[1], None)
    directions = b.v[own_rows] / (b.s * b.scale[own_rows, None])  # of the pseudo-inverse of R
    return _agreed(theta[own_rows], scale**2 * directions @ directions.T)


def _dealt(late: FloatArray) -> FloatArray:
    """The column of a lateness (n,) dealt to as many parts (n, PIECES) that tell as much each."""
    told = np.cumsum(late**2)
    piece = np.minimum(PIECES * told / max(told[-1], 1e-300), PIECES - 1e-9).astype(int)
    out: FloatArray = late[:, None] * (piece[:, None] == np.arange(PIECES))
    return out


def _agreed(values: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """What the parts say together, and its standard error by what they differ.

    With weights w = C^-1 1 of the covariance C the mean is  w'T / w'1;  its variance 1 / w'1 is
    multiplied by  max(1, (T - mean)' C^-1 (T - mean) / (parts - 1)):  noise alone gives 1, and a
    missing effect that looks late in one stretch and early in another one more.

    Source: Birge, Phys. Rev. 40, 1932, p. 207 (ratio of external and internal consistency).
    """
    one = np.ones(values.size)
    inverse = np.linalg.pinv(covariance)
    weight = inverse @ one
    total = float(weight @ one)
    if total <= 0.0:
        return 0.0, float("inf")
    mean = float(weight @ values) / total
    apart = values - mean
    ratio = float(apart @ inverse @ apart) / max(values.size - 1, 1)
    return mean, float(np.sqrt(max(ratio, 1.0) / total))


def _slow(x: FloatArray, problem: Problem) -> FloatArray:
    cutoff = problem.rates.effort / SLOW / (problem.rate / 2)
    sos = scipy.signal.butter(2, cutoff, output="sos")
    pad = min(30, len(x) - 1)
    return np.asarray(scipy.signal.sosfiltfilt(sos, x, axis=0, padlen=pad))


def real_delay(result: FitResult, j: int, delay: float, whole: bool = False) -> bool:
    """Whether a delay found over the whole band is one of the slow motion, too.

    It must exceed there by `CLEAR` standard errors one sample, or what the other joints have in
    common with it, and not be a small part of `delay` [s]: a lag that grows with frequency is the
    answer to noise, or a coarse encoder's.
    """
    late, error = slow_delay(result, j, whole)
    sure = abs(late) - CLEAR * error > _alignment(result, j, whole)
    return sure and abs(late) > abs(delay) / 3


def _alignment(result: FitResult, j: int, whole: bool) -> float:
    """Lateness [s] that may be how the recording was made and no joint's own delay.

    All joints share their stamps: beside others that are in time, one that is not is late itself,
    be it by less than a sample.
    """
    problem = result.problem
    others = [k for k in np.flatnonzero(~problem.holds).tolist() if k != j]
    seen = [slow_delay(result, k, whole) for k in others]
    known = [abs(late) + CLEAR * error for late, error in seen]
    return min([longest_shift(problem), *([max(known)] if known else [])])


def sample_shift(result: FitResult) -> tuple[float, float]:
    """Delay of the effort against the motion [s], common to all joints, and its standard error.

    Zero beyond one sample.

    Of the slow motion, for noise in a closed loop looks like a delay where it is fast; and told
    apart from friction that turns before the speed does, or is bent over the speed.  The median
    over joints, weighted by what each can tell, so that one joint's real delay or hysteresis does
    not shift the others.

    Any alignment within one sample is as likely as another before the data are seen, with a
    standard deviation s of half a sample.  Of an estimate T with error e what is taken out is

        T s^2 / (s^2 + e^2).
    """
    problem = result.problem
    if result.model.explains != "motor":
        return 0.0, 0.0
    late = {t.joint for t in result.terms if Trait.SHIFTS in t.effect.traits}
    longest = longest_shift(problem)
    seen = [slow_delay(result, j, friction=True) for j in sorted(set(range(problem.d)) - late)]
    seen = [(value, error) for value, error in seen if error < KNOWN * longest]
    shift, error = _middle(seen, longest / FINEST) if seen else (0.0, 0.0)
    if abs(shift) > longest:
        return 0.0, error
    spread = KNOWN * longest
    shift *= spread**2 / (spread**2 + error**2)
    return (shift if abs(shift) >= longest / FINEST else 0.0), error


def recorded_late(result: FitResult) -> float:
    """Delay (negative) [s] of efforts that were recorded late by more than a sample, or 0.

    Some joint must be so beyond its error; by how much, the joints say together: of all shifts up
    to `LATEST` the one whose slow motion leaves least,

        min_T  sum_j log |(1 - Q_j Q_j') y_j(t + T)|,

    Q_j the columns of the model and of other laws of friction on joint j, all coefficients free.
    No joint may lose by it.
    """
    problem = result.problem
    longest, moves = longest_shift(problem), np.flatnonzero(~problem.holds).tolist()
    if problem.shift >= -longest:
        told = [slow_delay(result, j, friction=True) for j in moves]
        if not any(value + CLEAR * error < -longest for value, error in told):
            return 0.0
    step = max(1.0 / min(problem.sources), LATEST / MOST_SHIFTS)
    shifts = -step * np.arange(int(LATEST / step) + 1)
    left = np.array([[_left(result, j, s) for j in moves] for s in shifts])
    best = int(np.argmin(np.log(np.maximum(left, 1e-300)).sum(axis=1)))
    return float(shifts[best]) if best and np.all(left[best] < (1 + LESS) * left[0]) else 0.0


def _left(result: FitResult, j: int, shift: float) -> float:
    """Norm of what the model leaves of joint j's slow effort when its motor's is shifted.

    Beside another law of friction, which looks late where the model's own is of another form.
    """
    problem = result.problem
    key = ("slow basis", j)
    x = result.x.reshape(problem.d, problem.n, -1)[j]

    def made() -> FloatArray:
        more = block(problem, Term(_OtherFriction(), j))
        own = _slow_runs(np.concatenate([x[:, np.any(x != 0, axis=0)], more], axis=1), problem)
        return np.asarray(scipy.linalg.qr(own, mode="economic")[0])

    q = problem.remembered(key, [result.x], made)
    later = Alignment(shift)
    late = [later(m.tau[:, [j]], m.t) - m.tau[:, [j]] for m in problem.motions]
    y = _slow_runs(problem.y[j][:, None] + problem.gated(late, j), problem)[:, 0]
    return float(np.linalg.norm(y - q @ (q.T @ y)))


def _slow_runs(x: FloatArray, problem: Problem) -> FloatArray:
    """Columns (n, m) of several runs, slow part of each run by itself."""
    return np.concatenate([_slow(x[problem.run == k], problem) for k in np.unique(problem.run)])


def _middle(seen: Sequence[tuple[float, float]], finest: float) -> tuple[float, float]:
    """Median of values, each with the weight of its standard error, and its own standard error.

    No value counts for more than one that is known to `finest`.  The error is that of the values'
    own errors e, or of what they differ by if that is more (Birge, as in `_agreed`):

        1 / sqrt(sum 1 / e^2)  max(1, chi),   chi^2 = sum ((T - middle) / e)^2 / (joints - 1).
    """
    value, error = np.array(seen).T
    order, least = np.argsort(value), np.maximum(error, finest)
    weight = np.cumsum(1.0 / least[order] ** 2)
    middle = float(value[order][np.searchsorted(weight, weight[-1] / 2)])
    chi = np.sqrt(np.sum(((value - middle) / least) ** 2) / max(value.size - 1, 1))
    return middle, float(max(1.0, chi) / np.sqrt(np.sum(1.0 / error**2)))


def fit_as_stated(
    problem: Problem, model: RobotModel, scale: FloatArray | None = None
) -> FitResult:
    """Fit with the alignment that the model or the recording states, and no other one.

    `scale` as in `fit`.
    """
    given = problem.given_shift
    stated = problem.given_lag if problem.given_lag.lag else problem.alignment
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
        slack = _free(result, bristles=True)
        result = _taken_earlier(problem, model, result, scale)
    result = _in_time(problem, model, result, scale)
    if ask and problem.shift < -longest:
        result = _filter_undone(problem, model, result, scale)
    late = problem.alignment.late > longest >= start.late
    built_up = late and slack is not None and bool(np.mean(np.log(_free(result) / slack)) > 0.0)
    if built_up or (late and _ratio(result, at_first) > 1 - LESS):
        # what bends before it slides looks late, and leaves less where nothing is shifted
        problem.align_effort(start)
        return fit(problem, model, scale=scale)
    return result


def _free(result: FitResult, bristles: bool = False) -> FloatArray:
    """Relative error of each moving joint with all coefficients of its own.

    `bristles`: beside friction that builds up, and that is bent over the speed.
    """
    problem, out = result.problem, []
    for j in np.flatnonzero(~problem.holds).tolist():
        x = result.x.reshape(problem.d, problem.n, -1)[j]
        own = x[:, np.any(x != 0, axis=0)]
        if bristles:
            more = [block(problem, Term(e, j)) for e in (_Bristles(), _OtherFriction())]
            own = np.concatenate([own, *more], axis=1)
        q = scipy.linalg.qr(own, mode="economic")[0]
        y = problem.y[j]
        size = max(float(np.linalg.norm(problem.effort[j])), 1e-300)
        out.append(max(float(np.linalg.norm(y - q @ (q.T @ y))) / size, 1e-12))
    return np.array(out)


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

    Or, if they are known to be late, to have passed a filter.  A large effect that the given model
    lacks hides it there.  Leaves the problem aligned for good if so, and the model to be sought
    again; else everything as it was.
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
    now = problem.alignment
    changed = now.lag > 0.0 or now.late > before.late + longest
    problem.aligned = changed and _ratio(found, error) ** 2 < 1 - DELAYED
    if not problem.aligned:
        problem.align_effort(before)
        renew(result)
    return problem.aligned


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
        problem.align_effort(Alignment(-(1 - share) * start.late, share * start.late, poles))
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


@dataclass(frozen=True)
class Lateness:
    """By how much the efforts of a recording are late, as a diagnosis with the base model has it.

    Parameters
    ----------
    seconds : float or None
        Lateness against the positions [s], negative where they are early; None = not known.
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
            "import with --robot ARM.urdf",
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
            "this motion does not show the delay between efforts and positions to half a sample; "
            "record slow strokes of about a second with much effort, for a minute",
        )
    late = problem.alignment.late
    size, side = abs(late), "late" if late > 0 else "early"
    side += f", through {_filter(problem.alignment)}" if problem.alignment.lag else ""
    if size < longest / FINEST:
        return Lateness(late, late * samples, "efforts against positions: in time, as far as seen")
    return Lateness(
        late,
        late * samples,
        f"efforts against positions: {size * 1e3:.3g} ms {side} ({size * samples:.2g} samples), by "
        "a fit of the base model; a diagnosis corrects it (to change it, set shift_s under "
        "[signal])",
    )


#: Codes of notes on the alignment: within a sample, and efforts that were recorded later than that.
ALIGNED, RECORDED_LATE = "late-effort", "recorded-late"


def _filter(a: Alignment) -> str:
    """A filter that was undone: its poles and half-power frequency, or its length."""
    if not a.poles:
        return f"a moving average over {2e3 * a.lag:.3g} ms"
    poles = "one pole" if a.poles == 1 else "two poles"
    return f"a low-pass of {poles} at {np.sqrt(a.poles) / (2 * np.pi * a.lag):.3g} Hz"


def late_effort(problem: Problem) -> list[tuple[str, str]]:
    """Note (code, sentence) on the lateness of the effort that was taken out; none for none."""
    a, longest = problem.alignment, longest_shift(problem)
    stated = problem.given_shift is not None or problem.given_lag.lag > 0.0
    if a.lag:
        rest = (
            f" (and the efforts shifted by {a.shift * 1e3:.3g} ms)" if abs(a.shift) > 1e-5 else ""
        )
        why = "No drive moves a joint before it pushes, so this is how they were recorded"
        why = "The model or map file says so" if stated else why
        return [
            (
                RECORDED_LATE,
                f"the efforts are {a.lag * 1e3:.3g} ms late, as behind {_filter(a)}. "
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
