"""Options that say what is taken of a ROS bag, and which joints of a robot the columns are of."""

from __future__ import annotations

import argparse
import math

from hil.errors import ConfigError
from hil.record.bags import BagChoice
from hil.record.sources import urdf_text

_TOPICS = ("topic", "effort_topic", "force_topic")


def add(parser: argparse.ArgumentParser) -> None:
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


def choice(args: argparse.Namespace) -> BagChoice:
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
        joints=joints(args),
        lock=locked(args),
        tip=getattr(args, "tip", ""),
        arm=args.arm or "",
    )


def joints(args: argparse.Namespace) -> tuple[str, ...]:
    """Joints of --joints."""
    return tuple(n.strip() for n in args.joints.split(",") if n.strip())


def locked(args: argparse.Namespace) -> dict[str, float]:
    """Positions [rad or m] of --lock.

    Raises
    ------
    ConfigError
        If one makes no sense.
    """
    return dict(_locked(text) for text in args.lock)


def typed(args: argparse.Namespace) -> tuple[str, ...]:
    """The words of these options, for a command that comes next."""
    single = {k: getattr(args, k) for k in ("robot", *_TOPICS, "joints")}
    out = [w for k, v in single.items() if v for w in (f"--{k.replace('_', '-')}", v)]
    return (*out, *(w for text in args.lock for w in ("--lock", text)))


def refuse(args: argparse.Namespace) -> None:
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
