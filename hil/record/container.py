"""Reads the records of an MCAP file in one pass, whole, cut off anywhere, or damaged within.

The file is walked record by record and chunk by chunk; what a killed writer left is read up
to the last complete chunk.  Where a record cannot be one, the walk goes on at the next place
where three records follow each other: a damaged length costs its record and no other.
Definitions are believed where a checksum covers them (summary, chunks), and taken as they
stand where none does.  Messages beside the chunks are such only where the summary counts them, or
where there are no chunks: one damaged bit makes a message of a definition or an index.  What no
record shows, the checksum of all bytes does.  Payloads stay bytes: decoding is done a channel at a
time.

Messages of all channels are kept as they are read until every topic gets its own: columns of
numbers, and payloads that stay where they were read.  Where the messages of a chunk lie is found by
a compiled walk, in files that are worth its import.
"""

from __future__ import annotations

import json
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
from hil.userfile import LARGEST, read_bytes


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

    def __len__(self) -> int:
        return sum(map(len, self._where)) + len(self._rows)

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
_FOOTER, _SCHEMA, _CHANNEL, _MSG, _CHUNK, _ATTACHMENT = 2, 3, 4, 5, 6, 9
_ATTACHMENT_INDEX, _STATISTICS, _METADATA, _DATA_END = 10, 11, 12, 15
#: Opcodes from here on are a writer's own, and are passed over.
_PRIVATE = 0x80
_UNREADABLE = (struct.error, zstandard.ZstdError, UnicodeDecodeError, KeyError, ValueError)
_ZSTD = b"\x28\xb5\x2f\xfd"
#: Attachment with a copy of the metadata: a metadata record has no checksum, an attachment has.
METADATA_COPY = "hil.metadata.json"
#: Metadata record of a file that is what was left of another one; it is no part of the session.
RECOVERY = "recovery"
#: Before the name of an attached file: its copy, packed with zlib.
FILE_COPY = "hil.copy/"
#: Records that must follow each other where the walk goes on after a damaged one, and bytes that
#: are searched at once.
_CHAIN, _SEARCHED = 3, 2**20
#: From this size on [byte] the compiled walk is worth the import of the compiler, where nothing
#: else has needed that.
_LARGE = 2**24
#: No writer makes chunks so large [byte]; a damaged length must not claim the memory.
_LARGEST_CHUNK = 2**28
#: All chunks together may unpack to so many bytes, and to so many times the file.
_ROOM, RATIO = 2**24, 256
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
        Records within that could not be read, or whose checksum is wrong; they are left out, or
        taken from their copy.  At least 1 where the checksum of all bytes is wrong.
    recovery : dict
        What the file was recovered from, and what was lost then; empty of another file.
    """

    path: Path
    topics: dict[str, Topic] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    truncated: bool = False
    size: int = 0
    unread: int = 0
    damaged: int = 0
    recovery: dict[str, str] = field(default_factory=dict)

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
        raw = read_bytes(path, LARGEST)
    except OSError as error:
        raise DataError(f"session {path}: {error.strerror}") from error
    if not _is_mcap(raw):
        what = f"session {path} {'is not an MCAP file' if raw else 'is empty'}"
        raise DataError(
            f"{what}; convert tables and ROS bags with 'hil import' (in Python, a data frame with "
            "hil.from_arrays)"
        ).about("tables", what)
    out = Container(path, size=len(raw))
    reader = _Reader(out, messages, len(raw) >= _LARGE or "numba" in sys.modules)
    reader.read(raw)
    out.recovery = out.metadata.pop(RECOVERY, {})
    return out


def _is_mcap(raw: bytes) -> bool:
    """Whether a file begins as one does, but for a damaged bit."""
    bits = int.from_bytes(raw[: len(MAGIC)]) ^ int.from_bytes(MAGIC)
    return len(raw) >= len(MAGIC) and bits.bit_count() <= 1


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


def _chunk_fits(raw: bytes, at: int, length: int) -> bool:
    """Whether the fields of a chunk whose content begins at `at` fill its length exactly."""
    if length < 40:
        return False
    (name,) = struct.unpack_from("<I", raw, at + 28)
    if name > 16 or 40 + name > length:
        return False
    (n,) = struct.unpack_from("<Q", raw, at + 32 + name)
    return bool(40 + name + n == length)


def _end(raw: bytes, at: int, limit: int) -> int:
    """Where the record at `at` ends; -1 where no record can be."""
    if at + HEAD > limit:
        return -1
    code, length = _RECORD.unpack_from(raw, at)
    end = int(at + HEAD + length)
    if end > limit or not (1 <= code <= _DATA_END or code >= _PRIVATE):
        return -1
    if code == _CHUNK and not _chunk_fits(raw, at + HEAD, length):
        return -1
    return -1 if code == _DATA_END and length != 4 else end


def _goes_on(raw: bytes, at: int, limit: int) -> bool:
    """Whether records follow each other from `at` on: a whole chunk, or several of any kind."""
    for _ in range(_CHAIN):
        code, end = raw[at], _end(raw, at, limit)
        if end < 0 or code >= _PRIVATE:
            return False
        if code == _CHUNK or end == limit:
            return True
        at = end
        if at >= limit:
            return False
    return True


def _next_record(raw: bytes, start: int, limit: int) -> int:
    """First place from `start` on where records follow each other again; -1 where none is."""
    for first in range(start, limit - HEAD + 1, _SEARCHED):
        stop = min(first + _SEARCHED, limit - HEAD + 1)
        block = np.frombuffer(raw, np.uint8, stop - first + HEAD - 1, first)
        n = stop - first
        # a known opcode, and a length below 4 GiB
        likely = (block[:n] >= 1) & (block[:n] <= _DATA_END)
        for k in range(5, HEAD):
            likely &= block[k : k + n] == 0
        for at in (first + np.flatnonzero(likely)).tolist():
            if _goes_on(raw, at, limit):
                return int(at)
    return -1


def _summary(raw: bytes) -> tuple[bytes, bool]:
    """Records of the summary, and whether its checksum is wrong; empty where none is right."""
    at = len(raw) - len(MAGIC) - HEAD - 20
    if at < len(MAGIC) or not raw.endswith(MAGIC):
        return b"", False
    code, length = _RECORD.unpack_from(raw, at)
    start, _, checksum = struct.unpack_from("<QQI", raw, at + HEAD)
    if (code, length) != (_FOOTER, 20):
        return b"", True
    if not start or not checksum:
        return b"", False
    if len(MAGIC) <= start < at and zlib.crc32(raw[start : at + HEAD + 16]) == checksum:
        return raw[start:at], False
    return b"", True


class _Reader:
    def __init__(self, out: Container, messages: bool, large: bool) -> None:
        self.out, self.messages = out, messages
        self.schemas: dict[int, tuple[str, str, bytes]] = {}
        self.channels: dict[int, Topic] = {}
        #: Schemas and channels that a checksum covers.
        self.proven: set[tuple[int, int]] = set()
        self.found = Messages(large)
        #: Where attached files have been read.
        self.walked: set[int] = set()
        #: Copies of attached files by their names, packed.
        self.copies: dict[str, bytes] = {}
        #: Bytes that the chunks say they unpack to.
        self.claimed = 0
        #: Messages beside the chunks.
        self.loose: list[tuple[int, int, int, int, int]] = []
        #: Whether there are chunks; messages that the summary counts, -1 where it does not say.
        self.chunked, self.counted = False, -1
        #: Where the record stands that is read, and the last copy of the metadata.
        self.at = self.copied = 0

    def read(self, raw: bytes) -> None:
        """The whole file."""
        summary, broken = _summary(raw)
        limit = len(raw) - len(MAGIC) - HEAD - 20 - len(summary) if summary else len(raw)
        attachments = self.definitions(summary)
        stop, ended = self.records(raw, limit)
        ended = ended or bool(summary)
        later = self.out.metadata
        for offset, length in attachments:
            if offset not in self.walked and offset + length <= limit:
                self.at = offset
                self.whole(_ATTACHMENT, raw[offset + HEAD : offset + length])
        self.out.metadata = {**later, **self.out.metadata}
        room = min(_ROOM, RATIO * len(raw))
        for name in [name for name in self.copies if name not in self.out.attachments]:
            if text := _unpacked(self.copies[name], room) if room else b"":
                self.out.attachments[name] = text
                room -= len(text)
        self.take_loose()
        self.found.hand_out(self.channels)
        if self.messages and not self.out.damaged:
            wrong = _differs(raw, limit if summary else stop + HEAD + 4)
            self.out.damaged = int(wrong or (broken and ended))
        self.out.truncated = not (ended and raw.endswith(MAGIC))
        self.out.unread = 0 if ended else len(raw) - stop

    def definitions(self, summary: bytes) -> list[tuple[int, int]]:
        """Schemas and channels of the summary; place and length of every attachment."""
        at, attachments = 0, []
        while at < len(summary):
            code, length = _RECORD.unpack_from(summary, at)
            data = summary[at + HEAD : at + HEAD + length]
            if code in (_SCHEMA, _CHANNEL):
                self.record(code, data, proven=True)
            elif code == _ATTACHMENT_INDEX:
                attachments.append(struct.unpack_from("<QQ", data))
            elif code == _STATISTICS:
                (self.counted,) = struct.unpack_from("<Q", data)
            at += HEAD + length
        return attachments

    def records(self, raw: bytes, limit: int) -> tuple[int, bool]:
        """Walk records; where the last complete one ends, and if the data section ended."""
        at = doubt = len(MAGIC)
        while at < limit:
            end = _end(raw, at, limit)
            if end < 0:
                found = _next_record(raw, doubt, limit)
                if found < 0:
                    break
                self.out.damaged += 1
                at = doubt = found
                continue
            code = raw[at]
            if code == _DATA_END:
                return at, True
            # its fields say so, whatever became of its opcode
            chunk = code == _CHUNK or (
                raw[at + HEAD + 28 : at + HEAD + 36] == b"\x04\0\0\0zstd"
                and _chunk_fits(raw, at + HEAD, end - at - HEAD)
            )
            self.chunked = self.chunked or chunk
            if code == _ATTACHMENT:
                self.walked.add(at)
            self.at = at
            if not chunk or self.messages:
                self.whole(_CHUNK if chunk else code, raw[at + HEAD : end])
            doubt = end if chunk else at + 1
            at = end
        return at, False

    def whole(self, code: int, data: bytes) -> None:
        """One record; a damaged one is left out and counted."""
        try:
            if code == _CHUNK:
                self.inner(*self.unpacked(data))
            else:
                self.record(code, data)
        except (*_UNREADABLE, MemoryError, OverflowError):
            self.out.damaged += 1

    def unpacked(self, chunk: bytes) -> tuple[bytes, bool]:
        """Records of a chunk, and whether it has a checksum, which is verified."""
        uncompressed, checksum = struct.unpack_from("<QI", chunk, 16)
        compression, start = _text(chunk, 28)
        (n,) = struct.unpack_from("<Q", chunk, start)
        data = chunk[start + 8 : start + 8 + n]
        if compression == "zstd" or data.startswith(_ZSTD):
            self.refuse_claim(max(uncompressed, zstandard.frame_content_size(data)))
            data = zstandard.ZstdDecompressor().decompress(data, max_output_size=uncompressed)
        elif compression.isalnum():
            raise DataError(
                f"session {self.out.path}: chunks are compressed with {compression!r}; "
                "expected zstd or none: convert the file"
            )
        if checksum and zlib.crc32(data) != checksum:
            raise struct.error("checksum of the chunk")
        return data, bool(checksum)

    def refuse_claim(self, size: int) -> None:
        """Refuse a chunk, or the chunks until here, of more than a file of this size may hold."""
        if size > _LARGEST_CHUNK or self.claimed + size > _ROOM + RATIO * self.out.size:
            raise struct.error("claims of the chunks")
        self.claimed += size

    def inner(self, data: bytes, proven: bool) -> None:
        """Records of a chunk."""
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
                self.record(code, data[at : at + length], proven)
            at += length

    def message(self, data: bytes, at: int, length: int, base: int) -> None:
        """A message of a chunk."""
        self.found.note(*self.row(data, at, length, base))

    def row(self, data: bytes, at: int, length: int, base: int) -> tuple[int, int, int, int, int]:
        """Channel, sequence number, time, and place and size of the payload of a message."""
        number, sequence, log_time, _ = _MESSAGE.unpack_from(data, at)
        if number not in self.channels or not _MESSAGE.size <= length <= len(data) - at:
            raise struct.error("message of no channel, or not whole")
        start = base + at + _MESSAGE.size
        return number, sequence, log_time, start, length - _MESSAGE.size

    def take_loose(self) -> None:
        """Messages beside the chunks that are none by the damage of a bit."""
        count = len(self.found)
        if self.chunked and not 0 <= count + len(self.loose) <= self.counted:
            self.out.damaged += len(self.loose)
            return
        for row in self.loose:
            self.found.note(*row)

    def record(self, code: int, data: bytes, proven: bool = False) -> None:
        """Any record but a chunk; `proven`: a checksum covers it."""
        if code in (_SCHEMA, _CHANNEL):
            (number,) = struct.unpack_from("<H", data)
            if proven or (code, number) not in self.proven:
                (self.schema if code == _SCHEMA else self.channel)(number, data)
            if proven:
                self.proven.add((code, number))
        elif code == _MSG:
            if _defines(data):
                raise struct.error("a channel, and no message")
            self.loose.append(self.row(data, 0, len(data), self.found.add(data)))
        elif code == _METADATA:
            name, at = _text(data, 0)
            self.out.metadata[name] = _pairs(data, at)
        elif code == _ATTACHMENT:
            self.attachment(data)

    def schema(self, number: int, data: bytes) -> None:
        """Keep a schema."""
        name, at = _text(data, 2)
        encoding, at = _text(data, at)
        self.schemas[number] = (name, encoding, data[at + 4 :])

    def channel(self, number: int, data: bytes) -> None:
        """Make the topic of a channel, or put it in the place of one that was damaged."""
        (schema,) = struct.unpack_from("<H", data, 2)
        name, at = _text(data, 4)
        kind, language, text = self.schemas.get(schema, ("", "", b""))
        topic = Topic(name, kind, _text(data, at)[0], language, text)
        before = self.channels.get(number)
        if before is not None and _same(before, topic):
            return
        if before is not None and sum(t is before for t in self.channels.values()) == 1:
            del self.out.topics[before.name]
        self.channels[number] = self.out.topics.setdefault(name, topic)
        self.found.known[number] = True

    def copy(self, records: dict[str, dict[str, str]]) -> None:
        """Metadata of a copy: all until there, of which some may be damaged."""
        if self.at < self.copied:
            return
        self.copied, read = self.at, self.out.metadata
        self.out.damaged += sum(read.get(name) != record for name, record in records.items())
        self.out.metadata = records

    def attachment(self, data: bytes) -> None:
        """Keep an attached file, if its checksum is right."""
        name, at = _text(data, 16)
        _, at = _text(data, at)
        (n,) = struct.unpack_from("<Q", data, at)
        (checksum,) = struct.unpack_from("<I", data, at + 8 + n)
        if checksum and zlib.crc32(data[: at + 8 + n]) != checksum:
            raise struct.error("checksum of the attachment")
        content = data[at + 8 : at + 8 + n]
        if name == METADATA_COPY:
            self.copy(_records(content))
        elif name.startswith(FILE_COPY):
            self.copies[name.removeprefix(FILE_COPY)] = content
        else:
            self.out.attachments[name] = content


def _defines(data: bytes) -> bool:
    """Whether the fields of a channel's definition fill a record exactly."""
    try:
        _, at = _text(data, 4)
        _, at = _text(data, at)
        (n,) = struct.unpack_from("<I", data, at)
    except (struct.error, UnicodeDecodeError):
        return False
    return bool(at + 4 + n == len(data))


