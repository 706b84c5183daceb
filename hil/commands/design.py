"""`hil design`: a teleoperation controller on paper before it runs, and its rig file."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil import registry
from hil.commands import common, designtext, outputs, plugins
from hil.errors import ConfigError, unknown
from hil.rig.config import RigConfig, load_rig
from hil.rig.open import build_controller
from hil.runtime import session
from hil.teleop import architecture, force_sensor_free, law_parameters, rig_designs, sampled_loop
from hil.teleop.rig_designs import Arms
from hil.teleop.summary import Summary, summarise
from hil.toml import parse
from hil.userfile import read_text

EXAMPLE = (
    "hil design rigs/lawrence.toml --design position-force --set stiffness=200 -o own.toml\n"
    "  hil run own.toml -o s.mcap"
)
REPORT = "design"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("rig", metavar="RIG.toml", help="rig file")
    parser.add_argument(
        "--design",
        choices=(*architecture.DESIGNS, "optimised"),
        help="named design; default: the controller of the rig file",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help=f"what the design is made from (repeatable): {', '.join(rig_designs.WISHES)}; "
        f"of the law: {', '.join(rig_designs.REAL)}; of the optimised design: "
        f"{', '.join(rig_designs.TASK)}",
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
    plugins.load_installed()
    config = load_rig(args.rig)
    settings = rig_designs.settings(args.set)
    parameters, notes = _parameters(args, config, settings)
    law_type = registry.load("hil.controllers", "lawrence").Config
    law = parse(law_type, parameters, "controller.parameters")
    period = config.loop.period_ns * 1e-9
    loops = law_parameters.loops_of(law)
    found = [summarise(loop, period) for loop in loops]
    trouble = _trouble(loops, period) or _with_estimators(config, parameters)
    if args.report:
        with outputs.writing(args.report):
            Path(args.report).write_text(designtext.page(loops, found, trouble), encoding="utf-8")
    if args.json:
        common.emit(_json(parameters, found, trouble) | {"active": notes})
    else:
        common.out(designtext.text(loops, found, trouble) + "".join(f"\n  {n}" for n in notes))
    if trouble:
        raise ConfigError(f"{args.output or 'this design'} is {_not(args.output)}: {trouble}")
    if args.output:
        _write(args.output, config, parameters)
        if not args.json:
            common.out(f"\n{args.output}: run it with 'hil run {args.output} -o s.mcap'")
    return 0


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
                f"--design: {', '.join((*architecture.DESIGNS, 'optimised'))}"
            )
    given |= rig_designs.models(_models(args.model), config)
    given |= {k: v for k, v in settings.items() if k in rig_designs.REAL}
    wishes = {k: v for k, v in settings.items() if k in rig_designs.WISHES}
    law_type = registry.load("hil.controllers", "lawrence").Config
    base = parse(law_type, {"c1": [0.0] * 3, "c7": [0.0] * 3} | given, "controller.parameters")
    arms = Arms.of(base)
    task = {k: v for k, v in settings.items() if k in rig_designs.TASK}
    _fits(args.design, wishes, task)
    notes: list[str] = []
    if args.design is None:
        designs = law_parameters.designs_of(base)
    elif args.design == "optimised":
        found = rig_designs.optimised(task, arms, base)
        designs, notes = [f.design for f in found], designtext.reasons(found)
    else:
        designs = rig_designs.designs(args.design, wishes, arms)
    if args.fsf:
        designs = [force_sensor_free.transform(d) for d in designs]
    return given | law_parameters.table(designs), notes


def _fits(name: str | None, wishes: Mapping[str, Any], task: Mapping[str, Any]) -> None:
    """Refuse settings that the chosen design does not read."""
    wrong = [] if name == "optimised" else list(task)
    wrong += list(wishes) if name in (None, "optimised") else []
    if wrong:
        raise ConfigError(
            f"--set {wrong[0]} means nothing for "
            f"{f'--design {name}' if name else 'the controller of the rig file'}; "
            f"named designs read {', '.join(rig_designs.WISHES)}, --design optimised "
            f"{', '.join(rig_designs.TASK)}"
        )


def _models(words: list[str]) -> dict[str, str]:
    out = {}
    for word in words:
        arm, _, path = word.partition("=")
        if arm not in ("leader", "follower") or not path:
            raise ConfigError(f"--model {word}: " + unknown("arm", arm, ("leader", "follower")))
        out[arm] = path
    return out


def _trouble(loops: list[sampled_loop.Loop], period: float) -> str:
    try:
        sampled_loop.refuse(loops, period)
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


def _json(parameters: Mapping[str, Any], found: list[Summary], trouble: str) -> dict[str, Any]:
    return {
        "schema": "hil.design/1",
        "parameters": session.plain(parameters),
        "refused": trouble,
        "axes": [designtext.finite(dataclasses.asdict(s)) for s in found],
    }


def _write(path: str, config: RigConfig, parameters: Mapping[str, Any]) -> None:
    arms = config.controller.arms
    law = dataclasses.replace(config.controller, name="lawrence", parameters=parameters, arms=arms)
    text = session.to_toml(session.plain(dataclasses.replace(config, controller=law)))
    with outputs.writing(path):
        Path(path).write_text(text, encoding="utf-8")


def _is_rig(path: Path) -> bool:
    try:
        text = read_text(path)
    except (OSError, ValueError):
        return False
    return not text.strip() or 'schema = "hil.rig/' in text


def _is_report(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(4096).decode("utf-8", "replace")
    return not head.strip() or designtext.TITLE in head
