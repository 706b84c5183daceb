"""From a ROS bag to recordings: which topic, which joints, on one clock.

What a bag does not say is not guessed: where two answers are possible, the import asks.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError, plural, unknown
from hil.record.locked import (
    called_in,
    frame_axes,
    free_joints,
    in_base_axes,
    locked_urdf,
    refuse_beyond,
)
from hil.record.recording import BAG, BEGAN, LOCKED, UNWRAPPED, Recording, RobotSource, refuse_names
from hil.record.schema import LIBRARY, written_by

FloatArray = NDArray[np.float64]
Stamps = NDArray[np.int64]
#: A joint whose position stays within this [rad or m] stands still.
STILL = 1e-3
#: A step of so many median periods is a gap; efforts are not interpolated over it.
GAP = 10.0
#: Fewer samples, or a longer median period [s], are useless for dynamics.
FEWEST, LONGEST_PERIOD = 20, 0.05
_STATES = ("sensor_msgs/msg/JointState", "control_msgs/msg/JointTrajectoryControllerState")
_WRENCH = "geometry_msgs/msg/WrenchStamped"


@dataclass(frozen=True)
class TableChoice:
    """How the columns of a table are read, as the options of `hil import` say it.

    Parameters
    ----------
    map : str
        Map file, or the name of a built-in map.
    unit : str
        Unit of the axes, or ``"deg"``.
    rate_hz : float
        Sample rate of a table without times; 0 where it has some.
    missing, run : str
        What becomes of missing values; run of a file with several.
    torque_constant : tuple of float
        Effort at the joint by motor current [N m/A].
    """

    map: str = ""
    unit: str = ""
    rate_hz: float = 0.0
    missing: str = ""
    run: str = ""
    torque_constant: tuple[float, ...] = ()


@dataclass(frozen=True)
class BagChoice:
    """What is taken of a bag; what is empty is chosen where only one choice is possible.

    Parameters
    ----------
    topic, effort_topic, force_topic : str
        Topics of the joint state, of the motor efforts and of the force at the tip.
    robot : str
        URDF text, before the one in the bag.
    joints : tuple of str
        Joints that move; the others of the URDF are locked.
    lock : mapping of str to float
        Where joints are locked [rad or m], before what the bag says.
    tip, arm : str
        Frame of the force; name of the arm, or which of several arms.
    table : TableChoice
        How the columns of a table are read.
    described : str
        URDF text of the model, for a table that brings no robot.
    """

    topic: str = ""
    effort_topic: str = ""
    force_topic: str = ""
    robot: str = ""
    joints: tuple[str, ...] = ()
    lock: Mapping[str, float] = field(default_factory=dict)
    tip: str = ""
    arm: str = ""
    table: TableChoice = TableChoice()
    described: str = ""


@dataclass(frozen=True)
class _Group:
    """Messages of one topic about one set of joints, in the order of their stamps."""

    topic: str
    type: str
    names: tuple[str, ...]
    frame: str
    stamp: Stamps
    header: Stamps
    parts: Mapping[str, FloatArray]

    @property
    def stamped(self) -> bool:
        """Whether the messages bear a time of their own."""
        return bool(np.any(self.header > 0) and np.all(self.header >= 0))

    def has(self, part: str) -> bool:
        """Whether a part holds a number for some joint."""
        return part in self.parts and bool(np.isfinite(self.parts[part]).any())

    def on(self, clock: str) -> tuple[Stamps, dict[str, FloatArray]]:
        """Increasing stamps [ns] by a clock, and the parts in that order."""
        stamps = self.header if clock == "header" else self.stamp
        _, first = np.unique(stamps, return_index=True)
        return stamps[first], {k: v[first] for k, v in self.parts.items()}


@dataclass(frozen=True)
class _Bag:
    path: Path
    groups: tuple[_Group, ...]
    texts: Mapping[str, str]
    others: Mapping[str, str]
    #: Names in the first message of each topic that cannot be told apart.
    unnamed: Mapping[str, list[str]]


def is_bag(path: str | Path) -> bool:
    """Whether a path is a ROS bag: by ending or folder, or an MCAP file that is no session."""
    path = Path(path)
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    if path.suffix.lower() in (".bag", ".db3"):
        return path.is_file()
    return path.suffix.lower() == ".mcap" and path.is_file() and not _is_session(path)


def _is_session(path: Path) -> bool:
    """Whether an MCAP file says in its header that this program wrote it; so do damaged ones."""
    # what is no MCAP file at all, the reader of sessions says better
    return written_by(path) in (None, LIBRARY)


def read_bag(path: str | Path, choice: BagChoice | None = None) -> list[Recording]:
    """Recordings of the arms of a bag; what was taken is told in ``metadata["note"]``.

    Parameters
    ----------
    path : str or Path
        ROS 1 bag, ROS 2 folder with ``metadata.yaml``, or one file of it (MCAP, SQLite).
    choice : BagChoice, optional
        What to take.

    Raises
    ------
    DataError
        If the bag is damaged, lacks what is needed, or holds several things that could be meant.
    ConfigError
        If a topic or joint that was named is not there.
    """
    chosen = choice or BagChoice()
    bag = _open(Path(path))
    states = _states(bag, chosen)
    zero = {clock: min(int(g.on(clock)[0][0]) for g in states.values()) for clock in _CLOCKS}
    taken = {topic for g in states.values() for topic in (g.topic, _effort(bag, g, chosen)[1])}
    return [_recording(bag, arm, state, chosen, zero, taken) for arm, state in states.items()]


def _open(path: Path) -> _Bag:
    try:
        from hil.record.binary_tables import read_arrays  # its process, where there is a bag

        arrays = read_arrays(path)
    except OSError as error:
        raise DataError(f"bag {path}: {error.strerror or error}") from error
    except DataError as error:
        if path.suffix.lower() != ".mcap":
            raise
        how = f"{shlex.join(['hil', 'info', str(path)])} --recover OUT.mcap"
        said = str(error).rstrip(".")
        raise DataError(f"{said}. If it was cut off, '{how}' writes what is left of it") from error
    about = json.loads(np.asarray(arrays["about"]).tobytes())
    groups = []
    for k, told in enumerate(about["groups"]):
        values = arrays[str(k)]
        if not isinstance(values, dict):
            raise DataError(f"bag {path}: group {k} was not read; it is damaged")
        parts = {n: np.asarray(v, float) for n, v in values.items() if n not in _CLOCKS}
        received, written = (np.asarray(values[n], np.int64) for n in _CLOCKS)
        names = tuple(str(n) for n in told["names"])
        topic, kind, frame = (str(told[key]) for key in ("topic", "type", "frame"))
        groups.append(_Group(topic, kind, names, frame, received, written, parts))
    return _Bag(path, tuple(groups), about["texts"], about["others"], about["unnamed"])


_CLOCKS = ("stamp", "header")


# ---------------------------------------------------------------- what is taken


def _states(bag: _Bag, chosen: BagChoice) -> dict[str, _Group]:
    """Group of the joint state of every arm."""
    found = [g for g in bag.groups if g.type in _STATES and g.has("position")]
    if chosen.topic:
        topics = {g.topic for g in found}
        if chosen.topic not in topics:
            raise ConfigError(
                f"bag {bag.path}: " + unknown("joint state topic", chosen.topic, topics)
            )
        found = [g for g in found if g.topic == chosen.topic]
    if not found:
        raise DataError(
            f"bag {bag.path} has no joint positions{_unnamed(bag)}. It has: {_topics(bag)}"
        )
    if chosen.joints:
        whole = [g for g in found if set(chosen.joints) <= set(g.names)]
        whole = whole or [
            g for g in found if called_in(_robots(bag, chosen), g.names, chosen.joints)
        ]
        if not whole:
            known = sorted({n for g in found for n in g.names})
            lost = next((n for n in chosen.joints if n not in known), "")
            if lost:
                raise ConfigError(f"bag {bag.path}: " + unknown("joint", lost, known))
            raise DataError(
                f"bag {bag.path}: no topic holds all of {', '.join(chosen.joints)}; take the "
                f"joints of one: {_choices(found)}"
            )
        found = whole
    arms = {_namespace(g.topic): g for g in found if g.topic.endswith("/measured_js")}
    # what a controller wants is no state beside what was measured
    found = [g for g in found if arms.get(_namespace(g.topic), g) is g]
    if len(arms) == len(found) and all(arms):  # CRTK: every arm is a namespace
        if not chosen.arm:  # a jaw that rests is no arm
            arms = {n: g for n, g in arms.items() if _works(bag, g, chosen)} or arms
        if chosen.arm and len(arms) > 1:
            if chosen.arm not in arms:
                raise ConfigError(f"bag {bag.path}: " + unknown("arm", chosen.arm, arms))
            return {chosen.arm: arms[chosen.arm]}
        return {chosen.arm: found[0]} if chosen.arm else arms
    return {chosen.arm or "arm": _only(bag, found, chosen)}


def _works(bag: _Bag, state: _Group, chosen: BagChoice) -> bool:
    """Whether a joint of a topic moves, and an effort of it was recorded."""
    try:
        effort, _ = _effort(bag, state, chosen)
    except DataError:
        return False
    return bool(_useful(state, effort, chosen))


def _robots(bag: _Bag, chosen: BagChoice) -> list[str]:
    """Joints of the URDF that was named or is the bag's only one."""
    urdf = _urdf(bag, "", chosen)
    return [j.name for j in free_joints(urdf)] if urdf else []


