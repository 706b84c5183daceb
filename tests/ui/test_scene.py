"""The arms in space and the margin of the gains: as the models and the design say."""

import time

import numpy as np
import pytest

from hil import registry
from hil.commands.ui import Scene, margins_of
from hil.errors import ConfigError
from hil.models.phantom import Premium
from hil.rig.config import load_rig
from hil.toml import parse

Q = [0.2, 0.5, 0.3]


@pytest.fixture(scope="module")
def teleop():
    return Scene(load_rig("teleop"))


def test_an_arm_is_drawn_from_its_base_over_the_elbow_to_the_tip(teleop):
    places = teleop.arms({"arms": {"leader": {"position": Q}}})
    base, elbow, tip = np.array(places["leader"])
    robot = Premium(())
    assert base == pytest.approx(np.zeros(3))
    assert np.linalg.norm(elbow) == pytest.approx(robot.l1, rel=1e-4)
    assert np.linalg.norm(tip - elbow) == pytest.approx(robot.l2, rel=1e-4)
    assert tip == pytest.approx(robot.tip(np.array([Q]))[0], abs=1e-5)


def test_an_arm_of_a_description_is_drawn_joint_by_joint():
    """Six joints by their URDF: base, joints and tip, above each other where the arm stands."""
    places = Scene(load_rig("arm6")).arms({"arms": {"arm": {"position": [0.0] * 6}}})["arm"]
    assert len(places) == 8
    steps = np.linalg.norm(np.diff(np.array(places), axis=0), axis=1)
    assert np.sum(steps > 0.01) >= 4


def test_the_simulated_gel_lies_below_the_place_where_the_tip_begins(teleop):
    home, gel = [0.0, 0.4, 0.3], teleop.gel
    tip = teleop.arms({"arms": {"follower": {"position": home}}})["follower"][-1]
    assert gel["arm"] == "follower"
    assert gel["centre"] == pytest.approx([tip[0], tip[1], tip[2] - 0.015], abs=2e-5)


def test_the_gel_of_a_rig_file_goes_before_the_simulated_one():
    table = {"arm": "follower", "centre": [0.2, 0.01, -0.1], "size": [0.08, 0.06, 0.02]}
    assert Scene(load_rig("teleop", {"gel": table})).gel == table
    assert Scene(load_rig("identify")).gel is None


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"arm": "follower"}, "centre"),
        ({"centre": [0.0, 0.0, 0.0]}, "needs an arm"),
        ({"arm": "follower", "centre": [0.0, 0.0]}, "centre"),
        ({"arm": "third", "centre": [0.0, 0.0, 0.0]}, "third"),
        ({"arm": "follower", "centre": [0.0] * 3, "size": [0.1, 0.0, 0.1]}, "above 0 m"),
    ],
)
def test_a_gel_that_is_none_is_refused(table, said):
    with pytest.raises(ConfigError, match=said):
        load_rig("teleop", {"gel": table})


def test_an_arm_without_a_measurement_is_not_drawn(teleop):
    assert teleop.arms({}) == {}
    assert teleop.arms({"arms": {"leader": {"position": [None, 0.0, 0.0]}}}) == {}


def test_a_law_without_a_margin_says_so(teleop):
    found = teleop.margin({})
    assert found["level"] == "" and "No margin is computed" in found["text"]


def test_the_margin_of_the_gains_in_force_is_that_of_the_design():
    config = load_rig("lawrence")
    scene = Scene(config)
    assert scene.margin({})["busy"]
    for _ in range(1200):
        found = scene.margin({})
        if not found["busy"]:
            break
        time.sleep(0.05)
    assert found["level"] == "good" and [a["axis"] for a in found["axes"]] == ["x", "y", "z"]
    assert all(10 < a["delay_ms"] < 50 for a in found["axes"])
    # negative damping of the follower's own motion stands no environment
    kind = registry.load("hil.controllers", "lawrence").Config
    gains = dict(config.controller.parameters) | {"c7": [250.0, -3.0, 0.0]}
    wild = margins_of("lawrence", parse(kind, gains, "controller.parameters"), 1e-3)
    assert wild["level"] == "bad" and "axis" in wild["text"]
