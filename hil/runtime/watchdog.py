"""The process beside the loop: where the loop stops ticking, it takes the power off.

It shares nothing with the loop but a page of memory, so that it outlives a crash, a kill and a
hang of the interpreter.  It cannot reach the motors itself: it runs the program of the rig file
(a relay, a supply with a network port), and writes down that it did.

Python starts this file isolated (``-I -S FILE``) and nothing but the standard library is imported
here: no file of the working directory, no variable and no package of the user's can take its
place.  `hil.runtime.guard` is the loop's end of the page.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

#: Words of the page, 64 bits each, so that each is written and read whole.  The loop writes the
#: first four: time of its last beat [ns, monotonic; 0 = does not run yet], tick, 1 = ended
#: properly, a number to be answered.  The process writes the others: the answer, time of its last
#: beat, 1 = it cuts.
LOOP_BEAT, TICK, ENDED, ASKED, ANSWER, DOG_BEAT, CUTS = range(7)
#: How often hearts are felt, in shares of the time-out; the longest pause between [s].
_SHARE, _LONGEST = 0.2, 0.1
#: A cut that fails is tried so often; pause before the next [s], and how long one may take [s].
ATTEMPTS, PAUSE_S, LIMIT = 3, 0.2, 10.0
#: Metadata record of a session with the report.
WATCHDOG = "watchdog"
#: What a latch says where the disk had no room for more.
UNTOLD = {"why": "unknown (the disk had no room for it)", "worked": False, "cut": "has begun"}


def watch(page: memoryview[int], parent: int, timeout: float) -> str:
    """Feel the heart until it stops or the session ends; why it stopped, empty if it ended.

    Before the first beat the loop is not running, and only the life of the process counts.
    """
    pause = min(timeout * _SHARE, _LONGEST)
    while True:
        page[DOG_BEAT] = time.monotonic_ns()
        beat_ns = page[LOOP_BEAT]
        if page[ENDED]:
            return ""
        if os.getppid() != parent:
            return "the process of the loop is gone"
        if beat_ns and time.monotonic_ns() - beat_ns > timeout * 1e9:
            return "the loop does not tick"
        time.sleep(pause)


def run_cut_program(words: Sequence[str]) -> tuple[bool, str]:
    """Run the program that takes the power off, again where it fails; whether it worked, and how.

    Whatever it meets ends in the sentence: there is nobody left to raise it to.
    """
    name, done, none = Path(words[0]).name, "", subprocess.DEVNULL
    for attempt in range(ATTEMPTS):
        if attempt:
            time.sleep(PAUSE_S)
        try:
            # the terminal or pipe of the loop may be gone, and to print there would end it
            code = subprocess.run(
                words, stdin=none, stdout=none, stderr=none, timeout=LIMIT
            ).returncode
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            done = f"{name} failed: {error}"
            continue
        done = f"{name} returned {code}"
        if code == 0:
            return True, done
    return False, done


def write_report(path: Path, report: Mapping[str, object]) -> None:
    """Put a report into its place, whole and on the disk."""
    new = path.with_name(path.name + ".new")
    with new.open("w", encoding="utf-8") as file:
        file.write(json.dumps(report) + "\n")
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)


def report_path(session: Path) -> Path:
    """Where a watchdog writes that it acted."""
    return session.with_name(session.name + ".watchdog.json")


def tripped(report: Path) -> dict[str, Any]:
    """Report of a cut; empty where there is none."""
    from hil.userfile import LARGEST_TEXT, read_bytes  # the watchdog itself needs nothing of hil

    try:
        return parsed_report(read_bytes(report, LARGEST_TEXT).decode("utf-8", "replace"))
    except FileNotFoundError:
        return {}
    except OSError as error:
        return {"why": f"unknown, {report} cannot be read", "cut": str(error)}


def parsed_report(text: str) -> dict[str, Any]:
    """Report from its text, which anybody may have written; empty where there is none."""
    try:
        found = json.loads(text or "{}")
    except (ValueError, RecursionError):
        found = text
    return found if isinstance(found, dict) else {"why": "unknown", "cut": f"report {text[:80]!r}"}


def report_in_words(trip: Mapping[str, Any]) -> str:
    """A report as a sentence."""
    silent = trip.get("silent_s")
    told = isinstance(silent, (int, float))
    after = f" {silent:.2g} s after tick {trip.get('last_tick')}" if told else ""
    sure = "" if trip.get("worked") is True else "; THE POWER MAY STILL BE ON"
    return f"the watchdog cut the power{after}, because {trip.get('why')}: {trip.get('cut')}{sure}"


def cut_power(page: memoryview[int], told: Mapping[str, Any], why: str) -> None:
    """Cut the power; the latch stands before the program runs, the report when it has."""
    page[CUTS] = 1
    beat_ns, tick = page[LOOP_BEAT], page[TICK]
    silent = (time.monotonic_ns() - beat_ns) * 1e-9 if beat_ns else None
    report = {"why": why, "last_tick": tick, "silent_s": silent, "time_s": time.time()}
    places = [Path(told[name]) for name in ("latch", "report")]
    if told.get("reserve"):
        # a new name takes no room, and a full disk must not lose the latch
        with contextlib.suppress(OSError):
            os.replace(told["reserve"], places[0])
    trouble = _written(places[:1], {**report, "worked": False, "cut": "has begun"})
    worked, done = run_cut_program(told["cut"])
    whole = {**report, "worked": worked, "cut": done}
    trouble += _written(places, whole)
    if not worked or trouble:
        sys.stderr.write(f"hil watchdog: {why}; {'; '.join([done, *trouble])}\n")


def _written(places: Sequence[Path], report: Mapping[str, object]) -> list[str]:
    """Sentences about the places that took no report; a full disk must not stop the cut."""
    trouble = []
    for place in places:
        try:
            write_report(place, report)
        except OSError as error:
            trouble.append(f"{place} cannot be written: {error}")
    return trouble


def main(argv: Sequence[str]) -> int:
    """Answer the loop, watch, and cut the power where the loop stops."""
    # it ends when the session does, not before; handlers, because the cut program would go on
    # ignoring what is ignored here
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: None)
    told = json.loads(argv[1])
    with mmap.mmap(int(argv[0]), mmap.PAGESIZE) as raw, memoryview(raw).cast("q") as page:
        if not os.access(told["cut"][0], os.X_OK):
            sys.stderr.write(f"hil watchdog: {told['cut'][0]} may not be run\n")
            return 2
        page[DOG_BEAT] = time.monotonic_ns()
        page[ANSWER] = page[ASKED]
        why = watch(page, int(told["parent"]), float(told["timeout"]))
        if not why:
            return 0
        cut_power(page, told, why)
    return 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
