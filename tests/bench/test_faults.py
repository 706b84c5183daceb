"""The fault campaign judges what a session says; here are those that go through the drivers."""

import dataclasses
import json

import numpy as np
import pytest

from hil.bench.faults import cases, runner
from hil.record.container import read
from hil.record.schema import decode_numbers
from hil.rig.safety import BITS

SOME = [f for f in cases.FAULTS if f.wire or f.over or f.steered or "law" in f.name]


def test_there_are_at_least_forty_each_with_a_name_of_its_own():
    names = [*(f.name for f in cases.FAULTS), *runner.PROCESS_CASES]
    assert len(names) == len(set(names)) >= 40
    assert {f.condition for f in cases.FAULTS} - {""} <= set(BITS)


@pytest.mark.parametrize("fault", SOME, ids=lambda f: f.name)
def test_a_fault_leads_to_its_state(fault, tmp_path):
    found = runner.one(fault, tmp_path / "s.mcap")
    assert found.right, found


def test_a_wrong_expectation_is_seen(tmp_path):
    fault = next(f for f in cases.FAULTS if f.name == "encoders lost")
    for change in ({"state": "PAUSED"}, {"condition": "overrun"}, {"within": 0}, {"exit": "done"}):
        wrong = dataclasses.replace(fault, **change)
        assert not runner.one(wrong, tmp_path / "s.mcap").right, change


def fault(name):
    return next(f for f in cases.FAULTS if f.name == name)


def test_a_clock_that_goes_back_is_counted_and_its_grid_moved(tmp_path):
    found = runner.one(fault("clock jumps back by 10 s"), tmp_path / "s.mcap")
    box = read(tmp_path / "s.mcap")
    last = json.loads(box.topics["/events"].data[-1])
    assert found.right and last["data"]["clock_set_back"] == 1 and last["data"]["missed"] == 0
    assert len(box.topics["/loop/timing"].times) == 1000
    # a period late at the most, not ten seconds
    late = decode_numbers(box.topics["/loop/timing"])[:, 0]
    assert late.max() < 1e6


def test_time_of_day_is_asked_once(tmp_path):
    assert runner.one(fault("time of day set back by an hour"), tmp_path / "s.mcap").right
    times = np.array(read(tmp_path / "s.mcap").topics["/loop/timing"].times)
    assert set(np.diff(times).tolist()) == {1_000_000}


@pytest.mark.parametrize("name", ["first", "second"])
def test_frames_that_come_twice_change_no_word(name, tmp_path):
    case, seen = fault(f"force board: {name} frames sent twice"), []
    twice = dataclasses.replace(case, strike=lambda t: (seen.append(t), case.strike(t)))
    clean = dataclasses.replace(twice, strike=lambda t: None)
    words = []
    for k, done in enumerate((twice, clean)):
        path = tmp_path / f"{k}.mcap"
        assert runner.one(done, path).right
        words.append(decode_numbers(read(path).topics["/rig/raw"]))
    np.testing.assert_array_equal(*words)
    board = seen[0].rig.bench.wired.boxes["follower-ft"].faults
    assert cases.EVER - getattr(board, f"twice_{name}") > 500


def test_sensors_that_fail_stop_the_motors_within_two_ticks():
    late = [f.name for f in cases.FAULTS if f.within > 2 and f.condition[:5] in ("joint", "force")]
    # a box of motors is no sensor; a CAN board may miss one answer before it counts as stale
    assert late[:2] == ["motor box unplugged", "motor box silent"]
    assert all(name.startswith("force board") for name in late[2:])


@pytest.mark.real_time
def test_a_killed_process_loses_a_tenth_of_a_second_and_its_power(tmp_path):
    found = runner.in_child("process killed (-9)", tmp_path)
    assert found.lost <= 100 and found.right, found
    assert "gone" in runner.fault_row(found)[4]


@pytest.mark.real_time
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("process hangs until the cut", "power-cut"),
        ("watchdog killed (-9)", "watchdog-lost"),
        ("killed, json.py in its folder", "gone"),
    ],
)
def test_a_watchdog_that_is_attacked_is_a_fault_or_cuts(name, says, tmp_path):
    found = runner.in_child(name, tmp_path)
    assert found.right, found
    assert says in runner.fault_row(found)[4]
    assert found.ticks is not None and found.ticks < 2000


@pytest.mark.real_time
def test_a_full_disk_stops_the_record_and_not_the_loop(tmp_path):
    found = runner.in_child("disk full", tmp_path)
    assert found.right and found.lost > 0, found


def test_cyclictest_is_read(monkeypatch):
    from hil.bench import loop

    text = "# Histogram\n000005 000010\n000007 000088\n001200 000002\n# Max Latencies: 01200\n"
    done = type("Done", (), {"returncode": 0, "stdout": text + "# Histogram Overflows: 00000\n"})
    monkeypatch.setattr(loop.shutil, "which", lambda name: "/usr/bin/cyclictest")
    monkeypatch.setattr(loop.subprocess, "run", lambda *a, **k: done)
    found = loop.cyclictest(1.0)
    assert (found.ticks, found.missed, found.p50, found.most) == (100, 2, 7.0, 1200.0)
    monkeypatch.setattr(loop.shutil, "which", lambda name: None)
    assert "not installed" in loop.cyclictest(1.0).note
    ours = loop.LoopRun("hil run", 1, 0, 1, 1, 1, 1)
    assert "nothing to compare" in loop.loop_verdict([loop.cyclictest(1.0), ours])
    assert loop.plain_sleep(0.01).ticks == 10
