"""A cable-driven arm of three joints seen from its motors: a filter a joint, and networks.

    Jm_j q_m'' = tau_c - Fcm sgn~(q_m') - Fvm q_m' - k1 D - k3 D^3,        D = q_m - q
    L(q) q''   = k1 D + k3 D^3 - Fcl sgn~(q') - Fvl q' - C q' - N - tau_n,  L = M - diag(Jm)

Each joint has an unscented filter with the ten states of `hil.estimate.elastic_ukf`: its link's
inertia is 1 / (L^-1)_jj, and what the other links' torques do to it enters as a known torque.  The
momentum that the corrections bring in a second, (Jm K_2 + L K_4) innovation / T, is what the model
lacks: friction tau_n that the networks of `hil.controllers.estimators.wavelets` learn while nothing
touches the arm, a force on the tip afterwards.  Thesis section 3.1.3 is one joint; filter and
networks together on three joints are its future work.
"""

from __future__ import annotations

import numpy as np

from hil.controllers.estimators import wavelets
from hil.controllers.estimators.transmission_config import NAMES, UNITS, TransmissionConfig
from hil.controllers.estimators.transmission_kernels import FIRST, estimate
from hil.estimate.elastic_ukf import RECORD, N
from hil.signals.device import FloatArray

_F = np.float64
_KNOWN = np.dtype([
    ("model", _F, (8,)), ("lengths", _F, (2,)), ("rotor", _F, (3,)), ("start", _F, (3, 6)),
    ("spread", _F, (N,)), ("wander", _F), ("soft", _F), ("period", _F), ("share", _F),
    ("until", _F), ("touch", _F),
])  # fmt: skip
_WORK = np.dtype([
    *((name, _F, (3,)) for name in (
        "rub", "seen", "goal", "flow", "room", "r", "link", "load", "speed", "slope", "motor",
        "innovation",
    )),
    ("jacobian", _F, (3, 3)), ("square", _F, (3, 3)), ("matrix", _F, (3, 3)),
])  # fmt: skip


class Transmission:
    """The estimator of one arm; see `hil.signals.device.Estimator`.

    Parameters
    ----------
    config : TransmissionConfig
        Parameters.
    period : float
        Of the loop [s].
    """

    names, units, force, message = NAMES, UNITS, 0, "TransmissionEstimate"

    def __init__(self, config: TransmissionConfig, period: float) -> None:
        self.corner_hz, joints = config.corner_hz, config.joints()
        self.memory = FIRST + wavelets.size(config.network.nodes)
        self._c, self._w = np.zeros(1, _KNOWN)[0], np.zeros(1, _WORK)[0]
        for name in ("model", "lengths", "rotor", "soft", "touch"):
            self._c[name] = getattr(config, name)
        gain = 2 * np.pi * config.corner_hz * period
        self._c["start"] = [np.log(j.start) for j in joints]
        self._c["spread"] = [1e-6, 1e-2, 1e-6, 1e-2, *[config.spread] * 6]
        self._c["wander"], self._c["until"] = config.noise[4], config.learn_until
        self._c["period"], self._c["share"] = period, gain / (1 + gain)
        self._n = config.network.record(gain / (1 + gain), period)
        self._psi = np.zeros(6 + config.network.nodes)
        self._f = np.zeros(3, RECORD)
        for record, one in zip(self._f, joints, strict=True):
            record["noise"], record["w"] = one.variances(), one.weights()
            record["variance"] = one.resolution**2 / 12

    def update(
        self, phase: int, past: FloatArray, u: FloatArray, sent: FloatArray, now: FloatArray,
        out: FloatArray,
    ) -> None:  # fmt: skip
        """One period; see `hil.signals.device.Estimator`."""
        estimate(
            phase, u, sent, self._c, self._n, self._psi, self._f, self._w, past, now, out
        )  # fmt: skip


Config = TransmissionConfig
build = Transmission
