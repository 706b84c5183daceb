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
        fig.update_xaxes(title_text=unit, type="log", range=[low, high], row=row, col=column)
        if column == 1:
            fig.update_yaxes(title_text=f"amplitude [{m.effort_unit(j)}]", row=row, col=column)
    text = (
        f"{m.joints[j]}: spectra of measured minus predicted effort. Grey: what noise alone would "
        "stay below. A peak over position betrays a wheel, a screw or a motor's teeth; a line over "
        "time, something that turns or hums whatever the arm does."
    )
    return embed(fig, f"spectra-{j + 1}", text)
