"""Messages of a ROS bag as arrays, by the library rosbags.

It runs in the process of `hil.record.binary_tables`, which limits memory and time.  What comes out,
as of any file of arrays: ``about``, the bytes of a JSON text with the groups of messages, the robot
descriptions and the topics that nothing reads; and for each group a struct of its arrays.  A group
is what one topic says of one set of joints: two publishers on one topic, as of an arm and its
gripper, are two groups.
"""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import DataError

#: Messages of a bag that are looked at.
MOST_MESSAGES = 50_000_000
_POINT = """
trajectory_msgs/JointTrajectoryPoint {0}"""
_OLD = ("desired", "actual", "error")
_NEW = ("reference", "feedback", "error", "output")
_TRAJECTORY = "control_msgs/msg/JointTrajectoryControllerState"
#: Definitions of control_msgs, which no bag of SQLite before Iron carries: the newest first.
_DEFINITIONS = tuple(
    "std_msgs/Header header\nstring[] joint_names"
    + "".join(_POINT.format(part) for part in parts)
    + more
    for parts, more in (
        (
            _NEW,
            "\nstring[] multi_dof_joint_names"
            + "".join(f"\ntrajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_{p}" for p in _NEW)
            + "\nfloat64 speed_scaling_factor",
        ),
        (
            _NEW,
            "\nstring[] multi_dof_joint_names"
            + "".join(
                f"\ntrajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_{p}" for p in _NEW
            ),
        ),
        (_OLD, ""),
    )
)


@dataclass
class _Group:
    """Messages of one topic about one set of joints; numbers as they come, a row a message."""

    topic: str
    type: str
    names: tuple[str, ...]
    frame: str
    parts: tuple[str, ...]
    stamp: array[int] = field(default_factory=lambda: array("q"))
    header: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def arrays(self) -> Iterator[tuple[str, np.ndarray]]:
        """Stamps and parts, each (n,) or (n, d)."""
        yield "stamp", np.frombuffer(self.stamp, np.int64)
        yield "header", np.frombuffer(self.header, np.int64)
        d = len(self.names)
        block = np.frombuffer(self.values, np.float64).reshape(-1, len(self.parts), d)
        for k, part in enumerate(self.parts):
            yield part, block[:, k]


#: Names, frame and the parts of one message.
_Row = tuple[Sequence[str], str, Sequence[Sequence[float]]]


def _joint_state(m: Any) -> _Row:
    return m.name, "", (m.position, m.velocity, m.effort)


def _trajectory(m: Any) -> _Row:
    """State of a trajectory controller: its output as the effort, where it has one."""
    seen = m.feedback if hasattr(m, "feedback") else m.actual
    output = getattr(m, "output", None)
    effort = output.effort if output is not None and len(output.effort) else seen.effort
    return m.joint_names, "", (seen.positions, seen.velocities, effort)


def _wrench(m: Any) -> _Row:
    f, t = m.wrench.force, m.wrench.torque
    values = (f.x, f.y, f.z, t.x, t.y, t.z)
    return ("fx", "fy", "fz", "tx", "ty", "tz"), m.header.frame_id, (values,)


def _numbers(m: Any) -> _Row:
    return tuple(str(k + 1) for k in range(len(m.data))), "", (m.data,)


_STATE = ("position", "velocity", "effort")
_READ: dict[str, tuple[tuple[str, ...], Callable[[Any], _Row]]] = {
    "sensor_msgs/msg/JointState": (_STATE, _joint_state),
    _TRAJECTORY: (_STATE, _trajectory),
    "geometry_msgs/msg/WrenchStamped": (("wrench",), _wrench),
    "std_msgs/msg/Float64MultiArray": (("effort",), _numbers),
}
_TEXT = "std_msgs/msg/String"


