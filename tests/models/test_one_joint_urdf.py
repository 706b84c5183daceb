"""A URDF with a single joint: every shape that Pinocchio flattens for it."""

from __future__ import annotations

import numpy as np

from hil.models.robots import make_robot
from hil.record.recording import Recording, RobotSource

URDF = """<robot name="pendulum"><link name="base"/><link name="rod"><inertial>
<origin xyz="0 0 -0.2"/><mass value="0.5"/><inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0"
ixz="0" iyz="0"/></inertial></link><joint name="hinge" type="revolute"><parent link="base"/>
<child link="rod"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="5" velocity="9"/></joint>
</robot>"""


def test_regressor_and_jacobian_of_a_pendulum() -> None:
    q = np.linspace(-1, 1, 5)[:, None]
    source = RobotSource(preset="", urdf=URDF)
    robot = make_robot(source, Recording("x", "arm", ("hinge",), q[:, 0], q, q, robot=source))
    effort = robot.regressor(q, 0 * q, 0 * q) @ robot.prior
    assert np.allclose(np.abs(effort[:, 0]), 0.5 * 9.81 * 0.2 * np.abs(np.sin(q[:, 0])), atol=1e-3)
    push = np.tile([1.0, 0, 0, 0, 0, 0], (5, 1))
    assert robot.external(q, push).shape == (5, 1)
