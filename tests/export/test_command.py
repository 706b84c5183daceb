"""`hil export` on the command line: what it prints, writes and refuses."""

import hashlib
import json

import pytest

from hil.cli import main
from hil.export import target
from hil.models.files import write_model
from hil.record.export import write_recordings


@pytest.fixture(scope="module")
def folder(tmp_path_factory, arm, made):
    """Two sessions and the fitted model of the arm."""
    place = tmp_path_factory.mktemp("export")
    for name, run in (("run1", arm.run), ("run2", arm.other)):
        write_recordings(place / f"{name}.mcap", [run])
    write_model(made("c").steps[-1].result.model, place / "arm.toml")
    return place


def test_a_refit_prints_both_errors_and_what_is_lost(folder, capsys):
    words = ["export", folder / "arm.toml", "--to", "mjcf", "-o", folder / "a.xml"]
    words += ["--data", folder / "run1.mcap", "--holdout", folder / "run2.mcap"]
    assert main([str(w) for w in words]) == 0
    said = capsys.readouterr().out
    assert "whole model" in said and "within the target" in said and "lost: stribeck" in said
    assert "<mujoco" in (folder / "a.xml").read_text()


def test_what_loses_nothing_has_one_error(made):
    assert [s.label for s in made("c").steps] == ["whole model"] and not made("c").lost


def test_json(folder, capsys):
    words = ["export", folder / "arm.toml", "--to", "python", "-o", folder / "a.py", "--json"]
    assert main([str(w) for w in words]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["schema"] == "hil.export/1" and told["held_out"] == []
    assert told["files"] == [str(folder / "a.py")] and "cost of a call" in told["notes"][-1]


def test_a_card_says_what_is_known_and_what_is_not(folder, made):
    card, file = folder / "card.md", folder / "arm.toml"
    assert main(["export", str(file), "--to", "card", "-o", str(card)]) == 0
    text = card.read_text()
    description = (folder / "arm.urdf").read_bytes()
    assert hashlib.sha256(file.read_bytes() + b"\0" + description).hexdigest() in text
    values = made("c").steps[-1].result.values
    assert all(f"| {name.replace('_', chr(92) + '_')} |" in text for name in values)
    assert "fit of run1" in text and "| fore | " in text and "| numpy | " in text
    assert "Unknown: no recording was given" in text
    words = ["--data", str(folder / "run1.mcap"), "--holdout", str(folder / "run2.mcap")]
    assert main(["export", str(file), "--to", "card", "-o", str(card), *words]) == 0
    text = card.read_text()
    assert "Unknown" not in text and "held out: other sessions" in text


def refused(capsys, *words):
    """The one line of a refusal."""
    try:
        code = main([str(w) for w in words])
    except SystemExit as left:  # a mistake in the words themselves
        code = left.code
    said = capsys.readouterr().err
    assert code == 2 and said.count("\n") == 1 and "Traceback" not in said
    return said


def test_refusals(folder, capsys):
    model, foreign = folder / "arm.toml", folder / "mine.urdf"
    foreign.write_text("<robot name='mine'/>")
    start = ("export", model, "--to")
    assert "a file is there" in refused(capsys, *start, "urdf", "-o", foreign)
    assert foreign.read_text() == "<robot name='mine'/>"
    # the robot of the model itself
    assert "a file is there" in refused(capsys, *start, "urdf", "-o", folder / "arm.urdf")
    assert ".xml" in refused(capsys, *start, "mjcf", "-o", folder / "a.urdf")
    held = ("--holdout", folder / "run1.mcap")
    assert "needs --data" in refused(capsys, *start, "c", "-o", folder / "b.h", *held)
    assert "unknown value" in refused(capsys, *start, "nonsense", "-o", folder / "b.h")
    none = folder / "none.toml"
    assert "none.toml" in refused(capsys, "export", none, "--to", "c", "-o", folder / "b.h")


def test_the_robot_beside_a_file_is_no_users_file(folder, capsys):
    """A second file beside the output never takes the place of another one."""
    (folder / "i.urdf").write_text("<robot name='mine'/>")
    words = ("export", folder / "arm.toml", "--to", "isaac", "-o", folder / "i.yaml", "--feasible")
    assert "a file is there" in refused(capsys, *words)
    assert not (folder / "i.yaml").exists() and "mine" in (folder / "i.urdf").read_text()


def test_every_target_says_what_it_is():
    for name in target.names():
        found = target.get(name)
        assert found.what and found.ending.startswith(".")
