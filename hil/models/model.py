"""A model: a robot and a frozen tuple of effects, composed with `+`; its values, also in words."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, listed_names, unknown
from hil.models import catalogue
from hil.models.effect import Effect, Trait
from hil.models.parts import Param
from hil.record.recording import Recording, RobotSource
from hil.shown import Shown

ALL = ("*",)


@dataclass(frozen=True)
class Value:
    """A parameter's value with what is known of it.

    Parameters
    ----------
    value, stderr : float
        Estimate and standard error (NaN where unknown), in `unit`.
    unit : str
        SI unit.
    lower, upper : float
        Bounds.
    at_bound, identifiable : bool
        Whether the estimate lies on a bound; whether the data determine it.
    source : str
        Where it comes from, e.g. ``"fit of run1.mcap"``.
    """

    value: float
    stderr: float = float("nan")
    unit: str = ""
    lower: float = float("-inf")
    upper: float = float("inf")
    at_bound: bool = False
    identifiable: bool = True
    source: str = ""


@dataclass(frozen=True)
class Use:
    """One effect in a model, on some joints, with its options and values.

    Parameters
    ----------
    type : str
        Name in the catalogue.
    joints : tuple of str
        Joint names; ``("*",)`` means all.  One name may stand alone.
    options : dict
        ``per_run = true`` gives every run its own coefficients; ``fixed = true`` keeps the values.
        ``reference`` is the run that values of other runs are differences to.
    values : dict of str to Value
        By full name, e.g. ``j2.stribeck.fs``.
    """

    type: str
    joints: tuple[str, ...] = ALL
    options: dict[str, object] = field(default_factory=dict)
    values: dict[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse what is no name; one joint's name is a list of one."""
        if not isinstance(self.type, str):
            raise ConfigError(
                f"hil.Use takes the name of an effect, not {type(self.type).__name__}; "
                "give e.g. hil.Use('stribeck', ['joint1'])"
            )
        object.__setattr__(self, "joints", listed_names(self.joints, "joints"))

    def on(self, every: tuple[str, ...]) -> tuple[str, ...]:
        """Its joints by name, among all of a robot."""
        return every if self.joints == ALL else self.joints

    def off(self, gone: tuple[str, ...], every: tuple[str, ...]) -> Use | None:
        """The same on its other joints: None if none is left, itself if it had none of these."""
        rest = tuple(j for j in self.on(every) if j not in gone)
        if len(rest) == len(self.on(every)):
            return self
        theirs = tuple(f"j{k + 1}." for k, j in enumerate(every) if j in gone)
        values = {n: v for n, v in self.values.items() if not n.startswith(theirs)}
        return replace(self, joints=rest, values=values) if rest else None


@dataclass(frozen=True)
class Band:
    """Signal processing of an identification; zeros mean: choose from the data.

    Parameters
    ----------
    position_hz : float
        Cut-off of the zero-phase position filter.
    effort_hz : float
        Cut-off of the zero-phase filter that every column and the effort pass.
    rate_hz : float
        Rate of the recorded rows, where their stamps are not to be believed.
    gap_s : float
        Gap in the rows from which a run is split.
    shift_s : float or None
        By how much the efforts are early against the positions, and are taken later; None =
        estimated within one sample.
    lag_s : float
        Time constant of a low-pass that the efforts passed before they were recorded, and that is
        undone; 0 = none, or estimated where `shift_s` is.
    lag_poles : float
        Of that low-pass: 1, or 2 as Butterworth's; 0 of a moving average over twice `lag_s`.
    clock_ppm : float
        By how much the lateness of the efforts grows, in microseconds a second: their clock and
        that of the positions differ; 0 = not, or estimated where `shift_s` is.
    effort_step : tuple of float
        Steps of the converter that sends the efforts, by joint [N m or N], where the recorded ones
        are those before it; 0 = none, empty = sought where an error is left.
    accuracy : float
        Share of the rms effort to which the efforts are known: no effect below it is named, and no
        error below it is unexplained.
    """

    position_hz: float = 0.0
    effort_hz: float = 0.0
    rate_hz: float = 0.0
    gap_s: float = 0.0
    shift_s: float | None = None
    lag_s: float = 0.0
    lag_poles: float = 1.0
    clock_ppm: float = 0.0
    effort_step: tuple[float, ...] = ()
    accuracy: float = 0.0

    def beside(self, other: Band) -> Band:
        """What it says, and what another one says where it is silent."""
        plain = Band()
        mine = {f.name: getattr(self, f.name) for f in fields(Band)}
        return replace(other, **{k: v for k, v in mine.items() if v != getattr(plain, k)})


