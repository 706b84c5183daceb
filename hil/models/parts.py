"""What an effect is composed of: its documentation, scope, variation, relations, search, limits.

Every part is a small frozen object with a default that most effects keep.  Shared code asks for
the parts, and never for the name of an effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, Flag, auto
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.models.motion import FloatArray, Motion

if TYPE_CHECKING:
    from hil.models.effect import Effect

INF = float("inf")
#: Name of the shape parameter that holds another joint's number, counted from 1.
JOINT = "joint"
#: Unit of an effort per effort of the other joint: 1, or m or 1/m where only one of them turns.
EFFORT_RATIO = "{F}/{G}"
#: Words for a number of poles.
POLES = ((1.0, "one pole"), (2.0, "two poles"))


@dataclass(frozen=True)
class Param:
    """One parameter of an effect.

    Parameters
    ----------
    name : str
        Short name, e.g. ``"fc"``; in a model it is ``j2.coulomb.fc``.
    unit : str
        SI unit; ``{F}`` stands for N m or N, ``{x}`` for rad or m, ``{y}`` for that of the other
        joint where the shape names one; or `EFFORT_RATIO`, an effort per that joint's.
    text : str
        What it is.
    lower, upper : float
        Physical bounds.
    source : str
        Where equation or bounds come from.
    codes : tuple of (float, str)
        Words for some values, e.g. ``((1.0, "Dahl"),)``.
    choice : bool
        Whether it is no quantity at all: there is nothing between its values, and no error.
    size : bool
        Whether a shape value is a size (a time, a width, a frequency): one that is less than its
        standard error is not determined, and nothing is named by it.
    tuned : bool
        Whether a further shape value goes to the joint optimum with everything else, where it is
        not zero (which stands for: not there); the first one of a range always does.
    usual : float or None
        What a shape value is where a model does not say it; None: it is searched.
    """

    name: str
    unit: str
    text: str
    lower: float = -INF
    upper: float = INF
    source: str = ""
    codes: tuple[tuple[float, str], ...] = ()
    choice: bool = False
    size: bool = False
    tuned: bool = False
    usual: float | None = None

    def unit_at(self, units: Sequence[str], j: int, other: int) -> str:
        """Its unit on joint j, where `other` is the joint that the shape names, or j.

        Parameters
        ----------
        units : sequence of str
            ``"rad"`` or ``"m"`` of every joint.
        j, other : int
            Joints, counted from 0.
        """
        own, theirs = ("m" if units[k] == "m" else "rad" for k in (j, other))
        if self.unit == EFFORT_RATIO:
            return "1" if own == theirs else {"rad": "m", "m": "1/m"}[own]
        force = "N" if own == "m" else "N m"
        return self.unit.replace("{F}", force).replace("{x}", own).replace("{y}", theirs)

    def words(self, value: float, joints: tuple[str, ...] = ()) -> str:
        """Words for a value; empty where the number says all.

        Parameters
        ----------
        value : float
            The value.
        joints : tuple of str
            Joints of the robot, where they are known.
        """
        if self.name == JOINT:
            k = int(value)
            return joints[k - 1] if 1 <= k <= len(joints) else f"joint number {k}"
        return next((text for code, text in self.codes if code == value), "")


Shape = Sequence[float]
Shapes = list[tuple[float, ...]]
#: Unusual forms, and what they must beat: an effect and its shapes.
Others = tuple[Shapes, "Effect", Shapes]
#: Families whose effort is set by posture and acceleration.
SOLID = ("mass", "stiffness")
#: Standard errors from which on a value is not chance.
VALUE_DEVIATIONS = 2.0
#: Share of the motor's effort from which an external one tells a late motion from a late command.
TELLING_PUSH = 0.1
#: Least change of a gain within the run that is one.  Halved: what a model lacks of the load by
#: chance is a change; doubled: a motor that warms by 10 K, or weakens by 2 % at its top speed, goes
#: unnamed.
GAIN_CHANGES = 0.015
#: The instance that declares no shape parameters has one shape, an empty one.
_EMPTY: Shapes = [()]


# ------------------------------------------------------------ traits


class Trait(Flag):
    """What shared code has to know of an effect, whatever its name."""

    NONE = 0
    #: Part of every model, or of none: never proposed as missing.
    GIVEN = auto()
    #: A free function that stands for what no law explains; never a name.
    CORRECTION = auto()
    #: Stands for a robot description that is missing: tried before any named effect.
    GEOMETRY = auto()
    #: The columns depend on `Motion.load`, hence on the model's own masses, and springs at rest.
    LOAD = auto()
    #: The columns depend on position, speed, acceleration and robot alone: made once.
    MOTION = auto()
    #: The columns hold time, a measured effort or a state: a simulation takes them from the
    #: measured run.
    REPLAYED = auto()
    #: Passes the load on smoother, and the noise of the positions less with it.
    SMOOTHS = auto()
    #: The effort acts late as a whole: by its coefficient times all its shape values [s].  Noise
    #: in a closed loop imitates it, so the slow motion must show it, too.
    LATE = auto()
    #: ... motor and external effort together: it is the motion that is measured late.
    WHOLE = auto()
    #: ... by the same time at every frequency: takes the place of an alignment within one sample.
    SHIFTS = auto()
    #: The sign of the speed times one size: its first shape value resolves the sign.
    DRY = auto()
    #: Proportional to the own speed, with one coefficient.
    VISCOUS = auto()
    #: The robot's own parameters: its columns are the robot's regressor, and the robot's
    #: description is their prior.
    BODY = auto()
    #: The rotor's inertia, one coefficient; where an axis' only inertia holds it there is none.
    ROTOR = auto()
    #: Its shape is the surface, (position, side), that laws of a contact refer to.
    SURFACE = auto()
    #: Scales the whole effort: without another measured effort it scales all parameters alike.
    GAIN = auto()
    #: Explains jumps of the recorded position.
    JUMPS = auto()
    #: A stop of the joint's range; its shape is (position, side).
    STOP = auto()
    #: A series over a variable: it follows whatever another law of that variable misses.
    SERIES = auto()


class Sight(Flag):
    """What a recording must have for an effect to show at all."""

    ANYTHING = 0
    #: Speeds far below the highest.
    SLOW = auto()
    #: Several reversals.
    REVERSALS = auto()
    #: A good part of the joint's range.
    RANGE = auto()
    #: A static or external load that changes.
    LOAD = auto()
    #: Minutes of motion.
    MINUTES = auto()
    #: A measured external force.
    FORCE = auto()


class Over(Enum):
    """Variable over which a figure draws an effect."""

    SPEED = "speed"
    POSITION = "position"
    DEPTH = "depth"
    LOAD = "load"
    OTHER_SPEED = "other speed"
    #: The own position and r times the other joint's.
    STRETCH = "stretch"
    TIME = "time"
    PERIOD = "period"
    DISPLACEMENT = "displacement"
    EFFORT_RATE = "effort rate"


# ------------------------------------------------------------ documentation


def _silent(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """No remark."""
    return ""


@dataclass(frozen=True)
class Doc:
    """What people are told of an effect.

    Parameters
    ----------
    equation, signature, shown_by, source : str
        What it is, how it shows, which motion shows it, and where it comes from.
    confused_with : tuple of str
        Effects that it is mistaken for.
    caveat : str
        What the law leaves out, where that moves its values by more than their standard errors,
        which count noise alone; said beside the values.
    variables : str
        What a correction is a function of, in words.
    remark : callable
        What its fitted values and errors say that a reader might miss, by short names.
    shown : Sight
        What a recording must have to show it.
    over : Over or None
        What a figure draws it over; None: the variable that orders it best.
    formulas : tuple of str
        The equation's columns as text (`hil.models.formula`), so that other programs can take
        them over; empty where a joint's state does not say them.
    """

    equation: str
    signature: str
    shown_by: str
    source: str
    confused_with: tuple[str, ...] = ()
    caveat: str = ""
    variables: str = ""
    remark: Callable[[Mapping[str, float], Mapping[str, float]], str] = _silent
    shown: Sight = Sight.ANYTHING
    over: Over | None = None
    formulas: tuple[str, ...] = ()


# ------------------------------------------------------------ scope


class Of(Enum):
    """What an effect belongs to, and where it is felt."""

    #: One joint; columns (n, m).
    JOINT = "joint"
    #: One joint (or a pair), felt on all; columns (n, d, m).
    JOINTS = "joints"
    #: The robot as it is described; columns (n, d, m).
    ROBOT = "robot"
    #: What is fixed to its tip, as a force sensor: some of its coefficients alone may look like a
    #: joint's effect; columns (n, d, m).
    TIP = "tip"


def _nothing(motion: Motion, j: int) -> str:
    """Nothing is lacking."""
    return ""


@dataclass(frozen=True)
class Scope:
    """What an effect belongs to, and what it needs there.

    Parameters
    ----------
    of : Of
        Joint, joints, robot or tip.
    explains : tuple of str
        Which measured effort it can be part of: ``"motor"`` and/or ``"external"``.
    lacks : callable (motion, j) -> str
        Why the effect cannot be tried on these data; empty if it can.
    terms : callable (motion, j) -> tuple of Param, or None
        Coefficients for joint j of this robot; None: always the same, `Effect.params`.
    sought_alone : bool
        Whether its shape is sought by the effort of its own joint, though all joints feel it.
    formulas : callable (motion, j) -> tuple of str, or None
        Columns of `terms` as formulas (`hil.models.formula`), where they depend on the robot;
        None: always those of `Doc.formulas`, if any.
    """

    of: Of = Of.JOINT
    explains: tuple[str, ...] = ("motor",)
    lacks: Callable[[Motion, int], str] = _nothing
    terms: Callable[[Motion, int], tuple[Param, ...]] | None = None
    sought_alone: bool = False
    formulas: Callable[[Motion, int], tuple[str, ...]] | None = None

    @property
    def whole(self) -> bool:
        """Whether one set of coefficients acts on all joints: then columns are (n, d, m)."""
        return self.of is not Of.JOINT

    @property
    def of_robot(self) -> bool:
        """Whether one term stands for the whole robot, so that no joint is named."""
        return self.of in (Of.ROBOT, Of.TIP)

    @property
    def tip(self) -> bool:
        """Whether a joint's effect may be one of its coefficients alone."""
        return self.of is Of.TIP


