"""Haply Inverse3 by the JSON of its Inverse Service over a WebSocket: codec, link, box and arm.

Source: the vendor's pages "WebSocket protocol", "Control commands" and "Simulation channel" of
Inverse SDK 3.5.  The service answers every message with one state of all devices, so the tick
sends the efforts and reads what was measured after the tick before.  `docs/hardware.md` says which
facts are documented and which are assumed.
"""

from __future__ import annotations

import json
import socket
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import fabs, isfinite, radians
from typing import Any, Protocol

import numba as nb
import numpy as np

from hil.drivers.damiao import DamiaoArm, DamiaoArmConfig, DrivesWire
from hil.drivers.links.udp import ReplayedDatagrams, split_host
from hil.errors import ConfigError, DeviceError, unknown
from hil.signals.bus import Attached, Bus
from hil.signals.device import FloatArray, IntArray, Status

# -- the JSON -------------------------------------------------------------------------------------

#: Port of the format 3.x.
PORT = 10001


@dataclass(frozen=True)
class CoordinateSpace:
    """What three numbers of the device are.

    Parameters
    ----------
    position, velocity : str
        Keys in ``state``.
    axes : tuple of str
        Keys of the three numbers.
    unit : float
        [m], or [rad], of one in the JSON.
    steps : tuple of float
        Sizes of the whole numbers that a session keeps: position [m or rad], speed [m/s or rad/s],
        effort [N or N m].
    """

    position: str
    velocity: str
    axes: tuple[str, str, str]
    unit: float
    steps: tuple[float, float, float]


#: The cursor's axes in metres and newtons; or the joints, in degrees.
COMMAND_SPACES = {
    "cursor": CoordinateSpace(
        "cursor_position", "cursor_velocity", ("x", "y", "z"), 1.0, (1e-8, 1e-7, 1e-4)
    ),
    "joints": CoordinateSpace(
        "angular_position", "angular_velocity", ("a0", "a1", "a2"), radians(1.0), (1e-8, 1e-7, 1e-5)
    ),
}
#: Format -> key of the three numbers in `set_cursor_force`.
_FORMATS = {"3.5": "vector", "3.1": "values"}


def command_message(device: str, space: str, version: str) -> bytes:
    """Message with efforts of one device, three places left for the numbers."""
    body = (
        f'"set_cursor_force":{{"{_FORMATS[version]}":{{"x":%.4f,"y":%.4f,"z":%.4f}}}}'
        if space == "cursor"
        else '"set_angular_torques":{"torques":{"a0":%.6f,"a1":%.6f,"a2":%.6f}}'
    )
    who = json.dumps(device).replace("%", "%%")
    return f'{{"inverse3":[{{"device_id":{who},"commands":{{{body}}}}}]}}'.encode()


def devices(message: bytes) -> list[dict[str, Any]] | None:
    """Rows of the Inverse3 in a message of the service; None where it is none of its messages."""
    try:
        said = json.loads(message)
    except ValueError:
        return None
    rows = said.get("inverse3", []) if isinstance(said, dict) else None
    return rows if isinstance(rows, list) and all(isinstance(r, dict) for r in rows) else None


def numbers_of(row: Mapping[str, Any], key: str, axes: tuple[str, str, str]) -> Any:
    """Three finite numbers of a device's state; None where they are not there."""
    try:
        table = row["state"][key]
        found = (float(table[axes[0]]), float(table[axes[1]]), float(table[axes[2]]))
    except (KeyError, TypeError, ValueError):
        return None
    return found if isfinite(found[0] + found[1] + found[2]) else None


def lacks(row: Mapping[str, Any]) -> str:
    """What keeps a device from giving forces, by its ``status``; empty where nothing does."""
    status = row.get("status")
    status = status if isinstance(status, dict) else {}
    if status.get("power_supply") is False:
        return "has no power supply"
    return "is not ready" if status.get("ready") is False else ""


def scaled(row: Mapping[str, Any]) -> str:
    """Where the service stretches positions, which are then no metres; empty where it does not."""
    places = (("config", "mount"), ("state", "transform"))
    for part, key in places:
        table = row.get(part)
        scale = (table.get(key) or {}).get("scale") if isinstance(table, dict) else None
        if isinstance(scale, dict) and any(float(v) != 1.0 for v in scale.values()):
            return f"{key}.scale = {scale}"
    return ""


# -- the link -------------------------------------------------------------------------------------


