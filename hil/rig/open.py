"""Open a rig: from its configuration to devices, estimators and ports that the loop drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil import registry
from hil.errors import ConfigError, DeviceError
from hil.interrupt import Ended
from hil.rig import boxes as cabling
from hil.rig import estimators, safety
from hil.rig.boxes import BoxWire, CanDrives, only_gauges, open_boxes, places, trouble, wired
from hil.rig.check import (
    arm_description,
    check_parameters,
    check_tables,
    check_trajectory,
    device_options,
    limits_of_arm,
    measures_force,
    self_contained,
)
from hil.rig.config import SIMULATED, ArmConfig, DeviceConfig, RigConfig, robot_source
from hil.rig.frame_capture import Taps
from hil.signals.device import (
    Controller,
    Device,
    FloatArray,
    IntArray,
    MeasuredCf,
    MeasuredJs,
    OperatingState,
    ServoJf,
    Status,
    Tareable,
    Wire,
)
from hil.signals.frame import GAUGES
from hil.toml import in_table, parse


@dataclass(frozen=True)
class ArmPort:
    """Capabilities and words of one arm.

    Parameters
    ----------
    joints : MeasuredJs
        Joint state.
    efforts : ServoJf
        Takes joint efforts.
    force : MeasuredCf or None
        Force at the tip.
    counts, codes : ndarray (d,) of int
        Words of the last exchange.
    gauges : ndarray (6,) of int
        Words of the force sensor.
    torque_limit, speed_limit : ndarray (d,)
        [N m], [rad/s].
    limits : ndarray
        Of `hil.rig.safety.safety_limits`.
    tip : callable or None
        Writes the tip position [m] of a posture into an array (3,), where there is a `box`.
    box : ndarray (2, 3) or None
        Workspace of the tip [m].
    """

    joints: MeasuredJs
    efforts: ServoJf
    force: MeasuredCf | None
    counts: IntArray
    codes: IntArray
    gauges: IntArray
    torque_limit: FloatArray
    speed_limit: FloatArray
    limits: FloatArray
    tip: Callable[[FloatArray, FloatArray], None] | None = None
    box: FloatArray | None = None


class _PlugInDevice:
    """Fast path of a plug-in's device: what it raises or wrongly answers says whose it is."""

    def __init__(self, device: Any, name: str, driver: str) -> None:
        self._device, self._name, self._driver = device, name, driver

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def measured_js(self, t_ns: int, position: FloatArray, velocity: FloatArray) -> Status:
        """See `hil.signals.device.MeasuredJs`."""
        return self._status("measured_js", t_ns, position, velocity)

    def measured_cf(self, t_ns: int, position: FloatArray, wrench: FloatArray) -> Status:
        """See `hil.signals.device.MeasuredCf`."""
        return self._status("measured_cf", t_ns, position, wrench)

    def servo_jf(self, effort: FloatArray, sent: FloatArray) -> Status:
        """See `hil.signals.device.ServoJf`."""
        return self._status("servo_jf", effort, sent)

    def fault(self) -> None:
        """See `hil.signals.device.ServoJf`."""
        with registry.blaming("hil.drivers", self._driver, self._failed("fault"), DeviceError):
            self._device.fault()

    def _failed(self, step: str) -> str:
        return f"device {self._name!r} (driver {self._driver!r}) failed in {step}"

    def _status(self, step: str, *given: Any) -> Status:
        try:
            found = getattr(self._device, step)(*given)
            if isinstance(found, (int, np.integer)) and 0 <= found <= Status.LOST:
                return found  # type: ignore[return-value]
            raise TypeError(f"it returned {found!r}; a hil.signals.device.Status is needed")
        except Ended:
            raise
        except (Exception, SystemExit) as error:
            what = self._failed(step)
            said = registry.blamed("hil.drivers", self._driver, what, error)
            raise DeviceError(said) from error


class _PlugInLaw:
    """Law of a plug-in: what it raises says whose it is."""

    def __init__(self, law: Any, name: str) -> None:
        self._law, self._name = law, name
        self.state_names: tuple[str, ...] = _state_names(law)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._law, name)

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """See `hil.signals.device.Controller`."""
        try:
            self._law.update(t, x, u, x_next, y)
        except Ended:
            raise
        except (Exception, SystemExit) as error:
            what = f"the law {self._name!r} failed at {t:g} s"
            raise ConfigError(
                registry.blamed("hil.controllers", self._name, what, error)
            ) from error


