"""Mistakes in a rig file that show before any device is opened, and the limits it sets an arm."""

from __future__ import annotations

import typing
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil import registry
from hil.errors import ConfigError
from hil.excite import trajectory
from hil.excite.trajectory import INF, Limits, of_robot
from hil.excite.trajectory import check_fits_arm as check_motion
from hil.models.robots import bare_robot
from hil.record.recording import RobotSource
from hil.rig import boxes
from hil.rig.boxes import check_roles
from hil.rig.config import ArmConfig, RigConfig, robot_source
from hil.signals import settable
from hil.signals.settable import ArmDescription
from hil.toml import in_table, parse


def check_tables(config: RigConfig) -> None:
    """Refuse mistakes in the tables of devices and boxes, before anything is opened or simulated.

    Raises
    ------
    ConfigError
        Names the table.
    """
    require_boxes(config)
    boxes.check_channels(config)
    for name, device in config.devices.items():
        _check_arm(device_options(config, name), name, config.arms[device.arm], device.arm)
        spots = boxes.places(config, name)
        if "gauges" in spots:
            boxes.only_gauges(name, spots)
        elif spots:
            check_roles(name, spots, len(config.arms[config.devices[name].arm].joints))
    used = boxes.backends(config)
    for box in config.boxes:
        boxes.check_box(config, box, box in used)


def _check_arm(options: Any, name: str, arm: ArmConfig, called: str) -> None:
    """Refuse a device whose driver says that it is not of its arm."""
    refuse = getattr(options, "refuse_arm", None)
    if refuse is not None:
        with in_table(f"devices.{name}"):
            refuse(called, "" if arm.own else arm.robot, len(arm.joints))


def check_parameters(config: RigConfig) -> None:
    """Refuse parameters outside of the ranges that the law declares, unless it judges itself.

    Raises
    ------
    ConfigError
        As for an operator's ``set``.
    """
    given = config.controller.parameters
    with in_table("controller"):
        law = registry.load("hil.controllers", config.controller.name)
    parameters = parse(law.Config, given, "controller.parameters")
    if getattr(law, "JUDGED", False):
        return
    known = settable.ranges(parameters)
    with in_table("controller.parameters"):
        for name in known.keys() & given.keys():
            value = getattr(parameters, name)
            settable.checked(name, value if isinstance(value, tuple) else (value,), known)


def require_boxes(config: RigConfig) -> None:
    """Refuse devices that are to go through boxes and are wired to none.

    Raises
    ------
    ConfigError
        Names the devices and what to add.
    """
    for backend in dict.fromkeys(map(config.backend_of, config.devices)):
        bare = [
            n
            for n, d in config.devices.items()
            if not d.channels
            and config.backend_of(n) == backend != "sim"
            and (backend == "replay" or not self_contained(config, n))
        ]
        if bare:
            raise ConfigError(
                f"back end {backend!r} needs boxes, and wired to none is {', '.join(bare)}; add "
                f"[devices.{bare[0]}.channels] and the [boxes.NAME] that it names, as "
                'rigs/teleop.toml has them, or set backend = "sim", ideal wires.  (A driver that '
                "speaks to its device itself has SELF_CONTAINED = True in its class.)"
            )


def opens(config: RigConfig, name: str) -> Any:
    """Class of a device, known before it is opened; None where its driver does not say."""
    found = registry.load("hil.drivers", config.devices[name].driver).open_device
    if isinstance(found, type):
        return found
    try:
        return typing.get_type_hints(found).get("return")
    except Exception:  # an annotation may name anything
        return None


def self_contained(config: RigConfig, name: str) -> bool:
    """Whether a device has no boxes because its driver speaks to it itself."""
    return bool(getattr(opens(config, name), "SELF_CONTAINED", False))


def measures_force(config: RigConfig, arm: str) -> bool:
    """Whether a device of an arm measures the force on its tip."""
    mine = [n for n, d in config.devices.items() if d.arm == arm]
    return any(hasattr(opens(config, n), "measured_cf") for n in mine)


def device_options(config: RigConfig, name: str) -> Any:
    """Options of a device, checked."""
    return boxes.options_of("hil.drivers", config.devices[name], f"devices.{name}")


def check_trajectory(config: RigConfig) -> None:
    """Refuse a trajectory that an arm's limits, joints or the loop's rate do not allow.

    Raises
    ------
    ConfigError
        Before any device is opened.
    """
    path = config.controller.parameters.get("trajectory")
    if not isinstance(path, str) or not path:
        return
    motion = trajectory.read_trajectory(path)
    for arm in config.controller.arms:
        table = config.arms[arm]
        source = robot_source(table)
        robot = bare_robot(source, table.joints)
        limits = limits_of_arm(table, source)
        try:
            check_motion(motion, limits, robot, config.loop.rate_hz)
        except ConfigError as error:
            raise ConfigError(f"{path}, arm {arm!r}: {error}") from error


def limits_of_arm(arm: ArmConfig, source: RobotSource, center: tuple[float, ...] = ()) -> Limits:
    """Limits of an arm of a rig file: the file's, and the robot's where the file has none.

    Raises
    ------
    ConfigError
        If neither bounds the positions, or the middle posture lies outside.
    """
    known = of_robot(source)
    if known is None:
        if not (arm.position_min and arm.position_max):
            raise ConfigError(
                f"robot {arm.robot!r} brings no limits; give position_min and position_max [rad] "
                "in the arm's table of the rig file"
            )
        low, high = np.array(arm.position_min), np.array(arm.position_max)
        known = Limits(low, high, np.full(low.size, INF), np.full(low.size, INF), (low + high) / 2)
    low = np.array(arm.position_min) if arm.position_min else known.low
    high = np.array(arm.position_max) if arm.position_max else known.high
    own = [k for k in ("position", "workspace") if getattr(arm, f"{k}_min")]
    # a speed that the robot does not state, the file has to: nothing is assumed
    lacking = [k for what, k in known.unstated if what == "speed"]
    speed = np.where(np.isin(np.arange(low.size), lacking), INF, known.speed)
    out = replace(
        known,
        low=low,
        high=high,
        box=_box(arm, known.box),
        speed=np.minimum(speed, arm.speed_limit),
        unstated=tuple(x for x in known.unstated if x[0] != "speed"),
        torque=np.minimum(known.torque, arm.torque_limit),
        center=np.array(center) if center else np.clip(known.center, low, high),
        source=" and ".join([*(["the rig file"] if own else []), known.source]).strip(),
    )
    return out


def arm_description(arm: ArmConfig) -> ArmDescription:
    """What a law or a simulator is told of an arm."""
    source = robot_source(arm)
    limits = limits_of_arm(arm, source)
    return ArmDescription(
        arm.joints,
        source.urdf,
        tuple(map(float, limits.low)),
        tuple(map(float, limits.high)),
        tuple(map(float, limits.center)),
        arm.torque_limit,
    )


def _box(arm: ArmConfig, known: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    given = (arm.workspace_min, arm.workspace_max)
    if known is None and not any(given):
        return None
    base = np.array([[-INF] * 3, [INF] * 3]) if known is None else known
    return np.stack([np.array(g) if g else b for g, b in zip(given, base, strict=True)])
