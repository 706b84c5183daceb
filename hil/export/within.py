"""A model refitted within what a target can express, with the error that this costs.

Without a recording the values are only translated: what is lost takes its share of the effort with
it.  With one, all that is left is fitted anew, so that it carries what it can of the lost effects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.heldout import Examiner, settled
from hil.diagnosis.types import Step
from hil.diagnosis.verbs import make_problem
from hil.errors import ConfigError
from hil.export import feasible
from hil.export.content import Content, Lost, Vocabulary, translate
from hil.identify.errors import complete
from hil.identify.fit import fit
from hil.identify.parallel import single_threaded
from hil.identify.result import FitResult
from hil.identify.timing import fit_aligned
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import RobotModel
from hil.models.robots import Robot, bare_robot
from hil.record.recording import Recording

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
    robot = bare_robot(model.robot, _names(model))
    content = translate(model, robot, words)
    note = "translated only, not refitted: give a recording with --data to see what the loss costs"
    if content.bodies is None or not words.bodies:
        return Within(content, model, notes=(note,))
    rows = _anywhere(model, robot, content)
    found = _feasible(content, rows, mended)
    if found is None:
        return Within(content, model, notes=(note,))
    return Within(replace(content, bodies=found.bodies), model, (), (note, _said(found)))


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
    left, lost = reduced(model, words)
    after = before
    if left != model:
        result = complete(fit(problem, left, scale=before.result.sigma))
        after = Step("within the target", result, examine(result))
    content = translate(after.result.model, problem.robot, words, problem.span)
    content = replace(content, lost=(*lost, *content.lost))
    steps: tuple[Step, ...] = (before,) if after is before else (before, after)
    notes = [text for _, text in after.result.warnings]
    if content.bodies is None or not words.bodies:
        return Within(content, after.result.model, steps, tuple(notes))
    found = _feasible(content, _measured(after.result), mended)
    if found is None:
        return Within(content, after.result.model, steps, tuple(notes))
    notes.append(_said(found))
    if not holdout:
        notes.append("the bodies were found on all the data, the held-out blocks included")
    # the errors that are shown are those of the very bodies that are written
    result = complete(fit(problem, _holding(after.result, found.bodies), scale=after.result.sigma))
    steps = (*steps, Step("feasible bodies", result, examine(result)))
    content = translate(result.model, problem.robot, words, problem.span)
    content = replace(content, bodies=found.bodies, lost=(*lost, *content.lost))
    return Within(content, result.model, steps, (*notes,))


def reduced(model: RobotModel, words: Vocabulary) -> tuple[RobotModel, list[Lost]]:
    """A model without what a target cannot say, and that.

    Coefficients that every run has of its own become one for all.

    Raises
    ------
    ConfigError
        If nothing is left.
    """
    kept, lost = [], []
    for use in model.effects:
        if reason := words.lacks(catalogue.get(use.type)):
            lost.append(Lost(use.type, use.joints, reason))
            continue
        options = {k: v for k, v in use.options.items() if k != "per_run"}
        once = {k: v for k, v in use.values.items() if "[" not in k}
        kept.append(replace(use, options=options, values=once))
    if not kept:
        raise ConfigError(
            f"the target can say none of the model's effects: {', '.join(model.names())}"
        )
    return replace(model, effects=tuple(kept)), lost


# ------------------------------------------------------------ bodies


def _feasible(content: Content, rows: FloatArray, mended: bool) -> feasible.Nearest | None:
    """Feasible bodies; None where they are already.

    Raises
    ------
    ConfigError
        If only others are, and those were not asked for.
    """
    if content.bodies is None or not (bad := feasible.infeasible(content.bodies)):
        return None
    tree = content.tree
    prior = (tree.spread @ content.robot.prior).reshape(-1, 10)
    found = feasible.nearest(content.bodies, prior, rows)
    if found.same or mended:
        return found
    names = ", ".join(tree.joints[k] for k in bad)
    raise ConfigError(
        f"masses and inertias behind {names} are those of no body (a mass or a principal moment is "
        f"not above zero, or one moment exceeds the sum of the others). The nearest feasible ones "
        f"change the efforts by {100 * found.change:.2g} %; --feasible takes them"
    )


def _said(found: feasible.Nearest) -> str:
    change = f"the efforts of the bodies change by {100 * found.change:.2g} %"
    if found.same:
        return (
            "masses and inertias that the data do not determine were chosen so that every body is "
            f"feasible; {change}"
        )
    return f"masses and inertias are the nearest feasible ones; {change}"


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
