"""One identification session on request (entry point ``phantom`` of ``hil.sim_sessions``)."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import asin, asinh, cos, exp, fabs, floor, pi, sin, sqrt, tanh
from typing import Any

import numba as nb
import numpy as np
import scipy.signal
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.sim_devices.plants import truth, world
from hil.sim_devices.plants.layout import ARM_DTYPE as PLANT_ARM
from hil.sim_devices.plants.layout import ARM_STATE_DTYPE as PLANT_STATE
from hil.sim_devices.plants.layout import ELEMENTS, NOISES, SUBSTEPS

# Further hidden laws, compiled; each is of another form than the library's of that name.

#: Load at which the exponent of the load friction is normalised [N m].
LOAD = 0.05
#: Mean of exp(1.2 sin x) over a turn: the Bessel function I0(1.2).
MEAN_HUM = 1.3937
#: Idler: inertia [kg m^2], shaft stiffness [N m/rad] and damping [N m s/rad].
IDLER, SHAFT, SHAFT_DAMPING = 2e-5, 20.0, 0.02


@nb.njit(cache=True, nogil=True)
def cable(p: Any, x: Any, i: int) -> float:
    """Torque [N m] that the cable of joint i carries: compliance, softness at zero, dead zone."""
    stretch = x.qm[i] - x.q[i]
    if p.slack[i] > 0.0:
        # nothing is carried within the gap, neither by the spring nor by its damper
        half = 0.5 * p.slack[i]
        if stretch > half:
            stretch -= half
        elif stretch < -half:
            stretch += half
        else:
            return 0.0
    # 1/k' = 1/k + give
    pull = p.cable[i] * stretch / (1.0 + p.cable[i] * p.give[i])
    if p.soft[i] > 0.0:
        # k' = k (1 + w^2) / (1 + soft + w^2), w = stretch / soft_at
        w = stretch / p.soft_at[i]
        pull *= (1.0 + w * w) / (1.0 + p.soft[i] + w * w)
    for j in range(3):
        pull += p.cable_damping[i, j] * (x.vm[j] - x.v[j])
    return float(pull)


@nb.njit(cache=True, nogil=True)
def motor(p: Any, x: Any, i: int, elapsed: float, tick: float, dt: float) -> float:
    """Torque [N m] of motor i: the plant's drive, a second-order lag, ripple and detents."""
    value = world.motor(p, x, i, elapsed, tick, dt)
    fed = x.drive[i]
    if p.slow_drive[i] > 0.0:
        # T^2 u'' + 1.4 T u' + u = drive
        w = 1.0 / p.slow_drive[i]
        x.slow[i, 1] += dt * (w * w * (fed - x.slow[i, 0]) - 1.4 * w * x.slow[i, 1])
        x.slow[i, 0] += dt * x.slow[i, 1]
        value += (1.0 + p.gain[i]) * (x.slow[i, 0] - fed)
        fed = x.slow[i, 0]
    if p.ripple[i] != 0.0:
        # commutation: |cos(phase / 2)| less its mean, times the torque
        value += p.ripple[i] * fed * (fabs(cos(0.5 * p.ripple_cycles[i] * x.qm[i])) - 2.0 / pi)
    if p.choke[i] != 0.0:
        # beyond L a tenth of what is asked for comes through, by a knee of L / 20
        beyond = fabs(fed) - 1.0 / p.choke[i]
        if beyond > 0.0:
            most = 0.9 * (beyond - 0.05 / p.choke[i] * tanh(20.0 * beyond * p.choke[i]))
            value -= most if fed > 0.0 else -most
    if p.leak[i] != 0.0:
        value += p.leak[i] * x.drive[(i + 1) % 3]
    if p.detent[i] != 0.0:
        # phase-modulated wave: all harmonics
        phase = p.detent_cycles[i] * x.qm[i]
        value += p.detent[i] * sin(phase + 0.4 * sin(phase) + 0.3)
    return float(value + p.offset[i])