# ------------------------------------------------------------ variation


def always(shape: Shape) -> bool:
    """Whatever the shape."""
    return True


def never(shape: Shape) -> bool:
    """Whatever the shape."""
    return False


@dataclass(frozen=True)
class Variation:
    """How the coefficients vary between runs, and within one.

    Parameters
    ----------
    per_run : bool
        Every run has its own coefficients where there are several.
    relative : bool
        Only differences between runs can be seen: the first run's coefficients are zero.
    sudden : bool
        Tried only where a value of the model changes at one instant.
    own : callable (shape) -> bool
        Whether coefficients are of one run alone, so that any other run has its own.
    dated : callable (shape) -> bool
        Whether it acts at instants of a run that are seen there: no other run can confirm it.
    timed : callable (shape) -> bool
        Whether it goes by the clock: it then holds for runs that begin in the same state alone.
    single : tuple of float
        Shape that what shows in differences between runs is tried with in a single run.
    """

    per_run: bool = False
    relative: bool = False
    sudden: bool = False
    own: Callable[[Shape], bool] = never
    dated: Callable[[Shape], bool] = never
    timed: Callable[[Shape], bool] = never
    single: tuple[float, ...] = ()


NEVER = Variation()
PER_RUN = Variation(per_run=True)
RELATIVE = Variation(per_run=True, relative=True)
AT_AN_INSTANT = Variation(sudden=True, own=always, dated=always)