def _differs(raw: bytes, stop: int) -> bool:
    """Whether the checksum of all bytes before the end of the data, at `stop`, is wrong."""
    at = stop - HEAD - 4
    if at < len(MAGIC) or stop > len(raw) or _RECORD.unpack_from(raw, at) != (_DATA_END, 4):
        return False
    (checksum,) = struct.unpack_from("<I", raw, at + HEAD)
    # some writers leave out the first bytes, which are the same in every file
    return bool(checksum) and checksum not in (zlib.crc32(raw[:at]), zlib.crc32(raw[8:at]))


def _records(content: bytes) -> dict[str, dict[str, str]]:
    """Metadata from its copy, which anybody may have written."""
    try:
        found = json.loads(content)
    except RecursionError as error:
        raise ValueError("a copy of the metadata that nests too deep") from error
    if not isinstance(found, dict):
        raise ValueError("a copy of the metadata that is no table")
    return {
        str(name): {str(key): str(text) for key, text in record.items()}
        for name, record in found.items()
        if isinstance(record, dict)
    }


def _unpacked(content: bytes, most: int) -> bytes:
    """An attached file from its copy; empty where it is damaged, or larger than `most` bytes."""
    unpack = zlib.decompressobj()
    try:
        text = unpack.decompress(content, most)
    except zlib.error:
        return b""
    return text if unpack.eof else b""


def _same(one: Topic, other: Topic) -> bool:
    """Whether two definitions of a channel agree."""
    names = ("name", "schema", "encoding", "schema_encoding", "schema_text")
    return all(getattr(one, n) == getattr(other, n) for n in names)


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