def _only(bag: _Bag, found: list[_Group], chosen: BagChoice) -> _Group:
    """The one group that can be meant: of the robot, with motion, a state before a controller's."""
    known = set(_robots(bag, chosen))

    def robots(g: _Group) -> bool:
        return not known or bool(known & set(g.names))

    def moving(g: _Group) -> bool:
        return any(_moves(g, n) for n in g.names)

    def driven(g: _Group) -> bool:
        return bool(chosen.effort_topic) or g.has("effort")

    def plain(g: _Group) -> bool:
        return g.type == _STATES[0]

    for better in (robots, moving, driven, plain):
        found = [g for g in found if better(g)] or found
    if len(found) > 1:
        raise DataError(
            f"bag {bag.path} has several joint states; choose one with --topic, or its joints "
            f"with --joints: {_choices(found)}"
        )
    return found[0]


def _choices(groups: Sequence[_Group]) -> str:
    return "; ".join(f"{g.topic} ({', '.join(g.names)})" for g in groups)


def _unnamed(bag: _Bag) -> str:
    """Topics whose messages were passed over, and why."""
    told = [
        f"the messages of {topic} name a joint twice ({', '.join(map(repr, names))})"
        if names
        else f"the messages of {topic} name no joint"
        for topic, names in bag.unnamed.items()
    ]
    return f": {'; '.join(told)}; record it with a name for each joint" if told else ""


