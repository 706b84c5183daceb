"""From a fitted model to what the loop compensates: rigid-body parameters, and all its effects.

Any effect of the library, or a user's own, made ready for the loop as tables; others are refused
by name.  Nothing is looked up by name: the effect itself is tried.  Which of the loop's quantities
it depends on, and whether it has a memory, shows when rows of a made-up motion are changed and
exchanged; a function of one or two of them becomes a table, fine enough for what lies between
knots.  Presliding has a memory and a kernel of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.estimate import compensation
from hil.estimate.compensation import BEND, MEMORY, SLIP, TERM, VARIABLES
from hil.models import catalogue
from hil.models.effect import SOLID, Effect, Trait, terms_of
from hil.models.friction import Presliding
from hil.models.model import RobotModel, Value
from hil.models.motion import Motion
from hil.models.phantom import Premium
from hil.models.robots import bare_robot

FloatArray = NDArray[np.float64]
#: Parts of a model that the rigid-body part of the loop holds.
_RIGID = Trait.BODY | Trait.ROTOR
_JOINTS = ("joint1", "joint2", "joint3")
#: What stands for an effect without values.
_NO_VALUE = Value(math.nan)


def rigid_parameters(model: RobotModel) -> FloatArray:
    """Pi (8,) of a Premium 1.5 from a fitted model, rotors and payload included.

    Raises
    ------
    ConfigError
        If it is another robot, or the model has no values.
    """
    if model.robot.preset != "phantom-premium-1.5":
        raise ConfigError(
            f"the loop computes the torques of a phantom-premium-1.5; this model is of "
            f"{model.robot.preset or 'a URDF'!r}"
        )
    values = model.values()
    body, rotors = _names_with(Trait.BODY), _names_with(Trait.ROTOR)
    pi = np.array([_value(values, f"{body[0]}.{n}") for n in Premium.names])
    for row, name in ((0, "j1"), (4, "j2"), (5, "j3")):
        for key, value in values.items():
            if key.startswith(tuple(f"{name}.{rotor}." for rotor in rotors)):
                pi[row] += value.value
    return pi


def _names_with(trait: Trait) -> list[str]:
    """Names of the effects with a trait."""
    return [name for name, effect in catalogue.table().items() if trait in effect.traits]


def compensated_values(model: RobotModel) -> dict[str, float]:
    """All values of a fitted model but the rigid body's, as the loop takes them.

    Raises
    ------
    ConfigError
        Naming an effect that the loop cannot compensate, and why.
    """
    catalogue.load_files(model.plugins)
    found = {
        name: value.value
        for use in model.effects
        if not catalogue.get(use.type).traits & _RIGID
        for name, value in (use.values or {f"j1.{use.type}.-": _NO_VALUE}).items()
    }
    tables(found, span(model))
    return found


def span(model: RobotModel) -> list[float]:
    """Lowest and highest position of each joint that its laws refer to; empty if unknown."""
    known = {r.joint: r.span or r.position for r in model.valid}
    joints = tuple(bare_robot(model.robot, _JOINTS).joints)
    return [x for j in joints for x in known[j]] if set(joints) <= set(known) else []


def _value(values: Mapping[str, Value], name: str) -> float:
    found = values.get(name)
    if found is None:
        raise ConfigError(
            f"the model has no value of {name}; identify it first with 'hil fit SESSION.mcap "
            "--model M.toml -o FITTED.toml'"
        )
    return float(found.value)


@dataclass(frozen=True)
class Tables:
    """What the loop's kernels take for one arm; see `hil.estimate.compensation`.

    Parameters
    ----------
    terms : ndarray of TERM
        Functions of one or two quantities.
    slips : ndarray of SLIP
        Presliding.
    values : ndarray (n,)
        Torques at the knots [N m].
    """

    terms: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, TERM))
    slips: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, SLIP))
    values: FloatArray = field(default_factory=lambda: np.zeros(1))


def tables(values: Mapping[str, float], span: Sequence[float] = ()) -> Tables:
    """Tables of the effects whose values a model file gives.

    Parameters
    ----------
    values : mapping
        Full name of a parameter, as ``j2.stribeck.fs``, to its value [SI].
    span : sequence of 6 floats, or empty
        Lowest and highest position of each joint that the model was identified on [rad].

    Raises
    ------
    ConfigError
        Naming an effect that the loop cannot evaluate, and why; or for a span that is none.
    """
    _refuse_span(span)
    terms: list[Any] = []
    slips: list[Any] = []
    flat: list[FloatArray] = []
    ends = np.reshape(span, (3, 2)) if len(span) else np.tile(_ENDS["q"], (3, 1))
    groups = _groups(values)
    for j, effect, given in groups:
        _refuse_load(effect, [e for k, e, _ in groups if k == j])
        part = _Part(effect, j, *_numbers(effect, j, given), ends, bool(len(span)))
        theta = part.theta
        if isinstance(effect, Presliding):
            if part.shape[0] <= 0.0:
                raise _refusal(effect, "its displacement s is not positive")
            if part.shape[1] > 1.0:
                raise _refusal(effect, "LuGre's form has no kernel there")
            slips.append((j, part.shape[0], int(part.shape[1] != 0.0), theta[1:4]))
            part = replace(part, theta=np.array([theta[0], 0.0, 0.0, 0.0]))
        axes = part.axes()
        if axes or part.torque(_made_up(part.ends)).any():
            sheet = _sampled(part, axes)
            rows = [(VARIABLES.index(n), *limits) for n, limits in zip(axes, sheet[1], strict=True)]
            terms.append((j, *(rows + 2 * [(0, 0.0, 1.0, 1)])[:2], sum(x.size for x in flat)))
            flat.append(sheet[0].reshape(-1))
    out = np.concatenate(flat) if flat else np.zeros(1)
    return Tables(np.array(terms, TERM), np.array(slips, SLIP), out)


def _refuse_load(effect: Effect, beside: Sequence[Effect]) -> None:
    """Refuse a law of a load that the loop knows only a part of: it knows no springs in it."""
    carried = [e.name for e in beside if e.family in SOLID]
    if Trait.LOAD in effect.traits and carried:
        why = f"the load that it refers to holds {', '.join(carried)}, which the loop's does not"
        raise _refusal(effect, why)


def _refuse_span(span: Sequence[float]) -> None:
    if len(span) not in (0, 6) or not all(
        -math.inf < low <= high < math.inf for low, high in zip(span[::2], span[1::2], strict=True)
    ):
        raise ConfigError(
            f"span = {list(span)}; expected the lowest and highest position of each of three "
            "joints [rad], or nothing"
        )


@lru_cache(maxsize=8)
def cached_tables(values: tuple[tuple[str, float], ...], span: tuple[float, ...]) -> Tables:
    """`tables`, made once: an operator who sets a parameter makes a new law while the loop runs."""
    return tables(dict(values), span)


def steady(
    values: tuple[tuple[str, float], ...], span: tuple[float, ...], q: FloatArray, qd: FloatArray
) -> FloatArray:
    """Torques of the tables in steady motion, without load or gravity, (3,) [N m].

    Presliding counts as slid through: all of its elements at their limits.

    Parameters
    ----------
    values, span : tuple
        As of `tables`.
    q, qd : ndarray (3,)
        Positions [rad], speeds [rad/s].
    """
    found, out = cached_tables(values, span), np.zeros(3)
    known, past = np.zeros(len(VARIABLES)), np.zeros(MEMORY)
    known[:3], known[3:6] = q, qd
    past[:3] = q - 1e3 * qd
    compensation.friction(
        True, known, found.terms, found.slips, found.values, past, np.zeros(MEMORY), out
    )
    return out


def _groups(values: Mapping[str, float]) -> list[tuple[int, Effect, dict[str, float]]]:
    """Joint from 0, effect and its values, in the order of the mapping."""
    found: dict[tuple[int, str], dict[str, float]] = {}
    for name, value in values.items():
        words = name.split(".")
        if len(words) != 3 or words[0] not in ("j1", "j2", "j3"):
            effect = catalogue.get(words[-2] if len(words) > 1 else name)
            raise _refusal(effect, f"{name} is no parameter of a joint; j1 to j3 are")
        found.setdefault((int(words[0][1]) - 1, words[1]), {})[words[2]] = float(value)
    return [(j, catalogue.get(name), given) for (j, name), given in found.items()]


def _numbers(
    effect: Effect, j: int, given: Mapping[str, float]
) -> tuple[tuple[float, ...], FloatArray]:
    """Shape and coefficients of an effect on joint j, in the order of its columns."""
    motion = _made_up(np.tile(_ENDS["q"], (3, 1)))
    shapes = [p.name for p in effect.shape]
    names = [p.name for p in terms_of(effect, motion, j)]
    missing = [n for n in (*shapes, *names) if not math.isfinite(given.get(n, math.nan))]
    if missing:
        raise _refusal(effect, f"its {', '.join(missing[:6])} on joint {j + 1} are unknown")
    return tuple(given[n] for n in shapes), np.array([given[n] for n in names])


#: First and largest number of knots an axis, and what a table may miss between them, as a share
#: of its largest value within `_FAIR` of the ends of a speed axis.
_KNOTS, _LARGEST_AXIS, _MISS, _FAIR = (
    {"q": 65, "v": 97, "load": 5, "gravity": 5, "t": 97},
    4097,
    0.01,
    0.1,
)


def _sampled(part: _Part, axes: Sequence[str]) -> tuple[FloatArray, list[Any]]:
    """Table with as many knots as it takes."""
    counts = [_KNOTS[_kind_of(n)] for n in axes]
    while True:
        sheet, marks = part.sheet(axes, counts)
        coarse = [k for k in range(len(axes)) if _misses(part, axes, counts, k) > _MISS]
        if not coarse:
            return sheet, marks
        for k in coarse:
            counts[k] = 2 * counts[k] - 1
        if max(counts) > _LARGEST_AXIS or math.prod(counts) > 2_000_000:
            raise _refusal(part.effect, f"it varies too finely over {axes[coarse[0]]} for a table")


def _misses(part: _Part, axes: Sequence[str], counts: Sequence[int], k: int) -> float:
    """Largest error halfway between knots of axis k, over the largest value there is."""
    few = [min(c, 33) if i != k else c for i, c in enumerate(counts)]
    sheet, _ = part.sheet(axes, few)
    twice = [2 * c - 1 if i == k else c for i, c in enumerate(few)]
    fine, marks = part.sheet(axes, twice)
    rows, right = np.moveaxis(fine, k, 0), np.moveaxis(sheet, k, 0)
    start, step, count = marks[k]
    u = start + step * np.arange(count)
    x = BEND * np.sinh(u) if axes[k][0] in _BENT else u
    share = ((x[1::2] - x[:-2:2]) / (x[2::2] - x[:-2:2])).reshape(-1, *[1] * (right.ndim - 1))
    between = right[:-1] + share * (right[1:] - right[:-1])
    inner = np.abs(x[1::2]) < (_FAIR * _ENDS["v"][1] if axes[k][0] == "v" else np.inf)
    error = np.abs(between - rows[1::2])[inner].max(initial=0.0)
    return float(error / max(np.abs(rows[1::2][inner]).max(initial=0.0), 1e-12))


#: Quantities that are tried alone; sums and differences of speeds stand for two of them.
_PLAIN = VARIABLES[:13]
#: First letters of those whose knots are dense about zero.
_BENT = ("v", "t")


def _refusal(effect: Effect, why: str) -> ConfigError:
    """Error that names the effect."""
    return ConfigError(
        f"effect {effect.name!r} cannot be compensated in the loop: {why}; fit a model without it, "
        "or take it out of the file"
    )


@dataclass(frozen=True)
class _Part:
    """One effect on one joint with its values.

    Parameters
    ----------
    effect : Effect
        The effect.
    joint : int
        From 0.
    shape, theta : sequence of float
        Shape and coefficients.
    ends : ndarray (3, 2)
        Positions [rad].
    known : bool
        Whether `ends` are those of the identification.
    """

    effect: Effect
    joint: int
    shape: tuple[float, ...]
    theta: FloatArray
    ends: FloatArray
    known: bool

    def torque(self, motion: Motion) -> FloatArray:
        """Torque of the motion's rows [N m], (n,)."""
        columns = self.effect.columns(motion, self.joint, self.shape)
        if columns.ndim != 2 or columns.shape[1] != self.theta.size:
            raise _refusal(self.effect, "it acts on the whole robot")
        out: FloatArray = columns @ self.theta
        return out

    def axes(self) -> list[str]:
        """Quantities it depends on, at most two; found by trying.

        Raises
        ------
        ConfigError
            If it has a memory, or needs what the loop does not know.
        """
        if "motor" not in self.effect.scope.explains:
            raise _refusal(
                self.effect, "it is a part of the measured force, not of a motor's torque"
            )
        base = _made_up(self.ends)
        plain, half = self.torque(base), _ROWS // 2
        for rows, kept in ((slice(1, half), slice(half, None)), (slice(half, None), slice(half))):
            # whatever happened before, or will happen
            if not _same(self.torque(_stirred(base, rows))[kept], plain[kept]):
                raise _refusal(self.effect, "it has a memory for which the loop has no kernel")
        found = [n for n in _PLAIN if self._moves(base, plain, n)]
        other = np.random.default_rng(3).uniform(-1, 1, (_ROWS, 3))
        for name, said in _OTHERS.items():
            if not _same(self.torque(base.with_(**{name: other})), plain):
                raise _refusal(self.effect, f"it needs {said} at the very instant")
        wide = base.with_(span=1.3 * base.span)
        if not self.known and not _same(self.torque(wide), plain):
            raise _refusal(
                self.effect,
                "its coefficients are relative to the range of positions it was "
                "identified on, which the model file does not give ([valid])",
            )
        both = [n for n in VARIABLES[13:] if found == [n[:2], n[3:]]]
        found = next(([n] for n in both if self._together(base, plain, n)), found)
        if len(found) > 2:
            raise _refusal(
                self.effect, f"it depends on {', '.join(found)}, more than a table holds"
            )
        return found

    def _moves(self, base: Motion, plain: FloatArray, name: str) -> bool:
        rng = np.random.default_rng(5)
        if name == "t":
            # the sample period, between the first two instants, stays
            later = np.where(np.arange(_ROWS) < 2, 0.0, 100.0)
            return not _same(self.torque(base.with_(t=base.t + later)), plain)
        # evenly over the range, its ends included, in another order than before
        places = rng.permutation(np.linspace(*self._limits(name), _ROWS))
        return not _same(self.torque(_changed(base, name, places)), plain)

    def _together(self, base: Motion, plain: FloatArray, name: str) -> bool:
        """Whether only the sum or difference of two speeds counts."""
        slip, qd = np.linspace(-1, 1, _ROWS), base.qd.copy()
        qd[:, int(name[1]) - 1] += slip
        qd[:, int(name[4]) - 1] -= slip if name[2] == "+" else -slip
        return _same(self.torque(base.with_(qd=qd)), plain)

    def _limits(self, name: str) -> tuple[float, float]:
        if name[0] == "q":
            low, high = self.ends[int(name[1]) - 1]
            return float(low), float(high)
        return _ENDS[_kind_of(name)]

    def sheet(self, axes: Sequence[str], counts: Sequence[int]) -> tuple[FloatArray, list[Any]]:
        """Torques at the knots, and start, step and count of each axis."""
        marks, places = [], []
        for name, count in zip(axes, counts, strict=True):
            low, high = self._limits(name)
            if name[0] in _BENT:
                low, high = math.asinh(low / BEND), math.asinh(high / BEND)
            marks.append((low, (high - low) / (count - 1), count))
            u = np.linspace(low, high, count)
            places.append(BEND * np.sinh(u) if name[0] in _BENT else u)
        return self.at(axes, places), marks

    def at(self, axes: Sequence[str], places: Sequence[FloatArray]) -> FloatArray:
        """Torques on a grid of places, the shape of the grid."""
        grid = np.array(list(product(*places)))
        base = _made_up(self.ends, len(grid) + 1, still=True)
        for k, name in enumerate(axes):
            # the first row stands for the start, where time counts from
            base = _changed(base, name, np.concatenate([[0.0], grid[:, k]]))
        return self.torque(base)[1:].reshape([len(p) for p in places])


