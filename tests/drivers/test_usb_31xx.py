"""USB-31xx: reports of the protocol notes on both sides, rates, heartbeat, broken boxes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.drivers.usb_31xx import codec
from hil.drivers.usb_31xx.driver import HidLink, Usb31xx, Usb31xxConfig
from hil.errors import ConfigError, DeviceError, DeviceTimeoutError
from hil.signals.bus import Bus
from hil.sim_devices.hid.module import SimHid
from hil.sim_devices.hid.usb31xx import Sim31xx

MS = 1_000_000


class World:
    """A box on a simulated bus, and its time."""

    def __init__(self, model="usb-3101", **hands):
        self.now, self.edges, self.steps, self.seen = 0, [], {}, []
        self.hid = SimHid(lambda milliseconds: self.advance(self.now + milliseconds * MS))
        self.box = Sim31xx(model, "A1", lambda *edge: self.edges.append(edge))
        self.hid.devices.append(self.box)
        real = self.box.output
        self.box.output = lambda report: (self.seen.append((self.now, report)), real(report))
        self.bus = Bus("hid", self.hid, self.run, self.pause, lambda: self.now, simulated=True)

    def advance(self, t_ns):
        while self.now + MS <= t_ns:
            self.now += MS
            self.box.tick(self.now)
            for step in list(self.steps.values()):
                step()

    def run(self, name, step):
        self.steps[name] = step
        return lambda: self.steps.pop(name, None) and None

    def pause(self, seconds):
        self.advance(self.now + round(seconds * 1e9))

    def open(self, channels=(0, 1, 2), **options):
        return Usb31xx("dac", self.bus, "", Usb31xxConfig(self.model(), **options), channels)

    def model(self):
        return self.box.descriptor["product_string"].lower()


# golden reports, hexadecimal, from the protocol notes

REPORTS = [
    ("14 01 00 c0 00", codec.aout(1, 49_152, codec.NOW)),
    ("14 03 ff ff 01", codec.aout(3, 65_535, codec.ON_SYNC)),
    ("15", bytes([codec.AOUT_SYNC])),
    ("1c 02 01", codec.aout_config(2)),
    ("30 18 01 00 08", codec.memory_read(codec.calibration_address(1), 8)),
    ("43 00", bytes([codec.SET_SYNC, codec.MASTER])),
    ("44", bytes([codec.GET_STATUS])),
    ("06 00 01", bytes([codec.DIO_BIT, 0, 1])),
    ("02 00 00", bytes([codec.DIO_DIRECTION_BIT, 0, 0])),
]


@pytest.mark.parametrize(("golden", "made"), REPORTS)
def test_reports_of_the_driver(golden, made):
    assert made == bytes.fromhex(golden)


def perfect(model="usb-3101"):
    box = Sim31xx(model, "A1")
    box._gain[:], box._offset[:] = 1.0, -0.0
    box._flash = box._calibration()
    return box


def send(box, *reports):
    for text in reports:
        box.output(bytes.fromhex(text))
    box.tick(box.now_ns + len(reports) * MS)


def test_reports_of_the_simulated_box():
    box = perfect()
    send(box, "1c 01 01", "14 01 00 c0 00")
    assert box.volts[1] == 5.0
    send(box, "14 01 00 80 01")
    assert box.volts[1] == 5.0  # staged alone
    send(box, "15")
    assert box.volts[1] == 5.0  # a slave does not sync by report
    send(box, "43 00", "15", "44")
    assert box.volts[1] == 0.0
    assert box.inputs.pop() == bytes.fromhex("44 01")
    send(box, "14 01 ff ff 00")
    assert box.volts[1] == pytest.approx(9.9997, abs=1e-4)
    send(box, "1c 01 00")
    assert box.volts[1] == 0.0  # a range change is 0 V of the new range
    send(box, "14 01 00 80 00")
    assert box.volts[1] == 5.0  # 0..10 V
    send(box, "30 18 01 00 08")
    assert box.inputs.pop()[:9] == bytes.fromhex("30") + np.array([1, 0], "<f4").tobytes()


def asked(box, *reports):
    send(box, *reports)
    found = [r.hex(" ") for r in box.inputs]
    box.inputs.clear()
    return found


def test_digital_lines_of_the_simulated_box():
    edges = []
    box = Sim31xx("usb-3101", "A1", lambda *edge: edges.append(edge[:2]))
    box.outside = 0xA5
    assert asked(box, "03", "05 00", "05 01") == ["03 a5", "05 01", "05 00"]
    # lines 0 to 3 are driven; what the world puts on the others stays
    asked(box, "02 00 00", "02 01 00", "02 02 00", "02 03 00", "04 0a")
    assert edges == [(1, 1), (3, 1)]
    assert asked(box, "03", "05 03", "05 05", "05 06") == ["03 aa", "05 01", "05 01", "05 00"]
    asked(box, "01 01")
    assert asked(box, "03") == ["03 a5"]
    asked(box, "01 00", "04 f0")
    assert asked(box, "03") == ["03 f0"]
    box.power_up()
    assert asked(box, "03") == ["03 a5"]  # inputs again
    assert asked(box, "03 00", "05", "05 00 00") == []  # of no such length


def test_the_event_counter_of_the_simulated_box():
    box = perfect()
    box.count(0x01020304)
    assert asked(box, "21") == ["21 04 03 02 01"]
    box.count(0xFFFFFFFF)
    assert asked(box, "21") == ["21 03 03 02 01"]  # 32 bits
    assert asked(box, "20", "21") == ["21 00 00 00 00"]
    box.count(5)
    box.power_up()
    assert asked(box, "21") == ["21 00 00 00 00"]
    send(box, "40 03")
    assert box.blinks == 3


def memory(box, address, count):
    at = address.to_bytes(2, "little").hex(" ")
    (answer,) = asked(box, f"30 {at} 00 {count:02x}")
    return " ".join(answer.split()[1 : 1 + count])


def test_the_users_memory_is_written():
    box = perfect()
    send(box, "31 10 00 03 0a 0b 0c")
    assert memory(box, 0x0F, 5) == "00 0a 0b 0c 00"
    # wrong lengths, too long, across the end of the user's part: nothing
    send(box, "31 10 00 03 01 01", "31 10 00 00", "31", "31 fe 00 04 01 01 01 01")
    send(box, "31 00 00 3c" + " 01" * 60)
    assert memory(box, 0x0F, 5) == "00 0a 0b 0c 00"
    assert memory(box, 0xFE, 2) == "00 00"
    send(box, "31 c5 00 3b" + " 07" * 59)
    assert memory(box, 0xC4, 2) == "00 07" and memory(box, 0xFF, 1) == "07"
    box.power_up()
    assert memory(box, 0x0F, 5) == "00 0a 0b 0c 00"


def test_the_flash_is_written_in_blocks_when_unlocked():
    box = perfect()
    before = memory(box, 0x100, 62)
    send(box, "31 00 01 20" + " 00" * 32, "31 00 05 02 aa 55", "31 00 01 01 00")
    assert memory(box, 0x100, 62) == before  # locked, or the wrong key
    # a block begins where the low five bits are 0; the first of a sector erases both
    send(box, "31 00 05 02 55 aa", "31 07 01 04 11 22 33 44")
    assert memory(box, 0x100, 62) == "11 22 33 44" + " ff" * 58
    send(box, "31 2b 01 02 f0 0f", "31 3f 01 01 3c")
    assert memory(box, 0x11E, 6) == "ff ff 30 0f ff ff"  # ones to zeros alone
    send(box, "31 40 01 3b" + " 05" * 59)
    assert memory(box, 0x15E, 3) == "05 05 ff"  # 32 bytes, no more
    box.power_up()
    send(box, "31 00 01 01 00")
    assert memory(box, 0x100, 3) == "11 22 33"  # it stays; the key does not


def test_a_calibration_that_was_overwritten_is_refused():
    world = World()
    send(world.box, "31 00 05 02 55 aa", "31 00 01 01 00")
    with pytest.raises(DeviceError, match="no calibration"):
        world.open()


def test_one_report_a_frame():
    box = perfect()
    box.output(bytes.fromhex("1c 00 01"))
    box.output(bytes.fromhex("14 00 00 c0 00"))
    box.output(bytes.fromhex("14 00 00 80 00"))
    volts = []
    for k in range(1, 5):
        box.tick(k * MS)
        volts.append(box.volts[0])
    assert volts == [0.0, 5.0, 0.0, 0.0]


# properties of the codec


@given(st.integers(-(2**40), 2**40), st.floats(0.9, 1.1), st.floats(-3000.0, 3000.0))
def test_a_converter_value_never_wraps(code, slope, offset):
    value = codec.dac_code(code, slope, offset)
    assert 0 <= value <= 65_535
    ideal = slope * min(max(code + 32_768, 0), 65_535) + offset
    assert abs(value - min(max(ideal, 0.0), 65_535.0)) <= 0.5 + 1e-9


@given(st.integers(0, 15), st.integers(0, 65_535), st.sampled_from([0, 1]))
def test_a_report_holds_what_went_in(channel, value, when):
    report = codec.aout(channel, value, when)
    assert (report[0], report[1], report[4]) == (0x14, channel, when)
    assert report[2] + 256 * report[3] == value


def test_a_flash_without_calibration_is_refused():
    with pytest.raises(DeviceError, match="no calibration"):
        codec.decode_calibration(b"\xff" * 8, "box 'x', channel 0")
    world = World()
    world.box._flash = b"\x00" * 0x400
    with pytest.raises(DeviceError, match="slope 0, offset 0"):
        world.open()


# voltages and rates


def test_calibrated_voltages_are_right_to_a_code():
    world = World()
    assert np.abs(world.box._gain - 1).max() > 5e-4
    dac = world.open()
    for code in (-30_000, -1, 0, 1, 12_345, 30_000):
        dac.put(1, code)
        world.advance(world.now + 20 * MS)
        assert abs(world.box.volts[1] - code / 3276.8) <= 1.01 * 10 / 32_768
    dac.put(1, 10**9)
    world.advance(world.now + 20 * MS)
    # a converter with a gain below one does not reach its rail
    assert world.box.volts[1] == pytest.approx(10.0, abs=0.2)
    dac.close()


@pytest.mark.parametrize(
    ("channels", "options"),
    [
        ((0,), {"heartbeat_ms": 0.0}),
        ((0,), {}),
        ((0, 1, 2), {}),
        ((0, 1, 2), {"staged": False}),
        ((0, 1, 2, 3), {"heartbeat_ms": 50.0}),
    ],
)
def test_the_rate_is_the_one_that_is_said(channels, options):
    world = World()
    dac = world.open(channels, **options)
    dac.power(True)
    world.seen.clear()
    for k in range(2000):
        for c in channels:
            dac.put(c, k + 1)
        world.advance(world.now + MS)
    updates = sum(r[0] == 0x14 and r[1] == channels[-1] for _, r in world.seen) / 2.0
    assert updates == pytest.approx(dac.config.rate_hz(len(channels)), rel=0.01)
    assert max(np.unique([t for t, _ in world.seen], return_counts=True)[1]) == 1
    dac.close()


def test_one_box_a_motor_reaches_almost_1_khz_and_one_an_arm_250():
    alone = Usb31xxConfig(heartbeat_ms=0.0)
    assert alone.rate_hz(1) == 980.0
    assert Usb31xxConfig().rate_hz(3) == pytest.approx(232.5)
    assert Usb31xxConfig(staged=False).rate_hz(3) == pytest.approx(310.0)


def test_staged_channels_change_at_once():
    world = World()
    dac = world.open()
    zero = world.box.volts.copy()
    for c in range(3):
        dac.put(c, 10_000)
    changed = []
    for _ in range(20):
        world.advance(world.now + MS)
        changed.append(int((world.box.volts[:3] != zero[:3]).sum()))
    assert set(changed) == {0, 3}
    dac.close()


# the heartbeat, and zero on the way out


def test_the_heartbeat_beats_only_while_enabled():
    world = World()
    dac = world.open()
    world.advance(world.now + 100 * MS)
    assert not world.edges
    dac.power(True)
    world.advance(world.now + 1000 * MS)
    assert len(world.edges) == pytest.approx(50, abs=1)
    dac.power(False)
    world.edges.clear()
    world.advance(world.now + 200 * MS)
    assert not world.edges
    dac.close()


def test_the_output_holds_when_the_host_dies_and_the_heartbeat_stops():
    world = World()
    dac = world.open()
    dac.power(True)
    dac.put(0, 9_999)
    world.advance(world.now + 100 * MS)
    world.steps.clear()  # the process is killed
    world.edges.clear()
    world.advance(world.now + 1000 * MS)
    assert world.box.volts[0] == pytest.approx(9_999 / 3276.8, abs=1e-3)
    assert not world.edges


def test_a_kill_by_exception_sends_zeros():
    world = World()
    dac = world.open()
    dac.power(True)
    with pytest.raises(RuntimeError):
        try:
            for c in range(3):
                dac.put(c, 20_000)
            world.advance(world.now + 50 * MS)
            assert world.box.volts[0] > 5.0
            raise RuntimeError
        finally:
            dac.close()
    assert np.abs(world.box.volts[:3]).max() < 1e-3
    dac.close()


# boxes that go wrong


def test_a_box_that_is_gone():
    world = World()
    dac = world.open()
    world.box.plugged = False
    dac.put(0, 100)
    world.advance(world.now + 10 * MS)
    assert "plug it in again" in dac.trouble
    dac.close()


def test_a_box_that_was_reset_is_not_trusted():
    world = World()
    dac = world.open()
    world.box.power_up()
    world.advance(world.now + 200 * MS)
    assert "lost its settings" in dac.trouble
    dac.close()


def test_a_box_that_says_nothing():
    world = World()
    dac = world.open()
    world.box.muted = True
    world.advance(world.now + 200 * MS)
    assert "does not answer" in dac.trouble
    dac.close()
    with pytest.raises(DeviceTimeoutError, match="report 0x30"):
        world.open()


def test_stale_input_of_a_crashed_program_is_skipped():
    world = World()
    world.box.inputs.extend([bytes.fromhex("44 00")] * 50)
    assert len(world.box.inputs) == 30  # the oldest are dropped
    dac = world.open()
    assert not dac.trouble
    dac.close()


def test_nothing_attached_wrong_serial_no_permission_wrong_channel():
    world = World()
    with pytest.raises(DeviceError, match=r"serial number Z9 \(attached: A1"):
        Usb31xx("dac", world.bus, "Z9", Usb31xxConfig(), (0,))
    with pytest.raises(ConfigError, match="channels 0 to 3, not 5"):
        world.open((5,))
    world.box.readable = False
    with pytest.raises(DeviceError, match="udev"):
        world.open()
    world.box.plugged = False
    with pytest.raises(DeviceError, match="09db:009a is attached"):
        world.open()


def test_options_that_cannot_be():
    slow = {"heartbeat_ms": 60.0}  # the amplifier has cut itself off by then
    for wrong in ({"model": "usb-3102"}, {"heartbeat_bit": 8}, {"heartbeat_ms": 1.0}, slow):
        with pytest.raises(ConfigError):
            Usb31xxConfig(**wrong)


def test_the_simulated_handle_fails_as_hidapi_does():
    world = World()
    handle = world.hid.device()
    with pytest.raises(ValueError, match="not open"):
        handle.write(b"\x44")
    with pytest.raises(OSError, match="open failed"):
        handle.open_path(b"nowhere")
    handle.open(0x09DB, 0x009A)
    with pytest.raises(RuntimeError, match="already open"):
        handle.open(0x09DB, 0x009A)
    assert handle.write(b"\x44") == 1
    assert handle.read(64, 100) == [0x44, 0]
    world.box.plugged = False
    assert handle.write(b"\x44") == -1
    with pytest.raises(OSError, match="read error"):
        handle.read(64, 10)


def test_a_link_skips_answers_to_other_questions():
    world = World()
    link = HidLink("dac", world.bus, 0x009A, "")
    world.box.inputs.append(bytes.fromhex("03 ff"))
    assert link.query(bytes([codec.GET_STATUS]), 1) == b"\0"
