"""From the payloads of a channel to arrays: the layout is read once, the numbers all at once.

Any channel of numbers by its topic, e.g. ``/loop/timing``, ``/rig/raw`` or ``/extras``.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError, unknown
from hil.record.container import Topic, read
from hil.record.schema import PARTS

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
