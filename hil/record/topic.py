"""One channel's messages: columns of numbers, and payloads that stay where they were read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


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
        out: list[int] = self.stamps.tolist()
        return out

    @cached_property
    def sequence(self) -> list[int]:
        """Sequence number of each message."""
        out: list[int] = self.ticks.tolist()
        return out

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
