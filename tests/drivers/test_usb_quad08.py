"""USB-QUAD08: words of the protocol notes on both sides, cold start, a stream that goes wrong."""

import errno
import threading
from array import array

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.drivers.usb_quad08 import codec, link
from hil.drivers.usb_quad08.driver import (
    Quad08,
    Quad08Config,
    ScanClock,
    configure_counter,
    start_scan,
)
from hil.drivers.usb_quad08.link import UsbLink, find_devices
from hil.errors import ConfigError, DeviceError
from hil.signals.bus import Bus
from hil.signals.device import Status
from hil.sim_devices.usb import quad08
from hil.sim_devices.usb.backend import SimUsb

MS = 1_000_000
#: UL for Linux 1.2.1, as in the protocol notes: six counters of 32 bits.
SIX_32 = (
    "0003 0060 000b 0062 001b 0060 001b 0062 002b 0060 002b 0062 003b 0060 003b 0062 "
    "004b 0060 004b 0062 005b 0060 005f 0062"
)


class World:
    """A box whose encoders turn evenly, and its time."""

    def __init__(self, cold=False):
        self.place, self.speed, self.now = np.zeros(8), np.zeros(8), 0
        self.box = quad08.SimQuad08("S1", self.stand, cold)
        self.usb = SimUsb()
        self.usb.devices.append(self.box)
        self.steps = {}
        self.asleep = False

    def stand(self, out):
        out[:] = self.place

    def advance(self, t_ns):
        while self.now + MS <= t_ns:
            self.now += MS
            self.place += self.speed * 1e-3
            self.box.tick(self.now)
            for step in [] if self.asleep else list(self.steps.values()):
                step()

    def run(self, name, step):
        self.steps[name] = step
        return lambda: self.steps.pop(name, None) and None

    def pause(self, seconds):
        self.advance(self.now + round(seconds * 1e9))

    def bus(self, **changes):
        hands = {"run": self.run, "pause": self.pause, "now_ns": lambda: self.now}
        return Bus("usb", self.usb, **(hands | {"simulated": True} | changes))

    def open(self, channels=(0, 1, 2, 3, 4, 5), **options):
        return Quad08("quad", self.bus(), "", Quad08Config(**options), channels)

    def link(self):
        return UsbLink("quad", find_devices(self.usb, self.box.product, "")[0])


# golden words


@pytest.mark.parametrize(
    ("word", "given"),
    [
        (0x0815, {"edges": 4}),
        (0x2815, {"edges": 4, "asynchronous": True}),
        (0x0915, {"edges": 4, "index": "clear"}),
        (0x0855, {"edges": 4, "index": "latch"}),
        (0x080D, {"edges": 2}),
        (0x0805, {"edges": 1}),
    ],
)
def test_mode_words(word, given):
    assert codec.mode_word(**given) == word


def test_words_of_a_scan():
    assert codec.scan_list(range(6), 2) == [int(w, 16) for w in SIX_32.split()]
    assert (codec.pacer_divisor(1000), codec.pacer_divisor(50_000)) == (47_999, 959)
    assert codec.mark_patterns() == [0xFE, 0x02, 0xFB, 0x08, 0xEF, 0x20, 0xBF, 0x80]
    assert codec.debounce_byte(0.0) == 0x80
    assert codec.words16(0x123456789ABC, 3) == [0x9ABC, 0x5678, 0x1234]


def transfers(world):
    """Every control transfer that reaches the box: (type, request, value, index, length)."""
    seen, real = [], world.box.control

    def control(kind, request, value, index, data):
        seen.append((kind, request, value, index, len(data)))
        return real(kind, request, value, index, data)

    world.box.control = control
    return seen


def test_transfers_of_an_asynchronous_counter():
    world = World()
    link, seen = world.link(), transfers(world)
    configure_counter(link, 3, Quad08Config(), asynchronous=True)
    assert [(i, v) for _, _, v, i, _ in seen] == [
        (0x2E, 3),
        (0x2C, 0x8080),
        (0x2E, 3),
        (0x2D, 0x8080),
        (0x2E, 3),
        (0x28, 0x2815),
        (0x2E, 0x33),
        (0x28, 0xFFFF),
        (0x2E, 0x23),
        (0x28, 0xFFFF),
        (0x2E, 0x13),
        (0x28, 0xFFFF),
    ]
    assert {(kind, request, length) for kind, request, _, _, length in seen} == {(0x40, 0xB4, 0)}


