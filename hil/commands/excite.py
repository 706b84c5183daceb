"""`hil excite`: the safe motion that identifies a model or separates rival effects.

The robot comes from a rig file, a URDF, or a session.

Periodic band-limited motion that identifies a model as well as its limits allow.

The Fourier coefficients are chosen so that

    J = ln cond(X D) - ln det(X' W X) / 2 p,   D scaling the columns to unit norm,

is small: base parameters of the rigid body and friction are told apart (first term) and
determined with little variance (second term, D-optimality).

Sources: Swevers et al., IEEE Trans. Robotics and Automation 13(5), 1997 (Fourier series, D-
optimality); Gautier and Khalil, Int. J. Robotics Research 11(4), 1992 (condition number).
"""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from hil import outputs, terminal, work
from hil.commands import common
from hil.errors import ConfigError, plural, unknown
from hil.excite import choose, trajectory
from hil.excite.choose import (
    MOST_TIMES,
    NO_MOTION,
    NOISE,
    UNKNOWN_EFFECT_SHARE,
    Choice,
    Option,
    decide,
    menu,
    question,
    survey,
)
from hil.excite.question import (
    DEFAULT_BAND,
    Foreseen,
    Question,
    Rival,
    Space,
    Stage,
    foreseen,
    joint_space_room,
    nominal,
    playable,
    refusal,
    stage_of,
)
from hil.excite.trajectory import (
    Limits,
    Margin,
    Played,
    Trajectory,
    header,
    of_robot,
    period_times,
    rounds,
    sample,
)
from hil.identify.design import Term
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.model import RobotModel, base_model
from hil.models.motion import Motion
from hil.models.robots import Robot, bare_robot
from hil.record.bags import is_bag
from hil.record.recording import RobotSource
from hil.record.sources import load_sources
from hil.record.table_files import FORMATS, ending
from hil.record.urdf_checks import urdf_joints
from hil.rig.check import limits_of_arm
from hil.rig.config import RigConfig, load_rig, robot_source
from hil.userfile import is_dataset, read_text
from hil.work import single_threaded

#: Share of a joint's range that encoders resolve where nothing is known.
RESOLUTION = 1e-4
FloatArray = NDArray[np.float64]
#: Fundamental period [s] and highest frequency [Hz].
_PERIOD, _HIGHEST = 10.0, 1.2
#: Instants a period, random starts, and evaluations of J for closed-form and URDF robots.
_INSTANTS, _STARTS, _BUDGET, _BUDGET_URDF = 160, 40, 6000, 3000
#: Joints of two arms of seven; the time of the search grows with about the third power.
_MOST_JOINTS = 14


@dataclass(frozen=True)
class FourierDesign:
    """What an identifying motion must determine.

    Parameters
    ----------
    space : Space
        Room and limits.
    terms : list of Term
        Parts of the model.
    noise : ndarray (d,)
        Weights of the joints' rows [N m or N].
    columns : ndarray of int
        Columns that are independent of each other (base parameters).
    frame : Motion
        What does not depend on the motion: robot and sign resolution.
    """

    space: Space
    terms: list[Term]
    noise: FloatArray
    columns: NDArray[np.int_]
    frame: Motion


@dataclass(frozen=True)
class Identifying:
    """An identifying motion, and a naive one to compare with.

    Parameters
    ----------
    motion : Trajectory
        The motion.
    condition, naive : float
        Condition numbers of its columns scaled to unit norm, and of one sine a joint.
    with_offset : float
        Condition number with a constant torque a joint besides, as the base model of a fit has it.
    columns : int
        How many columns there are, without those.
    """

    motion: Trajectory
    condition: float
    naive: float
    with_offset: float
    columns: int


