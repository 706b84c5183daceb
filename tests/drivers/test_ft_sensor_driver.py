"""Driver of the force sensor against the gauges of the simulated one."""

import numpy as np
import pytest

from hil.drivers.ft_sensor import TRANSDUCERS, FtSensor, FtSensorConfig
from hil.errors import ConfigError
from hil.signals.device import Status
from hil.sim_devices.bench import open_bench
from hil.sim_devices.plants import world
from hil.sim_devices.plants.layout import NOISES


@pytest.mark.parametrize(("model", "tolerance"), [("nano17", 0.02), ("nano25", 0.04)])
def test_a_force_on_the_tip_comes_out_in_the_base_frame(model, tolerance):
    pose, force = [0.7, 0.4, 0.9], np.array([1.0, -0.6, 0.8])
    bench = open_bench({"arm": model}, {"home": pose}, 1_000_000, 1)
    wire = bench.wire("arm")
    sensor = FtSensor("ft", wire, FtSensorConfig(model=model), 1e-3)
    after = sensor.tare(0)
    assert after == 200_000_000
    bench.state["force"][0] = force
    world.read_sensors(
        bench.parameters[0], bench.state[0], 0.2, np.zeros(NOISES), wire.counts, wire.gauges
    )
    wrench = np.zeros(6)
    sensor.measured_cf(after, np.array(pose), wrench)
    np.testing.assert_allclose(wrench[:3], force, atol=tolerance)
    assert np.abs(wrench[3:]).max() < 0.02


def test_without_load_it_reads_noise_alone():
    bench = open_bench({"arm": "nano17"}, {}, 1_000_000, 1)
    sensor = FtSensor("ft", bench.wire("arm"), FtSensorConfig(), 1e-3)
    t_ns, wrench, seen = sensor.tare(0), np.zeros(6), []
    for _ in range(200):
        t_ns += 1_000_000
        sensor.measured_cf(t_ns, np.zeros(3), wrench)
        seen.append(wrench[:3].copy())
    assert 1e-4 < np.std(seen, 0).max() < 5e-3
    assert np.abs(np.mean(seen, 0)).max() < 1e-3


def test_mistakes_are_named():
    with pytest.raises(ConfigError, match="Did you mean 'nano17'"):
        FtSensorConfig(model="nano18")
    with pytest.raises(ConfigError, match="tare_samples"):
        FtSensorConfig(tare_samples=0)


class LoadedWire:
    """Words of a sensor under a load in its own axes."""

    trouble = ""

    def __init__(self, config, load):
        self.counts = np.zeros(3, np.int64)
        self.gauges = np.rint(np.linalg.solve(config.calibration(), load)).astype(np.int64)

    def receive(self, t_ns):
        return Status.OK

    def close(self):
        pass


@pytest.mark.parametrize("pose", [[0.0, 0.0, 0.0], [0.7, 0.4, 0.9]])
@pytest.mark.parametrize(
    ("model", "load", "status"),
    [
        ("nano17", [4.2, 4.2, 4.2, 0.0, 0.0, 0.0], Status.OK),
        ("nano17", [11.9, -11.9, 16.9, 0.0, 0.0, 0.0], Status.OK),
        ("nano17", [12.1, 0.0, 0.0, 0.0, 0.0, 0.0], Status.CLAMPED),
        ("nano17", [0.0, -12.1, 0.0, 0.0, 0.0, 0.0], Status.CLAMPED),
        ("nano17", [0.0, 0.0, -17.1, 0.0, 0.0, 0.0], Status.CLAMPED),
        ("nano17", [0.0, 0.0, 0.0, 0.0, 0.0, 0.13], Status.CLAMPED),
        ("nano25", [0.0, 0.0, -160.0, 0.0, 0.0, 0.0], Status.OK),
    ],
)
def test_each_axis_of_the_sensor_has_its_own_range(pose, model, load, status):
    config = FtSensorConfig(model=model)
    sensor = FtSensor("ft", LoadedWire(config, np.array(load)), config, 1e-3)
    wrench = np.zeros(6)
    assert sensor.measured_cf(0, np.array(pose), wrench) is status
    assert np.linalg.norm(wrench[:3]) == pytest.approx(np.linalg.norm(load[:3]), abs=0.05)
    assert sensor.max_force == min(TRANSDUCERS[model].ranges[:3])
