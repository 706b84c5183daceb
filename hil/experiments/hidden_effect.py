"""The circle: a session performs badly, the missing effect is named and added, and it falls.

An effect is hidden in both simulated arms.  Each arm is identified from one session and judged on
another; the diagnosis names what is missing and adds it; the law of the teleoperation compensates
what the model holds.  A machine then moves the leader, in free space and with the follower in a
gel:

    free     rms of the force that the operator feels where nothing is touched [N]
    contact  rms of what is felt less what the gel does, f_m - f_s [N]

Both for a law with force sensors and for its transform without any, and for three models: none
(the published parameters of the rig file, no friction), the fitted base model, the diagnosed one.
Nothing of the simulator is read.
"""

from __future__ import annotations

import argparse
import dataclasses
import multiprocessing
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil import registry, terminal
from hil.diagnosis.engine import diagnose
from hil.diagnosis.types import Diagnosis
from hil.errors import ConfigError, DataError, DeviceError, plural
from hil.estimate import compensation_tables
from hil.experiments import transparency as rig
from hil.experiments import without_force_sensors
from hil.experiments.pages import SeedMean, bars, made_with
from hil.interrupt import with_its_parent
from hil.models.files import write_model
from hil.models.model import RobotModel, base_model
from hil.record.mcap_read import load
from hil.rig.config import ControllerConfig, RigConfig, load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.teleop import force_sensor_free, law_parameters
from hil.teleop.rig_designs import ArmImpedances
from hil.terminal import Found
from hil.toml import parse
from hil.userfile import write_text
from hil.work import on_one_thread

#: Hidden in both arms: five laws of friction, and the joint.
_EFFECTS = (
    ("stribeck", "joint2"),
    ("presliding", "joint2"),
    ("coupled-friction", "joint2"),
    ("position-friction", "joint1"),
    ("asymmetric-viscous", "joint1"),
)
_ARMS = ("leader", "follower")
MODEL_STAGES = ("as built", "fitted", "diagnosed")
SENSOR_CASES = ("with sensors", "without")
#: Motion of the operator's machine [Hz], [m]; gel [N/m^1.3]; length of a session on it [periods].
_HZ, _SIZE, _GEL, SESSION_PERIODS, _SETTLE = 0.7, (0.01, 0.02, 0.01), 400.0, 4, 2.0
IDENTIFIED_S = 20.0
#: Shares of the modelled friction that are compensated; the largest with which all laws run.
SHARES = (1.0, 0.8, 0.6)
_SEEDS, _QUICK_SEEDS, _QUICK_EFFECTS = 10, 2, 1


@dataclass(frozen=True)
class CircleRow:
    """One effect with one seed.

    Parameters
    ----------
    effect, joint : str
        Hidden in both arms; empty: nothing is hidden.
    seed : int
        Of the noise and of the motions.
    named : tuple of str
        What the diagnosis added to the leader and to the follower.
    right : bool
        Whether that is the effect on its joint, in both arms, and nothing else.
    error : tuple of 2 floats
        Held-out error of the worst joint over its noise floor, base and diagnosed model; the worse
        of both arms.
    share : float
        Of the modelled friction, compensated.
    free, contact : dict
        Model -> law -> [N].
    """

    effect: str
    joint: str
    seed: int
    named: tuple[str, ...]
    right: bool
    error: tuple[float, float]
    share: float
    free: dict[str, dict[str, float]]
    contact: dict[str, dict[str, float]]


def hidden(effect: str, joint: str) -> dict[str, Any]:
    """Table ``[simulation]`` of an effect in both arms."""
    if not effect:
        return {}
    rows = [{"effect": effect, "arm": arm, "joint": joint, "amplitude": 1.0} for arm in _ARMS]
    return {"hidden": rows}


def identifying(folder: Path, effect: str, joint: str, seed: int, motion: int) -> Path:
    """A session that identifies both arms."""
    config = load_rig(
        rig_path("identify"),
        {"simulation": hidden(effect, joint), "controller": {"parameters": {"seed": motion}}},
    )
    path = folder / f"identify-{motion}.mcap"
    runner.run_session(config, IDENTIFIED_S, seed, "lockstep", path).enabled()
    return path


