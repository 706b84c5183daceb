"""Files for simulators, read back by their own programs: the same efforts as our evaluation."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from export_reference import evaluated
from plants import spatial

from hil.export.target import Job, get
from hil.models.model import Range, Use, Value, base_model


def rnea(model, q, v, a):
    data = model.createData()
    return np.array([pin.rnea(model, data, *x).copy() for x in zip(q, v, a, strict=True)])


def test_urdf_by_pinocchio(made, states):
    found = made("urdf")
    model = pin.buildModelFromXML(found.texts[".urdf"])
    q, v, a = states
    joints = {j.get("name"): j for j in ET.fromstring(found.texts[".urdf"]).iter("joint")}
    said = [joints[n].find("dynamics").attrib for n in list(model.names)[1:]]
    damping, friction = (np.array([float(x[k]) for x in said]) for k in ("damping", "friction"))
    efforts = rnea(model, q, v, a) + damping * v + friction * np.sign(v)
    np.testing.assert_allclose(efforts, evaluated(found.steps[-1], q, v, a), atol=1e-6)


def test_mjcf_by_mujoco(made, states):
    mujoco = pytest.importorskip("mujoco")
    found = made("mjcf")
    model = mujoco.MjModel.from_xml_string(found.texts[".xml"])
    # friction of any size is fully there at these speeds if its constraint is stiff
    model.dof_solref[:, 0] = 1e-4
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)
    data, efforts = mujoco.MjData(model), []
    for q, v, a in zip(*states, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        # u - t0 is what the joint gets
        efforts.append(data.qfrc_inverse - model.actuator_biasprm[:, 0])
    wanted = evaluated(found.steps[-1], *states)
    np.testing.assert_allclose(np.array(efforts), wanted, atol=1e-6)


def test_the_motor_of_a_joint_with_a_spring_has_no_bias(made):
    root = ET.fromstring(made("mjcf").texts[".xml"])
    sprung = [j.get("name") for j in root.iter("joint") if j.get("springref")]
    bias = {g.get("joint"): g.get("biasprm").split()[0] for g in root.iter("general")}
    assert len(sprung) == 1 and float(bias[sprung[0]]) == 0.0
    assert any(float(x) for name, x in bias.items() if name not in sprung)


def _sdf_model(text):
    """Pinocchio's model of an SDF, by the rules of SDF 1.9: link poses relative to the parent."""
    model, ids = pin.Model(), {"world": 0}
    sdf = ET.fromstring(text).find("model")
    links = {x.get("name"): x for x in sdf.findall("link")}
    for joint in sdf.findall("joint"):
        child, parent = joint.find("child").text, joint.find("parent").text
        x = np.array(links[child].find("pose").text.split(), dtype=float)
        assert links[child].find("pose").get("relative_to", "world") == parent
        place = pin.SE3(pin.rpy.rpyToMatrix(*x[3:]), x[:3])
        axis = np.array(joint.find("axis/xyz").text.split(), dtype=float)
        kind = pin.JointModelRevoluteUnaligned(axis)
        ids[child] = model.addJoint(ids[parent], kind, place, joint.get("name"))
        own = links[child].find("inertial")
        i = {e.tag: float(e.text) for e in own.find("inertia")}
        rows = [[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]]]
        rows.append([i["ixz"], i["iyz"], i["izz"]])
        at = np.array(own.find("pose").text.split(), dtype=float)
        body = pin.Inertia(float(own.find("mass").text), at[:3], np.array(rows))
        model.appendBodyToJoint(ids[child], body, pin.SE3.Identity())
    dynamics = [j.find("axis/dynamics") for j in sdf.findall("joint")]
    keys = ("damping", "friction", "spring_stiffness", "spring_reference")
    return model, *np.array([[float(x.findtext(k, "0")) for x in dynamics] for k in keys])


def test_sdf_by_its_own_rules(made, states):
    found = made("sdf")
    model, damping, friction, stiffness, reference = _sdf_model(found.texts[".sdf"])
    assert np.count_nonzero(stiffness) == 1
    q, v, a = states
    v = 3.0 * v  # without its offset and ripple the last joint's reversal is fitted wider
    efforts = rnea(model, q, v, a) + damping * v + friction * np.sign(v)
    efforts += stiffness * (q - reference)
    np.testing.assert_allclose(efforts, evaluated(found.steps[-1], q, v, a), atol=1e-6)


@pytest.fixture(scope="module")
def geared():
    """A rotor behind a gear, which SDF has no word for, on a joint with a weak spring."""

    def session(seed):
        run = spatial(seed, 6.0)
        tau = run.tau.copy()
        speed = np.gradient(run.q[:, 2], run.t)
        tau[:, 2] += 0.3 * np.gradient(speed, run.t) + 0.3 * (run.q[:, 2] - 0.5)
        return replace(run, tau=tau)

    one, two = session(1), session(2)
    return base_model(one.robot) + Use("spring", ("fore",)), one, two


