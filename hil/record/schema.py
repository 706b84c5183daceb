"""Channels of a session and their encoding, ROS 2 CDR: one `struct.pack` a message, and back.

Joint names, field names and frames are constant within a session, so every message of a
channel has the same layout: constant bytes with numbers in between.  On the way back to arrays
that layout is read once, and the numbers all at once.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError, unknown
from hil.record.container import Topic, read

_TIME = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_RULE = "=" * 80 + "\n"
JOINT_STATE = (
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
    f"float64[] effort\n{_RULE}MSG: std_msgs/Header\n{_HEADER}"
    f"{_RULE}MSG: builtin_interfaces/Time\n{_TIME}"
)
WRENCH = (
    f"std_msgs/Header header\ngeometry_msgs/Wrench wrench\n{_RULE}MSG: geometry_msgs/Wrench\n"
    f"Vector3 force\nVector3 torque\n{_RULE}MSG: geometry_msgs/Vector3\n"
    f"float64 x\nfloat64 y\nfloat64 z\n{_RULE}MSG: std_msgs/Header\n{_HEADER}"
    f"{_RULE}MSG: builtin_interfaces/Time\n{_TIME}"
)
EVENT_SCHEMA = (
    '{"type": "object", "properties": {"tick": {"type": "integer"}, "name": {"type": "string"}, '
    '"data": {"type": "object"}}, "required": ["tick", "name"]}'
)
#: Library that the header of a session names.
LIBRARY = "hil"
#: First bytes of an MCAP file.
MAGIC = b"\x89MCAP0\r\n"
PARTS = ("position", "velocity", "effort")
#: Stamps [s] from here on do not fit into a ROS 2 message.
LAST_S = 2**31
MESSAGE_KINDS = ("joint_state", "wrench", "fields")
#: What every ROS 2 tool accepts; a decoder refuses the whole channel otherwise.
FIELD = re.compile(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class Channel:
    """One topic.

    Parameters
    ----------
    topic : str
        CRTK name under the arm, e.g. ``/leader/measured_js``.
    kind : str
        ``"joint_state"``, ``"wrench"`` or ``"fields"`` (own message of named float64).
    names : tuple of str
        Joint names, or field names; unused for a wrench.
    parts : tuple of str
        Which of position, velocity, effort a joint state holds, in this order.
    units : tuple of str
        Units of the fields, one a field.
    frame : str
        Frame of the header.
    message : str
        Message name of a ``fields`` channel, e.g. ``hil_msgs/msg/LoopTiming``.

    Raises
    ------
    ConfigError
        For an unknown kind, no names, names that stand twice or that no ROS 2 message can
        hold, parts out of order, or another number of units than fields.
    """

    topic: str
    kind: str
    names: tuple[str, ...] = ()
    parts: tuple[str, ...] = PARTS
    units: tuple[str, ...] = ()
    frame: str = ""
    message: str = ""

    def __post_init__(self) -> None:
        if fault := self._fault():
            raise ConfigError(f"channel {self.topic}: {fault}")

    def _fault(self) -> str:
        if self.kind not in MESSAGE_KINDS:
            return unknown("kind", self.kind, MESSAGE_KINDS)
        if self.kind == "wrench":
            return ""
        if not self.names or len(set(self.names)) < len(self.names):
            return f"names are {self.names}; expected at least one, each once"
        if self.kind == "joint_state":
            inorder = tuple(p for p in PARTS if p in self.parts) == tuple(self.parts)
            text = f"parts are {self.parts}; expected some of {PARTS}, in this order"
            return "" if inorder and self.parts else text
        bad = [n for n in self.names if not FIELD.fullmatch(n)]
        if bad:
            return f"field {bad[0]!r}; expected small letters, digits and single _ between them"
        wrong = self.units and len(self.units) != len(self.names)
        return f"{len(self.units)} units for {len(self.names)} fields" if wrong else ""

    @property
    def width(self) -> int:
        """Numbers a message holds."""
        if self.kind == "joint_state":
            return len(self.names) * len(self.parts)
        return 6 if self.kind == "wrench" else len(self.names)

    def schema(self) -> tuple[str, str]:
        """Schema name and `ros2msg` text."""
        if self.kind == "joint_state":
            return "sensor_msgs/msg/JointState", JOINT_STATE
        if self.kind == "wrench":
            return "geometry_msgs/msg/WrenchStamped", WRENCH
        units = self.units or ("",) * len(self.names)
        lines = [
            f"float64 {name}  # [{unit}]\n" for name, unit in zip(self.names, units, strict=True)
        ]
        text = f"builtin_interfaces/Time stamp\n{''.join(lines)}{_RULE}"
        return self.message or "hil_msgs/msg/Fields", (
            f"{text}MSG: builtin_interfaces/Time\n{_TIME}"
        )


class _Layout:
    """Struct format under construction; CDR aligns relative to the end of its header."""

    def __init__(self) -> None:
        self.format, self.size, self.constants = "<4s", 0, [b"\x00\x01\x00\x00"]

    def _align(self, to: int) -> None:
        pad = -self.size % to
        self.format += f"{pad}x" if pad else ""
        self.size += pad

    def stamp(self) -> None:
        self.format += "iI"
        self.size += 8

    def constant(self, data: bytes, align: int) -> None:
        self._align(align)
        self.format += f"{len(data)}s"
        self.size += len(data)
        self.constants.append(data)

    def text(self, value: str) -> None:
        raw = value.encode() + b"\x00"
        self.constant(struct.pack("<I", len(raw)) + raw, 4)

    def count(self, n: int) -> None:
        self.constant(struct.pack("<I", n), 4)

    def doubles(self, n: int) -> None:
        if n:
            self._align(8)
            self.format += f"{n}d"
            self.size += 8 * n


def encoder(channel: Channel) -> Callable[[int, Sequence[float]], bytes]:
    """Encoder of a channel: (t_ns, values) to bytes.

    Values are, for a joint state, its parts one after the other; for a wrench force then
    torque; else the fields.
    """
    return _packer(_layout(channel))


def places(channel: Channel) -> list[int]:
    """Byte of an encoded message at which each value stands."""
    at, found = 0, []
    for count, kind in re.findall(r"(\d*)([sxdiI])", _layout(channel).format):
        n = int(count or 1)
        found += [at + 8 * k for k in range(n)] if kind == "d" else []
        at += n * {"d": 8, "i": 4, "I": 4}.get(kind, 1)
    return found


def _layout(channel: Channel) -> _Layout:
    layout = _Layout()
    layout.stamp()
    n = len(channel.names)
    if channel.kind in ("joint_state", "wrench"):
        layout.text(channel.frame)
    if channel.kind == "joint_state":
        layout.count(n)
        for name in channel.names:
            layout.text(name)
        for part in PARTS:
            held = n if part in channel.parts else 0
            layout.count(held)
            layout.doubles(held)
    else:
        layout.doubles(channel.width)
    return layout


def _packer(layout: _Layout) -> Callable[[int, Sequence[float]], bytes]:
    """One pack for the numbers; the constant bytes, which never overlap them, are or-ed in."""
    text, constants = layout.format.removeprefix("<4siI"), iter(layout.constants[1:])
    numbers, fixed = "<4xiI", bytearray(layout.constants[0] + bytes(8))
    for count, kind in re.findall(r"(\d+)([sxd])", text):
        numbers += f"{count}{'d' if kind == 'd' else 'x'}"
        size = int(count) * (8 if kind == "d" else 1)
        fixed += next(constants) if kind == "s" else bytes(size)
    pack, size, mask = struct.Struct(numbers).pack, len(fixed), int.from_bytes(fixed, "little")

    def encode(t_ns: int, values: Sequence[float]) -> bytes:
        raw = pack(t_ns // 1_000_000_000, t_ns % 1_000_000_000, *values)
        return (int.from_bytes(raw, "little") | mask).to_bytes(size, "little")

    return encode


FloatArray = NDArray[np.float64]


def decode(topic: Topic, joints: tuple[str, ...]) -> FloatArray:
    """Numbers of a channel, shape (n, columns).

    Parameters
    ----------
    topic : Topic
        A JointState (its effort, in the order of `joints`), a WrenchStamped (force, torque), or
        fields, one a joint.
    joints : tuple of str
        Joints of the arm.

    Raises
    ------
    DataError
        If the messages are of another encoding, or of other joints.
    """
    if topic.schema.endswith("/JointState"):
        names, parts = decode_joint_state(topic)
        return _ordered(topic, parts["effort"], names, joints)
    values = decode_numbers(topic)
    return values if _is_wrench(topic) else _ordered(topic, values, (), joints)


def decode_numbers(topic: Topic) -> FloatArray:
    """Numbers of a WrenchStamped (n, 6), or of a stamped message of float64 fields (n, k).

    Raises
    ------
    DataError
        If the messages are of another encoding, or differ in size.
    """
    _refuse_encoding(topic)
    if _is_wrench(topic):
        (n,) = struct.unpack_from("<I", topic.payload(0), 12)
        return _numbers(topic, 4 + -(-(12 + n) // 8) * 8, 6)
    return _numbers(topic, 12, (int(topic.sizes[0]) - 12) // 8)


def _is_wrench(topic: Topic) -> bool:
    return topic.schema.endswith("/WrenchStamped")


def _ordered(
    topic: Topic, values: FloatArray | None, names: tuple[str, ...], joints: tuple[str, ...]
) -> FloatArray:
    if values is None or values.shape[1] != len(joints) or (names and set(names) != set(joints)):
        found = "no numbers" if values is None else f"{values.shape[1]} numbers a message"
        of = f" of {', '.join(names)}" if names else ""
        raise DataError(f"topic {topic.name} has {found}{of}; expected one each of {joints}")
    return values[:, [names.index(j) for j in joints]] if names else values


def decode_joint_state(
    topic: Topic,
) -> tuple[tuple[str, ...], dict[str, FloatArray | None]]:
    """Joint names and the parts (n, d) of a JointState topic; absent parts are None.

    Raises
    ------
    DataError
        If the messages are of another type or encoding, or differ in size.
    """
    _refuse_encoding(topic)
    if not topic.schema.endswith("/JointState"):
        raise DataError(
            f"topic {topic.name} is of type {topic.schema!r}; expected sensor_msgs/msg/JointState"
        )
    data = topic.payload(0)
    _, at = _string(data, 8)
    count, at = _count(data, at)
    names = []
    for _ in range(count):
        name, at = _string(data, at)
        names.append(name)
    parts: dict[str, FloatArray | None] = {}
    for part in PARTS:
        n, at = _count(data, at)
        at += -at % 8 if n else 0
        parts[part] = _numbers(topic, at + 4, n) if n else None
        at += 8 * n
    return tuple(names), parts


def _refuse_encoding(topic: Topic) -> None:
    if topic.encoding != "cdr" or topic.payload(0)[:2] != b"\x00\x01":
        raise DataError(
            f"topic {topic.name} is encoded as {topic.encoding!r}; "
            "expected ROS 2 CDR, little endian"
        )


def _count(data: bytes, at: int) -> tuple[int, int]:
    """Length at `at`, counted from the end of the CDR header, and where it ends."""
    at += -at % 4
    (n,) = struct.unpack_from("<I", data, at + 4)
    return n, at + 4


def _string(data: bytes, at: int) -> tuple[str, int]:
    n, at = _count(data, at)
    return data[at + 4 : at + 4 + n - 1].decode(), at + n


def _numbers(topic: Topic, start: int, count: int) -> FloatArray:
    """`count` doubles at byte `start` of every message, shape (n, count)."""
    if count <= 0:
        return np.zeros((len(topic), 0))
    size = int(topic.sizes[0])
    if np.any(topic.sizes != size):
        raise DataError(f"topic {topic.name}: messages of different sizes; expected one layout")
    if start + 8 * count > size:
        raise DataError(f"topic {topic.name}: a message ends before its numbers")
    return topic.cut(start, 8 * count).view("<f8").astype(np.float64)


_WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")


def read_fields(path: str | Path, topic: str) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Time and every field of a channel.

    Parameters
    ----------
    path : str or Path
        Session.
    topic : str
        E.g. ``/loop/timing``.

    Returns
    -------
    t : ndarray (n,)
        Log time [s], from the first stamp of the session on where that counts from 1970.
    fields : dict of str to ndarray (n,)
        By the name in the schema, whose comments give the units; of a joint state
        ``position.<joint>`` and so on, of a wrench fx to tz.

    Raises
    ------
    DataError
        If the session has no such topic, or it does not hold numbers.
    """
    box = read(path)
    if topic not in box.topics:
        raise DataError(f"session {path}: " + unknown("topic", topic, box.topics))
    channel = box.topics[topic]
    t = box.seconds(channel)
    if not len(channel):
        raise DataError(f"session {path}: topic {topic} has no messages")
    try:
        return t, numbers(channel)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise DataError(f"session {path}: topic {topic} cannot be decoded: {error}") from error