def _law_of(models: Mapping[str, str], share: float, kind: str) -> dict[str, Any]:
    """Parameters of the law for these models; without any, the rig file's own arms."""
    settings = without_force_sensors.LAW | {"friction_share": share}
    if models:
        given, axes = rig.arm_parameters(models, settings)
    else:
        own = load_rig(rig_path("lawrence")).controller.parameters
        gains = {f"c{k}" for k in range(1, 9)}
        given = {k: v for k, v in own.items() if k not in gains} | settings
        kind_of = registry.load("hil.controllers", "lawrence").Config
        none = {"c1": [0.0] * 3, "c7": [0.0] * 3}
        axes = ArmImpedances.of(parse(kind_of, none | given, "experiment"))
    designs = without_force_sensors.four_channel_designs(axes)
    if kind == SENSOR_CASES[1]:
        designs = [force_sensor_free.transform(d) for d in designs]
    return given | law_parameters.law_table(designs)


def rig_of(law: Mapping[str, Any], effect: str, joint: str, gel: float | None) -> RigConfig:
    """Rig with the effect, a machine on the leader, and a gel 20 mm above home or none."""
    operator = {"kind": "mechanical", "frequency": _HZ, "size": list(_SIZE), "onset": 1.0}
    below = 1.0 if gel is None else -0.02
    simulation = {"operator": operator, "gel": {"below_home": below, "stiffness": gel}}
    config = load_rig(rig_path("lawrence"), {"simulation": simulation | hidden(effect, joint)})
    controller = ControllerConfig("lawrence", config.controller.arms, dict(law))
    return dataclasses.replace(config, controller=controller)


def felt(config: RigConfig, path: Path, seed: int) -> tuple[float, float]:
    """Rms of the force felt, and of it less the force on the follower, over whole periods [N]."""
    runner.run_session(config, _SETTLE + SESSION_PERIODS / _HZ, seed, "lockstep", path).enabled()
    n = round(SESSION_PERIODS / _HZ / rig.PERIOD)
    forces = []
    for arm, sign in zip(_ARMS, (1.0, -1.0), strict=True):
        wrench = load(path, arm).wrench
        if wrench is None:
            raise RuntimeError("a session of this rig has forces")
        forces.append(sign * wrench[-n:, :3])
    return _rms(forces[0]), _rms(forces[0] - forces[1])


def _rms(force: Any) -> float:
    return float(np.sqrt(np.mean(np.sum((force - force.mean(axis=0)) ** 2, axis=1))))