def test_the_order_of_a_start():
    world = World()
    seen = transfers(world)
    world.open()
    writes = [(i, v) for k, r, v, i, _ in seen if (k, r) == (0x40, 0xB4)]
    end = [(0x00, 0x0003), (0x58, 0x0011), (0x00, 0x0071), (0x00, 0x0011), (0x00, 0x0031)]
    assert writes[-5:] == end
    lists = [int(w, 16) for w in SIX_32.split()]
    assert [v for i, v in writes if i == 0x01] == lists * 2
    assert (0x40, 0xBB, 1, 2, 0) in seen
    pacer = [(0x00, 0x0060), (0x02, 959), (0x03, 0), (0x05, 0)]
    at = writes.index((0x00, 0x0060))
    assert writes[at : at + 4] == pacer


#: One initialisation after the marks: converters off, scan off (protocol notes 1.3, 1.8); it is
#: done twice, and the five words of the converters are known the second time.
DISARM = [(0x59, 0), (0x59, 0x10), (0x00, 0x30), (0x00, 0x10), (0x00, 3), (0x58, 0x10)]
PASSES = [
    [(0x10, 0x10), (0x58, 0), *((0x10, w) for w in words), (0x10, 4), *DISARM]
    for words in ((0, 0, 0, 0, 0), (0x20, 0x30, 0x40, 0x50, 0x60))
]


def test_the_initialisation_is_done_twice_as_the_vendor_does():
    world = World()
    seen = transfers(world)
    link.open_link("quad", world.usb, "", "", world.pause)
    marks = [p for m in codec.mark_patterns() for p in ((0x40, 0xB4, m), (0xC0, 0xB4, 0))]
    expected = [(0xC0, 0xB2, 0, 0)]
    for words in PASSES:
        expected.append((0xC0, 0xB0, 0, 0))
        expected += [(k, r, v, 0x5D) for k, r, v in marks]
        expected += [(0x40, 0xB4, v, i) for i, v in words]
    vendor = [t[:4] for t in seen if t[1] in (0xB0, 0xB2, 0xB4)]
    assert vendor == expected
    assert world.box.fpga.initialised == 2


@pytest.mark.parametrize("spoil", ["one pass", "marks"])
def test_a_simulated_box_scans_only_after_both_initialisations(spoil, monkeypatch):
    world = World()
    if spoil == "one pass":
        monkeypatch.setattr(codec, "DAC_WORDS", codec.DAC_WORDS[:1])
    else:
        monkeypatch.setattr(link, "prove", lambda link: None)
    with pytest.raises(DeviceError):
        world.open()
    monkeypatch.undo()
    world.open().close()


def test_digital_lines_are_pulled_up():
    world = World()
    box = world.link()
    assert box.read(0x22) == 0xFF  # nothing is connected
    world.box.fpga.outside = 0xF3
    assert box.read(0x22) == 0xF3
    box.write(0x22, 0x55)
    assert box.read(0x22) == 0xF3  # inputs yet
    box.write(0x23, 0xFF)
    assert box.read(0x22) == 0xF3  # no port yet
    box.write(0x18, 0x30)
    box.write(0x23, 0x0F)
    assert box.read(0x22) == 0xF1  # open collectors: 0 pulls down, 1 lets go
    box.write(0x23, 0xFF)
    assert box.read(0x22) == 0x51
    world.box.power_up(cold=False)
    assert world.link().read(0x22) == 0xFF


def test_resets_may_come_together():
    world = World()
    quad, fpga = world.open(), world.box.fpga
    fpga.fifo += b"12"
    fpga.write(0x00, 0x0001)
    assert fpga.fifo and fpga._list
    fpga.write(0x00, 0x0006)
    assert not fpga.fifo and not fpga._list
    quad.close()


