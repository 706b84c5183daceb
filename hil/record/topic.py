"""One channel's messages: columns of numbers, and payloads that stay where they were read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

#: Channel, sequence number, start and size of the payload; log time [ns].
Row = tuple[int, int, int, int]
#: Columns of `Row`.
CHANNEL, SEQUENCE, START, SIZE = range(4)
#: Messages that one call of the compiled walk may find.
AT_ONCE = 4096


def _none() -> NDArray[np.int64]:
    return np.zeros(0, np.int64)


@dataclass(eq=False)
class Topic:
    """One channel's messages.

    Parameters
    ----------
    name, schema, encoding : str
        Topic, schema name, message encoding.
    schema_encoding, schema_text : str, bytes
        The schema as it stands in the file.
    stamps : ndarray of uint64 (n,)
        Log times [ns].
    ticks : ndarray of int64 (n,)
        Sequence numbers.
    starts, sizes : ndarray of int64 (n,)
        Where each payload lies in `raw`.
    raw : bytearray
        Payloads of all channels, and what lies between them.
    """

    name: str
    schema: str
    encoding: str
    schema_encoding: str = ""
    schema_text: bytes = b""
    stamps: NDArray[np.uint64] = field(default_factory=lambda: np.zeros(0, np.uint64), repr=False)
    ticks: NDArray[np.int64] = field(default_factory=_none, repr=False)
    starts: NDArray[np.int64] = field(default_factory=_none, repr=False)
    sizes: NDArray[np.int64] = field(default_factory=_none, repr=False)
    raw: bytearray = field(default_factory=bytearray, repr=False)

    def __len__(self) -> int:
        return int(self.stamps.size)

    @cached_property
    def times(self) -> list[int]:
        """Log time of each message [ns]."""
        return [int(t) for t in self.stamps.tolist()]

    @cached_property
    def sequence(self) -> list[int]:
        """Sequence number of each message."""
        return [int(k) for k in self.ticks.tolist()]

    @cached_property
    def data(self) -> list[bytes]:
        """Payloads."""
        return [self.payload(k) for k in range(len(self))]

    def payload(self, k: int) -> bytes:
        """Payload of message number k."""
        start = int(self.starts[k])
        return bytes(self.raw[start : start + int(self.sizes[k])])

    def cut(self, start: int, size: int) -> NDArray[np.uint8]:
        """The same `size` bytes of every payload from byte `start` on, (n, size)."""
        first = self.starts + start
        if not len(self) or np.any(start + size > self.sizes):
            raise IndexError(f"topic {self.name}: a message ends before byte {start + size}")
        # every byte begins a slice here; only those asked for are copied
        windows = np.ndarray(
            (len(self.raw) - size + 1,), dtype=f"V{size}", buffer=self.raw, strides=(1,)
        )
        return windows[first].view(np.uint8).reshape(len(self), size)

    def only(self, keep: NDArray[np.bool_]) -> Topic:
        """The messages that `keep` (n,) marks."""
        return replace(
            self, stamps=self.stamps[keep], ticks=self.ticks[keep], starts=self.starts[keep],
            sizes=self.sizes[keep],
        )  # fmt: skip


class Found:
    """Messages of all channels in the order in which they are read.

    Parameters
    ----------
    large : bool
        Whether there are so many that a compiled walk is worth its import.
    """

    def __init__(self, large: bool) -> None:
        self.known = np.zeros(2**16, dtype=np.bool_)
        self._large, self._raw = large, bytearray()
        self._where: list[NDArray[np.int64]] = []
        self._stamps: list[NDArray[np.uint64]] = []
        self._rows: list[Row] = []
        self._times: list[int] = []

    def add(self, data: bytes) -> int:
        """Keep the bytes of a chunk; where they begin among all of them."""
        self._raw += data
        return len(self._raw) - len(data)

    def note(self, channel: int, sequence: int, stamp: int, start: int, size: int) -> None:
        """One message."""
        self._rows.append((channel, sequence, start, size))
        self._times.append(stamp)

    def walk(self, data: bytes, at: int, base: int) -> int:
        """Note messages from byte `at` of a chunk on, as far as it is quick; where that ends."""
        if not self._large:
            return at
        from hil.record.walk import messages

        count = AT_ONCE
        raw = np.frombuffer(data, np.uint8)
        while count == AT_ONCE:
            where, stamps = np.empty((AT_ONCE, 4), np.int64), np.empty(AT_ONCE, np.uint64)
            count, at = messages(raw, at, self.known, where, stamps)
            if count:
                self._flush()
                where[:count, START] += base
                self._where.append(where[:count].copy())
                self._stamps.append(stamps[:count].copy())
        return at

    def _flush(self) -> None:
        if self._rows:
            self._where.append(np.array(self._rows, np.int64))
            self._stamps.append(np.array(self._times, np.uint64))
            self._rows, self._times = [], []

    def hand_out(self, channels: dict[int, Topic]) -> None:
        """Give every topic its messages."""
        self._flush()
        if not self._where:
            return
        where, stamps = np.concatenate(self._where), np.concatenate(self._stamps)
        for topic in {id(t): t for t in channels.values()}.values():
            numbers = [number for number, other in channels.items() if other is topic]
            own = np.isin(where[:, CHANNEL], numbers)
            topic.stamps, topic.raw = stamps[own], self._raw
            topic.ticks, topic.starts, topic.sizes = where[own, 1:].T.copy()