def circle_of(effect: str, joint: str, seed: int) -> CircleRow:
    """The whole circle for one effect and seed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = [identifying(folder, effect, joint, 10 * seed + k, 3 * seed + k) for k in (0, 1)]
        models: dict[str, dict[str, str]] = {m: {} for m in MODEL_STAGES}
        found: dict[str, Diagnosis] = {}
        for arm in _ARMS:
            one, other = (load(path, arm) for path in paths)
            d = found[arm] = diagnose([one], base_model(one.robot, arm), [other])
            # corrections without a name stay out: the loop compensates laws
            last = _compensable(d.ladder[-1 - d.corrected].result.model)
            for kind, model in (
                (MODEL_STAGES[1], d.ladder[0].result.model),
                (MODEL_STAGES[2], last),
            ):
                models[kind][arm] = str(folder / f"{arm}-{kind}.toml")
                write_model(model, models[kind][arm])
        share, free, contact = _sessions(models, effect, joint, folder, seed)
    named = tuple(
        " + ".join(f"{f.effect}@{f.joint}" for f in d.findings) or "nothing" for d in found.values()
    )
    ends = [
        [float(np.max(d.ladder[k].heldout.rms / d.noise)) for d in found.values()] for k in (0, -1)
    ]
    wanted = f"{effect}@{joint}" if effect else "nothing"
    return CircleRow(
        effect,
        joint,
        seed,
        named,
        all(text == wanted for text in named),
        (max(ends[0]), max(ends[1])),
        share,
        free,
        contact,
    )


def _compensable(model: RobotModel) -> RobotModel:
    """The model without the effects for which the loop has no compensation, such as a delay."""
    for name in dict.fromkeys(use.type for use in model.effects):
        if f"effect {name!r} cannot be compensated" in _why(model):
            model = replace(model, effects=tuple(u for u in model.effects if u.type != name))
    return model


def _why(model: RobotModel) -> str:
    """What speaks against compensating a model; empty: nothing."""
    try:
        compensation_tables.compensated_values(model)
    except ConfigError as error:
        return str(error)
    return ""


def _sessions(
    models: Mapping[str, Mapping[str, str]], effect: str, joint: str, folder: Path, seed: int
) -> tuple[float, dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    """Share, and newtons of all models and laws, at the largest share with which all run."""
    why = ""
    for share in SHARES:
        free: dict[str, dict[str, float]] = {m: {} for m in models}
        contact: dict[str, dict[str, float]] = {m: {} for m in models}
        try:
            for m, paths in models.items():
                for kind in SENSOR_CASES:
                    law = _law_of(paths, share, kind)
                    path = folder / "teleop.mcap"
                    free[m][kind] = felt(rig_of(law, effect, joint, None), path, seed)[0]
                    contact[m][kind] = felt(rig_of(law, effect, joint, _GEL), path, seed)[1]
            return share, free, contact
        except (ConfigError, DeviceError, DataError) as error:
            why = str(error)
    raise DataError(f"{effect} on {joint}, seed {seed}: no share of friction runs: {why}")


def _case(words: tuple[str, str, int]) -> CircleRow:
    with on_one_thread():
        return circle_of(*words)


def study(
    seed: int = 1,
    quick: bool = False,
    workers: int = 1,
    report: Callable[[str], None] = lambda _: None,
) -> list[CircleRow]:
    """All effects, and none, with all seeds; the same numbers for any number of workers.

    Parameters
    ----------
    seed : int
        The first.
    quick : bool
        One effect, and none, with two seeds.
    workers : int
        Processes.
    report : callable
        Takes a line for every case that is done.
    """
    effects = _EFFECTS[:_QUICK_EFFECTS] if quick else _EFFECTS
    seeds = range(seed, seed + (_QUICK_SEEDS if quick else _SEEDS))
    todo = [(e, j, s) for e, j in (*effects, ("", "")) for s in seeds]
    rows = []
    context = multiprocessing.get_context("spawn")
    with context.Pool(min(workers, len(todo)), with_its_parent) as pool:
        for row in pool.imap(_case, todo):
            rows.append(row)
            report(f"{row.effect or 'nothing hidden'}, seed {row.seed}: {', '.join(row.named)}")
    return rows


@dataclass(frozen=True)
class CircleSummary:
    """An effect over its seeds; every figure with the half width of its 95 % interval.

    Parameters
    ----------
    effect, joint : str
        Which; empty: nothing hidden.
    right, cases : int
        How often the effect alone was named in both arms, of how many.
    error : tuple of 2 floats
        Mean held-out error over the noise floor, base and diagnosed.
    free, contact : dict
        Law -> model -> (mean, half width) [N].
    """

    effect: str
    joint: str
    right: int
    cases: int
    error: tuple[float, float]
    free: dict[str, dict[str, tuple[float, float]]]
    contact: dict[str, dict[str, tuple[float, float]]]


def summaries(rows: Sequence[CircleRow]) -> list[CircleSummary]:
    """Every effect over its seeds, in order."""
    out = []
    for effect, joint in dict.fromkeys((r.effect, r.joint) for r in rows):
        own = [r for r in rows if r.effect == effect]
        error = np.mean([r.error for r in own], axis=0)
        free, contact = (
            {
                law: {m: _interval([getattr(r, part)[m][law] for r in own]) for m in MODEL_STAGES}
                for law in SENSOR_CASES
            }
            for part in ("free", "contact")
        )
        out.append(
            CircleSummary(
                effect,
                joint,
                sum(r.right for r in own),
                len(own),
                (float(error[0]), float(error[1])),
                free,
                contact,
            )
        )
    return out


def _interval(values: Sequence[float]) -> tuple[float, float]:
    found = SeedMean.of(values)
    return found.mean, found.half


_HEAD = ("hidden in both arms", "named", "error / floor", "law", "free [N]", "contact [N]")


def _cells(found: Sequence[CircleSummary]) -> list[list[str]]:
    """Rows of the table: as built -> fitted -> diagnosed."""
    out = []
    for s in found:
        for k, law in enumerate(SENSOR_CASES):
            first = [
                f"{s.effect} on {s.joint}" if s.effect else "nothing",
                f"{s.right} of {s.cases}",
                f"{s.error[0]:.2f} -> {s.error[1]:.2f}",
            ]
            out.append(
                [
                    *(first if k == 0 else ["", "", ""]),
                    law,
                    *(_falls(part[law]) for part in (s.free, s.contact)),
                ]
            )
    return out


def _falls(values: Mapping[str, tuple[float, float]]) -> str:
    """Means of the three models, and the half width of the last."""
    return (
        " -> ".join(f"{values[m][0]:.3f}" for m in MODEL_STAGES)
        + f" +- {values[MODEL_STAGES[-1]][1]:.3f}"
    )


def figure(found: Sequence[CircleSummary]) -> str:
    """Bars of the force felt in free space as SVG: three models an effect, law with sensors."""
    groups = {
        s.effect or "nothing hidden": [SeedMean(*s.free[SENSOR_CASES[0]][m]) for m in MODEL_STAGES]
        for s in found
    }
    title = "Force felt in free space [N], mean over the seeds, law with force sensors"
    return bars(title, MODEL_STAGES, groups)


def page(rows: Sequence[CircleRow], command: str, picture: str) -> str:
    """Page for the documentation."""
    found = summaries(rows)
    shares, seeds = sorted({r.share for r in rows}), {r.seed for r in rows}
    lines = [
        "# A hidden effect, found, added and felt no more",
        "",
        f"Printed by `{command}` on the simulated rig: {plural(len(seeds), 'seed')} an effect.",
        "",
        "An effect is hidden in both arms. Each arm is identified from one session of "
        f"{IDENTIFIED_S:g} s and judged on another.",
        "The diagnosis names what is missing and adds it, and the teleoperation law compensates "
        "what the model holds.",
        f"A machine then moves the leader at {_HZ:g} Hz, in free space and with the follower in a "
        "gel. *Free* is the force that",
        "the operator feels where nothing is touched. *Contact* is the rms of what is felt less "
        "what the gel does. Each cell",
        "shows the law with the rig file's model, with the fitted base model, and with the "
        "diagnosed model; the interval",
        "(95 %) is that of the last one over the seeds.",
        "",
        f"![Force felt in free space]({picture})",
        "",
        "| " + " | ".join(_HEAD) + " |",
        "|" + "---|" * len(_HEAD),
        *("| " + " | ".join(line) + " |" for line in _cells(found)),
        "",
        *_read(found),
        "",
        "Share of the modelled friction that is compensated: "
        + ", ".join(f"{100 * s:.0f} %" for s in shares)
        + " (the largest with which all laws of a case run).",
        "",
        "The thesis compensates friction with a model of its own choice and does not ask which "
        "effect is missing; there is",
        "no figure of it to compare with.",
        "",
    ]
    return "\n".join(lines)


def _read(found: Sequence[CircleSummary]) -> list[str]:
    """What the table says, in sentences made from its numbers."""
    named = [s for s in found if s.effect]
    lines = []
    for part, what in (("free", "force felt in free space"), ("contact", "error in contact")):
        for law in SENSOR_CASES:
            first, last = (
                float(np.mean([getattr(s, part)[law][m][0] for s in named]))
                for m in (MODEL_STAGES[1], MODEL_STAGES[2])
            )
            sensors = " force sensors" if law == SENSOR_CASES[1] else ""
            lines.append(
                f"- {law.capitalize()}{sensors}: the {what} is "
                f" {first:.3f} N with the fitted base models and {last:.3f} N with the diagnosed "
                f"ones, {100 * abs(1 - last / first):.0f} % {'less' if last <= first else 'more'}."
            )
    return lines


def command(args: argparse.Namespace) -> Found:
    """Effects hidden in both arms: found, added, compensated; what the operator feels falls."""
    rows = study(args.seed, args.quick, args.workers, terminal.log)
    found = summaries(rows)
    if args.report:
        place = Path(args.report).with_suffix(".svg")
        command = made_with("hidden-effect", args.report, args.seed, " --quick" * args.quick)
        terminal.write_page(args.report, page(rows, command, place.name))
        write_text(place, figure(found))
    text = (
        f"{terminal.table(list(_HEAD), _cells(found))}\n"
        "  newtons with the rig file's model -> the fitted base model -> the diagnosed model, "
        "+- 95 %"
    )
    return text, {
        "rows": [dataclasses.asdict(r) for r in rows],
        "summaries": [dataclasses.asdict(s) for s in found],
    }
