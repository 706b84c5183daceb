"""The plan on the test plants: every effect on robot after robot, at three levels."""

from __future__ import annotations

from hil.bench.diagnosis import amplitudes, figures, session, testplants
from hil.bench.diagnosis.cases import PAIRS, Case, Hidden, distinct, known

LEVELS = amplitudes.LEVELS["test"]
NOISES = ("white", "coloured", "dac")
MOTIONS = ("wander", "shuttle", "points")
#: Effects whose pair of joints starts at any joint but the last.
PAIRED = ("coupled-transmission",)
#: Of the quick plan: robots whose sessions take least.
SMALL = ("elbow3", "pendulum", "planar2", "spindle", "stylus3", "scara4", "gantry2")


def plan(quick: bool = False, seeds: int = 10) -> list[Case]:
    """All cases; with ten seeds every effect has been on every robot that can show it.

    Where `quick`, every effect once, at one of the levels, and seven sessions with nothing hidden.
    """
    if quick:
        return _quick()
    found = nothing(range(2 if seeds > 2 else 1))
    for k, effect in enumerate(session.kinds("test")):
        for seed in range(seeds):
            found += [single(k, effect, level, seed) for level in LEVELS]
    return [c for c in found + two(range(min(seeds, 4))) if not _calibrated(c) or distinct(c)]


def _calibrated(case: Case) -> bool:
    """Whether its amplitudes are in the file; a plan does not wait for others."""
    known = amplitudes.table("test")
    where = (case.robot, case.excitation)
    return all(amplitudes.name(h.effect, h.joint, *where) in known for h in case.hidden)


def _quick() -> list[Case]:
    found = [c for k, c in enumerate(nothing(range(1))) if k % 13 == 0]
    for k, effect in enumerate(session.kinds("test")):
        found.append(single(k, effect, LEVELS[1 + k % 2], k % 7, SMALL))
    return found


def single(k: int, effect: str, level: float, seed: int, among: tuple[str, ...] = ()) -> Case:
    """Effect number `k`, hidden; robot, joint, motion and noise follow from it and the seed."""
    needs = session.kinds("test")[effect][0]
    robots = [r for r in testplants.fitting(needs) if not among or r in among]
    robot = robots[(k + seed) % len(robots)]
    joint = _joint(effect, robot, k + seed + seed // len(robots))
    kind = "one" if figures.accepted(effect) & known() else "outside"
    motion = MOTIONS[(k + seed + seed // len(robots)) % len(MOTIONS)]
    noise = NOISES[(k + 2 * seed + LEVELS.index(level)) % len(NOISES)]
    return Case(kind, robot, (Hidden(effect, joint, level),), noise, motion, seed, needs == "force")


def _joint(effect: str, robot: str, n: int) -> int:
    """A joint on which the effect has its joint's name."""
    return n % (testplants.joints(robot) - (effect in PAIRED))


def nothing(seeds: range) -> list[Case]:
    """Sessions with no hidden effect: every robot, motion and noise."""
    return [
        Case("none", robot, (), noise, motion, 50 + seed)
        for seed in seeds
        for motion in MOTIONS
        for noise in NOISES
        for robot in testplants.fitting("")
    ]


def two(seeds: range) -> list[Case]:
    """Two hidden effects on one joint, or on two, of a robot that has them."""
    found, robots = [], testplants.fitting("arm")
    for k, (a, b) in enumerate(PAIRS):
        for seed in seeds:
            robot = robots[(k + seed) % len(robots)]
            d, level = testplants.joints(robot), LEVELS[1 + seed % 2]
            first = _joint(a, robot, k + seed)
            second = first if seed % 2 else (first + 1) % d
            hidden = (Hidden(a, first, level), Hidden(b, second, level))
            noise, motion = NOISES[(k + seed) % 3], MOTIONS[(k + 2 * seed) % 3]
            found.append(Case("two", robot, hidden, noise, motion, 100 + seed))
    return found
