"""A simulated NETCANOEM on any python-can interface, as a process of its own.

``python -m hil.sim_devices.force.serve udp_multicast 239.74.163.2`` answers until it is stopped; a
rig with ``interface = "udp_multicast"`` and ``backend = "hardware"`` then has a sensor.  Time is
the machine's; the bus has no bit rate of its own.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import deque

import can

from hil.sim_devices.canbus.line import CanFrame
from hil.sim_devices.force.netcanoem import DEFAULT_BASE, RESET_NS, NetCanOemBoard
from hil.sim_devices.force.transducer import SimulatedTransducer


def answer(
    bus: can.BusABC, board: NetCanOemBoard, seconds: float, own: deque[tuple[int, bytes]]
) -> bool:
    """Take one frame within `seconds` and send what the board says to it; False if none came.

    `own` are frames sent that the interface may hand back: the echo of a slot looks like its
    request.
    """
    message = bus.recv(seconds)
    if message is None:
        return False
    frame = (message.arbitration_id, bytes(message.data))
    if frame in own:
        own.remove(frame)
        return True
    # the frames' own order stands for the bus; a board that was just switched on is ready
    board.hear(CanFrame(*frame), time.monotonic_ns() + RESET_NS)
    while board.outbox:
        _, out = board.outbox.popleft()
        own.append((out.ident, out.data))
        bus.send(can.Message(arbitration_id=out.ident, is_extended_id=False, data=out.data))
    return True


def main(words: list[str] | None = None) -> int:
    """Serve one board; 3 and one sentence where the interface cannot be used."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("interface")
    parser.add_argument("channel")
    parser.add_argument("--base", type=lambda text: int(text, 0), default=DEFAULT_BASE)
    parser.add_argument("--model", default="nano17")
    parser.add_argument("--idle", type=float, default=60.0, help="end after so many idle seconds")
    args = parser.parse_args(words)
    board = NetCanOemBoard(SimulatedTransducer(args.model, [1]), base=args.base)
    try:
        with can.Bus(interface=args.interface, channel=args.channel) as bus:
            board.transducer.read(0)  # compiled before the first question
            sys.stdout.write("ready\n")
            sys.stdout.flush()
            own: deque[tuple[int, bytes]] = deque(maxlen=16)
            while answer(bus, board, args.idle, own):
                pass
    except (can.CanError, OSError) as error:
        sys.stderr.write(f"{args.interface} {args.channel}: {error}\n")
        return 3
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
