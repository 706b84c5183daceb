"""Control laws: pure, within the arm's limits, geometry right."""

import dataclasses

import numpy as np
import pytest

from hil import registry
from hil.controllers import dynamics, joint_tracking
from hil.controllers.joint_tracking import JointTracking, JointTrackingConfig
from hil.controllers.position_force import PositionForce, PositionForceConfig
from hil.errors import ConfigError
from hil.rig import safety
from hil.rig.config import ControllerConfig, load_rig
from hil.rig.open import build_controller

ARMS = ("leader", "follower")
LENGTHS = np.array([0.215, 0.170])
LAWS = [
    JointTracking(JointTrackingConfig(seed=3), ARMS, 1e-3),
    PositionForce(PositionForceConfig(), ARMS, 1e-3),
    PositionForce(
        PositionForceConfig(space="workspace", stiffness=(300.0,) * 3, damping=(3.0,) * 3),
        ARMS,
        1e-3,
    ),
]


@pytest.mark.parametrize("law", LAWS)
def test_a_law_is_pure(law):
    rng = np.random.default_rng(0)
    n = len(law.state_names)
    x, u = rng.uniform(0.1, 1, n), rng.uniform(-1, 1, (2, 12))
    kept = x.copy(), u.copy()
    answers = []
    for _ in range(2):
        following, y = np.full(n, np.nan), np.full((2, 3), np.nan)
        law.update(1.234, x, u, following, y)
        answers.append((following, y))
    for a, b in zip(*answers, strict=True):
        assert np.isfinite(a).all()
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(x, kept[0])
    np.testing.assert_array_equal(u, kept[1])


@pytest.mark.parametrize("law", LAWS[1:])
def test_the_follower_is_pulled_to_the_leader(law):
    n = len(law.state_names)
    x, following, y = np.zeros(n), np.zeros(n), np.zeros((2, 3))
    u = np.zeros((2, 12))
    u[:, :3] = [0.1, 0.4, 0.3]
    law.update(0.0, x, u, following, y)
    rest = y.copy()
    u[0, 0] += 0.05
    law.update(0.0, following, u, x, y)
    assert y[1, 0] - rest[1, 0] > 0.01


