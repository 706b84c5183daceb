"""Two sessions of one seed are the same bytes, and where they are not, the number is named."""

import json
import sys
from pathlib import Path

import numpy as np
import plants
import pytest

from hil.bench import determinism
from hil.cli import main
from hil.errors import ConfigError
from hil.record.difference import first_difference
from hil.record.export import write_recordings

RIG = str(Path(__file__).parents[2] / "rigs" / "teleop.toml")


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sessions")
    for name, more in {
        "one": [],
        "two": [],
        "other": ["--at", "0.1 set force_scale 0.5"],
        "seed": ["--seed", "4"],
    }.items():
        words = ["run", RIG, "--seconds", "0.2", "--seed", "3", *more, "-o"]
        assert main([*words, str(folder / f"{name}.mcap")]) == 0
    return folder


def test_the_same_seed_gives_the_same_bytes(sessions):
    assert first_difference(sessions / "one.mcap", sessions / "two.mcap") is None


def test_the_first_number_that_differs_is_named_with_its_tick(sessions):
    found = first_difference(sessions / "one.mcap", sessions / "other.mcap")
    assert found.tick == 101 and found.where.startswith(("/leader/setpoint_jf", "/events"))
    seed = first_difference(sessions / "one.mcap", sessions / "seed.mcap")
    assert seed.tick == 1 and " " in seed.where and float(seed.first) != float(seed.second)


def test_one_changed_number_is_found(tmp_path):
    r = plants.joints()
    write_recordings(tmp_path / "a.mcap", [r])
    r.tau[1234, 1] = np.nextafter(r.tau[1234, 1], np.inf)
    write_recordings(tmp_path / "b.mcap", [r])
    found = first_difference(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert found.where == f"/{r.arm}/setpoint_jf effort.{r.joints[1]}"
    assert float(found.second) == r.tau[1234, 1] != float(found.first)


def test_the_command_tells_it(sessions, capsys):
    words = ["replay", str(sessions / "one.mcap"), "--against"]
    assert main([*words, str(sessions / "two.mcap")]) == 0
    assert "the same bytes" in capsys.readouterr().out
    assert main([*words, str(sessions / "seed.mcap"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert not told["identical"] and told["first"]["tick"] == 1
    assert main([*words, str(sessions / "no.mcap")]) == 2


@pytest.mark.slow
def test_interpreters_are_compared_and_named(monkeypatch):
    monkeypatch.setattr(determinism, "RIGS", ("teleop",))
    found = determinism.compare_interpreters([sys.executable, sys.executable], 0.05)
    assert [s.difference for s in found] == [None, None]
    assert determinism.rows(found)[1][2:] == ["the same", "the same bytes"]
    assert "2 of 2 sessions" in determinism.page(found, "x")
    with pytest.raises(ConfigError, match="cannot run"):
        determinism.compare_interpreters([sys.executable, "/nowhere/python"], 0.05)
