"""What `hil excite` prints: JSON, the menu, margins, and how to play the motion."""

from __future__ import annotations

import argparse
import math
from typing import Any

from hil.commands import common
from hil.excite.choose import Choice
from hil.excite.margins import Margin
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
