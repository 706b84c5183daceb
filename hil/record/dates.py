"""When a recording was made, and by what that is known."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

from hil.record.mcap_read import SessionSummary
from hil.record.recording import BEGAN, BEGAN_BY

#: No recording is later [s since 1970]: the year 3000.
_LATEST = 32503680000.0


def began(found: SessionSummary) -> tuple[datetime, str]:
    """Date of the first sample (UTC), and by what it is known.

    Returns
    -------
    date : datetime
        In UTC.
    by : {"stamps", "table", "file"}
        Whether that is the date of the recording's own stamps, or only when the table that was
        imported, or the session itself, was last changed.
    """
    told = found.metadata.get("import", {})
    if found.zero_ns:
        seconds, by = found.zero_ns * 1e-9, "stamps"
    else:
        seconds, by = _number(told.get(BEGAN, "")), told.get(BEGAN_BY, "")
    if not math.isfinite(seconds) or by not in ("stamps", "table"):
        seconds, by = changed(Path(found.path)), "file"
    return datetime.fromtimestamp(seconds, UTC), by


def _number(text: str) -> float:
    """A number below the year 3000 as a time; NaN where a damaged record holds none."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if 0.0 < value < _LATEST else math.nan


def changed(path: Path) -> float:
    """When a file was last changed [s since 1970]; of a folder, the latest of its files."""
    files = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else []
    return max((p.stat().st_mtime for p in files), default=path.stat().st_mtime)
