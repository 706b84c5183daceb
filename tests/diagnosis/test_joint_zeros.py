"""Joints not counted as the description says: small errors get a name, large ones are refused."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import plants
import pytest

import hil
from hil.diagnosis import columns
from hil.diagnosis.engine import diagnose
from hil.diagnosis.joint_zeros import Postures, Sense, countings
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.model import base_model
from hil.record.recording import Recording, RobotSource


def read(run: Recording, j: int, sign=1.0, shift=0.0, ratio=1.0, effort=1.0) -> Recording:
    """The run with joint j recorded as sign * ratio * q + shift."""
    q, tau = run.q.copy(), run.tau.copy()
    q[:, j] = sign * ratio * q[:, j] + shift
    tau[:, j] *= effort
    return replace(run, q=q, tau=tau)


def answer(j: int, **how: float):
    runs = [read(plants.spatial(seed), j, **how) for seed in (1, 2)]
    return diagnose(runs[:1], base_model(runs[0].robot), runs[1:])


def test_a_zero_that_is_off_is_named_with_its_size_where_the_joints_behind_feel_it():
    found = answer(1, shift=0.06)
    assert [(f.effect, f.joint) for f in found.findings] == [("joint-zero", "upper")]
    assert found.findings[0].felt_on in ("upper", "fore")
    value = found.findings[0].parameters["j2.joint-zero.z"]
    assert value.value == pytest.approx(0.06, abs=0.003)
    assert all(found.explained.heldout.rms < 1.1 * found.noise)


@pytest.mark.parametrize("j", [plants.further(0), 2])
@pytest.mark.slow
def test_the_masses_of_the_first_and_the_last_joint_turn_along_with_its_zero(j):
    found = answer(j, shift=0.06)
    assert found.verdict == "adequate" and not found.findings


@pytest.mark.slow
@pytest.mark.parametrize("j", [0, 2])
def test_a_ratio_that_is_off_is_named_with_its_size(j):
    found = answer(j, ratio=1.06)
    joint = plants.JOINTS[j]
    assert [(f.effect, f.joint) for f in found.findings] == [("joint-ratio", joint)]
    value = found.findings[0].parameters[f"j{j + 1}.joint-ratio.r"]
    assert value.value == pytest.approx(1 - 1 / 1.06, abs=0.004)
    assert all(found.explained.heldout.rms < 1.1 * found.noise)


def test_what_corrects_it_is_said():
    zero, ratio = (catalogue.get(name).doc.remark for name in ("joint-zero", "joint-ratio"))
    assert "add -0.0524 to the position's shift" in zero({"z": 0.0524}, {})
    assert "3 degrees" in zero({"z": 0.0524}, {})
    assert "scale in a map by 0.95" in ratio({"r": 0.05}, {})


@pytest.mark.parametrize(
    ("d", "j", "how", "words"),
    [
        (3, 1, {"shift": np.pi / 2}, "q2 (upper): shift = -1.571 rad (-90 deg)"),
        (3, 1, {"sign": -1.0}, "q2 (upper): sign = -1"),
        (3, 1, {"sign": -1.0, "effort": -1.0}, "sign = -1, and sign = -1 for its effort"),
        plants.further(5, 3, {"shift": -np.pi / 2}, "q4 (joint4): shift = 1.571 rad (90 deg)"),
        plants.further(5, 2, {"sign": -1.0}, "q3 (joint3): sign = -1"),
    ],
)
def test_another_sense_of_a_joint_is_bad_data_and_said(d, j, how, words):
    run = plants.spatial(1) if d == 3 else plants.serial_arm(d, 1)
    run = read(run, j, **how)
    found = hil.diagnose([run], base_model(run.robot))
    assert found.verdict == "bad-data"
    ((code, text),) = found.warnings
    assert code == "posture" and words in text


@pytest.mark.slow
def test_two_joints_in_another_sense_are_both_said():
    run = read(read(plants.serial_arm(5, 1), 1, sign=-1.0), 3, shift=1.0)
    found = hil.diagnose([run], base_model(run.robot))
    assert found.verdict == "bad-data"
    assert "q2 (joint2): sign = -1" in found.warnings[0][1]
    said = re.search(r"q4 \(joint4\): shift = (\S+) rad", found.warnings[0][1])
    assert said and float(said[1]) == pytest.approx(-1.0, abs=0.03)


@pytest.mark.parametrize(
    ("d", "j", "k"), [(4, 3, 1.0), plants.further(5, 3, 4.0), plants.further(5, 4, 1.0)]
)
@pytest.mark.slow
def test_a_spring_is_no_other_zero_of_another_joint(d, j, k):
    """Of a hose on the last joint a map was to move the zero of the joint before by 40 degrees."""
    run = plants.serial_arm(d, 1)
    q, tau = run.q[:, j], run.tau.copy()
    tau[:, j] += k * np.std(tau[:, j]) / np.std(q) * (q - np.mean(q) - 0.3 * np.std(q))
    run = replace(run, tau=tau)
    found = fit(Problem([run], run.robot), base_model(run.robot))
    assert Postures(found).best() != [Sense()] * d
    assert not [x for x in countings(found, [run]) if x.senses]


@pytest.mark.parametrize("d", [3, 5])
def test_an_arm_as_it_is_described_is_read_as_it_is(d):
    run = plants.spatial(1) if d == 3 else plants.serial_arm(d, 1)
    problem = Problem([run], run.robot)
    assert Postures(fit(problem, base_model(run.robot))).best() == [Sense()] * d


def test_friction_that_the_model_lacks_is_no_other_posture():
    run = plants.spatial(1)
    v = np.gradient(run.q, run.t, axis=0)
    heavy = replace(run, tau=run.tau + 4.0 * np.tanh(v / 0.02) * np.exp(-((v / 0.3) ** 2)))
    found = fit(Problem([heavy], run.robot), base_model(run.robot))
    assert np.max(found.relative) > 10.0
    assert Postures(found).best() == [Sense()] * 3


@pytest.mark.parametrize(
    ("axis", "numbers"), [((0.0, 9.81, 0.0), "0 9.81 0"), plants.further((0, 0, 0), "0 0 0")]
)
@pytest.mark.slow
def test_gravity_that_acts_otherwise_is_bad_data_with_the_line_for_the_description(axis, numbers):
    run = plants.serial_arm(5, 1)
    true = pin.buildModelFromXML(run.robot.urdf)
    data = true.createData()
    down = [pin.computeGeneralizedGravity(true, data, q).copy() for q in run.q]
    true.gravity.linear = np.array(axis, dtype=float)
    there = [pin.computeGeneralizedGravity(true, data, q).copy() for q in run.q]
    run = replace(run, tau=run.tau + np.array(there) - np.array(down))
    found = hil.diagnose([run], base_model(run.robot))
    assert found.verdict == "bad-data"
    ((code, text),) = found.warnings
    assert code == "description-gravity" and f"<gravity>{numbers}</gravity>" in text


@pytest.mark.slow
def test_columns_in_another_order_are_bad_data_and_said():
    run = plants.serial_arm(5, 1)
    order = [2, 1, 0, 3, 4]
    run = replace(run, q=run.q[:, order].copy(), tau=run.tau[:, order].copy())
    found = hil.diagnose([run], base_model(run.robot))
    assert found.verdict == "bad-data"
    ((code, text),) = found.warnings
    assert code == "order"
    assert "joint1 is q3 and tau3, joint3 is q1 and tau1" in text


PAN = """<robot name="head"><link name="base"/>
<link name="post"><inertial><origin xyz="0.03 0.01 0.05"/><mass value="1.6"/>
<inertia ixx="0.006" iyy="0.006" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="head"><inertial><origin xyz="0.09 0.01 0.02"/><mass value="1.5"/>
<inertia ixx="0.003" iyy="0.004" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pan" type="revolute"><parent link="base"/><child link="post"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="50" velocity="9"/></joint>
<joint name="nod" type="revolute"><parent link="post"/><child link="head"/>
<origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="50" velocity="9"/></joint></robot>"""


def leaning_head(seed: int, angle: float) -> Recording:
    """A head on a post whose first axis carries next to nothing but what a lean brings."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 24.0, 0.004)
    w, phase = 2 * np.pi * rng.uniform(0.1, 0.6, (3, 2, 1)), rng.uniform(0, 6, (3, 2, 1))
    size = 0.5 * np.array([1.0, 0.6])[:, None]
    q, v, a = (
        np.sum(size * w**k * np.sin(w * t + phase + k * np.pi / 2), axis=0).T for k in range(3)
    )
    model = pin.buildModelFromXML(PAN)
    turn = pin.exp3(np.radians(angle) * np.array([0.8, -0.6, 0.0]))
    model.gravity.linear = turn @ np.array([0.0, 0.0, -9.81])
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)])
    tau += 0.05 * np.tanh(v / 0.01) + 0.02 * v + 0.01 * rng.standard_normal(v.shape)
    return Recording(f"run{seed}", "head", ("pan", "nod"), t, q, tau, robot=RobotSource("", PAN))


