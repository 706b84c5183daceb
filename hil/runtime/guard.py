"""The loop's end of the watchdog: starts it, proves it, feels its heart, keeps its latch.

Each watches the other.  The process cuts the power where the loop stops; the loop goes to FAULT
where the process stops, or has cut.  A rig may be enabled only after the process has answered.  A
cut is latched on disk, for the program that made it: no session starts with that program until
the operator asks for it, and until a new process has answered.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import mmap
import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil import trusted_code
from hil.errors import ConfigError, DeviceError
from hil.rig.config import SafetyConfig
from hil.rig.cut import proven
from hil.rig.safety import BITS
from hil.runtime import watchdog
from hil.runtime.watchdog import (
    ANSWER,
    ASKED,
    CUTS,
    DOG_BEAT,
    ENDED,
    LOOP_BEAT,
    TICK,
    report_in_words,
    report_path,
    tripped,
)

_LOST, _CUT = BITS["watchdog-lost"], BITS["power-cut"]
#: Longest wait for the answer of a new process, and for its end [s].
ANSWERS, ENDS = 10.0, 2.0
#: Longest time that a cut takes [s].
CUTTING = watchdog.ATTEMPTS * (watchdog.LIMIT + watchdog.PAUSE_S)
#: No site, no variables, no working directory: nothing of the user's is imported.
ISOLATED = ("-I", "-S")


class Watchdog:
    """A proven process beside the loop.

    Parameters
    ----------
    page : memoryview of int
        Shared with the process.
    child : Popen
        The process.
    timeout : float
        Silence of either that the other takes for its end [s].
    report, latch : Path
        Where the process writes that it acted: beside the session, and for the next one.
    """

    def __init__(
        self,
        page: memoryview[int],
        child: subprocess.Popen[bytes],
        timeout: float,
        report: Path,
        latch: Path,
    ) -> None:
        self._page, self._child, self._report, self._latch = page, child, report, latch
        self._timeout_ns = round(timeout * 1e9)

    def beat(self, tick: int) -> int:
        """Say that `tick` has come; conditions of `hil.rig.safety`: it is lost, it has cut."""
        page, now = self._page, time.monotonic_ns()
        page[LOOP_BEAT], page[TICK] = now, tick
        if page[CUTS]:
            return _CUT
        return _LOST if now - page[DOG_BEAT] > self._timeout_ns else 0

    def end(self) -> None:
        """Say that the session is over, and the motors are off."""
        self._page[ENDED] = 1

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._child.pid

    @property
    def alive(self) -> bool:
        """Whether the process has not ended."""
        return self._child.poll() is None

    def trip(self) -> dict[str, Any]:
        """What the process says of its cut, which is waited for; empty where it made none."""
        if not self._page[CUTS]:
            return {}
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(CUTTING)
        # the latch, too, tells of it, where the disk of the session is full
        told = tripped(self._report) or tripped(self._latch)
        return told or {"why": "unknown", "cut": "the watchdog left no report"}

    def proved(self) -> dict[str, Any]:
        """As `trip`, after a cut that was asked for, by not beating; its latch is taken back."""
        trip = self.trip()
        if trip.get("worked"):
            self._latch.unlink(missing_ok=True)
        return trip

    def settle(self) -> None:
        """End the process, which may hang."""
        self.end()
        try:
            self._child.wait(ENDS + self._timeout_ns * 1e-9)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()

    def answers(self) -> bool:
        """Whether it answers a number that it cannot know, within `ANSWERS`."""
        page = self._page
        page[ASKED] = asked = secrets.randbits(62) | 1
        until = time.monotonic() + ANSWERS
        while page[ANSWER] != asked:
            if self._child.poll() is not None or time.monotonic() > until:
                return False
            time.sleep(0.001)
        return True


def latch_of(words: Sequence[str]) -> Path:
    """Where it stands that a program has cut; the same however the paths among `words` are spelled.

    A path counts as the file that it leads to; the name of a file in the working directory only
    where it is a script, because any other word may have such a name by chance.
    """
    plain = [os.path.realpath(word) if _is_path(word) else word for word in words[1:]]
    key = "\0".join([os.path.realpath(words[0]), *plain])
    return trusted_code.folder() / "cut" / f"{hashlib.sha256(key.encode()).hexdigest()}.json"


def _is_path(word: str) -> bool:
    return os.path.exists(word) and (os.sep in word or trusted_code.is_script(Path(word)))


def latched(words: Sequence[str]) -> str:
    """Why no session may start with this program: it has cut before; empty if it may."""
    latch = latch_of(words)
    trip = tripped(latch)
    if not trip and latch.exists():
        trip = {"why": "unknown", "cut": f"{latch} is empty"}
    if not trip:
        return ""
    when, at = trip.get("time_s"), ""
    if isinstance(when, (int, float)) and 0 < when < 1e11:
        at = f"{datetime.fromtimestamp(when, UTC):%Y-%m-%d %H:%M:%S} UTC: "
    return f"{at}{report_in_words(trip)}"


def watchdog_state(
    config: SafetyConfig, source: str, rearm: bool = False
) -> tuple[bool, str] | None:
    """Whether a session could start with this watchdog, and what it is like; None without one."""
    try:
        words = proven(config)
        if not words:
            return None
        asked = trusted_code.cut_program(words)
        trusted_code.require(asked, source)
    except ConfigError as error:
        return False, str(error)
    why = latched(words)
    if why and not rearm:
        return False, f"{why}; 'hil run {source} --rearm' starts a session all the same"
    return True, f"runs {asked.text} after {config.watchdog:g} s without a tick; agreed to"


@contextlib.contextmanager
def guarded_session(
    config: SafetyConfig, session: Path, source: str = "RIG.toml", rearm: bool = False
) -> Iterator[Watchdog | None]:
    """Proven watchdog around a session; None where the rig file asks for none.

    Parameters
    ----------
    config : SafetyConfig
        Of the rig file.
    session : Path
        Its report is written beside.
    source : str
        The rig file, for messages.
    rearm : bool
        Go on although the program has cut before.

    Raises
    ------
    ConfigError
        If there is no program that could be run, or the user has not agreed to it.
    DeviceError
        If the process does not start or answer, or a cut is latched.
    """
    try:
        words = proven(config)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from error.__cause__
    if not words:
        yield None
        return
    trusted_code.require(trusted_code.cut_program(words), source)
    latch, report = latch_of(words), report_path(session.absolute())
    why = latched(words)
    if why and not rearm:
        raise DeviceError(
            f"the power of this rig was cut and stays off: {why}. Find out why, look at the rig, "
            "switch its power on, then run again with --rearm"
        )
    with (
        _reserved(latch) as reserve,
        _started(config.watchdog, words, latch, report, reserve) as dog,
    ):
        latch.unlink(missing_ok=True)
        yield dog


@contextlib.contextmanager
def _reserved(latch: Path) -> Iterator[Path]:
    """A latch made before it is needed: a disk that fills up during the session cannot lose it."""
    trusted_code.ask_consent(latch.parent)
    reserve = latch.with_name(f"{latch.name}.{os.getpid()}.reserve")
    try:
        watchdog.write_report(reserve, watchdog.UNTOLD)
    except OSError as error:
        reserve.unlink(missing_ok=True)
        raise ConfigError(
            f"the watchdog's latch cannot be prepared: {trusted_code.unwritable(error, reserve)}"
        ) from error
    try:
        yield reserve
    finally:
        reserve.unlink(missing_ok=True)


@contextlib.contextmanager
def _started(
    timeout: float, words: Sequence[str], latch: Path, report: Path, reserve: Path
) -> Iterator[Watchdog]:
    """A process that has answered."""
    with tempfile.TemporaryFile() as file:
        file.truncate(mmap.PAGESIZE)
        with (
            mmap.mmap(file.fileno(), mmap.PAGESIZE) as raw,
            memoryview(raw).cast("q") as page,
        ):
            child = _process(file.fileno(), timeout, words, latch, report, reserve)
            dog = Watchdog(page, child, timeout, report, latch)
            try:
                if not dog.answers():
                    code = child.poll()
                    how = "does not answer" if code is None else f"ended at once (code {code})"
                    raise DeviceError(
                        f"the watchdog {how}, so the rig must not be enabled; see what "
                        f"'{' '.join([sys.executable, *ISOLATED, watchdog.__file__])}' says"
                    )
                yield dog
            finally:
                dog.trip()
                dog.settle()


def _process(
    page: int, timeout: float, words: Sequence[str], latch: Path, report: Path, reserve: Path
) -> subprocess.Popen[bytes]:
    # told, not asked: the loop may be gone before this process has begun
    told = {
        "parent": os.getpid(),
        "timeout": timeout,
        "cut": list(words),
        "report": str(report),
        "latch": str(latch),
        "reserve": str(reserve),
    }
    command = [sys.executable, *ISOLATED, watchdog.__file__, str(page), json.dumps(told)]
    try:
        return subprocess.Popen(
            command, pass_fds=[page], stdin=subprocess.DEVNULL, start_new_session=True
        )
    except OSError as error:
        raise ConfigError(f"the watchdog cannot be started: {error}") from error