def _topics(bag: _Bag) -> str:
    have = {g.topic: g.type for g in bag.groups} | dict(bag.others)
    have |= {topic: "not used" for topic in bag.unnamed if topic not in have}
    return ", ".join(f"{t} ({k})" for t, k in sorted(have.items())) or "no messages"


def _namespace(topic: str) -> str:
    return ".".join(topic.strip("/").split("/")[:-1])


def _description(bag: _Bag, arm: str) -> str:
    """Robot description of an arm's namespace, else the only one of the bag."""
    own = [text for topic, text in bag.texts.items() if arm and _namespace(topic) == arm]
    texts = own or list(dict.fromkeys(bag.texts.values()))
    if len(texts) > 1:
        raise DataError(
            f"bag {bag.path} has several robot descriptions ({', '.join(bag.texts)}); name the "
            "URDF with --robot"
        )
    return texts[0] if texts else ""


def _urdf(bag: _Bag, arm: str, chosen: BagChoice) -> str:
    """Text of the robot's description: the one that was named, else the bag's."""
    return chosen.robot or _description(bag, arm)


def _moves(group: _Group, name: str) -> bool:
    q = group.parts["position"][:, group.names.index(name)]
    return bool(np.isfinite(q).any() and np.nanmax(q) - np.nanmin(q) > STILL)


