"""Errors on data that the parameters have not seen, and where a held-out session differs.

The sharpness of Coulomb friction's sign is what fitted runs hardly say and others do.  A fit takes
the sharpest sign that explains its runs about as well as the best one, for a blunt sign imitates
what happens at low speed.  Runs that reverse quickly hardly tell them apart; a run that lingers
about zero speed does, and its error is then neither noise nor a missing effect.

A held-out session differs from the fitted ones where an effect is in only one of them.

Three cases, joint by joint, each with its own sign:

- *values*: with the parameters of the fit the held-out error is far above what the same model
  leaves when it is fitted to that session alone; within what their standard errors allow, that is
  the fit's motion and not the rig;
- *theirs*: fitted alone the held-out session keeps an error that a candidate explains there, and
  that candidate is not in the fitted ones;
- *ours*: a candidate explains what is left in the fitted sessions, and the held-out one, fitted
  alone, shows less than a quarter of it.

Nothing here changes a verdict; it says why one came out as it did.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.attribution import choose, plausible
from hil.diagnosis.candidates import held_out_residual
from hil.diagnosis.constants import (
    ADEQUATE,
    CERTAIN,
    HALF,
    NEAR_FLOOR,
    OPEN,
    SURE,
    WHOLE,
    WORTH,
)
from hil.diagnosis.evidence import floor_of, gather, in_time, terms_to_try
from hil.diagnosis.floor import practical
from hil.diagnosis.grams import Split, split
from hil.diagnosis.types import Candidate, Diagnosis, Evidence, HeldOut, Step, above_zero
from hil.errors import DataError, plural
from hil.identify.context import set_context
from hil.identify.design import Term, coefficients
from hil.identify.fit import (
    assemble,
    fit,
    identified,
    leaves,
    outside,
    own_values,
    predict,
    unit_of,
)
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.regression import cluster_covariance, inflation, least_squares, time_blocks
from hil.identify.result import FitResult
from hil.identify.screening import CLOSE
from hil.identify.timing import fit_aligned
from hil.models.effect import Trait
from hil.models.model import Band
from hil.record.checks import check
from hil.record.consistency import Note, notes_of
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]


# ------------------------------------------------------------ examiner


class Examiner:
    """Evaluates fits on held-out runs if there are any, else on blocks of the same ones.

    Parameters
    ----------
    problem : Problem
        The runs of the fit.
    holdout : list of Recording
        Other runs; may be empty.
    before : Problem, optional
        What the held-out runs were for another model of the same runs.
    """

    def __init__(
        self, problem: Problem, holdout: list[Recording], before: Problem | None = None
    ) -> None:
        self.kind = "holdout" if holdout else "folds"
        self._problem = problem
        self._other: Problem | None = None
        #: The last model fitted to the held-out runs alone, once their floor was asked for.
        self.alone: FitResult | None = None
        if holdout:
            for other in holdout:
                _of_robot(other, problem)
                _sound(other)
            _other_than(problem.recordings, holdout)
            band = Band(effort_step=problem.effort_step)
            asked = (holdout, problem.source, problem.explains, band, problem.rates)
            known = before.again(*asked) if before is not None else None
            if known is None or not np.array_equal(known.span, problem.span):
                known = Problem(*asked, problem.span)
            self._other = known

    @property
    def other(self) -> Problem | None:
        """The held-out runs; None without any."""
        return self._other

    def outside(self, result: FitResult) -> list[str]:
        """Where the held-out runs leave the range of the fit; empty without any."""
        if self._other is None:
            return []
        predict(result, self._other)  # the load there is the fit's
        return outside(result.model.valid, self._other, "held-out session")

    def own(self, result: FitResult) -> list[tuple[str, str]]:
        """Warning (code, sentence) where held-out runs get values that are fitted to themselves."""
        found = own_values(result)
        if self._other is None or not found:
            return []
        joints, runs = result.problem.joints, self._other.runs
        parts = [
            f"{name}{' on ' + ', '.join(joints[j] for j in some) if some else ''} "
            f"({plural(size * max(len(some), 1), 'value')} a run)"
            for name, (size, some) in found.items()
        ]
        total = runs * sum(size * max(len(some), 1) for size, some in found.values())
        names = ", ".join(
            self._other.recordings[int(np.argmax(self._other.whole == k))].name for k in range(runs)
        )
        text = (
            f"every run has its own values of {'; '.join(parts)}: {plural(total, 'value')} "
            f"were fitted to {names}. The held-out error does not test them"
        )
        return [("held-out-values", text)]

    def __call__(self, result: FitResult) -> HeldOut:
        """Held-out residuals of a fit."""
        if self._other is not None:
            if self._other.alignment != self._problem.alignment:
                self._other.align_effort(self._problem.alignment)
            residual = predict(result, self._other)
            return _held(residual, self._other, self.kind)
        if result.terms and all(t.fixed for t in result.terms):  # no row has been fitted
            return _held(result.residual, self._problem, self.kind)
        folds = split(self._problem, whole_runs=not any(t.per_run for t in result.terms))
        return of_blocks(held_out_residual(result, folds), self._problem, folds)

    def floor(self, result: FitResult, evidence: Evidence) -> FloatArray | None:
        """Noise floor of the held-out runs themselves (d,); None without any.

        `evidence` is that beside the fit: its candidates are what might be explained there.
        """
        if self._other is None:
            return None
        self.alone = fit(self._other, result.model)
        return np.asarray(floor_of(self.alone, evidence).rms)


def _of_robot(other: Recording, problem: Problem) -> None:
    """Refuse a held-out run of another robot."""
    if other.joints != problem.joints:
        raise DataError(
            f"held-out session {other.name!r} has joints {', '.join(other.joints)}, the "
            f"fitted ones {', '.join(problem.joints)}; give sessions of one robot"
        )
    ours, theirs = problem.recordings[0].robot, other.robot
    if _named(ours) and _named(theirs) and ours.preset != theirs.preset:
        raise DataError(
            f"held-out session {other.name!r} is of the robot {theirs.preset!r}, the fitted ones "
            f"of {ours.preset!r}; give sessions of one robot"
        )


def _named(robot: RobotSource) -> bool:
    """Whether a session says of which known robot it is; axes may be anybody's."""
    return not robot.urdf and robot.preset not in ("", "single-axis")