def _geared(geared, name):
    model, one, two = geared
    return get(name).make(Job(model, Path("arm.toml"), "arm", [one], [two], True))


def test_no_spring_pushes_away_to_take_up_what_is_lost(geared):
    """The errors are those of what is written: a constant effort goes with its spring."""
    found = _geared(geared, "sdf")
    values = found.steps[0].result.values
    assert values["j3.spring.k"].value == pytest.approx(0.3, abs=0.05)
    _, damping, friction, stiffness, _ = _sdf_model(found.texts[".sdf"])
    assert not stiffness.any() and np.all(damping >= 0) and np.all(friction >= 0)
    (said,) = (x for x in found.notes if "would become negative" in x)
    assert "j3.spring.k" in said
    assert any(x.startswith("spring on fore: ") for x in found.lost)
    left = found.steps[-1].result
    assert not any(t.effect.name == "spring" for t in left.terms)
    assert left.values["j3.viscous.fv"].value == pytest.approx(damping[2], rel=1e-9)


def test_a_target_with_a_word_for_the_rotor_keeps_the_spring(geared):
    found = _geared(geared, "mjcf")
    joints = list(ET.fromstring(found.texts[".xml"]).iter("joint"))
    assert float(joints[2].get("stiffness")) == pytest.approx(0.3, abs=0.05)
    assert not any("would become negative" in x for x in found.notes)


def test_isaac_settings_beside_their_urdf(made, states):
    found = made("isaac")
    model = pin.buildModelFromXML(found.texts[".urdf"])
    assert "<dynamics" not in found.texts[".urdf"]
    settings, joint = {}, ""
    for line in found.texts[".yaml"].splitlines():
        if line.startswith("  ") and line.endswith(":") and not line.startswith("   "):
            joint = line.strip(' ":')
            settings[joint] = {}
        elif line.startswith("    "):
            key, _, value = line.strip().partition(": ")
            settings[joint][key] = value
    names = list(model.names)[1:]
    assert list(settings) == names and settings["base"]["effort_limit_sim"] == "99.0"
    rotor, dry, viscous = (
        np.array([float(settings[n][k]) for n in names])
        for k in ("armature", "dynamic_friction", "viscous_friction")
    )
    q, v, a = states
    efforts = rnea(model, q, v, a) + rotor * a + dry * np.sign(v) + viscous * v
    np.testing.assert_allclose(efforts, evaluated(found.steps[-1], q, v, a), atol=1e-6)


def test_what_is_lost_is_said_and_costs(made):
    urdf, mjcf = made("urdf"), made("mjcf")
    assert {x.partition(" ")[0].strip(":") for x in urdf.lost} == {
        "armature",
        "torque-offset",
        "spring",
        "stribeck",
        "cogging",
    }
    assert {x.partition(" ")[0].strip(":") for x in mjcf.lost} == {"stribeck", "cogging"}
    whole, left = urdf.steps[0].heldout.relative, urdf.steps[1].heldout.relative
    # a spring of 1.5 N m/rad on the second joint is much of its effort
    assert left[1] > 1.5 * whole[1]
    # where there is a spring, that is not lost
    assert mjcf.steps[-1].heldout.relative[1] < 0.25 * left[1]
    sdf = made("sdf")
    assert sdf.steps[-1].heldout.relative[1] < 0.25 * left[1]
    # a constant effort is a spring's reference there, and has no word on the other joints
    assert [x for x in sdf.lost if x.startswith("torque-offset")] == [
        "torque-offset on base, fore: the target can say it only on a joint that has a spring"
    ]


def test_the_error_is_that_of_the_bodies_that_are_written(made):
    """Bodies are mended where what the target leaves out makes them infeasible, and it is said."""
    labels = {name: made(name).steps[-1].label for name in ("urdf", "mjcf")}
    assert set(labels.values()) <= {"feasible bodies", "within the target"}
    assert "feasible bodies" in labels.values()
    for name, label in labels.items():
        said = any("the efforts of the bodies change by" in x for x in made(name).notes)
        assert said == (label == "feasible bodies")


def test_a_refit_is_better_than_leaving_out(made, arm):
    """What is left carries what it can of what was lost: the rule of the export."""
    found = made("mjcf")
    q, v, a = (x[100:-100:20] for x in _motion(arm.other))
    tau = arm.other.tau[100:-100:20, 0]
    whole, refitted = found.steps[0], found.steps[1]
    result = whole.result
    motion = result.problem.motions[0].at_states(q, v, a, 0 * q, 0 * q, 0 * q)
    peak = next(t for t in result.terms if t.effect.name == "stribeck")
    where = result.slices[result.terms.index(peak)]
    dropped = evaluated(whole, q, v, a)[:, 0]
    dropped -= peak.effect.columns(motion, peak.joint, peak.shape) @ result.theta[where]
    kept = evaluated(refitted, q, v, a)[:, 0]
    assert np.std(tau - kept) < 0.9 * np.std(tau - dropped)


