"""An arm behind simulated boxes as the far end of `check_driver`."""

from contextlib import ExitStack

from bench_far import ArmFar

from hil.drivers.premium import PremiumArm, PremiumConfig
from hil.drivers.usb_31xx.driver import Usb31xx, Usb31xxConfig
from hil.drivers.usb_quad08.driver import Quad08, Quad08Config
from hil.rig.boxes import BoxPlace, BoxWire
from hil.sim_devices.bench import WiredBench


class BoxFar(ArmFar):
    """Arm with one USB-QUAD08 and one USB-3101; `lost` names the one that tests break."""

    def __init__(self, lost="quad", quad=None, dac=None, signs=(1, -1, 1)):
        super().__init__()
        self.quad, self.dac = quad or Quad08Config(), dac or Usb31xxConfig()
        self.signs = signs
        cables = {
            role: [(k, role, "arm", k, s) for k, s in enumerate(signs)]
            for role in ("encoders", "motors")
        }
        self.wired = WiredBench(
            self.bench,
            {
                "quad": {
                    "driver": "usb-quad08",
                    "address": "",
                    "options": {},
                    "cables": cables["encoders"],
                },
                "dac": {
                    "driver": "usb-31xx",
                    "address": "",
                    "options": {"model": self.dac.model},
                    "cables": cables["motors"],
                },
            },
        )
        self.lost = self.wired.boxes[lost]

    @property
    def now_ns(self):
        return self.bench.now_ns

    def unplug(self):
        self.lost.plugged = False

    def replug(self):
        self.lost.plugged = True
        self.lost.power_up(**({"cold": False} if self.lost is self.wired.boxes["quad"] else {}))

    def mute(self, on):
        self.lost.muted = on

    def garble(self):
        self.lost.garbled = 1

    def open(self):
        """The arm, which closes its boxes too."""
        with ExitStack() as stack:
            quad = Quad08("quad", self.wired.buses["usb"], "", self.quad, (0, 1, 2))
            stack.callback(quad.close)
            dac = Usb31xx("dac", self.wired.buses["hid"], "", self.dac, (0, 1, 2))
            stack.callback(dac.close)
            rows = {
                "encoders": [(quad, BoxPlace("quad", k, s)) for k, s in enumerate(self.signs)],
                "motors": [(dac, BoxPlace("dac", k, s)) for k, s in enumerate(self.signs)],
            }
            wire = BoxWire("arm", rows, self.bench.advance)
            wire.close = stack.pop_all().close
        return PremiumArm("arm", wire, PremiumConfig(home=tuple(self.pose)), 1e-3)
