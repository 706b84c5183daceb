"""Robots: closed forms against Pinocchio, energy, and finite differences."""

import numpy as np
import pinocchio as pin
import pytest

from hil.errors import ConfigError
from hil.models.phantom import Omni, Premium
from hil.models.robots import IndependentAxes, Robot, make_robot
from hil.models.urdf import UrdfRobot
from hil.record.recording import Recording, RobotSource
from hil.record.urdf_checks import urdf_joints

JOINTS = ("joint1", "joint2", "joint3")
PREMIUM, OMNI = Premium(JOINTS), Omni(JOINTS)
# angles, then joint rates of the tree: q_tree = T q
TREE = np.array([[1, 0, 0], [0, 1, 0], [0, -1, 1], [0, 0, 1], [0, 1, -1]], float)

ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.1 0.02 0.03"/><mass value="1.2"/>
<inertia ixx="0.01" iyy="0.02" izz="0.015" ixy="0.001" ixz="0.002" iyz="-0.001"/></inertial></link>
<link name="slider"><inertial><origin xyz="0.05 0 0"/><mass value="0.7"/>
<inertia ixx="0.004" iyy="0.006" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="wrist"><inertial><origin xyz="0.02 0.01 0"/><mass value="0.4"/>
<inertia ixx="0.001" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tip"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="rail" type="prismatic"><origin xyz="0.3 0 0"/><parent link="upper"/>
<child link="slider"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="9" velocity="9"/></joint>
<joint name="spin" type="continuous"><origin xyz="0.1 0 0" rpy="0.3 0 0"/><parent link="slider"/>
<child link="wrist"/><axis xyz="0 0 1"/></joint>
<joint name="tool" type="fixed"><origin xyz="0.15 0.05 0"/><parent link="wrist"/>
<child link="tip"/></joint></robot>"""


def states(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, qd, qdd = np.random.default_rng(seed).normal(size=(3, n, 3))
    return q, qd, 10 * qdd


def workspace(n: int, seed: int = 1) -> np.ndarray:
    """Premium's joint limits, |theta2 - theta3| included."""
    rng = np.random.default_rng(seed)
    q = np.radians(rng.uniform([-90, -124, -29], [90, 119, 214], (8 * n, 3)))
    difference = np.degrees(q[:, 1] - q[:, 2])
    return q[(difference > -55) & (difference < 65)][:n]


