"""Targets of an export: their table, what each declares, how a model becomes a file of theirs.

A model is refitted within what its target can express, with the error that this costs.  Without a
recording the values are only translated: what is lost takes its share of the effort with it.  With
one, all that is left is fitted anew, so that it carries what it can of the lost effects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil import registry
from hil.diagnosis.constants import MATTERS
from hil.diagnosis.heldout import Examiner, settled
from hil.diagnosis.types import Step
from hil.diagnosis.verbs import make_problem
from hil.errors import ConfigError, printable
from hil.export import trees
from hil.export.content import (
    SENSOR,
    STAND_INS,
    Content,
    Lost,
    Vocabulary,
    passive,
    slid,
    stand_ins,
    translate,
)
from hil.identify.fit import fit
from hil.identify.gauss_newton import complete
from hil.identify.result import FitResult
from hil.identify.timing import fit_aligned
from hil.models import catalogue
from hil.models.bodies import NearestBodies, infeasible, nearest_feasible
from hil.models.effect import Trait
from hil.models.model import ALL, RobotModel, Use, Value
from hil.models.robots import IndependentAxes, Robot, bare_robot
from hil.record.recording import Recording
from hil.work import single_threaded

FloatArray = NDArray[np.float64]


#: States at which bodies are compared where no recording says which ones matter.
STATES = 500


@dataclass(frozen=True)
class Within:
    """A model within a target's words.

    Parameters
    ----------
    content : Content
        What the target gets; its `lost` are all effects that are lost.
    model : RobotModel
        The model of that content.
    steps : tuple of Step
        The whole model and the one that is left, with their held-out errors; empty without a
        recording.
    notes : tuple of str
        What the user should know.
    """

    content: Content
    model: RobotModel
    steps: tuple[Step, ...] = ()
    notes: tuple[str, ...] = ()


@single_threaded
def within(
    model: RobotModel,
    words: Vocabulary,
    runs: list[Recording],
    holdout: list[Recording],
    mended: bool = False,
) -> Within:
    """Fit a model to what a target can express.

    Parameters
    ----------
    model : RobotModel
        The model.
    words : Vocabulary
        Of the target.
    runs, holdout : list of Recording
        Recordings to fit and to judge on; with no runs the values are translated only.
    mended : bool
        Whether infeasible bodies are replaced by the nearest feasible ones, instead of refused.

    Raises
    ------
    ConfigError
        If the target cannot express the robot, or its bodies are infeasible and not `mended`.
    """
    if runs:
        return _refitted(model, words, runs, holdout, mended)
    stood, base = model, _base(model)
    if base is not None:
        model = _on(base, model)
    robot = _bare(model)
    content, friction = slid(translate(model, robot, words), model, robot, words)
    note = "translated only, not refitted: give a recording with --data to see what the loss costs"
    notes = (*friction, note) if content.lost else tuple(friction)
    if base is not None:
        notes = (*notes, _leans(base) + f"; {_second_order(stood)}")
    if content.bodies is None or not words.bodies:
        return Within(content, model, notes=notes)
    rows = _anywhere(model, robot, content)
    found = _feasible(content, rows, mended)
    if found is None:
        return Within(content, model, notes=notes)
    return Within(replace(content, bodies=found.bodies), model, (), (*notes, _said(found, content)))


#: The effect that is no part of a program's words, for it is how the robot stands.
_TILT = "base-tilt"


def _base(model: RobotModel) -> FloatArray | None:
    """Orientation (3, 3) of the base that a model found; None where it stands as described."""
    use = next((u for u in model.effects if u.type == _TILT), None)
    named = [f"{_TILT}.{p.name}" for p in catalogue.get(_TILT).params]
    if use is None or not model.robot.urdf or not all(n in use.values for n in named):
        return None
    return trees.rotation(np.array([*(use.values[n].value for n in named), 0.0]))


def _on(base: FloatArray, model: RobotModel) -> RobotModel:
    """The model of the robot whose description says how the base stands."""
    robot = replace(model.robot, urdf=trees.turned(model.robot.urdf, base))
    kept = tuple(u for u in model.effects if u.type != _TILT)
    return replace(model, robot=robot, effects=kept)


def _seen(base: FloatArray, run: Recording) -> Recording:
    """A run whose measured forces are in the axes of the ground, as the base is now known."""
    robot, wrench = run.robot, run.wrench
    if robot.urdf:
        robot = replace(robot, urdf=trees.turned(robot.urdf, base))
    if wrench is not None:
        wrench = np.concatenate([wrench[:, :3] @ base.T, wrench[:, 3:] @ base.T], axis=1)
    return replace(run, robot=robot, wrench=wrench)


def _leans(base: FloatArray) -> str:
    roll, pitch, yaw = trees.angles(base)
    return (
        f"the base leans as {_TILT} says: it is turned by roll {roll:.4g}, pitch {pitch:.4g}, yaw "
        f"{yaw:.2g} rad against the ground, which is the base of what is written"
    )


def _second_order(model: RobotModel) -> str:
    """What a rotation differs by from the effect, whose gravity is longer."""
    use = next(u for u in model.effects if u.type == _TILT)
    size = float(np.linalg.norm([v.value for v in use.values.values()]))
    return f"gravity is {100 * (math.hypot(1.0, size) - 1.0):.2g} % less than the model's"


def _bare(model: RobotModel) -> Robot:
    """Robot of a model without a recording; axes whose inertia is a mass slide."""
    names, source = _names(model), model.robot
    units = [v.unit for name, v in model.values().items() if name.startswith("rigid-body.m")]
    if source.urdf or source.preset not in ("", "single-axis") or len(units) != len(names):
        return bare_robot(source, names)
    return IndependentAxes(names, " ".join("m" if unit == "kg" else "rad" for unit in units))


def _names(model: RobotModel) -> tuple[str, ...]:
    """Joints of a preset, as the model's identified range has them."""
    names = tuple(r.joint for r in model.valid)
    if not names and not model.robot.urdf:
        raise ConfigError(
            "the model names no joints: it has no [valid.JOINT] tables and no URDF; give the "
            "recording with --data, or fit it: 'hil fit SESSION.mcap --model M.toml -o FITTED.toml'"
        )
    return names


