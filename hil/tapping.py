"""Buses with a tap: frames of a box are kept for the session, or come from one."""

from __future__ import annotations

from dataclasses import replace

from hil.config import RigConfig
from hil.errors import ConfigError
from hil.record.frames import FrameLog, Replay, read_frames
from hil.signals.bus import Bus

#: Kinds of buses whose drivers can be recorded and replayed.
KINDS = ("can", "udp")


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
        self.logs: dict[str, FrameLog] = {}
        self.replays: dict[str, Replay] = {}

    def recorded(self, name: str, bus: Bus) -> Bus:
        """The bus of a box, with a tap where the rig file wants its frames."""
        if not self._frames or bus.kind not in KINDS:
            return bus
        log = self.logs.setdefault(name, FrameLog())

        def advance(t_ns: int) -> None:
            log.advance(t_ns)
            bus.advance(t_ns)

        return replace(bus, log=log, advance=advance)

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
        if kind not in KINDS:
            raise ConfigError(
                f"box {name!r}: frames of {kind!r} cannot be replayed, those of "
                f"{' and '.join(KINDS)} can; set backend = 'sim' for the devices wired to it."
            )
        found = self.replays[name] = Replay(name, read_frames(self._session, name))
        return Bus(
            kind, None, lambda label, step: lambda: None, lambda seconds: None,
            lambda: found.now_ns, found.advance, simulated=True, replay=found,
        )  # fmt: skip
