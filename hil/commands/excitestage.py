"""On which robot `hil excite` plans: a rig file, a URDF, or a session of a robot without either."""

from __future__ import annotations

import argparse
from pathlib import Path

from hil.commands import common
from hil.config import RigConfig, load_rig
from hil.errors import ConfigError, unknown
from hil.excite.foresee import BAND
from hil.excite.limits import Limits, of_arm, of_robot
from hil.excite.recorded import stage_of
from hil.excite.space import explore
from hil.excite.stage import Stage
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.model import RobotModel, base_model
from hil.models.robots import Robot, bare_robot
from hil.record.mcap_read import load
from hil.record.recording import RobotSource

#: Share of a joint's range that encoders resolve where nothing is known.
RESOLUTION = 1e-4


def own_robot(path: str) -> bool:
    """Whether the robot is one that `hil run` cannot move: a URDF or a session."""
    return path.lower().endswith((".urdf", ".mcap"))


def stage(args: argparse.Namespace) -> tuple[RobotModel, Stage]:
    """Model and stage of a command line."""
    given = common.model_file(args.model) if args.model else None
    if args.rig.lower().endswith(".mcap"):
        return _session(args, given)
    if args.rig.lower().endswith(".urdf"):
        source, limits = _urdf(args.rig)
        robot = bare_robot(source)
    else:
        source, limits, joints = _rig(args, load_rig(args.rig))
        robot = bare_robot(source, joints)
    model = _model(args, given, source, robot)
    quantum = RESOLUTION * (limits.high - limits.low)
    return model, Stage(explore(limits, robot), source, BAND, quantum, args.seconds)


def _model(
    args: argparse.Namespace, given: RobotModel | None, source: RobotSource, robot: Robot
) -> RobotModel:
    if given is not None and given.robot.urdf and given.robot.urdf != source.urdf:
        raise ConfigError(
            f"model {args.model} is of another robot than {args.rig}; give that robot's URDF in "
            "place of the rig file"
        )
    # an offset asks for no motion
    model = base_model(source) - "torque-offset" if given is None else given
    model.check_joints(tuple(robot.joints))
    return model


def _session(args: argparse.Namespace, given: RobotModel | None) -> tuple[RobotModel, Stage]:
    run = load(args.rig, args.arm)
    named = given is not None and bool(given.robot.preset or given.robot.urdf)
    source = given.robot if given is not None and named else run.robot
    problem = Problem([run], source)
    model = _model(args, given, source, problem.robot)
    # without values the effort that a motion needs cannot be foreseen
    known = model if given is not None else fit(problem, model).model
    return known, stage_of(problem, args.seconds)


def _urdf(path: str) -> tuple[RobotSource, Limits]:
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    source = RobotSource("", text)
    limits = of_robot(source)
    if limits is None:
        raise ConfigError(f"{path} brings no limits")
    return source, limits


def _rig(
    args: argparse.Namespace, config: RigConfig
) -> tuple[RobotSource, Limits, tuple[str, ...]]:
    name = args.arm or config.controller.arms[0]
    if name not in config.arms:
        raise ConfigError(unknown("arm", name, config.arms))
    arm = config.arms[name]
    source = RobotSource(arm.robot, tip=arm.tip)
    center = config.controller.parameters.get("center", ())
    return source, of_arm(arm, source, tuple(map(float, center))), arm.joints
