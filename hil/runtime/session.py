"""What a session file says of itself: channels, metadata, the rig file without its secrets.

Beside that, who runs a session, and what it turned out to be.

Nothing of ``[simulation]`` reaches a session but a hash: an analysis must find hidden effects
in the signals.  Nothing depends on wall-clock time in lockstep.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hil import registry
from hil.errors import ConfigError, DataError, unknown
from hil.record import mcap_read
from hil.record.mcap_write import SessionWriter
from hil.record.recording import TAGS, tag_record
from hil.record.schema import Channel
from hil.record.urdf_checks import urdf_joints
from hil.revision import source_revision
from hil.rig import estimators
from hil.rig.check import measures_force
from hil.rig.config import RigConfig, robot_source
from hil.rig.open import Rig
from hil.runtime.board import BoardWriter
from hil.runtime.realtime import Arrangement
from hil.runtime.recorder import SessionParts
from hil.runtime.statistics import Statistics
from hil.runtime.watchdog import report_path
from hil.signals.device import Controller, OperatingState
from hil.signals.frame import GAUGES, TIMING, TIMING_UNITS, FrameLayout
from hil.userfile import LARGEST_TEXT, read_bytes


def _words(d: int) -> dict[str, str]:
    """Words of an arm of d joints on ``/rig/raw``, with their units."""
    groups = (("count", d, "count"), ("code", d, "DAC code"), ("gauge", GAUGES, "ADC word"))
    return {f"{name}{i + 1}": unit for name, n, unit in groups for i in range(n)}


def with_run_options(
    config: RigConfig, seconds: float | None, seed: int, clock: str | None
) -> RigConfig:
    """Rig file with the options of this run; `seed` where the law needs one and has none."""
    changes: dict[str, Any] = {}
    if seconds is not None:
        changes["seconds"] = float(seconds)
    if clock == "lockstep" and config.hardware:
        raise ConfigError("--clock lockstep: hardware runs in real time; use --clock real.")
    changes["clock"] = clock or config.clock
    config = dataclasses.replace(config, loop=dataclasses.replace(config.loop, **changes))
    if config.controller.name not in registry.names("hil.controllers"):
        return config  # refused when the rig is opened
    law = registry.load("hil.controllers", config.controller.name)
    names = {f.name for f in dataclasses.fields(law.Config)}
    if "seed" in names and "seed" not in config.controller.parameters:
        parameters = {**config.controller.parameters, "seed": seed}
        controller = dataclasses.replace(config.controller, parameters=parameters)
        config = dataclasses.replace(config, controller=controller)
    return config


def topics(
    config: RigConfig, layout: FrameLayout, controller: Controller
) -> list[tuple[str, slice]]:
    """Topic -> columns of a row of the ring, in the order in which messages are written."""
    found = []
    for i, arm in enumerate(config.controller.arms):
        found.append((f"/{arm}/measured_js", layout.part("js", i)))
        found.append((f"/{arm}/setpoint_jf", layout.part("jf", i)))
        if measures_force(config, arm):
            found.append((f"/{arm}/measured_cf", layout.part("cf", i)))
    found.append(("/rig/raw", layout.part("words")))
    first = layout.part("estimates").start
    for c in estimators.estimators_beside(controller):
        found.append((c.topic, slice(first + c.at.start, first + c.at.stop)))
    found.append(("/loop/timing", layout.part("timing")))
    return found


def slow_topics(layout: FrameLayout) -> list[tuple[str, slice]]:
    """Topics that get the last row of every burst of the slow side; 'hil replay' has the rest."""
    return [("/controller/state", layout.part("state"))]


def _channels(config: RigConfig, controller: Controller) -> list[Channel]:
    """Channels behind `topics`, in the same order."""
    found = []
    for arm in config.controller.arms:
        joints = config.arms[arm].joints
        state = ("position", "velocity")
        found.append(Channel(f"/{arm}/measured_js", "joint_state", joints, state))
        found.append(Channel(f"/{arm}/setpoint_jf", "joint_state", joints, ("effort",)))
        if measures_force(config, arm):
            found.append(Channel(f"/{arm}/measured_cf", "wrench", frame="base"))
    raw = {
        f"{arm}_{word}": unit
        for arm in config.controller.arms
        for word, unit in _words(len(config.arms[arm].joints)).items()
    }
    found.append(_fields("/rig/raw", tuple(raw), tuple(raw.values()), "RigRaw"))
    for c in estimators.estimators_beside(controller):
        found.append(_fields(c.topic, c.estimator.names, c.estimator.units, c.estimator.message))
    own = estimators.bare_law(controller).state_names
    states = tuple(name.replace(".", "_") for name in own)
    found.append(_fields("/controller/state", states, ("",) * len(states), "ControllerState"))
    found.append(_fields("/loop/timing", TIMING, TIMING_UNITS, "LoopTiming"))
    return found


def _fields(topic: str, names: tuple[str, ...], units: tuple[str, ...], message: str) -> Channel:
    return Channel(topic, "fields", names, units=units, message=f"hil_msgs/msg/{message}")


def session_metadata(config: RigConfig, rig: Rig, seed: int) -> dict[str, dict[str, str]]:
    """Metadata records: the session, then every arm."""
    secret = json.dumps(plain(config.simulation), sort_keys=True)
    revision, dirty = source_revision()
    records = {
        "session": {
            "rig": config.name,
            "package_version": version("hil-teleop"),
            "git_revision": revision,
            "git_dirty": dirty,
            "seed": str(seed),
            "clock": config.loop.clock,
            "scheduler": "lockstep" if config.loop.clock == "lockstep" else "default",
            "rate_hz": repr(config.loop.rate_hz),
            "simulation_sha256": hashlib.sha256(secret.encode()).hexdigest(),
        }
    }
    for arm in config.controller.arms:
        table = config.arms[arm]
        records[f"robot/{arm}"] = {
            "preset": "" if table.own else table.robot,
            # a URDF may have no frame of the default's name: its last one is then the tip
            "tip": robot_source(table).tip,
            "joints": json.dumps(list(table.joints)),
        }
    if config.record.tags:
        records[TAGS] = tag_record(config.record.tags)
    for name, box in rig.boxes.items():
        if settings := getattr(box, "settings", None):
            records[f"box/{name}"] = {"settings": json.dumps(settings, sort_keys=True)}
    for name, device in rig.devices.items():
        scales = getattr(device, "scales", None)
        if scales is not None:
            records[f"calibration/{name}"] = {"scales": json.dumps(scales.tolist())}
    for name, bias in rig.biases.items():
        told: dict[str, str] = getattr(rig.devices[name], "certificate", {})
        records[f"calibration/{name}"] = {"bias_words": json.dumps(bias), **told}
    return records


def open_writer(
    output: Path,
    config: RigConfig,
    rig: Rig,
    seed: int,
    model: str | Path | None = None,
    aside: Callable[[Path], None] = lambda path: None,
    say: Callable[[str], None] = lambda text: None,
) -> SessionParts:
    """Session file, open, with its metadata and the rig file already in it.

    `aside` is called with its path when all else is known to be right, before it is written.
    """
    attachments = {"rig.toml": rig_text(config).encode()}
    for arm in config.controller.arms:
        if config.arms[arm].own:
            attachments[f"robot/{arm}.urdf"] = robot_source(config.arms[arm]).urdf.encode()
    played = config.controller.parameters.get("trajectory")
    if isinstance(played, str) and played:
        attachments["trajectory.toml"] = _attached(Path(played))
    if model is not None:
        attachments["model.toml"] = _attached(Path(model))
    plan, records = _channels(config, rig.controller), session_metadata(config, rig, seed)
    aside(output)
    # of a session that is not there any more
    report_path(output).unlink(missing_ok=True)
    record = config.record

    def opened(path: Path, part: Mapping[str, str]) -> SessionWriter:
        own = {**records, "part": part} if part else records
        writer = SessionWriter(path, plan, own, attachments, sync=record.sync)
        if rig.taps is not None:
            writer.frames(rig.taps.logs, rig.origin_ns, config.loop.period_ns)
            writer.at_the_end(rig.taps.told)
        return writer

    return SessionParts(output, opened, record.split_seconds, record.split_megabytes, say)


def refuse_model(path: str | Path, config: RigConfig) -> None:
    """Refuse a file to attach that is no model of an arm of the rig.

    Raises
    ------
    ConfigError
        If it is no model file, or of another arm, robot or joints.
    """
    from hil.models.files import read_model  # only where a model is attached

    model, arms = read_model(path), {n: config.arms[n] for n in config.controller.arms}
    if model.arm and model.arm not in arms:
        raise ConfigError(f"model {path}: {unknown('arm of the rig', model.arm, arms)}")
    said = [u.joint for u in model.valid] + [j for u in model.effects for j in u.joints if j != "*"]
    if model.robot.urdf:
        said += [j.name for j in urdf_joints(model.robot.urdf)]
    own = model.robot.preset if model.robot.preset != "single-axis" else ""
    able = [arms[model.arm]] if model.arm else list(arms.values())
    if not any(set(said) <= set(arm.joints) and own in ("", arm.robot) for arm in able):
        joints = f" with {', '.join(dict.fromkeys(said))}" if said else ""
        have = "; ".join(f"{a.robot} with {', '.join(a.joints)}" for a in able)
        raise ConfigError(
            f"model {path} is of {own or 'a robot'}{joints}, the rig {config.name!r} has {have}; "
            "attach a model of this rig"
        )


def _attached(path: Path) -> bytes:
    try:
        return read_bytes(path, LARGEST_TEXT)
    except OSError as error:
        raise ConfigError(f"cannot attach {path}: {error.strerror}") from error


def conclude(writer: SessionParts, statistics: Statistics, arrangement: Arrangement) -> None:
    """Metadata that only the end knows: figures of the loop, histograms, arrangement."""
    writer.metadata(
        "loop",
        {
            "figures": json.dumps(statistics.figures().as_dict()),
            "wake_late_us": json.dumps(statistics.late.filled()),
            "busy_us": json.dumps(statistics.busy.filled()),
            "granted": "; ".join(arrangement.granted),
            "refused": "; ".join(arrangement.refused),
        },
    )


def rig_text(config: RigConfig) -> str:
    """Rig file as it was run, with overrides, without ``[simulation]``."""
    table = plain(config)
    table.pop("simulation")
    return to_toml(table)


def plain(value: Any) -> Any:
    """`value` with plain dictionaries and lists throughout, dataclasses included."""
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return value


def to_toml(table: Mapping[str, Any], path: tuple[str, ...] = ()) -> str:
    """TOML text of nested tables; a table within a list is written inline."""
    lines, below = [], []
    for key, value in table.items():
        if isinstance(value, Mapping):
            below.append(to_toml(value, (*path, key)))
        else:
            lines.append(f"{_toml_key(key)} = {_toml_value(value)}")
    # an empty table stays one: a reader may ask for it
    head = [f"[{'.'.join(map(_toml_key, path))}]"] if path and (lines or not table) else []
    return "\n".join([*head, *lines, *([""] if head or lines else [])]) + "".join(below)


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)


def _toml_value(value: Any) -> str:
    """One TOML value; JSON has no infinity, and its escapes of rare characters are none of TOML."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_toml_key(k)} = {_toml_value(v)}" for k, v in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml_value, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "-inf" if value < 0.0 else "inf"
    if isinstance(value, (bool, int, float, str)):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value.isoformat())  # dates and times are the rest of TOML


