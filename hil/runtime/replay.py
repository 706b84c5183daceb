"""Re-run the law of a session on what it measured, and compare what it commanded, bit by bit.

Rig, measurements and commands come from the session, on rows that all channels share.  The loop's
decisions (operating state, commands of the operator) are taken from the record; the law, the limits
and the conversion of the driver are run again.
"""

from __future__ import annotations

import dataclasses
import json
import struct
import tempfile
from collections import defaultdict, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil import registry
from hil.errors import DataError
from hil.record.container import Container, read
from hil.record.schema import decode_joint_state, decode_numbers
from hil.revision import source_revision
from hil.rig import estimators, safety
from hil.rig.check import measures_force, opens, self_contained
from hil.rig.config import RigConfig
from hil.rig.operator import Shop
from hil.runtime import commands
from hil.signals.device import Controller, FloatArray, IntArray, OperatingState, ServoJf, Status
from hil.signals.frame import GAUGES, TIMING, FrameLayout
from hil.signals.settable import SettableRange
from hil.toml import parse
from hil.userfile import parse_toml


@dataclass
class RecordedInputs:
    """What a session holds for a replay, on the rows that all its channels share."""

    config: RigConfig
    ticks: IntArray
    times: FloatArray
    u: FloatArray
    sent: FloatArray
    codes: FloatArray
    timing: dict[str, FloatArray]
    states: dict[int, FloatArray]
    commands: dict[int, list[str]]
    scales: dict[str, FloatArray]


