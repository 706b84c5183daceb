"""Wavelet network on a Coulomb and viscous backbone: any function of speeds and position.

It names nothing.  It shows how much a function of these variables could explain at all.  With
inputs x scaled to their range (95 % within -1 .. 1) and dyadic levels m, centres c = k 2^-m,

    tau = sum_i w_i psi(2^m (x - c_i)),   psi(z) = (dim - |z|^2) exp(-|z|^2 / 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from hil.models.effect import Doc, Effect, Grid, Param, Scope, Shapes, Trait, typical_speed
from hil.models.motion import FloatArray, Motion

#: Inputs by the value of the shape: own speed; position and speed; above 0 the other joint.
SPEED, PLACE = 0.0, -1.0
#: Speed that counts as 1, in multiples of the rms speed (about the 95 % quantile of |v|).
UNIT_SPEED = 2.0


@lru_cache(maxsize=8)
def lines(dim: int) -> tuple[FloatArray, ...]:
    """Centres along each input, level by level; finer where all are small.

    Coarse levels cover the range, fine ones the neighbourhood of zero, where friction changes.
    """
    reaches = (1.0, 1.5, 0.5, 0.25)[: 4 if dim == 1 else 2]
    return tuple(np.arange(-r, r + 1e-9, 2.0**-m) for m, r in enumerate(reaches))


def wavelets(x: FloatArray) -> FloatArray:
    """Mexican hats of inputs x (n, dim), one at every crossing of centres: shape (n, nodes)."""
    n, dim = x.shape
    out = []
    for level, line in enumerate(lines(dim)):
        # z = 2^m (x - c); |z|^2 is a sum over the inputs, and its exponential a product
        square = (2.0**level * (x.T[:, None] - line[:, None])) ** 2
        bell = np.exp(-square / 2)
        total, hat = square[0], bell[0]
        for k in range(1, dim):
            total = (total[:, None] + square[k]).reshape(-1, n)
            hat = (hat[:, None] * bell[k]).reshape(-1, n)
        out.append((dim - total) * hat)
    return np.concatenate(out).T


def nodes(dim: int) -> int:
    """Wavelets of `dim` inputs."""
    return sum(len(line) ** dim for line in lines(dim))


def dictionary(motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
    """Columns for one set of inputs and scales (see `FrictionNetwork.shape`), shape (n, m)."""
    inputs, size, other = (float(x) for x in shape)
    own = motion.qd[:, j] / max(size, 1e-12)
    parts = [wavelets(own[:, None])]
    if inputs == PLACE:
        place = np.clip(motion.scaled(j), -1.2, 1.2)
        parts.append(wavelets(np.stack([place, own], axis=1)))
    elif inputs > 0:
        w = motion.qd[:, int(inputs) - 1] / max(other, 1e-12)
        parts += [wavelets(w[:, None]), wavelets(np.stack([own, w], axis=1))]
    return np.concatenate(parts, axis=1)


def input_sets(motion: Motion, j: int) -> Shapes:
    """Shapes: own speed, position and speed, own and every other joint's speed."""
    size = UNIT_SPEED * typical_speed(motion, j)
    others = [
        (float(k + 1), size, UNIT_SPEED * typical_speed(motion, k))
        for k in range(motion.d)
        if k != j
    ]
    return [(SPEED, size, 1.0), (PLACE, size, 1.0), *others]


def _friction_network_terms(motion: Motion, j: int) -> tuple[Param, ...]:
    """One weight a wavelet of the largest set of inputs."""
    one, two = nodes(1), nodes(2)
    most = 2 * one + two if motion.d > 1 else one + two
    return tuple(Param(f"w{k + 1}", "{F}", "weight of a wavelet") for k in range(most))


class FrictionNetwork(Effect):
    """Any function of own speed, and of position or another joint's speed beside it."""

    name, family = "friction-network", "friction"
    doc = Doc(
        equation="tau = sum_i w_i psi(2^m (x - c_i)),  x = (v), (q, v) or (v, v_k), scaled",
        signature="whatever is left over speed and position",
        confused_with=("stribeck", "position-friction", "coupled-friction", "quadratic-drag"),
        shown_by="motion that visits all combinations of its inputs",
        source=(
            "Naerum thesis 3.1.1 (wavelet friction network, Paper I); Mexican hat, dyadic levels"
        ),
    )
    params = (Param("w1", "{F}", "weight of a wavelet"),)
    shape = (
        Param(
            "inputs",
            "1",
            "0: own speed; -1: position and speed; k: own and joint k's",
            -1.0,
            codes=(
                (SPEED, "own speed"),
                (PLACE, "position and speed"),
                *((float(k), f"own speed and that of joint number {k}") for k in range(1, 8)),
            ),
            choice=True,
        ),
        Param("v", "{x}/s", "own speed that counts as 1", 0.0),
        Param("w", "{x}/s", "the other joint's speed that counts as 1", 0.0),
    )
    scope = Scope(terms=_friction_network_terms)
    search = Grid(input_sets, refine=False)
    traits = Trait.GIVEN

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Wavelets of the inputs; always as many as the largest set has, the others zero.

        Directions that move the effort by less than a noise unit are left out of every fit,
        which is what keeps the weights of overlapping wavelets bounded.
        """
        values = dictionary(motion, j, shape)
        out = np.zeros((motion.n, len(_friction_network_terms(motion, j))))
        out[:, : values.shape[1]] = values
        return out


EFFECTS: tuple[Effect, ...] = (FrictionNetwork(),)
