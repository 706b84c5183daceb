"""The doors: what is written comes in as it was, and what does not is said."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import hil
from hil.bench import doors

QUICK = ("CSV", "motor currents", "NumPy arrays", "pandas frame")


@pytest.mark.parametrize("name", QUICK)
def test_a_door_lets_in_what_was_written(name, tmp_path, monkeypatch):
    monkeypatch.setattr(doors, "N_SAMPLES", 400)
    (door,) = [d for d in doors.DOORS if d.name == name]
    row = doors._through(door, tmp_path)
    assert row.good and row.seconds > 0
    assert "2 joints, 400 samples" in row.out


def test_there_are_twenty_kinds_at_least_and_names_are_told_once():
    names = [d.name for d in doors.DOORS]
    assert len(set(names)) == len(names) >= 20


def test_another_motion_is_not_taken_for_the_same():
    t, q, _, tau = doors.door_motion()
    assert doors._compared("x", "", 0.0, hil.from_arrays(t, q, tau)).good
    assert not doors._compared("x", "", 0.0, hil.from_arrays(t, q, 1.001 * tau)).good
    assert not doors._compared("x", "", 0.0, hil.from_arrays(1.001 * t, q, tau)).good
    assert not doors._compared("x", "", 0.0, hil.from_arrays(t[1:], q[1:], tau[1:])).good


def test_a_command_that_fails_is_shown_with_its_error(tmp_path):
    row = doors._through(doors.Door("nothing", lambda folder: ["nowhere.csv"]), tmp_path)
    assert row.good is False
    assert "nowhere.csv" in row.out


def test_the_published_table_has_every_door_and_no_failure():
    page = (Path(__file__).parents[2] / "docs" / "bench" / "doors.md").read_text("utf-8")
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")]
    marks = [row[-1].rstrip(" |") for row in rows if row[0] != "| source"]
    expected = ["yes"] * len(doors.DOORS) + ["read"] * len(doors.PUBLIC)
    # the vendor's library cannot be installed where the table is printed
    assert marks == expected + ["-" if w.needs == "uldaq" else "yes" for w in doors.WAYS]


def test_a_way_out_is_read_back(tmp_path):
    (way,) = [w for w in doors.WAYS if w.name.startswith("URDF without data")]
    row = doors._went(way, tmp_path)
    assert row.good and not row.source and "friction 0.1" in row.out


def test_a_way_whose_library_is_missing_is_shown_so(tmp_path):
    way = doors.WayOut("x", doors._uldaq, lambda folder: ("", True), "no_such_module")
    row = doors._went(way, tmp_path)
    assert row.good is None and "no_such_module is not installed" in row.out
    assert "uldaq" in (tmp_path / "rig.toml").read_text()


def test_without_the_folder_of_recordings_the_row_says_so(monkeypatch):
    monkeypatch.delenv(doors.VARIABLE, raising=False)
    row = doors._public("EMPS", ("import", "emps/DATA_EMPS.mat"))
    assert math.isnan(row.seconds) and row.good is None and doors.VARIABLE in row.out