def played_boxes(box: Container, folder: Path) -> RecordedInputs:
    """Everything that a replay needs."""
    if "rig.toml" not in box.attachments:
        raise DataError(f"session {box.path} has no rig file; only sessions of 'hil run' replay")
    try:
        config = parse(RigConfig, parse_toml(box.attachments["rig.toml"].decode()), "rig")
    except ValueError as error:  # also what is no text, no TOML or no rig file
        raise DataError(f"session {box.path}: its rig file cannot be read: {error}") from error
    config = _with_robots(box, config, folder)
    if "trajectory.toml" in box.attachments:
        (folder / "trajectory.toml").write_bytes(box.attachments["trajectory.toml"])
        law = config.controller
        played = {**law.parameters, "trajectory": str(folder / "trajectory.toml")}
        config = dataclasses.replace(config, controller=dataclasses.replace(law, parameters=played))
    needed = [
        f"/{a}/{c}"
        for a in config.controller.arms
        for c in ("measured_js", "setpoint_jf", *(["measured_cf"] * _has_force(box, config, a)))
    ]
    needed += ["/rig/raw", "/loop/timing"]
    for name in needed:
        if name not in box.topics or not len(box.topics[name]):
            raise DataError(f"session {box.path} holds nothing on {name}; it cannot be replayed")
    n = min(len(box.topics[name]) for name in needed)
    if any(box.topics[name].sequence[:n] != box.topics[needed[0]].sequence[:n] for name in needed):
        raise DataError(f"session {box.path}: its channels do not hold the same ticks")
    try:
        return _arrays(box, config, n)
    except (struct.error, IndexError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise DataError(
            f"session {box.path}: its records cannot be decoded, so it cannot be replayed "
            f"({type(error).__name__}: {error})"
        ) from error


def _has_force(box: Container, config: RigConfig, arm: str) -> bool:
    """Whether the law was given a recorded force; older sessions hold zeros where none was."""
    return f"/{arm}/measured_cf" in box.topics or measures_force(config, arm)


def _with_robots(box: Container, config: RigConfig, folder: Path) -> RigConfig:
    """The rig with the URDFs that the session holds, in place of files that may have moved."""
    arms = dict(config.arms)
    for name, arm in config.arms.items():
        text = box.attachments.get(f"robot/{name}.urdf")
        if arm.own and text is not None:
            place = folder / f"{len(list(folder.iterdir()))}.urdf"
            place.write_bytes(text)
            arms[name] = dataclasses.replace(arm, robot=str(place))
    return dataclasses.replace(config, arms=arms)


def _arrays(box: Container, config: RigConfig, n: int) -> RecordedInputs:
    arms = config.controller.arms
    d = len(config.arms[arms[0]].joints)
    one = FrameLayout(1, 0, joints=d)
    u, sent = np.zeros((n, len(arms), one.measured)), np.zeros((n, len(arms), d))
    raw, codes = decode_numbers(box.topics["/rig/raw"])[:n].reshape(n, len(arms), one.words), []
    for a, arm in enumerate(arms):
        _, js = decode_joint_state(box.topics[f"/{arm}/measured_js"])
        _, jf = decode_joint_state(box.topics[f"/{arm}/setpoint_jf"])
        for part, at in (("position", 0), ("velocity", d)):
            u[:, a, at : at + d] = _given(js[part], box, arm)[:n]
        if _has_force(box, config, arm):
            u[:, a, 2 * d :] = decode_numbers(box.topics[f"/{arm}/measured_cf"])[:n]
        sent[:, a] = _given(jf["effort"], box, arm)[:n]
        codes.append(raw[:, a, d : 2 * d])
    columns = decode_numbers(box.topics["/loop/timing"])[:n]
    timing = {name: columns[:, k] for k, name in enumerate(TIMING[: columns.shape[1]])}
    timing.setdefault("state", np.full(n, float(_ENABLED)))
    if not all(np.isfinite(timing[name]).all() for name in ("missed", "state")):
        raise ValueError("a state or a count of missed periods is not a number")
    states = {}
    if "/controller/state" in box.topics and len(box.topics["/controller/state"]):
        topic = box.topics["/controller/state"]
        states = dict(zip(topic.sequence, decode_numbers(topic), strict=True))
    ticks = box.topics["/loop/timing"].ticks[:n]
    times = box.topics["/loop/timing"].stamps[:n].astype(np.float64)
    return RecordedInputs(
        config,
        ticks,
        times,
        u,
        sent,
        np.stack(codes, axis=1),
        timing,
        states,
        _commands(box),
        _scales(box),
    )


def _scales(box: Container) -> dict[str, FloatArray]:
    """Device -> scales of its drives, where the session holds them."""
    found = {}
    for name, record in box.metadata.items():
        if name.startswith("calibration/") and "scales" in record:
            scales = np.array(json.loads(record["scales"]), np.float64)
            if scales.ndim != 2 or scales.shape[1] != 3 or not np.all(scales > 0):
                raise ValueError(f"{name}: three scales above zero for every drive are needed")
            found[name.removeprefix("calibration/")] = scales
    return found


def _given(values: FloatArray | None, box: Container, arm: str) -> FloatArray:
    if values is None:
        raise DataError(f"session {box.path}: arm {arm!r} misses a part of its state")
    return values


def _commands(box: Container) -> dict[int, list[str]]:
    """Tick -> commands that the loop obeyed before it."""
    found: dict[int, list[str]] = defaultdict(list)
    for raw in box.topics["/events"].data if "/events" in box.topics else ():
        event = json.loads(raw)
        if event["name"] == "command":
            found[int(event["tick"])].append(str(event["data"]["text"]))
    return found


_ENABLED = int(OperatingState.ENABLED)


class _Nowhere:
    """Wire that leads nowhere: a driver of d joints converts, nothing moves.

    `scales` (d, 3) are those that the drives had, of a robot that has drives of its own.
    """

    trouble = ""

    def __init__(self, d: int, scales: FloatArray) -> None:
        self.counts, self.gauges = np.zeros(d, np.int64), np.zeros(GAUGES, np.int64)
        self.rates, self.scales = np.zeros(d, np.int64), scales

    def home(self, counts: IntArray) -> None: ...

    def receive(self, t_ns: int) -> Status:
        return Status.OK

    def send(self, codes: IntArray) -> None: ...

    def power(self, on: bool) -> None: ...

    def rest(self) -> None: ...

    def close(self) -> None: ...


class ReplayRun:
    """The law over the rows of a record; what commands do to the loop, done to this.

    Parameters
    ----------
    record : Played
        What the session holds.
    changes : dict of str to float
        Parameters of the law that are to be others.
    """

    def __init__(self, record: RecordedInputs, changes: dict[str, float]) -> None:
        self.record = record
        self.shop = Shop(None, record.config, bounded=False)
        self.law: Controller = self.shop.law({k: (v,) for k, v in changes.items()})
        self.x = np.zeros(len(self.law.state_names))
        self.x_next = np.zeros_like(self.x)
        self.period_ns = record.config.loop.period_ns
        self.zero_ns = self.tick = 0
        self.state = _ENABLED
        #: Non-zero while the safety has paused, as of the loop.
        self.reason = 0
        self._asked = False
        self._held = set(changes)
        #: Recorded commands that would have undone the changes, with their ticks.
        self.left_out: list[tuple[int, str]] = []
        self.drivers = [
            _driver(record.config, arm, record.scales) for arm in record.config.controller.arms
        ]
        self.joints = record.sent.shape[2]
        limits = [record.config.arms[arm] for arm in record.config.controller.arms]
        self.limits = [(np.array(a.torque_limit), np.array(a.speed_limit)) for a in limits]

    @property
    def powered(self) -> bool:
        """ENABLED or PAUSED in the tick before."""
        return self.state in (_ENABLED, int(OperatingState.PAUSED))

    def begin(self) -> None:
        """To ENABLED."""
        if self.state == OperatingState.DISABLED:
            self.zero_ns = max(0, self.tick - 1) * self.period_ns
        self.reason = 0

    def pause(self) -> None:
        """To PAUSED; the record says so."""
        self._asked = True

    def finish(self) -> None:
        """End; the record says so."""

    def follow(self, controller: Controller, restart: bool) -> None:
        """As `hil.runtime.loop.Loop.follow`."""
        before, self.law = self.law, controller
        size = len(controller.state_names)
        if restart or size != len(self.x):
            self.x, self.x_next = estimators.anew(controller, before, self.x), np.zeros(size)
            self.zero_ns = (self.tick - 1) * self.period_ns

    def all(self) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Efforts and codes of every row, (n, arms, d), and where the law's state was known."""
        r = self.record
        sent, codes = np.zeros_like(r.sent), np.zeros_like(r.codes)
        known = np.ones(r.ticks.size, bool)
        gap = np.diff(r.ticks, prepend=0) - np.diff(r.timing["missed"], prepend=0.0)
        lost, waiting = False, deque(sorted(r.commands))
        for k, tick in enumerate(r.ticks.tolist()):
            self._obey(waiting, tick)
            lost = lost or gap[k] > 1
            self._enter(int(r.timing["state"][k]))
            if not lost:
                self.row(k, sent[k], codes[k])
            known[k] = not lost
            if lost and tick in r.states and r.states[tick].size == self.x.size:
                self.x[:] = r.states[tick]
                lost = False
        return sent, codes, known

    def _obey(self, waiting: deque[int], tick: int) -> None:
        """Commands up to a tick, but for those that set what the changes hold.

        `waiting` holds ticks with commands, also those whose rows were not recorded.
        """
        self._asked = False
        while waiting and waiting[0] <= tick:
            self.tick = waiting.popleft()
            for text in self.record.commands[self.tick]:
                if text.startswith("set ") and text.split()[1] in self._held:
                    self.left_out.append((self.tick, text))
                else:
                    commands.parse_command(text, self.shop).apply(self)
        self.tick = tick

    def _enter(self, state: int) -> None:
        """State of a row; a pause that nobody asked for is one of the safety."""
        paused = state == OperatingState.PAUSED != self.state
        if paused and not self._asked:
            self.reason = 1
        self.state = state

    def row(self, k: int, sent: FloatArray, codes: FloatArray) -> None:
        """One tick: law if it ran, limits, conversion."""
        u, y = self.record.u[k], np.zeros((len(self.drivers), self.joints))
        if self.state == _ENABLED:
            t = (self.tick * self.period_ns - self.zero_ns) * 1e-9
            self.law.update(t, self.x, u, self.x_next, y)
            self.x, self.x_next = self.x_next, self.x
        for a, driver in enumerate(self.drivers):
            safety.limit(y[a], u[a, self.joints : 2 * self.joints], *self.limits[a])
            if driver is None:
                sent[a], codes[a] = y[a], self.record.codes[k, a]
            else:
                driver.servo_jf(y[a], sent[a])
                codes[a] = getattr(driver, "codes", 0)
            if "conditions" in self.record.timing:
                safety.snap(sent[a], safety.EFFORT_GRID)


def _driver(config: RigConfig, arm: str, scales: Mapping[str, FloatArray]) -> ServoJf | None:
    """Driver that takes the efforts of an arm, enabled on a wire to nowhere.

    None for one that speaks to its device itself: a replay opens no device.
    """
    for name, device in config.devices.items():
        if device.arm == arm and hasattr(opens(config, name), "servo_jf"):
            return None if self_contained(config, name) else _on_nowhere(config, name, scales)
    raise DataError(f"the rig file of the session has no device that drives arm {arm!r}")


def _on_nowhere(config: RigConfig, name: str, scales: Mapping[str, FloatArray]) -> ServoJf:
    device = config.devices[name]
    kind = registry.load("hil.drivers", device.driver)
    options = parse(kind.Config, device.options, f"devices.{name}.options")
    d = len(config.arms[device.arm].joints)
    its = scales.get(name, np.ones((d, 3)))
    if len(its) != d:
        raise DataError(f"{name} has scales of {len(its)} drives for {d} joints of {device.arm}")
    driver = kind.open_device(name, _Nowhere(d, its), options, config.loop.period_ns * 1e-9)
    driver.enable()
    return driver  # type: ignore[no-any-return]


@dataclass(frozen=True)
class CommandDifference:
    """Where record and replay part.

    Parameters
    ----------
    tick : int
        First tick that differs.
    arm, what : str
        Arm, and ``effort`` or ``code`` with the number of the joint.
    recorded, replayed : float
        Values.
    """

    tick: int
    arm: str
    what: str
    recorded: float
    replayed: float


@dataclass
class Replayed:
    """Outcome.

    Parameters
    ----------
    path : str
        Session.
    ticks, compared, differ : int
        Rows there are, rows compared, and rows that differ.
    first : Difference or None
        The first one.
    notes : list of str
        What limits the comparison, or explains a difference.
    rms : dict of str to list of float
        Arm -> rms of replayed minus recorded effort per joint [N m].
    """

    path: str
    ticks: int
    compared: int = 0
    differ: int = 0
    first: CommandDifference | None = None
    notes: list[str] = field(default_factory=list)
    rms: dict[str, list[float]] = field(default_factory=dict)

    def as_dict(self) -> dict[str, object]:
        """Plain dictionary for JSON."""
        return {
            "schema": "hil.replay/1",
            "identical": not self.differ,
            **dataclasses.asdict(self),
        }


def replay(path: str | Path, changes: Mapping[str, float] | None = None) -> Replayed:
    """Re-run the law of a session.

    Parameters
    ----------
    path : str or Path
        Session of `hil run`.
    changes : mapping, optional
        Parameters of the law that are to be others: what would it have commanded?

    Raises
    ------
    DataError
        If the session holds no rig file, or misses a channel.
    """
    box = read(path)
    with tempfile.TemporaryDirectory() as folder:
        record = played_boxes(box, Path(folder))
        out = Replayed(str(path), record.ticks.size)
        known = Shop(None, record.config).settable()
        made = ReplayRun(record, dict(changes or {}))
        _judge(record, *made.all(), out)
    _explain(box, out, changes)
    out.notes += _beyond(changes or {}, known)
    for tick, text in made.left_out:
        out.notes.append(f"the recorded command {text!r} of tick {tick} was left out")
    return out


def _judge(
    r: RecordedInputs, sent: FloatArray, codes: FloatArray, known: Any, out: Replayed
) -> None:
    """Compare bit by bit."""
    worse = (sent != r.sent) | (codes != r.codes)
    worse &= known[:, None, None]
    out.compared, out.differ = int(known.sum()), int(worse.any(axis=(1, 2)).sum())
    for a, arm in enumerate(r.config.controller.arms):
        error = (sent[:, a] - r.sent[:, a])[known]
        out.rms[arm] = (
            np.sqrt(np.mean(error**2, axis=0)).tolist() if error.size else [0.0] * error.shape[1]
        )
    if out.differ:
        k, a, j = (int(v[0]) for v in np.nonzero(worse))
        told = ("effort", r.sent, sent), ("code", r.codes, codes)
        name, old, new = told[int(r.sent[k, a, j] == sent[k, a, j])]
        out.first = CommandDifference(
            int(r.ticks[k]),
            r.config.controller.arms[a],
            f"{name}{j + 1}",
            float(old[k, a, j]),
            float(new[k, a, j]),
        )
    if out.compared < out.ticks:
        out.notes.append(
            f"{out.ticks - out.compared} rows follow rows that {_missing(r)}: the state of the "
            "law was unknown until the record gave it again"
        )


def _missing(r: RecordedInputs) -> str:
    """Why rows are not in the record."""
    dropped = "dropped" in r.timing and np.any(np.diff(r.timing["dropped"], prepend=0.0) > 0.0)
    told = [text for texts in r.commands.values() for text in texts]
    why = ["the ring dropped"] if dropped else []
    why += ["the operator did not record (record off)"] if "record off" in told else []
    return " or that ".join(why) or "the record lacks"


def _beyond(changes: Mapping[str, float], known: Mapping[str, SettableRange]) -> list[str]:
    """Changes that no operator could make: a replay moves nothing, and therefore takes them."""
    return [
        f"{name} = {value:g} is out of range: {known[name]}; a session that runs refuses it"
        for name, value in changes.items()
        if name in known and not known[name].low <= value <= known[name].high
    ]


def _explain(box: Container, out: Replayed, changes: Mapping[str, float] | None) -> None:
    """Reasons why record and replay may differ."""
    told = box.metadata.get("session", {})
    if changes:
        changed = ", ".join(f"{k} = {v:g}" for k, v in changes.items())
        out.notes.append(f"the law was run with {changed}")
    if changes or not out.differ:
        return
    revision, dirty = source_revision()
    if told.get("git_revision") != revision:
        out.notes.append(
            f"recorded by revision {told.get('git_revision', 'unknown')[:12]}, replayed by "
            f"{revision[:12]}"
        )
    if "true" in (dirty, told.get("git_dirty")):
        out.notes.append("one of the two had uncommitted changes")
