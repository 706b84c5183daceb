"""What the analysis commands share: options, loading, and how results go out."""

from __future__ import annotations

import argparse
import contextlib
import math
import webbrowser
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from hil import outputs, terminal
from hil.errors import ConfigError
from hil.models import catalogue
from hil.models.files import read_model, write_model
from hil.models.model import RobotModel, Value, base_model, in_words, without_error
from hil.record.arrays import once
from hil.record.bags import BagChoice, TableChoice
from hil.record.recording import Recording
from hil.record.sources import find, load_sources, stand_elsewhere, urdf_text
from hil.record.urdf_checks import unlike
from hil.terminal import Found
from hil.userfile import parse_toml, read_text


def add_sessions(
    parser: argparse.ArgumentParser, model: bool = True, what: str = "recordings to fit"
) -> None:
    """Options of every command that looks at sessions with a model."""
    kinds = "sessions, ROS bags, tables, or folders of them"
    parser.add_argument("sessions", nargs="+", metavar="S.mcap", help=f"{what}: {kinds}")
    add_model(parser)
    if model:
        add_holdout(parser)
    add_sources(parser)
    add_tables(parser)


def add_sources(parser: argparse.ArgumentParser) -> None:
    """--robot, and the options of bags and joints."""
    parser.add_argument(
        "--robot", default="", metavar="URDF", help="robot; default: that of the session or bag"
    )
    add_bag(parser)


def add_workers(parser: argparse._ActionsContainer, what: str = "", *also: str) -> None:
    """--workers and --cluster.

    Parameters
    ----------
    parser : ArgumentParser or group of it
        Of the command.
    what : str
        Where they count, if not everywhere, e.g. ``" (diagnosis)"``.
    *also : str
        Older names of --workers.
    """
    parser.add_argument(
        "--workers", *also, type=int, default=2, metavar="N", help=f"processes (default 2){what}"
    )
    parser.add_argument(
        "--cluster",
        default="",
        metavar="ADDRESS",
        help=f"a Dask scheduler in place of processes, e.g. tcp://host:8786{what}",
    )


def add_page(parser: argparse.ArgumentParser, here: str) -> None:
    """--host (default `here`), --port and --no-browser of a command that serves a page."""
    parser.add_argument(
        "--host",
        default=here,
        metavar="ADDRESS",
        help="address on which the page listens: default this machine alone, 0.0.0.0 all of its "
        "addresses; on each, a request needs the token of the printed address",
    )
    parser.add_argument("--port", type=int, default=0, help="port; default: a free one")
    parser.add_argument(
        "--no-browser", action="store_true", help="print the address, and open no browser"
    )


def tell_page(what: str, here: str, there: str, power: str, browser: bool) -> None:
    """Print the address of a page, and open it.

    Parameters
    ----------
    what : str
        Name of the page.
    here, there : str
        Its address, and that for other machines; empty: for none.
    power : str
        What everybody can do who has the address.
    browser : bool
        Open it.
    """
    terminal.out(f"{what} is open at {here}")
    if there != here and there:
        terminal.out(f"From another machine: {there}")
    if there:
        terminal.out(
            f"warning: Anyone who has this address {power}. The data are not encrypted: use --host "
            "only within the network of the lab. From elsewhere, leave out --host and use a tunnel "
            "(ssh -L)."
        )
    if browser:
        webbrowser.open(here)


def add_tags(parser: argparse.ArgumentParser) -> None:
    """--tag."""
    parser.add_argument(
        "--tag",
        action="append",
        default=[],
        metavar="TAG",
        help="word by which 'hil list' finds the session (repeatable)",
    )


def add_holdout(parser: argparse.ArgumentParser) -> None:
    """--holdout."""
    parser.add_argument(
        "--holdout",
        action="append",
        default=[],
        metavar="H.mcap",
        help="session to judge on (repeatable); without, blocks of the same sessions",
    )


def add_report(parser: argparse.ArgumentParser) -> None:
    """--report."""
    parser.add_argument(
        "--report",
        metavar="R.html",
        help="write a self-contained report; an older report there is replaced",
    )


def add_output(parser: argparse.ArgumentParser, name: str, what: str) -> None:
    """-o for a model file."""
    parser.add_argument(
        "-o",
        "--output",
        metavar=name,
        help=f"write {what}; an older model file there is replaced, any other file is not",
    )


