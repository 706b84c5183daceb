"""A stranger's arm of six joints: excite, record, diagnose, add, excite again, record again."""

import json

import pytest

from hil.cli import main
from hil.record.mcap_read import load
from hil.rigs import rig_path

HIDDEN = '\n[[simulation.hidden]]\neffect = "spring"\njoint = "elbow"\n'


@pytest.fixture(scope="module")
def circle(tmp_path_factory):
    """Rig file with a spring in the elbow, its first motion and the session of it."""
    folder = tmp_path_factory.mktemp("circle")
    for name in ("arm6.toml", "arm6.urdf"):
        text = rig_path("arm6").with_name(name).read_text()
        (folder / name).write_text(text + HIDDEN * name.endswith("toml"))
    rig, motion, session = (str(folder / n) for n in ("arm6.toml", "first.toml", "first.mcap"))
    assert main(["excite", rig, "-o", motion, "--seconds", "7"]) == 0
    asked = ["--trajectory", motion, "--seconds", "9", "--clock", "lockstep"]
    assert main(["run", rig, *asked, "-o", session]) == 0
    return folder, rig, session


@pytest.mark.slow
def test_the_hidden_spring_is_named(circle, capsys):
    _, _, session = circle
    capsys.readouterr()
    assert main(["diagnose", session, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["findings"]
    assert ("spring", "elbow") == (found[0]["effect"], found[0]["joint"])
    assert found[0]["confidence"] > 0.9


@pytest.mark.slow
def test_the_hidden_spring_is_added_and_played_for_again(circle, capsys):
    folder, rig, session = circle
    capsys.readouterr()
    model = str(folder / "second.toml")
    add = ["add", "spring", "--joint", "elbow", "--session", session, "-o", model, "--json"]
    assert main(add) == 0
    before, after = json.loads(capsys.readouterr().out)["ladder"]
    assert after["relative"]["elbow"] < 0.4 * before["relative"]["elbow"]

    motion, again = str(folder / "second_motion.toml"), str(folder / "second.mcap")
    asked = ["--for", "stribeck,cogging", "--joint", "elbow", "--model", model, "--seconds", "10"]
    assert main(["excite", rig, *asked, "-o", motion]) == 0
    assert main(["run", rig, "--trajectory", motion, "--seconds", "11", "-o", again]) == 0
    assert load(again, "arm").joints[2] == "elbow"
