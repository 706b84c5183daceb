"""From a rig file to open devices: drivers by name, wires by back end."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil import registry
from hil.config import RigConfig, parse
from hil.errors import ConfigError, DeviceError
from hil.excite import files, margins
from hil.excite.limits import of_arm
from hil.models.robots import bare_robot
from hil.record.recording import RobotSource
from hil.runtime.loop import ArmPort
from hil.signals.device import Controller, Device, MeasuredCf, MeasuredJs, ServoJf, Tareable, Wire

#: What to do where a back end is asked for that does not exist.
NOT_YET = 'this version drives simulated devices only; set backend = "sim"'


@dataclass
class Rig:
    """Open devices of a rig.

    Parameters
    ----------
    devices : dict
        Name -> device.
    ports : list of ArmPort
        Arms in the order of the controller.
    controller : Controller
        The law.
    origin_ns : int
        Device time of tick 0, after taring [ns].
    biases : dict
        Device -> bias of its gauges [words].
    """

    devices: dict[str, Device]
    ports: list[ArmPort]
    controller: Controller
    origin_ns: int = 0
    biases: dict[str, list[float]] = field(default_factory=dict)

    def enable(self) -> None:
        """Enable every device; the first refusal is raised, and `close` makes the rest safe."""
        for device in self.devices.values():
            device.enable()

    def close(self) -> None:
        """Make every device safe and release it, even where another one fails to."""
        with ExitStack() as stack:
            for device in self.devices.values():
                stack.callback(device.close)


def require_backend(name: str, config: RigConfig) -> None:
    """Refuse a device whose back end does not exist."""
    backend = config.backend_of(name)
    if backend != "sim":
        driver = config.devices[name].driver
        raise DeviceError(
            f"device {name!r}: driver {driver!r} has no {backend!r} back end yet; {NOT_YET}."
        )


def open_rig(config: RigConfig, seed: int) -> Rig:
    """Open all devices, tare the force sensors, and build the controller."""
    for name in config.devices:
        require_backend(name, config)
    check_trajectory(config)
    wires = _wires(config, seed)
    period = config.loop.period_ns * 1e-9
    devices: dict[str, Device] = {}
    for name, device in config.devices.items():
        driver = registry.load("hil.drivers", device.driver)
        options = parse(driver.Config, device.options, f"devices.{name}.options")
        devices[name] = driver.open_device(name, wires[device.arm], options, period)
    ports = [_port(arm, config, devices) for arm in config.controller.arms]
    rig = Rig(devices, ports, build_controller(config))
    _tare(rig)
    return rig


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
    motion = files.read(path)
    for arm in config.controller.arms:
        table = config.arms[arm]
        source = RobotSource(table.robot, tip=table.tip)
        robot = bare_robot(source, table.joints)
        limits = of_arm(table, source)
        try:
            margins.check(motion, limits, robot, config.loop.rate_hz)
        except ConfigError as error:
            raise ConfigError(f"{path}, arm {arm!r}: {error}") from error


def build_controller(config: RigConfig) -> Controller:
    """Law of the rig with its parameters."""
    law = registry.load("hil.controllers", config.controller.name)
    given = config.controller.parameters
    parameters = parse(law.Config, given, "controller.parameters")
    built: Controller = law.build(parameters, config.controller.arms, config.loop.period_ns * 1e-9)
    return built


def force_sensors(config: RigConfig) -> dict[str, str]:
    """Arm -> model of the force sensor that it carries."""
    models = dict.fromkeys(config.arms, "nano17")
    for device in config.devices.values():
        if device.driver == "ft-sensor":
            models[device.arm] = str(device.options.get("model", "nano17"))
    return models


def _wires(config: RigConfig, seed: int) -> Mapping[str, Wire]:
    section: dict[str, Any] = dict(config.simulation)
    open_bench = registry.load("hil.sim_devices", str(section.get("bench", "ideal")))
    bench = open_bench(force_sensors(config), section, config.loop.period_ns, seed)
    return {arm: bench.wire(arm) for arm in config.arms}


def _port(arm: str, config: RigConfig, devices: Mapping[str, Device]) -> ArmPort:
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
    return ArmPort(
        joints[0], efforts[0], force[0] if force else None,
        getattr(joints[0], "counts", zeros[:3]), getattr(efforts[0], "codes", zeros[:3]),
        getattr(force[0], "gauges", zeros) if force else zeros,
        np.array(limits.torque_limit), np.array(limits.speed_limit),
    )  # fmt: skip


def _tare(rig: Rig) -> None:
    """Tare the force sensors one after the other, while the arms rest."""
    for name, device in rig.devices.items():
        if isinstance(device, Tareable):
            rig.origin_ns = device.tare(rig.origin_ns)
            rig.biases[name] = [float(b) for b in device.bias]