def messages(path: str, most: int) -> Iterator[tuple[str, str | None, np.ndarray]]:
    """Arrays of a bag by name and field, see the head of this file.

    Parameters
    ----------
    path : str
        ROS 1 bag, ROS 2 folder with ``metadata.yaml``, or one file of it (MCAP, SQLite).
    most : int
        Bytes that the arrays may take.

    Raises
    ------
    DataError
        If it holds more than that.
    """
    bag = _Bag(path)
    groups: dict[tuple[str, ...], _Group] = {}
    texts: dict[str, str] = {}
    unnamed: dict[str, Sequence[str]] = {}
    size = 0
    with bag.reader as reader:
        known = [c for c in reader.connections if c.msgtype in _READ or _is_description(c)]
        others = {c.topic: c.msgtype for c in reader.connections if c not in known}
        for seen, (connection, stamp, raw) in enumerate(reader.messages(known) if known else ()):
            message = bag.decode(connection, raw)
            if connection.msgtype == _TEXT:
                texts[connection.topic] = message.data
                continue
            held = _READ[connection.msgtype][1](message)
            if len(set(held[0])) < len(held[0]) or not held[0]:
                unnamed.setdefault(connection.topic, list(held[0]))
                continue
            size += _take(groups, connection, stamp, message, held)
            if size > most or seen >= MOST_MESSAGES:
                raise DataError(f"holds more than {most >> 20} MiB of joint states; split it")
    about = {
        "groups": [
            {"topic": g.topic, "type": g.type, "names": g.names, "frame": g.frame}
            for g in groups.values()
        ],
        "texts": texts,
        "others": others,
        "unnamed": unnamed,
    }
    yield "about", None, np.frombuffer(json.dumps(about).encode(), np.uint8)
    for k, g in enumerate(groups.values()):
        for name, values in g.arrays():
            yield str(k), name, values


def _is_description(connection: Any) -> bool:
    topic: str = connection.topic
    return connection.msgtype == _TEXT and topic.endswith("robot_description")


def _take(
    groups: dict[tuple[str, ...], _Group], connection: Any, stamp: int, message: Any, held: _Row
) -> int:
    """Add a message to its group; how many bytes that takes."""
    (parts, _), (names, frame, values) = _READ[connection.msgtype], held
    key = (connection.topic, frame, *sorted(names))
    group = groups.get(key)
    if group is None:
        group = _Group(connection.topic, connection.msgtype, tuple(names), frame, parts)
        groups[key] = group
    group.stamp.append(stamp)
    header = getattr(message, "header", None)
    group.header.append(-1 if header is None else _nanoseconds(header.stamp))
    moved = tuple(names) != group.names
    for part in values:
        row = list(map(float, part)) if len(part) == len(names) else [math.nan] * len(names)
        if moved:  # the same joints in another order
            row = [row[list(names).index(n)] for n in group.names]
        group.values.extend(row)
    return 16 + 8 * len(parts) * len(names)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


class _Bag:
    """A bag of any generation, and the types of its messages."""

    def __init__(self, path: str) -> None:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
        from rosbags.typesys import Stores, get_typestore

        self._first = path.lower().endswith(".bag") and Path(path).is_file()
        self.reader: Any = Reader1(Path(path)) if self._first else Reader2(Path(path))
        self._plain = get_typestore(Stores.ROS1_NOETIC if self._first else Stores.ROS2_HUMBLE)
        self._stores: dict[int, Any] = {}

    def decode(self, connection: Any, raw: bytes) -> Any:
        """The message of a connection."""
        store = self._stores.get(connection.id)
        if store is None:
            store = self._stores[connection.id] = self._types(connection, raw)
        return self._message(store, connection.msgtype, raw)

    def _message(self, store: Any, kind: str, raw: bytes) -> Any:
        return (store.deserialize_ros1 if self._first else store.deserialize_cdr)(raw, kind)

    def _types(self, connection: Any, raw: bytes) -> Any:
        """Types by the definition that a connection carries, else by those of the distributions."""
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

        definition, kind = connection.msgdef, connection.msgtype
        if definition.format != MessageDefinitionFormat.NONE:
            store = get_typestore(Stores.EMPTY)
            if definition.format == MessageDefinitionFormat.MSG:
                store.register(get_types_from_msg(definition.data, kind))
            else:
                store.register(get_types_from_idl(definition.data))
            return store
        if kind != _TRAJECTORY:
            return self._plain
        for text in _DEFINITIONS:
            store = get_typestore(Stores.ROS2_HUMBLE)
            store.register(get_types_from_msg(text, kind))
            try:
                self._message(store, kind, raw)
            except Exception:  # of another version; where none fits, that is said below
                continue
            return store
        raise DataError(f"holds {kind} of an unknown version; record it as MCAP, with definitions")


def prepare() -> None:
    """Load the library before memory is limited.

    Raises
    ------
    DataError
        If it is not installed.
    """
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2
        import rosbags.typesys  # noqa: F401
    except ImportError:
        raise DataError(
            "is a ROS bag, which needs the library rosbags: pip install 'hil-teleop[bags]'"
        ) from None
