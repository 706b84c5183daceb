"""One identification problem: the rows of its runs, and the columns of any effect.

Rows of a regression: runs through the filters, where each joint moves, what its motor does.
"""

from __future__ import annotations

import copy
import math
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError
from hil.identify import bands
from hil.identify.clock import Even, Timing
from hil.identify.column_cache import Kept, Seen, watched
from hil.identify.prepare import (
    Decimator,
    at_instants,
    converted,
    on_grid,
    prepare,
    signal,
    timing_notes,
)
from hil.models.effect import Effect, Trait, terms_of
from hil.models.model import Band, RobotModel
from hil.models.motion import Motion
from hil.models.robots import Robot, make_robot
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]
#: Raw columns of the motion alone are kept up to this size [bytes], else made again.
KEPT = 2**27
#: Raw columns that pass the filter at once [bytes]: more would leave the processor's cache.
ROW_BATCH = 2**22


@dataclass(frozen=True)
class Alignment:
    """How motor efforts r that were recorded become those tau that acted.

        tau(t) = r(u) + T r'(u) + T^2/2 r''(u),    u = t - s + c t,

    the last part of a low-pass of two poles alone (Butterworth's, T = sqrt(2) / its half-power
    frequency).  Of more poles this is the series of a delay by T.  A mean over the last 2 T has no
    poles; its spectrum is divided by

        sin(w T) / (w T)  exp(-i w T),

    the first part by a quarter at least: about its zeros nothing is left to be found again.

    Parameters
    ----------
    shift : float
        By how much they are taken later, s [s].
    lag : float
        Time constant T of a low-pass that they passed, and that is undone [s]; 0 = none.
    poles : int
        Of that low-pass: 1 or 2; 0 of a moving average over 2 T.
    rate : float
        By how much their lateness grows c [s/s]: their clock and that of the positions differ.
    """

    shift: float = 0.0
    lag: float = 0.0
    poles: int = 1
    rate: float = 0.0

    @property
    def late(self) -> float:
        """By how much slow efforts were recorded late [s]."""
        return self.lag - self.shift

    def __call__(self, x: FloatArray, t: FloatArray, since: FloatArray) -> FloatArray:
        """Columns (n, d) over t (n,), aligned by cubic splines; the ends are kept.

        `since` is the time since the start of the run (n,), of which t may be a later part.
        """
        mean = self.lag > 0.0 and self.poles == 0
        whole = _mean_undone(x, self.lag / (t[1] - t[0])) if mean else x
        spline = scipy.interpolate.CubicSpline(t, whole, axis=0)
        at = np.clip(t - self.shift + self.rate * since + self.lag * mean, t[0], t[-1])
        out = spline(at)
        if self.lag and self.poles:
            out += self.lag * spline(at, 1)
        if self.lag and self.poles > 1:
            out += self.lag**2 / 2 * spline(at, 2)
        return np.asarray(out)


#: Part of a sample by which efforts may be shifted and be values of instants.  Half: the least
#: lateness blunts every turn; double: a step between two samples rings.
ON_SAMPLE = 0.1
#: Least share of a wave that a moving average is taken to have left.
LEFT = 0.25


