"""`hil excite` and `hil run --trajectory`: planned, played, refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.excite import trajectory
from hil.excite.trajectory import sample
from hil.record.mcap_read import load

RIG = Path(__file__).parents[2] / "rigs" / "identify.toml"


def test_a_separating_motion_is_planned_and_played(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["excite", str(RIG), "--for", "stribeck,quadratic-drag", "--joint", "joint2"]
    assert main([*words, "--seconds", "8", "-o", "next.toml", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["schema"] == "hil.excite/1" and data["for"] == ["stribeck", "quadratic-drag"]
    assert data["menu"][0]["log_odds"] == max(m["log_odds"] for m in data["menu"])
    assert {m["what"].split()[0] for m in data["margins"]} >= {"position", "speed", "torque"}
    text = Path("next.toml").read_text()
    assert main([*words, "--seconds", "8", "-o", "again.toml"]) == 0
    assert Path("again.toml").read_text() == text
    assert (
        main(["run", str(RIG), "--trajectory", "next.toml", "-o", "s.mcap", "--seconds", "6"]) == 0
    )
    run, motion = load("s.mcap", "follower"), trajectory.read("next.toml")
    late = run.t > 1.5
    wanted, _, _ = sample(motion, run.t[late])
    assert np.abs(run.q[late] - wanted).max() < 0.03


def test_one_line_of_the_rig_file_plays_a_trajectory(tmp_path, capsys):
    motion = ["excite", str(RIG), "--for", "cogging", "--joint", "joint1", "--motion", "rests"]
    assert main([*motion, "--seconds", "8", "-o", str(tmp_path / "m.toml")]) == 0
    text = RIG.read_text(encoding="utf-8")
    line = 'trajectory = "m.toml"\n'
    rig = tmp_path / "rig.toml"
    rig.write_text(text.replace("[controller.parameters]\n", "[controller.parameters]\n" + line))
    assert main(["run", str(rig), "--seconds", "2", "-o", str(tmp_path / "s.mcap")]) == 0
    moved = np.ptp(load(tmp_path / "s.mcap", "follower").q, axis=0)
    assert moved[0] > 0.02 and moved[1:].max() < 0.02


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--for", "stribek"], "Did you mean 'stribeck'"),
        (["--for", "payload"], "structural"),
        (["--for", "torque-offset,asymmetric-coulomb", "--joint", "joint2"], "structural"),
        (["--for", "torque-gain"], "hand force"),
        (["--for", "contact-damping"], "contact only"),
        (["--for", "coulomb"], "already in the model"),
        (["--for", "stribeck", "--joint", "elbow"], "unknown joint 'elbow'"),
        (["--for", "stribeck", "--arm", "folower"], "Did you mean 'follower'"),
        (["--joint", "joint1"], "need --for"),
        (["--seconds", "1"], "5 to 600"),
    ],
)
def test_mistakes_are_one_sentence(words, says, tmp_path, capsys):
    place = tmp_path / "x.toml"
    assert main(["excite", str(RIG), *words, "-o", str(place)]) == 2
    assert says in capsys.readouterr().err
    assert not place.exists()


def test_outputs_are_not_written_over(tmp_path, capsys):
    model = tmp_path / "m.toml"
    model.write_text('schema = "hil.model/1"\n', encoding="utf-8")
    assert main(["excite", str(RIG), "-o", str(model)]) == 2
    assert "not a trajectory file" in capsys.readouterr().err
    assert model.read_text(encoding="utf-8") == 'schema = "hil.model/1"\n'


def test_a_trajectory_beyond_the_limits_moves_no_motor(tmp_path, capsys):
    main(
        [
            "excite",
            str(RIG),
            "--for",
            "cogging",
            "--joint",
            "joint1",
            "--seconds",
            "8",
            "-o",
            str(tmp_path / "m.toml"),
        ]
    )
    narrow = tmp_path / "narrow.toml"
    rig = RIG.read_text(encoding="utf-8")
    limits = "position_min = [-0.1, 0.0, 0.0]\nposition_max = [0.1, 0.8, 0.6]\n"
    narrow.write_text(rig.replace("[arms.leader]\n", "[arms.leader]\n" + limits), "utf-8")
    capsys.readouterr()
    words = ["--trajectory", str(tmp_path / "m.toml"), "-o", str(tmp_path / "s.mcap")]
    assert main(["run", str(narrow), *words]) == 2
    error = capsys.readouterr().err
    assert "arm 'leader'" in error and "position joint1" in error
    assert main(["run", str(RIG.with_name("teleop.toml")), *words]) == 2
    assert "trajectory" in capsys.readouterr().err
    assert main(["run", str(RIG), "--trajectory", "none.toml", *words[2:]]) == 2
    assert "no such file" in capsys.readouterr().err
    assert not (tmp_path / "s.mcap").exists()


@pytest.mark.slow
def test_an_identifying_motion_has_a_small_condition_number(tmp_path, capsys):
    place = str(tmp_path / "id.toml")
    assert main(["excite", str(RIG), "-o", place, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["columns"] == 14
    assert data["condition"] < 5.0 < 8.0 < data["condition_naive"]