@pytest.mark.parametrize("seed", [plants.further(1), 2])
@pytest.mark.slow
def test_a_base_that_leans_a_little_is_an_effect_and_no_fault_of_the_recording(seed):
    """Even where that is most of a joint's error, and other columns imitate a part of it."""
    run, held = leaning_head(seed, 4.0), leaning_head(seed + 10, 4.0)
    found = hil.diagnose(run, base_model(run.robot), held)
    assert [(f.effect, f.joint) for f in found.findings] == [("base-tilt", None)]
    turn = [v.value for v in found.findings[0].parameters.values()]
    np.testing.assert_allclose(np.abs(turn), np.radians(4.0) * np.array([0.8, 0.6]), atol=0.004)


@pytest.mark.parametrize(("angle", "little"), [(4, 1), (13, 1), (16, 0), (90, 0), (180, 0)])
def test_how_far_a_base_leans_before_it_is_another_description(angle, little):
    run = plants.serial_arm(5, 1)
    found = Postures(fit(Problem([run], run.robot), base_model(run.robot)))
    down = np.array([0.0, 0.0, -9.81])
    turn = pin.exp3(np.radians(angle) * np.array([0.6, 0.8, 0.0]))
    assert found.leans(turn @ down) == little
    assert not found.leans(np.zeros(3))


def test_a_spring_about_the_vertical_is_no_gravity_from_another_side():
    """A cable on the first joint of an arm was a gravity along x, and the answer *bad-data*."""
    run = plants.serial_arm(2, 1, seconds=10.0)
    sprung = replace(run, tau=run.tau + np.outer(3.0 * (run.q[:, 0] - 0.1), [1.0, 0.0]))
    fit = hil.fit([sprung], hil.base_model(run.robot))
    assert fit.relative[0] > 50.0
    assert columns.mistaken(fit, [sprung]) == []
