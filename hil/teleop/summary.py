"""What is worth knowing of a design before it runs: figures of merit of one axis, and plots.

The plots show H (Bode), regions of stability, and the width of transmitted impedance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hil.teleop import architecture, force_sensor_free, hybrid, passivity
from hil.teleop.architecture import IDEAL
from hil.teleop.gate import Margins, axis_margins
from hil.teleop.hybrid import FREE_MOTION, GRID, FloatArray, Impedance
from hil.teleop.sampled_loop import SampledLoop

#: Band over which the sensitivity is averaged, and up to which tracking counts [Hz].
_BAND, _TRACKING = (0.2, 5.0), 1.0
#: Largest environment of the bounded test: stiffness [N/m], damping [N s/m].
_LARGEST = Impedance(0.0, 6.0, 1500.0)


@dataclass(frozen=True)
class DesignSummary:
    """Figures of merit of one axis, with filters and delays.

    Parameters
    ----------
    axis, name : str
        Axis and design.
    missed : tuple of str
        Conditions of transparency that fail, with what they should be.
    sensitivity, sensitivity_dc : float
        Weighted rms of abs(dz_t/dz_e) / (kp kf) over 0.2 to 5 Hz about the environment, and its
        value at rest; transparent = 1, as f_m = kf f_s and v_s = kp v_m make z_t = kp kf z_e.
    tracking_free, tracking_contact : float
        Largest abs(1 - v_s / (kp v_m)) to 1 Hz in free space and against the environment.
    width : float
        Smallest width of transmitted impedance over 0.2 to 5 Hz [N s/m].
    llewellyn, passive : float
        Smallest margin of absolute stability, smallest eigenvalue of passivity, over 0.016 to 320 Hz.
    bounded : float
        Smallest Re z_t over passive environments up to 1500 N/m and 6 N s/m [N s/m].
    D, kappa : float
        Distance to the force estimation singularity: 0, infinite at it.
    fsf_smallest, fsf_bound : float
        Loop gain of the force-sensor-free form, and what sampling demands of it.
    margins : Margins
        Stability with the declared operators and environments.
    """  # noqa: E501

    axis: str
    name: str
    missed: tuple[str, ...]
    sensitivity: float
    sensitivity_dc: float
    tracking_free: float
    tracking_contact: float
    width: float
    llewellyn: float
    passive: float
    bounded: float
    D: float
    kappa: float
    fsf_smallest: float
    fsf_bound: float
    margins: Margins


def weighted(values: Any, w: FloatArray, weight: float = 0.0) -> float:
    """Root of the weighted mean square of `values` (n,) over w [rad/s], trapezoidal.

    Parameters
    ----------
    weight : float
        Exponent n of the weight w^n: 0 counts every hertz alike, -1 every octave.
    """
    size = w**weight
    square = np.abs(np.asarray(values)) ** 2 * size
    return float(np.sqrt(np.trapezoid(square, w) / np.trapezoid(size, w)))


def band(points: int = 60) -> FloatArray:
    """Frequencies of the sensitivity [rad/s], both ends of the band included."""
    return 2 * np.pi * np.geomspace(*_BAND, points)


def tracking(h: Any, ze: Any, scale: float) -> FloatArray:
    """|1 - v_s / (kp v_m)| with v_s/v_m = -h21 / (1 + h22 z_e), (n,)."""
    ratio = -h[..., 1, 0] / (1 + h[..., 1, 1] * ze)
    out: FloatArray = np.abs(1 - ratio / scale)
    return out


def summarise(loop: SampledLoop, period: float, weight: float = 0.0) -> DesignSummary:
    """Figures of merit of one axis.

    Parameters
    ----------
    loop : Loop
        The axis.
    period : float
        Of the loop [s].
    weight : float
        Of the sensitivity, see `weighted`.
    """
    d, ze = loop.design, next((z for z in loop.environments if z != FREE_MOTION), hybrid.GEL)
    goal = d.motion_scale * d.force_scale
    w, slow = band(), 2 * np.pi * np.geomspace(0.02, _TRACKING, 40)
    wide, near, far = (hybrid.hybrid(d, hybrid.jw(x), loop.real) for x in (GRID, w, slow))
    sampled = force_sensor_free.sampled_condition(d, loop.real.acceleration_hz, period)
    still = hybrid.hybrid(d, np.array([1e-4j]), loop.real)
    gap = tracking(far, ze(hybrid.jw(slow)), d.motion_scale)
    return DesignSummary(
        loop.axis,
        d.name,
        tuple(c.text for c in architecture.conditions(d) if not c.holds),
        weighted(hybrid.sensitivity(near, ze(hybrid.jw(w))), w, weight) / goal,
        float(abs(hybrid.sensitivity(still, ze(np.array([1e-4j])))[0])) / goal,
        float(tracking(far, 0.0, d.motion_scale).max()),
        float(gap.max()),
        float(hybrid.impedance_width(near, w, _LARGEST).min()),
        float(passivity.llewellyn(wide).min()),
        float(passivity.is_passive(wide).min()),
        float(passivity.half_disc(wide, np.abs(_LARGEST(hybrid.jw(GRID)))).min()),
        d.D,
        force_sensor_free.conditioning(d),
        sampled.smallest,
        sampled.bound,
        axis_margins(loop, period),
    )


_COLORS = ("#0072B2", "#D55E00", "#009E73")
_ENTRIES = ("h11 [N s/m]", "h12", "h21", "h22 [m/(N s)]")
_HZ = GRID / (2 * np.pi)


def _figure(rows: int, cols: int, titles: tuple[str, ...], height: int) -> Any:
    figure = make_subplots(rows, cols, subplot_titles=titles, horizontal_spacing=0.09)
    figure.update_layout(
        template="plotly_white", height=height, margin={"l": 60, "r": 20, "t": 50, "b": 45}
    )
    return figure


def bode_plot(loops: list[SampledLoop]) -> Any:
    """Magnitude and phase of h11..h22: ideal dashed, with filters and delays solid."""
    figure = _figure(2, 4, _ENTRIES, 520)
    for loop, color in zip(loops, _COLORS, strict=False):
        for real, dash in ((IDEAL, "dash"), (loop.real, "solid")):
            h = hybrid.hybrid(loop.design, hybrid.jw(), real).reshape(-1, 4)
            for k in range(4):
                line = {"color": color, "dash": dash, "width": 1.6}
                size, angle = np.abs(h[:, k]), np.unwrap(np.angle(h[:, k])) * 180 / np.pi
                name = f"{loop.axis or 'axis'} {'as it runs' if dash == 'solid' else 'ideal'}"
                shown = k == 0
                for row, values in ((1, 20 * np.log10(np.maximum(size, 1e-9))), (2, angle)):
                    figure.add_trace(
                        go.Scatter(
                            x=_HZ,
                            y=values,
                            line=line,
                            name=name,
                            legendgroup=name,
                            showlegend=shown and row == 1,
                        ),
                        row,
                        k + 1,
                    )
    figure.update_xaxes(type="log")
    figure.update_xaxes(title_text="Hz", row=2)
    figure.update_yaxes(title_text="dB", row=1, col=1)
    figure.update_yaxes(title_text="degrees", row=2, col=1)
    return figure


def stability_plot(loops: list[SampledLoop]) -> Any:
    """Margins over frequency: passivity, Llewellyn, and radius mu of admissible environments."""
    titles = ("absolute stability", "passivity (min eigenvalue)", "mu: admissible reflection")
    figure = _figure(1, 3, titles, 330)
    for loop, color in zip(loops, _COLORS, strict=False):
        h = hybrid.hybrid(loop.design, hybrid.jw(), loop.real)
        rows = (passivity.llewellyn(h), passivity.is_passive(h), passivity.mu(h, 20.0))
        for col, values in enumerate(rows, 1):
            figure.add_trace(
                go.Scatter(
                    x=_HZ,
                    y=np.clip(values, -5, 5),
                    line={"color": color},
                    name=loop.axis or "axis",
                    showlegend=col == 1,
                ),
                1,
                col,
            )
    figure.update_xaxes(type="log", title_text="Hz")
    for col, limit in ((1, 0.0), (2, 0.0), (3, 1.0)):
        figure.add_hline(y=limit, line={"dash": "dash", "color": "#888"}, row=1, col=col)
    return figure


def region_plot(
    loop: SampledLoop, hz: tuple[float, ...] = (0.5, 2.0, 10.0), b: float = 20.0
) -> Any:
    """Stability circles in the plane of the environment's reflection (z_e - b) / (z_e + b)."""
    figure = _figure(1, 1, ("environments that are stable with every passive operator",), 460)
    angle = np.linspace(0, 2 * np.pi, 181)
    figure.add_trace(
        go.Scatter(
            x=np.cos(angle),
            y=np.sin(angle),
            line={"color": "#444", "dash": "dot"},
            name="passive environments (inside)",
        )
    )
    h = hybrid.hybrid(loop.design, hybrid.jw(2 * np.pi * np.array(hz)), loop.real)
    centre, radius, outside = passivity.stability_circle(h, b)
    for k, f in enumerate(hz):
        where = "outside" if outside[k] else "inside"
        figure.add_trace(
            go.Scatter(
                x=centre[k].real + radius[k] * np.cos(angle),
                y=centre[k].imag + radius[k] * np.sin(angle),
                name=f"{f:g} Hz: stable {where}",
            )
        )
    figure.update_xaxes(range=[-3, 3], title_text="real part")
    figure.update_yaxes(range=[-2, 2], scaleanchor="x", title_text="imaginary part")
    return figure


def impedance_plot(loops: list[SampledLoop]) -> Any:
    """Transmitted impedance in free space and against the stiffest world: its width."""
    figure = _figure(1, 1, ("transmitted impedance: free, gel, stiffest",), 360)
    for loop, color in zip(loops, _COLORS, strict=False):
        h = hybrid.hybrid(loop.design, hybrid.jw(), loop.real)
        for ze, dash, said in (
            (hybrid.FREE_MOTION, "dot", "free"),
            (next(z for z in loop.environments if z != FREE_MOTION), "solid", "gel"),
            (_LARGEST, "dash", "stiffest"),
        ):
            size = np.abs(hybrid.transmitted(h, ze(hybrid.jw())))
            figure.add_trace(
                go.Scatter(
                    x=_HZ,
                    y=np.maximum(size, 1e-6),
                    line={"color": color, "dash": dash},
                    name=f"{loop.axis or 'axis'} {said}",
                )
            )
    figure.update_xaxes(type="log", title_text="Hz")
    figure.update_yaxes(type="log", title_text="N s/m")
    return figure
