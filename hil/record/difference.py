"""The first message in which two sessions differ, named down to the number."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hil.errors import DataError
from hil.record.container import Container, Topic, read
from hil.record.schema import numbers
from hil.userfile import LARGEST, read_bytes


@dataclass(frozen=True)
class Difference:
    """Where two sessions part.

    Parameters
    ----------
    where : str
        Topic and field, or what of the file.
    tick : int
        First tick that differs; -1 where no message does.
    first, second : str
        What stands in the one and in the other.
    """

    where: str
    tick: int
    first: str
    second: str

    def __str__(self) -> str:
        at = f"tick {self.tick}, " if self.tick >= 0 else ""
        return f"{at}{self.where}: {self.first} and {self.second}"


def first_difference(first: str | Path, second: str | Path) -> Difference | None:
    """Earliest difference of two sessions; None where their bytes are the same.

    Parameters
    ----------
    first, second : str or Path
        Sessions.

    Raises
    ------
    DataError
        If one of them is not a session.
    """
    a, b = read(first), read(second)
    if _bytes(first) == _bytes(second):
        return None
    found = [_topic(a, b, name) for name in {**a.topics, **b.topics}]
    real = [d for d in found if d is not None]
    if real:
        return min(real, key=lambda d: d.tick)
    return _beside(a, b) or Difference("bytes of the container", -1, "one", "another order or size")


def _bytes(path: str | Path) -> bytes:
    return read_bytes(path, LARGEST)


def _topic(a: Container, b: Container, name: str) -> Difference | None:
    """First message of a topic that differs."""
    if name not in a.topics or name not in b.topics:
        here = "there" if name in a.topics else "missing"
        return Difference(name, -1, here, "missing" if here == "there" else "there")
    one, other = a.topics[name], b.topics[name]
    for k, (x, y) in enumerate(zip(one.data, other.data, strict=False)):
        if x != y or one.times[k] != other.times[k]:
            return _field(one, other, k)
    n, m = len(one.data), len(other.data)
    if n != m:
        last = (one if n > m else other).sequence[min(n, m)]
        return Difference(f"{name}, number of messages", last, str(n), str(m))
    return None


def _field(one: Topic, other: Topic, k: int) -> Difference:
    """The number within message `k` that differs."""
    if one.times[k] != other.times[k]:
        return Difference(
            f"{one.name}, time [ns]", one.sequence[k], str(one.times[k]), str(other.times[k])
        )
    try:
        x, y = numbers(one), numbers(other)
    except DataError:
        x = y = {}
    for name in x:
        if name in y and x[name][k] != y[name][k]:
            return Difference(
                f"{one.name} {name}",
                one.sequence[k],
                repr(float(x[name][k])),
                repr(float(y[name][k])),
            )
    return Difference(one.name, one.sequence[k], one.data[k][:60].hex(), other.data[k][:60].hex())


def _beside(a: Container, b: Container) -> Difference | None:
    """Metadata and attachments that differ."""
    for name in {**a.metadata, **b.metadata}:
        x, y = a.metadata.get(name, {}), b.metadata.get(name, {})
        for key in {**x, **y}:
            if x.get(key) != y.get(key):
                return Difference(f"metadata {name}.{key}", -1, repr(x.get(key)), repr(y.get(key)))
    for name in {**a.attachments, **b.attachments}:
        if a.attachments.get(name) != b.attachments.get(name):
            return Difference(f"attachment {name}", -1, "one", "another")
    return None
