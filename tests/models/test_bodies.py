"""The batch regressor against Pinocchio's, for every kind of joint and a branched tree."""

import numpy as np
import pinocchio as pin

from hil.models.urdf import UrdfRobot

AXES = {
    "revolute": "0.36 0.48 0.8",
    "prismatic": "0.48 -0.6 0.64",
    "continuous": "0 0.6 0.8",
    "last": "0 0 1",
}
PARENTS = {"revolute": "base", "prismatic": "l0", "continuous": "l0", "last": "l2"}


def tree() -> str:
    """Four bodies, two of them behind the first one."""
    out = '<link name="base"/>'
    for k, name in enumerate(AXES):
        kind = "revolute" if name == "last" else name
        out += (
            f'<link name="l{k}"><inertial><origin xyz="0.1 {0.2 - 0.1 * k} 0.05" rpy="0.1 0 0.3"/>'
            f'<mass value="{1.2 - 0.2 * k}"/><inertia ixx="0.02" iyy="0.03" izz="0.04" '
            'ixy="0.001" ixz="0.002" iyz="0.003"/></inertial></link>'
            f'<joint name="j{k}" type="{kind}">'
            f'<origin xyz="0.2 0.1 {0.1 * k}" rpy="0.4 0.{k} 0.3"/><parent link="{PARENTS[name]}"/>'
            f'<child link="l{k}"/><axis xyz="{AXES[name]}"/>'
            '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        )
    return f'<robot name="tree">{out}</robot>'


def test_regressor_and_tip_mass_are_pinocchios() -> None:
    robot = UrdfRobot(tree())
    model = pin.buildModelFromXML(tree())
    data = model.createData()
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 40, 4))
    ours, tip = robot.regressor(q, qd, qdd), robot.tip_mass(q, qd, qdd)
    assert tip is not None
    frame, world = model.nframes - 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for k in range(len(q)):
        state = pin.integrate(model, pin.neutral(model), q[k])
        theirs = pin.computeJointTorqueRegressor(model, data, state, qd[k], qdd[k])
        np.testing.assert_allclose(ours[k], theirs, atol=1e-12)
        pin.forwardKinematics(model, data, state, qd[k], qdd[k])
        a = pin.getFrameClassicalAcceleration(model, data, frame, world).linear
        jacobian = pin.computeFrameJacobian(model, data, state, frame, world)[:3]
        np.testing.assert_allclose(tip[k], jacobian.T @ (a - model.gravity.linear), atol=1e-12)


def test_balance_is_pinocchios() -> None:
    robot = UrdfRobot(tree())
    model = pin.buildModelFromXML(tree())
    data = model.createData()
    rng = np.random.default_rng(1)
    q, qd = rng.normal(size=(2, 40, 4))
    # each state with bodies of its own
    pi = robot.prior * rng.uniform(0.5, 2.0, (40, 1))
    rest, mass = robot.balance(q, qd, pi)
    for k in range(len(q)):
        for i, inertia in enumerate(np.split(pi[k], 4)):
            model.inertias[i + 1] = pin.Inertia.FromDynamicParameters(inertia)
        state = pin.integrate(model, pin.neutral(model), q[k])
        np.testing.assert_allclose(rest[k], pin.nle(model, data, state, qd[k]), atol=1e-12)
        upper = np.triu(pin.crba(model, data, state))
        theirs = upper + np.triu(upper, 1).T
        np.testing.assert_allclose(mass[k], theirs, atol=1e-12)
