"""Buses with a tap: frames of a box are kept for the session, or come from one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from hil import registry
from hil.errors import ConfigError
from hil.record.container import read
from hil.record.frames import BoundedFrameLog, RecordedAnswers, read_frames
from hil.rig.config import RigConfig
from hil.signals.bus import Bus

#: Kinds of buses whose drivers can be recorded and replayed.
FRAME_KINDS = ("can", "udp", "ws", "usb", "hid")
#: Those whose tap is in what the bus hands to the library; the others have it in their link.
HANDLES = ("usb", "hid")


class Taps:
    """What is recorded of the boxes of a rig, and what is replayed to them.

    Parameters
    ----------
    config : RigConfig
        Its table ``[record]`` says what.

    Attributes
    ----------
    logs : dict of str to FrameLog
        Box -> its frames.
    replays : dict of str to Replay
        Box -> the recording that answers for it.
    """

    def __init__(self, config: RigConfig) -> None:
        self._frames, self._session = config.record.frames, config.record.replay
        self.logs: dict[str, BoundedFrameLog] = {}
        self.replays: dict[str, RecordedAnswers] = {}

    def recorded(self, name: str, bus: Bus) -> Bus:
        """The bus of a box, with a tap where the rig file wants its frames."""
        if not self._frames or bus.kind not in FRAME_KINDS:
            return bus
        log = self.logs.setdefault(name, BoundedFrameLog())

        def advance(t_ns: int) -> None:
            log.advance(t_ns)
            bus.advance(t_ns)

        tapped = replace(bus, log=log, advance=advance)
        if bus.kind not in HANDLES:
            return tapped
        return replace(tapped, handle=registry.load("hil.taps", bus.kind).recorded(bus, log))

    def advance(
        self, boxes: Iterable[str], world: Callable[[int], None] | None
    ) -> Callable[[int], None] | None:
        """What a wire through these boxes tells the time to, beside a simulated `world`."""
        told: list[Callable[[int], None]] = [self.logs[b].advance for b in boxes if b in self.logs]
        told += [self.replays[b].advance for b in boxes if b in self.replays]
        if not told:
            return world
        if world is not None:
            told.append(world)

        def advance(t_ns: int) -> None:
            for tell in told:
                tell(t_ns)

        return advance

    def told(self) -> dict[str, dict[str, str]]:
        """What a session should say of its frames at its end: lost ones, and differences."""
        found = {f"frames/{box}": {"dropped": str(log.dropped)} for box, log in self.logs.items()}
        for box, replay in self.replays.items():
            found[f"replay/{box}"] = {
                "session": self._session,
                "asked": str(replay.asked),
                "other": str(replay.other),
                "first": "; ".join(replay.differences[:3]),
            }
        return found

    def ends(self) -> tuple[int, str]:
        """Last tick of the recording that answers for boxes, and where it ends in words.

        No tick and no words where nothing is replayed, or the recording has no ticks.
        """
        row = read(self._session).topics.get("/loop/timing") if self.replays else None
        if row is None or len(row.times) < 2:
            return 0, ""
        ticks = row.sequence[-1]
        period = (row.times[-1] - row.times[0]) / (row.sequence[-1] - row.sequence[0])
        return ticks, f"the recording {self._session} ends at {1e-9 * ticks * period:.6g} s"

    def replayed(self, name: str, kind: str) -> Bus:
        """Bus of a box that a session answers for.

        Raises
        ------
        ConfigError
            If no session is named, or frames of this kind of bus cannot be replayed.
        DataError
            If the session has no frames of this box.
        """
        if not self._session:
            raise ConfigError(
                f"box {name!r}: back end 'replay' needs the session, [record] replay = 'S.mcap'."
            )
        if kind not in FRAME_KINDS:
            raise ConfigError(
                f"box {name!r}: frames of {kind!r} cannot be replayed, those of "
                f"{' and '.join(FRAME_KINDS)} can; set backend = 'sim' for the devices wired to it."
            )
        found = self.replays[name] = RecordedAnswers(name, read_frames(self._session, name))
        plain = Bus(
            kind,
            None,
            found.run,
            found.pause,
            lambda: found.now_ns,
            found.advance,
            simulated=True,
            replay=found,
        )
        if kind not in HANDLES:
            return plain
        return replace(plain, handle=registry.load("hil.taps", kind).replayed(found))
