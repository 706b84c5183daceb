"""`hil bench identify`, `velocity`, `ukf`, `redesign` and `wire`: how long things take."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from hil.bench import identify, redesign, ukf, velocity, wire
from hil.commands import benchpage, common, identifytable, outputs
from hil.commands.benchpage import Found
from hil.runtime.realtime import arranged


def _identify(args: argparse.Namespace) -> Found:
    """How long identification and diagnosis take, beside peers."""
    outputs.check(args.report, ".md", (), identifytable.is_page, "a page of this benchmark")
    report = identify.run(figaroh=args.figaroh, report=lambda what: common.log(f"measuring {what}"))
    if args.report:
        with outputs.writing(args.report):
            Path(args.report).write_text(identifytable.page(report), encoding="utf-8")
    return identifytable.text(report), identifytable.data(report)


def _velocity(args: argparse.Namespace) -> Found:
    """Velocity estimators: error and delay of each, and what an update costs here."""
    benchpage.check(args.report)
    text = velocity.report()
    benchpage.write(args.report, text)
    rows = [
        [label, f"{velocity.cost_ns(name, options):.0f}"] for label, name, options in velocity.CASES
    ]
    cost = common.table(["estimator", "ns"], rows)
    data = {"rows": [vars(r) | {"delay_ms": None if r.delay_ms != r.delay_ms else r.delay_ms}
                     for r in velocity.compare()]}  # fmt: skip
    return f"{text}\nOne update of three channels on this machine\n{cost}", dict(data)


def _ukf(args: argparse.Namespace) -> Found:
    """Compiled elastic-transmission filter against filterpy."""
    f = ukf.measure()
    rows = [["compiled", f"{f.compiled_us:.2f}"], ["filterpy", f"{f.reference_us:.0f}"]]
    text = common.table(["filter of ten states", "us a step"], rows)
    text += f"\n  largest difference over {f.steps} steps: {f.worst:.1e} standard deviations\n\n"
    beside = [[said, f"{us:.1f}"] for said, us in f.loop_us.items()]
    text += common.table(["in the loop, one arm", "us a tick"], beside)
    return text, dict(vars(f))


def _redesign(args: argparse.Namespace) -> Found:
    """Sensitivity-optimised designs: what they reach, and how long they take."""
    rows = redesign.measure()
    cells = [
        [r.task, f"{r.sensitivity:.3f}", f"{r.kappa:.2f}", f"{r.agreeing} of {r.starts}",
         f"{r.cold_s:.2f}", f"{r.warm_s:.2f}"]
        for r in rows
    ]  # fmt: skip
    head = ["task", "sensitivity", "condition of Q", "agree", "from afar s", "re-design s"]
    return common.table(head, cells), {"rows": [vars(r) for r in rows]}


def _wire(args: argparse.Namespace) -> Found:
    """Microseconds a tick of every driver on its simulated wire; speed of lockstep sessions."""
    costs = [*wire.costs(), wire.session()]
    speeds = [wire.speed(backend) for backend in wire.SPEEDS]
    rows = [[c.name, f"{c.median:.1f}", f"{c.p99:.1f}"] for c in costs]
    whole, real = costs[-2].p99, costs[-1].p99
    text = common.table(["a tick of rigs/teleop.toml, sim-wire", "median us", "p99 us"], rows)
    with arranged() as found:
        text += f"\n  arranged as a session in real time: {found.as_text()}"
    text += (
        f"\n  p99 of the whole tick: {_met(whole <= wire.TICK_US)} ({wire.TICK_US:g} us), after a "
        f"sleep: {_met(real <= wire.TICK_US)}\n\n"
    )
    rows = [
        [s.backend, f"{s.wall:.1f}", f"{s.cpu:.1f}", f"{wire.SPEEDS[s.backend]:g}",
         _met(s.wall >= wire.SPEEDS[s.backend])]
        for s in speeds
    ]  # fmt: skip
    head = [f"lockstep, {wire.SECONDS:g} s", "x real time", "x processor time", "wanted", ""]
    data = {"costs": [vars(c) for c in costs], "speeds": [vars(s) for s in speeds],
            "tick_us_wanted": wire.TICK_US, "speeds_wanted": wire.SPEEDS}  # fmt: skip
    return text + common.table(head, rows), data


def _met(reached: bool) -> str:
    return "met" if reached else "NOT met"


BENCHES: dict[str, Callable[[argparse.Namespace], Found]] = {
    "identify": _identify,
    "velocity": _velocity,
    "ukf": _ukf,
    "redesign": _redesign,
    "wire": _wire,
}
