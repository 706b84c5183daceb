"""A Haply Inverse3 behind its Inverse Service: the WebSocket's bytes and the JSON of format 3.x.

Written from the vendor's pages, without the driver's codec.  In a rig with ``backend =
"sim-wire"`` it answers in the tick's own time.  ``python -m hil.sim_devices.joints.haply`` serves
one on a real port of this machine until it is stopped; a rig with ``backend = "hardware"`` then
has a device.

Assumed, for the vendor does not say it: forces end after 100 ms without a message, an answer comes
within a quarter of a millisecond, gravity is compensated wholly.  Not simulated: the device's
reach and kinematics (its axes are three sliders), grips, navigation, filters.
"""

from __future__ import annotations

import argparse
import json
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from math import degrees
from typing import Any

import numpy as np
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from hil.errors import ConfigError
from hil.sim_devices.joints.bench import JointBench

_PORT = 10001
#: Silence of the host after which there is no force [ns].
IDLE_NS = 100_000_000
#: What its axes move [kg], and the force that it gives at most [N].
_MASSES, _MOST = (0.31, 0.27, 0.22), 9.0
#: Steps of its words: position [m], speed [m/s], force [N].
_STEPS = (1e-6, 1e-5, 1e-4)


class SimInverse:
    """One device.

    Parameters
    ----------
    ident : str
        Identifier.
    arm : SimArm
        The three axes that it moves.
    axes : list of (int, int)
        Joint of x, y, z, and 1 or -1 where it goes the other way.

    Attributes
    ----------
    present, powered : bool
        Whether the service lists it; whether its supply is on.
    stretch : float
        Scale of its mount.
    """

    def __init__(self, ident: str, arm: Any, axes: list[tuple[int, int]]) -> None:
        self.ident, self._arm, self._axes = ident, arm, axes
        self.present = self.powered = True
        self.stretch = 1.0
        self._heard_ns = 0
        arm.slide([_MASSES[k % 3] for k in range(len(arm.joints))], _STEPS)
        arm.p["top"] = _MOST
        arm.powered[:] = True  # it has no brakes

    def force(self, wanted: list[float], now_ns: int) -> None:
        """Forces of x, y, z [N] from now on."""
        self._heard_ns = now_ns
        for (joint, sign), value in zip(self._axes, wanted, strict=True):
            whole = round(sign * value / _STEPS[2]) if self.powered else 0
            self._arm.codes[joint] = whole

    def tick(self, now_ns: int) -> None:
        """No force for a host that is silent."""
        if now_ns - self._heard_ns > IDLE_NS or not (self.powered and self.present):
            self._arm.codes[:] = 0

    def row(self, whole: bool) -> dict[str, Any]:
        """Its entry in a message; `whole` with the configuration."""
        x = self._arm.x
        place = [sign * x["q"].item(j) for j, sign in self._axes]
        speed = [sign * x["v"].item(j) for j, sign in self._axes]
        given = [sign * self._arm.codes.item(j) * _STEPS[2] for j, sign in self._axes]
        same = {"position": vector([0.0] * 3), "scale": vector([1.0] * 3)}
        found: dict[str, Any] = {"device_id": self.ident}
        if whole:
            found["config"] = {
                "type": "inverse3",
                "device_info": {"major_version": 7, "minor_version": 4, "id": self.ident},
                "gravity_compensation": {"enabled": True, "scaling_factor": 1.0},
                "torque_scaling": {"enabled": True},
                "handedness": "right",
                "mount": same | {"scale": vector([self.stretch] * 3)},
                "filters": {"force_gate": {"gain": 0.3}, "damping": {"scalar": 0.0}},
            }
        found["state"] = {
            "cursor_position": vector(place),
            "cursor_velocity": vector(speed),
            "angular_position": _angles([degrees(q) for q in place]),
            "angular_velocity": _angles([degrees(q) for q in speed]),
            "current_cursor_force": vector(given),
            "control_domain": "cartesian",
            "control_mode": "force" if any(given) else "idle",
            "transform": same,
        }
        found["status"] = {
            "calibrated": True,
            "in_use": True,
            "power_supply": self.powered,
            "ready": self.powered,
            "started": True,
        }
        return found


