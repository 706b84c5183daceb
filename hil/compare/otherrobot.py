"""Whether a model is of the robot that a session says it is of."""

from __future__ import annotations

from collections.abc import Sequence

from hil.models.model import RobotModel
from hil.record.recording import Recording, RobotSource

CODE = "other-robot"


def other_robot(model: RobotModel, recordings: Sequence[Recording]) -> list[tuple[str, str]]:
    """Warning (code, sentence) where a model is of another kind of robot than the runs.

    Of a session that names no robot, or independent axes, any model may be tried.

    Parameters
    ----------
    model : RobotModel
        The model.
    recordings : sequence of Recording
        Runs that it is given.
    """
    ours = _kind(model.robot)
    for r in recordings:
        theirs = _kind(r.robot)
        known = r.robot.urdf or r.robot.preset not in ("", "single-axis")
        if known and ours != theirs:
            return [(CODE, _sentence(ours, theirs, r.name))]
    return []


def _kind(robot: RobotSource) -> str:
    """What a robot is, in words."""
    if robot.urdf:
        return "a URDF"
    if robot.preset in ("", "single-axis"):
        return "independent axes (no gravity, no coupling of joints)"
    return f"the robot {robot.preset!r}"


def _sentence(ours: str, theirs: str, name: str) -> str:
    return (
        f"the model is of {ours}, the session {name} of {theirs}: its errors may be the robot's; "
        "without --model the base model of the session's own robot is taken"
    )
