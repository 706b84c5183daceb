"""Errors on data that the parameters have not seen, and how sharp a sign they ask for.

The sharpness of Coulomb friction's sign is what fitted runs hardly say and others do.  A fit takes
the sharpest sign that explains its runs about as well as the best one, for a blunt sign imitates
what happens at low speed.  Runs that reverse quickly hardly tell them apart; a run that lingers
about zero speed does, and its error is then neither noise nor a missing effect.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.candidates import held_out
from hil.diagnosis.constants import WORTH
from hil.diagnosis.evidence import floor_of
from hil.diagnosis.folds import Split, split
from hil.diagnosis.types import Evidence, HeldOut, Step
from hil.errors import DataError, plural
from hil.identify.context import set_context
from hil.identify.design import Term
from hil.identify.fit import assemble, fit, predict, time_blocks
from hil.identify.predict import outside, own_values
from hil.identify.problem import AUTOMATIC, Problem
from hil.identify.result import FitResult
from hil.identify.screening import CLOSE
from hil.identify.timing import fit_aligned
from hil.models.effect import Trait
from hil.record.checks import check
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
            asked = (holdout, problem.source, problem.explains, AUTOMATIC, problem.rates)
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
        return of_blocks(held_out(result, folds), self._problem, folds)

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
        raise DataError(
            f"held-out session {run.name!r} has faults, nothing can be judged on it: "
            f"{'; '.join(errors[:3])}. See 'hil info', then mend or leave it out."
        )


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
    j = term.joint
    rows: list[tuple[float, float]] = []
    for v0 in _blunter(term, result):
        other = _with(result, term, v0)
        if other.rms[j] ** 2 > CLOSE * result.rms[j] ** 2:
            break
        rows.append((v0, float(examine(other).rms[j])))
    least = min((error for _, error in rows), default=np.inf)
    if least > (1 - WORTH) * heldout.rms[j]:
        return 0.0
    return next(v0 for v0, error in rows if error**2 <= CLOSE * least**2)


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
