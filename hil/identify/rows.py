"""Rows of a regression: runs through the filters, where each joint moves, what its motor does."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError
from hil.identify import bands, standstill
from hil.identify.clock import Timing, even
from hil.identify.decimator import Decimator
from hil.identify.kept import Kept
from hil.identify.prepare import prepare, signal, timing_notes
from hil.models.effect import Effect
from hil.models.model import Band
from hil.models.motion import Motion
from hil.models.robots import Robot, make_robot
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]
T = TypeVar("T")
#: Band chosen from the data.
AUTOMATIC = Band()


def _alike(recordings: list[Recording]) -> None:
    """Refuse recordings of robots with different numbers of joints."""
    first = recordings[0]
    for r in recordings:
        if r.d != first.d:
            raise DataError(
                f"recording {r.name!r} has {r.d} joints but {first.name!r} has {first.d}; "
                "give sessions of one robot"
            )


def _same(old: Sequence[weakref.ref[Any]], new: Sequence[object]) -> bool:
    """Whether these are the same objects, and still there."""
    return len(old) == len(new) and all(a() is b for a, b in zip(old, new, strict=True))


class Rows:
    """Filtered target and motion of the runs of one arm.

    Rows are ordered joint by joint, within a joint run by run: row (j, k) = j * n + k.

    Parameters
    ----------
    recordings : list of Recording
        The runs; same joints.
    robot : RobotSource
        The model's robot.
    explains : str
        ``"motor"``: target tau + tau_ext; ``"external"``: target tau_ext.
    band : Band
        Filter band, zeros = choose.

    Attributes
    ----------
    y : ndarray (d, n)
        Target after the filter.
    effort : ndarray (d, n)
        Measured effort after the same filter (what `relative` refers to).
    recordings : list of Recording
        The runs on an even grid, in parts where a long gap splits one.
    run : ndarray (n,)
        Index of each instant's part, in `recordings` and `motions`.
    whole : ndarray (parts,)
        Index of the run that each part belongs to: what is a run's own is all its parts'.
    timings : list of Timing
        The clock of each run.
    t, q, qd, qdd : ndarray
        Time (n,) and unfiltered-by-the-effort-filter motion (d, n) at the instants.
    """

    def __init__(
        self,
        recordings: list[Recording],
        robot: RobotSource,
        explains: str = "motor",
        band: Band = AUTOMATIC,
        rates: bands.Rates | None = None,
        span: FloatArray | None = None,
    ) -> None:
        if not recordings:
            raise DataError("no recording given")
        #: What others have computed from the motion alone.
        self.memo: dict[tuple[object, ...], Any] = {}
        first = recordings[0]
        _alike(recordings)
        self.source = robot
        self.robot: Robot = make_robot(robot, first)
        self.joints, self.explains = first.joints, explains
        said = [signal(band, r) for r in recordings]
        made = [even(r, b.rate_hz, b.gap_s) for r, b in zip(recordings, said, strict=True)]
        parts = [part for found, _ in made for part in found]
        self.whole = np.repeat(np.arange(len(made)), [len(found) for found, _ in made])
        self.timings: list[Timing] = [timing for _, timing in made]
        self.recordings = [part.recording for part in parts]
        #: Rates at which the parts were truly measured [Hz].
        self.sources = [
            min(self.timings[k].source, r.rate)
            for k, r in zip(self.whole, self.recordings, strict=True)
        ]
        moving = explains == "motor"
        self.rates = rates or bands.choose(self.recordings, said[0], moving, self.sources)
        lows = np.min([r.q.min(axis=0) for r in self.recordings], axis=0)
        highs = np.max([r.q.max(axis=0) for r in self.recordings], axis=0)
        self.span = np.stack([lows, highs], axis=1) if span is None else span
        self.motions: list[Motion] = []
        self._filters: list[Decimator] = []
        self._still: list[FloatArray] = []
        self._spoilt: list[FloatArray] = []
        for part in parts:
            made_of = prepare(part, self.robot, self.rates, self.span, explains)
            motion, still, spoilt, decimator = made_of
            self.motions.append(motion)
            self._still.append(still)
            self._spoilt.append(spoilt)
            self._filters.append(decimator)
        self._share_slips()
        self._assemble()
        self.shift = 0.0
        #: Lateness of the effort that a model's or a map's [signal] gives [s]; None = estimate.
        self.given_shift = said[0].shift_s
        #: Least first shape value of an effect on a joint, where other runs have shown it.
        self.least: dict[tuple[str, int], float] = {}
        self._kept = Kept()
        #: Whether columns are made that another round of a search may make again.
        self._spare = False
        self._raw: dict[tuple[object, ...], list[FloatArray]] = {}
        self._rest: dict[tuple[object, ...], list[tuple[NDArray[np.int_], FloatArray]]] = {}

    @property
    def d(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def n(self) -> int:
        """Instants after the filter, all runs together."""
        return int(self.run.size)

    @property
    def runs(self) -> int:
        """Number of runs, each whatever its number of parts."""
        return int(self.whole[-1]) + 1

    @property
    def notes(self) -> list[tuple[str, str]]:
        """What was done to the rows before the filters: (code, sentence), run by run."""
        names = [self.recordings[int(np.argmax(self.whole == k))].name for k in range(self.runs)]
        return [
            (code, f"run {name}: {text}")
            for name, timing in zip(names, self.timings, strict=True)
            for code, text in timing_notes(timing)
        ]

    @property
    def instants(self) -> int:
        """Instants before the filter, all runs together."""
        return sum(m.n for m in self.motions)

    @property
    def count(self) -> FloatArray:
        """Instants at which each joint moves (d,)."""
        return np.asarray(np.sum(self.live, axis=1), dtype=np.float64)

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Joints (d,) that only hold their place in every run: nothing is to be learnt of them."""
        if self.explains != "motor":
            return np.zeros(self.d, dtype=bool)
        motions = [(m.q, m.grain) for m in self.motions]
        held = self.remembered(
            ("holds",), sum(motions, ()), lambda: [standstill.holding(*m) for m in motions]
        )
        return np.asarray(np.all(held, axis=0))

    def remembered(
        self, key: tuple[object, ...], made_of: Sequence[object], make: Callable[[], T]
    ) -> T:
        """What `make` gave for the very same objects before, else what it gives now.

        The objects are not kept alive for it.
        """
        known = self.memo.get(key)
        if known is None or not _same(known[0], made_of):
            known = self.memo[key] = ([weakref.ref(x) for x in made_of], make())
        out: T = known[1]
        return out

    def grid(self, effect: Effect, j: int) -> list[tuple[float, ...]]:
        """Shapes of an effect that are worth trying on joint j, from the first run."""
        first = self.motions[0]
        return self.remembered(("grid", effect, j), [first], lambda: effect.search.grid(first, j))

    def rms(self, x: FloatArray) -> FloatArray:
        """Root mean square over the instants at which each joint moves, (d, n) to (d,)."""
        out: FloatArray = np.sqrt(np.sum(x**2, axis=1) / self.count)
        return out

    @property
    def rate(self) -> float:
        """Rate of the instants [Hz]."""
        return self._filters[0].rate

    def _share_slips(self) -> None:
        """Tell every run which joints' positions jump in any of them."""
        found = [np.any(m.slips[0], axis=0) for m in self.motions if m.slips.size]
        if found:
            which = np.any(found, axis=0)
            self.motions = [replace(m, slipped=which) for m in self.motions]

    def _assemble(self) -> None:
        #: Speed noise by joint (d,): what is slower than this is not motion.
        self.speed_noise = np.max([m.v0 for m in self.motions], axis=0)
        self.motions = [
            m.with_(v0=0.5 * self.speed_noise, resolution=0.5 * self.speed_noise)
            for m in self.motions
        ]
        #: Instants at which each joint moves (d, n); the others are left out (set to zero).
        self.live = self._gate()
        self._target()
        self.q = self.filtered([m.q for m in self.motions]).T.copy()
        self.qd = self._sampled("qd").T.copy()
        self.qdd = self._sampled("qdd").T.copy()
        self.t = np.concatenate([f.times for f in self._filters])
        sizes = [f.times.size for f in self._filters]
        self.run = np.repeat(np.arange(len(sizes)), sizes)

    def _target(self) -> None:
        """Filtered target and effort of the motions as they stand."""
        motor = self.explains == "motor"
        target = [m.tau + m.tau_ext if motor else m.tau_ext for m in self.motions]
        effort = [m.tau if motor else m.tau_ext for m in self.motions]
        joints = range(self.d)
        self.y = np.stack([self.gated([x[:, j] for x in target], j) for j in joints])
        self.effort = np.stack([self.gated([x[:, j] for x in effort], j) for j in joints])

    def _gate(self) -> NDArray[np.bool_]:
        """At standstill friction balances any effort: no equation there, for the motor's effort.

        Nor is there one beside a bridge over rows that are missing.
        """
        if self.explains != "motor":
            self._still = [np.zeros_like(x) for x in self._still]
        live = standstill.live(self.filtered(self._still))
        kept = np.all(live, axis=0)
        self._still = [np.where(kept, 0.0, x) for x in self._still]
        if any(np.any(x) for x in self._spoilt):
            wide = [x[:, None] for x in self._spoilt]
            whole = zip(self._still, wide, strict=True)
            self._still = [np.maximum(x, spoilt) for x, spoilt in whole]
            live &= np.abs(self.filtered(wide)) <= standstill.TOLERATED
        #: Joints (d,) that stand still at any instant that counts.
        self._stands = np.any([np.any(x, axis=0) for x in self._still], axis=0)
        return live.T.copy()

    def gated(self, parts: Sequence[FloatArray], j: int) -> FloatArray:
        """Effort filter of what acts on joint j, standstill taken out before and after it."""
        if not self._stands[j]:
            return self.filtered(parts)
        shape = (-1, *[1] * (parts[0].ndim - 1))
        moving = [(1.0 - s[:, j]).reshape(shape) for s in self._still]
        out = self.filtered([x * w for x, w in zip(parts, moving, strict=True)])
        out *= self.live[j].reshape(shape)
        return out

    def back(self, rows: FloatArray, j: int) -> FloatArray:
        """Transpose of `gated`: what rows (n,) of joint j weigh at each instant of the motions."""
        out = []
        for k, (f, still) in enumerate(zip(self._filters, self._still, strict=True)):
            part = np.where(self.live[j], rows, 0.0)[self.run == k]
            out.append(f.adjoint(part) * (1.0 - still[:, j]))
        return np.concatenate(out)

    def spread(self, labels: NDArray[np.int_]) -> NDArray[np.int_]:
        """Labels of the rows (n,) at the instants of the motions: those of the nearest row."""
        out = []
        for k, m in enumerate(self.motions):
            t, own = self.t[self.run == k], labels[self.run == k]
            out.append(own[np.searchsorted((t[1:] + t[:-1]) / 2, m.t)])
        return np.concatenate(out)

    def stretches(self, k: int) -> list[tuple[int, int]]:
        """First instants of part k's motion, and ends, between bridges over missing rows.

        A bridge that is as exact as the noise is none.
        """
        gone = np.concatenate([[1.0], self._spoilt[k], [1.0]]) > 0
        edges = np.flatnonzero(gone[1:] != gone[:-1]).tolist()
        return list(zip(edges[::2], edges[1::2], strict=True))

    def _sampled(self, name: str) -> FloatArray:
        return self.filtered([getattr(m, name) for m in self.motions])

    def filtered(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Effort filter of one array a run, runs stacked along axis 0."""
        runs = [f(x) for f, x in zip(self._filters, parts, strict=True)]
        return np.concatenate(runs) if len(runs) > 1 else runs[0]
