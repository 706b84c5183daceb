"""Studies with many seeds: the same numbers everywhere, nothing finished lost; and their pages."""

from __future__ import annotations

import inspect
import json
import math
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from jobs import digits, lost_always, lost_once, odd, process
from scipy import stats

from hil.bench import teleop as bench
from hil.cli import main
from hil.commands import experiment
from hil.errors import ConfigError, DeviceError
from hil.experiments import friction_network
from hil.experiments.pages import SeedMean, StudyPage, bars, line_chart, means
from hil.experiments.parallel_runs import FAILED, TRIES, LostRun, Where, replicate, spread

SEEDS = [3, 1, 2]
#: Pages of the studies that have one over seeds.
PAGES = {n: page for n in experiment.EXPERIMENTS if (page := experiment.page_of(n))}


def test_processes_and_this_one_give_the_same_digits_in_the_order_of_the_seeds():
    here, there = (replicate(digits, "x", SEEDS, workers=w) for w in (1, 2))
    assert list(here) == list(there) == SEEDS
    assert here == there == {s: digits("x", s) for s in SEEDS}


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_digits_and_its_lost_workers_are_survived(tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as cluster:
        done = []
        far = Where(cluster=cluster.scheduler_address)
        found = replicate(digits, "x", SEEDS, cluster=far.cluster, done=done.append)
        survived = replicate(lost_once, str(tmp_path), SEEDS, cluster=far.cluster)
        others = dict(spread(partial(lost_always, "x"), [1, 2], far))
        # a worker that is started again just now cannot be closed, and one that died a moment ago
        # is still on the list: both must answer
        with distributed.Client(cluster) as client:
            end = time.monotonic() + 30
            while len(client.run(os.getpid, on_error="ignore")) < 2:
                assert time.monotonic() < end, "workers that were lost do not come back"
    assert survived == {s: {"seed": s} for s in SEEDS}
    assert others == {0: {"seed": 1}, 1: LostRun()}
    assert found == {s: digits("x", s) for s in SEEDS}
    assert sorted(done) == sorted(SEEDS)


def test_a_lost_worker_is_survived(tmp_path):
    assert replicate(lost_once, str(tmp_path), SEEDS, workers=2) == {s: {"seed": s} for s in SEEDS}
    with pytest.raises(DeviceError, match=f"seed 2: it ended its process {TRIES} times"):
        replicate(lost_always, "x", SEEDS, workers=2, folder=tmp_path / "kept")
    # the run that loses its process loses no other one
    kept = sorted(p.name for p in (tmp_path / "kept").iterdir())
    assert kept == ["x-1.json", "x-3.json"]


def test_processes_end_with_the_one_that_started_them():
    """However it ends: a bench that is killed leaves nothing that works on for hours."""
    lines = [
        "import os, signal, sys; sys.path.insert(0, sys.argv[1])",
        "from jobs import for_ever",
        "from hil.experiments.parallel_runs import replicate",
        "replicate(for_ever, str(os.getpid()), [1, 2], workers=2)",
    ]
    command = [sys.executable, "-c", "\n".join(lines), str(Path(__file__).parents[1])]
    killed = subprocess.Popen(command, stdout=subprocess.PIPE)
    # the workers hold the other end of the pipe
    try:
        told, _ = killed.communicate(timeout=30)
    finally:
        killed.kill()
    assert (killed.returncode, told) == (-signal.SIGKILL, b"at work")


def test_processes_are_replaced_so_that_they_do_not_grow(monkeypatch):
    monkeypatch.setattr("hil.experiments.parallel_runs.RUNS_OF_A_PROCESS", 1)
    found = dict(spread(process, [1, 2, 3, 4], Where(2)))
    assert sorted(found) == [0, 1, 2, 3]
    assert {found[0], found[1]}.isdisjoint({found[2], found[3]})


def test_work_that_is_no_longer_wanted_ends_its_processes():
    before = multiprocessing.active_children()
    results = spread(process, list(range(4)), Where(2))
    next(results)
    results.close()
    assert multiprocessing.active_children() == before


@pytest.mark.parametrize("workers", [1, 2])
def test_a_seed_that_fails_is_told_and_the_others_count(workers):
    found = replicate(odd, "x", SEEDS, workers=workers)
    assert found == {3: {"seed": 3}, 1: {"seed": 1}, 2: {FAILED: "the session ended PAUSED"}}


def test_finished_runs_of_the_same_version_are_not_run_again(tmp_path):
    first = replicate(digits, "x", [1, 2], folder=tmp_path, version="a")

    def never(name, seed):
        assert seed == 3
        return {"seed": 3}

    found = replicate(never, "x", SEEDS, folder=tmp_path, version="a")
    assert found == {**first, 3: {"seed": 3}}
    with pytest.raises(AssertionError):
        replicate(never, "x", [1], folder=tmp_path, version="b")
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"x-{s}.json" for s in (1, 2, 3)]


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "f").write_text("")
    with pytest.raises(ConfigError, match="a folder is needed"):
        replicate(digits, "x", [1], folder=tmp_path / "f")