# ------------------------------------------------------------ relations


def _on_all(motion: Motion) -> bool:
    """On all data."""
    return True


def _no_foils(motion: Motion, j: int, shape: Shape) -> Sequence[FloatArray]:
    """No laws."""
    return ()


def _no_state(motion: Motion, j: int, shape: Shape, beta: Sequence[float]) -> FloatArray | None:
    """The sign of the speed stays."""
    return None


def _no_temperature(motion: Motion, j: int, shape: Shape) -> FloatArray | None:
    """No law of a temperature."""
    return None


@dataclass(frozen=True)
class Twin:
    """An effect with the very same columns on some data: there no motion tells them apart.

    Parameters
    ----------
    name : str
        The other effect.
    when : callable (motion) -> bool
        On which data.
    """

    name: str
    when: Callable[[Motion], bool] = _on_all


@dataclass(frozen=True)
class Relations:
    """What an effect is to others.

    Parameters
    ----------
    replaces : tuple of str
        Effects of the same joint that this one takes the place of.
    twins : tuple of Twin
        Effects that it cannot be told from.
    extends : tuple of str
        Effects of the same joint beside one of which alone this one is sought: it adds to them.
    limit : str
        Simpler effect that this one becomes in a limit; real parts are near it, not at it.
    causes : tuple of str
        Physical causes of which it is a form, in any words: beside another form of one of them on
        the same joint it is no news.
    foils : callable (motion, j, shape) -> sequence of ndarray (n, m), or (n, d, m) of all joints
        Columns of nearby laws without a name: where one of them fits better, the effect would be
        a wrong name, however much it explains.
    state : callable (motion, j, shape, beta) -> ndarray (n,) or None
        State of the joint's friction, 1 in steady sliding forwards, that takes the place of the
        speed's sign: every law that scales friction scales it.
    linear : callable (motion, j, shape) -> ndarray (n,) or None
        Measured temperature in which the law is linear, though nature's may be curved.
    """

    replaces: tuple[str, ...] = ()
    twins: tuple[Twin, ...] = ()
    extends: tuple[str, ...] = ()
    limit: str = ""
    causes: tuple[str, ...] = ()
    foils: Callable[[Motion, int, Shape], Sequence[FloatArray]] = _no_foils
    state: Callable[[Motion, int, Shape, Sequence[float]], FloatArray | None] = _no_state
    linear: Callable[[Motion, int, Shape], FloatArray | None] = _no_temperature


