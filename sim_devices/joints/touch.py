"""What touches a simulated arm: a hand at its tip, the wall around its shaft, tissue before it.

All of it acts on the last body.  The frame ``tip`` of the URDF is where it is; its z is the shaft,
which points away from the arm.

    hand    spring and damper to a path, in place and in turning, with tremor
    wall    hole in an elastic wall that the shaft goes through.  Across the shaft, with d from the
            hole's rest to the shaft:  f = -(k + h d^2) d - b (d - d1) - c d',  d1' = (d - d1) / T;
            along and about it the friction of a seal
    tissue  half space before the tip.  With depth e:  f = k e^p (1 + 1.5 a e') along its normal,
            and Maxwell elements across it and about the shaft, as long as the tip is in it

Wall: a quasi-linear viscoelastic layer, cut down to one branch (Fung 1993); tissue: Hunt &
Crossley 1975.  No number here is a law's.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import acos, cos, pi, sin, sqrt, tanh
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.sim_devices.plants.build import with_defaults

_F = np.float64
_V, _M = (_F, (3,)), (_F, (3, 3))
FloatArray = NDArray[np.float64]


def _fields(text: str, *shape: Any) -> list[Any]:
    return [(name, *shape) for name in text.split()]


#: Parameters and state of all that touches one arm; what is measured of it stands last.
TOUCH = np.dtype([
    *_fields("any hand wall tissue", np.int64),
    # where the tip is in its body
    *_fields("place", *_V), *_fields("turn", *_M),
    # hand
    *_fields("k b kr br onset skill pivot roll roll_rate tremor", _F),
    *_fields("size rate phase home aim aim_v aim_w shake", *_V),
    *_fields("home_turn aim_turn", *_M),
    # wall
    *_fields("wall_k wall_h wall_b wall_time wall_c seal seal_radius", _F),
    *_fields("hole flow", *_V),
    # tissue
    *_fields("tissue_k tissue_p tissue_a shear torsion tissue_time twist", _F),
    *_fields("surface normal slide", *_V),
    # measured: place, turning and speeds of the tip; what acts there; wall, across and all of it
    *_fields("tip speed spin hand_force hand_torque tissue_force tissue_torque", *_V),
    *_fields("wall_force wall_off", *_V), *_fields("axes", *_M), ("load", _F, (6,)),
])  # fmt: skip


@nb.njit(cache=True, nogil=True, error_model="numpy")
def turned(m: Any, v: Any, out: Any) -> None:
    """M v into `out` (3,)."""
    for i in range(3):
        out[i] = m[i, 0] * v[0] + m[i, 1] * v[1] + m[i, 2] * v[2]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def product(a: Any, b: Any, out: Any) -> None:
    """A b into `out` (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def moment(a: Any, b: Any, out: Any) -> None:
    """Add a x b to `out` (3,)."""
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def about(axis: Any, angle: float, out: Any) -> None:
    """Rotation by `angle` about a unit vector into `out` (3, 3)."""
    s, c = sin(angle), cos(angle)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = c + (1.0 - c) * axis[i] * axis[i]
        out[i, j] = (1.0 - c) * axis[i] * axis[j] - s * axis[k]
        out[i, k] = (1.0 - c) * axis[i] * axis[k] + s * axis[j]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def wanted(h: Any, t: float, room: Any, out: Any) -> None:
    """Turning (3, 3) that the hand wants at time `t`, with `h.aim` as its place.

    The handle is turned as if it went through a point `pivot` behind the tip's home, by a share
    `skill` of that, and rolled about its own axis.
    """
    ramp = min(1.0, t / h.onset)
    axis, away, swing, spun = room[0, 0], room[0, 1], room[1], room[2]
    for i in range(3):
        axis[i] = h.home_turn[i, 2]
    about(axis, ramp * h.roll * sin(h.roll_rate * t), spun)
    angle = 0.0
    if h.pivot > 0.0:
        long, along = 0.0, 0.0
        for i in range(3):
            away[i] = h.aim[i] - h.home[i] + h.pivot * axis[i]
            long += away[i] * away[i]
            along += away[i] * axis[i]
        angle = h.skill * acos(min(1.0, along / sqrt(long)))
        room[0, 2, :] = 0.0
        moment(axis, away, room[0, 2])
        size = sqrt(room[0, 2, 0] ** 2 + room[0, 2, 1] ** 2 + room[0, 2, 2] ** 2)
        for i in range(3):
            room[0, 2, i] /= size + 1e-12
    about(room[0, 2], angle, swing)
    product(swing, spun, room[3])
    product(room[3], h.home_turn, out)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def aim(h: Any, t: float, tick: float, random: Any, room: Any) -> None:
    """Where the hand wants the tip at the start of a tick, and how fast that moves."""
    keep = 1.0 - tick / 0.02
    for i in range(3):
        h.shake[i] = keep * h.shake[i] + sqrt(1.0 - keep * keep) * random[i]
    ramp, rate = min(1.0, t / h.onset), 0.0
    if ramp < 1.0:
        rate = 6.0 * ramp * (1.0 - ramp) / h.onset
    ramp = ramp * ramp * (3.0 - 2.0 * ramp)
    for i in range(3):
        h.aim[i], h.aim_v[i] = h.home[i], 0.0
        for k in range(3):
            angle = h.rate[k] * t + h.phase[k]
            wave = sin(angle) - sin(h.phase[k])
            h.aim[i] += h.home_turn[i, k] * ramp * h.size[k] * wave
            speed = ramp * h.rate[k] * cos(angle) + rate * wave
            h.aim_v[i] += h.home_turn[i, k] * h.size[k] * speed
        h.aim[i] += h.tremor * h.shake[i]
    wanted(h, t, room, h.aim_turn)
    for i in range(3):
        h.aim[i] += tick * h.aim_v[i]
    wanted(h, t + tick, room, room[4])
    # w = vee((R(t + T) R(t)^T - its transpose) / 2 T)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        off = 0.0
        for m in range(3):
            off += room[4, k, m] * h.aim_turn[j, m] - room[4, j, m] * h.aim_turn[k, m]
        h.aim_w[i] = 0.5 * off / tick
        h.aim[i] -= tick * h.aim_v[i]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def touch_poses(b: Any, x: Any, vec: Any, t: Any, room: Any) -> None:
    """Place, axes and speeds of the tip in base axes, from the transforms and speeds of bodies."""
    parent, d = b[0], b[0].size
    axes, origin, step = room[5], room[0, 0], room[0, 1]
    for i in range(3):
        origin[i] = 0.0
        for j in range(3):
            axes[i, j] = 1.0 if i == j else 0.0
    for n in range(d):
        if parent[n] != n - 1:
            continue
        # [p]x = -E^T (lower left)
        for k in range(3):
            i, j = (k + 2) % 3, (k + 1) % 3
            step[k] = 0.0
            for m in range(3):
                step[k] -= x[n, m, i] * x[n, 3 + m, j]
        turned(axes, step, room[0, 2])
        for i in range(3):
            origin[i] += room[0, 2, i]
            for j in range(3):
                room[4, i, j] = axes[i, 0] * x[n, j, 0] + axes[i, 1] * x[n, j, 1]
                room[4, i, j] += axes[i, 2] * x[n, j, 2]
        axes[:] = room[4]
    turned(axes, t.place, step)
    product(axes, t.turn, t.axes)
    v = vec[d - 1, 0]
    turned(axes, v[:3], t.spin)
    turned(axes, v[3:], t.speed)
    moment(t.spin, step, t.speed)
    for i in range(3):
        t.tip[i] = origin[i] + step[i]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def hold(t: Any, room: Any) -> None:
    """Force and torque of the hand on the tip."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        off = 0.0
        for m in range(3):
            off += t.axes[j, m] * t.aim_turn[k, m] - t.axes[k, m] * t.aim_turn[j, m]
        # sin of the angle between, about its axis
        t.hand_torque[i] = 0.5 * t.kr * off + t.br * (t.aim_w[i] - t.spin[i])
        t.hand_force[i] = t.k * (t.aim[i] - t.tip[i]) + t.b * (t.aim_v[i] - t.speed[i])


@nb.njit(cache=True, nogil=True, error_model="numpy")
def enclose(t: Any, dt: float, room: Any) -> float:
    """Force of the wall on the shaft; how far from the tip along the shaft it acts [m]."""
    t.wall_force[:] = 0.0
    t.wall_off[:] = 0.0
    shaft, speed = room[0, 0], room[0, 1]
    at = 0.0
    for i in range(3):
        shaft[i] = t.axes[i, 2]
        at += shaft[i] * (t.hole[i] - t.tip[i])
    if at > 0.0:  # the tip is out of the hole
        return 0.0
    size, along, spin = 0.0, 0.0, 0.0
    for i in range(3):
        t.wall_off[i] = t.tip[i] + at * shaft[i] - t.hole[i]
        size += t.wall_off[i] * t.wall_off[i]
        speed[i] = t.speed[i]
        room[0, 2, i] = at * shaft[i]
        along += t.speed[i] * shaft[i]
        spin += t.spin[i] * shaft[i]
    moment(t.spin, room[0, 2], speed)
    stiff = t.wall_k + t.wall_h * size
    for i in range(3):
        t.wall_force[i] = -stiff * t.wall_off[i] - t.wall_b * (t.wall_off[i] - t.flow[i])
        t.wall_force[i] -= t.wall_c * (speed[i] - along * shaft[i])
        t.flow[i] += dt * (t.wall_off[i] - t.flow[i]) / t.wall_time
    return at


@nb.njit(cache=True, nogil=True, error_model="numpy")
def meet(t: Any, dt: float, room: Any) -> None:
    """Force and torque of the tissue on the tip."""
    depth, rate, spin = 0.0, 0.0, 0.0
    for i in range(3):
        depth += (t.surface[i] - t.tip[i]) * t.normal[i]
        rate -= t.speed[i] * t.normal[i]
        spin += t.spin[i] * t.axes[i, 2]
    t.tissue_force[:] = 0.0
    t.tissue_torque[:] = 0.0
    if depth <= 0.0:
        t.slide[:] = 0.0
        t.twist = 0.0
        return
    normal = t.tissue_k * depth**t.tissue_p * (1.0 + 1.5 * t.tissue_a * rate)
    t.twist += dt * (spin - t.twist / t.tissue_time)
    for i in range(3):
        across = t.speed[i] + rate * t.normal[i]
        t.slide[i] += dt * (across - t.slide[i] / t.tissue_time)
        t.tissue_force[i] = max(normal, 0.0) * t.normal[i] - t.shear * depth * t.slide[i]
        t.tissue_torque[i] = -t.torsion * depth * t.twist * t.axes[i, 2]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def apply_touch(b: Any, x: Any, vec: Any, t: Any, dt: float, room: Any) -> None:
    """All that touches the arm, as a force on its last body: taken off `vec[d - 1, 2]`."""
    touch_poses(b, x, vec, t, room)
    force, torque, local = room[6, 0], room[6, 1], room[6, 2]
    force[:] = 0.0
    torque[:] = 0.0
    if t.hand:
        hold(t, room)
        force += t.hand_force
        torque += t.hand_torque
    if t.wall:
        at = enclose(t, dt, room)
        moment(room[0, 2], t.wall_force, torque)
        force += t.wall_force
        if at < 0.0:
            along, spin = 0.0, 0.0
            for i in range(3):
                along += t.speed[i] * t.axes[i, 2]
                spin += t.spin[i] * t.axes[i, 2]
            for i in range(3):
                force[i] -= t.seal * tanh(along / 0.003) * t.axes[i, 2]
                torque[i] -= t.seal * t.seal_radius * tanh(spin / 0.5) * t.axes[i, 2]
    if t.tissue:
        meet(t, dt, room)
        force += t.tissue_force
        torque += t.tissue_torque
    # into the body's frame, about its origin
    axes, d = room[5], b[0].size
    for i in range(3):
        local[i] = axes[0, i] * force[0] + axes[1, i] * force[1] + axes[2, i] * force[2]
        t.load[3 + i] = local[i]
        t.load[i] = axes[0, i] * torque[0] + axes[1, i] * torque[1] + axes[2, i] * torque[2]
    moment(t.place, local, t.load)
    for i in range(6):
        vec[d - 1, 2, i] -= t.load[i]


def touch_scratch() -> FloatArray:
    """Room for `apply_touch` and `aim`."""
    return np.zeros((7, 3, 3))


_OPERATOR_KEYS: dict[str, Any] = {
    "arm": "", "size": [0.0] * 3, "frequency": [0.2] * 3, "phase": [0.0] * 3, "roll": 0.0,
    "roll_frequency": 0.2, "pivot": 0.0, "skill": 1.0, "onset": 1.5, "stiffness": 320.0,
    "damping": 7.0, "turn_stiffness": 3.5, "turn_damping": 0.06, "tremor": 2e-4, "spread": 0.15,
}  # fmt: skip
WALL_KEYS: dict[str, Any] = {
    "arm": "", "depth": 0.118, "off": [0.0] * 2, "stiffness": 430.0, "hardening": 2.5e6,
    "branch": 260.0, "relaxation": 0.7, "damping": 4.0, "seal": 0.35, "seal_radius": 0.004,
}  # fmt: skip
TISSUE_KEYS: dict[str, Any] = {
    "arm": "", "ahead": 0.01, "stiffness": 1900.0, "power": 1.35, "damping": 0.9, "shear": 9e3,
    "torsion": 11.0, "relaxation": 6.0,
}  # fmt: skip


def attach_touch(
    t: Any, table: str, given: Mapping[str, Any], tip: FloatArray, axes: FloatArray, rng: Any
) -> None:
    """Set up one table of ``[simulation]`` in `t`, with the tip at home at `tip` (3,), `axes`.

    Lengths across and along are those of the tip's axes at home.

    Raises
    ------
    ConfigError
        For a key that is not known or a value out of range.
    """
    where = f"simulation.{table}"
    keys = {"operator": _OPERATOR_KEYS, "incision": WALL_KEYS, "tissue": TISSUE_KEYS}[table]
    row = with_defaults(where, dict(given), keys)
    least = dict.fromkeys(("onset", "relaxation"), 0.01)
    for key in row.keys() - {"arm", "size", "phase", "off", "ahead", "roll"}:
        if np.min(row[key]) < least.get(key, 0.0):
            raise ConfigError(
                f"[{where}] {key} = {row[key]}: {least.get(key, 0.0):g} or more is needed"
            )
    t["any"] = 1
    {"operator": _hand, "incision": _wall, "tissue": _tissue}[table](t, row, tip, axes, rng)


def _hand(
    t: Any, row: dict[str, Any], tip: FloatArray, axes: FloatArray, rng: np.random.Generator
) -> None:
    """A hand; `spread` makes every session's another one."""

    def varied(value: float) -> float:
        return float(value * np.exp(row["spread"] * rng.uniform(-1.0, 1.0)))

    t["hand"], t["home"], t["home_turn"] = 1, tip, axes
    t["k"], t["b"] = varied(row["stiffness"]), varied(row["damping"])
    t["kr"], t["br"] = varied(row["turn_stiffness"]), varied(row["turn_damping"])
    t["pivot"], t["skill"] = varied(row["pivot"]), row["skill"]
    t["size"], t["rate"] = row["size"], 2 * pi * np.array(row["frequency"], float)
    t["phase"] = np.array(row["phase"], float) + 2.0 * row["spread"] * rng.uniform(-1.0, 1.0, 3)
    t["roll"], t["roll_rate"] = row["roll"], 2 * pi * row["roll_frequency"]
    t["onset"], t["tremor"] = row["onset"], row["tremor"]


def _wall(t: Any, row: dict[str, Any], tip: FloatArray, axes: FloatArray, rng: Any) -> None:
    t["wall"], across = 1, row["off"]
    t["hole"] = tip - row["depth"] * axes[:, 2] + across[0] * axes[:, 0] + across[1] * axes[:, 1]
    t["wall_k"], t["wall_h"], t["wall_b"] = row["stiffness"], row["hardening"], row["branch"]
    t["wall_time"], t["wall_c"] = row["relaxation"], row["damping"]
    t["seal"], t["seal_radius"] = row["seal"], row["seal_radius"]


def _tissue(t: Any, row: dict[str, Any], tip: FloatArray, axes: FloatArray, rng: Any) -> None:
    t["tissue"], t["normal"] = 1, -axes[:, 2]
    t["surface"] = tip + row["ahead"] * axes[:, 2]
    t["tissue_k"], t["tissue_p"], t["tissue_a"] = row["stiffness"], row["power"], row["damping"]
    t["shear"], t["torsion"], t["tissue_time"] = row["shear"], row["torsion"], row["relaxation"]


__all__ = ["TOUCH", "aim", "apply_touch", "attach_touch", "touch_scratch"]