def _same(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.allclose(a, b, rtol=1e-6, atol=1e-12))


#: Speed over which the sign of the velocity is resolved [rad/s].
SIGN_SPEED = 0.02
#: Ends of the tables: positions without an identified range [rad], speeds [rad/s], torques
#: [N m] (straight on beyond), time [s].
_ENDS = {
    "q": (-2.5, 4.0),
    "v": (-30.0, 30.0),
    "load": (-1.0, 1.0),
    "gravity": (-1.0, 1.0),
    "t": (0.0, 1800.0),
}
_ROWS = 400
_OTHERS = {"qdd": "an acceleration", "temperature": "a motor temperature", "tau_ext": "a force"}
_FIELDS = {"q": "q", "v": "qd", "load": "load", "gravity": "static"}


def _kind_of(name: str) -> str:
    """Row of `_ENDS` and `_KNOTS`."""
    return name[0] if name[0] in "qvt" else name.rstrip("123")


def _changed(motion: Motion, name: str, values: FloatArray) -> Motion:
    """The motion with one quantity replaced; the torque before compensation is load and command."""
    if name == "t":
        return motion.with_(t=values)
    # a sum or difference is its first speed where the second one rests
    name = name[:2] if name[0] == "v" else name
    kind, at, changes = name[:-1], int(name[-1]) - 1, {}
    for key in (_FIELDS[kind], *(("tau",) if kind == "load" else ())):
        array = getattr(motion, key).copy()
        array[:, at] = values
        changes[key] = array
    return motion.with_(**changes)


