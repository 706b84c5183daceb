"""What a model says in numbers that any program can take: bodies, and columns as formulas.

A target has a vocabulary.  What of a model is not in it is lost, and said to be.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.identify.design import head
from hil.models import catalogue, formula
from hil.models.bodies import Tree
from hil.models.effect import Effect, Trait
from hil.models.model import ALL, RobotModel, Use
from hil.models.param import JOINT
from hil.models.robots import Robot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Vocabulary:
    """What a target can express.

    Parameters
    ----------
    bodies : bool
        Masses and inertias of links.
    columns : tuple of str, or None
        Formulas that it has a word for; None: any.
    follows : bool
        Joints that follow another one.
    """

    bodies: bool = True
    columns: tuple[str, ...] | None = None
    follows: bool = True

    def lacks(self, effect: Effect) -> str:
        """Why an effect cannot be said; empty if it can."""
        if Trait.BODY in effect.traits:
            return "" if self.bodies else "the target has no bodies"
        if not effect.doc.formulas:
            return "it is no formula of the joint's present state"
        if self.columns is None:
            return ""
        words = {_same(text) for text in self.columns}
        known = all(_same(text) in words for text in effect.doc.formulas)
        return "" if known else f"the target has no term for  {effect.doc.equation}"


def _same(text: str) -> str:
    """A formula however it is spaced."""
    return ast.unparse(formula.parsed(text))


@dataclass(frozen=True)
class Lost:
    """An effect that a target cannot say.

    Parameters
    ----------
    effect : str
        Its name.
    joints : tuple of str
        Where it acts.
    reason : str
        Why it is lost.
    """

    effect: str
    joints: tuple[str, ...]
    reason: str

    @property
    def text(self) -> str:
        """One line."""
        where = f" on {', '.join(self.joints)}" if self.joints and self.joints != ALL else ""
        return f"{self.effect}{where}: {self.reason}"


@dataclass(frozen=True)
class Column:
    """One column with its value.

    Parameters
    ----------
    effect : str
        Name of the effect, for comments.
    joint : int
        Joint that feels it, from 0 on.
    text : str
        The formula.
    value : float
        The coefficient.
    known : mapping of str to float
        Names of the formula that are numbers.
    other : int
        Joint whose speed is ``vk``; -1 = none.
    """

    effect: str
    joint: int
    text: str
    value: float
    known: Mapping[str, float] = field(default_factory=dict)
    other: int = -1

    def written(self, state: Mapping[str, str], syntax: formula.Syntax = formula.PLAIN) -> str:
        """Value times column in some language (`hil.models.formula.written`)."""
        column = formula.written(self.text, self.known, state, syntax)
        return f"{formula.number(self.value)} * {column}"


@dataclass(frozen=True)
class Content:
    """A model as far as a target can say it.

    Parameters
    ----------
    robot : Robot
        Joints, units.
    urdf : str
        Description it was made with; empty for a preset.
    bodies : ndarray (b, 10), or None
        m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz behind each moving joint, in its axes.
    columns : tuple of Column
        All else.
    stops : dict of int to list of (float, float)
        Positions and sides of stops by joint.
    lost : tuple of Lost
        What it cannot say.
    """

    robot: Robot
    urdf: str
    bodies: FloatArray | None
    columns: tuple[Column, ...]
    stops: dict[int, list[tuple[float, float]]]
    lost: tuple[Lost, ...]

    @property
    def tree(self) -> Tree:
        """The robot's bodies.

        Raises
        ------
        ConfigError
            If its parameters are lumped.
        """
        if self.robot.tree is None:
            raise ConfigError(
                "this robot's parameters are sums over several links, so no link has a mass of its "
                "own; give a model with a URDF: [robot] urdf = 'arm.urdf'"
            )
        return self.robot.tree

    def each(self, text: str) -> FloatArray:
        """Sum of the values of a column by joint (d,)."""
        out, wanted = np.zeros(len(self.robot.joints)), _same(text)
        for c in self.columns:
            if _same(c.text) == wanted:
                out[c.joint] += c.value
        return out

    def effort(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Motor effort of the content at states (n, d) [N m or N]."""
        out = np.zeros(q.shape)
        if self.bodies is not None:
            out += self.tree.regressor(q, qd, qdd) @ self.bodies.reshape(-1)
        for c in self.columns:
            j, k = c.joint, max(c.other, 0)
            state = {"q": q[:, j], "v": qd[:, j], "a": qdd[:, j], "vk": qd[:, k]}
            out[:, j] += c.value * formula.evaluate(c.text, {**c.known, **state})
        return out


def translate(
    model: RobotModel, robot: Robot, words: Vocabulary, span: FloatArray | None = None
) -> Content:
    """A model's values in the words of a target.

    Parameters
    ----------
    model : RobotModel
        With values.
    robot : Robot
        Its robot.
    words : Vocabulary
        Of the target.
    span : ndarray (d, 2), optional
        Smallest and largest recorded position, where they are known.

    Raises
    ------
    ConfigError
        If the model explains the external effort, has no values, or the target has no such robot.
    """
    if model.explains != "motor":
        raise ConfigError(
            "the model is a law of contact (explains = 'external'); robots and feed-forwards take "
            "a model of the motor effort"
        )
    if not model.values():
        raise ConfigError(
            "the model has no values; 'hil fit SESSION.mcap --model M.toml -o FITTED.toml' finds "
            "them, or give the recording: --data SESSION.mcap"
        )
    if robot.tree is not None and not (robot.tree.alone or words.follows):
        raise ConfigError(
            "the robot has joints that follow another one (mimic), which this target has no word "
            "for; choose urdf, c, cpp or python"
        )
    return _Translation(model, robot, words, span).content()