def test_a_mean_and_its_interval_are_those_of_student():
    x = [1.0, 2.0, 4.0]
    found = SeedMean.of(x)
    low, high = stats.t.interval(0.95, 2, np.mean(x), stats.sem(x))
    assert (found.mean - found.half, found.mean + found.half) == pytest.approx((low, high))
    assert str(SeedMean(0.04149, 0.00123)) == "0.0415 +- 0.0012"
    assert str(SeedMean(12.0, 0.0)) == "12"
    assert str(SeedMean(math.nan, math.nan)) == "-"


def test_bars_stand_for_their_numbers():
    svg = bars("a < b", ["one", "two"], {"x": [SeedMean(1, 0.1), SeedMean(2, math.nan)]})
    root = ET.fromstring(svg)
    space = "{http://www.w3.org/2000/svg}"
    heights = [float(r.get("height")) for r in root.iter(f"{space}rect")][:2]
    assert heights[1] == pytest.approx(2 * heights[0], abs=0.2)
    assert "a < b" in [t.text for t in root.iter(f"{space}text")]


def test_names_of_groups_do_not_run_into_each_other():
    one, space = SeedMean(1, 0.1), "{http://www.w3.org/2000/svg}"
    few, many = (
        ET.fromstring(bars("a", ["b"], {f"accelerometer {k}": [one] for k in range(n)}))
        for n in (4, 18)
    )
    for root, turned in ((few, 0), (many, 18)):
        assert sum("rotate" in t.get("transform", "") for t in root.iter(f"{space}text")) == turned