@nb.njit(cache=True, nogil=True)
def motor_friction(p: Any, x: Any, i: int, t: float, tension: float, dt: float) -> float:
    """Further friction torque [N m] on motor i; `tension` is what its cable carries [N m]."""
    s, total = x.sm[i], 0.0
    if p.preslide[i] != 0.0:
        total += p.preslide[i] * world.slip(x.zp[i], p.preslide_at[i], p.weight, x.vm[i], dt)
    if p.rub[i] != 0.0:
        # triangular over position
        total += p.rub[i] * s * asin(sin(p.rub_cycles[i] * x.qm[i] + 0.6)) * 2.0 / pi
    if p.load_rub[i] != 0.0:
        total += p.load_rub[i] * s * (fabs(tension) / LOAD) ** 1.3
    if p.fade[i] != 0.0:
        # friction lost while the grease warms up: t / (t + 8 s)
        total -= p.fade[i] * s * t / (t + 8.0)
    if p.thixotropy[i] != 0.0:
        # structure rebuilds at rest and is sheared away: l' = (1 - l) / 3 - 1.5 |v| l
        x.thick[i] += dt * ((1.0 - x.thick[i]) / 3.0 - 1.5 * fabs(x.vm[i]) * x.thick[i])
        total += p.thixotropy[i] * x.thick[i] * s
    if p.sheared[i] != 0.0:
        # Eyring's fluid: asinh(v / ve)
        total += p.sheared[i] * asinh(x.vm[i] / p.sheared_speed[i])
    return float(total + p.placed_viscous[i] * x.qm[i] * x.vm[i])


@nb.njit(cache=True, nogil=True)
def link_torque(p: Any, x: Any, i: int, t: float, dt: float) -> float:
    """Further torque [N m] on link i: oscillator, disturbances in time, pair of positions."""
    total = p.telegraph[i] * x.flip[i]
    if p.oscillator[i] != 0.0:
        # J (w^2 (phi - q) + 0.08 w (phi' - v)), and its reaction on the attached mass
        w = p.oscillator_rate[i]
        push = w * w * (x.osc[i, 0] - x.q[i]) + 0.08 * w * (x.osc[i, 1] - x.v[i])
        x.osc[i, 1] -= dt * push
        x.osc[i, 0] += dt * x.osc[i, 1]
        total += p.oscillator[i] * push
    if p.hum[i] != 0.0:
        total += p.hum[i] * (exp(1.2 * sin(p.hum_rate[i] * t)) - MEAN_HUM)
    if p.chirp[i] != 0.0:
        # 0.5 Hz rising by 0.2 Hz a second
        total += p.chirp[i] * sin(2.0 * pi * (0.5 + 0.1 * t) * t)
    if p.pair[i] != 0.0:
        total += p.pair[i] * sin(6.0 * x.q[(i + 1) % 3]) * cos(5.0 * x.q[(i + 2) % 3])
    return float(total)


@nb.njit(cache=True, nogil=True)
def idlers(p: Any, x: Any, link: Any, dt: float) -> None:
    """Idler wheels that turn with two joints, on soft shafts; adds to `link` (3,) [N m]."""
    for i in range(3):
        if p.idler[i] == 0.0:
            continue
        # pairs (1, 2), (2, 3), (1, 3)
        a = 0 if i == 2 else i
        b = 2 if i == 2 else i + 1
        twist = x.q[a] + x.q[b] - x.idle[i, 0]
        torque = SHAFT * twist + SHAFT_DAMPING * (x.v[a] + x.v[b] - x.idle[i, 1])
        s = world.slip(x.idle_z[i], p.slip_link[a], p.weight, x.idle[i, 1], dt)
        x.idle[i, 1] += dt * (torque - p.idler[i] * (s + 0.1 * x.idle[i, 1])) / IDLER
        x.idle[i, 0] += dt * x.idle[i, 1]
        link[a] -= torque
        link[b] -= torque


@nb.njit(cache=True, nogil=True)
def _chance(p: Any, x: Any, random: Any, tick: float) -> None:
    """What happens at random in a tick: jittered delay, lost counts, the telegraph's flips."""
    for i in range(3):
        if p.jitter[i] > 0.0:
            # 0.7..1.3 of the mean, new every tick
            p.delay[i] = p.jitter[i] * (1.0 + 0.3 * min(max(random[6 + i], -1.0), 1.0))
        if p.slips[i] != 0.0 and fabs(random[6 + i]) > 3.7:
            # a burst of counts lost, five or six times in 25 s, against the motion
            x.lost[i] -= p.slips[i] * (1.0 if x.vm[i] > 0.0 else -1.0)
        if p.telegraph[i] != 0.0 and fabs(random[9 + i]) > 3.4:
            x.flip[i] = -x.flip[i]