def _driven(effort: tuple[_Group, str], name: str) -> bool:
    """Whether an effort of a joint was recorded: numbers that are not one and the same."""
    group, _ = effort
    if name not in group.names:
        return False
    tau = group.parts["effort"][:, group.names.index(name)]
    tau = tau[np.isfinite(tau)]
    return bool(tau.size and tau.max() > tau.min())


def _effort(bag: _Bag, state: _Group, chosen: BagChoice) -> tuple[_Group, str]:
    """Group that holds the motor efforts, and how it is told."""
    if chosen.effort_topic:
        found = [g for g in bag.groups if g.topic == chosen.effort_topic and g.has("effort")]
        if not found:
            have = {g.topic for g in bag.groups if g.has("effort")}
            raise ConfigError(
                f"bag {bag.path}: " + unknown("topic with efforts", chosen.effort_topic, have)
            )
        best = max(found, key=lambda g: len(set(g.names) & set(state.names)))
        return _named_as(bag, best, state, chosen), best.topic
    beside = state.topic.rpartition("/")[0] + "/setpoint_jf"
    for g in bag.groups:
        if g.topic == beside and state.topic.endswith("/measured_js") and g.has("effort"):
            return g, beside
    if state.has("effort"):
        return state, state.topic
    known = sorted({g.topic for g in bag.groups if g.has("effort")})
    raise DataError(
        f"bag {bag.path}: {state.topic} holds no efforts; name their topic with --effort-topic"
        f" ({', '.join(known) if known else 'no topic of this bag holds any'})"
    )


def _named_as(bag: _Bag, group: _Group, state: _Group, chosen: BagChoice) -> _Group:
    """Numbers without names as those of the chosen joints, in the order they were given."""
    if group.type in _STATES:
        return group
    names = chosen.joints or state.names
    if len(names) != len(group.names):
        raise DataError(
            f"bag {bag.path}: {group.topic} has {plural(len(group.names), 'number')} a message "
            f"without names, for {plural(len(names), 'joint')} ({', '.join(names)}); name its "
            "joints in its order with --joints"
        )
    return _Group(group.topic, group.type, tuple(names), "", group.stamp, group.header, group.parts)


# ---------------------------------------------------------------- one recording


@dataclass(frozen=True)
class _Chosen:
    """Joints that move, in the order of the robot; the robot; where the others are locked.

    And the joints that the user wants locked or did not name: nothing is known of their efforts.
    """

    names: tuple[str, ...]
    robot: RobotSource
    units: tuple[str, ...]
    locked: Mapping[str, float]
    asked: frozenset[str] = frozenset()
    #: Whether the description is the bag's own.
    own: bool = False