# ------------------------------------------------------------ search


def _no_shape(motion: Motion, j: int) -> Shapes:
    """Nothing to search."""
    return _EMPTY


def _no_more(motion: Motion, j: int, shape: Shape) -> Shapes:
    """No other values."""
    return []


def _usual(motion: Motion, j: int, shape: Shape) -> Others | None:
    """No unusual forms."""
    return None


def _no_carrier(motion: Motion, j: int) -> FloatArray | None:
    """No factor."""
    return None


def _no_powers(motion: Motion, j: int) -> NDArray[np.complex128] | None:
    """No factors."""
    return None


@dataclass(frozen=True)
class ShapeSearch:
    """How the shape values are found: not at all (`FIXED`), or as the subclasses say.

    Parameters
    ----------
    grid : callable (motion, j) -> list of tuple
        Shape values worth trying (coarse; a local search refines), the usual forms first.
    refine : bool
        Whether a local search may refine the first value after the grid.
    rounds : int
        Rounds in which `across` and then the first value again are searched; with any, the forms
        of the grid are climbed each from its own best value, where those differ.
    across : callable (motion, j, shape) -> list of tuple
        Shapes that differ from a found one in another value than the first, the usual before the
        unusual: the first that leaves no more than 1 % above the best is taken.
    others : callable (motion, j, shape) -> Others or None
        Unusual forms about a found shape, and what they must beat.  A form that holds another
        effect in itself is taken only where it leaves clearly less than the two beside each other.
    sharpest : bool
        Whether the first value that leaves within 1 % of the best is taken, from the start on.
    at_resolution : bool
        Whether the lower end of the grid is what the data resolve, hence no bound.
    """

    grid: Callable[[Motion, int], Shapes] = _no_shape
    refine: bool = True
    rounds: int = 0
    across: Callable[[Motion, int, Shape], Shapes] = _no_more
    others: Callable[[Motion, int, Shape], Others | None] = _usual
    sharpest: bool = False
    at_resolution: bool = False


