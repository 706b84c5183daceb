"""A damaged or cut-off session: what one bad bit may cost."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from hil.bench import record_speed
from hil.cli import main
from hil.record.container import FILE_COPY, METADATA_COPY, read
from hil.record.mcap_write import SessionWriter
from hil.record.schema import Channel

STATE = Channel("/arm/measured_js", "joint_state", ("a", "b"), ("position",))
EFFORT = Channel("/arm/setpoint_jf", "joint_state", ("a", "b"), ("effort",))
RECORDS = {"session": {"seed": "7", "rig": "teleop"}, "model": {"name": "arm"}}
FILES = {"rig.toml": b"rate_hz = 1000\n" * 20, "arm.urdf": b"<robot name='a'/>"}
TICKS, START = 1500, 1_700_000_000 * 10**9


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("damage") / "s.mcap"
    rng = np.random.default_rng(3)
    with SessionWriter(path, [STATE, EFFORT], RECORDS, FILES) as w:
        for k in range(TICKS):
            for topic in (STATE.topic, EFFORT.topic):
                w.write(topic, k + 1, START + k * 10**6, rng.normal(size=2))
        w.event(TICKS, START + TICKS * 10**6, "done", {})
    return path


def changed(whole, at, bit):
    raw = bytearray(whole.read_bytes())
    raw[at] ^= 1 << bit
    return bytes(raw)


def lost_rows(path, raw):
    path.write_bytes(raw)
    box = read(path)
    assert list(box.topics)[:2] == [STATE.topic, EFFORT.topic]
    assert [box.topics[c.topic].schema for c in (STATE, EFFORT)] == [
        "sensor_msgs/msg/JointState"
    ] * 2
    return max(TICKS - len(box.topics[c.topic]) for c in (STATE, EFFORT)), box


def test_any_one_bit_costs_a_tenth_of_a_second_at_most(whole, tmp_path):
    size = whole.stat().st_size
    rng = np.random.default_rng(0)
    # the head, where one chunk is all that follows, and a sample of the rest
    places = [*range(0, 2600, 9), *rng.integers(0, size, 300).tolist()]
    for at in places:
        raw = changed(whole, at, int(rng.integers(8)))
        lost, box = lost_rows(tmp_path / "x.mcap", raw)
        assert lost <= 100, at
        assert box.metadata == RECORDS, at
        assert box.attachments == FILES, at


def test_metadata_survive_a_bit_that_no_checksum_covers(whole, tmp_path):
    raw = whole.read_bytes()
    at = raw.index(b"teleop")
    path = tmp_path / "x.mcap"
    path.write_bytes(changed(whole, at, 1))
    assert read(path).metadata == RECORDS
    assert METADATA_COPY not in read(path).attachments


def test_a_damaged_file_that_is_attached_is_counted_and_read_from_its_copy(whole, tmp_path):
    path = tmp_path / "x.mcap"
    raw = bytearray(changed(whole, whole.read_bytes().index(b"<robot"), 2))
    path.write_bytes(raw)
    box = read(path)
    assert box.attachments == FILES
    assert (box.damaged, box.truncated) == (1, False)
    raw[raw.index(b"hil.copy/arm.urdf") + 50] ^= 1
    path.write_bytes(raw)
    assert list(read(path).attachments) == ["rig.toml"]
    assert read(path).damaged == 2


def outside(raw, opcode):
    """Where the records of a kind begin, those in chunks left aside."""
    at, found = 8, []
    while at < len(raw) - 8:
        code, length = struct.unpack_from("<BQ", raw, at)
        found += [at] if code == opcode else []
        at += 9 + length
    return found


@pytest.mark.parametrize(("opcode", "bit"), [(4, 0), (7, 1)])
@pytest.mark.parametrize("killed", [False, True])
def test_a_definition_or_an_index_becomes_no_message(whole, tmp_path, opcode, bit, killed):
    raw = whole.read_bytes()
    ends = len(raw) if not killed else outside(raw, 6)[-1]
    kept = rows(read_of(raw[:ends], tmp_path))
    for at in [p for p in outside(raw, opcode) if p < ends][:: 1 + (opcode == 7) * 9]:
        box = read_of(changed(whole, at, bit)[:ends], tmp_path)
        assert rows(box) == kept, at
        assert box.damaged >= 1, at


def rows(box):
    return {name: len(t) for name, t in box.topics.items() if len(t)}


def read_of(raw, folder):
    (folder / "x.mcap").write_bytes(raw)
    return read(folder / "x.mcap")


def test_messages_beside_the_chunks_are_read_where_the_summary_counts_them(tmp_path):
    path = tmp_path / "x.mcap"
    for packed in (False, True):
        with path.open("wb") as file:
            w = Writer(file, use_chunking=packed)
            w.start()
            number = w.register_channel("/a", "json", w.register_schema("n", "jsonschema", b"{}"))
            for k in range(20):
                w.add_message(number, k, b"{}", k, k)
            if packed:
                w.flush()
                beside = Message(number, 99, b"{}", 99, 20)
                beside.write(vars(w)["_Writer__record_builder"])
                vars(w)["_Writer__statistics"].message_count += 1
            w.finish()
        box = read(path)
        assert (len(box.topics["/a"]), box.damaged) == (20 + packed, 0)


def test_metadata_of_the_end_survive_any_one_bit_and_the_damage_is_told(tmp_path, capsys):
    path = tmp_path / "s.mcap"
    with SessionWriter(path, [STATE, EFFORT], RECORDS, FILES) as w:
        for k in range(50):
            for topic in (STATE.topic, EFFORT.topic):
                w.write(topic, k + 1, START + k * 10**6, [0.1 * k, 1.0])
        w.metadata("loop", {"figures": "late"})
    raw = path.read_bytes()
    at = outside(raw, 12)[-1]
    for place in range(at, outside(raw, 15)[0]):
        box = read_of(changed(path, place, place % 8), tmp_path)
        assert box.metadata == {**RECORDS, "loop": {"figures": "late"}}, place
        assert box.damaged >= 1, place
    assert main(["info", str(tmp_path / "x.mcap")]) == 0
    assert "damaged record" in capsys.readouterr().out


def test_a_bit_that_no_record_shows_is_told_by_the_checksum_of_all(whole, tmp_path):
    at = outside(whole.read_bytes(), 7)[3] + 20
    assert read(whole).damaged == 0
    assert read_of(changed(whole, at, 1), tmp_path).damaged == 1


@pytest.mark.parametrize("text", ["[1]", "{", "[" * 10**5, '{"a": [1], "session": {"seed": [7]}}'])
def test_a_copy_that_anybody_wrote_is_read(tmp_path, text):
    path = tmp_path / "x.mcap"
    files = {METADATA_COPY: text.encode(), FILE_COPY + "a": zlib.compress(bytes(2**20))}
    with SessionWriter(path, [], {}, files | {FILE_COPY + "b": b"no zlib"}):
        pass
    box = read(path)
    assert all(isinstance(v, str) for r in box.metadata.values() for v in r.values())


@pytest.mark.parametrize("bit", range(8))
def test_the_first_chunk_and_its_definitions_may_go(whole, tmp_path, bit):
    raw = whole.read_bytes()
    first = raw.index(b"\x04\0\0\0zstd") + 40
    lost, box = lost_rows(tmp_path / "x.mcap", changed(whole, first, bit))
    assert lost <= 100
    assert box.damaged <= 1


def test_a_damaged_length_costs_its_record_alone(whole, tmp_path):
    raw = whole.read_bytes()
    chunk = raw.index(b"\x04\0\0\0zstd", len(raw) // 2) - 9 - 28
    for at in range(chunk + 1, chunk + 9):
        for bit in (0, 3, 7):
            lost, box = lost_rows(tmp_path / "x.mcap", changed(whole, at, bit))
            assert 0 < lost <= 100
            assert box.damaged >= 1


def test_cut_off_anywhere_in_the_last_second(whole, tmp_path):
    raw, path = whole.read_bytes(), tmp_path / "x.mcap"
    marks = [i for i in range(len(raw)) if raw.startswith(b"\x04\0\0\0zstd", i)]
    starts = [i - 37 for i in marks if raw[i - 37] == 6]
    ends = [s + 9 + int.from_bytes(raw[s + 1 : s + 9], "little") for s in starts]
    path.write_bytes(raw[: ends[-15]])
    before = len(read(path).topics[EFFORT.topic])
    assert TICKS - before >= 1000
    cuts = sorted({*range(ends[-15], ends[-1], 61), *ends, *(e - 1 for e in ends)})
    for stop in cuts[cuts.index(ends[-15]) :]:
        path.write_bytes(raw[:stop])
        box = read(path)
        kept = len(box.topics[EFFORT.topic])
        assert (box.metadata, box.truncated, len(box.attachments)) == (RECORDS, True, 2)
        # a chunk counts from its last byte on, and none holds more than 100 ms
        assert (kept > before) == (stop in ends[-14:])
        assert 0 <= kept - before <= 100
        before = kept


def test_garbage_between_records_is_stepped_over(whole, tmp_path):
    raw = whole.read_bytes()
    chunk = raw.index(b"\x04\0\0\0zstd", len(raw) // 2) - 37
    rubbish = np.random.default_rng(1).integers(0, 256, 5000).astype(np.uint8).tobytes()
    # nothing of the summary is where it says any more
    lost, box = lost_rows(tmp_path / "x.mcap", raw[:chunk] + rubbish + raw[chunk:])
    assert lost == 0
    assert box.damaged == 1


def readers(path):
    """Messages that a streaming and an indexed reader of the format find, checksums verified."""
    with path.open("rb") as file:
        streamed = sum(
            type(r).__name__ == "Message" for r in StreamReader(file, validate_crcs=True).records
        )
    with path.open("rb") as file:
        indexed = len(list(make_reader(file, validate_crcs=True).iter_messages()))
    return streamed, indexed


@pytest.mark.parametrize("harm", ["killed", "bit"])
def test_what_is_recovered_opens_in_every_reader(whole, tmp_path, capsys, harm):
    raw = whole.read_bytes()
    bad, good = tmp_path / "bad.mcap", tmp_path / "good.mcap"
    middle = raw.index(b"\x04\0\0\0zstd", len(raw) // 2)
    bad.write_bytes(raw[: middle + 500] if harm == "killed" else changed(whole, middle + 500, 3))
    with pytest.raises((McapError, ValueError, struct.error)):
        readers(bad)
    assert main(["info", str(bad)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert ("refuses the file" if harm == "killed" else "shows wrong numbers") in said
    assert main(["info", str(bad), "--recover", str(good)]) == 0
    box = read(good)
    assert (box.damaged, box.truncated, box.metadata) == (0, False, RECORDS)
    kept = sum(len(t) for t in box.topics.values())
    assert readers(good) == (kept, kept)
    assert kept >= (2 * TICKS - 200 if harm == "bit" else TICKS - 200)


def test_the_bench_counts_what_damage_costs():
    found = record_speed.damage(flips=40, stride=5000)
    assert (found.flips, found.unreadable) == (40, 0)
    assert found.cuts >= 10
    assert 0 <= found.flip_lost <= 100
    assert 0 < found.cut_lost <= 100
