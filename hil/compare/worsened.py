"""Names with which the model moves worse than without.

A missing cause that is found lowers both errors: that of the effort, and that of the motion that
the model simulates from measured states.  A law that only imitates it where the rig has been, e.g.
friction that builds up over a displacement in place of a play behind a soft shaft, can lower the
first and raise the second.
"""

from __future__ import annotations

from collections.abc import Sequence

from hil.compare.findings import Finding, Step
from hil.identify.multistep import MultiStep

CODE = "worsened"
#: Factor by which the simulated error must rise, beyond its standard error: of 132 names that were
#: looked at in sessions of `hil bench diagnosis`, all but one wrong one raised it by 1.1 at most.
RISE = 1.3


def moves_worse(before: MultiStep, after: MultiStep, j: int) -> bool:
    """Whether joint j is simulated worse, over short horizons or in the closed-loop replay."""
    pairs = [(before, after), (before.closed_loop, after.closed_loop)]
    return any(x.rises(y, j, RISE) for y, x in pairs if x is not None and y is not None)


def worsened(
    steps: Sequence[Step], simulated: Sequence[MultiStep], findings: Sequence[Finding]
) -> dict[str, str]:
    """Joints that the last model simulates worse than the first one, each with a sentence.

    Parameters
    ----------
    steps : sequence of Step
        The ladder: first and last model.
    simulated : sequence of MultiStep
        Their simulated errors, as many as steps.
    findings : sequence of Finding
        What would be named; effects of the whole robot are not asked.
    """
    problem = steps[0].result.problem
    out = {}
    for joint in dict.fromkeys(f.joint for f in findings if f.joint is not None):
        j = problem.joints.index(joint)
        if not moves_worse(simulated[0], simulated[-1], j):
            continue
        names = " and ".join(f.effect for f in findings if f.joint == joint)
        rise = _rise(simulated[0], simulated[-1], j, problem.robot.units[j])
        out[joint] = (
            f"{joint}: {names} would lower the error of the effort, and the simulated position "
            f"error {rise}: a cause lowers both, that is not the cause"
        )
    return out


def _rise(before: MultiStep, after: MultiStep, j: int, unit: str) -> str:
    if not after.rises(before, j, RISE) and before.closed_loop and after.closed_loop:
        return _rise(before.closed_loop, after.closed_loop, j, f"{unit} under a servo of 1 Hz")
    old, new, seconds = float(before.rms[j]), float(after.rms[j]), after.horizon
    if after.lost:
        return f"over {seconds:g} s is beyond the recorded range in every window"
    return f"over {seconds:g} s rises from {old:.3g} to {new:.3g} {unit}"
