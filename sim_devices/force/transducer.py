"""A strain-gauge transducer: wrench in, gauge words out, with all that spoils them.

word_k = round(S_k (I + E) f (1 + a dT) + b_k + z_k dT + w_k(t) + n_k), held at the rails

S is the inverse of the calibration matrix, E what the certificate does not know (gain error and
cross-talk), dT the warming, w a random walk, n white noise.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from math import exp
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown

FloatArray = NDArray[np.float64]
#: Readings whose random numbers are drawn at once: few, so that none takes much longer than others.
_BLOCK = 16


@dataclass(frozen=True)
class Certificate:
    """What the manufacturer measured of one transducer.

    Parameters
    ----------
    serial : str
        Serial number.
    matrix : ndarray (6, 6)
        Counts of force or torque per gauge word; rows Fx Fy Fz Tx Ty Tz.
    force_counts, torque_counts : int
        Per unit of force and torque.
    force_unit, torque_unit : int
        Codes of the units: force 2 = N; torque 3 = N m, 4 = N mm.
    """

    serial: str
    matrix: FloatArray
    force_counts: int
    torque_counts: int
    force_unit: int
    torque_unit: int

    def wrench_per_word(self) -> FloatArray:
        """Matrix (6, 6) [N, N m] per word."""
        metre = {3: 1.0, 4: 1e-3}[self.torque_unit]
        scale = [1.0 / self.force_counts] * 3 + [metre / self.torque_counts] * 3
        return np.asarray(self.matrix * np.array(scale)[:, None])


def load(model: str) -> tuple[Certificate, dict[str, Any]]:
    """Certificate and imperfections of a transducer of `transducers.toml`.

    Raises
    ------
    ConfigError
        If there is none of that name.
    """
    table = tomllib.loads((files("hil.sim_devices.force") / "transducers.toml").read_text("utf-8"))
    if model not in table:
        raise ConfigError(unknown("simulated transducer", model, table))
    facts = table[model]
    volts = np.array(facts["matrix"] if "matrix" in facts else table["nano17"]["matrix"])
    if "matrix" not in facts:
        # no certificate is at hand: the pattern of the Nano17, stretched to the ranges
        ratio = np.array(facts["range"]) / np.array(table["nano17"]["range"])
        volts = volts * ratio[:, None]
    # words span the converter's 20 V; a million counts per unit
    matrix = np.float32(volts * 20.0 / 65536.0 * 1e6).astype(float)
    return Certificate(facts["serial"], matrix, 1_000_000, 1_000_000, 2, 4), facts


class SimulatedTransducer:
    """One sensor with its own imperfections.

    Parameters
    ----------
    model : str
        Name in `transducers.toml`.
    seed : sequence of int
        Of its imperfections and its noise.
    press : callable, optional
        Writes the load of now into an array (6,) before every reading.

    Attributes
    ----------
    load : ndarray (6,)
        Force [N] and torque [N m] ON it now, in its own frame.
    words : ndarray (6,) of int
        What the converters read.
    warming : float
        Above the temperature of calibration [K].
    """

    def __init__(
        self, model: str, seed: list[int], press: Callable[[FloatArray], None] | None = None
    ) -> None:
        self.certificate, facts = load(model)
        self._press = press
        self.max_force = float(facts["range"][0])
        rng = np.random.default_rng([*seed, 0xF7])
        gain = facts["gain_error"] * np.clip(rng.standard_normal(6), -2, 2) / 2
        cross = facts["crosstalk"] * np.clip(rng.standard_normal((6, 6)), -2, 2) / 2
        # cross-talk in shares of full scale: ranges of force and torque differ
        full = np.array(facts["range"]) * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])
        np.fill_diagonal(cross, gain)
        error = cross * full[:, None] / full[None, :]
        certified = self.certificate.wrench_per_word()
        self._response = np.linalg.inv(certified) @ (np.eye(6) + error)
        self._offset = facts["offset"] * rng.standard_normal(6)
        self._thermal = facts["offset_per_kelvin"] * rng.standard_normal(6)
        self._facts = np.array([facts["noise"], facts["walk"], facts["gain_per_kelvin"]])
        self._warm, self._tau = facts["warming"], facts["warming_time"]
        self._walk = np.zeros(6)
        self._rng, self._noise, self._left = rng, np.zeros((_BLOCK, 12)), 0
        self._last_ns = 0
        self.load, self.words = np.zeros(6), np.zeros(6, np.int64)
        self.warming = 0.0

    def read(self, t_ns: int) -> NDArray[np.int64]:
        """Words (6,) at `t_ns`."""
        if self._press is not None:
            self._press(self.load)
        if self._left == 0:
            self._rng.standard_normal(out=self._noise)
            self._left = _BLOCK
        # dT' = (T_end - dT) / tau, from cold at time 0
        self.warming = self._warm * (1.0 - exp(-t_ns * 1e-9 / self._tau))
        elapsed = max(0.0, (t_ns - self._last_ns) * 1e-9)
        self._last_ns = t_ns
        _words(
            self._response,
            self.load,
            self._offset,
            self._thermal,
            self._walk,
            self._facts,
            self.warming,
            elapsed,
            self._noise[_BLOCK - self._left],
            self.words,
        )
        self._left -= 1
        return self.words


@nb.njit(cache=True, nogil=True)
def _words(
    response: Any,
    load: Any,
    offset: Any,
    thermal: Any,
    walk: Any,
    facts: Any,
    warming: float,
    elapsed: float,
    random: Any,
    out: Any,
) -> None:
    noise, drift, gain = facts[0], facts[1], facts[2]
    for k in range(6):
        walk[k] += drift * np.sqrt(elapsed) * random[6 + k]
        strain = 0.0
        for j in range(6):
            strain += response[k, j] * load[j]
        word = strain * (1.0 + gain * warming) + offset[k] + thermal[k] * warming
        word += walk[k] + noise * random[k]
        out[k] = int(min(max(np.floor(word + 0.5), -32768.0), 32767.0))