def numbers(channel: Topic) -> dict[str, FloatArray]:
    """Every field of a topic, by the names that `read_fields` gives, shape (n,) each.

    Raises
    ------
    DataError
        If it does not hold numbers.
    """
    if channel.schema.endswith("/JointState"):
        names, parts = decode_joint_state(channel)
        return {
            f"{part}.{name}": values[:, k]
            for part, values in parts.items()
            if values is not None
            for k, name in enumerate(names)
        }
    values = decode_numbers(channel)
    names = _WRENCH
    if not channel.schema.endswith("/WrenchStamped"):
        body = channel.schema_text.decode().split("\n====")[0]
        names = tuple(re.findall(r"^float64 (\w+)", body, re.M))
    if values.shape[1] != len(names):
        raise DataError(
            f"topic {channel.name}: type {channel.schema!r} is not one of named float64"
        )
    return dict(zip(names, values.T, strict=True))


def written_by(path: str | Path) -> str | None:
    """Library that the header of an MCAP file names; None where it is no such file."""
    with Path(path).open("rb") as file:
        head = file.read(256)
    if not head.startswith(MAGIC) or len(head) < 21:
        return None
    data, found = head[17:], ""
    for _ in ("profile", "library"):
        size = int.from_bytes(data[:4], "little")
        found, data = data[4 : 4 + size].decode("utf-8", "replace"), data[4 + size :]
    return found