@nb.njit(cache=True, nogil=True)
def _shaft(p: Any, x: Any, i: int) -> float:
    """What the encoder of motor i sees [rad]: its angle and its eccentric disc."""
    seen = float(x.qm[i])
    if p.wobble[i] != 0.0:
        phase = p.wobble_cycles[i] * x.qm[i]
        seen += p.wobble[i] * sin(phase + 0.5) / sqrt(1.0 + 0.5 * cos(phase))
    return seen


# The whole session in one compiled loop: encoders, control law, DAC, drive, plant.


@nb.njit(cache=True, nogil=True)
def _substep(p: Any, x: Any, t: float, elapsed: float, tick: float, dt: float, link: Any) -> None:
    """Semi-implicit Euler step of motors, cables and links; `link` (3,) is scratch [N m]."""
    for i in range(3):
        pull = cable(p, x, i)
        x.sm[i] = world.direction(p, x, i, dt)
        link[i] = pull - world.link_side(p, x, i, dt) + world.passive_force(p, x, i, dt)
        link[i] += link_torque(p, x, i, t, dt)
        x.heat[i] += dt * (fabs(x.vm[i]) - x.heat[i]) / p.warming_time
        push = motor(p, x, i, elapsed, tick, dt) - pull
        push -= world.motor_side(p, x, i, pull) + motor_friction(p, x, i, t, pull, dt)
        x.vm[i] += dt * push / p.rotor[i]
    idlers(p, x, link, dt)
    world.push_links(p, x, link, dt)
    if p.locked == 1:
        x.v[1:], x.vm[1:] = 0.0, 0.0
    for i in range(3):
        x.qm[i] += dt * x.vm[i]
        x.q[i] += dt * x.v[i]


@nb.njit(cache=True, nogil=True)
def control(p: Any, r: Any, q: Any, v: Any, gains: Any, codes: Any) -> None:
    """PD to the reference `r` (3, 3) with nominal torques fed forward, rounded to DAC codes.

    u = K (r - q) + D (r' - v) + I r'' + Fc tanh(r' / 0.02) + g(q)
    """
    for i in range(3):
        u = gains[0, i] * (r[i, 0] - q[i]) + gains[1, i] * (r[i, 1] - v[i])
        u += gains[3, i] * r[i, 2] + gains[4, i] * tanh(r[i, 1] / 0.02)
        u += gains[2, i] * (cos(q[i]) if i == 1 else sin(q[i]))
        top = floor(p.torque_max[i] / p.dac[i])
        codes[i] = min(max(floor(u / p.dac[i] + 0.5), -top), top)


@nb.njit(cache=True, nogil=True)
def run(
    p: Any,
    x: Any,
    reference: Any,
    gains: Any,
    share: float,
    push: Any,
    random: Any,
    tick: float,
    substeps: int,
    out: Any,
) -> None:
    """Run a session of n ticks.

    Parameters
    ----------
    p, x : records of `layout.ARM_DTYPE` and `layout.ARM_STATE_DTYPE`
        Parameters and state.
    reference : ndarray (n, 3, 3)
        Place [rad], speed [rad/s] and acceleration [rad/s^2] of every joint.
    gains : ndarray (5, 3)
        Stiffness, damping, nominal gravity, inertia, Coulomb friction.
    share : float
        Share of the first-order filter on the speed, per tick.
    push : ndarray (n, 3)
        Force ON the tip, base frame [N].
    random : ndarray (n, NOISES)
        Standard normal numbers.
    tick : float
        Period of the loop [s], in `substeps` steps of the plant.
    out : ndarray (n, 9)
        Written: measured positions [rad] and speeds [rad/s], efforts sent [N m].
    """
    dt = tick / substeps
    q, v, codes, link = np.zeros(3), np.zeros(3), np.zeros(3, np.int64), np.zeros(3)
    for k in range(reference.shape[0]):
        for i in range(3):
            count = floor((_shaft(p, x, i)) * p.encoder[i] + x.lost[i])
            place = (count + 0.5) / p.encoder[i]
            if k > 0:
                v[i] += share * ((place - q[i]) / tick - v[i])
            q[i] = place
        control(p, reference[k], q, v, gains, codes)
        for i in range(3):
            out[k, i], out[k, 3 + i], out[k, 6 + i] = q[i], v[i], codes[i] * p.dac[i]
        _chance(p, x, random[k], tick)
        world.take_command(p, x, codes, random[k], tick)
        x.force[:] = push[k]
        for n in range(substeps):
            if n == 0:
                world.tip_state(p, x)
            _substep(p, x, k * tick + n * dt, n * dt, tick, dt, link)


