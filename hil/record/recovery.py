"""The file of a session: written whole or not at all, and made proper again after a killed writer.

Recovery keeps every message that is there, byte for byte.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import stat
import zlib
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO, FileIO, RawIOBase
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.records import Channel, ChunkIndex, Schema
from mcap.writer import CompressionType, IndexType, Writer

from hil.errors import ConfigError, DataError
from hil.record.container import FILE_COPY, METADATA_COPY, RECOVERY, Container, read
from hil.record.schema import LIBRARY, written_by

CHUNK_BYTES = 64 * 1024
#: Bytes of a message record around its payload.
FRAME = 31


def mcap_writer(file: SessionFile, largest: int, library: str = LIBRARY) -> Writer:
    """Started MCAP writer whose chunks stay within 64 KiB.

    Parameters
    ----------
    file : SessionFile
        Where to.
    largest : int
        Size of the largest payload [byte]; a chunk is closed after the message that fills it.
    library : str
        Whose file it says it is: what is left of a bag stays a bag.
    """
    writer = Writer(
        cast(IO[Any], file),
        chunk_size=max(CHUNK_BYTES - FRAME - largest, 0),
        compression=CompressionType.ZSTD,
        index_types=IndexType.ALL,
        enable_data_crcs=True,
    )
    # a list of objects would grow by more than a megabyte a minute
    if getattr(writer, "_Writer__chunk_indices", None) == []:
        vars(writer)["_Writer__chunk_indices"] = ChunkIndices()
    writer.start(profile="ros2", library=library)
    return writer


class ChunkIndices:
    """Chunk indices of a session that is being written, as compressed bytes until its end."""

    #: Bytes of records that are compressed together.
    BLOCK = 1 << 16

    def __init__(self) -> None:
        self._full: list[bytes] = []
        self._open = bytearray()

    def append(self, index: ChunkIndex) -> None:
        """Keep one index."""
        builder = RecordBuilder()
        index.write(builder)
        self._open += builder.end()  # type: ignore[no-untyped-call]
        if len(self._open) >= self.BLOCK:
            self._full.append(zlib.compress(bytes(self._open), 1))
            self._open.clear()

    def __iter__(self) -> Iterator[ChunkIndex]:
        """All of them in order."""
        for block in (*map(zlib.decompress, self._full), bytes(self._open)):
            stream = ReadDataStream(BytesIO(block))
            while stream.count < len(block):
                stream.read1()  # opcode
                stream.read8()  # length
                yield ChunkIndex.read(stream)


def describe(
    writer: Writer, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]
) -> None:
    """What a session is, before its first message: metadata, attached files, and copies.

    A metadata record has no checksum; its copy is an attachment, which has one.  An attached file
    that is damaged is read from its own copy.
    """
    for name, record in metadata.items():
        writer.add_metadata(name, dict(record))
    for name, data in attachments.items():
        writer.add_attachment(0, 0, name, "application/octet-stream", data)
    copy_metadata(writer, metadata)
    for name, data in attachments.items():
        writer.add_attachment(0, 0, FILE_COPY + name, "application/zlib", zlib.compress(data, 9))


def copy_metadata(writer: Writer, metadata: Mapping[str, Mapping[str, str]]) -> None:
    """Attach all metadata until here, with a checksum."""
    copy = json.dumps({name: dict(record) for name, record in metadata.items()}, sort_keys=True)
    writer.add_attachment(0, 0, METADATA_COPY, "application/json", copy.encode())


def define_schema(writer: Writer, name: str, encoding: str, text: bytes) -> int:
    """Register a schema, and write it outside of the chunks too; its number.

    The library writes definitions into the open chunk alone, and a session whose first chunk is
    damaged would lose them all.
    """
    number: int = writer.register_schema(name, encoding, text)
    _outside(writer, Schema(number, text, encoding, name))
    return number


def define_channel(writer: Writer, topic: str, encoding: str, schema: int) -> int:
    """Register a channel, and write it outside of the chunks too; its number."""
    number: int = writer.register_channel(topic, encoding, schema)
    _outside(writer, Channel(number, topic, encoding, {}, schema))
    return number


def _outside(writer: Writer, record: Schema | Channel) -> None:
    """Let a record stand before the next chunk, as far as this release of mcap can."""
    builder = getattr(writer, "_Writer__record_builder", None)
    if builder is not None:
        record.write(builder)


def chunk_closer(writer: Writer) -> Callable[[], None]:
    """Function that closes the open chunk.

    Not every published mcap 1.6 has a public ``flush``; without it the private step does.
    """
    public: Callable[[], None] | None = getattr(writer, "flush", None)
    private: Callable[[], None] | None = getattr(writer, "_Writer__finalize_chunk", None)
    found = public or private
    if found is None:
        raise ConfigError("this release of mcap cannot close a chunk; install mcap 1.6")
    return found


class SessionFile:
    """File that is written only by `flush`, and all of it or nothing.

    Parameters
    ----------
    raw : RawIOBase
        Open for writing.
    path : Path
        Its name.
    """

    def __init__(self, raw: RawIOBase, path: Path) -> None:
        self._raw, self._path = raw, path
        self._waiting, self.kept = bytearray(), 0

    def write(self, data: bytes) -> int:
        """Keep `data` for the next `flush`."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Bytes so far, waiting ones included."""
        return self.kept + len(self._waiting)

    def flush(self) -> None:
        """Hand what waits to the operating system."""
        if not self._waiting:
            return
        data, self._waiting = self._waiting, bytearray()
        view = memoryview(data)
        while view:
            view = view[self._raw.write(view) or 0 :]
        self.kept += len(data)

    def cut(self) -> None:
        """Take back what an interrupted `flush` left behind, as far as the disk allows."""
        self._waiting = bytearray()
        with contextlib.suppress(OSError):  # then the reader leaves the torn chunk out
            self._raw.truncate(self.kept)

    def sync(self) -> None:
        """Have the disk take what the operating system holds."""
        os.fdatasync(self._raw.fileno())

    def discard(self) -> None:
        """Close, and remove the file if it is one and still there."""
        ours = self._is_regular and not self.gone
        self._waiting = bytearray()
        self._raw.close()
        if ours:
            self._path.resolve().unlink(missing_ok=True)

    @property
    def _is_regular(self) -> bool:
        return stat.S_ISREG(os.fstat(self._raw.fileno()).st_mode)

    @property
    def gone(self) -> bool:
        """Whether another file, or none, stands at the name of this one, or it was shortened."""
        if not self._is_regular:
            return False
        ours = os.fstat(self._raw.fileno())
        try:
            return ours.st_size < self.kept or not os.path.samestat(self._path.stat(), ours)
        except OSError:
            return True

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._raw.closed

    def close(self) -> None:
        """Close without writing what waits."""
        self._raw.close()

    def __enter__(self) -> SessionFile:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is not None:
            self.discard()  # no stub of what failed
            return
        self.flush()
        self.close()


