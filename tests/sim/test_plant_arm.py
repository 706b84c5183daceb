"""The arm of the simulator: geometry, agreement with Pinocchio, energy."""

import numpy as np
import pinocchio as pin
import pytest

from hil.sim_devices.plants import truth, world
from hil.sim_devices.plants.layout import ARM_STATE_DTYPE, GEL_DTYPE, NOISES, OPERATOR

ROWS = np.array([[1, 0, 0], [0, 1, 0], [0, -1, 1], [0, 0, 1], [0, 1, -1]], float)


def parameters():
    return truth.arm_record(truth.load_truth("nominal"), "nano17", np.zeros((6, 6)))


def tree():
    """The parallelogram as an open tree (joint angles = ROWS @ theta)."""
    facts = truth.load_truth("nominal")
    geo, mass, inertia = facts["geometry"], facts["masses"], facts["inertias"]
    model = pin.Model()
    pitch = np.array([0.0, -1.0, 0.0])

    def link(parent, joint, at, name, m, com, diagonal):
        k = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array(at)), name)
        body = pin.Inertia(m, np.array(com, float), np.diag(diagonal))
        model.appendBodyToJoint(k, body, pin.SE3.Identity())
        return k

    def turned(key):  # local axes x, y (pitch), z from pitch, y, z of the source
        x, y, z = inertia[key]
        return np.array([z, x, y])

    l1, l2, l3 = geo["l1"], geo["l2"], geo["rod"]
    upper = turned("upper") - mass["upper"] * geo["upper"] ** 2 * np.array([0, 1, 1])
    crank = turned("crank") - mass["crank"] * geo["crank"] ** 2 * np.array([1, 1, 0])
    revolute = pin.JointModelRevoluteUnaligned
    base = link(0, pin.JointModelRZ(), [0, 0, 0], "base", 0.0, [0, 0, 0], [0, 0, inertia["base"]])
    be = link(base, revolute(pitch), [0, 0, 0], "be", mass["upper"], [geo["upper"], 0, 0], upper)
    a = link(
        be, revolute(pitch), [l1, 0, 0], "a", mass["forearm"], [0, 0, -l2 / 2], turned("forearm")
    )
    df = link(base, revolute(pitch), [0, 0, 0], "df", mass["crank"], [0, 0, geo["crank"]], crank)
    link(df, revolute(pitch), [0, 0, -l3], "c", mass["rod"], [l1 / 2, 0, 0], turned("rod"))
    tip = pin.Inertia(facts["sensors"]["nano17"]["mass"], np.array([0, 0, -l2]), np.zeros((3, 3)))
    model.appendBodyToJoint(a, tip, pin.SE3.Identity())
    model.gravity.linear = np.array([0, 0, -truth.GRAVITY])
    return model


def test_accelerations_agree_with_pinocchio():
    model, p, x = tree(), parameters(), np.zeros(1, ARM_STATE_DTYPE)
    data, rng = model.createData(), np.random.default_rng(0)
    for _ in range(50):
        q, v, torque = rng.uniform(-1, 1, 3), rng.uniform(-3, 3, 3), rng.uniform(-0.2, 0.2, 3)
        x["q"][0], x["v"][0] = q, v
        world.push_links(p[0], x[0], torque, 1.0)
        mass = ROWS.T @ pin.crba(model, data, ROWS @ q) @ ROWS
        bias = ROWS.T @ pin.rnea(model, data, ROWS @ q, ROWS @ v, np.zeros(5))
        np.testing.assert_allclose(x["v"][0] - v, np.linalg.solve(mass, torque - bias), rtol=1e-9)


def test_tip_velocity_is_the_rate_of_the_tip_and_force_does_its_power():
    p, x, h = parameters(), np.zeros(1, ARM_STATE_DTYPE), 1e-6
    rng = np.random.default_rng(1)
    for _ in range(20):
        q, v, force = rng.uniform(-1, 1, (3, 3))
        tips = []
        for sign in (-1, 1):
            x["q"][0], x["v"][0] = q + sign * h * v, v
            world.tip_state(p[0], x[0])
            tips.append(x["tip"][0].copy())
        np.testing.assert_allclose(x["tip_v"][0], (tips[1] - tips[0]) / (2 * h), atol=1e-6)
        # J^T f: change of the momentum M dv along v equals f . tip velocity
        x["q"][0], x["v"][0] = q, v
        world.tip_state(p[0], x[0])
        power = force @ x["tip_v"][0]
        jumps = []
        for f in (force, np.zeros(3)):
            x["v"][0], x["force"][0] = v, f
            world.push_links(p[0], x[0], np.zeros(3), 1.0)
            jumps.append(x["v"][0].copy())
        assert v @ mass_matrix(p, q) @ (jumps[0] - jumps[1]) == pytest.approx(power, rel=1e-9)


def mass_matrix(p, q):
    c2, s3, s23 = np.cos(q[1]), np.sin(q[2]), np.sin(q[1] - q[2])
    a = p["m11"][0]
    m = np.diag([a @ [1, np.cos(2 * q[1]), np.cos(2 * q[2]), c2 * s3], p["m22"][0], p["m33"][0]])
    m[1, 2] = m[2, 1] = -p["m23"][0] * s23
    return m


def energy(p, x):
    q, v, stretch = x["q"][0], x["v"][0], x["qm"][0] - x["q"][0]
    kinetic = v @ mass_matrix(p, q) @ v / 2 + (p["rotor"][0] * x["vm"][0] ** 2).sum() / 2
    height = p["g2"][0] * np.sin(q[1]) - p["g3"][0] * np.cos(q[2])
    return kinetic + (p["cable"][0] * stretch**2).sum() / 2 + height


@pytest.mark.parametrize(("substeps", "tolerance"), [(16, 3e-3), (128, 4e-4)])
def test_without_friction_energy_stays(substeps, tolerance):
    p, x = parameters(), np.zeros(1, ARM_STATE_DTYPE)
    for name in (
        "coulomb_motor",
        "coulomb_link",
        "viscous_motor",
        "viscous_link",
        "noise_low",
        "noise_white",
        "cable_damping",
    ):
        p[name] = 0.0
    x["q"], x["qm"] = [0.2, 0.4, 0.3], [0.2, 0.4, 0.3]
    x["v"], x["vm"] = [3.0, 1.0, -1.0], [3.0, 1.0, -1.0]
    gel, hand = np.zeros(1, GEL_DTYPE), np.zeros(1, OPERATOR)
    hand["onset"] = gel["relaxation"] = 1.0
    start, worst = energy(p, x), 0.0
    kinetic = 0.5 * (p["rotor"][0] * x["vm"][0] ** 2).sum()
    kinetic += 0.5 * x["v"][0] @ mass_matrix(p, x["q"][0]) @ x["v"][0]
    words = np.zeros((1, 3), np.int64), np.zeros((1, 6), np.int64)
    for tick in range(500):
        world.run_plant(
            p,
            x,
            hand,
            gel,
            tick * 1e-3,
            1e-3,
            substeps,
            np.zeros((1, 3), np.int64),
            np.zeros((1, NOISES)),
            *words,
        )
        worst = max(worst, abs(energy(p, x) - start))
    assert np.abs(x["q"][0] - [0.2, 0.4, 0.3]).max() > 0.3
    assert worst < tolerance * kinetic