# Memory layout of the compiled session: the further hidden effects and the plant's records.

_F, _J = np.float64, (3,)

_MORE = np.dtype(
    [
        ("locked", np.int64),  # 1: joints 2 and 3 are clamped, a single axis is left
        ("preslide", _F, _J),
        ("preslide_at", _F, (3, ELEMENTS)),  # [N m], [rad]
        ("rub", _F, _J),
        ("rub_cycles", _F, _J),  # [N m], [rad/rad]
        ("load_rub", _F, _J),
        ("fade", _F, _J),  # [N m]
        ("give", _F, _J),
        ("soft", _F, _J),
        ("soft_at", _F, _J),  # [rad/(N m)], 1, [rad]
        ("slack", _F, _J),  # [rad]
        ("idler", _F, _J),  # [N m]
        ("ripple", _F, _J),
        ("ripple_cycles", _F, _J),  # 1, [rad/rad]
        ("detent", _F, _J),
        ("detent_cycles", _F, _J),  # [N m], [rad/rad]
        ("slow_drive", _F, _J),
        ("jitter", _F, _J),
        ("offset", _F, _J),  # [s], [s], [N m]
        ("leak", _F, _J),
        ("choke", _F, _J),  # 1, [1/(N m)]
        ("oscillator", _F, _J),
        ("oscillator_rate", _F, _J),  # [kg m^2], [rad/s]
        ("hum", _F, _J),
        ("hum_rate", _F, _J),  # [N m], [rad/s]
        ("wobble", _F, _J),
        ("wobble_cycles", _F, _J),
        ("slips", _F, _J),  # [rad], 1, [counts]
        ("telegraph", _F, _J),
        ("chirp", _F, _J),
        ("pair", _F, _J),  # [N m]
        ("thixotropy", _F, _J),
        ("placed_viscous", _F, _J),  # [N m], [N m s/rad^2]
        ("sheared", _F, _J),
        ("sheared_speed", _F, _J),  # [N m], [rad/s]
    ]
)

_MORE_STATE = np.dtype(
    [
        ("zp", _F, (3, ELEMENTS)),  # presliding elements [rad]
        ("slow", _F, (3, 2)),  # second-order amplifier [N m], [N m/s]
        ("idle", _F, (3, 2)),
        ("osc", _F, (3, 2)),  # idler and attached oscillator [rad], [rad/s]
        ("idle_z", _F, (3, ELEMENTS)),
        ("lost", _F, _J),
        ("flip", _F, _J),
        ("thick", _F, _J),  # [counts], +-1, 0..1
    ]
)

#: Parameters of the arm; all of the first part are zero unless an effect is hidden.
# The plant's fields come last: Numba takes a record that only continues another one for that
# other type, with a warning, and a function compiled for the plant would serve both.
_ARM = np.dtype(_MORE.descr + PLANT_ARM.descr)
_STATE = np.dtype(_MORE_STATE.descr + PLANT_STATE.descr)


# What may be hidden in a session: name -> which fields it sets; and kinds of no catalogue.

#: Names that begin so are in no catalogue.
_OUTSIDE = "outside-"


@dataclass(frozen=True)
class HiddenForm:
    """One kind of hidden effect.

    Parameters
    ----------
    text : str
        Its form.
    size : dict
        Field of the plant -> value at amplitude 1, scaled by the amplitude.
    shape : dict
        Field -> value at any amplitude.
    sensor : str
        Key of the sensor chain that the amplitude goes to instead (`sensors`), with `size`.
    needs : str
        ``"force"``: a measured force; ``"arm"``: more than one joint; ``"runs"``: a run with
        and one without; empty: any motion.
    least, most : float
        Smallest amplitude (below it the control loop meets the cables' resonance) and the
        largest that is still that effect on a haptic arm.
    """

    text: str
    size: dict[str, float] = field(default_factory=dict)
    shape: dict[str, Any] = field(default_factory=dict)
    sensor: str = ""
    needs: str = ""
    least: float = 0.0
    most: float = 30.0


_SLIP = (3e-3, 6e-3, 1.2e-2, 2e-2)

