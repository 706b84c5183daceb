"""`hil experiment`: a study of the thesis end to end, with its table."""

from __future__ import annotations

import argparse
import dataclasses
import math
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hil.commands import common
from hil.commands.common import Found
from hil.commands.design import finite
from hil.commands.terminal import silent
from hil.errors import ConfigError, DataError, plural
from hil.experiments import (
    cable_arm,
    elastic_transmission,
    friction_network,
    hidden_effect,
    manual_excitation,
    palpation,
    perception,
    singularity,
    transparency,
    without_force_sensors,
)
from hil.experiments.pages import PAGES, cells, means, picture
from hil.experiments.pages import text as page_text
from hil.experiments.replicate import FAILED, made_by, replicate
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
        "--seeds", type=int, default=0, help="so many seeds; means with their 95 %% intervals"
    )
    parser.add_argument("--quick", action="store_true", help="two seeds; a part of hidden-effect")
    common.add_workers(parser)
    parser.add_argument(
        "--keep",
        metavar="FOLDER",
        help="keep every finished run there; what is there is not run again",
    )
    parser.add_argument(
        "--report", metavar="PAGE.md", help="write the page, its figure beside it (10 seeds)"
    )
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Run one study and print its table."""
    common.where(args)
    if args.seeds < 0:
        raise ConfigError(f"--seeds {args.seeds}: one or more is needed")
    if args.all == bool(args.name):
        raise ConfigError(
            "give the name of one study, or --all; 'hil experiment --help' tells them"
        )
    if args.all:
        return _every(args)
    common.check_page(args.report)
    text, data = _study(args)
    if args.json:
        common.emit({"schema": f"hil.experiment.{args.name}/1", **finite(data)})
    else:
        common.out(text)
    return 0


def _every(args: argparse.Namespace) -> int:
    """All studies after one another, and their times."""
    if args.report:
        raise ConfigError("--report is the page of one study; give its name in place of --all")
    found, took = {}, {}
    for name in EXPERIMENTS:
        own = argparse.Namespace(**{**vars(args), "name": name})
        if name not in PAGES:  # it has its own seeds
            own.seeds, own.cluster, own.keep = 0, "", None
        began = time.perf_counter()
        text, data = _study(own)
        took[name], found[name] = time.perf_counter() - began, finite(data)
        if not args.json:
            common.out(f"{text}\n")
    if args.json:
        common.emit({"schema": "hil.experiment/1", "studies": found, "seconds": took})
    else:
        rows = [[name, f"{s:.0f}"] for name, s in [*took.items(), ("all", sum(took.values()))]]
        common.out(common.table(["study", "s"], rows))
    return 0


def _study(args: argparse.Namespace) -> Found:
    """One study as it was asked for."""
    many = args.seeds or (_QUICK if args.quick else _SEEDS if args.report else 0)
    if args.name in PAGES and many:
        return _replicated(args, many)
    if args.cluster or args.keep or args.seeds:
        raise ConfigError(
            f"--seeds, --cluster and --keep are for {', '.join(PAGES)}, and the last two for many "
            "seeds; give --seeds 10"
        )
    return EXPERIMENTS[args.name](args)


#: Seeds of a page, and of a quick one.
_SEEDS, _QUICK = 10, 2


def _replicated(args: argparse.Namespace, many: int) -> Found:
    """A study with many seeds: the table of means, and the page."""
    page, seeds = PAGES[args.name], list(range(args.seed, args.seed + many))
    shown = not (args.quiet or args.json)
    with tqdm(total=many, unit="seed", disable=None if shown else True, leave=False) as bar:
        runs = replicate(
            data_of,
            args.name,
            seeds,
            workers=args.workers,
            cluster=args.cluster,
            folder=args.keep,
            version=made_by(),
            done=lambda _: bar.update(),
        )
    good = [run for run in runs.values() if FAILED not in run]
    lost = [f"seed {k}: {_reason(run[FAILED])}" for k, run in runs.items() if FAILED in run]
    if not good:
        raise DataError(f"no seed gave a number; {lost[0]}")
    told = plural(many, "seed") if not lost else f"{len(good)} of {plural(many, 'seed')}"
    told += f" ({'; '.join(lost)})" if lost else ""
    found = means(page, good)
    if args.report:
        place = Path(args.report).with_suffix(".svg")
        command = f"hil experiment {args.name}" + (f" --seeds {many}" if many != _SEEDS else "")
        common.write_page(args.report, page_text(page, found, command, told, place.name))
        if figure := picture(page, found):
            write_text(place, figure)
    lines = [f"{page.title}: {told}; mean and 95 % interval of the mean", ""]
    lines += [common.table(page.head, cells(found)), "", f"Thesis: {page.thesis}"]
    lines += [f"  - {line}" for line in page.read(found)]
    data = {name: [dataclasses.asdict(s) for s in row] for name, row in found.items()}
    told_of = {"seeds": seeds, "failed": lost, "columns": page.head[1:]}
    return "\n".join(lines), {**told_of, "means": data}


def _reason(text: str) -> str:
    """Why a run failed, without folders that are gone and what to do about it."""
    return re.sub(r"\S*/([^/\s]+)", r"\1", text.partition(";")[0]).rstrip(".")


def data_of(name: str, seed: int) -> dict[str, Any]:
    """Data of a study with one seed, as ``--json`` prints them."""
    words = argparse.Namespace(name=name, seed=seed, quick=False, workers=1, report=None)
    with silent():  # many say it together
        _, data = EXPERIMENTS[name](words)
    out: dict[str, Any] = finite(data)
    return out


def _elastic(args: argparse.Namespace) -> Found:
    """An elastic transmission seen from the motor alone, identified on line."""
    s = elastic_transmission.study(args.seed)
    rows = [[k, f"{v:.3f}"] for k, v in s.parameters.items()]
    lines = [
        "Parameters after 25 s, from guesses 40 % low to 80 % high",
        common.table(["parameter", "estimate / truth"], rows),
    ]
    lines += [
        f"  correlation of {k}: {v:.2f} (-1: only the sum is known)"
        for k, v in s.correlation.items()
    ]
    cells = [
        [
            f"{r.study} {r.value:g}",
            f"{1e3 * r.angle:.3f}",
            f"{1e3 * r.motor_angle:.3f}",
            f"{100 * r.speed:.2f}",
            f"{1e3 * r.innovation:+.3f}",
        ]
        for r in s.rows
    ]
    head = ["parameters frozen, then", "link mrad", "motor for link", "speed %", "innovation mrad"]
    lines += ["", common.table(head, cells)]
    lines.append(
        f"  interaction torque moves the mean innovation by {1e3 * s.slope:.2f} mrad/(N m), "
        f"straight within {100 * s.departure:.1f} %"
    )
    return "\n".join(lines), dataclasses.asdict(s)


def _transparency(args: argparse.Namespace) -> Found:
    """The hybrid matrix that sessions show, against the prediction."""
    rows = transparency.study(args.seed, common.log)
    cells = [
        [
            f"{r.design} {r.entry}",
            f"{r.hz:g}",
            f"{r.predicted:.4g}",
            f"{r.measured:.4g}",
            f"{r.difference:.3g}",
            f"{100 * r.own:.1f}",
            f"{100 * r.bound * r.scale / r.predicted:.1f}",
            "yes" if r.inside else "no",
        ]
        for r in rows
    ]
    head = [
        "entry",
        "Hz",
        "|predicted|",
        "|measured|",
        "difference",
        "of |predicted| %",
        "scatter 95 % %",
        "inside",
    ]
    text = "Hybrid matrix of sessions against the prediction (vertical axis, encoder side)\n"
    text += common.table(head, cells)
    worst = {e: transparency.worst(rows, e) for e in transparency.NAMES}
    told = ", ".join(f"{e} {100 * x:.1f} %" for e, x in worst.items())
    inside = sum(r.inside for r in rows)
    text += (
        "\n  difference: |measured - predicted| of the complex numbers, in N s/m (h11), 1 (h12,"
        "\n  h21), m/(N s) (h22), and in % of the entry's own size"
        "\n  scatter: 95 % bound of what the scatter of the sessions' periods allows, same scale"
        f"\n  inside: {inside} of {len(rows)} differ by no more than the scatter; what is beyond"
        "\n  it is the model's error (friction that is left, fitted parameters), not the data's"
        f"\n  worst difference, of the entry's own size: {told}"
    )
    return text, {
        "rows": [dataclasses.asdict(r) | {"inside": r.inside} for r in rows],
        "worst": worst,
        "inside": inside,
    }


def _fsf(args: argparse.Namespace) -> Found:
    """A law with force sensors against its transform that needs none."""
    s = without_force_sensors.study(args.seed, common.log)
    cells = [
        [
            f"{r.hz:g}",
            *(f"{100 * a:.1f}, {100 * b:.1f}" for a, b in zip(r.theory, r.measured, strict=True)),
            f"{r.master_error:.3f} of {r.master_size:.3f}",
            f"{r.slave_error:.3f} of {r.slave_size:.3f}",
        ]
        for r in s.rows
    ]
    head = ["Hz", *(f"{h} %" for h in transparency.NAMES), "f_m error [N]", "f_s error [N]"]
    text = (
        f"With force sensors, and transformed to need none: condition of Q {s.kappa:.3g}, D "
        f"{s.D:.3g}\n  sampled-data condition: {s.smallest:.3g} > {s.bound:.3g}\n\n"
        f"{common.table(head, cells)}\n  h11..h22: difference of both laws over the entry's own "
        f"size: theory, sessions\n\n  closer to the singularity: {s.refused}"
    )
    return text, dataclasses.asdict(s)


def _cable_arm(args: argparse.Namespace) -> Found:
    """Force on the tip without a sensor: filters and networks together on the cable arm."""
    s = cable_arm.study(args.seed, common.log)
    lines = [
        f"Force on the tip without a sensor, {cable_arm.ARM} of the simulated rig, after "
        f"{cable_arm.LEARN:g} s of learning in the loop"
    ]
    for condition in cable_arm.CONDITIONS:
        rows = [r for r in s.rows if r.condition == condition]
        cells = [
            [r.estimator, f"{1e3 * r.free:.1f}", f"{1e3 * r.touched:.1f}", str(r.nodes)]
            for r in rows
        ]
        head = ["estimator", "free, rms mN", "touching, rms error mN", "nodes"]
        lines += ["", f"{condition}:", common.table(head, cells)]
        lines.append(
            f"  force where it touches: {1e3 * rows[0].size:.0f} mN rms; learnt during "
            f"{100 * s.learnt[condition]:.0f} % of the first part"
        )
    lines += ["", "Cables' stiffness by the filters [N m/rad], from a first guess of 150"]
    lines += [f"  {k}: {', '.join(f'{x:.1f}' for x in v)}" for k, v in s.stiffness.items()]
    return "\n".join(lines), dataclasses.asdict(s)


def _palpation(args: argparse.Namespace) -> Found:
    """Share of a bolt in a gel that the operator feels, against the prediction."""
    rows, p = palpation.study(args.seed, common.log)
    cells = [
        [
            r.controller,
            f"{r.predicted:.3f}",
            f"{r.mean:.3f}",
            f"{r.std:.3f}",
            f"{r.designed:.3f}",
            f"{r.stroke_predicted:.3f}",
            f"{sum(r.stroked) / len(r.stroked):.3f}",
        ]
        for r in rows
    ]
    head = [
        *("controller", "predicted", "measured", "+- a trial", "design, 0.2-5 Hz"),
        *("stroke: predicted", "measured"),
    ]
    text = (
        "Sensitivity by palpation of a bolt in a gel: share of the change of the environment's "
        f"impedance\nthat reaches the operator, {palpation.HZ:g} Hz, {len(rows[0].measured)} "
        f"trials (a pen in the hand: 1)\n{common.table(head, cells)}\n"
        "  design: weighted tangent at the law's environment, 300 N/m, another measure\n"
        "  stroke: across a bolt in the gel with a constant force down, force over depth\n"
        "  exact two-sided Mann-Whitney p, corrected after Holm:\n"
    )
    text += "\n".join(f"    {k}: {v:.2g}" for k, v in p.items())
    return text, {"rows": [dataclasses.asdict(r) for r in rows], "p": p}


def _perception(args: argparse.Namespace) -> Found:
    """Simulated subjects look for the bolt: power of the test, and one that can decide."""
    rows = perception.study(args.seed, common.log)
    head, numbers = PAGES["perception"].head, PAGES["perception"].rows
    data: dict[str, Any] = {"rows": [dataclasses.asdict(r) for r in rows]}
    cells = [
        [name, *("-" if math.isnan(x) else f"{x:.3g}" for x in values)]
        for name, values in numbers(data).items()
    ]
    return common.table(head, cells), data


def _singularity(args: argparse.Namespace) -> Found:
    """How close to the force estimation singularity the hardware lets a law come."""
    rows = singularity.study(args.seed)
    cells = [
        [r.factor, r.level, *(f"{x:.2f}" for x in (r.stable, r.handed_back, r.accurate)),
         "-" if math.isnan(r.linear) else f"{r.linear:.2f}"]
        for r in rows
    ]  # fmt: skip
    head = ["changed", "to", *PAGES["singularity"].head[1:]]
    return common.table(head, cells), {"rows": [dataclasses.asdict(r) for r in rows]}


def _friction(args: argparse.Namespace) -> Found:
    """Wavelet friction networks against Coulomb and viscous friction."""
    rows = friction_network.study(args.seed)
    cells = [
        [r.model, *(f"{100 * x:.1f}" for x in (*r.train, *r.validation)), str(r.nodes)]
        for r in rows
    ]
    head = [
        "model",
        *(f"train {j} %" for j in (1, 2, 3)),
        *(f"valid {j} %" for j in (1, 2, 3)),
        "nodes",
    ]
    text = "Error of the torque relative to its rms, joints 1 to 3, another motion for validation\n"
    return text + common.table(head, cells), {"rows": [dataclasses.asdict(r) for r in rows]}


def _excitation(args: argparse.Namespace) -> Found:
    """What a hand, the motors, or both determine of an arm."""
    rows = manual_excitation.study(args.seed)
    cells = [
        [
            r.name,
            f"{r.found.rank} of 17",
            f"{r.found.condition:.3g}",
            "-" if math.isnan(r.worst) else f"{100 * r.worst:.2f}",
        ]
        for r in rows
    ]
    head = ["excitation", "rank", "condition", "worst error of what is determined %"]
    text = common.table(head, cells)
    text += "".join(f"\n  {r.name}: {r.found.text}" for r in rows)
    rig = manual_excitation.on_the_rig(args.seed)
    kappa = [
        [
            name,
            *(f"{f.values[f'j{j}.kappa']:.3f} +- {f.stderr[f'j{j}.kappa']:.1g}" for j in (1, 2, 3)),
        ]
        for name, f in rig.items()
    ]
    text += "\n\nSimulated rig: a hand on the leader, the law's torques as dither\n"
    text += common.table(["motor constants found", "motor 1", "motor 2", "motor 3"], kappa)
    text += (
        "\n  +- takes the samples for independent and the friction for Coulomb and viscous; what"
        "\n  friction really is adds more than that"
    )
    return text, {
        "rows": [dataclasses.asdict(r) for r in rows],
        "rig": {k: dataclasses.asdict(f) for k, f in rig.items()},
    }


def _hidden_effect(args: argparse.Namespace) -> Found:
    """Effects hidden in both arms: found, added, compensated; what the operator feels falls."""
    rows = hidden_effect.study(args.seed, args.quick, args.workers, common.log)
    found = hidden_effect.summaries(rows)
    if args.report:
        picture = Path(args.report).with_suffix(".svg")
        command = "hil experiment hidden-effect" + " --quick" * args.quick
        common.write_page(args.report, hidden_effect.page(rows, command, picture.name))
        write_text(picture, hidden_effect.figure(found))
    text = (
        f"{common.table(list(hidden_effect.HEAD), hidden_effect.cells(found))}\n"
        "  newtons with the rig file's model -> the fitted base model -> the diagnosed model, "
        "+- 95 %"
    )
    return text, {
        "rows": [dataclasses.asdict(r) for r in rows],
        "summaries": [dataclasses.asdict(s) for s in found],
    }


EXPERIMENTS: dict[str, Callable[[argparse.Namespace], Found]] = {
    "hidden-effect": _hidden_effect,
    "elastic-ukf": _elastic,
    "transparency": _transparency,
    "fsf": _fsf,
    "friction-network": _friction,
    "ukf-network": _cable_arm,
    "singularity": _singularity,
    "perception": _perception,
    "palpation": _palpation,
    "manual-excitation": _excitation,
}
