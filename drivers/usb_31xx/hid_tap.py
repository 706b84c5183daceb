"""What stands for the module ``hid`` with a tap: every report into a log, or out of a recording.

Keys: ``list:`` what was enumerated, ``rNN:`` reports of number NN in either direction, ``gone:``
where the box was lost.
"""

from __future__ import annotations

import base64
import json
from typing import Any

from hil.drivers.usb_31xx.driver import module
from hil.signals.bus import Bus, FrameLog, Replay


def recorded(bus: Bus, log: FrameLog) -> Any:
    """Module whose reports go into a log too."""
    return _Recorded(module(bus), log)


def replayed(replay: Replay) -> Any:
    """Module that a recording answers for."""
    return _Replayed(replay)


class _Recorded:
    def __init__(self, real: Any, log: FrameLog) -> None:
        self._real, self._log = real, log

    def enumerate(self, vendor: int, product: int) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = self._real.enumerate(vendor, product)
        text = [
            {"serial_number": r["serial_number"], "path": base64.b64encode(r["path"]).decode()}
            for r in rows
        ]
        self._log.add("rx", "list:", json.dumps(text).encode())
        return rows

    def device(self) -> Any:
        return _RecordedDevice(self._real.device(), self._log)


class _RecordedDevice:
    def __init__(self, real: Any, log: FrameLog) -> None:
        self._real, self._log = real, log
        self.open_path, self.close = real.open_path, real.close
        self.set_nonblocking = real.set_nonblocking

    def write(self, report: bytes) -> int:
        self._log.add("tx", f"r{report[0]:02x}:", bytes(report))
        try:
            done = int(self._real.write(report))
        except (OSError, ValueError):
            self._log.add("rx", "gone:", b"")
            raise
        if done < 0:
            self._log.add("rx", "gone:", b"")
        return done

    def read(self, size: int, timeout_ms: int = 0) -> list[int]:
        try:
            found: list[int] = (
                self._real.read(size, timeout_ms) if timeout_ms else (self._real.read(size))
            )
        except (OSError, ValueError):
            self._log.add("rx", "gone:", b"")
            raise
        if found:
            self._log.add("rx", f"r{found[0]:02x}:", bytes(found))
        return found


class _Replayed:
    def __init__(self, replay: Replay) -> None:
        self._replay = replay

    def enumerate(self, vendor: int, product: int) -> list[dict[str, Any]]:
        frame = self._replay.take(True, "list")
        rows = json.loads(frame.data) if frame is not None else []
        return [{**r, "path": base64.b64decode(r["path"])} for r in rows]

    def device(self) -> Any:
        return _ReplayedDevice(self._replay)


class _ReplayedDevice:
    def __init__(self, replay: Replay) -> None:
        self._replay, self._gone = replay, False

    def open_path(self, path: bytes) -> None:
        """The recorded one was opened too."""

    def close(self) -> None:
        """Nothing to release."""

    def set_nonblocking(self, on: int) -> None:
        """It never waits."""

    def _there(self) -> None:
        if self._gone or self._replay.take(False, "gone") is not None:
            self._gone = True
            raise OSError(19, "read error: gone in the recording")

    def write(self, report: bytes) -> int:
        self._there()
        self._replay.put(f"r{report[0]:02x}:", bytes(report))
        return len(report)

    def read(self, size: int, timeout_ms: int = 0) -> list[int]:
        self._there()
        frame = self._replay.take_any()
        return list(frame.data[:size]) if frame is not None else []
