"""From the table ``[simulation]`` of a rig file to the records of the compiled plant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.sim_devices.plants import truth, world
from hil.sim_devices.plants.layout import ARM_DTYPE, ARM_STATE_DTYPE, GEL_DTYPE, OPERATOR, SINES

# Hidden effects: physics that a session may hold and that its analysis has to find.
#
# Each row names the fields of `layout.ARM_DTYPE` that it sets, with the value at amplitude 1 and
# whether the amplitude scales it.  The laws are in `friction`, `drive` and `passive`; they are
# not those of the library.

_JOINTS = ("joint1", "joint2", "joint3")


@dataclass(frozen=True)
class HiddenKind:
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


HIDDEN_KINDS: dict[str, HiddenKind] = {
    "stribeck": HiddenKind(
        {"stribeck": 0.013}, {"stribeck_speed": 0.15}, "rational Stribeck curve"
    ),
    "asymmetric-coulomb": HiddenKind({"asym_coulomb": 0.008}, {}, "one direction rubs harder"),
    "asymmetric-viscous": HiddenKind({"asym_viscous": 0.008}, {}, "one direction is more viscous"),
    "quadratic-drag": HiddenKind({"drag": 0.024}, {}, "|v|^1.8"),
    "presliding": HiddenKind({"coulomb_motor": 0.002}, {}, "nested Maxwell slip over 3..20 mrad"),
    "position-friction": HiddenKind(
        {"eccentric": 0.006},
        {"eccentric_period": 0.45, "eccentric_phase": 0.6},
        "eccentric pulley rubs once a turn",
    ),
    "load-friction": HiddenKind({"capstan": 0.25}, {}, "capstan friction of the loaded cable"),
    "coupled-friction": HiddenKind({"couple": 0.006}, {}, "another joint's cable rubs on this one"),
    "spring": HiddenKind({"spring": 0.06}, {"spring_rest": 0.1}, "over-centre spring"),
    "position-torque": HiddenKind({"umbilical": 0.012}, {"umbilical_at": 0.1}, "umbilical cable"),
    "end-stop": HiddenKind(
        {"stop": 0.3}, {"stop_at": (0.15, 0.6, 0.5)}, "rubber stop within the range"
    ),
    "torque-gain": HiddenKind({"gain": 0.08}, {}, "torque constant off"),
    "cogging": HiddenKind(
        {"cogging": 0.006}, {"cogging_cycles": 33.6}, "two harmonics of the motor"
    ),
    "delay": HiddenKind({"delay": 0.008}, {}, "commands arrive late [s]"),
    "payload": HiddenKind({"payload": 0.03}, {}, "a mass at the tip [kg]"),
    "outside-speed-product": HiddenKind(
        {"product": 0.03}, {}, "product of the other joints' speeds"
    ),
    "outside-stick-slip": HiddenKind({"burst": 0.03}, {}, "friction bursts at random times"),
    "outside-resonance": HiddenKind({"resonance": 0.06}, {}, "resonance that moves with speed"),
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


#: Keys of a row of ``[[simulation.hidden]]``, with a value of their type.
ROW_KEYS: dict[str, Any] = {"effect": "stribeck", "arm": "arm", "joint": "joint2", "amplitude": 1.0}


def hidden_rows(rows: list[Any], known: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows of ``[[simulation.hidden]]``, each checked like every other table.

    Parameters
    ----------
    rows : list
        As the rig file has them.
    known : mapping
        Effect -> keys of its own beside `ROW_KEYS`, with a value of their type.
    """
    for n, row in enumerate(rows, 1):
        where = f"[[simulation.hidden]] row {n}"
        if not isinstance(row, Mapping):
            raise ConfigError(f"{where}: a table is needed, not {row!r}")
        name = row.get("effect")
        own = known.get(name, {}) if isinstance(name, str) else {}
        if isinstance(name, str) and name not in known:
            raise ConfigError(f"{where}: {unknown('effect', name, known)}")
        with_defaults(where, dict(row), ROW_KEYS | dict(own))
        if name is None:
            raise ConfigError(
                f"{where}: the key 'effect' is missing; there are {', '.join(sorted(known))}"
            )
    return [dict(row) for row in rows]


