"""A Haply Inverse3 at its simulated service: the far end of `check_driver`."""

import numpy as np

from hil.drivers.haply import BOX, HaplyArm, HaplyArmConfig, InverseConfig
from hil.rig.boxes import BoxPlace, CanDrives
from hil.rigs import rig_path
from hil.signals.settable import ArmDescription
from hil.sim_devices.bench import open_bench
from hil.sim_devices.joints.bench import PARTS_PER_TICK
from hil.testing import FarEnd

URDF = rig_path("inverse3").with_name("inverse3.urdf").read_text()
PERIOD_NS = 1_000_000
SIGNS = (1, -1, 1)


class InverseFar(FarEnd):
    """Three axes, one turned round; `place` holds the cursor against its own dynamics."""

    joints = 3

    def __init__(self, address="localhost:10001/0A1B", **options):
        super().__init__()
        three = (0.0, 0.0, 0.0)
        arm = ArmDescription(("x", "y", "z"), URDF, three, three, three, (4.0, 4.0, 4.0))
        self.bench = open_bench({"arm": arm}, {}, PERIOD_NS, 1)
        cables = [(k, "drives", "arm", k, s) for k, s in enumerate(SIGNS)]
        row = {"driver": "haply-inverse", "address": address, "options": {}, "cables": cables}
        self.bus = self.bench.buses({"inverse": row})["ws"]
        self.service = self.bench.services["localhost:10001"]
        self.device, self.arm = self.service.devices[0], self.bench.arms["arm"]
        self.address, self.config = address, InverseConfig(**options)
        self.way, self.left, self.moving = np.zeros(3), 0, False
        self.arm.run = self.hold

    @property
    def now_ns(self):
        return self.bench.now_ns

    def hold(self, random, span):
        self.left = max(0, self.left - 1)
        self.arm.x["q"] = self.pose - self.way * self.left / PARTS_PER_TICK
        self.arm.x["v"] = self.way / PARTS_PER_TICK / span if self.moving else 0.0
        self.moving = self.left > 0

    def place(self, position):
        self.way, self.left, self.moving = position - self.pose, PARTS_PER_TICK, True
        self.pose[:] = position

    def effort(self):
        return self.arm.codes * self.arm.scales[:, 2]

    def unplug(self):
        self.device.present = False

    def replug(self):
        self.device.present = True

    def mute(self, on):
        self.service.silent = on

    def garble(self):
        self.service.spoilt = True

    def box(self, bus=None, address=None):
        return BOX.open_box("inverse", bus or self.bus, address or self.address, self.config, ())

    def open(self):
        box = self.box()
        places = [(box, BoxPlace("inverse", k, s)) for k, s in enumerate(SIGNS)]
        config = HaplyArmConfig(max_effort=4.0)
        arm = HaplyArm("cursor", CanDrives("cursor", places), config, PERIOD_NS * 1e-9)
        close = arm.close

        def both():
            close()
            box.close()

        arm.close = both
        return arm