def _state_names(law: Any) -> tuple[str, ...]:
    """Names of the entries of a law's state, each once: they become fields of a message."""
    names = tuple(law.state_names)
    if not all(isinstance(n, str) for n in names) or len(set(names)) < len(names):
        raise TypeError(f"state_names = {names!r}; strings are needed, each once")
    return names


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
    if force and not measures_force(config, arm):
        raise ConfigError(
            f"arm {arm!r}: one of its devices {', '.join(mine)} measures a force, and its driver "
            "does not say so before it is opened; make open_device the class of the device, or "
            "annotate what it returns."
        )
    limits = config.arms[arm]
    if limits.own and not all(getattr(d, "ANY_ARM", True) for d in force):
        name = next(n for n, d in mine.items() if d is force[0])
        raise ConfigError(
            f"arm {arm!r}: the force sensor {name!r} turns what it reads by the joints of a "
            "PHANTOM, and this arm has a URDF; take it out of the rig file, or bring a driver of "
            "your own that tells forces in the base frame."
        )
    none, zeros = np.zeros(len(limits.joints), np.int64), np.zeros(GAUGES, np.int64)
    robot = limits_of_arm(limits, robot_source(limits))
    boxed = bool(limits.workspace_min or limits.workspace_max)
    force_range = float(getattr(force[0], "max_force", np.inf)) if force else np.inf
    numbers = safety.safety_limits(limits, robot, config.safety, force_range)
    _refuse_lamps(arm, limits, numbers)
    return ArmPort(
        _watched(joints[0], mine, config),
        _watched(efforts[0], mine, config),
        _watched(force[0], mine, config) if force else None,
        getattr(joints[0], "counts", none),
        getattr(efforts[0], "codes", none),
        getattr(force[0], "gauges", zeros) if force else zeros,
        np.array(limits.torque_limit),
        np.array(limits.speed_limit),
        numbers,
        _tip(limits.robot) if boxed else None,
        robot.box if boxed else None,
    )


def _watched(device: Any, mine: Mapping[str, Device], config: RigConfig) -> Any:
    """A device as the loop calls it; those of this package keep to the rules by their tests."""
    name = next(n for n, d in mine.items() if d is device)
    driver = config.devices[name].driver
    return device if registry.own("hil.drivers", driver) else _PlugInDevice(device, name, driver)


def _refuse_lamps(arm: str, table: ArmConfig, numbers: FloatArray) -> None:
    """Refuse a yellow lamp of the rig file that the sensor's range leaves no place for."""
    yellow, red = safety.lamps(numbers)
    if 0.0 < red < yellow and table.force_yellow:
        raise ConfigError(
            f"[arms.{arm}]: force_yellow = {yellow:g} N is above {red:g} N, 85 % of the range of "
            "its force sensor, where the red lamp is; give less, or force_red too."
        )


