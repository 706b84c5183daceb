"""Several joints without a robot description: sums of sines and cosines stand for the geometry."""

from __future__ import annotations

import numpy as np
import pytest

import hil
from hil.commands.diagnose import text
from hil.models.model import base_model
from hil.record.recording import Recording, RobotSource
from hil.report.data import from_diagnosis
from hil.report.text import Files, command, details

RATE = 200.0


def arm(stribeck: float = 0.0, seed: int = 0) -> Recording:
    """A double pendulum of two uniform rods, with friction; written down by hand.

    tau_1 = (a + 2 b cos q2) a1 + (c + b cos q2) a2 - b sin q2 (2 v1 v2 + v2^2) + g terms
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0, 40, 1 / RATE)
    q, v, a = np.zeros((3, t.size, 2))
    for j, freqs in enumerate(((0.11, 0.31, 0.77), (0.17, 0.41, 0.97))):
        for f in freqs:
            w, size, phase = 2 * np.pi * f, 0.9 / (1 + 3 * f), rng.uniform(0, 6.28)
            q[:, j] += size * np.sin(w * t + phase)
            v[:, j] += size * w * np.cos(w * t + phase)
            a[:, j] -= size * w * w * np.sin(w * t + phase)
    s, c = np.sin(q[:, 1]), np.cos(q[:, 1])
    both = np.cos(q.sum(axis=1))
    one = (0.9 + 0.5 * c) * a[:, 0] + (0.2 + 0.25 * c) * a[:, 1]
    one += -0.25 * s * (2 * v[:, 0] * v[:, 1] + v[:, 1] ** 2) + 12 * np.cos(q[:, 0]) + 4 * both
    two = (0.2 + 0.25 * c) * a[:, 0] + 0.2 * a[:, 1] + 0.25 * s * v[:, 0] ** 2 + 4 * both
    tau = np.stack([one, two], axis=1) + 0.4 * np.tanh(v / 0.01) + 0.3 * v
    tau[:, 1] += stribeck * np.exp(-np.abs(v[:, 1] / 0.15)) * np.tanh(v[:, 1] / 0.01)
    tau += 0.02 * rng.standard_normal(tau.shape)
    source = RobotSource("single-axis")
    return Recording("run", "arm", ("joint1", "joint2"), t, q, tau, robot=source)


def test_geometry_is_learnt_and_not_named() -> None:
    """Gravity and couplings get no name, and leave next to nothing."""
    run = arm()
    d = hil.diagnose([run], base_model(run.robot))
    assert d.verdict == "unexplained"
    assert not d.findings
    assert {c.effect.split("-")[0] for c in d.corrections} == {"generic"}
    assert np.all(d.ladder[0].heldout.relative > 20)
    assert np.all(d.ladder[-1].heldout.relative < 1)
    assert d.warnings[0][0] == "no-geometry"


def test_friction_beside_an_unknown_geometry_is_named() -> None:
    """What gravity cannot be keeps its name."""
    run = arm(stribeck=0.8)
    d = hil.diagnose([run], base_model(run.robot))
    assert [(f.effect, f.joint) for f in d.findings] == [("stribeck", "joint2")]
    assert d.findings[0].parameters["j2.stribeck.fs"].value == pytest.approx(0.8, rel=0.15)


def test_a_known_geometry_needs_none() -> None:
    """Where the geometry is known, or there is one joint, nothing stands for it."""
    run = arm()
    single = Recording(
        "one",
        "arm",
        ("joint1",),
        run.t,
        run.q[:, :1],
        run.tau[:, :1],
        robot=RobotSource("single-axis"),
    )
    d = hil.diagnose([single], base_model(single.robot))
    assert not any(c.effect.startswith("generic") for c in d.corrections)


def plant(robot: str, motion: int, *hidden: dict[str, object]) -> Recording:
    """A MuJoCo arm, recorded without its description."""
    pytest.importorskip("mujoco")
    from hil.sim_devices.mujoco_plants import session

    rows = session.simulate(robot, ("wander", motion), list(hidden))
    sound = np.isfinite(rows["q"]).all(axis=1)
    t, q, tau = (rows[key][sound] for key in ("t", "q", "tau"))
    joints = tuple(str(name) for name in session.robots()[robot]["joints"])
    return Recording("run", "arm", joints, t, q, tau, robot=RobotSource("single-axis"))


@pytest.mark.parametrize("robot", ["planar2", "elbow3"])
def test_a_mujoco_arm_without_a_description_lacks_its_description_alone(robot: str) -> None:
    run = plant(robot, 1)
    d = hil.diagnose([run], base_model(run.robot))
    assert d.verdict == "unexplained" and not d.findings
    first, last = (d.ladder[k].heldout.relative for k in (0, -1))
    assert np.all(last < 0.2 * first)
    assert all("unknown geometry" in c.of for c in d.corrections)
    said = text(d, hil.ladder(d))
    assert "gravity of an unknown geometry" in said and "--robot ARM.urdf" in said


@pytest.mark.parametrize(
    ("robot", "motion", "effect", "joint"),
    [("planar2", 1, "stribeck", 1), ("elbow3", 2, "cogging", 1), ("elbow3", 3, "stribeck", 0)],
)
def test_a_name_beside_an_unknown_geometry_stands_alone(
    robot: str, motion: int, effect: str, joint: int
) -> None:
    """What a large effect hides of the geometry is found beside it, and gets no name."""
    run = plant(robot, motion, {"effect": effect, "joint": joint, "amplitude": 5.0})
    d = hil.diagnose([run], base_model(run.robot))
    assert [(f.effect, f.joint) for f in d.findings] == [(effect, run.joints[joint])]
    assert {c.effect.split("-")[0] for c in d.corrections} >= {"generic"}


def test_what_stands_for_the_geometry_is_said_first_and_written() -> None:
    """The terminal and the report begin with it; the command writes the whole model."""
    run = arm(stribeck=0.8)
    d = hil.diagnose([run], base_model(run.robot))
    lines = text(d, hil.ladder(d)).splitlines()
    assert "without a robot description" in lines[1] and "--robot" in lines[1]
    assert sum("without a robot description" in line for line in lines) == 1
    assert "sines and cosines stand for the missing robot description on joint1" in " ".join(lines)
    m = from_diagnosis(d)
    assert "without a robot description" in details(m)[0]
    assert command(m, Files(("s.mcap",), model="")) == "hil improve s.mcap -o s.plus1.toml"
    assert any(u.type.startswith("generic") for u in d.model.effects)


def test_a_lateness_that_is_none_is_not_told() -> None:
    """What was shifted to and fro while the geometry was missing is no news."""
    run = arm()
    d = hil.diagnose([run], base_model(run.robot))
    assert not any(code == "late-effort" for code, _ in d.warnings)