HIDDEN_FORMS: dict[str, HiddenForm] = {
    "stribeck": HiddenForm("1 / (1 + (v/vs)^2)", {"stribeck": 0.01}, {"stribeck_speed": 0.15}),
    "asymmetric-coulomb": HiddenForm(
        "square of a friction state", {"asym_coulomb": 0.006}, most=1.6
    ),
    "asymmetric-viscous": HiddenForm("v tanh(v / 0.08)", {"asym_viscous": 0.006}),
    "quadratic-drag": HiddenForm("|v|^1.8", {"drag": 0.02}),
    "presliding": HiddenForm("four Maxwell elements", {"preslide": 0.01}, {"preslide_at": _SLIP}),
    "position-friction": HiddenForm("triangular", {"rub": 0.006}, {"rub_cycles": 14.0}),
    "load-friction": HiddenForm("|load|^1.3", {"load_rub": 0.01}),
    "coupled-friction": HiddenForm(
        "friction state of another joint", {"couple": 0.005}, needs="arm"
    ),
    # no more can be lost than the motors' 8.5 mN m and more
    "friction-drift": HiddenForm("t / (t + 8 s)", {"fade": 0.006}, most=1.4),
    "elastic-transmission": HiddenForm("two masses", {"give": 0.01}, most=20.0),
    "hardening-cable": HiddenForm("rational softness at zero", {"soft": 4.0}, {"soft_at": 1e-3}),
    "backlash": HiddenForm("dead zone between two masses", {"slack": 2e-3}, most=10.0),
    "coupled-transmission": HiddenForm("idler on a soft shaft", {"idler": 0.004}, needs="arm"),
    "torque-gain": HiddenForm("gain of the drive", {"gain": 0.1}, needs="force"),
    "torque-offset": HiddenForm("constant", {"offset": 0.004}, most=5.0),
    "torque-ripple": HiddenForm(
        "|cos|, times the torque", {"ripple": 0.3}, {"ripple_cycles": 40.0}
    ),
    "torque-saturation": HiddenForm("a tenth comes through beyond it", {"choke": 20.0}),
    "torque-crosstalk": HiddenForm("share of the next motor's torque", {"leak": 0.05}, needs="arm"),
    "cogging": HiddenForm("sin(a + 0.4 sin a)", {"detent": 0.004}, {"detent_cycles": 33.6}),
    "actuator-lag": HiddenForm("second order", {"slow_drive": 4e-3}, least=0.4),
    "delay": HiddenForm("jittered by 30 %", {"jitter": 6e-3}, least=0.5),
    "payload": HiddenForm("mass in one of two runs", {"payload": 0.02}, needs="runs"),
    "spring": HiddenForm("-k sin(q - q0)", {"spring": 0.05}, {"spring_rest": 0.1}),
    "position-torque": HiddenForm("kinked cable", {"umbilical": 0.01}, {"umbilical_at": 0.1}),
    "end-stop": HiddenForm("d^1.5 (1 + c v)", {"stop": 0.3}, {"stop_at": (0.15, 0.6, 0.5)}),
    "encoder-eccentricity": HiddenForm(
        "tilted sine", {"wobble": 2e-3}, {"wobble_cycles": 13.0}, most=10.0
    ),
    "missed-counts": HiddenForm("lost at random, against the motion", {"slips": 4.0}),
    "filter-lag": HiddenForm(
        "two poles on the recorded position", {"lag": 3e-3}, sensor="lag", needs="force"
    ),
    "vibration-mode": HiddenForm(
        "attached mass", {"oscillator": 3e-4}, {"oscillator_rate": 22.0}, most=10.0
    ),
    "periodic-disturbance": HiddenForm("exp(1.2 sin wt)", {"hum": 0.003}, {"hum_rate": 17.15}),
    "force-bias": HiddenForm("in sensor axes", {"bias": 0.02}, sensor="bias", needs="force"),
    "force-drift": HiddenForm("t / (t + 10 s)", {"drift": 0.04}, sensor="drift", needs="force"),
    "force-gain": HiddenForm("saturating", {"gain": 0.1}, sensor="gain", needs="force"),
    "force-crosstalk": HiddenForm("in sensor axes", {"cross": 0.1}, sensor="cross", needs="force"),
    "outside-speed-product": HiddenForm("v_a v_b", {"product": 0.02}, needs="arm"),
    "outside-stick-slip": HiddenForm("bursts at random", {"burst": 0.03}),
    "outside-resonance": HiddenForm("moves with speed", {"resonance": 0.06}),
    "outside-telegraph": HiddenForm("offset that flips at random", {"telegraph": 0.004}),
    "outside-chirp": HiddenForm("frequency that rises", {"chirp": 0.005}),
    "outside-position-pair": HiddenForm("sin 6 q_a cos 5 q_b", {"pair": 0.01}, needs="arm"),
    "outside-thixotropy": HiddenForm("rebuilds at rest", {"thixotropy": 0.02}),
    "outside-placed-viscous": HiddenForm("q v", {"placed_viscous": 0.02}),
    # last: the plans number what is hidden
    "sublinear-viscous": HiddenForm("asinh(v / ve)", {"sheared": 0.006}, {"sheared_speed": 0.2}),
}


