"""A body on a link: its effort against Pinocchio's, and which bodies there can be."""

import numpy as np
import pinocchio as pin
import pytest
from test_robots import ARM, PREMIUM, TREE, pin_state, premium_tree, states

from hil.models import catalogue
from hil.models.bodies import parameters, pseudo_inertia
from hil.models.effect import refused
from hil.models.motion import Motion
from hil.models.payload import _apart
from hil.models.robots import Robot
from hil.models.urdf import UrdfRobot

PAYLOAD = catalogue.get("payload")
MASS, CENTRE = 0.8, np.array([0.03, -0.05, 0.11])
ABOUT = np.array([[0.004, 0.0005, 0.0002], [0.0005, 0.005, -0.0003], [0.0002, -0.0003, 0.003]])
BODY = pin.Inertia(MASS, CENTRE, ABOUT)


def real(motion: Motion, j: int, shape, beta, error=()) -> bool:
    """Whether a payload of these values can be."""
    return not refused(PAYLOAD, motion, j, shape, beta, error)


def order(body: pin.Inertia) -> np.ndarray:
    """Parameters (10,) in the order of the effect, which is Pinocchio's."""
    return np.asarray(body.toDynamicParameters())


def moving(robot: Robot, n: int = 300) -> Motion:
    """A run over many postures whose efforts are those of a body of one kilogram at the tip."""
    q, qd, qdd = states(n)
    zero, d = np.zeros_like(q), q.shape[1]
    tau = robot.tip_mass(q, qd, qdd)
    assert tau is not None
    return Motion(
        t=np.arange(n) * 0.01,
        q=q,
        qd=qd,
        qdd=qdd,
        tau=tau,
        tau_ext=zero,
        load=zero,
        static=zero,
        v0=np.full(d, 0.01),
        resolution=np.full(d, 0.01),
        span=np.array([[-1.0, 1.0]] * d),
        contact=np.full((d, 2), np.nan),
        robot=robot,
    )


@pytest.mark.parametrize("link", [1, 2, 3])
def test_a_body_on_any_link_of_a_urdf_is_pinocchios(link: int) -> None:
    bare, loaded = pin.buildModelFromXML(ARM), pin.buildModelFromXML(ARM)
    tip = loaded.frames[loaded.getFrameId("tip")]
    place = pin.SE3.Identity()
    if link == tip.parentJoint:
        place = pin.SE3(np.eye(3), tip.placement.translation)
    loaded.appendBodyToJoint(link, BODY, place)
    one, two = bare.createData(), loaded.createData()
    q, qd, qdd = states(30)
    expected = [
        pin.rnea(loaded, two, pin_state(a), b, c) - pin.rnea(bare, one, pin_state(a), b, c)
        for a, b, c in zip(q, qd, qdd, strict=True)
    ]
    got = UrdfRobot(ARM).body_load(q, qd, qdd, link) @ order(BODY)
    np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(("link", "joint"), [(1, "base"), (2, "be"), (3, "a")])
def test_a_body_on_any_link_of_a_preset_is_pinocchios(link: int, joint: str) -> None:
    bare, tip = premium_tree()
    loaded, _ = premium_tree()
    place = loaded.frames[tip].placement if link == 3 else pin.SE3.Identity()
    loaded.appendBodyToJoint(loaded.getJointId(joint), BODY, place)
    one, two = bare.createData(), loaded.createData()
    q, qd, qdd = states(30)
    expected = [
        TREE.T @ (pin.rnea(loaded, two, *x) - pin.rnea(bare, one, *x))
        for x in ((TREE @ a, TREE @ b, TREE @ c) for a, b, c in zip(q, qd, qdd, strict=True))
    ]
    got = PREMIUM.body_load(q, qd, qdd, link) @ order(BODY)
    np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-9)


