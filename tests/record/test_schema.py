"""The encoding, read back by an independent decoder of ROS 2 messages."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from hil.errors import ConfigError
from hil.record.schema import PARTS, Channel, encoder

text = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9)
joints = st.lists(text, min_size=1, max_size=8, unique=True).map(tuple)
field_names = st.lists(
    st.from_regex(r"[a-z][a-z0-9]{0,5}(_[a-z0-9]{1,3})?", fullmatch=True),
    min_size=1,
    max_size=8,
    unique=True,
).map(tuple)
stamps = st.integers(0, 2**31 * 10**9 - 1)
parts = st.sets(st.sampled_from(PARTS), min_size=1).map(lambda s: tuple(p for p in PARTS if p in s))


def decoded(channel: Channel, t_ns: int, values: list[float]):
    name, definition = channel.schema()
    schema = Schema(id=1, name=name, encoding="ros2msg", data=definition.encode())
    decode = DecoderFactory().decoder_for("cdr", schema)
    assert decode is not None
    return decode(encoder(channel)(t_ns, values))


def numbers(data, n: int) -> list[float]:
    return data.draw(st.lists(st.floats(width=64), min_size=n, max_size=n))


def same(got, want) -> bool:
    pairs = zip(got, want, strict=True)
    return all(
        math.isnan(b) if math.isnan(a) else (a, math.copysign(1, a)) == (b, math.copysign(1, b))
        for a, b in pairs
    )


@settings(deadline=None)
@given(names=joints, held=parts, frame=text, t_ns=stamps, data=st.data())
def test_joint_state(names, held, frame, t_ns, data):
    channel = Channel("/arm/measured_js", "joint_state", names, held, frame=frame)
    values = numbers(data, channel.width)
    message = decoded(channel, t_ns, values)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(t_ns, 10**9)
    assert message.header.frame_id == frame
    assert tuple(message.name) == names
    got = [x for p in PARTS for x in getattr(message, p)]
    assert same(got, values)
    assert all(len(getattr(message, p)) == (len(names) if p in held else 0) for p in PARTS)


@settings(deadline=None)
@given(frame=text, t_ns=stamps, data=st.data())
def test_wrench(frame, t_ns, data):
    values = numbers(data, 6)
    message = decoded(Channel("/arm/measured_cf", "wrench", frame=frame), t_ns, values)
    force, torque = message.wrench.force, message.wrench.torque
    assert same((force.x, force.y, force.z, torque.x, torque.y, torque.z), values)
    assert message.header.frame_id == frame


@settings(deadline=None)
@given(names=field_names, t_ns=stamps, data=st.data())
def test_fields(names, t_ns, data):
    units = tuple("N m" for _ in names)
    channel = Channel("/x", "fields", names, units=units, message="hil_msgs/msg/X")
    values = numbers(data, len(names))
    message = decoded(channel, t_ns, values)
    assert same([getattr(message, n) for n in names], values)
    assert message.stamp.sec == t_ns // 10**9
    assert "float64 " + names[0] + "  # [N m]" in channel.schema()[1]


def test_messages_of_a_channel_have_one_size():
    encode = encoder(Channel("/a/measured_js", "joint_state", ("a", "bcd"), frame="base"))
    cases = [(0, 0.0), (10**18, -1e300), (1, math.nan)]
    assert len({len(encode(t, [v] * 6)) for t, v in cases}) == 1


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"kind": "joints", "names": ("a",)}, "unknown kind 'joints'"),
        ({"kind": "joint_state"}, "at least one"),
        ({"kind": "joint_state", "names": ("a", "a")}, "each once"),
        ({"kind": "joint_state", "names": ("a",), "parts": ("effort", "position")}, "order"),
        ({"kind": "joint_state", "names": ("a",), "parts": ("torque",)}, "some of"),
        ({"kind": "fields", "names": ("a.b",)}, "'a.b'"),
        ({"kind": "fields", "names": ("a_",)}, "'a_'"),
        ({"kind": "fields", "names": ("A",)}, "'A'"),
        ({"kind": "fields", "names": ("a", "b"), "units": ("N",)}, "1 units for 2 fields"),
    ],
)
def test_a_channel_that_cannot_be(options, word):
    with pytest.raises(ConfigError, match=word):
        Channel("/x", **options)
