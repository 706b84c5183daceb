"""Which libusb pyusb gets."""

import sys
import types

import pytest

from hil.drivers.usb_quad08.link import libusb_backend


def test_a_given_one_comes_first() -> None:
    given = object()
    assert libusb_backend(given) is given


def test_the_systems_before_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def get_backend(find_library: object = None) -> object:
        asked.append(find_library)
        return "packaged" if find_library else None

    package = types.ModuleType("libusb_package")
    package.find_library = lambda name: "libusb-1.0.so"  # type: ignore[attr-defined]
    monkeypatch.setattr("usb.backend.libusb1.get_backend", get_backend)
    monkeypatch.setitem(sys.modules, "libusb_package", package)
    assert libusb_backend() == "packaged"
    assert asked == [None, package.find_library]
    monkeypatch.setitem(sys.modules, "libusb_package", None)
    assert libusb_backend() is None


def test_here_there_is_one() -> None:
    pytest.importorskip("libusb_package")
    assert libusb_backend() is not None