def test_the_tip_s_link_comes_first_then_the_others_from_the_base_on() -> None:
    assert UrdfRobot(ARM).links == (3, 1, 2)
    assert UrdfRobot(ARM, tip="slider").links == (2, 1, 3)
    assert [s[0] for s in PAYLOAD.search.grid(moving(PREMIUM), 0)] == [3.0, 1.0, 2.0]


def test_a_pseudo_inertia_and_the_parameters_are_one() -> None:
    pi = order(BODY)
    np.testing.assert_allclose(parameters(pseudo_inertia(pi)), pi, rtol=1e-12)
    assert np.linalg.eigvalsh(pseudo_inertia(pi))[0] > 0


def test_bodies_that_there_can_be_are_credible() -> None:
    motion, body = moving(UrdfRobot(ARM)), order(BODY)
    point = order(pin.Inertia(MASS, CENTRE, np.zeros((3, 3))))
    for link in (1.0, 2.0, 3.0):
        for one in (body, -body, point):
            assert real(motion, 0, (link,), one)
        # one run with a load, one with another, the first without
        assert real(motion, 0, (link,), np.concatenate([body, 0.5 * point]))
        # the first run carried both
        assert real(motion, 0, (link,), np.concatenate([-body, -body - point]))


@pytest.mark.parametrize(("share", "can_be"), [(0.05, True), (0.3, False)])
def test_runs_without_a_body_seem_to_carry_what_a_law_misses(share: float, can_be: bool) -> None:
    """Of three runs the second carries one, the third less than it than there can be."""
    motion, body = moving(UrdfRobot(ARM)), order(BODY)
    flat = np.r_[np.zeros(4), 0.3, np.zeros(5)]
    rows = PAYLOAD.columns(motion, 0, (3.0,))
    size = np.linalg.norm(rows @ body) / np.linalg.norm(rows @ flat)
    assert real(motion, 0, (3.0,), np.concatenate([body, share * size * flat])) is can_be


def test_bodies_that_there_cannot_be_are_not() -> None:
    motion = moving(UrdfRobot(ARM))
    far = np.r_[0.05, 0.4, np.zeros(8)]  # a centre 8 m away, and no inertia from that
    flat = np.r_[np.zeros(4), 0.3, np.zeros(5)]  # against the triangle inequality
    for body in (far, flat):
        assert not real(motion, 0, (3.0,), body)
    errors = np.full(10, 1e-4)
    assert not real(motion, 0, (3.0,), flat, errors)
    assert real(motion, 0, (3.0,), flat, 1e4 * errors)


def test_what_no_motion_shows_is_free() -> None:
    """On a turntable only the inertia about its axis acts: any other value will do."""
    motion = moving(PREMIUM)
    only = np.zeros(10)
    only[9] = 0.002
    assert real(motion, 0, (1.0,), only)
    only[1] = 5.0
    assert real(motion, 0, (1.0,), only)


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_whatever_body_there_is_can_be(joints: int) -> None:
    """Few joints show few of its parameters, of which the estimate alone is no body."""
    motion, rng = moving(PREMIUM), np.random.default_rng(joints)
    seen = PAYLOAD.columns(motion, 0, (3.0,))[:, :joints].reshape(-1, 10)
    rotate, size = np.linalg.qr(seen)[1], np.linalg.norm(seen, axis=0)
    live = size > 1e-9 * size.max()
    for _ in range(40):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        spread = turn @ np.diag(rng.uniform(0.01, 0.1, 3) ** 2) @ turn.T
        mass = rng.uniform(0.1, 2.0)
        about = mass * (np.trace(spread) * np.eye(3) - spread)
        body = order(pin.Inertia(mass, rng.normal(size=3) * 0.2, about))
        # what a fit makes of it: the shortest of all values that act alike, nearly
        known = np.where(
            live, np.linalg.pinv(rotate / np.where(live, size, 1), 1e-9) @ (rotate @ body), 0
        )
        known = np.where(live, known / np.where(live, size, 1), 0)
        known *= 1 + 1e-4 * rng.normal(size=10)
        assert _apart(rotate, known) < 1e-3 * np.sum((rotate @ known) ** 2)