def _sound(run: Recording) -> None:
    """Refuse a held-out run whose faults would make every error meaningless."""
    errors = [f.sentence for f in check(run) if f.severity == "error"]
    if errors:
        what = f"held-out session {run.name!r} has faults, nothing can be judged on it: "
        what += "; ".join(errors[:3])
        raise DataError(f"{what}. See 'hil info', then mend or leave it out.").about("faults", what)


def _other_than(fitted: list[Recording], holdout: list[Recording]) -> None:
    """Refuse a held-out run that was fitted: nothing is held out then."""
    for h in holdout:
        for r in fitted:
            if np.array_equal(h.q, r.q) and np.array_equal(h.tau, r.tau):
                raise DataError(
                    f"held-out session {h.name!r} holds the same data as the fitted session "
                    f"{r.name!r}; give another one, or none: then blocks of it are held out"
                )


def _held(residual: FloatArray, problem: Problem, kind: str) -> HeldOut:
    names = tuple(r.name for r in problem.recordings)
    return HeldOut(residual, problem.effort, _blocks(problem), kind, problem.run, names)


def _blocks(problem: Problem) -> NDArray[np.int_]:
    """Blocks of a twentieth of the shortest run, 0.2 to 1 s."""
    shortest = float(min(np.bincount(problem.run))) / problem.rate
    return time_blocks(problem, float(np.clip(shortest / 20, 0.2, 1.0)))


def of_blocks(residual: FloatArray, problem: Problem, folds: Split) -> HeldOut:
    """Left-out residuals (d, n) of the fitted runs; what is not tested does not count."""
    names = tuple(r.name for r in problem.recordings)
    effort = np.where(folds.tested, problem.effort, 0.0)
    return HeldOut(residual, effort, folds.block, "folds", problem.run, names)


#: Ratio of one resolution to the next that is tried.
RESOLUTION_RATIO = 1.25