def mass_matrix(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Columns of M from the regressor: unit accelerations at rest, without gravity."""
    still = np.zeros_like(q)
    rest = robot.regressor(q, still, still) @ robot.prior
    units = [robot.regressor(q, still, still + np.eye(3)[k]) @ robot.prior - rest for k in range(3)]
    return np.stack(units, axis=2)


def premium_tree() -> tuple[pin.Model, int]:
    """Theory 1.5: base, be, a (forearm), df, c with the bodies of theory 1.3."""
    l1, l2, l3, l5, l6 = 0.215, 0.170, 0.0325, -0.0368, 0.0527
    model, one = pin.Model(), pin.SE3.Identity()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])

    def place(x: float, z: float) -> pin.SE3:
        return pin.SE3(np.eye(3), np.array([x, 0.0, z]))

    def add(parent: int, joint: object, at: pin.SE3, name: str) -> int:
        return int(model.addJoint(parent, joint, at, name))

    pitch = np.array([0.0, -1.0, 0.0])
    base = add(0, pin.JointModelRZ(), one, "base")
    be = add(base, pin.JointModelRevoluteUnaligned(pitch), one, "be")
    a = add(be, pin.JointModelRevoluteUnaligned(pitch), place(l1, 0), "a")
    df = add(base, pin.JointModelRevoluteUnaligned(pitch), one, "df")
    c = add(df, pin.JointModelRevoluteUnaligned(pitch), place(0, -l3), "c")

    def body(joint: int, m: float, com: tuple[float, float], own: tuple[float, ...]) -> None:
        # inertias are listed (pitch, across, along); in link frames x along u2, y pitch, z
        inertia = np.diag(own)
        model.appendBodyToJoint(joint, pin.Inertia(m, np.array([com[0], 0, com[1]]), inertia), one)

    # u2 bodies: long axis z of the list = x of the frame: (zz, xx, yy); u3 bodies (zz, xx, yy)
    ia, ic = np.array([0.4864, 0.001843, 0.4864]) * 1e-4, np.array([0.959, 0.959, 0.0051]) * 1e-4
    ibe, idf = np.array([11.09, 10.06, 0.591]) * 1e-4, np.array([7.11, 0.629, 6.246]) * 1e-4
    mbe, mdf = 0.2359, 0.1906
    ibe = ibe - mbe * l5**2 * np.array([1, 1, 0])
    idf = idf - mdf * l6**2 * np.array([1, 0, 1])
    body(base, 0.0, (0, 0), (0, 0, 11.87e-4))
    body(be, mbe, (l5, 0), (ibe[2], ibe[0], ibe[1]))
    body(a, 0.0202, (0, -l2 / 2), (ia[2], ia[0], ia[1]))
    body(df, mdf, (0, l6), (idf[2], idf[0], idf[1]))
    body(c, 0.0249, (l1 / 2, 0), (ic[2], ic[0], ic[1]))
    tip = model.addFrame(pin.Frame("tip", a, place(0, -l2), pin.FrameType.OP_FRAME))
    return model, int(tip)


def exact_parameters() -> np.ndarray:
    """pi1..pi8 by theory 1.3 from the listed bodies (the prior is rounded to five digits)."""
    l1, l2, l3, l5, l6, g = 0.215, 0.170, 0.0325, -0.0368, 0.0527, 9.81
    ma, mc, mbe, mdf = 0.0202, 0.0249, 0.2359, 0.1906
    axx, ayy, azz = 0.4864e-4, 0.001843e-4, 0.4864e-4
    cxx, cyy, czz = 0.959e-4, 0.959e-4, 0.0051e-4
    bxx, byy, bzz = 11.09e-4, 10.06e-4, 0.591e-4
    dxx, dyy, dzz = 7.11e-4, 0.629e-4, 6.246e-4
    every = ayy + azz + 2 * 11.87e-4 + byy + bzz + cyy + czz + dyy + dzz
    lever = 4 * l1**2 * ma + l2**2 * ma + l1**2 * mc + 4 * l3**2 * mc
    return np.array(
        [
            (4 * every + lever) / 8,
            (4 * (byy - bzz + cyy - czz) + l1**2 * (4 * ma + mc)) / 8,
            (4 * (ayy - azz + dyy - dzz) - l2**2 * ma - 4 * l3**2 * mc) / 8,
            l1 * (l2 * ma + l3 * mc),
            bxx + cxx + l1**2 * ma + l1**2 * mc / 4,
            axx + dxx + l2**2 * ma / 4 + l3**2 * mc,
            g * (l1 * ma + l5 * mbe + l1 * mc / 2),
            g * (l2 * ma / 2 + l3 * mc - l6 * mdf),
        ]
    )


def test_premium_is_the_pinocchio_tree_with_its_linear_map() -> None:
    model, _ = premium_tree()
    data, pi = model.createData(), exact_parameters()
    q, qd, qdd = states(200)
    got = PREMIUM.regressor(q, qd, qdd) @ pi
    expected = [
        TREE.T @ pin.rnea(model, data, TREE @ a, TREE @ b, TREE @ c)
        for a, b, c in zip(q, qd, qdd, strict=True)
    ]
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)


def test_premium_s_prior_is_the_published_one() -> None:
    np.testing.assert_allclose(PREMIUM.prior, exact_parameters(), rtol=3e-5)


def test_premium_s_jacobian_is_the_tree_s_tip() -> None:
    model, tip = premium_tree()
    data = model.createData()
    q, _, _ = states(50)
    for row, jac in zip(q, PREMIUM.jacobian(q), strict=True):
        whole = pin.computeFrameJacobian(
            model, data, TREE @ row, tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        np.testing.assert_allclose(jac, (whole @ TREE)[:3], atol=1e-14)


def test_premium_s_parameters_are_minimal() -> None:
    q, qd, qdd = states(100)
    y = PREMIUM.regressor(q, qd, qdd).reshape(-1, 8)
    assert np.linalg.matrix_rank(y) == 8


def test_mass_is_symmetric_and_positive_over_the_workspace() -> None:
    m = mass_matrix(PREMIUM, workspace(2000))
    np.testing.assert_allclose(m, m.transpose(0, 2, 1), atol=1e-18)
    assert np.linalg.eigvalsh(m).min() > 8e-4


def test_omni_s_mass_is_positive_below_sixty_degrees() -> None:
    rng = np.random.default_rng(3)
    q = rng.uniform([-1, 0, -0.5], [1, 1.8, 1.2], (4000, 3))
    m = mass_matrix(OMNI, q)
    np.testing.assert_allclose(m, m.transpose(0, 2, 1), atol=1e-18)
    close = np.abs(q[:, 1] - q[:, 2]) < np.pi / 3
    low = np.linalg.eigvalsh(m)[:, 0]
    assert low[close].min() > 0
    assert low.min() < 0  # the published parameters fail when the links align


@pytest.mark.parametrize("robot", [PREMIUM, OMNI], ids=["premium", "omni"])
def test_energy_is_conserved(robot: Robot) -> None:
    """qd'(M qdd + C qd) = d/dt (qd' M qd / 2): what skew symmetry of M' - 2C means."""
    q, qd, qdd = states(300, seed=4)
    still = np.zeros_like(q)
    inertial = (robot.regressor(q, qd, qdd) - robot.regressor(q, still, still)) @ robot.prior
    h = 1e-5

    def kinetic(s: float) -> np.ndarray:
        v = qd + s * qdd
        m = mass_matrix(robot, q + s * qd + s**2 / 2 * qdd)
        return np.einsum("ni,nij,nj->n", v, m, v) / 2

    rate = (kinetic(h) - kinetic(-h)) / (2 * h)
    np.testing.assert_allclose(np.sum(qd * inertial, axis=1), rate, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("robot", [PREMIUM, OMNI], ids=["premium", "omni"])
def test_gravity_and_springs_come_from_a_potential(robot: Robot) -> None:
    q, _, _ = states(50)
    still, h = np.zeros_like(q), 1e-6

    def effort(x: np.ndarray) -> np.ndarray:
        return robot.regressor(x, still, still) @ robot.prior

    slope = [(effort(q + h * e) - effort(q - h * e)) / (2 * h) for e in np.eye(3)]
    stiffness = np.stack(slope, axis=2)
    np.testing.assert_allclose(stiffness, stiffness.transpose(0, 2, 1), atol=1e-8)


def test_omni_is_the_published_form() -> None:
    k = OMNI.prior
    q, _, _ = states(20)
    still = np.zeros_like(q)
    m = mass_matrix(OMNI, q)
    c2, s2, s3 = np.cos(q[:, 1]), np.sin(q[:, 1]), np.sin(q[:, 2])
    m11 = k[0] + k[1] * np.cos(2 * q[:, 1]) + k[2] * np.cos(2 * q[:, 2]) + k[3] * c2 * s3
    np.testing.assert_allclose(m[:, 0, 0], m11, atol=1e-15)
    np.testing.assert_allclose(m[:, 0, 1], k[4] * s2, atol=1e-15)
    np.testing.assert_allclose(m[:, 1, 1], k[5], atol=1e-15)
    np.testing.assert_allclose(m[:, 1, 2], -k[3] / 2 * np.sin(q[:, 1] - q[:, 2]), atol=1e-15)
    n = OMNI.regressor(q, still, still) @ k
    np.testing.assert_allclose(n[:, 0], 0)
    np.testing.assert_allclose(n[:, 1], k[7] * c2 + k[9] * (q[:, 1] - np.pi / 2), atol=1e-15)
    np.testing.assert_allclose(n[:, 2], k[8] * s3, atol=1e-15)


@pytest.mark.parametrize(
    "robot", [PREMIUM, OMNI, IndependentAxes(JOINTS)], ids=["premium", "omni", "axes"]
)
def test_balance_is_the_regressor_s(robot: Robot) -> None:
    rng = np.random.default_rng(4)
    q, qd, qdd = rng.normal(size=(3, 50, 3))
    # each state with bodies of its own
    pi = rng.normal(size=(50, robot.prior.size))
    rest, mass = robot.balance(q, qd, pi)
    tau = np.einsum("ndp,np->nd", robot.regressor(q, qd, qdd), pi)
    np.testing.assert_allclose(rest + np.einsum("nij,nj->ni", mass, qdd), tau, atol=1e-12)
    np.testing.assert_allclose(mass, mass.transpose(0, 2, 1), atol=1e-12)


@pytest.mark.parametrize("robot", [PREMIUM, OMNI], ids=["premium", "omni"])
def test_phantom_jacobian_is_the_derivative_of_the_tip(robot: Premium | Omni) -> None:
    def tip(q: np.ndarray) -> np.ndarray:
        r = robot.l1 * np.cos(q[:, 1]) + robot.l2 * np.sin(q[:, 2])
        z = robot.l1 * np.sin(q[:, 1]) - robot.l2 * np.cos(q[:, 2])
        return np.stack([r * np.cos(q[:, 0]), r * np.sin(q[:, 0]), z], axis=1)

    q, _, _ = states(50)
    h = 1e-6
    slopes = [(tip(q + h * e) - tip(q - h * e)) / (2 * h) for e in np.eye(3)]
    jac = robot.jacobian(q)
    np.testing.assert_allclose(jac, np.stack(slopes, axis=2), atol=1e-9)
    det = robot.l1 * robot.l2 * np.linalg.norm(tip(q)[:, :2], axis=1) * np.cos(q[:, 1] - q[:, 2])
    np.testing.assert_allclose(np.abs(np.linalg.det(jac)), np.abs(det), atol=1e-12)


def test_premium_s_tip_mass_is_the_added_body() -> None:
    bare, tip = premium_tree()
    loaded, _ = premium_tree()
    frame = loaded.frames[tip]
    added = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    loaded.appendBodyToJoint(frame.parentJoint, added, frame.placement)
    q, qd, qdd = states(50)
    one, two = bare.createData(), loaded.createData()
    expected = [
        TREE.T @ (pin.rnea(loaded, two, *x) - pin.rnea(bare, one, *x))
        for x in ((TREE @ a, TREE @ b, TREE @ c) for a, b, c in zip(q, qd, qdd, strict=True))
    ]
    got = PREMIUM.tip_mass(q, qd, qdd)
    np.testing.assert_array_equal(PREMIUM.tip_load(q, qd, qdd)[:, :, 0], got)
    np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-8)


