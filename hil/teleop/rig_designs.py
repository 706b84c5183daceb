"""From words of a command line to the designs of three axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

from hil.errors import ConfigError, unknown
from hil.estimate import compensation_tables
from hil.models.files import read_model
from hil.models.phantom import Premium
from hil.teleop import architecture, law_parameters, optimise, transparent_search
from hil.teleop.architecture import Design, RobotImpedance, Wish
from hil.teleop.hybrid import Impedance
from hil.teleop.optimise import DesignProblem
from hil.teleop.transparent_search import TransparentDesign

#: What a design is made from, and what of the law can be set beside it.
WISHES = tuple(f.name for f in fields(Wish) if f.name not in ("master", "slave"))
REAL = (
    "shape",
    "forces",
    "leader_mass",
    "follower_mass",
    "velocity_hz",
    "acceleration_hz",
    "force_hz",
    "forward",
    "backward",
    "friction_share",
    "friction_damping",
    "disturbance",
    "observer_hz",
)
#: Bounds and tolerances of an optimised design, as in `hil.teleop.optimise.DesignProblem`.
TASK = ("max_stiffness", "max_force", "corner", "free", "contact", "kappa", "weight")
#: What the search for a transparent design reads.
SEARCH = ("accelerations",)
#: Masses of the sensors on the tip [kg] (data sheets), reflected inertia of the rotors [kg m^2].
_SENSORS = {"nano17": 0.009, "nano25": 0.063}
_ROTORS = (1.8e-4, 1.3e-4, 1.3e-4)


class RigTables(Protocol):
    """What is read of a rig file."""

    @property
    def devices(self) -> Mapping[str, Any]:
        """Devices by name."""

    @property
    def controller(self) -> Any:
        """Controller with its arms and parameters."""


@dataclass(frozen=True)
class ArmImpedances:
    """The two arms as the axes see them.

    Parameters
    ----------
    master, slave : tuple of 3 floats
        Mass on each axis [kg]: the natural one, or what computed torque makes of it.
    """

    master: tuple[float, ...]
    slave: tuple[float, ...]

    @staticmethod
    def of(law: Any) -> ArmImpedances:
        """Masses for a law: its own where the arm is shaped, else those of its models."""
        if law.shape != "natural":
            m, s = law.masses()
            return ArmImpedances(tuple(map(float, m)), tuple(map(float, s)))
        tips = [
            law_parameters.tip_mass(p, law.pose) for p in (law.leader_model, law.follower_model)
        ]
        return ArmImpedances(*(tuple(round(float(x), 4) for x in tip) for tip in tips))


def settings(words: Sequence[str]) -> dict[str, Any]:
    """Values of KEY=VALUE words; channels as DELAY[,JITTER[,LOSS]] in seconds.

    Raises
    ------
    ConfigError
        For an unknown key, or a value that is no number.
    """
    out: dict[str, Any] = {}
    for word in words:
        key, _, text = word.partition("=")
        if key not in (known := (*WISHES, *REAL, *TASK, *SEARCH)):
            raise ConfigError("--set: " + unknown("key", key, known))
        out[key] = text if key in ("shape", "forces") else _value(key, text)
    return out


def _value(key: str, text: str) -> Any:
    try:
        numbers = [float(x) for x in text.split(",")]
    except ValueError:
        raise ConfigError(f"--set {key}={text}: a number is needed") from None
    if key in ("forward", "backward"):
        if len(numbers) > 3:
            raise ConfigError(f"--set {key}={text}: DELAY[,JITTER[,LOSS]] is needed")
        return dict(zip(("delay", "jitter", "loss"), numbers, strict=False))
    if key.endswith("_mass") or key == "friction_damping":
        return numbers
    if len(numbers) != 1:
        raise ConfigError(f"--set {key}={text}: one number is needed")
    return numbers[0]


def optimised(
    task: Mapping[str, float], arms: ArmImpedances, law: Any
) -> list[optimise.OptimisedDesign]:
    """Sensitivity-optimised designs of the three axes, the later ones warm-started.

    Parameters
    ----------
    task : mapping
        Keys of `TASK`.
    arms : Arms
        Masses.
    law : LawrenceConfig
        Filters, delays, operator and environment.
    """
    names = {"max_stiffness": "stiffness", "max_force": "force"}
    chosen: dict[str, Any] = _ON_THE_RIG | {names.get(k, k): v for k, v in task.items()}
    found: list[optimise.OptimisedDesign] = []
    for m, s in zip(arms.master, arms.slave, strict=True):
        problem = DesignProblem(
            master=RobotImpedance(m),
            slave=RobotImpedance(s),
            environment=Impedance(*law.environment),
            operator=Impedance(*law.operator),
            real=law_parameters.realisation(law),
        )
        start = found[0].theta if found else None
        found.append(optimise.optimise(replace(problem, **chosen), start))
    return found


def transparent(
    law: Any,
    arms: ArmImpedances,
    period: float,
    search: Mapping[str, float],
    fixed: Mapping[str, Any],
) -> TransparentDesign:
    """Most transparent design that runs: with acceleration terms, without, or the better of both.

    Parameters
    ----------
    law : LawrenceConfig
        Filters, delays, operator, environment and arms.
    arms : ArmImpedances
        Masses.
    period : float
        Of the loop [s].
    search : mapping
        Keys of `SEARCH`.
    fixed : mapping
        Filters that the user set.

    Raises
    ------
    ConfigError
        If none runs.
    """
    masses = {"leader_mass": arms.master, "follower_mass": arms.slave}
    loops = law_parameters.loops_of(replace(law, forces="measured", **masses))
    if search:
        return transparent_search.search(loops, period, search["accelerations"] != 0.0, fixed)
    found = []
    for kind in (True, False):
        try:
            found.append(transparent_search.search(loops, period, kind, fixed))
        except ConfigError as error:
            failed = error
    if not found:
        raise failed
    return min(found, key=lambda f: f.error)


#: Bounds that suit the arms' cables: k up to 150 N/m with b up to 1.5 N s/m.
_ON_THE_RIG = {"stiffness": 150.0, "corner": 100.0, "contact": 0.75, "kappa": 1.5}


def designs(name: str, wishes: Mapping[str, float], arms: ArmImpedances) -> list[Design]:
    """Designs of the three axes, each for its own masses.

    Parameters
    ----------
    name : str
        Named design.
    wishes : mapping
        Values of `Wish`.
    arms : Arms
        Masses.
    """
    out = []
    for m, s in zip(arms.master, arms.slave, strict=True):
        robots = {"master": RobotImpedance(m), "slave": RobotImpedance(s)}
        out.append(architecture.named_design(name, replace(Wish(**wishes), **robots)))  # type: ignore[arg-type]
    return out


def models(paths: Mapping[str, str], rig: RigTables) -> dict[str, Any]:
    """Rigid-body parameters and effects to compensate of both arms.

    An arm without a fitted model gets the published parameters with its rotors and the mass of
    its force sensor, and no friction compensation.
    """
    out: dict[str, Any] = {}
    given = rig.controller.parameters
    for role, arm in zip(("leader", "follower"), rig.controller.arms, strict=True):
        if role in paths:
            model = read_model(paths[role])
            out[f"{role}_model"] = compensation_tables.rigid_parameters(model).tolist()
            out[f"{role}_effects"] = compensation_tables.effects(model)
            out[f"{role}_span"] = compensation_tables.span(model)
            out["plugins"] = [*out.get("plugins", given.get("plugins", [])), *model.plugins]
            if given.get("friction_speeds"):
                out[f"{role}_friction"] = [0.0] * 3 * len(given["friction_speeds"])
        elif f"{role}_model" not in given:
            out[f"{role}_model"] = _nominal(_payload(rig, arm))
    return out


def _nominal(payload: float) -> list[float]:
    """Published parameters pi with rotors and a mass [kg] at the tip, (8,)."""
    pi = Premium.prior.copy()
    pi[[0, 4, 5]] += _ROTORS
    return [float(x) for x in law_parameters.payload(pi, payload)]


def _payload(rig: RigTables, arm: str) -> float:
    """Mass of an arm's force sensor [kg]."""
    for device in rig.devices.values():
        if device.arm == arm and device.driver == "ft-sensor":
            return _SENSORS.get(str(device.options.get("model", "nano17")), 0.0)
    return 0.0