# ------------------------------------------------------------ sharpness of the sign


def settled(result: FitResult, examine: Examiner, label: str) -> Step:
    """A first rung: the fit with signs as blunt as the held-out runs ask for, and its errors."""
    step = Step(label, result, examine(result))
    found = blunt(result, step.heldout, examine)
    if not found:
        return step
    result.problem.least.update(found)
    again = fit_aligned(result.problem, result.model, result.sigma)
    return Step(label, again, examine(again))


def blunt(result: FitResult, heldout: HeldOut, examine: Examiner) -> dict[tuple[str, int], float]:
    """Least resolution of the sign that other runs ask for, by (``"coulomb"``, joint).

    Parameters
    ----------
    result : FitResult
        A fit.
    heldout : HeldOut
        Its residuals on other runs.
    examine : Examiner
        Makes these.

    Returns
    -------
    dict
        For joints whose error is larger on the other runs, the sharpest value, in steps of
        `RESOLUTION_RATIO`, that explains the fitted runs as well as the present one and lowers
        the held-out error by more than `WORTH`, to within 1 % of the best one's.  Empty
        without other runs.
    """
    if heldout.kind != "holdout":
        return {}
    problem = result.problem
    ratio = heldout.rms / np.maximum(result.rms, 1e-300)
    signs = [t for t in result.terms if Trait.DRY in t.effect.traits and not t.fixed_shape]
    signs = [t for t in signs if ratio[t.joint] > 1 + WORTH and not problem.holds[t.joint]]
    if not signs:
        return {}
    found = {t.key: _sharpest(t, result, heldout, examine) for t in signs}
    set_context(problem, result.terms)
    return {key: v0 for key, v0 in found.items() if v0 > 0.0}


def _sharpest(term: Term, result: FitResult, heldout: HeldOut, examine: Examiner) -> float:
    """Sharpest resolution that is about the best on other runs; 0 where the present one will do."""
    j, values = term.joint, _blunter(term, result)
    # every third value shows whether any will do
    seen = _predicted(term, values[::3], result, examine)
    if min((error for _, error in seen), default=np.inf) > (1 - WORTH / 2) * heldout.rms[j]:
        return 0.0
    rows = _predicted(term, values, result, examine)
    least = min((error for _, error in rows), default=np.inf)
    if least > (1 - WORTH) * heldout.rms[j]:
        return 0.0
    return next(v0 for v0, error in rows if error**2 <= CLOSE * least**2)


def _predicted(
    term: Term, values: Sequence[float], result: FitResult, examine: Examiner
) -> list[tuple[float, float]]:
    """Resolutions that explain the fitted runs as well, with the joint's error on other runs."""
    rows: list[tuple[float, float]] = []
    for v0 in values:
        other = _with(result, term, v0)
        if other.rms[term.joint] ** 2 > CLOSE * result.rms[term.joint] ** 2:
            break
        rows.append((v0, float(examine(other).rms[term.joint])))
    return rows


def _blunter(term: Term, result: FitResult) -> list[float]:
    """Blunter resolutions, in steps of `RESOLUTION_RATIO` to the end of the grid."""
    (most,) = result.problem.grid(term.effect, term.joint)[-1]
    v0 = float(term.shape[0])
    return [
        float(v0 * RESOLUTION_RATIO**k)
        for k in range(1, int(np.log(most / v0) / np.log(RESOLUTION_RATIO)) + 1)
    ]


def _with(result: FitResult, term: Term, v0: float) -> FitResult:
    """The fit with another sign on a joint, its coefficients solved again."""
    terms = [t.reshaped((v0, *t.shape[1:])) if t is term else t for t in result.terms]
    set_context(result.problem, terms)
    return assemble(result.problem, result.model, terms, result.sigma)


# ------------------------------------------------------------ what turns one session into the other


@dataclass(frozen=True)
class _Try:
    """One explanation: words, share of the difference, its score; whether another value alone."""

    text: str
    share: float
    score: float
    single: bool = True


