"""What `hil design` says: tables for people, a page with plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from plotly.io import to_html

from hil.commands import common
from hil.report import elements as html
from hil.teleop import summary
from hil.teleop.architecture import FORCE, MOTION, Design
from hil.teleop.optimise import Found
from hil.teleop.sampled_loop import Loop
from hil.teleop.summary import Summary

TITLE = "Design of a teleoperation controller"
#: Figure of merit -> format, unit and what it should be.
ROWS = (
    ("sensitivity", "dz_t/dz_e, rms 0.2-5 Hz", "1 = transparent"),
    ("sensitivity_dc", "dz_t/dz_e at rest", ""),
    ("tracking_free", "tracking error to 1 Hz, free", "0"),
    ("tracking_contact", "tracking error to 1 Hz, contact", "0"),
    ("width", "width of impedance [N s/m]", "large"),
    ("llewellyn", "absolute stability margin", ">= 0"),
    ("passive", "passivity, min eigenvalue", ">= 0"),
    ("bounded", "min Re z_t, bounded world [N s/m]", ">= 0"),
    ("D", "D = -det Q", "far from 0"),
    ("kappa", "conditioning of Q", "<= 3, at most 9"),
    ("fsf_smallest", "force-free loop gain", "above the next"),
    ("fsf_bound", "its sampled bound", ""),
)
MARGINS = (
    ("pole", "rightmost pole of all pairs [rad/s]", "< 0; 0 = drifts freely"),
    ("radius", "sampled eigenvalue", "condition: <= 1"),
    ("delay_s", "round-trip delay margin [s]", "more than there is"),
)
#: Which rows decide; see `hil.teleop.sampled_loop`.
DECIDES = (
    "conditions: gains that can be realised, and the sampled eigenvalue with every declared "
    "operator and environment;\n  the other rows are goals and may be missed"
)


def text(loops: Sequence[Loop], found: Sequence[Summary], trouble: str) -> str:
    """Everything for a terminal."""
    head = ["", *(f"axis {loop.axis}" for loop in loops)]
    lines = [f"design {found[0].name}", "", common.table(head, gains(loops)), ""]
    lines.append(common.table([*head, "goal"], merits(found)))
    told = missed(found)
    lines += ["", f"  {DECIDES}", "  transparent: " + ("yes" if not told else "no")]
    lines += [f"    {m}" for m in told]
    lines.append(f"  decisive pair: {found[0].margins.pair}")
    lines.append(f"  REFUSED: {trouble}" if trouble else "  may run: both conditions are met")
    return "\n".join(lines)


def missed(found: Sequence[Summary]) -> list[str]:
    """Missed conditions of transparency, each once with the axes that miss it."""
    axes: dict[str, list[str]] = {}
    for s in found:
        for condition in s.missed:
            axes.setdefault(condition, []).append(s.axis)
    return [f"axis {', '.join(names)}: {condition}" for condition, names in axes.items()]


def gains(loops: Sequence[Loop]) -> list[list[str]]:
    """Rows of gains, one column an axis."""
    designs = [loop.design for loop in loops]
    rows = []
    for name in sorted((*MOTION, *FORCE)):
        rows.append([f"{name}{' (k, b, a)' if name in MOTION else ''}", *_cells(designs, name)])
    for role in ("master", "slave"):
        rows.append([f"{role} mass [kg]", *(f"{getattr(d, role).m:.4g}" for d in designs)])
    return rows


def _cells(designs: Sequence[Design], name: str) -> list[str]:
    values = [getattr(d, name) for d in designs]
    if name in FORCE:
        return [f"{v:.4g}" for v in values]
    return [f"{v.k:.4g}, {v.b:.4g}, {v.a:.4g}" for v in values]


def merits(found: Sequence[Summary]) -> list[list[str]]:
    """Rows of figures of merit."""
    rows = [[said, *(_number(getattr(s, k)) for s in found), goal] for k, said, goal in ROWS]
    for k, said, goal in MARGINS:
        rows.append([said, *(_number(getattr(s.margins, k)) for s in found), goal])
    return rows


def _number(x: float) -> str:
    if x == 0.0 or abs(x) < 1e-9:
        return "0"
    if math.isinf(x):
        return "infinite" if x > 0.0 else "-infinite"
    return f"{x:.5g}" if 0.99 < x < 1.01 else f"{x:.3g}"


def reasons(found: Sequence[Found]) -> list[str]:
    """Why each optimised axis is not more sensitive: its active constraints."""
    lines = []
    for axis, f in zip("xyz", found, strict=True):
        lines.append(f"axis {axis}: sensitivity {f.sensitivity:.3f}, held back by (price)")
        lines += [f"  {a.text} ({a.price:.2g})" for a in f.active if a.price > 1e-3]
    return lines


def page(loops: Sequence[Loop], found: Sequence[Summary], trouble: str) -> str:
    """Page with the plots."""
    head = ["", *(f"axis {loop.axis}" for loop in loops)]
    axes = list(loops)
    figures = (
        (
            summary.bode_plot(axes),
            "bode",
            "Hybrid matrix; transparent is h11 = h22 = 0, h12 = 1, "
            "h21 = -1. Dashed: ideal; solid: with filters and delays.",
        ),
        (
            summary.impedance_plot(axes),
            "width",
            "What the operator feels: the width between free "
            "and stiffest is all that can be told apart.",
        ),
        (
            summary.stability_plot(axes),
            "margins",
            "Above the dashed lines: stable with every "
            "passive operator and environment; passive; all reflections admissible.",
        ),
        (
            summary.region_plot(axes[0]),
            "region",
            f"Axis {axes[0].axis}: stability circles, reference 20 N s/m.",
        ),
    )
    body = f"<h1>{TITLE}</h1>" + html.warnings([trouble] if trouble else [])
    body += html.section("Gains", html.table(head, gains(loops)))
    body += html.section("Figures of merit", html.table([*head, "goal"], merits(found)))
    body += html.section("Plots", *(embed(f, name, said) for f, name, said in figures))
    return html.document(TITLE, body)


def embed(figure: Any, name: str, caption: str) -> str:
    """HTML of a figure with its caption; the page holds plotly's script."""
    inner = to_html(
        figure, config={"displaylogo": False}, include_plotlyjs=False, full_html=False, div_id=name
    )
    return f"<figure><figcaption>{html.escape(caption)}</figcaption>{inner}</figure>"


def finite(value: Any) -> Any:
    """`value` with null in place of what JSON cannot hold."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