def _optimise(model: RobotModel, stage: Stage, seed: int = 0) -> Identifying:
    """Best motion of several random starts, each refined by L-BFGS-B."""
    design = _design(model, stage)
    rng = np.random.default_rng(seed)
    d, h = stage.space.center.size, int(_HIGHEST * _PERIOD)
    low = 1.0 / np.sqrt(np.arange(1, h + 1))[None, :, None]
    starts = [rng.normal(size=(d, h, 2)) * low for _ in range(_STARTS)]
    starts.sort(key=lambda c: cost(c, design))
    budget = _BUDGET_URDF if stage.source.urdf else _BUDGET
    tried = [_refined(c, design, budget // 2, k / 2) for k, c in enumerate(starts[:2])]
    best = min(tried, key=lambda c: cost(c, design))
    motion = shaped(best, stage.space, "identify")
    x = regressor(motion, design)
    naive = regressor(_naive(stage.space), design)
    d = stage.space.center.size
    whole = np.hstack([x, np.tile(np.eye(d), (len(x) // d, 1))])
    return Identifying(motion, _condition(x), _condition(naive), _condition(whole), x.shape[1])


def _refined(c: FloatArray, design: FourierDesign, budget: int, done: float) -> FloatArray:
    """A start, refined; `done`: share of the search that lies behind it, which is one half."""
    tries = count()

    def objective(z: FloatArray) -> float:
        work.at("seek the motion", done + 0.5 * min(next(tries) / budget, 1.0))
        return cost(z.reshape(c.shape), design)

    found = scipy.optimize.minimize(
        objective, c.ravel(), method="L-BFGS-B", options={"maxfun": budget, "eps": 1e-4}
    )
    return np.asarray(found.x, dtype=np.float64).reshape(c.shape)


def cost(c: FloatArray, design: FourierDesign) -> float:
    """J of raw coefficients (d, h, 2)."""
    x = regressor(shaped(c, design.space, "try"), design)
    norm = np.linalg.norm(x, axis=0)
    if np.any(norm < 1e-12):
        return 1e6
    s = np.linalg.svd(x / norm, compute_uv=False)
    # ln det(X'X) = 2 sum ln(norm) + 2 sum ln(s)
    spread = np.sum(np.log(norm)) + np.sum(np.log(np.maximum(s, 1e-12)))
    return float(np.log(s[0] / max(float(s[-1]), 1e-12)) - spread / norm.size)


def shaped(c: FloatArray, space: Space, name: str) -> Trajectory:
    """Motion of raw coefficients, scaled to fill the common range within the speed limits."""
    t = np.arange(_INSTANTS) * (_PERIOD / _INSTANTS)
    k = np.arange(1, c.shape[1] + 1)
    angle = 2 * np.pi / _PERIOD * np.outer(t, k)
    s, o, w = np.sin(angle), np.cos(angle), 2 * np.pi / _PERIOD * k[:, None]
    place = s @ c[..., 0].T + o @ c[..., 1].T
    rate = o @ (w * c[..., 0].T) - s @ (w * c[..., 1].T)
    # 2 % for what happens between the instants
    room = 0.98 * np.ptp(space.together, axis=1)
    scale = np.minimum(
        room / np.maximum(np.ptp(place, axis=0), 1e-12),
        0.98 * space.speed / np.maximum(np.abs(rate).max(axis=0), 1e-12),
    )
    middle = space.together.mean(axis=1) - scale * (place.max(axis=0) + place.min(axis=0)) / 2
    robot = space.robot
    return Trajectory(
        tuple(robot.joints),
        tuple(robot.units),
        _PERIOD,
        np.array([0.0, _PERIOD]),
        np.stack([middle, middle]),
        np.ones(2),
        scale[:, None, None] * c,
        name,
    )


def _naive(space: Space) -> Trajectory:
    """One sine a joint over the same range: 0.2 Hz, neighbours a quarter period apart."""
    c = np.zeros((space.center.size, 2, 2))
    phase = np.arange(space.center.size) * np.pi / 2
    c[:, 1] = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    return shaped(c, space, "naive")


def _design(model: RobotModel, stage: Stage) -> FourierDesign:
    space = stage.space
    rng = np.random.default_rng(0)
    probe = shaped(rng.normal(size=(space.center.size, 8, 2)), space, "probe")
    problem = stage.foresee(probe)
    terms, _ = nominal(model, problem, space.limits)
    torque = np.where(np.isfinite(space.limits.torque), space.limits.torque, 1.0)
    every = FourierDesign(space, terms, torque, np.arange(0), problem.motions[0])
    x = regressor(probe, every)
    norm = np.linalg.norm(x, axis=0)
    live = np.flatnonzero(norm > 1e-9 * norm.max())
    _, r, order = scipy.linalg.qr(x[:, live] / norm[live], mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    columns = np.sort(live[order[: int(np.sum(size > 1e-6 * size[0]))]])
    return FourierDesign(space, terms, torque, columns, problem.motions[0])


def regressor(x: Trajectory, design: FourierDesign) -> FloatArray:
    """Weighted columns of the design on one period, shape (n d, p)."""
    q, qd, qdd = sample(x, period_times(x, _INSTANTS / _PERIOD))
    n, d = q.shape
    nothing = np.zeros_like(q)
    motion = design.frame.with_(
        t=np.arange(n) * (_PERIOD / n),
        q=q,
        qd=qd,
        qdd=qdd,
        tau=nothing,
        tau_ext=nothing,
        load=nothing,
        static=nothing,
    )
    blocks = []
    for t in design.terms:
        columns = t.effect.columns(motion, t.joint, t.shape)
        if columns.ndim == 2:
            full = np.zeros((n, d, columns.shape[1]))
            full[:, t.joint] = columns
            columns = full
        blocks.append(columns / design.noise[:, None])
    out = np.concatenate(blocks, axis=2).reshape(n * d, -1)
    return out[:, design.columns] if design.columns.size else out


def _condition(x: FloatArray) -> float:
    """Condition number of the columns scaled to unit norm; infinite where one is zero."""
    norm = np.linalg.norm(x, axis=0)
    if np.any(norm < 1e-12):
        return float("inf")
    s = np.linalg.svd(x / norm, compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 1e-15 else float("inf")


def own_robot(path: str) -> bool:
    """Whether the robot is one that `hil run` cannot move: a URDF or a recording."""
    return path.lower().endswith(".urdf") or recorded(path)


def recorded(path: str) -> bool:
    """Whether the robot is that of a recording: a session, a bag or a table, not of a rig file."""
    if is_bag(path) or is_dataset(Path(path)):
        return True
    kind = ending(path)
    other = kind not in (".toml", ".urdf", "") and Path(path).is_file()
    return kind in (".mcap", ".bag", ".db3", *FORMATS) or other


def given_stage(args: argparse.Namespace) -> tuple[RobotModel, Stage]:
    """Model and stage of a command line."""
    given = common.model_file(args.model) if args.model else None
    if recorded(args.rig):
        return _session(args, given)
    if words := common.bag_words(args):
        raise ConfigError(f"{words[0]} is of a recording, and {args.rig} is none; leave it out")
    if args.rig.lower().endswith(".urdf"):
        source, limits = _urdf(args.rig)
        robot = bare_robot(source)
    else:
        source, limits, joints = _rig(args, load_rig(args.rig))
        robot = bare_robot(source, joints)
    _refuse_many(len(robot.joints), args.rig)
    model = _model(args, given, source, robot)
    quantum = RESOLUTION * (limits.high - limits.low)
    return model, Stage(
        joint_space_room(limits, robot), source, DEFAULT_BAND, quantum, _seconds(args)
    )


def _refuse_many(joints: int, where: str) -> None:
    """Refuse a robot whose motion would take hours."""
    if joints > _MOST_JOINTS:
        raise ConfigError(
            f"{where} has {joints} moving joints; a motion is planned for at most {_MOST_JOINTS}. "
            "Give a URDF of one arm, with the type fixed for the joints that are to rest"
        )


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
    choice = replace(common.bag_choice(args), described=given.robot.urdf if given else "")
    (run,), _ = load_sources([args.rig], [], args.arm or None, choice)
    _refuse_many(run.d, args.rig)
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
    urdf_joints(text, path)
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
    args: argparse.Namespace,
    motion: Trajectory,
    margins: list[Margin],
    rows: Played | None,
    space: Space,
) -> dict[str, Any]:
    """`hil excite --json`; `table` is what --csv wrote."""
    limits = [
        {"what": m.what, "used": m.used, "limit": terminal.json_value(m.limit), "unit": m.unit}
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
        "assumed_limits": [asdict(a) for a in trajectory.assumed(space.limits, space.robot)],
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
    return float(_SECONDS if args.seconds is None else args.seconds)


def _length_note(args: argparse.Namespace, motion: Trajectory) -> str:
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


def _assumed(question: Question, units: tuple[str, ...], model: RobotModel) -> str:
    """What the menu takes for granted of what was not measured; units of the joints."""
    fitted = [r for r in question.rivals if r.name in model.names()]
    guessed = [r for r in question.rivals if r.name not in model.names()]
    size = f"an effect of {100 * UNKNOWN_EFFECT_SHARE:g} % of the torque limit, " if guessed else ""
    said = [f"{size}a noise of {100 * NOISE:g} %", *(_shape(r, units) for r in guessed)]
    own = [_shape(r, units) or r.name for r in fitted]
    lines = [f"  of the model: {'; '.join(own)}"] if own else []
    return "\n".join([*lines, f"  assumed: {'; '.join(filter(None, said))}"])


def _shape(rival: Rival, units: tuple[str, ...]) -> str:
    """Shape values of a rival, e.g. ``stribeck with vs = 0.2 rad/s``."""
    effect, at = rival.term.effect, (rival.term.joint, rival.term.other)
    values = []
    for p, value in zip(effect.shape, rival.term.shape, strict=True):
        number = f"{p.name} = {value:.3g} {p.unit_at(units, *at)}".removesuffix(" 1")
        said = p.words(value)
        values.append(f"{p.name}: {said}" if said and p.choice else number)
    return f"{effect.name} with {', '.join(values)}" if values else ""


def _limit_table(margins: list[Margin], space: Space) -> str:
    """Distance to each limit, and which of them nobody stated."""
    rows = []
    for m in margins:
        if m.what.startswith(("speed", "torque")):
            share = f"{100 * (1 - m.used / m.limit):.0f} %" if math.isfinite(m.limit) else "-"
            rows.append([m.what, f"{m.used:.3g} of {m.limit:.3g} {m.unit}", share])
        else:
            rows.append([m.what, f"{m.used:.3g} {m.unit} to the limit", ""])
    table = terminal.table(["limit", "largest", "left"], rows)
    said = [
        f"{a.what} {' to '.join(f'{v:.3g}' for v in a.values)} {a.unit}"
        for a in trajectory.assumed(space.limits, space.robot)
    ]
    if not said:
        return table
    return (
        f"{table}\n  assumed, as the robot states none: {', '.join(said)}; write the true values "
        "into the URDF, or into the arm of a rig file"
    )


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


def _beside_motion(motion: trajectory.Trajectory) -> str:
    """What to do with the session of a motion that leaves joints where they are."""
    if np.all(np.ptp(motion.via, axis=0) + np.abs(motion.series).sum(axis=(1, 2)) > 0):
        return ""
    return (
        "\nThe other joints only hold their place and show little: diagnose it together with a "
        "session in which all of them move,\n  hil diagnose FIRST.mcap SESSION.mcap --model M.toml"
    )


EXAMPLE = (
    "hil excite identify --for stribeck,quadratic-drag --joint joint2 -o next.toml\n"
    "  hil run identify --trajectory next.toml -o next.mcap"
)
#: Rows a second of the table that --csv writes [Hz].
_RATE = 1000.0
#: Length of a motion where none is asked for [s].
_SECONDS = 30.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument(
        "rig",
        metavar="RIG.toml",
        help="rig file, the URDF of a robot of your own, or a recording: a session, a ROS bag or a "
        "table; without a URDF its motion keeps to the range, twice the speed and twice the effort "
        "recorded",
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
        f"a header, {_RATE:g} rows a second, from rest to rest; an older table there is replaced",
    )
    parser.add_argument("--model", metavar="M.toml", help="model file; default: the base model")
    parser.add_argument("--arm", help="arm of the rig; default: the first one that moves")
    parser.add_argument("--joint", help="joint in question; default: all in turn")
    parser.add_argument(
        "--motion", choices=tuple(choose.MENU), help="use this motion instead of the best one"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        help=f"length [s] (default {_SECONDS:g}); longer where the allowed speeds require it",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (default 0)")
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")
    common.add_sources(parser)
    common.add_tables(parser)


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
    work.at("seek the motion", 0.0)
    found = _optimise(model, stage, args.seed)
    motion, margins = foreseen(found.motion, stage, model)
    rows = _write(args, motion, stage, "identifies the model")
    if args.json:
        extra = {
            "condition": terminal.json_value(found.condition),
            "condition_naive": terminal.json_value(found.naive),
            "condition_with_offset": terminal.json_value(found.with_offset),
            "columns": found.columns,
        }
        terminal.emit(as_dict(args, motion, margins, rows, stage.space) | extra)
        return 0
    naive, offset = (
        f"{x:.3g}" if math.isfinite(x) else "without limit (rank lost)"
        for x in (found.naive, found.with_offset)
    )
    terminal.out(
        f"{args.output}: identifies {found.columns} base and friction parameters, period "
        f"{motion.period:g} s\n  condition number {found.condition:.3g}; with one sine a joint "
        f"{naive}\n  beside a torque offset of each joint, as 'hil fit' has it, {offset}\n"
        f"{_length_note(args, motion)}\n{_limit_table(margins, stage.space)}\n\n"
        f"{play(args, rows)}"
    )
    return 0


def _separate(
    args: argparse.Namespace, model: RobotModel, stage: Stage, names: tuple[str, ...]
) -> int:
    for name in names:
        catalogue.get(name)
    joint, joints = _joint(args, stage), len(stage.space.robot.joints)
    work.at("rate the motions", 0.0)
    asked = question(model, names, joint, stage)
    foreseen = menu(asked, stage, joint)
    seen = survey(foreseen, asked, stage)
    _refuse_beyond(args, foreseen, stage, asked)
    found = decide(seen, asked, ())
    if found.structural:
        raise ConfigError(_inseparable(names))
    best = _wanted(args, found)
    motion = _named(best.motion, names)
    what = f"separates {_versus(names)}: {choose.describe_motion(best.motion.name, joints)}"
    rows = _write(args, motion, stage, what)
    if args.json:
        listed = [
            {"motion": o.motion.name, "log_odds": o.verdict.odds, "share": o.verdict.share}
            for o in found.options
        ]
        terminal.emit(as_dict(args, motion, best.margins, rows, stage.space) | {"menu": listed})
        return 0
    about = choose.describe_motion(motion.name, joints)
    terminal.out(
        f"{args.output}: {motion.name}, {motion.period:.3g} s: {about}\n"
        f"  for {_versus(names)}\n{_assumed(asked, tuple(stage.space.robot.units), model)}\n"
        f"{_length_note(args, motion)}\n"
        f"{menu_table(found)}\n\n"
        f"{_limit_table(best.margins, stage.space)}\n\n{play(args, rows)}"
        f"{_beside_motion(motion)}"
    )
    return 0


def _refuse_beyond(
    args: argparse.Namespace, made: list[Foreseen], stage: Stage, asked: Question
) -> None:
    """Refuse where the motion asked for breaks a limit at every size, or all of the menu do."""
    mine = [x for x in made if args.motion in (None, x[0].name)]
    if mine and not any(map(playable, mine)):
        raise refusal(mine[0], stage, asked)


def _wanted(args: argparse.Namespace, found: Choice) -> Option:
    """The motion of the menu that was asked for, else the best one."""
    options = {o.motion.name: o for o in found.options}
    if args.motion and args.motion not in options:
        raise ConfigError(
            f"--motion {args.motion} would take more than {MOST_TIMES:g} times as long as asked "
            f"for, or needs more joints; there is {', '.join(options)}"
        )
    return options[args.motion] if args.motion else found.best


def _inseparable(names: tuple[str, ...]) -> str:
    """Why no motion answers, and what to do; one effect may need a load, a sensor or other limits.

    What shows each of several effects does not tell them apart: nothing is said of it.
    """
    text = (
        f"{NO_MOTION} separates {_versus(names)}: in all of the menu together, the one imitates "
        "the other"
    )
    if len(names) > 1:
        return f"{text}. Within these limits, use either for predictions"
    return f"{text}. Beyond these limits: {catalogue.get(names[0]).doc.shown_by}"


def _versus(names: tuple[str, ...]) -> str:
    return " against ".join(names) if len(names) > 1 else f"{names[0]} against the model"


def _named(motion: Trajectory, names: tuple[str, ...]) -> Trajectory:
    return replace(motion, purpose=names)


def _write(args: argparse.Namespace, motion: Trajectory, stage: Stage, what: str) -> Played | None:
    """Write the motion, and its table if one is wanted."""
    with outputs.writing(args.output):
        trajectory.write_trajectory(motion, args.output, f"Written by 'hil excite'; {what}.")
    if not args.csv:
        return None
    rows = trajectory.played_back(motion, _seconds(args), _RATE, stage.space.limits.speed)
    with outputs.writing(args.csv):
        trajectory.write_csv(rows, args.csv)
    return rows