def _tip(robot: str) -> Callable[[FloatArray, FloatArray], None]:
    """Tip position of a posture, compiled; for the workspace of the loop."""
    forward, lengths = registry.load("hil.kinematics", robot)()
    return lambda q, out: forward(q, lengths, out)


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
    boxes : dict
        Name -> open box.
    taps : Taps, optional
        Frames of the boxes, recorded or replayed.
    stack : ExitStack
        What closing takes.
    bench : object or None
        The simulator behind the wires, for who pulls its plugs; None on hardware.
    drivers : dict
        Device -> name of its driver.
    """

    devices: dict[str, Device]
    ports: list[ArmPort]
    controller: Controller
    origin_ns: int = 0
    biases: dict[str, list[float]] = field(default_factory=dict)
    boxes: dict[str, Any] = field(default_factory=dict)
    taps: Taps | None = None
    stack: ExitStack = field(default_factory=ExitStack)
    bench: Any = None
    drivers: dict[str, str] = field(default_factory=dict)

    def enable(self) -> None:
        """Enable every device; the first refusal is raised, and `close` makes the rest safe."""
        for name, device in self.devices.items():
            driver = self.drivers.get(name, "")
            with _step(name, driver, "cannot be enabled"):
                device.enable()

    def trouble(self) -> str:
        """Why boxes are lost; empty while none is."""
        return " ".join(filter(None, map(trouble, self.boxes.values()))).rstrip(".")

    def states(self, tables: Mapping[str, DeviceConfig], why: str = "") -> list[dict[str, str]]:
        """State of every device and box, with the reason of a fault.

        Parameters
        ----------
        tables : mapping of str to DeviceConfig
            ``[devices]`` of the rig file.
        why : str
            Why the loop let go of the arms; empty where it did not.
        """
        lost = {name: trouble(box).rstrip(".") for name, box in self.boxes.items()}
        rows = []
        for name, device in self.devices.items():
            table, state = tables[name], device.state
            wires = (p.lstrip("-").partition("/")[0] for ps in table.channels.values() for p in ps)
            found = "; ".join(dict.fromkeys(lost[w] for w in wires if lost.get(w)))
            reason = found or (why if state is OperatingState.FAULT else "")
            row = {"name": name, "driver": table.driver, "state": state.name, "reason": reason}
            rows.append(row)
        for name, reason in lost.items():
            state_ = "LOST" if reason else "ANSWERS"
            rows.append({"name": name, "driver": "box", "state": state_, "reason": reason})
        return rows

    def outrun(self, tick: int) -> str:
        """Where the recording in place of the boxes ends, if before `tick`; empty if not."""
        ticks, said = self.taps.ends() if self.taps is not None else (0, "")
        return said if tick > ticks else ""

    def close(self) -> None:
        """Make every device safe and release it and its boxes, even where another one fails to."""
        self.stack.close()


def open_rig(config: RigConfig, seed: int, bench: Any = None) -> Rig:
    """Open all boxes and devices, tare the force sensors, and build the controller.

    Parameters
    ----------
    config : RigConfig
        The rig.
    seed : int
        Of the simulation.
    bench : object, optional
        Simulated bench to use instead of a new one, from `bench_of`.

    Raises
    ------
    DeviceError
        If a box or device is not there or refuses.
    """
    check_tables(config)
    check_trajectory(config)
    check_parameters(config)
    controller = build_controller(config)  # a law that refuses does so before any device opens
    check_forces(config, controller)
    with ExitStack() as stack:
        rig = _open(config, bench or bench_of(config, seed), stack, controller)
        rig.stack = stack.pop_all()
    return rig


def _open(config: RigConfig, bench: Any, stack: ExitStack, controller: Controller) -> Rig:
    """Rig whose devices and boxes `stack` closes."""
    plan = cabling.wiring_plan(config)
    buses = bench.buses(plan) if bench is not None and plan else {}
    taps = Taps(config)
    boxes = open_boxes(config, buses, stack, taps)
    period = config.loop.period_ns * 1e-9
    devices: dict[str, Device] = {}
    for name, device in config.devices.items():
        driver, options = registry.load("hil.drivers", device.driver), device_options(config, name)
        wire = _wire(name, config, bench, boxes, taps)
        with in_table(f"devices.{name}"), _step(name, device.driver, "cannot be opened"):
            devices[name] = opened = driver.open_device(name, wire, options, period)
        stack.callback(_close, name, device.driver, opened)
    ports = [port_of(arm, config, devices) for arm in config.controller.arms]
    rig = Rig(devices, ports, controller)
    rig.boxes, rig.taps, rig.bench = boxes, taps, bench
    rig.drivers = {name: device.driver for name, device in config.devices.items()}
    rig.origin_ns = bench.now_ns if bench is not None else 0
    _tare(rig)
    return rig


def _step(name: str, driver: str, failed: str) -> AbstractContextManager[None]:
    """A step of a device: what a plug-in's driver raises names both."""
    what = f"device {name!r} (driver {driver!r}) {failed}"
    return registry.blaming("hil.drivers", driver, what, DeviceError)


def _close(name: str, driver: str, device: Device) -> None:
    """Close a device; one of a plug-in that fails to is disabled at least, or it is said."""
    try:
        device.close()
    except (Exception, SystemExit):
        off = "it was disabled"
        try:
            device.disable()
        except (Exception, SystemExit):
            off = "its motors may still be on: take their power off"
        with _step(name, driver, f"failed to close ({off})"):
            raise


