"""Rig files that come with the package: run by name, copied to be edited."""

import tomllib
from pathlib import Path

import pytest

from hil import cli, rigs
from hil.rig import config


@pytest.mark.parametrize("name", rigs.NAMES)
def test_a_shipped_rig_is_opened_by_its_name(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert config.load_rig(name) == config.load_rig(rigs.rig_path(name))


def test_a_file_of_that_name_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = rigs.rig_path("teleop").read_text("utf-8").replace('name = "teleop"', 'name = "mine"', 1)
    Path("teleop").write_text(text, "utf-8")
    assert config.load_rig("teleop").name == "mine"


def test_init_copies_a_rig_that_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["init", "identify", "-o", "mine.toml"]) == 0
    assert "hil run mine.toml" in capsys.readouterr().out
    assert tomllib.loads(Path("mine.toml").read_text("utf-8"))["schema"] == "hil.rig/1"
    words = ["run", "mine.toml", "--clock", "lockstep", "--seconds", "0.05", "-o", "s.mcap"]
    assert cli.main(words) == 0
    assert Path("s.mcap").stat().st_size > 0


def test_init_writes_over_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("teleop.toml").write_text("mine = 1\n", "utf-8")
    assert cli.main(["init"]) == 2
    assert "nothing was touched" in capsys.readouterr().err
    assert Path("teleop.toml").read_text("utf-8") == "mine = 1\n"


def test_a_name_that_is_no_rig_says_which_there_are(capsys):
    assert cli.main(["run", "teleo", "-o", "s.mcap"]) == 2
    assert "teleop" in capsys.readouterr().err
