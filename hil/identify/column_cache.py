"""Filtered columns, kept for as long as what they were made of stays as it is.

What that is nobody has to declare: while an effect makes its columns, its motion notes which of
its fields it looks at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

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
#: An effect's name, its joint, and what tells its columns from others of it.
Key = tuple[object, ...]
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
class _Moment:
    """Columns that were made of one state of the fields that they looked at."""

    seen: Seen
    states: tuple[object, ...]
    #: Columns by key; those another round of a search may do without are the spare ones.
    needed: dict[Key, FloatArray] = field(default_factory=dict)
    spare: dict[Key, FloatArray] = field(default_factory=dict)

    def get(self, key: Key) -> FloatArray | None:
        """Columns under a key; None if there are none."""
        known = self.needed.get(key)
        return self.spare.get(key) if known is None else known

    def copied(self, states: tuple[object, ...]) -> _Moment:
        """The same columns, under the same states as they are named now."""
        return _Moment(self.seen, states, dict(self.needed), dict(self.spare))

    def latest(self, room: int) -> tuple[dict[Key, FloatArray], int]:
        """The latest spare columns that have room, the oldest first, and the room that is left."""
        some = []
        for key, columns in reversed(self.spare.items()):
            if columns.nbytes <= room:
                some.append((key, columns))
                room -= columns.nbytes
        return dict(reversed(some)), room


class Kept:
    """Columns by key; one whose fields have changed since counts as absent.

    Columns that are tried are made again and again as a search goes on.  They are kept, for several
    values of the small fields (a sign's resolution) at once, until newer ones need their room: no
    more than `CACHE_BYTES` of them.
    """

    def __init__(self, looked: dict[Key, list[Seen]] | None = None) -> None:
        #: What columns of an effect and a joint have looked at so far.
        self._looked = {} if looked is None else looked
        #: Columns of the present states, and of former ones that may come back, the oldest first.
        self._present: dict[Seen, _Moment] = {}
        self._former: list[_Moment] = []
        self._motions: Sequence[Motion] = ()
        self._states: dict[Seen, tuple[object, ...]] = {}
        self._room = CACHE_BYTES

    def get(self, key: Key, motions: Sequence[Motion]) -> FloatArray | None:
        """Columns that are as the motions are now; None if there are none."""
        for seen in self._looked.get(key[:2], ()):
            moment = self._present.get(seen)
            if moment is not None and _same(moment.states, self._now(seen, motions)):
                known = moment.get(key)
                if known is not None:
                    return known
        return None

    def put(
        self,
        key: Key,
        columns: FloatArray,
        seen: Seen,
        motions: Sequence[Motion],
        spare: bool = False,
    ) -> None:
        """Keep columns that were made of these fields; for `spare` ones the oldest of them go."""
        if spare and columns.nbytes > self._room:
            self._make_room(columns.nbytes)
        if spare and columns.nbytes > self._room:
            return
        states = self._now(seen, motions)
        moment = self._present.get(seen)
        if moment is None or not _same(moment.states, states):
            self._former += [] if moment is None else [moment]
            moment = self._present[seen] = _Moment(seen, states)
        looked = self._looked.setdefault(key[:2], [])
        if seen not in looked:
            looked.append(seen)
        (moment.spare if spare else moment.needed)[key] = columns
        self._room -= columns.nbytes * spare

    def looked_at(self, key: Key, name: str, j: int) -> bool:
        """Whether columns of an effect and a joint were made of a field of joint j, or of all."""
        return any({(name, j), (name, None)} & {*seen} for seen in self._looked.get(key, ()))

    def _make_room(self, size: int) -> None:
        """Let the oldest spare columns go, a part of the room at once."""
        wanted = max(size, CACHE_BYTES // ROOM_PART)
        for moment in (*self._former, *self._present.values()):
            for key in list(moment.spare):
                if self._room >= wanted:
                    return
                gone = moment.spare.pop(key, None)
                if gone is not None:  # else another thread was quicker
                    self._room += gone.nbytes

    def pruned(self, motions: Sequence[Motion]) -> Kept:
        """The same without what has changed.

        Spare columns whose small fields alone have changed may be as they are now once more: the
        latest of them stay, but for a part of the room that is left to new ones.
        """
        out, former = Kept(self._looked), []
        for moment in (*self._former, *self._present.values()):
            states = out._now(moment.seen, motions)
            if _same(moment.states, states):
                out._present[moment.seen] = moment.copied(states)
            elif moment.spare and _may(moment.states, states):
                former.append(moment)
        fresh = out._present.values()
        out._room -= sum(x.nbytes for m in fresh for x in m.spare.values())
        left = out._room - CACHE_BYTES // NEW_PART
        for moment in reversed(former):
            some, now = moment.latest(left)
            out._room, left = out._room - (left - now), now
            if some:
                out._former.insert(0, _Moment(moment.seen, moment.states, {}, some))
        return out

    def _now(self, seen: Seen, motions: Sequence[Motion]) -> tuple[object, ...]:
        """What is looked at, as it is now; made once for a list of runs."""
        if self._motions is not motions:
            self._motions, self._states = motions, {}
        if seen not in self._states:
            self._states[seen] = tuple(_state(m, *f) for f in seen for m in motions)
        return self._states[seen]


def _same(was: tuple[object, ...], now: tuple[object, ...]) -> bool:
    """Whether the runs are as they were in all that was looked at."""
    return was is now or all(
        a is b or (isinstance(a, bytes | float) and a == b) for a, b in zip(was, now, strict=True)
    )


def _may(was: tuple[object, ...], now: tuple[object, ...]) -> bool:
    """Whether only small fields are other ones now than when it was made."""
    return all(a is b or isinstance(a, bytes | float) for a, b in zip(was, now, strict=True))


def _state(motion: Motion, name: str, j: int | None) -> object:
    if name == "friction":
        return motion.friction[j] if j is not None and motion.friction else None
    if j is not None:
        return float(getattr(motion, name)[j])
    value = getattr(motion, name)
    # the bytes, for NaN is no surface and equal to no surface
    return value.tobytes() if name in SMALL_FIELDS else value
