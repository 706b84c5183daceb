"""Check that an effect keeps the contract which fitting, ranking and reporting rely on.

It is checked on seeded, smooth motions with exact derivatives.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields

import numpy as np

from hil.errors import HilError, in_short, plural, unknown
from hil.models import catalogue
from hil.models.catalogue import misdeclared
from hil.models.effect import Effect, Fitted, Param, refused, terms_of
from hil.models.motion import FloatArray, Motion
from hil.models.phantom import Premium
from hil.models.robots import IndependentAxes, Robot


def sample_motions(n: int = 2000) -> Iterator[tuple[str, Motion]]:
    """Motions on which effects are checked: label and motion.

    Parameters
    ----------
    n : int
        Instants of each motion.

    Yields
    ------
    str, Motion
        1 to 3 joints, moving and at standstill, with and without an external effort and a
        known surface; the three-joint robot has geometry.  Three joints without, and one joint
        over several turns.
    """
    for d in (1, 2, 3):
        names = tuple(f"joint{k + 1}" for k in range(d))
        robot: Robot = _Geared(names) if d == 3 else IndependentAxes(names)
        for seed, external in ((d, False), (10 + d, True)):
            what = "with" if external else "without"
            yield (
                f"{plural(d, 'joint')} moving, {what} external effort",
                _moving(robot, n, seed, external),
            )
        yield f"{plural(d, 'joint')} at standstill", _still(robot, n)
    yield (
        "3 joints without geometry",
        _moving(IndependentAxes(("joint1", "joint2", "joint3")), n, 31, False),
    )
    yield (
        "1 joint over several turns",
        _moving(IndependentAxes(("joint1",)), n, 21, False, turns=3.0),
    )


class _Geared(Premium):
    """Three joints with geometry, and rotors that are not part of the links' inertias."""

    has_armature = True


def _moving(robot: Robot, n: int, seed: int, external: bool, turns: float = 0.0) -> Motion:
    """Sum of seeded random sines up to 3 Hz, with exact derivatives; over some turns, if asked."""
    rng, d = np.random.default_rng(seed), len(robot.joints)
    t = np.arange(n, dtype=np.float64) / 128.0
    w = 2 * np.pi * rng.uniform(0.1, 3.0, (d, 8))
    size, phase = rng.normal(0.0, 0.3, (d, 8)) / w, rng.uniform(0, 2 * np.pi, (d, 8))
    angle = w[None] * t[:, None, None] + phase[None]
    q = np.sum(size * np.sin(angle), axis=2)
    qd = np.sum(size * w * np.cos(angle), axis=2)
    qdd = -np.sum(size * w**2 * np.sin(angle), axis=2)
    if turns:
        q, qd, qdd = (x * (2 * np.pi * turns / np.ptp(q)) for x in (q, qd, qdd))
    tau = 0.1 * qdd + 0.05 * np.tanh(qd / 0.01) + 0.01 * q
    push = 0.2 * np.sin(2.0 * np.pi * 0.7 * t)[:, None] * np.ones(d) if external else 0.0 * q
    middle = np.stack([q.mean(axis=0), np.where(np.arange(d) % 2, -1.0, 1.0)], axis=1)
    contact = middle if external else np.full((d, 2), np.nan)
    return _motion(robot, t, (q, qd, qdd), tau, push, contact)


def _still(robot: Robot, n: int) -> Motion:
    t, d = np.arange(n, dtype=np.float64) / 128.0, len(robot.joints)
    q, zero = np.full((n, d), 0.3), np.zeros((n, d))
    contact = np.tile([0.3, 1.0], (d, 1))
    return _motion(robot, t, (q, zero, zero.copy()), zero.copy(), zero.copy(), contact)


def _motion(
    robot: Robot,
    t: FloatArray,
    state: tuple[FloatArray, FloatArray, FloatArray],
    tau: FloatArray,
    push: FloatArray,
    contact: FloatArray,
) -> Motion:
    q, qd, qdd = state
    speed = np.sqrt(np.mean(qd**2, axis=0))
    return Motion(
        t=t,
        q=q,
        qd=qd,
        qdd=qdd,
        tau=tau,
        tau_ext=push,
        load=0.1 * qdd + 0.05 * q - push,
        static=0.05 * q,
        v0=np.maximum(0.01 * speed, 1e-9),
        resolution=np.maximum(0.005 * speed, 1e-9),
        span=np.stack([q.min(axis=0), q.max(axis=0)], axis=1),
        contact=contact,
        robot=robot,
        temperature=20.0 + 0.1 * t[:, None] + 0.0 * q,
        wrench=_wrench(robot, t, push),
        response=_Stiff(*q.shape),
    )


