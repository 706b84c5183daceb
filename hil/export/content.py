"""What a model says in numbers that any program can take: bodies, and columns as formulas.

A target has a vocabulary.  What of a model is not in it is lost, and said to be.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.identify.design import head
from hil.models import catalogue, formula
from hil.models.bodies import Tree
from hil.models.effect import Effect, Over, Trait
from hil.models.mass import SPRING
from hil.models.model import ALL, RobotModel, Use
from hil.models.motion import Motion
from hil.models.parts import JOINT, Param
from hil.models.robots import Robot

FloatArray = NDArray[np.float64]
#: Family of what belongs to the sensors: a program that drives the robot has no use for it.
SENSOR = "sensor"
#: Share of the recorded range beyond a stop from which it is no end of the range.
DEEPEST = 1 / 3
#: Formulas whose coefficients are friction, damping, stiffness or inertia: below zero a program
#: that moves the robot by them is driven.
PASSIVE = (
    *("sign", "v", "a", SPRING),
    "abs(side * max(0, side * (q - q0))) * v",
    *("abs(max(0, q - q0)) * v", "abs(min(0, q - q1)) * v"),
)
#: Formulas of friction that simulators have, and the effects that these are.
_FRICTION = ("sign", "v")
STAND_INS = ("coulomb", "viscous")
#: Speeds at which laws of friction are compared; way between two instants of a stroke [rad or m].
SPEEDS, STROKE = 40, 100.0


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
    beside : mapping of str to str
        Formulas that it can say only on joints that have another one, too.
    """

    bodies: bool = True
    columns: tuple[str, ...] | None = None
    follows: bool = True
    beside: Mapping[str, str] = field(default_factory=dict)

    def lacks(self, effect: Effect) -> str:
        """Why an effect cannot be said; empty if it can."""
        if Trait.BODY in effect.traits:
            return "" if self.bodies else "the target has no bodies"
        if not effect.doc.formulas and effect.scope.formulas is None:
            return (
                "its effort depends on more than the present motion, and the target can say no more"
            )
        if self.columns is None:
            return ""
        words = {_same(text) for text in self.columns}
        known = effect.scope.formulas is None and all(
            _same(text) in words for text in effect.doc.formulas
        )
        return "" if known else f"the target has no term for  {effect.doc.equation}"

    def alone(self, use: Use, model: RobotModel, joint: str) -> str:
        """Why an effect cannot be said on one joint, for what stands beside it; empty if it can."""
        for text in catalogue.get(use.type).doc.formulas:
            needed = self.beside.get(text)
            beside = [
                catalogue.get(other.type)
                for other in model.effects
                if other.joints == ALL or joint in other.joints
            ]
            if needed and not any(needed in e.doc.formulas for e in beside):
                effect = next(e for e in catalogue.table().values() if needed in e.doc.formulas)
                return f"the target can say it only on a joint that has a {effect.name}"
        return ""


def passive(model: RobotModel, joints: tuple[str, ...]) -> frozenset[str]:
    """Names of a model's coefficients that are not below zero, and must not come there.

    What the whole model has below zero is what the recording shows, and stays.
    """
    words, values = {_same(text) for text in PASSIVE}, model.values()
    found = set()
    for use in model.effects:
        effect = catalogue.get(use.type)
        every = zip(effect.doc.formulas, effect.params, strict=False)
        mine = [p.name for text, p in every if _same(text) in words]
        acting = [j for j, name in enumerate(joints) if use.joints == ALL or name in use.joints]
        found |= {f"{head(effect, j)}.{name}" for j in acting for name in mine}
    return frozenset(n for n in found if n not in values or values[n].value >= 0.0)


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


def _grouped(lost: list[Lost]) -> list[Lost]:
    """One for all joints of which the same is lost for the same reason."""
    out: dict[tuple[str, str], Lost] = {}
    for x in lost:
        key = (x.effect, x.reason)
        out[key] = replace(out[key], joints=(*out[key].joints, *x.joints)) if key in out else x
    return list(out.values())


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
        Joint whose place is ``qk`` and whose speed ``vk``; -1 = none.
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
        d = q.shape[1]
        every = formula.states(d, lambda i: q[:, i], lambda i: qd[:, i], lambda i: qdd[:, i])
        for c in self.columns:
            j, k = c.joint, max(c.other, 0)
            own = {"q": q[:, j], "v": qd[:, j], "a": qdd[:, j]}
            state = {**own, "qk": q[:, k], "vk": qd[:, k], **every}
            out[:, j] += c.value * formula.evaluate(c.text, {**c.known, **state})
        return out


