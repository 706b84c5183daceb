"""One identification problem: the rows of its runs, and the columns of any effect."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.identify.kept import Seen, watched
from hil.identify.rows import Rows
from hil.models.effect import Effect, Trait, terms_of
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
#: Raw columns of the motion alone are kept up to this size [bytes], else made again.
KEPT = 2**27
#: Raw columns that pass the filter at once [bytes]: more would leave the processor's cache.
BATCH = 2**22


class Problem(Rows):
    """Runs of one arm, ready for regression; parameters and rows as of `Rows`."""

    def shift_effort(self, seconds: float) -> None:
        """Take the motor effort `seconds` later: tau(t) <- tau(t - s), by cubic splines."""
        self.shift += seconds
        self.motions = [m.with_(tau=_later(m.tau, m.t, seconds)) for m in self.motions]
        self._target()
        self._kept = self._kept.pruned(self.motions)

    def set_context(self, **changes: FloatArray) -> None:
        """Change v0, contact or load; forget the columns that were made of them."""
        if "load" in changes:
            sizes = np.cumsum([m.n for m in self.motions])[:-1]
            loads = np.split(changes["load"], sizes)
            still = np.split(changes["static"], sizes)
            parts = zip(self.motions, loads, still, strict=True)
            self.motions = [m.with_(load=x, static=z) for m, x, z in parts]
        else:
            self.motions = [m.with_(**changes) for m in self.motions]
        self._kept = self._kept.pruned(self.motions)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Columns that are made within are kept only as far as there is room for them."""
        before, self._spare = self._spare, True
        try:
            yield
        finally:
            self._spare = before

    def columns(
        self, effect: Effect, j: int, shape: Sequence[float], per_run: bool = False,
        every: bool = False,
    ) -> FloatArray:  # fmt: skip
        """Filtered columns of an effect: (n, m) on joint j, or (d, n, m) of the whole robot.

        With `per_run` a set a run: all runs but the first one of an effect that only shows in
        differences between runs, unless `every`.
        """
        first = int(effect.variation.relative and not every) if per_run else None
        key = (effect.name, j, tuple(shape), first)
        known = self._kept.get(key, self.motions)
        if known is not None:
            return known
        if first is not None and first >= self.runs:
            # one run alone shows no difference between runs
            return np.zeros((self.d, self.n, 0) if effect.scope.whole else (self.n, 0))
        raw, fields = self._made(effect, j, shape)
        out = self.acting(raw, None if effect.scope.whole else j)
        if first is not None:
            out = self.by_run(out, first)
        return self._keep(key, out, effect, fields)

    def _keep(
        self, key: tuple[object, ...], out: FloatArray, effect: Effect, fields: Seen
    ) -> FloatArray:
        columns = np.moveaxis(out, 0, 1) if effect.scope.whole else out
        self._kept.put(key, columns, fields, self.motions, self._spare)
        return columns

    def several(
        self, effect: Effect, j: int, shapes: Sequence[Sequence[float]]
    ) -> list[FloatArray]:
        """Columns of several shapes of an effect on joint j, through one filter pass."""
        keys = {tuple(s): (effect.name, j, tuple(s), None) for s in shapes}
        there = {s: self._kept.get(key, self.motions) for s, key in keys.items()}
        missing = [s for s, known in there.items() if known is None]
        found = {s: known for s, known in there.items() if known is not None}
        while missing:
            made = [self._made(effect, j, missing[0])]
            room = max(1, BATCH // max(sum(x.nbytes for x in made[0][0]), 1))
            now, missing = missing[:room], missing[room:]
            made += [self._made(effect, j, s) for s in now[1:]]
            runs = zip(*(raw for raw, _ in made), strict=True)
            wide = [_beside(parts) for parts in runs]
            out = self.acting(wide, None if effect.scope.whole else j)
            edges = np.cumsum([raw[0].shape[-1] for raw, _ in made])[:-1]
            parts = zip(now, np.split(out, edges, axis=-1), made, strict=True)
            for shape, part, (_, fields) in parts:
                found[shape] = self._keep(keys[shape], np.ascontiguousarray(part), effect, fields)
        return [found[tuple(s)] for s in shapes]

    def acting(self, raw: Sequence[FloatArray], j: int | None) -> FloatArray:
        """What acts on joint j, or with None on all joints along axis 1, as the rows see it."""
        if j is not None:
            return self.gated(raw, j)
        joints = range(self.d)
        return np.stack([self.gated([x[:, i] for x in raw], i) for i in joints], axis=1)

    def raw(self, effect: Effect, j: int, shape: Sequence[float]) -> list[FloatArray]:
        """Columns of an effect before the filter, one array a run.

        Those that depend on nothing but the motion, without a shape, are made once.
        """
        return self._made(effect, j, shape)[0]

    def at_rest(
        self, effect: Effect, j: int, shape: Sequence[float]
    ) -> list[tuple[NDArray[np.int_], FloatArray]]:
        """Which columns of an effect are not zero where the robot rests at each posture, and these.

        One pair a run; what depends on nothing but the motion, without a shape, is made once.
        """
        key = (effect.name, j)
        if key in self._rest:
            return self._rest[key]
        made, _ = watched(effect, [m.at_rest() for m in self.motions], j, shape)
        some = [np.flatnonzero(np.any(x.reshape(-1, x.shape[-1]), axis=0)) for x in made]
        out = [(k, np.ascontiguousarray(x[..., k])) for k, x in zip(some, made, strict=True)]
        once = Trait.MOTION in effect.traits and not effect.shape
        if once and sum(x.nbytes for _, x in out) <= KEPT:
            self._rest[key] = out
        return out

    def _made(
        self, effect: Effect, j: int, shape: Sequence[float]
    ) -> tuple[list[FloatArray], Seen]:
        """Columns before the filter, one array a run, and what they were made of."""
        key = (effect.name, j)
        if key in self._raw:
            return self._raw[key], ()
        out, fields = watched(effect, self.motions, j, shape)
        _sound(effect, j, self.motions[0], out[0])
        if (
            Trait.MOTION in effect.traits
            and not effect.shape
            and sum(x.nbytes for x in out) <= KEPT
        ):
            self._raw[key] = out
        return out, fields

    def by_run(self, x: FloatArray, first: int) -> FloatArray:
        """Columns (n, ..) as one set of columns a run, from run number `first` on."""
        runs = range(first, self.runs)
        mask = self.whole[self.run].reshape(-1, *[1] * (x.ndim - 1))
        return np.concatenate([np.where(mask == k, x, 0.0) for k in runs] or [x[..., :0]], axis=-1)


def _later(x: FloatArray, t: FloatArray, seconds: float) -> FloatArray:
    """Columns (n, d) so much later; the ends are kept."""
    spline = scipy.interpolate.CubicSpline(t, x, axis=0)
    return np.asarray(spline(np.clip(t - seconds, t[0], t[-1])))


def _beside(parts: Sequence[FloatArray]) -> FloatArray:
    """Columns of several arrays in one, each column's instants side by side in memory."""
    return np.concatenate([x.T for x in parts]).T if parts[0].ndim == 2 else np.dstack(parts)


def _sound(effect: Effect, j: int, motion: Motion, columns: FloatArray) -> None:
    """Refuse columns of a shape that was not declared, or with a number that is none."""
    rows = (motion.n, motion.d) if effect.scope.whole else (motion.n,)
    expected = (*rows, len(terms_of(effect, motion, j)))
    if np.shape(columns) != expected:
        raise ConfigError(
            f"effect {effect.name!r}: columns have shape {np.shape(columns)}, expected {expected}: "
            f"one for each of its {expected[-1]} params"
        )
    if not expected[-1]:
        raise ConfigError(f"effect {effect.name!r} has no params, so there is nothing to fit")
    # a sum is cheap; one that is no number may still be an overflow
    sound = np.isfinite(np.sum(columns)) or np.isfinite(columns).all()
    if not sound and not effect.scope.lacks(motion, j):
        raise ConfigError(
            f"effect {effect.name!r}: its columns hold NaN or infinity on joint {j + 1}; "
            "guard its equation (division by zero, power of a negative number)"
        )
