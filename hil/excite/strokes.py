"""Building a path from strokes at constant speed and rests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.excite.space import Space
from hil.excite.trajectory import Trajectory

FloatArray = NDArray[np.float64]
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
            tuple(robot.joints), tuple(robot.units), float(times[-1]), times, via,
            _blends(times, via, self.space.speed), np.zeros((len(robot.joints), 0, 2)), name,
        )  # fmt: skip


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
        tuple(robot.joints), tuple(robot.units), period, np.array([0.0, period]), via,
        np.full(2, min(1.0, period)), np.stack([-part.imag, part.real], axis=-1), name,
    )  # fmt: skip


def joints_of(space: Space, j: int | None) -> Sequence[int]:
    """The joint in question, or all."""
    return range(space.center.size) if j is None else [j]