def test_a_study_with_seeds_writes_its_page_and_resumes(tmp_path, capsys):
    page, kept = tmp_path / "p.md", tmp_path / "kept"
    words = ["experiment", "elastic-ukf", "--seeds", "2", "--workers", "1", "--keep", str(kept)]
    assert main([*words, "--report", str(page)]) == 0
    said = capsys.readouterr().out
    assert "2 seeds; mean and 95 % interval" in said
    assert main([*words, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["seeds"] == [1, 2]
    told = page.read_text(encoding="utf-8")
    for part in (
        "## The thesis, and here",
        "`hil experiment elastic-ukf --seeds 2 --report p.md`",
        "(p.svg)",
    ):
        assert part in told
    first = data["means"]["link inertia 1"][0]
    assert f"| link inertia 1 | {SeedMean(first['mean'], first['half'])} |" in told
    ET.fromstring((tmp_path / "p.svg").read_text(encoding="utf-8"))
    assert len(list(kept.iterdir())) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fsf", "--seeds", "-1"], "--seeds -1"),
        (["fsf", "--seeds", "0"], "--seeds 0: one or more is needed"),
        (["hidden-effect", "--seeds", "3"], "--seeds, --cluster and --keep are for"),
        (["fsf", "--keep", "x"], "give --seeds 10"),
        (["fsf", "--seeds", "2", "--cluster", "tcp://127.0.0.1:9"], "does not answer"),
    ],
)
def test_options_that_cannot_be_meant(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hil.experiments.parallel_runs.PATIENCE", 0.5)
    assert main(["experiment", *words]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


def test_a_row_that_some_runs_lack_is_a_mean_of_the_others():
    page = PAGES["friction-network"]
    one = {"rows": [{"model": "m", "train": [0.1], "validation": [math.nan], "nodes": 3}]}
    found = means(page, [one, one])
    assert found["m"][0].mean == pytest.approx(10.0)
    assert math.isnan(found["m"][1].mean)


@pytest.mark.parametrize("name", PAGES)
def test_every_page_is_in_the_documentation_with_its_command(name):
    docs = Path(__file__).parents[2] / "docs" / "experiments"
    told = (docs / f"{name}.md").read_text(encoding="utf-8")
    seeds = re.search(r": (?:\d+ of )?(\d+) seeds", told)[1]
    assert f"`hil experiment {name} --seeds {seeds} --report {name}.md`: " in told
    assert PAGES[name].thesis in told
    assert (docs / f"{name}.svg").exists() == bool(PAGES[name].figure)


@pytest.mark.parametrize("name", experiment.EXPERIMENTS)
def test_every_page_is_of_ten_seeds(name):
    docs = Path(__file__).parents[2] / "docs" / "experiments"
    told = (docs / f"{name}.md").read_text(encoding="utf-8")
    assert re.search(r"`: (?:9 of )?10 seeds|rig: 10 seeds", told)


@pytest.mark.parametrize("name", experiment.EXPERIMENTS)
def test_the_results_say_the_seeds_of_every_study(name):
    docs = Path(__file__).parents[2] / "docs"
    page = (docs / "experiments" / f"{name}.md").read_text(encoding="utf-8")
    command, seeds = re.search(r"Printed by `([^`]+)`.*?: (\d+(?: of \d+)? seeds)", page).groups()
    title = page.partition("\n")[0].removeprefix("# ")
    row = f"| [{title}](experiments/{name}.md) | {seeds} | `{command}` |"
    assert row in (docs / "results.md").read_text(encoding="utf-8").splitlines()


def test_all_studies_after_one_another_with_their_times(capsys, monkeypatch):
    few = {n: experiment.EXPERIMENTS[n] for n in ("elastic-ukf", "friction-network")}
    monkeypatch.setattr(experiment, "EXPERIMENTS", few)
    motion = friction_network.random_sines
    monkeypatch.setattr(friction_network, "random_sines", lambda s, seed: motion(s / 6, seed))
    assert main(["experiment", "--all", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert list(data["studies"]) == list(data["seconds"]) == list(few)
    assert data["studies"]["elastic-ukf"]["parameters"]["k1"] > 0
    assert min(data["seconds"].values()) > 0
    assert list(data["processor_seconds"]) == list(few)


def test_the_times_of_all_studies_are_those_of_their_processes_too(capsys, monkeypatch):
    """What the processes of a study took counts, beside this one's waiting for them."""
    busy = "import time\nwhile time.process_time() < 1.2: pass"

    def study(args):
        subprocess.run([sys.executable, "-c", busy], check=True)
        return args.name, {}

    monkeypatch.setattr(experiment, "_study", study)
    monkeypatch.setattr(experiment, "EXPERIMENTS", {"fsf": experiment.EXPERIMENTS["fsf"]})
    assert main(["experiment", "--all"]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0] == "fsf"
    for name, row in zip(("fsf", "all"), table[-2:], strict=True):
        said, seconds, processor = row.split()
        assert said == name and int(processor) >= 1 and int(seconds) >= 1


@pytest.mark.parametrize(
    ("name", "less", "whole"),
    [
        ("palpation", {"trials": 1}, {"trials": 6}),
        ("transparency", {"hz": (1.0, 4.0)}, {"hz": (0.5, 1.0, 2.0, 4.0)}),
        ("fsf", {"hz": (0.5, 4.0)}, {"hz": (0.5, 1.0, 2.0, 4.0)}),
        ("ukf-network", {"part": 0.5}, {"part": 1.0}),
        ("friction-network", {"learnt": 30.0}, {"learnt": 60.0}),
        ("manual-excitation", {"part": 0.5}, {"part": 1.0}),
        ("singularity", {"kappas": 8}, {"kappas": 16}),
    ],
)
def test_a_quick_study_is_less_of_each_seed_and_says_what(name, less, whole, monkeypatch):
    module = sys.modules[PAGES[name].rows.__module__]
    of = "on_the_rig" if name == "manual-excitation" else "study"
    signature, asked = inspect.signature(getattr(module, of)), []

    class EnoughError(Exception):
        pass

    def study(*given, **more):
        asked.append(dict(signature.bind(*given, **more).arguments))
        raise EnoughError

    monkeypatch.setattr(module, of, study)
    for quick, right in ((True, less), (False, whole)):
        with pytest.raises(EnoughError):
            experiment.data_of(name, 7, quick)
        assert asked[-1]["seed"] == 7
        told = {k: len(x) if k == "kappas" else x for k, x in asked[-1].items()}
        assert {k: told[k] for k in right} == right
    assert PAGES[name].quick


def test_the_page_of_a_quick_study_says_so_and_its_runs_are_kept_apart(tmp_path, monkeypatch):
    def told(name, seed, quick=False):
        asked.append(quick)
        return {"rows": [{"name": "a", "x": float(seed + quick)}]}

    page = StudyPage(
        "A title",
        "About.",
        "Nothing.",
        ("row", "x"),
        lambda data: {r["name"]: (r["x"],) for r in data["rows"]},
        lambda found: [],
        quick="half of it",
    )
    asked = []
    monkeypatch.setattr(experiment, "data_of", told)
    monkeypatch.setattr(experiment, "page_of", lambda name: page)
    at, kept = tmp_path / "p.md", tmp_path / "kept"
    words = ["experiment", "fsf", "--keep", str(kept), "--workers", "1", "--report", str(at)]
    assert main([*words, "--quick"]) == 0
    text = at.read_text(encoding="utf-8")
    assert "`hil experiment fsf --quick --seeds 2 --report p.md`: 2 seeds; quick, half of" in text
    assert main([*words, "--seeds", "2"]) == 0
    assert "`hil experiment fsf --seeds 2 --report p.md`: 2 seeds; mean" in at.read_text("utf-8")
    assert asked == [True, True, False, False]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "give the name of one study, or --all"),
        (["fsf", "--all"], "give the name of one study, or --all"),
        (["--all", "--report", "x.md"], "--report is the page of one study"),
    ],
)
def test_one_study_or_all(words, said, capsys):
    assert main(["experiment", *words]) == 2
    assert said in capsys.readouterr().err


def test_a_line_ends_where_there_is_no_number():
    svg = line_chart(
        "a", ["0", "10", "", "x"], {"l": [1.0, 2.0, math.nan, 1.0], "m": [math.nan] * 4}
    )
    space = "{http://www.w3.org/2000/svg}"
    drawn = [p.get("points").split() for p in ET.fromstring(svg).iter(f"{space}polyline")]
    assert [len(p) for p in drawn] == [2, 1]
    low, high = (float(p.partition(",")[2]) for p in drawn[0])
    assert low > high  # 2 is above 1


def test_the_figures_of_the_bench_of_delays_have_every_law_and_stand_in_the_page():
    links = ("0 ms", "1 ms, x")
    rows = [bench.DelayRow(law, link, 1.0, 2.0, 4.0) for law in "ab" for link in links]
    rows += [bench.DelayRow("c", link, why="refused: not stable") for link in links]
    page = (Path(__file__).parents[2] / "docs/bench/teleop.md").read_text(encoding="utf-8")
    for name, figure in bench.figures(rows).items():
        assert all(f">{law}</text>" in figure for law in "abc")
        assert f"(teleop-{name}.svg)" in page
