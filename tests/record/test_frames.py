"""Wire frames in a session, and a recording in place of a device."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from hil.cli import main
from hil.commands.run import replay_differences
from hil.errors import ConfigError, DataError, DeviceError
from hil.record.container import read
from hil.record.frames import (
    RX,
    START,
    TX,
    BoundedFrameLog,
    Frame,
    RecordedAnswers,
    decode,
    encode,
    read_frames,
)
from hil.record.mcap_read import summary
from hil.record.schema import read_fields
from hil.rig.config import load_rig
from hil.rig.open import open_rig
from hil.runtime import runner
from hil.runtime.session import rig_text
from hil.sim_devices.force.netcanoem import NetCanOemBoard
from hil.sim_devices.usb.quad08 import SimQuad08

RIG = Path(__file__).parents[2] / "rigs" / "identify.toml"
#: Arms on ideal wires, the follower's force sensor on its bus.
ARMS = {name: {"backend": "sim"} for name in ("leader-arm", "follower-arm", "leader-force")}
RDT = {"follower-ft": {"driver": "netft-rdt", "address": "192.168.1.1"}}


def run(path, backend, boxes=None, seconds=0.3, **record):
    over = {"devices": {**ARMS, "follower-force": {"backend": backend}}, "record": record}
    config = load_rig(RIG, {**over, "boxes": boxes or {}})
    runner.run_session(config, seconds, seed=3, output=path)
    return path


def words(path):
    _, fields = read_fields(path, "/rig/raw")
    return np.array([fields[f"follower_gauge{k}"] for k in range(1, 7)])


@settings(deadline=None)
@given(st.integers(0, 2**63), st.text(max_size=9), st.binary(max_size=70), st.integers(0, 2**40))
def test_a_frame_survives_its_message(t_ns, key, data, stamp):
    frame = Frame(t_ns, RX, key.replace("\x00", ""), data)
    assert decode(encode(frame, stamp)) == frame


@given(st.binary(max_size=60))
def test_any_bytes_are_a_frame_or_refused(data):
    try:
        frame = decode(data)
    except DataError as error:
        assert str(error)
    else:
        assert decode(encode(frame, 0)) == frame


def test_frames_are_read_by_other_readers_of_mcap(tmp_path):
    path = run(tmp_path / "s.mcap", "sim-wire", frames=True)
    mine = read_frames(path, "follower-ft")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        theirs = [m for *_, m in reader.iter_decoded_messages(topics=["/frames/follower-ft"])]
    assert len(mine) == len(theirs) > 900
    for a, b in zip(mine, theirs, strict=True):
        assert (a.t_ns, a.kind, a.key, a.data) == (b.loop_ns, b.kind, b.key, bytes(b.data))
    polls = [f for f in mine if f.kind == TX and f.key == "210"]
    assert len(polls) >= 300


def test_without_the_switch_there_are_none_and_the_message_says_so(tmp_path):
    path = run(tmp_path / "s.mcap", "sim-wire")
    with pytest.raises(DataError, match=r"frames = true"):
        read_frames(path, "follower-ft")


@pytest.mark.parametrize("boxes", [{}, RDT])
def test_a_failure_in_the_field_comes_again_on_the_desk(tmp_path, monkeypatch, boxes):
    if not boxes:
        # lost and late second frames, and a gauge at its rail for a while
        asked, answer = [0], NetCanOemBoard.hear

        def hear(self, frame, t_ns):
            asked[0] += 1
            faults = self.faults
            faults.lose_second = int(asked[0] % 31 == 0)
            faults.delay_second = int(asked[0] % 47 == 0)
            faults.stuck = {3: 32767} if 300 < asked[0] < 310 else {}
            answer(self, frame, t_ns)

        monkeypatch.setattr(NetCanOemBoard, "hear", hear)
    field = run(tmp_path / "field.mcap", "sim-wire", boxes, frames=True)
    monkeypatch.undo()
    desk = run(tmp_path / "desk.mcap", "replay", boxes, replay=str(field))
    np.testing.assert_array_equal(words(desk), words(field))
    assert len(np.unique(words(field)[0])) > 5
    _, fields = read_fields(field, "/loop/timing")
    _, again = read_fields(desk, "/loop/timing")
    np.testing.assert_array_equal(fields["status"], again["status"])


def test_a_driver_that_now_asks_something_else_is_told_apart(tmp_path):
    field = run(tmp_path / "field.mcap", "sim-wire", frames=True)
    over = {
        "devices": {**ARMS, "follower-force": {"backend": "replay"}},
        "record": {"replay": str(field)},
    }
    rig = open_rig(load_rig(RIG, over), 0)
    replay = rig.taps.replays["follower-ft"]
    assert replay.other == 0
    assert rig.taps.told()["replay/follower-ft"]["other"] == "0"
    replay.put("20f", b"\x01")
    assert "20f 01 now" in replay.differences[0]
    rig.close()


def test_answers_wait_for_their_time_and_their_question():
    frames = [
        Frame(50, START),
        Frame(50, TX, "a", b"1"),
        Frame(60, RX, "b", b"2"),
        Frame(70, TX, "a", b"1"),
        Frame(70, RX, "b", b"3"),
    ]
    replay = RecordedAnswers("box", frames)
    replay.advance(1000)
    assert replay.take(True) is None
    replay.put("a", b"1")
    assert replay.take(False) is None
    replay.advance(1010)
    assert replay.take(False).data == b"2"
    assert replay.take(True) is None
    replay.put("a", b"9")
    assert replay.take(True).data == b"3"
    assert replay.over
    assert replay.other == 1


def test_a_full_log_drops_and_counts(monkeypatch):
    monkeypatch.setattr("hil.record.frames.MOST_WAITING", 3)
    log = BoundedFrameLog()
    for k in range(5):
        log.add(TX, "", bytes([k]))
    assert log.dropped == 2
    assert [f.data[0] for f in log.take()] == [0, 1, 2]
    assert log.take() == []


def test_what_a_replay_needs_is_asked_for(tmp_path):
    with pytest.raises(ConfigError, match=r"replay = 'S\.mcap'"):
        run(tmp_path / "s.mcap", "replay")
    path = run(tmp_path / "s.mcap", "sim-wire", frames=True)
    with pytest.raises(DataError, match="Available: follower-ft"):
        read_frames(path, "leader-ft")


def whole(path, backend, seconds=0.5, **record):
    config = load_rig(RIG, {"backend": backend, "record": record})
    runner.run_session(config, seconds, seed=3, output=path)
    return read_fields(path, "/rig/raw")[1]


def test_a_whole_rig_comes_again_from_its_frames(tmp_path):
    field = whole(tmp_path / "field.mcap", "sim-wire", frames=True)
    desk = whole(tmp_path / "desk.mcap", "replay", replay=str(tmp_path / "field.mcap"))
    for name, values in field.items():  # counts, gauges and codes
        np.testing.assert_array_equal(desk[name], values)
    told = summary(tmp_path / "desk.mcap").metadata
    assert int(told["replay/leader-ft"]["asked"]) > 1000
    assert told["replay/leader-ft"]["other"] == "0"
    said = replay_differences(str(tmp_path / "desk.mcap"))
    assert said and all("-motor" in line and "frames sent are others" in line for line in said)
    assert summary(tmp_path / "field.mcap").metadata["frames/encoders"] == {"dropped": "0"}
    assert max(np.ptp(field[f"follower_count{k}"]) for k in (1, 2, 3)) > 50


def test_a_replay_beyond_its_recording_says_where_that_ends(tmp_path):
    field, desk = tmp_path / "field.mcap", tmp_path / "desk.mcap"
    whole(field, "sim-wire", frames=True)
    with pytest.raises(ConfigError, match=r"field\.mcap ends at 0\.5 s, take --seconds") as error:
        whole(desk, "replay", 1.0, replay=str(field))
    assert "plug it in" not in str(error.value)
    assert read_fields(desk, "/rig/raw")[0].size > 500


def test_an_encoder_box_that_was_unplugged_is_unplugged_again(tmp_path, monkeypatch):
    def said(path, backend, **record):
        with pytest.raises(DeviceError) as error:
            whole(path, backend, **record)
        return str(error.value).replace(str(path), "PATH")

    tick, stops = SimQuad08.tick, [0]

    def unplugged(self, now_ns):
        stops[0] += 1
        if stops[0] == 700:
            self.plugged = False
        tick(self, now_ns)

    monkeypatch.setattr(SimQuad08, "tick", unplugged)
    field = said(tmp_path / "field.mcap", "sim-wire", frames=True)
    monkeypatch.undo()
    desk = said(tmp_path / "desk.mcap", "replay", replay=str(tmp_path / "field.mcap"))
    assert "unplugged" in field
    assert desk == field


@pytest.mark.real_time
def test_frames_have_the_log_time_of_their_tick(tmp_path):
    over = {
        "devices": {**ARMS, "follower-force": {"backend": "sim-wire"}},
        "record": {"frames": True},
    }
    runner.run_session(load_rig(RIG, over), 0.2, seed=3, clock="real", output=tmp_path / "s.mcap")
    topics = read(tmp_path / "s.mcap").topics
    rows, frames = topics["/rig/raw"].times, topics["/frames/follower-ft"].times
    # frames from before tick 0 have its log time; a loaded machine may miss the first ticks
    assert rows[0] - frames[0] == topics["/rig/raw"].sequence[0] * 1_000_000
    assert frames[-1] <= rows[-1] + 1_000_000
    assert frames == sorted(frames)


def test_hil_run_says_where_a_driver_asks_something_else(tmp_path, capsys):
    field = run(tmp_path / "field.mcap", "sim-wire", frames=True)
    over = {
        "devices": {**ARMS, "follower-force": {"backend": "replay"}},
        "record": {"replay": str(field)},
        "boxes": {"follower-ft": {"options": {"calibration": 3}}},
    }
    rig = tmp_path / "desk.toml"
    config = load_rig(RIG, over)
    rig.write_text(rig_text(config), encoding="utf-8")
    # slot 3 instead of 0: the recorded echo gives it away
    assert main(["run", str(rig), "--seconds", "0.1", "-o", str(tmp_path / "x.mcap")]) == 3
    assert "asked for calibration 3, the board echoes 00" in capsys.readouterr().err
    rig.write_text(
        rig_text(
            load_rig(RIG, {**over, "boxes": {"follower-ft": {"options": {"answer_ms": 3.0}}}})
        ),
        encoding="utf-8",
    )
    assert main(["run", str(rig), "--seconds", "0.1", "-o", str(tmp_path / "x.mcap")]) == 0
    assert replay_differences(str(tmp_path / "x.mcap")) == []
