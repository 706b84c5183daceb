"""A three-joint arm simulated by Pinocchio, independent of the library's regressors."""

import numpy as np
import pinocchio as pin

from hil.record.recording import Recording, RobotSource

JOINTS = ("base", "upper", "fore")
FC, FV = np.array([0.30, 0.25, 0.12]), np.array([0.20, 0.15, 0.05])
TRUE = (3.0, 1.6, 0.8)
NOISE = 0.02


def urdf(masses: tuple[float, float, float] = TRUE) -> str:
    """Shoulder about z, then two pitch joints; links of 0.3 m with the given masses."""
    axes = ("0 0 1", "0 1 0", "0 1 0")
    links = ['<link name="world"/>']
    joints = []
    parent = "world"
    for name, axis, m in zip(JOINTS, axes, masses, strict=True):
        at = "0 0 0" if parent in ("world", "base_link") else "0.3 0 0"
        links.append(
            f'<link name="{name}_link"><inertial><origin xyz="0.15 0.01 0.02"/>'
            f'<mass value="{m}"/><inertia ixx="{0.002 * m}" iyy="{0.01 * m}" izz="{0.011 * m}" '
            f'ixy="{0.0005 * m}" ixz="0" iyz="0"/></inertial></link>'
        )
        joints.append(
            f'<joint name="{name}" type="revolute"><origin xyz="{at}"/><parent link="{parent}"/>'
            f'<child link="{name}_link"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="99" velocity="9"/></joint>'
        )
        parent = f"{name}_link"
    return f'<robot name="arm">{"".join(links + joints)}</robot>'


def record(seed: int, seconds: float = 20.0, name: str = "", offset: float = 0.0) -> Recording:
    """Random band-limited motion; effort = rnea + Coulomb and viscous friction + noise."""
    rng, fs = np.random.default_rng(seed), 500.0
    t = np.arange(int(seconds * fs)) / fs
    w = 2 * np.pi * rng.uniform(0.1, 1.2, (3, 6))
    phase, size = rng.uniform(0, 2 * np.pi, (3, 6)), rng.uniform(0.3, 0.6, (3, 6)) / w**0.5
    angle = t[:, None, None] * w + phase
    q = np.sum(size * np.sin(angle), axis=2)
    qd = np.sum(size * w * np.cos(angle), axis=2)
    qdd = -np.sum(size * w**2 * np.sin(angle), axis=2)
    model = pin.buildModelFromXML(urdf())
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *row).copy() for row in zip(q, qd, qdd, strict=True)])
    tau += FC * np.sign(qd) + FV * qd + NOISE * rng.normal(size=tau.shape) + offset
    return Recording(name or f"run{seed}", "arm", JOINTS, t, q, tau, robot=RobotSource("", urdf()))