def check_forces(config: RigConfig, controller: Controller) -> None:
    """Refuse a law that reads the force of an arm which measures none.

    Raises
    ------
    ConfigError
        Names the law, the arm, and what to do.
    """
    fed = {c.arm for c in estimators.estimators_beside(controller) if c.feeds}
    for row in getattr(estimators.bare_law(controller), "needs_force", ()):
        arm = config.controller.arms[row]
        if row not in fed and not measures_force(config, arm):
            mine = ", ".join(n for n, d in config.devices.items() if d.arm == arm) or "none"
            raise ConfigError(
                f"[controller]: the law {config.controller.name!r} reads the force on the tip of "
                f"arm {arm!r}, and no device of that arm measures one (its devices: {mine}); add a "
                "force sensor, an estimator of that arm with replaces_force = true, or take "
                "parameters or a law that need no force there."
            )


def build_controller(config: RigConfig) -> Controller:
    """Law of the rig with its parameters, and the estimators beside it."""
    with in_table("controller"):
        law = registry.load("hil.controllers", config.controller.name)
    name, given = config.controller.name, config.controller.parameters
    with registry.blaming("hil.controllers", name, f"the law {name!r} cannot be built"):
        parameters = parse(law.Config, given, "controller.parameters")
        with in_table("controller"):
            built = _law(law, parameters, config)
        if not registry.own("hil.controllers", name):
            built = _PlugInLaw(built, name)
    return estimators.accompanied(built, config)


def _law(law: Any, parameters: Any, config: RigConfig) -> Controller:
    """A law of any number of joints is told the robots; the others are of arms of three."""
    arms, period = config.controller.arms, config.loop.period_ns * 1e-9
    if getattr(law, "ANY_JOINTS", False):
        robots = tuple(arm_description(config.arms[arm]) for arm in arms)
        found: Controller = law.build(parameters, arms, period, robots)
        return found
    d = len(config.arms[arms[0]].joints)
    if d != 3:
        laws = registry.loadable("hil.controllers")
        able = [n for n, found in laws if getattr(found, "ANY_JOINTS", False)]
        raise ConfigError(
            f"the law {config.controller.name!r} is of arms of three joints, these have {d}; "
            f"laws for any number of joints are {', '.join(able)}"
        )
    of_three: Controller = law.build(parameters, arms, period)
    return of_three


def force_sensors(config: RigConfig) -> dict[str, str]:
    """Arm -> model of the force sensor that it carries."""
    models = dict.fromkeys(config.arms, "nano17")
    for device in config.devices.values():
        if device.driver == "ft-sensor":
            models[device.arm] = str(device.options.get("model", "nano17"))
    return models


def bench_of(config: RigConfig, seed: int) -> Any:
    """Simulated bench, or None where everything is hardware."""
    if all(config.backend_of(d) not in SIMULATED for d in config.devices):
        return None
    section: dict[str, Any] = dict(config.simulation)
    open_bench = registry.load("hil.sim_devices", str(section.get("bench", "ideal")))
    arms = {a: arm_description(t) for a, t in config.arms.items() if t.own}
    return open_bench(arms or force_sensors(config), section, config.loop.period_ns, seed)


def _wire(
    name: str, config: RigConfig, bench: Any, boxes: Mapping[str, Any], taps: Taps
) -> Wire | None:
    """Wire of a device: through boxes where it has them, ideal in a simulation, or its own."""
    if self_contained(config, name) and config.backend_of(name) not in SIMULATED:
        return None
    if name not in wired(config):
        ideal: Wire = bench.wire(config.devices[name].arm)
        return ideal
    spots = places(config, name)
    if "gauges" in spots:
        source: Wire = boxes[only_gauges(name, spots).box]
        return source
    if "drives" in spots:
        return CanDrives(name, [(boxes[p.box], p) for p in spots["drives"]])
    rows = {role: [(boxes[p.box], p) for p in row] for role, row in spots.items()}
    world = None if bench is None else bench.advance
    names = {p.box for row in spots.values() for p in row}
    return BoxWire(name, rows, taps.advance(sorted(names), world))


def _tare(rig: Rig) -> None:
    """Tare the force sensors one after the other, while the arms rest."""
    for name, device in rig.devices.items():
        if isinstance(device, Tareable):
            with _step(name, rig.drivers[name], "cannot be tared"):
                rig.origin_ns = device.tare(rig.origin_ns)
            rig.biases[name] = [float(b) for b in device.bias]