def add_model(parser: argparse.ArgumentParser) -> None:
    """--model, --arm, --json."""
    parser.add_argument(
        "--model",
        metavar="M.toml",
        help="model file; without, the base model of the session's robot",
    )
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE.py",
        help="effects of your own, beside those of the model (repeatable); the file is run",
    )
    parser.add_argument("--arm", help="arm of the session, e.g. follower")
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


@dataclass(frozen=True)
class NamedFunction:
    """Row of a table of names: what runs, loaded when it is asked for, and what it is for.

    Parameters
    ----------
    place : str
        ``"module:function"``; the function takes the command line and gives a `Found`.
    help : str
        What the help says of it.
    """

    place: str
    help: str

    def load(self) -> Callable[[argparse.Namespace], Found]:
        """Import the function."""
        module, _, name = self.place.partition(":")
        found: Callable[[argparse.Namespace], Found] = getattr(import_module(module), name)
        return found


def list_names(parser: argparse.ArgumentParser, rows: Mapping[str, NamedFunction]) -> None:
    """Add the names that a command takes to its help, each with what it is for."""
    wide = max(map(len, rows))
    told = [f"  {name:{wide}s}  {row.help}" for name, row in rows.items()]
    parser.description = "\n".join([parser.description or "", "", "NAME is one of", *told])


def load_inputs(
    args: argparse.Namespace, sessions: Sequence[str] | None = None
) -> tuple[list[Recording], list[Recording], RobotModel]:
    """Sessions, held-out sessions and model of a command line.

    A model without a robot takes the session's; a session without a model gets the base model.
    Outputs that must not be written are refused first.
    """
    paths = find(sessions if sessions is not None else args.sessions)
    others = find(getattr(args, "holdout", []))
    check_outputs(args, [*paths, *others, *([args.model] if args.model else [])])
    catalogue.load_installed()
    note_compiling()
    model = model_file(args.model) if args.model else None
    arm = args.arm or (model.arm if model else "") or None
    described = model.robot.urdf if model else ""
    choice = replace(bag_choice(args), described=described)
    runs, held = load_sources(paths, others, arm, choice)
    if note := runs[0].metadata.get("note"):
        terminal.log(note)
    for text in stand_elsewhere([*runs, *held]):
        terminal.log(text)
    robot = runs[0].robot
    if model is None:
        model = base_model(robot, runs[0].arm)
        terminal.log(
            f"no --model given: base model ({' + '.join(model.names())}) of the session's robot"
        )
    elif not (model.robot.preset or model.robot.urdf):
        model = replace(model, robot=robot)
    elif where := unlike(model.robot.urdf, robot.urdf):
        terminal.log(
            f"warning: model {args.model} describes another robot than {runs[0].name}: {where}. "
            "The model's is taken"
        )
    model = with_plugins(model, getattr(args, "plugin", ()))
    if args.arm:  # what is written holds for this arm alone
        model = replace(model, arm=args.arm)
    outputs.refuse_urdf(getattr(args, "output", None), model.robot.urdf)
    _refuse_robots([*paths, *others], [*runs, *held])
    runs = once(runs, _twice)
    model.check_joints(runs[0].joints)
    return _distinct(runs), _distinct(held), model


def with_plugins(model: RobotModel, files: Sequence[str]) -> RobotModel:
    """The model that also names files of effects, which are loaded: who names them runs them.

    Raises
    ------
    ConfigError
        If a file is missing, does not run, or holds no effects.
    """
    fresh = [str(Path(f).resolve()) for f in files]
    for name in fresh:
        if name not in model.plugins:
            catalogue.load_plugin(Path(name))
    return replace(model, plugins=tuple(dict.fromkeys([*model.plugins, *fresh])))


#: What compiles on the first use [s].
COMPILING_S = 15


@cache
def note_compiling() -> None:
    """Say once, at the first analysis of an installation, why it takes so long."""
    from hil.identify import bands

    if not bands.compiled():
        terminal.log(f"compiling (once per installation), about {COMPILING_S} s")


def check_outputs(args: argparse.Namespace, inputs: Iterable[str | Path]) -> None:
    """Refuse early an output that cannot be written, or must not be written over."""
    given, model, report = list(inputs), getattr(args, "output", None), "a report of hil"
    outputs.check(model, ".toml", given, outputs.is_model, "a model file")
    outputs.check(getattr(args, "report", None), ".html", given, outputs.is_report, report)