def stand_ins(
    kept: Sequence[Use], lost: Sequence[Lost], words: Vocabulary, joints: tuple[str, ...]
) -> list[Use]:
    """Coulomb and viscous friction for joints that lose a law of friction and have them not.

    They are fitted; the law may have been all the friction of its joint.

    Parameters
    ----------
    kept, lost : sequence of Use, of Lost
        What a target can say of a model, and what not.
    words : Vocabulary
        Of the target.
    joints : tuple of str
        All of the robot.
    """
    bare = [
        j
        for j in joints
        if any(
            catalogue.get(x.effect).family == "friction" and (x.joints == ALL or j in x.joints)
            for x in lost
        )
    ]
    out = []
    for name in STAND_INS:
        there = [use.joints for use in kept if use.type == name]
        new = tuple(j for j in bare if not any(own == ALL or j in own for own in there))
        if new and not words.lacks(catalogue.get(name)):
            out.append(Use(name, new))
    return out


def slid(
    content: Content, model: RobotModel, robot: Robot, words: Vocabulary
) -> tuple[Content, list[str]]:
    """A content without data whose lost friction is put into Coulomb and viscous friction.

    Returns
    -------
    Content, list of str
        The content, and sentences on what was done or is missing.
    """
    return _Translation(model, robot, words, None).sliding(content)


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
        self.model, self.robot, self.words = model, robot, words
        self.span = model.spans(robot.joints) if span is None else span
        self.signs = {
            j: use.values[name].value
            for use in model.effects
            for j in self._joints(use)
            if (name := f"{head(catalogue.get(use.type), j)}.v0") in use.values
        }
        self.stops: dict[int, list[tuple[float, float]]] = {}

    def _joints(self, use: Use) -> list[int]:
        return self._named(use.joints)

    def content(self) -> Content:
        columns: list[Column] = []
        lost: list[Lost] = []
        bodies = None
        for use in self.model.effects:
            effect = catalogue.get(use.type)
            if effect.family == SENSOR:
                continue
            if reason := self._unsaid(use, effect):
                lost.append(Lost(use.type, use.joints, reason))
            elif Trait.BODY in effect.traits:
                bodies = self._bodies(use)
            else:
                for j in self._joints(use):
                    name = self.robot.joints[j]
                    alone = self.words.alone(use, self.model, name)
                    if found := alone or self._gap(use, effect, j):
                        lost.append(Lost(use.type, (name,), found))
                    else:
                        columns.extend(self._columns(use, effect, j))
            if Trait.STOP in effect.traits:
                self._stop(use, effect)
        source = self.model.robot.urdf
        lost = _grouped([*lost, *self._orphans(columns)])
        return Content(self.robot, source, bodies, tuple(columns), self.stops, tuple(lost))

    def _orphans(self, columns: list[Column]) -> list[Lost]:
        """Take out columns whose companion on the joint was lost; what they were."""
        gone = [
            c
            for c in columns
            if (needed := self.words.beside.get(c.text))
            and not any(x.joint == c.joint and x.text == needed for x in columns)
        ]
        columns[:] = [c for c in columns if c not in gone]
        why = "the target can say it only beside an effect that is lost, or that came to zero"
        return [Lost(c.effect, (self.robot.joints[c.joint],), why) for c in gone]

    def sliding(self, content: Content) -> tuple[Content, list[str]]:
        """The content with what it loses of friction put into its Coulomb and viscous parts.

        Lost laws of speed and of displacement have an effort F(v) in steady sliding.  With what
        the content already has of ``sign`` and ``v`` it becomes the nearest fc sign(v) + fv v,
        fc, fv >= 0, in the mean square over the speeds that the model was identified at.

        Returns
        -------
        Content, list of str
            The content, and a sentence for every joint whose friction was changed or could not be.
        """
        fits = all(self.words.columns is None or text in self.words.columns for text in _FRICTION)
        lost = {(x.effect, j) for x in content.lost for j in self._named(x.joints)}
        columns, said = list(content.columns), []
        for j, joint in enumerate(self.robot.joints if fits else ()):
            uses = [u for u in self.model.effects if (u.type, j) in lost and self._slides(u, j)]
            if not uses:
                continue
            names = " + ".join(u.type for u in uses)
            top = max(
                (abs(x) for r in self.model.valid if r.joint == joint for x in r.speed), default=0.0
            )
            if not top:
                said.append(
                    f"no friction of {names} on {joint} is written: the model does not state the "
                    "speeds that it was identified at; give a recording with --data"
                )
                continue
            own = [c for c in columns if c.joint == j and c.text in _FRICTION]
            v = np.tile(top * np.linspace(1.0 / SPEEDS, 1.0, SPEEDS), 2)
            ones = np.ones(v.size)
            force = sum((self._steady(u, j, v[:SPEEDS]) for u in uses), np.zeros(v.size))
            force += sum(c.value * (v if c.text == "v" else ones) for c in own)
            (fc, fv), _ = scipy.optimize.nnls(np.stack([ones, v], axis=1), force)
            rest = float(np.sqrt(np.mean((force - fc - fv * v) ** 2)))
            known = {"v0": self.signs.get(j) or top / SPEEDS}
            both = Column(names, j, "sign", float(fc), known), Column(names, j, "v", float(fv))
            columns = [*(c for c in columns if c not in own), *both]
            x = self.robot.units[j]
            f = "N" if x == "m" else "N m"
            said.append(
                f"friction of {joint} is {fc:.3g} {f} and {fv:.3g} {f} s/{x}, the nearest to "
                f"{names} in steady sliding up to {top:.3g} {x}/s, the speeds of its "
                f"identification (rms difference {rest:.2g} {f}); small motions and reversals "
                "differ more"
            )
        return replace(content, columns=tuple(columns)), said

    def _named(self, joints: tuple[str, ...]) -> list[int]:
        every = self.robot.joints
        return [j for j, name in enumerate(every) if joints == ALL or name in joints]

    def _slides(self, use: Use, j: int) -> bool:
        """Whether an effect is friction that speed alone decides in steady sliding, with values."""
        effect = catalogue.get(use.type)
        sliding = effect.family == "friction" and effect.doc.over in (Over.SPEED, Over.DISPLACEMENT)
        known = len(self._shape(use, effect, j)) == len(effect.shape)
        return sliding and known and bool(self._values(use, effect, j))

    def _steady(self, use: Use, j: int, speeds: FloatArray) -> FloatArray:
        """Effort against steady sliding at speeds (n,), there and then back (2 n,)."""
        effect = catalogue.get(use.type)
        shape, values = list(self._shape(use, effect, j).values()), self._values(use, effect, j)
        out = []
        for way in (1.0, -1.0):
            for v in speeds:
                stroke = self._stroke(j, way * v)
                columns = effect.columns(stroke, j, shape)[-1, : len(values)]
                out.append(way * float(columns @ values))
        return np.array(out)

    def _stroke(self, j: int, v: float) -> Motion:
        """A long stroke of one joint at a constant speed, far beyond any displacement."""
        n, d = 8, len(self.robot.joints)
        t = np.linspace(0.0, (n - 1) * STROKE / abs(v), n)
        q, qd, none = np.zeros((n, d)), np.zeros((n, d)), np.zeros((n, d))
        q[:, j], qd[:, j] = v * t, v
        signs = np.array([self.signs.get(k) or abs(v) * 1e-3 for k in range(d)])
        span: FloatArray = np.tile(np.array([-1.0, 1.0]), (d, 1))
        away: FloatArray = np.full((d, 2), np.nan)
        return Motion(t, q, qd, none, none, none, none, none, signs, signs, span, away, self.robot)

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
        if effect.scope.formulas is not None and self.span is None:
            return "its law is about the recorded span; give the recording with --data"
        for text, _ in self._terms(effect, j) if self._values(use, effect, j) else ():
            lacking = formula.numbers(text) - set(known)
            if lacking & {"low", "high"}:
                return "its law is about the recorded span; give the recording with --data"
            if lacking:
                return f"the model has no value of {', '.join(sorted(lacking))}"
        return ""

    def _terms(self, effect: Effect, j: int) -> list[tuple[str, Param]]:
        """Columns of an effect on a joint as formulas, and their coefficients."""
        scope = effect.scope
        if scope.formulas is None or scope.terms is None or self.span is None:
            return list(zip(effect.doc.formulas, effect.params, strict=False))
        rest = replace(self._stroke(j, 1.0), span=self.span)
        return list(zip(scope.formulas(rest, j), scope.terms(rest, j), strict=True))

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
        own = effect.params if effect.scope.formulas is None else self._own(effect, j)
        names = [f"{head(effect, j)}.{p.name}" for p in own]
        return [use.values[n].value for n in names if n in use.values]

    def _own(self, effect: Effect, j: int) -> list[Param]:
        return [p for _, p in self._terms(effect, j)]

    def _columns(self, use: Use, effect: Effect, j: int) -> Iterator[Column]:
        known = self._known(use, effect, j)
        other = int(known.get(JOINT, 0)) - 1
        for text, p in self._terms(effect, j):
            value = use.values.get(f"{head(effect, j)}.{p.name}")
            if value is not None and value.value:
                needed = {k: known[k] for k in sorted(formula.names(text) & set(known))}
                yield Column(use.type, j, text, value.value, needed, other)

    def _stop(self, use: Use, effect: Effect) -> None:
        for j in self._joints(use):
            shape = list(self._shape(use, effect, j).values())
            if len(shape) == 2 and self._ends(j, *shape):
                self.stops.setdefault(j, []).append((shape[0], shape[1]))

    def _ends(self, j: int, place: float, side: float) -> bool:
        """Whether a stop ends the range; a spring that engages far within it does not."""
        if self.span is None:
            return True
        low, high = self.span[j]
        beyond = high - place if side > 0 else place - low
        return bool(beyond < DEEPEST * (high - low))
