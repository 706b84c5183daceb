"""`hil demo`: the whole story on simulated devices."""

from __future__ import annotations

import argparse
import os
import random
import time
from pathlib import Path

from hil import outputs, terminal
from hil.bench import hidden
from hil.commands import common
from hil.commands.diagnose import short
from hil.diagnosis import engine, verbs
from hil.diagnosis.types import Diagnosis
from hil.interrupt import saying
from hil.models import catalogue
from hil.models.model import base_model
from hil.record.mcap_read import load
from hil.report.data import Files, diagnosis_json, ladder_json, with_files
from hil.report.html import diagnosis_report
from hil.rig.config import load_rig
from hil.rigs import rig_path

EXAMPLE = "hil demo --seed 7 -o out/demo"
SESSIONS = ("first.mcap", "second.mcap", "heldout.mcap")
_MODEL, _REPORT = "improved.toml", "report.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument(
        "--seed", type=int, default=1, help="changes the hidden effect and the noise"
    )
    parser.add_argument(
        "-o",
        "--output",
        default="hil-demo",
        metavar="FOLDER",
        help="folder for the sessions, the model and the report, made if it does not exist "
        "(default hil-demo); an earlier demo there is replaced, other files are not",
    )
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Record, compare, diagnose, add, report, and only then reveal."""
    began = time.perf_counter()
    catalogue.load_installed()
    say = terminal.log if args.json else terminal.out
    folder = Path(args.output)
    _check(folder)
    effect, joint = random.Random(args.seed).choice(hidden.EFFECTS)
    say("1. Recording three sessions of two simulated PHANTOM Premium 1.5 arms at 1 kHz.")
    say("   An effect that the analysis knows nothing of is hidden in the follower.")
    say(f"   Everything is written into the folder {folder}{os.sep}\n")
    with saying(lambda: f"what was recorded until then is in {folder}"):
        paths = [_record(folder, k, 10 * args.seed + k, effect, joint) for k in range(3)]
    for path in paths:
        say(f"   {path}")
    runs = [load(path, "follower") for path in paths]
    model = base_model(runs[0].robot, "follower")
    say(f"\n2. Model: {' + '.join(model.names())}. Fit on two sessions, judged on the third.\n")
    d = engine.diagnose(runs[:2], model, runs[2:])
    names = [str(p) for p in paths]
    files = Files(tuple(names[:2]), tuple(names[2:]), "", "follower")
    d.warnings = [(code, with_files(said, files)) for code, said in d.warnings]
    say(short(d, verbs.ladder(d), files))
    common.save_model(d.model, folder / _MODEL)
    with outputs.writing(folder / _REPORT):
        diagnosis_report(d, folder / _REPORT, files)
    return _end(args, d, f"{effect} on {joint}", folder, time.perf_counter() - began)


def _check(folder: Path) -> None:
    """Make the folder; refuse what cannot be written, and what is not an earlier demo's."""
    outputs.make_folder(folder)
    outputs.check(folder / _MODEL, ".toml", (), outputs.is_model, "a model file")
    outputs.check(folder / _REPORT, ".html", (), outputs.is_report, "a report of hil")
    for name in SESSIONS:
        outputs.check(folder / name, ".mcap")


def _record(folder: Path, k: int, seed: int, effect: str, joint: str) -> Path:
    """One session; a session of an earlier demo is replaced, any other is kept aside."""
    target, rig = folder / SESSIONS[k], rig_path("identify")
    outputs.keep_unless(target, "session", {"rig": load_rig(rig).name, "clock": "lockstep"})
    return hidden.identification_session(rig, folder, seed, seed, effect, joint).rename(target)


def _end(args: argparse.Namespace, d: Diagnosis, truth: str, folder: Path, seconds: float) -> int:
    named = [f"{f.effect} on {f.joint}" for f in d.findings]
    j = d.result.problem.joints.index(truth.split(" on ")[1])
    ratio = [float(s.heldout.rms[j] / d.noise[j]) for s in d.ladder]
    if args.json:
        rungs = verbs.ladder(d)
        truth_json = {"effect": truth.split(" on ")[0], "joint": truth.split(" on ")[1]}
        terminal.emit({**diagnosis_json(d), "ladder": ladder_json(rungs), "hidden": truth_json})
        return 0
    right = named == [truth]
    terminal.out(
        f"\n3. What was hidden: {truth}. {'Named right.' if right else 'Not what was named.'}\n"
        f"   held-out error of that joint: {ratio[0]:.2f} -> {ratio[-1]:.2f} times its floor\n"
        f"\n   report          {folder / _REPORT}"
        f"\n   improved model  {folder / _MODEL}\n   {seconds:.0f} s"
    )
    return 0