def test_external_effort_is_virtual_work() -> None:
    q, _, _ = states(20)
    wrench = np.random.default_rng(5).normal(size=(20, 6))
    for robot in (PREMIUM, OMNI):
        expected = [j.T @ f for j, f in zip(robot.jacobian(q), wrench[:, :3], strict=True)]
        np.testing.assert_allclose(robot.external(q, wrench), expected, atol=1e-15)


# --- URDF -----------------------------------------------------------------------------------


def pin_state(q: np.ndarray) -> np.ndarray:
    return np.array([q[0], q[1], np.cos(q[2]), np.sin(q[2])])


def test_urdf_regressor_is_inverse_dynamics() -> None:
    robot, model = UrdfRobot(ARM), pin.buildModelFromXML(ARM)
    data = model.createData()
    q, qd, qdd = states(100)
    got = robot.regressor(q, qd, qdd) @ robot.prior
    expected = [
        pin.rnea(model, data, pin_state(a), b, c) for a, b, c in zip(q, qd, qdd, strict=True)
    ]
    np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-11)


def test_urdf_names_joints_units_and_parameters() -> None:
    robot = UrdfRobot(ARM)
    assert robot.joints == ("shoulder", "rail", "spin")
    assert robot.units == ("rad", "m", "rad")
    assert robot.names[:2] == ("shoulder.m", "shoulder.mx")
    assert len(robot.names) == len(robot.param_units) == robot.prior.size == 30
    assert robot.prior[10] == pytest.approx(0.7)


