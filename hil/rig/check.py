"""Mistakes in a rig file that show before any device is opened or simulated."""

from __future__ import annotations

from typing import Any

from hil.errors import ConfigError
from hil.excite import trajectory
from hil.excite.limits import check as check_motion
from hil.excite.limits import of_arm
from hil.models.robots import bare_robot
from hil.record.recording import RobotSource
from hil.rig import boxes
from hil.rig.boxes import check_roles
from hil.rig.config import RigConfig


def check_tables(config: RigConfig) -> None:
    """Refuse mistakes in the tables of devices and boxes, before anything is opened or simulated.

    Raises
    ------
    ConfigError
        Names the table.
    """
    require_boxes(config)
    boxes.check_channels(config)
    for name in config.devices:
        device_options(config, name)
        spots = boxes.places(config, name)
        if "gauges" in spots:
            boxes.only_gauges(name, spots)
        elif spots:
            check_roles(name, spots)
    for box in boxes.backends(config):
        boxes.box_options(config, box)


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
            if not d.channels and config.backend_of(n) == backend != "sim"
        ]
        if bare:
            raise ConfigError(
                f"back end {backend!r} needs boxes, and wired to none is {', '.join(bare)}; add "
                f"[devices.{bare[0]}.channels] and the [boxes.NAME] that it names, as "
                'rigs/teleop.toml has them, or set backend = "sim", ideal wires.'
            )


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
    motion = trajectory.read(path)
    for arm in config.controller.arms:
        table = config.arms[arm]
        source = RobotSource(table.robot, tip=table.tip)
        robot = bare_robot(source, table.joints)
        limits = of_arm(table, source)
        try:
            check_motion(motion, limits, robot, config.loop.rate_hz)
        except ConfigError as error:
            raise ConfigError(f"{path}, arm {arm!r}: {error}") from error