def test_the_simulated_box_sends_the_words_of_the_notes():
    world = World()
    quad = world.open()
    quad.close()
    world.speed[:6] = [1e3, -1e3, 70_000_000, 0, 0, 0]
    link = world.link()
    for channel in range(6):
        configure_counter(link, channel, Quad08Config(), asynchronous=False)
    start_scan(link, [int(w, 16) for w in SIX_32.split()], 47_999)
    world.advance(world.now + 30 * MS)
    data = bytes(world.link().device.read(0x82, 512))
    rows = np.frombuffer(data[:480], "<u4").reshape(-1, 6)
    assert list(rows[0]) == [0] * 6  # the first scan zeroes
    step = np.diff(rows.astype(np.int64), axis=0) % 2**32
    assert set(step[:, 0]) == {1}
    assert set(step[:, 1]) == {2**32 - 1}
    assert set(step[:, 2]) == {70_000}
    assert not step[:, 3:].any()


# properties of the codec


@given(
    st.lists(st.lists(st.integers(-20_000, 20_000), min_size=3, max_size=3), max_size=60),
    st.sampled_from([1, 2]),
    st.integers(0, 63),
)
@settings(deadline=None)
def test_unwrapping_gives_back_any_motion(moves, words, start):
    true = np.cumsum([[0, 0, 0], *moves], axis=0)
    ring = np.zeros(256, np.uint16)
    last, counts = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for k, row in enumerate(true[1:]):
        at = start + k * 3 * words
        for i, value in enumerate(row):
            for w in range(words):
                ring[(at + i * words + w) % 256] = int(value) >> 16 * w & 0xFFFF
        assert codec.unwrap(ring, at, 1, words, 20_000, last, counts) == 0
        assert (counts == row).all()


@given(st.integers(1, 8), st.sampled_from([1, 2, 4]))
def test_a_scan_list_has_one_start_and_one_end(n, words):
    found = codec.scan_list(range(n), words)
    heads = found[::2]
    assert [w >> 4 & 7 for w in heads] == [c for c in range(n) for _ in range(words)]
    assert [bool(w & 4) for w in heads] == [False] * (n * words - 1) + [True]
    assert [bool(w & 8) for w in heads] == [False] + [True] * (n * words - 1)


@given(st.binary(min_size=1, max_size=40), st.integers(0, 0xFFF0))
def test_hex_records_come_back(data, address):
    head = bytes([len(data)]) + address.to_bytes(2, "big") + b"\0"
    line = head + data
    text = ":" + (line + bytes([-sum(line) & 0xFF])).hex() + "\n:00000001FF\n"
    found = codec.hex_records(text, "x.hex")
    assert b"".join(d for _, d in found) == data
    assert all(len(d) <= 16 for _, d in found)
    assert [a for a, _ in found] == list(range(address, address + len(data), 16))
    with pytest.raises(DeviceError, match=r"x.hex, line 1"):
        codec.hex_records(text.replace(":", ";", 1), "x.hex")


@given(st.floats(1000.0, 100_000.0))
def test_the_pacer_is_never_slower_than_asked(rate):
    divisor = codec.pacer_divisor(rate)
    assert codec.scan_period_ns(divisor) <= 1e9 / rate * (1 + 1e-12)
    assert codec.scan_period_ns(divisor + 1) > 1e9 / rate * (1 - 1e-12)


# cold start


@pytest.fixture
def images(tmp_path):
    """Images of the right form; what is in them is nothing."""

    def line(address, data):
        row = bytes([len(data)]) + address.to_bytes(2, "big") + b"\0" + data
        return ":" + (row + bytes([-sum(row) & 0xFF])).hex()

    end = ":00000001FF"
    (tmp_path / "loader.hex").write_text("\n".join([line(0x0000, bytes(range(16))), end]))
    both = [line(0x0100, b"inside"), line(0x4000, b"outside"), end]
    (tmp_path / "firmware.hex").write_text("\n".join(both))
    (tmp_path / "fpga.bin").write_bytes(bytes(0x4E) + bytes(212_410))
    return tmp_path


