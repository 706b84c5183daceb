"""The noise floor, what no model could explain; and what a function without a name still could.

The floor is measured and not assumed.

Three sources, the first available counts:

1. *repeats*: the motion repeats itself; what differs between two passes is noise;
2. *largest model*: what the base model, every candidate and a smooth function of all positions
   and speeds together cannot predict on blocks of time that they were not fitted to.

The noise scale must never come from the incomplete model: the missing effect inflates it.

What any free function without a name could still explain is asked where no effect does.

For each set of inputs a wavelet network is fitted to what the model leaves, together with all of
the model's own columns, with a ridge, and judged on blocks of time that it was not fitted to:

    share = (E0^2 - E^2) / (E0^2 - floor^2),

E the left-out rms error with the network and E0 without it; the floor is the least of the noise
floor and of all E.  The largest share says which variables carry the missing structure; a small one
everywhere says that it is none of these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from hil.diagnosis.constants import ADEQUATE, ALARMS, MATTERS, SENSOR_ACCURACY, WORTH
from hil.diagnosis.grams import Split, split
from hil.diagnosis.types import Explainable, Floor
from hil.identify import bands
from hil.identify.context import drives
from hil.identify.problem import Problem
from hil.identify.regression import basis, inflation, period, time_blocks
from hil.identify.result import FitResult
from hil.models.expansions import PLACE, SPEED, dictionary, input_sets
from hil.models.motion import Motion
from hil.work import in_parallel

FloatArray = NDArray[np.float64]
#: Name of the way in which a floor is measured where the motion repeats itself.
REPEATS = "repeats"
#: Columns of which less than this is new do not count.
RANK = 1e-6
#: Times that normal equations are solved, from the second on for what is left.
FLOOR_STEPS = 2
#: A model with more coefficients than this share of the instants follows any noise.
FULL = 0.9
#: Ridges that are tried.
STRENGTHS = (1e-4, 1e-3, 1e-2, 1e-1)
#: Shares of the blocks of time that are left out in turn, and the length of a block [s].
_FOLDS, _SECONDS = 5, 0.5


def smooth_features(problem: Problem, j: int) -> FloatArray:
    """Smooth functions of position and speeds for joint j, filtered, shape (n, m); made once."""
    if ("smooth", j) not in problem.memo:
        problem.memo["smooth", j] = _smooth(problem, j)
    out: FloatArray = problem.memo["smooth", j]
    return out


def _smooth(problem: Problem, j: int) -> FloatArray:
    rms = np.maximum(
        np.sqrt(np.mean(np.concatenate([m.qd for m in problem.motions]) ** 2, axis=0)), 1e-12
    )
    parts = []
    for m in problem.motions:
        x, v = np.clip(m.scaled(j), -1, 1), m.qd / rms
        own = v[:, j]
        bumps = np.exp(-0.5 * ((own[:, None] - np.linspace(-2.1, 2.1, 7)) / 0.5) ** 2)
        place = np.polynomial.chebyshev.chebvander(x, 3)
        columns = [(bumps[:, :, None] * place[:, None, :3]).reshape(len(x), 21), place[:, 1:]]
        others = [k for k in range(problem.d) if k != j][:5]
        for k in others:
            columns.append(
                np.stack(
                    [np.tanh(3 * v[:, k]), v[:, k], v[:, k] * own, v[:, k] * np.tanh(3 * own)],
                    axis=1,
                )
            )
        pairs = [(a, b) for a in others for b in others if a < b][:6]
        columns += [(v[:, a] * v[:, b])[:, None] for a, b in pairs]
        parts.append(np.concatenate(columns, axis=1))
    return problem.gated(parts, j)


def largest_model(
    result: FitResult, extra: list[list[FloatArray]]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Everything fitted together, joint by joint.

    Parameters
    ----------
    result : FitResult
        The present fit.
    extra : list (d) of list of ndarray (n, m)
        Candidate columns for each joint.

    Returns
    -------
    residual (d, n), inflation (d,), scale (d,), predicted (d,)
        Residual, its 1 + 2 sum rho, its rms corrected for degrees of freedom, and the rms
        error on blocks that were left out.
    """
    problem = result.problem
    x = result.x.reshape(problem.d, problem.n, -1)
    dealt = split(problem, whole_runs=False)
    out = np.empty_like(result.residual)
    factor, scale, predicted = np.ones((3, problem.d)) * [[1.0], [0.0], [0.0]]
    for j in range(problem.d):
        own = x[j][:, np.any(x[j] != 0, axis=0)]
        live = problem.live[j]
        out[j] = 0.0
        if not np.any(live):
            continue
        columns, y = (
            _beside(own, [*extra[j], smooth_features(problem, j)], live),
            problem.y[j, live],
        )
        norm = np.linalg.norm(columns, axis=0)
        some = norm > 1e-300
        penalised = (np.arange(norm.size) >= own.shape[1])[some]
        # in place: of ten minutes these are the largest arrays of a diagnosis
        columns = columns[:, some]
        columns /= norm[some]
        folds = _folds(columns, y, dealt, live)
        out[j, live], rank = _least_squares(folds)
        factor[j] = inflation(out[j], problem.run)
        # band-limited or coloured rows: one independent value in `factor` instants
        spent = rank * max(factor[j], problem.rate / (2 * problem.rates.effort))
        now = float(result.rms[j])
        free = max(y.size - spent, 0.3 * y.size)
        scale[j] = min(np.sqrt(np.sum(out[j] ** 2) / free), now)
        predicted[j] = min(_left_out(folds, penalised), now)
        if rank > FULL * y.size:  # the residual is rounding; the left-out blocks are not
            scale[j] = predicted[j]
    return out, factor, scale, predicted