@dataclass(frozen=True)
class Range:
    """What one joint went through when the model was identified: lowest and highest values.

    Parameters
    ----------
    joint : str
        Joint.
    position, speed, load : (float, float)
        Ends [rad, rad/s, N m or m, m/s, N].
    span : (float, float), optional
        First and last position of all, which laws over the range refer to [rad or m]; None in files
        of earlier versions.
    """

    joint: str
    position: tuple[float, float]
    speed: tuple[float, float]
    load: tuple[float, float]
    span: tuple[float, float] | None = None


@dataclass(frozen=True, repr=False)
class RobotModel(Shown):
    """Robot plus effects; immutable, `model + "stribeck"` makes a new one.

    Parameters
    ----------
    robot : RobotSource
        Preset or URDF.
    effects : tuple of Use
        The parts.
    arm : str
        Arm of the session it describes; ``""`` = the only or first one.
    explains : str
        ``"motor"``: the motor effort; ``"external"``: the measured external effort (contact).
    band : Band
        Filter band.
    plugins : tuple of str
        Files with a user's effects.
    valid : tuple of Range
        What it was identified on; empty where nobody knows.
    fitted : Band
        Filters and shift of the efforts behind which its values were fitted.
    """

    robot: RobotSource
    effects: tuple[Use, ...]
    arm: str = ""
    explains: str = "motor"
    band: Band = Band()
    plugins: tuple[str, ...] = ()
    urdf_path: str = ""
    valid: tuple[Range, ...] = ()
    fitted: Band = Band()

    def __post_init__(self) -> None:
        if not isinstance(self.robot, RobotSource):
            raise ConfigError(_no_robot(self.robot))

    def __repr__(self) -> str:
        robot = self.robot.preset or ("URDF" if self.robot.urdf else "robot of the session")
        return f"RobotModel({robot}: {' + '.join(self.names())}; {len(self.values())} values)"

    def spans(self, joints: Sequence[str]) -> NDArray[np.float64] | None:
        """Positions (d, 2) that its laws over the range refer to, [rad or m].

        None where it does not say so for all of the joints.
        """
        known = {r.joint: r.span for r in self.valid if r.span}
        return np.array([known[j] for j in joints]) if set(joints) <= set(known) else None

    @property
    def keeps(self) -> bool:
        """Whether some of its values are kept as they are when it is fitted."""
        return any(u.options.get("fixed") for u in self.effects)

    def as_it_is(self, runs: Sequence[str] = (), like: str = "") -> RobotModel:
        """The model with all its values kept: a fit of it fits nothing.

        Filters and shift are those that it was fitted with, where `band` does not say otherwise.

        Parameters
        ----------
        runs : sequence of str
            Runs that it is to predict.  Where an effect has values of every run, one that was
            never fitted gets the median of the others.
        like : str
            Fitted run whose values those get instead.

        Raises
        ------
        ConfigError
            If an effect has no values, or none is of the run that others are to be like.
        """
        fitted = {run for u in self.effects for known in of_runs(u).values() for run in known}
        if like and like not in fitted:
            raise ConfigError(unknown("run with values of its own", like, fitted))
        empty = [u.type for u in self.effects if not u.values and not self._replaced(u)]
        # a rotor that is part of an axis' only inertia has none, and a description its own masses
        known = Trait.BODY | Trait.ROTOR
        needed = [name for name in empty if not catalogue.get(name).traits & known]
        if needed or not any(u.values for u in self.effects):
            raise ConfigError(
                f"the model has no values of {', '.join(empty)}, so it predicts nothing as it is; "
                "'hil fit SESSION.mcap --model M.toml -o FITTED.toml' finds them"
            )
        kept = {"fixed": True, "fixed_shape": True}
        effects = tuple(
            replace(_in_runs(u, runs, like), options=u.options | kept) for u in self.effects
        )
        return replace(self, effects=effects, band=self.band.beside(self.fitted))

    def _replaced(self, use: Use) -> bool:
        """Whether other effects stand in the place of an effect on all of its joints."""
        joints = {r.joint for r in self.valid} if use.joints == ("*",) else set(use.joints)
        by = [
            u
            for u in self.effects
            if use.type in catalogue.get(u.type).relations.replaces
            or (u.type == use.type and u is not use and u.options.get("per_run"))
        ]
        everywhere = any(u.joints == ("*",) for u in by)
        return bool(by) and (everywhere or joints <= {j for u in by for j in u.joints})

    def __add__(self, other: Use | str) -> RobotModel:
        """Model with one more effect (what it replaces steps back on the same joints).

        Values of every run take the place of one value for all.

        Raises
        ------
        ConfigError
            If the effect is unknown or already there for one of the joints, or none was given.
        """
        if not isinstance(other, str | Use):
            raise ConfigError(
                f"a model takes an effect, not {type(other).__name__}; give its name, "
                "model + 'stribeck', or model + hil.Use('stribeck', ['joint1'])"
            )
        use = Use(other) if isinstance(other, str) else other
        catalogue.get(use.type)
        for old in self.effects:
            own = bool(use.options.get("per_run")) and not old.options.get("per_run")
            if old.type == use.type and _overlap(old.joints, use.joints) and not own:
                raise ConfigError(
                    f"the model already has {use.type!r} on {_text(old.joints)}; "
                    "remove it first or name another joint"
                )
        return replace(self, effects=(*self.effects, use))

    def __sub__(self, other: Use | str) -> RobotModel:
        """Model without an effect: of its name on every joint, of a use on the joints it names.

        Raises
        ------
        ConfigError
            As `without`.
        """
        if not isinstance(other, str | Use):
            raise ConfigError(
                f"a model without an effect takes its name, not {type(other).__name__}; give e.g. "
                "model - 'stribeck', or model - hil.Use('stribeck', ['joint1'])"
            )
        use = Use(other) if isinstance(other, str) else other
        return self.without(use.type, use.joints)

    def without(
        self, effect: str, joints: str | tuple[str, ...] = ALL, every: tuple[str, ...] = ()
    ) -> RobotModel:
        """Model without an effect on some joints; on the others it stays.

        Parameters
        ----------
        effect : str
            Its name.
        joints : str or tuple of str
            Joints that lose it; ``("*",)`` means all.
        every : tuple of str
            Joints of the robot, which an effect on all of them has; those of a fitted model are
            known.

        Raises
        ------
        ConfigError
            If the model has no such effect, or not on one of the joints.
        """
        gone = listed_names(joints, "joints")
        mine = [u for u in self.effects if u.type == effect]
        if not mine:
            raise ConfigError(unknown("effect of this model", effect, self.names()))
        if gone == ALL:
            return replace(self, effects=tuple(u for u in self.effects if u.type != effect))
        if catalogue.get(effect).scope.of_robot:
            raise ConfigError(f"{effect!r} is of the whole robot; take it away without a joint")
        every = every or tuple(r.joint for r in self.valid)
        if not every and any(u.joints == ALL for u in mine):
            raise ConfigError(
                f"the model has {effect!r} on all joints, and their names are not known before it "
                f"is fitted; give model.without({effect!r}, {list(gone)}, every=run.joints)"
            )
        there = tuple(dict.fromkeys(j for u in mine for j in u.on(every)))
        for joint in gone:
            if joint not in there:
                raise ConfigError(unknown(f"joint of {effect!r}", joint, there))
        kept = [u if u.type != effect else u.off(gone, every) for u in self.effects]
        return replace(self, effects=tuple(u for u in kept if u is not None))

    def names(self) -> tuple[str, ...]:
        """Names of its effects, in order, without repetition."""
        return tuple(dict.fromkeys(u.type for u in self.effects))

    def values(self) -> dict[str, Value]:
        """All parameter values by full name."""
        return {name: value for use in self.effects for name, value in use.values.items()}

    def check_joints(self, joints: tuple[str, ...]) -> None:
        """Raise ConfigError if an effect names a joint that the robot does not have."""
        for use in self.effects:
            for joint in use.joints:
                if joint != "*" and joint not in joints:
                    raise ConfigError(f"effect {use.type!r}: " + unknown("joint", joint, joints))


