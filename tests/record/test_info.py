"""`hil info`."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import plants
import pytest
from bag_files import BagFile
from record_tables import write_csv

from hil.cli import main
from hil.record.export import write_recordings
from hil.record.mcap_read import load
from hil.record.mcap_write import SessionWriter


@pytest.fixture
def session(tmp_path):
    path = tmp_path / "s.mcap"
    write_recordings(
        path, [replace(plants.joints(), arm="leader"), replace(plants.joints(1), arm="tail")]
    )
    return path


def test_text_for_a_stranger(session, capsys):
    assert main(["info", str(session)]) == 0
    text = capsys.readouterr().out
    assert "/leader/measured_js" in text
    assert "arm leader: 2 joints, 3000 samples, 5.998 s at 500 Hz" in text
    assert text.count("data faults: none found") == 2


def test_tables_and_bags_are_looked_at_without_an_import(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run, two = plants.tanh_axes(), plants.joints()
    table = {"t": 1.7e9 + run.t, "angle": run.q[:, 0], "torque": run.tau[:, 0], "pump": run.t}
    write_csv(tmp_path / "run.csv", table)
    names = '[columns]\nq1 = "angle"\ntau1 = "torque"\n'
    (tmp_path / "m.toml").write_text('schema = "hil.map/1"\n' + names)
    with BagFile(tmp_path, "mcap", "bag") as bag:
        bag.joints(
            "/joint_states", two.t[:500], ["a", "b"], two.q[:500].copy(), None, two.tau[:500].copy()
        )
    assert main(["info", "run.csv", "--map", "m.toml", "--arm", "elbow"]) == 0
    said = capsys.readouterr().out
    assert f"arm elbow: 1 joint, {run.n} samples" in said and "channel" not in said
    assert "recorded 2023-11-14 22:13:20 UTC" in said and "not used: pump" in said
    assert main(["info", "bag", *map(str, (tmp_path / "bag").glob("*.mcap")), "--json"]) == 0
    folder, file = json.loads(capsys.readouterr().out)["sessions"]
    assert [e["arms"][0]["joints"] for e in (folder, file)] == [["a", "b"]] * 2
    assert "positions of /joint_states" in file["arms"][0]["taken"] and file["bytes"] > 1000
    assert main(["info", "bag"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].startswith("2 joints without a robot description: ")
    assert main(["info", "run.csv"]) == 2
    assert "--propose-map" in capsys.readouterr().err


def test_stops_are_told_with_their_causes(tmp_path, capsys):
    path = tmp_path / "s.mcap"
    events = [(9, "PAUSED", []), (20, "ENABLED", [])] * 4 + [(30, "FAULT", ["position", "new\x1b"])]
    with SessionWriter(path, [], {}) as writer:
        for tick, state, conditions in events:
            told = {"state": state, "conditions": conditions}
            writer.event(tick, tick * 1_000_000, "state", told)
            writer.event(tick, tick * 1_000_000, "state", {**told, "conditions": ["overrun"]})
            writer.event(tick, tick * 1_000_000, "state", {"conditions": 1, "state": {}})
    assert main(["info", str(path)]) == 0
    text = capsys.readouterr().out
    assert text.count("PAUSED at 0.0090 s (tick 9): asked for by the operator") == 4
    assert "FAULT at 0.0300 s (tick 30): a joint is outside of its range; new\\x1b\n" in text
    assert main(["info", str(path), "--json"]) == 0
    states = json.loads(capsys.readouterr().out)["sessions"][0]["states"]
    assert len(states) == 18 and states[0]["causes"] == [] and states[0]["tick"] == 9


RECORDS = (
    {"loop": {"figures": "{"}},
    {"loop": {"figures": "[1]"}},
    {"loop": {"figures": '{"ticks": NaN}'}, "session": {"rate_hz": "abc"}},
    {"loop": {"figures": "[" * 10**5}},
    {"part": {"first": "a"}, "watchdog": {"report": "[" * 10**5}},
)


@pytest.mark.parametrize("records", RECORDS, ids=range(len(RECORDS)))
def test_records_that_no_checksum_covers_are_read_whatever_they_say(tmp_path, records, capsys):
    with SessionWriter(tmp_path / "s.mcap", [], records):
        pass
    assert main(["info", str(tmp_path / "s.mcap")]) == 0
    assert main(["info", str(tmp_path / "s.mcap"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["sessions"][0]["loop"] is None


def test_json(session, capsys):
    assert main(["info", str(session), str(session), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "hil.info/1"
    assert len(found["sessions"]) == 2
    leader, tail = found["sessions"][0]["arms"]
    assert (leader["name"], tail["name"]) == ("leader", "tail")
    assert leader["rate_hz"] == pytest.approx(500)
    assert leader["units"] == ["rad", "rad"]
    assert leader["ranges"]["q1"][0] < 0 < leader["ranges"]["q1"][1]
    assert leader["faults"] == []


def test_lost_rows_are_counted_once_and_alike(tmp_path, capsys):
    r = plants.tanh_axes()
    keep = np.ones(r.n, bool)
    keep[[400, 900, 901, 902, 1300]] = False
    kept = {n: getattr(r, n)[keep] for n in ("t", "q", "tau")}
    write_recordings(tmp_path / "s.mcap", [replace(r, **kept, qd=None)])
    assert main(["info", str(tmp_path / "s.mcap")]) == 0
    text = capsys.readouterr().out
    rows = [line.split() for line in text.splitlines() if "measured_js" in line]
    assert rows[0][-1] == "5"
    assert "5 rows missing in 3 gaps" in text and "[gap] 3 gaps, the longest" in text
    assert "they are interpolated" in text
    assert "efforts against positions: in time, as far as seen\n" in text
    assert main(["info", str(tmp_path / "s.mcap"), "--json"]) == 0
    channels = json.loads(capsys.readouterr().out)["sessions"][0]["channels"]
    assert {c["missing"] for c in channels} == {5}


def test_faults_are_told_and_exit_is_zero(tmp_path, capsys):
    r = plants.joints()
    tau = r.tau.copy()
    tau[5, 0] = np.nan
    write_recordings(tmp_path / "s.mcap", [replace(r, tau=tau)])
    assert main(["info", str(tmp_path / "s.mcap")]) == 0
    assert "error [not-finite] joint1: tau1: 1 of 3000" in capsys.readouterr().out
    assert main(["info", str(tmp_path / "s.mcap"), "--json"]) == 0
    (arm,) = json.loads(capsys.readouterr().out)["sessions"][0]["arms"]
    assert arm["faults"][0]["code"] == "not-finite"


def test_cut_off_session_is_read_and_recovered(session, tmp_path, capsys):
    whole = session.read_bytes()
    session.write_bytes(whole[: len(whole) // 2])
    assert main(["info", str(session)]) == 0
    assert "cut off" in capsys.readouterr().out
    target = tmp_path / "r.mcap"
    assert main(["info", str(session), "--recover", str(target)]) == 0
    assert 100 < load(target, "leader").n < 3000
    assert main(["info", str(target)]) == 0
    assert "cut off" not in capsys.readouterr().out.split("recovered")[1]


def test_recover_writes_nothing_over(session, capsys):
    before = session.read_bytes()
    assert main(["info", str(session), "--recover", str(session)]) == 2
    assert session.read_bytes() == before
    assert "exists" in capsys.readouterr().err


def test_recover_into_a_missing_folder(session, tmp_path):
    assert main(["info", str(session), "--recover", str(tmp_path / "no" / "r.mcap")]) == 2


def test_recover_takes_one_session(session, tmp_path):
    words = ["info", str(session), str(session), "--recover", str(tmp_path / "r.mcap")]
    assert main(words) == 2


@pytest.mark.parametrize("content", [b"", b"t,q1,tau1\n"])
def test_unreadable(tmp_path, capsys, content):
    (tmp_path / "s.mcap").write_bytes(content)
    assert main(["info", str(tmp_path / "s.mcap")]) == 2
    assert "hil import" in capsys.readouterr().err


def test_one_that_is_unreadable_hides_no_other(session, tmp_path, capsys):
    broken = [tmp_path / f"{name}.mcap" for name in "az"]
    for path in broken:
        path.write_bytes(b"nothing")
    given = [str(broken[0]), str(session), str(broken[1])]
    assert main(["info", *given]) == 2
    out, err = capsys.readouterr()
    assert out.startswith(f"{session}: ") and all(path.name in err for path in broken)
    assert main(["info", *given[:2], "--json"]) == 2
    out, err = capsys.readouterr()
    assert [s["path"] for s in json.loads(out)["sessions"]] == [str(session)]
    assert broken[0].name in err


@pytest.mark.real_time
def test_a_session_in_real_time_has_a_date_and_the_figures_of_its_loop(tmp_path, capsys):
    path = tmp_path / "s.mcap"
    rig = str(Path(__file__).parents[2] / "rigs" / "teleop.toml")
    assert main(["run", rig, "--clock", "real", "--seconds", "0.3", "-o", str(path)]) == 0
    capsys.readouterr()
    assert main(["info", str(path)]) == 0
    text = capsys.readouterr().out
    assert f"recorded {datetime.now(UTC):%Y-%m-}" in text and " UTC, 0.3" in text
    assert "at 1000 Hz, clock real;" in text and "deadlines missed" in text
    assert "wake-up late  p50" in text and "longest gap" in text and "arranged" in text
    assert main(["info", str(path), "--json"]) == 0
    (session,) = json.loads(capsys.readouterr().out)["sessions"]
    assert session["loop"]["ticks"] + session["loop"]["missed"] >= 300
    assert abs(session["start_ns"] * 1e-9 - time.time()) < 60
    assert max(c["last_s"] for c in session["channels"]) < 1
    # steps of time are exact to the nanosecond, though stamps count from 1970
    steps = np.diff(load(path, "leader").t) * 1e3
    assert np.abs(steps - np.round(steps)).max() < 1e-9


def test_a_table_says_nothing_of_a_loop(session, capsys):
    assert main(["info", str(session)]) == 0
    text = capsys.readouterr().out
    assert "loop:" not in text and "UTC" not in text


def test_a_recovered_session_says_what_it_is(session, tmp_path, capsys):
    target = tmp_path / "r.mcap"
    session.write_bytes(session.read_bytes()[:-200])
    assert main(["info", str(session), "--recover", str(target)]) == 0
    capsys.readouterr()
    assert main(["info", str(target)]) == 0
    assert f"recovered from {session.name}: " in capsys.readouterr().out
    assert main(["info", str(target), "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["sessions"]
    assert told["recovered"]["source"] == session.name
