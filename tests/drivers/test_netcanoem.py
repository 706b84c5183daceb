"""The NETCANOEM driver over python-can against the board on a simulated line."""

import errno
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.drivers.links.can import open_bus
from hil.drivers.netcanoem.driver import NetCanOem, NetCanOemConfig, attached, open_box
from hil.errors import ConfigError, DeviceError, DeviceTimeoutError
from hil.signals.bus import Bus
from hil.signals.device import MeasuredCf, OperatingState, Status, Tareable
from hil.sim_devices.force.netcanoem import NetCanOemBoard
from hil.sim_devices.force.transducer import SimulatedTransducer
from hil.testing import check_driver

sys.path.insert(0, str(Path(__file__).parent))
from can_far import NetCanFar, Rig, board, open_sensor

MS = 1_000_000
CONFIG = NetCanOemConfig()


def ticks(sensor, t_ns, n, pose=(0.0, 0.0, 0.0)):
    wrench, seen = np.zeros(6), []
    for _ in range(n):
        t_ns += MS
        seen.append(sensor.measured_cf(t_ns, np.array(pose), wrench))
    return t_ns, wrench, seen


@pytest.fixture
def rig():
    return Rig(board())


@pytest.fixture
def sensor(rig):
    device = open_sensor("ft", rig.link(), CONFIG)
    device.t = device.tare(0)
    device.enable()
    return device


def test_conformance():
    far = NetCanFar()
    checked = check_driver(far.open, far)
    assert checked.skipped == []
    assert set(checked.done) == {"states", "force", "unplug", "time-out", "bad frames"}


def test_it_reads_what_the_board_holds(rig, sensor):
    held = rig.line.nodes[0].slots[0]
    assert isinstance(sensor, MeasuredCf)
    assert isinstance(sensor, Tareable)
    identity = sensor.source.identity
    assert identity.serial == "FT08577"
    assert identity.units == ("N", "N-mm")
    np.testing.assert_allclose(identity.matrix, held.matrix, rtol=1e-6)
    assert identity.counts == (1_000_000, 1_000_000)


@pytest.mark.parametrize("model", ["nano17", "nano25"])
def test_a_wrench_comes_out_in_newtons_through_all_imperfections(model):
    rig = Rig(NetCanOemBoard(SimulatedTransducer(model, [3]), bit_rate=1_000_000))
    transducer = rig.line.nodes[0].transducer
    sensor = open_sensor("ft", rig.link(), CONFIG)
    t = sensor.tare(0)
    full = transducer.max_force
    transducer.load[:] = [0.1 * full, 0.0, -0.05 * full, 0.0, 0.0, 0.0]
    _, wrench, seen = ticks(sensor, t, 20)
    # base frame at pose 0: x stays, z turns round; gain error and cross-talk of half a percent
    np.testing.assert_allclose(wrench[[0, 2]], [0.1 * full, 0.05 * full], atol=0.006 * full)
    assert seen[-1] is Status.OK


def test_every_tick_at_one_megabit_brings_a_new_sample(sensor):
    _, _, seen = ticks(sensor, sensor.t, 50)
    assert set(seen) == {Status.OK}
    assert sensor.source.timeouts == 0


def test_two_boards_share_a_bus_at_1_khz_and_keep_their_frames_apart():
    rig = Rig(board(base=0x20), board(base=0x21))
    link = rig.link()
    pair = [open_sensor(f"ft{b}", link, NetCanOemConfig(base=b)) for b in (0x20, 0x21)]
    t = max(s.tare(0) for s in pair)
    t = pair[0].tare(t)
    for k, node in enumerate(rig.line.nodes[:2]):
        node.transducer.load[0] = 1.0 + k
    before = rig.line.frames
    for _ in range(100):
        t += MS
        for sensor in pair:
            wrench = np.zeros(6)
            status = sensor.measured_cf(t, np.zeros(3), wrench)
    assert status is Status.OK
    assert [s.source.timeouts for s in pair] == [0, 0]
    assert wrench[0] == pytest.approx(2.0, abs=0.01)
    assert rig.line.frames - before >= 590


def test_one_identifier_twice_is_refused(rig):
    link = rig.link()
    open_sensor("a", link, CONFIG)
    with pytest.raises(ConfigError, match="another base"):
        open_sensor("b", link, CONFIG)


@pytest.mark.parametrize("fault", ["mute", "lose_first", "lose_second", "delay_second", "short"])
def test_a_bad_answer_never_becomes_a_wrong_wrench(rig, sensor, fault):
    far = rig.line.nodes[0]
    far.transducer.load[0] = 5.0
    t, wrench, _ = ticks(sensor, sensor.t, 10)
    assert wrench[0] == pytest.approx(5.0, abs=0.01)
    for _ in range(5):
        setattr(far.faults, fault, 1)
        t, wrench, seen = ticks(sensor, t, 12)
        assert wrench[0] == pytest.approx(5.0, abs=0.01)
        assert np.abs(wrench[1:]).max() < 0.01
        assert seen[-1] is Status.OK
        assert Status.STALE in seen
        assert Status.INVALID not in seen
    # 4 ms late: what is asked in the meantime is not answered, either
    assert sensor.source.timeouts == (10 if fault == "delay_second" else 5)
    assert sensor.state is OperatingState.ENABLED