def _refitted(
    model: RobotModel,
    words: Vocabulary,
    runs: list[Recording],
    holdout: list[Recording],
    mended: bool,
) -> Within:
    problem = make_problem(runs, model)
    examine = Examiner(problem, holdout)
    before = settled(fit_aligned(problem, model), examine, "whole model")
    left, lost = reduced(model, words, problem.robot.joints)
    after = before
    base = _base(before.result.model)
    if base is not None:
        left, lost = reduced(_on(base, model), words, problem.robot.joints)
        least, problem = problem.least, make_problem([_seen(base, r) for r in runs], left)
        problem.least.update(least)
        examine = Examiner(problem, [_seen(base, r) for r in holdout])
    refit = _Refit(words, before.result, lost)
    problem.positive = passive(before.result.model, problem.joints)
    if base is not None or left != model:
        first = fit_aligned if base is not None else fit
        result = refit(first(problem, left, scale=before.result.sigma))
        after = Step("within the target", result, examine(result))
    content = translate(after.result.model, problem.robot, words, problem.span)
    content = replace(content, lost=(*lost, *content.lost))
    steps: tuple[Step, ...] = (before,) if after is before else (before, after)
    notes = [text for _, text in after.result.warnings]
    notes += _stood_in(model, left, lost) + _anew(model, before.result)
    notes += _moved(before.result, after.result)
    if base is not None:
        notes.append(_leans(base))
    asked = content.bodies is not None and words.bodies
    found = _feasible(content, _measured(after.result), mended) if asked else None
    if found is None:
        return Within(content, after.result.model, steps, (*notes, *_worthless(steps), *refit.held))
    notes.append(_said(found, content))
    if not holdout:
        notes.append("the bodies were found on all the data, the held-out blocks included")
    # the errors that are shown are those of the very bodies that are written
    result = refit(fit(problem, _holding(after.result, found.bodies), scale=after.result.sigma))
    steps = (*steps, Step("feasible bodies", result, examine(result)))
    content = translate(result.model, problem.robot, words, problem.span)
    content = replace(content, bodies=found.bodies, lost=(*lost, *content.lost))
    return Within(content, result.model, steps, (*notes, *_worthless(steps), *refit.held))


