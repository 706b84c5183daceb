"""A cable-driven arm of three joints seen from its motors: a filter a joint, and networks.

    Jm_j q_m'' = tau_c - Fcm sgn~(q_m') - Fvm q_m' - k1 D - k3 D^3,        D = q_m - q
    L(q) q''   = k1 D + k3 D^3 - Fcl sgn~(q') - Fvl q' - C q' - N - tau_n,  L = M - diag(Jm)

Each joint has an unscented filter with the ten states of `hil.estimate.elastic_ukf`: its link's
inertia is 1 / (L^-1)_jj, and what the other links' torques do to it enters as a known torque.  The
momentum that the corrections bring in a second, (Jm K_2 + L K_4) innovation / T, is what the model
lacks: friction tau_n that the networks of `hil.controllers.estimators.wavelets` learn while nothing
touches the arm, a force on the tip afterwards.  Thesis section 3.1.3 is one joint; filter and
networks together on three joints are its future work.

First the parameters, as in a rig file, and what the estimator tells; then the compiled kernels:
loads of the links, a filter a joint, what is left.  `c`, `n`, `f` and `w` are their records.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numba as nb
import numpy as np

from hil.controllers import dynamics
from hil.controllers.estimators import network, wavelets
from hil.controllers.estimators.network import WaveletConfig
from hil.controllers.lawrence_config import PREMIUM
from hil.errors import ConfigError
from hil.estimate.elastic_ukf import UKF_DTYPE, N, UkfConfig, correct, foresee
from hil.signals.device import FloatArray

_EACH = (
    "stiffness",
    "hardening",
    "coulomb_motor",
    "viscous_motor",
    "coulomb_link",
    "viscous_link",
)
TRANSMISSION_COLUMNS = (
    *(f"force_{axis}" for axis in "xyz"),
    *(
        f"{what}{j}"
        for what in ("torque", "position", "velocity", "cable", "friction", "innovation", *_EACH)
        for j in (1, 2, 3)
    ),
    "learning",
    "nodes",
)
_UNITS = (
    *["N"] * 3,
    *["N m"] * 3,
    *["rad"] * 3,
    *["rad/s"] * 3,
    *["N m"] * 6,
    *["rad"] * 3,
    *["N m/rad"] * 3,
    *["N m/rad^3"] * 3,
    *["N m"] * 3,
    *["N m s/rad"] * 3,
    *["N m"] * 3,
    *["N m s/rad"] * 3,
    *["1"] * 2,
)
#: Reflected rotors of the Premium 1.5 [kg m^2], and a count of its encoders [rad].
ROTORS, _COUNTS = (1.8e-4, 1.3e-4, 1.3e-4), (1.15e-4, 1.37e-4, 1.37e-4)


@dataclass(frozen=True)
class TransmissionConfig:
    """Parameters of the estimator.

    Parameters
    ----------
    model : tuple of 8 floats
        Rigid-body parameters pi of the arm with rotors and sensor.
    rotor : tuple of 3 floats
        Reflected inertia of the motors Jm [kg m^2].
    start : tuple of 6 or 18 floats
        First guess of k1 [N m/rad], k3 [N m/rad^3], Fcm [N m], Fvm [N m s/rad], Fcl, Fvl.
    resolution : tuple of 3 floats
        Encoder counts [rad].
    noise : tuple of 5 floats
        Variances a tick: q_m, q_m', q, q', log parameters.
    spread : float
        Variance of the log parameters at the start.
    soft : float
        Speed over which the sign of friction is resolved [rad/s].
    corner_hz : float
        Low-pass of the force.
    learn_until : float
        Time after which parameters and networks stay as they are [s].
    touch : float
        Measured force above which, and for half a second after, nothing is learnt [N].
    network : table
        See `WaveletConfig`; nodes = 0: the filters alone.
    lengths : tuple of 2 floats
        l1, l2 [m].
    """

    model: tuple[float, ...] = PREMIUM
    rotor: tuple[float, float, float] = ROTORS
    start: tuple[float, ...] = (150.0, 1e4, 0.008, 6e-4, 0.004, 6e-4)
    resolution: tuple[float, float, float] = _COUNTS
    noise: tuple[float, ...] = (1e-12, 1e-4, 1e-12, 1e-4, 1e-10)
    spread: float = 0.1
    soft: float = 0.02
    corner_hz: float = 10.0
    learn_until: float = float("inf")
    touch: float = 0.3
    network: WaveletConfig = field(default_factory=lambda: WaveletConfig(nodes=0))
    lengths: tuple[float, float] = dynamics.LINK_LENGTHS

    def __post_init__(self) -> None:
        if len(self.model) != 8 or len(self.start) not in (6, 18):
            raise ConfigError("elastic-ukf: model needs 8 numbers, start 6 or 18")
        if min(self.corner_hz, self.touch) <= 0.0:
            raise ConfigError("elastic-ukf: corner_hz and touch must be positive")
        self.joints()

    def joints(self) -> list[UkfConfig]:
        """One filter a joint."""
        rows = np.resize(self.start, 18).reshape(3, 6)
        return [
            UkfConfig(
                rotor, 1e-3, tuple(map(float, row)), grain, self.noise, self.spread, self.soft
            )
            for rotor, row, grain in zip(self.rotor, rows, self.resolution, strict=True)
        ]


#: Memory: filters (3 x (N + N^2)), network's friction (3), residuals (3), time, last touch.
_EACH_JOINT = N + N * N
_FILTERS = 3 * _EACH_JOINT
_FIRST = _FILTERS + 8
#: Variance of a logarithm that counts as known; Runge-Kutta steps a tick.
KNOWN_VARIANCE = 1e-12
STEPS_A_TICK = 4


@nb.njit(cache=True, nogil=True)
def links(q: Any, c: Any, w: Any) -> None:
    """L(q) = M - diag(Jm) into w.matrix (3, 3) [kg m^2]; joint 1 stands alone (M12 = M13 = 0)."""
    w.goal[:] = 0.0
    dynamics.premium_inverse_dynamics(q, w.goal, w.goal, c.model, w.flow)
    for k in range(3):
        w.room[:] = 0.0
        w.room[k] = 1.0
        dynamics.premium_inverse_dynamics(q, w.goal, w.room, c.model, w.seen)
        for j in range(3):
            w.matrix[j, k] = w.seen[j] - w.flow[j]
    for j in range(3):
        w.matrix[j, j] = max(w.matrix[j, j] - c.rotor[j], 0.2 * w.matrix[j, j])
    # what is left stays positive, whatever the parameters
    most = 0.9 * np.sqrt(w.matrix[1, 1] * w.matrix[2, 2])
    w.matrix[1, 2] = w.matrix[2, 1] = min(max(w.matrix[1, 2], -most), most)


@nb.njit(cache=True, nogil=True)
def loads(m: Any, q: Any, c: Any, w: Any) -> None:
    """Links' inertias 1 / (L^-1)_jj, and known torques ON the links (3,) [N m].

    L q'' = b  =>  (det / L33) q_2'' = b_2 - (L23 / L33) b_3, and 2, 3 exchanged.
    """
    links(q, c, w)
    for j in range(3):
        w.speed[j], w.goal[j] = m[_EACH_JOINT * j + 3], 0.0
    dynamics.premium_inverse_dynamics(q, w.speed, w.goal, c.model, w.flow)
    for j in range(3):
        x = m[_EACH_JOINT * j : _EACH_JOINT * j + N]
        stretch = x[0] - x[2]
        w.load[j] = -w.flow[j] - m[_FILTERS + j]
        pull = np.exp(x[4]) * stretch + np.exp(x[5]) * stretch**3
        rub = np.exp(x[8]) * np.tanh(x[3] / c.soft) + np.exp(x[9]) * x[3]
        w.goal[j] = pull - rub + w.load[j]
    a, b, s = w.matrix[1, 1], w.matrix[2, 2], w.matrix[1, 2]
    w.link[0], w.link[1], w.link[2] = w.matrix[0, 0], a - s * s / b, b - s * s / a
    w.load[1] -= s / b * w.goal[2]
    w.load[2] -= s / a * w.goal[1]


@nb.njit(cache=True, nogil=True)
def begin(j: int, y: float, f: Any, c: Any) -> None:
    """First guess of joint j at motor angle y [rad]."""
    for r in range(N):
        f.x[r] = c.start[j, r - 4] if r >= 4 else (y if r in (0, 2) else 0.0)
        for s in range(N):
            f.p[r, s] = c.spread[r] if r == s else 0.0


@nb.njit(cache=True, nogil=True)
def hold(f: Any) -> None:
    """Take the parameters for known; their own covariance is kept in the memory meanwhile."""
    for r in range(N):
        for s in range(N):
            if r >= 4 or s >= 4:
                f.p[r, s] = KNOWN_VARIANCE if r == s else 0.0


@nb.njit(cache=True, nogil=True)
def joint(
    j: int, phase: int, y: float, u: float, free: bool, f: Any, c: Any, w: Any, m: Any, at: int
) -> None:
    """Filter of one joint over one period; into w what it corrects a second.

    Memory m from `at`: state (N,), covariance (N, N).
    """
    if phase == 0:
        begin(j, y, f, c)
    else:
        for r in range(N):
            f.x[r] = m[at + r]
            for s in range(N):
                f.p[r, s] = m[at + N + N * r + s]
        if phase == 1:
            # the arm was moved meanwhile; its parameters were not
            f.x[0], f.x[1], f.x[2], f.x[3] = y, 0.0, y, 0.0
    if not free and phase > 0:
        hold(f)
    f.noise[4:] = c.wander if free else 0.0
    f.c[0], f.c[1], f.c[2], f.c[3] = 1.0 / c.rotor[j], 1.0 / w.link[j], 1.0 / c.soft, w.load[j]
    if phase == 2 and not (foresee(f, u, c.period, STEPS_A_TICK) and np.isfinite(f.x[0])):
        begin(j, y, f, c)
    w.innovation[j] = correct(f.x, f.p, y, f.variance, f.gain)
    for r in range(N):
        m[at + r] = f.x[r]
        for s in range(N):
            if free or phase == 0 or r < 4 or s < 4:
                m[at + N + N * r + s] = f.p[r, s]
    w.motor[j] = c.rotor[j] * f.gain[1] * w.innovation[j] / c.period
    w.slope[j] = f.gain[3] * w.innovation[j] / c.period


@nb.njit(cache=True, nogil=True)
def unexplained(phase: int, c: Any, w: Any, now: Any) -> None:
    """Torque that no filter foresaw, through a low-pass, into w.r (3,) [N m]."""
    for j in range(3):
        push = w.motor[j]
        for k in range(3):
            push += w.matrix[j, k] * w.slope[k]
        # r <- r + share (momentum a second - r)
        at = _FILTERS + 3 + j
        now[at] += c.share * ((push if phase == 2 else 0.0) - now[at])
        w.r[j] = now[at]


@nb.njit(cache=True, nogil=True)
def rub(free: bool, n: Any, nets: Any, psi: Any, w: Any, now: Any) -> None:
    """Friction by the networks into w.rub (3,) [N m]; while the arm is free, they learn."""
    wavelets.predict_network(w.speed, n, nets, psi, w.rub, w.seen)
    for j in range(3):
        now[_FILTERS + j] = w.rub[j]
        # what is left is learnt on top of what is known
        w.goal[j] = w.seen[j] - w.r[j]
    if free and nets.size > wavelets.HEAD_NUMBERS:
        wavelets.learn_weights(w.goal, w.seen, n, nets)
        wavelets.adapt_structure(w.speed, n, nets)


@nb.njit(cache=True, nogil=True)
def _estimate(
    phase: int,
    u: Any,
    sent: Any,
    c: Any,
    n: Any,
    psi: Any,
    f: Any,
    w: Any,
    past: Any,
    now: Any,
    out: Any,
) -> None:
    """One period; see `hil.controllers.estimators.transmission.Transmission.update`."""
    now[:] = past
    free = network.untouched(phase, u[6:9], c, past, now, _FIRST - 2)
    nets = now[_FIRST:]
    if phase == 0:
        wavelets.clear(nets)
        for j in range(3):
            begin(j, u[j], f[j], c)
            now[_EACH_JOINT * j : _EACH_JOINT * j + N] = f[j].x
    loads(now, u[:3], c, w)
    for j in range(3):
        joint(j, phase, u[j], sent[j], free, f[j], c, w, now, j * _EACH_JOINT)
        w.speed[j] = f[j].x[3]
    unexplained(phase, c, w, now)
    rub(free, n, nets, psi, w, now)
    dynamics.jacobian(u[:3], c.lengths, w.jacobian)
    dynamics.solve_transposed(w.jacobian, w.r, w.square, out)
    tell(f, w, out)
    out[_NAMED - 2], out[_NAMED - 1] = free, network.count(nets)


_NAMED = len(TRANSMISSION_COLUMNS)


@nb.njit(cache=True, nogil=True)
def tell(f: Any, w: Any, out: Any) -> None:
    """Estimates of the joints into `out`, in the order of NAMES."""
    for j in range(3):
        x = f[j].x
        stretch, k1, k3 = x[0] - x[2], np.exp(x[4]), np.exp(x[5])
        out[3 + j], out[6 + j], out[9 + j] = w.r[j], x[2], x[3]
        out[12 + j] = k1 * stretch + k3 * stretch**3
        out[15 + j], out[18 + j] = w.rub[j], w.innovation[j]
        for e in range(6):
            out[21 + 3 * e + j] = np.exp(x[4 + e])


_F = np.float64
_KNOWN = np.dtype(
    [
        ("model", _F, (8,)),
        ("lengths", _F, (2,)),
        ("rotor", _F, (3,)),
        ("start", _F, (3, 6)),
        ("spread", _F, (N,)),
        ("wander", _F),
        ("soft", _F),
        ("period", _F),
        ("share", _F),
        ("until", _F),
        ("touch", _F),
    ]
)
_WORK = np.dtype(
    [
        *(
            (name, _F, (3,))
            for name in (
                "rub",
                "seen",
                "goal",
                "flow",
                "room",
                "r",
                "link",
                "load",
                "speed",
                "slope",
                "motor",
                "innovation",
            )
        ),
        ("jacobian", _F, (3, 3)),
        ("square", _F, (3, 3)),
        ("matrix", _F, (3, 3)),
    ]
)


class Transmission:
    """The estimator of one arm; see `hil.signals.device.Estimator`.

    Parameters
    ----------
    config : TransmissionConfig
        Parameters.
    period : float
        Of the loop [s].
    """

    names, units, force, message = TRANSMISSION_COLUMNS, _UNITS, 0, "TransmissionEstimate"

    def __init__(self, config: TransmissionConfig, period: float) -> None:
        self.corner_hz, joints = config.corner_hz, config.joints()
        self.memory = _FIRST + wavelets.memory_size(config.network.nodes)
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
        self._f = np.zeros(3, UKF_DTYPE)
        for record, one in zip(self._f, joints, strict=True):
            record["noise"], record["w"] = one.variances(), one.weights()
            record["variance"] = one.resolution**2 / 12

    def update(
        self,
        phase: int,
        past: FloatArray,
        u: FloatArray,
        sent: FloatArray,
        now: FloatArray,
        out: FloatArray,
    ) -> None:
        """One period; see `hil.signals.device.Estimator`."""
        _estimate(phase, u, sent, self._c, self._n, self._psi, self._f, self._w, past, now, out)


Config = TransmissionConfig
build = Transmission