def test_a_late_second_frame_is_not_joined_to_the_next_first(rig, sensor):
    far = rig.line.nodes[0]
    far.faults.delay_ns = 4_500_000
    far.faults.delay_second = 1
    t, _, _ = ticks(sensor, sensor.t, 2)
    far.transducer.load[:] = [8.0, 3.0, -4.0, 0.05, 0.0, 0.0]
    wrench = np.zeros(6)
    for _ in range(12):
        t += MS
        sensor.measured_cf(t, np.zeros(3), wrench)
        old = np.abs(wrench[:3]).max() < 0.01
        new = np.allclose(wrench[:3], [8.0, -3.0, 4.0], atol=0.02)
        assert old or new
    assert new
    assert sensor.source.halves == 1


def test_a_saturated_gauge_is_not_used_and_in_the_end_a_fault(rig, sensor):
    far = rig.line.nodes[0]
    far.faults.stuck = {3: 32767}
    t, wrench, seen = ticks(sensor, sensor.t, 40)
    assert set(seen[3:]) == {Status.STALE}
    assert np.abs(wrench).max() < 0.05
    far.faults.stuck = {}
    t, _, seen = ticks(sensor, t, 5)
    assert seen[-1] is Status.OK
    far.faults.stuck = {0: -32768}
    _, _, seen = ticks(sensor, t, 80)
    assert seen[-1] is Status.INVALID
    assert sensor.state is OperatingState.FAULT
    with pytest.raises(DeviceError, match="gauges 0 are saturated"):
        sensor.source.sample(t + 100 * MS)


@pytest.mark.parametrize("bit", [1, 2, 3, 4, 5, 6, 7, 11, 12])
def test_a_critical_status_bit_stops_the_use_of_samples(rig, sensor, bit):
    rig.line.nodes[0].faults.status = 1 << bit
    _, _, seen = ticks(sensor, sensor.t, 20)
    assert set(seen[3:]) == {Status.STALE}
    assert sensor.source.status >> 15 & 1
    sensor.disable()
    with pytest.raises(DeviceError, match="the board reports"):
        sensor.enable()


@pytest.mark.parametrize("bit", [0, 8, 14])
def test_a_note_in_the_status_word_is_kept_and_measured_through(rig, sensor, bit):
    rig.line.nodes[0].faults.status = 1 << bit
    _, _, seen = ticks(sensor, sensor.t, 20)
    assert set(seen) == {Status.OK}
    assert sensor.source.status & 1 << bit


def test_the_bias_is_taken_off_and_saturation_shows_in_taring(rig):
    far = rig.line.nodes[0]
    far.transducer._offset[:] = [100.0, -200.0, 300.0, 50.0, -20.0, 10.0]
    sensor = open_sensor("ft", rig.link(), CONFIG)
    t = sensor.tare(0)
    np.testing.assert_array_equal(sensor.bias, [100, -200, 300, 50, -20, 10])
    _, wrench, _ = ticks(sensor, t, 3)
    assert np.abs(wrench).max() < 1e-9
    far.faults.stuck = {5: 32767}
    with pytest.raises(DeviceError, match="gauges 5"):
        sensor.tare(t + 10 * MS)


def test_an_overload_is_said():
    rig = Rig(board())
    sensor = open_sensor("ft", rig.link(), CONFIG, max_force=12.0)
    rig.line.nodes[0].transducer.load[2] = -20.0
    assert ticks(sensor, 0, 5)[2][-1] is Status.CLAMPED


def test_old_firmware_needs_the_units_of_the_certificate():
    def old(**options):
        rig = Rig(board(firmware=(3, 6, 1)))
        return NetCanOem("ft", rig.link(), NetCanOemConfig(**options))

    source = old(force_unit="N", torque_unit="N-mm")
    assert source.identity.counts == (1_000_000, 1_000_000)
    with pytest.raises(DeviceError, match=r"firmware 3\.6 cannot tell its units"):
        old()


def test_units_against_the_board_are_refused(rig):
    config = NetCanOemConfig(force_unit="lbf")
    with pytest.raises(DeviceError, match="counts in N and N-mm"):
        NetCanOem("ft", rig.link(), config)


def test_pounds_become_newtons():
    far = board()
    import dataclasses

    far.slots[0] = dataclasses.replace(far.slots[0], force_unit=1, torque_unit=1)
    source = NetCanOem("ft", Rig(far).link(), CONFIG)
    metric = NetCanOem("ft", Rig(board()).link(), CONFIG)
    ratio = source.calibration / metric.calibration
    np.testing.assert_allclose(ratio[:3], 4.4482216152605, rtol=1e-9)
    np.testing.assert_allclose(ratio[3:], 112.9848290276167, rtol=1e-9)