def _beside(own: FloatArray, more: Sequence[FloatArray], live: NDArray[np.bool_]) -> FloatArray:
    """Columns side by side, of the instants that count."""
    out = np.concatenate([own, *more], axis=1)
    return out if live.all() else out[live]


@dataclass(frozen=True)
class _Folds:
    """Columns of length one (n, p) and y (n,), with X'X and X'y of every fold.

    And the rows that are tested of each fold.
    """

    x: FloatArray
    y: FloatArray
    grams: FloatArray
    rights: FloatArray
    tested: list[NDArray[np.int_]]


def _folds(x: FloatArray, y: FloatArray, dealt: Split, live: NDArray[np.bool_]) -> _Folds:
    """The instants `live` (of n) of a joint, whose rows `x` and `y` are, by fold."""
    fold, inner = dealt.fold[dealt.block][live], dealt.tested[live]
    parts = [np.flatnonzero(fold == k) for k in range(dealt.folds)]
    grams = np.stack([x[rows].T @ x[rows] for rows in parts])
    rights = np.stack([x[rows].T @ y[rows] for rows in parts])
    return _Folds(x, y, grams, rights, [rows[inner[rows]] for rows in parts])


def _left_out(f: _Folds, penalised: NDArray[np.bool_]) -> float:
    """Rms error on left-out blocks of time; ridge on some columns, the best of STRENGTHS."""
    ridges = np.stack([np.diag(np.where(penalised, s, 1e-10)) for s in STRENGTHS])
    errors, every, right = np.zeros(len(ridges)), f.grams.sum(axis=0), f.rights.sum(axis=0)
    for k, rows in enumerate(f.tested):
        x, y = f.x[rows], f.y[rows]
        left = (every - f.grams[k] + ridges, (right - f.rights[k])[:, None])
        theta = np.linalg.solve(*left)[:, :, 0]
        errors += np.sum((y[:, None] - x @ theta.T) ** 2, axis=0)
    count = sum(rows.size for rows in f.tested)
    return float(np.sqrt(errors.min() / count)) if count else float("inf")


def _least_squares(f: _Folds) -> tuple[FloatArray, int]:
    """Residual of y on all columns, and how many of them count.

    P'X'X P = R'R with the largest pivots first, down to RANK in R; solved again for what is left,
    as normal equations lose half the digits.

    Source: Golub and Van Loan, Matrix Computations, 2013, 4.2.9 (pivoting), 5.3.8 (refinement).
    """
    if not f.x.size:
        return f.y, 0
    factor, order, rank, _ = scipy.linalg.lapack.dpstrf(f.grams.sum(axis=0), tol=RANK**2)
    own, left = order[:rank] - 1, f.y
    for _ in range(FLOOR_STEPS):
        theta = np.zeros(f.x.shape[1])
        theta[own] = scipy.linalg.cho_solve((factor[:rank, :rank], False), (f.x.T @ left)[own])
        left = left - f.x @ theta
    return left, int(rank)