class _Stiff:
    """A model of one inertia, stiffness and friction for all joints."""

    def __init__(self, n: int, d: int) -> None:
        unit: FloatArray = np.broadcast_to(np.eye(d), (n, d, d)).copy()
        self.inertia, self.gradient, self.damping = 0.1 * unit, 0.05 * unit, np.full(d, 0.02)
        self.rotor: FloatArray = np.zeros(d)
        self.tilt: FloatArray = np.broadcast_to(
            0.05 * np.cos(np.arange(n))[:, None, None], (n, d, 2)
        )
        self._n, self._d = n, d

    def weight(self, j: int) -> FloatArray:
        """As the stiffness."""
        return np.ascontiguousarray(self.gradient[:, j, j])

    def slope(self, j: int) -> FloatArray:
        """As the stiffness."""
        return self.gradient[:, :, j]

    def coriolis(self, j: int) -> FloatArray:
        """Of an inertia that is the same everywhere."""
        return np.zeros((self._n, self._d))

    def unslipped(self, j: int) -> FloatArray:
        """A jump in the middle."""
        out = np.zeros((self._n, self._d))
        out[self._n // 2 :, j] = -0.05 * 1e-3
        return out


def _wrench(robot: Robot, t: FloatArray, push: FloatArray) -> FloatArray:
    """A force that turns, for the robot that has a tip; no rows otherwise."""
    if not isinstance(robot, Premium) or not np.any(push):
        return np.zeros((0, 6))
    angle = 2 * np.pi * 0.3 * t
    zero = np.zeros_like(t)
    return np.stack([np.sin(angle), np.cos(angle), 0.5 + zero, zero, zero, zero], axis=1)


__all__ = ["FAMILIES", "ConformanceError", "check_effect", "sample_motions"]

FAMILIES = (
    "friction",
    "transmission",
    "actuator",
    "mass",
    "stiffness",
    "sensor",
    "structure",
    "contact",
    "correction",
)
#: Texts and tuples that a declaration holds: its part ("": the class itself), then their names.
_TEXTS = {"": ("name", "family"), "doc": ("equation", "signature", "shown_by", "source")}
_TUPLES = {
    "": ("params", "shape"),
    "doc": ("confused_with",),
    "scope": ("explains",),
    "relations": ("replaces", "twins", "causes"),
}
_EFFORTS = ("motor", "external")
_KEBAB = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


class ConformanceError(HilError, AssertionError):
    """An effect breaks the contract of `hil.models.effect.Effect`."""


def check_effect(effect: Effect) -> None:
    """Check that an effect can be fitted, ranked, added and reported like a built-in one.

    Its declaration is read, then its columns are evaluated for robots of one to three joints
    on seeded random smooth motions and at standstill, with and without an external effort and
    a known surface.  Nothing is returned: an effect that passes passes silently.

    Parameters
    ----------
    effect : Effect
        Instance, built in or a user's own.

    Raises
    ------
    ConformanceError
        With a sentence that says what is wrong and what was expected.

    Examples
    --------
    >>> from hil.models import catalogue
    >>> check_effect(catalogue.get("stribeck"))
    """
    if not isinstance(effect, Effect):
        raise ConformanceError(
            f"{effect!r} is not an instance of hil.models.effect.Effect; "
            "EFFECTS holds instances, e.g. EFFECTS = (MyEffect(),)"
        )
    _declaration(effect)
    tried = 0
    for label, motion in sample_motions():
        joints = range(1) if effect.scope.of_robot else range(motion.d)
        tried += sum(_on_joint(effect, motion, j, f"{label}, joint {j + 1}") for j in joints)
    if not tried:
        raise ConformanceError(
            f"effect {effect.name!r} is not available on any of the sample motions (1 to 3 "
            "joints, with and without external effort); 'scope.lacks' must return '' where it acts"
        )


def _declaration(effect: Effect) -> None:
    kind = type(effect).__name__
    if said := misdeclared(effect):
        raise ConformanceError(said)
    for name, value in _declared(effect, _TEXTS):
        if not isinstance(value, str) or not value.strip():
            raise ConformanceError(f"{kind}.{name} must be a non-empty text, got {value!r}")
    if not _KEBAB.fullmatch(effect.name):
        raise ConformanceError(
            f"{kind}.name is {effect.name!r}; expected kebab-case, e.g. 'cable-creep'"
        )
    if effect.family not in FAMILIES:
        raise ConformanceError(
            f"{kind}.family is {effect.family!r}; expected one of {', '.join(FAMILIES)}"
        )
    for name, value in _declared(effect, _TUPLES):
        if not isinstance(value, tuple):
            raise ConformanceError(f"{kind}.{name} must be a tuple, got {value!r}")
    efforts = effect.scope.explains
    if not efforts or not set(efforts) <= set(_EFFORTS):
        raise ConformanceError(
            f"{kind}.scope.explains is {efforts!r}; expected 'motor', 'external' or both"
        )
    _names_of_others(effect)
    _parameters(effect, (*effect.params, *effect.shape))


def _declared(effect: Effect, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, object]]:
    """Attributes by their names as they are written, e.g. ``doc.equation``, and their values."""
    for part, names in wanted.items():
        owner = getattr(effect, part) if part else effect
        for name in names:
            yield f"{part}.{name}".lstrip("."), getattr(owner, name)


