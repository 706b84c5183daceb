"""Warnings where a recording goes beyond the limits that its URDF states."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hil.record import consistency as physics
from hil.record.finding import Finding
from hil.record.recording import Recording
from hil.record.urdf_joints import UrdfJoint

FloatArray = NDArray[np.float64]
#: Share of the range by which a position, and of the limit by which a speed or an effort, must be
#: beyond it; and samples that must be: a limit is a round number, a single sample is noise.
ROOM, BEYOND, FEW = 0.02, 0.05, 3
#: An effort so many times beyond its limit, but not a thousand times, is in milli-units.
MILLI = 20.0
#: Width [s] over which a speed is averaged, so that encoder counts are not taken for speed.
_WIDTH_S = 0.01


def position(r: Recording, k: int, joint: UrdfJoint) -> Iterator[Finding]:
    """Position beyond the range of a joint.

    Parameters
    ----------
    r : Recording
        Finite values.
    k : int
        Index of the joint in the recording.
    joint : UrdfJoint
        What the URDF says of it.
    """
    q, room = r.q[:, k], ROOM * (joint.upper - joint.lower)
    out = int(np.count_nonzero((q > joint.upper + room) | (q < joint.lower - room)))
    if math.isfinite(room) and out >= FEW:
        yield Finding(
            "limits", "warning", r.joints[k],
            f"q{k + 1} runs from {q.min():.4g} to {q.max():.4g} {joint.unit}, beyond the limits of "
            f"the URDF ({joint.lower:.4g} to {joint.upper:.4g}) in {_share(out, r.n)} of the "
            "samples; check sign, unit and zero of this joint",
        )  # fmt: skip


def speed_and_effort(r: Recording, k: int, joint: UrdfJoint) -> Iterator[Finding]:
    """Speed and effort beyond what a joint is said to be capable of; parameters as `position`."""
    effort = "N m" if joint.unit == "rad" else "N"
    q = r.q[:, k]
    # no mean over steps is faster than the fastest of them
    if float(np.abs(np.diff(q)).max()) > joint.velocity * float(np.diff(r.t).min()):
        mean = physics.smooth(q, max(round(_WIDTH_S / r.period), 1))
        yield from _beyond(
            "velocity-limit", f"the speed of q{k + 1}", np.gradient(mean, r.t), joint.velocity,
            f"{joint.unit}/s", r.joints[k], "check the unit of this position and of the time",
        )  # fmt: skip
    most = float(np.abs(r.tau[:, k]).max())
    milli = MILLI * joint.effort < most <= 1000 * joint.effort
    yield from _beyond(
        "effort-limit", f"tau{k + 1}", r.tau[:, k], joint.effort, effort, r.joints[k],
        f"is it in m{effort}? Then scale it by 0.001 in a map when importing" if milli else
        f"check that it is the effort at the joint in {effort} (after the gear, and no current), "
        "and that the URDF is of this robot",
    )  # fmt: skip


def _beyond(
    code: str, name: str, values: FloatArray, limit: float, unit: str, joint: str, advice: str
) -> Iterator[Finding]:
    size = np.abs(values)
    out = int(np.count_nonzero(size > (1 + BEYOND) * limit))
    if out >= FEW:
        yield Finding(
            code, "warning", joint,
            f"{name} reaches {size.max():.5g} {unit}, beyond the limit of the URDF ({limit:.4g}) "
            f"in {_share(out, size.size)} of the samples; {advice}",
        )  # fmt: skip


def _share(count: int, n: int) -> str:
    share = max(100 * count / n, 0.01)
    return f"{share:.0f} %" if share > 10 else f"{share:.2g} %"