def draw_hidden(rows: list[dict[str, Any]], arms: list[str], seed: int) -> list[dict[str, Any]]:
    """Replace ``effect = "random"`` by a choice that depends on `seed` alone."""
    rng = np.random.default_rng([seed, 0x41D])
    chosen = []
    for row in rows:
        full = dict(row)
        if full["effect"] == "random":
            full["effect"] = RANDOM[int(rng.integers(len(RANDOM)))]
            joint = _JOINTS[int(rng.integers(3))]
            full.setdefault("joint", joint)
        full.setdefault("arm", "follower" if "follower" in arms else arms[0])
        chosen.append(full)
    return chosen


def apply(p: NDArray[np.void], row: dict[str, Any]) -> None:
    """Put one effect of ``[[simulation.hidden]]`` into the record `p` (1,) of its arm."""
    name = row["effect"]
    amplitude = float(row.get("amplitude", 1.0))
    if name == "payload":
        truth.add_tip_mass(p, amplitude * HIDDEN_KINDS[name].size["payload"])
        return
    kind, joint = HIDDEN_KINDS[name], row.get("joint", "joint2")
    joints = _JOINTS if joint == "all" else (joint,)
    for label in joints:
        if label not in _JOINTS:
            raise ConfigError(f"[[simulation.hidden]] {name}: {unknown('joint', label, _JOINTS)}")
        i = _JOINTS.index(label)
        values = {k: v * amplitude for k, v in kind.size.items()}
        values |= {k: v[i] if isinstance(v, tuple) else v for k, v in kind.shape.items()}
        _set(p, name, i, values | _own(row), row)


def _own(row: dict[str, Any]) -> dict[str, float]:
    """Values that the row itself gives, e.g. ``stop_at = 0.3``."""
    own = {k: v for k, v in row.items() if k not in ("effect", "arm", "joint", "amplitude", "by")}
    return {k: float(v) for k, v in own.items()}


def _set(
    p: NDArray[np.void], name: str, i: int, values: dict[str, float], row: dict[str, Any]
) -> None:
    if name == "coupled-friction":
        by = row.get("by", _JOINTS[(i + 1) % 3])
        if by not in _JOINTS or by == _JOINTS[i]:
            raise ConfigError(f"[[simulation.hidden]] {name}: by = {by!r} must be another joint.")
        p["couple"][0, i, _JOINTS.index(by)] += values["couple"]
        return
    for key, value in values.items():
        # what is scaled adds up; a shape is set
        p[key][0, i] = value if key in HIDDEN_KINDS[name].shape else p[key][0, i] + value
    if name == "presliding":
        p["slip_motor"][0, i], p["creep"][0, i] = NESTED_SLIP, 0.0


#: Keys of ``[simulation]`` and of its tables, with their defaults.
_DEFAULTS: dict[str, Any] = {
    "bench": "ideal",
    "truth": "nominal",
    "home": [0.0, 0.4, 0.3],
    "hidden": [],
    "hidden_seed": None,
    "operator": {},
    "gel": {},
    "quadrature": {},
}
_OPERATOR_KEYS: dict[str, Any] = {
    "kind": "none",
    "arm": "leader",
    "size": [0.03, 0.05, 0.03],
    "frequency": 0.4,
    "tremor": 4e-5,
    "onset": 1.0,
    "force": 1.0,
}
GEL_KEYS: dict[str, Any] = {"arm": "", "below_home": 0.02, "stiffness": None, "bolt": {}}
#: A stiff inclusion along x: place across it from the tip's home, cover above it, radius, and what
#: the gel is thick without it [m].
BOLT_KEYS: dict[str, Any] = {"place": 0.01, "depth": 0.008, "radius": 0.003, "thickness": 0.02}
#: Of a number, in SI units.
_LARGEST = 1e12
#: Table -> key -> least and largest value, and its unit: what a hand does, what the steps of the
#: physics bear, and a tip at the end of an arm of 0.4 m.
_RANGES: dict[str, dict[str, tuple[float, float, str]]] = {
    "simulation": {"hidden_seed": (0, _LARGEST, ""), "truth_seed": (0, _LARGEST, "")},
    "simulation.operator": {
        "size": (-0.5, 0.5, "m"),
        "frequency": (0.01, 20.0, "Hz"),
        "tremor": (0.0, 0.01, "m"),
        "onset": (0.01, 60.0, "s"),
        "force": (0.0, 20.0, "N"),
        "stiffness": (0.0, 1e5, "N/m"),
    },
    "simulation.tissue": {"stiffness": (0.0, 1e6, "N/m^p")},
    "simulation.incision": {"stiffness": (0.0, 1e6, "N/m")},
    "simulation.gel": {"below_home": (-1.0, 1.0, "m"), "stiffness": (0.0, 1e5, "N/m^1.3")},
    "simulation.gel.bolt": dict.fromkeys(BOLT_KEYS, (-1.0, 1.0, "m")),
}
_KINDS = {"none": 0, "hand": 1, "mechanical": 2, "stroking": 3}


