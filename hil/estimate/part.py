"""One effect on one joint, tried: what it depends on, and its torque over that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.controllers.compensation import BEND, VARIABLES
from hil.errors import ConfigError
from hil.estimate.probe import ENDS, OTHERS, ROWS, changed, kind_of, made_up, stirred
from hil.models.effect import Effect
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
#: Quantities that are tried alone; sums and differences of speeds stand for two of them.
PLAIN = VARIABLES[:13]
#: First letters of those whose knots are dense about zero.
BENT = ("v", "t")


def refusal(effect: Effect, why: str) -> ConfigError:
    """Error that names the effect."""
    return ConfigError(
        f"effect {effect.name!r} cannot be compensated in the loop: {why}; fit a model without it, "
        "or take it out of the file"
    )


@dataclass(frozen=True)
class Part:
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
            raise refusal(self.effect, "it acts on the whole robot")
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
            raise refusal(
                self.effect, "it is a part of the measured force, not of a motor's torque"
            )
        base = made_up(self.ends)
        plain, half = self.torque(base), ROWS // 2
        for rows, kept in ((slice(1, half), slice(half, None)), (slice(half, None), slice(half))):
            # whatever happened before, or will happen
            if not _same(self.torque(stirred(base, rows))[kept], plain[kept]):
                raise refusal(self.effect, "it has a memory for which the loop has no kernel")
        found = [n for n in PLAIN if self._moves(base, plain, n)]
        other = np.random.default_rng(3).uniform(-1, 1, (ROWS, 3))
        for name, said in OTHERS.items():
            if not _same(self.torque(base.with_(**{name: other})), plain):
                raise refusal(self.effect, f"it needs {said} at the very instant")
        wide = base.with_(span=1.3 * base.span)
        if not self.known and not _same(self.torque(wide), plain):
            raise refusal(
                self.effect, "its coefficients are relative to the range of positions it was "
                "identified on, which the model file does not give ([valid])",
            )  # fmt: skip
        both = [n for n in VARIABLES[13:] if found == [n[:2], n[3:]]]
        found = next(([n] for n in both if self._together(base, plain, n)), found)
        if len(found) > 2:
            raise refusal(self.effect, f"it depends on {', '.join(found)}, more than a table holds")
        return found

    def _moves(self, base: Motion, plain: FloatArray, name: str) -> bool:
        rng = np.random.default_rng(5)
        if name == "t":
            # the sample period, between the first two instants, stays
            later = np.where(np.arange(ROWS) < 2, 0.0, 100.0)
            return not _same(self.torque(base.with_(t=base.t + later)), plain)
        # evenly over the range, its ends included, in another order than before
        places = rng.permutation(np.linspace(*self._limits(name), ROWS))
        return not _same(self.torque(changed(base, name, places)), plain)

    def _together(self, base: Motion, plain: FloatArray, name: str) -> bool:
        """Whether only the sum or difference of two speeds counts."""
        slip, qd = np.linspace(-1, 1, ROWS), base.qd.copy()
        qd[:, int(name[1]) - 1] += slip
        qd[:, int(name[4]) - 1] -= slip if name[2] == "+" else -slip
        return _same(self.torque(base.with_(qd=qd)), plain)

    def _limits(self, name: str) -> tuple[float, float]:
        if name[0] == "q":
            low, high = self.ends[int(name[1]) - 1]
            return float(low), float(high)
        return ENDS[kind_of(name)]

    def sheet(self, axes: Sequence[str], counts: Sequence[int]) -> tuple[FloatArray, list[Any]]:
        """Torques at the knots, and start, step and count of each axis."""
        marks, places = [], []
        for name, count in zip(axes, counts, strict=True):
            low, high = self._limits(name)
            if name[0] in BENT:
                low, high = math.asinh(low / BEND), math.asinh(high / BEND)
            marks.append((low, (high - low) / (count - 1), count))
            u = np.linspace(low, high, count)
            places.append(BEND * np.sinh(u) if name[0] in BENT else u)
        return self.at(axes, places), marks

    def at(self, axes: Sequence[str], places: Sequence[FloatArray]) -> FloatArray:
        """Torques on a grid of places, the shape of the grid."""
        grid = np.array(list(product(*places)))
        base = made_up(self.ends, len(grid) + 1, still=True)
        for k, name in enumerate(axes):
            # the first row stands for the start, where time counts from
            base = changed(base, name, np.concatenate([[0.0], grid[:, k]]))
        return self.torque(base)[1:].reshape([len(p) for p in places])


def _same(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.allclose(a, b, rtol=1e-6, atol=1e-12))
