"""The boxes by the vendor's library: conformance over its documented names, and what is refused."""

import sys
from pathlib import Path

import numpy as np
import pytest

from hil.drivers.usb_31xx import driver as usb_31xx
from hil.drivers.usb_quad08 import driver as usb_quad08
from hil.errors import ConfigError, DeviceError
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.signals.bus import Bus
from hil.signals.device import Status
from hil.testing import check_driver

sys.path.insert(0, str(Path(__file__).parent))
from uldaq_far import UldaqFar

ALL = {"states", "position", "effort", "zero on exit", "unplug", "time-out", "bad frames"}


@pytest.fixture
def far(monkeypatch):
    def made(**options):
        found = UldaqFar(**options)
        monkeypatch.setitem(sys.modules, "uldaq", found.library)
        return found

    return made


@pytest.mark.parametrize("options", [{}, {"quad": {"bits": 16}, "dac": {"staged": False}}])
def test_conformance(far, options):
    one = far(**options)
    checked = check_driver(one.open, one)
    assert set(checked.done) == ALL
    assert one.library.connected == 0
    assert ("a_out_list" in one.library.calls) is not bool(options)
    assert one.library.beats > 10


def test_the_counters_are_set_up_as_by_our_own_driver(far):
    one = far(quad={"index": "latch"})
    box = usb_quad08.open_box("quad", one.bus("usb"), "", one.quad, (0, 2))
    kind, mode = one.library.config[2][:2]
    assert kind == one.library.CounterMeasurementType.ENCODER
    assert mode == 1 << 20 | 1 << 21  # X4, latched on the index
    assert sorted(one.library.config) == [0, 1, 2]
    start, zero = one.now_ns, one.library.scan.zero
    for k in range(1, 20):
        one.place(one.pose + np.array([5e-3, 0.0, -5e-3]))
        one.bench.advance(start + k * 1_000_000)
        assert box.receive(start + k * 1_000_000) is Status.OK
    moved = (one.wire.counts - zero)[[0, 2]]
    assert np.abs(moved).min() > 100
    assert np.allclose(box.counts, moved, atol=60)  # one packet behind
    assert "by uldaq" in box.describe()
    box.close()


def test_a_box_that_is_not_there_is_told_with_what_is(far):
    one = far()
    with pytest.raises(DeviceError, match=r"no USB-QUAD08 77 \(it lists USB-QUAD08 010, USB-3101"):
        usb_quad08.open_box("quad", one.bus("usb"), "77", one.quad, (0,))


def test_without_the_library_the_rig_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "uldaq", None)
    for module, kind in ((usb_quad08, "usb"), (usb_31xx, "hid")):
        with pytest.raises(ConfigError, match=r"libuldaq.*pip install uldaq"):
            module.open_box("box", Bus(kind), "", module.Config(route="uldaq"), (0,))


def test_a_simulated_box_is_not_reached_by_the_library():
    config = load_rig(rig_path("teleop"))
    assert config.boxes
    with pytest.raises(ConfigError, match="real boxes only"):
        usb_quad08.open_box(
            "box", Bus("usb", simulated=True), "", usb_quad08.Config(route="uldaq"), (0,)
        )


def test_an_unknown_route_is_refused():
    with pytest.raises(ConfigError, match="own, uldaq"):
        usb_31xx.Config(route="vendor")
