"""What must not run: improper gains, an unstable loop, a delay beyond the margin.

Checked before a motor moves; a refusal names the condition, its margin and the way out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from hil.errors import ConfigError
from hil.teleop import hybrid, sampled
from hil.teleop.axis import Loop
from hil.teleop.design import MOTION
from hil.teleop.hybrid import Impedance

__all__ = ["Loop", "Margins", "margins", "proper", "refuse"]
#: Beyond this per period a mode grows; a free position is a mode of exactly 1.
GROWTH = 1e-7
#: From here on a growing mode is put down to the cable [Hz].
CABLE = 80.0


@dataclass(frozen=True)
class Margins:
    """Margins of one axis over all pairs of operator and environment.

    Parameters
    ----------
    axis : str
        Which.
    pole : float
        Largest real part of the continuous closed-loop poles [rad/s].
    radius : float
        Largest magnitude of the sampled closed-loop eigenvalues.
    delay_s : float
        Additional round-trip delay that the continuous loop bears [s].
    pair : str
        Operator and environment with the largest `radius`.
    """

    axis: str
    pole: float
    radius: float
    delay_s: float
    pair: str


def proper(loop: Loop) -> None:
    """Refuse gains that cannot be realised or cannot hold a slave.

    Raises
    ------
    ConfigError
        Naming the gain.
    """
    d, where = loop.design, f"axis {loop.axis or '-'}"
    for name in MOTION:
        term = getattr(d, name)
        if not np.isfinite([term.k, term.b, term.a]).all():
            raise ConfigError(f"{where}: {name} has a gain that is not a finite number")
        if term.a and loop.real.acceleration_hz == 0.0:
            raise ConfigError(
                f"{where}: {name} has an acceleration term ({term.a:.3g} kg) without a filter, an "
                "improper gain; set acceleration_hz (30, say)"
            )
    for name in ("c2", "c3", "c5", "c6"):
        value = getattr(d, name)
        if not np.isfinite(value) or (name in ("c5", "c6") and value < -1.0):
            raise ConfigError(f"{where}: {name} = {value:.4g} is improper; c5, c6 >= -1 is needed")
    if d.c7.k < 0.0 or d.c7.b < 0.0:
        raise ConfigError(
            f"{where}: c7 = ({d.c7.k:.4g}, {d.c7.b:.4g}) pushes the slave away from its place; "
            "its stiffness and damping must not be negative"
        )


def margins(loop: Loop, period: float) -> Margins:
    """Margins of one axis."""
    rows = []
    for zh, ze in _pairs(loop):
        found = hybrid.poles(loop.design, zh, ze, loop.real)
        rows.append((
            float(found.real.max(initial=-np.inf)),
            sampled.radius(loop, zh, ze, period),
            hybrid.delay_margin(loop.design, zh, ze, loop.real),
            _said(zh, ze),
        ))  # fmt: skip
    worst = max(rows, key=lambda r: r[1])
    return Margins(loop.axis, max(r[0] for r in rows), worst[1], min(r[2] for r in rows), worst[3])


def refuse(loops: Iterable[Loop], period: float) -> None:
    """Refuse a controller that must not run.

    Parameters
    ----------
    loops : iterable of Loop
        Its axes; axes that are equal but for their name are checked once.
    period : float
        Of the loop [s].

    Raises
    ------
    ConfigError
        Naming axis, condition and margin.
    """
    seen = set()
    for loop in loops:
        same = replace(loop, axis="")
        if same in seen:
            continue
        seen.add(same)
        proper(loop)
        for zh, ze in _pairs(loop):
            _stable(loop, zh, ze, period)


def _stable(loop: Loop, zh: Impedance, ze: Impedance, period: float) -> None:
    size, hz = sampled.mode(loop, zh, ze, period)
    if size <= 1.0 + GROWTH:
        return
    growth, pair = np.log(size) / period, _said(zh, ze)
    where = f"axis {loop.axis or '-'}, {pair}"
    now = replace(loop.real, forward_s=0.0, backward_s=0.0)
    without = replace(loop, real=now)
    total = loop.real.forward_s + loop.real.backward_s
    if total > 0.0 and sampled.radius(without, zh, ze, period) <= 1.0 + GROWTH:
        bears = sampled.margin(without, zh, ze, period)
        raise ConfigError(
            f"{where}: the round-trip delay of {1e3 * total:.3g} ms is beyond the margin of "
            f"{1e3 * bears:.3g} ms; shorten the delay, or lower c2, c4 and the stiffness"
        )
    pole = hybrid.poles(loop.design, zh, ze, now).real.max(initial=-np.inf)
    if pole > 1e-6:
        raise ConfigError(
            f"{where}: the loop is unstable, a pole at +{pole:.3g} rad/s (it must be negative); "
            "run 'hil design RIG.toml' for the margins"
        )
    raise ConfigError(
        f"{where}: this pair is stable on paper, with its rightmost pole at {pole:.3g} rad/s, "
        f"but not when sampled every {1e3 * period:.3g} ms with these "
        f"filters: a mode of {hz:.3g} Hz grows by {growth:.3g} /s (eigenvalue {size:.5f}, at most "
        f"1); {_advice(loop, hz)}"
    )


def _advice(loop: Loop, hz: float) -> str:
    if any(getattr(loop.design, c).a for c in MOTION):
        return (
            "lower acceleration_hz, or go further from the estimation singularity (smaller c2 c3)"
        )
    if loop.cable and hz > CABLE:
        return "it is the cable between motor and tip: lower the damping of c7 and c8"
    return "lower the gains, or raise velocity_hz and force_hz"


def _pairs(loop: Loop) -> Iterable[tuple[Impedance, Impedance]]:
    return product(loop.operators, loop.environments)


def _said(zh: Impedance, ze: Impedance) -> str:
    def one(z: Impedance) -> str:
        return f"{z.m:g} kg, {z.b:g} N s/m, {z.k:g} N/m"

    return f"operator ({one(zh)}), environment ({one(ze)})"
