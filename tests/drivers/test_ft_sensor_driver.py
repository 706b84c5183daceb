"""Driver of the force sensor against the gauges of the simulated one."""

import numpy as np
import pytest

from hil.drivers.ft_sensor import FtSensor, FtSensorConfig
from hil.errors import ConfigError
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
    world.sense(
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