def create(path: str | Path, overwrite: bool) -> SessionFile:
    """Open a session file for writing.

    Raises
    ------
    ConfigError
        If it cannot be created, exists and must not be overwritten, or another process is
        writing it.
    """
    # where another program shortens the file, appending leaves no hole that hides it
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | (0 if overwrite else os.O_EXCL)
    try:
        raw = FileIO(os.open(path, flags, 0o666), "r+b")
        _lock(raw, path)
        if stat.S_ISREG(os.fstat(raw.fileno()).st_mode):
            raw.truncate(0)
        return SessionFile(raw, Path(path))
    except FileExistsError as error:
        raise ConfigError(f"session {path} exists; name a new file") from error
    except OSError as error:
        raise ConfigError(f"cannot write session {path}: {error.strerror}") from error


def _lock(raw: FileIO, path: str | Path) -> None:
    """Claim a file; the claim ends with the file, however the process ends."""
    try:
        fcntl.flock(raw.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raw.close()
        raise ConfigError(
            f"cannot write session {path}: another process is writing it; end that one, or choose "
            "another name"
        ) from None
    except OSError:  # a file system without locks
        return


def in_use(path: str | Path) -> bool:
    """Whether a process is writing a session."""
    try:
        with FileIO(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK), "r") as raw:
            fcntl.flock(raw.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # no file, or a file system without locks
        return False
    return False


def recover(
    source: str | Path, target: str | Path, more: Mapping[str, Mapping[str, str]] | None = None
) -> int:
    """Write what a cut-off or damaged session still holds as a complete one.

    Parameters
    ----------
    source : str or Path
        The session; it is only read.
    target : str or Path
        The new file.
    more : mapping of str to mapping, optional
        Further metadata records: what stands beside the session.

    Returns
    -------
    int
        Messages kept, of all channels.

    Raises
    ------
    DataError
        If the source is no session, or holds no complete message.
    ConfigError
        If the target exists or cannot be created.
    """
    box = read(source)
    kept = sum(len(t) for t in box.topics.values())
    if not kept:
        raise DataError(f"session {source} holds no complete message; nothing to recover")
    if Path(target).exists():
        raise ConfigError(f"{target} exists; name a new file to recover into")
    largest = max(int(t.sizes.max()) for t in box.topics.values() if len(t))
    with create(target, overwrite=False) as file:
        writer = mcap_writer(file, largest, written_by(source) or LIBRARY)
        numbers = _head(writer, box, more or {})
        for name, k in _in_order(box):
            t = box.topics[name]
            writer.add_message(numbers[name], t.times[k], t.data[k], t.times[k], t.sequence[k])
        chunk_closer(writer)()
        writer.finish()  # type: ignore[no-untyped-call]
        file.flush()
    return kept


def _head(writer: Writer, box: Container, more: Mapping[str, Mapping[str, str]]) -> dict[str, int]:
    """Write all but the messages; the number of each channel."""
    told = {
        "source": Path(box.path).name,
        "unread_bytes": str(box.unread),
        "damaged_records": str(box.damaged),
    }
    describe(writer, {**box.metadata, **more, RECOVERY: told}, box.attachments)
    schemas: dict[tuple[str, str, bytes], int] = {}
    numbers: dict[str, int] = {}
    for t in box.topics.values():
        key = (t.schema, t.schema_encoding, t.schema_text)
        if key not in schemas:
            schemas[key] = define_schema(writer, *key)
        numbers[t.name] = define_channel(writer, t.name, t.encoding, schemas[key])
    return numbers


def _in_order(box: Container) -> list[tuple[str, int]]:
    """Topic and index of every message, by time, then by the order of the channels."""
    names = [(t.name, k) for t in box.topics.values() for k in range(len(t))]
    times = np.concatenate([t.stamps for t in box.topics.values()])
    return [names[k] for k in np.argsort(times, kind="stable").tolist()]
