"""The tutorial's device from outside of the package passes the public suite."""

import os
import re
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from hil import registry
from hil.drivers.premium import PremiumArm, PremiumConfig
from hil.errors import DeviceError
from hil.rig.boxes import BoxPlace, BoxWire
from hil.rig.config import load_rig
from hil.rig.open import open_rig
from hil.signals.bus import Bus
from hil.signals.device import Status
from hil.testing import check_driver

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
RIGS = Path(__file__).parents[2] / "rigs"


@pytest.fixture
def own(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import serial_mcu
    import simulated_mcu

    yield serial_mcu, simulated_mcu
    for name in ("serial_mcu", "simulated_mcu"):
        sys.modules.pop(name)


def open_arm(module, bus, address="/dev/ttyACM0"):
    box = module.open_box("mcu", bus, address, module.Config(), (0, 1, 2))
    three = [(box, BoxPlace("mcu", k, 1)) for k in range(3)]
    wire = BoxWire("arm", {"encoders": three, "motors": three}, None)
    arm = PremiumArm("arm", wire, PremiumConfig(), 1e-3)
    close = arm.close

    def both():
        close()
        box.close()

    arm.close = both
    return arm


def test_the_tutorials_device_conforms(own):
    module, far_module = own
    far = far_module.SimulatedMcu()
    bus = Bus("serial", far, pause=lambda seconds: None)
    checked = check_driver(lambda: open_arm(module, bus), far)
    assert checked.skipped == []
    assert {"states", "position", "effort", "zero on exit", "unplug", "time-out", "bad frames"} <= {
        *checked.done
    }


def test_the_pages_code_runs_and_nothing_is_skipped(own, capsys):
    page = (EXAMPLES.parent / "own-device.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.S)
    exec(code, {})
    assert "skipped=[]" in capsys.readouterr().out


def test_driver_and_simulation_together_stay_below_150_lines():
    files = [EXAMPLES / f"{name}.py" for name in ("serial_mcu", "simulated_mcu")]
    code = [x for f in files for x in f.read_text(encoding="utf-8").splitlines() if x.strip()]
    assert len(code) < 150


def test_golden_bytes(own):
    module, _ = own
    assert module.checked(module.ASK.pack(0xA5, 1, 1, -2, 256, 0)) == bytes.fromhex(
        "A5 01 0100 FEFF 0001 A5"
    )
    assert module.ANSWER.size == 14


def test_a_real_port_carries_the_same_bytes(own):
    """pyserial itself on a pseudo-terminal; the board answers while the driver waits."""
    module, _ = own
    board, port = os.openpty()

    def pause(seconds):
        if os.read(board, 9)[:1] == b"\xa5":
            answer = struct.pack("<B3i", 0x5A, 7, -8, 9)
            os.write(board, answer + bytes([sum(answer) & 255]))

    try:
        box = module.open_box(
            "mcu",
            Bus("serial", pause=pause),
            os.ttyname(port),
            module.Config(baud=115200),
            (0, 1, 2),
        )
        np.testing.assert_array_equal(box.counts, [7, -8, 9])
        box.power(True)
        for channel, code in enumerate((1, 2, 3)):
            box.put(channel, code)
        pause(0)
        pause(0)
        assert box.receive(1_000_000) is Status.OK
        box.close()
        assert os.read(board, 9)[1] == 0
    finally:
        os.close(board)
        os.close(port)


def test_a_rig_file_finds_it_by_its_entry_point_and_says_what_is_missing(own, monkeypatch):
    monkeypatch.setitem(registry.BUILT_IN["hil.boxes"], "serial-mcu", "serial_mcu")
    places = ["mcu/0", "mcu/1", "mcu/2"]
    arm = {"backend": "hardware", "channels": {"encoders": places, "motors": places}}
    over = {
        "devices": {"follower-arm": arm},
        "boxes": {"mcu": {"driver": "serial-mcu", "address": "/dev/ttyNONE"}},
    }
    with pytest.raises(DeviceError, match="/dev/ttyNONE"):
        open_rig(load_rig(RIGS / "identify.toml", over), 0)
