"""Memory layout of the compiled plant: one structured record per arm.

Joint vectors have length 3 and SI units (rad, N m).  Fields of the second group in `ARM_DTYPE` are
zero in the nominal plant and are set by `hil.sim_devices.plants.build`.
"""

from __future__ import annotations

import numpy as np

#: Substeps per tick of the loop.
SUBSTEPS = 16
#: Ticks that the actuation delay line holds.
HISTORY = 64
#: Maxwell elements per friction interface.
ELEMENTS = 4
#: Sines of the operator's motion: voluntary, then tremor.
SINES = 12
#: Random numbers per tick and arm: 3 coloured, 3 white, 6 gauges, 1 burst time, 1 burst size.
NOISES = 14

_F, _J = np.float64, (3,)

_NOMINAL = [
    ("l1", _F), ("l2", _F),
    ("m11", _F, (4,)),  # 1, cos 2 th2, cos 2 th3, cos th2 sin th3 [kg m^2]
    ("m22", _F), ("m33", _F), ("m23", _F),  # [kg m^2]; M23 = -m23 sin(th2 - th3)
    ("g2", _F), ("g3", _F),  # gravity [N m]: g2 cos th2, g3 sin th3
    ("rotor", _F, _J),  # reflected rotor inertia [kg m^2]
    ("cable", _F, _J), ("cable_damping", _F, (3, 3)),  # [N m/rad], [N m s/rad]
    ("coulomb_motor", _F, _J), ("coulomb_link", _F, _J),  # [N m]
    ("viscous_motor", _F, _J), ("viscous_link", _F, _J),  # [N m s/rad]
    ("slip_motor", _F, (3, ELEMENTS)), ("slip_link", _F, (3, ELEMENTS)),  # breakaway [rad]
    ("weight", _F, (ELEMENTS,)),  # share of each Maxwell element
    ("creep", _F, _J),  # speed at which the greased motor side yields [rad/s]; 0 = Maxwell slip
    ("warming", _F), ("warming_time", _F),  # friction lost per rad/s of mean speed, [s]
    ("lag", _F),  # amplifier time constant [s]
    ("torque_max", _F, _J),
    ("noise_low", _F, _J), ("noise_pole", _F), ("noise_white", _F, _J),  # [N m]
    ("dac", _F, _J),  # joint torque per DAC code [N m]
    ("encoder", _F, _J),  # counts per rad of the joint
    ("gauge", _F, (6, 6)), ("gauge_bias", _F, (6,)),  # words per N or N m, words
    ("gauge_drift", _F, (6,)), ("gauge_noise", _F),  # words/s, words
]  # fmt: skip

_HIDDEN = [
    ("stribeck", _F, _J), ("stribeck_speed", _F, _J),
    ("asym_coulomb", _F, _J), ("asym_viscous", _F, _J), ("drag", _F, _J),
    ("eccentric", _F, _J), ("eccentric_period", _F, _J), ("eccentric_phase", _F, _J),
    ("capstan", _F, _J), ("couple", _F, (3, 3)),
    ("spring", _F, _J), ("spring_rest", _F, _J),
    ("umbilical", _F, _J), ("umbilical_at", _F, _J),
    ("stop", _F, _J), ("stop_at", _F, _J),
    ("gain", _F, _J), ("cogging", _F, _J), ("cogging_cycles", _F, _J),
    ("delay", _F, _J),  # [s]
    ("product", _F, _J), ("burst", _F, _J), ("resonance", _F, _J),
]  # fmt: skip

ARM_DTYPE = np.dtype(_NOMINAL + _HIDDEN)

ARM_STATE_DTYPE = np.dtype([
    ("parked", np.int64), ("head", np.int64),
    ("qm", _F, _J), ("vm", _F, _J), ("q", _F, _J), ("v", _F, _J),
    ("zm", _F, (3, ELEMENTS)), ("zl", _F, (3, ELEMENTS)),  # Maxwell deflections [rad]
    ("sm", _F, _J),  # friction state -1..1 on the motor side
    ("drive", _F, _J), ("history", _F, (3, HISTORY)),  # torque after lag, commands [N m]
    ("low", _F, _J), ("white", _F, _J), ("heat", _F, _J),
    ("ring", _F, (3, 2)), ("bang", _F),
    ("tip", _F, _J), ("tip_v", _F, _J), ("force", _F, _J),  # [m], [m/s], [N] on the arm
])  # fmt: skip

OPERATOR = np.dtype([
    ("kind", np.int64),  # 0 none, 1 hand, 2 machine
    ("home", _F, _J), ("mass", _F),
    ("arm_k", _F), ("arm_b", _F), ("grip_k", _F), ("grip_b", _F), ("limit", _F), ("onset", _F),
    ("size", _F, (3, SINES)), ("rate", _F, (3, SINES)), ("phase", _F, (3, SINES)),
    ("x", _F, _J), ("v", _F, _J),  # state of the hand
    ("aim", _F, _J), ("aim_v", _F, _J),
])  # fmt: skip

GEL_DTYPE = np.dtype([
    ("on", np.int64), ("surface", _F),
    ("stiffness", _F), ("power", _F), ("damping", _F),
    ("branch", _F), ("relaxation", _F), ("drag", _F),
    ("bolt", _F), ("bolt_y", _F), ("bolt_width", _F),
    ("flow", _F),  # state: deflection of the dashpot of the Maxwell arm [m]
])  # fmt: skip
