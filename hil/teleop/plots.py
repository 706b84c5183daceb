"""Figures of a design: Bode plots of H, regions of stability, width of transmitted impedance."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hil.teleop import hybrid, passivity
from hil.teleop.axis import Loop
from hil.teleop.design import IDEAL
from hil.teleop.hybrid import GRID
from hil.teleop.summary import LARGEST

COLORS = ("#0072B2", "#D55E00", "#009E73")
NAMES = ("h11 [N s/m]", "h12", "h21", "h22 [m/(N s)]")
HZ = GRID / (2 * np.pi)


def _figure(rows: int, cols: int, titles: tuple[str, ...], height: int) -> Any:
    figure = make_subplots(rows, cols, subplot_titles=titles, horizontal_spacing=0.09)
    figure.update_layout(
        template="plotly_white", height=height, margin={"l": 60, "r": 20, "t": 50, "b": 45}
    )
    return figure


def bode(loops: list[Loop]) -> Any:
    """Magnitude and phase of h11..h22: ideal dashed, with filters and delays solid."""
    figure = _figure(2, 4, NAMES, 520)
    for loop, color in zip(loops, COLORS, strict=False):
        for real, dash in ((IDEAL, "dash"), (loop.real, "solid")):
            h = hybrid.hybrid(loop.design, hybrid.jw(), real).reshape(-1, 4)
            for k in range(4):
                line = {"color": color, "dash": dash, "width": 1.6}
                size, angle = np.abs(h[:, k]), np.unwrap(np.angle(h[:, k])) * 180 / np.pi
                name = f"{loop.axis or 'axis'} {'as it runs' if dash == 'solid' else 'ideal'}"
                shown = k == 0
                for row, values in ((1, 20 * np.log10(np.maximum(size, 1e-9))), (2, angle)):
                    figure.add_trace(
                        go.Scatter(x=HZ, y=values, line=line, name=name, legendgroup=name,
                                   showlegend=shown and row == 1), row, k + 1,
                    )  # fmt: skip
    figure.update_xaxes(type="log")
    figure.update_xaxes(title_text="Hz", row=2)
    figure.update_yaxes(title_text="dB", row=1, col=1)
    figure.update_yaxes(title_text="degrees", row=2, col=1)
    return figure


def stability(loops: list[Loop]) -> Any:
    """Margins over frequency: passivity, Llewellyn, and radius mu of admissible environments."""
    titles = ("absolute stability", "passivity (min eigenvalue)", "mu: admissible reflection")
    figure = _figure(1, 3, titles, 330)
    for loop, color in zip(loops, COLORS, strict=False):
        h = hybrid.hybrid(loop.design, hybrid.jw(), loop.real)
        rows = (passivity.llewellyn(h), passivity.passive(h), passivity.mu(h, 20.0))
        for col, values in enumerate(rows, 1):
            figure.add_trace(
                go.Scatter(x=HZ, y=np.clip(values, -5, 5), line={"color": color},
                           name=loop.axis or "axis", showlegend=col == 1), 1, col,
            )  # fmt: skip
    figure.update_xaxes(type="log", title_text="Hz")
    for col, limit in ((1, 0.0), (2, 0.0), (3, 1.0)):
        figure.add_hline(y=limit, line={"dash": "dash", "color": "#888"}, row=1, col=col)
    return figure


def region(loop: Loop, hz: tuple[float, ...] = (0.5, 2.0, 10.0), b: float = 20.0) -> Any:
    """Stability circles in the plane of the environment's reflection (z_e - b) / (z_e + b)."""
    figure = _figure(1, 1, ("environments that are stable with every passive operator",), 460)
    angle = np.linspace(0, 2 * np.pi, 181)
    figure.add_trace(go.Scatter(
        x=np.cos(angle), y=np.sin(angle), line={"color": "#444", "dash": "dot"},
        name="passive environments (inside)",
    ))  # fmt: skip
    h = hybrid.hybrid(loop.design, hybrid.jw(2 * np.pi * np.array(hz)), loop.real)
    centre, radius, outside = passivity.stability_circle(h, b)
    for k, f in enumerate(hz):
        where = "outside" if outside[k] else "inside"
        figure.add_trace(go.Scatter(
            x=centre[k].real + radius[k] * np.cos(angle),
            y=centre[k].imag + radius[k] * np.sin(angle),
            name=f"{f:g} Hz: stable {where}",
        ))  # fmt: skip
    figure.update_xaxes(range=[-3, 3], title_text="real part")
    figure.update_yaxes(range=[-2, 2], scaleanchor="x", title_text="imaginary part")
    return figure


def impedance(loops: list[Loop]) -> Any:
    """Transmitted impedance in free space and against the stiffest world: its width."""
    figure = _figure(1, 1, ("transmitted impedance: free, gel, stiffest",), 360)
    for loop, color in zip(loops, COLORS, strict=False):
        h = hybrid.hybrid(loop.design, hybrid.jw(), loop.real)
        for ze, dash, said in (
            (hybrid.FREE, "dot", "free"), (loop.environments[-1], "solid", "gel"),
            (LARGEST, "dash", "stiffest"),
        ):  # fmt: skip
            size = np.abs(hybrid.transmitted(h, ze(hybrid.jw())))
            figure.add_trace(go.Scatter(
                x=HZ, y=np.maximum(size, 1e-6), line={"color": color, "dash": dash},
                name=f"{loop.axis or 'axis'} {said}",
            ))  # fmt: skip
    figure.update_xaxes(type="log", title_text="Hz")
    figure.update_yaxes(type="log", title_text="N s/m")
    return figure
