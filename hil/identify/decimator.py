"""The effort filter: one linear operator that low-passes and decimates.

Of N instants only the lowest frequencies are wanted.  With N = p M, instants d, d + p, d + 2 p ...
have a transform X_d of their own of length M, and

    X[k] = sum_d exp(-2 pi i k d / N) X_d[k],    k <= M / 2

(decimation in time: Cooley, Tukey, Mathematics of Computation 19, 1965).
"""

from __future__ import annotations

import numba
import numpy as np
import scipy.fft
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@numba.njit(cache=True, nogil=True)
def _joined(parts: ComplexArray, turns: ComplexArray, out: ComplexArray) -> None:
    """Sum over d of turns (k, d) and parts (columns, M, d), to out (k, columns)."""
    for j in range(out.shape[1]):
        for k in range(out.shape[0]):
            real, imag = 0.0, 0.0
            for d in range(turns.shape[1]):
                x, turn = parts[j, k, d], turns[k, d]
                real += x.real * turn.real - x.imag * turn.imag
                imag += x.real * turn.imag + x.imag * turn.real
            out[k, j] = complex(real, imag)


class Decimator:
    """The one linear operator that every column and the effort pass: low-pass and decimate.

    Done in the frequency domain, so that it is exactly linear, exactly zero-phase and the
    same for all: y = X theta before it means y = X theta after it.

    Parameters
    ----------
    n : int
        Instants before.
    fs : float
        Their rate [Hz].
    cutoff : float
        Cut-off (half power) [Hz]; output rate is about three times that.
    """

    def __init__(self, n: int, fs: float, cutoff: float) -> None:
        self._good = int(scipy.fft.next_fast_len(n, real=True))
        duration = self._good / fs
        # a length without large prime factors, so that the transform back is quick
        wanted = scipy.fft.next_fast_len(max(int(duration * 1.5 * cutoff), 8), real=True)
        self._keep = min(int(wanted), self._good // 2) + 1
        f = np.arange(self._keep) / duration
        # |H|^2 of a 4th order Butterworth, forward and backward
        self._gain = 1.0 / (1.0 + (f / cutoff) ** 8)
        self._out = 2 * (self._keep - 1)
        most = self._good // max(2 * (self._keep - 1), 1)
        self._parts = next(p for p in range(max(most, 1), 0, -1) if self._good % p == 0)
        # exp(-2 pi i k d / N) times the gain, and what the shorter transform back asks for
        phase = np.outer(np.arange(self._keep), np.arange(self._parts)) / self._good
        size = self._gain[:, None] * (self._out / self._good)
        self._turns = size * np.exp(-2j * np.pi * phase)
        self._n = n
        self.rate = self._out / duration
        edge = max(2, int(np.ceil(1.5 / cutoff * self.rate)))
        last = int(np.floor((n - 1) / fs * self.rate)) - edge
        self._slice = slice(edge, max(last, edge + 1))
        self.times = np.arange(self._out)[self._slice] / self.rate

    def __call__(self, x: FloatArray) -> FloatArray:
        """Filter and decimate along axis 0; (n, ...) to (n_out, ...)."""
        # pad by a straight line back to the start: linear in x, and without a step
        pad = self._good - self._n
        if pad:
            ramp = np.arange(1, pad + 1).reshape(-1, *[1] * (x.ndim - 1)) / (pad + 1)
            x = np.concatenate([x, x[-1:] + (x[:1] - x[-1:]) * ramp])
        flat = x.reshape(self._good, -1)
        # every p-th instant has a spectrum of its own: short, and at hand at once
        parts = scipy.fft.rfft(flat.T.reshape(flat.shape[1], -1, self._parts), axis=1)
        spectrum = np.empty((self._keep, flat.shape[1]), dtype=np.complex128)
        _joined(parts, self._turns, spectrum)
        out = scipy.fft.irfft(spectrum, n=self._out, axis=0)
        result: FloatArray = out[self._slice].reshape(-1, *x.shape[1:])
        return result

    def adjoint(self, y: FloatArray) -> FloatArray:
        """Transpose of the operator but for the padding: x'(F' y) = (F x)' y; (n_out,) to (n,)."""
        full = np.zeros(self._out)
        full[self._slice] = y
        spectrum = np.zeros(self._good // 2 + 1, dtype=np.complex128)
        spectrum[: self._keep] = scipy.fft.rfft(full)[: self._keep] * self._gain
        spectrum[self._keep - 1] *= 0.5  # the highest frequency has no mirror image after it
        out: FloatArray = scipy.fft.irfft(spectrum, n=self._good)[: self._n]
        return out
