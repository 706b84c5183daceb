"""Identification by manual excitation, motor constants included (thesis paper II).

    tau_s = Y(q, q', q'') pi + Y_f(q') phi - diag(u) kappa

where the hand's force is measured at the tip, tau_s = J^T F_s, and the motors give kappa u for a
commanded u.  Linear least squares in x = (pi, phi, kappa).  What the data do not determine is
said, not guessed: without a hand's force only ratios of x are known; without motor torque kappa
is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.errors import FitError
from hil.models.phantom import Premium

FloatArray = NDArray[np.float64]
#: Smallest singular value, relative to the largest, that counts.
_TOLERANCE = 1e-6
#: Speed over which the sign of the Coulomb column is resolved [rad/s].
_SOFT = 0.02
NAMES = (
    *Premium.names,
    *(f"j{j}.{c}" for j in (1, 2, 3) for c in ("fc", "fv")),
    *(f"j{j}.kappa" for j in (1, 2, 3)),
)


@dataclass(frozen=True)
class Identified:
    """Result of an identification.

    Parameters
    ----------
    values, stderr : dict
        By name; standard error infinite where the data do not determine the value.
    rank, condition : int, float
        Of the column-scaled regressor.
    undetermined : tuple of str
        Names of parameters that a direction without information touches.
    text : str
        What that means and what to do.
    """

    values: dict[str, float]
    stderr: dict[str, float]
    rank: int
    condition: float
    undetermined: tuple[str, ...]
    text: str


def regressor(q: FloatArray, qd: FloatArray, qdd: FloatArray, u: FloatArray) -> FloatArray:
    """Columns of (pi, phi, kappa), shape (3 n, 17), joints of an instant together.

    Parameters
    ----------
    q, qd, qdd : ndarray (n, 3)
        Motion [rad, rad/s, rad/s^2], filtered alike.
    u : ndarray (n, 3)
        Commanded motor torque at the joint [N m], filtered like the rest.
    """
    n = len(q)
    out = np.zeros((n, 3, len(NAMES)))
    out[:, :, :8] = Premium(()).regressor(q, qd, qdd)
    for j in range(3):
        out[:, j, 8 + 2 * j] = np.tanh(qd[:, j] / _SOFT)
        out[:, j, 9 + 2 * j] = qd[:, j]
        out[:, j, 14 + j] = -u[:, j]
    return out.reshape(3 * n, -1)


def identify(
    q: FloatArray, qd: FloatArray, qdd: FloatArray, u: FloatArray, tau_s: FloatArray
) -> Identified:
    """Least squares with the truth about its rank.

    Parameters
    ----------
    q, qd, qdd, u : ndarray (n, 3)
        See `regressor`.
    tau_s : ndarray (n, 3)
        Joint torque of the measured force ON the tip, J^T F_s [N m].

    Raises
    ------
    FitError
        If the arm never moves.
    """
    x, y = regressor(q, qd, qdd, u), tau_s.reshape(-1)
    size = np.sqrt((x**2).mean(axis=0))
    if not size[:8].any() or not np.ptp(q, axis=0).any():
        raise FitError("the arm does not move in this record; nothing can be identified")
    unit = x / np.where(size > 0, size, 1.0)
    # scale of the equation itself, for the case tau_s = 0 whose null vector is x
    _, s, vt = np.linalg.svd(unit, full_matrices=False)
    rank = int(np.sum(s > _TOLERANCE * s[0]))
    inverse = vt[:rank].T / s[:rank]
    theta = inverse @ (inverse.T @ (unit.T @ y))
    rest = y - unit @ theta
    variance = float(rest @ rest) / max(y.size - rank, 1)
    spread = np.sqrt(variance * (inverse**2).sum(axis=1))
    lost = (vt[rank:] ** 2).sum(axis=0) > 1e-6 if rank < s.size else np.zeros(s.size, bool)
    with np.errstate(divide="ignore", invalid="ignore"):  # a column of zeros: its value is unknown
        values = np.where(size > 0, theta / size, np.nan)
        stderr = np.where(lost | (size == 0), np.inf, spread / size)
    names = tuple(n for n, out in zip(NAMES, lost, strict=True) if out)
    return Identified(
        dict(zip(NAMES, values.tolist(), strict=True)),
        dict(zip(NAMES, stderr.tolist(), strict=True)),
        rank,
        float(s[0] / s[rank - 1]),
        names,
        _advice(rank, u, y),
    )


def _advice(rank: int, u: FloatArray, tau_s: FloatArray) -> str:
    if rank == len(NAMES):
        return "all parameters are determined, motor constants included"
    if not np.any(tau_s):
        return (
            "no hand's force: every parameter may be scaled by the same factor, only ratios are "
            "known; push the arm by hand with a force sensor, or take the motor constants as given"
        )
    if not np.any(u):
        return (
            "no motor torque: the motor constants do not act and are not determined; let the "
            "motors give a small torque (gravity compensation, dither) while the hand moves the arm"
        )
    return "the motion is not rich enough; move all joints, in both directions, at several speeds"


def richness(q: FloatArray, qd: FloatArray, qdd: FloatArray, cells: int = 10) -> dict[str, float]:
    """Measures of how rich a motion is (the thesis leaves the word undefined).

    Returns
    -------
    dict
        ``inverse_condition`` of the column-scaled regressor without motors, ``log_det`` of its
        normal matrix (at most 0), ``cells``: share of velocity cells visited, ``entropy`` of the
        velocity histogram relative to a uniform one.
    """
    x = regressor(q, qd, qdd, np.zeros_like(q))[:, :14]
    unit = x / np.maximum(np.sqrt((x**2).mean(axis=0)), 1e-300)
    s = np.linalg.svd(unit, compute_uv=False)
    top = np.abs(qd).max(axis=0)
    at = np.floor((qd / np.maximum(top, 1e-300) + 1) / 2 * (cells - 1e-9)).astype(int)
    _, counts = np.unique(at, axis=0, return_counts=True)
    p = counts / counts.sum()
    return {
        "inverse_condition": float(s[-1] / s[0]),
        "log_det": float(2 * np.log(np.maximum(s / np.sqrt(len(x)), 1e-300)).sum()),
        "cells": float(counts.size / cells**3),
        "entropy": float(-(p * np.log(p)).sum() / np.log(cells**3)),
    }