def vector(values: list[float]) -> dict[str, float]:
    """Numbers by their axes."""
    return {k: round(v, 8) for k, v in zip("xyz", values, strict=True)}


def _angles(values: list[float]) -> dict[str, float]:
    """Numbers by their joints."""
    return {f"a{k}": round(v, 6) for k, v in enumerate(values)}


class Connection:
    """One client of the service: what a connection that never waits looks like to it."""

    def __init__(self, service: SimService) -> None:
        self._service, self._protocol = service, ServerProtocol()
        self.inbox, self.outbox = bytearray(), bytearray()
        self.closed = False

    def send(self, data: bytes) -> int:
        """Bytes of the client."""
        if self.closed:
            raise OSError(32, "Broken pipe")
        self.inbox += data
        return len(data)

    def recv(self, size: int) -> bytes:
        """Bytes of the service."""
        if not self.outbox and not self.closed:
            raise BlockingIOError(11, "nothing has come")
        data = bytes(self.outbox[:size])
        del self.outbox[:size]
        return data

    def close(self) -> None:
        """The client goes."""
        self.closed = True

    def work(self, now_ns: int) -> None:
        """Answer what has come."""
        if self.inbox:
            self._protocol.receive_data(bytes(self.inbox))
            self.inbox.clear()
        for event in self._protocol.events_received():
            if isinstance(event, Request):
                self._protocol.send_response(self._protocol.accept(event))
                self._say(True)
            elif isinstance(event, Frame) and event.opcode is Opcode.TEXT:
                self._service.obey(bytes(event.data), now_ns)
                if not self._service.silent and self._protocol.state is State.OPEN:
                    self._say(False)
        self.outbox += b"".join(self._protocol.data_to_send())

    def _say(self, whole: bool) -> None:
        text = json.dumps(self._service.message(whole)).encode()
        if self._service.spoilt and not whole:
            self._service.spoilt, text = False, text[: len(text) // 2]
        self._protocol.send_text(text)


class SimService:
    """The program that devices are connected to.

    Attributes
    ----------
    devices : list of SimInverse
        What it lists.
    heard : list of bytes
        Last messages of clients.
    silent, spoilt : bool
        Takes messages and answers none; cuts the next answer in half.
    """

    def __init__(self) -> None:
        self.devices: list[SimInverse] = []
        self.heard: list[bytes] = []
        self.silent = self.spoilt = False
        self._clients: list[Connection] = []

    def open(self) -> Connection:
        """A client connects."""
        self._clients.append(Connection(self))
        return self._clients[-1]

    def message(self, whole: bool) -> dict[str, Any]:
        """State of all devices, or the inventory."""
        return {"inverse3": [d.row(whole) for d in self.devices if d.present]}

    def obey(self, data: bytes, now_ns: int) -> None:
        """Commands of one message; what it does not know it passes over."""
        self.heard = [*self.heard[-7:], data]
        for row in json.loads(data).get("inverse3", []):
            body = row.get("commands", {})
            for device in self.devices:
                if device.ident != row.get("device_id") or not device.present:
                    continue
                if "set_cursor_force" in body:
                    table = body["set_cursor_force"]
                    table = table.get("vector", table.get("values"))
                    device.force([float(table[k]) for k in "xyz"], now_ns)
                if "set_angular_torques" in body:
                    table = body["set_angular_torques"]["torques"]
                    device.force([float(table[f"a{k}"]) for k in range(3)], now_ns)

    def tick(self, now_ns: int) -> None:
        """Work through what has come."""
        for client in list(self._clients):
            client.work(now_ns)
            if client.closed:
                self._clients.remove(client)
        for device in self.devices:
            device.tick(now_ns)

    def drop(self) -> None:
        """Close all connections, as when the program ends."""
        for client in self._clients:
            client.closed = True


def put(bench: JointBench, name: str, row: Mapping[str, Any]) -> None:
    """Device of a box of a rig file, at its service, moving the arm that is cabled to it.

    Raises
    ------
    ConfigError
        If its channels are not the three axes of one arm.
    """
    server, _, ident = row["address"].partition("/")
    host, _, port = server.partition(":")
    cables = sorted(row["cables"])
    moved = {arm for _, _, arm, *_ in cables}
    if [c[0] for c in cables] != [0, 1, 2] or len(moved) != 1:
        raise ConfigError(f"box {name!r}: its channels 0, 1 and 2 are the axes of one arm.")
    axes = [(joint, sign) for _, _, _, joint, sign in cables]
    at = f"{host or 'localhost'}:{port or _PORT}"
    service = bench.services.setdefault(at, SimService())
    service.devices.append(SimInverse(ident or "0A1B", bench.arms[moved.pop()], axes))


def serve_clients(
    service: SimService,
    listener: socket.socket,
    world: Callable[[], int],
    done: threading.Event,
) -> None:
    """Serve one client after the other on a real port, until `done` is set.

    Parameters
    ----------
    service : SimService
        What is served.
    listener : socket
        Bound and listening.
    world : callable
        Runs the simulated world up to now, and says the time [ns].
    """
    listener.settimeout(0.05)
    while not done.is_set():
        try:
            peer, _ = listener.accept()
        except TimeoutError:
            service.tick(world())
            continue
        client = service.open()
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.settimeout(0.001)
        with peer:
            while not done.is_set() and not client.closed:
                try:
                    data = peer.recv(1 << 16)
                except TimeoutError:
                    service.tick(world())
                    continue
                except OSError:
                    break
                if not data:
                    break
                client.send(data)
                service.tick(world())
                peer.sendall(bytes(client.outbox))
                client.outbox.clear()
        client.close()


class _Alone:
    """Three sliders of an arm that no rig file describes."""

    joints: tuple[str, ...] = ("x", "y", "z")
    center: tuple[float, ...] = (0.0, -0.12, 0.15)
    torque_limit: tuple[float, ...] = (8.0, 8.0, 8.0)
    urdf: str = (
        "<robot name='cursor'><link name='o'/><link name='a'/><link name='b'/><link name='c'/>"
        + "".join(
            f"<joint name='{n}' type='prismatic'><parent link='{p}'/><child link='{c}'/>"
            f"<axis xyz='{axis}'/></joint>"
            for n, p, c, axis in (
                ("x", "o", "a", "1 0 0"),
                ("y", "a", "b", "0 1 0"),
                ("z", "b", "c", "0 0 1"),
            )
        )
        + "</robot>"
    )


def single_device(ident: str = "0A1B") -> tuple[SimService, Callable[[], int]]:
    """A service with one device, and what runs its world along this machine's clock."""
    world = JointBench({"arm": _Alone()}, {}, 1_000_000, 1)
    service = SimService()
    service.devices.append(SimInverse(ident, world.arms["arm"], [(0, 1), (1, 1), (2, 1)]))
    world.advance(1_000_000)  # compiled before the first client
    start_ns = time.monotonic_ns()

    def now() -> int:
        world.advance(time.monotonic_ns() - start_ns)
        return int(world.now_ns)

    return service, now


def main(words: list[str] | None = None) -> int:
    """Serve one device; 3 and one sentence where the port cannot be used."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=_PORT)
    parser.add_argument("--seconds", type=float, default=np.inf, help="end after so long")
    args = parser.parse_args(words)
    done = threading.Event()
    if args.seconds < np.inf:
        threading.Timer(args.seconds, done.set).start()
    try:
        with socket.create_server(("localhost", args.port)) as listener:
            service, world = single_device()
            sys.stdout.write("ready\n")
            sys.stdout.flush()
            serve_clients(service, listener, world, done)
    except OSError as error:
        sys.stderr.write(f"port {args.port}: {error}\n")
        return 3
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
