"""`hil design`: a controller on paper before it runs, its tables, page and rig file."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hil import outputs, registry, terminal
from hil.errors import ConfigError, unknown
from hil.models import catalogue
from hil.report import elements as html
from hil.report.html import program_rows
from hil.rig.check import arm_description
from hil.rig.config import RigConfig, load_rig
from hil.rig.open import build_controller
from hil.runtime import session
from hil.teleop import (
    architecture,
    force_sensor_free,
    gate,
    law_parameters,
    rig_designs,
    summary,
)
from hil.teleop.architecture import FORCE_GAINS, MOTION, Design
from hil.teleop.optimise import OptimisedDesign
from hil.teleop.rig_designs import ArmImpedances
from hil.teleop.sampled_loop import SampledLoop
from hil.teleop.summary import DesignSummary, summarise
from hil.toml import parse
from hil.userfile import read_text, write_text

_TITLE = "Design of a teleoperation controller"
#: Figure of merit -> format, unit and what it should be.
ROWS = (
    ("sensitivity", "dz_t/dz_e / (kp kf), rms 0.2-5 Hz", "1 = transparent"),
    ("sensitivity_dc", "dz_t/dz_e / (kp kf) at rest", ""),
    ("tracking_free", "tracking error to 1 Hz, free", "0"),
    ("tracking_contact", "tracking error to 1 Hz, contact", "0"),
    ("width", "width of impedance [N s/m]", "large"),
    ("llewellyn", "absolute stability margin", ">= 0"),
    ("passive", "passivity, min eigenvalue", ">= 0"),
    ("bounded", "min Re z_t, bounded world [N s/m]", ">= 0"),
    ("D", "D = -det Q", "far from 0"),
    ("kappa", "conditioning of Q", "<= 3, at most 9"),
    ("fsf_smallest", "force-free loop gain", "above the sampled bound"),
    ("fsf_bound", "sampled bound of that gain", ""),
)
MARGINS = (
    ("pole", "rightmost pole of all pairs [rad/s]", "< 0 (0: free drift)"),
    ("radius", "sampled eigenvalue", "condition: <= 1"),
    ("delay_s", "round-trip delay margin [s]", "above the channel's delay"),
)
#: Which rows decide; see `hil.teleop.sampled_loop`.
_DECIDES = (
    "conditions: gains that can be realised, and the sampled eigenvalue with every declared "
    "operator and environment;\n  the other rows are goals and may be missed"
)


def _text(loops: Sequence[SampledLoop], found: Sequence[DesignSummary], trouble: str) -> str:
    """Everything for a terminal."""
    head = ["", *(f"axis {loop.axis}" for loop in loops)]
    lines = [f"design {found[0].name}", "", terminal.table(head, _gain_rows(loops)), ""]
    lines.append(terminal.table([*head, "goal"], merits(found)))
    told = _missed(found)
    lines += ["", f"  {_DECIDES}", "  transparent: " + ("yes" if not told else "no")]
    lines += [f"    {m}" for m in told]
    lines.append(f"  decisive pair: {found[0].margins.pair}")
    lines.append(f"  REFUSED: {trouble}" if trouble else "  may run: both conditions are met")
    return "\n".join(lines)


def _missed(found: Sequence[DesignSummary]) -> list[str]:
    """Missed conditions of transparency, each once with the axes that miss it."""
    axes: dict[str, list[str]] = {}
    for s in found:
        for condition in s.missed:
            axes.setdefault(condition, []).append(s.axis)
    return [f"axis {', '.join(names)}: {condition}" for condition, names in axes.items()]


def _gain_rows(loops: Sequence[SampledLoop]) -> list[list[str]]:
    """Rows of gains, one column an axis."""
    designs = [loop.design for loop in loops]
    rows = []
    for name in sorted((*MOTION, *FORCE_GAINS)):
        rows.append([f"{name}{' (k, b, a)' if name in MOTION else ''}", *_cells(designs, name)])
    for arm, role in (("leader", "master"), ("follower", "slave")):
        rows.append([f"{arm} mass [kg]", *(f"{getattr(d, role).m:.4g}" for d in designs)])
    return rows


def _cells(designs: Sequence[Design], name: str) -> list[str]:
    values = [getattr(d, name) for d in designs]
    if name in FORCE_GAINS:
        return [f"{v:.4g}" for v in values]
    return [f"{v.k:.4g}, {v.b:.4g}, {v.a:.4g}" for v in values]


def merits(found: Sequence[DesignSummary]) -> list[list[str]]:
    """Rows of figures of merit."""
    rows = [[said, *(_number(getattr(s, k)) for s in found), goal] for k, said, goal in ROWS]
    for k, said, goal in MARGINS:
        rows.append([said, *(_number(getattr(s.margins, k)) for s in found), goal])
    return rows


def _number(x: float) -> str:
    if x == 0.0 or abs(x) < 1e-9:
        return "0"
    if math.isinf(x):
        return "infinite" if x > 0.0 else "-infinite"
    return f"{x:.5g}" if 0.99 < x < 1.01 else f"{x:.3g}"


def reasons(found: Sequence[OptimisedDesign]) -> list[str]:
    """Why each optimised axis is not more sensitive: its active constraints."""
    lines = []
    for axis, f in zip("xyz", found, strict=True):
        lines.append(f"axis {axis}: sensitivity {f.sensitivity:.3f}, held back by (shadow price)")
        lines += [f"  {a.text} ({a.price:.2g})" for a in f.active if a.price > 1e-3]
    return lines


def page(loops: Sequence[SampledLoop], found: Sequence[DesignSummary], trouble: str) -> str:
    """Page with the plots."""
    head = ["", *(f"axis {loop.axis}" for loop in loops)]
    axes = list(loops)
    figures = (
        (
            summary.bode_plot(axes),
            "bode",
            f"Hybrid matrix; transparent is h11 = h22 = 0, h12 = {axes[0].design.force_scale:g}, "
            f"h21 = {-axes[0].design.motion_scale:g}. Dashed: ideal; solid: with filters and "
            "delays.",
        ),
        (
            summary.impedance_plot(axes),
            "width",
            "What the operator feels: the width between free "
            "and stiffest is all that can be told apart.",
        ),
        (
            summary.stability_plot(axes),
            "margins",
            "Above the dashed lines: stable with every "
            "passive operator and environment; passive; all reflections admissible.",
        ),
        (
            summary.region_plot(axes[0]),
            "region",
            f"Axis {axes[0].axis}: stability circles, reference 20 N s/m.",
        ),
    )
    body = f"<h1>{_TITLE}</h1>" + _verdict(found, trouble)
    body += html.section("Gains", html.html_table(head, _gain_rows(loops)))
    body += html.section("Figures of merit", html.html_table([*head, "goal"], merits(found)))
    body += html.section("Plots", *(embed(f, name, said) for f, name, said in figures))
    body += html.section("Provenance", html.html_table(["", ""], program_rows(), (0, 1)))
    return html.document(_TITLE, body)


def _verdict(found: Sequence[DesignSummary], trouble: str) -> str:
    """What `hil design` says of a design: whether it may run, and whether it is transparent."""
    told = _missed(found)
    lines = [f"Refused: {trouble}."] if trouble else []
    lines.append(
        f"It is not transparent: {'; '.join(told)}."
        if told
        else "It is transparent within the band."
    )
    lines.append(f"Decisive pair of operator and environment: {found[0].margins.pair}.")
    headline = f"The design {found[0].name} " + (
        "is refused; 'hil run' would not start it."
        if trouble
        else "may run: both conditions are met."
    )
    return html.verdict_box(headline, lines, "#D55E00" if trouble else "#009E73")


def embed(figure: Any, name: str, caption: str) -> str:
    """HTML of a figure with its caption: data for the script that the page holds already."""
    data = json.loads(figure.to_json())
    drawn = [name, data["data"], data["layout"], {"displaylogo": False}]
    told = json.dumps(drawn, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f"<figure><figcaption>{html.escape(caption)}</figcaption>"
        f'<div id="{name}" class="plotly-graph-div"></div>'
        f'<script type="application/json" class="figure">{told}</script></figure>'
    )


EXAMPLE = (
    "hil design lawrence --design position-force --set stiffness=200 -o own.toml\n"
    "  hil run own.toml -o s.mcap"
)
_REPORT = "design"
#: The law, its schemes by what `--design` calls them, and what each of them costs.
_DELAYED = "delayed"
SCHEME_COSTS: Mapping[str, str] = {
    "passivity": "half of the stiffness even without delay, a third at 30 ms, a tenth at 300 ms",
    "waves": "soft beyond 10 ms: the stiffness felt is about `wave` over the delay",
    "tanks": "as passivity, with more drag; little stiffness is left at 300 ms",
    "model": "nothing while the environment stands still; a new contact is felt a round trip late",
}
#: What --set takes of it: its numbers and its channels.
SETTABLE_NUMBERS = (
    "stiffness",
    "damping",
    "force_scale",
    "leader_damping",
    "seed",
    "reserve",
    "wave",
    "smooth",
    "level",
    "share",
    "fill",
    "touch",
    "forget",
    "expected",
    "blend",
    "stiffest",
    "brake",
    "forward",
    "backward",
)
#: Designs that are made by name, those that are searched for, and laws over a delay.
CHOICES = (*architecture.DESIGNS, "transparent", "optimised", *SCHEME_COSTS)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("rig", metavar="RIG.toml", help="rig file")
    parser.add_argument(
        "--design",
        choices=CHOICES,
        help="named design; transparent and optimised are searched for; "
        f"{', '.join(SCHEME_COSTS)} are laws over a channel with delay; default: the "
        "controller of the rig file",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help=f"what the design is made from (repeatable): {', '.join(rig_designs.WISH_KEYS)}; "
        f"of the law: {', '.join(rig_designs.REAL)}; of the optimised design: "
        f"{', '.join(rig_designs.TASK)}; of the transparent design: accelerations=0 or 1; of a law "
        f"over a delay: {', '.join(SETTABLE_NUMBERS)}",
    )
    parser.add_argument("--fsf", action="store_true", help="transform it to need no force sensor")
    parser.add_argument(
        "--model",
        action="append",
        default=[],
        metavar="ARM=FITTED.toml",
        help="identified model of an arm, for computed torque and friction (repeatable)",
    )
    parser.add_argument("--report", metavar="D.html", help="write the plots")
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")
    parser.add_argument(
        "-o",
        "--output",
        metavar="RIG.toml",
        help="write a rig file with this controller for 'hil run'; refused for a bad design",
    )


def run(args: argparse.Namespace) -> int:
    """Make, judge, print, write."""
    outputs.check(args.output, ".toml", [args.rig], _is_rig, "a rig file")
    outputs.check(args.report, ".html", [args.rig], _is_report, "a design report")
    catalogue.load_installed()
    config = load_rig(args.rig)
    if config.controller.name in COUPLINGS and args.design is None:
        return _judge_coupling(args, config)
    over_delay = args.design in SCHEME_COSTS
    for arm in config.controller.arms:
        if len(config.arms[arm].joints) != 3:
            raise ConfigError(
                f"{args.rig}: arm {arm!r} has {len(config.arms[arm].joints)} joints; laws with "
                f"c1..c8 are of arms of three. {' and '.join(COUPLINGS)}, of two arms of their "
                "own URDFs, are judged as the rig file has them, without --design"
            )
    if over_delay or (args.design is None and config.controller.name == _DELAYED):
        return _judge_delayed(args, config, rig_designs.design_settings(args.set, SETTABLE_NUMBERS))
    settings = rig_designs.design_settings(args.set)
    parameters, notes = _parameters(args, config, settings)
    law_type = registry.load("hil.controllers", "lawrence").Config
    law = parse(law_type, parameters, "controller.parameters")
    period = config.loop.period_ns * 1e-9
    loops = [
        dataclasses.replace(loop, real=loop.real.held(period))
        for loop in law_parameters.loops_of(law)
    ]
    found = [summarise(loop, period, settings.get("weight", 0.0)) for loop in loops]
    trouble = _trouble(loops, period) or _with_estimators(config, parameters)
    if args.report:
        with outputs.writing(args.report):
            write_text(args.report, page(loops, found, trouble))
    if args.json:
        terminal.emit(_json(parameters, found, trouble) | {"active": notes})
    else:
        notes = [*notes, *_channels(law, period)]
        terminal.out(_text(loops, found, trouble) + "".join(f"\n  {n}" for n in notes))
    if trouble:
        raise ConfigError(f"{args.output or 'this design'} is {_not(args.output)}: {trouble}")
    if args.output:
        _write(args.output, config, parameters)
        if not args.json:
            terminal.out(f"\n{args.output}: run it with 'hil run {args.output} -o s.mcap'")
    return 0


def _channels(law: Any, period: float, least: int = 0) -> list[str]:
    """What the loop makes of channels that are not at once."""
    if law.forward == law.backward == type(law.forward)():
        return []
    there, back = (way.told(period, least) for way in (law.forward, law.backward))
    return [f"channel in ticks of {1e3 * period:g} ms: there {there}; back {back}"]


#: Laws of two whole arms that are judged as they stand in the rig file, and what of them makes an
#: unstable one stable.
COUPLINGS = {"cartesian-coupling": gate.TIPS, "joint-coupling": gate.JOINTS}


def _judge_coupling(args: argparse.Namespace, config: RigConfig) -> int:
    """Judge a law of whole arms over its set; nothing of it is designed here."""
    name = config.controller.name
    for word in ("set", "fsf", "model", "report", "output"):
        if getattr(args, word):
            raise ConfigError(
                f"--{word} means nothing for {name}, which is judged as the rig file has it; "
                "change [controller.parameters] there, or choose a law with --design"
            )
    known = registry.load("hil.controllers", name)
    law = parse(known.Config, config.controller.parameters, "controller.parameters")
    arms, period = config.controller.arms, config.loop.period_ns * 1e-9
    robots = tuple(arm_description(config.arms[arm]) for arm in arms)
    found = known.margin(law, arms, period, robots)
    trouble = ""
    try:
        gate.refuse_coupled(found, period, COUPLINGS[name])
    except ConfigError as error:
        trouble = str(error)
    if args.json:
        told = {"law": name, "refused": trouble, "coupled": dataclasses.asdict(found)}
        terminal.emit({"schema": "hil.design/1", **told})
    else:
        terminal.out(coupling_text(name, found, period, trouble))
    if trouble:
        raise ConfigError(f"{args.rig}: {trouble}")
    return 0


def coupling_text(name: str, found: gate.CoupledMargin, period: float, trouble: str) -> str:
    """What a law of whole arms was found to be."""
    growth = math.log(found.radius) / period
    delay = f"{1e3 * found.delay_s:.3g} ms" + (
        f" at most; beyond, unstable with {found.limit}" if found.limit else " and more"
    )
    return "\n".join(
        [
            f"law {name}, small motions about postures where it starts, arms without friction",
            "",
            f"  judged         {found.members} cases of postures, masses, hands and contacts",
            f"  growth         {growth:.2g} /s at {found.hz:.3g} Hz, with {found.where}",
            f"  more delay     {'none' if trouble else delay}",
            "",
            f"  REFUSED: {trouble}"
            if trouble
            else f"  may run: no mode grows by more than {gate.DRIFT:g} /s, which friction ends",
            "  'hil run' checks the same, without more delay",
        ]
    )


#: What bounds the energy that comes out of the channel, by scheme; no margin is looked for.
_CHANNEL = {
    "passivity": (
        "whatever delay, jitter and loss, the channel",
        "gives out little more energy than was put in and the reserve of each axis and side",
    ),
    "waves": (
        "whatever delay, jitter and loss, the channel",
        "gives out no more energy than was put in",
    ),
    "tanks": (
        "whatever delay, jitter and loss, what moves an",
        "arm is taken from its tank, full at the start, which braking the arm fills",
    ),
    "model": (
        "no force goes through the channel, and the",
        "leader touches a model; nothing bounds the energy by which the follower is moved late",
    ),
}


def _judge_delayed(args: argparse.Namespace, config: RigConfig, settings: Mapping[str, Any]) -> int:
    """Make the law, judge it as `hil run` does, print it, and write the rig file."""
    for word in ("fsf", "model", "report"):
        if getattr(args, word):
            raise ConfigError(
                f"--{word} means nothing for the law {_DELAYED}, which has no c1..c8 and no fitted "
                "model; leave it out, or choose a design with c1..c8"
            )
    delayed = registry.load("hil.controllers", _DELAYED)
    own = config.controller.name == _DELAYED
    given: dict[str, Any] = session.plain(config.controller.parameters) if own else {}
    if config.controller.name == "lawrence":
        given = _scaled(args, session.plain(config.controller.parameters))
    given |= {"scheme": args.design} if args.design else {}
    given |= {k: int(v) if k == "seed" else v for k, v in settings.items()}
    controller = dataclasses.replace(config.controller, name=_DELAYED, parameters=given)
    made = dataclasses.replace(config, controller=controller)
    law = parse(delayed.Config, given, "controller.parameters")
    trouble = ""
    try:
        build_controller(made)
    except ConfigError as error:
        trouble = str(error)
    period = config.loop.period_ns * 1e-9
    if args.json:
        told: dict[str, Any] = {"law": _DELAYED, "scheme": law.scheme, "parameters": given}
        told |= {"refused": trouble, "borne": delayed.borne(period)}
        told |= {"ringing": delayed.ringing(law, period)}
        terminal.emit({"schema": "hil.design/1", **told, "asked": delayed.asked(law, period)})
    else:
        parts = delayed.asked(law, period), delayed.borne(period), delayed.ringing(law, period)
        told_text = delayed_text(law, *parts, trouble)
        terminal.out("\n  ".join([told_text, *_channels(law, period, 1)]))
    if trouble:
        raise ConfigError(f"{args.output or 'this design'} is refused: {trouble}")
    if args.output:
        with outputs.writing(args.output):
            write_text(args.output, session.to_toml(session.plain(made)))
        if not args.json:
            terminal.out(f"\n{args.output}: run it with 'hil run {args.output} -o s.mcap'")
    return 0


def _scaled(args: argparse.Namespace, own: Mapping[str, Any]) -> dict[str, Any]:
    """The force scale of a rig of c1..c8 for a law over a delay, which scales no motion."""
    if own.get("motion_scale", 1.0) != 1.0:
        raise ConfigError(
            f"{args.rig} has motion_scale = {own['motion_scale']:g}, and --design {args.design} "
            "moves the follower as far as the leader; set motion_scale = 1 in "
            f"[controller.parameters], or choose {', '.join(architecture.DESIGNS)}"
        )
    return {"force_scale": own["force_scale"]} if "force_scale" in own else {}


def delayed_text(
    law: Any, asked: Mapping[str, float], most: float, ringing: float, trouble: str
) -> str:
    """The law over a channel with delay, for a terminal."""
    ways = [
        f"{what} {1e3 * way.delay:g} ms, jitter {1e3 * way.jitter:g} ms, {100 * way.loss:g} % lost"
        for what, way in (("there", law.forward), ("back", law.backward))
    ]
    rows = [[what, f"{value:.3g}"] for what, value in asked.items()]
    verdict = f"REFUSED: {trouble}" if trouble else "may run: all values are below"
    loop = [
        f"  gain round leader, channel and follower: {ringing:.2g}; it must be below 1, or the",
        "  force that goes round rings at the resonance of rotors and cables",
    ]
    return "\n".join(
        [
            f"law {_DELAYED}, scheme {law.scheme}; {'; '.join(ways)}",
            "",
            terminal.table(["spring and damper", "K T + 2 B [N s/m]"], rows),
            f"  each must be below {most:.3g} N s/m; with more, a rotor swings against its cable",
            *(loop if ringing else ()),
            "",
            "  delay          " + ("\n" + 17 * " ").join(_CHANNEL[law.scheme]),
            f"  what it costs  {SCHEME_COSTS[law.scheme]}",
            "                 drag and stiffness of all schemes over delay: 'hil bench teleop'",
            f"  {verdict}",
        ]
    )


def _not(output: str | None) -> str:
    return "not written" if output else "refused, 'hil run' would not start it"


def _parameters(
    args: argparse.Namespace, config: RigConfig, settings: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    """Parameters of the law, the rig's own or of a new design; and why it is not better."""
    given: dict[str, Any] = session.plain(config.controller.parameters)
    if config.controller.name != "lawrence":
        given = {}
        if args.design is None:
            raise ConfigError(
                f"{args.rig} runs {config.controller.name!r}, which has no c1..c8; choose one with "
                f"--design: {', '.join(CHOICES)}"
            )
    given |= rig_designs.models(_models(args.model), config)
    known = rig_designs.REAL + (rig_designs.SCALES if args.design else ())
    given |= {k: v for k, v in settings.items() if k in known}
    wishes = {k: v for k, v in settings.items() if k in rig_designs.WISHES}
    law_type = registry.load("hil.controllers", "lawrence").Config
    base = parse(law_type, {"c1": [0.0] * 3, "c7": [0.0] * 3} | given, "controller.parameters")
    arms = ArmImpedances.of(base)
    task = {k: v for k, v in settings.items() if k in rig_designs.TASK}
    search = {k: v for k, v in settings.items() if k in rig_designs.SEARCH}
    _fits(args.design, wishes, task, search)
    period = config.loop.period_ns * 1e-9
    notes: list[str] = []
    if args.design is None:
        designs = law_parameters.designs_of(base)
    elif args.design == "optimised":
        found = rig_designs.optimised(task, arms, base)
        designs, notes = [f.design for f in found], reasons(found)
    elif args.design == "transparent":
        best = rig_designs.transparent(base, arms, period, search, settings)
        designs, given = best.designs, given | best.filters
        notes = [
            f"{designs[0].name}: {best.error:.3g} from the transparent hybrid matrix (rms, 0.2-5 "
            f"Hz, in 1 and 10 N s/m); {best.refused} of {best.tried} would be nearer but do not run"
        ]
    else:
        scales = {k: getattr(base, k) for k in rig_designs.SCALES}
        designs = rig_designs.axis_designs(args.design, scales | wishes, arms)
    if args.fsf:
        designs = _without_sensors(base, designs, period)
    return given | law_parameters.law_table(designs), notes


