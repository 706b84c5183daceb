"""An ambiguity said, its motion computed, played, and the answer right; and what is never guessed.

The story of docs/excite.md.
"""

import json
from pathlib import Path

import pytest

from hil.cli import main
from hil.diagnosis.engine import diagnose
from hil.diagnosis.equivalence import sets_of
from hil.models.model import base_model
from hil.record.mcap_read import load
from hil.report.data import diagnosis_json
from hil.rig.config import load_rig
from hil.runtime import runner

RIG = Path(__file__).parents[2] / "rigs" / "identify.toml"
SLOW = {"speed": [0.5, 0.5, 0.5]}
SMALL = {"amplitude": [0.12, 0.12, 0.12]}


def record(folder: Path, effect: str, joint: str, seed: int, parameters: dict, seconds=None):
    """Session of the follower with a hidden effect."""
    row = {"effect": effect, "arm": "follower", "joint": joint}
    over = {"simulation": {"hidden": [row]}, "controller": {"parameters": parameters}}
    path = folder / f"{effect}-{seed}.mcap"
    runner.run_session(load_rig(RIG, over), seconds, seed, "lockstep", path)
    return load(path, "follower")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "joint", "poor", "rival"),
    [("position-torque", "joint1", SLOW, "spring")],
)
def test_the_proposed_motion_resolves_an_ambiguity(effect, joint, poor, rival, tmp_path, capsys):
    first = record(tmp_path, effect, joint, 1, poor | {"seed": 1})
    model = base_model(first.robot)
    before = diagnose([first], model)
    assert before.verdict == "ambiguous"
    found = next(s for s in sets_of(before) if {effect, rival} <= set(s.effects))
    assert found.reason == "excitation" and "another motion can separate them" in found.why
    # the command that the answer gives, word for word but for the files
    place = tmp_path / "next.toml"
    words = found.command.replace("RIG.toml", str(RIG)).replace("next.toml", str(place)).split()
    assert words[:2] == ["hil", "excite"] and main(words[1:]) == 0
    capsys.readouterr()
    second = record(tmp_path, effect, joint, 101, {"trajectory": str(place)}, 32.0)
    after = diagnose([first, second], model)
    assert (after.findings[0].effect, after.findings[0].joint) == (effect, joint)


@pytest.mark.slow
def test_offset_and_asymmetric_coulomb_are_said_to_be_one(tmp_path):
    run = record(tmp_path, "asymmetric-coulomb", "joint1", 1, {"seed": 1})
    d = diagnose([run], base_model(run.robot) - "torque-offset")
    assert d.verdict == "ambiguous"
    text = json.dumps(diagnosis_json(d))
    found = next(s for s in sets_of(d) if {"torque-offset", "asymmetric-coulomb"} <= set(s.effects))
    assert "no motion tells" in found.why or found.reason == "structural"
    assert '"reason"' in text and '"command"' in text


@pytest.mark.slow
def test_payload_and_torque_gain_are_said_and_not_guessed(tmp_path):
    run = record(tmp_path, "payload", "joint2", 1, SLOW | {"seed": 1})
    d = diagnose([run], base_model(run.robot))
    assert not {f.effect for f in (*d.findings, *d.partial)} & {"payload", "torque-gain"}
    sets = {s.effects[0]: s for s in sets_of(d)}
    assert sets["payload"].reason == sets["torque-gain"].reason == "structural"
    assert "limits: one recording with and one without the mass" in sets["payload"].experiment
    assert "hand force" in sets["torque-gain"].experiment
    assert not sets["payload"].command and not sets["torque-gain"].command
