"""Registry: names in a rig file to drivers, controllers and simulators; strings until used."""

from __future__ import annotations

import importlib
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from hil.errors import ConfigError, unknown

#: group -> name -> module (with `Config` and `open_device` or `build`) or ``module:attribute``.
#: Entry points of the same groups join in.
BUILT_IN: dict[str, dict[str, str]] = {
    "hil.drivers": {
        "premium": "hil.drivers.premium",
        "ft-sensor": "hil.drivers.ft_sensor",
        "damiao": "hil.drivers.damiao",
        "haply": "hil.drivers.haply",
    },
    "hil.boxes": {
        "usb-quad08": "hil.drivers.usb_quad08.driver",
        "usb-31xx": "hil.drivers.usb_31xx.driver",
        "damiao-can": "hil.drivers.damiao_can",
        "haply-inverse": "hil.drivers.haply:BOX",
        "netcanoem": "hil.drivers.netcanoem.driver",
        "netft-can": "hil.drivers.netft_can",
        "netft-rdt": "hil.drivers.netft_rdt",
    },
    "hil.controllers": {
        "cartesian-coupling": "hil.controllers.cartesian:CARTESIAN_COUPLING",
        "computed-torque": "hil.controllers.joint_space:COMPUTED_TORQUE",
        "joint-coupling": "hil.controllers.joint_space:JOINT_COUPLING",
        "joint-pd": "hil.controllers.joint_space:JOINT_PD",
        "joint-tracking": "hil.controllers.joint_tracking",
        "delayed": "hil.controllers.delayed",
        "lawrence": "hil.controllers.lawrence",
        "position-force": "hil.controllers.position_force",
    },
    "hil.estimators": {
        "force": "hil.controllers.estimators.forces",
        "friction-network": "hil.controllers.estimators.network",
        "elastic-ukf": "hil.controllers.estimators.transmission",
    },
    "hil.taps": {"usb": "hil.drivers.usb_quad08.usb_tap", "hid": "hil.drivers.usb_31xx.hid_tap"},
    "hil.velocity": {
        "first-difference": "hil.signals.velocity:FirstDifference",
        "filtered-difference": "hil.signals.velocity:FilteredDifference",
        "foaw-end-fit": "hil.signals.velocity:FoawEndFit",
        "foaw-best-fit": "hil.signals.velocity:FoawBestFit",
        "kalman": "hil.signals.velocity:Kalman",
    },
    "hil.kinematics": {"phantom-premium-1.5": "hil.controllers.dynamics:premium"},
    "hil.exports": {
        "urdf": "hil.export.urdf:TARGET",
        "mjcf": "hil.export.mjcf:TARGET",
        "sdf": "hil.export.sdf:TARGET",
        "isaac": "hil.export.urdf:ISAAC",
        "c": "hil.export.code:C",
        "cpp": "hil.export.code:CPP",
        "python": "hil.export.code:PYTHON",
        "ros2": "hil.export.code:ROS2",
        "card": "hil.export.card:TARGET",
    },
    "hil.sim_devices": {},
    "hil.sim_sessions": {},
}


def names(group: str) -> dict[str, str]:
    """All names of a group with where they live."""
    return _installed(group) | BUILT_IN[group]


@cache
def _installed(group: str) -> dict[str, str]:
    """Entry points of a group; reading those of all packages takes milliseconds."""
    return {e.name: e.value for e in entry_points(group=group)}


def load(group: str, name: str) -> Any:
    """What stands behind `name` of `group`, imported now."""
    known = names(group)
    if name not in known:
        raise ConfigError(unknown(group.removeprefix("hil.").rstrip("s"), name, known))
    module, _, attribute = known[name].partition(":")
    try:
        found = importlib.import_module(module)
    except ImportError as error:
        raise ConfigError(f"{name!r} of {group} cannot be imported: {error}.") from error
    return getattr(found, attribute) if attribute else found
