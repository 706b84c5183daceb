"""Rig files: what may stand in them, one class a table, and reading one."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.errors import ConfigError, DataError, unknown
from hil.models.robots import PRESET_ROBOTS
from hil.record.locked import locked_urdf
from hil.record.recording import RobotSource, tag_record
from hil.record.schema import FIELD
from hil.record.urdf_checks import UrdfJoint, frames_of, urdf_joints
from hil.rigs import NAMES, packaged
from hil.toml import merge, parse
from hil.userfile import parse_toml, read_text


@dataclass(frozen=True)
class RecordConfig:
    """Table ``[record]``: files of a session, and the raw wire frames in it.

    Parameters
    ----------
    split_seconds, split_megabytes : float
        Length [s] and size [10^6 byte] after which a session goes on in a new file; 0: never.
    sync : float
        At most so much of the record [s] is lost when the power fails; 0 leaves it to the
        operating system when it writes to the disk.
    frames : bool
        Write every frame of the boxes into the session.
    replay : str
        Session whose frames answer for the boxes on back end ``"replay"``.
    tags : tuple of str
        Words by which ``hil list`` finds the session.
    """

    split_seconds: float = 0.0
    split_megabytes: float = 0.0
    sync: float = 0.0
    frames: bool = False
    replay: str = ""
    tags: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "tags", tuple(self.tags))
        tag_record(self.tags)
        for name in ("split_seconds", "split_megabytes", "sync"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ConfigError(f"[record]: {name} = {value:g}; 0 or more is needed.")
            if name != "sync" and 0.0 < value < 1.0:
                raise ConfigError(
                    f"[record]: {name} = {value:g}; a file holds 1 s and 1 MB at least. Give 1 or "
                    "more, or 0 to record into one file."
                )


#: Rows of the ring [1]: an hour and more at 1 kHz.
MOST_ROWS = 2**22


@dataclass(frozen=True)
class LoopConfig:
    """Table ``[loop]``: rates [Hz], clock, length of a session [s], rows of the ring.

    `realtime` asks the operating system for its real-time class, an own core and locked memory
    where the clock is real.
    """

    rate_hz: float = 1000.0
    slow_hz: float = 100.0
    clock: str = "lockstep"
    seconds: float = 10.0
    ring_rows: int = 8192
    realtime: bool = True

    def __post_init__(self) -> None:
        if self.clock not in ("lockstep", "real"):
            raise ConfigError(f"[loop]: {unknown('clock', self.clock, ('lockstep', 'real'))}")
        if not 0.0 < self.slow_hz <= self.rate_hz <= 10_000.0:
            raise ConfigError("[loop]: 0 < slow_hz <= rate_hz <= 10000 is needed.")
        if self.seconds <= 0.0 or not 1 <= self.ring_rows <= MOST_ROWS:
            raise ConfigError(
                f"[loop]: seconds and ring_rows must be positive, ring_rows at most {MOST_ROWS}."
            )

    @property
    def period_ns(self) -> int:
        """Length of a tick [ns]."""
        return round(1e9 / self.rate_hz)


@dataclass(frozen=True)
class WindingConfig:
    """Table ``[arms.NAME.winding]``: heat of the motors, by two time constants.

    Parameters
    ----------
    effort_per_amp : tuple of float
        Joint effort per motor current [N m/A], one a joint; default the Premium's reductions
        13.3, 11.2, 11.2 times 23.4 mN m/A.  Empty: nothing is known, and no heat is followed.
    resistance : float
        Of the winding at 25 degC [Ohm].
    winding_to_housing, housing_to_air : float
        Thermal resistances [K/W].
    winding_time, housing_time : float
        Time constants [s].
    ambient, yellow, red : float
        Room, and winding temperatures that light the lamps [degC]; the loop pauses at red.

    Notes
    -----
    Defaults: Maxon RE25 118743 as used in the Premium (mahilab/Phantom).
    """

    effort_per_amp: tuple[float, ...] = (0.311, 0.262, 0.262)
    resistance: float = 2.18
    winding_to_housing: float = 3.1
    housing_to_air: float = 14.0
    winding_time: float = 12.0
    housing_time: float = 612.0
    ambient: float = 25.0
    yellow: float = 80.0
    red: float = 100.0

    def __post_init__(self) -> None:
        positive = (
            *self.effort_per_amp,
            self.resistance,
            self.winding_to_housing,
            self.housing_to_air,
            self.winding_time,
            self.housing_time,
        )
        if min(positive) <= 0 or not self.ambient < self.yellow < self.red:
            raise ConfigError(
                "effort_per_amp, resistances and times must be positive and ambient < yellow < red."
            )


@dataclass(frozen=True)
class SafetyConfig:
    """Table ``[safety]``: when the loop lets go.

    Parameters
    ----------
    stale_ticks : int
        Readings in a row that repeat the last good value before the loop pauses.
    missed_limit : int
        Periods missed within a second that pause the loop; the first second does not count.
    stuck_time : float
        A joint that stands within a count for so long [s] under more than half its torque limit
        has a stuck encoder; 0 = not checked.
    watchdog : float
        Time without a tick [s] after which a process beside this one runs `cut`; 0 = none.
    cut : tuple of str
        Program with arguments that takes the power off the motors.
    """

    stale_ticks: int = 2
    missed_limit: int = 100
    stuck_time: float = 0.25
    watchdog: float = 0.0
    cut: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.stale_ticks < 1 or self.missed_limit < 1:
            raise ConfigError("[safety]: stale_ticks and missed_limit must be at least 1.")
        if self.stuck_time < 0 or self.watchdog < 0:
            raise ConfigError("[safety]: stuck_time and watchdog must not be negative.")


#: Joints that an arm on the loop has at most.
MOST_JOINTS = 7
#: File of a robot of one's own.
URDF = ".urdf"
#: Frame of the tip where the rig file names none.
TIP = "tip"


@dataclass(frozen=True)
class ArmConfig:
    """Table ``[arms.NAME]``: which robot, its joints, and limits [N m], [rad/s].

    `robot` is a preset, or a URDF beside the rig file.  Of a URDF, `joints` are those that run, in
    kinematic order, all where the rig file names none; the others stand where `lock` says [rad or
    m], else at 0.  The limits are those of the URDF, where the rig file does not give them.

    `position_min`, `position_max` [rad] and `workspace_min`, `workspace_max` (tip, base frame)
    [m] bound planned motions; empty means those of the robot.  The loop pauses outside of the
    positions, and outside of the workspace where the rig file gives one.  `acceleration_limit`
    [rad/s^2] is what an encoder can show; `force_yellow` and `force_red` [N] light the lamps, 0
    means 60 and 85 % of the sensor's range.
    """

    robot: str = "phantom-premium-1.5"
    tip: str = TIP
    joints: tuple[str, ...] = ("joint1", "joint2", "joint3")
    torque_limit: tuple[float, ...] = (0.8, 0.8, 0.8)
    speed_limit: tuple[float, ...] = (25.0, 25.0, 25.0)
    position_min: tuple[float, ...] = ()
    position_max: tuple[float, ...] = ()
    workspace_min: tuple[float, ...] = ()
    workspace_max: tuple[float, ...] = ()
    acceleration_limit: float = 5000.0
    force_yellow: float = 0.0
    force_red: float = 0.0
    winding: WindingConfig = field(default_factory=WindingConfig)
    lock: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._refuse_robot()
        self._refuse_rows()
        self._refuse_forces()
        for name in ("position", "workspace"):
            self._refuse_range(name)
        if self.own and (self.workspace_min or self.workspace_max):
            raise ConfigError(
                "a workspace is watched of the PHANTOM Premium alone; bound the joints of "
                "a URDF with position_min and position_max."
            )

    def _refuse_robot(self) -> None:
        """Refuse a robot that is neither a preset nor a URDF, and joints that cannot be run."""
        if not self.own and self.robot not in PRESET_ROBOTS:
            raise ConfigError(
                f"{unknown('robot', self.robot, PRESET_ROBOTS)} A robot of your own is a URDF "
                'beside the rig file, e.g. robot = "arm.urdf".'
            )
        d = len(self.joints)
        if not 1 <= d <= MOST_JOINTS or (d != 3 and not self.own):
            most = f"1 to {MOST_JOINTS}" if self.own else "3"
            more = (
                f" Name those that run, joints = {json.dumps(self.joints[:MOST_JOINTS])}; the "
                "others are locked."
                if self.own and d > MOST_JOINTS
                else ""
            )
            raise ConfigError(f"robot {self.robot!r} has {d} joints; {most} can be run.{more}")
        if self.lock and not self.own:
            raise ConfigError("lock is of the joints of a URDF; a preset has none to lock.")
        twice = [n for k, n in enumerate(self.joints) if n in self.joints[:k]]
        if twice:
            raise ConfigError(
                f"joints = {list(self.joints)} has {twice[0]!r} twice; each joint needs a name of "
                "its own."
            )

    def _refuse_rows(self) -> None:
        """Refuse rows of another length than the joints, and limits that nothing can keep."""
        d = len(self.joints)
        for name in ("torque_limit", "speed_limit"):
            row = getattr(self, name)
            if len(row) != d:
                raise ConfigError(f"{name} = {list(row)} needs {d} entries, one per joint.")
            if min(row) <= 0:
                raise ConfigError(f"{name} = {list(row)}; each entry must be positive.")
        if self.own and self.winding == WindingConfig():
            object.__setattr__(self, "winding", WindingConfig(effort_per_amp=()))
        if len(self.winding.effort_per_amp) not in ({0, d} if self.own else {d}):
            raise ConfigError(f"winding: effort_per_amp needs {d} entries, one per joint.")
        if self.acceleration_limit <= 0:
            raise ConfigError(
                f"acceleration_limit = {self.acceleration_limit:g} rad/s^2 must be positive."
            )

    def _refuse_forces(self) -> None:
        """Refuse lamps that no force lights; whether the sensor reaches them shows at opening."""
        for name in ("force_yellow", "force_red"):
            if getattr(self, name) < 0:
                raise ConfigError(
                    f"{name} = {getattr(self, name):g} N; above 0, or 0 for the share of the "
                    "sensor's range."
                )
        if 0 < self.force_red < self.force_yellow:
            raise ConfigError(
                f"force_yellow = {self.force_yellow:g} N is above force_red = {self.force_red:g} "
                "N; the yellow lamp comes first."
            )

    def _refuse_range(self, name: str) -> None:
        """Refuse a range of positions or of the workspace that is none."""
        low, high = getattr(self, f"{name}_min"), getattr(self, f"{name}_max")
        n = len(self.joints) if name == "position" else 3
        if len(low) not in (0, n) or len(high) not in (0, n):
            raise ConfigError(f"{name}_min and {name}_max need {n} entries or none.")
        if low and high and not all(a < b for a, b in zip(low, high, strict=True)):
            raise ConfigError(
                f"{name}_min = {list(low)} must be below {name}_max = {list(high)}, entry by entry."
            )
        if name == "position":
            refuse_degrees("position_min", low)
            refuse_degrees("position_max", high)

    @property
    def own(self) -> bool:
        """Whether the robot is a URDF."""
        return self.robot.lower().endswith(URDF)


#: More than a joint with ends turns [rad]: four turns.  Beyond the second one a number stands for
#: no limit at all.
MOST_TURNED, UNLIMITED = 8 * math.pi, 3600.0


def refuse_degrees(what: str, angles: Iterable[float]) -> None:
    """Refuse ends of joints that are degrees: many turns, and whole or half numbers.

    Raises
    ------
    ConfigError
        With the angle in rad, and how a winch says that it turns so often.
    """
    for angle in angles:
        if MOST_TURNED < abs(angle) <= UNLIMITED and float(2 * angle).is_integer():
            raise ConfigError(
                f"{what}: {angle:g} rad are {abs(angle) / (2 * math.pi):.0f} turns, more than the "
                f"{MOST_TURNED / (2 * math.pi):.0f} that a joint with ends has; if these are "
                f"degrees, write {math.radians(angle):.6g}. If the joint does turn so often, give "
                f"position_min and position_max that are no whole or half number, {angle + 0.01:g}."
            )


def robot_source(arm: ArmConfig) -> RobotSource:
    """Robot of an arm, its URDF read.

    Raises
    ------
    ConfigError
        If the URDF cannot be read.
    """
    if not arm.own:
        return RobotSource(arm.robot, tip=arm.tip)
    # the frame TIP is the default of a URDF too, and its last one where it has none
    text, _ = locked_urdf(_urdf(arm.robot), arm.joints, arm.lock, arm.robot)
    return RobotSource("", text, "" if arm.tip == TIP else arm.tip)


def _urdf(path: str) -> str:
    try:
        return read_text(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"robot {path}: cannot be read ({error}); name a URDF file.") from error


@dataclass(frozen=True)
class DeviceConfig:
    """Table ``[devices.NAME]``: driver, arm, back end (empty = the rig's), driver's options.

    `channels` maps a role to places ``"BOX/CHANNEL"``, with a minus in front where the sign is
    turned, e.g. ``encoders = ["quad/0", "-quad/1", "quad/2"]``; ideal wires have no use for it.
    """

    driver: str
    arm: str
    backend: str = ""
    address: str = ""
    channels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class BoxConfig:
    """Table ``[boxes.NAME]``: interface that devices are wired to; not used by ideal wires.

    Driver, back end (empty = of the devices wired to it), address (a serial number; empty = the
    only one attached), driver's options.
    """

    driver: str
    backend: str = ""
    address: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ControllerConfig:
    """Table ``[controller]``: name, arms in the order of the law, parameters of the law."""

    name: str
    arms: tuple[str, ...] = ("leader", "follower")
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class EstimatorConfig:
    """Table ``[estimators.NAME]``: runs in the loop beside the law, and is recorded every tick.

    `replaces_force` gives the law its force in place of the arm's force sensor.
    """

    name: str
    arm: str
    replaces_force: bool = False
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class GelConfig:
    """Table ``[gel]``: a block that an arm presses into, for the operator's page to draw.

    Parameters
    ----------
    arm : str
        The arm; empty: none is declared.
    centre : tuple of float
        Middle of its surface in the arm's base frame, whose z points up [m].
    size : tuple of float
        Length along x, along y, and thickness [m].
    """

    arm: str = ""
    centre: tuple[float, ...] = ()
    size: tuple[float, ...] = (0.12, 0.12, 0.03)

    def __post_init__(self) -> None:
        if bool(self.arm) != (len(self.centre) == 3) or len(self.centre) not in (0, 3):
            raise ConfigError(
                "[gel]: needs an arm, and with it centre = [x, y, z], the middle of the surface "
                "in the base frame of that arm [m]."
            )
        if len(self.size) != 3 or min(self.size) <= 0.0:
            raise ConfigError(
                "[gel]: size = [length along x, along y, thickness] needs three lengths above 0 m."
            )


SCHEMA = "hil.rig/1"
#: sim: ideal wires.  sim-wire: the same drivers as on hardware, on simulated buses.  The others
#: are the hardware: "hardware" every box on its own bus, or the name of that bus; and "replay",
#: the frames of a session.
BACKENDS = ("sim", "sim-wire", "hardware", "usb", "hid", "can", "udp", "ws", "replay")
SIMULATED = ("sim", "sim-wire")


@dataclass(frozen=True)
class RigConfig:
    """A whole rig file.

    Parameters
    ----------
    name : str
        Of the rig.
    backend : str
        Back end of every device that does not name its own.
    gel : GelConfig
        What an arm presses into, as it is drawn.
    simulation : mapping
        Table that the simulator reads; it never reaches a session.
    """

    controller: ControllerConfig
    arms: Mapping[str, ArmConfig]
    devices: Mapping[str, DeviceConfig]
    boxes: Mapping[str, BoxConfig] = field(default_factory=dict)
    schema: str = SCHEMA
    name: str = "rig"
    backend: str = "sim"
    loop: LoopConfig = field(default_factory=LoopConfig)
    record: RecordConfig = field(default_factory=RecordConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    estimators: Mapping[str, EstimatorConfig] = field(default_factory=dict)
    gel: GelConfig = field(default_factory=GelConfig)
    simulation: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.schema != SCHEMA:
            raise ConfigError(f"schema = {self.schema!r}; this version reads {SCHEMA!r}.")
        for device in self.devices.values():
            _one_of("arm", device.arm, self.arms)
        self._refuse_arms()
        if self.gel.arm:
            _one_of("arm of [gel]", self.gel.arm, self.controller.arms)
        many = {len(self.arms[arm].joints) for arm in self.controller.arms}
        if len(many) > 1:
            raise ConfigError(
                f"[controller]: its arms have {' and '.join(map(str, sorted(many)))} joints; all "
                "arms of one law have the same number."
            )
        for estimator in self.estimators.values():
            _one_of("arm of an estimator", estimator.arm, self.controller.arms)
        own = [d.backend for d in self.devices.values()] + [b.backend for b in self.boxes.values()]
        for backend in (self.backend, *filter(None, own)):
            _one_of("backend", backend, BACKENDS)

    def _refuse_arms(self) -> None:
        """Refuse arms that no session can name, and a law that has one twice."""
        for arm in self.arms:
            if not FIELD.fullmatch(arm):
                raise ConfigError(
                    f"[arms.{_quoted(arm)}]: the name of an arm becomes that of channels and "
                    "fields of a session; small letters, digits and single _ between them are "
                    'needed, a letter first, e.g. "leader".'
                )
        arms = self.controller.arms
        for k, arm in enumerate(arms):
            _one_of("arm of the controller", arm, self.arms)
            if arm in arms[:k]:
                raise ConfigError(
                    f"[controller]: arms = {list(arms)} has {arm!r} twice; a law drives each arm "
                    f"once. There are {', '.join(self.arms)}."
                )

    @property
    def hardware(self) -> bool:
        """Whether any device or box is not simulated."""
        own = [self.boxes[b].backend for b in self.boxes if self.boxes[b].backend]
        used = {*own, *(self.backend_of(d) for d in self.devices)}
        return not used <= {*SIMULATED, "replay"}

    @property
    def clock(self) -> str:
        """Clock of a session: hardware knows real time alone."""
        return "real" if self.hardware else self.loop.clock

    def backend_of(self, device: str) -> str:
        """Back end of `device`: its own, or the rig's."""
        return self.devices[device].backend or self.backend


def _quoted(name: str) -> str:
    """Name as a key of a TOML table."""
    return name if name.replace("_", "a").replace("-", "a").isalnum() else f'"{name}"'


def _one_of(kind: str, name: str, known: Iterable[str]) -> None:
    if name not in known:
        raise ConfigError(unknown(kind, name, known))


def load_rig(path: str | Path, overrides: Mapping[str, Any] | None = None) -> RigConfig:
    """Read a rig file.

    Parameters
    ----------
    path : str or Path
        TOML file, or the name of a rig file that comes with the package, e.g. ``"teleop"``.
    overrides : mapping, optional
        Tables that are merged over the file, e.g.
        ``{"simulation": {"hidden": [{"effect": "stribeck", "joint": "joint2"}]}}``.
    """
    path = packaged(path)
    try:
        table = parse_toml(read_text(path))
    except FileNotFoundError:
        raise ConfigError(
            f"{path}: no such rig file. Name a file, or a rig that comes with the package: "
            f"{', '.join(NAMES)} ('hil init teleop' copies one to edit)."
        ) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: not a readable TOML file ({error}).") from error
    try:
        return parse(RigConfig, merge(_robots(_beside(table, path), path), overrides or {}), "rig")
    except (ConfigError, DataError) as error:
        raise ConfigError(f"{path}: {error}") from error


#: Effort and speed of a joint whose URDF has none: it may not move before the rig file gives them.
_MOST = {"torque_limit": "effort", "speed_limit": "velocity"}


def _robots(table: dict[str, Any], path: Path) -> dict[str, Any]:
    """The table with what the URDF of an arm gives and the rig file does not."""
    arms = table.get("arms")
    for name, arm in arms.items() if isinstance(arms, Mapping) else ():
        robot = arm.get("robot") if isinstance(arm, Mapping) else None
        if not isinstance(robot, str) or not robot.lower().endswith(URDF):
            continue
        place = str(path.parent / robot)
        joints = _that_run(name, arm, place, urdf_joints(_urdf(place), place))
        _refuse_urdf(name, arm, place, joints)
        filled: dict[str, Any] = {"joints": [j.name for j in joints], **arm, "robot": place}
        for key, of in _MOST.items():
            known = [getattr(j, of) for j in joints]
            lacking = [j.name for j, most in zip(joints, known, strict=True) if math.isinf(most)]
            if key not in filled and lacking:
                raise ConfigError(
                    f"[arms.{name}]: {place} has no limit of {of} above 0 for "
                    f"{', '.join(lacking)}; give {key} in the rig file, one entry per joint."
                )
            filled.setdefault(key, known)
        table = merge(table, {"arms": {name: filled}})
    return table


def _that_run(
    name: str, arm: Mapping[str, Any], place: str, joints: Sequence[UrdfJoint]
) -> Sequence[UrdfJoint]:
    """Joints of a URDF that the rig file names; all but the locked ones where it names none."""
    known, lock = [j.name for j in joints], arm.get("lock", {})
    locked = set(lock) if isinstance(lock, Mapping) else set()
    said = arm.get("joints", [n for n in known if n not in locked])
    if not isinstance(said, list) or not all(isinstance(n, str) for n in said):
        return joints  # which the rows of the table say
    for wanted in (*said, *sorted(locked)):
        if wanted not in known:
            raise ConfigError(
                f"[arms.{name}]: {unknown(f'moving joint of {place}', wanted, known)}"
            )
    if both := sorted(locked & set(said)):
        raise ConfigError(f"[arms.{name}]: joint {both[0]!r} is to run and locked; choose one.")
    run = [j for j in joints if j.name in said]
    if said != [j.name for j in run]:
        order = json.dumps([j.name for j in run])
        raise ConfigError(f"[arms.{name}]: joints are in the order of {place}: {order}.")
    return run


def _refuse_urdf(name: str, arm: Mapping[str, Any], place: str, joints: Sequence[Any]) -> None:
    """Refuse a tip that the URDF does not have, and ranges in degrees."""
    tip, frames = arm.get("tip", TIP), frames_of(_urdf(place))
    if isinstance(tip, str) and tip not in (TIP, "") and tip not in frames:
        raise ConfigError(f"[arms.{name}]: tip: {unknown(f'frame of {place}', tip, frames)}")
    for joint in joints:
        own = [
            a
            for k, a in (("position_min", joint.lower), ("position_max", joint.upper))
            if k not in arm
        ]
        if joint.unit == "rad":
            refuse_degrees(f"[arms.{name}]: {place}, limit of joint {joint.name!r}", own)


def _beside(table: dict[str, Any], path: Path) -> dict[str, Any]:
    """The table with the path of its controller's trajectory taken from the file's folder."""
    controller = table.get("controller")
    parameters = controller.get("parameters") if isinstance(controller, Mapping) else None
    name = parameters.get("trajectory") if isinstance(parameters, Mapping) else None
    if not isinstance(name, str) or not name:
        return table
    return merge(table, {"controller": {"parameters": {"trajectory": str(path.parent / name)}}})
