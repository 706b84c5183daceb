"""The residual's spectra: orders over position, lines and octaves over time.

An amplitude over n instants of noise with rms s and n / c independent values has in each of its
two components the standard error  s sqrt(2 c / n);  the largest of N orders stays below

    band = s sqrt(2 c / n) sqrt(2 ln(N / 0.01))

with 99 % probability (Rayleigh amplitudes).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from hil.compare.floor import Floor
from hil.identify.result import FitResult
from hil.interval import interval

FloatArray = NDArray[np.float64]
LEVEL = 0.01
#: Highest order, in periods over the span; what is faster meets fewer than five instants.
HIGHEST = 80.0


@dataclass(frozen=True)
class Spectrum:
    """One spectrum of one joint's residual.

    Parameters
    ----------
    feature : str
        ``order``, ``friction-order``, ``line`` or ``frequency``.
    unit : str
        Unit of `x`.
    x, amplitude, band : ndarray (m,)
        Order or frequency, amplitude of the residual there [N m or N], and its noise band.
    """

    feature: str
    unit: str
    x: FloatArray
    amplitude: FloatArray
    band: FloatArray


@dataclass(frozen=True)
class Line:
    """One place of a spectrum above its band."""

    feature: str
    low: float
    high: float
    unit: str
    amplitude: float
    strength: float
    share: float
    text: str


def order_spectra(result: FitResult, floor: Floor, j: int) -> list[Spectrum]:
    """Amplitude over the order of position, of the residual and of its friction-like part."""
    problem, live = result.problem, result.problem.live[j]
    q, v, r = problem.q[j, live], problem.qd[j, live], result.residual[j, live]
    span = float(np.ptp(q))
    if span <= 0 or q.size < 50:
        return []
    # an instant moves by |v| / rate: orders faster than five instants a period are not seen
    top = min(HIGHEST, span * problem.rate / (5 * max(float(np.quantile(np.abs(v), 0.5)), 1e-12)))
    orders = np.arange(1.5, max(top, 2.0), 0.25) / span
    noise = floor.scale[j] * np.sqrt(2 * floor.inflation[j] / q.size)
    band = np.full(orders.size, noise * np.sqrt(2 * np.log(orders.size / LEVEL)))
    wave = np.exp(-2j * np.pi * orders[:, None] * q)
    unit = f"1/{problem.robot.units[j]}"
    return [
        Spectrum(name, unit, orders, 2 * np.abs(wave @ (part - part.mean())) / q.size, band)
        for name, part in (("order", r), ("friction-order", r * np.sign(v)))
    ]


def time_spectra(result: FitResult, floor: Floor, j: int) -> list[Spectrum]:
    """Lines over the time's frequency, and rms by octave beside the noise's."""
    problem = result.problem
    run = np.argmax(np.bincount(problem.run))
    r = result.residual[j, problem.run == run]
    noise = floor.residual[j, problem.run == run]
    if r.size < 64:
        return []
    window: FloatArray = np.hanning(r.size)
    f = np.asarray(np.fft.rfftfreq(r.size, 1 / problem.rate), dtype=np.float64)
    size: FloatArray = 2 * np.abs(np.fft.rfft(r * window)) / window.sum()
    near = 2 * (max(r.size // 60, 5) // 2) + 1
    # a line stands out of its own neighbourhood: 1.18 turns a Rayleigh median into sigma
    local = scipy.signal.medfilt(size, near) / 1.18
    band = np.asarray(local * np.sqrt(2 * np.log(f.size / LEVEL)), dtype=np.float64)
    seen = (f > 0) & (f <= problem.rates.effort)
    line = Spectrum("line", "Hz", f[seen], size[seen], band[seen])
    edges: FloatArray = problem.rates.effort * np.exp2(np.arange(-6.0, 1.0))
    power = np.abs(np.fft.rfft(r)) ** 2, np.abs(np.fft.rfft(noise)) ** 2
    parts = [(f > a) & (f <= b) for a, b in zip([0.0, *edges[:-1]], edges, strict=True)]
    total = [np.array([np.sqrt(2 * p[part].sum()) / r.size for part in parts]) for p in power]
    scale = float(floor.scale[j]) / max(float(np.sqrt(np.mean(noise**2))), 1e-300)
    count = np.array([max(int(part.sum()), 1) for part in parts])
    octave = Spectrum("frequency", "Hz", edges, total[0], scale * total[1] * (1 + 3 / count**0.5))
    return [line, octave]


def lines(result: FitResult, floor: Floor, j: int) -> list[Line]:
    """The strongest place above its band in each spectrum of joint j, as a sentence."""
    joint, units = result.problem.joints[j], result.problem.robot.units
    effort = "N" if units[j] == "m" else "N m"
    excess = max(float(result.rms[j] ** 2 - floor.rms[j] ** 2), 1e-300)
    out = []
    for s in [*order_spectra(result, floor, j), *time_spectra(result, floor, j)]:
        strength = s.amplitude / np.maximum(s.band, 1e-300)
        k = int(np.argmax(strength))
        if strength[k] <= 1:
            continue
        low = float(s.x[k - 1] if s.feature == "frequency" and k else s.x[k])
        power = float(s.amplitude[k] ** 2) / (1 if s.feature == "frequency" else 2)
        size = f"{s.amplitude[k]:.2g} {effort}, {strength[k]:.1f} times its noise band"
        out.append(
            Line(
                s.feature, low, float(s.x[k]), s.unit, float(s.amplitude[k]),
                float(strength[k]), min(power / excess, 1.0),
                f"{joint}: {_what(s, k, low, result, j)} {size}",
            )
        )  # fmt: skip
    return out


def _what(s: Spectrum, k: int, low: float, result: FitResult, j: int) -> str:
    x = float(s.x[k])
    if s.feature == "frequency":
        return f"at {interval(low, x) if low < x else f'{x:.3g}'} Hz the error is"
    if s.feature == "line":
        where = "which the motion has, too," if _in_motion(result, j, x) else "not in the motion,"
        return f"the residual has a line at {x:.3g} Hz, {where} of"
    kind = "the residual" if s.feature == "order" else "the friction"
    return f"over position {kind} ripples with a period of {1 / x:.3g} {s.unit[2:]}, amplitude"


def _in_motion(result: FitResult, j: int, f: float) -> bool:
    """Whether the speed's spectrum has a line within one bin of f [Hz]."""
    problem = result.problem
    run = np.argmax(np.bincount(problem.run))
    v = problem.qd[j, problem.run == run]
    size = np.abs(np.fft.rfft((v - v.mean()) * np.hanning(v.size)))
    k = round(f * v.size / problem.rate)
    near = size[max(k - 2, 0) : k + 3].max(initial=0.0)
    wide = np.median(size[max(k - 40, 0) : k + 41])
    return bool(near > 6 * wide)
