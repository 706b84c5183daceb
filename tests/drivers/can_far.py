"""One NETCANOEM board on a simulated CAN line: the far end, and what tests break on it."""

import itertools

import numpy as np

from drivers.ft_sensor import ForceSensor
from drivers.links.can import CanLink, open_bus
from drivers.netcanoem import NetCanOem, NetCanOemConfig
from hil.testing import FarEnd
from sim_devices.canbus.line import LINES, CanLine
from sim_devices.force.netcanoem import NetCanOemBoard
from sim_devices.force.transducer import Transducer
from sim_devices.simtime import VirtualTime

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
    sensor = Transducer(model, [1])
    sensor._response = np.linalg.inv(sensor.certificate.wrench_per_word())
    sensor._offset[:], sensor._thermal[:], sensor._facts[:] = 0.0, 0.0, 0.0
    return sensor


def board(model="nano17", **options):
    return NetCanOemBoard(quiet(model), **({"bit_rate": FAST} | options))


def open_sensor(name, link, config, tare_samples=20, max_force=25.0):
    return ForceSensor(name, NetCanOem(name, link, config), tare_samples, max_force)


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
        # at pose 0 the forearm hangs: x of the sensor is x, y is -y, z is -z of the base
        self.board.transducer.load[:] = wrench * np.array([1, -1, -1, 1, -1, -1])

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