def _worthless(steps: Sequence[Step]) -> list[str]:
    """A note on joints whose effort no model at all would foretell better than what is written."""
    first, last = steps[0], steps[-1]
    joints = last.result.problem.joints
    bad = [
        f"{joint} {was:.3g} -> {now:.3g} %"
        for joint, was, now in zip(
            joints, first.heldout.relative, last.heldout.relative, strict=True
        )
        if now > max(100.0, was)
    ]
    if not bad:
        return []
    return [
        f"warning: what is written is worse than no model at all ({', '.join(bad)} of the effort "
        "on left-out data). Export to c, cpp or python, which have a word for every law, or add "
        "what is lost in your program and export without --data"
    ]


@dataclass
class _Refit:
    """Fits within a target's words.

    Parameters
    ----------
    words : Vocabulary
        Of the target.
    before : FitResult
        Of the whole model.
    lost : list of Lost
        What is lost; what a fit loses comes to it.
    """

    words: Vocabulary
    before: FitResult
    lost: list[Lost]
    zero: set[str] = field(default_factory=set)

    def __call__(self, result: FitResult) -> FitResult:
        """The fit, again without what the target cannot say now that other values came to zero."""
        result = complete(result)
        while True:
            known = self.before.values
            self.zero |= {
                n
                for n in known.keys() & result.values.keys() & result.problem.positive
                if result.values[n].at_bound and not known[n].at_bound
            }
            problem, model = result.problem, result.model
            gone = translate(model, problem.robot, self.words, problem.span).lost
            left, more = reduced(_without(model, gone, problem.joints), self.words, problem.joints)
            if left == model:
                return result
            self.lost += [*gone, *more]
            result = complete(fit(problem, left, scale=result.sigma))

    @property
    def held(self) -> list[str]:
        """A note on values that would have become negative; empty where none would."""
        if not self.zero:
            return []
        names = ", ".join(sorted(self.zero))
        return [
            f"values that would become negative to take up what is lost, and are held at 0: {names}"
            "; the errors are those with them"
        ]


def _without(model: RobotModel, gone: Sequence[Lost], joints: tuple[str, ...]) -> RobotModel:
    """A model without what was lost on some joints."""
    out = []
    for use in model.effects:
        lost = [x.joints for x in gone if x.effect == use.type]
        every = [j for j in joints if use.joints == ALL or j in use.joints]
        left = tuple(j for j in every if not any(x == ALL or j in x for x in lost))
        if left:
            out.append(replace(use, joints=left) if len(left) < len(every) else use)
    return replace(model, effects=tuple(out))


#: Change of a value that is told: beyond so many standard errors, and by this share of it; and
#: how many are told.
_BEYOND, _SHARE, _MOST_TOLD = 3.0, 0.1, 5


def _moved(before: FitResult, after: FitResult) -> list[str]:
    """A note on values that took up what the target lacks; empty where none did."""
    if not (told := _changes(before.values, after.values)):
        return []
    return [
        f"values that take up what is lost: {told}; without --data they stay, for a program in "
        "which you add the lost effect yourself"
    ]


def _anew(model: RobotModel, result: FitResult) -> list[str]:
    """A note on values of the model file that a fit to the data moved; empty where none did."""
    if not (told := _changes(model.values(), result.values)):
        return []
    return [f"values were fitted anew to --data: {told}; without --data they stay"]


