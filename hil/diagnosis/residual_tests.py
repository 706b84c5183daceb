"""Whether the residual is noise: values that change at once, and what no noise is like.

**A value that is another one from some instant of a run on.**
A gain that was set, a screw that came loose, a load that was picked up: laws that hold throughout
can but imitate it, and the noise floor hides what no candidate explains.  So the columns x of a few
values of each joint, cut at instants s of every run, are tried beside the fit with residual r and
orthonormal columns Q:

    c = x [t > s],   gain = (c' r)^2 / (c'c - |Q'c|^2),   value = c' r / (c'c - |Q'c|^2).

**Whether what is left at the noise floor is distributed as noise is.**
Noise that many small causes add up to is Gaussian, whatever its colour.  A wave, or a torque that
switches, keeps to its two sides, and bursts stand out; no function of the motion need predict
them, and a floor that is measured holds them.  So of the residual r of n instants, less its mean,
over its rms around each instant, with the autocorrelation rho:

    k = mean(r^4) / mean(r^2)^2 - 3,   se = sqrt(24 / n (1 + 2 sum rho^4)).

A wave has k = -3/2, a switch -2, noise 0.  Source: Lomnicki, Metrika 4, 1961, 37-62 (the standard
error for a Gaussian process).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.special import chdtri

from hil.diagnosis.artefacts import Blur, blur, coarsely_encoded
from hil.diagnosis.constants import (
    ADEQUATE,
    BURSTS,
    BURSTS_ALONE,
    CERTAIN,
    FLOOR_SHARE,
    HALF,
    LEVEL,
    NEAR_FLOOR,
    SURE,
    SWINGS,
    TENTH,
)
from hil.diagnosis.floor import practical
from hil.diagnosis.types import Change, Cut
from hil.identify.fit import in_units
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.regression import inflation
from hil.identify.result import FitResult
from hil.record.consistency import Note

FloatArray = NDArray[np.float64]
CHANGED, BENT = "changed", "curved-in-temperature"
#: Instants of a run that are tried, and those around the best of them.
_INSTANTS, _AROUND = 15, 16
#: Share of a column below which it is the model's own.
_OWN_SHARE = 1e-4
CAUSE = "was a gain changed, is a screw loose, does something touch it, does a part warm up?"
#: What to do where a value changed within a run, and where a whole run has another one.
CUT_THERE = "Give what was recorded before and after that instant as two sessions"
FIT_APART = (
    "Fit the sessions of one state of the rig together, and leave that session out or fit it alone"
)
#: What may change, and its unit.
VALUES = (
    ("effort at rest", "{F}"),
    ("Coulomb friction", "{F}"),
    ("viscous friction", "{F} s/{x}"),
    ("inertia", "{F} s^2/{x}"),
    ("stiffness", "{F}/{x}"),
    ("scale of all efforts", "1"),
)


# ------------------------------------------------------------ changes at once


def changes_told(found: Sequence[Change]) -> list[tuple[str, str]]:
    """Notes (code, sentence), the last with what to do."""
    texts = [c.text for c in found]
    what = [CUT_THERE] * any(c.at for c in found) + [FIT_APART] * any(not c.at for c in found)
    last = [f"{t}; {CAUSE} {'. '.join(what)}" for t in texts[-1:]]
    said = zip([*texts[:-1], *last], found, strict=True)
    return [Note(CHANGED, t, c.joint) for t, c in said]


def changes(result: FitResult, projector: Projector | None = None) -> tuple[Change, ...]:
    """The change that explains most, joint by joint, where the error falls by a tenth or more.

    Parameters
    ----------
    result : FitResult
        A fit.
    projector : Projector, optional
        That of the same fit.
    """
    if result.model.explains != "motor":
        return ()
    projector = projector or Projector(result.problem, result.terms, result.sigma)
    moves = np.flatnonzero(~result.problem.holds).tolist()
    found = (_change_of(projector, result, j) for j in moves)
    return tuple(c for c in found if c is not None)


def _change_of(projector: Projector, result: FitResult, j: int) -> Change | None:
    """What changed on joint j, if it is more than chance and matters."""
    problem, columns = result.problem, _columns(result, j)
    cuts = _coarse(result)
    gain, value, what, cut = _best(projector, j, columns, range(len(VALUES)), cuts)
    others = _throughout(projector, j, columns[:, what]), _bend(projector, result, j)[0]
    if gain < ADEQUATE * max(others):
        return None
    if cut[1]:
        # the instant itself, between its neighbours
        gain, value, what, cut = _best(projector, j, columns, [what], _fine(result, cut))
        if _at_an_end(problem, columns[:, what], cut):
            return None
    rows = slice(j * problem.n, (j + 1) * problem.n)
    r = projector.residual[rows]
    left = r - value * _beside(projector, j, columns[:, what] * _later(problem, cut))
    rss, rest = float(r @ r), float(left @ left)
    tried = len(cuts) * len(VALUES) * problem.d
    # gain / (noise * inflation) ~ chi2(1), Bonferroni over all that was tried
    noise = rest / max(float(problem.count[j]), 1.0) * inflation(r, problem.run)
    chance = gain < chdtri(1, LEVEL / tried) * max(noise, 1e-300)
    if chance or rest * ADEQUATE**2 > rss:
        return None
    name, unit = VALUES[what]
    run, at = problem.recordings[cut[0]].name, cut[1]
    unit = in_units(unit, problem, j)
    return Change(problem.joints[j], name, unit, run, at, value, 1 - rest / rss, rss - rest)


def changes_somewhere(result: FitResult, projector: Projector, found: Sequence[Change]) -> bool:
    """Whether a value changes within the runs: at one instant, or in each run at its own.

    A load that every run picks up leaves steps in all of them, of which each hides the other.

    Parameters
    ----------
    result : FitResult
        A fit.
    projector : Projector
        That of the same fit.
    found : sequence of Change
        What `changes` found.
    """
    if found or result.problem.runs == 1 or result.model.explains != "motor":
        return bool(found)
    moves = np.flatnonzero(~result.problem.holds).tolist()
    return any(_in_every_run(projector, result, j) for j in moves)


def _in_every_run(projector: Projector, result: FitResult, j: int) -> bool:
    """Whether one value of joint j that changes in every run at its best instant matters."""
    problem, columns = result.problem, _columns(result, j)
    rows = slice(j * problem.n, (j + 1) * problem.n)
    r, cuts = projector.residual[rows], [c for c in _coarse(result) if c[1]]
    parts = sorted({part for part, _ in cuts})
    tried = len(cuts) * len(VALUES) * problem.d
    for k in range(len(VALUES)):
        best = [_best(projector, j, columns, [k], [c for c in cuts if c[0] == p])[3] for p in parts]
        later = np.any([_later(problem, cut) for cut in best], axis=0)
        own = _beside(projector, j, columns[:, k] * later)
        left = r - own * (own @ r) / max(float(own @ own), 1e-300)
        rss, rest = float(r @ r), float(left @ left)
        noise = rest / max(float(problem.count[j]), 1.0) * inflation(left, problem.run)
        # as of one change
        chance = rss - rest < chdtri(len(parts), LEVEL / tried) * max(noise, 1e-300)
        if not chance and rest * ADEQUATE**2 < rss:
            return True
    return False


def _throughout(projector: Projector, j: int, c: FloatArray) -> float:
    """Gain of a column (n,) of joint j that acts throughout: what an offset does is no change."""
    rows = slice(j * projector.problem.n, (j + 1) * projector.problem.n)
    whole = float(c @ c)
    free = whole - float(np.sum(projector.inner(rows, c[:, None]) ** 2))
    along = float(c @ projector.residual[rows])
    return along**2 / free if free > _OWN_SHARE * whole else 0.0


def _bend(projector: Projector, result: FitResult, j: int) -> tuple[float, int, str]:
    """What a curve of the temperature explains where a law of joint j is linear in it.

    Gain of the columns that bend it, their number, and the law's name; zero without such a law.
    """
    problem, out = result.problem, (0.0, 0, "")
    for t in result.terms:
        if t.joint != j or t.effect.scope.whole:
            continue
        raw = []
        for m in problem.motions:
            warm = t.effect.relations.linear(m, j, t.shape)
            raw += [] if warm is None else [t.effect.columns(m, j, t.shape) * warm[:, None]]
        if len(raw) == len(problem.motions):
            gain = projector.gain_of(t, problem.gated(raw, j) / result.sigma[j])
            out = max(out, (gain, raw[0].shape[1], t.effect.name))
    return out


def bends(result: FitResult, projector: Projector | None) -> list[tuple[str, str]]:
    """Notes (code, sentence) on laws of a temperature that are curved, where the model's are not.

    Parameters
    ----------
    result : FitResult
        A fit.
    projector : Projector, optional
        That of the same fit; without it nothing is said.
    """
    if projector is None or result.model.explains != "motor":
        return []
    problem, out = result.problem, []
    for j in np.flatnonzero(~problem.holds).tolist():
        gain, count, name = _bend(projector, result, j)
        r = projector.residual[j * problem.n : (j + 1) * problem.n]
        rss = float(r @ r)
        rest = max(rss - gain, 0.0)
        noise = rest / max(float(problem.count[j]), 1.0) * inflation(r, problem.run)
        # as of a change: beyond chance on all joints, and the error falls by a tenth
        if count and gain > chdtri(count, LEVEL / problem.d) * noise and rest * ADEQUATE**2 < rss:
            fall = 100 * (1 - np.sqrt(rest / rss))
            text = (
                f"{problem.joints[j]}: {name} is taken as linear in the measured temperature; a "
                f"curved law of it would lower the error by {fall:.0f} %"
            )
            out.append((BENT, text))
    return out


def _beside(projector: Projector, j: int, c: FloatArray) -> FloatArray:
    """Part of a column (n,) of joint j that the base does not do, on the same rows."""
    n, (q, u) = projector.problem.n, projector.parts[j]
    known = projector.inner(slice(j * n, (j + 1) * n), c[:, None])
    out: FloatArray = c - (q @ (u @ known))[:, 0]
    return out


def _later(problem: Problem, cut: Cut) -> NDArray[np.bool_]:
    """Rows (n,) of a run from an instant on."""
    own = problem.run == cut[0]
    out: NDArray[np.bool_] = own & (problem.t >= float(problem.t[own].min()) + cut[1])
    return out


def _at_an_end(problem: Problem, c: FloatArray, cut: Cut) -> bool:
    """Whether a column (n,) has less than a tenth of it in its run on one side of an instant.

    What changes there is how the run begins or ends, and no other state of the rig: a spring that
    yields or a mass that swings is not at rest when a recording starts.
    """
    later, own = _later(problem, cut), problem.run == cut[0]
    whole, after = float(c[own] @ c[own]), float(c[later] @ c[later])
    return min(after, whole - after) < TENTH * whole


def _columns(result: FitResult, j: int) -> FloatArray:
    """Columns (n, 6) of `VALUES` on joint j, weighted as the rows are."""
    problem = result.problem
    raw = [
        np.stack([np.ones(m.n), m.sign(j), m.qd[:, j], m.qdd[:, j], m.q[:, j]], axis=1)
        for m in problem.motions
    ]
    made = np.column_stack([problem.gated(raw, j), problem.y[j] - result.residual[j]])
    return np.asarray(made / result.sigma[j], dtype=np.float64)


def _coarse(result: FitResult) -> list[Cut]:
    """Instants over every run; of several runs each one as a whole, too, against all others.

    Of two runs one is enough: which of them is the other one is not known.
    """
    motions = result.problem.motions
    whole = [(k, 0.0) for k in range(1 if len(motions) == 2 else 0, len(motions))]
    whole = whole if len(motions) > 1 else []
    inside = np.arange(1, _INSTANTS + 1) / (_INSTANTS + 1)
    return whole + [(k, float(m.since[-1] * x)) for k, m in enumerate(motions) for x in inside]


def _fine(result: FitResult, cut: Cut) -> list[Cut]:
    """Instants around one of the coarse ones, itself among them."""
    step = float(result.problem.motions[cut[0]].since[-1]) / (_INSTANTS + 1) / _AROUND
    return [(cut[0], cut[1] + step * x) for x in range(1 - _AROUND, _AROUND)]


def _best(
    projector: Projector, j: int, columns: FloatArray, which: Sequence[int], cuts: list[Cut]
) -> tuple[float, float, int, Cut]:
    """Gain, value, number of the value and cut of what explains most on joint j."""
    problem = projector.problem
    rows = slice(j * problem.n, (j + 1) * problem.n)
    later = [_later(problem, cut) for cut in cuts]
    found = [(0.0, 0.0, which[0], cuts[0])]
    for k in which:
        c = columns[:, k : k + 1] * np.stack(later, axis=1)
        whole = np.sum(c**2, axis=0)
        free = whole - np.sum(projector.inner(rows, c) ** 2, axis=0)
        free = np.where(free > _OWN_SHARE * whole, free, np.inf)
        along = c.T @ projector.residual[rows]
        b = int(np.argmax(along**2 / free))
        found.append((float(along[b] ** 2 / free[b]), float(along[b] / free[b]), k, cuts[b]))
    return max(found, key=lambda x: x[0])


UNLIKE = "unlike-noise"
#: Parts of a run that have an rms of their own.
_PARTS = 6
#: Autocorrelations counted.
_LAGS = 400
#: Instants that are named, and the Fourier transform's padding.
NAMED_INSTANTS, PADDED = 3, 4


# ------------------------------------------------------------ unlike noise


@dataclass(frozen=True)
class Unlike:
    """What is left on one joint, where it is no noise.

    Parameters
    ----------
    joint : str
        Name.
    kurtosis : float
        Of the residual; noise has 0.
    matters : bool
        Whether it is most of what is left, so that the model is not adequate.
    text : str
        One sentence without its full stop.
    """

    joint: str
    kurtosis: float
    matters: bool
    text: str


def unlike_noise(
    result: FitResult, error: FloatArray, floor: FloatArray, projector: Projector | None = None
) -> list[Unlike]:
    """Joints that move, are at their floor, and leave something other than noise that matters.

    Parameters
    ----------
    result : FitResult
        The last fit, of motor efforts; of others nothing is said.
    error, floor : ndarray (d,)
        Held-out error and the noise floor it is compared with [N m or N].
    projector : Projector, optional
        Of the fit: bursts that are no more than blurred reversals are then left out.
    """
    problem, out = result.problem, []
    moves = ~problem.holds & (error <= NEAR_FLOOR * floor) & (result.model.explains == "motor")
    moves &= error > practical(problem) * problem.rms(problem.effort)
    for j in np.flatnonzero(moves).tolist():
        own = _unlike_of(result, j, projector)
        out += [own] if own else []
    return out


def _unlike_of(result: FitResult, j: int, projector: Projector | None) -> Unlike | None:
    """What is left on joint j, if it is no noise."""
    problem, left = result.problem, result.residual[j]
    raw = _runs(problem, j, left)
    if not raw:
        return None
    (k, se), (whole, spread) = _even(raw), kurtosis(np.concatenate(raw))
    alone = k
    if k > BURSTS and k > CERTAIN * se and projector is not None:
        filtered = blur(result, projector, j)
        left = left - filtered.effort
        raw = _runs(problem, j, left)
        k, se = _even(raw)
        alone = _elsewhere(problem, j, left, filtered, projector) if k > BURSTS_ALONE else k
    joint, rate = problem.joints[j], problem.rate
    if k < SWINGS and k < -SURE * se:
        return Unlike(joint, k, True, f"{joint}: {_swings(k, [r / _around(r) for r in raw], rate)}")
    if k > BURSTS and k > CERTAIN * se:
        # where the speed passes a count a row, a coarse encoder bursts
        if coarsely_encoded(problem)[j]:
            return None
        return Unlike(joint, k, alone > BURSTS_ALONE, f"{joint}: {_bursts(problem, j, left, k)}")
    longest = max(raw, key=len)
    size = _around(longest)
    if whole > SURE * spread and HALF * size.max() > size.min():
        return Unlike(joint, whole, False, f"{joint}: {_uneven(longest)}")
    return None


def _elsewhere(
    problem: Problem, j: int, left: FloatArray, filtered: Blur, projector: Projector
) -> float:
    """Kurtosis of what is left (n,) of joint j but at reversals, where their blur is a good part.

    One wider filter does not undo all of a blur; it bursts at the same instants.
    """
    share = filtered.gain * projector.sigma[j] ** 2 / max(float(np.sum(left**2)), 1e-300)
    near = np.abs(filtered.effort) > TENTH * float(np.max(np.abs(filtered.effort)))
    # the filter of the efforts spreads a burst to the rows beside it
    near = binary_dilation(near)
    if share <= FLOOR_SHARE or np.all(near | ~problem.live[j]):
        return _even(_runs(problem, j, left))[0]
    runs = [
        left[(problem.run == k) & problem.live[j] & ~near] for k in range(len(problem.recordings))
    ]
    return _even([r / max(float(r.std()), 1e-300) for r in runs if r.size >= _LAGS] or [left])[0]


def unlike_notes(found: Sequence[Unlike]) -> list[tuple[str, str]]:
    """Code and sentence of each."""
    return [Note(UNLIKE, u.text, u.joint) for u in found]


def kurtosis(r: FloatArray) -> tuple[float, float]:
    """Excess kurtosis of r (n,) of mean 0, and its standard error for Gaussian noise."""
    n, r = r.size, r / max(float(np.sqrt(np.mean(r**2))), 1e-300)
    power = np.abs(np.fft.rfft(r, 2 * n)) ** 2
    rho = np.clip(np.fft.irfft(power)[1 : min(_LAGS, n // 4)] / n, -1.0, 1.0)
    # k = mean(r^4) - 3,   se = sqrt(24 / n (1 + 2 sum rho^4))
    return float(np.mean(r**4)) - 3.0, float(np.sqrt(24.0 / n * (1.0 + 2.0 * np.sum(rho**4))))


def _runs(problem: Problem, j: int, left: FloatArray) -> list[FloatArray]:
    """What is left on joint j (n,), run by run, where there is enough of it."""
    parts = [_residual(problem, j, left, k) for k in range(len(problem.recordings))]
    return [r for r in parts if r.size >= _LAGS]


def _even(runs: list[FloatArray]) -> tuple[float, float]:
    """Kurtosis over the rms around each instant, and its standard error."""
    return kurtosis(np.concatenate([r / _around(r) for r in runs]))


def _residual(problem: Problem, j: int, left: FloatArray, k: int) -> FloatArray:
    """What is left on joint j in run k, of mean 0 and rms 1."""
    r = left[(problem.run == k) & problem.live[j]]
    out: FloatArray = (r - r.mean()) / max(float(r.std()), 1e-300) if r.size else r
    return out


def _around(r: FloatArray) -> FloatArray:
    """Rms of r (n,) around each instant, between those of PARTS parts."""
    edges = np.linspace(0, r.size, _PARTS + 1).astype(int)
    power = [float(np.mean(r[a:b] ** 2)) for a, b in pairwise(edges.tolist())]
    middle = (edges[1:] + edges[:-1]) / 2
    out: FloatArray = np.sqrt(np.interp(np.arange(r.size), middle, power))
    return np.maximum(out, 1e-300)


def _swings(k: float, runs: list[FloatArray], rate: float) -> str:
    """Sentence on a residual of two sides, with its frequency in the thirds of the longest run."""
    longest = max(runs, key=len)
    at = [_frequency(part, rate) for part in np.array_split(longest, 3)]
    where = f"about {at[0]:.2g}, {at[1]:.2g} and {at[2]:.2g} Hz in the thirds of the run"
    if max(at) < NEAR_FLOOR * min(at):
        where = f"about {at[1]:.2g} Hz"
    does = "swings from side to side"
    return (
        f"the remaining error {does}, at {where}. It is not noise (kurtosis {k:.2g}; noise 0, sine "
        "-1.5, switch -2): something acts that does not follow from the motion"
    )


def _frequency(r: FloatArray, rate: float) -> float:
    """Frequency of the strongest wave [Hz]."""
    size = np.abs(np.fft.rfft((r - r.mean()) * np.hanning(r.size), PADDED * r.size))
    return float(np.argmax(size) * rate / (PADDED * r.size))


def _bursts(problem: Problem, j: int, left: FloatArray, k: float) -> str:
    """Sentence on a residual that comes in bursts, with where it is largest in the run of most."""
    live = problem.live[j]
    squares = np.sort(left[live] ** 2)[::-1]
    count = max(round(TENTH * squares.size), 1)
    share = float(squares[:count].sum() / squares.sum())
    power = np.where(live & (left**2 >= squares[count - 1]), left**2, 0.0)
    run = int(np.argmax(np.bincount(problem.run, power)))
    own = problem.run == run
    when = problem.t[own & live] - float(problem.t[own].min())
    where = ", ".join(
        f"{x:.2f}" for x in _largest(_residual(problem, j, left, run), when, problem.rate)
    )
    return (
        f"the remaining error comes in bursts: {100 * share:.0f} % of its power lies in a tenth of "
        f"the time (noise: 44 %; kurtosis {k:.2g}, noise 0). The largest are at {where} s of "
        f"{problem.recordings[run].name}: {_slowly(problem, j, left)}"
    )


#: Words of bursts at low speed.
STARTS = "most of it lies where the joint starts, stops or turns"


def _slowly(problem: Problem, j: int, left: FloatArray) -> str:
    """What to look at in bursts (n,): friction at low speed, where most of them are slow."""
    live = problem.live[j]
    speed, power = np.abs(problem.qd[j][live]), left[live] ** 2
    most = power >= np.quantile(power, 1 - TENTH)
    slow = speed < TENTH * float(np.sqrt(np.mean(speed**2)))
    share = float(power[most & slow].sum() / max(power[most].sum(), 1e-300))
    if share <= HALF or share <= 2 * float(slow.mean()):
        return "check what happens there"
    return f"{STARTS}, which slow strokes with many turns would show (friction at low speed)"


def _uneven(r: FloatArray) -> str:
    """Sentence on noise that is not of one size throughout."""
    thirds = [float(np.sqrt(np.mean(x**2))) for x in np.array_split(r, 3)]
    size = ", ".join(f"{x / thirds[0]:.2g}" for x in thirds)
    return (
        f"the remaining error is like noise of changing size: {size} times in the thirds of the "
        "run. "
        "Standard errors and the noise floor are averages over the run"
    )


def _largest(r: FloatArray, t: FloatArray, rate: float) -> list[float]:
    """Times of the largest bursts in order, no two within a second."""
    width = max(round(HALF * rate), 1)
    power, found = np.convolve(r**2, np.ones(width), "same"), list[float]()
    for i in np.argsort(-power).tolist():
        if all(abs(t[i] - x) > 1.0 for x in found):
            found.append(float(t[i]))
        if len(found) == NAMED_INSTANTS:
            break
    return sorted(found)
