"""`hil design` of a law over a channel with delay: what it asks of the loop, and its rig file."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from typing import Any

from hil import outputs, terminal
from hil.controllers import delayed
from hil.errors import ConfigError
from hil.rig.config import RigConfig
from hil.rig.open import build_controller
from hil.runtime import session
from hil.toml import parse
from hil.userfile import write_text

#: The law, its schemes by what `--design` calls them, and what each of them costs.
LAW = "delayed"
SCHEMES: Mapping[str, str] = {
    "passivity": "about half of the stiffness at 30 ms; less with every further millisecond",
    "waves": "soft beyond 10 ms: the stiffness felt is about `wave` over the delay",
    "tanks": "as passivity, with more drag; little stiffness is left at 300 ms",
    "model": "nothing while the environment stands still; a new contact is felt a round trip late",
}
#: What --set takes: the numbers of the law, and its channels.
NUMBERS = tuple(
    f.name
    for f in dataclasses.fields(delayed.DelayedConfig)
    if isinstance(f.default, (int, float)) and not isinstance(f.default, bool)
)
CHANNELS = ("forward", "backward")


_CHANNEL = (
    "  delay          the channel gives out no more energy than was put in, whatever its",
    "                 delay, jitter and loss: no margin is looked for",
)
_MODEL = (
    "  delay          the leader touches a model of the environment, and no force goes through the",
    "                 channel: no margin is looked for",
)


def judge(args: argparse.Namespace, config: RigConfig, settings: Mapping[str, Any]) -> int:
    """Make the law, judge it as `hil run` does, print it, and write the rig file."""
    for word in ("fsf", "model", "report"):
        if getattr(args, word):
            raise ConfigError(
                f"--{word} means nothing for the law {LAW}, which has no c1..c8 and no fitted "
                "model; leave it out, or choose a design with c1..c8"
            )
    own = config.controller.name == LAW
    given: dict[str, Any] = session.plain(config.controller.parameters) if own else {}
    given |= {"scheme": args.design} if args.design else {}
    given |= {k: int(v) if k == "seed" else v for k, v in settings.items()}
    controller = dataclasses.replace(config.controller, name=LAW, parameters=given)
    made = dataclasses.replace(config, controller=controller)
    law = parse(delayed.DelayedConfig, given, "controller.parameters")
    trouble = ""
    try:
        build_controller(made)
    except ConfigError as error:
        trouble = str(error)
    period = config.loop.period_ns * 1e-9
    if args.json:
        told: dict[str, Any] = {"law": LAW, "scheme": law.scheme, "parameters": given}
        told |= {"refused": trouble, "borne": delayed.borne(period)}
        terminal.emit({"schema": "hil.design/1", **told, "asked": delayed.asked(law, period)})
    else:
        terminal.out(text(law, period, trouble))
    if trouble:
        raise ConfigError(f"{args.output or 'this design'} is refused: {trouble}")
    if args.output:
        with outputs.writing(args.output):
            write_text(args.output, session.to_toml(session.plain(made)))
        if not args.json:
            terminal.out(f"\n{args.output}: run it with 'hil run {args.output} -o s.mcap'")
    return 0


def text(law: delayed.DelayedConfig, period: float, trouble: str) -> str:
    """The law for a terminal."""
    ways = [
        f"{what} {1e3 * way.delay:g} ms, jitter {1e3 * way.jitter:g} ms, {100 * way.loss:g} % lost"
        for what, way in (("there", law.forward), ("back", law.backward))
    ]
    most = delayed.borne(period)
    rows = [[what, f"{value:.3g}"] for what, value in delayed.asked(law, period).items()]
    verdict = f"REFUSED: {trouble}" if trouble else "may run: every part is below it"
    return "\n".join(
        [
            f"law {LAW}, scheme {law.scheme}; {'; '.join(ways)}",
            "",
            terminal.table(["spring and damper", "K T + 2 B [N s/m]"], rows),
            f"  each must be below {most:.3g} N s/m, which a rotor before its cable bears at "
            f"{1e3 * period:g} ms",
            "",
            *(_MODEL if law.scheme == "model" else _CHANNEL),
            f"  what it costs  {SCHEMES[law.scheme]}",
            "                 drag and stiffness of all schemes over delay: 'hil bench teleop'",
            f"  {verdict}",
        ]
    )