def _changes(before: Mapping[str, Value], after: Mapping[str, Value]) -> str:
    """Values that clearly differ, the largest change first; a few of them."""
    found = []
    for name in before.keys() & after.keys():
        old, new = before[name], after[name]
        change, sure = abs(new.value - old.value), old.stderr if old.stderr == old.stderr else 0.0
        if old.identifiable and change > max(_BEYOND * sure, _SHARE * abs(old.value)):
            unit = "" if old.unit == "1" else f" {old.unit}"
            text = f"{name} {old.value:.4g} -> {new.value:.4g}{unit}"
            found.append((-change / max(abs(old.value), 1e-300), text))
    told = [text for _, text in sorted(found)]
    more = f", and {len(told) - _MOST_TOLD} more" if len(told) > _MOST_TOLD else ""
    return ", ".join(told[:_MOST_TOLD]) + more


def reduced(
    model: RobotModel, words: Vocabulary, joints: tuple[str, ...]
) -> tuple[RobotModel, list[Lost]]:
    """A model without what a target cannot say, and that; `joints` are all of the robot.

    Coefficients that every run has of its own become one for all.  What the sensors do stays: it is
    no part of the robot, and no target gets it.  Simple friction stands for laws of it that are
    lost (`stand_ins`).

    Raises
    ------
    ConfigError
        If nothing is left.
    """
    kept, lost = [], []
    for use in model.effects:
        if catalogue.get(use.type).family == SENSOR:  # without it the robot would take what it does
            kept.append(use)
            continue
        if reason := words.lacks(catalogue.get(use.type)):
            lost.append(Lost(use.type, use.joints, reason))
            continue
        every = [j for j in joints if use.joints == ALL or j in use.joints]
        said = {j: words.alone(use, model, j) for j in every}
        if gone := tuple(j for j in every if said[j]):
            lost.append(Lost(use.type, gone, said[gone[0]]))
            if len(gone) == len(every):
                continue
            use = replace(use, joints=tuple(j for j in every if not said[j]))
        if use.options.get("per_run") and _shared(use, model):
            continue  # what all runs have in common says it once
        options = {k: v for k, v in use.options.items() if k != "per_run"}
        once = {k: v for k, v in use.values.items() if "[" not in k}
        kept.append(replace(use, options=options, values=once))
    if all(catalogue.get(use.type).family == SENSOR for use in kept):
        raise ConfigError(
            f"the target can say none of the model's effects: {', '.join(model.names())}"
        )
    kept += stand_ins(kept, lost, words, joints)
    return replace(model, effects=tuple(kept)), lost


def _stood_in(model: RobotModel, left: RobotModel, lost: list[Lost]) -> list[str]:
    """A note on friction that stands for laws that are lost; empty where none does."""
    new = [
        u
        for u in left.effects
        if u.type in STAND_INS
        and not any(
            o.type == u.type and (o.joints == ALL or set(u.joints) <= set(o.joints))
            for o in model.effects
        )
    ]
    if not new:
        return []
    names = {x.effect for x in lost if catalogue.get(x.effect).family == "friction"}
    what = " and ".join(f"{u.type} on {', '.join(u.joints)}" for u in new)
    return [f"{what} {'stands' if len(new) == 1 else 'stand'} for {', '.join(sorted(names))}"]


def _shared(use: Use, model: RobotModel) -> bool:
    """Whether the model has one value for all runs beside those of every run, on all joints."""
    return any(
        other.type == use.type
        and not other.options.get("per_run")
        and (other.joints == ALL or set(use.joints) <= set(other.joints))
        for other in model.effects
    )


# ------------------------------------------------------------ bodies