#: Name of a value of one run.
_OF_A_RUN = re.compile(r"(.*)\[(.*)\]")


def of_runs(use: Use) -> dict[str, dict[str, Value]]:
    """Values of an effect by name and run; that of a reference run is 0."""
    out: dict[str, dict[str, Value]] = {}
    for name, value in use.values.items():
        if use.options.get("per_run") and (found := _OF_A_RUN.fullmatch(name)):
            out.setdefault(found[1], {})[found[2]] = value
    reference = use.options.get("reference")
    for known in out.values():
        if isinstance(reference, str):
            known.setdefault(reference, replace(next(iter(known.values())), value=0.0))
    return out


def _in_runs(use: Use, runs: Sequence[str], like: str) -> Use:
    """An effect with values for all of some runs, see `RobotModel.as_it_is`."""
    more: dict[str, Value] = {}
    for name, known in of_runs(use).items():
        # one odd run of several does not draw the median away from the others
        usual = float(np.median([v.value for v in known.values()]))
        other = replace(next(iter(known.values())), value=usual, stderr=float("nan"))
        other = known.get(like, other)
        more |= {f"{name}[{run}]": known.get(run, other) for run in runs}
    return replace(use, values=use.values | more)


def _overlap(a: tuple[str, ...], b: tuple[str, ...]) -> bool:
    return a == ALL or b == ALL or bool(set(a) & set(b))


def _text(joints: tuple[str, ...]) -> str:
    return "all joints" if joints == ALL else ", ".join(joints)


