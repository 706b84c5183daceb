"""Laws in joint space for any number of joints."""

import numpy as np
import pinocchio as pin
import pytest

from hil import registry
from hil.controllers.joint_space import Chain
from hil.errors import ConfigError
from hil.rigs import rig_path
from hil.signals.settable import ArmDescription

URDF = rig_path("arm6").with_name("arm6.urdf").read_text()
JOINTS = ("base_turn", "shoulder_lift", "elbow", "wrist_roll", "wrist_pitch", "wrist_turn")
ARM = ArmDescription(JOINTS, URDF, (-1.0,) * 6, (1.0,) * 6, (0.1,) * 6, (9.0,) * 6)
PERIOD = 2e-3


def built(name, arms=("arm",), **parameters):
    law = registry.load("hil.controllers", name)
    return law.build(law.Config(**parameters), arms, PERIOD, (ARM,) * len(arms))


def test_efforts_of_the_chain_are_those_of_an_independent_library():
    rng = np.random.default_rng(1)
    model = pin.buildModelFromXML(URDF)
    for _ in range(5):
        q, v, a = rng.uniform(-2.0, 2.0, (3, 6))
        expected = pin.rnea(model, model.createData(), q, v, a)
        assert np.allclose(Chain(ARM).efforts(q, v, a), expected, rtol=1e-10, atol=1e-10)


def closed(law, seconds, q, push=lambda t: 0.0, arms=1):
    """The law on the bodies of the URDF, by pinocchio: positions of all arms at every tick."""
    model = pin.buildModelFromXML(URDF)
    data = model.createData()
    n = len(law.state_names)
    x, x_next = np.zeros(n), np.zeros(n)
    u, y, v = np.zeros((arms, 18)), np.zeros((arms, 6)), np.zeros((arms, 6))
    q, seen = np.array(q, float).reshape(arms, 6), []
    for k in range(round(seconds / PERIOD)):
        u[:, :6], u[:, 6:12] = q, v
        law.update(k * PERIOD, x, u, x_next, y)
        x, x_next = x_next, x
        for a in range(arms):
            tau = y[a] + (push(k * PERIOD) if a == 0 else 0.0)
            for _ in range(8):
                v[a] += PERIOD / 8 * pin.aba(model, data, q[a], v[a], tau)
                q[a] += PERIOD / 8 * v[a]
        seen.append(q.copy())
    return np.array(seen)


@pytest.mark.parametrize("name", ["joint-pd", "computed-torque"])
def test_the_arm_goes_to_its_posture_without_a_jump(name):
    seen = closed(built(name, center=(0.3, 0.2, -0.4, 0.5, -0.3, 0.4)), 3.0, np.zeros(6))
    assert np.abs(seen[0]).max() < 1e-4
    assert np.abs(seen[-1, 0] - (0.3, 0.2, -0.4, 0.5, -0.3, 0.4)).max() < 5e-3


def test_computed_torque_follows_closer_than_pd():
    goal = (1.0, 0.7, -0.8, 0.5, -0.3, 0.4)
    ways = {
        n: closed(built(n, center=goal), 1.2, np.zeros(6)) for n in ("joint-pd", "computed-torque")
    }
    ramp = (1 - np.cos(np.pi * np.minimum(1.0, np.arange(len(ways["joint-pd"])) * PERIOD))) / 2
    off = {n: np.abs(w[:, 0] - ramp[:, None] * np.array(goal)).max() for n, w in ways.items()}
    assert off["computed-torque"] < 0.3 * off["joint-pd"]


def test_two_coupled_arms_follow_each_other_and_keep_their_offset():
    start = np.array([[0.2, 0.1, 0.0, 0.0, 0.0, 0.0], [0.0] * 6])
    law = built("joint-coupling", ("a", "b"))
    seen = closed(law, 2.0, start, lambda t: np.array([0.3, 0, 0, 0.02, 0, 0]) * (t < 0.8), 2)
    assert np.abs(seen[:, 0] - seen[0, 0]).max() > 0.05
    gap = seen[-1, 0] - seen[-1, 1]
    assert np.abs(gap - start[0]).max() < 0.02


def test_a_law_does_not_allocate():
    import tracemalloc

    law = built("computed-torque")
    n = len(law.state_names)
    x, x_next, u, y = np.zeros(n), np.zeros(n), np.zeros((1, 18)), np.zeros((1, 6))
    for k in range(50):
        law.update(k * PERIOD, x, u, x_next, y)
    tracemalloc.start()
    before = tracemalloc.take_snapshot()
    for k in range(500):
        law.update(k * PERIOD, x, u, x_next, y)
    grown = tracemalloc.take_snapshot().compare_to(before, "filename")
    tracemalloc.stop()
    assert sum(s.size_diff for s in grown if "controllers" in s.traceback[0].filename) < 512


@pytest.mark.parametrize(
    ("name", "arms", "parameters", "said"),
    [
        ("joint-pd", ("a",), {"center": (0.0,)}, "center needs 6"),
        ("joint-pd", ("a",), {"armature": (0.1, 0.1)}, "armature needs 6"),
        ("computed-torque", ("a",), {"friction": (0.1,) * 7}, "friction needs 6"),
        ("joint-coupling", ("a",), {}, "two arms"),
        ("joint-pd", ("a",), {"bandwidth_hz": 0.0}, "bandwidth_hz"),
        ("joint-coupling", ("a", "b"), {"share": 1.5}, "share"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(name, arms, parameters, said):
    with pytest.raises(ConfigError, match=said):
        built(name, arms, **parameters)


def test_an_arm_without_a_urdf_is_refused():
    law = registry.load("hil.controllers", "joint-pd")
    bare = ArmDescription(("j",), "", (-1.0,), (1.0,), (0.0,), (1.0,))
    with pytest.raises(ConfigError, match="URDF"):
        law.build(law.Config(), ("a",), PERIOD, (bare,))
