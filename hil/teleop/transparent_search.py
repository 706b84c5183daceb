"""A transparent controller that runs on these arms, with or without acceleration terms.

The theorem leaves the local gains c5..c8 free, and the filters are free besides.  On paper all
choices are equally transparent; with filters, cables and sampling they are not, and most do not
run.  All of a grid are ranked by what the operator would feel of them, from 0.2 to 5 Hz, and the
first that `hil.teleop.gate` passes on all three axes is taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from hil.errors import ConfigError
from hil.teleop import gate, hybrid, summary
from hil.teleop.architecture import Design, RobotImpedance, Wish, named_design
from hil.teleop.sampled_loop import SampledLoop

#: Families with their free local gains; two channels are limits of them.
_FAMILIES = (
    "four-channel",
    "three-channel-1",
    "three-channel-2",
    "three-channel-3",
    "three-channel-4",
)
_STIFFNESS = (60.0, 120.0, 250.0)
_DAMPING = (0.3, 0.6, 1.0, 1.5)
_LOCAL_FORCES = (0.0, -0.3, -0.5, -0.7, -0.85)
_ACCELERATION_HZ = (0.5, 1.0, 2.0, 4.0)
_FORCE_HZ = (10.0, 30.0, 100.0)
#: What counts as one in h11 and h22 [N s/m]: a calm hand's damping.
_UNIT = 10.0


@dataclass(frozen=True)
class TransparentDesign:
    """What the search found.

    Parameters
    ----------
    designs : list of 3 Design
        Of the axes.
    filters : dict
        Corners for the law [Hz].
    error : float
        Distance from the transparent hybrid matrix, rms over 0.2 to 5 Hz.
    tried, refused : int
        Candidates, and how many better ones do not run.
    """

    designs: list[Design]
    filters: dict[str, float]
    error: float
    tried: int
    refused: int


def search(
    loops: Sequence[SampledLoop],
    period: float,
    accelerations: bool,
    fixed: Mapping[str, float],
) -> TransparentDesign:
    """Most transparent design of the grid that runs.

    Parameters
    ----------
    loops : sequence of 3 SampledLoop
        Axes with their set; the designs in them give masses and scales alone.
    period : float
        Of the loop [s].
    accelerations : bool
        Whether c1 and c4 have the acceleration terms of the theorem.
    fixed : mapping
        Filters that are not to be changed, as ``force_hz``.

    Raises
    ------
    ConfigError
        If none runs.
    """
    ranked = sorted(_candidates(loops, accelerations, fixed), key=lambda c: c[0])
    for k, (error, designs, filters) in enumerate(ranked):
        if _runs(loops, designs, filters, period):
            return TransparentDesign(designs, filters, error, len(ranked), k)
    kind = "with" if accelerations else "without"
    raise ConfigError(
        f"none of {len(ranked)} transparent designs {kind} acceleration terms runs on these arms "
        f"with these delays; use --set accelerations={int(not accelerations)}, shorter delays, or "
        "--design optimised"
    )


def _candidates(
    loops: Sequence[SampledLoop], accelerations: bool, fixed: Mapping[str, float]
) -> Iterator[tuple[float, list[Design], dict[str, float]]]:
    """Error, designs and filters of the whole grid."""
    corners: dict[str, Sequence[float]] = {"force_hz": _FORCE_HZ}
    if accelerations:
        corners["acceleration_hz"] = _ACCELERATION_HZ
    corners |= {k: (v,) for k, v in fixed.items() if k in corners}
    for values in product(*corners.values()):
        filters = dict(zip(corners, values, strict=True))
        for name, k, b, local in product(_FAMILIES, _STIFFNESS, _DAMPING, _LOCAL_FORCES):
            wish = Wish(
                stiffness=k,
                damping=b,
                master_stiffness=k,
                master_damping=b,
                slave_force=local,
                master_force=local,
                motion_scale=loops[0].design.motion_scale,
                force_scale=loops[0].design.force_scale,
            )
            designs = [_design(name, wish, loop, accelerations) for loop in loops]
            error = max(_error(d, loop, filters) for d, loop in zip(designs, loops, strict=True))
            if np.isfinite(error):
                yield error, designs, filters


def _design(name: str, wish: Wish, loop: SampledLoop, accelerations: bool) -> Design:
    """Named design for the masses of an axis."""
    d = loop.design
    own: dict[str, Any] = {"master": RobotImpedance(d.master.m), "slave": RobotImpedance(d.slave.m)}
    out = named_design(name, replace(wish, **own))
    if not accelerations:
        terms = {c: replace(getattr(out, c), a=0.0) for c in ("c1", "c4", "c7", "c8")}
        out = replace(out, **terms)
    return replace(out, name=f"transparent ({name})")


def _error(d: Design, loop: SampledLoop, filters: Mapping[str, float]) -> float:
    """Distance of H from the transparent one, in units of 1 and 10 N s/m, rms over the band."""
    w = summary.band(12)
    try:
        h = hybrid.hybrid(d, hybrid.jw(w), replace(loop.real, **filters))
    except ConfigError:
        return float("inf")
    kp, kf = d.motion_scale, d.force_scale
    gap = np.stack(
        [
            h[:, 0, 0] / _UNIT,
            h[:, 0, 1] / kf - 1.0,
            h[:, 1, 0] / kp + 1.0,
            h[:, 1, 1] * _UNIT,
        ]
    )
    return summary.weighted(np.linalg.norm(gap, axis=0), w, -1.0)


def _runs(
    loops: Sequence[SampledLoop],
    designs: Sequence[Design],
    filters: Mapping[str, float],
    period: float,
) -> bool:
    """Whether the gate passes all axes, with a tick of delay to spare.

    The declared pairs at one pose come first, which is quick.
    """
    made = [
        replace(
            loop,
            design=d,
            real=replace(loop.real, forward_s=loop.real.forward_s + period, **filters),
        )
        for loop, d in zip(loops, designs, strict=True)
    ]
    quick = [
        replace(x, operators=x.operators[:2], environments=x.environments[:2], tips=())
        for x in made
    ]
    return all(gate.passes(x, period) for x in (*quick, *made))
