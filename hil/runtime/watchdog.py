"""Watchdog outside of the process: where the loop stops ticking, it takes the power off.

The process beside the loop shares nothing with it but a page of memory, so that it outlives a
crash, a kill and a hang of the interpreter.  It cannot reach the motors itself: it runs the
program of the rig file (a relay, a supply with a network port), and writes down that it did.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from hil.errors import ConfigError
from hil.rig.config import SafetyConfig

_BEAT = struct.Struct("<qqq")  # monotonic time [ns], tick, 1 = ended properly
#: How often the heart is felt, in shares of the time-out.
_SHARE = 0.2


class Watchdog:
    """The loop's end of the page.

    Parameters
    ----------
    page : mmap
        Shared with the process beside.
    """

    def __init__(self, page: mmap.mmap) -> None:
        self._page = page

    def beat(self, tick: int) -> None:
        """Say that `tick` is done."""
        _BEAT.pack_into(self._page, 0, time.monotonic_ns(), tick, 0)

    def end(self) -> None:
        """Say that the session is over, and the motors are off."""
        _BEAT.pack_into(self._page, 0, time.monotonic_ns(), -1, 1)


def beside(session: Path) -> Path:
    """Where a watchdog writes that it acted."""
    return session.with_name(session.name + ".watchdog.json")


@contextlib.contextmanager
def guarded(config: SafetyConfig, session: Path) -> Iterator[Watchdog | None]:
    """Watchdog process around a session; None where the rig file asks for none.

    Raises
    ------
    ConfigError
        If the process cannot be started.
    """
    if not config.watchdog:
        yield None
        return
    with tempfile.TemporaryFile() as file:
        file.truncate(mmap.PAGESIZE)
        with mmap.mmap(file.fileno(), mmap.PAGESIZE) as page:
            dog = Watchdog(page)
            told = json.dumps(
                {
                    # told, not asked: the loop may be gone before this process has begun
                    "parent": os.getpid(),
                    "timeout": config.watchdog,
                    "cut": list(config.cut),
                    "report": str(beside(session)),
                }
            )
            words = [sys.executable, "-m", "hil.runtime.watchdog", str(file.fileno()), told]
            try:
                child = subprocess.Popen(
                    words,
                    pass_fds=[file.fileno()],
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,
                )
            except OSError as error:
                raise ConfigError(f"the watchdog cannot be started: {error}") from error
            try:
                yield dog
            finally:
                dog.end()
                child.wait(timeout=10.0 + config.watchdog)


def watch(page: mmap.mmap, parent: int, timeout: float) -> str:
    """Feel the heart until it stops or the session ends; why it stopped, empty if it ended.

    Before the first beat the loop is not running, and only the life of the process counts.
    """
    while True:
        beat_ns, _, ended = _BEAT.unpack_from(page)
        if ended:
            return ""
        if os.getppid() != parent:
            return "the process of the loop is gone"
        if beat_ns and time.monotonic_ns() - beat_ns > timeout * 1e9:
            return "the loop does not tick"
        time.sleep(timeout * _SHARE)


def main(argv: Sequence[str]) -> int:
    """Watch, and cut the power where the loop stops."""
    told = json.loads(argv[1])
    with mmap.mmap(int(argv[0]), mmap.PAGESIZE) as page:
        why = watch(page, int(told["parent"]), float(told["timeout"]))
        beat_ns, tick, _ = _BEAT.unpack_from(page)
        if not why:
            return 0
        silent = (time.monotonic_ns() - beat_ns) * 1e-9 if beat_ns else None
    done = "no program is given in [safety] cut"
    if told["cut"]:
        try:
            code = subprocess.run(told["cut"], timeout=10, check=False).returncode
            done = f"{told['cut'][0]} returned {code}"
        except (OSError, subprocess.SubprocessError) as error:
            done = f"{told['cut'][0]} failed: {error}"
    report = {"why": why, "last_tick": tick, "silent_s": silent, "cut": done}
    new = Path(told["report"] + ".new")
    new.write_text(json.dumps(report) + "\n", encoding="utf-8")
    new.replace(told["report"])
    return 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
