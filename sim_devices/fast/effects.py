"""What may be hidden in a session: name -> which fields it sets; and kinds of no catalogue."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.sim_devices.plants import truth

#: Names that begin so are in no catalogue.
OUTSIDE = "outside-"


@dataclass(frozen=True)
class Law:
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

EFFECTS: dict[str, Law] = {
    "stribeck": Law("1 / (1 + (v/vs)^2)", {"stribeck": 0.01}, {"stribeck_speed": 0.15}),
    "asymmetric-coulomb": Law("square of a friction state", {"asym_coulomb": 0.006}, most=1.6),
    "asymmetric-viscous": Law("v tanh(v / 0.08)", {"asym_viscous": 0.006}),
    "quadratic-drag": Law("|v|^1.8", {"drag": 0.02}),
    "presliding": Law("four Maxwell elements", {"preslide": 0.01}, {"preslide_at": _SLIP}),
    "position-friction": Law("triangular", {"rub": 0.006}, {"rub_cycles": 14.0}),
    "load-friction": Law("|load|^1.3", {"load_rub": 0.01}),
    "coupled-friction": Law("friction state of another joint", {"couple": 0.005}, needs="arm"),
    # no more can be lost than the motors' 8.5 mN m and more
    "friction-drift": Law("t / (t + 8 s)", {"fade": 0.006}, most=1.4),
    "elastic-transmission": Law("two masses", {"give": 0.01}, most=20.0),
    "hardening-cable": Law("rational softness at zero", {"soft": 4.0}, {"soft_at": 1e-3}),
    "backlash": Law("dead zone between two masses", {"slack": 2e-3}, most=10.0),
    "coupled-transmission": Law("idler on a soft shaft", {"idler": 0.004}, needs="arm"),
    "torque-gain": Law("gain of the drive", {"gain": 0.1}, needs="force"),
    "torque-offset": Law("constant", {"offset": 0.004}, most=5.0),
    "torque-ripple": Law("|cos|, times the torque", {"ripple": 0.3}, {"ripple_cycles": 40.0}),
    "torque-saturation": Law("a tenth comes through beyond it", {"choke": 20.0}),
    "torque-crosstalk": Law("share of the next motor's torque", {"leak": 0.05}, needs="arm"),
    "cogging": Law("sin(a + 0.4 sin a)", {"detent": 0.004}, {"detent_cycles": 33.6}),
    "actuator-lag": Law("second order", {"slow_drive": 4e-3}, least=0.4),
    "delay": Law("jittered by 30 %", {"jitter": 6e-3}, least=0.5),
    "payload": Law("mass in one of two runs", {"payload": 0.02}, needs="runs"),
    "spring": Law("-k sin(q - q0)", {"spring": 0.05}, {"spring_rest": 0.1}),
    "position-torque": Law("kinked cable", {"umbilical": 0.01}, {"umbilical_at": 0.1}),
    "end-stop": Law("d^1.5 (1 + c v)", {"stop": 0.3}, {"stop_at": (0.15, 0.6, 0.5)}),
    "encoder-eccentricity": Law(
        "tilted sine", {"wobble": 2e-3}, {"wobble_cycles": 13.0}, most=10.0
    ),
    "missed-counts": Law("lost at random, against the motion", {"slips": 4.0}),
    "filter-lag": Law(
        "two poles on the recorded position", {"lag": 3e-3}, sensor="lag", needs="force"
    ),
    "vibration-mode": Law(
        "attached mass", {"oscillator": 3e-4}, {"oscillator_rate": 22.0}, most=10.0
    ),
    "periodic-disturbance": Law("exp(1.2 sin wt)", {"hum": 0.003}, {"hum_rate": 17.15}),
    "force-bias": Law("in sensor axes", {"bias": 0.02}, sensor="bias", needs="force"),
    "force-drift": Law("t / (t + 10 s)", {"drift": 0.04}, sensor="drift", needs="force"),
    "force-gain": Law("saturating", {"gain": 0.1}, sensor="gain", needs="force"),
    "force-crosstalk": Law("in sensor axes", {"cross": 0.1}, sensor="cross", needs="force"),
    "outside-speed-product": Law("v_a v_b", {"product": 0.02}, needs="arm"),
    "outside-stick-slip": Law("bursts at random", {"burst": 0.03}),
    "outside-resonance": Law("moves with speed", {"resonance": 0.06}),
    "outside-telegraph": Law("offset that flips at random", {"telegraph": 0.004}),
    "outside-chirp": Law("frequency that rises", {"chirp": 0.005}),
    "outside-position-pair": Law("sin 6 q_a cos 5 q_b", {"pair": 0.01}, needs="arm"),
    "outside-thixotropy": Law("rebuilds at rest", {"thixotropy": 0.02}),
    "outside-placed-viscous": Law("q v", {"placed_viscous": 0.02}),
}


def apply(p: NDArray[np.void], sensors: dict[str, float], row: dict[str, Any]) -> None:
    """Put one effect into the record `p` (1,) or the sensor chain.

    Parameters
    ----------
    p : ndarray (1,) of `layout.ARM`
    sensors : dict
        Amplitudes of the sensor effects, changed in place.
    row : dict
        ``effect``, ``joint`` (0..2) and ``amplitude``.
    """
    name, i, amplitude = row["effect"], int(row["joint"]), float(row["amplitude"])
    if name not in EFFECTS:
        raise ConfigError(unknown("hidden effect", name, EFFECTS))
    law = EFFECTS[name]
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
