"""One recording made ready: filtered motion, external effort, and what stands still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError
from hil.identify import bands, standstill
from hil.identify.decimator import Decimator
from hil.models.motion import Motion
from hil.models.robots import Robot
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: Shortest run, in periods of the effort filter.
SHORTEST = 6.0


def prepare(
    r: Recording, robot: Robot, rates: bands.Rates, span: FloatArray, explains: str
) -> tuple[Motion, FloatArray, Decimator]:
    """Motion of a run, where each joint stands (n, d; 1 there), and the run's effort filter.

    Raises
    ------
    DataError
        If the run is too short for the filter, or lacks the effort that is to be explained.
    """
    fs = r.rate
    q, qd, qdd = bands.derivatives(r.q, fs, rates.position)
    stride = max(1, int(fs / (5.0 * rates.position)))
    pick, step = slice(None, None, stride), stride / fs
    t = np.arange(q[pick].shape[0], dtype=np.float64) * step
    if t.size * step * rates.effort < SHORTEST:
        raise DataError(
            f"run {r.name!r} of {r.n / fs:.3g} s is too short for a filter of "
            f"{rates.effort:.3g} Hz; record {SHORTEST / rates.effort:.2g} s or more"
        )
    motion = Motion(
        t=t, q=q[pick], qd=qd[pick], qdd=qdd[pick],
        tau=bands.smooth(r.tau, fs, rates.position)[pick],
        tau_ext=_external(r, q[pick], pick, robot, rates, explains),
        load=np.zeros_like(q[pick]), static=np.zeros_like(q[pick]),
        v0=_resolution(r, rates), resolution=np.zeros(r.d), span=span,
        contact=np.full((r.d, 2), np.nan), robot=robot, average=step,
        wrench=_slow(None if r.tau_ext is not None else r.wrench, 6, pick, r.rate, rates),
        temperature=_slow(r.temperature, r.d, pick, r.rate, rates),
        grain=standstill.position_noise(r.q) * np.sqrt(12), slips=_slips(r, pick, rates),
    )  # fmt: skip
    still = standstill.standing(r.q, qdd, fs, 0.5 / rates.effort, rates.position)
    return motion, still[pick], Decimator(t.size, 1 / step, rates.effort)


def _slips(r: Recording, pick: slice, rates: bands.Rates) -> FloatArray:
    """What jumps of the positions add to q, qd and qdd after the filter, (3, n, d) or (3, 0, 0)."""
    error = np.stack([found.shift(r.n) for found in r.jumps], axis=1)
    if not np.any(error):
        return np.zeros((3, 0, 0))
    return np.stack([x[pick] for x in bands.derivatives(error, r.rate, rates.position)])


def _slow(
    x: FloatArray | None, width: int, pick: slice, fs: float, rates: bands.Rates
) -> FloatArray:
    """A measured channel after the position filter; no rows where it was not recorded."""
    return np.zeros((0, width)) if x is None else bands.smooth(x, fs, rates.position)[pick]


def _external(
    r: Recording, q: FloatArray, pick: slice, robot: Robot, rates: bands.Rates, explains: str
) -> FloatArray:
    """External effort (n, d), measured at the joints or from the wrench at the tip."""
    if r.tau_ext is not None:
        return bands.smooth(r.tau_ext, r.rate, rates.position)[pick]
    if r.wrench is not None:
        return robot.external(q, bands.smooth(r.wrench, r.rate, rates.position)[pick])
    if explains == "external":
        raise DataError(
            f"recording {r.name!r} has no external effort (tauext or fx, fy, fz) to explain"
        )
    return np.zeros_like(q)


def _resolution(r: Recording, rates: bands.Rates) -> FloatArray:
    """Speed noise after the position filter, at least 0.2 % of the rms speed (d,)."""
    fs, cutoff = r.rate, rates.position
    sigma_q = standstill.position_noise(r.q)
    # s_v = s_q 2 pi fc sqrt(2 fc / (3 fs)) for white noise up to fc
    sigma_v = sigma_q * 2 * np.pi * cutoff * np.sqrt(2 * cutoff / (3 * fs))
    rms = np.sqrt(np.mean(np.diff(r.q, axis=0) ** 2, axis=0)) * fs
    out: FloatArray = np.maximum(np.maximum(sigma_v, 0.002 * rms), 1e-9)
    return out
