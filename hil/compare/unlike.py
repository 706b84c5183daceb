"""Whether what is left at the noise floor is distributed as noise is.

Noise that many small causes add up to is Gaussian, whatever its colour.  A wave, or a torque that
switches, keeps to its two sides, and bursts stand out; no function of the motion need foretell
them, and a floor that is measured holds them.  So of the residual r of n instants, each run by its
own mean and rms, with the autocorrelation rho:

    k = mean(r^4) / mean(r^2)^2 - 3,   se = sqrt(24 / n (1 + 2 sum rho^4)).

A wave has k = -3/2, a switch -2, noise 0.  Source: Bai and Ng, J. Business & Economic Statistics
23, 2005, 49-60 (tests of k for data that depend on each other).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
CODE = "unlike-noise"
#: Kurtosis, and its standard errors, below which a residual keeps to two sides: one of a thousand
#: joints with Gaussian noise of any colour.
SWINGS, SURE = -0.5, -2.3
#: Kurtosis that no wave has.
SWITCH = -1.6
#: The same above which it comes in bursts; noise of turning encoders reaches 0.9.
BURSTS, CLEAR = 1.0, 5.0
#: Errors up to so many floors may be called adequate.
NEAR = 1.25
#: Fewer instants tell nothing.
FEWEST = 200
#: Autocorrelations counted; share of the time that is called bursts; their length [s].
LAGS, TENTH, LENGTH = 400, 0.1, 0.25
#: Instants that are named, and the Fourier transform's padding.
NAMED, PADDED = 3, 4


@dataclass(frozen=True)
class Unlike:
    """What is left on one joint, where it is no noise.

    Parameters
    ----------
    joint : str
        Name.
    kurtosis : float
        Of the residual; noise has 0.
    swings : bool
        Whether it keeps to two sides; else it comes in bursts.
    text : str
        One sentence without its full stop.
    """

    joint: str
    kurtosis: float
    swings: bool
    text: str


def unlike(result: FitResult, error: FloatArray, floor: FloatArray) -> list[Unlike]:
    """Joints that move, are at their floor, and leave something other than noise.

    Parameters
    ----------
    result : FitResult
        The last fit, of motor efforts; of others nothing is said.
    error, floor : ndarray (d,)
        Held-out error and the noise floor it is compared with [N m or N].
    """
    problem, out = result.problem, []
    moves = ~problem.holds & (error <= NEAR * floor) & (result.model.explains == "motor")
    for j in np.flatnonzero(moves).tolist():
        runs = [_scaled(result, j, k) for k in range(len(problem.recordings))]
        r = np.concatenate(runs)
        if r.size < FEWEST:
            continue
        k, se = kurtosis(r)
        joint = problem.joints[j]
        if k < SWINGS and k < SURE * se:
            out.append(Unlike(joint, k, True, f"{joint}: {_swings(k, runs, problem.rate)}"))
        elif k > BURSTS and k > CLEAR * se:
            out.append(Unlike(joint, k, False, f"{joint}: {_bursts(result, j, k, runs)}"))
    return out


def notes(found: Sequence[Unlike]) -> list[tuple[str, str]]:
    """Code and sentence of each."""
    return [(CODE, u.text) for u in found]


def kurtosis(r: FloatArray) -> tuple[float, float]:
    """Excess kurtosis of r (n,) of mean 0 and rms 1, and its standard error for Gaussian noise."""
    n = r.size
    power = np.abs(np.fft.rfft(r, 2 * n)) ** 2
    rho = np.clip(np.fft.irfft(power)[1 : min(LAGS, n // 4)] / n, -1.0, 1.0)
    # k = mean(r^4) - 3,   se = sqrt(24 / n (1 + 2 sum rho^4))
    return float(np.mean(r**4)) - 3.0, float(np.sqrt(24.0 / n * (1.0 + 2.0 * np.sum(rho**4))))


def _scaled(result: FitResult, j: int, k: int) -> FloatArray:
    """Residual of joint j in run k, of mean 0 and rms 1."""
    problem = result.problem
    r = result.residual[j, (problem.run == k) & problem.live[j]]
    out: FloatArray = (r - r.mean()) / max(float(r.std()), 1e-300) if r.size else r
    return out


def _swings(k: float, runs: list[FloatArray], rate: float) -> str:
    """Sentence on a residual of two sides, with its frequency in the thirds of the longest run."""
    longest = max(runs, key=len)
    at = [_frequency(part, rate) for part in np.array_split(longest, 3)]
    where = f"about {at[0]:.2g}, {at[1]:.2g} and {at[2]:.2g} Hz in the thirds of the run"
    if max(at) < 1.25 * min(at):
        where = f"about {at[1]:.2g} Hz"
    does = "switches between two levels" if k < SWITCH else "swings from side to side"
    return (
        f"what is left {does}, at {where}, and is no noise (kurtosis {k:.2g}; noise has 0, a wave "
        "-1.5, a switch -2): something acts there that the motion does not foretell"
    )


def _frequency(r: FloatArray, rate: float) -> float:
    """Frequency of the strongest wave [Hz]."""
    size = np.abs(np.fft.rfft((r - r.mean()) * np.hanning(r.size), PADDED * r.size))
    return float(np.argmax(size) * rate / (PADDED * r.size))


def _bursts(result: FitResult, j: int, k: float, runs: list[FloatArray]) -> str:
    """Sentence on a residual that comes in bursts, with where it is largest."""
    problem = result.problem
    squares = np.sort(np.concatenate(runs) ** 2)[::-1]
    share = float(squares[: round(TENTH * squares.size)].sum() / squares.sum())
    run = int(np.argmax([len(r) for r in runs]))
    own = problem.run == run
    when = problem.t[own & problem.live[j]] - float(problem.t[own].min())
    where = ", ".join(f"{x:.2f}" for x in _largest(runs[run], when, problem.rate))
    return (
        f"what is left comes in bursts: a tenth of the time holds {100 * share:.0f} % of its "
        f"square (kurtosis {k:.2g}; noise has 0 and 44 %). The largest are at {where} s of "
        f"{problem.recordings[run].name}: look what happens there"
    )


def _largest(r: FloatArray, t: FloatArray, rate: float) -> list[float]:
    """Times of the largest bursts in order, no two within a second."""
    width = max(round(LENGTH * rate), 1)
    power, found = np.convolve(r**2, np.ones(width), "same"), list[float]()
    for i in np.argsort(-power).tolist():
        if all(abs(t[i] - x) > 1.0 for x in found):
            found.append(float(t[i]))
        if len(found) == NAMED:
            break
    return sorted(found)