@dataclass
class Plan:
    """Records (arms,) of the compiled plant."""

    parameters: NDArray[np.void]
    state: NDArray[np.void]
    operators: NDArray[np.void]
    gels: NDArray[np.void]


def with_defaults(where: str, given: dict[str, Any], known: dict[str, Any]) -> dict[str, Any]:
    """Table with its defaults; an unknown key is an error that names the nearest.

    A value is of the type of its default; numbers are finite, and within `_RANGES`.
    """
    head, ranges = where if where.startswith("[") else f"[{where}]", _RANGES.get(where, {})
    for key, value in given.items():
        if key not in known:
            raise ConfigError(f"{head}: {unknown('key', key, known)}")
        if not same_type(value, known[key]):
            raise ConfigError(f"{head} {key} = {value!r}: something like {known[key]!r} is needed")
        if value is not None and key in ranges:
            low, high, unit = ranges[key]
            if np.min(value) < low or np.max(value) > high:
                raise ConfigError(f"{head} {key} = {value}: {low:g} to {high:g} {unit} is needed")
    return known | given


def same_type(value: Any, default: Any) -> bool:
    """Whether a value of a rig file is of the type of another one, and finite."""
    if isinstance(default, int):
        return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _LARGEST
    if default is None or isinstance(default, float):
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return (number and abs(value) <= _LARGEST) or (default is None and value is None)
    if isinstance(default, list) and default:
        alike = isinstance(value, list) and len(value) == len(default)
        return alike and all(same_type(x, default[0]) for x in value)
    return isinstance(value, type(default))


def plan_bench(arms: dict[str, str], section: dict[str, Any], seed: int) -> Plan:
    """Build all records; `arms` maps the name of an arm to its force sensor."""
    table = with_defaults("simulation", section, _DEFAULTS)
    facts = truth.load_truth(table["truth"])
    rng = np.random.default_rng([seed, 0xB0D])
    names, n = list(arms), len(arms)
    parameters, state = np.zeros(n, ARM_DTYPE), np.zeros(n, ARM_STATE_DTYPE)
    gauges = np.random.default_rng(0xCA1)
    for i, sensor in enumerate(arms.values()):
        parameters[i] = truth.arm_record(facts, sensor, gauges.standard_normal((6, 6)))[0]
        start(parameters[i], state[i], np.asarray(table["home"], float))
    choice = table["hidden_seed"]
    own: dict[str, dict[str, Any]] = {
        name: kind.size | dict.fromkeys(kind.shape, 1.0) for name, kind in HIDDEN_KINDS.items()
    }
    own["coupled-friction"]["by"] = "joint1"
    rows = hidden_rows(table["hidden"], own | {"random": {}})
    for row in draw_hidden(rows, names, seed if choice is None else int(choice)):
        if row["arm"] not in names:
            raise ConfigError(f"[[simulation.hidden]]: {unknown('arm', row['arm'], names)}")
        k = names.index(row["arm"])
        apply(parameters[k : k + 1], row)
    operators = _operators(names, table["operator"], facts, state, rng)
    return Plan(parameters, state, operators, _gels(names, table["gel"], facts, state))


