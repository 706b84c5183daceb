"""From the open devices of one arm to its port into the loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from hil import registry
from hil.config import RigConfig
from hil.errors import ConfigError
from hil.excite.limits import of_arm
from hil.record.recording import RobotSource
from hil.runtime import watch
from hil.runtime.port import ArmPort
from hil.signals.device import Device, FloatArray, MeasuredCf, MeasuredJs, ServoJf


def port_of(arm: str, config: RigConfig, devices: Mapping[str, Device]) -> ArmPort:
    """Capabilities of one arm, from whichever of its devices has them."""
    mine = {n: d for n, d in devices.items() if config.devices[n].arm == arm}
    joints = [d for d in mine.values() if isinstance(d, MeasuredJs)]
    efforts = [d for d in mine.values() if isinstance(d, ServoJf)]
    force = [d for d in mine.values() if isinstance(d, MeasuredCf)]
    if len(joints) != 1 or len(efforts) != 1 or len(force) > 1:
        raise ConfigError(
            f"arm {arm!r}: one device that measures joints and takes efforts is needed, and at "
            f"most one force sensor; it has {', '.join(mine) or 'no device'}."
        )
    zeros = np.zeros(6, np.int64)
    limits = config.arms[arm]
    robot = of_arm(limits, RobotSource(limits.robot, tip=limits.tip))
    boxed = bool(limits.workspace_min or limits.workspace_max)
    force_range = float(getattr(force[0], "max_force", np.inf)) if force else np.inf
    return ArmPort(
        joints[0], efforts[0], force[0] if force else None,
        getattr(joints[0], "counts", zeros[:3]), getattr(efforts[0], "codes", zeros[:3]),
        getattr(force[0], "gauges", zeros) if force else zeros,
        np.array(limits.torque_limit), np.array(limits.speed_limit),
        watch.limits(limits, robot, config.safety, force_range),
        _tip(limits.robot) if boxed else None, robot.box if boxed else None,
    )  # fmt: skip


def _tip(robot: str) -> Callable[[FloatArray, FloatArray], None]:
    """Tip position of a posture, compiled; for the workspace of the loop."""
    forward, lengths = registry.load("hil.kinematics", robot)()
    return lambda q, out: forward(q, lengths, out)
