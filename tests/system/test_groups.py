"""`hil diagnose` of many sessions: grouped, in processes and on a cluster, resumed, lost."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import plants
import pytest

from hil.bench import real
from hil.bench.diagnosis import cases, runner
from hil.bench.real import Ours, RealCase, RealRow, ScriptErrors
from hil.cli import main
from hil.commands import common, diagnose, many_sessions
from hil.errors import ConfigError, DataError
from hil.experiments.parallel_runs import LostRun, Where, computer
from hil.models import catalogue
from hil.record.export import write_recordings
from hil.record.sources import RobotName


@pytest.fixture(scope="module")
def cluster():
    """Scheduler and two workers on this machine."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as found:
        yield found.scheduler_address


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two days of one axis, and a day of another robot."""
    place = tmp_path_factory.mktemp("fleet")
    for day, seed in (("monday", 1), ("tuesday", 2)):
        (place / day).mkdir()
        write_recordings(place / day / "axis.mcap", [plants.smooth_axis(seed, 8.0, 200.0)])
    other = plants.smooth_axis(3, 8.0, 200.0)
    write_recordings(
        place / "tuesday" / "other.mcap",
        [plants.single("other", other.t, other.q[:, 0], other.tau[:, 0], "elbow")],
    )
    return place


def answers(capsys, *words) -> tuple[int, list[dict]]:
    code = main(["diagnose", *map(str, words), "--json"])
    data = json.loads(capsys.readouterr().out)
    assert data["schema"] == "hil.diagnose.groups/1"
    return code, data["groups"]


@pytest.mark.slow
def test_sessions_of_several_robots_are_diagnosed_group_by_group(folder, capsys):
    code, found = answers(capsys, folder / "tuesday", folder / "monday", "--workers", 1)
    assert code == 0
    assert [(g["robot"], len(g["sessions"])) for g in found] == [
        ("single-axis: joint1", 2),
        ("single-axis: elbow", 1),
    ]
    assert all(g["diagnosis"]["schema"] == "hil.diagnose/1" for g in found)
    # a group's answer is that of its sessions alone
    assert main(["diagnose", str(folder / "tuesday" / "other.mcap"), "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert found[1]["diagnosis"] == alone


@pytest.mark.slow
def test_a_cluster_gives_the_same_digits(folder, cluster, capsys, monkeypatch):
    for name, effect in dict(
        catalogue.table()
    ).items():  # what other tests loaded into this process
        if type(effect).__module__.startswith("hil_plugin_"):
            monkeypatch.delitem(catalogue.table(), name)
    day = folder / "tuesday"
    here, far = (
        answers(capsys, day, "--by", "session", *words)
        for words in (("--workers", 1), ("--cluster", cluster))
    )
    assert here == far
    assert [g["group"] for g in here[1]] == [str(day / "axis.mcap"), str(day / "other.mcap")]


def test_what_is_kept_is_not_diagnosed_again_and_a_bad_session_is_a_row(
    folder, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(many_sessions, "made_by", lambda: "a")
    monkeypatch.setattr(diagnose, "group_answer", told)
    (tmp_path / "s").mkdir()
    for name in ("a", "b"):
        path = tmp_path / "s" / f"{name}.mcap"
        path.write_bytes((folder / "monday" / "axis.mcap").read_bytes())
    (tmp_path / "s" / "c.mcap").write_text("nonsense")
    words = ["diagnose", str(tmp_path / "s"), "--by", "session", "--keep", str(tmp_path / "k")]
    assert main([*words, "--workers", "1"]) == 2
    said = capsys.readouterr().out
    assert "c.mcap is not an MCAP file" in said and "2 diagnosed now" in said
    assert len(list((tmp_path / "k").iterdir())) == 2
    (tmp_path / "s" / "b.mcap").touch()  # a changed session is another one
    assert main([*words, "--workers", "1"]) == 2
    assert "1 diagnosed now" in capsys.readouterr().out


def told(args):
    """An answer as short as one can be."""
    ladder = [{"relative": {"joint1": x}} for x in (4.0, 2.0)]
    found = [{"effect": "stribeck", "joint": "joint1"}]
    verdict = "missing-effect" if "a" in Path(args.sessions[0]).stem else "adequate"
    return {"diagnosis": {"verdict": verdict, "findings": found, "ladder": ladder}, "text": "-"}


def words_of(folder, **more) -> object:
    parser = argparse.ArgumentParser()
    diagnose.configure(parser)
    args = parser.parse_args([str(folder), "--by", "session"])
    for key, value in more.items():
        setattr(args, key, value)
    return args


def test_a_session_that_loses_its_process_is_a_row(folder, capsys, monkeypatch):
    monkeypatch.setattr(many_sessions, "spread", lambda work, jobs, where: [(0, told(jobs[0][1]))])
    args = words_of(folder / "monday")
    assert many_sessions.run_groups(args, many_sessions.session_groups(args), told) == 0
    assert "stribeck on joint1" in capsys.readouterr().out
    monkeypatch.setattr(many_sessions, "spread", lambda work, jobs, where: [(0, LostRun())])
    assert many_sessions.run_groups(args, many_sessions.session_groups(args), told) == 2
    assert "it ended its process 3 times" in capsys.readouterr().out


def test_many_sessions_are_counted_by_robot(capsys):
    args = words_of("x")
    robots = [RobotName((f"j{k % 2}",), "arm") for k in range(60)]
    found = [many_sessions.RobotGroup(f"{k}", r, [Path(f"{k}")]) for k, r in enumerate(robots)]
    rows = [
        many_sessions._Row(
            str(g.robot), g.label, 1, "adequate" if k % 3 else "missing-effect", ("x",)
        )
        for k, g in enumerate(found)
    ]
    said = many_sessions._summary(args, rows, 60, 3.0)
    assert "arm: j0      30        20              10  x (30)" in said
    assert "40 rows more" in said


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (RobotName(("a",), "arm"), RobotName(("a",), "arm"), True),
        (RobotName(("a",), "arm"), RobotName(("a",)), True),
        (RobotName(("a",), "arm"), RobotName(("a",), "leg"), False),
        (RobotName(("a", "b"), "arm"), RobotName(("a",), "arm"), False),
        (RobotName(("a", "b"), "arm", True), RobotName(("a",), "arm", True), True),
    ],
)
def test_what_is_one_robot(one, other, same):
    assert one.same(other) == other.same(one) == same


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--by", "session", "--report", "r.html"], "--report is the page of one diagnosis"),
        (["--by", "session", "-o", "b.toml"], "-o is the model of one robot"),
        (["--by", "session", "--workers", "0"], "--workers 0: one or more is needed"),
        (["--by", "session", "--cluster", "tcp://127.0.0.1:9"], "does not answer"),
        (["--by", "session", "--keep", "monday/axis.mcap"], "a folder is needed"),
    ],
)
def test_options_that_cannot_be_meant(words, said, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setattr("hil.experiments.parallel_runs.PATIENCE", 0.5)
    assert main(["diagnose", ".", *words]) == 2
    error = [x for x in capsys.readouterr().err.splitlines() if not x.startswith("no --model")]
    assert len(error) == 1 and said in error[0]


def test_a_held_out_session_goes_to_its_robot(folder, tmp_path):
    write_recordings(tmp_path / "h.mcap", [plants.smooth_axis(4, 8.0, 200.0)])
    found = many_sessions.session_groups(
        words_of(folder, by="robot", holdout=[str(tmp_path / "h.mcap")])
    )
    assert [len(g.holdout) for g in found] == [1, 0]
    lone = words_of(folder / "tuesday" / "other.mcap", holdout=[str(tmp_path / "h.mcap")])
    with pytest.raises(ConfigError, match="no session to fit is of that robot"):
        many_sessions.session_groups(lone)


# --- the benchmarks --------------------------------------------------------------------------


def case_row(case: RealCase) -> RealRow:
    ours = Ours("adequate", [("x on a", 0.5)], ["m"], [[1 / 3]], 0, [0.1], False, 1.0, (0.7,))
    script = ScriptErrors([0.3], [0.2], [["poly3"]], 0.1)
    return RealRow(case.name, case.kind, case.complete, ["a"], [False], script, ours, 50.0)


def nothing() -> real.SessionSplit:
    return [], []


def lacks(case: RealCase) -> RealRow:
    raise DataError("get it from there")


@pytest.mark.slow
def test_real_recordings_on_a_cluster_give_the_rows_of_this_machine(cluster):
    todo = [RealCase(name, "drive", nothing) for name in "ab"]
    far = sorted(real.examine_cases(todo, Where(cluster=cluster), case_row), key=lambda r: r.case)
    assert far == [case_row(c) for c in todo]
    assert [real.from_data(json.loads(json.dumps(real.to_data(r)))) for r in far] == far
    with pytest.raises(DataError, match="get it from there"):
        list(real.examine_cases(todo, Where(cluster=cluster), lacks))


def judged(case):
    return {"case": case.name, "value": float(len(case.name)) / 3}


def test_cases_of_the_diagnosis_on_a_cluster_give_the_rows_of_this_machine(cluster, tmp_path):
    todo = cases.rig_plan(True, 1)[:4]
    rows = [
        runner.run_cases(todo, where, tmp_path / f"{k}.jsonl", judged)
        for k, where in enumerate((Where(), Where(cluster=cluster)))
    ]
    assert rows[0] == rows[1]
    assert runner.run_cases(todo, Where(), tmp_path / "1.jsonl", None) == rows[0]  # resumed


def test_real_recordings_are_resumed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(real, "examine_cases", lambda todo, where: map(case_row, todo))
    words = ["bench", "real", "--only", "a_spring", "--resume", str(tmp_path / "r.jsonl")]
    assert main(words) == 0
    first = capsys.readouterr().out
    monkeypatch.setattr(real, "examine_cases", lambda todo, where: map(lacks, todo))
    assert main(words) == 0
    assert capsys.readouterr().out == first


def test_workers_have_one_name_everywhere():
    parser = argparse.ArgumentParser()
    common.add_workers(parser, " (x)", "--jobs")
    assert computer(parser.parse_args(["--jobs", "3"])) == Where(3, "")
