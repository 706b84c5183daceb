"""`hil design` of the laws over a channel with delay: made, judged and written for `hil run`."""

from __future__ import annotations

import json
from dataclasses import fields

import pytest

from hil.cli import main
from hil.commands import design
from hil.controllers.delayed import SCHEMES, DelayedConfig
from hil.rig.config import load_rig


def test_every_scheme_can_be_chosen_and_says_its_cost():
    assert set(design.SCHEME_COSTS) == set(SCHEMES)
    known = {f.name for f in fields(DelayedConfig) if isinstance(f.default, (int, float))}
    assert set(design.SETTABLE_NUMBERS) == known | {"forward", "backward"}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_law_for_a_rig_with_delay_is_designed_and_runs(scheme, tmp_path, capsys):
    own = tmp_path / "own.toml"
    words = ["--set", "forward=0.1,0.05,0.1", "--set", "backward=0.1", "--set", "stiffness=150"]
    assert main(["design", "lawrence", "--design", scheme, *words, "-o", str(own)]) == 0
    said = capsys.readouterr().out
    assert f"scheme {scheme}; there 100 ms, jitter 50 ms, 10 % lost" in said and "may run" in said
    law = load_rig(own).controller
    assert (law.name, law.parameters["scheme"]) == ("delayed", scheme)
    assert law.parameters["stiffness"] == 150.0
    assert main(["run", str(own), "-o", str(tmp_path / "s.mcap"), "--seconds", "0.3"]) == 0


def test_the_law_of_a_rig_file_is_judged_as_it_stands(capsys):
    assert main(["design", "delayed", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["law"], told["scheme"], told["refused"]) == ("delayed", "passivity", "")
    assert max(told["asked"].values()) < told["borne"]


def test_what_the_period_cannot_render_is_refused_and_not_written(tmp_path, capsys):
    own = tmp_path / "own.toml"
    assert main(["design", "delayed", "--set", "damping=4", "-o", str(own)]) == 2
    said = capsys.readouterr()
    assert "REFUSED" in said.out and "stiffness and damping ask for" in said.err
    assert not own.exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["delayed", "--fsf"], "--fsf means nothing for the law delayed"),
        (["delayed", "--set", "wavy=1"], "Did you mean 'wave'"),
        (["lawrence", "--set", "novalue"], "--set novalue: KEY=VALUE is needed"),
        (["lawrence", "--set", "forward=0.05", "--set", "backward=0.05"], "--design passivity"),
    ],
)
def test_what_it_says_where_it_cannot(words, said, capsys):
    assert main(["design", *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.slow
def test_a_search_that_found_nothing_does_not_propose_what_it_tried(capsys, monkeypatch):
    monkeypatch.setattr("hil.teleop.rig_designs._runs", lambda *args: False)
    monkeypatch.setattr("hil.teleop.rig_designs._STIFFNESS", (60.0,))
    assert main(["design", "lawrence", "--design", "transparent"]) == 2
    said = capsys.readouterr().err
    assert "with or without acceleration terms" in said and "accelerations=" not in said