def test_a_cold_box_is_loaded_and_counts(images):
    world = World(cold=True)
    seen = transfers(world)
    quad = world.open(images=str(images))
    assert world.box.product == 0x00CA
    assert bytes(world.box.ram[a] for a in range(0x4000, 0x4007)) == b"outside"
    assert sum(r == 0xB3 for _, r, _, _, _ in seen) == 104
    resets = [d for _, r, v, _, d in seen if (r, v) == (0xA0, 0xE600)]
    assert len(resets) == 5
    world.speed[0] = 500.0
    world.advance(world.now + 100 * MS)
    assert quad.receive(world.now) is Status.OK
    assert abs(quad.counts[0] - 50) <= 1
    quad.close()


def test_a_cold_box_without_images_says_where_they_come_from(tmp_path):
    world = World(cold=True)
    with pytest.raises(DeviceError, match="has no firmware"):
        world.open()
    with pytest.raises(ConfigError, match=r"lacks loader\.hex"):
        world.open(images=str(tmp_path))


def test_an_fpga_that_does_not_take_its_image(images):
    world = World()
    world.box.configured, world.box.fpga_size = False, 1
    with pytest.raises(DeviceError, match="FPGA refused"):
        world.open(images=str(images))


def test_an_fpga_that_does_not_prove_itself():
    world = World()
    real = world.box.fpga.read
    world.box.fpga.read = lambda r: 0x20 if r == 0x5D else real(r)
    with pytest.raises(DeviceError, match="returned 0x20 for 0xfe"):
        world.open()


def test_nothing_attached_and_no_permission():
    world = World()
    world.box.plugged = False
    with pytest.raises(DeviceError, match="no USB-QUAD08 is attached"):
        world.open()
    world.box.plugged, world.box.readable = True, False
    with pytest.raises(DeviceError, match=r"no permission.*udev"):
        world.open()
    with pytest.raises(DeviceError, match="serial number S9"):
        link.open_link("quad", world.usb, "S9", "", world.pause)


# the stream


@pytest.mark.parametrize("bits", [16, 32])
def test_the_top_speed_of_the_motor_both_ways(bits):
    world = World()
    quad = world.open(bits=bits)
    world.speed[:2] = 332_000, -332_000
    start = world.place.copy()
    for _ in range(1000):
        world.advance(world.now + MS)
        assert quad.receive(world.now) is Status.OK
    gone = (world.place - start)[:2]
    # at most two packets old: 1.7 ms with 16 bits
    assert np.abs(quad.counts[:2] - gone).max() < 332 * 2.0
    steps = []
    for _ in range(50):
        before = quad.counts[0]
        world.advance(world.now + MS)
        quad.receive(world.now)
        steps.append(quad.counts[0] - before)
    assert max(steps) - min(steps) <= 2 * 332_000 / 50_000 + 1  # the age does not jitter
    quad.close()


def test_an_overrun_is_noticed():
    world = World()
    quad = world.open()
    world.asleep = True
    world.advance(world.now + 100 * MS)
    world.asleep = False
    for _ in range(200):
        world.advance(world.now + MS)
        if quad.receive(world.now) is Status.LOST:
            break
    assert "overrun" in quad.trouble
    quad.close()


def test_a_stall_is_stale_then_lost():
    world = World()
    quad = world.open()
    seen = []
    world.advance(world.now + MS)
    quad.receive(world.now)
    world.box.fpga.running = False
    for _ in range(80):
        world.advance(world.now + MS)
        seen.append(quad.receive(world.now))
    assert seen.index(Status.STALE) in range(3, 8)
    assert seen.index(Status.LOST) in range(48, 54)
    assert "has not sent counts" in quad.trouble
    quad.close()


def test_a_lost_word_is_noticed():
    world = World()
    quad = world.open(bits=16)
    world.speed[:6] = [3e3, -2e3, 1e4, 0, 5e3, -9e3]
    world.advance(world.now + 100 * MS)
    assert quad.receive(world.now) is Status.OK
    world.box.garbled = 1
    world.advance(world.now + 5 * MS)
    assert quad.receive(world.now) is Status.LOST
    assert "out of step" in quad.trouble
    quad.close()


