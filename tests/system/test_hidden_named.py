"""A hidden effect is named from the recording alone; a session with none raises no alarm."""

import json
from functools import partial

import pytest

from hil.bench import hidden
from hil.cli import main
from hil.rigs import rig_path

#: One seed of each family here, 12 s long; `hil bench hidden` runs all ten with three of 30 s.
CASES = [
    ("", "joint1"),
    ("stribeck", "joint2"),
    ("presliding", "joint2"),
    ("coupled-friction", "joint2"),
    ("position-torque", "joint1"),
    ("cogging", "joint2"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "joint"), CASES)
def test_hidden_effect_is_named(tmp_path, effect, joint):
    found = hidden.hidden_case(rig_path("identify"), tmp_path, effect, joint, seed=4, length=12.0)
    assert found.right, found
    assert found.after < 1.25


def test_outside_effect_gets_no_name(tmp_path):
    rig, effect = rig_path("identify"), "outside-speed-product"
    path = hidden.identification_session(rig, tmp_path, 5, 5, effect, "joint2", seconds=12.0)
    from hil.diagnosis.engine import diagnose
    from hil.models.model import base_model
    from hil.record.mcap_read import load

    run = load(path, "follower")
    assert diagnose([run], base_model(run.robot)).verdict == "unexplained"


def test_session_carries_no_trace_of_what_is_hidden(tmp_path):
    rig = rig_path("identify")
    path = hidden.identification_session(rig, tmp_path, 1, 1, "stribeck", "joint2", seconds=2.0)
    raw = path.read_bytes()
    assert b"stribeck" not in raw and b"hidden" not in raw


def test_demo_tells_the_whole_story(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        hidden, "identification_session", partial(hidden.identification_session, seconds=12.0)
    )
    assert main(["demo", "--seed", "2", "-o", str(tmp_path), "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["verdict"] == "missing-effect"
    found = out["findings"][0]
    assert (found["effect"], found["joint"]) == (out["hidden"]["effect"], out["hidden"]["joint"])
    joint = found["joint"]
    first, last = out["ladder"][0], out["ladder"][-1]
    assert last["relative"][joint] < first["relative"][joint]
    assert last["rms"][joint] <= 1.1 * out["remaining"]["noise_floor"][joint]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert found["effect"] in page
