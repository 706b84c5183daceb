"""Golden frames of the NETCANOEM manual hold the driver's codec and the board's to the document."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.drivers.netcanoem import codec
from hil.drivers.netcanoem.driver import NetCanOem, NetCanOemConfig
from hil.errors import DeviceError
from hil.signals.device import Status
from hil.sim_devices.canbus.line import CanFrame, Node

sys.path.insert(0, str(Path(__file__).parent))
from can_far import Rig, board

WORDS = st.lists(st.integers(-32768, 32767), min_size=6, max_size=6)
SINGLES = st.floats(width=32, allow_nan=False, allow_infinity=False)

#: What goes over the wire with base 0x20, as the manual's tables say: request, then answers.
GOLDEN = {
    "gauges": ((0x200, ""), [(0x200, "8040 0001 FFFE 7FFF"), (0x201, "8000 0064 FFFF")]),
    "row Fz": (
        (0x202, "02"),
        [(0x202, "3F800000 C0200000"), (0x203, "00000000 447A0000"), (0x204, "BF000000 41200000")],
    ),
    "serial": ((0x205, ""), [(0x205, "46 54 30 38 35 37 37 00")]),
    "slot": ((0x206, "03"), [(0x206, "03")]),
    "counts": ((0x207, ""), [(0x207, "000F4240 000186A0")]),
    "units": ((0x208, ""), [(0x208, "02 04")]),
    "base": ((0x20D, "21"), [(0x20D, "")]),
    "bit rate": ((0x20E, "01"), [(0x20E, "")]),
    "firmware": ((0x20F, ""), [(0x20F, "03 08 0029")]),
    "reset": ((0x20C, ""), []),
}


#: What went over the wire of a real board at base 0x7F beside a motor controller (griloHBG,
#: modern-cpp-study-group, challenge-1-force-sensor-read): request, then answers.
OBSERVED = {
    "slot": ((0x7F6, "00"), [(0x7F6, "00")]),
    "counts": ((0x7F7, ""), [(0x7F7, "000F4240 000F4240")]),
    "units": ((0x7F8, ""), [(0x7F8, "02 03")]),
    "MID_VSG": ((0x7F9, "00"), [(0x7F9, "02 01")]),
    "thermistor": ((0x7F9, "02"), [(0x7F9, "00 B1")]),
    "power": ((0x7F9, "03"), [(0x7F9, "01 18")]),
    "DAC": ((0x7F9, "04"), [(0x7F9, "00 1F")]),
    "ground": ((0x7F9, "05"), [(0x7F9, "80 09")]),
    "row Fx": (
        (0x7F2, "00"),
        [(0x7F2, "41A75FA6 4004D456"), (0x7F3, "C2F77DBA 44E4EEB0"), (0x7F4, "42C35EFE C4F66466")],
    ),
    "row Tz": (
        (0x7F2, "05"),
        [(0x7F2, "3F40256A C1DAD5F4"), (0x7F3, "3FF85F58 C1CCED0E"), (0x7F4, "3F9FF9FC C1DD29AD")],
    ),
    "gauges": ((0x7F0, ""), [(0x7F0, "4000 0012 FE3A E6A8"), (0x7F1, "04FA FA93 0143")]),
}
#: Gauges of the sample above, 0 to 5.
SEEN = [0x0012, 0x04FA, 0xFE3A - 0x10000, 0xFA93 - 0x10000, 0xE6A8 - 0x10000, 0x0143]


def singles(name):
    """The numbers of an observed row of the matrix."""
    text = "".join(d for _, d in OBSERVED[name][1]).replace(" ", "")
    return np.frombuffer(bytes.fromhex(text), ">f4").astype(float)


def observed_board():
    far = board()
    far.base = 0x7F
    matrix = far.slots[0].matrix.copy()
    matrix[0], matrix[5] = singles("row Fx"), singles("row Tz")
    far.slots = {0: dataclasses.replace(far.slots[0], matrix=matrix, torque_unit=3)}
    far.faults.status = 1 << 14
    far.faults.stuck = dict(enumerate(SEEN))
    return far


@pytest.mark.parametrize("name", OBSERVED)
def test_the_board_answers_as_a_real_one(name):
    (ident, request), answers = OBSERVED[name]
    far = observed_board()
    far.hear(CanFrame(ident, bytes.fromhex(request)), 10**9)
    assert [f for _, f in far.outbox] == [CanFrame(i, bytes.fromhex(d)) for i, d in answers]


def test_the_driver_reads_a_real_board():
    data = {name: [bytes.fromhex(d) for _, d in answers] for name, (_, answers) in OBSERVED.items()}
    gauges = np.zeros(6, np.int64)
    status = codec.first_half(data["gauges"][0], gauges)
    codec.second_half(data["gauges"][1], gauges)
    assert gauges.tolist() == SEEN == [18, 1274, -454, -1389, -6488, 323]
    assert status == 0x4000 and not status & codec.CRITICAL
    assert codec.describe_status(status) == "CAN bus error"
    assert codec.counts_per_unit(data["counts"][0]) == (1_000_000, 1_000_000)
    assert codec.unit_codes(data["units"][0]) == (2, 3)
    row = [x for d in data["row Fx"] for x in codec.matrix_pair(d)]
    assert row == pytest.approx(
        [20.9217, 2.07546, -123.745, 1831.459, 97.6855, -1971.138], rel=1e-5
    )
    words = [codec.diagnostic(data[n][0]) for n in ("MID_VSG", "thermistor", "power", "ground")]
    assert words == [513, 177, 280, 32777]


def test_every_sample_of_a_board_with_a_bus_error_is_used():
    rig = Rig(observed_board())
    source = NetCanOem("ft", rig.link(), NetCanOemConfig(base=0x7F))
    seen = [source.receive(10**9 + k * 10**6) for k in range(30)]
    assert set(seen[1:]) == {Status.OK} and source.status == 0x4000
    assert source.gauges.tolist() == SEEN and not source.unusable


class Hasty(Node):
    """Another program on the bus: it asks again as soon as the first half of an answer is there."""

    def __init__(self):
        super().__init__(1_000_000)
        self.heard, self.left = [], 1

    def hear(self, frame, t_ns):
        self.heard.append((frame.ident, len(frame.data)))
        if frame.ident == 0x7F0 and len(frame.data) == 8 and self.left:
            self.left -= 1
            self.outbox.append((t_ns, CanFrame(0x7F0)))


def test_a_request_that_overtakes_the_second_half_harms_nothing():
    far, other = observed_board(), Hasty()
    rig = Rig(far, other)
    other.left = 0
    source = NetCanOem("ft", rig.link(), NetCanOemConfig(base=0x7F))
    other.heard.clear()
    other.left = 1
    seen = [source.receive(10**9 + k * 10**6) for k in range(10)]
    # ours is heard by the other, its own request is not: the second half comes after it
    order = [(0x7F0, 0), (0x7F0, 8), (0x7F1, 6), (0x7F0, 8), (0x7F1, 6)]
    assert other.heard[:5] == order
    assert set(seen) == {Status.OK} and source.gauges.tolist() == SEEN
    assert (source.timeouts, source.malformed) == (0, 0)


@pytest.mark.parametrize(("late_us", "timeouts", "stale"), [(900, 1, 0), (1900, 1, 1)])
def test_a_second_half_that_our_own_wait_overtakes_is_joined_to_its_first(late_us, timeouts, stale):
    far = observed_board()
    rig = Rig(far)
    source = NetCanOem("ft", rig.link(), NetCanOemConfig(base=0x7F))
    far.faults.delay_ns = late_us * 1000
    t = 10**9
    for _ in range(3):
        t += 10**6
        source.receive(t)
    far.faults.delay_second = 1
    seen = []
    for _ in range(10):
        t += 10**6
        seen.append(source.receive(t))
    assert source.timeouts == timeouts and source.malformed == 0
    assert seen.count(Status.STALE) == stale and seen[-1] is Status.OK
    assert source.gauges.tolist() == SEEN


def golden_board():
    far = board()
    matrix = far.slots[0].matrix.copy()
    matrix[2] = [1.0, -2.5, 0.0, 1000.0, -0.5, 10.0]
    held = dataclasses.replace(far.slots[0], matrix=matrix, torque_counts=100_000)
    far.slots = {0: held, 3: held}
    far.faults.status = 1 << 6
    far.faults.stuck = dict(enumerate([1, -32768, -2, 100, 32767, -1]))
    return far


@pytest.mark.parametrize("name", GOLDEN)
def test_the_board_answers_by_the_document(name):
    (ident, request), answers = GOLDEN[name]
    far = golden_board()
    far.hear(CanFrame(ident, bytes.fromhex(request)), 10**9)
    assert [f for _, f in far.outbox] == [CanFrame(i, bytes.fromhex(d)) for i, d in answers]


def test_the_driver_reads_by_the_document():
    data = {name: [bytes.fromhex(d) for _, d in answers] for name, (_, answers) in GOLDEN.items()}
    gauges = np.zeros(6, np.int64)
    assert codec.first_half(data["gauges"][0], gauges) == 0x8040
    codec.second_half(data["gauges"][1], gauges)
    assert gauges.tolist() == [1, -32768, -2, 100, 32767, -1]
    row = [x for d in data["row Fz"] for x in codec.matrix_pair(d)]
    assert row == [1.0, -2.5, 0.0, 1000.0, -0.5, 10.0]
    assert codec.serial_number(data["serial"][0]) == "FT08577"
    assert codec.counts_per_unit(data["counts"][0]) == (1_000_000, 100_000)
    assert codec.unit_codes(data["units"][0]) == (2, 4)
    assert codec.firmware(data["firmware"][0]) == (3, 8, 41)


def test_the_driver_asks_by_the_document():
    rig = Rig(board())
    heard = []
    rig.line.nodes[0].hear = lambda frame, t: (
        heard.append(frame) or type(rig.line.nodes[0]).hear(rig.line.nodes[0], frame, t)
    )
    source = NetCanOem("ft", rig.link(), NetCanOemConfig())
    source.receive(10**9)
    source.receive(10**9 + 10**6)
    asked = [(f.ident, f.data.hex()) for f in heard]
    rows = [(0x202, f"{axis:02x}") for axis in range(6)]
    start = [(0x20F, ""), (0x206, "00"), (0x205, ""), (0x207, ""), (0x208, "")]
    assert asked == [*start, *rows, (0x200, "")]


@pytest.mark.parametrize(
    ("ident", "request_"),
    [
        (0x200, "00"),
        (0x202, ""),
        (0x202, "06"),
        (0x206, "10"),
        (0x201, ""),
        (0x20A, ""),
        (0x210, ""),
        (0x1FF, ""),
    ],
)
def test_what_the_document_does_not_define_stays_unanswered(ident, request_):
    far = board()
    far.hear(CanFrame(ident, bytes.fromhex(request_)), 10**9)
    assert not far.outbox


def test_old_firmware_ignores_the_questions_that_came_later():
    far = board(firmware=(3, 6, 0))
    for ident, data in ((0x207, b""), (0x208, b""), (0x209, b"\x02")):
        far.hear(CanFrame(ident, data), 10**9)
    assert not far.outbox


def test_settings_come_into_force_at_power_up_alone():
    far = board()
    for ident, data in ((0x20D, b"\x21"), (0x20E, b"\x03")):
        far.hear(CanFrame(ident, data), 10**9)
    assert (far.base, far.bit_rate) == (0x20, 1_000_000)
    far.power_cycle(2 * 10**9)
    assert (far.base, far.bit_rate) == (0x21, 500_000)
    far.switch_defaults = True
    far.power_cycle(3 * 10**9)
    assert (far.base, far.bit_rate) == (0x20, 250_000)


@settings(deadline=None)
@given(WORDS)
def test_gauge_words_survive_the_way_through_two_codecs(words):
    far = board()
    far.faults.stuck = dict(enumerate(words))
    far.hear(CanFrame(0x200), 10**9)
    (_, first), (_, second) = far.outbox
    out = np.zeros(6, np.int64)
    codec.first_half(first.data, out)
    codec.second_half(second.data, out)
    assert out.tolist() == words


@settings(deadline=None)
@given(st.lists(SINGLES, min_size=6, max_size=6), st.integers(0, 5))
def test_matrix_rows_survive_the_way_through_two_codecs(row, axis):
    far = board()
    matrix = np.zeros((6, 6))
    matrix[axis] = row
    far.slots[0] = dataclasses.replace(far.slots[0], matrix=matrix)
    far.hear(CanFrame(0x202, bytes([axis])), 10**9)
    read = [x for _, f in far.outbox for x in codec.matrix_pair(f.data)]
    assert read == row


@settings(deadline=None)
@given(st.integers(0, 0x7F), st.integers(0, 15))
def test_identifiers_are_base_and_operation(base, operation):
    ident = codec.identifier(base, operation)
    assert ident < 1 << 11
    assert (ident >> 4, ident & 15) == (base, operation)


PARSERS = [
    codec.matrix_pair,
    codec.serial_number,
    codec.counts_per_unit,
    codec.unit_codes,
    codec.firmware,
    codec.diagnostic,
]


@settings(deadline=None)
@given(st.sampled_from(PARSERS), st.binary(max_size=8))
def test_any_bytes_are_read_or_refused_with_a_device_error(parse, data):
    try:
        parse(data)
    except DeviceError:
        return


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0x200, 0x20F), st.binary(max_size=8)), max_size=8))
def test_any_frames_while_polling_are_survived(frames):
    source = _POLLED
    for ident, data in frames:
        source._hear(ident, data)
    source.receive(10**9)


_POLLED = NetCanOem("ft", Rig(board()).link(), NetCanOemConfig())


@settings(deadline=None)
@given(st.integers(0, 0xFFFF))
def test_every_status_word_has_words(word):
    assert codec.describe_status(word)
