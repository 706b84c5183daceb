"""The whole rig on simulated buses: force sensors over CAN beside encoders and motors."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from hil.drivers.ft_sensor import FtSensorConfig, open_device
from hil.errors import ConfigError
from hil.record.mcap_read import summary
from hil.record.schema import read_fields
from hil.rig.boxes import open_boxes, wiring_plan
from hil.rig.config import load_rig
from hil.rig.open import force_sensors, open_rig
from hil.runtime import runner
from hil.signals.device import Status
from hil.sim_devices.bench import open_bench

RIGS = Path(__file__).parents[2] / "rigs"


def record(path, over=None, seconds=1.0, seed=4, rig="teleop.toml"):
    runner.run_session(load_rig(RIGS / rig, over), seconds, seed, output=path)
    return path


def test_forces_come_over_can_one_tick_late_in_the_base_frame():
    config = load_rig(RIGS / "teleop.toml", {"backend": "sim-wire"})
    bench = open_bench(force_sensors(config), dict(config.simulation), 1_000_000, 3)
    pose, true = np.array([0.4, 0.5, 0.7]), np.zeros(3)

    def hold(_):
        bench.state["q"][1], bench.state["force"][1] = pose, true

    bench.after.append(hold)
    with ExitStack() as stack:
        boxes = open_boxes(config, bench.buses(wiring_plan(config)), stack)
        sensor = open_device("ft", boxes["follower-ft"], FtSensorConfig(), 1e-3)
        t, before, wrench = sensor.tare(bench.now_ns), np.zeros(3), np.zeros(6)
        errors = []
        for k in range(300):
            t += 1_000_000
            status = sensor.measured_cf(t, pose, wrench)
            errors.append(np.abs(wrench[:3] - before).max())
            # what holds at the end of this tick is sampled in the next and read at its end
            before = true.copy()
            true[:] = 2.0 * np.sin([0.03 * k, 0.02 * k, 0.05 * k])
        assert status is Status.OK
        assert np.sqrt(np.mean(np.square(errors[5:]))) < 0.03


def test_the_session_tells_the_transducer_and_its_matrix(tmp_path):
    path = record(tmp_path / "s.mcap", {"backend": "sim-wire"}, 0.2)
    told = summary(path).metadata
    assert told["calibration/follower-force"]["transducer"] == "FT08577"
    assert "matrix" in told["calibration/leader-force"]
    _, words = read_fields(path, "/rig/raw")
    assert np.abs(words["follower_gauge1"]).max() > 10


def test_one_device_alone_may_be_on_a_simulated_bus(tmp_path):
    force = {"backend": "sim-wire"}
    over = {"devices": {"leader-force": force}}
    path = record(tmp_path / "s.mcap", over, 0.2)
    assert "transducer" in summary(path).metadata["calibration/leader-force"]
    assert "transducer" not in summary(path).metadata["calibration/follower-force"]


def test_same_seed_same_bytes(tmp_path):
    a, b = (record(tmp_path / f"{n}.mcap", {"backend": "sim-wire"}, 0.2) for n in "ab")
    assert a.read_bytes() == b.read_bytes()


@pytest.mark.parametrize(
    ("over", "text"),
    [
        ({"boxes": {"follower-ft": {"address": "can0/0x20"}}}, "address of its own"),
        ({"boxes": {"follower-ft": {"address": "can0/xx"}}}, "not CHANNEL/BASE"),
        ({"devices": {"leader-force": {"channels": {"motors": ["leader-ft/0"]}}}}, "gauges alone"),
        ({"devices": {"leader-force": {"channels": {"gauges": ["leader-ft/1"]}}}}, "channel 0"),
    ],
)
def test_wrong_wiring_of_a_sensor_is_one_sentence(over, text):
    from hil.rig.open import open_rig

    with pytest.raises(ConfigError, match=text):
        open_rig(load_rig(RIGS / "teleop.toml", {"backend": "sim-wire", **over}), 0)


@pytest.mark.parametrize(
    "box",
    [
        {"driver": "netft-rdt", "address": "192.168.1.1"},
        {
            "driver": "netft-can",
            "address": "can1/0x1b0",
            "options": {"scale_factors": [1000.0] * 6},
        },
    ],
)
def test_another_interface_is_a_change_of_the_boxs_table(box, tmp_path):
    over = {"devices": {"leader-force": {"backend": "sim-wire"}}, "boxes": {"leader-ft": box}}
    path = record(tmp_path / "s.mcap", over, 0.2, rig="identify.toml")
    assert "counts_per_force" in summary(path).metadata["calibration/leader-force"]


@pytest.mark.parametrize(
    ("bit_rate", "second", "gaps"),
    [
        (1_000_000, "can0", (1, 1)),
        (500_000, "can0", (1, 2)),
        (500_000, "can1", (1, 1)),
        (250_000, "can0", (2, 3)),
        (250_000, "can1", (2, 2)),
        (125_000, "can0", (4, 7)),
    ],
)
def test_every_how_many_ticks_a_force_is_new(bit_rate, second, gaps):
    """The table of docs/hardware.md; a slow bus is waited for and not asked over and over."""
    slow = {"options": {"bit_rate": bit_rate, "stale_ms": 10.0}}
    over = {"leader-ft": slow, "follower-ft": slow | {"address": f"{second}/0x21"}}
    config = load_rig(RIGS / "teleop.toml", {"backend": "sim-wire", "boxes": over})
    rig = open_rig(config, 3)
    try:
        boxes = [rig.boxes["leader-ft"], rig.boxes["follower-ft"]]
        t, new = rig.origin_ns, [[0], [0]]
        before = [b.gauges.copy() for b in boxes]
        for k in range(1, 300):
            t += 1_000_000
            for i, box in enumerate(boxes):
                assert box.receive(t) is Status.OK
                if (box.gauges != before[i]).any():
                    new[i].append(k)
                    before[i][:] = box.gauges
        assert tuple(int(np.diff(row[2:]).max()) for row in new) == gaps
        assert [b.timeouts for b in boxes] == [0, 0]
    finally:
        rig.close()