class _Translation:
    """Goes through a model's effects once."""

    def __init__(
        self, model: RobotModel, robot: Robot, words: Vocabulary, span: FloatArray | None
    ) -> None:
        self.model, self.robot, self.words, self.span = model, robot, words, span
        self.signs = {
            j: use.values[name].value
            for use in model.effects
            for j in self._joints(use)
            if (name := f"{head(catalogue.get(use.type), j)}.v0") in use.values
        }
        self.stops: dict[int, list[tuple[float, float]]] = {}

    def _joints(self, use: Use) -> list[int]:
        every = self.robot.joints
        return [j for j, name in enumerate(every) if use.joints == ALL or name in use.joints]

    def content(self) -> Content:
        columns: list[Column] = []
        lost: list[Lost] = []
        bodies = None
        for use in self.model.effects:
            effect = catalogue.get(use.type)
            if reason := self._unsaid(use, effect):
                lost.append(Lost(use.type, use.joints, reason))
            elif Trait.BODY in effect.traits:
                bodies = self._bodies(use)
            else:
                for j in self._joints(use):
                    if found := self._gap(use, effect, j):
                        lost.append(Lost(use.type, (self.robot.joints[j],), found))
                    else:
                        columns.extend(self._columns(use, effect, j))
            if Trait.STOP in effect.traits:
                self._stop(use, effect)
        source = self.model.robot.urdf
        return Content(self.robot, source, bodies, tuple(columns), self.stops, tuple(lost))

    def _unsaid(self, use: Use, effect: Effect) -> str:
        """Why an effect is lost on all joints."""
        if Trait.BODY in effect.traits and self.robot.tree is None:
            return "the robot's parameters are sums over several links"
        if any("[" in name for name in use.values):
            return "it has other values in every run; give the recording, --data, for one of all"
        if not use.values and Trait.GIVEN not in effect.traits:
            return "the model has no values of it; give the recording with --data"
        return self.words.lacks(effect)

    def _bodies(self, use: Use) -> FloatArray:
        """Parameters (b, 10): the model's, else those of the description."""
        tree, robot = self.robot.tree, self.robot
        if tree is None:
            raise ConfigError("the robot has no bodies of its own")
        named = [use.values.get(f"{use.type}.{name}") for name in robot.names]
        own = [p if v is None else v.value for v, p in zip(named, robot.prior, strict=True)]
        out: FloatArray = (tree.spread @ np.array(own)).reshape(-1, 10)
        return out

    def _shape(self, use: Use, effect: Effect, j: int) -> dict[str, float]:
        names = {p.name: f"{head(effect, j)}.{p.name}" for p in effect.shape}
        return {k: use.values[name].value for k, name in names.items() if name in use.values}

    def _gap(self, use: Use, effect: Effect, j: int) -> str:
        """What number is missing on one joint; empty where none is, or the effect does not act."""
        known = self._known(use, effect, j)
        for text in effect.doc.formulas if self._values(use, effect, j) else ():
            lacking = formula.names(text) - set(known) - set(formula.STATE)
            if lacking & {"low", "high"}:
                return "its law is about the recorded span; give the recording with --data"
            if lacking:
                return f"the model has no value of {', '.join(sorted(lacking))}"
        return ""

    def _known(self, use: Use, effect: Effect, j: int) -> dict[str, float]:
        """Numbers that the formulas of an effect on a joint may name."""
        known = self._shape(use, effect, j)
        other = int(known.get(JOINT, 0)) - 1
        signs = {"v0": self.signs.get(j), "v0k": self.signs.get(other)}
        known |= {k: v for k, v in signs.items() if v is not None}
        if self.span is not None:
            known |= {"low": float(self.span[j, 0]), "high": float(self.span[j, 1])}
        return known

    def _values(self, use: Use, effect: Effect, j: int) -> list[float]:
        """Coefficients on one joint; empty where the effect does not act there."""
        names = [f"{head(effect, j)}.{p.name}" for p in effect.params]
        return [use.values[n].value for n in names if n in use.values]

    def _columns(self, use: Use, effect: Effect, j: int) -> Iterator[Column]:
        known = self._known(use, effect, j)
        other = int(known.get(JOINT, 0)) - 1
        for text, value in zip(effect.doc.formulas, self._values(use, effect, j), strict=False):
            if value:
                needed = {k: known[k] for k in sorted(formula.names(text) & set(known))}
                yield Column(use.type, j, text, value, needed, other)

    def _stop(self, use: Use, effect: Effect) -> None:
        for j in self._joints(use):
            shape = list(self._shape(use, effect, j).values())
            if len(shape) == 2:
                self.stops.setdefault(j, []).append((shape[0], shape[1]))
