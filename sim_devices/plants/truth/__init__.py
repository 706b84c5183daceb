"""True parameters of the simulated arms, read by the simulator alone."""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.sim_devices.plants.layout import ARM_DTYPE

GRAVITY = 9.81


def load_truth(name: str) -> dict[str, Any]:
    """Read the truth file `name` of this package."""
    folder = resources.files(__name__)
    known = sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".toml"))
    if name not in known:
        raise ConfigError(f"[simulation] truth: {unknown('truth file', name, known)}")
    return tomllib.loads((folder / f"{name}.toml").read_text(encoding="utf-8"))


def arm_record(
    truth: dict[str, Any], sensor: str, crosstalk: NDArray[np.float64]
) -> NDArray[np.void]:
    """Parameter record of one arm that carries `sensor` at its tip.

    Parameters
    ----------
    truth : dict
        A truth file.
    sensor : str
        Name under ``[sensors]``.
    crosstalk : ndarray (6, 6)
        Standard normal numbers; scaled by the sensor's cross-talk.

    Returns
    -------
    ndarray (1,) of `ARM_DTYPE`
    """
    if sensor not in truth["sensors"]:
        raise ConfigError(unknown("force sensor", sensor, truth["sensors"]))
    p = np.zeros(1, ARM_DTYPE)
    _bodies(p, truth)
    add_tip_mass(p, truth["sensors"][sensor]["mass"])
    _drives(p, truth)
    _friction(p, truth)
    _gauges(p, truth["sensors"][sensor], crosstalk)
    return p


def _bodies(p: NDArray[np.void], truth: dict[str, Any]) -> None:
    """Mass matrix and gravity from the bodies: sum of J^T m J and of inertias."""
    geo, m, inertia = truth["geometry"], truth["masses"], truth["inertias"]
    l1, l2, l3 = geo["l1"], geo["l2"], geo["rod"]
    a, c, be, df = (np.array(inertia[k]) for k in ("forearm", "rod", "upper", "crank"))
    ma, mc = m["forearm"], m["rod"]
    p["l1"], p["l2"] = l1, l2
    # about the vertical: I cos^2 + I' sin^2 = (I + I')/2 +- (I - I')/2 cos 2th, and m r^2
    along_2 = np.array([be[2] + c[2], be[1] + c[1]])  # long axis z
    along_3 = np.array([a[1] + df[1], a[2] + df[2]])  # long axis y
    half_2, half_3 = l1**2 * (ma + mc / 4) / 2, (l2**2 * ma / 4 + l3**2 * mc) / 2
    p["m11"][0, 0] = inertia["base"] + along_2.sum() / 2 + along_3.sum() / 2 + half_2 + half_3
    p["m11"][0, 1] = (along_2[1] - along_2[0]) / 2 + half_2
    p["m11"][0, 2] = (along_3[0] - along_3[1]) / 2 - half_3
    coupling = l1 * (l2 * ma + l3 * mc)
    p["m11"][0, 3], p["m23"] = coupling, coupling / 2
    p["m22"] = be[0] + c[0] + l1**2 * (ma + mc / 4)
    p["m33"] = a[0] + df[0] + l2**2 * ma / 4 + l3**2 * mc
    p["g2"] = GRAVITY * (l1 * ma + geo["upper"] * m["upper"] + l1 * mc / 2)
    p["g3"] = GRAVITY * (l2 * ma / 2 + l3 * mc - geo["crank"] * m["crank"])


def add_tip_mass(p: NDArray[np.void], mass: float) -> None:
    """Add a point `mass` [kg] at the tip: M += m J^T J, N += m g J_z."""
    l1, l2 = p["l1"], p["l2"]
    p["m11"] += mass * np.stack([(l1**2 + l2**2) / 2, l1**2 / 2, -(l2**2) / 2, 2 * l1 * l2], -1)
    p["m22"] += mass * l1**2
    p["m33"] += mass * l2**2
    p["m23"] += mass * l1 * l2
    p["g2"] += mass * GRAVITY * l1
    p["g3"] += mass * GRAVITY * l2


def _drives(p: NDArray[np.void], truth: dict[str, Any]) -> None:
    """Motors, encoders, cables and their noise, reflected to the joints."""
    motor, noise, cable = truth["motors"], truth["noise"], truth["cables"]
    gear = np.array(motor["gear"])
    p["rotor"] = gear**2 * motor["rotor"]
    p["encoder"] = gear * motor["counts"] / (2 * np.pi)
    p["dac"] = gear * motor["torque_constant"] * motor["amps_per_code"]
    p["torque_max"] = gear * motor["stall"]
    p["lag"] = motor["lag"]
    p["cable"], p["cable_damping"] = cable["stiffness"], np.array(cable["damping"])
    p["noise_low"], p["noise_white"] = noise["low"], noise["white"]
    p["noise_pole"] = 2 * np.pi * noise["corner"]


def _friction(p: NDArray[np.void], truth: dict[str, Any]) -> None:
    friction = truth["friction"]
    for key in ("coulomb_motor", "coulomb_link", "viscous_motor", "viscous_link"):
        p[key] = friction[key]
    p["slip_motor"][:], p["slip_link"][:] = friction["slip"], friction["slip"]
    p["weight"], p["warming"] = friction["weight"], friction["warming"]
    p["creep"] = friction["creep"]
    p["warming_time"] = friction["warming_time"]


def _gauges(p: NDArray[np.void], sensor: dict[str, Any], crosstalk: NDArray[np.float64]) -> None:
    """Strain of three beams at 0, 120 and 240 degrees: one axial, one tangential gauge each."""
    angle = np.deg2rad([0.0, 120.0, 240.0])
    force, torque = sensor["words_per_newton"], sensor["words_per_newton_metre"]
    zero, one = np.zeros(3), np.ones(3)
    axial = np.stack([zero, zero, one, np.sin(angle), -np.cos(angle), zero], -1)
    tangential = np.stack([-np.sin(angle), np.cos(angle), zero, zero, zero, one], -1)
    ideal = np.empty((6, 6))
    ideal[0::2], ideal[1::2] = axial, tangential
    ideal *= np.array([force] * 3 + [torque] * 3)
    # f' = (I + E) f: what the certificate does not know
    p["gauge"] = ideal @ (np.eye(6) + sensor["crosstalk"] * np.clip(crosstalk, -2, 2) / 2)
    p["gauge_bias"], p["gauge_drift"] = sensor["bias"], sensor["drift"]
    p["gauge_noise"] = sensor["noise"]