def repeat_floor(result: FitResult) -> FloatArray | None:
    """Floor from repeats: rms of the residual's difference over one period / sqrt 2.

    The residual, not the effort, is compared: what small differences of the motion cost is
    taken out by the model.  None if no run repeats itself at least once.
    """
    problem = result.problem
    total, count = np.zeros((2, problem.d))
    common = np.zeros((len(problem.recordings), problem.d))
    for k in range(len(problem.recordings)):
        lag = period(problem, k)
        if not lag:
            continue
        r, live = result.residual[:, problem.run == k], problem.live[:, problem.run == k]
        both = live[:, lag:] & live[:, :-lag]
        total += np.sum(both * (r[:, lag:] - r[:, :-lag]) ** 2, axis=1) / 2
        count += np.sum(both, axis=1)
        common[k] = _common(problem, k, lag)
    known = count > 0
    if not np.all(known | problem.silent):
        return None
    power = total / np.maximum(count, 1)
    if np.any(common > 0):
        power = power + stir(result, common) * result.sigma**2 / np.maximum(problem.count, 1)
    return np.asarray(np.sqrt(power))


def _common(problem: Problem, k: int, lag: int) -> FloatArray:
    """Share (d,) of the positions' noise that comes again with part k's motion.

    Where positions repeat themselves to less than their noise it is the rounding of an encoder, the
    same each time, of which the difference between two passes tells nothing.
    """
    r, q = problem.recordings[k], problem.q[:, problem.run == k]
    passed = min(1.0, 2 * problem.rates.position / r.rate)
    noise = np.maximum(bands.white_noise(r, most=False) ** 2 * passed, 1e-300)
    apart = np.mean((q[:, lag:] - q[:, :-lag]) ** 2, axis=1) / 2
    out: FloatArray = np.clip(1.0 - apart / noise, 0.0, 1.0)
    return out


#: Seed of the noise that is added to positions.
STIR = 0


def stir(result: FitResult, shares: FloatArray | None = None) -> FloatArray:
    """Weighted sum of squares (d,) that noise of the positions makes of the predicted efforts.

    Parameters
    ----------
    result : FitResult
        The fit that predicts them.
    shares : ndarray (parts, d), optional
        Share of each joint's noise power, part by part; default all of it.
    """
    problem, draw = result.problem, np.random.default_rng(STIR)
    noisy = []
    for k, (r, m) in enumerate(zip(problem.recordings, problem.motions, strict=True)):
        size = bands.white_noise(r, most=False)
        size = size if shares is None else size * np.sqrt(shares[k])
        noise = size * draw.standard_normal(r.q.shape)
        e, de, dde = (
            bands.every(x, m.dt * r.rate)[: m.n]
            for x in bands.derivatives(noise, r.rate, problem.rates.position)
        )
        noisy.append(m.with_(q=m.q + e, qd=m.qd + de, qdd=m.qdd + dde))
    law = problem, result.terms, result.theta, result.slices
    each = [b - a for a, b in zip(drives(*law), drives(*law, noisy), strict=True)]
    rows = np.stack([problem.gated([x[:, j : j + 1] for x in each], j) for j in range(problem.d)])
    out: FloatArray = np.sum((rows[:, :, 0] / result.sigma[:, None]) ** 2, axis=1)
    return out


def noise_floor(result: FitResult, extra: list[list[FloatArray]]) -> Floor:
    """Noise floor of a fit, from repeats where the motion repeats, else the largest model.

    Of a joint that only holds its place nothing is judged: its floor is its residual.  One without
    an effort has the largest effort of the others.
    """
    residual, factor, scale, predicted = largest_model(result, extra)
    repeats = repeat_floor(result)
    rms, method = (predicted, "largest-model") if repeats is None else (repeats, REPEATS)
    size = result.problem.rms(result.problem.effort)
    rms = np.where(result.problem.holds, result.rms, np.hypot(rms, known_to(result) * size))
    # where no effort is recorded nothing is known of it
    unknown = np.where(result.problem.silent, float(np.max(size)), 0.0)
    return Floor(np.maximum(rms, unknown), method, residual, factor, np.maximum(scale, unknown))