def _feasible(content: Content, rows: FloatArray, mended: bool) -> NearestBodies | None:
    """Feasible bodies; None where they are already.

    Raises
    ------
    ConfigError
        If only bodies with other efforts are, by more than efforts are measured to, and those were
        not asked for.
    """
    if content.bodies is None or not (bad := infeasible(content.bodies)):
        return None
    tree = content.tree
    prior = (tree.spread @ content.robot.prior).reshape(-1, 10)
    found = nearest_feasible(content.bodies, prior, rows)
    if found.same or mended or found.change < MATTERS:
        return found
    names = ", ".join(tree.joints[k] for k in bad)
    raise ConfigError(
        f"masses and inertias behind {names} are those of no body (a mass or a principal moment is "
        f"not above zero, or one moment exceeds the sum of the others). The nearest feasible ones "
        f"change the efforts by {100 * found.change:.2g} %; --feasible takes them"
    )


#: Factor between a written mass and the described one from which it is told.
_OTHER_MASS = 2.0


def _said(found: NearestBodies, content: Content) -> str:
    change = f"the efforts of the bodies change by {100 * found.change:.2g} %"
    if found.change == 0.0:
        change = "the efforts stay the same"
    if told := _other_masses(found, content):
        change += f". Masses far from those of the description: {told}"
    if found.same:
        return (
            "masses and inertias that the data do not determine were chosen so that every body is "
            f"feasible; {change}"
        )
    return f"masses and inertias are the nearest feasible ones; {change}"


def _other_masses(found: NearestBodies, content: Content) -> str:
    """Masses that are written far from the described ones: a body's centre of mass may need them.

    m Ixx >= (m z)^2: a first moment that took up a spring asks for a heavy body.
    """
    tree = content.tree
    described = (tree.spread @ content.robot.prior).reshape(-1, 10)[:, 0]
    told = []
    for joint, m, m0 in zip(tree.joints, found.bodies[:, 0], described, strict=True):
        if m0 > 0.0 and not m0 / _OTHER_MASS < m < m0 * _OTHER_MASS:
            told.append(f"{m:.3g} kg behind {joint} ({m0:.3g})")
    return ", ".join(told)