def test_an_empty_slot_is_refused_and_another_one_chosen():
    rig = Rig(board(slot=2))
    with pytest.raises(DeviceError, match="slot 0 holds no usable calibration"):
        NetCanOem("ft", rig.link(), NetCanOemConfig())
    assert NetCanOem("ft", rig.link(), NetCanOemConfig(calibration=2)).identity.serial


def test_another_transducer_than_in_the_rig_file_is_refused(rig):
    with pytest.raises(DeviceError, match="FT08577"):
        NetCanOem("ft", rig.link(), NetCanOemConfig(serial="FT00001"))


@pytest.mark.parametrize(
    ("far", "host", "base"),
    [(board(bit_rate=250_000), 1_000_000, 0x20), (board(base=0x30), 1_000_000, 0x20), (None,) * 3],
)
def test_silence_names_what_to_check(far, host, base):
    rig = Rig(*([far] if far else []))
    config = NetCanOemConfig(base=base or 0x20, bit_rate=host or 1_000_000)
    with pytest.raises(DeviceTimeoutError, match="SW2-1"):
        NetCanOem("ft", rig.link(host or 1_000_000), config)


def test_a_board_that_resets_forgets_its_slot_and_the_driver_sees_it():
    rig = Rig(board(slot=2))
    sensor = open_sensor("ft", rig.link(), NetCanOemConfig(calibration=2))
    t = sensor.tare(0)
    sensor.enable()
    ticks(sensor, t, 5)
    rig.line.nodes[0].power_cycle(rig.time.now_ns)
    _, _, seen = ticks(sensor, t + 5 * MS, 100)
    assert sensor.source.status >> 6 & 1
    assert seen[-1] is Status.INVALID
    assert sensor.state is OperatingState.FAULT


def test_options_out_of_range_are_named():
    for bad in ({"base": 128}, {"calibration": 16}, {"lost_ms": 0.1}, {"force_unit": "pound"}):
        with pytest.raises(ConfigError):
            NetCanOemConfig(**bad)


def test_boxes_on_one_channel_share_a_link_and_one_bit_rate():
    rig = Rig(board(base=0x20), board(base=0x21))
    bus = Bus("can", {"interface": "hil-sim", "prefix": ""}, advance=rig.time.at, simulated=True)
    a = open_box("a", bus, f"{rig.channel}/0x20", CONFIG, (0,))
    b = open_box("b", bus, f"{rig.channel}/33", CONFIG, (0,))
    assert len(rig.line.nodes) == 3
    with pytest.raises(ConfigError, match="one bit_rate"):
        open_box("c", bus, f"{rig.channel}/0x22", NetCanOemConfig(bit_rate=500_000), (0,))
    a.close()
    assert len(rig.line.nodes) == 3
    b.close()
    b.close()
    assert len(rig.line.nodes) == 2
    open_box("a", bus, f"{rig.channel}/0x20", CONFIG, (0,)).close()


def test_a_kernel_without_socketcan_is_told_apart_from_a_bus_that_is_down(monkeypatch):
    for number, says in ((errno.EAFNOSUPPORT, "modprobe can_raw"), (errno.ENODEV, "ip link set")):
        error = OSError(number, "no")
        monkeypatch.setattr("can.Bus", lambda error=error, **options: raise_(error))
        with pytest.raises(DeviceError, match=says):
            open_bus("socketcan", "can0", 1_000_000)


def raise_(error):
    raise error


def test_an_interface_that_is_not_there_is_named():
    with pytest.raises(DeviceError, match="no interface 'sockcan'"):
        open_box("a", Bus("can"), "can0", NetCanOemConfig(interface="sockcan"), (0,))
    with pytest.raises(DeviceError, match="ip link set can77 up"):
        open_box("a", Bus("can"), "can77", CONFIG, (0,))


def test_hil_devices_lists_boards_interfaces_and_missing_libraries(monkeypatch, capsys):
    from hil import registry
    from hil.cli import main

    rig = Rig(board(base=0x21))
    bus = Bus("can", {"interface": "hil-sim", "prefix": ""}, advance=rig.time.at, simulated=True)
    monkeypatch.setattr("hil.drivers.netcanoem.driver.can_channels", lambda: [rig.channel])
    (found,) = attached(bus)
    assert found.usable
    assert found.address == f"{rig.channel}/0x21"
    assert "transducer FT08577" in found.what
    rig.line.nodes[0].powered = False
    (found,) = attached(bus)
    assert not found.usable
    assert "SW2-1" in found.what
    monkeypatch.setattr("hil.drivers.netcanoem.driver.can_channels", list)
    monkeypatch.setitem(registry.BUILT_IN["hil.boxes"], "netft-can", "no_such_library_here")
    assert main(["devices"]) in (0, 3)
    said = capsys.readouterr().out
    assert "no_such_library_here" in said
    assert "hil-teleop[hardware]" in said
