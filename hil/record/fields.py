"""Any channel of numbers by its topic, e.g. ``/loop/timing``, ``/rig/raw`` or ``/extras``."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError, unknown
from hil.record.container import Topic, read
from hil.record.decode import decode_joint_state, decode_numbers

FloatArray = NDArray[np.float64]
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
            for part, values in parts.items() if values is not None
            for k, name in enumerate(names)
        }  # fmt: skip
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
