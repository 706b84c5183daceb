"""The plan: which effect is hidden where, how large, under which noise and motion.

`rig_plan` is that of the tuning plants, `mujoco_plan` that of the test plants: every effect on
robot after robot, at three levels.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.bench.diagnosis import amplitudes, session, tables
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import RobotModel, base_model
from hil.record.recording import RobotSource

_LEVELS = amplitudes.EXCESS_LEVELS["tuning"]
_NOISES = ("white", "coloured")
EXCITATIONS = ("repeated", "strokes")
SEEDS_PER_CASE, _FEWER = 10, 3
#: Seeds of sessions with nothing hidden: without a false alarm in 208, its rate is below 2 %.
_NOTHING = 32
#: Effects of sensors: half the seeds.
_SENSORS = ("force-", "encoder-", "missed-", "filter-")
#: Pairs of effects that are hidden together, and whether on one joint.
_PAIRS = (
    ("stribeck", "cogging"),
    ("quadratic-drag", "position-friction"),
    ("end-stop", "stribeck"),
    ("asymmetric-viscous", "cogging"),
    ("presliding", "position-torque"),
    ("coupled-friction", "quadratic-drag"),
    ("delay", "position-torque"),
    ("position-friction", "end-stop"),
)


@dataclass(frozen=True)
class HiddenEffect:
    """One hidden effect: its name, its joint (from 0) and the excess it leaves [floors]."""

    effect: str
    joint: int
    level: float

    @property
    def label(self) -> str:
        """Joint as a diagnosis names it."""
        return f"joint{self.joint + 1}"


@dataclass(frozen=True)
class LastPair(HiddenEffect):
    """A pair of the last joint and the one before, which belongs to that one."""

    @property
    def label(self) -> str:
        """Joint as a diagnosis names it."""
        return f"joint{self.joint}"


@dataclass(frozen=True)
class Idler(HiddenEffect):
    """The pair (1, 3) of idlers of the tuning plants, which belongs to its first joint."""

    @property
    def label(self) -> str:
        """Joint as a diagnosis names it."""
        return "joint1"


@dataclass(frozen=True)
class SessionCase:
    """One recording session to be diagnosed.

    Parameters
    ----------
    kind : str
        ``"one"``, ``"two"``, ``"none"`` or ``"outside"`` (also: not yet in the catalogue).
    robot : str
        ``"arm"`` (three joints), ``"axis"`` (the turntable alone), or a robot of the test plants.
    hidden : tuple of Hidden
    noise, excitation : str
    seed : int
        Of motion and noise.
    force : bool
        Whether a force acts at the tip and is measured.
    """

    kind: str
    robot: str
    hidden: tuple[HiddenEffect, ...]
    noise: str
    excitation: str
    seed: int
    force: bool = False

    @property
    def plant(self) -> str:
        """``"tuning"`` or ``"test"``."""
        return session.plant_of_robot(self.robot)

    @property
    def name(self) -> str:
        """Key of the case in the results."""
        what = "+".join(f"{h.effect}@{h.joint + 1}x{h.level:g}" for h in self.hidden) or "none"
        force = "/force" if self.force else ""
        return f"{what}/{self.robot}/{self.noise}/{self.excitation}/{self.seed}{force}"


#: Effects that an offset of the base model would take up: the model under suspicion lacks it there.
_OFFSETS = ("torque-offset", "asymmetric-coulomb")


def suspected(case: SessionCase, robot: RobotSource) -> RobotModel:
    """The model under suspicion: the base model, without an offset where an offset is hidden."""
    model = base_model(robot)
    hidden = any(h.effect in _OFFSETS for h in case.hidden)
    return model - "torque-offset" if hidden else model


def known() -> set[str]:
    """Effects that a diagnosis of motor effort can name at present."""
    table = catalogue.table().values()
    return {e.name for e in table if Trait.GIVEN not in e.traits and "motor" in e.scope.explains}


def rig_plan(quick: bool = False, seeds: int = SEEDS_PER_CASE) -> list[SessionCase]:
    """All cases of the tuning plants; where `quick`, every effect at two of the levels, or at one.

    Effects that are not in the catalogue count as outside, with fewer seeds; sensors have half.
    """
    if quick:
        return _quick()
    # false alarms are rare: their number is not cut with the seeds
    there, found = known(), nothing_hidden(range(_NOTHING))
    for effect in session.kinds_of_plant():
        count = (seeds + 1) // 2 if effect.startswith(_SENSORS) else seeds
        for seed in range(count if effect in there else min(seeds, _FEWER)):
            for level in _LEVELS:
                for noise in _NOISES:
                    found += [single(effect, level, noise, e, seed) for e in EXCITATIONS]
    return [c for c in found + two(range(min(seeds, 4)), _NOISES, (1.5, 5.0)) if _distinct(c)]


def _quick() -> list[SessionCase]:
    found = [c for c in nothing_hidden(range(2)) if (c.robot, c.force) == ("arm", False)]
    for k, effect in enumerate(session.kinds_of_plant()):
        # one level of what sensors do and of what has no name: the whole is to take minutes
        few = effect.startswith(_SENSORS) or effect not in known()
        for n, level in enumerate(_LEVELS):
            if n == k % len(_LEVELS) or (few and n == (k + 1) % len(_LEVELS)):
                continue
            noise, excitation = _NOISES[(k + n) % 2], EXCITATIONS[(k // 2 + n) % 2]
            found.append(single(effect, level, noise, excitation, (k + n) % 3))
    # every pair once: on one joint, or on two
    pairs = [c for k, c in enumerate(two(range(1), _NOISES[1:], (5.0,))) if k % 4 in (0, 3)]
    return [c for c in found + pairs if _distinct(c)]


def single(effect: str, level: float, noise: str, excitation: str, seed: int) -> SessionCase:
    """One hidden effect; its joint follows from the seed, every fifth is a single axis."""
    needs, kind = session.kinds_of_plant()[effect][0], "one" if effect in known() else "outside"
    axis = seed % 5 == 4 and not needs
    joint = 0 if axis else seed % 3
    last = effect == "coupled-transmission" and joint == 2
    hidden = ((Idler if last else HiddenEffect)(effect, joint, level),)
    robot = "axis" if axis else "arm"
    return SessionCase(kind, robot, hidden, noise, excitation, seed, needs == "force")


def _distinct(case: SessionCase) -> bool:
    """Whether no smaller level has the same amplitude, the largest there is."""
    for h in case.hidden:
        levels = amplitudes.EXCESS_LEVELS[case.plant]
        steps = [
            amplitudes.amplitude(h.effect, h.joint, case.robot, case.excitation, x)
            for x in levels[: levels.index(h.level) + 1]
        ]
        if len(steps) > 1 and steps[-1] < 1.02 * steps[-2]:
            return False
    return True


def nothing_hidden(seeds: range) -> list[SessionCase]:
    """Sessions with no hidden effect: arm, single axis, arm with a measured force."""
    arms = (("arm", False), ("axis", False), ("arm", True))
    return [
        SessionCase("none", robot, (), noise, excitation, seed, force)
        for seed in seeds
        for noise in _NOISES
        for excitation in EXCITATIONS
        for robot, force in arms
        if (robot, force) == ("arm", False) or seed < len(seeds) // 3
    ]


def two(seeds: range, noises: tuple[str, ...], levels: tuple[float, ...]) -> list[SessionCase]:
    """Two hidden effects, on one joint and on two."""
    found = []
    for k, (a, b) in enumerate(_PAIRS):
        if not {a, b} <= known():
            continue
        for seed in seeds:
            for n, level in enumerate(levels):
                first = (seed + k) % 3
                for second in (first, (first + 1) % 3):
                    hidden = (HiddenEffect(a, first, level), HiddenEffect(b, second, level))
                    noise = noises[(seed + n) % len(noises)]
                    excitation = EXCITATIONS[(seed + k) % 2]
                    found.append(SessionCase("two", "arm", hidden, noise, excitation, 100 + seed))
    return found


_MUJOCO_LEVELS = amplitudes.EXCESS_LEVELS["test"]
_MUJOCO_NOISES = ("white", "coloured", "dac")
_MUJOCO_MOTIONS = ("wander", "shuttle", "points")
#: Effects whose pair of joints starts at any joint but the last.
_PAIRED = ("coupled-transmission", "coupled-spring")
#: Effects on two neighbours, hidden on any joint and named on the earlier one.
_UNORDERED = ("differential",)
#: Of the quick plan: robots whose sessions take least.
_SMALL_ROBOTS = ("elbow3", "pendulum", "planar2", "spindle", "stylus3", "scara4", "gantry2")


def mujoco_plan(quick: bool = False, seeds: int = 10) -> list[SessionCase]:
    """All cases; with ten seeds every effect has been on every robot that can show it.

    Where `quick`, every effect once, at one of the levels, and seven sessions with nothing hidden.
    """
    if quick:
        return _quick_mujoco()
    found = _mujoco_nothing(range(2 if seeds > 2 else 1))
    for k, effect in enumerate(session.kinds_of_plant("test")):
        for seed in range(seeds):
            found += [_mujoco_single(k, effect, level, seed) for level in _MUJOCO_LEVELS]
    return [
        c for c in found + _mujoco_two(range(min(seeds, 4))) if not _calibrated(c) or _distinct(c)
    ]


def _calibrated(case: SessionCase) -> bool:
    """Whether its amplitudes are in the file; a plan does not wait for others."""
    known = amplitudes.amplitude_table("test")
    where = (case.robot, case.excitation)
    return all(amplitudes.name(h.effect, h.joint, *where) in known for h in case.hidden)


def _quick_mujoco() -> list[SessionCase]:
    found = [c for k, c in enumerate(_mujoco_nothing(range(1))) if k % 13 == 0]
    for k, effect in enumerate(session.kinds_of_plant("test")):
        found.append(_mujoco_single(k, effect, _MUJOCO_LEVELS[1 + k % 2], k % 7, _SMALL_ROBOTS))
    return found


def _mujoco_single(
    k: int, effect: str, level: float, seed: int, among: tuple[str, ...] = ()
) -> SessionCase:
    """Effect number `k`, hidden; robot, joint, motion and noise follow from it and the seed."""
    needs = session.kinds_of_plant("test")[effect][0]
    robots = [r for r in session.robots_showing(needs) if not among or r in among]
    robot = robots[(k + seed) % len(robots)]
    joint = _joint(effect, robot, k + seed + seed // len(robots))
    kind = "one" if tables.accepted(effect) & known() else "outside"
    motion = _MUJOCO_MOTIONS[(k + seed + seed // len(robots)) % len(_MUJOCO_MOTIONS)]
    noise = _MUJOCO_NOISES[(k + 2 * seed + _MUJOCO_LEVELS.index(level)) % len(_MUJOCO_NOISES)]
    last = effect in _UNORDERED and joint == session.joint_count(robot) - 1
    hidden = ((LastPair if last else HiddenEffect)(effect, joint, level),)
    return SessionCase(kind, robot, hidden, noise, motion, seed, needs == "force")


def _joint(effect: str, robot: str, n: int) -> int:
    """A joint on which the effect has its joint's name."""
    return n % (session.joint_count(robot) - (effect in _PAIRED))


def _mujoco_nothing(seeds: range) -> list[SessionCase]:
    """Sessions with no hidden effect: every robot, motion and noise."""
    return [
        SessionCase("none", robot, (), noise, motion, 50 + seed)
        for seed in seeds
        for motion in _MUJOCO_MOTIONS
        for noise in _MUJOCO_NOISES
        for robot in session.robots_showing("")
    ]


def _mujoco_two(seeds: range) -> list[SessionCase]:
    """Two hidden effects on one joint, or on two, of a robot that has them."""
    found, robots = [], session.robots_showing("arm")
    for k, (a, b) in enumerate(_PAIRS):
        for seed in seeds:
            robot = robots[(k + seed) % len(robots)]
            d, level = session.joint_count(robot), _MUJOCO_LEVELS[1 + seed % 2]
            first = _joint(a, robot, k + seed)
            second = first if seed % 2 else (first + 1) % d
            hidden = (HiddenEffect(a, first, level), HiddenEffect(b, second, level))
            noise, motion = _MUJOCO_NOISES[(k + seed) % 3], _MUJOCO_MOTIONS[(k + 2 * seed) % 3]
            found.append(SessionCase("two", robot, hidden, noise, motion, 100 + seed))
    return found
