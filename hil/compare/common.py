"""What several findings have in common, which no joint's name says by itself."""

from __future__ import annotations

from hil.compare.findings import Finding
from hil.identify.timing import LATE

CODE = "common-cause"
#: Spread of times, relative to their mean, within which they are one: late forms differ by as much.
ALIKE = 0.2


def common(findings: list[Finding], moving: list[str]) -> list[tuple[str, str]]:
    """Note (code, sentence) where every joint that moves is late by the same time.

    Parameters
    ----------
    findings : list of Finding
        What was named.
    moving : list of str
        Joints that move.
    """
    late = {f.joint: _lateness(f) for f in findings if f.effect in LATE}
    if len(moving) < 2 or set(late) != set(moving):
        return []
    times = list(late.values())
    mean = sum(times) / len(times)
    if max(times) - min(times) > ALIKE * mean:
        return []
    text = (
        f"{', '.join(moving)} are late by the same time, {1e3 * mean:.3g} ms: more likely one "
        f"cause than {len(late)}, such as efforts and positions that were recorded with different "
        "clocks, one filter or one bus"
    )
    return [(CODE, text)]


def _lateness(f: Finding) -> float:
    """How late the whole effort acts [s]: a T n, as far as the effect has them."""
    values = {name.rsplit(".", 1)[-1]: v.value for name, v in f.parameters.items()}
    return values.get("a", 1.0) * values["T"] * values.get("n", 1.0)
