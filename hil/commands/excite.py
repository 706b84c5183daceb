"""`hil excite`: the safe motion that identifies a model or separates rival effects.

The robot comes from a rig file, a URDF, or a session.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import Any

from hil import outputs, progress, terminal
from hil.commands import common
from hil.errors import ConfigError, plural, unknown
from hil.excite import choose, fourier, trajectory
from hil.excite.choose import NOISE, SIZE, Choice, decide, question, survey
from hil.excite.question import BAND, Question, Rival
from hil.excite.stage import Stage, explore, foreseen, stage_of
from hil.excite.trajectory import Limits, Margin, Played, Trajectory, header, of_robot, rounds
from hil.identify.fit import fit
from hil.identify.parallel import single_threaded
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.model import RobotModel, base_model
from hil.models.robots import Robot, bare_robot
from hil.record.bags import is_bag
from hil.record.recording import RobotSource
from hil.record.sources import load_source
from hil.rig.check import limits_of_arm
from hil.rig.config import RigConfig, load_rig, robot_source
from hil.userfile import read_text

#: Share of a joint's range that encoders resolve where nothing is known.
RESOLUTION = 1e-4


def own_robot(path: str) -> bool:
    """Whether the robot is one that `hil run` cannot move: a URDF, a session or a bag."""
    return path.lower().endswith((".urdf", ".mcap")) or is_bag(path)


def given_stage(args: argparse.Namespace) -> tuple[RobotModel, Stage]:
    """Model and stage of a command line."""
    given = common.model_file(args.model) if args.model else None
    if args.rig.lower().endswith(".mcap") or is_bag(args.rig):
        return _session(args, given)
    if args.rig.lower().endswith(".urdf"):
        source, limits = _urdf(args.rig)
        robot = bare_robot(source)
    else:
        source, limits, joints = _rig(args, load_rig(args.rig))
        robot = bare_robot(source, joints)
    model = _model(args, given, source, robot)
    quantum = RESOLUTION * (limits.high - limits.low)
    return model, Stage(explore(limits, robot), source, BAND, quantum, _seconds(args))


def _model(
    args: argparse.Namespace, given: RobotModel | None, source: RobotSource, robot: Robot
) -> RobotModel:
    if given is not None and given.robot.urdf and given.robot.urdf != source.urdf:
        raise ConfigError(
            f"model {args.model} is of another robot than {args.rig}; give that robot's URDF in "
            "place of the rig file"
        )
    model = _moving(base_model(source)) if given is None else given
    model.check_joints(tuple(robot.joints))
    return model


def _moving(model: RobotModel) -> RobotModel:
    """The model without what is constant: that asks for no motion."""
    for name in model.names():
        if catalogue.get(name).relations.causes == ("constant",):
            model = model - name
    return model


def _session(args: argparse.Namespace, given: RobotModel | None) -> tuple[RobotModel, Stage]:
    run = load_source(args.rig, args.arm or None)
    named = given is not None and bool(given.robot.preset or given.robot.urdf)
    source = given.robot if given is not None and named else run.robot
    problem = Problem([run], source)
    model = _model(args, given, source, problem.robot)
    # without values the effort that a motion needs cannot be foreseen
    known = model if given is not None and given.values() else fit(problem, model).model
    return known, stage_of(problem, _seconds(args))


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
    source = robot_source(arm)
    center = config.controller.parameters.get("center", ())
    return source, limits_of_arm(arm, source, tuple(map(float, center))), arm.joints


def as_dict(
    args: argparse.Namespace, motion: Trajectory, margins: list[Margin], rows: Played | None
) -> dict[str, Any]:
    """`hil excite --json`; `table` is what --csv wrote."""
    limits = [
        {"what": m.what, "used": m.used, "limit": terminal.finite(m.limit), "unit": m.unit}
        for m in margins
    ]
    return {
        "schema": "hil.excite/1",
        "output": args.output,
        "motion": motion.name,
        "for": list(motion.purpose),
        "period_s": motion.period,
        "asked_s": _seconds(args),
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


def _seconds(args: argparse.Namespace) -> float:
    """Length that the motion should have [s]."""
    return float(SECONDS if args.seconds is None else args.seconds)


def length(args: argparse.Namespace, motion: Trajectory) -> str:
    """Where the motion is not as long as was asked, why; nothing where nothing was asked."""
    asked, period = args.seconds, motion.period
    if asked is None or abs(period - asked) < 0.01 * asked:
        return ""
    if period > asked:
        return (
            f"  longer than the {asked:g} s asked for: one round takes {period:.3g} s at the "
            "speeds that it needs and the limits allow\n"
        )
    return (
        f"  one round takes {period:.3g} s: {plural(rounds(period, asked), 'whole round')} in the "
        f"{asked:g} s asked for\n"
    )


def menu_table(found: Choice) -> str:
    """Every motion of the menu with what it would say."""
    rows = [
        [o.motion.name, f"{o.verdict.odds:.1f}", f"{100 * o.verdict.share:.1f} %"]
        for o in found.options
    ]
    return terminal.table(["menu", "log odds", "cannot be imitated"], rows)


def assumed(question: Question, units: tuple[str, ...], model: RobotModel) -> str:
    """What the menu takes for granted of what was not measured; units of the joints."""
    fitted = [r for r in question.rivals if r.name in model.names()]
    guessed = [r for r in question.rivals if r.name not in model.names()]
    size = f"an effect of {100 * SIZE:g} % of the torque limit, " if guessed else ""
    said = [f"{size}a noise of {100 * NOISE:g} %", *(_shape(r, units) for r in guessed)]
    own = [_shape(r, units) or r.name for r in fitted]
    lines = [f"  of the model: {'; '.join(own)}"] if own else []
    return "\n".join([*lines, f"  assumed: {'; '.join(filter(None, said))}"])


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
    return terminal.table(["limit", "largest", "left"], rows)


def play(args: argparse.Namespace, rows: Played | None) -> str:
    """How to play the motion, and what the table holds."""
    own = own_robot(args.rig)
    lines = (
        [
            f"{args.csv}: {', '.join(header(rows.q.shape[1]))} in SI units, {rows.t.size} rows, "
            f"{rows.t[-1]:.4g} s: {plural(rows.rounds, 'round')} of the motion, with "
            f"{rows.lead:g} s before and behind to come from rest and back"
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


def beside(args: argparse.Namespace, joints: int) -> str:
    """What to do with the session of a motion of one of several joints."""
    if not args.joint or joints == 1:
        return ""
    return (
        "\nJoints that only hold their place beside it say little: diagnose it together with a "
        "session in which all of them move,\n  hil diagnose FIRST.mcap SESSION.mcap --model M.toml"
    )


EXAMPLE = (
    "hil excite rigs/identify.toml --for stribeck,quadratic-drag --joint joint2 -o next.toml\n"
    "  hil run rigs/identify.toml --trajectory next.toml -o next.mcap"
)
#: Rows a second of the table that --csv writes [Hz].
RATE = 1000.0
#: Length of a motion where none is asked for [s].
SECONDS = 30.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument(
        "rig",
        metavar="RIG.toml",
        help="rig file, the URDF of a robot of your own, a session (S.mcap) or a ROS bag: without "
        "a URDF in it the motion keeps to the range, twice the speed and twice the effort recorded",
    )
    parser.add_argument(
        "--for",
        dest="effects",
        default="",
        metavar="EFFECT[,EFFECT]",
        help="one effect to show, or rivals to separate; without, the motion identifies the model",
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="TRAJ.toml",
        help="trajectory to write; an older trajectory there is replaced",
    )
    parser.add_argument(
        "--csv",
        metavar="TABLE.csv",
        help="also write the motion as a table for a rig of your own: t, q1.., qd1.., qdd1.., SI, "
        f"a header, {RATE:g} rows a second, from rest to rest; an older table there is replaced",
    )
    parser.add_argument("--model", metavar="M.toml", help="model file; default: the base model")
    parser.add_argument("--arm", help="arm of the rig; default: the first one that moves")
    parser.add_argument("--joint", help="joint in question; default: all in turn")
    parser.add_argument(
        "--motion", choices=tuple(choose.MENU), help="this motion of the menu, not the best one"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        help=f"length [s] (default {SECONDS:g}); what needs longer at the speeds allowed takes it",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (default 0)")
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


@single_threaded
def run(args: argparse.Namespace) -> int:
    """Plan, write and print."""
    given = [args.rig, *([args.model] if args.model else [])]
    outputs.check(args.output, ".toml", given, trajectory.is_trajectory, "a trajectory file")
    outputs.check(args.csv, ".csv", given, trajectory.is_table, "a table of a motion")
    if not 5.0 <= _seconds(args) <= 600.0 or args.seed < 0:
        raise ConfigError("--seconds must be 5 to 600, --seed 0 or more")
    catalogue.load_installed()
    model, stage = given_stage(args)
    names = tuple(dict.fromkeys(x.strip() for x in args.effects.split(",") if x.strip()))
    if not names:
        return _identify(args, model, stage)
    return _separate(args, model, stage, names)


def _joint(args: argparse.Namespace, stage: Stage) -> int | None:
    joints = tuple(stage.space.robot.joints)
    if not args.joint:
        return 0 if len(joints) == 1 else None
    if args.joint not in joints:
        raise ConfigError(unknown("joint", args.joint, joints))
    return joints.index(args.joint)


def _identify(args: argparse.Namespace, model: RobotModel, stage: Stage) -> int:
    if args.motion or args.joint:
        raise ConfigError("--motion and --joint need --for EFFECT; without it all joints move")
    progress.at("seek the motion", 0.0)
    found = fourier.optimise(model, stage, args.seed)
    motion, margins = foreseen(found.motion, stage, model)
    rows = _write(args, motion, stage, "identifies the model")
    if args.json:
        extra = {
            "condition": terminal.finite(found.condition),
            "condition_naive": terminal.finite(found.naive),
            "columns": found.columns,
        }
        terminal.emit(as_dict(args, motion, margins, rows) | extra)
        return 0
    naive = f"{found.naive:.3g}" if math.isfinite(found.naive) else "without limit (rank lost)"
    terminal.out(
        f"{args.output}: identifies {found.columns} base and friction parameters, period "
        f"{motion.period:g} s\n  condition number {found.condition:.3g}; with one sine a joint "
        f"{naive}\n{length(args, motion)}\n{limits(margins)}\n\n"
        f"{play(args, rows)}"
    )
    return 0


def _separate(
    args: argparse.Namespace, model: RobotModel, stage: Stage, names: tuple[str, ...]
) -> int:
    for name in names:
        catalogue.get(name)
    joint, joints = _joint(args, stage), len(stage.space.robot.joints)
    progress.at("rate the motions", 0.0)
    asked = question(model, names, joint, stage)
    found = decide(survey(asked, stage, joint), asked, ())
    best = next((o for o in found.options if o.motion.name == args.motion), found.best)
    if found.structural:
        raise ConfigError(_inseparable(names))
    motion = _named(best.motion, names)
    what = f"separates {_versus(names)}: {choose.describe(best.motion.name, joints)}"
    rows = _write(args, motion, stage, what)
    if args.json:
        listed = [
            {"motion": o.motion.name, "log_odds": o.verdict.odds, "share": o.verdict.share}
            for o in found.options
        ]
        terminal.emit(as_dict(args, motion, best.margins, rows) | {"menu": listed})
        return 0
    about = choose.describe(motion.name, joints)
    terminal.out(
        f"{args.output}: {motion.name}, {motion.period:.3g} s: {about}\n"
        f"  for {_versus(names)}\n{assumed(asked, tuple(stage.space.robot.units), model)}\n"
        f"{length(args, motion)}\n"
        f"{menu_table(found)}\n\n"
        f"{limits(best.margins)}\n\n{play(args, rows)}"
        f"{beside(args, joints)}"
    )
    return 0


def _inseparable(names: tuple[str, ...]) -> str:
    """Why no motion answers, and what would."""
    return (
        f"no motion of this robot separates {_versus(names)}: whatever it does, the one "
        "imitates the other (structural); a different measurement is needed: "
        + "; ".join(dict.fromkeys(catalogue.get(n).doc.shown_by for n in names))
    )


def _versus(names: tuple[str, ...]) -> str:
    return " against ".join(names) if len(names) > 1 else f"{names[0]} against the model"


def _named(motion: Trajectory, names: tuple[str, ...]) -> Trajectory:
    return replace(motion, purpose=names)


def _write(args: argparse.Namespace, motion: Trajectory, stage: Stage, what: str) -> Played | None:
    """Write the motion, and its table if one is wanted."""
    with outputs.writing(args.output):
        trajectory.write(motion, args.output, f"Written by 'hil excite'; {what}.")
    if not args.csv:
        return None
    rows = trajectory.played(motion, _seconds(args), RATE, stage.space.limits.speed)
    with outputs.writing(args.csv):
        trajectory.write_csv(rows, args.csv)
    return rows