def _mean_undone(x: FloatArray, half: float) -> FloatArray:
    """Columns (n, d) whose waves are as large as before a mean over 2 `half` samples."""
    pad = min(math.ceil(20 * half), len(x) - 1)
    # continued by its own turned copy, as filters do
    begin, end = 2 * x[0] - x[pad:0:-1], 2 * x[-1] - x[-2 : -pad - 2 : -1]
    wide = np.concatenate([begin, x, end])
    size = scipy.fft.next_fast_len(len(wide), real=True)
    left = np.sinc(2 * half * scipy.fft.rfftfreq(size))
    gain = np.copysign(1.0 / np.maximum(np.abs(left), LEFT), left)
    out = scipy.fft.irfft(scipy.fft.rfft(wide, size, axis=0) * gain[:, None], size, axis=0)
    return np.asarray(out[pad : pad + len(x)])


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
        #: Steps of the converter that the efforts pass after they are recorded, by joint.
        self.effort_step = said[0].effort_step
        sent = [converted(r, self.effort_step) for r in recordings]
        moving = explains == "motor"
        made = [on_grid(r, b, moving) for r, b in zip(sent, said, strict=True)]
        parts = [part for found, _ in made for part in found]
        self.whole = np.repeat(np.arange(len(made)), [len(found) for found, _ in made])
        self.timings: list[Timing] = [timing for _, timing in made]
        self.recordings = [part.recording for part in parts]
        #: Rates at which the parts were truly measured [Hz].
        self.sources = [
            min(self.timings[k].source, r.rate)
            for k, r in zip(self.whole, self.recordings, strict=True)
        ]
        self.rates = rates or bands.choose(self.recordings, said[0], moving, self.sources)
        lows = np.min([r.q.min(axis=0) for r in self.recordings], axis=0)
        highs = np.max([r.q.max(axis=0) for r in self.recordings], axis=0)
        self.span = np.stack([lows, highs], axis=1) if span is None else span
        self._move(parts)
        self._share_slips()
        self._assemble()
        self._unaligned(said[0])
        #: Least first shape value of an effect on a joint, where other runs have shown it.
        self.least: dict[tuple[str, int], float] = {}
        #: Coefficients that must not be negative, whatever their effects allow.
        self.positive: frozenset[str] = frozenset()
        self._kept = Kept()
        #: Whether columns are made that another round of a search may make again.
        self._spare = False
        self._raw: dict[tuple[object, ...], list[FloatArray]] = {}
        self._rest: dict[tuple[object, ...], list[tuple[NDArray[np.int_], FloatArray]]] = {}
        #: What it was made of, and what a fit changes, as it was before any.
        self._asked = (tuple(recordings), robot, explains, band, rates)
        self._first = (tuple(self.motions), self.y, self.effort)

    def _unaligned(self, said: Band) -> None:
        """How efforts and positions are aligned: not yet, or as a [signal] says."""
        #: How the motor efforts are aligned.
        self.alignment = Alignment()
        #: Whether efforts that were recorded late by more than a sample have been looked for.
        self.asked_late = False
        #: Whether the alignment is settled: no fit changes it.
        self.aligned = False
        #: Lateness of the effort that a model's or a map's [signal] gives [s]; None = estimate.
        self.given_shift = said.shift_s
        #: Low-pass that a model or a map's [signal] says the efforts passed, and their clock.
        ppm = said.clock_ppm
        self.given_lag = Alignment(0.0, said.lag_s, int(said.lag_poles), 1e-6 * ppm)
        #: Share of the rms effort to which the efforts are known, if a [signal] says it; else 0.
        self.accuracy = said.accuracy

    def _filtered(self, parts: Sequence[Even], finely: bool) -> None:
        """Every part behind the filters, at instants between slow rows too (`finely`)."""
        given = self.robot, self.rates, self.span, self.explains
        prepared = [prepare(part, *given, finely=finely) for part in parts]
        self.motions: list[Motion] = self._counted([motion for motion, *_ in prepared])
        self._still: list[FloatArray] = [still for _, still, *_ in prepared]
        self._spoilt: list[FloatArray] = [spoilt for *_, spoilt, _ in prepared]
        self._filters: list[Decimator] = [decimator for *_, decimator in prepared]

    def _move(self, parts: Sequence[Even]) -> None:
        """Motion, standstill, bridges and filter of each part."""
        self._filtered(parts, finely=True)
        rows = [(p.recording, m) for p, m in zip(parts, self.motions, strict=True)]
        #: Whether efforts are values of instants, see `hil.identify.prepare.at_instants`.
        self.of_instants = self.explains == "motor" and at_instants(rows)
        if self.of_instants:
            if any(m.n > r.n for r, m in rows):
                # between two rows there is no value of an instant
                self._filtered(parts, finely=False)
            self.motions = [replace(m, average=0.0) for m in self.motions]

    def _counted(self, motions: Sequence[Motion]) -> list[Motion]:
        """Motions of the parts that know their run, and how long every run is."""
        last = {k: float(m.since[-1]) for k, m in zip(self.whole, motions, strict=True)}
        lengths = tuple(last.values()) if len(last) > 1 else ()
        pairs = zip(self.whole, motions, strict=True)
        return [replace(m, run=int(k), lengths=lengths) for k, m in pairs]

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
    def as_recorded(self) -> tuple[FloatArray, FloatArray]:
        """What a model is to explain, and the efforts, (d, n) each, before a fit aligned them."""
        _, y, effort = self._first
        return y, effort

    @property
    def taken(self) -> Band:
        """Filters and alignment of the efforts that everything here has passed."""
        position, effort = float(self.rates.position), float(self.rates.effort)
        a = self.alignment
        lag = {"lag_s": a.lag, "lag_poles": float(a.poles), "clock_ppm": 1e6 * a.rate}
        return Band(position, effort, shift_s=a.shift, effort_step=self.effort_step, **lag)

    @property
    def shift(self) -> float:
        """By how much the motor efforts are taken later [s]."""
        return self.alignment.shift

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
    def left_out(self) -> NDArray[np.bool_]:
        """Instants (n,) at which runs are left out, whatever moves."""
        out = np.zeros(self.n, dtype=bool)
        for k, r in enumerate(self.recordings):
            for begin, end in r.left_out:
                t = r.t[0] + self.t
                out |= (self.run == k) & (begin <= t) & (t <= end)
        return out

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Joints (d,) of which nothing is to be learnt.

        They only hold their place in every run, or have no effort that changes.
        """
        if self.explains != "motor":
            return np.zeros(self.d, dtype=bool)
        motions = [(m.q, m.grain) for m in self.motions]
        held = self.remembered(
            ("holds",), sum(motions, ()), lambda: [bands.holding(*m) for m in motions]
        )
        return np.asarray(np.all(held, axis=0)) | self.silent

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
        """Root mean square over the instants at which each joint moves, (d, n) to (d,).

        Zero for a joint without one.
        """
        out: FloatArray = np.sqrt(np.sum(x**2, axis=1) / np.maximum(self.count, 1.0))
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
        live = bands.live(self.filtered(self._still))
        kept = np.all(live, axis=0)
        self._still = [np.where(kept, 0.0, x) for x in self._still]
        self.silent = self._silent()
        live &= ~self.silent
        self._still = [np.where(self.silent, 1.0, x) for x in self._still]
        if any(np.any(x) for x in self._spoilt):
            wide = [x[:, None] for x in self._spoilt]
            whole = zip(self._still, wide, strict=True)
            self._still = [np.maximum(x, spoilt) for x, spoilt in whole]
            live &= np.abs(self.filtered(wide)) <= bands.TOLERATED
        #: Joints (d,) that stand still at any instant that counts.
        self._stands = np.any([np.any(x, axis=0) for x in self._still], axis=0)
        return live.T.copy()

    def _silent(self) -> NDArray[np.bool_]:
        """Joints (d,) whose effort never changes: without a motor, or not recorded.

        A joint's rows are weighed by its own error, so that rows without one would outweigh all
        others; where no joint has an effort, the fit says so itself.
        """
        if self.explains != "motor":
            return np.zeros(self.d, dtype=bool)
        efforts = np.concatenate([m.tau + m.tau_ext for m in self.motions])
        silent = np.ptp(efforts, axis=0) == 0
        return np.asarray(silent & ~np.all(silent))

    def gated(self, parts: Sequence[FloatArray], j: int) -> FloatArray:
        """Effort filter of what acts on joint j, standstill taken out before and after it."""
        if not self._stands[j]:
            return self.filtered(parts)
        out = self.filtered(parts, [1.0 - s[:, j] for s in self._still])
        out *= self.live[j].reshape(-1, *[1] * (out.ndim - 1))
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

    def filtered(
        self, parts: Sequence[FloatArray], weights: Sequence[FloatArray | None] | None = None
    ) -> FloatArray:
        """Effort filter of one array a run, with its weights (n,), runs stacked along axis 0."""
        weights = weights or [None] * len(self._filters)
        runs = [f(x, w) for f, x, w in zip(self._filters, parts, weights, strict=True)]
        return np.concatenate(runs) if len(runs) > 1 else runs[0]


class Problem(Rows):
    """Runs of one arm, ready for regression; parameters and rows as of `Rows`."""

    def again(
        self,
        recordings: Sequence[Recording],
        robot: RobotSource,
        explains: str,
        band: Band,
        rates: bands.Rates | None = None,
    ) -> Problem | None:
        """The same before any fit, with the columns that were made of the motion; what it gives to
        the new one, this one makes again where it is asked for it.  None where anything of what is
        asked for differs from what this one was made of.
        """
        runs, *rest = self._asked
        same = len(runs) == len(recordings) and all(map(lambda a, b: a is b, runs, recordings))
        if not same or rest != [robot, explains, band, rates]:
            return None
        out = self._unfitted(*self._first)
        self._kept = Kept()
        return out

    def with_signs(self, recordings: Sequence[Recording], signs: FloatArray) -> Problem:
        """The same before any fit, with motor efforts of other signs; columns are kept.

        What was found of their clock stays: it asks how well an effort follows, and not where to.

        Parameters
        ----------
        recordings : sequence of Recording
            The runs with these efforts.
        signs : ndarray (d,)
            Factor of each joint's effort, 1 or -1.
        """
        first, y, effort = self._first
        motions = tuple(replace(m, tau=m.tau * signs) for m in first)
        turned = effort * signs[:, None]
        out = self._unfitted(motions, y - effort + turned, turned)
        out.recordings = [replace(r, tau=r.tau * signs) for r in self.recordings]
        vars(out).update(_asked=(tuple(recordings), *self._asked[1:]))
        return out

    def _unfitted(self, first: tuple[Motion, ...], y: FloatArray, effort: FloatArray) -> Problem:
        """The same before any fit, with these motions and efforts; columns of them are kept."""
        motions = list(first)
        fresh = {
            "motions": motions,
            "y": y,
            "effort": effort,
            "memo": {},
            "least": {},
            "positive": frozenset(),
            "alignment": Alignment(),
            "asked_late": False,
            "aligned": False,
            "_spare": False,
            "_first": (first, y, effort),
        }
        out = copy.copy(self)
        vars(out).update(fresh, _kept=self._kept.pruned(motions))
        return out

    def shift_effort(self, seconds: float) -> None:
        """Take the motor effort `seconds` later than it is: tau(t) <- tau(t - s)."""
        self.align_effort(replace(self.alignment, shift=self.shift + seconds))

    def align_effort(self, alignment: Alignment) -> None:
        """Align the motor effort as it was recorded."""
        self.alignment = alignment
        recorded = [m.tau for m in self._first[0]]
        self.motions = [
            replace(m, tau=alignment(tau, m.t, m.since), average=self._average(r, m))
            for m, tau, r in zip(self.motions, recorded, self.recordings, strict=True)
        ]
        self._target()
        self._kept = self._kept.pruned(self.motions)

    def _average(self, r: Recording, m: Motion) -> float:
        """Time over which a sign is averaged [s]: between two instants there is no value of one."""
        a = self.alignment
        samples = a.shift / m.dt
        between = abs(samples - round(samples)) > ON_SAMPLE or a.lag or a.rate
        return 0.0 if self.of_instants and not between else max(m.dt, r.period)

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
        self,
        effect: Effect,
        j: int,
        shape: Sequence[float],
        per_run: bool = False,
        every: bool = False,
    ) -> FloatArray:
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

    def uses_sign(self, effect: Effect, j: int, k: int) -> bool:
        """Whether columns of an effect on joint j, made before, changed with joint k's sign."""
        return self._kept.looked_at((effect.name, j), "v0", k)

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
            room = max(1, ROW_BATCH // max(sum(x.nbytes for x in made[0][0]), 1))
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
        some = [np.flatnonzero(np.any(x, axis=tuple(range(x.ndim - 1)))) for x in made]
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


def of_model(
    recordings: Sequence[Recording], model: RobotModel, before: Problem | None = None
) -> Problem:
    """Runs as a model is fitted to them; values that it keeps refer to the range that it states.

    `before` is a problem that may be of the same runs: its columns are used again then.
    """
    if before is not None and not model.keeps:
        known = before.again(recordings, model.robot, model.explains, model.band)
        if known is not None:
            return known
    span = model.spans(recordings[0].joints) if model.keeps and recordings else None
    return Problem(list(recordings), model.robot, model.explains, model.band, span=span)
