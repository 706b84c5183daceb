"""Data faults of a recording, before anyone fits it: time base, missing and frozen values.

What needs the laws of motion (scale and sign of velocities and efforts) is in
`hil.record.motioncheck`.  An ``"error"`` means that any fit would be worthless.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hil.record.finding import Finding
from hil.record.motioncheck import check_motion, described_joints
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]

#: Below these rates [Hz] an identification is doubtful, or hopeless.
SLOW_HZ, HOPELESS_HZ = 100.0, 20.0
#: A run from which alone no effect is named (`hil.compare.identifiable`) [s], and no fit made.
SHORT_S, HOPELESS_SAMPLES = 4.0, 20
_GAP, _JITTER = 3.0, 0.5
#: No measured quantity reaches this in any unit; NaN and infinity do not pass it either.
_ABSURD = 1e50

__all__ = ["Finding", "check", "columns", "joint_units"]


def check(recording: Recording) -> list[Finding]:
    """Find the faults of a recording.

    Parameters
    ----------
    recording : Recording
        One run of one arm.

    Returns
    -------
    list of Finding
        Errors first; empty if nothing is wrong.  Never raises for bad data.
    """
    found = [*_values(recording), *_time(recording)]
    if not any(f.severity == "error" for f in found):
        found += [*_frozen(recording), *check_motion(recording)]
    return sorted(found, key=lambda f: f.severity)


def columns(recording: Recording) -> Iterator[tuple[str, str, FloatArray]]:
    """Every column of a recording: its table name (``tau2``), its joint or ``""``, its values."""
    for key, stem in _STEMS.items():
        values = getattr(recording, key)
        for k in range(0 if values is None else values.shape[1]):
            yield f"{stem}{k + 1}", recording.joints[k], values[:, k]
    if recording.wrench is not None:
        for k, name in enumerate(("fx", "fy", "fz", "tx", "ty", "tz")):
            yield name, "", recording.wrench[:, k]


def joint_units(recording: Recording) -> tuple[str, ...]:
    """Unit of each joint, ``"rad"`` or ``"m"``: of the URDF, else what the recording says."""
    listed = described_joints(recording)
    if listed:
        return tuple(j.unit for j in listed)
    return (recording.metadata.get("unit", "rad"),) * recording.d


_STEMS = {
    "q": "q", "qd": "qd", "tau": "tau", "tau_ext": "tauext", "current": "i", "temperature": "temp",
}  # fmt: skip


def _values(r: Recording) -> Iterator[Finding]:
    for name, joint, values in [("t", "", r.t), *columns(r)]:
        bad = np.flatnonzero(~(np.abs(values) < _ABSURD))
        if bad.size:
            yield Finding(
                "not-finite", "error", joint,
                f"{name}: {bad.size} of {r.n} values are NaN, infinite or absurd, first at sample "
                f"{bad[0]}; cut or repair them before importing",
            )  # fmt: skip


def _time(r: Recording) -> Iterator[Finding]:
    t = r.t[np.isfinite(r.t)]
    if t.size < HOPELESS_SAMPLES:
        yield Finding(
            "too-short", "error", "", f"{r.n} samples; at least {HOPELESS_SAMPLES} are needed"
        )
        return
    dt = np.diff(t)
    period = float(np.median(dt))
    back, same = np.flatnonzero(dt < 0), np.flatnonzero(dt == 0)
    if back.size:
        yield Finding(
            "time-backward", "error", "",
            f"time runs backward {back.size} times, first after {t[back[0]]:.6g} s; "
            "sort the rows or import each run by itself",
        )  # fmt: skip
    if same.size:
        yield Finding(
            "time-repeated", "error" if period <= 0 else "warning", "",
            f"{same.size} repeated time stamps, first at {t[same[0]]:.6g} s; "
            "rows that repeat all values, too, are left out of an analysis",
        )  # fmt: skip
    if period > 0:
        yield from _rate(t, dt[dt > 0], period)


def _rate(t: FloatArray, dt: FloatArray, period: float) -> Iterator[Finding]:
    rate, gaps = 1 / period, dt > _GAP * period
    if rate < SLOW_HZ:
        severity = "error" if rate < HOPELESS_HZ else "warning"
        hint = "; is the time in milliseconds? Scale it by 0.001 in a map"
        text = f"{rate:.4g} Hz is slow for dynamics (from {SLOW_HZ:.0f} Hz on it is fine)"
        text += hint if severity == "error" else ""
        yield Finding("sample-rate", severity, "", text)
    if t[-1] - t[0] < SHORT_S:
        text = (
            f"{t[-1] - t[0]:.3g} s of data: parameters will be uncertain, and no effect is named "
            f"from less than {SHORT_S:g} s; record longer, or give several runs together"
        )
        yield Finding("too-short", "warning", "", text)
    if gaps.any():
        first = t[np.flatnonzero(np.diff(t) > _GAP * period)[0]]
        yield Finding(
            "gap", "warning", "",
            f"{gaps.sum()} gaps, the longest {dt.max():.3g} s, the first after {first:.6g} s; "
            "an analysis bridges short ones and splits the run at long ones: nothing is "
            "differentiated across them",
        )  # fmt: skip
    if gaps.all():
        return
    low, high = np.quantile(dt[~gaps], (0.05, 0.95))
    if high - low > _JITTER * period:
        yield Finding(
            "irregular-time", "warning", "",
            f"period varies from {low * 1e3:.4g} to {high * 1e3:.4g} ms (5 to 95 %); "
            "an analysis resamples where the positions follow the stamps",
        )  # fmt: skip


def _frozen(r: Recording) -> Iterator[Finding]:
    still = np.ptp(r.q, axis=0) == 0
    idle = np.ptp(r.tau, axis=0) == 0
    if still.all() and idle.all():
        text = "no position and no effort changes in the whole recording: the sensors were stuck"
        yield Finding("stuck", "error", "", text)
        return
    if idle.all() and not np.any(r.tau) and r.wrench is None and r.tau_ext is None:
        text = (
            "no effort is recorded: every tau is zero, and there is no measured force; "
            "name the effort columns in a map"
        )
        yield Finding("no-effort", "error", "", text)
        return
    span = np.ptp(r.tau, axis=0)
    for k, joint in enumerate(r.joints):
        if still[k] and not idle[k] and (still.all() or span[k] > 0.8 * float(np.max(span))):
            text = (
                f"q{k + 1} never changes while tau{k + 1} varies by {span[k]:.3g}; "
                "is the joint locked, or its encoder dead?"
            )
            yield Finding("stuck", "warning", joint, text)
        if idle[k] and not still[k] and (r.tau[0, k] != 0 or not idle.all()):
            text = f"tau{k + 1} never changes while q{k + 1} moves; is the channel dead?"
            yield Finding("stuck", "warning", joint, text)
