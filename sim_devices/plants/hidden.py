"""Hidden effects: physics that a session may hold and that its analysis has to find.

Each row names the fields of `layout.ARM` that it sets, with the value at amplitude 1 and
whether the amplitude scales it.  The laws are in `friction`, `drive` and `passive`; they are
not those of the library.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.sim_devices.plants import truth

JOINTS = ("joint1", "joint2", "joint3")


@dataclass(frozen=True)
class Hidden:
    """One kind of hidden effect.

    Parameters
    ----------
    size : dict
        Field -> value at amplitude 1, scaled by the amplitude.
    shape : dict
        Field -> value at any amplitude, or one per joint.
    text : str
        What it is.
    """

    size: dict[str, float]
    shape: dict[str, float | tuple[float, float, float]]
    text: str


HIDDEN: dict[str, Hidden] = {
    "stribeck": Hidden({"stribeck": 0.013}, {"stribeck_speed": 0.15}, "rational Stribeck curve"),
    "asymmetric-coulomb": Hidden({"asym_coulomb": 0.008}, {}, "one direction rubs harder"),
    "asymmetric-viscous": Hidden({"asym_viscous": 0.008}, {}, "one direction is more viscous"),
    "quadratic-drag": Hidden({"drag": 0.024}, {}, "|v|^1.8"),
    "presliding": Hidden({"coulomb_motor": 0.002}, {}, "nested Maxwell slip over 3..20 mrad"),
    "position-friction": Hidden(
        {"eccentric": 0.006},
        {"eccentric_period": 0.45, "eccentric_phase": 0.6},
        "eccentric pulley rubs once a turn",
    ),
    "load-friction": Hidden({"capstan": 0.25}, {}, "capstan friction of the loaded cable"),
    "coupled-friction": Hidden({"couple": 0.006}, {}, "another joint's cable rubs on this one"),
    "spring": Hidden({"spring": 0.06}, {"spring_rest": 0.1}, "over-centre spring"),
    "position-torque": Hidden({"umbilical": 0.012}, {"umbilical_at": 0.1}, "umbilical cable"),
    "end-stop": Hidden(
        {"stop": 0.3}, {"stop_at": (0.15, 0.6, 0.5)}, "rubber stop within the range"
    ),
    "torque-gain": Hidden({"gain": 0.08}, {}, "torque constant off"),
    "cogging": Hidden({"cogging": 0.006}, {"cogging_cycles": 33.6}, "two harmonics of the motor"),
    "delay": Hidden({"delay": 0.008}, {}, "commands arrive late [s]"),
    "payload": Hidden({"payload": 0.03}, {}, "a mass at the tip [kg]"),
    "outside-speed-product": Hidden({"product": 0.03}, {}, "product of the other joints' speeds"),
    "outside-stick-slip": Hidden({"burst": 0.03}, {}, "friction bursts at random times"),
    "outside-resonance": Hidden({"resonance": 0.06}, {}, "resonance that moves with speed"),
}

#: What ``effect = "random"`` chooses from: effects that free motion alone can reveal.
RANDOM = (
    "stribeck",
    "asymmetric-coulomb",
    "asymmetric-viscous",
    "quadratic-drag",
    "presliding",
    "position-friction",
    "coupled-friction",
    "position-torque",
    "end-stop",
    "cogging",
    "delay",
)

NESTED_SLIP = (3e-3, 6e-3, 1.2e-2, 2e-2)


def choose(rows: list[dict[str, Any]], arms: list[str], seed: int) -> list[dict[str, Any]]:
    """Replace ``effect = "random"`` by a choice that depends on `seed` alone."""
    rng = np.random.default_rng([seed, 0x41D])
    chosen = []
    for row in rows:
        full = dict(row)
        if full["effect"] == "random":
            full["effect"] = RANDOM[int(rng.integers(len(RANDOM)))]
            joint = JOINTS[int(rng.integers(3))]
            full.setdefault("joint", joint)
        full.setdefault("arm", "follower" if "follower" in arms else arms[0])
        chosen.append(full)
    return chosen


def apply(p: NDArray[np.void], row: dict[str, Any]) -> None:
    """Put one effect of ``[[simulation.hidden]]`` into the record `p` (1,) of its arm."""
    name = row["effect"]
    if name not in HIDDEN:
        raise ConfigError(f"[[simulation.hidden]]: {unknown('effect', name, [*HIDDEN, 'random'])}")
    amplitude = float(row.get("amplitude", 1.0))
    if name == "payload":
        truth.add_tip_mass(p, amplitude * HIDDEN[name].size["payload"])
        return
    kind, joint = HIDDEN[name], row.get("joint", "joint2")
    joints = JOINTS if joint == "all" else (joint,)
    for label in joints:
        if label not in JOINTS:
            raise ConfigError(f"[[simulation.hidden]] {name}: {unknown('joint', label, JOINTS)}")
        i = JOINTS.index(label)
        values = {k: v * amplitude for k, v in kind.size.items()}
        values |= {k: v[i] if isinstance(v, tuple) else v for k, v in kind.shape.items()}
        _set(p, name, i, values | _own(row, values), row)


def _own(row: dict[str, Any], values: dict[str, float]) -> dict[str, float]:
    """Values that the row itself gives, e.g. ``stop_at = 0.3``."""
    own = {k: v for k, v in row.items() if k not in ("effect", "arm", "joint", "amplitude", "by")}
    for key in own:
        if key not in values:
            raise ConfigError(f"[[simulation.hidden]]: {unknown('key', key, values)}")
    return {k: float(v) for k, v in own.items()}


def _set(
    p: NDArray[np.void], name: str, i: int, values: dict[str, float], row: dict[str, Any]
) -> None:
    if name == "coupled-friction":
        by = row.get("by", JOINTS[(i + 1) % 3])
        if by not in JOINTS or by == JOINTS[i]:
            raise ConfigError(f"[[simulation.hidden]] {name}: by = {by!r} must be another joint.")
        p["couple"][0, i, JOINTS.index(by)] += values["couple"]
        return
    for key, value in values.items():
        # what is scaled adds up; a shape is set
        p[key][0, i] = value if key in HIDDEN[name].shape else p[key][0, i] + value
    if name == "presliding":
        p["slip_motor"][0, i], p["creep"][0, i] = NESTED_SLIP, 0.0
