"""What `hil excite` prints: JSON, the menu, margins, and how to play the motion.

On which robot `hil excite` plans: a rig file, a URDF, or a session of a robot without either.
"""

from __future__ import annotations

import argparse
import math
from typing import Any

from hil.commands import common
from hil.errors import ConfigError, unknown
from hil.excite.choose import NOISE, SIZE, Choice
from hil.excite.foresee import BAND
from hil.excite.limits import Limits, Margin, of_robot
from hil.excite.question import Question, Rival
from hil.excite.stage import Stage, explore, stage_of
from hil.excite.trajectory import Played, Trajectory, header
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.model import RobotModel, base_model
from hil.models.robots import Robot, bare_robot
from hil.record.mcap_read import load
from hil.record.recording import RobotSource
from hil.rig.check import limits_of_arm
from hil.rig.config import RigConfig, load_rig
from hil.userfile import read_text

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
        text = read_text(path)
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
    return source, limits_of_arm(arm, source, tuple(map(float, center))), arm.joints


def finite(x: float) -> float | None:
    """A number for JSON; None where it is not finite."""
    return x if math.isfinite(x) else None


def as_dict(
    args: argparse.Namespace, motion: Trajectory, margins: list[Margin], rows: Played | None
) -> dict[str, Any]:
    """`hil excite --json`; `table` is what --csv wrote."""
    limits = [
        {"what": m.what, "used": m.used, "limit": finite(m.limit), "unit": m.unit} for m in margins
    ]
    return {
        "schema": "hil.excite/1",
        "output": args.output,
        "motion": motion.name,
        "for": list(motion.purpose),
        "period_s": motion.period,
        "asked_s": args.seconds,
        "margins": limits,
        "table": None if rows is None else _table(args, rows),
    }


def _table(args: argparse.Namespace, p: Played) -> dict[str, Any]:
    return {
        "output": args.csv,
        "columns": header(p.q.shape[1]),
        "rows": int(p.t.size),
        "seconds": float(p.t[-1]),
        "lead_in_s": p.lead,
        "periods": p.rounds,
    }


def length(args: argparse.Namespace, motion: Trajectory) -> str:
    """Where the motion is not as long as was asked, why; else nothing."""
    asked, period = args.seconds, motion.period
    if abs(period - asked) < 0.01 * asked:
        return ""
    if period > asked:
        return (
            f"  longer than the {asked:g} s asked for: one round takes {period:.3g} s at the "
            "speeds that it needs and the limits allow\n"
        )
    times = asked / period
    return (
        f"  shorter than the {asked:g} s asked for: it repeats every {period:.3g} s; play it "
        f"{times:.2g} times\n"
    )


def menu(found: Choice) -> str:
    """Every motion of the menu with what it would say."""
    rows = [
        [o.motion.name, f"{o.verdict.odds:.1f}", f"{100 * o.verdict.share:.1f} %"]
        for o in found.options
    ]
    return common.table(["menu", "log odds", "cannot be imitated"], rows)


def assumed(question: Question, units: tuple[str, ...]) -> str:
    """What the menu takes for granted, as nothing has been measured; units of the joints."""
    shapes = "; ".join(filter(None, (_shape(r, units) for r in question.rivals)))
    return (
        f"  assumed: an effect of {100 * SIZE:g} % of the torque limit, a noise of "
        f"{100 * NOISE:g} %{f'; {shapes}' if shapes else ''}"
    )


def _shape(rival: Rival, units: tuple[str, ...]) -> str:
    """Shape values of a rival, e.g. ``stribeck with vs = 0.2 rad/s``."""
    effect, unit = rival.term.effect, units[rival.term.joint]
    values = []
    for p, value in zip(effect.shape, rival.term.shape, strict=True):
        number = f"{p.name} = {value:.3g} {p.unit.replace('{x}', unit)}".removesuffix(" 1")
        said = p.words(value)
        values.append(f"{p.name}: {said}" if said and p.choice else number)
    return f"{effect.name} with {', '.join(values)}" if values else ""


def limits(margins: list[Margin]) -> str:
    """Distance to each limit."""
    rows = []
    for m in margins:
        if m.what.startswith(("speed", "torque")):
            share = f"{100 * (1 - m.used / m.limit):.0f} %" if math.isfinite(m.limit) else "-"
            rows.append([m.what, f"{m.used:.3g} of {m.limit:.3g} {m.unit}", share])
        else:
            rows.append([m.what, f"{m.used:.3g} {m.unit} to the limit", ""])
    return common.table(["limit", "largest", "left"], rows)


def play(args: argparse.Namespace, rows: Played | None) -> str:
    """How to play the motion, and what the table holds."""
    own = own_robot(args.rig)
    lines = (
        [
            f"{args.csv}: {', '.join(header(rows.q.shape[1]))} in SI units, {rows.t.size} rows, "
            f"{rows.t[-1]:.4g} s: {rows.rounds} x the motion, with {rows.lead:g} s before it and "
            "behind it to come from rest and back"
        ]
        if rows is not None
        else []
    )
    if not own:
        how = f"Play it: hil run {args.rig} --trajectory {args.output} -o SESSION.mcap"
        return "\n".join([*lines, how])
    where = args.csv or "the table that --csv TABLE.csv writes"
    lines.append(
        f"'hil run' plays on the arms of a rig file only, not on this robot: let its own "
        f"controller follow {where},\n"
        "starting at the first row, and import what it records with 'hil import'."
    )
    return "\n".join(lines)


def beside(args: argparse.Namespace) -> str:
    """What to do with the session of a motion of one joint."""
    if not args.joint:
        return ""
    return (
        "\nJoints that only hold their place beside it say little: diagnose it together with a "
        "session in which all of them move,\n  hil diagnose FIRST.mcap SESSION.mcap --model M.toml"
    )
