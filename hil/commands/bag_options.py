"""Options that say what is taken of a ROS bag, and which joints of a robot move."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from hil.errors import ConfigError
from hil.record.bags import BagChoice
from hil.userfile import read_text

_TOPICS = ("topic", "effort_topic", "force_topic")


def add(parser: argparse.ArgumentParser) -> None:
    """--topic, --effort-topic, --force-topic, --joints, --lock."""
    group = parser.add_argument_group("ROS bags", "chosen where only one choice is possible")
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
        help="joints that move; the others of the URDF are locked (default: those that the bag "
        "shows moving, with efforts)",
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
        robot=_urdf(args.robot),
        joints=tuple(n.strip() for n in args.joints.split(",") if n.strip()),
        lock=dict(_locked(text) for text in args.lock),
        tip=getattr(args, "tip", ""),
        arm=args.arm or "",
    )


def refuse(args: argparse.Namespace) -> None:
    """Refuse options of bags for something else.

    Raises
    ------
    ConfigError
        If one is given.
    """
    for name in (*_TOPICS, "joints", "lock"):
        if getattr(args, name):
            option = "--" + name.replace("_", "-")
            raise ConfigError(f"{option} is for ROS bags; {args.table} is none")


def _urdf(name: str) -> str:
    if not name:
        return ""
    try:
        return read_text(Path(name))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"robot {name} cannot be read: {error}") from error


def _locked(text: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not name.strip() or not math.isfinite(value):
        raise ConfigError(f"--lock {text!r}; expected JOINT=X with X in rad or m, e.g. finger=0.02")
    return name.strip(), value
