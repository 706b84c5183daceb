"""The timed CAN bus: bits, order, acknowledge, clashes, and python-can's face of it."""

import itertools

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.sim_devices.canbus.line import LINES, CanFrame, CanLine, Node, bits
from hil.sim_devices.simtime import VirtualTime

_NUMBER = itertools.count()


class Ear(Node):
    def __init__(self, rate=1_000_000):
        super().__init__(rate)
        self.heard = []
        self.errors = 0

    def hear(self, frame, t_ns):
        self.heard.append((frame.ident, frame.data, t_ns))

    def error(self, t_ns):
        self.errors += 1


def line(*nodes):
    bus = CanLine(VirtualTime())
    for node in nodes:
        bus.attach(node)
    return bus


def reference_bits(ident, data):
    """Frame length from a string of bits, stuffed as ISO 11898-1 says."""
    raw = f"0{ident:011b}000{len(data):04b}" + "".join(f"{b:08b}" for b in data)
    crc = 0
    for bit in raw:
        high = (crc >> 14) ^ int(bit)
        crc = (crc << 1) & 0x7FFF
        if high:
            crc ^= 0x4599
    raw += f"{crc:015b}"
    stuffed = ""
    for bit in raw:
        stuffed += bit
        if len(stuffed) >= 5 and len(set(stuffed[-5:])) == 1:
            stuffed += "1" if bit == "0" else "0"
    return len(stuffed) + 10


@settings(deadline=None)
@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_frame_lengths_are_those_of_the_standard(ident, data):
    n = len(data)
    assert bits(ident, data) == reference_bits(ident, data)
    # 44 + 8 n bits, and at most one stuff bit per four of the first 34 + 8 n
    assert 44 + 8 * n <= bits(ident, data) <= 44 + 8 * n + (33 + 8 * n) // 4


def test_a_poll_of_a_force_sensor_takes_what_the_notes_say():
    poll = sum(bits(i, d) + 3 for i, d in ((0x200, b""), (0x200, bytes(8)), (0x201, bytes(6))))
    assert 253 <= poll <= 305


def test_the_lower_identifier_goes_first_and_one_frame_at_a_time():
    a, b, ear = Ear(), Ear(), Ear()
    bus = line(a, b, ear)
    a.outbox.append((0, CanFrame(0x201, b"late")))
    b.outbox.append((0, CanFrame(0x200, b"soon")))
    bus.run(10**9)
    assert [i for i, _, _ in ear.heard] == [0x200, 0x201]
    first, second = (t for *_, t in ear.heard)
    assert first == bits(0x200, b"soon") * 1000
    assert second == first + 3000 + bits(0x201, b"late") * 1000


def test_who_has_the_bus_keeps_it():
    a, b, ear = Ear(), Ear(), Ear()
    bus = line(a, b, ear)
    a.outbox.append((0, CanFrame(0x7FF, bytes(8))))
    b.outbox.append((5_000, CanFrame(0x001)))
    bus.run(10_000)
    assert ear.heard == []
    bus.run(10**9)
    assert [i for i, *_ in ear.heard] == [0x7FF, 0x001]


def test_time_does_not_depend_on_how_often_one_looks():
    def times(step):
        a, ear = Ear(), Ear()
        bus = line(a, ear)
        for k in range(5):
            a.outbox.append((k * 10_000, CanFrame(0x100 + k, bytes([k]))))
        for t in range(0, 2_000_000, step):
            bus.run(t)
        return ear.heard

    assert times(7_000) == times(999_000) == times(100)


@pytest.mark.parametrize("others", [[], [Ear(250_000)]])
def test_without_an_acknowledge_it_is_sent_again_and_again(others):
    a = Ear()
    bus = line(a, *others)
    a.outbox.append((0, CanFrame(0x200)))
    bus.run(50_000_000)
    assert a.outbox or a.off
    assert a.errors > 10
    assert all(not o.heard for o in others)
    # alone, a node never leaves the bus; against another bit rate it does
    assert a.off is bool(others)


def test_one_identifier_from_two_with_other_data_is_an_error_for_both():
    a, b, ear = Ear(), Ear(), Ear()
    bus = line(a, b, ear)
    a.outbox.append((0, CanFrame(0x200)))
    b.outbox.append((0, CanFrame(0x200, bytes(8))))
    bus.run(10_000_000)
    assert ear.heard == []
    assert a.off
    assert b.off


@pytest.fixture
def channel():
    name = f"line{next(_NUMBER)}"
    LINES[name] = kept = line(Ear())
    yield name
    del kept


def test_python_can_opens_it_by_name_and_waits_in_its_time(channel):
    with can.Bus(interface="hil-sim", channel=channel, bitrate=1_000_000) as bus:
        other = can.Bus(interface="hil-sim", channel=channel, bitrate=1_000_000)
        bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"abc"))
        assert other.recv(0.0) is None
        message = other.recv(0.01)
        assert (message.arbitration_id, bytes(message.data)) == (0x123, b"abc")
        assert message.timestamp == pytest.approx(bits(0x123, b"abc") * 1e-6)
        before = LINES[channel].time.now_ns
        assert other.recv(0.5) is None
        assert LINES[channel].time.now_ns == before + 500_000_000
        other.set_filters([{"can_id": 0x100, "can_mask": 0x7FF}])
        for ident in (0x101, 0x100):
            bus.send(can.Message(arbitration_id=ident, is_extended_id=False))
        assert other.recv(0.1).arbitration_id == 0x100
        other.shutdown()
        with pytest.raises(can.CanOperationError):
            other.recv(0.0)


def test_python_can_refuses_what_the_bus_cannot_do(channel):
    with pytest.raises(can.CanInitializationError, match="no simulated CAN line"):
        can.Bus(interface="hil-sim", channel="nowhere")
    with can.Bus(interface="hil-sim", channel=channel, bitrate=1_000_000) as bus:
        with pytest.raises(can.CanOperationError):
            bus.send(can.Message(arbitration_id=1, is_extended_id=True))
        LINES[channel].nodes[0].powered = False
        for _ in range(10):
            bus.send(can.Message(arbitration_id=1, is_extended_id=False))
        with pytest.raises(can.CanOperationError, match="No buffer space"):
            bus.send(can.Message(arbitration_id=1, is_extended_id=False))
        assert bus.recv(0.001).is_error_frame
