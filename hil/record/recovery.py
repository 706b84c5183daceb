"""A proper session from what a killed writer left: every message, byte for byte."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mcap.writer import Writer

from hil.errors import ConfigError, DataError
from hil.record.container import Container, read
from hil.record.sessionfile import chunk_closer, create, mcap_writer


def recover(source: str | Path, target: str | Path) -> int:
    """Write what a cut-off or damaged session still holds as a complete one.

    Parameters
    ----------
    source : str or Path
        The session; it is only read.
    target : str or Path
        The new file.

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
        writer = mcap_writer(file, largest)
        numbers = _head(writer, box)
        for name, k in _in_order(box):
            t = box.topics[name]
            writer.add_message(numbers[name], t.times[k], t.data[k], t.times[k], t.sequence[k])
        chunk_closer(writer)()
        writer.finish()  # type: ignore[no-untyped-call]
    return kept


def _head(writer: Writer, box: Container) -> dict[str, int]:
    """Write all but the messages; the number of each channel."""
    for name, record in box.metadata.items():
        writer.add_metadata(name, record)
    for name, data in box.attachments.items():
        writer.add_attachment(0, 0, name, "application/octet-stream", data)
    schemas: dict[tuple[str, str, bytes], int] = {}
    numbers: dict[str, int] = {}
    for t in box.topics.values():
        key = (t.schema, t.schema_encoding, t.schema_text)
        if key not in schemas:
            schemas[key] = writer.register_schema(*key)
        numbers[t.name] = writer.register_channel(t.name, t.encoding, schemas[key])
    return numbers


def _in_order(box: Container) -> list[tuple[str, int]]:
    """Topic and index of every message, by time, then by the order of the channels."""
    names = [(t.name, k) for t in box.topics.values() for k in range(len(t))]
    times = np.concatenate([t.stamps for t in box.topics.values()])
    return [names[k] for k in np.argsort(times, kind="stable").tolist()]
