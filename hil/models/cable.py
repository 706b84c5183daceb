"""A cable between motor and link that is soft about zero tension and rigid under load.

Its strands and its winding settle before they carry: between the elastic transmission (one
stiffness) and the play (none, then a hard one) it is the family that joins them.  With the zero
of tension at the stiffness k0 and the stretch s that the soft range takes up,

    d(T) = s T / (T0 + |T|),    s = T0 / k0,    dT/dd = k0 (1 + |T| / T0)^2:

T0 -> infinity is the elastic transmission, T0 -> 0 with s kept a play of width 2 s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.models.effect import (
    STRICT,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Param,
    Relations,
    Shapes,
    Trait,
)
from hil.models.motion import FloatArray, Motion
from hil.models.passing import load_size, passing
from hil.models.transmission import FRICTIONS, LOWEST, MOST, highest, inside, spring

#: Tensions that take up half the soft range, in units of the load's standard deviation: tried at
#: first, and once a resonance is found.  At the largest such a load makes the cable hardly more
#: than twice as stiff: that is an elastic transmission.  At the smallest it makes it some hundreds
#: of times as stiff: that is a play.  With the first ones the steps of the frequency: the sooner
#: it stiffens the less it rings.
TENSIONS = {0.3: 1.5, 0.1: 1.7, 1.0: 1.35}
MORE_TENSIONS = (0.05, 0.1, 0.17, 0.3, 0.55, 1.0, 2.0)
#: Damping ratios at zero tension: at first, and then.
ZETA, ZETAS = 0.1, (0.03, 0.05, 0.1, 0.2, 0.4)
#: Friction of the link that is tried at first, in the same units.
RUB = 0.1


def _hardening_cable_grid(motion: Motion, j: int) -> Shapes:
    """Resonances over the lower half of the band, three tensions, some damping."""
    low, high = LOWEST, max(0.5 * highest(motion), 1.5 * LOWEST)
    size = load_size(motion, j)
    out: Shapes = []
    for t, step in TENSIONS.items():
        some = np.geomspace(low, high, 1 + int(np.ceil(np.log(high / low) / np.log(step))))
        out += [(float(f), t * size, ZETA, RUB * size) for f in some]
    return out


def _hardening_cable_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Tensions, then dampings and frictions of the link, one of them changed at a time."""
    f, tension, zeta, rub = shape
    size = load_size(motion, j)
    return [
        *((f, t * size, zeta, rub) for t in MORE_TENSIONS),
        *((f, tension, z, rub) for z in ZETAS),
        *((f, tension, zeta, r * size) for r in (0.0, *FRICTIONS)),
    ]


def _hardening_cable_between(f: Fitted) -> bool:
    """Neither all of the motion in its soft range nor next to nothing, and much behind it."""
    low, high = (t * load_size(f.motion, f.j) for t in (MORE_TENSIONS[0], MORE_TENSIONS[-1]))
    between = 1.05 * low < f.shape[1] < 0.95 * high and inside(f.motion, f.shape[0])
    return between and f.beta[0] > MOST


class HardeningCable(Effect):
    """A cable that is soft about zero tension and stiffer the more it carries."""

    name, family = "hardening-cable", "transmission"
    doc = Doc(
        equation=(
            "tau = a (P - L),  L = load + fl sgn(v - d'),  I d'' + P = L,  P = T + c T',  "
            "d = (T / k0) / (1 + |T| / T0),  k0 = (2 pi f)^2 I,  c = zeta / (pi f)"
        ),
        signature=(
            "the load comes late and rings after it changes its sign, the less the larger it is"
        ),
        confused_with=("backlash", "elastic-transmission", "vibration-mode"),
        shown_by="the same fast motion under a small and a large static load",
        source="Naerum thesis 3.2; Miyasaka et al., ICRA 2015 (cable stiffness rises with load)",
        caveat=(
            "the law of a real cable is another one: stretch, tension and damping are those of "
            "the nearest cable of this form, and the standard errors count noise alone"
        ),
    )
    params = (Param("a", "1", "share of the load that the cable carries", 0.0, 2.0),)
    shape = (
        Param("f", "Hz", "resonance about zero tension with the motor held", 0.0, size=True),
        Param("T0", "{F}", "tension at which it is four times as stiff as at zero", 0.0),
        Param("zeta", "1", "damping ratio about zero tension", 0.0),
        Param("fl", "{F}", "Coulomb friction behind the cable", 0.0),
    )
    relations = Relations(limit="elastic-transmission", causes=("resonance", "play"))
    search = Grid(_hardening_cable_grid, across=_hardening_cable_across, rounds=2)
    limits = (Limit("between", _hardening_cable_between), STRICT)
    traits = Trait.LOAD | Trait.REPLAYED | Trait.SMOOTHS

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """What passes the cable, less the load."""
        tension, (k, c, _) = float(shape[1]), spring(motion, j, (shape[0], shape[2]))
        return passing(motion, j, (tension / k, tension), c / k, float(shape[3]))


EFFECTS: tuple[Effect, ...] = (HardeningCable(),)
