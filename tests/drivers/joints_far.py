"""Damiao drives of a simulated arm on a CAN line: the far end of `check_driver`."""

import numpy as np

from hil.drivers.damiao import DamiaoArm, DamiaoArmConfig
from hil.drivers.damiao_can import DamiaoBusConfig, open_box
from hil.rig.boxes import BoxPlace, CanDrives
from hil.rigs import rig_path
from hil.signals.settable import ArmDescription
from hil.sim_devices.bench import open_bench
from hil.sim_devices.joints.bench import PARTS_PER_TICK
from hil.testing import FarEnd

URDF = rig_path("arm6").with_name("arm6.urdf").read_text()
JOINTS = ("base_turn", "shoulder_lift", "elbow", "wrist_roll", "wrist_pitch", "wrist_turn")
SIGNS = (1, 1, -1, 1, 1, -1)
PERIOD_NS = 2_000_000


def description(d=6):
    limits = (26.0, 50.0, 26.0, 9.0, 9.0, 9.0)
    return ArmDescription(JOINTS, URDF, (-1.0,) * 6, (1.0,) * 6, (0.1,) * 6, limits)


class DrivesFar(FarEnd):
    """Six drives, two of them turned round; `place` holds the arm against its own dynamics."""

    joints = 6

    def __init__(self, **options):
        super().__init__()
        self.bench = open_bench({"arm": description()}, {}, PERIOD_NS, 1)
        cables = [(k + 1, "drives", "arm", k, s) for k, s in enumerate(SIGNS)]
        row = {"driver": "damiao-can", "address": "can0", "options": options, "cables": cables}
        self.bus = self.bench.buses({"bus": row})["can"]
        self.config = DamiaoBusConfig(**options)
        self.drives, self.arm = self.bench.drives["bus"], self.bench.arms["arm"]
        self.pose = np.full(6, 0.1)
        self.way, self.left, self.moving = np.zeros(6), 0, False
        self.arm.run = self.hold

    @property
    def now_ns(self):
        return self.bench.now_ns

    def hold(self, random, span):
        """A part of the way to where the joints are to stand, evenly within the tick."""
        self.left = max(0, self.left - 1)
        self.arm.x["q"] = self.pose - self.way * self.left / PARTS_PER_TICK
        self.arm.x["v"] = self.way / PARTS_PER_TICK / span if self.moving else 0.0
        self.moving = self.left > 0

    def place(self, position):
        self.way, self.left, self.moving = position - self.pose, PARTS_PER_TICK, True
        self.pose[:] = position

    def effort(self):
        return self.arm.codes * self.arm.scales[:, 2] * self.arm.powered

    def unplug(self):
        self.drives[2].cut(False)

    def replug(self):
        self.drives[2].cut(True)

    def mute(self, on):
        self.drives[4].silent = on

    def garble(self):
        self.drives[1].spoilt = True

    def box(self):
        return open_box("bus", self.bus, "can0", self.config, (1, 2, 3, 4, 5, 6))

    def open(self):
        box = self.box()
        places = [(box, BoxPlace("bus", k + 1, s)) for k, s in enumerate(SIGNS)]
        arm = DamiaoArm("arm", CanDrives("arm", places), DamiaoArmConfig(), PERIOD_NS * 1e-9)
        close = arm.close

        def both():
            close()
            box.close()

        arm.close = both
        return arm
