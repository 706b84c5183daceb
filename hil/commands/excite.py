"""`hil excite`: the safe motion that identifies a model or separates rival effects."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

from hil.commands import common, excite_text, outputs, plugins
from hil.errors import ConfigError, unknown
from hil.excite import fourier, menu, trajectory
from hil.excite.choose import decide, question, survey
from hil.excite.stage import Stage, foreseen
from hil.excite.trajectory import Played, Trajectory
from hil.identify.parallel import single_threaded
from hil.models import catalogue
from hil.models.model import RobotModel

EXAMPLE = (
    "hil excite rigs/identify.toml --for stribeck,quadratic-drag --joint joint2 -o next.toml\n"
    "  hil run rigs/identify.toml --trajectory next.toml -o next.mcap"
)
#: Rows a second of the table that --csv writes [Hz].
RATE = 1000.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument(
        "rig",
        metavar="RIG.toml",
        help="rig file, the URDF of a robot of your own, or a session (S.mcap): without a URDF in "
        "it the motion keeps to the range, twice the speed and twice the effort recorded",
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
        "--motion", choices=tuple(menu.MENU), help="this motion of the menu, not the best one"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=30.0,
        help="length [s] (default 30); what needs longer at the speeds allowed takes longer",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (default 0)")
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


@single_threaded
def run(args: argparse.Namespace) -> int:
    """Plan, write and print."""
    given = [args.rig, *([args.model] if args.model else [])]
    outputs.check(args.output, ".toml", given, trajectory.is_trajectory, "a trajectory file")
    outputs.check(args.csv, ".csv", given, trajectory.is_table, "a table of a motion")
    if not 5.0 <= args.seconds <= 600.0 or args.seed < 0:
        raise ConfigError("--seconds must be 5 to 600, --seed 0 or more")
    plugins.load_installed()
    model, stage = excite_text.stage(args)
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
    found = fourier.optimise(model, stage, args.seed)
    motion, margins = foreseen(found.motion, stage, model)
    rows = _write(args, motion, stage, "identifies the model")
    if args.json:
        extra = {
            "condition": excite_text.finite(found.condition),
            "condition_naive": excite_text.finite(found.naive),
            "columns": found.columns,
        }
        common.emit(excite_text.as_dict(args, motion, margins, rows) | extra)
        return 0
    naive = f"{found.naive:.3g}" if math.isfinite(found.naive) else "without limit (rank lost)"
    common.out(
        f"{args.output}: identifies {found.columns} base and friction parameters, period "
        f"{motion.period:g} s\n  condition number {found.condition:.3g}; with one sine a joint "
        f"{naive}\n{excite_text.length(args, motion)}\n{excite_text.limits(margins)}\n\n"
        f"{excite_text.play(args, rows)}"
    )
    return 0


def _separate(
    args: argparse.Namespace, model: RobotModel, stage: Stage, names: tuple[str, ...]
) -> int:
    for name in names:
        catalogue.get(name)
    joint = _joint(args, stage)
    asked = question(model, names, joint, stage)
    found = decide(survey(asked, stage, joint), asked, ())
    best = next((o for o in found.options if o.motion.name == args.motion), found.best)
    if found.structural:
        raise ConfigError(_inseparable(names))
    motion = _named(best.motion, names)
    what = f"separates {_versus(names)}: {menu.describe(best.motion.name)}"
    rows = _write(args, motion, stage, what)
    if args.json:
        listed = [
            {"motion": o.motion.name, "log_odds": o.verdict.odds, "share": o.verdict.share}
            for o in found.options
        ]
        common.emit(excite_text.as_dict(args, motion, best.margins, rows) | {"menu": listed})
        return 0
    common.out(
        f"{args.output}: {motion.name}, {motion.period:.3g} s: {menu.describe(motion.name)}\n"
        f"  for {_versus(names)}\n{excite_text.assumed(asked, tuple(stage.space.robot.units))}\n"
        f"{excite_text.length(args, motion)}\n"
        f"{excite_text.menu(found)}\n\n"
        f"{excite_text.limits(best.margins)}\n\n{excite_text.play(args, rows)}"
        f"{excite_text.beside(args)}"
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
    rows = trajectory.played(motion, args.seconds, RATE, stage.space.limits.speed)
    with outputs.writing(args.csv):
        trajectory.write_csv(rows, args.csv)
    return rows
