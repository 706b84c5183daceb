"""What `hil excite` prints: JSON, the menu, margins, and how to play the motion."""

from __future__ import annotations

import argparse
import math
from typing import Any

from hil.commands import common
from hil.excite.ask import NOISE, SIZE
from hil.excite.choose import Choice
from hil.excite.margins import Margin
from hil.excite.question import Question, Rival
from hil.excite.trajectory import Trajectory


def finite(x: float) -> float | None:
    """A number for JSON; None where it is not finite."""
    return x if math.isfinite(x) else None


def as_dict(args: argparse.Namespace, motion: Trajectory, margins: list[Margin]) -> dict[str, Any]:
    """`hil excite --json`."""
    rows = [
        {"what": m.what, "used": m.used, "limit": finite(m.limit), "unit": m.unit} for m in margins
    ]
    return {
        "schema": "hil.excite/1", "output": args.output, "motion": motion.name,
        "for": list(motion.purpose), "period_s": motion.period, "margins": rows,
    }  # fmt: skip


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
    values = [
        f"{p.name} = {value:.3g} {p.unit.replace('{x}', unit)}".removesuffix(" 1")
        for p, value in zip(effect.shape, rival.term.shape, strict=True)
    ]
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


def play(args: argparse.Namespace) -> str:
    """How to play the motion."""
    if args.rig.lower().endswith(".urdf"):
        return "The file holds the motion as via points and a Fourier series, in SI units."
    return f"Play it: hil run {args.rig} --trajectory {args.output} -o SESSION.mcap"


def beside(args: argparse.Namespace) -> str:
    """What to do with the session of a motion of one joint."""
    if not args.joint:
        return ""
    return (
        "\nJoints that only hold their place say little: diagnose it together with a session in "
        "which all of them move,\n  hil diagnose FIRST.mcap SESSION.mcap --model M.toml"
    )