def explanation(
    fitted: FitResult, alone: FitResult, residual: FloatArray, j: int
) -> tuple[str, bool]:
    """Words for what would account for joint j's error under the other's parameters.

    All parameters stay as they were fitted; one term at a time is added to them, of the model's
    own (another value) or of the catalogue's (an effect), and the best is told with its share of
    what the parameters miss; longer laws pay the price of their coefficients.  Empty where none
    accounts for `WHOLE` of it.  And whether one of the model's values does, to what they leave.

    Parameters
    ----------
    fitted, alone : FitResult
        The fit, and the same model fitted to the other runs.
    residual : ndarray (d, n)
        Residual of the other runs under the fit.
    j : int
        Joint.
    """
    problem, sigma = alone.problem, alone.sigma
    bare = Projector(problem, [], sigma)
    bare.residual = (residual / sigma[:, None]).reshape(-1)
    bare.rss = float(bare.residual @ bare.residual)
    r, left = residual[j] / sigma[j], alone.residual[j] / sigma[j]
    missed = max(float(r @ r - left @ left), 1e-300)
    per = float(np.mean(left**2)) * inflation(left, problem.run)
    price = float(np.log(max(r.size / inflation(left, problem.run), 2.0)))
    tried = [_scaled(fitted, alone, residual, j, missed, per, price)]
    for term, known in _terms(fitted, alone, j):
        tried.append(_tried(term, known, bare, missed, per, price, j))
    best = max(tried, key=lambda x: x.score)
    if best.share < WHOLE:
        return "", False
    kept = missed * (1.0 - best.share) + float(left @ left)
    alike = best.single and kept <= NEAR_FLOOR**2 * float(left @ left)
    return f"{best.text} would explain {100 * min(best.share, 1.0):.0f} % of that", alike


def _terms(fitted: FitResult, alone: FitResult, j: int) -> list[tuple[Term, bool]]:
    """Terms on joint j: the model's own with their shapes (True), and candidates without any.

    What has a shape to be searched would imitate anything, but for a difference between runs; what
    every run has for itself says nothing of another one.
    """
    mine = [t for t in fitted.terms if t.effect.scope.whole or t.joint == j]
    own = [(t, True) for t in mine if not t.per_run]
    new = [
        replace(t, per_run=False, shape=shape)
        for t in terms_to_try(alone)[0]
        if (t.effect.variation.relative or not t.effect.shape)
        and (t.effect.scope.of_robot or t.joint == j)
        for shape in t.effect.search.grid(alone.problem.motions[0], j)
    ]
    return [*own, *((t, False) for t in new)]


def _tried(
    term: Term, known: bool, bare: Projector, missed: float, per: float, price: float, j: int
) -> _Try:
    columns = bare.weighted(term)
    rows = bare.residual[bare.rows(term)]
    beta = least_squares(columns, rows)
    n = bare.problem.n
    part = (columns @ beta)[j * n : (j + 1) * n] if term.effect.scope.whole else columns @ beta
    r = bare.residual[j * n : (j + 1) * n]
    gain = float(r @ r - (r - part) @ (r - part))
    score = gain / per - price * beta.size
    single = known and beta.size == 1
    return _Try(_words(term, known, beta, bare), gain / missed, score, single)


def _words(term: Term, known: bool, beta: FloatArray, bare: Projector) -> str:
    """E.g. ``torque-offset on joint2 (0.3 N m)``, ``another value of j2.coulomb.fc (by 0.1)``."""
    problem = bare.problem
    joints, named = problem.joints, coefficients(term, problem)
    unit = unit_of(named[0][1], problem, term)
    size = f"{beta[0]:+.3g} {unit}".removesuffix(" 1") if beta.size == 1 else ""
    if known:
        if beta.size == 1:
            return f"another {named[0][0]} ({size})"
        return f"other values of {term.effect.name}"
    where = "" if term.effect.scope.of_robot else f" on {joints[term.joint]}"
    return f"{term.effect.name}{where}{f' ({size})' if size else ''} in one of them"


