"""Why a design is not better: the constraints and bounds that bind, each with its price."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil.teleop.hybrid import FloatArray
from hil.teleop.problem import ORDER
from hil.teleop.search import MARGIN, Search

#: A constraint is active within this slack (each is scaled to about 1).
ACTIVE = 2e-3


@dataclass(frozen=True)
class Active:
    """A constraint that stops the design from being better.

    Parameters
    ----------
    name, text : str
        What it is, and what it says here.
    price : float
        Estimated gain of sensitivity per unit of (scaled) relaxation.
    """

    name: str
    text: str
    price: float


def active(search: Search, x: FloatArray) -> tuple[Active, ...]:
    """Constraints and bounds that bind, with their prices from the stationarity conditions."""
    slack = {n: v for n, v in search.constraints(x).items() if v.min() < ACTIVE}
    rows: list[tuple[str, str, FloatArray]] = []
    for name in slack:
        rows.append((name, _reason(search, x, name), _gradient(search, x, name)))
    for i, name in enumerate(ORDER):
        edge = np.eye(8)[i]
        if x[i] > 1 - ACTIVE:
            rows.append((f"{name} upper", f"{name} at its bound {search.top[i]:.4g}", -edge))
        elif x[i] < ACTIVE:
            rows.append((f"{name} lower", f"{name} at 0: its sign is fixed", edge))
    if not rows:
        return ()
    # grad sigma + sum price grad g = 0
    uphill = _slope(search.sensitivity, x)
    prices = np.linalg.lstsq(np.stack([r[2] for r in rows], 1), -uphill, rcond=None)[0]
    out = [Active(n, t, float(p)) for (n, t, _), p in zip(rows, prices, strict=True)]
    return tuple(sorted(out, key=lambda a: -a.price))


def _reason(search: Search, x: FloatArray, name: str) -> str:
    p, values = search.p, search.constraints(x)[name]
    at = int(values.argmin())
    hz = (search.slow if "tracking" in name else search.wide) / (2 * np.pi)
    return {
        "free tracking": f"free tracking error reaches {p.free:g} at {hz[at % 8]:.2g} Hz",
        "contact tracking": f"contact tracking error reaches {p.contact:g} at {hz[at % 8]:.2g} Hz",
        "stability": f"Re z_t reaches {MARGIN:g} N s/m at {hz[at % hz.size]:.3g} Hz",
        "poles": "the slowest pole reaches -0.5 rad/s",
        "fsf": f"the condition of Q reaches {p.kappa:g}: estimation singularity",
    }[name]


def _gradient(search: Search, x: FloatArray, name: str) -> FloatArray:
    at = int(search.constraints(x)[name].argmin())
    return _slope(lambda v: float(search.constraints(v)[name][at]), x)


def _slope(f: Callable[[FloatArray], float], x: FloatArray) -> FloatArray:
    """Gradient by differences that stay within the bounds, (8,)."""
    step = 1e-5
    ahead, behind = np.minimum(x + step, 1.0), np.maximum(x - step, 0.0)
    out = np.empty(8)
    for i in range(8):
        up, down = x.copy(), x.copy()
        up[i], down[i] = ahead[i], behind[i]
        out[i] = (f(up) - f(down)) / (ahead[i] - behind[i])
    return out
