"""Single samples that stand out of their neighbours: transmission errors, loose contacts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hil.record.consistency import reached
from hil.record.finding import Finding
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: Times the largest bend of an ordinary sample (99 % of all) from which one is a spike.
OUT = 20.0
#: Bend that the value may keep behind a spike; more is a step.
BACK = 0.2


def spikes(x: FloatArray) -> NDArray[np.intp]:
    """Samples of a signal (n,) that leave it for one sample and come back.

    b_k = x_k - (x_{k-1} + x_{k+1}) / 2

    Parameters
    ----------
    x : ndarray (n,)
        Signal.

    Returns
    -------
    ndarray of int
        Indices; empty below 1000 samples, where the ordinary bend is not known.
    """
    none = np.empty(0, dtype=np.intp)
    if x.size < 1000:
        return none
    bend = np.abs(x[1:-1] - (x[:-2] + x[2:]) / 2)
    if reached(bend, float(bend.max()) / OUT):
        return none
    usual = float(np.quantile(bend, 0.99))
    moved = np.abs(np.diff(x))
    if not np.any(moved):
        return none
    count = float(np.min(moved[moved > 0]))
    limit = max(OUT * usual, 5 * count, 0.02 * float(np.subtract(*np.quantile(x, [0.99, 0.01]))))
    found: NDArray[np.intp] = 1 + np.flatnonzero(bend > limit)
    back = np.abs(x[found + 1] - x[found - 1]) < BACK * bend[found - 1]
    return found[back]


def check_spikes(r: Recording) -> Iterator[Finding]:
    """A warning for every column with spikes."""
    for k, joint in enumerate(r.joints):
        for name, values in (("q", r.q), ("tau", r.tau), ("tauext", r.tau_ext)):
            if values is None:
                continue
            at = spikes(values[:, k])
            if at.size:
                first = int(at[0])
                count = "once" if at.size == 1 else f"{at.size} times"
                yield Finding(
                    "spike", "warning", joint,
                    f"{name}{k + 1} leaves its neighbours for a single sample {count}, first at "
                    f"{r.t[first]:.6g} s ({values[first, k]:.4g} between "
                    f"{values[first - 1, k]:.4g} and {values[first + 1, k]:.4g}): an analysis "
                    "puts there what its neighbours say",
                )  # fmt: skip