def _scaled(
    fitted: FitResult,
    alone: FitResult,
    residual: FloatArray,
    j: int,
    missed: float,
    per: float,
    price: float,
) -> _Try:
    """All efforts of the joint scaled: another torque constant, gear or unit."""
    model = alone.problem.y[j] - residual[j]
    size = float(model @ model)
    if size == 0.0:
        return _Try("", 0.0, -np.inf)
    g = float(model @ residual[j]) / size
    gain = g * g * size / float(alone.sigma[j]) ** 2
    text = f"all efforts of the joint scaled by {1 + g:.3g} (a torque-gain, a gear, a unit)"
    return _Try(text, gain / missed, gain / per - price)


def prediction_distance(fitted: FitResult, alone: FitResult, j: int) -> float:
    """Difference of two fits' predictions on joint j in units of what their errors allow.

    With X the columns of the other runs, theta and V the coefficients of both fits and their
    covariances,  z^2 = |X (theta_1 - theta_2)|^2 / tr X (V_1 + V_2) X';  directions that the first
    fit does not determine are left out of both.
    """
    rows = slice(j * alone.problem.n, (j + 1) * alone.problem.n)
    x = alone.x[rows]
    if fitted.names != alone.names:
        return float("inf")
    b = fitted.basis
    known = (b.v @ b.v.T) * b.scale[None, :] / b.scale[:, None]
    x = x @ known
    moved = x @ (fitted.theta - alone.theta)
    allowed = sum(float(np.sum((x @ v) * x)) for v in map(_covariance, (fitted, alone)))
    return float(np.sqrt(moved @ moved / max(allowed, 1e-300)))


