"""A few seconds of measured and predicted effort, with the residual below."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.compare.material import Material
from hil.compare.plots import AFTER, BAND, BEFORE, MEASURED, embed, grid, line, scatter

FloatArray = NDArray[np.float64]
SECONDS, POINTS = 5.0, 700


def window(weight: FloatArray, run: NDArray[np.int_], length: int) -> slice:
    """Stretch of `length` instants within one run where `weight` is largest.

    Parameters
    ----------
    weight : ndarray (n,)
        What to collect.
    run : ndarray (n,)
        Run of each instant.
    length : int
        Instants wanted; less if no run is that long.
    """
    length = max(2, min(length, int(np.bincount(run).max())))
    total = np.concatenate([[0.0], np.cumsum(weight)])
    gain = total[length:] - total[:-length]
    whole = run[length - 1 :] == run[: run.size - length + 1]
    start = int(np.argmax(np.where(whole, gain, -np.inf)))
    return slice(start, start + length)


def trace_figure(m: Material) -> str:
    """Measured against predicted effort of every joint, before and after, on held-out data."""
    old, new = m.before.heldout, m.after.heldout
    run = old.run if old.run.size else np.zeros(old.effort.shape[1], dtype=int)
    scale = np.maximum(m.floor, 1e-300)[:, None] ** 2
    weight = np.sum(
        (old.residual**2 - (new.residual**2 if len(m.rungs) > 1 else 0)) / scale, axis=0
    )
    part = window(weight, run, int(SECONDS * m.problem.rate))
    step = max(1, (part.stop - part.start) // POINTS)
    part = slice(part.start, part.stop, step)
    titles = [t for joint in m.joints for t in (joint, "")]
    heights = [170.0, 100.0] * len(m.joints)
    fig = grid(2 * len(m.joints), 1, titles, heights, gap=54)
    time = np.arange(part.start, part.stop, step) / m.problem.rate
    time = time - time[0]
    for j in range(len(m.joints)):
        _joint(fig, m, j, part, time)
    fig.update_xaxes(title_text="time [s]", row=2 * len(m.joints), col=1)
    fig.update_xaxes(range=[0, float(time[-1])])
    most = "the models differ most" if len(m.rungs) > 1 else "the model errs most"
    text = (
        f"The stretch of the held-out data where {most}. Per joint: measured and "
        "predicted effort, below it what remains (grey: plus and minus the noise floor's rms)."
    )
    return embed(fig, "traces", text)


def _joint(fig: Any, m: Material, j: int, part: slice, time: FloatArray) -> None:
    old, new = m.before.heldout, m.after.heldout
    top, below, first = 2 * j + 1, 2 * j + 2, j == 0
    put = fig.add_trace
    y = old.effort[j, part]
    put(line(time, y, "measured", MEASURED, width=2.4, showlegend=first), row=top, col=1)
    floor = float(m.floor[j])
    band = scatter(
        x=[0, time[-1], time[-1], 0], y=[floor, floor, -floor, -floor], fill="toself", mode="none",
        fillcolor=BAND, name="noise floor", legendgroup="floor", showlegend=first, hoverinfo="skip",
    )  # fmt: skip
    put(band, row=below, col=1)
    single = len(m.rungs) == 1
    name = f"{'predicted' if single else 'before'} ({m.before.label})"
    cases = [(old, name, BEFORE, "dot")]
    if not single:
        cases.append((new, after_name(m), AFTER, "solid"))
    for held, name, color, dash in cases:
        r = held.residual[j, part]
        put(line(time, y - r, name, color, dash=dash, showlegend=first), row=top, col=1)
        put(line(time, r, name, color, dash=dash, width=1.4, showlegend=False), row=below, col=1)
    unit, axes = m.effort_unit(j), fig.update_yaxes
    fig.update_xaxes(showticklabels=False, ticks="", row=top, col=1)
    axes(title_text=f"effort [{unit}]", row=top, col=1)
    axes(title_text=f"residual [{unit}]", nticks=4, row=below, col=1)


def after_name(m: Material) -> str:
    """Legend of the last model."""
    return f"after ({m.after.label})" if len(m.rungs) == 2 else "after (all effects added)"
