"""Joints that are locked: the robot that is left against Pinocchio's reduced model."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from hil.errors import ConfigError
from hil.models.urdf import UrdfRobot
from hil.record.bags import BagChoice
from hil.record.locked import columns_robot, frame_axes, free_joints, locked_urdf
from hil.record.recording import Recording, RobotSource
from hil.record.sources import subset


def link(name, mass=0.0):
    """Link with a body off its centre, and a mesh of a package that is not there."""
    mesh = '<visual><geometry><mesh filename="package://none/m.dae"/></geometry></visual>'
    body = (
        f'<inertial><origin xyz="0.02 -0.01 0.1" rpy="0.1 0.2 0.3"/><mass value="{mass}"/>'
        '<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0.002" izz="0.01"/></inertial>'
    )
    return f'<link name="{name}">{body if mass else ""}{mesh}</link>'


def joint(
    name,
    kind,
    parent,
    child,
    axis="0 0 1",
    more='<limit lower="-2" upper="2" effort="9" velocity="9"/>',
):
    origin = '<origin xyz="0.1 0.05 0.2" rpy="0.4 -0.7 1.1"/>'
    return (
        f'<joint name="{name}" type="{kind}">{origin}<parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>{more}</joint>'
    )


def stock():
    """An arm on a mobile base as its makers publish it: leftovers of xacro, wheels, fingers."""
    limits = '<limit lower="-3.1" upper="-0.1" effort="9" velocity="9"/>'
    finger = '<limit lower="0" upper="0.04" effort="9" velocity="9"/>'
    mimic = finger + '<mimic joint="finger1" multiplier="2" offset="0.005"/>'
    leader = limits + '<mimic joint="elbow" multiplier="-0.5" offset="0.1"/>'
    return "".join(
        [
            '<robot name="stock" xmlns:xacro="http://ros.org/wiki/xacro">',
            '<xacro:macro name="left_over"/>',
            '<material name="grey"><color rgba="1 1 1 1"/></material>',
            *map(link, ("world", "base", "flange", "camera")),
            *(link(n, k + 1.0) for k, n in enumerate(("lift", "upper", "fore", "hand", "rod"))),
            *(link(n, 0.2) for n in ("wheel_l", "wheel_r", "finger_l", "finger_r")),
            joint("drive", "floating", "world", "base"),
            joint("left", "continuous", "base", "wheel_l", more=""),
            joint("right", "continuous", "base", "wheel_r", more=""),
            joint("column", "prismatic", "base", "lift"),
            joint("shoulder", "revolute", "lift", "upper", "0 0.6 0.8"),
            joint("elbow", "revolute", "upper", "fore", "0 1 0", limits),
            joint("follower", "revolute", "upper", "rod", "1 0 0", leader),
            joint("tool", "fixed", "fore", "flange", more=""),
            joint("eye", "fixed", "flange", "camera", more=""),
            joint("wrist", "revolute", "flange", "hand", "1 0 0"),
            joint("finger1", "prismatic", "hand", "finger_l", "0 1 0", finger),
            joint("finger2", "prismatic", "hand", "finger_r", "0 -1 0", mimic),
            '<transmission name="t"><actuator name="m"/></transmission><gazebo/></robot>',
        ]
    )


KEEP = ("shoulder", "elbow", "wrist")
AT = {"column": 0.3, "left": 1.2, "finger1": 0.03}


def test_a_stock_robot_has_the_arms_joints_alone():
    names = [j.name for j in free_joints(stock())]
    assert set(names) == {*KEEP, *AT, "right"}
    text, locked = locked_urdf(stock(), KEEP, AT)
    assert locked == {**AT, "right": 0.0}
    assert UrdfRobot(text).joints == KEEP


def test_efforts_of_the_locked_robot_are_those_of_the_whole_one():
    rng = np.random.default_rng(1)
    q, v, a = (rng.uniform(-1, 1, (5, 3)) for _ in range(3))
    text, _ = locked_urdf(stock(), KEEP, AT)
    robot = UrdfRobot(text)
    found = robot.regressor(q, v, a) @ robot.prior

    whole = pin.buildModelFromXML(locked_urdf(stock(), [*KEEP, *AT, "right"], {})[0])
    data = whole.createData()
    place = {"follower": (-0.5, 0.1, "elbow")}
    for k in range(5):
        free, speed, acc = (dict(zip(KEEP, x[k], strict=True)) for x in (q, v, a))
        full = pin.neutral(whole)
        dq, ddq = np.zeros(whole.nv), np.zeros(whole.nv)
        free |= {**AT, "right": 0.0, "finger2": 2 * AT["finger1"] + 0.005}
        for name, (factor, offset, leader) in place.items():
            free[name] = factor * free[leader] + offset
            speed[name], acc[name] = factor * speed[leader], factor * acc[leader]
        for n, name in enumerate(whole.names[1:], 1):
            at, one = whole.idx_qs[n], free[name]
            wide = whole.joints[n].nq == 2
            full[at : at + 1 + wide] = [np.cos(one), np.sin(one)] if wide else one
            dq[whole.idx_vs[n]], ddq[whole.idx_vs[n]] = speed.get(name, 0), acc.get(name, 0)
        tau = pin.rnea(whole, data, full, dq, ddq)
        by_name = {n: tau[whole.idx_vs[i]] for i, n in enumerate(whole.names[1:], 1)}
        by_name["elbow"] += -0.5 * by_name["follower"]
        np.testing.assert_allclose(found[k], [by_name[n] for n in KEEP], atol=1e-9)


def test_zero_out_of_reach_is_the_next_limit():
    _, locked = locked_urdf(stock(), ["shoulder"], {})
    assert locked["elbow"] == -0.1


def test_axes_of_a_link_are_those_of_pinocchio():
    text, _ = locked_urdf(stock(), KEEP, AT)
    model = pin.buildModelFromXML(text)
    data = model.createData()
    q = np.random.default_rng(2).uniform(-1, 1, (4, 3))
    axes = frame_axes(text, "camera", KEEP, q)
    for k in range(4):
        full = pin.neutral(model)  # the joint that mimics is one of its own here
        for name, value in zip(KEEP, q[k], strict=True):
            full[model.idx_qs[model.getJointId(name)]] = value
        pin.framesForwardKinematics(model, data, full)
        want = data.oMf[model.getFrameId("camera")].rotation
        np.testing.assert_allclose(axes[k], want, atol=1e-12)
    assert frame_axes(text, "nowhere", KEEP, q) is None


@pytest.mark.parametrize(
    ("keep", "at", "said"),
    [(["elbw"], {}, "elbow"), (["elbow"], {"wheel": 0.0}, "left"), ([], {"tool": 0.0}, "moving")],
)
def test_unknown_joints_are_named(keep, at, said):
    with pytest.raises(ValueError, match=said):
        locked_urdf(stock(), keep, at)


def test_some_joints_of_a_recording():
    text, _ = locked_urdf(stock(), KEEP, AT)
    t = np.arange(50) * 0.01
    q = np.stack([np.sin(t), np.full(50, 0.4), np.cos(t)], axis=1)
    whole = Recording("run", "arm", KEEP, t, q, 2 * q, robot=RobotSource("", text))
    part = subset(whole, BagChoice(joints=("wrist", "shoulder")))
    assert part.joints == ("shoulder", "wrist")
    np.testing.assert_array_equal(part.tau, 2 * q[:, [0, 2]])
    assert UrdfRobot(part.robot.urdf).joints == part.joints
    assert part.metadata["locked"] == '{"elbow": 0.4}'
    with pytest.raises(ValueError, match=r"'run' has no joint hip"):
        subset(whole, BagChoice(joints=("hip",)))


def test_a_recorded_joint_is_locked_where_it_stood_or_not_at_all():
    text, _ = locked_urdf(stock(), KEEP, AT)
    t = np.arange(500) * 0.01
    q = np.stack([np.sin(t), np.full(500, -0.4), 0.3 * np.cos(t)], axis=1)
    whole = Recording("run", "arm", KEEP, t, q, 2 * q, robot=RobotSource("", text))
    still = subset(whole, BagChoice(lock={"elbow": -0.38}))
    assert still.joints == ("shoulder", "wrist") and "note" not in still.metadata
    for moving in (BagChoice(lock={"wrist": 0.1}), BagChoice(joints=("shoulder", "elbow"))):
        said = subset(whole, moving).metadata["note"]
        assert "wrist is left out although it moves from -0.3 to 0.3 rad, and is locked at" in said
    with pytest.raises(
        ConfigError, match=r"'elbow' between -0.4 and -0.4 rad, it cannot be locked"
    ):
        subset(whole, BagChoice(lock={"elbow": -0.6}))
    with pytest.raises(ConfigError, match=r"locked at 5 rad, its range in the URDF is .*; give a"):
        subset(whole, BagChoice(lock={"elbow": 5.0}))
    with pytest.raises(ConfigError, match=r"joint 'column' is to be locked at 30 "):
        columns_robot(RobotSource("", stock()), KEEP, {**AT, "column": 30.0}, 3)
