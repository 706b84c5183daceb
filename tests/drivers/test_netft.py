"""ATI's Net F/T box over CAN and over UDP: conformance, golden bytes, faults."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil.drivers import netft_can as can_codec
from hil.drivers import netft_rdt as rdt_codec
from hil.drivers.netft_can import NetFtCanConfig
from hil.drivers.netft_rdt import NetFtRdtConfig, open_box
from hil.errors import ConfigError, DeviceError, DeviceTimeoutError
from hil.signals.device import Status
from hil.sim_devices.canbus.line import CanFrame
from hil.testing import check_driver

sys.path.insert(0, str(Path(__file__).parent))
from can_far import NetFtCanFar, RdtFar

MS = 1_000_000
ALL = {"states", "force", "unplug", "time-out", "bad frames"}
WORDS16 = st.lists(st.integers(-32768, 32767), min_size=6, max_size=6)
WORDS32 = st.lists(st.integers(-(2**31), 2**31 - 1), min_size=6, max_size=6)


def ticks(source, t_ns, n):
    seen = []
    for _ in range(n):
        t_ns += MS
        seen.append(source.receive(t_ns))
    return t_ns, seen


@pytest.mark.parametrize("kind", [NetFtCanFar, RdtFar])
def test_conformance(kind):
    far = kind()
    checked = check_driver(far.open, far)
    assert checked.skipped == []
    assert set(checked.done) == ALL


def fixed(box, values):
    box.converter.counts = lambda t_ns: np.array(values)


def test_the_can_frames_are_those_of_the_document():
    far = NetFtCanFar()
    far.board.factors[:] = 1.0
    fixed(far.board, [1, -2, 3, 256, -32768, 32767])
    far.board.faults.status = 0x8001
    far.board.hear(CanFrame(0x1B0, b"\x02"), 0)
    first, second = (f for _, f in far.board.outbox)
    # Fx Tx Fy Ty, then Fz Tz status sample; little-endian
    assert first == CanFrame(0x1B5, bytes.fromhex("0100 0001 FEFF 0080"))
    assert second == CanFrame(0x1B6, bytes.fromhex("0300 FF7F 0180 0100"))
    words = [0] * 6
    can_codec.first_frame(first.data, words)
    assert can_codec.second_frame(second.data, words) == (0x8001, 1)
    assert words == [1, -2, 3, 256, -32768, 32767]
    far.board.outbox.clear()
    for request in (b"", b"\x05", b"\x02\x00"):
        far.board.hear(CanFrame(0x1B0, request), 0)
    assert not far.board.outbox


def test_the_rdt_record_is_that_of_the_document():
    far = RdtFar()
    fixed(far.box, [1, -1, 1_000_000, -1_000_000, 2**31 - 1, -(2**31)])
    far.box.status = 0x80010000
    assert rdt_codec.request(rdt_codec.REAL_TIME) == bytes.fromhex("1234 0002 00000000")
    assert rdt_codec.request(rdt_codec.STOP, 7) == bytes.fromhex("1234 0000 00000007")
    far.box.send(bytes.fromhex("1234 0002 00000001"))
    far.time.wait(10 * MS)
    data = far.box.recv(2048)
    assert data == bytes.fromhex(
        "00000001 00000001 80010000 00000001 FFFFFFFF 000F4240 FFF0BDC0 7FFFFFFF 80000000"
    )
    words = [0] * 6
    assert rdt_codec.record(data, words) == (1, 1, 0x80010000)
    assert words == [1, -1, 1_000_000, -1_000_000, 2**31 - 1, -(2**31)]
    with pytest.raises(BlockingIOError):
        far.box.recv(2048)


@settings(deadline=None)
@given(WORDS16)
def test_can_words_survive_two_codecs(values):
    far = _CAN
    far.board.factors[:] = 1.0
    fixed(far.board, values)
    far.board.outbox.clear()
    far.board.hear(CanFrame(0x1B0, b"\x02"), 0)
    words = [0] * 6
    (_, first), (_, second) = far.board.outbox
    can_codec.first_frame(first.data, words)
    can_codec.second_frame(second.data, words)
    assert words == values


_CAN = NetFtCanFar()


@settings(deadline=None)
@given(WORDS32, st.integers(0, 2**32 - 1))
def test_rdt_records_survive_two_codecs(values, status):
    far = RdtFar()
    fixed(far.box, values)
    far.box.status = status
    far.box.send(rdt_codec.request(rdt_codec.REAL_TIME, 1))
    far.time.wait(MS)
    words = [0] * 6
    assert rdt_codec.record(far.box.recv(100), words)[2] == status
    assert words == values


@settings(deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=5))
@example([bytes.fromhex("00000100" + 32 * "00")])
def test_any_datagram_is_survived(datagrams):
    # a forged number far ahead makes all that follow old, until the stream is asked for again
    far = RdtFar()
    source = far.source()
    far.box.arrived.extendleft((0, d) for d in datagrams)
    _, seen = ticks(source, far.time.now_ns, 40)
    assert seen[-1] is Status.OK
    assert Status.LOST not in seen


@pytest.mark.parametrize("fault", ["drop", "spoil", "swap"])
def test_a_lost_short_or_swapped_record_never_becomes_an_older_wrench(fault):
    far = RdtFar()
    source = far.source()
    t, _ = ticks(source, far.time.now_ns, 5)
    number = source._sequence
    for _ in range(20):
        setattr(far.box, fault, 1)
        t, seen = ticks(source, t, 1)
        assert source._sequence > number
        number = source._sequence
    assert {"drop": source.missed, "spoil": source.malformed, "swap": source.old}[fault] >= 15
    assert Status.LOST not in seen


def test_a_box_that_restarts_is_asked_to_stream_again():
    far = RdtFar()
    source = far.source()
    t, _ = ticks(source, far.time.now_ns, 50)
    far.box._left = 0
    t, seen = ticks(source, t, 40)
    assert Status.STALE in seen
    assert seen[-1] is Status.OK
    assert Status.LOST not in seen


def test_status_of_the_box_stops_the_use_of_its_records():
    far = RdtFar()
    source = far.source()
    far.box.status = 0x2
    _, seen = ticks(source, far.time.now_ns, 60)
    assert seen[5] is Status.STALE
    assert seen[-1] is Status.LOST
    with pytest.raises(DeviceError, match="status 0x00000002"):
        source.check()
    can = NetFtCanFar()
    source = can.box()
    can.board.faults.status = 1
    _, seen = ticks(source, can.rig.time.now_ns, 60)
    assert seen[10] is Status.STALE
    assert seen[-1] is Status.LOST
    with pytest.raises(DeviceError, match="status 0x0001"):
        source.check()


def test_silence_is_one_sentence():
    far = RdtFar()
    far.box.mute = True
    with pytest.raises(DeviceTimeoutError, match="RDT enabled on its page"):
        far.source()
    with pytest.raises(ConfigError, match="HOST or HOST:PORT"):
        open_box("ft", far.bus(), "box:x", NetFtRdtConfig(), (0,))
    far = NetFtCanFar()
    far.board.powered = False
    with pytest.raises(DeviceTimeoutError, match="no whole sample"):
        far.box()


def test_a_real_socket_with_nobody_behind_it_is_one_sentence():
    from hil.signals.bus import Bus

    bus = Bus("udp", pause=lambda seconds: None)
    with pytest.raises(DeviceTimeoutError, match=r"no record from 127\.0\.0\.1:9"):
        open_box("ft", bus, "127.0.0.1:9", NetFtRdtConfig(), (0,))


def test_a_real_socket_carries_the_records():
    import socket

    from hil.signals.bus import Bus

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
        box.bind(("127.0.0.1", 0))
        box.settimeout(5.0)
        answers = []

        def pause(seconds):
            # the far end acts while the driver waits: no thread, no sleep
            if not answers:
                data, host = box.recvfrom(100)
                answers.append(data)
                box.sendto(bytes.fromhex("00000001 00000001 00000000") + bytes(24), host)

        address = f"127.0.0.1:{box.getsockname()[1]}"
        source = open_box("ft", Bus("udp", pause=pause), address, NetFtRdtConfig(), (0,))
        assert answers == [rdt_codec.request(rdt_codec.REAL_TIME)]
        assert source.gauges.tolist() == [0] * 6
        source.close()
        assert box.recv(100) == rdt_codec.request(rdt_codec.STOP)


def test_options_without_which_forces_would_be_wrong_are_asked_for():
    with pytest.raises(ConfigError, match="scale_factors"):
        NetFtCanConfig()
    with pytest.raises(ConfigError, match="torque_unit"):
        NetFtRdtConfig(torque_unit="Nm")
    with pytest.raises(ConfigError, match="counts_per_force"):
        NetFtRdtConfig(counts_per_force=0)