def test_a_thread_reads_the_stream():
    world = World()
    go, enough = threading.Event(), threading.Event()

    def wait(milliseconds):
        # the world goes on when the reader waits: no time passes here
        if world.now > 400 * MS:
            enough.set()
        if enough.is_set() or (world.now > 50 * MS and not go.is_set()):
            return False
        world.speed[0] = 1000.0 if go.is_set() else 0.0
        world.advance(world.now + MS)
        return True

    world.usb.wait = wait
    bus = Bus("usb", world.usb, pause=enough.wait, now_ns=lambda: world.now)
    quad = Quad08("quad", bus, "", Quad08Config(), (0, 1))
    go.set()
    assert enough.wait(30.0)
    quad.close()
    assert world.usb.opened == 0
    scan = quad._scans - 1
    assert quad._unwrap(scan, 3.0) is Status.OK
    assert abs(quad.counts[0] - world.place[0]) < 2
    assert quad.counts[1] == 0


def test_scan_clock_follows_a_clock_that_drifts():
    clock, ages = ScanClock(20_000.0, 400_000.0), []
    for k in range(1, 20_000):
        t = k * MS
        # a box 100 ppm fast, packets of 21 scans, delays that jump
        newest = int(t * 1.0001 / 20_000) // 21 * 21 - (5 if k % 7 == 0 else 0)
        scan = clock.choose(t, newest)
        assert scan <= newest
        ages.append(t * 1.0001 - scan * 20_000)
    assert np.ptp(ages[1000:]) < 450_000


# the simulated bus is libusb's


def test_what_pyusb_sees_of_a_bus():
    world = World()
    device = find_devices(world.usb, 0x00CA, "S1")[0]
    texts = device.manufacturer, device.product, device.serial_number
    assert texts == ("MCC", "USB-QUAD08", "S1")
    assert device[0][(0, 0)][0].wMaxPacketSize == 512
    for call, number in (
        (lambda: device.read(0x82, 512, 10), errno.ETIMEDOUT),
        (lambda: device.read(0x82, 100, 10), errno.EOVERFLOW),
        (lambda: device.ctrl_transfer(0xC0, 0x77, 0, 0, 1), errno.EPIPE),
    ):
        with pytest.raises(OSError) as caught:
            call()
        assert caught.value.errno == number
    world.box.plugged = False
    with pytest.raises(OSError) as caught:
        device.read(0x82, 512, 10)
    assert caught.value.errno == errno.ENODEV


def test_a_bulk_read_waits_for_a_full_buffer_and_keeps_what_came_until_its_time_is_over():
    world, left = World(), [0]
    quad = world.open(channels=(0,))
    world.asleep = True  # nobody but this test reads

    def wait(milliseconds):
        left[0] -= 1
        world.advance(world.now + MS)
        return left[0] > 0

    world.usb.wait = wait
    device, buffer = quad._link.device, array("B", bytes(8 * 512))
    # 200 bytes a millisecond, in whole packets: a piece of one stays in the box
    left[0] = 4
    assert device.read(0x82, buffer, 4) in (512, 1024)
    left[0] = 100
    assert device.read(0x82, buffer, 100) == 8 * 512
    left[0] = 1
    with pytest.raises(OSError) as caught:
        device.read(0x82, buffer, 1)
    assert caught.value.errno == errno.ETIMEDOUT
    quad.close()


@pytest.mark.parametrize("edges", [1, 2, 4])
def test_the_simulated_counter_counts_edges(edges):
    world = World()
    quad = world.open(channels=(0,), edges=edges)
    world.speed[0] = 3000.0
    world.advance(world.now + 400 * MS)
    world.speed[0] = -4000.0
    world.advance(world.now + 600 * MS)
    quad.receive(world.now)
    world.speed[0] = 0.0
    world.advance(world.now + 5 * MS)
    quad.receive(world.now)
    assert abs(quad.counts[0] - (1200 - 2400) * edges / 4) <= 1
    quad.close()


def test_options_that_cannot_be():
    with pytest.raises(ConfigError, match="half of 16 bits"):
        Quad08Config(bits=16, lost_ms=100.0)
    wrongs = {"bits": 24, "edges": 3, "index": "x", "rate_hz": 1.0, "debounce_us": 2.0}
    for wrong in [{key: value} for key, value in wrongs.items()]:
        with pytest.raises(ConfigError):
            Quad08Config(**wrong)
