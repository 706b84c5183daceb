"""What any free function without a name could still explain, where no effect does.

For each set of inputs a wavelet network is fitted to what the model leaves, together with all of
the model's own columns, with a ridge, and judged on blocks of time that it was not fitted to:

    share = (E0^2 - E^2) / (E0^2 - floor^2),

E the left-out rms error with the network and E0 without it; the floor is the least of the noise
floor and of all E.  The largest share says which
variables carry the missing structure; a small one everywhere says that it is none of these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.constants import ADEQUATE, WORTH
from hil.diagnosis.types import Explainable, Floor
from hil.identify.parallel import in_parallel
from hil.identify.problem import Problem
from hil.identify.regression import basis, time_blocks
from hil.identify.result import FitResult
from hil.models.motion import Motion
from hil.models.network import PLACE, SPEED, dictionary, input_sets

FloatArray = NDArray[np.float64]
FOLDS, SECONDS, STRENGTHS = 5, 0.5, (1e-4, 1e-3, 1e-2, 1e-1)


# ------------------------------------------------------------ blocks of time left out


class Folds:
    """A model's own columns and residual, every fifth block of time left out in turn."""

    def __init__(self, result: FitResult) -> None:
        self.result, problem = result, result.problem
        q = _free(result).reshape(problem.d, problem.n, -1)
        y = result.residual / result.sigma[:, None]
        fold = time_blocks(problem, SECONDS) % FOLDS
        #: Columns (d, n_k, r) and residual (d, n_k) of each fold.
        self.parts = [(q[:, fold == k], y[:, fold == k]) for k in range(FOLDS)]
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


def _free(result: FitResult) -> FloatArray:
    """Orthonormal weighted columns (d n, r) of the parameters that are not on a bound."""
    free = np.array([not (n in result.values and result.values[n].at_bound) for n in result.names])
    if free.all():
        return result.basis.q
    w = np.repeat(1.0 / result.sigma, result.problem.n)
    return basis(result.x[:, free] * w[:, None]).q


#: Makes columns (n, m).
Make = Callable[[], FloatArray]
#: Rows up to which a network is fitted where nothing is left above the floor.
MAX_ROWS = 10_000
#: Bumps over a joint's own range and over another one's, and joints up to which those are asked.
FINE, COARSE, NEAR = 40, 12, 4
#: Bumps over each of two joints' ranges.
POSES = 7
#: Fall of an error from which it is no noise.
HIDDEN_SHARE = 1 - 1 / ADEQUATE
#: Cosines over time; the same blocks as elsewhere are left out in turn, so it interpolates.
TREND = 6


# ------------------------------------------------------------ functions


@dataclass(frozen=True)
class Function:
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


def told(shares: list[Explainable]) -> list[str]:
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


def foretold(result: FitResult) -> dict[int, float] | None:
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
        sets = [make for what, _, make in _sets(problem, j) if what != "t" and not _of_speeds(what)]
        out[j] = 1.0 - min(_errors(folds, j, sets)) / before
    return out


def _of_speeds(what: str) -> bool:
    """Whether a set of inputs is the speeds of two joints: the largest model has those."""
    return what.startswith("qd of ") and " and " in what


def hidden(result: FitResult, falls: dict[int, float]) -> list[Explainable]:
    """Shares on joints at their floor of whose error a function removes a tenth or more.

    The floor hides what no candidate explains; that it can be foretold shows that it is no noise.
    Shares are of the whole squared error.

    Parameters
    ----------
    result : FitResult
        The fit.
    falls : dict of int to float
        What `foretold` says of it.
    """
    return [
        s for j, fall in falls.items() if fall > HIDDEN_SHARE for s in _of_joint(result, 0.0, j)
    ]


def _of_joint(result: FitResult, floor: float, j: int) -> list[Explainable]:
    problem, folds = result.problem, Folds(result)
    before = folds.left_out(np.zeros((problem.n, 0)), j)
    return shares(_asked(folds, j, _sets(problem, j)), before, floor, problem.joints[j])


def _asked(folds: Folds, j: int, sets: Iterable[tuple[str, str, Make]]) -> list[Function]:
    found = list(sets)
    errors = _errors(folds, j, [make for _, _, make in found])
    named = zip(found, errors, strict=True)
    return [Function(what, words, error) for (what, words, _), error in named]


def _errors(folds: Folds, j: int, sets: Sequence[Make]) -> list[float]:
    """Left-out error of joint j with each set of columns."""
    return in_parallel(lambda make: folds.left_out(make(), j), sets, folds.result.problem.instants)


def shares(found: list[Function], before: float, floor: float, joint: str) -> list[Explainable]:
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
        out.append(Explainable(joint, f"network: {f.what}", share, text, f.words))
    return out


def _sets(problem: Problem, j: int) -> Iterator[tuple[str, str, Make]]:
    """Short name, words and filtered columns (n, m), made when asked, of every set of inputs."""
    own, names = problem.joints[j], problem.joints

    def seen(raw: Callable[[Motion], FloatArray]) -> Make:
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
    for k in range(problem.d) if problem.d <= NEAR else ():
        if k != j:
            rubs = seen(partial(_rubs, j=j, k=k))
            yield f"q of {names[k]}", f"the position of {names[k]}", rubs
            both = seen(partial(_poses, j=j, k=k))
            yield f"q of {own} and {names[k]}", f"its position and that of {names[k]}", both
    trend = seen(partial(_trend, j=j))
    yield "t", "time (offset, dry and viscous friction that change slowly)", trend


def _places(m: Motion, j: int) -> FloatArray:
    """Functions of joint j's position."""
    return _bumps(m.q[:, j], m.span[j], FINE)


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
    each = _bumps(m.q[:, k], m.span[k], COARSE)
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