def _without_sensors(base: Any, designs: Sequence[Design], period: float) -> list[Design]:
    """The designs without force sensors; one that is proposed instead runs on all axes."""
    loops = law_parameters.loops_of(dataclasses.replace(base, forces="measured"))

    def runs(near: Design) -> bool:
        gains = {c: getattr(near, c) for c in FORCE_GAINS}
        made = [force_sensor_free.transform(dataclasses.replace(d, **gains)) for d in designs]
        return all(
            gate.passes(dataclasses.replace(loop, design=d), period)
            for loop, d in zip(loops, made, strict=True)
        )

    return [force_sensor_free.transform(d, runs=runs) for d in designs]


#: What is not made from wishes, the scales apart.
_NO_WISHES = (None, "optimised", "transparent")


def _fits(
    name: str | None,
    wishes: Mapping[str, Any],
    task: Mapping[str, Any],
    search: Mapping[str, Any],
) -> None:
    """Refuse settings that the chosen design does not read."""
    wrong = [] if name == "optimised" else list(task)
    kept = rig_designs.SCALES if name else ()
    asked = [key for key, w in rig_designs.WISH_KEYS.items() if w in wishes and w not in kept]
    wrong += asked if name in _NO_WISHES else []
    wrong += [] if name == "transparent" else list(search)
    if wrong:
        scales = ", ".join(rig_designs.SCALES)
        raise ConfigError(
            f"--set {wrong[0]} means nothing for "
            f"{f'--design {name}' if name else 'the controller of the rig file'}; "
            f"named designs read {', '.join(rig_designs.WISH_KEYS)}, --design optimised "
            f"{scales}, {', '.join(rig_designs.TASK)}, --design transparent {scales}, "
            f"{', '.join(rig_designs.SEARCH)}"
        )


