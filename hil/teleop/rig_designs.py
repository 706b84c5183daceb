"""From words of a command line to the designs of three axes, named or searched for.

The transparent design is one that runs on these arms, with or without acceleration terms.  The
theorem leaves the local gains c5..c8 free, and the filters are free besides.  On paper all choices
are equally transparent; with filters, cables and sampling they are not, and most do not run.  All
of a grid are ranked by what the operator would feel of them, from 0.2 to 5 Hz, and the first that
`hil.teleop.gate` passes on all three axes is taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any, Protocol

import numpy as np

from hil.errors import ConfigError, unknown
from hil.estimate import compensation_tables
from hil.models.files import read_model
from hil.models.phantom import Premium
from hil.teleop import gate, hybrid, law_parameters, optimise, summary
from hil.teleop.architecture import MOTION, Design, RobotImpedance, Wish, named_design
from hil.teleop.hybrid import Impedance
from hil.teleop.optimise import DesignProblem
from hil.teleop.sampled_loop import SampledLoop

#: What a design is made from, and what of the law can be set beside it.
WISHES = tuple(f.name for f in fields(Wish) if f.name not in ("master", "slave"))
#: The same by the words of the rig: its key in ``--set`` -> its name by the thesis' symbols.
WISH_KEYS = {w.replace("master", "leader").replace("slave", "follower"): w for w in WISHES}
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
#: Goals that every design has, and the rig file has already.
SCALES = ("motion_scale", "force_scale")
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


def design_settings(words: Sequence[str], names: Sequence[str] = ()) -> dict[str, Any]:
    """Values of KEY=VALUE words; channels as DELAY[,JITTER[,LOSS]] in seconds.

    `names` are the keys, without any those of a design with c1..c8; the thesis' names of its
    wishes are taken, too.

    Raises
    ------
    ConfigError
        For an unknown key, or a value that is no number.
    """
    out: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        if not equals:
            raise ConfigError(f"--set {word}: KEY=VALUE is needed, e.g. --set stiffness=200")
        key = key if names else WISH_KEYS.get(key, key)
        if key not in (names or (*WISHES, *REAL, *TASK, *SEARCH)):
            known = names or (*WISH_KEYS, *REAL, *TASK, *SEARCH)
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
        Filters, delays, scales, operator and environment.
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
            motion_scale=law.motion_scale,
            force_scale=law.force_scale,
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
        return most_transparent(loops, period, search["accelerations"] != 0.0, fixed)
    found = []
    for kind in (True, False):
        try:
            found.append(most_transparent(loops, period, kind, fixed))
        except ConfigError:
            continue
    if not found:
        raise ConfigError(
            "no transparent design, with or without acceleration terms, runs on these arms with "
            f"these delays; {_WITHOUT_DELAY}"
        )
    return min(found, key=lambda f: f.error)


#: What to do where no transparent design runs.
_WITHOUT_DELAY = (
    "shorter delays, --design optimised, or a law that bears any delay: --design passivity, waves, "
    "tanks, model"
)
#: Bounds that suit the arms' cables: k up to 150 N/m with b up to 1.5 N s/m.
_ON_THE_RIG = {"stiffness": 150.0, "corner": 100.0, "contact": 0.75, "kappa": 1.5}


def axis_designs(name: str, wishes: Mapping[str, float], arms: ArmImpedances) -> list[Design]:
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
        out.append(named_design(name, replace(Wish(**wishes), **robots)))  # type: ignore[arg-type]
    return out


def without_accelerations(design: Design) -> Design:
    """The design without the acceleration terms of its motion gains."""
    terms = {c: replace(getattr(design, c), a=0.0) for c in MOTION}
    return replace(design, **terms)


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
            out[f"{role}_effects"] = compensation_tables.compensated_values(model)
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


# ------------------------------------------------------------ the search for a transparent design

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


def most_transparent(
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
        f"with these delays; use --set accelerations={int(not accelerations)}, or {_WITHOUT_DELAY}"
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
        out = without_accelerations(out)
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