class Stream(Protocol):
    """What the link needs of a TCP connection that never waits."""

    def send(self, data: bytes) -> int:
        """Send some of it; how much."""
        ...

    def recv(self, size: int) -> bytes:
        """What has come; `BlockingIOError` when nothing has, empty when it is closed."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


#: Wait for a connection [s].
CONNECT_S = 2.0
_NEEDS = (
    "the library websockets is not installed, and the Inverse Service speaks over it; "
    "pip install 'hil-teleop[haply]'"
)


def _socket(host: str, port: int) -> Stream:
    """Connection that sends at once (no delay for larger packets) and never waits."""
    found = socket.create_connection((host, port), CONNECT_S)
    found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    found.setblocking(False)
    return found


class MessageLink:
    """Text messages to and from a WebSocket; nothing waits but opening.

    Parameters
    ----------
    bus : Bus
        Time, and in a simulation what opens the stand-in of a connection.
    host, port : str, int
        The service.

    Attributes
    ----------
    trouble : str
        Why the connection is gone; empty while it is not.

    Raises
    ------
    ConfigError
        If the library is missing.
    DeviceError
        If nobody answers there.
    """

    def __init__(self, bus: Bus, host: str, port: int) -> None:
        self.trouble = ""
        self._bus, self._log = bus, bus.log
        self._messages: deque[bytes] = deque()
        self._part, self._unsent, self._open = b"", b"", False
        self._replayed = ReplayedDatagrams(bus.replay) if bus.replay is not None else None
        if self._replayed is not None:
            return
        try:
            from websockets.client import ClientProtocol
            from websockets.frames import Frame, Opcode
            from websockets.uri import parse_uri
        except ImportError as error:
            raise ConfigError(_NEEDS) from error
        self._frame, self._continues = Frame, Opcode.CONT
        self._data = (Opcode.TEXT, Opcode.BINARY, Opcode.CONT)
        opener: Callable[[str, int], Stream] = bus.handle or _socket
        try:
            self._stream = opener(host, port)
        except OSError as error:
            raise DeviceError(
                f"no Inverse Service answers at {host}:{port} ({error}); start it, or Haply Hub, "
                "on that machine"
            ) from error
        self._protocol: Any = ClientProtocol(parse_uri(f"ws://{host}:{port}"))
        self._protocol.send_request(self._protocol.connect())
        self._flush()

    def advance(self, t_ns: int) -> None:
        """It is `t_ns` now."""
        self._bus.advance(t_ns)

    def send(self, message: bytes) -> bool:
        """Send one message; False where the connection has no room for it now."""
        if self._replayed is not None:
            self._replayed.send(message)
            return True
        if self.trouble or (self._unsent and not self._flush()):
            return False
        self._protocol.send_text(message)
        if self._log is not None:
            self._log.add("tx", "", message)
        self._flush()
        return True

    def _flush(self) -> bool:
        """Hand what is to be sent to the connection; whether all of it went."""
        rest = self._unsent + b"".join(self._protocol.data_to_send())
        try:
            self._unsent = rest[self._stream.send(rest) :] if rest else b""
        except BlockingIOError:
            self._unsent = rest
        except OSError as error:
            self.trouble = str(error)
        return not self._unsent

    def receive(self) -> bytes | None:
        """Next message, or None; never waits."""
        if self._replayed is not None:
            try:
                return self._replayed.recv(1 << 20)
            except BlockingIOError:
                return None
        if not self._messages and not self.trouble:
            self._take()
        return self._messages.popleft() if self._messages else None

    def _take(self) -> None:
        """Whole messages of what has come."""
        try:
            data = self._stream.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError as error:
            self.trouble = str(error)
            return
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
            self.trouble = "the service closed the connection"
        for event in self._protocol.events_received():
            if isinstance(event, self._frame) and event.opcode in self._data:
                start = self._part if event.opcode is self._continues else b""
                self._part = start + bytes(event.data)
                if event.fin:
                    self._messages.append(self._part)
                    if self._log is not None:
                        self._log.add("rx", "", self._part)
        refused = self._protocol.handshake_exc or self._protocol.parser_exc
        if refused is not None and not self.trouble:
            self.trouble = str(refused)
        if not self.trouble:
            self._flush()

    def close(self) -> None:
        """Say goodbye and release the connection."""
        if self._replayed is not None:
            return
        if not self.trouble:
            self._protocol.send_close(1000)
            self._flush()
            self.trouble = "closed"
        self._stream.close()


# -- the box --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class InverseConfig:
    """Options of the box ``haply-inverse``.

    Parameters
    ----------
    space : str
        ``"cursor"``: channels 0, 1, 2 are x, y, z of the cursor [m, N].  ``"joints"``: they are
        a0, a1, a2 [rad, N m].
    format : str
        ``"3.5"``, or ``"3.1"`` for services before it, which name the force's numbers otherwise.
    torque_unit : float
        Torque of one unit of ``set_angular_torques`` [N m]; the vendor does not say it, so that
        ``space = "joints"`` has no default.
    answer_ms : float
        Wait for the service while opening and switching off.
    stale_ms, lost_ms : float
        Age of a state from which it is STALE; from which the device is lost [ms].
    """

    space: str = "cursor"
    format: str = "3.5"
    torque_unit: float = 0.0
    answer_ms: float = 500.0
    stale_ms: float = 5.0
    lost_ms: float = 50.0

    def __post_init__(self) -> None:
        if self.space not in COMMAND_SPACES:
            raise ConfigError(unknown("space", self.space, COMMAND_SPACES))
        if self.format not in _FORMATS:
            raise ConfigError(unknown("format", self.format, _FORMATS))
        if not 0 < self.stale_ms <= self.lost_ms or self.answer_ms <= 0:
            raise ConfigError("0 < stale_ms <= lost_ms and answer_ms > 0 are needed.")
        if self.space == "joints" and (self.torque_unit <= 0 or self.format != "3.5"):
            raise ConfigError(
                'space = "joints" needs format "3.5" and torque_unit [N m], what one unit of '
                "set_angular_torques is; measure it with a weight on a lever, the vendor's pages "
                "do not say it."
            )


_OK, _STALE, _LOST = Status.OK, Status.STALE, Status.LOST
#: Messages without an answer after which no other one is sent: the answers stay at most so old.
FLYING = 2
#: Messages that one tick takes at most.
_CROWD = 16
#: Wait between two looks while opening [s].
_STEP_S = 1e-3


class Inverse3:
    """One device of the service; see `hil.rig.boxes.DrivesBox`.

    Parameters
    ----------
    name : str
        Box.
    bus : Bus
        For its waits.
    link : MessageLink
        Open connection.
    place : str
        Where the service is, for messages.
    device : str
        Identifier; empty for the only one.
    config : InverseConfig
        Options.

    Attributes
    ----------
    counts, rates : ndarray (3,) of int
        Last answer, in `scales`.
    scales : ndarray (3, 3)
        Size of a step: position [m or rad], speed [m/s or rad/s], effort [N or N m].
    settings : dict
        What the service does to the device, as it says; it goes into the session.
    trouble : str
        Why the device is lost; empty while it is not.
    malformed, skipped : int
        Answers that were none; ticks without a message because the service was behind.

    Raises
    ------
    DeviceError
        If the device is not there, or the service stretches its positions.
    """

    channels = (0, 1, 2)

    def __init__(
        self,
        name: str,
        bus: Bus,
        link: MessageLink,
        place: str,
        device: str,
        config: InverseConfig,
    ) -> None:
        self.name, self.config, self.place = name, config, place
        self._bus, self._link, self._space = bus, link, COMMAND_SPACES[config.space]
        self.counts, self.rates = np.zeros(3, np.int64), np.zeros(3, np.int64)
        self.scales = np.tile(self._space.steps, (3, 1))
        position, speed, effort = self._space.steps
        self._per_position, self._per_speed = self._space.unit / position, self._space.unit / speed
        self._effort = effort / (config.torque_unit or 1.0)
        self.trouble, self.malformed, self.skipped = "", 0, 0
        self._on = self._closed = self._asked = False
        self._flying, self._heard_ns, self._gone = 0, -1, ""
        self._stale_ns, self._lost_ns = round(config.stale_ms * 1e6), round(config.lost_ms * 1e6)
        self.serial, self._row = device, {}
        self._row = self._found()
        self.serial, self.settings = str(self._row["device_id"]), self._row.get("config") or {}
        self._command = command_message(self.serial, config.space, config.format)
        self._zero = self._command % (0.0, 0.0, 0.0)
        self._take(self._row)

    def _found(self) -> dict[str, Any]:
        """Row of the device in the inventory, which the service sends by itself at first."""
        for _ in range(max(1, round(self.config.answer_ms * 1e-3 / _STEP_S))):
            message = self._link.receive()
            if message is not None:
                return self._chosen(devices(message))
            if self._link.trouble:
                break
            self._bus.pause(_STEP_S)
        said = self._link.trouble or f"it sent no list of devices in {self.config.answer_ms:g} ms"
        raise DeviceError(
            f"box {self.name!r}: no Inverse Service speaks at {self.place}: {said}; its WebSocket "
            f"of format 3.x has the port {PORT} unless it was set otherwise"
        )

    def _chosen(self, rows: list[dict[str, Any]] | None) -> dict[str, Any]:
        rows = rows or []
        known = [str(r.get("device_id")) for r in rows]
        mine = [r for r in rows if self.serial in ("", r.get("device_id"))]
        if len(mine) != 1:
            what = f"device {self.serial}" if self.serial else "one Inverse3"
            raise DeviceError(
                f"box {self.name!r}: the service at {self.place} has "
                f"{', '.join(known) or 'no Inverse3'}, and {what} is wanted; "
                + (
                    f"write address = '{self.place}/{known[0]}', or another one of them"
                    if known
                    else "connect it, and look whether Haply Hub shows it"
                )
            )
        stretched = scaled(mine[0])
        if stretched and self.config.space == "cursor":
            raise DeviceError(
                f"box {self.name!r}: the service has {stretched} for device {known[0]}, so that "
                "its positions are no metres; set every scale to 1 there"
            )
        if numbers_of(mine[0], self._space.position, self._space.axes) is None:
            raise DeviceError(
                f"box {self.name!r}: the service's list has no state.{self._space.position} of "
                f"device {known[0]}; is its format older than 3.1?"
            )
        return mine[0]

    def receive(self, t_ns: int) -> Status:
        """Answers that have come until `t_ns`; STALE, then LOST, where none comes for a while."""
        self._link.advance(t_ns)
        if self.trouble:
            return _LOST
        if self._heard_ns < 0:
            self._heard_ns = t_ns
        fresh = self._drain()
        if fresh:
            self._heard_ns, self._gone = t_ns, ""
            if self._on:
                lack = lacks(self._row)
                if lack:
                    self.trouble = f"{self.name}: device {self.serial} {lack}."
        elif self._link.trouble:
            self.trouble = f"{self.name}: {self._link.trouble}."
        elif self._asked and t_ns - self._heard_ns >= self._lost_ns:
            why = self._gone or f"the service at {self.place} does not answer"
            self.trouble = f"{self.name}: {why} for {self.config.lost_ms:g} ms."
        if self.trouble:
            return _LOST
        return _STALE if self._asked and t_ns - self._heard_ns >= self._stale_ns else _OK

    def _drain(self) -> bool:
        """Whether a good state was among what has come; the newest one is kept."""
        fresh = False
        for _ in range(_CROWD):
            message = self._link.receive()
            if message is None:
                break
            self._flying = max(0, self._flying - 1)
            rows = devices(message)
            if rows is None:
                self.malformed += 1
                continue
            self._gone = f"the service lists device {self.serial} no more"
            for row in rows:
                if row.get("device_id") == self.serial:
                    self._gone = ""
                    fresh = self._take(row)
        return fresh

    def _take(self, row: dict[str, Any]) -> bool:
        """Keep a state, if it is whole."""
        space = self._space
        position = numbers_of(row, space.position, space.axes)
        velocity = numbers_of(row, space.velocity, space.axes)
        if position is None or velocity is None:
            self.malformed += 1
            return False
        self._row = row
        for k in range(3):
            self.counts[k] = round(position[k] * self._per_position)
            self.rates[k] = round(velocity[k] * self._per_speed)
        return True

    def send(self, codes: IntArray) -> None:
        """Efforts (3,) in steps; zeros while it is off, for without a message comes no answer."""
        self._asked = True
        if self._flying >= FLYING:
            self.skipped += 1
            return
        message = self._zero
        if self._on:
            e = self._effort
            message = self._command % (e * codes.item(0), e * codes.item(1), e * codes.item(2))
        self._flying += self._link.send(message)

    def rest(self) -> None:
        """Zeros at once, and from now on; never waits."""
        self._on = False
        self._flying += self._link.send(self._zero)

    def power(self, on: bool) -> None:
        """Let efforts through or not; switching off waits until the service has said that it heard.

        A device that has no power or is not ready is lost.
        """
        if on:
            lack = lacks(self._row)
            if lack:
                self.trouble = f"{self.name}: device {self.serial} {lack}."
            self._on = not lack
            return
        self.rest()
        for _ in range(max(1, round(self.config.answer_ms * 1e-3 / _STEP_S))):
            if not self._flying or self._link.trouble or self.trouble:
                break
            self._bus.pause(_STEP_S)
            self._drain()

    def describe(self) -> str:
        """What the device is and what its service does to forces, for `hil devices`."""
        return f"Inverse3 {self.serial} by the service at {self.place}" + service_settings(
            self.settings
        )

    def close(self) -> None:
        """Zeros, then leave the service."""
        if not self._closed:
            self._closed = True
            self.power(False)
            self._link.close()


def service_settings(config: Mapping[str, Any]) -> str:
    """Settings of the service that a model of the device sees, in words."""
    said = []
    for key in ("gravity_compensation", "torque_scaling"):
        table = config.get(key)
        if isinstance(table, dict) and "enabled" in table:
            said.append(f"{key.replace('_', ' ')} {'on' if table['enabled'] else 'off'}")
    filters = config.get("filters")
    for key, value in (("damping", "scalar"), ("force_gate", "gain")):
        table = filters.get(key) if isinstance(filters, dict) else None
        if isinstance(table, dict) and value in table:
            said.append(f"{key.replace('_', ' ')} {table[value]:g}")
    if "handedness" in config:
        said.append(f"{config['handedness']}-handed")
    return f" ({', '.join(said)})" if said else ""


def open_box(
    name: str, bus: Bus, address: str, config: InverseConfig, channels: tuple[int, ...]
) -> Inverse3:
    """Open a device at ``HOST[:PORT][/DEVICE]``; empty is the only one on this machine.

    Raises
    ------
    ConfigError
        If the address or a channel is wrong, or a library is missing.
    DeviceError
        If the service or the device is not there.
    """
    if any(c not in Inverse3.channels for c in channels):
        raise ConfigError(f"box {name!r}: channels are 0, 1 and 2, not {max(channels)}.")
    server, _, device = address.partition("/")
    host, port = split_host(name, server or "localhost", PORT)
    try:
        link = MessageLink(bus, host, port)
    except (ConfigError, DeviceError) as error:
        raise type(error)(f"box {name!r}: {error}") from error.__cause__
    try:
        return Inverse3(name, bus, link, f"{host}:{port}", device, config)
    except OSError:
        link.close()
        raise


def attached(bus: Bus) -> list[Attached]:
    """Devices of the service on this machine, if there is one; nothing is moved."""
    try:
        link = MessageLink(bus, "localhost", PORT)
    except DeviceError:
        return []
    try:
        for _ in range(200):
            message = link.receive()
            if message is not None or link.trouble:
                break
            bus.pause(_STEP_S)
    finally:
        link.close()
    rows = devices(message or b"") or []
    return [
        Attached(
            f"localhost:{PORT}/{row.get('device_id')}",
            f"Inverse3{service_settings(row.get('config') or {})}"
            + (f"; it {lacks(row)}" * bool(lacks(row))),
            not lacks(row),
        )
        for row in rows
    ]


class BOX:
    """What the registry looks for under ``haply-inverse``."""

    BUS = "ws"
    Config = InverseConfig
    open_box = staticmethod(open_box)
    attached = staticmethod(attached)


# -- the arm --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HaplyArmConfig(DamiaoArmConfig):
    """Options of the device ``haply``: those of ``damiao``, and the largest effort.

    Parameters
    ----------
    max_effort : float
        Of each axis [N, or N m]; the service limits forces by itself, at a value that is not
        published.
    """

    max_effort: float = 5.0

    def __post_init__(self) -> None:
        if not 0.0 < self.max_effort < 1e3:
            raise ConfigError("max_effort is above 0 [N or N m].")


@nb.njit(cache=True, nogil=True)
def whole(effort: Any, scale: Any, most: float, out: Any, sent: Any) -> int:
    """Whole steps for efforts; 0 = as asked, 1 = clamped, 3 = not a number (zeros).

    Parameters
    ----------
    effort, sent : ndarray (d,)
        Asked for, and really going out [N or N m].
    scale : ndarray (d,)
        Size of a step.
    most : float
        Largest effort.
    out : ndarray (d,)
        Steps.
    """
    status = 0
    for i in range(effort.size):
        if not isfinite(effort[i]):
            status = 3
    for i in range(effort.size):
        value = effort[i] if status != 3 else 0.0
        if fabs(value) > most:
            value = most if value > 0.0 else -most
            status = 1
        out[i] = round(value / scale[i])
        sent[i] = scale[i] * out[i]
    return status


class HaplyArm(DamiaoArm):
    """Three axes of an Inverse3: `MeasuredJs` and `ServoJf`, with zero for no effort."""

    def __init__(self, name: str, wire: DrivesWire, config: HaplyArmConfig, period: float) -> None:
        super().__init__(name, wire, config, period)
        self._most = config.max_effort

    @property
    def effort_limit(self) -> FloatArray:
        """Largest effort [N or N m] (d,)."""
        return np.full(self.counts.size, self._most)

    def _encode(self, effort: FloatArray, sent: FloatArray) -> int:
        status: int = whole(effort, self._effort, self._most, self.codes, sent)
        return status


#: What the registry looks for under ``haply``.
Config = HaplyArmConfig
open_device = HaplyArm