def _no_robot(given: object) -> str:
    """Sentence for what stands in place of a robot."""
    if isinstance(given, Recording):
        how = "give its robot, hil.base_model(run.robot)"
    elif isinstance(given, str | Path):
        how = (
            "a URDF is read with the recording, hil.from_arrays(t, q, tau, robot='arm.urdf'), and "
            "hil.base_model(run.robot) follows; hil.read_model('m.toml') reads a model file"
        )
    else:
        how = "run.robot of a recording is one"
    return f"a model takes a RobotSource, not {type(given).__name__}: {how}"


def as_model(given: object, verb: str) -> RobotModel:
    """The model that a verb was given.

    Parameters
    ----------
    given : object
        A model.
    verb : str
        Name of the verb, for messages.

    Raises
    ------
    ConfigError
        If it is something else; the sentence says what makes a model of it.
    """
    if isinstance(given, RobotModel):
        return given
    how = "hil.base_model(run.robot) makes one"
    if isinstance(given, str | Path):
        how = f"hil.read_model({str(given)!r}) reads a model file"
    elif isinstance(getattr(given, "model", None), RobotModel):
        how = "the model of an answer or a fit is its .model"
    raise ConfigError(f"{verb} takes a RobotModel as the model, not {type(given).__name__}; {how}")


#: The offset is one for all runs; every run its own is an option that a model declares.
BASE_EFFECTS = ("rigid-body", "armature", "coulomb", "viscous", "torque-offset")


def base_model(robot: RobotSource, arm: str = "") -> RobotModel:
    """Base model of any robot: rigid-body + armature + coulomb + viscous + torque-offset."""
    return RobotModel(robot, tuple(Use(name) for name in BASE_EFFECTS), arm)


#: Shape parameter over which a sign is resolved.
SIGN = "v0"
#: Standard error in units of its value from which a coefficient is loose.
LOOSE = 0.5
_NAME = re.compile(r"(?:j\d+\.)?(?P<effect>[^.]+)\.(?P<param>[^\[]+)")


def _shape(name: str) -> tuple[Effect, Param] | None:
    """Effect and shape parameter of a full name; None for a coefficient or an unknown effect."""
    found = _NAME.fullmatch(name)
    effect = catalogue.table().get(found["effect"]) if found else None
    if effect is None or found is None:
        return None
    return next(((effect, p) for p in effect.shape if p.name == found["param"]), None)


def in_words(name: str, value: float, joints: tuple[str, ...] = ()) -> str:
    """Words for a value that is a code; empty where the number says all.

    Parameters
    ----------
    name : str
        Full name of the parameter.
    value : float
        Its value.
    joints : tuple of str
        Joints of the robot, where they are known: the other joint of a coupling has a name.
    """
    found = _shape(name)
    return found[1].words(value, joints) if found else ""


def without_error(name: str, v: Value) -> str:
    """Why a value has no standard error; empty where it has one, or can have none by its nature."""
    found = _shape(name)
    if v.stderr == v.stderr or (found and (found[1].choice or found[1].words(v.value))):
        return ""
    if v.source == "given":
        return "given, not fitted"
    if not v.identifiable:
        return "the data do not determine it by itself"
    if v.at_bound:
        return "at the end of what was searched, the optimum may lie beyond"
    if found and found[1].name == SIGN:
        return "the sharpest sign that fits, as fine as the data resolve"
    if found and found[0].search.at_resolution:
        return "at the end of what the data resolve"
    return "it hardly changes the effort here"


def remark(effect: str, parameters: Mapping[str, Value]) -> str:
    """What the fitted values of one effect say that a reader might miss; empty if nothing.

    Parameters
    ----------
    effect : str
        Its name.
    parameters : mapping of str to Value
        Its parameters by full name.
    """
    short = {n.split(".")[-1]: v for n, v in parameters.items() if "[" not in n}
    kind = catalogue.get(effect)
    if not all(p.name in short for p in (*kind.params, *kind.shape)):
        return ""
    values, errors = ({n: getattr(v, k) for n, v in short.items()} for k in ("value", "stderr"))
    said = [kind.doc.remark(values, errors), _loose(kind, values, errors)]
    return "; ".join(x for x in said if x)


def _loose(kind: Effect, values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """What to make of a single coefficient that is loose with a shape of its own."""
    if len(kind.params) != 1 or not kind.shape:
        return ""
    name = kind.params[0].name
    loose = [n for n in errors if errors[n] > LOOSE * abs(values[n])]
    if name not in loose or len(loose) < 2:
        return ""
    others = ", ".join(n for n in loose if n != name)
    return (
        f"{name} trades off with {others}: sure is the law that they make together, in the range "
        "that was recorded, and none of them alone"
    )
