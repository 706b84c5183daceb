"""Wire of one device through boxes, and what it needs of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from hil.errors import ConfigError, unknown
from hil.signals.device import IntArray, Status
from hil.wiring import Place

#: Looked up once: members of an enumeration are slow to find in the fast path.
_OK, _LOST = Status.OK, Status.LOST


class CountsBox(Protocol):
    """A box that counts.

    `channels` lists its open channels, `counts` (channels,) holds the counts of the last
    `receive` and stays the same array, `trouble` says why it is lost.
    """

    channels: tuple[int, ...]
    counts: IntArray
    trouble: str

    def receive(self, t_ns: int) -> Status:
        """Refresh `counts` for time `t_ns`; never waits or raises."""
        ...


class CodesBox(Protocol):
    """A box that gives voltages.

    `trouble` says why it is lost; `heartbeat` whether it shows an amplifier that the host lives.
    """

    trouble: str
    heartbeat: bool

    def put(self, channel: int, code: int) -> None:
        """Code -32768..32767 of a channel, which goes out as soon as the box can."""
        ...

    def rest(self) -> None:
        """Zeros as soon as possible and no sign of life any more; never waits."""
        ...

    def power(self, on: bool) -> None:
        """Start or stop the sign of life; stopping sends zeros first."""
        ...


class BoxWire:
    """Wire of one device through boxes: what `Wire` says, counts and codes from anywhere.

    Parameters
    ----------
    name : str
        Device.
    rows : dict
        Role -> (box, `Place`) in the order of the motors; roles ``encoders`` and ``motors``.
    advance : callable, optional
        Lets a simulated world run to a time [ns].

    Raises
    ------
    ConfigError
        If a role is unknown or does not have three places, or no box gives a heartbeat.
    """

    def __init__(
        self, name: str, rows: Mapping[str, list[tuple[Any, Place]]],
        advance: Callable[[int], None] | None,
    ) -> None:  # fmt: skip
        encoders, motors = _roles(name, rows)
        self.counts = np.zeros(len(encoders), np.int64)
        self.gauges = np.zeros(6, np.int64)
        self._offset = np.zeros(len(encoders), np.int64)
        self._in = [
            (i, b.counts, b.channels.index(p.channel), p.sign) for i, (b, p) in enumerate(encoders)
        ]
        self._out = [(i, b, p.channel, p.sign) for i, (b, p) in enumerate(motors)]
        self._readers: list[CountsBox] = _distinct(b for b, _ in encoders)
        self._writers: list[CodesBox] = _distinct(b for b, _ in motors)
        self._advance = advance
        self._lost = False

    @property
    def trouble(self) -> str:
        """Why the wire is lost; empty while it is not."""
        texts = [b.trouble for b in self._readers] + [b.trouble for b in self._writers]
        return " ".join(filter(None, texts))

    def home(self, counts: IntArray) -> None:
        """The arm rests where its encoders should read `counts` (3,)."""
        self._offset[:] = 0
        self._collect()
        self._offset[:] = counts - self.counts
        self.counts[:] = counts

    def receive(self, t_ns: int) -> Status:
        """Counts for time `t_ns`; LOST also when the way out is lost, and then for good."""
        if self._advance is not None:
            self._advance(t_ns)
        status = _OK
        for box in self._readers:
            said = box.receive(t_ns)
            status = status if said is _OK else max(status, said)
        self._collect()
        for writer in self._writers:
            if writer.trouble:
                status = _LOST
        if status is _LOST and not self._lost:
            self._lost = True
            for writer in self._writers:
                writer.rest()
        return _LOST if self._lost else status

    def _collect(self) -> None:
        counts, offset = self.counts, self._offset
        for i, source, at, sign in self._in:
            counts[i] = sign * source.item(at) + offset.item(i)

    def send(self, codes: IntArray) -> None:
        """DAC codes to their boxes."""
        for i, box, channel, sign in self._out:
            box.put(channel, sign * codes.item(i))

    def power(self, on: bool) -> None:
        """Sign of life on or off."""
        for writer in self._writers:
            writer.power(on and not self._lost)

    def close(self) -> None:
        """The boxes are the rig's and are closed by it."""


#: Roles of a device that is wired to boxes, and places each.
ROLES = {"encoders": 3, "motors": 3}


def check_roles(name: str, rows: Mapping[str, Sequence[object]]) -> None:
    """Refuse a device whose roles are not those of `ROLES`, with as many places.

    Raises
    ------
    ConfigError
        Names the table.
    """
    for role in rows:
        if role not in ROLES:
            raise ConfigError(f"[devices.{name}.channels]: {unknown('role', role, ROLES)}")
    for role, n in ROLES.items():
        if len(rows.get(role, ())) != n:
            raise ConfigError(f"[devices.{name}.channels]: {role} needs {n} places BOX/CHANNEL.")


def _roles(
    name: str, rows: Mapping[str, list[tuple[Any, Place]]]
) -> tuple[list[tuple[Any, Place]], list[tuple[Any, Place]]]:
    check_roles(name, rows)
    if not any(box.heartbeat for box, _ in rows["motors"]):
        raise ConfigError(
            f"[devices.{name}.channels]: none of its motor boxes gives a heartbeat, and its "
            "amplifiers would go on when the host dies; set heartbeat_ms in the options of one of "
            "them."
        )
    return rows["encoders"], rows["motors"]


def _distinct(boxes: Any) -> list[Any]:
    return list({id(b): b for b in boxes}.values())
