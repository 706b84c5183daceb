"""`hil experiment`: a study of the thesis end to end, with its table.

Each study is a module of `hil.experiments` with its `command`, which gives the table, and its
`PAGE`; it is loaded when it is asked for.  A new study is such a module and a row of `EXPERIMENTS`.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import re
import time
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hil import terminal
from hil.commands import common
from hil.commands.common import NamedFunction
from hil.errors import ConfigError, DataError, plural
from hil.experiments.pages import StudyPage, cells, made_with, means, picture
from hil.experiments.pages import text as page_text
from hil.experiments.parallel_runs import FAILED, computer, made_by, replicate
from hil.terminal import Found, silent
from hil.userfile import write_text

EXAMPLE = "hil experiment elastic-ukf"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument(
        "name", nargs="?", choices=sorted(EXPERIMENTS), metavar="NAME", help="which study"
    )
    parser.add_argument(
        "--all", action="store_true", help="every study, and the time that each took"
    )
    common.list_names(parser, EXPERIMENTS)
    parser.add_argument("--seed", type=int, default=1, help="first seed (default 1)")
    parser.add_argument(
        "--seeds",
        type=int,
        default=None,
        help="number of seeds; means with 95 %% intervals (default: one run without intervals)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="two seeds, and less of each; the answer says what"
    )
    common.add_workers(parser)
    parser.add_argument(
        "--keep",
        metavar="FOLDER",
        help="keep every finished run in this folder; runs found there are not repeated",
    )
    parser.add_argument(
        "--report", metavar="PAGE.md", help="write the page, its figure beside it (10 seeds)"
    )
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Run one study and print its table."""
    computer(args)
    if args.seeds is not None and args.seeds < 1:
        raise ConfigError(
            f"--seeds {args.seeds}: one or more is needed; leave it out for one run with --seed"
        )
    args.seeds = args.seeds or 0
    if args.all == bool(args.name):
        raise ConfigError(
            "give the name of one study, or --all; 'hil experiment --help' lists them"
        )
    if args.all:
        return _every(args)
    terminal.check_page(args.report)
    text, data = _study(args)
    if args.json:
        terminal.emit({"schema": f"hil.experiment.{args.name}/1", **terminal.json_value(data)})
    else:
        terminal.out(text)
    return 0


def _every(args: argparse.Namespace) -> int:
    """All studies after one another, and their times."""
    if args.report:
        raise ConfigError("--report is the page of one study; give its name in place of --all")
    found, took, spent = {}, {}, {}
    for name in EXPERIMENTS:
        own = argparse.Namespace(**{**vars(args), "name": name})
        if page_of(name) is None:  # it has its own seeds
            own.seeds, own.cluster, own.keep = 0, "", None
        began, used = time.perf_counter(), _processor()
        text, data = _study(own)
        took[name], found[name] = time.perf_counter() - began, terminal.json_value(data)
        spent[name] = _processor() - used
        if not args.json:
            terminal.out(f"{text}\n")
    if args.json:
        times = {"seconds": took, "processor_seconds": spent}
        terminal.emit({"schema": "hil.experiment/1", "studies": found, **times})
    else:
        rows = [[name, f"{s:.0f}", f"{spent[name]:.0f}"] for name, s in took.items()]
        rows.append(["all", f"{sum(took.values()):.0f}", f"{sum(spent.values()):.0f}"])
        terminal.out(terminal.table(["study", "s", "processor s"], rows))
    return 0


def _processor() -> float:
    """Time that processors gave this process and those that it has ended [s]."""
    return sum(os.times()[:4])


def _study(args: argparse.Namespace) -> Found:
    """One study as it was asked for."""
    many = args.seeds or (_QUICK if args.quick else _SEEDS if args.report else 0)
    page = page_of(args.name) if many else None
    if page:
        return _replicated(args, page, many)
    if args.cluster or args.keep or args.seeds:
        paged = ", ".join(n for n in EXPERIMENTS if page_of(n))
        raise ConfigError(
            f"--seeds, --cluster and --keep are for {paged}, and the last two for many "
            "seeds; give --seeds 10"
        )
    return EXPERIMENTS[args.name].load()(args)


def page_of(name: str) -> StudyPage | None:
    """The page of a study over seeds; None where the study writes its own."""
    module = import_module(EXPERIMENTS[name].place.partition(":")[0])
    page: StudyPage | None = getattr(module, "PAGE", None)
    return page


#: Seeds of a page, and of a quick one.
_SEEDS, _QUICK = 10, 2


