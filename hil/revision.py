"""Which revision of the source this program is, for records, pages and reports."""

from __future__ import annotations

import subprocess
from pathlib import Path


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