def known_to(result: FitResult) -> float:
    """Share of the rms effort to which the efforts, or the forces, are known."""
    sensor = result.model.explains == "external"
    return result.problem.accuracy or (SENSOR_ACCURACY if sensor else MATTERS)


def practical(problem: Problem) -> float:
    """Share of the rms effort below which nothing matters: no effect of that size is named."""
    return problem.accuracy or MATTERS


def alarming(problem: Problem) -> float:
    """Share of the rms effort below which what has no sure name leaves a model adequate."""
    return problem.accuracy or ALARMS


# ------------------------------------------------------------ a function without a name


class Folds:
    """A model's own columns and residual, every fifth block of time left out in turn."""

    def __init__(self, result: FitResult) -> None:
        self.result, problem = result, result.problem
        q = free_columns(result).reshape(problem.d, problem.n, -1)
        y = result.residual / result.sigma[:, None]
        fold = time_blocks(problem, _SECONDS) % _FOLDS
        #: Columns (d, n_k, r) and residual (d, n_k) of each fold.
        self.parts = [(q[:, fold == k], y[:, fold == k]) for k in range(_FOLDS)]
        self.fold = fold
        self.grams = [np.tensordot(a, a, axes=((0, 1), (0, 1))) for a, _ in self.parts]
        self.rights = [np.tensordot(a, b, axes=((0, 1), (0, 1))) for a, b in self.parts]

    def left_out(self, more: FloatArray, j: int) -> float:
        """Rms error of joint j on the folds left out; best of four ridges on `more` (n, m).

        The model's own parameters are fitted again each time, on all joints together; those on a
        bound stay there.
        """
        result = self.result
        norm = np.linalg.norm(more, axis=0)
        some = norm > 1e-12 * max(float(norm.max(initial=0.0)), 1e-300)
        more = more[:, some] / norm[some]
        own = [np.hstack([a[j], more[self.fold == k]]) for k, (a, _) in enumerate(self.parts)]
        aims = [b[j] for _, b in self.parts]
        grams, rights = self._products(own, aims)
        gram, right, r = np.sum(grams, axis=0), np.sum(rights, axis=0), self.grams[0].shape[0]
        errors = []
        for strength in STRENGTHS if more.shape[1] else STRENGTHS[:1]:
            ridge = np.diag(np.where(np.arange(len(right)) >= r, strength, 1e-10))
            total = 0.0
            for k, (a, b) in enumerate(zip(own, aims, strict=True)):
                theta = np.linalg.solve(gram - grams[k] + ridge, right - rights[k])
                total += float(np.sum((b - a @ theta) ** 2))
            errors.append(total)
        return float(result.sigma[j] * np.sqrt(min(errors) / max(result.problem.count[j], 1.0)))

    def _products(
        self, own: list[FloatArray], aims: list[FloatArray]
    ) -> tuple[list[FloatArray], list[FloatArray]]:
        """X'X and X'y of each fold; the added columns act on one joint's rows alone."""
        grams, rights, r = [], [], self.grams[0].shape[0]
        for a, b, gram, right in zip(own, aims, self.grams, self.rights, strict=True):
            wide = np.empty((a.shape[1], a.shape[1]))
            wide[:, r:] = a.T @ a[:, r:]
            wide[r:, :r] = wide[:r, r:].T
            wide[:r, :r] = gram
            grams.append(wide)
            rights.append(np.concatenate([right, a[:, r:].T @ b]))
        return grams, rights


def free_columns(result: FitResult) -> FloatArray:
    """Orthonormal weighted columns (d n, r) of the parameters that are not on a bound."""
    free = np.array([not (n in result.values and result.values[n].at_bound) for n in result.names])
    if free.all():
        return result.basis.q
    w = np.repeat(1.0 / result.sigma, result.problem.n)
    return basis(result.x[:, free] * w[:, None]).q


