"""The verbs of the Python API: fit, compare, diagnose, add, ladder, on recordings and models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil import work
from hil.diagnosis.columns import mistaken
from hil.diagnosis.constants import BEYOND, TENTH
from hil.diagnosis.engine import diagnose
from hil.diagnosis.evidence import gather
from hil.diagnosis.heldout import Examiner, held_out_differences, settled
from hil.diagnosis.preconditions import contradicted, other_robot, without_effort
from hil.diagnosis.residual_tests import unlike_noise, unlike_notes
from hil.diagnosis.residuals import Region, seeming, that_matter
from hil.diagnosis.types import Diagnosis, Evidence, HeldOut, Step, above_zero
from hil.diagnosis.verdict import NO_GEOMETRY, noticed
from hil.errors import ConfigError, DataError, listed_names
from hil.identify.context import renew
from hil.identify.fit import outside
from hil.identify.gauss_newton import complete
from hil.identify.multistep import MultiStep, both, each
from hil.identify.problem import Problem, of_model
from hil.identify.result import FitResult
from hil.identify.timing import fit_aligned, fit_as_stated
from hil.models import catalogue
from hil.models.model import Range, RobotModel, Use, as_model, of_runs
from hil.models.robots import undescribed
from hil.record.arrays import Runs, as_runs, held_out
from hil.record.checks import check
from hil.record.consistency import DataFault, Note
from hil.record.recording import Recording
from hil.shown import Plotted, Shown
from hil.work import single_threaded

FloatArray = NDArray[np.float64]
__all__ = ["add", "compare", "diagnose", "fit", "ladder"]


# ------------------------------------------------------------ verbs


@dataclass(frozen=True, repr=False, eq=False)
class Comparison(Plotted):
    """A model against measurements.

    Parameters
    ----------
    result : FitResult
        The fit.
    heldout : HeldOut
        Errors on held-out data.
    evidence : Evidence
        Noise floor and candidates.
    where : dict
        Regions in which the model fails by more than the practical size, by joint.
    multi_step : MultiStep
        Short-horizon simulation error.
    faults : list
        What `hil info` says of the data.
    heldout_floor : ndarray (d,) or None
        Noise floor of the held-out runs themselves.
    """

    result: FitResult
    heldout: HeldOut
    evidence: Evidence
    where: dict[str, list[Region]]
    multi_step: MultiStep
    faults: list[DataFault] = field(default_factory=list)
    heldout_floor: FloatArray | None = None
    #: What the given model had been identified on.
    valid: tuple[Range, ...] = ()
    #: The held-out runs as they were judged on.
    judged: Problem | None = None

    def __repr__(self) -> str:
        each = zip(self.result.problem.joints, self.heldout.rms / self.noise, strict=True)
        return f"Comparison(error over noise floor: {', '.join(f'{k} {x:.2f}' for k, x in each)})"

    @property
    def noise(self) -> FloatArray:
        """Noise floor that belongs to the held-out errors (d,), as `Diagnosis.noise`."""
        if self.heldout_floor is not None:
            noise = np.minimum(self.heldout_floor, self.heldout.rms)
        else:
            noise = np.minimum(self.evidence.floor.rms, self.result.rms)
        return above_zero(noise)


def faults_of(recordings: list[Recording]) -> list[DataFault]:
    """Data faults of all runs; the analysis must not go on where one is an error."""
    return [f for r in recordings for f in check(r)]


def make_problem(
    recordings: list[Recording], model: RobotModel, before: Problem | None = None
) -> Problem:
    """Problem of some runs for a model; `before` as `hil.identify.problem.of_model` has it.

    Raises
    ------
    DataError
        If a run has a fault that makes every result worthless (see `hil info`).
    """
    errors = [f for f in faults_of(recordings) if f.severity == "error"]
    errors = errors or without_effort(recordings)
    if errors:
        what = "the recording has faults that make any fit worthless: "
        what += "; ".join(f.text for f in errors[:3])
        raise DataError(
            f"{what}. Run 'hil info' on it, mend or cut the recording, then try again."
        ).about("faults", what)
    return of_model(recordings, model, before)


@single_threaded
def fit(recordings: Runs, model: RobotModel) -> FitResult:
    """Fit all parameters of a model jointly to one run or several.

    Raises
    ------
    ConfigError
        If an argument is of another kind.
    DataError
        If a run has a fault that makes every result worthless.
    """
    recordings, model = as_runs(recordings, "hil.fit"), as_model(model, "hil.fit")
    work.at("fit", 0.0)
    result = complete(fit_as_stated(make_problem(recordings, model), model))
    beyond = [("outside-range", text) for text in outside(model.valid, result.problem)]
    notes = _undescribed(result.problem) + other_robot(model, recordings) + contradicted(result)
    return replace(result, warnings=notes + beyond)


def _undescribed(problem: Problem) -> list[tuple[str, str]]:
    """Warning where several joints have no geometry."""
    text = undescribed(problem.source, problem.d)
    return [(NO_GEOMETRY, text)] if text else []


def _unsimulated(d: int) -> MultiStep:
    """What stands where no model was simulated."""
    unknown = np.full(d, np.nan)
    return MultiStep(0.0, unknown, unknown, 0, 0)


@single_threaded
def compare(
    recordings: Runs,
    model: RobotModel,
    holdout: Runs | None = None,
    *,
    as_is: bool = False,
    like: str = "",
    simulate: bool = True,
    fitted: Callable[[FitResult, HeldOut], None] = lambda result, held: None,
    before: Comparison | None = None,
) -> Comparison:
    """Model against measurement: error, noise floor, where it fails, one-step and simulated.

    Parameters
    ----------
    recordings, model, holdout
        Runs to fit, model, runs to judge on.
    as_is : bool
        Whether the model keeps its values, in place of a fit of all of them.
    like : str
        Fitted run whose own values (a payload, an offset) runs that were not fitted get then;
        default their median.
    simulate : bool
        Whether the model is simulated over short horizons.
    fitted : callable
        Gets the fit and its errors on held-out data as soon as they are known; the noise floor and
        the effects that may be missing take several times longer.
    before : Comparison, optional
        Of another model with the same runs: what was made of their motion is used again.  Effects
        must be the same ones as then.

    Raises
    ------
    DataError
        If a run has a fault that makes every result worthless, or a held-out run has one, is of
        another robot, or is one of the fitted ones.
    ConfigError
        If an argument is of another kind.
    """
    recordings, model = as_runs(recordings, "hil.compare"), as_model(model, "hil.compare")
    if like and not as_is:
        raise ConfigError("like is of as_is: without it each run is given values of its own")
    given, names = model, [r.name for r in recordings]
    model = given.as_it_is(names, like) if as_is else given
    work.at("fit", 0.0)
    rows, judged = (before.result.problem, before.judged) if before else (None, None)
    problem = make_problem(recordings, model, rows)
    examine = Examiner(problem, held_out(holdout, "hil.compare"), judged)
    step = settled(fit_aligned(problem, model), examine, "model")
    result, heldout = complete(step.result), step.heldout
    of_others = _of_other_runs(given, names, like, result) if as_is else []
    fitted(result, heldout)
    work.at("measure the noise floor", 0.15)
    evidence = gather(result)
    where = that_matter(result, evidence.floor)
    beyond = outside(model.valid, problem) + examine.outside(result)
    faults = [
        *faults_of(recordings),
        *(DataFault("outside-range", "warning", "", x) for x in beyond),
    ]
    if simulate:
        work.at("simulate the model", 0.4)
    floor = examine.floor(result, evidence)
    alike = Diagnosis("compared", [], [Step("model", result, heldout)], evidence, evidence)
    alike.floor = evidence.floor.rms
    level = evidence.floor.rms if floor is None else floor
    notes = _undescribed(problem) + other_robot(model, recordings) + of_others
    # a wrong column looks like wrong masses, too; it is asked of the first model of the runs alone
    asked = before is None and not all(t.fixed for t in result.terms)
    columns = mistaken(result, recordings) if asked else []
    above = heldout.rms / above_zero(np.minimum(level, heldout.rms))
    notes += columns or contradicted(result, above)
    notes += held_out_differences(alike, examine)
    notes += noticed(evidence, result)
    notes += examine.own(result)
    notes += unlike_notes(unlike_noise(result, heldout.rms, level, evidence.projector))
    faults += [_as_fault(n) for n in notes]
    steps = both(result, problem) if simulate else _unsimulated(problem.d)
    out = Comparison(
        result, heldout, evidence, where, steps, faults, floor, model.valid, examine.other
    )
    ratio = dict(zip(problem.joints, (heldout.rms / out.noise).tolist(), strict=True))
    out.faults.extend(_as_fault(n) for n in seeming(ratio, where))
    return out


def _as_fault(note: tuple[str, str]) -> DataFault:
    """A note among the faults of a comparison."""
    return DataFault(note[0], "warning", "", note[1], note if isinstance(note, Note) else None)


def _of_other_runs(
    model: RobotModel, names: Sequence[str], like: str, result: FitResult
) -> list[tuple[str, str]]:
    """Notes (code, sentence) of effects with values of single runs, of which these are none.

    `result` is what the model leaves of these runs as it is.
    """
    out, everyone = [], set[str]()
    for use in model.effects:
        fitted = {run for known in of_runs(use).values() for run in known}
        if fitted and (new := [n for n in names if n not in fitted]):
            everyone |= fitted
            taken = f"those of {like} are" if like in fitted else "their median is"
            out.append(
                f"{use.type} has values of {', '.join(sorted(fitted))} alone; for "
                f"{', '.join(new)} {taken} taken"
            )
    if not out:
        return []
    nearest = _nearest(model, names, sorted(everyone - {like}), result)
    return [("other-runs", f"{said}{nearest}") for said in out]


def _nearest(
    model: RobotModel, names: Sequence[str], fitted: Sequence[str], result: FitResult
) -> str:
    """What the values of another fitted run would leave, where that is clearly less."""
    j = int(np.argmax(result.relative))
    left = {
        run: float(fit_as_stated(result.problem, model.as_it_is(names, run)).relative[j])
        for run in fitted
    }
    renew(result)
    best = min(left, key=lambda run: left[run], default="")
    if not best or left[best] > (1 - TENTH) * result.relative[j]:
        return ". Without --as-is each run is given its own"
    return (
        f". With those of {best} the error of {result.problem.joints[j]} would be "
        f"{left[best]:.3g} instead of {result.relative[j]:.3g} % (--like {best})"
    )


@dataclass(frozen=True, repr=False)
class Rung:
    """One model of an error ladder with both of its errors.

    Printed, it is its label and those errors, by joint.
    """

    step: Step
    multi_step: MultiStep

    def __repr__(self) -> str:
        errors = (self.step.heldout.relative, self.multi_step.relative)
        one, several = (", ".join(f"{x:.2f}" for x in e) for e in errors)
        return f"Rung({self.step.label}: held-out error {one} %, simulated error {several} %)"


class _BeforeAndAfter(NamedTuple):
    """Two rungs of a ladder."""

    before: Rung
    after: Rung


class Added(Shown, _BeforeAndAfter):
    """The models before and after an effect was added: a pair; printed, a table of their errors."""

    __slots__ = ()

    def __repr__(self) -> str:
        was, now = (", ".join(f"{x:.2f}" for x in rung.step.heldout.relative) for rung in self)
        return f"Added({self.after.step.label}: held-out error {was} -> {now} %)"


@single_threaded
def ladder(diagnosis: Diagnosis) -> list[Rung]:
    """Every accepted step with its simulated error (motor efforts only).

    Raises
    ------
    ConfigError
        If the argument is no diagnosis.
    """
    if not isinstance(diagnosis, Diagnosis):
        raise ConfigError(
            f"hil.ladder takes a diagnosis, not {type(diagnosis).__name__}; "
            "hil.diagnose(run, model) makes one"
        )
    steps = diagnosis.ladder
    if diagnosis.multi_steps is None:
        work.at("simulate the models", 0.7)
        results = [s.result for s in steps]
        diagnosis.multi_steps = each(results, results[0].problem) if results else []
    return [Rung(s, m) for s, m in zip(steps, diagnosis.multi_steps, strict=True)]


@single_threaded
def add(
    recordings: Runs,
    model: RobotModel,
    effect: str,
    joints: str | tuple[str, ...] = ("*",),
    holdout: Runs | None = None,
) -> Added:
    """Add one effect, refit everything, and return the model before and after.

    Returns
    -------
    Added
        A pair of rungs, ``before, after = hil.add(...)``; printed, a table.

    Raises
    ------
    ConfigError
        If the effect or a joint is unknown, already there, or impossible with these data.
    """
    if not isinstance(effect, str):
        raise ConfigError(
            f"hil.add takes (recordings, model, effect); effect is {type(effect).__name__}, "
            "expected its name, e.g. hil.add([run], model, 'stribeck')"
        )
    kind = catalogue.get(effect)
    recordings, model = as_runs(recordings, "hil.add"), as_model(model, "hil.add")
    joints = listed_names(joints, "joints")
    problem = make_problem(recordings, model)
    examine = Examiner(problem, held_out(holdout, "hil.add"))
    before = settled(fit_aligned(problem, model), examine, "before")
    where = "" if joints == ("*",) else f" on {', '.join(joints)}"
    joints = _usable(effect, joints, problem)
    own: dict[str, object] = (
        {"per_run": True} if kind.variation.per_run and len(recordings) > 1 else {}
    )
    larger = before.result.model + Use(effect, joints, own)
    first = both(before.result, problem)
    # what the effect does may have looked like lateness, or have hidden it: it is sought anew
    problem = make_problem(recordings, larger, problem)
    examine = Examiner(problem, held_out(holdout, "hil.add"), examine.other)
    after = complete(fit_aligned(problem, larger))
    after = replace(after, warnings=[*after.warnings, *examine.own(after)])
    step = Step(f"+ {effect}{where}", after, examine(after))
    return Added(Rung(before, first), Rung(step, both(after, problem)))


def _usable(effect: str, joints: tuple[str, ...], problem: Problem) -> tuple[str, ...]:
    """Joints among those asked for on which an effect can be fitted to these data."""
    kind, every = catalogue.get(effect), problem.joints
    asked = every if joints == ("*",) and not kind.scope.whole else joints
    reasons = {
        name: kind.scope.lacks(problem.motions[0], every.index(name) if name in every else 0)
        for name in asked
    }
    good = tuple(name for name, why in reasons.items() if not why)
    if not good or (len(good) < len(asked) and joints != ("*",)):
        why = next(why for why in reasons.values() if why)
        raise ConfigError(f"effect {effect!r} cannot be fitted to these data: {why}")
    return joints if len(good) == len(asked) else good


# ------------------------------------------------------------ both errors


def rising(rungs: list[Rung], factor: float = 1.01) -> list[str]:
    """Sentences where a step lowers the effort error but the simulated motion gets worse.

    A rise counts from one percent on, and beyond its standard error over the same windows, where
    no later step takes it back.

    Parameters
    ----------
    rungs : list of Rung
        The ladder.
    factor : float
        Rise of the simulated error that counts.
    """
    out = []
    for before, after in pairwise(rungs):
        if after.step.result.model.explains != "motor":  # a law of contact has no motion
            continue
        for j in range(after.step.result.problem.d):
            steps = (after.multi_step, rungs[-1].multi_step)
            if all(m.rises(before.multi_step, j, factor) for m in steps):
                out.append(_sentence(before, after, j))
    return out


def useless(before: Rung, after: Rung, joints: list[int]) -> list[str]:
    """Sentences for an effect that lowers no held-out error beyond its standard error.

    Parameters
    ----------
    before, after : Rung
        The model without and with it.
    joints : list of int
        Joints that it acts on.
    """
    old, new = before.step.heldout, after.step.heldout
    if any(new.rms[j] < old.rms[j] and new.gain(old, j) > BEYOND for j in joints):
        return []
    names, se = after.step.result.problem.joints, new.standard_error()
    return [
        f"held-out error of {names[j]} {old.relative[j]:.2f} -> {new.relative[j]:.2f} % "
        f"(standard error {se[j]:.2f}): no significant benefit"
        for j in joints
    ]


def _sentence(before: Rung, after: Rung, j: int) -> str:
    old, new = float(before.multi_step.rms[j]), float(after.multi_step.rms[j])
    problem = after.step.result.problem
    joint, unit = problem.joints[j], problem.robot.units[j]
    errors = [float(r.step.heldout.relative[j]) for r in (before, after)]
    over = f"simulated position error over {after.multi_step.horizon:g} s"
    rise = f"{over} rises from {old:.3g} to {new:.3g} {unit} ({100 * (new / old - 1):+.1f} %)"
    if after.multi_step.lost:
        rise = f"{over} is unknown: most simulations leave the recorded range"
    if errors[1] < 0.99 * errors[0]:
        return (
            f"{after.step.label}: the one-step error of {joint} falls, but its {rise}: the effect "
            "improves the effort prediction, not the simulation"
        )
    if errors[1] > 1.01 * errors[0]:
        return f"{after.step.label}: the one-step error of {joint} rises, and its {rise}"
    return f"{after.step.label}: the one-step error of {joint} stays, but its {rise}"
