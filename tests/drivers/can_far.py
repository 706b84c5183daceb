"""One NETCANOEM board on a simulated CAN line: the far end, and what tests break on it."""

import itertools

import numpy as np

from hil.drivers import netft_can, netft_rdt
from hil.drivers.ft_sensor import ForceSensor
from hil.drivers.links.can import CanLink, open_bus
from hil.drivers.netcanoem.driver import NetCanOem, NetCanOemConfig
from hil.drivers.netft_can import NetFtCanConfig
from hil.drivers.netft_rdt import NetFtRdtConfig
from hil.signals.bus import Bus
from hil.sim_devices.canbus.line import LINES, CanLine
from hil.sim_devices.force.netcanoem import NetCanOemBoard
from hil.sim_devices.force.netft import NetFtCanBox, RdtBox
from hil.sim_devices.force.transducer import SimulatedTransducer
from hil.sim_devices.simtime import VirtualTime
from hil.testing import FarEnd

_NUMBER = itertools.count()
FAST = 1_000_000


class Rig:
    """A line of its own with some boards; time is that of the line."""

    def __init__(self, *boards):
        self.time = VirtualTime()
        self.line = CanLine(self.time)
        self.channel = f"test{next(_NUMBER)}"
        LINES[self.channel] = self.line
        for board in boards:
            self.line.attach(board)

    def link(self, bit_rate=FAST):
        return CanLink(open_bus("hil-sim", self.channel, bit_rate), self.time.at)


def quiet(model="nano17", **facts):
    """A transducer without imperfections, but for those that are given."""
    sensor = SimulatedTransducer(model, [1])
    sensor._response = np.linalg.inv(sensor.certificate.wrench_per_word())
    sensor._offset[:], sensor._thermal[:], sensor._facts[:] = 0.0, 0.0, 0.0
    return sensor


def board(model="nano17", **options):
    return NetCanOemBoard(quiet(model), **({"bit_rate": FAST} | options))


def open_sensor(name, link, config, tare_samples=20, max_force=25.0):
    return ForceSensor(name, NetCanOem(name, link, config), tare_samples, forces(max_force))


def forces(most):
    """Ranges of a sensor whose torques are not looked at."""
    return (most,) * 3 + (np.inf,) * 3


#: At pose 0 the forearm hangs: x of the sensor is x, y is -y, z is -z of the base.
HANGING = np.array([1, -1, -1, 1, -1, -1])


class NetCanFar(FarEnd):
    """`check_driver`'s hand on the board: presses it, mutes it, spoils it, cuts its supply."""

    def __init__(self, **options):
        super().__init__()
        self.board = board(**options)
        self.rig = Rig(self.board)
        self.config = NetCanOemConfig(lost_ms=30.0)

    def open(self):
        return open_sensor("ft", self.rig.link(), self.config, 10)

    def press(self, wrench):
        self.board.transducer.load[:] = wrench * HANGING

    def unplug(self):
        self.board.powered = False

    def replug(self):
        self.board.powered = True
        self.board.power_cycle(self.rig.time.now_ns)
        self.rig.time.wait(self.rig.time.now_ns + 20_000_000)

    def mute(self, on):
        self.board.faults.mute = 10**9 if on else 0

    def garble(self):
        self.board.faults.short = 1


FACTORS = (1000.0, 1000.0, 1500.0, 10.0, 10.0, 10.0)


class NetFtCanFar(NetCanFar):
    """A Net F/T box on a CAN line."""

    def __init__(self):
        FarEnd.__init__(self)
        self.board = NetFtCanBox(quiet(), 0x1B0, FAST, FACTORS)
        self.board.transducer = self.board.converter.transducer
        self.rig = Rig(self.board)
        self.config = NetFtCanConfig(scale_factors=FACTORS, lost_ms=30.0)

    def box(self):
        bus = Bus(
            "can",
            {"interface": "hil-sim", "prefix": ""},
            advance=self.rig.time.at,
            now_ns=lambda: 0,
            simulated=True,
        )
        return netft_can.open_box("ft", bus, self.rig.channel, self.config, (0,))

    def open(self):
        return ForceSensor("ft", self.box(), 10, forces(25.0))

    def replug(self):
        self.board.powered = True
        self.board.outbox.clear()
        self.board.failures = 0


class RdtFar(FarEnd):
    """A Net F/T box on a network."""

    def __init__(self):
        super().__init__()
        self.time = VirtualTime()
        self.box = RdtBox(quiet(), self.time)

    def bus(self):
        def pause(seconds):
            self.time.wait(self.time.now_ns + round(seconds * 1e9))

        return Bus(
            "udp",
            self.box.open,
            pause=pause,
            now_ns=lambda: 0,
            advance=self.time.at,
            simulated=True,
        )

    def source(self):
        return netft_rdt.open_box("ft", self.bus(), "box", NetFtRdtConfig(lost_ms=30.0), (0,))

    def open(self):
        return ForceSensor("ft", self.source(), 10, forces(25.0))

    def press(self, wrench):
        self.box.converter.transducer.load[:] = wrench * HANGING

    def unplug(self):
        self.box.here = False

    def replug(self):
        self.box.here = True
        self.box._left = 0
        self.box.arrived.clear()

    def mute(self, on):
        self.box.mute = on

    def garble(self):
        self.box.spoil = 4