def _joints(bag: _Bag, arm: str, state: _Group, effort: _Group, chosen: BagChoice) -> _Chosen:
    """Joints by name: those that were asked for, else those that move and have an effort."""
    urdf = _urdf(bag, arm, chosen)
    known = free_joints(urdf) if urdf else ()
    refuse_beyond(known, chosen.lock)
    order = [j.name for j in known] or list(state.names)
    if known and not set(order) & set(state.names):
        raise DataError(
            f"bag {bag.path}: the URDF is of another robot: its joints are {', '.join(order)}, "
            f"those of {state.topic} {', '.join(state.names)}. If they are the same ones, name the "
            "URDF's with --joints in the order of the topic"
        )
    for name in chosen.joints:
        if name not in order:
            raise ConfigError("the URDF: " + unknown("moving joint", name, order))
    wanted = chosen.joints or tuple(_useful(state, effort, chosen))
    names = tuple(n for n in order if n in wanted)
    if not names:
        raise DataError(
            f"bag {bag.path}: no joint of {state.topic} moves and has an effort "
            f"({', '.join(state.names)}); name the topic of the efforts with --effort-topic"
        )
    asked = frozenset(order if chosen.joints else chosen.lock)
    if not known:
        robot = RobotSource(tip=chosen.tip)
        return _Chosen(names, robot, ("rad",) * len(names), {}, asked)
    held = {n: _held(state, n) for n in order if n in state.names and n not in names}
    text, locked = locked_urdf(urdf, names, {**held, **chosen.lock})
    units = tuple(j.unit for j in known if j.name in names)
    robot = RobotSource("", text, chosen.tip)
    return _Chosen(names, robot, units, locked, asked, not chosen.robot)


def _renamed(group: _Group, called: Mapping[str, str]) -> _Group:
    return replace(group, names=tuple(called.get(n, n) for n in group.names))


def _useful(state: _Group, effort: _Group, chosen: BagChoice) -> list[str]:
    return [
        n
        for n in state.names
        if n not in chosen.lock and _moves(state, n) and _driven((effort, ""), n)
    ]


def _held(state: _Group, name: str) -> float:
    q = state.parts["position"][:, state.names.index(name)]
    return float(np.nanmedian(q)) if np.isfinite(q).any() else 0.0


def _recording(
    bag: _Bag,
    arm: str,
    state: _Group,
    chosen: BagChoice,
    zero: Mapping[str, int],
    taken: Collection[str],
) -> Recording:
    """Recording of an arm; its time counts from the first joint state of the bag.

    Topics are `taken` by any arm; the others are told.
    """
    from hil.record.units import axes_unit

    effort, source = _effort(bag, state, chosen)
    known = [j.name for j in free_joints(urdf)] if (urdf := _urdf(bag, arm, chosen)) else []
    called = called_in(known, state.names, chosen.joints)
    state, effort = _renamed(state, called), _renamed(effort, called)
    chosen = replace(chosen, joints=tuple(called.get(n, n) for n in chosen.joints))
    what = _joints(bag, arm, state, effort, chosen)
    _refuse_names(bag, state, what)
    strange = _unknown(bag, state, effort, known)
    force = _force(bag, chosen)
    used = [g for g in (state, effort, force) if g is not None]
    clock = "header" if all(g.stamped for g in used) else "stamp"
    stamps, parts = state.on(clock)
    columns = [state.names.index(n) for n in what.names]
    q, qd = parts["position"][:, columns], parts["velocity"][:, columns]
    tau, good = _aligned(effort, "effort", clock, stamps, what.names)
    same = (effort.topic, effort.names) == (state.topic, state.names)
    if same:  # a message without its effort is left out, not bridged
        good &= np.isfinite(parts["effort"][:, columns]).all(axis=1)
    wrench = None
    if force is not None:
        wrench, present = _aligned(force, "wrench", clock, stamps, force.names)
        good &= present
        wrench, what = _in_base(force, wrench, what, q)
    good &= np.isfinite(q).all(axis=1)
    keep = np.flatnonzero(good)
    _refuse_short(bag, state, stamps[keep])
    has_speed = bool(np.isfinite(qd[keep]).all())
    note = f"{bag.path.name}: {_told(bag, state, source, force, what, clock, taken)}"
    note += _called_otherwise(what, called) + strange + _left_out(state, keep.size)
    turning = [k for k, unit in enumerate(what.units) if unit != "m"]
    found = Recording(
        name=bag.path.stem,
        arm=arm,
        joints=what.names,
        t=(stamps[keep] - zero[clock]).astype(np.float64) * 1e-9,
        q=q[keep],
        tau=tau[keep],
        qd=qd[keep] if has_speed else None,
        wrench=None if wrench is None else wrench[keep],
        robot=what.robot,
        metadata={
            "unit": axes_unit(what.units),
            "note": note,
            BAG: str(bag.path),
            **_began(state, stamps[keep[0]], clock),
            **_locked_note(what),
        },
    ).unwrapped(turning)
    if said := found.metadata.get(UNWRAPPED):
        found.metadata["note"] += f"; {said}"
    return found


