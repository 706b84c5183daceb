"""One identification problem: runs, filters, target and the columns of any effect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError
from hil.identify import bands, standstill
from hil.models.effect import Effect
from hil.models.model import Band
from hil.models.motion import Motion
from hil.models.robots import Robot, make_robot
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]
#: Shortest run, in periods of the effort filter.
SHORTEST = 6.0
#: Band chosen from the data.
AUTOMATIC = Band()


class Problem:
    """Runs of one arm, ready for regression.

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
    run : ndarray (n,)
        Run index of each instant.
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
        first = recordings[0]
        for r in recordings:
            if r.d != first.d:
                raise DataError(
                    f"recording {r.name!r} has {r.d} joints but {first.name!r} has {first.d}; "
                    "give sessions of one robot"
                )
        self.source = robot
        self.robot: Robot = make_robot(robot, first)
        self.joints, self.explains = first.joints, explains
        self.recordings = recordings
        self.rates = rates or bands.choose(recordings, band)
        lows = np.min([r.q.min(axis=0) for r in recordings], axis=0)
        highs = np.max([r.q.max(axis=0) for r in recordings], axis=0)
        self.span = np.stack([lows, highs], axis=1) if span is None else span
        self.motions: list[Motion] = []
        self._filters: list[bands.Decimator] = []
        self._still: list[FloatArray] = []
        for r in recordings:
            self._add(r)
        self._assemble()
        self.shift = 0.0
        self._cache: dict[tuple[object, ...], FloatArray] = {}

    @property
    def d(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def n(self) -> int:
        """Instants after the filter, all runs together."""
        return int(self.run.size)

    @property
    def count(self) -> FloatArray:
        """Instants at which each joint moves (d,)."""
        return np.asarray(np.sum(self.live, axis=1), dtype=np.float64)

    def rms(self, x: FloatArray) -> FloatArray:
        """Root mean square over the instants at which each joint moves, (d, n) to (d,)."""
        out: FloatArray = np.sqrt(np.sum(x**2, axis=1) / self.count)
        return out

    @property
    def rate(self) -> float:
        """Rate of the instants [Hz]."""
        return self._filters[0].rate

    def _external(self, r: Recording) -> FloatArray:
        if r.tau_ext is not None:
            return r.tau_ext
        if r.wrench is not None:
            return np.zeros_like(r.q)
        if self.explains == "external":
            raise DataError(
                f"recording {r.name!r} has no external effort (tauext or fx, fy, fz) to explain"
            )
        return np.zeros_like(r.q)

    def _add(self, r: Recording) -> None:
        fs = r.rate
        q, qd, qdd = bands.derivatives(r.q, fs, self.rates.position)
        tau = bands.smooth(r.tau, fs, self.rates.position)
        ext = bands.smooth(self._external(r), fs, self.rates.position)
        stride = max(1, int(fs / (5.0 * self.rates.position)))
        pick = slice(None, None, stride)
        if r.tau_ext is None and r.wrench is not None:
            wrench = bands.smooth(r.wrench, fs, self.rates.position)
            ext = np.empty((0, r.d))
            external = self.robot.external(q[pick], wrench[pick])
        else:
            external = ext[pick]
        step = stride / fs
        t = np.arange(q[pick].shape[0], dtype=np.float64) * step
        if t.size * step * self.rates.effort < SHORTEST:
            raise DataError(
                f"run {r.name!r} of {r.n / fs:.3g} s is too short for a filter of "
                f"{self.rates.effort:.3g} Hz; record {SHORTEST / self.rates.effort:.2g} s or more"
            )
        motion = Motion(
            t=t, q=q[pick], qd=qd[pick], qdd=qdd[pick], tau=tau[pick], tau_ext=external,
            load=np.zeros_like(q[pick]), static=np.zeros_like(q[pick]), v0=self._resolution(r),
            resolution=np.zeros(r.d), span=self.span,
            contact=np.full((r.d, 2), np.nan), robot=self.robot, average=step,
        )  # fmt: skip
        self.motions.append(motion)
        still = standstill.standing(r.q, qdd, fs, 0.5 / self.rates.effort, self.rates.position)
        self._still.append(still[pick])
        self._filters.append(bands.Decimator(t.size, 1 / step, self.rates.effort))

    def _resolution(self, r: Recording) -> FloatArray:
        """Speed noise after the position filter, at least 0.2 % of the rms speed."""
        fs, cutoff = r.rate, self.rates.position
        sigma_q = standstill.position_noise(r.q)
        # s_v = s_q 2 pi fc sqrt(2 fc / (3 fs)) for white noise up to fc
        sigma_v = sigma_q * 2 * np.pi * cutoff * np.sqrt(2 * cutoff / (3 * fs))
        rms = np.sqrt(np.mean(np.diff(r.q, axis=0) ** 2, axis=0)) * fs
        out: FloatArray = np.maximum(np.maximum(sigma_v, 0.002 * rms), 1e-9)
        return out

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
        """At standstill friction balances any effort: no equation there, for the motor's effort."""
        if self.explains != "motor":
            self._still = [np.zeros_like(x) for x in self._still]
        live = standstill.live(self.filtered(self._still))
        kept = np.all(live, axis=0)
        self._still = [np.where(kept, 0.0, x) for x in self._still]
        return live.T.copy()

    def gated(self, parts: Sequence[FloatArray], j: int) -> FloatArray:
        """Effort filter of what acts on joint j, standstill taken out before and after it."""
        if not any(np.any(s[:, j]) for s in self._still):
            return self.filtered(parts)
        shape = (-1, *[1] * (parts[0].ndim - 1))
        moving = [(1.0 - s[:, j]).reshape(shape) for s in self._still]
        out = self.filtered([x * w for x, w in zip(parts, moving, strict=True)])
        out *= self.live[j].reshape(shape)
        return out

    def shift_effort(self, seconds: float) -> None:
        """Take the motor effort `seconds` later: tau(t) <- tau(t - s), to first order in s."""
        self.shift += seconds
        self.motions = [
            m.with_(tau=m.tau - seconds * np.gradient(m.tau, m.dt, axis=0)) for m in self.motions
        ]
        self._target()
        self._cache.clear()

    def _sampled(self, name: str) -> FloatArray:
        return self.filtered([getattr(m, name) for m in self.motions])

    def filtered(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Effort filter of one array a run, runs stacked along axis 0."""
        return np.concatenate([f(x) for f, x in zip(self._filters, parts, strict=True)])

    def set_context(self, **changes: FloatArray) -> None:
        """Change v0, contact or load; forget the columns that depend on them."""
        if "load" in changes:
            sizes = np.cumsum([m.n for m in self.motions])[:-1]
            loads = np.split(changes["load"], sizes)
            still = np.split(changes["static"], sizes)
            parts = zip(self.motions, loads, still, strict=True)
            self.motions = [m.with_(load=x, static=z) for m, x, z in parts]
            self._cache = {k: v for k, v in self._cache.items() if not k[0]}
        else:
            self.motions = [m.with_(**changes) for m in self.motions]
            self._cache.clear()

    def columns(
        self, effect: Effect, j: int, shape: Sequence[float], per_run: bool = False
    ) -> FloatArray:
        """Filtered columns of an effect: (n, m) on joint j, or (d, n, m) of the whole robot."""
        key = (effect.uses_load, effect.name, j, tuple(shape), per_run)
        if key not in self._cache:
            raw = [effect.columns(m, j, shape) for m in self.motions]
            expected = (self.motions[0].n, self.d) if effect.whole_robot else (self.motions[0].n,)
            if raw[0].shape[:-1] != expected:
                raise ConfigError(
                    f"effect {effect.name!r}: columns have shape {raw[0].shape}, expected "
                    f"{expected} + (coefficients,)"
                )
            if effect.whole_robot:
                joints = range(self.d)
                out = np.stack([self.gated([x[:, i] for x in raw], i) for i in joints], axis=1)
            else:
                out = self.gated(raw, j)
            if per_run:
                out = self._split(out)
            self._cache[key] = np.moveaxis(out, 0, 1) if effect.whole_robot else out
        return self._cache[key]

    def _split(self, x: FloatArray) -> FloatArray:
        """One set of columns a run."""
        runs = range(len(self.motions))
        mask = self.run.reshape(-1, *[1] * (x.ndim - 1))
        return np.concatenate([np.where(mask == k, x, 0.0) for k in runs], axis=-1)
