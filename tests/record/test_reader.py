"""Reading: any cut, any damage, other writers; never a wrong number, never a traceback."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plants
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from record_tables import URDF

from hil.cli import main
from hil.errors import DataError, HilError
from hil.record import container
from hil.record.checks import check
from hil.record.export import write_recordings
from hil.record.mcap_read import arms, load, read_metadata, summary
from hil.record.mcap_write import SessionWriter
from hil.record.recording import RobotSource
from hil.record.recovery import recover
from hil.record.schema import Channel, read_fields
from hil.record.sources import load_sources

R = plants.joints(seconds=3.0)
FULL = replace(R, wrench=np.random.default_rng(1).normal(size=(R.n, 6)), tau_ext=2 * R.tau)


class Whole(bytes):
    """Session of two arms; short in messages of hypothesis."""

    def __repr__(self) -> str:
        return f"<{len(self)} bytes>"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "s.mcap"
    write_recordings(path, [FULL, replace(R, arm="tail")], {"session": {"seed": "3"}})
    return Whole(path.read_bytes())


def size_of_preamble(raw: bytes) -> int:
    """Where the first chunk ends, 9 bytes of record header each."""
    at = 8
    while raw[at] != 6:
        at += 9 + int.from_bytes(raw[at + 1 : at + 9], "little")
    return at + 9 + int.from_bytes(raw[at + 1 : at + 9], "little")


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1))
def test_cut_anywhere_leaves_a_prefix(share, whole, tmp_path):
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: int(share * len(whole))])
    if share * len(whole) < size_of_preamble(whole):
        with pytest.raises(DataError):
            load(path, "arm")
        return
    left = load(path, "arm")
    assert 0 < left.n <= R.n
    for key in ("q", "qd", "tau", "tau_ext", "wrench"):
        np.testing.assert_array_equal(getattr(left, key), getattr(FULL, key)[: left.n])
    if int(share * len(whole)) < len(whole):
        assert summary(path).truncated
        assert "cut off" in left.metadata["note"]
    assert read_metadata(path)["session"] == {"seed": "3"}


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(0), value=st.integers(0, 255), times=st.integers(1, 40))
def test_damaged_bytes_never_give_a_wrong_number(at, value, times, whole, tmp_path):
    first = size_of_preamble(whole)
    raw = bytearray(whole)
    at = first + at % (len(raw) - first)
    raw[at : at + times] = bytes([value]) * len(raw[at : at + times])
    path = tmp_path / "damaged.mcap"
    path.write_bytes(raw)
    try:
        left = load(path, "arm")
    except HilError:
        return
    rows = np.searchsorted(FULL.t, left.t - 1e-6)
    exact = np.abs(FULL.t[rows] - left.t) < 1e-8
    assert exact.all()
    np.testing.assert_array_equal(left.q, FULL.q[rows])
    np.testing.assert_array_equal(left.tau, FULL.tau[rows])


def test_a_damaged_chunk_is_told_and_left_out(whole, tmp_path, capsys):
    raw = bytearray(whole)
    raw[size_of_preamble(whole) + 4000] ^= 0xFF
    path = tmp_path / "s.mcap"
    path.write_bytes(raw)
    found = summary(path)
    if not found.damaged:  # the byte belongs to an index
        raw[size_of_preamble(whole) + 9000] ^= 0xFF
        path.write_bytes(raw)
    assert summary(path).damaged == 1
    assert "1 damaged records" in load(path, "arm").metadata["note"]
    assert main(["info", str(path)]) == 0
    assert "the file is damaged" in capsys.readouterr().out


def test_recovery_keeps_every_channel_and_byte(tmp_path):
    source, target = tmp_path / "s.mcap", tmp_path / "r.mcap"
    state = Channel("/arm/measured_js", "joint_state", ("a",), ("position", "effort"))
    raw = Channel("/rig/raw", "fields", ("count",), units=("1",), message="hil_msgs/msg/Raw")
    with SessionWriter(source, [state, raw], {"session": {"seed": "1"}}, {"rig.toml": b"r"}) as w:
        w.event(1, 1, "enabled", {})
        for k in range(1000):
            w.write("/arm/measured_js", k + 1, k * 10**6, [k, -k])
            w.write("/rig/raw", k + 1, k * 10**6, [k])
    before = source.read_bytes()
    source.write_bytes(before[: 2 * len(before) // 3])
    kept = recover(source, target)
    assert not summary(target).truncated
    with target.open("rb") as file:
        messages = list(make_reader(file, validate_crcs=True).iter_messages())
    assert len(messages) == kept
    (tmp_path / "w.mcap").write_bytes(before)
    with (tmp_path / "w.mcap").open("rb") as file:
        original = {(c.topic, m.sequence): m for _, c, m in make_reader(file).iter_messages()}
    for _, channel, message in messages:
        assert message.data == original[channel.topic, message.sequence].data
    assert {c.topic for _, c, _ in messages} == {"/arm/measured_js", "/rig/raw", "/events"}
    assert summary(target).attachments == ("rig.toml",)
    with pytest.raises(HilError, match="exists"):
        recover(source, target)


def test_nothing_to_recover(whole, tmp_path, capsys):
    path = tmp_path / "s.mcap"
    path.write_bytes(whole[: size_of_preamble(whole) - 1])
    assert main(["info", str(path), "--recover", str(tmp_path / "r.mcap")]) == 2
    assert "nothing to recover" in capsys.readouterr().err
    assert not (tmp_path / "r.mcap").exists()


def test_arms(whole, tmp_path):
    path = tmp_path / "s.mcap"
    path.write_bytes(whole)
    assert arms(path) == ("arm", "tail")
    assert "using 'arm'" in load(path).metadata["note"]
    assert "note" not in load(path, "tail").metadata
    assert [r.arm for r in load_sources([path, path], (), "tail")[0]] == ["tail", "tail"]
    with pytest.raises(DataError, match="Did you mean 'tail'"):
        load(path, "tial")


def test_the_urdf_travels_with_the_session(tmp_path):
    r = replace(R, joints=("shoulder", "elbow"), robot=RobotSource("", URDF, "tip"))
    write_recordings(tmp_path / "s.mcap", [r])
    assert load(tmp_path / "s.mcap").robot == r.robot


def session(path, channels, rows=50, values=None):
    with SessionWriter(path, channels, {}) as w:
        for k in range(rows):
            for c in channels:
                w.write(c.topic, k + 1, k * 10**6, values or range(c.width))
    return path


def test_efforts_in_another_order_of_joints(tmp_path):
    state = Channel("/arm/measured_js", "joint_state", ("a", "b"), ("position",))
    effort = Channel("/arm/setpoint_jf", "joint_state", ("b", "a"), ("effort",))
    r = load(session(tmp_path / "s.mcap", [state, effort], values=[10.0, 20.0]))
    assert r.q[0].tolist() == [10, 20]
    assert r.tau[0].tolist() == [20, 10]


def test_effort_of_the_state_where_there_is_no_setpoint(tmp_path):
    state = Channel("/arm/measured_js", "joint_state", ("a", "b"), ("position", "effort"))
    assert load(session(tmp_path / "s.mcap", [state])).tau[0].tolist() == [2, 3]


@pytest.mark.parametrize(
    ("channels", "word"),
    [
        ([Channel("/arm/measured_js", "joint_state", ("a",), ("position",))], "no motor effort"),
        ([Channel("/arm/measured_js", "joint_state", ("a",), ("effort",))], "no position"),
        ([Channel("/arm/measured_js", "fields", ("a",))], "expected sensor_msgs/msg/JointState"),
        ([Channel("/x/y", "fields", ("a",))], "no /<arm>/measured_js channel. It has: /x/y"),
        (
            [
                Channel("/arm/measured_js", "joint_state", ("a",), ("position",)),
                Channel("/arm/setpoint_jf", "joint_state", ("b",), ("effort",)),
            ],
            "1 numbers a message of b",
        ),
    ],
)
def test_sessions_without_what_is_needed(tmp_path, channels, word):
    with pytest.raises(DataError) as caught:
        load(session(tmp_path / "s.mcap", channels))
    assert word in str(caught.value)


def test_json_instead_of_cdr(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "s.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/JointState", "jsonschema", b"{}")
        channel = writer.register_channel("/arm/measured_js", "json", schema)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(DataError, match="encoded as 'json'; expected ROS 2 CDR"):
        load(tmp_path / "s.mcap")


def test_slow_channels_are_interpolated_and_do_not_shorten(tmp_path):
    state = Channel("/arm/measured_js", "joint_state", ("a",), ("position", "effort"))
    heat = Channel("/arm/motor_temperature", "fields", ("a",), units=("degC",))
    with SessionWriter(tmp_path / "s.mcap", [state, heat], {}) as w:
        for k in range(100):
            w.write(state.topic, k + 1, k * 10**6, [k, 0])
            if k in (0, 50):
                w.write(heat.topic, k + 1, k * 10**6, [20 + k])
    r = load(tmp_path / "s.mcap")
    assert r.n == 100
    assert r.temperature[25, 0] == 45


def test_any_channel_of_numbers(tmp_path):
    state = Channel("/arm/measured_js", "joint_state", ("a", "b"), ("position", "effort"))
    force = Channel("/arm/measured_cf", "wrench", frame="base")
    raw = Channel("/rig/raw", "fields", ("count", "word_2"), units=("1", "1"))
    path = session(tmp_path / "s.mcap", [state, force, raw])
    t, fields = read_fields(path, "/rig/raw")
    np.testing.assert_allclose(t, np.arange(50) * 1e-3)
    assert {n: v[0] for n, v in fields.items()} == {"count": 0, "word_2": 1}
    assert {n: v[9] for n, v in read_fields(path, "/arm/measured_js")[1].items()} == {
        "position.a": 0,
        "position.b": 1,
        "effort.a": 2,
        "effort.b": 3,
    }
    assert list(read_fields(path, "/arm/measured_cf")[1]) == ["fx", "fy", "fz", "tx", "ty", "tz"]
    with pytest.raises(DataError, match="Did you mean '/rig/raw'"):
        read_fields(path, "/rig/row")
    with SessionWriter(tmp_path / "e.mcap", [state], {}) as w:
        w.event(1, 0, "enabled", {})
    with pytest.raises(DataError, match="encoded as 'json'"):
        read_fields(tmp_path / "e.mcap", "/events")


def test_chunks_that_claim_more_than_a_file_may_hold(whole, tmp_path, monkeypatch):
    raw = bytearray(whole)
    magic = b"\x28\xb5\x2f\xfd"  # of zstd: then a descriptor and the size of the content
    frame = raw.index(magic, raw.index(magic) + 4)  # the first one has the channels
    assert raw[frame + 4] >> 6 < 3
    chunk = frame - 8 - 4 - 4 - 4 - 8  # size of the records, compression, checksum, claimed size
    assert raw[chunk + 16 : chunk + 20] == b"zstd"
    for claim in (2**40, 2**63, 2**28 + 1):
        raw[chunk : chunk + 8] = claim.to_bytes(8, "little")
        (tmp_path / "s.mcap").write_bytes(raw)
        found = summary(tmp_path / "s.mcap")
        assert found.damaged == 1
    # a frame of eight bytes of size says a terabyte
    at = raw.index(magic, frame + 4)
    raw[at + 4 : at + 13] = b"\xe0" + (2**40).to_bytes(8, "little")
    (tmp_path / "s.mcap").write_bytes(raw)
    assert summary(tmp_path / "s.mcap").damaged == 2
    # many chunks that each claim a little
    monkeypatch.setattr(container, "_ROOM", 0)
    monkeypatch.setattr(container, "RATIO", 1)
    (tmp_path / "s.mcap").write_bytes(whole)
    assert summary(tmp_path / "s.mcap").damaged > 1


def test_a_chunk_of_millions_of_messages_in_a_small_file_is_left_out(tmp_path):
    path = tmp_path / "s.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2**30)
        writer.start()
        number = writer.register_channel("/a", "json", 0)
        for _ in range(30):
            writer.add_message(number, 1, bytes(2**20), 1)
        writer.finish()
    assert path.stat().st_size < 50_000
    box = container.read(path)
    assert (len(box.topics["/a"]), box.damaged) == (0, 1)


def test_a_device_is_no_session(tmp_path, capsys):
    (tmp_path / "s.mcap").symlink_to("/dev/zero")
    assert main(["info", str(tmp_path / "s.mcap")]) == 2
    assert "not a regular file" in capsys.readouterr().err


def test_a_sample_rate_that_no_rig_has(tmp_path):
    run = plants.joints()
    (fault,) = [f for f in check(replace(run, t=1e-15 * np.arange(run.n))) if f.severity == "error"]
    assert fault.code == "sample-rate" and "1e-15 s" in fault.sentence