def _motion(run):
    qd = np.gradient(run.q, run.t, axis=0)
    return run.q, qd, np.gradient(qd, run.t, axis=0)


@pytest.fixture(scope="module")
def leaning():
    """A robot on a slope that its description does not know, with a known force at its tip."""
    one, two = (spatial(seed, tilt=(0.10, -0.06)) for seed in (1, 2))
    return one, two, base_model(one.robot) + Use("base-tilt")


def _leant(leaning, name, data=True):
    one, two, model = leaning
    job = Job(model, Path("arm.toml"), "arm", [one] if data else [], [two] if data else [], True)
    return get(name).make(job)


def test_a_base_that_leans_is_written_as_its_place(leaning, states):
    found = _leant(leaning, "urdf")
    assert not any(x.startswith("base-tilt") for x in found.lost)
    assert any("turned by roll 0.099" in x and "pitch -0.059" in x for x in found.notes)
    q, v, a = states
    model = pin.buildModelFromXML(found.texts[".urdf"])
    joints = {j.get("name"): j for j in ET.fromstring(found.texts[".urdf"]).iter("joint")}
    said = [joints[n].find("dynamics").attrib for n in list(model.names)[1:]]
    damping, friction = (np.array([float(x[k]) for x in said]) for k in ("damping", "friction"))
    efforts = rnea(model, q, v, a) + damping * v + friction * np.sign(v)
    np.testing.assert_allclose(efforts, evaluated(found.steps[-1], q, v, a), atol=1e-6)
    # the first joint is vertical as it is described, so only a base that leans gives it gravity
    assert np.ptp(rnea(model, q, 0 * v, 0 * a)[:, 0]) > 0.1
    # the printed error is that of the written base, and as small as the model's
    whole, written = (s.heldout.relative for s in found.steps[:2])
    assert np.all(written < 1.05 * whole)


@pytest.mark.parametrize("name", ["mjcf", "sdf"])
def test_a_base_that_leans_is_written_for_simulators(leaning, states, name):
    found = _leant(leaning, name)
    q, v, a = states
    weight = _our_weight(found.steps[-1], q)
    if name == "sdf":
        model = _sdf_model(found.texts[".sdf"])[0]
        np.testing.assert_allclose(rnea(model, q, 0 * v, 0 * a), weight, atol=1e-9)
        return
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(found.texts[".xml"])
    data, efforts = mujoco.MjData(model), []
    for x in q:
        data.qpos[:], data.qvel[:] = x, 0.0
        mujoco.mj_forward(model, data)
        efforts.append(data.qfrc_bias.copy())
    np.testing.assert_allclose(np.array(efforts), weight, atol=1e-9)


def _our_weight(step, q):
    result = step.result
    own = result.slices[[t.effect.name for t in result.terms].index("rigid-body")]
    still = np.zeros_like(q)
    return result.problem.robot.regressor(q, still, still) @ result.theta[own]


def test_a_base_that_leans_without_a_recording(leaning, states):
    """The rotation is the model's to second order, and the answer says by how much not."""
    whole = _leant(leaning, "urdf").steps[0]
    one, two, _ = leaning
    found = _leant((one, two, replace(whole.result.model, robot=one.robot)), "urdf", data=False)
    assert any("gravity is 0.6" in x and "% less than the model's" in x for x in found.notes)
    q, v, a = states
    tilt = whole.result.values["base-tilt.rx"].value, whole.result.values["base-tilt.ry"].value
    tree = whole.result.problem.robot.tree
    gravity = tree.gravity - np.cross([*tilt, 0.0], tree.gravity)
    own = whole.result.slices[[t.effect.name for t in whole.result.terms].index("rigid-body")]
    bodies = tree.spread @ whole.result.theta[own]
    ours = replace(tree, gravity=gravity).regressor(q, 0 * q, 0 * q) @ bodies
    written = rnea(pin.buildModelFromXML(found.texts[".urdf"]), q, 0 * v, 0 * a)
    np.testing.assert_allclose(written * np.hypot(1.0, np.hypot(*tilt)), ours, atol=1e-6)


@pytest.mark.parametrize("place, ends", [(0.9, True), (0.1, False)])
def test_a_spring_that_engages_far_within_the_range_is_no_end_of_it(place, ends):
    values = {
        f"j2.end-stop.{name}": Value(x)
        for name, x in {"k": 30.0, "h": 0.0, "c": 0.0, "q0": place, "side": 1.0}.items()
    }
    run = spatial(1)
    name = run.joints[1]
    model = base_model(run.robot) + Use("end-stop", (name,), values=values)
    went = tuple(Range(j, (-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0)) for j in run.joints)
    found = get("mjcf").make(Job(replace(model, valid=went), Path("arm.toml"), "arm"))
    joint = next(
        j for j in ET.fromstring(found.texts[".xml"]).iter("joint") if j.get("name") == name
    )
    high = joint.get("range", "").split()[-1:]
    assert (high == [f"{place:g}"]) is ends
