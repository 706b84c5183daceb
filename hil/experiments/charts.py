"""Bars with intervals as SVG, and the numbers that they show: means over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats


@dataclass(frozen=True)
class SeedMean:
    """Mean over seeds, and half width of its 95 % interval by Student's t.

    Parameters
    ----------
    mean, half : float
        `half` is NaN for one seed.
    """

    mean: float
    half: float

    @classmethod
    def of(cls, values: Sequence[float]) -> SeedMean:
        """Mean of values, one a seed."""
        n = len(values)
        if n < 2:
            return cls(float(np.mean(values)), float("nan"))
        half = stats.t.ppf(0.975, n - 1) * np.std(values, ddof=1) / np.sqrt(n)
        return cls(float(np.mean(values)), float(half))

    def __str__(self) -> str:
        """E.g. ``0.041 +- 0.001``; as many digits as the interval, or four where there is none."""
        if not np.isfinite(self.mean):
            return "-"
        if not (np.isfinite(self.half) and self.half > 1e-4 * abs(self.mean)):
            return f"{self.mean:.4g}"
        digits = int(np.clip(1 - np.floor(np.log10(self.half)), 0, 6))
        return f"{self.mean:.{digits}f} +- {self.half:.{digits}f}"


COLOURS = ("#c2c8d0", "#6f9bd1", "#1f5fa8", "#e0a458", "#8a4f7d")
_WIDE, _HIGH, _LEFT, _TOP, _LINE = 900, 340, 60, 40, 15


def bars(title: str, series: Sequence[str], groups: Mapping[str, Sequence[SeedMean]]) -> str:
    """Bar chart as SVG.

    Parameters
    ----------
    title : str
        What is shown, with its unit.
    series : sequence of str
        Names of the bars of a group.
    groups : mapping of str to sequence of SeedMean
        A value for each bar, by the name of the group.
    """
    tops = [s.mean + (s.half if s.half == s.half else 0.0) for g in groups.values() for s in g]
    most = max([t for t in tops if t == t], default=1.0) * 1.05 or 1.0
    step = (_WIDE - _LEFT - 20) / len(groups)
    names = {name: _wrapped(name, step) for name in groups}
    below = _HIGH + 20 + _LINE * max(map(len, names.values()))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDE} {below + 40}" '
        'font-family="sans-serif" font-size="13">',
        f'<path d="M0 0H{_WIDE}V{below + 40}H0z" fill="#fff"/>',
        f'<text x="{_LEFT}" y="20">{_safe(title)}</text>',
        *_grid(most),
    ]
    for i, (name, values) in enumerate(groups.items()):
        w = (step - 24) / len(series)
        for k, s in enumerate(values):
            parts += _bar(_LEFT + step * i + 12 + k * w, w - 4, s, most, COLOURS[k % len(COLOURS)])
        for k, line in enumerate(names[name]):
            x, y = _LEFT + step * (i + 0.5), _HIGH + 20 + _LINE * k
            parts.append(f'<text x="{x:.1f}" y="{y}" text-anchor="middle">{_safe(line)}</text>')
    x = float(_LEFT)
    for k, name in enumerate(series):
        colour = COLOURS[k % len(COLOURS)]
        parts.append(f'<rect x="{x:.0f}" y="{below + 8}" width="14" height="14" fill="{colour}"/>')
        parts.append(f'<text x="{x + 20:.0f}" y="{below + 20}">{_safe(name)}</text>')
        x += 50 + 7.5 * len(name)
    return "\n".join([*parts, "</svg>", ""])


def _grid(most: float) -> list[str]:
    steps = [d * 10.0**k for k in range(-6, 7) for d in (1, 2, 5)]
    tick = next(x for x in steps if most / x <= 6)
    out = []
    for value in np.arange(0.0, most, tick):
        y = _TOP + (_HIGH - _TOP) * (1 - value / most)
        out.append(
            f'<line x1="{_LEFT}" x2="{_WIDE - 10}" y1="{y:.0f}" y2="{y:.0f}" stroke="#ddd"/>'
        )
        out.append(f'<text x="{_LEFT - 8}" y="{y + 4:.0f}" text-anchor="end">{value:.3g}</text>')
    return out


def _bar(x: float, wide: float, s: SeedMean, most: float, colour: str) -> list[str]:
    if not np.isfinite(s.mean):
        return []
    h = (_HIGH - _TOP) * max(s.mean, 0.0) / most
    out = [
        f'<rect x="{x:.1f}" y="{_HIGH - h:.1f}" width="{wide:.1f}" height="{h:.1f}" '
        f'fill="{colour}"/>'
    ]
    if s.half == s.half:
        e, c = (_HIGH - _TOP) * s.half / most, x + wide / 2
        out.append(
            f'<line x1="{c:.1f}" x2="{c:.1f}" y1="{max(_HIGH - h - e, _TOP):.1f}" '
            f'y2="{min(_HIGH - h + e, _HIGH):.1f}" stroke="#222"/>'
        )
    return out


def _wrapped(name: str, step: float) -> list[str]:
    """A name in lines that fit its group."""
    lines = [""]
    for word in name.split():
        longer = f"{lines[-1]} {word}".strip()
        if len(longer) * 7.0 > step and lines[-1]:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _safe(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
