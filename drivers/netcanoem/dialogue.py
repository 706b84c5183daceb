"""Questions to a NETCANOEM board that wait for their answer: start-up and diagnosis."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from hil.drivers.links.can import CanLink
from hil.drivers.netcanoem import codec
from hil.drivers.netcanoem.config import NetCanOemConfig
from hil.errors import DeviceError, DeviceTimeoutError
from hil.signals.device import FloatArray

#: An answer takes well under a millisecond; a board that resets, tens of them [s].  A rig file
#: that gives answers more time than this gives it to these questions too.
PATIENCE_S = 0.05
TRIES = 3


@dataclass(frozen=True)
class Identity:
    """What a board said of itself.

    Parameters
    ----------
    serial : str
        Of the transducer in the selected slot.
    firmware : tuple of 3 int
        Major, minor, build.
    counts : tuple of 2 int
        Counts per unit of force and of torque.
    units : tuple of 2 str
        Units of force and torque.
    matrix : ndarray (6, 6)
        As read: rows Fx Fy Fz Tx Ty Tz, columns gauges 0 to 5 [counts of force or torque].
    """

    serial: str
    firmware: tuple[int, int, int]
    counts: tuple[int, int]
    units: tuple[str, str]
    matrix: FloatArray

    def calibration(self) -> FloatArray:
        """Matrix (6, 6): wrench in the sensor frame per gauge count [N, N m]."""
        newton = dict(codec.FORCE_UNITS.values())[self.units[0]]
        newton_metre = dict(codec.TORQUE_UNITS.values())[self.units[1]]
        # f = G g / (counts per unit), rows 0-2 force, 3-5 torque (manual, "Converting")
        scale = [newton / self.counts[0]] * 3 + [newton_metre / self.counts[1]] * 3
        return np.asarray(self.matrix * np.array(scale)[:, None])

    def record(self) -> dict[str, str]:
        """All of it as text, for a session's metadata."""
        return {
            "transducer": self.serial,
            "firmware": ".".join(map(str, self.firmware)),
            "counts_per_unit": json.dumps(self.counts),
            "units": json.dumps(self.units),
            "matrix": json.dumps(self.matrix.tolist()),
        }


class Dialogue:
    """One question at a time, asked again when the answer does not come.

    Parameters
    ----------
    name : str
        Of the device, for messages.
    link : CanLink
        The bus.
    config : NetCanOemConfig
        Base identifier and slot.
    """

    def __init__(self, name: str, link: CanLink, config: NetCanOemConfig) -> None:
        self.name, self._link, self._config = name, link, config
        self._heard: list[tuple[int, bytes]] = []

    def hear(self, operation: int, data: bytes) -> None:
        """Mailbox while a question is open; what cannot be an answer is a request come back."""
        if len(data) == codec.ANSWER_BYTES.get(operation):
            self._heard.append((operation, data))

    def ask(self, operation: int, request: bytes = b"", frames: int = 1) -> list[bytes]:
        """Data of the `frames` answers, operations `operation`, `operation` + 1, ...

        Raises
        ------
        DeviceTimeoutError
            If the board does not answer, or not in full, after three attempts.
        """
        wanted = list(range(operation, operation + frames))
        patience = max(PATIENCE_S, self._config.answer_ms * 1e-3)
        for _ in range(TRIES):
            self._link.poll()
            self._heard.clear()
            self._link.send(codec.identifier(self._config.base, operation), request)
            if self._link.wait(patience, lambda: self._last(frames) == wanted):
                return [d for _, d in self._heard[-frames:]]
        raise DeviceTimeoutError(self._silence(operation))

    def _last(self, frames: int) -> list[int]:
        return [o for o, _ in self._heard[-frames:]]

    def identify(self) -> Identity:
        """Select the slot of the configuration and read all that a conversion needs."""
        config = self._config
        version = codec.firmware(self.ask(codec.READ_FIRMWARE)[0])
        echo = self.ask(codec.SET_CALIBRATION, bytes([config.calibration]))[0]
        if echo != bytes([config.calibration]):
            raise DeviceError(
                f"{self.name}: asked for calibration {config.calibration}, the board echoes "
                f"{echo.hex() or 'nothing'}; nothing measured with it could be trusted"
            )
        serial = codec.serial_number(self.ask(codec.READ_SERIAL)[0])
        if config.serial and serial != config.serial:
            raise DeviceError(
                f"{self.name}: slot {config.calibration} holds transducer {serial!r}, the rig "
                f"file expects {config.serial!r}; choose the slot or the sensor"
            )
        counts, units = self._scale(version)
        return Identity(serial, version, counts, units, self._matrix())

    def _matrix(self) -> FloatArray:
        rows = [
            [x for d in self.ask(codec.READ_MATRIX, bytes([axis]), 3) for x in codec.matrix_pair(d)]
            for axis in range(6)
        ]
        matrix = np.array(rows)
        if not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix) < 6:
            raise DeviceError(
                f"{self.name}: slot {self._config.calibration} holds no usable calibration "
                "matrix (not finite, or not of full rank); is the slot empty?"
            )
        return matrix

    def _scale(self, version: tuple[int, int, int]) -> tuple[tuple[int, int], tuple[str, str]]:
        """Counts per unit and units, from the board or, with old firmware, from the rig file."""
        given = (self._config.force_unit, self._config.torque_unit)
        if version[:2] >= codec.UNITS_SINCE:
            counts = codec.counts_per_unit(self.ask(codec.READ_COUNTS)[0])
            force, torque = codec.unit_codes(self.ask(codec.READ_UNITS)[0])
            told = (codec.FORCE_UNITS[force][0], codec.TORQUE_UNITS[torque][0])
            if any(g and g != t for g, t in zip(given, told, strict=True)):
                raise DeviceError(
                    f"{self.name}: the board counts in {' and '.join(told)}, the rig file says "
                    f"{' and '.join(g or '(nothing)' for g in given)}; leave both out of it"
                )
            return counts, told
        if not all(given):
            raise DeviceError(
                f"{self.name}: firmware {version[0]}.{version[1]} cannot tell its units (3.7 "
                "can); give force_unit and torque_unit of the calibration sheet in the options"
            )
        return (codec.OLD_COUNTS, codec.OLD_COUNTS), given

    def _silence(self, operation: int) -> str:
        config, bus = self._config, self._link
        if bus.trouble:
            return f"{self.name}: the CAN bus failed: {bus.trouble}"
        heard = f"; {bus.errors} error frames on the bus" if bus.errors else ""
        return (
            f"{self.name}: no answer to operation {operation:#x} from base {config.base:#04x} at "
            f"{config.bit_rate} bit/s{heard}. Check supply (12-25 V), wiring and termination, the "
            "base, and the bit rate: boards come with base 0x20 at 250000 bit/s, and SW2-1 ON "
            "at power-up brings these back"
        )
