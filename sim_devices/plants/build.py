"""From the table ``[simulation]`` of a rig file to the records of the compiled plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.sim_devices.plants import arm, hidden, truth
from hil.sim_devices.plants.layout import ARM, GEL, OPERATOR, SINES, STATE

#: Keys of ``[simulation]`` and of its tables, with their defaults.
DEFAULTS: dict[str, Any] = {
    "bench": "ideal",
    "truth": "nominal",
    "home": [0.0, 0.4, 0.3],
    "hidden": [],
    "hidden_seed": None,
    "operator": {},
    "gel": {},
    "quadrature": {},
}
OPERATOR_KEYS: dict[str, Any] = {
    "kind": "none",
    "arm": "leader",
    "size": [0.03, 0.05, 0.03],
    "frequency": 0.4,
    "tremor": 4e-5,
    "onset": 1.0,
}
GEL_KEYS: dict[str, Any] = {"arm": "", "below_home": 0.02, "stiffness": None}
#: Of a number, in SI units.
LARGEST = 1e12
KINDS = {"none": 0, "hand": 1, "mechanical": 2}


@dataclass
class Plan:
    """Records (arms,) of the compiled plant."""

    parameters: NDArray[np.void]
    state: NDArray[np.void]
    operators: NDArray[np.void]
    gels: NDArray[np.void]


def with_defaults(where: str, given: dict[str, Any], known: dict[str, Any]) -> dict[str, Any]:
    """Table with its defaults; an unknown key is an error that names the nearest.

    A value is of the type of its default; numbers are finite.
    """
    for key, value in given.items():
        if key not in known:
            raise ConfigError(f"[{where}]: {unknown('key', key, known)}")
        if not _alike(value, known[key]):
            raise ConfigError(
                f"[{where}] {key} = {value!r}: something like {known[key]!r} is needed"
            )
    return known | given


def _alike(value: Any, default: Any) -> bool:
    if default is None or isinstance(default, int | float):
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return (number and abs(value) <= LARGEST) or (default is None and value is None)
    if isinstance(default, list) and default:
        alike = isinstance(value, list) and len(value) == len(default)
        return alike and all(_alike(x, default[0]) for x in value)
    return isinstance(value, type(default))


def plan(arms: dict[str, str], section: dict[str, Any], seed: int) -> Plan:
    """Build all records; `arms` maps the name of an arm to its force sensor."""
    table = with_defaults("simulation", section, DEFAULTS)
    facts = truth.load(table["truth"])
    rng = np.random.default_rng([seed, 0xB0D])
    names, n = list(arms), len(arms)
    parameters, state = np.zeros(n, ARM), np.zeros(n, STATE)
    gauges = np.random.default_rng(0xCA1)
    for i, sensor in enumerate(arms.values()):
        parameters[i] = truth.arm(facts, sensor, gauges.standard_normal((6, 6)))[0]
        start(parameters[i], state[i], np.asarray(table["home"], float))
    choice = table["hidden_seed"]
    for row in hidden.choose(table["hidden"], names, seed if choice is None else int(choice)):
        if row["arm"] not in names:
            raise ConfigError(f"[[simulation.hidden]]: {unknown('arm', row['arm'], names)}")
        k = names.index(row["arm"])
        hidden.apply(parameters[k : k + 1], row)
    operators = _operators(names, table["operator"], facts, state, rng)
    return Plan(parameters, state, operators, _gels(names, table["gel"], facts, state))


def start(p: np.void, x: np.void, home: NDArray[np.float64]) -> None:
    """Rest the arm at `home` (3,) [rad] in its dock."""
    if home.shape != (3,):
        raise ConfigError("[simulation] home: three joint angles [rad] are needed.")
    x["qm"][:], x["q"][:], x["parked"] = home, home, 1
    arm.tip(p, x)


def _operators(
    names: list[str],
    section: dict[str, Any],
    facts: dict[str, Any],
    state: NDArray[np.void],
    rng: np.random.Generator,
) -> NDArray[np.void]:
    table = with_defaults("simulation.operator", section, OPERATOR_KEYS)
    records = np.zeros(len(names), OPERATOR)
    records["onset"] = table["onset"]
    if table["kind"] not in KINDS:
        raise ConfigError(f"[simulation.operator]: {unknown('kind', table['kind'], KINDS)}")
    if table["kind"] == "none":
        return records
    if table["arm"] not in names:
        raise ConfigError(f"[simulation.operator]: {unknown('arm', table['arm'], names)}")
    k = names.index(table["arm"])
    h, hand = records[k], table["kind"] == "hand"
    h["kind"], h["home"], h["x"] = KINDS[table["kind"]], state[k]["tip"], 0.0
    for key, value in facts["hand" if hand else "machine"].items():
        h[key] = value
    if hand:
        h["x"] = state[k]["tip"]
        _voluntary(h, table, rng)
    else:
        h["rate"][:, 0] = 2 * np.pi * table["frequency"] * np.array([1.0, 0.5, 1.0])
        h["size"][:, 0] = table["size"]
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
    records = np.zeros(len(names), GEL)
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
    return records