#: Makes columns (n, m).
ColumnMaker = Callable[[], FloatArray]
#: Rows up to which a network is fitted where nothing is left above the floor.
MAX_ROWS = 10_000
#: Bumps over a joint's own range and over another one's, and joints up to which those are asked.
_FINE, _COARSE, _NEAR = 40, 12, 4
#: Bumps over each of two joints' ranges.
POSES = 7
#: Short name of the functions of time, and how any set of inputs is called in an answer.
TIME, NETWORK = "t", "network: "
#: Fall of an error from which it is no noise.
HIDDEN_SHARE = 1 - 1 / ADEQUATE
#: Cosines over time; the same blocks as elsewhere are left out in turn, so it interpolates.
TREND = 6


# ------------------------------------------------------------ functions


@dataclass(frozen=True)
class InputSet:
    """A set of inputs: short name, words, and the left-out error with a function of them."""

    what: str
    words: str
    error: float


def explainable(result: FitResult, floor: Floor) -> list[Explainable]:
    """Shares for every joint that moves and is still above its floor; empty where none is."""
    out = []
    for j in np.flatnonzero(~result.problem.holds).tolist():
        if result.rms[j] > ADEQUATE * floor.rms[j]:
            out += _of_joint(result, float(floor.rms[j]), j)
    return out


def function_sentences(shares: list[Explainable]) -> list[str]:
    """One sentence a joint, the largest share first; what explains nothing is not listed."""
    out = []
    for joint in dict.fromkeys(s.joint for s in shares):
        own = sorted((s for s in shares if s.joint == joint), key=lambda s: -s.share)
        some = [s for s in own if s.share >= WORTH]
        if not some:
            every = "; ".join(s.words for s in own)
            out.append(f"{joint}: functions of {every} explain none of it")
            continue
        rest = "".join(f", of {s.words} {100 * s.share:.0f} %" for s in some[1:])
        first = f"{some[0].words} could explain {100 * some[0].share:.0f} %"
        out.append(f"{joint}: a function of {first}{rest}")
    return out


def free_function_falls(result: FitResult) -> dict[int, float] | None:
    """Largest fall of each joint's left-out error by functions of positions and of its own speed.

    Asked of an error at the floor, where `explainable` finds nothing to share out.  None where the
    runs are so long that this would take its time.
    """
    problem = result.problem
    if problem.n * problem.d > MAX_ROWS or result.model.explains != "motor":
        return None
    out, folds = {}, Folds(result)
    for j in np.flatnonzero(~problem.holds).tolist():
        before = max(folds.left_out(np.zeros((problem.n, 0)), j), 1e-300)
        sets = [
            make for what, _, make in _sets(problem, j) if what != TIME and not _of_speeds(what)
        ]
        out[j] = 1.0 - min(_errors(folds, j, sets)) / before
    return out


def _of_speeds(what: str) -> bool:
    """Whether a set of inputs is the speeds of two joints: the largest model has those."""
    return what.startswith("qd of ") and " and " in what


def masked_at_floor(result: FitResult, falls: dict[int, float]) -> list[Explainable]:
    """Shares on joints at their floor of whose error a function removes a tenth or more.

    The floor hides what no candidate explains; that it can be predicted shows that it is no noise.
    Shares are of the whole squared error.

    Parameters
    ----------
    result : FitResult
        The fit.
    falls : dict of int to float
        What `free_function_falls` says of it.
    """
    return [
        s for j, fall in falls.items() if fall > HIDDEN_SHARE for s in _of_joint(result, 0.0, j)
    ]


def _of_joint(result: FitResult, floor: float, j: int) -> list[Explainable]:
    problem, folds = result.problem, Folds(result)
    before = folds.left_out(np.zeros((problem.n, 0)), j)
    return _shares(_asked(folds, j, _sets(problem, j)), before, floor, problem.joints[j])


def _asked(folds: Folds, j: int, sets: Iterable[tuple[str, str, ColumnMaker]]) -> list[InputSet]:
    found = list(sets)
    errors = _errors(folds, j, [make for _, _, make in found])
    named = zip(found, errors, strict=True)
    return [InputSet(what, words, error) for (what, words, _), error in named]