def _refuse_names(bag: _Bag, state: _Group, what: _Chosen) -> None:
    """Refuse names of joints that no file gives back."""
    try:
        refuse_names(what.names)
    except DataError as error:
        raise DataError(f"bag {bag.path}, {state.topic}: {error}; record it again") from error


def _unknown(bag: _Bag, state: _Group, effort: _Group, known: Sequence[str]) -> str:
    """What is said of moving, driven joints that the URDF does not have.

    Raises
    ------
    DataError
        If one is spelt as a joint of the URDF that the bag lacks, but for case and signs: that
        would stand still.
    """
    lacks = [n for n in known if n not in state.names]
    strange = [n for n in state.names if n not in known and _moves(state, n)]
    strange = [n for n in strange if _driven((effort, ""), n)] if known else []
    near = {_letters(n): n for n in lacks}
    for name in strange:
        if _letters(name) in near:
            raise DataError(
                f"bag {bag.path}: {state.topic} has a joint {name}, which the URDF lacks, and the "
                f"URDF has {near[_letters(name)]}, which the topic lacks. Give them one name, in "
                "the URDF or in the bag"
            )
    return f"; not in the URDF, left out: {', '.join(strange)}" if strange else ""


def _letters(name: str) -> str:
    """A name without case and signs."""
    return "".join(x for x in name.lower() if x.isalnum())


def _called_otherwise(what: _Chosen, called: Mapping[str, str]) -> str:
    """What is said of a bag that calls the robot's joints otherwise."""
    if not called:
        return ""
    first = next(old for old, new in called.items() if new == what.names[0])
    return f"; the bag calls {what.names[0]} {first}, and so on"


def _left_out(state: _Group, kept: int) -> str:
    """What is said of messages that are no rows."""
    lost = len(state.stamp) - kept
    if not lost:
        return ""
    return (
        f"; {plural(lost, 'message')} of {len(state.stamp)} left out: repeated, without a number, "
        "or where the other topics have none"
    )


def _began(state: _Group, first: int, clock: str) -> dict[str, str]:
    """When the first sample was taken, where a stamp says it: its own, else that of reception.

    The own stamps of a simulated robot count from the start of the simulation.
    """
    from hil.record.units import epoch_unit

    received = int(state.stamp[np.argmax(state.header == first)]) if clock == "header" else first
    known = next((ns for ns in (int(first), int(received)) if epoch_unit(ns * 1e-9) == "s"), 0)
    return {BEGAN: f"{known * 1e-9:.3f}"} if known else {}


def _locked_note(what: _Chosen) -> dict[str, str]:
    """What a session keeps of the joints that are locked."""
    return {LOCKED: json.dumps(what.locked)} if what.locked else {}


def _in_base(
    force: _Group, wrench: FloatArray, what: _Chosen, q: FloatArray
) -> tuple[FloatArray, _Chosen]:
    """A wrench in axes of the base, and the robot with the sensor's frame as its tip."""
    urdf = what.robot.urdf
    axes = frame_axes(urdf, force.frame, what.names, q) if urdf and force.frame else None
    if axes is None:
        return wrench, what
    if what.robot.tip not in ("", force.frame):
        raise DataError(
            f"topic {force.topic} measures in frame {force.frame!r}, and the tip is to be "
            f"{what.robot.tip!r}; leave --tip out"
        )
    return in_base_axes(wrench, axes), replace(what, robot=RobotSource("", urdf, force.frame))