@dataclass(frozen=True)
class Grid(ShapeSearch):
    """Values on a grid, then a climb of the first one."""


@dataclass(frozen=True)
class Waves(ShapeSearch):
    """Orders of waves over position, of which a long grid is screened at once.

    Parameters
    ----------
    carrier : callable (motion, j) -> ndarray (n,)
        Factor w if the columns are w times two harmonics over position, the order the only shape.
    powers : callable (motion, j) -> ndarray (n, m) of complex
        Factors w_m if the waves' size changes with their order: on the own joint the columns are
        real and imaginary part of  sum_m k^m w_m exp(i k q), k = 2 pi p, p the first shape value.
    """

    carrier: Callable[[Motion, int], FloatArray | None] = _no_carrier
    powers: Callable[[Motion, int], NDArray[np.complex128] | None] = _no_powers


@dataclass(frozen=True)
class Lines(ShapeSearch):
    """Frequencies in time: the columns are [sin, cos] of 2 pi f t, f [Hz] the only shape."""


FIXED = ShapeSearch()


# ------------------------------------------------------------ limits


@dataclass(frozen=True)
class Fitted:
    """Values that fit: what a limit looks at.

    Parameters
    ----------
    effect : Effect
        The physics.
    motion : Motion
        The run.
    j : int
        Joint index.
    shape, beta : sequence of float
        Shape values and coefficients.
    error : sequence of float
        Standard errors of the coefficients; empty where unknown, then none counts.
    """

    effect: Effect
    motion: Motion
    j: int
    shape: Sequence[float]
    beta: Sequence[float]
    error: Sequence[float] = ()

    @property
    def slack(self) -> list[float]:
        """Doubt of every coefficient: `VALUE_DEVIATIONS` standard errors; zero where unknown."""
        known = self.error if len(self.error) == len(self.beta) else [0.0] * len(self.beta)
        return [VALUE_DEVIATIONS * e if math.isfinite(e) else 0.0 for e in known]

    @property
    def determined(self) -> list[bool]:
        """Whether every coefficient has a value of its own: others may share it with no loss."""
        known = len(self.error) == len(self.beta)
        return [math.isfinite(e) for e in self.error] if known else [True] * len(self.beta)


@dataclass(frozen=True)
class Limit:
    """What values that fit must meet to be physics: else they are no finding.

    Parameters
    ----------
    code : str
        Short name, e.g. ``"bounds"``.
    met : callable (Fitted) -> bool
        Whether it is met.
    strict : bool
        Whether the search keeps all coefficients within their bounds as well.
    says : str
        Why values that break it are no finding, for people.
    unseen : bool
        Whether what breaks it may be there all the same, too small to be told by these data: it is
        no finding, but a rival of what takes as much.
    """

    code: str
    met: Callable[[Fitted], bool]
    strict: bool = False
    says: str = "the best values are physically impossible (friction that drives, for example)"
    unseen: bool = False


def _within(f: Fitted) -> bool:
    """Whether all lie within their bounds, but for `VALUE_DEVIATIONS` standard errors."""
    if len(f.effect.params) != len(f.beta):
        return True
    return all(
        p.lower - e <= b <= p.upper + e
        for p, b, e in zip(f.effect.params, f.beta, f.slack, strict=True)
    )


BOUNDS = Limit("bounds", _within)
STRICT = Limit("bounds", _within, strict=True)


def brakes(w: FloatArray, beta: Sequence[float], slack: Sequence[float]) -> bool:
    """Whether friction  F = c tanh(w / v0) + v w  takes power,  w F >= 0,  at every speed seen.

    Beside the joints' own friction the viscous part alone may come out below zero.

    Parameters
    ----------
    w : ndarray (n,)
        Relative speed [rad/s or m/s].
    beta, slack : sequence of float
        c and v, and what each may lack.
    """
    (c, v), (dc, dv), top = beta, slack, float(np.max(np.abs(w), initial=0.0))
    return c >= -dc and c + v * top >= -dc - dv * top