def _stirred(motion: Motion, rows: slice) -> Motion:
    """The motion with other values of everything but time in some rows."""
    changes = {}
    for key in (*_FIELDS.values(), "tau", *_OTHERS):
        array = getattr(motion, key).copy()
        array[rows] = array[rows][::-1] * 0.7
        changes[key] = array
    return motion.with_(**changes)


def _made_up(ends: FloatArray, n: int = _ROWS, still: bool = False) -> Motion:
    """Waves of every quantity within its range, four seconds long; or all at rest in the middle."""
    rng = np.random.default_rng(1)

    def fill(low: Any, high: Any) -> FloatArray:
        phase = rng.uniform(0, 2 * np.pi, (4, 3)), rng.uniform(0.01, 0.6, (4, 3))
        waves = np.sin(phase[0] + phase[1] * np.arange(n)[:, None, None]).sum(axis=1) / 2
        middle, half = np.add(low, high) / 2, np.subtract(high, low) / 2
        return np.asarray(middle + (0.0 if still else 1.0) * half * np.clip(waves, -1, 1))

    load = fill(-0.5, 0.5)
    return Motion(
        t=1e-2 * np.arange(n, dtype=np.float64),
        q=fill(*ends.T),
        qd=fill(-1, 1),
        qdd=fill(-1, 1),
        tau=load,
        tau_ext=fill(-1, 1),
        load=load,
        static=fill(-0.3, 0.3),
        v0=np.full(3, SIGN_SPEED),
        resolution=np.full(3, 1e-3),
        span=np.array(ends),
        contact=np.full((3, 2), np.nan),
        robot=Premium(()),
        temperature=fill(20, 40) if not still else np.zeros((n, 3)),
    )
