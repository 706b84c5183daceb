"""What `hil info` says of time: when a session was, and how its loop kept the pace."""

from __future__ import annotations

import json
from datetime import UTC, datetime

from hil.record.mcap_read import SessionSummary

_US = (
    ("wake-up late", "late"),
    ("tick takes", "busy"),
)
_SHARES = (("p50", "p50"), ("p99", "p99"), ("p99.9", "p999"), ("most", "most"))


def when(found: SessionSummary) -> str:
    """Date and length, e.g. ``recorded 2026-11-21 13:45:02 UTC, 3 s``."""
    length = max((c.last_s for c in found.channels if c.count), default=0.0)
    if not found.zero_ns:
        return f"{length:.4g} s"
    began = datetime.fromtimestamp(found.zero_ns * 1e-9, UTC)
    return f"recorded {began:%Y-%m-%d %H:%M:%S} UTC, {length:.4g} s"


def figures(found: SessionSummary) -> dict[str, float] | None:
    """Figures of the loop, where the session is of `hil run` and was closed."""
    told = found.metadata.get("loop", {}).get("figures")
    return dict(json.loads(told)) if told else None


def lines(found: SessionSummary) -> list[str]:
    """Rows about the loop; none for sessions that no loop wrote."""
    f = figures(found)
    if f is None:
        return []
    session, loop = found.metadata.get("session", {}), found.metadata["loop"]
    clock, rate = session.get("clock", "?"), float(session.get("rate_hz", "nan"))
    rows = [
        f"loop: {f['ticks']:.0f} ticks at {rate:g} Hz, clock {clock}; {f['missed']:.0f} deadlines "
        f"missed, {f['dropped']:.0f} rows dropped, at most {f['ring_most']:.0f} waited in the ring"
    ]
    if clock == "lockstep":
        return [*rows, "  no time passes within a tick of a virtual clock", ""]
    rows += [
        f"  {label:<13} " + ", ".join(f"{p} {f[f'{key}_{q}']:.1f}" for p, q in _SHARES) + " us"
        for label, key in _US
    ]
    rows.append(f"  {'longest gap':<13} {f['longest_gap']:.0f} us between two ticks")
    rows.append(f"  {'arranged':<13} {loop.get('granted') or 'nothing was granted'}")
    return [*rows, ""]
