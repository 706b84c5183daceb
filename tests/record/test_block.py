"""Rows written in blocks are the messages written one by one, to the byte."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.errors import ConfigError
from hil.record import mcap_write
from hil.record.mcap_write import SessionWriter
from hil.record.schema import Channel, encoder, places

CHANNELS = [
    Channel(
        "/arm/measured_js", "joint_state", ("joint1", "a_longer_one"), ("position", "velocity")
    ),
    Channel("/arm/setpoint_jf", "joint_state", ("joint1", "x"), ("effort",)),
    Channel("/arm/measured_cf", "wrench", frame="base"),
    Channel("/loop/timing", "fields", ("a", "b", "c"), units=("ns",) * 3, message="hil_msgs/msg/T"),
]
TOPICS = [
    ("/arm/measured_js", slice(2, 6)),
    ("/arm/setpoint_jf", slice(0, 2)),
    ("/arm/measured_cf", slice(6, 12)),
    ("/loop/timing", slice(12, 15)),
]


def write(path, bursts, rows_at_once):
    with SessionWriter(path, CHANNELS, {"session": {"a": "b"}}) as writer:
        tick = 0
        for n, step, seed in bursts:
            data = np.random.default_rng(seed).standard_normal((n, 15))
            stamps = np.array([[tick + k + 1, (tick + k + 1) * step] for k in range(n)], np.int64)
            stamps = stamps.reshape(-1, 2)
            tick += n
            if rows_at_once:
                writer.write_rows(TOPICS, stamps, data)
            else:
                for (k, t), row in zip(stamps.tolist(), data.tolist(), strict=True):
                    for topic, columns in TOPICS:
                        writer.write(topic, k, t, row[columns])
            writer.event(tick, tick * step, "burst", {"n": n})
        count = writer.messages
    return path.read_bytes(), count


@given(st.lists(st.tuples(st.integers(0, 150), st.just(1_000_000), st.integers(0, 9)), max_size=8))
@settings(deadline=None, max_examples=30)
def test_blocks_are_messages(tmp_path_factory, bursts):
    folder = tmp_path_factory.mktemp("block")
    assert write(folder / "a.mcap", bursts, True) == write(folder / "b.mcap", bursts, False)


def test_slow_ticks_close_chunks_by_time(tmp_path):
    bursts = [(7, 40_000_000, 1), (30, 40_000_000, 2)]
    one = write(tmp_path / "a.mcap", bursts, True)
    assert one == write(tmp_path / "b.mcap", bursts, False)


def test_another_release_of_mcap_gets_messages(tmp_path, monkeypatch):
    bursts = [(100, 1_000_000, 1), (40, 1_000_000, 2)]
    fast = write(tmp_path / "a.mcap", bursts, True)
    monkeypatch.setattr("hil.record.mcap_write.appender", lambda w, full: mcap_write._one_by_one(w))
    assert write(tmp_path / "b.mcap", bursts, True) == fast


@pytest.mark.parametrize("channel", CHANNELS)
def test_values_stand_where_it_is_said(channel):
    values = [float(k + 1) for k in range(channel.width)]
    raw = encoder(channel)(0, values)
    assert [np.frombuffer(raw, "<f8", 1, at)[0] for at in places(channel)] == values


def test_mistakes_are_named(tmp_path):
    with SessionWriter(tmp_path / "s.mcap", CHANNELS, {}) as writer:
        none, zeros = np.zeros((1, 2), np.int64), np.zeros((1, 15))
        with pytest.raises(ConfigError, match="Did you mean '/loop/timing'"):
            writer.write_rows([("/loop/timin", slice(0, 3))], none, zeros)
        with pytest.raises(ConfigError, match="takes 3 values, got 4"):
            writer.write_rows([("/loop/timing", slice(0, 4))], none, zeros)
