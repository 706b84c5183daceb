"""Where pyusb finds libusb: the system's, else the one that the package libusb-package brings."""

from __future__ import annotations

from typing import Any

from usb.backend import libusb1


def backend(given: Any = None) -> Any:
    """Back end for `usb.core.find`: as given, or of the libusb that there is; None without any."""
    found = libusb1.get_backend() if given is None else given
    if found is not None:
        return found
    try:
        import libusb_package
    except ImportError:
        return None
    return libusb1.get_backend(find_library=libusb_package.find_library)
