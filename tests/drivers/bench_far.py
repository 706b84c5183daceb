"""The simulated bench as the far end of `check_driver`: arms that stand where the test says."""

import numpy as np

from hil.sim_devices.bench import open_bench
from hil.sim_devices.plants import world
from hil.sim_devices.plants.layout import NOISES
from hil.testing import FarEnd


class BenchFar(FarEnd):
    """One arm of a bench; `advance` holds it in place against its own dynamics."""

    def __init__(self, model="nano17", home=(0.1, 0.4, 0.3)):
        super().__init__()
        self.bench = open_bench({"arm": model}, {"home": list(home)}, 1_000_000, 1)
        self.wire = self.bench.wire("arm")
        self.pose, self.force = np.array(home), np.zeros(6)
        self.bench.after.insert(0, self.hold)

    def advance(self, t_ns):
        self.bench.advance(t_ns)

    def hold(self, t_ns):
        p, x = self.bench.parameters[0], self.bench.state[0]
        x["q"], x["qm"], x["v"], x["vm"] = self.pose, self.pose, 0.0, 0.0
        x["force"] = self.force[:3]
        world.read_sensors(p, x, t_ns * 1e-9, np.zeros(NOISES), self.wire.counts, self.wire.gauges)


class ArmFar(BenchFar):
    """The arm of the bench."""

    def place(self, position):
        self.pose[:] = position

    def effort(self):
        return self.bench.codes[0] * self.bench.parameters["dac"][0]


class SensorFar(BenchFar):
    """The force sensor of the bench, whose world has no torque on the tip."""

    axes = 3

    def press(self, wrench):
        self.force[:] = wrench
