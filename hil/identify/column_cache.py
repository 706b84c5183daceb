"""Filtered columns, kept for as long as what they were made of stays as it is.

What that is nobody has to declare: while an effect makes its columns, its motion notes which of
its fields it looks at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hil.models.effect import Effect
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
#: Columns that are kept for another round of a search, all together [bytes].
CACHE_BYTES = 3 * 2**26
#: Part of it that former columns leave to new ones: one in so many.
NEW_PART = 2
#: Part of it that is made free at once where there is none left: one in so many.
ROOM_PART = 8
#: Fields of a motion; the robot is the problem's own.
FIELDS = frozenset(f.name for f in fields(Motion)) - {"robot"}
#: Those that are compared by value and not as objects.
SMALL_FIELDS = frozenset({"v0", "resolution", "span", "contact", "grain"})
#: What was looked at: a field, and of the sign resolution possibly one joint's.
Field = tuple[str, int | None]
#: All of them, in one order.
Seen = tuple[Field, ...]


class Watched(Motion):
    """A motion that notes which of its fields are looked at."""

    _seen: set[Field]
    _plain: Motion

    def __getattribute__(self, name: str) -> object:
        if name in FIELDS:
            seen = object.__getattribute__(self, "__dict__").get("_seen")
            if seen is not None:
                seen.add((name, None))
        return object.__getattribute__(self, name)

    def sign(self, j: int, v0: float | None = None) -> FloatArray:
        """As of any motion; only this joint's resolution counts as looked at, if it is used.

        The acceleration counts where signs are averaged.
        """
        self._seen.update({("qd", None), ("average", None)})
        if v0 is None:
            self._seen.update({("v0", j), ("friction", j)})
        if self._plain.average:
            self._seen.add(("qdd", None))
        return self._plain.sign(j, v0)


def watched(
    effect: Effect, motions: Sequence[Motion], j: int, shape: Sequence[float]
) -> tuple[list[FloatArray], Seen]:
    """Columns of an effect, one array a run, and the fields that it looked at for them."""
    seen: set[Field] = set()
    out = []
    for m in motions:
        view: Watched = object.__new__(Watched)
        view.__dict__.update(m.__dict__, _seen=seen, _plain=m)
        out.append(effect.columns(view, j, shape))
    return out, tuple(sorted(seen, key=str))


@dataclass
class _Made:
    columns: FloatArray
    seen: Seen
    states: tuple[object, ...]
    #: Whether another round of a search may do without it: then no more than `CACHE_BYTES`.
    spare: bool


class Kept:
    """Columns by key; one whose fields have changed since counts as absent.

    Columns that are tried are made again and again as a search goes on.  They are kept, for several
    values of the small fields (a sign's resolution) at once, until newer ones need their room.
    """

    def __init__(self) -> None:
        #: Those that may go, the oldest first.
        self._spare: dict[int, tuple[tuple[object, ...], _Made]] = {}
        self._made: dict[tuple[object, ...], list[_Made]] = {}
        self._motions: Sequence[Motion] = ()
        self._states: dict[Seen, tuple[object, ...]] = {}
        self._room = CACHE_BYTES

    def get(self, key: tuple[object, ...], motions: Sequence[Motion]) -> FloatArray | None:
        """Columns that are as the motions are now; None if there are none."""
        for made in self._made.get(key, ()):
            if self._fresh(made, motions):
                return made.columns
        return None

    def put(
        self,
        key: tuple[object, ...],
        columns: FloatArray,
        seen: Seen,
        motions: Sequence[Motion],
        spare: bool = False,
    ) -> None:
        """Keep columns that were made of these fields; for `spare` ones the oldest of them go."""
        if spare and columns.nbytes > self._room:
            self._make_room(columns.nbytes)
        if not spare or columns.nbytes <= self._room:
            self._hold(key, _Made(columns, seen, self._now(seen, motions), spare))

    def _make_room(self, size: int) -> None:
        """Let the oldest spare columns go, a part of the room at once."""
        wanted = max(size, CACHE_BYTES // ROOM_PART)
        for name in list(self._spare):
            if self._room >= wanted:
                break
            gone = self._spare.pop(name, None)
            if gone is None:  # another thread was quicker
                continue
            key, made = gone
            self._made[key] = [x for x in self._made[key] if x is not made]
            self._room += made.columns.nbytes

    def pruned(self, motions: Sequence[Motion]) -> Kept:
        """The same without what has changed.

        Spare columns whose small fields alone have changed may be as they are now once more: the
        latest of them stay, but for a part of the room that is left to new ones.
        """
        out, former, fresh = Kept(), [], []
        # columns of one moment share what they were made of: it is compared once
        compared: dict[int, tuple[tuple[object, ...], bool, bool]] = {}
        for key, every in self._made.items():
            for made in every:
                was = made.states
                if id(was) not in compared:
                    compared[id(was)] = was, out._fresh(made, motions), out._may(made)
                _, is_fresh, may = compared[id(was)]
                if is_fresh:
                    made.states = out._now(made.seen, motions)
                    fresh.append((key, made))
                elif made.spare and may:
                    former.append((key, made))
        room = CACHE_BYTES - sum(made.columns.nbytes for _, made in fresh if made.spare)
        some = []
        for key, made in reversed(former):
            if room - made.columns.nbytes > CACHE_BYTES // NEW_PART:
                some.append((key, made))
                room -= made.columns.nbytes
        # former ones are the first to go
        for key, made in (*reversed(some), *fresh):
            out._hold(key, made)
        return out

    def _hold(self, key: tuple[object, ...], made: _Made) -> None:
        self._made.setdefault(key, []).append(made)
        if made.spare:
            self._room -= made.columns.nbytes
            self._spare[id(made)] = key, made

    def _fresh(self, made: _Made, motions: Sequence[Motion]) -> bool:
        """Whether the runs are as they were in all that was looked at."""
        now = self._now(made.seen, motions)
        if now is not made.states:
            for a, b in zip(made.states, now, strict=True):
                if a is not b and not (isinstance(a, bytes | float) and a == b):
                    return False
            made.states = now
        return True

    def _may(self, made: _Made) -> bool:
        """Whether only small fields are other ones now than when it was made."""
        now = self._states[made.seen]
        pairs = zip(made.states, now, strict=True)
        return all(a is b or isinstance(a, bytes | float) for a, b in pairs)

    def _now(self, seen: Seen, motions: Sequence[Motion]) -> tuple[object, ...]:
        """What is looked at, as it is now; made once for a list of runs."""
        if self._motions is not motions:
            self._motions, self._states = motions, {}
        if seen not in self._states:
            self._states[seen] = tuple(_state(m, *f) for f in seen for m in motions)
        return self._states[seen]


def _state(motion: Motion, name: str, j: int | None) -> object:
    if name == "friction":
        return motion.friction[j] if j is not None and motion.friction else None
    if j is not None:
        return float(getattr(motion, name)[j])
    value = getattr(motion, name)
    # the bytes, for NaN is no surface and equal to no surface
    return value.tobytes() if name in SMALL_FIELDS else value
