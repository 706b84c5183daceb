"""A joint that only holds its place says nothing of its mechanics, so nothing is named there."""

from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.diagnosis.engine import diagnose
from hil.identify import bands
from hil.models.model import base_model
from hil.record.mcap_read import load
from hil.rig.config import load_rig
from hil.runtime import runner

RIG = Path(__file__).parents[2] / "rigs" / "identify.toml"


@pytest.mark.slow
def test_nothing_is_named_on_joints_that_hold_their_place(tmp_path, capsys):
    place = tmp_path / "one.toml"
    words = ["excite", str(RIG), "--for", "spring,position-torque", "--joint", "joint1"]
    assert main([*words, "-o", str(place)]) == 0
    capsys.readouterr()
    over = {"controller": {"parameters": {"trajectory": str(place)}}}
    path = tmp_path / "one.mcap"
    runner.run_session(load_rig(RIG, over), None, 1, "lockstep", path)
    run = load(path, "follower")
    found = diagnose([run], base_model(run.robot))
    assert found.ladder[0].result.problem.holds.tolist() == [False, True, True]
    named = [f.joint for f in (*found.findings, *found.partial)]
    assert not {"joint2", "joint3"} & set(named)
    assert not {
        c.term.joint for c in found.first.candidates if not c.term.effect.scope.of_robot
    } & {1, 2}
    assert "joint2, joint3: held in place" in dict(found.warnings)["holds"]


def test_what_does_not_move_at_all_is_held_and_what_creeps_is_not():
    still, creeping = np.zeros(1000), np.linspace(0.0, 0.1, 1000)
    q, grain = np.stack([still, creeping], axis=1), np.array([0.0, 1e-4])
    assert bands.holding(q, grain).tolist() == [True, False]