def _replicated(args: argparse.Namespace, page: StudyPage, many: int) -> Found:
    """A study with many seeds: the table of means, and the page."""
    seeds = list(range(args.seed, args.seed + many))
    shown = not (args.quiet or args.json)
    short = args.quick and bool(page.quick)
    kept = Path(args.keep) / "quick" if args.keep and short else args.keep
    with tqdm(total=many, unit="seed", disable=None if shown else True, leave=False) as bar:
        runs = replicate(
            partial(data_of, quick=short),
            args.name,
            seeds,
            workers=args.workers,
            cluster=args.cluster,
            folder=kept,
            version=made_by(),
            done=lambda _: bar.update(),
        )
    good = [run for run in runs.values() if FAILED not in run]
    lost = [f"seed {k}: {_reason(run[FAILED])}" for k, run in runs.items() if FAILED in run]
    if not good:
        raise DataError(f"no seed gave a number; {lost[0]}")
    told = plural(many, "seed") if not lost else f"{len(good)} of {plural(many, 'seed')}"
    told += f" ({'; '.join(lost)})" if lost else ""
    told += f"; quick, {page.quick}" if short else ""
    found, tested = means(page, good), page.test(good)
    if args.report:
        place = Path(args.report).with_suffix(".svg")
        more = " --quick" * short + f" --seeds {many}"
        command = made_with(args.name, args.report, args.seed, more)
        page_told = page_text(page, found, command, told, place.name, tested)
        terminal.write_page(args.report, page_told)
        if figure := picture(page, found):
            write_text(place, figure)
    lines = [f"{page.title}: {told}; mean and 95 % interval of the mean", ""]
    lines += [terminal.table(page.head, cells(found)), ""]
    if tested:
        lines += [tested.title, "", terminal.table(tested.head, tested.rows), ""]
    lines += [f"Thesis: {page.thesis}"]
    lines += [f"  - {x}" for x in [*page.read(found), *(tested.read if tested else [])]]
    data = {name: [dataclasses.asdict(s) for s in row] for name, row in found.items()}
    told_of = {"seeds": seeds, "failed": lost, "columns": page.head[1:]}
    if tested:
        told_of["test"] = dataclasses.asdict(tested)
    return "\n".join(lines), {**told_of, "means": data}


def _reason(text: str) -> str:
    """Why a run failed, without folders that are gone and what to do about it."""
    return re.sub(r"\S*/([^/\s]+)", r"\1", text.partition(";")[0]).rstrip(".")


def data_of(name: str, seed: int, quick: bool = False) -> dict[str, Any]:
    """Data of a study with one seed, as ``--json`` prints them."""
    words = argparse.Namespace(name=name, seed=seed, quick=quick, workers=1, report=None)
    with silent():  # many say it together
        _, data = EXPERIMENTS[name].load()(words)
    out: dict[str, Any] = terminal.json_value(data)
    return out


#: In the order of the help.
EXPERIMENTS: dict[str, NamedFunction] = {
    "hidden-effect": NamedFunction(
        "hil.experiments.hidden_effect:command",
        "Effects hidden in both arms: found, added, compensated; what the operator feels falls",
    ),
    "elastic-ukf": NamedFunction(
        "hil.experiments.elastic_transmission:command",
        "An elastic transmission seen from the motor alone, identified on line",
    ),
    "transparency": NamedFunction(
        "hil.experiments.transparency:command",
        "The hybrid matrix that sessions show, against the prediction",
    ),
    "fsf": NamedFunction(
        "hil.experiments.without_force_sensors:command",
        "A law with force sensors against its transform that needs none",
    ),
    "friction-network": NamedFunction(
        "hil.experiments.friction_network:command",
        "Wavelet friction networks against Coulomb and viscous friction",
    ),
    "ukf-network": NamedFunction(
        "hil.experiments.cable_arm:command",
        "Force on the tip without a sensor: filters and networks together on the cable arm",
    ),
    "singularity": NamedFunction(
        "hil.experiments.singularity:command",
        "How close to the force estimation singularity the hardware lets a law come",
    ),
    "perception": NamedFunction(
        "hil.experiments.perception:command",
        "Simulated subjects look for the bolt: power of the test, and one that can decide",
    ),
    "palpation": NamedFunction(
        "hil.experiments.palpation:command",
        "Share of a bolt in a gel that the operator feels, against the prediction",
    ),
    "manual-excitation": NamedFunction(
        "hil.experiments.manual_excitation:command",
        "What a hand, the motors, or both determine of an arm",
    ),
    "incision": NamedFunction(
        "hil.experiments.incision:command",
        "Six joints through an incision: what holding the shaft there gains and costs",
    ),
}
