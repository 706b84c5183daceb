"""The plan on the test plants, and results of both kinds of plants side by side."""

import json

import pytest

from hil.bench.diagnosis import amplitudes, cases, command, runner, session, tables
from hil.errors import ConfigError

needs_mujoco = pytest.mark.skipif(
    not session.mujoco_available(), reason="the test plants need MuJoCo (extra 'mujoco')"
)


def row(plant, robot, named, outcome, confidence=0.9):
    found = {"case": f"{plant}{robot}{named}", "plant": plant, "kind": "one", "robot": robot,
             "noise": "white", "excitation": "points", "seed": 0, "force": False,
             "hidden": [["stribeck", "joint1", 1.5]], "excess": 1.5, "verdict": "missing-effect",
             "before": 3.0, "after": 1.0, "revision": "abc", "outcome": outcome}  # fmt: skip
    finding = {"effect": named, "joint": "joint1", "confidence": confidence, "share": 1.0}
    return found | {"named": [finding | {"rivals": []}]}


def test_both_plants_have_their_tables():
    rows = [row("tuning", "arm", "stribeck", "right"), row("test", "elbow3", "cogging", "wrong")]
    text = tables.report(rows, "hil bench diagnosis")
    for title in tables.SECTIONS:
        assert f"## Test plants (MuJoCo): {title}" in text
        assert f"## Tuning plants: {title}" in text
    test, tuning = text.split("## Tuning plants: In short")
    assert "0.0 % (0/1" in test and "100.0 % (1/1" in tuning


def test_rows_of_an_earlier_revision_are_of_the_tuning_plants():
    old = row("tuning", "arm", "stribeck", "right")
    del old["plant"]
    text = tables.report([old], "hil bench diagnosis")
    assert "## In short" in text and "Tuning plants" not in text


@pytest.mark.parametrize(
    ("hidden", "named", "outcome"),
    [
        ("harmonic-drive", "encoder-eccentricity", "right"),
        ("harmonic-drive", "stribeck", "wrong"),
        ("belt-skip", "missed-counts", "right"),
    ],
)
def test_what_has_no_name_of_its_own_has_right_names(hidden, named, outcome):
    case = cases.SessionCase(
        "one", "elbow3", (cases.HiddenEffect(hidden, 0, 1.5),), "white", "points", 0
    )
    found = row("test", "elbow3", named, "") | {"hidden": [[hidden, "joint1", 1.5]]}
    assert runner.outcome(case, found) == outcome
    (mean,) = [s.k for _, _, _, s in tables.confidence_bins([found]) if s.n]
    assert mean == (outcome == "right")


def test_without_mujoco_the_tuning_plants_are_left_and_that_is_said(monkeypatch, capsys):
    monkeypatch.setattr(session, "mujoco_available", lambda: False)
    assert command.chosen_plants(None) == ["tuning"]
    assert session.MUJOCO_EXTRA in capsys.readouterr().err
    with pytest.raises(ConfigError, match="mujoco"):
        command.chosen_plants("test")


@needs_mujoco
def test_ten_seeds_put_every_effect_on_every_robot_that_can_show_it():
    plan = cases.mujoco_plan()
    assert len({c.name for c in plan}) == len(plan) > 1000
    assert {c.plant for c in plan} == {"test"}
    for effect, (needs, *_) in session.kinds_of_plant("test").items():
        on = {c.robot for c in plan if any(h.effect == effect for h in c.hidden)}
        assert on >= set(session.robots_showing(needs)), effect
    quick = cases.mujoco_plan(quick=True)
    assert len(quick) < 66
    assert {h.effect for c in quick for h in c.hidden} == set(session.kinds_of_plant("test"))


@needs_mujoco
def test_two_motors_of_the_last_two_joints_belong_to_the_earlier_one():
    """The pair has no order, and a diagnosis names it by its first joint."""
    found = [
        (h.joint, h.label, session.joint_count(c.robot))
        for c in cases.mujoco_plan(seeds=3)
        for h in c.hidden
        if h.effect == "differential"
    ]
    assert any(joint == count - 1 for joint, _, count in found)
    for joint, label, count in found:
        assert label == f"joint{min(joint, count - 2) + 1}"


def test_the_quick_plan_is_calibrated():
    known = amplitudes.amplitude_table("test")
    missing = {
        amplitudes.name(h.effect, h.joint, c.robot, c.excitation)
        for c in cases.mujoco_plan(quick=True)
        for h in c.hidden
    } - set(known)
    assert not missing
    for key, found in known.items():
        _, least, most = session.kinds_of_plant("test")[key.split("/")[0]]
        assert all(least <= a <= most for a in found), key


OUTCOMES = ("right", "ambiguous", "extra", "wrong", "one", "unexplained", "missed")


@needs_mujoco
@pytest.mark.slow
def test_a_case_becomes_a_row_that_can_be_read_again(tmp_path):
    (case,) = (c for c in cases.mujoco_plan(quick=True) if c.name.startswith("spring@"))
    found = runner.judged_row(case)
    assert found["plant"] == "test" and found["outcome"] in OUTCOMES
    path = tmp_path / "rows.jsonl"
    path.write_text(json.dumps(found) + "\n", encoding="utf-8")
    assert runner.read(path) == [found]