def _names_of_others(effect: Effect) -> None:
    if effect.name in effect.relations.replaces or effect.name in effect.doc.confused_with:
        raise ConformanceError(f"effect {effect.name!r} replaces or is confused with itself")
    known = {*catalogue.table(), effect.name, ""}
    twins = (t.name for t in effect.relations.twins)
    others = (*effect.relations.replaces, *twins, effect.relations.limit)
    for name in (*effect.doc.confused_with, *others):
        if name not in known:
            raise ConformanceError(
                f"effect {effect.name!r} names "
                + unknown("effect", name, known)
                + "; of a file of your own load all effects first (catalogue.load_plugin)"
            )


def _parameters(effect: Effect, params: Sequence[Param]) -> None:
    seen: set[str] = set()
    for p in params:
        if not isinstance(p, Param):
            raise ConformanceError(f"effect {effect.name!r}: {p!r} is not a Param")
        what = f"effect {effect.name!r}: parameter {p.name!r}"
        if not p.name or re.search(r"[\s.\[\]]", p.name):
            raise ConformanceError(f"{what} needs a name without spaces, dots and brackets")
        if p.name in seen:
            raise ConformanceError(f"{what} is declared twice")
        if not p.unit.strip():
            raise ConformanceError(f"{what} has no unit; write '1' for a pure number")
        if not p.text.strip():
            raise ConformanceError(f"{what} has no text that says what it is")
        if not p.lower < p.upper:
            raise ConformanceError(
                f"{what} has bounds {p.lower} .. {p.upper}; expected lower < upper"
            )
        seen.add(p.name)


def _on_joint(effect: Effect, motion: Motion, j: int, where: str) -> bool:
    """Check one joint of one motion; False where the effect is not available."""
    head = f"effect {effect.name!r} ({where})"
    arrays = {f.name: getattr(motion, f.name) for f in fields(motion)}
    before = {k: v.copy() for k, v in arrays.items() if isinstance(v, np.ndarray)}
    try:
        with warnings.catch_warnings(), np.errstate(divide="raise", over="raise", invalid="raise"):
            warnings.simplefilter("error")
            tried = _evaluate(effect, motion, j, head)
    except ConformanceError:
        raise
    except Exception as error:
        raise ConformanceError(f"{head} fails with {in_short(error)}") from error
    for name, value in before.items():
        if not np.array_equal(value, getattr(motion, name), equal_nan=True):
            raise ConformanceError(f"{head} modifies its input motion.{name}; work on a copy")
    return tried