def within_errors(
    alone: FitResult | None, step: Step, floor: FloatArray, asked: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Joints (d,) of those asked for whose held-out error is the fit's motion, not its physics.

    The same model fitted to the held-out runs is down to their floor, and the standard errors of
    both fits allow the difference.

    Parameters
    ----------
    alone : FitResult or None
        The model fitted to the held-out runs; None without any.
    step : Step
        The fit.
    floor : ndarray (d,)
        Noise floor of the held-out runs [N m or N].
    asked : ndarray (d,)
        Whether a joint is asked for.
    """
    out = np.zeros_like(asked)
    if alone is not None:
        for j in np.flatnonzero(asked & (alone.rms <= NEAR_FLOOR * floor)).tolist():
            out[j] = prediction_distance(step.result, alone, j) < CERTAIN
    return out


def _covariance(f: FitResult) -> FloatArray:
    blocks = np.tile(time_blocks(f.problem), f.problem.d)
    return cluster_covariance((f.residual / f.sigma[:, None]).reshape(-1), f.basis, blocks)


DIFFER, _SAID = "sessions-differ", "the sessions differ"
#: Kind of a difference between states of the rig, and of no other.
RIG_STATE = "state"
BOTH = "Fit the held-out session, too, and hold out another one"
HELD_OUT_ADVICE = (
    f"{BOTH}, set values that change from day to day under [offsets] in the map file, or record "
    "again in one state of the rig"
)


# ------------------------------------------------------------ differences


@dataclass(frozen=True)
class _Pair:
    """The fit, the held-out runs under it, and the same model fitted to those alone."""

    fitted: FitResult
    heldout: HeldOut
    alone: FitResult

    @property
    def joints(self) -> tuple[str, ...]:
        return self.fitted.problem.joints

    @property
    def ours(self) -> str:
        return ", ".join(r.name for r in self.fitted.problem.recordings)

    @property
    def theirs(self) -> str:
        return ", ".join(r.name for r in self.alone.problem.recordings)


def held_out_differences(out: Diagnosis, examine: Examiner) -> list[Note]:
    """Warnings (code, sentence), the last with what to do; none without held-out sessions.

    Nothing is told of joints whose held-out error has no practical size.

    Parameters
    ----------
    out : Diagnosis
        With its verdict, and what its motion could not show.
    examine : Examiner
        Has fitted the last model to the held-out runs alone.
    """
    if examine.alone is None:
        return []
    step = out.ladder[-1]
    pair = _Pair(step.result, step.heldout, examine.alone)
    theirs = pair.alone.problem
    felt = step.heldout.rms > practical(theirs) * theirs.rms(theirs.effort)
    moves = np.flatnonzero(felt & ~pair.fitted.problem.holds & ~theirs.holds).tolist()
    found = _ours(out, pair, moves) + _theirs(out, pair, moves)
    told = {k for k, text in found if text}
    above = step.heldout.rms > ADEQUATE * out.noise
    over = np.maximum(pair.fitted.rms / above_zero(out.floor), pair.alone.rms / out.noise)
    mixed = {c.joint for c in out.last.changes if not c.at}
    found += [
        (j, _values(pair, j, float(over[j]), pair.joints[j] in mixed))
        for j in moves
        if above[j] and j not in told
    ]
    notes = [
        Note(DIFFER, text, pair.joints[j], text, RIG_STATE if _SAID in text else "")
        for j, text in sorted(found)
        if text
    ]
    # else that the fitted sessions differ says what to do first
    return notes if mixed else _advised(notes)


def _advised(notes: list[Note]) -> list[Note]:
    """The same, the last with what to do (and no other: each has its finding as `size`)."""
    what = HELD_OUT_ADVICE if any(n.kind == RIG_STATE for n in notes) else BOTH
    found = [n.saying(n.size) for n in notes]
    return [*found[:-1], *(n.saying(f"{n.size}. {what}") for n in found[-1:])]


def still_differ(out: Diagnosis) -> list[tuple[str, str]]:
    """Warnings of a diagnosis but for differences on joints that its last model serves.

    What a model without its corrections lacks moves its parameters from session to session.  Where
    the corrected one is down to the floor of the held-out runs its parameters are theirs, too.
    """
    joints, down = out.result.problem.joints, out.ladder[-1].heldout.rms <= ADEQUATE * out.noise
    served = [joints[j] for j in np.flatnonzero(down)]
    said = notes_of(out.warnings, DIFFER)
    kept = [n for n in said if n.joint not in served]
    if kept and kept[-1] != said[-1] and said[-1][1] != said[-1].size:
        kept = _advised(kept)
    first = next((k for k, (code, _) in enumerate(out.warnings) if code == DIFFER), 0)
    others = [w for w in out.warnings if w[0] != DIFFER]
    return [*others[:first], *kept, *others[first:]]


def _values(pair: _Pair, j: int, over: float, mixed: bool) -> str:
    """The sentence where parameters of the fit do not serve the held-out runs; else empty.

    Where the model is above the floor of a session by itself, `over` times, each session gives its
    parameters what else it lacks there: the rig is another one only if a single value says so.
    Fitted sessions that are `mixed`, of several states of the rig, say nothing of the held-out one.
    """
    rms, own = float(pair.heldout.rms[j]), float(pair.alone.rms[j])
    single = replace(pair.heldout, residual=pair.alone.residual)
    if rms <= NEAR_FLOOR * own or single.gain(pair.heldout, j) < SURE:
        return ""
    joint, times = pair.fitted.problem.joints[j], rms / max(own, 1e-300)
    text = (
        f"with the parameters fitted to {pair.ours} the error on {pair.theirs} is {times:.1f} "
        f"times the error of the same model fitted to {pair.theirs} alone"
    )
    if mixed:
        return f"{joint}: {text}. The fitted sessions themselves differ there"
    if prediction_distance(pair.fitted, pair.alone, j) < CERTAIN:
        return (
            f"{joint}: {text}. The motion of {pair.ours} does not determine the parameters that "
            f"matter in {pair.theirs}: the difference lies within their standard errors"
        )
    why, alike = explanation(pair.fitted, pair.alone, pair.heldout.residual, j)
    if over > NEAR_FLOOR and not alike:
        return (
            f"{joint}: {text}. The model is incomplete (the error of a fitted session is up to "
            f"{over:.1f} times its noise floor). Its parameters differ between sessions for that "
            "reason"
        )
    left = leaves(identified(pair.fitted.problem), pair.alone.problem, j)
    lead = f"{pair.theirs} leaves the range of {pair.ours}, or" if left else ""
    return f"{joint}: {' '.join([lead, _SAID]).strip()}: {text}{f'; {why}' if why else ''}"


def _theirs(out: Diagnosis, pair: _Pair, joints: list[int]) -> list[tuple[int, str]]:
    """Sentences for what only the held-out sessions hold."""
    quiet = np.minimum(out.floor, pair.fitted.rms)
    louder = [j for j in joints if HALF * pair.alone.rms[j] ** 2 > quiet[j] ** 2]
    if not louder:
        return []
    evidence, known = gather(pair.alone), _real(out.last, pair.fitted)
    texts = []
    for j in louder:
        above = evidence.floor.exceeded(pair.alone.rms, j)
        named = [c for c in _real(evidence, pair.alone) if c.joint == j and above]
        if named and (named[0].name, j) not in {(k.name, k.joint) for k in known}:
            floor = float(min(evidence.floor.rms[j], evidence.floor.scale[j]))
            told = (_names(named, evidence.projector), pair.theirs, pair.ours)
            blind = any(u.hides(named[0].name, pair.joints[j]) for u in out.unseen)
            blind |= bool(leaves(identified(pair.fitted.problem), pair.alone.problem, j))
            blind |= _glimpsed(out.last, named[0])
            texts.append((j, _only(named[0], floor, told, pair.alone, blind)))
    return texts


def _glimpsed(evidence: Evidence, c: Candidate) -> bool:
    """Whether a fit saw an effect beyond chance, too, though too little of it to name."""
    return any(
        (k.name, k.joint) == (c.name, c.joint) and k.detected and k.score > 0
        for k in evidence.candidates
    )


def _ours(out: Diagnosis, pair: _Pair, joints: list[int]) -> list[tuple[int, str]]:
    """Sentences for what only the fitted sessions hold, where no name stands."""
    if out.verdict not in ("unexplained", "ambiguous"):
        return []
    texts, candidates = [], _real(out.last, pair.fitted)
    beside = Projector(pair.alone.problem, pair.alone.terms, pair.alone.sigma)
    for j in (j for j in joints if out.last.floor.exceeded(pair.fitted.rms, j)):
        named = [c for c in candidates if c.joint == j and not c.term.per_run]
        if not named or _power(named[0], beside) > OPEN * _here(named[0], pair.fitted):
            continue
        floor = float(min(out.last.floor.rms[j], out.last.floor.scale[j]))
        told = (_names(named, out.last.projector), pair.ours, pair.theirs)
        texts.append((j, _only(named[0], floor, told, pair.fitted)))
    return texts


def _real(evidence: Evidence, result: FitResult) -> list[Candidate]:
    """Candidates that could be named beside a fit."""
    return [c for c in plausible(evidence, result) if in_time(c, result)]


def _names(named: list[Candidate], projector: Projector | None) -> str:
    """Best candidate and those that the data hardly tell from it."""
    if projector is None:
        return named[0].name
    best, _, rivals = choose(named, projector)
    return " or ".join(dict.fromkeys([best.name, *(c.name for c, _ in rivals)]))


def _here(c: Candidate, result: FitResult) -> float:
    """Power of the residual that a candidate explains on its joint where it was found."""
    j = c.joint
    return float(c.parts[j] * result.sigma[j] ** 2 / max(result.problem.count[j], 1.0))


def _power(c: Candidate, beside: Projector) -> float:
    """The same in other sessions, with the same shape."""
    problem, j = beside.problem, c.joint
    return float(beside.gain(c.term) * beside.sigma[j] ** 2 / max(problem.count[j], 1.0))


def _only(
    c: Candidate, floor: float, told: tuple[str, str, str], where: FitResult, blind: bool = False
) -> str:
    """Sentence for an effect that the first of two sessions holds alone; empty if it is little.

    Of the other one's motion it is known whether it was blind to the effect.
    """
    name, here, there = told
    excess = max(float(where.rms[c.joint]) ** 2 - floor**2, 1e-300)
    share = min(_here(c, where) / excess, 1.0)
    if share < WHOLE:
        return ""
    joint = where.problem.joints[c.joint]
    text = f"{name} would explain {100 * share:.0f} % of the error above the noise in {here}"
    if blind:
        return f"{joint}: {text}; the motion of {there} can hardly show it"
    return f"{joint}: {_SAID}: {text}, and {there} does not show it"