def test_urdf_jacobian_is_the_derivative_of_the_tip() -> None:
    robot, model = UrdfRobot(ARM), pin.buildModelFromXML(ARM)
    data = model.createData()
    frame = model.getFrameId("tip")

    def tip(q: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(model, data, pin_state(q))
        return data.oMf[frame].translation.copy()

    q, _, _ = states(10)
    h = 1e-6
    jac = robot.jacobian(q)
    for row, matrix in zip(q, jac, strict=True):
        slopes = [(tip(row + h * e) - tip(row - h * e)) / (2 * h) for e in np.eye(3)]
        np.testing.assert_allclose(matrix[:3], np.stack(slopes, axis=1), atol=1e-8)
    wrench = np.random.default_rng(6).normal(size=(10, 6))
    expected = [j.T @ w for j, w in zip(jac, wrench, strict=True)]
    np.testing.assert_allclose(robot.external(q, wrench), expected, atol=1e-14)


def test_urdf_tip_mass_is_the_added_body() -> None:
    robot = UrdfRobot(ARM)
    bare, loaded = pin.buildModelFromXML(ARM), pin.buildModelFromXML(ARM)
    frame = loaded.frames[loaded.getFrameId("tip")]
    added = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    loaded.appendBodyToJoint(frame.parentJoint, added, frame.placement)
    one, two = bare.createData(), loaded.createData()
    q, qd, qdd = states(30)
    expected = [
        pin.rnea(loaded, two, pin_state(a), b, c) - pin.rnea(bare, one, pin_state(a), b, c)
        for a, b, c in zip(q, qd, qdd, strict=True)
    ]
    np.testing.assert_allclose(robot.tip_mass(q, qd, qdd), expected, rtol=1e-9, atol=1e-10)


def test_urdf_tip_load_is_a_body_whose_centre_lies_apart_from_the_tip() -> None:
    robot, mass = UrdfRobot(ARM), 0.8
    centre = np.array([0.03, -0.05, 0.11])
    bare, loaded = pin.buildModelFromXML(ARM), pin.buildModelFromXML(ARM)
    frame = loaded.frames[loaded.getFrameId("tip")]
    place = pin.SE3(np.eye(3), frame.placement.translation)
    # second moments about the tip belong to no parameter: m c c' is taken out
    s = -mass * np.outer(centre, centre)
    spread = np.trace(s) * np.eye(3) - s
    point = pin.Inertia(mass, centre, np.zeros((3, 3)))
    added = pin.Inertia.FromDynamicParameters(
        point.toDynamicParameters()
        + np.r_[
            np.zeros(4),
            spread[0, 0],
            spread[0, 1],
            spread[1, 1],
            spread[0, 2],
            spread[1, 2],
            spread[2, 2],
        ]
    )
    loaded.appendBodyToJoint(frame.parentJoint, added, place)
    one, two = bare.createData(), loaded.createData()
    q, qd, qdd = states(30)
    expected = [
        pin.rnea(loaded, two, pin_state(a), b, c) - pin.rnea(bare, one, pin_state(a), b, c)
        for a, b, c in zip(q, qd, qdd, strict=True)
    ]
    got = robot.tip_load(q, qd, qdd) @ np.r_[mass, mass * centre]
    np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-9)


