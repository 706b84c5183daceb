"""The fault campaign judges what a session says; here are those that go through the drivers."""

import dataclasses

import pytest

from hil.bench.faults import cases, process, runner, tables
from hil.runtime.conditions import BITS

SOME = [f for f in cases.FAULTS if f.wire or f.over or "law" in f.name]


def test_there_are_at_least_forty_each_with_a_name_of_its_own():
    names = [*(f.name for f in cases.FAULTS), *process.CASES]
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


def test_a_killed_process_loses_a_tenth_of_a_second_and_its_power(tmp_path):
    found = process.one("process killed (-9)", tmp_path)
    assert found.lost <= 100 and found.right, found
    assert "gone" in tables.row(found)[4]


def test_a_full_disk_stops_the_record_and_not_the_loop(tmp_path):
    found = process.one("disk full", tmp_path)
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
    ours = loop.Run("hil run", 1, 0, 1, 1, 1, 1)
    assert "nothing to compare" in loop.verdict([loop.cyclictest(1.0), ours])
    assert loop.plain_sleep(0.01).ticks == 10