def apply(p: NDArray[np.void], sensors: dict[str, float], row: dict[str, Any]) -> None:
    """Put one effect into the record `p` (1,) or the sensor chain.

    Parameters
    ----------
    p : ndarray (1,) of `layout.ARM_DTYPE`
    sensors : dict
        Amplitudes of the sensor effects, changed in place.
    row : dict
        ``effect``, ``joint`` (0..2) and ``amplitude``.
    """
    name, i, amplitude = row["effect"], int(row["joint"]), float(row["amplitude"])
    if name not in HIDDEN_FORMS:
        raise ConfigError(unknown("hidden effect", name, HIDDEN_FORMS))
    law = HIDDEN_FORMS[name]
    if name == "payload":
        truth.add_tip_mass(p, amplitude * law.size["payload"])
        return
    for key, value in law.size.items():
        if law.sensor:
            sensors[law.sensor] = sensors.get(law.sensor, 0.0) + amplitude * value
            sensors["joint"] = i
        elif key == "couple":
            p[key][0, i, (i + 1) % 3] += amplitude * value
        else:
            p[key][0, i] += amplitude * value
    for key, value in law.shape.items():
        per_joint = isinstance(value, tuple) and len(value) == 3
        p[key][0, i] = value[i] if per_joint else value


# What the recording holds of the true signals: force sensor in its own axes, filtered position.

FloatArray = NDArray[np.float64]
#: Resolution and noise of the force sensor [N], what its certificate does not know.
_STEP, _FORCE_NOISE, _CROSSTALK = 1.0 / 1280.0, 2e-3, 2e-3


def axes(q: FloatArray) -> FloatArray:
    """Sensor axes in the base frame, (n, 3, 3): rows normal to the forearm, across, along."""
    (s1, _, s3), (c1, _, c3) = np.sin(q).T, np.cos(q).T
    zero = np.zeros_like(s1)
    rows = [[c1 * c3, s1 * c3, s3], [s1, -c1, zero], [c1 * s3, s1 * s3, -c3]]
    return np.stack([np.stack(r, -1) for r in rows], 1)


def force(
    push: FloatArray, q: FloatArray, effects: dict[str, Any], rng: np.random.Generator, tick: float
) -> FloatArray:
    """Measured wrench (n, 6) [N, N m] in the base frame of the true tip force `push` (n, 3)."""
    turn = axes(q)
    f = np.einsum("nij,nj->ni", turn, push)
    k, t = int(effects.get("joint", 0)), tick * np.arange(len(q))
    e = _CROSSTALK * np.random.default_rng(0xCA1).standard_normal((3, 3))
    e[k, (k + 1) % 3] += effects.get("cross", 0.0)
    f = f @ (np.eye(3) + e).T
    # gain that is largest for small forces: f (1 + g / (1 + |f|))
    f[:, k] *= 1.0 + effects.get("gain", 0.0) / (1.0 + np.abs(f[:, k]))
    f[:, k] += effects.get("bias", 0.0) + effects.get("drift", 0.0) * t / (t + 10.0)
    f = _STEP * np.round((f + _FORCE_NOISE * rng.standard_normal(f.shape)) / _STEP)
    out = np.zeros((len(q), 6))
    out[:, :3] = np.einsum("nij,ni->nj", turn, f)
    return out


def late(q: FloatArray, seconds: float, joint: int, tick: float) -> FloatArray:
    """Position (n, 3) with two poles of time constant `seconds` / 2 on one joint."""
    if seconds <= 0.0:
        return q
    a = float(np.exp(-2.0 * tick / seconds))
    b = np.array([(1.0 - a) ** 2])
    out = q.copy()
    start = q[0, joint]
    filtered = scipy.signal.lfilter(b, np.array([1.0, -2.0 * a, a * a]), q[:, joint] - start)
    out[:, joint] = np.asarray(filtered) + start
    return out