def test_urdf_tip_is_named_or_the_frame_tip_or_the_last() -> None:
    q = np.array([[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(UrdfRobot(ARM).jacobian(q), UrdfRobot(ARM, "tip").jacobian(q))
    assert not np.allclose(UrdfRobot(ARM).jacobian(q), UrdfRobot(ARM, "wrist").jacobian(q))
    renamed = ARM.replace('"tip"', '"end"')
    np.testing.assert_array_equal(UrdfRobot(ARM).jacobian(q), UrdfRobot(renamed).jacobian(q))
    with pytest.raises(ConfigError, match=r"no frame 'tipp'.*wrist"):
        UrdfRobot(ARM, "tipp")


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_urdf_with_a_joint_of_several_freedoms_is_refused_by_name(kind: str) -> None:
    text = ARM.replace('name="spin" type="continuous"', f'name="spin" type="{kind}"')
    with pytest.raises(ConfigError, match="several degrees of freedom: spin"):
        UrdfRobot(text)


@pytest.mark.parametrize("text", ["", "no xml", "<robot", "<robot name='x'></robot>"])
def test_what_is_no_urdf_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="URDF"):
        UrdfRobot(text)


def following(joint: str, mimic: str) -> str:
    """The arm with one of its joints following another one."""
    start = ARM.index(f'<joint name="{joint}"')
    end = ARM.index("</joint>", start)
    return f"{ARM[:end]}{mimic}{ARM[end:]}"


MIMIC = following("spin", '<mimic joint="shoulder" multiplier="-0.5" offset="0.2"/>')
# q_all = A q + b with q = (shoulder, rail)
FOLLOW, SHIFT = np.array([[1, 0], [0, 1], [-0.5, 0]]), np.array([0, 0, 0.2])


def test_a_mimic_joint_follows_and_all_bodies_count() -> None:
    robot, model = UrdfRobot(MIMIC), pin.buildModelFromXML(ARM)
    data = model.createData()
    assert robot.joints == ("shoulder", "rail") and robot.units == ("rad", "m")
    assert len(robot.names) == robot.prior.size == 30
    q, qd, qdd = (x[:, :2] for x in states(50))
    got = robot.regressor(q, qd, qdd) @ robot.prior
    expected = [
        FOLLOW.T @ pin.rnea(model, data, pin_state(FOLLOW @ a + SHIFT), FOLLOW @ b, FOLLOW @ c)
        for a, b, c in zip(q, qd, qdd, strict=True)
    ]
    np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-11)
    rest, mass = robot.balance(q, qd, np.tile(robot.prior, (len(q), 1)))
    np.testing.assert_allclose(rest + np.einsum("nij,nj->ni", mass, qdd), got, rtol=1e-10)
    whole = UrdfRobot(ARM)
    everything = q @ FOLLOW.T + SHIFT, qd @ FOLLOW.T, qdd @ FOLLOW.T
    np.testing.assert_allclose(robot.jacobian(q), whole.jacobian(everything[0]) @ FOLLOW)
    np.testing.assert_allclose(robot.tip_mass(q, qd, qdd), whole.tip_mass(*everything) @ FOLLOW)


def test_model_and_importer_see_the_same_joints() -> None:
    for text in (ARM, MIMIC, following("shoulder", '<mimic joint="rail"/>')):
        assert UrdfRobot(text).joints == tuple(j.name for j in urdf_joints(text))


def test_a_joint_may_follow_one_that_follows() -> None:
    start = MIMIC.index('<joint name="rail"')
    end = MIMIC.index("</joint>", start)
    text = MIMIC[:end] + '<mimic joint="spin" multiplier="2" offset="1"/>' + MIMIC[end:]
    robot, whole = UrdfRobot(text), UrdfRobot(ARM)
    assert robot.joints == ("shoulder",)
    q = np.array([[0.4]])
    expected = whole.jacobian(np.array([[0.4, 1.0, 0.0]])) @ [[1.0], [-1.0], [-0.5]]
    np.testing.assert_allclose(robot.jacobian(q), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("mimic", "message"),
    [
        ('<mimic joint="spin"/>', "'spin' mimics 'spin', expected another moving joint"),
        ('<mimic joint="elbow"/>', "mimics 'elbow', expected another moving joint .shoulder, rail"),
        ('<mimic joint="rail" multiplier="x"/>', "the URDF does not parse"),
    ],
)
def test_mimic_joints_that_follow_nothing_are_refused(mimic: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        UrdfRobot(following("spin", mimic))


@pytest.mark.parametrize(
    ("kind", "limit"),
    [
        ("revolute", '<limit lower="-2" upper="2"/>'),
        ("revolute", '<limit lower="-2" upper="2" effort="9"/>'),
        ("revolute", '<limit lower="-2" upper="2" velocity="9"/>'),
        ("revolute", '<limit lower="-inf" upper="inf" effort="inf" velocity="inf"/>'),
        ("revolute", ""),
        ("revolute", '<limit lower="-2" upper="2"/><dynamics/><safety_controller/>'),
        ("continuous", "<limit/>"),
    ],
)
def test_bodies_need_no_limits(kind: str, limit: str) -> None:
    old = '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="9"/>'
    text = ARM.replace(old, f'<axis xyz="0 1 0"/>{limit}')
    text = text.replace('name="shoulder" type="revolute"', f'name="shoulder" type="{kind}"')
    assert text != ARM
    np.testing.assert_array_equal(UrdfRobot(text).regressor(*states(5)), FULL)


FULL = UrdfRobot(ARM).regressor(*states(5))


# --- presets --------------------------------------------------------------------------------


def recording(joints: tuple[str, ...], unit: str = "rad") -> Recording:
    zero = np.zeros((5, len(joints)))
    return Recording("run", "arm", joints, np.arange(5.0), zero, zero, metadata={"unit": unit})


def test_independent_axes_have_one_inertia_each() -> None:
    qdd = np.random.default_rng(0).normal(size=(7, 2))
    axes = IndependentAxes(("a", "b"), "m")
    y = axes.regressor(0 * qdd, 0 * qdd, qdd)
    np.testing.assert_allclose(y @ [2.0, 3.0], qdd * [2.0, 3.0])
    assert axes.names == ("m1", "m2") and axes.param_units == ("kg", "kg")
    assert axes.tip_mass(qdd, qdd, qdd) is None
    assert axes.tip_load(qdd, qdd, qdd) is None
    with pytest.raises(ConfigError, match="record tauext1"):
        axes.external(qdd, np.zeros((7, 6)))


def test_presets_follow_the_recording() -> None:
    one = make_robot(RobotSource("single-axis"), recording(("x",), "m"))
    assert one.units == ("m",) and one.names == ("m",) and not one.has_armature
    arm = make_robot(RobotSource("phantom-premium-1.5"), recording(("a", "b", "c")))
    assert arm.joints == ("a", "b", "c")
    assert make_robot(RobotSource("phantom-omni"), recording(JOINTS)).prior.size == 10


def test_wrong_robots_are_refused() -> None:
    with pytest.raises(ConfigError, match="Did you mean 'phantom-omni'"):
        make_robot(RobotSource("phantom-omi"), recording(JOINTS))
    with pytest.raises(ConfigError, match=r"3 joints \(.*\) but recording 'run' has 2"):
        make_robot(RobotSource("phantom-omni"), recording(("a", "b")))
    with pytest.raises(ConfigError, match="shoulder, rail, spin"):
        make_robot(RobotSource("", ARM), recording(("a",)))
    with pytest.raises(ConfigError, match=r"in the order rail, shoulder, spin, the robot in"):
        make_robot(RobotSource("", ARM), recording(("rail", "shoulder", "spin")))
    make_robot(RobotSource("", ARM), recording(("shoulder", "rail", "spin")))
    make_robot(RobotSource("", ARM), recording(("a", "b", "c")))
