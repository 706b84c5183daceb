"""The candidates: how much of the residual each explains, and which were detected."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.compare.candidate import Candidate
from hil.compare.detect import LEVEL
from hil.compare.material import Material
from hil.compare.page import escape, number, table
from hil.compare.plots import AFTER, FLOOR, bar, embed, grid, scatter

CANDIDATES = 14


def top_candidates(m: Material) -> list[Candidate]:
    """The candidates worth listing: the best by score, accepted ones always."""
    ranked = [c for c in m.first.candidates if c.absorbed < 1 - 1e-6]
    named = {(f.effect, f.joint) for f in (*m.findings, *m.partial)}
    chosen = ranked[:CANDIDATES]
    return chosen + [c for c in ranked[CANDIDATES:] if (c.name, place(m, c)) in named]


def place(m: Material, c: Candidate) -> str | None:
    """Joint of a candidate, None for one of the whole robot."""
    whole = c.term.effect.of_robot
    return None if whole else m.joints[c.term.joint]


def explained(m: Material, c: Candidate) -> float:
    """Share of the joint's squared residual that a candidate takes away beside the first model."""
    result, j = m.before.result, c.joint
    power = float(c.parts[j]) * float(result.sigma[j]) ** 2 / m.problem.count[j]
    return float(np.clip(power / max(float(result.rms[j]) ** 2, 1e-300), 0.0, 1.0))


def candidates_figure(m: Material) -> str:
    """Share of the squared residual that each candidate explains, and what there is to explain."""
    chosen = top_candidates(m)
    if not chosen:
        return ""
    labels = [escape(f"{c.name} on {place(m, c)}" if place(m, c) else c.name) for c in chosen]
    fig = grid(1, 1, [""], 25.0 * len(chosen) + 20)
    _share_bars(fig, m, chosen, labels)
    ratio = m.floor / np.maximum(m.before.result.rms, 1e-300)
    whole = [100 * max(0.0, 1 - float(ratio[c.joint]) ** 2) for c in chosen]
    mark = {"symbol": "diamond", "size": 9, "color": FLOOR}
    name = "all that is above the noise floor of the joint"
    fig.add_trace(scatter(x=whole, y=labels, mode="markers", marker=mark, name=name))
    order: dict[str, Any] = {"categoryorder": "array", "categoryarray": labels[::-1]}
    fig.update_yaxes(**order, tickmode="array", tickvals=labels, showgrid=False)
    fig.update_xaxes(title_text="share of the joint's squared residual [%]", range=[0, 112])
    fig.update_layout(margin={"l": 270}, barmode="overlay", legend_traceorder="normal")
    text = (
        "Each candidate was tried alone beside the first model, its coefficients fitted jointly "
        "with all others. A bar that reaches its diamond explains all that is not noise; a full "
        "refit, with the speeds and lengths inside the first model's own laws, may explain more. "
        "Best first, by evidence after the price of the parameters."
    )
    return embed(fig, "candidates", text)


def _share_bars(fig: Any, m: Material, chosen: list[Candidate], labels: list[str]) -> None:
    share = 100 * np.array([explained(m, c) for c in chosen])
    seen = np.array([c.p_value <= LEVEL and c.score > 0 for c in chosen])
    kinds = (
        (seen, "detected (above noise)", AFTER),
        (~seen, "not detected", "#bdbdbd"),
    )
    for which, name, color in kinds:
        text = [f"{x:.0f} %" if x >= 0.95 else f"{x:.1f} %" for x in share[which]]
        spot = ["inside" if x > 15 else "outside" for x in share[which]]
        bars = bar(
            x=share[which], y=np.array(labels)[which], orientation="h", name=name,
            marker_color=color, text=text, textposition=spot, cliponaxis=False,
        )  # fmt: skip
        fig.add_trace(bars)


def candidates_table(m: Material) -> str:
    """The same in numbers; accepted effects set off."""
    chosen = top_candidates(m)
    named = {(f.effect, f.joint) for f in (*m.findings, *m.partial)}
    strong = [k for k, c in enumerate(chosen) if (c.name, place(m, c)) in named]
    rows = [
        [
            c.name, place(m, c) or "whole robot", f"{100 * explained(m, c):.1f} %",
            number(c.chi2, 4), number(c.price), number(c.score, 4), number(c.p_value, 2),
            f"{100 * c.absorbed:.1f} %",
        ]
        for c in chosen
    ]  # fmt: skip
    head = ["effect", "joint", "explains", "chi2", "price", "score", "detection p", "absorbed"]
    return table(head, rows, (0, 1), strong) if rows else ""