_TICK = 1e-3
#: Torque noise [N m] of the two colours, alike below 20 Hz: at 5 Hz corner, and white at 1 kHz.
_NOISE = {"coloured": (1.0e-3, 5e-4), "white": (0.0, 4.0e-3)}
#: Gains of the joint controller: stiffness, damping, nominal gravity, inertia, friction.
_GAINS = np.array(
    [
        [8.0, 8.0, 4.0],
        [0.14, 0.14, 0.07],
        [0.0, 0.08, 0.0],
        [0.0035, 0.003, 0.0013],
        [0.012, 0.011, 0.010],
    ]
)
VELOCITY_FILTER = 3e-3
_SENSOR = "nano17"


def simulate(
    reference: FloatArray,
    push: FloatArray | None,
    hidden: list[dict[str, Any]],
    noise: str,
    seed: int,
    locked: bool = False,
) -> dict[str, FloatArray]:
    """Record one session at 1 kHz.

    Parameters
    ----------
    reference : ndarray (n, 3, 3)
        Place, speed and acceleration of every joint [rad, rad/s, rad/s^2].
    push : ndarray (n, 3) or None
        True force ON the tip, base frame [N]; measured where given.
    hidden : list of dict
        ``effect``, ``joint`` (0..2), ``amplitude`` of every hidden effect.
    noise : str
        ``"white"`` or ``"coloured"``.
    seed : int
        Of all noise.
    locked : bool
        Whether joints 2 and 3 are clamped.

    Returns
    -------
    dict
        ``t`` (n,) [s], ``q``, ``qd``, ``tau`` (n, 3) [rad, rad/s, N m], ``wrench`` (n, 6) if
        there is a force.
    """
    p, chain = plant_record(hidden, noise, locked)
    n = len(reference)
    rng = np.random.default_rng([seed, 0xFA57])
    out = np.zeros((n, 9))
    run(
        p[0],
        start(p, reference[0, :, 0])[0],
        reference,
        _GAINS,
        1.0 - float(np.exp(-_TICK / VELOCITY_FILTER)),
        np.zeros((n, 3)) if push is None else push,
        rng.standard_normal((n, NOISES)),
        _TICK,
        SUBSTEPS,
        out,
    )
    q = late(out[:, :3], chain.get("lag", 0.0), int(chain.get("joint", 0)), _TICK)
    found: dict[str, FloatArray] = {}
    found |= {
        "t": _TICK * np.arange(n, dtype=np.float64),
        "q": q,
        "qd": out[:, 3:6],
        "tau": out[:, 6:],
    }
    if push is not None:
        found["wrench"] = force(push, out[:, :3], chain, rng, _TICK)
    return found


def plant_record(
    hidden: list[dict[str, Any]], noise: str, locked: bool
) -> tuple[NDArray[np.void], dict[str, float]]:
    """Record (1,) of the arm with its hidden effects, and the amplitudes of sensor effects."""
    nominal = truth.arm_record(truth.load_truth("nominal"), _SENSOR, np.zeros((6, 6)))
    p = np.zeros(1, _ARM)
    for name in nominal.dtype.names or ():
        p[name] = nominal[name]
    p["noise_low"], p["noise_white"] = _NOISE[noise]
    p["locked"] = int(locked)
    chain: dict[str, float] = {}
    for row in hidden:
        apply(p, chain, row)
    return p, chain


def start(p: NDArray[np.void], home: FloatArray) -> NDArray[np.void]:
    """State (1,) at rest at `home` (3,) [rad]."""
    x = np.zeros(1, _STATE)
    x["qm"][0], x["q"][0], x["osc"][0, :, 0] = home, home, home
    # idlers of the pairs (1, 2), (2, 3), (1, 3)
    x["idle"][0, :, 0] = home[[0, 1, 0]] + home[[1, 2, 2]]
    x["flip"], x["thick"] = 1.0, 1.0
    world.tip_state(p[0], x[0])
    return x


def kinds() -> dict[str, tuple[str, float, float]]:
    """What may be hidden -> what it needs, its smallest and largest amplitude (`HiddenForm`)."""
    return {name: (law.needs, law.least, law.most) for name, law in HIDDEN_FORMS.items()}