def _measured(result: FitResult) -> FloatArray:
    """Rows of the bodies' regressor at the measured states, in units of the noise."""
    tree = result.problem.robot.tree
    if tree is None:
        return np.zeros((0, 0))
    parts = []
    for m in result.problem.motions:
        every = max(1, m.n // STATES)
        y = tree.regressor(m.q[::every], m.qd[::every], m.qdd[::every])
        parts.append((y / result.sigma[:, None]).reshape(-1, y.shape[-1]))
    return np.concatenate(parts)


def _anywhere(model: RobotModel, robot: Robot, content: Content) -> FloatArray:
    """The same at random states of the identified range; of a turn where nobody knows it."""
    rng, d = np.random.default_rng(0), len(robot.joints)
    known = {r.joint: r for r in model.valid}
    ends = [
        (known[j].position, known[j].speed) if j in known else ((-np.pi, np.pi), (-2.0, 2.0))
        for j in robot.joints
    ]
    q, qd = (np.stack([rng.uniform(*e[i], STATES) for e in ends], axis=1) for i in (0, 1))
    qdd = rng.uniform(-1.0, 1.0, (STATES, d)) * np.abs(qd).max(axis=0) * 2 * np.pi
    y = content.tree.regressor(q, qd, qdd)
    return y.reshape(-1, y.shape[-1])


def _holding(result: FitResult, bodies: FloatArray) -> RobotModel:
    """The model of a fit with its bodies held at some values."""
    robot, tree = result.problem.robot, result.problem.robot.tree
    if tree is None:
        return result.model
    own = np.linalg.lstsq(tree.spread, bodies.reshape(-1), rcond=None)[0]
    effects = []
    for use in result.model.effects:
        if Trait.BODY in catalogue.get(use.type).traits:
            named = dict(zip((f"{use.type}.{n}" for n in robot.names), own, strict=True))
            values = {
                k: replace(v, value=float(named.get(k, v.value))) for k, v in use.values.items()
            }
            use = replace(use, options=use.options | {"fixed": True}, values=values)
        effects.append(use)
    return replace(result.model, effects=tuple(effects))


@dataclass(frozen=True)
class Job:
    """What is to be exported.

    Parameters
    ----------
    model : RobotModel
        The model.
    source : Path
        Its file.
    name : str
        Stem of the output, for names in it.
    runs, holdout : list of Recording
        Recordings to refit to and to judge on; may be empty.
    mended : bool
        Whether infeasible bodies are replaced by the nearest feasible ones.
    """

    model: RobotModel
    source: Path
    name: str
    runs: list[Recording] = field(default_factory=list)
    holdout: list[Recording] = field(default_factory=list)
    mended: bool = False


@dataclass(frozen=True)
class Made:
    """What came of it.

    Parameters
    ----------
    texts : dict of str to str
        Texts by ending; the first is that of the output, others stand beside it.
    steps : tuple of Step
        Whole model and what is left of it, with held-out errors.
    lost, notes : tuple of str
        Effects that are lost; what else the user should know.
    """

    texts: dict[str, str]
    steps: tuple[Step, ...] = ()
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class Exporter(Protocol):
    """A program, or a reader, that takes models."""

    #: What it is, for help, and the ending of its file, e.g. ``".urdf"``.
    what: str
    ending: str

    def make(self, job: Job) -> Made:
        """Files of a model."""


@dataclass(frozen=True)
class Program:
    """A target that gets what it can express of a model, refitted within that.

    Parameters
    ----------
    what, ending : str
        As of `Exporter`.
    words : Vocabulary
        What it can express.
    write : callable (Content, name, head) -> dict of str to str
        Texts by ending, with the lines of the head as comments.
    cost : callable (text, Content) -> str, optional
        What one call of the written program costs, measured here; in words.
    """

    what: str
    ending: str
    words: Vocabulary
    write: Callable[[Content, str, tuple[str, ...]], dict[str, str]]
    cost: Callable[[str, Content], str] | None = None

    def make(self, job: Job) -> Made:
        """Refit, write, and measure the cost of a call."""
        found = within(job.model, self.words, job.runs, job.holdout, job.mended)
        lost = tuple(x.text for x in found.content.lost)
        texts = self.write(found.content, job.name, head(job, found, lost))
        cost = self.cost(texts[self.ending], found.content) if self.cost else ""
        said = (*found.notes, *_of_sensors(job.model), *([cost] if cost else []))
        return Made(texts, found.steps, lost, said)


def _of_sensors(model: RobotModel) -> list[str]:
    """What a model says of the sensors, which no target gets."""
    theirs = [u.type for u in model.effects if catalogue.get(u.type).family == SENSOR]
    if not theirs:
        return []
    return [f"not written, for it is of the sensors and not of the robot: {', '.join(theirs)}"]


def head(job: Job, found: Within, lost: tuple[str, ...]) -> tuple[str, ...]:
    """Lines at the head of a file: source, held-out errors, what is lost."""
    said = errors_of(found.steps) or ["translated without a recording: not refitted, error unknown"]
    lines = (f"written by hil export from {job.source.name}", *said, *(f"lost: {x}" for x in lost))
    return tuple(" ".join(printable(x).split()) for x in lines)


def errors_of(steps: Sequence[Step]) -> list[str]:
    """A sentence for each step: held-out error of the whole model, and of what is left of it.

    Parameters
    ----------
    steps : sequence of Step
        As of `Made`; none of a model that was only translated.
    """
    rows = [zip(s.result.problem.joints, s.heldout.relative, strict=True) for s in steps]
    said = [", ".join(f"{j} {x:.2f} %" for j, x in row) for row in rows]
    return [f"held-out error, {s.label}: {x}" for s, x in zip(steps, said, strict=True)]


def names() -> list[str]:
    """Names of all targets."""
    return sorted(registry.names("hil.exports"))


def get(name: str) -> Exporter:
    """Target by name.

    Raises
    ------
    ConfigError
        If there is none.
    """
    found: Exporter = registry.load("hil.exports", name)
    return found
