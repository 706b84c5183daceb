"""The menu of safe motions from which the best one for a question is chosen.

Each isolates one factor: speed, direction, position, load, frequency, the other joints' motion.
Paths are built from strokes at constant speed and rests.

Sources: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994 (strokes, reversals);
Swevers, Verdonck, De Schutter, IEEE Control Systems 27(5), 2007 (periodic excitation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hil.excite.stage import Space
from hil.excite.trajectory import Trajectory

#: Time to go from rest to the largest speed, and the shortest rounding of a corner [s].
RISE, SHORTEST = 0.2, 0.04
#: Shortest move, and shortest move between two sets of strokes [s].
QUICKEST, UNHURRIED = 0.05, 0.5


class Path:
    """Via points with times, from the middle posture on.

    Parameters
    ----------
    space : Space
        Room and speeds.
    """

    def __init__(self, space: Space) -> None:
        self.space = space
        self.times: list[float] = [0.0]
        self.points: list[FloatArray] = [space.center.copy()]

    @property
    def time(self) -> float:
        """Length so far [s]."""
        return self.times[-1]

    def to(self, target: FloatArray, speed: float, least: float = QUICKEST) -> None:
        """Go straight to a posture; the joint that needs longest moves at `speed` of its most."""
        needed = np.abs(target - self.points[-1]) / (speed * self.space.speed)
        if np.any(needed > 1e-9):
            self._add(target, max(float(np.max(needed)), least))

    def rest(self, seconds: float) -> None:
        """Stay."""
        self._add(self.points[-1], max(seconds, QUICKEST))

    def _add(self, target: FloatArray, seconds: float) -> None:
        self.times.append(self.time + seconds)
        self.points.append(np.array(target, dtype=np.float64))

    def posture(self, places: dict[int, float]) -> FloatArray:
        """Middle posture with some joints elsewhere."""
        q = self.space.center.copy()
        for j, value in places.items():
            q[j] = value
        return q

    def strokes(self, ends: tuple[FloatArray, FloatArray], speed: float, seconds: float) -> None:
        """To and fro between two postures at constant speed for about `seconds`.

        Where the time is too short for the whole way, a shorter way about its middle.
        """
        a, b = ends
        whole = float(np.max(np.abs(b - a) / self.space.speed)) / speed
        share = min(1.0, seconds / 2 / max(whole, 1e-9))
        middle = (a + b) / 2
        low, high = middle + share * (a - middle), middle + share * (b - middle)
        self.to(low, max(speed, 0.3), UNHURRIED)
        for _ in range(max(1, round(seconds / 2 / max(share * whole, QUICKEST)))):
            self.to(high, speed)
            self.to(low, speed)

    def closed(self, name: str, seconds: float) -> Trajectory:
        """The path as a trajectory: back to its start, repeated to fill about `seconds`."""
        self.to(self.space.center, 0.3, UNHURRIED)
        self.rest(0.3)
        rounds = max(1, int(seconds / self.time))
        t, q = np.array(self.times), np.array(self.points)
        times = np.concatenate([[0.0], *(k * self.time + t[1:] for k in range(rounds))])
        via = np.concatenate([q[:1], *(q[1:] for _ in range(rounds))])
        robot = self.space.robot
        return Trajectory(
            tuple(robot.joints),
            tuple(robot.units),
            float(times[-1]),
            times,
            via,
            _blends(times, via, self.space.speed),
            np.zeros((len(robot.joints), 0, 2)),
            name,
        )


def _blends(times: FloatArray, via: FloatArray, speed: FloatArray) -> FloatArray:
    """Rounding of each corner: in proportion to its change of speed, never meeting the next."""
    gaps = np.diff(times)
    slope = np.diff(via, axis=0) / gaps[:, None]
    change = np.abs(np.diff(np.concatenate([slope[-1:], slope, slope[:1]]), axis=0))
    wanted = np.maximum(RISE * np.max(change / speed, axis=1), SHORTEST)
    room = np.minimum(np.concatenate([gaps[-1:], gaps]), np.concatenate([gaps, gaps[:1]]))
    out: FloatArray = np.minimum(wanted, room)
    return out


def series(
    space: Space, values: FloatArray, period: float, name: str, highest: float
) -> Trajectory:
    """Trajectory about the middle posture from samples (n, d) of one period, band-limited.

    Parameters
    ----------
    highest : float
        Highest frequency kept [Hz].
    """
    n, robot = len(values), space.robot
    spectrum = np.fft.rfft(values - values.mean(axis=0), axis=0) / (n / 2)
    h = max(1, min(int(highest * period), n // 2 - 1))
    part = spectrum[1 : h + 1].T
    via = np.stack([space.center, space.center])
    return Trajectory(
        tuple(robot.joints),
        tuple(robot.units),
        period,
        np.array([0.0, period]),
        via,
        np.full(2, min(1.0, period)),
        np.stack([-part.imag, part.real], axis=-1),
        name,
    )


def joints_of(space: Space, j: int | None) -> Sequence[int]:
    """The joint in question, or all."""
    return range(space.center.size) if j is None else [j]


FloatArray = NDArray[np.float64]


def _ends(path: Path, j: int, together: bool = False) -> tuple[FloatArray, FloatArray]:
    low, high = (path.space.together if together else path.space.alone)[j]
    return path.posture({j: float(low)}), path.posture({j: float(high)})


def _at_speeds(
    space: Space, j: int | None, seconds: float, speeds: FloatArray, name: str
) -> Trajectory:
    path, joints = Path(space), joints_of(space, j)
    for i in joints:
        for v in speeds:
            path.strokes(_ends(path, i), float(v), seconds / len(speeds) / len(joints))
    return path.closed(name, seconds)


def slow_strokes(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Slow constant-speed strokes in both directions, log-spaced speeds."""
    return _at_speeds(space, j, seconds, np.geomspace(0.01, 0.15, 5), "slow-strokes")