def start(p: np.void, x: np.void, home: NDArray[np.float64]) -> None:
    """Rest the arm at `home` (3,) [rad] in its dock."""
    if home.shape != (3,):
        raise ConfigError("[simulation] home: three joint angles [rad] are needed.")
    x["qm"][:], x["q"][:], x["parked"] = home, home, 1
    world.tip_state(p, x)


def _operators(
    names: list[str],
    section: dict[str, Any],
    facts: dict[str, Any],
    state: NDArray[np.void],
    rng: np.random.Generator,
) -> NDArray[np.void]:
    table = with_defaults("simulation.operator", section, _OPERATOR_KEYS)
    records = np.zeros(len(names), OPERATOR)
    records["onset"] = table["onset"]
    if table["kind"] not in _KINDS:
        raise ConfigError(f"[simulation.operator]: {unknown('kind', table['kind'], _KINDS)}")
    if table["kind"] == "none":
        return records
    if table["arm"] not in names:
        raise ConfigError(f"[simulation.operator]: {unknown('arm', table['arm'], names)}")
    k = names.index(table["arm"])
    h, hand = records[k], table["kind"] == "hand"
    h["kind"], h["home"], h["x"] = _KINDS[table["kind"]], state[k]["tip"], 0.0
    for key, value in facts["hand" if hand else "machine"].items():
        h[key] = value
    if hand:
        h["x"] = state[k]["tip"]
        _voluntary(h, table, rng)
    else:
        h["rate"][:, 0] = 2 * np.pi * table["frequency"] * np.array([1.0, 0.5, 1.0])
        h["size"][:, 0] = table["size"]
        if table["kind"] == "stroking":
            h["limit"] = table["force"]
    return records


def _voluntary(h: np.void, table: dict[str, Any], rng: np.random.Generator) -> None:
    """Eight sines of 0.1 to 4 x `frequency`, four of tremor at 8 to 12 Hz."""
    slow, n = SINES - 4, (3, SINES)
    low = table["frequency"] * rng.uniform(0.25, 4.0, (3, slow))
    h["rate"][:] = 2 * np.pi * np.concatenate([low, rng.uniform(8.0, 12.0, (3, 4))], 1)
    # size falls with frequency, as voluntary motion does
    fall = 1.0 / (1.0 + (low / table["frequency"]) ** 2)
    fall *= np.asarray(table["size"])[:, None] / np.sqrt((fall**2).sum(1, keepdims=True) / 2) / 2
    h["size"][:] = np.concatenate([fall, np.full((3, 4), table["tremor"] / np.sqrt(2))], 1)
    h["phase"][:] = rng.uniform(0.0, 2 * np.pi, n)


def _gels(
    names: list[str], section: dict[str, Any], facts: dict[str, Any], state: NDArray[np.void]
) -> NDArray[np.void]:
    table = with_defaults("simulation.gel", section, GEL_KEYS)
    records = np.zeros(len(names), GEL_DTYPE)
    records["relaxation"] = 1.0
    if not table["arm"]:
        return records
    if table["arm"] not in names:
        raise ConfigError(f"[simulation.gel]: {unknown('arm', table['arm'], names)}")
    k = names.index(table["arm"])
    for key, value in facts["gel"].items():
        records[k][key] = value
    if table["stiffness"] is not None:
        records[k]["stiffness"] = table["stiffness"]
    records[k]["on"], records[k]["surface"] = 1, state[k]["tip"][2] - table["below_home"]
    if table["bolt"]:
        bolt = with_defaults("simulation.gel.bolt", table["bolt"], BOLT_KEYS)
        if not 0.0 < bolt["depth"] < bolt["thickness"] or not bolt["radius"] > 0.0:
            raise ConfigError(
                f"[simulation.gel.bolt]: depth = {bolt['depth']:g} m and radius = "
                f"{bolt['radius']:g} m; a depth within 0 and the thickness of "
                f"{bolt['thickness']:g} m, and a radius above 0, are needed"
            )
        # a column of gel on a stiff ground: stiffness over its height
        records[k]["bolt"] = bolt["thickness"] / bolt["depth"] - 1.0
        records[k]["bolt_y"] = state[k]["tip"][1] + bolt["place"]
        # what lies deeper shows wider at the surface
        records[k]["bolt_width"] = bolt["radius"] + 0.5 * bolt["depth"]
    return records
