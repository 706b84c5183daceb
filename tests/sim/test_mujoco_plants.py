"""The test plants: the mechanism is the described one, what is hidden shows, seeds repeat."""

import ast
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the test plants need MuJoCo (extra 'mujoco')")

from hil.models.robots import bare_robot
from hil.record.recording import RobotSource
from hil.sim_devices.mujoco_plants import describe, session
from hil.sim_devices.mujoco_plants.laws import EffectPlace
from hil.sim_devices.mujoco_plants.robots import ROBOTS
from hil.sim_devices.mujoco_plants.session import NAMES

DESCRIBED = [name for name, robot in ROBOTS.items() if robot.described]
SECONDS = 8.0


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Sessions of some seconds are enough here."""
    for name, robot in ROBOTS.items():
        monkeypatch.setitem(ROBOTS, name, replace(robot, seconds=SECONDS))


def test_there_are_small_and_large_robots_of_one_to_seven_joints():
    assert len(ROBOTS) >= 8
    assert {len(r.links) for r in ROBOTS.values()} >= {1, 2, 3, 4, 6, 7}
    assert {r.rate for r in ROBOTS.values()} >= {125.0, 2000.0}


@pytest.mark.parametrize("name", DESCRIBED)
def test_mujoco_and_the_exact_urdf_agree(name):
    pin = pytest.importorskip("pinocchio")
    robot = ROBOTS[name]
    motion = session.reference(robot, "wander", 5, robot.step)[::800]
    model = pin.buildModelFromXML(session.urdf(name, exact=True))
    rotor = np.array([link.rotor for link in robot.links])
    data = model.createData()
    expected = [pin.rnea(model, data, *x.T.copy()) + rotor * x[:, 2] for x in motion]
    np.testing.assert_allclose(
        session.effort(robot, motion), expected, rtol=0, atol=1e-9 * np.abs(expected).max()
    )


@pytest.mark.parametrize("name", ["pendulum", "elbow3", "scara4", "light7"])
def test_a_session_obeys_the_equation_of_motion(name, monkeypatch):
    # no noise, encoder or friction law in the way
    links = tuple(replace(link, friction=0.0) for link in ROBOTS[name].links)
    robot = replace(ROBOTS[name], links=links, counts=1e9, noise=1e-9, rate=1.0 / ROBOTS[name].step)
    monkeypatch.setitem(ROBOTS, name, robot)
    s = session.simulate(name, ("points", 2), [], "white", 0)
    v = np.gradient(s["q"], robot.step, axis=0, edge_order=2)
    motion = np.stack([s["q"], v, np.gradient(v, robot.step, axis=0)], -1)[1000:-1000:200]
    needed = session.effort(robot, motion) + motion[..., 1] * [k.viscous for k in links]
    sent = s["tau"][1000:-1000:200]
    # what is left is half a period of the controller
    assert np.sqrt(np.mean((sent - needed) ** 2)) < 0.01 * np.sqrt(np.mean(sent**2))


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_descriptions_load(name):
    known = session.robots()[name]
    if not known["urdf"]:
        assert name == "spindle"
        return
    robot = bare_robot(RobotSource("", known["urdf"]))
    assert robot.joints == known["joints"] and robot.units == known["units"]
    exact = bare_robot(RobotSource("", session.urdf(name, exact=True)))
    q = np.array([[link.middle for link in ROBOTS[name].links]])
    np.testing.assert_allclose(robot.tip(q), exact.tip(q), atol=1e-12)
    off = np.abs(robot.prior[::10] / exact.prior[::10] - 1.0)
    assert np.all((off > 0.01) & (off <= session.WRONG + 1e-9))


@cache
def plain(force):
    """The session that nothing is hidden in: the same for all effects."""
    return session.simulate("elbow3", ("shuttle", 3), [], "white", 1, force)


@pytest.mark.parametrize("effect", NAMES)
def test_every_effect_shows(effect):
    needs = session.kinds()[effect][0]
    force = needs == "force"
    hidden = [{"effect": effect, "joint": 1, "amplitude": 4.0}]
    without = plain(force)
    there = session.simulate("elbow3", ("shuttle", 3), hidden, "white", 1, force)
    assert np.isfinite(there["q"]).all()
    assert any(not np.array_equal(without[key], there[key]) for key in there)


def test_a_seed_repeats_and_another_does_not():
    hidden = [{"effect": "outside-wind", "joint": 0, "amplitude": 1.0}]
    one, same, other = (
        session.simulate("planar2", ("wander", 4), hidden, "coloured", seed) for seed in (7, 7, 8)
    )
    assert all(np.array_equal(one[key], same[key]) for key in one)
    assert not np.array_equal(one["tau"], other["tau"])


def test_rows_can_be_lost():
    whole = session.simulate("pendulum", ("points", 1), [])
    few = session.simulate("pendulum", ("points", 1), [], lost=0.02)
    assert 0.95 * len(whole["t"]) < len(few["t"]) < len(whole["t"])
    assert np.diff(few["t"]).max() > 10 * np.median(np.diff(few["t"]))


def test_a_load_that_is_picked_up_is_the_load_that_hangs_there():
    robot = ROBOTS["elbow3"]
    place = EffectPlace(robot, 0, 5.0, np.random.default_rng(0))
    hung = session.Plant(robot, [{"effect": "payload", "joint": 0, "amplitude": 5.0}], 0)
    taken = session.Plant(robot, [], 0)
    session.pick_up(taken.model, place)(np.inf)
    found = []
    for p in (hung, taken):
        p.data.qpos[:], p.data.qvel[:], p.data.qacc[:] = 0.4, 0.7, 1.1
        p._mj.mj_inverse(p.model, p.data)
        found.append(p.data.qfrc_inverse.copy())
    np.testing.assert_allclose(*found, rtol=1e-4)
    assert describe.inertia(robot.links[-1])[1].shape == (3, 3)


def test_mujoco_is_imported_where_it_is_used_alone():
    for path in Path(session.__file__).parent.glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        top = [n for n in tree.body if isinstance(n, ast.Import | ast.ImportFrom)]
        assert not any("mujoco" in a.name.split(".") for n in top for a in n.names), path
