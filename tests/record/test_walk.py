"""The compiled walk finds what the plain one does, in whole, cut and damaged files."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.errors import DataError
from hil.record import container
from hil.record.container import Topic

SMALL = (Path(__file__).parent / "small.mcap").read_bytes()


def both(path, monkeypatch):
    """What the compiled and what the plain walk find, or the words in which they refuse."""
    found = []
    monkeypatch.delitem(sys.modules, "numba", raising=False)
    for large in (0, 2**62):
        monkeypatch.setattr(container, "_LARGE", large)
        try:
            found.append(container.read(path))
        except DataError as error:
            found.append(str(error))
    return found


def told(found):
    """All that is to be the same, to be compared."""
    if isinstance(found, str):
        return found
    topics = [(n, t.times, t.sequence, t.data) for n, t in found.topics.items()]
    return found.truncated, found.unread, found.damaged, topics


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("walk")


ENDLESS = {"longer than the chunk": 2**40, "longer than a signed number": 2**63 + 30}


def plain(n=40, channels=3, broken=None):
    """An uncompressed chunk of messages of all sizes, one of them with what `broken` does."""
    out = bytearray()
    for k in range(channels):
        name = f"/c{k}".encode()
        body = k.to_bytes(2, "little") + bytes(2) + len(name).to_bytes(4, "little") + name
        out += container._RECORD.pack(4, len(body) + 8) + body + bytes(8)
    for k in range(n):
        body = container._MESSAGE.pack(k % channels, k, 10**18 + k, k) + bytes(range(k))
        length = len(body)
        if k == 20 and broken == "no channel":
            body = container._MESSAGE.pack(channels, k, 0, 0)
            length = len(body)
        elif k == 20 and broken == "too short":
            body, length = body[:10], 10
        elif k == 20 and broken in ENDLESS:
            length = ENDLESS[broken]
        out += container._RECORD.pack(container.MESSAGE, length) + body
    chunk = bytes(16) + len(out).to_bytes(8, "little") + bytes(8) + len(out).to_bytes(8, "little")
    return container.MAGIC + container._RECORD.pack(6, len(chunk) + len(out)) + chunk + out


@settings(max_examples=120)
@given(st.data())
def test_both_walks_find_the_same_in_any_file(folder, data):
    # the second has no checksum that would keep a damaged chunk from either walk
    whole = data.draw(st.sampled_from([SMALL, plain()]))
    raw = bytearray(whole[: data.draw(st.integers(9, len(whole)))])
    for _ in range(data.draw(st.integers(0, 3))):
        raw[data.draw(st.integers(8, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path = folder / "s.mcap"
    path.write_bytes(raw)
    with pytest.MonkeyPatch.context() as patch:
        one, other = both(path, patch)
    assert told(one) == told(other)


def test_the_compiled_walk_is_that_of_large_files(tmp_path, monkeypatch):
    path, calls, walked = tmp_path / "s.mcap", [], container.messages
    path.write_bytes(plain())
    monkeypatch.setattr(container, "messages", lambda *a: calls.append(1) or walked(*a))
    monkeypatch.delitem(sys.modules, "numba", raising=False)
    container.read(path)
    assert not calls
    monkeypatch.setattr(container, "_LARGE", path.stat().st_size)
    container.read(path)
    assert calls


def test_messages_outside_of_chunks_are_read_too(tmp_path, monkeypatch):
    chunked, loose = tmp_path / "c.mcap", tmp_path / "l.mcap"
    chunked.write_bytes(plain())
    head = len(container.MAGIC) + 9 + 40
    loose.write_bytes(container.MAGIC + plain()[head:])
    one, other = both(loose, monkeypatch)
    assert told(one) == told(other) == told(container.read(chunked))
    assert sum(len(t) for t in one.topics.values()) == 40


@pytest.mark.parametrize("broken", [None, "no channel", "too short", *ENDLESS])
def test_both_walks_stop_at_the_same_damage(tmp_path, monkeypatch, broken):
    path = tmp_path / "s.mcap"
    path.write_bytes(plain(broken=broken))
    one, other = both(path, monkeypatch)
    assert told(one) == told(other)
    found = sum(len(t) for t in one.topics.values())
    assert found == (40 if broken is None else 20)
    assert one.damaged == (broken is not None)
    assert one.topics["/c1"].data[1] == bytes(range(4))
    assert one.topics["/c1"].times[1] == 10**18 + 4


def test_more_messages_than_the_walk_takes_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.record.container.AT_ONCE", 7)
    path = tmp_path / "s.mcap"
    path.write_bytes(plain())
    one, other = both(path, monkeypatch)
    assert told(one) == told(other)
    assert sum(len(t) for t in container.read(path).topics.values()) == 40


def test_a_slice_of_every_payload_is_inside_it():
    topic = Topic("/x", "", "", raw=bytearray(range(30)))
    topic.stamps, topic.ticks = np.arange(3, dtype=np.uint64), np.arange(3)
    topic.starts, topic.sizes = np.array([0, 9, 25]), np.array([5, 5, 5])
    assert topic.cut(1, 3).tolist() == [[1, 2, 3], [10, 11, 12], [26, 27, 28]]
    with pytest.raises(IndexError, match="ends before byte 6"):
        topic.cut(3, 3)
    assert topic.only(np.array([False, False, True])).data == [bytes(range(25, 30))]
