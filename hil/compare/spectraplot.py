"""Spectra of the residual as figures: orders over position, lines and octaves over time."""

from __future__ import annotations

import numpy as np

from hil.compare.material import Material
from hil.compare.plots import AFTER, BAND, BEFORE, embed, grid, line
from hil.compare.spectra import Spectrum, order_spectra, time_spectra

TITLES = {
    "order": "ripple over position",
    "friction-order": "ripple of the friction over position",
    "line": "lines over time",
    "frequency": "by octave of frequency",
}


def spectra_figures(m: Material) -> list[str]:
    """Spectra of the residual before and after, with their bands, joint by joint."""
    out = []
    for j in m.concerned():
        rungs = [m.before, m.after] if len(m.rungs) > 1 else [m.before]
        found = [
            [*order_spectra(r.result, m.last.floor, j), *time_spectra(r.result, m.last.floor, j)]
            for r in rungs
        ]
        if found[0]:
            out.append(_figure(m, j, found))
    return out


def _figure(m: Material, j: int, found: list[list[Spectrum]]) -> str:
    titles = [TITLES[s.feature] for s in found[0]]
    fig = grid(-(-len(titles) // 2), 2, titles, 190)
    names = ("before", "after") if len(found) > 1 else ("model",)
    for k, s in enumerate(found[0]):
        row, column = k // 2 + 1, k % 2 + 1
        fig.add_trace(line(s.x, s.band, "noise band", BAND, width=5, showlegend=k == 0),
                      row=row, col=column)  # fmt: skip
        for own, name, color in zip(found, names, (BEFORE, AFTER), strict=False):
            trace = line(own[k].x, own[k].amplitude, name, color, showlegend=k == 0)
            fig.add_trace(trace, row=row, col=column)
        unit = "Hz" if s.unit == "Hz" else f"periods per {s.unit[2:]}"
        low, high = np.log10([s.x[s.x > 0].min(), s.x.max()])
        ticks = _ticks(float(low), float(high))
        fig.update_xaxes(
            title_text=unit, type="log", range=[low, high], tickmode="array", tickvals=ticks,
            ticktext=[f"{x:g}" for x in ticks], row=row, col=column,
        )  # fmt: skip
        fig.update_yaxes(tickformat="~g", row=row, col=column)
        if column == 1:
            fig.update_yaxes(title_text=f"amplitude [{m.effort_unit(j)}]", row=row, col=column)
    text = (
        f"{m.joints[j]}: spectra of measured minus predicted effort. Grey: what noise alone would "
        "stay below. A peak over position betrays a wheel, a screw or a motor's teeth; a line over "
        "time, something that turns or hums whatever the arm does."
    )
    return embed(fig, f"spectra-{j + 1}", text)


def _ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 of every decade between two powers of ten; every decade alone over many."""
    steps = (1.0, 2.0, 5.0) if high - low < 2.5 else (1.0,)
    decades = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    every = [round(s * 10.0**k, 9) for k in decades for s in steps]
    return [x for x in every if 10**low <= x <= 10**high]