@dataclass
class Operator:
    """Who watches and commands a session.

    Parameters
    ----------
    schedule : sequence of (float, str)
        Commands and their times [s].
    say : callable
        Takes sentences.
    live : callable or None
        Takes a line of figures a few times a second.
    lines : callable or None
        Called with a function that takes the operator's lines, once the loop is ready.
    wait : bool
        The session begins DISABLED and waits for ``start``.
    board : BoardWriter or None
        Shows the session to other processes, twenty times a second.
    """

    schedule: Sequence[tuple[float, str]] = ()
    say: Callable[[str], None] = lambda text: None
    live: Callable[[str], None] | None = None
    lines: Callable[[Callable[[str], None]], None] | None = None
    wait: bool = False
    board: BoardWriter | None = None


@dataclass(frozen=True)
class Summary:
    """What a session turned out to be.

    Parameters
    ----------
    path : str
        Session file.
    clock : str
        ``"lockstep"`` or ``"real"``.
    seed : int
        Of the noise, and of what the rig file leaves open.
    ticks, missed, dropped, limited : int
        Ticks run, periods skipped, rows lost, ticks with a limited command.
    seconds, wall_seconds : float
        Length of the session, and how long it took [s].
    longest_tick_us : float
        Longest time from wake-up to the last command [us]; 0 in virtual time.
    state, reason : str
        Operating state before the end, and the conditions that led to it.
    unwritten : int
        Rows that the loop gave but the disk did not take.
    left_out : int
        Rows that were not recorded because the operator said ``record off``.
    figures : dict
        `hil.runtime.statistics.Figures`.
    granted, refused : list of str
        What the operating system did for the loop, and sentences about what it did not.
    parts : list of str
        Files of the session after the first.
    """

    path: str
    clock: str
    seed: int
    ticks: int
    missed: int
    dropped: int
    limited: int
    seconds: float
    wall_seconds: float
    longest_tick_us: float
    state: str = "ENABLED"
    reason: str = ""
    unwritten: int = 0
    left_out: int = 0
    figures: dict[str, float] = field(default_factory=dict)
    granted: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    parts: list[str] = field(default_factory=list)

    @property
    def paused(self) -> bool:
        """Whether the motors were without torque when the session ended."""
        return self.state == OperatingState.PAUSED.name

    def enabled(self) -> Summary:
        """Return this, or refuse a session at whose end the law did not run.

        Raises
        ------
        DataError
            Naming the session, its state and the condition that led to it.
        """
        if self.state == OperatingState.ENABLED.name:
            return self
        raise DataError(
            f"{self.path}: the session ended {self.state}"
            + (f", because {self.reason}" if self.reason else "")
            + "; no number is taken from it. Run a design that 'hil design' passes, or a calmer "
            "motion"
        )

    def as_dict(self) -> dict[str, object]:
        """Plain dictionary for JSON."""
        return {"schema": "hil.run/1", **asdict(self)}


def cut_short(output: Path, error: OSError, lost: int) -> str:
    """What is left of a session that could not be written on."""
    try:
        longest = max(
            (c.last_s for c in mcap_read.summary(output).channels if c.count), default=0.0
        )
    except DataError:
        longest = 0.0
    kept = (
        f"the first {longest:.3g} s are kept; once there is room, 'hil info {output} --recover "
        "NEW.mcap' writes them as a proper session"
        if longest
        else "nothing of it was kept; make room and run it again"
    )
    return (
        f"session {output} was cut short while the loop went on to its end, {lost} rows are lost, "
        f"the arms are released: {error.strerror or error}; {kept}"
    )