def test_the_leader_feels_the_force_on_the_follower():
    law = LAWS[1]
    n = len(law.state_names)
    x, following, y = np.zeros(n), np.zeros(n), np.zeros((2, 3))
    u = np.zeros((2, 12))
    u[:, :3] = [0.1, 0.4, 0.3]
    force = np.array([0.5, -0.2, 1.0])
    for loaded in (False, True):
        u[1, 6:9] = force * loaded
        for _ in range(200):
            law.update(0.0, x, u, following, y)
            x, following = following, x
        if not loaded:
            rest = y[0].copy()
    jacobian = np.zeros((3, 3))
    dynamics.jacobian(u[0], LENGTHS, jacobian)
    np.testing.assert_allclose(y[0] - rest, 0.7 * jacobian.T @ force, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_the_motion_stays_within_the_arm_and_repeats(seed):
    config = JointTrackingConfig(seed=seed)
    law = JointTracking(config, ARMS, 1e-3)
    t = np.linspace(0, config.period, 4001)
    for arm in range(2):
        q = np.array(config.center) + joint_tracking.multisine_values(law._c[arm], t, config.period)
        speed = np.abs(np.gradient(q, t, axis=0)).max(0)
        fold = np.rad2deg(q[:, 1] - q[:, 2])
        assert fold.min() > -55
        assert fold.max() < 65
        assert (np.abs(q - config.center).max(0) <= np.array(config.amplitude) + 1e-4).all()
        assert (speed <= np.array(config.speed) * 1.01).all()
        assert (speed > 0.8).all()
        np.testing.assert_allclose(q[0], q[-1], atol=1e-9)
        reversals = (np.diff(np.sign(np.gradient(q, t, axis=0)), axis=0) != 0).sum(0)
        assert (reversals >= 10).all()


def test_other_seeds_are_other_motions_and_the_arms_differ():
    a, b = (JointTracking(JointTrackingConfig(seed=s), ARMS, 1e-3)._c for s in (1, 2))
    assert np.abs(a - b).max() > 0.01
    assert np.abs(a[0] - a[1]).max() > 0.01


def test_the_start_is_the_pose_where_the_arm_is():
    law = LAWS[0]
    n = len(law.state_names)
    u, y, following = np.zeros((2, 12)), np.zeros((2, 3)), np.zeros(n)
    u[:, :3] = [0.2, 0.5, 0.1]
    law.update(0.0, np.zeros(n), u, following, y)
    np.testing.assert_allclose(following[7:13].reshape(2, 3), u[:, :3])


def test_impossible_parameters_are_refused():
    with pytest.raises(ConfigError, match="center"):
        JointTracking(JointTrackingConfig(center=(0.0, 1.5, 0.0)), ARMS, 1e-3)
    with pytest.raises(ConfigError, match="leader and follower"):
        PositionForce(PositionForceConfig(), ("one",), 1e-3)


def test_geometry_there_and_back():
    rng, p, q = np.random.default_rng(0), np.zeros(3), np.zeros(3)
    jacobian, ahead = np.zeros((3, 3)), np.zeros(3)
    for _ in range(50):
        pose = np.array([rng.uniform(-1, 1), rng.uniform(-0.5, 1), 0.0])
        pose[2] = pose[1] + rng.uniform(-0.9, 0.9)
        dynamics.forward_kinematics(pose, LENGTHS, p)
        if np.hypot(p[0], p[1]) < 0.02 or LENGTHS @ [np.cos(pose[1]), np.sin(pose[2])] < 0:
            continue
        dynamics.inverse(p, LENGTHS, q)
        np.testing.assert_allclose(q, pose, atol=1e-9)
        dynamics.jacobian(pose, LENGTHS, jacobian)
        for i in range(3):
            moved = pose.copy()
            moved[i] += 1e-6
            dynamics.forward_kinematics(moved, LENGTHS, ahead)
            np.testing.assert_allclose((ahead - p) / 1e-6, jacobian[:, i], atol=1e-6)


def test_limits_clamp_and_stop():
    limits = np.full(3, 0.5), np.full(3, 10.0)
    effort = np.array([0.7, -0.9, 0.1])
    assert safety.limit(effort, np.zeros(3), *limits) == safety.CLAMPED
    np.testing.assert_array_equal(effort, [0.5, -0.5, 0.1])
    for effort, speed in (
        (np.array([np.nan, 0.1, 0.1]), np.zeros(3)),
        (np.full(3, 0.1), np.array([0.0, 11.0, 0.0])),
        (np.full(3, 0.1), np.array([0.0, np.nan, 0.0])),
    ):
        assert safety.limit(effort, speed, *limits) == safety.INVALID
        assert not effort.any()


#: Parameters with all that a law can do beside its defaults, for the suite below.
GIVEN = {
    "lawrence": {
        **load_rig("lawrence").controller.parameters,
        "disturbance": 1.0,
        "observer_hz": 5.0,
        "fixtures": [{"kind": "line", "stiffness": 100.0, "damping": 0.1}],
    },
    "cartesian-coupling": {
        **load_rig("surgical").controller.parameters,
        "singular_share": 0.99,
        "singular_damping": 0.02,  # more of it, anywhere, is refused: the wrist rings
    },
    "joint-coupling": {"armature": load_rig("arm6").controller.parameters["armature"]},
    "delayed": {"fixtures": [{"kind": "plane"}], "wall": {"stiffness": 200.0}},
}


@pytest.mark.parametrize("name", sorted(registry.names("hil.controllers")))
def test_every_registered_law_keeps_the_contract(name):
    """`hil.signals.device.Controller`: pure, finite, and all of its state and efforts written."""
    law = registry.load("hil.controllers", name)
    any_joints = "surgical" if name == "cartesian-coupling" else "arm6"
    config = load_rig(any_joints if getattr(law, "ANY_JOINTS", False) else "lawrence")
    arms = ("one", "two") if name == "joint-coupling" else config.controller.arms
    table = dict.fromkeys(arms, next(iter(config.arms.values())))
    own = ControllerConfig(name, arms, GIVEN.get(name, {}))
    changes = {"arms": table, "devices": {}} if name == "joint-coupling" else {}
    config = dataclasses.replace(config, controller=own, **changes)
    built = build_controller(config)
    rng, n, d = np.random.default_rng(0), len(built.state_names), len(config.arms[arms[0]].joints)
    assert len(set(built.state_names)) == n
    x, u = np.zeros(n), np.zeros((len(arms), 2 * d + 6))
    u[:, :d] = 0.3
    for k in range(1, 50):
        u[:, : 2 * d] += 1e-3 * rng.normal(size=(len(arms), 2 * d))
        u[:, 2 * d :] = 0.1 * rng.normal(size=(len(arms), 6))
        kept = x.copy(), u.copy()
        answers = []
        for _ in range(2):
            following, y = np.full(n, np.nan), np.full((len(arms), d), np.nan)
            built.update(k * 1e-3, x, u, following, y)
            answers.append((following, y))
        np.testing.assert_array_equal(answers[0][0], answers[1][0])
        np.testing.assert_array_equal(answers[0][1], answers[1][1])
        assert np.isfinite(answers[0][0]).all() and np.isfinite(answers[0][1]).all()
        np.testing.assert_array_equal(x, kept[0])
        np.testing.assert_array_equal(u, kept[1])
        x = answers[0][0]
