"""Robot descriptions as their packages ship them: joints by name, the others locked, unedited."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import numpy as np
import pinocchio
import pytest

import hil
from hil.identify.problem import Problem
from hil.models.urdf import UrdfRobot
from hil.record.locked import free_joints, locked_urdf

#: File of the package example-robot-data, and first and last joint of the arm.
ROBOTS = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_joint1", "panda_joint7"),
    "ur3": ("ur_description/urdf/ur3_robot.urdf", "shoulder_pan_joint", "wrist_3_joint"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "shoulder_pan_joint", "wrist_3_joint"),
    "ur5-gripper": ("ur_description/urdf/ur5_gripper.urdf", "shoulder_pan_joint", "wrist_3_joint"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "joint1", "joint7"),
    "tiago": ("tiago_description/robots/tiago.urdf", "arm_1_joint", "arm_7_joint"),
    "tiago-pro": (
        "tiago_pro_description/robots/tiago_pro.urdf",
        "arm_left_1_joint",
        "arm_left_7_joint",
    ),
    "kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_joint_1", "j2s6s200_joint_6"),
}


@pytest.fixture(params=ROBOTS)
def robot(request):
    """URDF file, and the names of the arm's joints."""
    file, first, last = ROBOTS[request.param]
    try:
        listed = metadata.files("example-robot-data") or []
    except metadata.PackageNotFoundError:
        pytest.skip("the package example-robot-data, which ships these files, is not installed")
    found = [Path(f.locate()) for f in listed if str(f).endswith(f"robots/{file}")]
    assert found, f"example-robot-data ships no {file}"
    names = [j.name for j in free_joints(found[0].read_text())]
    return found[0], names[names.index(first) : names.index(last) + 1]


def test_an_arm_of_the_stock_description_is_taken_by_its_joints(robot):
    path, joints = robot
    free = {j.name: j for j in free_joints(path.read_text())}
    t = np.arange(600) / 200.0
    q = np.empty((t.size, len(joints)))
    for k, name in enumerate(joints):
        low, high = getattr(free[name], "lower", None), getattr(free[name], "upper", None)
        middle = 0.0 if low is None else float(np.clip(0.0, low, high))
        q[:, k] = middle + 0.01 * np.sin((1 + 0.3 * k) * 2 * t)
    run = hil.from_arrays(t, q, np.cos(q), robot=path, joints=joints)
    assert run.joints == tuple(joints)
    problem = Problem([run], run.robot)
    assert tuple(problem.joints) == tuple(joints)
    whole = UrdfRobot(run.robot.urdf)
    assert np.isfinite(whole.tip(q)).all()


def test_the_locked_robot_weighs_what_the_whole_one_does(robot):
    """Gravity of the arm by pinocchio: whole robot with the others at rest, and the locked one."""
    path, joints = robot
    text, at = locked_urdf(path.read_text(), joints, {})
    whole = pinocchio.buildModelFromUrdf(str(path))
    small = pinocchio.buildModelFromXML(text)
    q0 = pinocchio.neutral(whole)
    for name, value in at.items():
        joint = whole.joints[whole.getJointId(name)]
        if joint.nq == 1 and name in whole.names:
            q0[joint.idx_q] = value
    tau = pinocchio.computeGeneralizedGravity(whole, whole.createData(), q0)
    own = pinocchio.computeGeneralizedGravity(small, small.createData(), pinocchio.neutral(small))
    for name in joints:
        a = whole.joints[whole.getJointId(name)].idx_v
        b = small.joints[small.getJointId(name)].idx_v
        assert own[b] == pytest.approx(tau[a], abs=1e-9)
