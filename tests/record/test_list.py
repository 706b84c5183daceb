"""`hil list`: what a folder holds, found by tags, with a verdict a session."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import plants
import pytest
from bag_files import BagFile

from hil.cli import main
from hil.record.export import write_recordings
from hil.record.sources import below, find

SMALL = Path(__file__).with_name("small.mcap")


@pytest.fixture
def folder(tmp_path, monkeypatch, capsys):
    """A session of a rig, imported tables with tags, a bag, a damaged file, a note."""
    monkeypatch.chdir(tmp_path)
    below = tmp_path / "sessions" / "day2"
    below.mkdir(parents=True)
    shutil.copy(SMALL, tmp_path / "sessions" / "small.mcap")
    (tmp_path / "t.csv").write_text(
        "t,q1,tau1\n" + "".join(f"{k * 0.004},{(k % 50) * 0.01},{k % 7}\n" for k in range(400))
    )
    words = ["import", "t.csv", "-o", "sessions/day2/a.mcap", "--tag", "needle", "--tag", "day 2"]
    assert main(words) == 0
    assert main([*words[:3], "sessions/b.mcap", "--tag", "needle"]) == 0
    run = plants.tanh_axes()
    with BagFile(below, "mcap", "bag") as bag:
        bag.joints("/joint_states", run.t[:300], list(run.joints), run.q[:300], None, run.tau[:300])
    (tmp_path / "sessions" / "broken.mcap").write_bytes(b"not a session")
    (tmp_path / "sessions" / "notes.txt").write_text("hello")
    capsys.readouterr()
    return tmp_path


def listed(capsys, *words):
    assert main(["list", *words, "--json"]) == 0
    return {r["path"]: r for r in json.loads(capsys.readouterr().out)["sessions"]}


def test_every_session_and_bag_below_a_folder_has_a_row(folder, capsys):
    found = listed(capsys, "sessions")
    assert set(found) == {
        "sessions/small.mcap",
        "sessions/b.mcap",
        "sessions/broken.mcap",
        "sessions/day2/a.mcap",
        "sessions/day2/bag",
    }
    assert found["sessions/day2/a.mcap"]["of"] == "from t.csv"
    assert found["sessions/day2/a.mcap"]["tags"] == ["day 2", "needle"]
    assert found["sessions/day2/bag"]["of"] == "ROS bag"
    assert found["sessions/small.mcap"]["of"].startswith("rig ")
    assert found["sessions/broken.mcap"]["verdict"].startswith("cannot be read: ")
    for name in ("sessions/b.mcap", "sessions/small.mcap"):
        assert "cannot" not in found[name]["verdict"] and found[name]["seconds"] > 0


def test_tags_filter_and_the_table_tells_how_many(folder, capsys):
    assert set(listed(capsys, "sessions", "--tag", "needle")) == {
        "sessions/day2/a.mcap",
        "sessions/b.mcap",
    }
    assert main(["list", "sessions", "--tag", "needle", "--tag", "day 2"]) == 0
    out = capsys.readouterr().out
    assert "sessions/day2/a.mcap" in out and "1 session with needle, day 2 of 5" in out


def test_a_session_of_a_rig_keeps_its_tags(folder, capsys):
    words = ["run", "teleop", "--clock", "lockstep", "--seconds", "0.1", "-o", "s.mcap"]
    assert main([*words, "--tag", "needle"]) == 0
    capsys.readouterr()
    assert listed(capsys, "s.mcap")["s.mcap"]["tags"] == ["needle"]
    assert main([*words, "--tag", "a,b"]) == 2
    assert "without a comma" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([], 0, ""),
        (["--at", "0.1 pause"], 4, "ended PAUSED"),
        (["--fault"], 3, "ended FAULT"),
    ],
)
def test_a_session_that_ended_without_torque_is_told(words, code, said, tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    assert main(["init", "identify", "-o", str(rig)]) == 0
    if words == ["--fault"]:
        text = rig.read_text(encoding="utf-8")
        limit = "[arms.leader]\nspeed_limit = [0.5, 0.5, 0.5]\n"
        rig.write_text(text.replace("[arms.leader]\n", limit), encoding="utf-8")
        words = []
    path = str(tmp_path / "s.mcap")
    run = ["run", str(rig), "--clock", "lockstep", "--seconds", "3", "-o", path, *words]
    assert main(run) == code
    capsys.readouterr()
    verdict = listed(capsys, path)[path]["verdict"]
    assert ("ended" in verdict) is bool(said) and said in verdict


def test_faults_are_counted(folder, capsys):
    run = plants.tanh_axes()
    write_recordings("stuck.mcap", [replace(run, tau=0 * run.tau)])
    assert "error" in listed(capsys, "stuck.mcap")["stuck.mcap"]["verdict"]


def test_a_folder_without_sessions_is_an_error(folder, capsys):
    (folder / "empty").mkdir()
    assert main(["list", "empty"]) == 2
    assert "holds no session and no ROS bag" in capsys.readouterr().err
    assert main(["list", "sessions", "nowhere"]) == 2
    assert "nowhere: no such folder or file" in capsys.readouterr().err


def test_a_folder_of_tables_is_listed_and_a_map_says_how_they_are_read(folder, capsys):
    runs = folder / "runs" / "monday"
    runs.mkdir(parents=True)
    rows = "".join(f"{k * 0.004},{(k % 50)},{k % 7}\n" for k in range(400))
    (runs / "a.csv").write_text("t,angle,torque\n" + rows)
    (runs / "notes.txt").write_text("hello")
    (folder / "m.toml").write_text(
        'schema = "hil.map/1"\n[columns]\nq1 = { from = "angle", unit = "deg" }\ntau1 = "torque"\n'
    )
    assert "has no column 'q1'" in listed(capsys, "runs")["runs/monday/a.csv"]["verdict"]
    row = listed(capsys, "runs", "--map", "m.toml")["runs/monday/a.csv"]
    assert (row["of"], row["arms"], row["recorded_by"]) == ("table", ["arm (1)"], "file")
    assert "cannot" not in row["verdict"] and row["seconds"] == pytest.approx(1.596)
    # a folder with sessions stands for these alone, as everywhere
    assert not [name for name in listed(capsys, ".") if name.endswith(".csv")]
    assert main(["list", "sessions", "--map", "m.toml"]) == 2
    assert "--map is of tables" in capsys.readouterr().err


def test_a_column_that_is_empty_throughout_is_left_out(folder, capsys):
    shutil.copy("sessions/small.mcap", "a.mcap")
    assert main(["list", "a.mcap"]) == 0
    head = capsys.readouterr().out.splitlines()[0]
    assert "arms" in head and "tags" not in head


def test_a_recording_without_a_date_of_its_own_has_that_of_its_table(folder, capsys):
    os.utime("t.csv", (1_700_000_000, 1_700_000_000))  # 2023-11-14 22:13:20 UTC
    assert main(["import", "t.csv", "-o", "old.mcap"]) == 0
    capsys.readouterr()
    row = listed(capsys, "old.mcap")["old.mcap"]
    assert (row["recorded"], row["recorded_by"]) == ("2023-11-14 22:13", "table")
    assert main(["list", "old.mcap"]) == 0
    out = capsys.readouterr().out
    assert "2023-11-14 22:13 *" in out
    assert "* the recording has no date; this is the last change of the imported table" in out
    assert main(["info", "old.mcap"]) == 0
    assert "table last changed 2023-11-14 22:13:20 UTC" in capsys.readouterr().out


def test_a_session_that_says_no_date_has_that_of_its_file(folder, capsys):
    write_recordings("bare.mcap", [plants.tanh_axes()])
    os.utime("bare.mcap", (1_700_000_000, 1_700_000_000))
    row = listed(capsys, "bare.mcap")["bare.mcap"]
    assert (row["recorded"], row["recorded_by"]) == ("2023-11-14 22:13", "file")


def test_a_bag_has_the_date_of_its_stamps_also_when_imported(folder, capsys):
    bag = "sessions/day2/bag"
    row = listed(capsys, bag)[bag]
    assert row["recorded_by"] == "stamps" and row["recorded"].startswith("20")
    assert main(["import", bag, "-o", "from_bag.mcap"]) == 0
    capsys.readouterr()
    again = listed(capsys, "from_bag.mcap")["from_bag.mcap"]
    assert (again["recorded"], again["recorded_by"]) == (row["recorded"], "stamps")


def test_a_table_with_dates_has_these(folder, capsys):
    rows = "".join(f"{1.7e9 + k * 0.004},{(k % 50) * 0.01},{k % 7}\n" for k in range(400))
    Path("dated.csv").write_text("t,q1,tau1\n" + rows)
    assert main(["import", "dated.csv", "-o", "dated.mcap"]) == 0
    capsys.readouterr()
    row = listed(capsys, "dated.mcap")["dated.mcap"]
    assert (row["recorded"], row["recorded_by"]) == ("2023-11-14 22:13", "stamps")


def test_a_recording_whose_time_does_not_begin_at_0_is_as_long_as_it_is(folder, capsys):
    rows = "".join(f"{1234.5 + k * 0.004:.3f},{(k % 50) * 0.01},{k % 7}\n" for k in range(401))
    Path("late.csv").write_text("t,q1,tau1\n" + rows)
    assert main(["import", "late.csv", "-o", "late.mcap"]) == 0
    capsys.readouterr()
    assert listed(capsys, "late.mcap")["late.mcap"]["seconds"] == pytest.approx(1.6)
    assert main(["info", "late.mcap"]) == 0
    assert ", 1.6 s" in capsys.readouterr().out


def test_a_folder_of_folders_is_the_sessions_in_them(folder):
    """The analyses take what the list shows, where a folder holds only folders of days."""
    (folder / "fleet").mkdir()
    shutil.move(str(folder / "sessions" / "day2"), str(folder / "fleet" / "day2"))
    assert find([folder / "fleet"]) == below([folder / "fleet"])
    assert {p.name for p in find([folder / "fleet"])} == {"a.mcap", "bag"}
    beside = {p.name for p in find([folder / "sessions"])}  # those of the folder itself alone
    assert beside == {"small.mcap", "b.mcap", "broken.mcap"}