def _models(words: list[str]) -> dict[str, str]:
    out = {}
    for word in words:
        arm, _, path = word.partition("=")
        if arm not in ("leader", "follower") or not path:
            raise ConfigError(f"--model {word}: " + unknown("arm", arm, ("leader", "follower")))
        out[arm] = path
    return out


def _trouble(loops: list[SampledLoop], period: float) -> str:
    try:
        gate.refuse(loops, period)
    except ConfigError as error:
        return str(error)
    return ""


def _with_estimators(config: RigConfig, parameters: Mapping[str, Any]) -> str:
    """What 'hil run' would say of the law beside the estimators of the rig file."""
    if config.estimators:
        law = dataclasses.replace(config.controller, name="lawrence", parameters=parameters)
        try:
            build_controller(dataclasses.replace(config, controller=law))
        except ConfigError as error:
            return str(error)
    return ""


def _json(
    parameters: Mapping[str, Any], found: list[DesignSummary], trouble: str
) -> dict[str, Any]:
    return {
        "schema": "hil.design/1",
        "parameters": session.plain(parameters),
        "refused": trouble,
        "axes": [terminal.json_value(dataclasses.asdict(s)) for s in found],
    }


def _write(path: str, config: RigConfig, parameters: Mapping[str, Any]) -> None:
    arms = config.controller.arms
    law = dataclasses.replace(config.controller, name="lawrence", parameters=parameters, arms=arms)
    text = session.to_toml(session.plain(dataclasses.replace(config, controller=law)))
    with outputs.writing(path):
        write_text(path, text)


def _is_rig(path: Path) -> bool:
    try:
        text = read_text(path)
    except (OSError, ValueError):
        return False
    return not text.strip() or 'schema = "hil.rig/' in text


def _is_report(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(4096).decode("utf-8", "replace")
    return not head.strip() or _TITLE in head
