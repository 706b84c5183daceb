"""The arms in space and the margin of the gains: as the models and the design say."""

import time

import numpy as np
import pytest

from hil import registry
from hil.models.phantom import Premium
from hil.rig.config import load_rig
from hil.toml import parse
from hil.ui.scene import Scene, margins_of

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