def _errors(folds: Folds, j: int, sets: Sequence[ColumnMaker]) -> list[float]:
    """Left-out error of joint j with each set of columns."""
    return in_parallel(lambda make: folds.left_out(make(), j), sets, folds.result.problem.instants)


def _shares(found: list[InputSet], before: float, floor: float, joint: str) -> list[Explainable]:
    """Shares of a joint's excess from left-out errors, `before` that without a function."""
    least = min([floor, *(f.error for f in found)])
    out = []
    for f in found:
        excess = max(before**2 - least**2, 1e-300)
        share = float(np.clip((before**2 - f.error**2) / excess, 0.0, 1.0))
        text = (
            f"{joint}: a function of {f.words} could explain {100 * share:.0f} % of the "
            "remaining error"
        )
        out.append(Explainable(joint, f"{NETWORK}{f.what}", share, text, f.words))
    return out


def _sets(problem: Problem, j: int) -> Iterator[tuple[str, str, ColumnMaker]]:
    """Short name, words and filtered columns (n, m), made when asked, of every set of inputs."""
    own, names = problem.joints[j], problem.joints

    def seen(raw: Callable[[Motion], FloatArray]) -> ColumnMaker:
        return lambda: problem.gated([raw(m) for m in problem.motions], j)

    for shape in input_sets(problem.motions[0], j):
        columns = seen(partial(dictionary, j=j, shape=shape))
        if shape[0] == SPEED:
            yield f"qd of {own}", "its own speed", columns
        elif shape[0] == PLACE:
            yield f"q,qd of {own}", "its position and speed", columns
        else:
            other = names[int(shape[0]) - 1]
            yield f"qd of {own} and {other}", f"its speed and that of {other}", columns
    yield f"q of {own}", "its position in detail", seen(partial(_places, j=j))
    spots = seen(partial(_spots, j=j))
    yield f"sgn qd,q of {own}", "its direction and its position in detail", spots
    for k in range(problem.d) if problem.d <= _NEAR else ():
        if k != j:
            rubs = seen(partial(_rubs, j=j, k=k))
            yield f"q of {names[k]}", f"the position of {names[k]}", rubs
            both = seen(partial(_poses, j=j, k=k))
            yield f"q of {own} and {names[k]}", f"its position and that of {names[k]}", both
    trend = seen(partial(_trend, j=j))
    yield TIME, "time (offset, dry and viscous friction that change slowly)", trend


def _places(m: Motion, j: int) -> FloatArray:
    """Functions of joint j's position."""
    return _bumps(m.q[:, j], m.span[j], _FINE)


def _spots(m: Motion, j: int) -> FloatArray:
    """Friction of any size along joint j's position."""
    return np.asarray(_places(m, j) * m.sign(j)[:, None])


def _bumps(q: FloatArray, span: FloatArray, count: int) -> FloatArray:
    """Gaussian bumps over a range, as wide as they are apart, shape (n, count)."""
    centres = np.linspace(span[0], span[1], count)
    width = max(float(span[1] - span[0]), 1e-9) / (count - 1)
    out: FloatArray = np.exp(-0.5 * ((q - centres[:, None]) / width) ** 2)
    return out.T


def _rubs(m: Motion, j: int, k: int) -> FloatArray:
    """Functions of joint k's position, alone and with the sign of joint j's speed."""
    each = _bumps(m.q[:, k], m.span[k], _COARSE)
    return np.concatenate([each, each * m.sign(j)[:, None]], axis=1)


def _poses(m: Motion, j: int, k: int) -> FloatArray:
    """Functions of the positions of joints j and k together."""
    a, b = (_bumps(m.q[:, i], m.span[i], POSES) for i in (j, k))
    return np.asarray(a[:, :, None] * b[:, None, :]).reshape(len(m.q), POSES**2)


def _trend(m: Motion, j: int) -> FloatArray:
    """cos(pi k t / T) times 1, sgn v and v, shape (n, 3 (TREND + 1))."""
    t, sign, v = m.since, m.sign(j), m.qd[:, j]
    waves = np.cos(np.pi * np.arange(TREND + 1) * t[:, None] / max(float(t[-1]), 1e-9))
    return np.concatenate([waves, waves * sign[:, None], waves * v[:, None]], axis=1)