def _force(bag: _Bag, chosen: BagChoice) -> _Group | None:
    if not chosen.force_topic:
        return None
    found = [g for g in bag.groups if g.type == _WRENCH]
    for g in found:
        if g.topic == chosen.force_topic:
            return g
    have = {g.topic for g in found}
    raise ConfigError(f"bag {bag.path}: " + unknown("force topic", chosen.force_topic, have))


def _aligned(
    group: _Group, part: str, clock: str, at: Stamps, names: Sequence[str]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """A part of a group at some stamps (n, k), and where it was recorded, not beyond or in gaps.

    Linear between its own samples; a topic on the same stamps comes out as it is.
    """
    stamps, parts = group.on(clock)
    values = parts[part][:, [group.names.index(n) for n in names if n in group.names]]
    if values.shape[1] < len(names):
        lost = [n for n in names if n not in group.names]
        raise DataError(f"topic {group.topic} holds no {part} of {', '.join(lost)}")
    whole = np.isfinite(values).all(axis=1)
    stamps, values = stamps[whole], values[whole]
    if stamps.size < 2:
        raise DataError(f"topic {group.topic} holds {plural(stamps.size, 'message')} with {part}")
    zero = stamps[0]
    own, to = (stamps - zero).astype(float), (at - zero).astype(float)
    out = np.stack([np.interp(to, own, column) for column in values.T], axis=1)
    steps = np.diff(own)
    after = np.clip(np.searchsorted(own, to, side="left"), 1, own.size - 1)
    exact = own[np.clip(np.searchsorted(own, to), 0, own.size - 1)] == to
    near = steps[after - 1] <= GAP * np.median(steps)
    good = (to >= own[0]) & (to <= own[-1]) & (near | exact)
    return out, good


def _refuse_short(bag: _Bag, state: _Group, stamps: Stamps) -> None:
    if stamps.size < FEWEST:
        raise DataError(
            f"bag {bag.path}: {plural(stamps.size, 'sample')} of {state.topic} have positions and "
            f"efforts; at least {FEWEST} are needed"
        )
    period = float(np.median(np.diff(stamps))) * 1e-9
    if period > LONGEST_PERIOD:
        raise DataError(
            f"bag {bag.path}: {state.topic} has a message every {period:.3g} s; too slow for "
            f"dynamics, at least {1 / LONGEST_PERIOD:g} Hz are needed"
        )


def _told(
    bag: _Bag,
    state: _Group,
    source: str,
    force: _Group | None,
    what: _Chosen,
    clock: str,
    taken: Collection[str],
) -> str:
    """What was taken of a bag, as one sentence."""
    said = f"positions of {state.topic}, efforts of {source}"
    if force is not None:
        known = bool(force.frame) and what.robot.tip == force.frame
        axes = f"the axes of {force.frame}" if known else "the axes of the base"
        said += f", force on the robot of {force.topic} in {axes}"
    said += f", joints {', '.join(what.names)}"
    said += "; robot: the description in the bag" if what.own else ""
    if what.locked:
        places = ", ".join(f"{n} at {v:.4g}" for n, v in what.locked.items())
        said += f"; locked: {places}"
        moved = [n for n in what.locked if n in state.names and _moves(state, n)]
        for some, why in (
            ([n for n in moved if n in what.asked], "moved"),
            ([n for n in moved if n not in what.asked], "moved without an effort that changes"),
        ):
            said += f"; of these {', '.join(some)} {why}" if some else ""
    elif left := [n for n in state.names if n not in what.names]:
        why = "" if what.asked else " (without motion or effort)"
        said += f"; left out: {', '.join(left)}{why}"
    used = {*taken, force.topic if force else ""}
    rest = sorted({g.topic for g in bag.groups} - used)
    said += f"; not used: {', '.join(rest)}" if rest else ""
    return said if clock == "header" else f"{said}; times of reception (not all have stamps)"
