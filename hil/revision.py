"""How the program is started again, its revision, on which machine, in how much memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

#: This program as another process; a file of the working directory does not take its place.
PROGRAM = (sys.executable, "-P", "-m", "hil")


def source_revision() -> tuple[str, str]:
    """Revision and dirty flag of the source tree; ``unknown`` outside of one."""
    here = Path(__file__).resolve().parent
    words = [
        "git",
        "-C",
        str(here),
        "describe",
        "--always",
        "--abbrev=40",
        "--dirty",
        "--exclude=*",
    ]
    try:
        text = subprocess.run(words, capture_output=True, text=True, timeout=5, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return "unknown", "unknown"
    revision, _, dirty = text.strip().partition("-")
    return revision, "true" if dirty else "false"


def machine() -> str:
    """Class of this machine, without its name."""
    info = Path("/proc/cpuinfo")
    guest = info.exists() and " hypervisor" in info.read_text(encoding="utf-8")
    return f"{os.cpu_count()}-core {'virtual ' if guest else ''}machine"


def peak() -> float:
    """Largest resident memory of this process so far [byte].

    Linux hands the parent's peak on to `getrusage` of a child; /proc does not.
    """
    import resource  # not on Windows

    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return 1024.0 * int(line.split()[1])
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
