"""A python-can bus across two processes: the driver here, the board there."""

import errno
import socket
import subprocess
import sys

import can
import pytest

from hil.drivers.links.can import open_bus
from hil.drivers.netcanoem.driver import NetCanOemConfig, open_box
from hil.errors import DeviceError
from hil.signals.bus import Bus

GROUP = "239.74.163.77"
CONFIG = NetCanOemConfig(interface="udp_multicast", answer_ms=2000.0)


def multicast():
    """What this machine says to a multicast group; empty where it carries one."""
    try:
        with (
            can.Bus(interface="udp_multicast", channel=GROUP) as a,
            can.Bus(interface="udp_multicast", channel=GROUP) as b,
        ):
            a.send(can.Message(arbitration_id=1, is_extended_id=False))
            return "" if b.recv(1.0) else "nothing comes back"
    except (can.CanError, OSError) as error:
        return str(error)


def test_the_driver_meets_a_board_in_another_process():
    trouble = multicast()
    if trouble:
        # honest either way: what the machine cannot do is said by the driver, not hidden here
        with pytest.raises(DeviceError, match=r"multicast|no answer"):
            open_box("ft", Bus("can"), GROUP, CONFIG, (0,))
        return
    words = [sys.executable, "-m", "hil.sim_devices.force.serve", "udp_multicast", GROUP]
    with subprocess.Popen([*words, "--idle", "30"], stdout=subprocess.PIPE, text=True) as board:
        try:
            assert board.stdout.readline() == "ready\n"
            box = open_box("ft", Bus("can"), f"{GROUP}/0x20", CONFIG, (0,))
            assert box.serial == "FT08577"
            t = 0
            for _ in range(20):
                t = box.sample(t)
            assert box.gauges.any()
            assert box.timeouts <= 2
            box.close()
        finally:
            board.terminate()


@pytest.mark.parametrize("number", [errno.ENODEV, errno.ENETUNREACH])
def test_without_multicast_the_message_says_what_to_do(monkeypatch, number):
    real = socket.socket.setsockopt

    def refused(self, *args):
        if args[1] in (socket.IP_ADD_MEMBERSHIP, socket.IPV6_JOIN_GROUP):
            raise OSError(number, "No such device")
        return real(self, *args)

    monkeypatch.setattr(socket.socket, "setsockopt", refused)
    with pytest.raises(DeviceError, match="multicast route"):
        open_bus("udp_multicast", GROUP, 1_000_000)


def test_without_msgpack_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setattr("can.interfaces.udp_multicast.utils.msgpack", None)
    with pytest.raises(DeviceError, match=r"hil-teleop\[hardware\]"):
        open_bus("udp_multicast", GROUP, 1_000_000)


def test_the_served_board_says_when_it_cannot_be_served(capsys):
    from hil.sim_devices.force import serve

    assert serve.main(["socketcan", "can77"]) == 3
    assert "can77" in capsys.readouterr().err
