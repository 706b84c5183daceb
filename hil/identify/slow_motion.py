"""How late the efforts are against the positions, told from the slow motion alone.

In a closed loop the controller answers the very disturbances that a model leaves over, so that
noise looks like a delay of several milliseconds where it is fast.  In the slow motion the commanded
one dominates.  What is told there is a delay of one joint, an alignment within a sample that all
joints have in common, or efforts that were recorded late by more: each beside other laws of
friction, which look late where the model's own is of another form.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.identify.design import Term, block
from hil.identify.problem import Alignment, Problem
from hil.identify.regression import basis
from hil.identify.result import FitResult
from hil.models.effect import Doc, Effect, Param, Trait
from hil.models.kernels import SLIPS, slip_state
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
#: The slow motion: below this fraction of the effort filter's cut-off.
SLOW = 4
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
#: Rate of one clock against another below which no joint's is better known [s/s]: crystals differ
#: by tens of millionths.
FINEST_RATE = 1e-6
#: Largest lateness of recorded efforts that is looked for [s]: a filter of 2 Hz, messages missed.
LATEST = 0.1
#: Shifts that are tried up to it, at most.
MOST_SHIFTS = 25
#: Share by which the error must fall where efforts are taken earlier by more than a sample, or a
#: filter is undone, and by which that of one joint may rise; by which the last model's must fall
#: where another lateness, or none, is taken in the end.
LESS = 0.1


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


class _ChangingFriction(Effect):
    """Friction that changes over the run, in its second order."""

    name, family = "changing-friction", "friction"
    doc = Doc(
        "tau = (c1 s + c2 s^2) tanh(v / v0) + (d1 s + d2 s^2) v,  s time over the run's length",
        "friction at the end of the run that differs from that at its start",
        "long runs",
        "Taylor's series",
    )
    params = tuple(Param(n, "{F}", "friction that changes") for n in ("c1", "c2", "d1", "d2"))
    traits = Trait.GIVEN

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Sign and speed, each times s and s^2."""
        s = motion.since / max(float(motion.since[-1]), 1e-9)
        own = motion.sign(j), motion.qd[:, j]
        return np.stack([x * s**k for x in own for k in (1, 2)], axis=1)


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
    late, more = (_WholeRate() if whole else _Rate()), ([_OtherFriction()] if friction else [])
    return _agreed(*_in_pieces(result, j, late, more)[:2])


