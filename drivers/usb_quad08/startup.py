"""From a box that has just got power to one whose FPGA is proven."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hil.drivers.usb_quad08 import codec
from hil.drivers.usb_quad08.link import Link, find
from hil.errors import ConfigError, DeviceError

#: Longest time that the box takes to come back with its firmware [s]; ULDAQ waits a flat 5 s.
COMEBACK_S, STEP_S = 8.0, 0.25
IMAGES = ("loader.hex", "firmware.hex", "fpga.bin")


def open_link(
    name: str, backend: Any, serial: str, images: str, pause: Callable[[float], None]
) -> Link:
    """Find a box, load what it lacks, and prove it.

    Raises
    ------
    DeviceError
        If none is attached, or it cannot be started; says what to do.
    """
    found = find(backend, codec.PRODUCT, serial)
    if not found:
        cold = find(backend, codec.LOADER, "")
        if not cold:
            what = f" with serial number {serial}" if serial else ""
            raise DeviceError(
                f"box {name!r}: no USB-QUAD08{what} is attached (09db:00ca, or 09db:0470 before "
                "its firmware is loaded); plug it in."
            )
        load_firmware(Link(name, cold[0]), _folder(name, images))
        found = _come_back(name, backend, serial, pause)
    link = Link(name, found[0])
    version = link.ask(codec.VERSION, 2)
    if version < codec.FIRMWARE_MIN:
        raise DeviceError(
            f"box {name!r}: firmware {version:#06x} is older than {codec.FIRMWARE_MIN:#06x}; "
            "load the images of UL for Linux 1.2.1 or later."
        )
    if link.ask(codec.FPGA_STATE, 1) != 1:
        load_fpga(link, _folder(name, images))
    prove(link)
    for _ in range(2):  # as ULDAQ does
        link.write_all(codec.DAC_DISARM)
        link.write_all(codec.DISARM)
    return link


def _folder(name: str, images: str) -> Path:
    """Folder of the images, complete."""
    where = "the options of the box: images = FOLDER"
    if not images:
        raise DeviceError(
            f"box {name!r}: it has no firmware (it loses it with its supply); give {where}, "
            f"with {', '.join(IMAGES)}, or run a program of UL for Linux once. See "
            "docs/hardware.md."
        )
    folder = Path(images).expanduser()
    missing = [file for file in IMAGES if not (folder / file).is_file()]
    if missing:
        raise ConfigError(f"box {name!r}: {folder} lacks {', '.join(missing)}; see {where}.")
    return folder


def load_firmware(link: Link, folder: Path) -> None:
    """Load the loader, through it the firmware, and start it; the box drops off the bus."""
    loader, firmware = (
        codec.hex_records((folder / file).read_text(encoding="ascii"), str(folder / file))
        for file in IMAGES[:2]
    )
    outside = [r for r in firmware if r[0] > codec.INTERNAL_TOP]
    inside = [r for r in firmware if r[0] <= codec.INTERNAL_TOP]
    link.device.set_interface_altsetting(0, 0)
    _reset(link, True)
    _write(link, [r for r in loader if r[0] <= codec.INTERNAL_TOP])
    _reset(link, False)
    _write(link, outside)
    _reset(link, True)
    _write(link, inside)
    _reset(link, True)
    _reset(link, False)
    link.close()


def _reset(link: Link, hold: bool) -> None:
    link.out(codec.RAM, codec.CPU_CONTROL, 0, bytes([hold]))


def _write(link: Link, records: list[tuple[int, bytes]]) -> None:
    for address, data in records:
        link.out(codec.RAM, address, 0, data)


def _come_back(name: str, backend: Any, serial: str, pause: Callable[[float], None]) -> list[Any]:
    for _ in range(round(COMEBACK_S / STEP_S)):
        pause(STEP_S)
        found = find(backend, codec.PRODUCT, serial)
        if found:
            return found
    raise DeviceError(
        f"box {name!r}: it did not come back within {COMEBACK_S:g} s after its firmware was "
        "loaded; check the images, and plug it in again."
    )


def load_fpga(link: Link, folder: Path) -> None:
    """Configure the FPGA."""
    link.out(codec.FPGA_STATE)
    for block in codec.fpga_blocks((folder / IMAGES[2]).read_bytes()):
        link.out(codec.FPGA_DATA, data=block)
    if link.ask(codec.FPGA_STATE, 1) != 1:
        raise DeviceError(
            f"box {link.name!r}: its FPGA refused {folder / IMAGES[2]}; extract the image anew."
        )


def prove(link: Link) -> None:
    """Write and read back the eight patterns that only a working FPGA returns."""
    for pattern in codec.mark_patterns():
        link.write(codec.MARK, pattern)
        seen = link.read(codec.MARK) & 0xFF
        if seen != pattern:
            raise DeviceError(
                f"box {link.name!r}: the FPGA returned 0x{seen:02x} for 0x{pattern:02x}; plug it "
                "in again, so that it is loaded anew."
            )
