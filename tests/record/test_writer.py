"""The session file: what is in it, in which order, and that other readers read it."""

from __future__ import annotations

import json
import subprocess
import sys

import mcap.writer
import numpy as np
import plants
import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

from hil.errors import ConfigError
from hil.record.export import write_recordings
from hil.record.mcap_read import load, read_attachments, read_metadata
from hil.record.mcap_write import CHUNK_BYTES, CHUNK_NS, SessionWriter
from hil.record.recovery import ChunkIndices
from hil.record.schema import Channel

STATE = Channel("/arm/measured_js", "joint_state", ("a", "b"), ("position",))
EFFORT = Channel("/arm/setpoint_jf", "joint_state", ("a", "b"), ("effort",))
WIDE = Channel("/rig/raw", "fields", tuple(f"w{k}" for k in range(300)))
START = 1_700_000_000 * 10**9


def write(path, ticks=500, channels=(STATE, EFFORT), start=START, **options):
    files, records = {"a.toml": b"x = 1"}, {"session": {"seed": "1"}}
    with SessionWriter(path, channels, records, files, **options) as w:
        for k in range(ticks):
            for c in channels:
                w.write(c.topic, k + 1, start + k * 10**6, np.full(c.width, k * 0.5))
            if k == 20:
                w.event(k + 1, start + k * 10**6, "contact", {"force": 1.5})
    return path


def records(path):
    with path.open("rb") as file:
        return list(StreamReader(file, emit_chunks=True).records)


def kinds(path):
    return [type(r).__name__ for r in records(path)]


def test_another_reader_reads_it_in_order(tmp_path):
    path = write(tmp_path / "s.mcap")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert (reader.get_header().profile, reader.get_header().library) == ("ros2", "hil")
        rows = list(reader.iter_decoded_messages(topics=["/arm/setpoint_jf"]))
    assert len(rows) == 500
    for k, (schema, _, raw, message) in enumerate(rows):
        assert schema.name == "sensor_msgs/msg/JointState"
        assert (raw.sequence, raw.log_time, raw.publish_time) == (
            k + 1,
            START + k * 10**6,
            START + k * 10**6,
        )
        assert list(message.effort) == [k * 0.5] * 2
        assert not message.position


def test_events_are_json_with_a_schema(tmp_path):
    with write(tmp_path / "s.mcap").open("rb") as file:
        ((schema, channel, raw),) = make_reader(file).iter_messages(topics=["/events"])
    assert (schema.encoding, channel.message_encoding, raw.sequence) == ("jsonschema", "json", 21)
    assert json.loads(raw.data) == {"data": {"force": 1.5}, "name": "contact", "tick": 21}
    assert json.loads(schema.data)["type"] == "object"


def test_metadata_and_attachments_come_first(tmp_path):
    path = write(tmp_path / "s.mcap")
    files, definitions = ["Attachment"] * 3, ["Schema", "Channel", "Channel"]
    assert kinds(path)[:9] == ["Header", "Metadata", *files, *definitions, "Chunk"]
    assert read_metadata(path) == {"session": {"seed": "1"}}
    assert read_attachments(path) == {"a.toml": b"x = 1"}


@pytest.mark.parametrize("channels", [(STATE,), (STATE, EFFORT, WIDE)])
def test_chunks_are_small_in_bytes_and_time(tmp_path, channels):
    chunks = [
        r
        for r in records(write(tmp_path / "s.mcap", channels=channels))
        if type(r).__name__ == "Chunk"
    ]
    assert len(chunks) >= 5
    assert max(c.uncompressed_size for c in chunks) <= CHUNK_BYTES
    assert max(c.message_end_time - c.message_start_time for c in chunks) <= CHUNK_NS
    assert {c.compression for c in chunks} == {"zstd"}


def test_the_same_input_makes_the_same_bytes(tmp_path):
    one, two = (write(tmp_path / f"{n}.mcap").read_bytes() for n in "ab")
    assert one == two


def test_mcap_without_a_public_flush(tmp_path, monkeypatch):
    usual = write(tmp_path / "a.mcap").read_bytes()
    monkeypatch.delattr(mcap.writer.Writer, "flush", raising=False)
    assert write(tmp_path / "b.mcap").read_bytes() == usual


def test_a_killed_process_loses_a_tenth_of_a_second_at_most(tmp_path):
    path = tmp_path / "s.mcap"
    program = f"""
import os
from hil.record.schema import Channel
from hil.record.mcap_write import SessionWriter
names = ("a", "b")
writer = SessionWriter({str(path)!r}, [
    Channel("/arm/measured_js", "joint_state", names, ("position",)),
    Channel("/arm/setpoint_jf", "joint_state", names, ("effort",))], {{"session": {{}}}})
for k in range(1234):
    writer.write("/arm/measured_js", k + 1, k * 10**6, [k, k])
    writer.write("/arm/setpoint_jf", k + 1, k * 10**6, [k, k])
os.kill(os.getpid(), 9)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -9
    left = load(path)
    assert 1134 <= left.n <= 1234
    np.testing.assert_array_equal(left.tau[:, 1], np.arange(left.n))
    assert "cut off" in left.metadata["note"]


def test_an_existing_file_is_kept_on_request(tmp_path):
    path = write(tmp_path / "s.mcap")
    before = path.read_bytes()
    with pytest.raises(ConfigError, match="exists"):
        write(path, overwrite=False)
    with pytest.raises(ConfigError, match="one topic"):
        write(path, channels=(STATE, STATE))
    assert path.read_bytes() == before


def test_no_such_folder(tmp_path):
    with pytest.raises(ConfigError, match="cannot write session"):
        write(tmp_path / "none" / "s.mcap")


def test_wrong_topic_or_width(tmp_path):
    with SessionWriter(tmp_path / "s.mcap", [STATE], {}) as w:
        with pytest.raises(ConfigError, match="Did you mean '/arm/measured_js'"):
            w.write("/arm/measured_jp", 1, 0, [0.0, 0.0])
        with pytest.raises(ConfigError, match="takes 2 values, got 3"):
            w.write("/arm/measured_js", 1, 0, [0.0] * 3)


def test_a_recording_comes_back_whole(tmp_path):
    r = plants.joints(d=3)
    rng = np.random.default_rng(0)
    from dataclasses import replace

    full = replace(
        r,
        tau_ext=rng.normal(size=r.q.shape),
        wrench=rng.normal(size=(r.n, 6)),
        current=rng.normal(size=r.q.shape),
        temperature=rng.normal(size=r.q.shape),
    )
    write_recordings(tmp_path / "s.mcap", [full])
    back = load(tmp_path / "s.mcap")
    for key in ("q", "qd", "tau", "tau_ext", "wrench", "current", "temperature"):
        np.testing.assert_array_equal(getattr(back, key), getattr(full, key))
    np.testing.assert_allclose(back.t, full.t, atol=1e-9)
    assert (back.joints, back.arm, back.robot) == (full.joints, full.arm, full.robot)


def test_indices_of_chunks_come_back_in_order_across_blocks(monkeypatch):
    monkeypatch.setattr(ChunkIndices, "BLOCK", 500)
    given = [
        ChunkIndex(100 + k, 7 * k, "zstd", 90, k + 1, 64, {1: k, 3: 2 * k}, k, 4000 + k)
        for k in range(40)
    ]
    kept = ChunkIndices()
    for index in given:
        kept.append(index)
    assert list(kept) == given
    assert list(kept) == given  # a summary may be written again