def speed_ladder(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Constant-speed strokes in both directions from very slow to fast, log-spaced speeds."""
    return _at_speeds(space, j, seconds, np.geomspace(0.01, 1.0, 8), "speed-ladder")


def fast_strokes(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Fast strokes over the range in both directions at three speeds."""
    return _at_speeds(space, j, seconds, np.array([0.4, 0.7, 1.0]), "fast-strokes")


def range_strokes(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Slow strokes over the whole range in both directions at two speeds."""
    path, joints = Path(space), joints_of(space, j)
    share = seconds / len(joints)
    for i in joints:
        low, high = _ends(path, i)
        whole = float(high[i] - low[i]) / float(space.speed[i])
        for v in (3.0 * whole / share, 6.0 * whole / share):
            path.to(low, 0.3)
            path.to(high, min(v, 1.0))
            path.to(low, min(v, 1.0))
    return path.closed("range-strokes", seconds)


def small_reversals(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Small nested reversals in two places, slowly and quickly."""
    path = Path(space)
    for i in joints_of(space, j):
        low, high = space.alone[i]
        for place in (0.35, 0.65):
            middle = low + place * (high - low)
            for size in np.geomspace(0.04, 0.001, 4):
                half = size * (high - low) / 2
                for period, count in ((1.4, 1), (0.5, 2)):
                    v = float(min(4 * half / period / space.speed[i], 1.0))
                    for _ in range(count):
                        path.to(path.posture({i: middle + half}), v)
                        path.to(path.posture({i: middle - half}), v)
    return path.closed("small-reversals", seconds)


def rests(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Rests in many postures, slow moves between them."""
    path = Path(space)
    count = max(4, int(seconds / 2.2))
    # Kronecker sequence of the plastic number's powers: spread evenly without a grid
    step = np.array([0.7548776662, 0.5698402910, 0.3, 0.8191725134, 0.6710436067, 0.5497, 0.45])
    for k in range(count):
        x = np.mod(0.5 + (k + 1) * np.resize(step, space.center.size), 1.0)
        q = space.together[:, 0] + x * np.ptp(space.together, axis=1)
        path.to(q if j is None else path.posture({j: float(q[j])}), 0.3)
        path.rest(1.5)
    return path.closed("rests", seconds)


def one_at_a_time(space: Space, j: int | None, seconds: float) -> Trajectory:
    """One joint at a time while the others rest."""
    speeds = np.array([0.05, 0.3, 0.8])
    return _at_speeds(space, None, seconds, speeds, "one-at-a-time")


def pairs(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Pairs of joints with all combinations of signs, at two speeds."""
    path, d = Path(space), space.center.size
    couples = [(i, k) for i in joints_of(space, j) for k in range(d) if k != i]
    for i, k in couples:
        (a, b), (c, e) = space.together[i], space.together[k]
        for v in (0.15, 0.5):
            for one, two in (((a, c), (b, e)), ((a, e), (b, c))):
                ends = tuple(path.posture({i: float(p), k: float(q)}) for p, q in (one, two))
                path.strokes((ends[0], ends[1]), v, seconds / 4 / len(couples))
    return path.closed("pairs", seconds)


def postures(space: Space, j: int | None, seconds: float) -> Trajectory:
    """The same strokes in four postures of the other joints, so under several static loads."""
    path, joints = Path(space), joints_of(space, j)
    others = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    for i in joints:
        rest = [k for k in range(space.center.size) if k != i]
        for side in others:
            sides = np.resize(side, len(rest))
            where = {k: float(space.together[k, s]) for k, s in zip(rest, sides, strict=True)}
            low, high = space.together[i]
            ends = tuple(path.posture(where | {i: float(x)}) for x in (low, high))
            path.strokes((ends[0], ends[1]), 0.25, seconds / 4 / len(joints))
    return path.closed("postures", seconds)


def range_ends(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Strokes that reach both ends of the range, slowly and fast."""
    path = Path(space)
    for i in joints_of(space, j):
        low, high = space.alone[i]
        for end in (low, high):
            near = path.posture({i: float(0.6 * end + 0.4 * space.center[i])})
            for v in (0.05, 0.2, 0.7):
                path.to(near, 0.3, 0.5)
                path.to(path.posture({i: float(end)}), v)
                path.to(near, v)
    return path.closed("range-ends", seconds)


def chirp(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Sine whose frequency sweeps from 0.1 to 4 Hz and back, as large as speed allows."""
    t = np.arange(4096) / 4096
    up = 1 - np.abs(2 * t - 1)
    # f(t) = 0.1 * 40^up, phase = 2 pi times its integral
    f = 0.1 * 40.0**up
    cycles = np.cumsum(f) * seconds / t.size
    phase = 2 * np.pi * cycles * round(cycles[-1]) / cycles[-1]
    out = np.zeros((t.size, space.center.size))
    for i in joints_of(space, j):
        half = np.min(np.abs(space.together[i] - space.center[i]))
        size = np.minimum(half, 0.7 * space.speed[i] / (2 * np.pi * f))
        out[:, i] = size * np.sin(phase + 2.1 * i)
    return series(space, out, seconds, "chirp", 6.0)


def multisine(space: Space, j: int | None, seconds: float) -> Trajectory:
    """All joints at once, many frequencies from 0.1 to 1.5 Hz."""
    rng, t = np.random.default_rng(0), np.arange(4096) / 4096
    k = np.arange(max(1, int(0.1 * seconds)), int(1.5 * seconds) + 1)
    out = np.zeros((t.size, space.center.size))
    for i in range(space.center.size):
        phase = rng.uniform(0, 2 * np.pi, k.size)
        wave = np.sum(np.sin(2 * np.pi * k[:, None] * t + phase[:, None]) / k[:, None], axis=0)
        rate = float(np.abs(np.gradient(wave, t * seconds)).max())
        half = float(np.min(np.abs(space.together[i] - space.center[i])))
        out[:, i] = wave * min(half / float(np.abs(wave).max()), float(space.speed[i]) / rate)
    return series(space, out, seconds, "multisine", 2.0)


Maker = Callable[[Space, "int | None", float], Trajectory]
MENU: dict[str, Maker] = {
    "slow-strokes": slow_strokes,
    "speed-ladder": speed_ladder,
    "fast-strokes": fast_strokes,
    "range-strokes": range_strokes,
    "small-reversals": small_reversals,
    "rests": rests,
    "one-at-a-time": one_at_a_time,
    "pairs": pairs,
    "postures": postures,
    "range-ends": range_ends,
    "chirp": chirp,
    "multisine": multisine,
}


#: Motions that need more than one joint.
SEVERAL = ("pairs", "one-at-a-time", "postures")


def describe(name: str, joints: int) -> str:
    """One sentence about a motion of the menu for so many joints, without its full stop."""
    text = (MENU[name].__doc__ or "").strip().rstrip(".")
    if joints == 1:
        text = text.removeprefix("All joints at once, ")
    return text[:1].lower() + text[1:]
