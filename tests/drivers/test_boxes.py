"""Arms behind simulated boxes pass the conformance suite, whichever box is broken."""

import pytest
from box_far import BoxFar

from hil.drivers.usb_31xx.driver import Usb31xxConfig
from hil.drivers.usb_quad08.driver import Quad08Config
from hil.testing import check_driver

ALL = ["states", "position", "effort", "zero on exit", "unplug", "time-out", "bad frames"]


@pytest.mark.parametrize("lost", ["quad", "dac"])
def test_an_arm_behind_boxes_passes_everything(lost):
    far = BoxFar(lost)
    checked = check_driver(far.open, far)
    assert (checked.done, checked.skipped) == (ALL, [])


@pytest.mark.parametrize(
    ("quad", "dac"),
    [
        (Quad08Config(bits=16, lost_ms=15.0), Usb31xxConfig(staged=False)),
        (Quad08Config(rate_hz=20_000.0), Usb31xxConfig("usb-3114", heartbeat_ms=40.0)),
    ],
)
def test_in_every_mode(quad, dac):
    far = BoxFar("quad", quad, dac)
    assert check_driver(far.open, far).done == ALL