def _in_pieces(
    result: FitResult, j: int, law: Effect, more: Sequence[Effect], by_run: bool = False
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lateness of each piece of the slow motion (k,), its covariance, and what each piece weighs.

    The last are squares (n, k) over the instants; `more`: what has coefficients of its own beside;
    `by_run`: as many pieces of each run.
    """
    problem = result.problem
    x = result.x.reshape(problem.d, problem.n, -1)[j]
    late, other = block(problem, Term(law, j)), [block(problem, Term(e, j)) for e in more]
    own = [x[:, np.any(x != 0, axis=0)], *other]
    rows = np.concatenate([*own, late, problem.y[j][:, None]], axis=1)
    rows = _slow_runs(rows, problem)
    dealt = _dealt_by_run(rows[:, -2], problem) if by_run else _dealt(rows[:, -2])
    columns = np.concatenate([rows[:, :-2], dealt], axis=1)
    b = basis(columns)
    nothing = np.zeros(columns.shape[1])
    theta = b.solve(rows[:, -1], nothing, np.zeros(len(rows)))
    left = rows[:, -1] - columns @ theta
    # one independent value in SLOW times the filter's own oversampling
    scale = np.sqrt(np.mean(left**2) * SLOW)
    own_rows = slice(-dealt.shape[1], None)
    directions = b.v[own_rows] / (b.s * b.scale[own_rows, None])  # of the pseudo-inverse of R
    return theta[own_rows], scale**2 * directions @ directions.T, dealt**2


def lateness_line(result: FitResult) -> tuple[float, float, float]:
    """Lateness of the efforts in the middle of the run [s], its growth [s/s] and that one's error.

    A line through the pieces of each joint, by generalised least squares, beside friction that
    changes over the run; errors as in `_agreed`.  Joints have one clock: their medians, as for a
    lateness that all have in common.  Runs have one rate, and each its own start.
    """
    problem = result.problem
    laws, lines = [_OtherFriction(), _ChangingFriction()], []
    half = max(float(m.since[-1]) for m in problem.motions) / 2
    for j in np.flatnonzero(~problem.holds).tolist():
        values, covariance, weight = _in_pieces(result, j, _Rate(), laws, by_run=True)
        since = problem.gated([m.since[:, None] for m in problem.motions], j)[:, 0]
        at = since @ weight / np.maximum(weight.sum(axis=0), 1e-300)
        # y = X theta + T dtau/dt: what is late has a negative T
        lines += _line(-values, covariance, at - half, problem.runs)
    if not lines:
        return 0.0, 0.0, float("inf")
    middle, slope = (
        _middle([(x[k], e[k]) for x, e in lines], finest)
        for k, finest in enumerate((longest_shift(problem) / FINEST, FINEST_RATE))
    )
    return middle[0], slope[0], slope[1]


def _line(
    values: FloatArray, covariance: FloatArray, at: FloatArray, runs: int = 1
) -> list[tuple[FloatArray, FloatArray]]:
    """Value and slope at zero of a line through some values, and their errors by the scatter.

    Of several runs, with as many values each: lines of one slope, and the mean of their values.
    Empty where the values do not determine a line.
    """
    own = np.repeat(np.eye(runs), at.size // runs, axis=0)
    line, inverse = np.concatenate([own, at[:, None]], axis=1), np.linalg.pinv(covariance)
    normal = line.T @ inverse @ line
    if np.linalg.matrix_rank(normal) < runs + 1:
        return []
    back = np.linalg.inv(normal)
    found = back @ line.T @ inverse @ values
    apart = values - line @ found
    ratio = float(apart @ inverse @ apart) / max(values.size - runs - 1, 1)
    mean = np.concatenate([np.full((1, runs), 1 / runs), np.zeros((1, runs))]).T
    mean = np.concatenate([mean, [[0.0, 1.0]]]).T
    error = np.sqrt(max(ratio, 1.0) * np.diag(mean @ back @ mean.T))
    return [(mean @ found, error)]


def _dealt_by_run(late: FloatArray, problem: Problem) -> FloatArray:
    """The same for each run by itself (n, runs PIECES)."""
    run = problem.whole[problem.run]
    return np.concatenate([_dealt(late * (run == k)) for k in range(problem.runs)], axis=1)


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
    answer to noise, or a coarse encoder's.  Friction that turns later than the speed lets an effort
    follow its motion: that one is told apart from it.
    """
    late, error = slow_delay(result, j, whole)
    if late < 0.0:
        late, error = slow_delay(result, j, whole, friction=True)
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

    Zero beyond one sample; efforts that are late by hardly more, and not for sure, are so by one.

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
    if shift > longest or shift + CLEAR * error < -longest:
        return 0.0, error
    spread = KNOWN * longest
    shift = max(shift * spread**2 / (spread**2 + error**2), -longest)
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
    late = [later(m.tau[:, [j]], m.t, m.since) - m.tau[:, [j]] for m in problem.motions]
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


def left_free(result: FitResult, bristles: bool = False) -> FloatArray:
    """Relative error of each moving joint with all coefficients of its own.

    `bristles`: beside friction that builds up, and that is bent over the speed.
    """
    problem, out = result.problem, []
    for j in np.flatnonzero(~problem.holds).tolist():
        q, y = _own_basis(result, j, bristles), problem.y[j]
        size = max(float(np.linalg.norm(problem.effort[j])), 1e-300)
        out.append(max(float(np.linalg.norm(y - q @ (q.T @ y))) / size, 1e-12))
    return np.array(out)


def _own_basis(result: FitResult, j: int, bristles: bool) -> FloatArray:
    """Orthonormal basis (n, m) of what a model says of joint j, each coefficient its own."""
    problem = result.problem
    x = result.x.reshape(problem.d, problem.n, -1)[j]
    own = x[:, np.any(x != 0, axis=0)]
    if bristles:
        more = [block(problem, Term(e, j)) for e in (_Bristles(), _OtherFriction())]
        own = np.concatenate([own, *more], axis=1)
    return np.asarray(scipy.linalg.qr(own, mode="economic")[0])


def common_lateness(result: FitResult) -> tuple[float, float]:
    """Delay of all efforts [s] that leaves least over the whole band, and the share that it leaves.

    What each joint's model leaves, all coefficients its own, beside friction that builds up and
    that is bent over the speed, falls with a delay T that all joints have in common as

        min_T  sum_j log |e_j - T r_j|,   e = P y,  r = P dtau/dt,  P = 1 - Q Q'.

    The share is that of the errors' geometric mean.
    """
    problem, errors = result.problem, []
    moves = np.flatnonzero(~problem.holds).tolist()
    for j in moves:
        q = _own_basis(result, j, bristles=True)
        rows = np.stack([problem.y[j], block(problem, Term(_Rate(), j))[:, 0]], axis=1)
        rows -= q @ (q.T @ rows)
        errors.append(rows.T @ rows)
    inner = np.array(errors)
    size, cross, rate = inner[:, 0, 0], inner[:, 0, 1], np.maximum(inner[:, 1, 1], 1e-300)
    least = np.maximum(size, 1e-300)

    def share(late: float) -> float:
        left = (size - 2 * late * cross + late**2 * rate) / least
        return float(np.exp(0.5 * np.mean(np.log(np.maximum(left, 1e-12)))))

    # the best one lies between those of single joints
    alone = cross / rate
    low, high = float(alone.min()), float(alone.max())
    if high - low <= 1e-12:
        return low, share(low)
    found = scipy.optimize.minimize_scalar(share, bounds=(low, high), method="bounded")
    return float(found.x), float(found.fun)
