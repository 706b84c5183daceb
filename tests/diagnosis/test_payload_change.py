"""A load picked up in the middle of a run: its instant, its mass and where its centre lies."""

import numpy as np
import pinocchio as pin
import pytest

import hil
from hil.record.recording import Recording, RobotSource
from hil.report.html import diagnosis_report

LINK = """
  <link name="l{k}"><inertial><origin xyz="0 0 {c}"/><mass value="{m}"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.004"/></inertial></link>
  <joint name="joint{k}" type="revolute"><parent link="l{p}"/><child link="l{k}"/>
    <origin xyz="0 0 {z}"/><axis xyz="{axis}"/>
    <limit lower="-3" upper="3" effort="200" velocity="10"/></joint>
"""
ROWS = (
    (1, 0, 0.1, 4.0, 0.05, "0 0 1"),
    (2, 1, 0.2, 3.0, 0.15, "0 1 0"),
    (3, 2, 0.3, 1.5, 0.1, "0 1 0"),
)
ARM = (
    '<robot name="arm"><link name="l0"/>'
    + "".join(LINK.format(k=k, p=p, z=z, m=m, c=c, axis=a) for k, p, z, m, c, a in ROWS)
    + '<link name="tip"/><joint name="end" type="fixed"><parent link="l3"/><child link="tip"/>'
    '<origin xyz="0 0 0.25"/></joint></robot>'
)
MASS, CENTRE, INSTANT = 0.6, np.array([0.0, 0.03, 0.06]), 8.0


def run(seed: int, change: str = "load", name: str = "run") -> Recording:
    """The arm on four tones a joint; its effort is Pinocchio's, with friction and noise."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.004)
    w = 2 * np.pi * rng.uniform(0.08, 0.7, (3, 4))
    angle = t[:, None, None] * w + rng.uniform(0, 6.28, (3, 4))
    size = 0.35 / w**0.5
    q, v, a = (size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle))
    q, v, a = (x.sum(axis=2) for x in (q, v, a))
    bare, loaded = pin.buildModelFromXML(ARM), pin.buildModelFromXML(ARM)
    tip = loaded.frames[loaded.getFrameId("tip")]
    body = pin.Inertia(MASS, CENTRE, 1e-4 * np.eye(3))
    loaded.appendBodyToJoint(tip.parentJoint, body, tip.placement)
    later = t > INSTANT
    arms = [(m, m.createData()) for m in (bare, loaded)]
    tau = np.array(
        [
            pin.rnea(*arms[int(new and change == "load")], *x)
            for new, *x in zip(later, q, v, a, strict=True)
        ]
    )
    tau += 0.4 * np.tanh(v / 0.01) + 0.3 * v
    if change == "gain":
        tau[:, 1] *= np.where(later, 1.1, 1.0)
    if change == "offset":
        tau[:, 1] += np.where(later, 1.0, 0.0)
    tau += 0.05 * rng.standard_normal(tau.shape)
    q = q + 1e-6 * rng.standard_normal(q.shape)
    joints = tuple(f"joint{k}" for k in (1, 2, 3))
    return Recording(name, "arm", joints, t, q, tau, robot=RobotSource("", ARM))


def answer(fitted: Recording, held: list[Recording] | None = None):
    return hil.diagnose([fitted], hil.base_model(fitted.robot), held)


@pytest.mark.parametrize("held", [[], ["load"], ["none"]], ids=["fifths", "both", "bare"])
def test_a_load_that_is_picked_up_is_named_with_mass_centre_and_instant(held, tmp_path):
    d = answer(run(1), [run(2, change, "other") for change in held])
    (found,) = d.findings
    assert (d.verdict, found.effect, found.joint) == ("missing-effect", "payload-change", None)
    assert found.confidence > 0.95
    values = {k.rsplit(".")[-1]: v.value for k, v in found.parameters.items()}
    assert values["m"] == pytest.approx(MASS, rel=0.05)
    assert values["t0"] == pytest.approx(INSTANT, abs=0.05)
    moments = [values[k] for k in ("mx", "my", "mz")]
    np.testing.assert_allclose(moments, MASS * CENTRE, atol=0.005)
    last = d.ladder[-1]
    assert np.all(last.result.rms < 1.1 * d.floor)
    assert np.all(last.heldout.rms < 1.15 * d.noise)
    diagnosis_report(d, tmp_path / "r.html")


@pytest.mark.parametrize(
    ("change", "says"), [("gain", "scale of all efforts"), ("offset", "effort at rest")]
)
def test_what_changes_on_one_joint_is_no_load_and_nothing_that_imitates_it(change, says):
    d = answer(run(1, change))
    assert d.verdict == "unexplained" and not d.findings
    (found,) = d.last.changes
    assert (found.joint, found.what) == ("joint2", says)
    assert found.at == pytest.approx(INSTANT, abs=0.3)


@pytest.mark.parametrize("seed", [1, 2])
def test_an_arm_that_carries_the_same_all_the_time_lacks_nothing(seed):
    assert answer(run(seed, "none")).verdict == "adequate"
