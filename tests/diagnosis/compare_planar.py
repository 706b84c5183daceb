"""A planar arm of two joints in a vertical plane, from its Lagrangian; the motion is prescribed."""

import numpy as np

from hil.record.recording import Recording, RobotSource

#: Masses [kg], length and centres [m], inertias about the centres [kg m^2], friction, gravity.
M, L, C, TURN = (1.6, 0.9), 0.3, (0.14, 0.12), (0.014, 0.005)
FC, FV, G = np.array([0.12, 0.08]), np.array([0.1, 0.06]), 9.81

_LINK = """<link name="{0}"><inertial><origin xyz="{1} 0 0"/><mass value="{2}"/>
<inertia ixx="1e-4" iyy="{3}" izz="{3}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
_JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
<origin xyz="{3} 0 0"/><axis xyz="0 -1 0"/><limit lower="-3" upper="3" effort="20" velocity="9"/>
</joint>"""
URDF = "".join(
    [
        '<robot name="planar"><link name="base"/>',
        _LINK.format("upper", C[0], M[0], TURN[0]),
        _LINK.format("fore", C[1], M[1], TURN[1]),
        _JOINT.format("shoulder", "base", "upper", 0),
        _JOINT.format("elbow", "upper", "fore", L),
        "</robot>",
    ]
)


def planar(
    seed: int, gain=(1.0, 1.0), offset=(0.0, 0.0), seconds: float = 25.0, noise=(0.02, 0.01)
) -> Recording:
    """25 s on five tones a joint; the motors' commands are gain times their torque, plus offset."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1e-3)
    f = np.array([0.07, 0.16, 0.37, 0.8, 1.4])[:, None] * rng.uniform(0.9, 1.1, (5, 2))
    a = np.array([0.6, 0.4, 0.2, 0.08, 0.03])[:, None]
    angle = 2 * np.pi * f * t[:, None, None] + rng.uniform(0, 6.28, (5, 2))
    q = np.sum(a * np.sin(angle), axis=1) + np.array([-0.3, 0.5])
    v = np.sum(a * 2 * np.pi * f * np.cos(angle), axis=1)
    w = -np.sum(a * (2 * np.pi * f) ** 2 * np.sin(angle), axis=1)
    (c1, c12), s2 = (np.cos(x) for x in (q[:, 0], q.sum(axis=1))), np.sin(q[:, 1])
    k = M[1] * L * C[1]
    one = TURN[0] + M[0] * C[0] ** 2 + TURN[1] + M[1] * (L**2 + C[1] ** 2) + 2 * k * np.cos(q[:, 1])
    two = TURN[1] + M[1] * C[1] ** 2
    both = two + k * np.cos(q[:, 1])
    heavy = G * M[1] * C[1] * c12
    tau = np.stack(
        [
            one * w[:, 0]
            + both * w[:, 1]
            - k * s2 * v[:, 1] * (2 * v[:, 0] + v[:, 1])
            + G * (M[0] * C[0] + M[1] * L) * c1
            + heavy,
            both * w[:, 0] + two * w[:, 1] + k * s2 * v[:, 0] ** 2 + heavy,
        ],
        axis=1,
    )
    tau += FC * np.sign(v) + FV * v + noise * rng.standard_normal(v.shape)
    tau = tau * gain + offset
    q = q + 1e-6 * rng.standard_normal(q.shape)
    return Recording(
        f"run{seed}", "arm", ("shoulder", "elbow"), t, q, tau, robot=RobotSource("", URDF)
    )
