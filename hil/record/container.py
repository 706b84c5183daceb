"""Reads the records of an MCAP file in one pass, whole or cut off anywhere.

The file is walked record by record and chunk by chunk; what a killed writer left is read up
to the last complete chunk.  Payloads stay bytes: decoding is done a channel at a time.

One channel's messages: columns of numbers, and payloads that stay where they were read.

Messages of all channels as they are read, until every topic gets its own.

Where the messages of a chunk lie: a compiled walk, for files that are worth its import.
"""

from __future__ import annotations

import struct
import sys
import zlib
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numba
import numpy as np
import zstandard
from numpy.typing import NDArray

from hil.errors import DataError
from hil.userfile import read_bytes


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
            self,
            stamps=self.stamps[keep],
            ticks=self.ticks[keep],
            starts=self.starts[keep],
            sizes=self.sizes[keep],
        )


#: Channel, sequence number, start and size of the payload.
Row = tuple[int, int, int, int]
CHANNEL, START = 0, 2
#: Messages that one call of the compiled walk may find.
AT_ONCE = 4096


class Messages:
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
        from hil.record.container import messages

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


__all__ = ["Container", "Topic", "read"]

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_SCHEMA, _CHANNEL, _MSG, _CHUNK, _ATTACHMENT, _METADATA, _DATA_END = 3, 4, 5, 6, 9, 12, 15
_UNREADABLE = (struct.error, zstandard.ZstdError, UnicodeDecodeError, KeyError)
#: From this size on [byte] the compiled walk is worth the import of the compiler, where nothing
#: else has needed that.
_LARGE = 2**24
#: No writer makes chunks so large [byte]; a damaged length must not claim the memory.
_LARGEST_CHUNK = 2**28
#: All chunks together may unpack to so many bytes, and to so many times the file.
_ROOM, _RATIO = 2**28, 256
#: Times from here on (1973) count from 1970, not from the start of a session [ns].
EPOCH_NS = 10**17


@dataclass
class Container:
    """Everything in a file.

    Parameters
    ----------
    path : Path
        The file.
    topics, metadata, attachments : mapping
        By name, in file order.
    truncated : bool
        Whether the writer did not finish.
    size, unread : int
        Bytes there are, and bytes at the end that no complete record holds.
    damaged : int
        Chunks within that could not be read, or whose checksum is wrong; they are left out.
    """

    path: Path
    topics: dict[str, Topic] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    truncated: bool = False
    size: int = 0
    unread: int = 0
    damaged: int = 0

    @property
    def zero_ns(self) -> int:
        """What to take off log times [ns]: the first of them where they count from 1970.

        A number of 64 bits has steps of 0.24 us at such times, and of a millionth of that here.
        """
        first = min((int(t.stamps[0]) for t in self.topics.values() if len(t)), default=0)
        return first if first >= EPOCH_NS else 0

    def seconds(self, topic: Topic) -> NDArray[np.float64]:
        """Log times of a topic [s], from `zero_ns` on, shape (n,)."""
        return np.asarray((topic.stamps.astype(np.int64) - self.zero_ns) * 1e-9, np.float64)


def read(path: str | Path, messages: bool = True) -> Container:
    """Read a file.

    Parameters
    ----------
    path : str or Path
        The session.
    messages : bool
        False: metadata and attachments only.

    Raises
    ------
    DataError
        If the file is missing, empty or not MCAP.
    """
    path = Path(path)
    try:
        raw = read_bytes(path, 2**48)
    except OSError as error:
        raise DataError(f"session {path}: {error.strerror}") from error
    if not raw.startswith(MAGIC):
        what = "is empty" if not raw else "is not an MCAP file"
        raise DataError(f"session {path} {what}; import a CSV, NPZ or MAT table with 'hil import'")
    out = Container(path, size=len(raw))
    reader = _Reader(out, messages, len(raw) >= _LARGE or "numba" in sys.modules)
    stop, ended = reader.records(raw, len(MAGIC))
    reader.found.hand_out(reader.channels)
    out.truncated = not (ended and raw.endswith(MAGIC))
    out.unread = 0 if ended else len(raw) - stop
    return out


def _text(data: bytes, at: int) -> tuple[str, int]:
    (n,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + n].decode(), at + 4 + n


def _pairs(data: bytes, at: int) -> dict[str, str]:
    (n,) = struct.unpack_from("<I", data, at)
    stop, at, out = at + 4 + n, at + 4, {}
    while at < stop:
        key, at = _text(data, at)
        out[key], at = _text(data, at)
    return out


