"""Messages of all channels as they are read, until every topic gets its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.record.topic import Topic

#: Channel, sequence number, start and size of the payload.
Row = tuple[int, int, int, int]
CHANNEL, START = 0, 2
#: Messages that one call of the compiled walk may find.
AT_ONCE = 4096


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
        self._buffers = np.empty((AT_ONCE, 4), np.int64), np.empty(AT_ONCE, np.uint64)
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

        raw, (where, stamps), count = np.frombuffer(data, np.uint8), self._buffers, AT_ONCE
        while count == AT_ONCE:
            count, at = messages(raw, at, self.known, where, stamps)
            if count:
                self._flush()
                own = where[:count].copy()
                own[:, START] += base
                self._where.append(own)
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
        topics = list({id(t): t for t in channels.values()}.values())
        place = np.zeros(self.known.size, np.int64)
        order = {id(t): k for k, t in enumerate(topics)}
        place[list(channels)] = [order[id(t)] for t in channels.values()]
        which = place[where[:, CHANNEL]]
        for k, topic in enumerate(topics):
            own = which == k
            topic.stamps, topic.raw = stamps[own], self._raw
            topic.ticks, topic.starts, topic.sizes = where[own, 1:].T.copy()