def model_file(path: str) -> RobotModel:
    """Read a model file; one that is none is told apart from one with a mistake in it.

    Raises
    ------
    ConfigError
        If it is empty, of another kind, or wrong.
    """
    try:
        text = read_text(path)
        schema = parse_toml(text).get("schema")
    except (OSError, ValueError):
        return read_model(path)  # says what is wrong with the file
    if not str(schema).startswith("hil.model/"):
        state = "is empty" if not text.strip() else "is not a model file"
        found = "" if schema is None else f" (its schema is {schema!r})"
        raise ConfigError(
            f'model {path} {state}{found}; a model file starts with schema = "hil.model/1", and '
            "'hil fit SESSION.mcap -o MODEL.toml' writes one"
        )
    return read_model(path)


def _refuse_robots(paths: Sequence[Path], runs: Sequence[Recording]) -> None:
    """Refuse sessions of several robots, each with its sessions."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for path, run in zip(paths, runs, strict=True):
        groups.setdefault(run.joints, []).append(str(path))
    if len(groups) > 1:
        rows = [f"{', '.join(names)}: {', '.join(joints)}" for joints, names in groups.items()]
        raise ConfigError(
            f"the sessions are of {len(groups)} robots, by their joints: {'; '.join(rows)}. Give "
            "those of one robot, or the joints that all have with --joints"
        )


def _twice(run: Recording, other: Recording) -> None:
    """Say that a run is left out, which would count twice."""
    terminal.log(f"warning: {run.name} holds the same data as {other.name}; left out")


def _distinct(runs: list[Recording]) -> list[Recording]:
    """Runs with distinct names, for per-run parameters."""
    names = [r.name for r in runs]
    return [
        r if names.count(r.name) == 1 else replace(r, name=f"{r.name}#{k + 1}")
        for k, r in enumerate(runs)
    ]


def deliver(
    args: argparse.Namespace,
    report: Callable[[str], None],
    data: Callable[[], dict[str, Any]],
    text: Callable[[], str],
) -> None:
    """Results of an analysis: the report where it is wanted, then JSON or text."""
    if args.report:
        with outputs.writing(args.report):
            report(args.report)
    if args.json:
        terminal.emit(data())
        return
    terminal.out(text())
    if args.report:
        terminal.out(f"\nreport: {args.report}")


def save_model(model: RobotModel, path: str | Path) -> None:
    """Write a model file."""
    with outputs.writing(path):
        write_model(model, path)


def value_line(name: str, v: Value, joints: tuple[str, ...] = ()) -> str:
    """``name = value +- standard error unit``, with words for codes, and why there is no error.

    Parameters
    ----------
    name : str
        Full name.
    v : Value
        The value.
    joints : tuple of str
        Joints of the robot, where they are known.
    """
    error = f" +- {v.stderr:.2g}" if v.stderr == v.stderr else ""
    text = f"{name} = {v.value:.4g}{error} {'' if v.unit == '1' else v.unit}".rstrip()
    said, why = in_words(name, v.value, joints), without_error(name, v)
    text += f" ({said})" if said else ""
    text += f" (no standard error: {why})" if why and v.identifiable and not v.at_bound else ""
    return text + (", on its bound" if v.at_bound else "" if v.identifiable else ", undetermined")


# Options that say what is taken of a ROS bag, and which joints of a robot the columns are of.

_TOPICS = ("topic", "effort_topic", "force_topic")


def add_bag(parser: argparse.ArgumentParser) -> None:
    """--topic, --effort-topic, --force-topic, --joints, --lock."""
    group = parser.add_argument_group(
        "ROS bags and joints", "chosen where only one choice is possible"
    )
    group.add_argument("--topic", default="", metavar="T", help="joint states, e.g. /joint_states")
    group.add_argument("--effort-topic", default="", metavar="T", help="motor efforts")
    group.add_argument(
        "--force-topic",
        default="",
        metavar="T",
        help="force on the robot at the tip, in axes of its base (WrenchStamped)",
    )
    group.add_argument(
        "--joints",
        default="",
        metavar="A,B",
        help="joints that move, of a table in the order of its columns; the others of the URDF are "
        "locked (default: those that a bag shows moving, with efforts; of a table all, or the arm "
        "without what hangs beyond its last column)",
    )
    group.add_argument(
        "--lock",
        action="append",
        default=[],
        metavar="JOINT=X",
        help="lock a joint at a position [rad or m] (repeatable)",
    )


def add_tables(parser: argparse.ArgumentParser) -> None:
    """--map and what else `hil import` knows of a table that is analysed without a session."""
    group = parser.add_argument_group("tables", "same as for 'hil import'")
    group.add_argument("--map", default="", metavar="MAP.toml", help=MAP)
    add_table_words(group)


MAP = "renames, scales, shifts and signs columns; or the name of a built-in map"


def add_table_words(parser: argparse._ActionsContainer) -> None:
    """--run, --unit, --torque-constant, --rate and --missing."""
    parser.add_argument(
        "--run", dest="which", default="", metavar="NAME", help="run of a file with several"
    )
    parser.add_argument(
        "--unit",
        default="",
        metavar="UNIT",
        help="unit of the axes, without a URDF: rad, m, or one a joint (rad,m); deg: positions in "
        "degrees, speeds in degrees/s",
    )
    parser.add_argument(
        "--torque-constant",
        default="",
        metavar="K[,K..]",
        help="efforts are motor currents [A]: effort at the joint by ampere, one or one a joint",
    )
    parser.add_argument(
        "--rate",
        type=_rate,
        default=0.0,
        metavar="HZ",
        help="sample rate of a table without a column of times",
    )
    parser.add_argument(
        "--missing",
        default="",
        choices=("refuse", "drop", "interpolate"),
        help="missing values: refuse them (default), leave their rows out, or fill up to 10 rows",
    )


def _rate(text: str) -> float:
    """A sample rate of the command line."""
    with contextlib.suppress(ValueError):
        rate = float(text)
        if 0 < rate < math.inf:
            return rate
    raise argparse.ArgumentTypeError(f"{text!r}: expected samples per second, e.g. 500")


def torque_constants(text: str) -> tuple[float, ...]:
    """Torque constants of the command line.

    Raises
    ------
    ConfigError
        If one is no number.
    """
    try:
        return tuple(float(x) for x in text.split(",")) if text else ()
    except ValueError:
        raise ConfigError(
            f"--torque-constant {text}: expected numbers with commas between them, e.g. 12.1,12.1,9"
        ) from None


def bag_choice(args: argparse.Namespace) -> BagChoice:
    """What the options say.

    Raises
    ------
    ConfigError
        If an option makes no sense, or the URDF cannot be read.
    """
    return BagChoice(
        topic=args.topic,
        effort_topic=args.effort_topic,
        force_topic=args.force_topic,
        robot=urdf_text(args.robot),
        joints=bag_joints(args),
        lock=bag_locks(args),
        tip=getattr(args, "tip", ""),
        arm=args.arm or "",
        table=_table_choice(args),
    )


def _table_choice(args: argparse.Namespace) -> TableChoice:
    """How tables are read; a command without these options reads them by their names."""
    if not hasattr(args, "map"):
        return TableChoice()
    constants = torque_constants(args.torque_constant)
    return TableChoice(args.map, args.unit, args.rate, args.missing, args.which, constants)


def bag_joints(args: argparse.Namespace) -> tuple[str, ...]:
    """Joints of --joints."""
    return tuple(n.strip() for n in args.joints.split(",") if n.strip())


def bag_locks(args: argparse.Namespace) -> dict[str, float]:
    """Positions [rad or m] of --lock.

    Raises
    ------
    ConfigError
        If one makes no sense.
    """
    return dict(_locked(text) for text in args.lock)


def bag_words(args: argparse.Namespace) -> tuple[str, ...]:
    """The words of these options, for a command that comes next."""
    single = {k: getattr(args, k) for k in ("robot", *_TOPICS, "joints")}
    of_tables = ("map", "unit", "rate", "missing", "torque_constant")
    for name in of_tables if hasattr(args, "map") else ():
        value = getattr(args, name)
        single[name] = f"{value:g}" if isinstance(value, float) and value else value
    single["run"] = getattr(args, "which", "")
    out = [w for k, v in single.items() if v for w in (f"--{k.replace('_', '-')}", v)]
    return (*out, *(w for text in args.lock for w in ("--lock", text)))


def refuse_topics(args: argparse.Namespace) -> None:
    """Refuse topics for something that is no bag.

    Raises
    ------
    ConfigError
        If one is given.
    """
    for name in _TOPICS:
        if getattr(args, name):
            option = "--" + name.replace("_", "-")
            raise ConfigError(f"{option} is for ROS bags; {args.table} is none")


def _locked(text: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not name.strip() or not math.isfinite(value):
        raise ConfigError(f"--lock {text!r}; expected JOINT=X with X in rad or m, e.g. finger=0.02")
    return name.strip(), value