class _Reader:
    def __init__(self, out: Container, messages: bool, large: bool) -> None:
        self.out, self.messages = out, messages
        self.schemas: dict[int, tuple[str, str, bytes]] = {}
        self.channels: dict[int, Topic] = {}
        self.found = Messages(large)
        #: Bytes that the chunks say they unpack to.
        self.claimed = 0

    def records(self, raw: bytes, at: int) -> tuple[int, bool]:
        """Walk records; where the last complete one ends, and if the data section ended."""
        size = len(raw)
        while at + 9 <= size:
            code, length = _RECORD.unpack_from(raw, at)
            if at + 9 + length > size:
                break
            if code == _DATA_END:
                return at, True
            if code != _CHUNK or self.messages:
                self.whole(code, raw[at + 9 : at + 9 + length])
            at += 9 + length
        return at, False

    def whole(self, code: int, data: bytes) -> None:
        """One record; a damaged one is left out and counted."""
        try:
            if code == _CHUNK:
                self.inner(self.unpacked(data))
            else:
                self.record(code, data)
        except (*_UNREADABLE, MemoryError, OverflowError):
            self.out.damaged += 1

    def unpacked(self, chunk: bytes) -> bytes:
        """Records of a chunk, its checksum verified."""
        uncompressed, checksum = struct.unpack_from("<QI", chunk, 16)
        compression, start = _text(chunk, 28)
        (n,) = struct.unpack_from("<Q", chunk, start)
        data = chunk[start + 8 : start + 8 + n]
        if compression == "zstd":
            self.refuse_claim(max(uncompressed, zstandard.frame_content_size(data)))
            data = zstandard.ZstdDecompressor().decompress(data, max_output_size=uncompressed)
        elif compression:
            raise DataError(
                f"session {self.out.path}: chunks are compressed with {compression!r}; "
                "expected zstd or none: convert the file"
            )
        if checksum and zlib.crc32(data) != checksum:
            raise struct.error("checksum of the chunk")
        return data

    def refuse_claim(self, size: int) -> None:
        """Refuse a chunk, or the chunks until here, of more than a file of this size may hold."""
        if size > _LARGEST_CHUNK or self.claimed + size > _ROOM + _RATIO * self.out.size:
            raise struct.error("claims of the chunks")
        self.claimed += size

    def inner(self, data: bytes) -> None:
        at, size, base = 0, len(data), self.found.add(data)
        while at + 9 <= size:
            at = self.found.walk(data, at, base)
            if at + 9 > size:
                break
            code, length = _RECORD.unpack_from(data, at)
            at += 9
            if code == _MSG:
                self.message(data, at, length, base)
            else:
                self.record(code, data[at : at + length])
            at += length

    def message(self, data: bytes, at: int, length: int, base: int) -> None:
        number, sequence, log_time, _ = _MESSAGE.unpack_from(data, at)
        if number not in self.channels or not _MESSAGE.size <= length <= len(data) - at:
            raise struct.error("message of no channel, or not whole")
        start = base + at + _MESSAGE.size
        self.found.note(number, sequence, log_time, start, length - _MESSAGE.size)

    def record(self, code: int, data: bytes) -> None:
        if code == _SCHEMA:
            (number,) = struct.unpack_from("<H", data)
            name, at = _text(data, 2)
            encoding, at = _text(data, at)
            self.schemas[number] = (name, encoding, data[at + 4 :])
        elif code == _CHANNEL:
            number, schema = struct.unpack_from("<HH", data)
            name, at = _text(data, 4)
            if number not in self.channels:
                kind, language, text = self.schemas.get(schema, ("", "", b""))
                topic = Topic(name, kind, _text(data, at)[0])
                topic.schema_encoding, topic.schema_text = language, text
                self.channels[number] = self.out.topics.setdefault(name, topic)
                self.found.known[number] = True
        elif code == _MSG:
            self.message(data, 0, len(data), self.found.add(data))
        elif code == _METADATA:
            name, at = _text(data, 0)
            self.out.metadata[name] = _pairs(data, at)
        elif code == _ATTACHMENT:
            name, at = _text(data, 16)
            _, at = _text(data, at)
            (n,) = struct.unpack_from("<Q", data, at)
            self.out.attachments[name] = data[at + 8 : at + 8 + n]


#: Bytes of a record's opcode and length; of what a message has before its payload.
HEAD, BEFORE = 9, 22
#: Opcode of a message.
MESSAGE = 5


@numba.njit(cache=True)
def _number(data: NDArray[np.uint8], at: int, size: int) -> np.uint64:
    """Little-endian number of `size` bytes."""
    out = np.uint64(0)
    for k in range(size):
        out |= np.uint64(data[at + k]) << np.uint64(8 * k)
    return out


@numba.njit(cache=True)
def messages(
    data: NDArray[np.uint8],
    at: int,
    known: NDArray[np.bool_],
    where: NDArray[np.int64],
    stamps: NDArray[np.uint64],
) -> tuple[int, int]:
    """Walk messages of known channels from byte `at` on, up to the first other record.

    Parameters
    ----------
    data : ndarray of uint8
        Records of a chunk.
    at : int
        Where the first of them begins.
    known : ndarray of bool (65536,)
        Whether a channel has been declared.
    where : ndarray of int64 (n, 4)
        Filled: channel, sequence number, start and size of the payload.
    stamps : ndarray of uint64 (n,)
        Filled: log times [ns].

    Returns
    -------
    count, at : int
        How many messages, and where the record after them begins.
    """
    count, size = 0, data.size
    while count < stamps.size and at + HEAD + BEFORE <= size and data[at] == MESSAGE:
        # one beyond 2^63 is negative, and as wrong as any that is too long
        length = np.int64(_number(data, at + 1, 8))
        if length < BEFORE or length > size - at - HEAD:
            break
        body = at + HEAD
        channel = _number(data, body, 2)
        if not known[channel]:
            break
        where[count, 0] = channel
        where[count, 1] = _number(data, body + 2, 4)
        where[count, 2] = body + BEFORE
        where[count, 3] = length - BEFORE
        stamps[count] = _number(data, body + 6, 8)
        at = int(body + length)
        count += 1
    return count, at
