"""Reads the records of an MCAP file in one pass, whole or cut off anywhere.

The file is walked record by record and chunk by chunk; what a killed writer left is read up
to the last complete chunk.  Payloads stay bytes: decoding is done a channel at a time.
"""

from __future__ import annotations

import struct
import sys
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zstandard
from numpy.typing import NDArray

from hil.errors import DataError
from hil.record.found import Found
from hil.record.topic import Topic

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
_LARGEST_CHUNK = 2**31
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
        raw = path.read_bytes()
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
        self.found = Found(large)

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
            data = zstandard.ZstdDecompressor().decompress(data, max_output_size=uncompressed)
        elif compression:
            raise DataError(
                f"session {self.out.path}: chunks are compressed with {compression!r}; "
                "expected zstd or none: convert the file"
            )
        if checksum and zlib.crc32(data) != checksum:
            raise struct.error("checksum of the chunk")
        return data

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