def _evaluate(effect: Effect, motion: Motion, j: int, head: str) -> bool:
    reason = effect.scope.lacks(motion, j)
    if not isinstance(reason, str):
        raise ConformanceError(f"{head}: 'scope.lacks' returned {reason!r}, expected a text")
    if reason:
        return False
    terms = terms_of(effect, motion, j)
    if not terms:
        raise ConformanceError(f"{head} has no coefficients; declare 'params' or 'scope.terms'")
    _parameters(effect, (*terms, *effect.shape))
    shapes = _grid(effect, motion, j, head)
    for shape in dict.fromkeys((shapes[0], shapes[len(shapes) // 2], shapes[-1])):
        _columns(effect, motion, j, shape, len(terms), head)
        _credible(effect, motion, j, shape, terms, head)
    return True


def _credible(
    effect: Effect,
    motion: Motion,
    j: int,
    shape: tuple[float, ...],
    terms: Sequence[Param],
    head: str,
) -> None:
    """What cannot be physics is no finding: a value beyond its bounds least of all."""
    inside = [float(np.clip(1.0, p.lower, p.upper)) for p in terms]
    for error in ((), [0.1] * len(terms)):
        for limit in effect.limits:
            said = limit.met(Fitted(effect, motion, j, shape, inside, error))
            if not isinstance(said, bool | np.bool_):
                raise ConformanceError(
                    f"{head}: limit {limit.code!r} returned {said!r}, expected True or False"
                )
    for k, p in enumerate(effect.params if len(effect.params) == len(terms) else ()):
        beyond = [(p.lower, -1.0), (p.upper, 1.0)]
        for value in (b + side * (1.0 + abs(b)) for b, side in beyond if np.isfinite(b)):
            beta = [*inside[:k], value, *inside[k + 1 :]]
            if not refused(effect, motion, j, shape, beta, [0.0] * len(terms)):
                raise ConformanceError(
                    f"{head}: 'limits' accept {p.name} = {value}, beyond its bounds {p.lower} "
                    f".. {p.upper}; limits of your own stand beside BOUNDS"
                )
    for columns in effect.relations.foils(motion, j, shape):
        if np.shape(columns)[:1] != (motion.n,) or not np.all(np.isfinite(columns)):
            raise ConformanceError(
                f"{head}: a foil has shape {np.shape(columns)} or values that are not finite; "
                f"expected ({motion.n}, m)"
            )


def _grid(effect: Effect, motion: Motion, j: int, head: str) -> list[tuple[float, ...]]:
    shapes = [tuple(s) for s in effect.search.grid(motion, j)]
    if not shapes:
        raise ConformanceError(f"{head} is available but its grid is empty")
    for shape in shapes:
        if len(shape) != len(effect.shape):
            raise ConformanceError(
                f"{head}: grid point {shape} has {len(shape)} values for "
                f"{len(effect.shape)} shape parameters"
            )
        for p, value in zip(effect.shape, shape, strict=True):
            if not np.isfinite(value) or not p.lower <= value <= p.upper:
                raise ConformanceError(
                    f"{head}: grid value {p.name} = {value} is not finite or outside the declared "
                    f"bounds {p.lower} .. {p.upper}"
                )
    return shapes


def _columns(
    effect: Effect, motion: Motion, j: int, shape: tuple[float, ...], count: int, head: str
) -> None:
    values = np.asarray(effect.columns(motion, j, shape))
    rows = (motion.n, motion.d) if effect.scope.whole else (motion.n,)
    if values.shape != (*rows, count):
        raise ConformanceError(
            f"{head}: columns have shape {values.shape}, expected {(*rows, count)} "
            f"for {count} coefficients"
        )
    if values.dtype != np.float64:
        raise ConformanceError(f"{head}: columns are {values.dtype}, expected float64")
    if not np.all(np.isfinite(values)):
        raise ConformanceError(f"{head}: columns are not finite for shape {shape}")
    kept = values.copy()
    if not np.array_equal(kept, effect.columns(motion, j, shape)):
        raise ConformanceError(f"{head}: two calls with the same input give different columns")
    # the shift is a power of two, so that rounding leaves the period as it is
    later = effect.columns(motion.with_(t=motion.t + 64.0), j, shape)
    if not np.allclose(kept, later, rtol=1e-6, atol=1e-9 * max(float(np.abs(kept).max()), 1e-300)):
        raise ConformanceError(
            f"{head}: columns change when the time axis is shifted; use time since motion.t[0]"
        )
