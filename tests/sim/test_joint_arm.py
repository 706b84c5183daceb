"""The simulated arm of a URDF: its motion is right, and its bodies are not those of the file."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from hil.errors import ConfigError
from hil.rigs import rig_path
from hil.signals.settable import ArmDescription
from hil.sim_devices.bench import open_bench
from hil.sim_devices.joints import motion
from hil.sim_devices.joints.bench import HIDDEN_FIELDS

URDF = rig_path("arm6").with_name("arm6.urdf").read_text()
JOINTS = ("base_turn", "shoulder_lift", "elbow", "wrist_roll", "wrist_pitch", "wrist_turn")
SLIDE = """<robot name="s"><link name="b"/><link name="c"><inertial><origin xyz="0.1 0 0.2"/>
<mass value="2"/><inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0" ixz="0" iyz="0"/></inertial>
</link><link name="d"><inertial><origin xyz="0 0.1 0"/><mass value="0.7"/><inertia ixx="0.01"
iyy="0.012" izz="0.009" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="0 0 0.3"
rpy="0.2 0.3 0"/><axis xyz="0 0.6 0.8"/><limit lower="-1" upper="1" velocity="1"
effort="40"/></joint>
<joint name="wrist" type="continuous"><parent link="c"/><child link="d"/><origin xyz="0 0.2 0"
rpy="0 0.5 1"/><axis xyz="1 0 0"/><limit velocity="1" effort="4"/></joint></robot>"""


def description(urdf=URDF, joints=JOINTS):
    d = len(joints)
    return ArmDescription(joints, urdf, (-1.0,) * d, (1.0,) * d, (0.2,) * d, (8.0,) * d)


def told(urdf, gravity):
    """The URDF with its own word of gravity."""
    return urdf.replace("</robot>", f"<gravity>{gravity}</gravity></robot>")


@pytest.mark.parametrize("gravity", ["", "0 0 9.81", "0 0 0", "-6.1 3 -7"])
@pytest.mark.parametrize(("urdf", "joints"), [(URDF, JOINTS), (SLIDE, ("rail", "wrist"))])
def test_accelerations_are_those_of_an_independent_library(monkeypatch, urdf, joints, gravity):
    pull = motion.described_gravity(told(urdf, gravity) if gravity else urdf)
    monkeypatch.setattr(motion, "_off", lambda rng, size: np.ones(size))
    built, d = motion.arm_of_urdf(urdf, joints, 0), len(joints)
    fields = tuple(getattr(built, f) for f in built.__dataclass_fields__)
    # an unlimited joint is a pair of cosine and sine there
    model = pin.buildModelFromXML(urdf.replace("continuous", "revolute"))
    rng = np.random.default_rng(0)
    q, v, tau = rng.uniform(-1.0, 1.0, (3, d))
    model.armature = rotor = rng.uniform(0.0, 0.1, d)
    said = [float(x) for x in gravity.split()] if gravity else [0.0, 0.0, -9.80665]
    model.gravity.linear = np.array(said)
    out = np.zeros(d)
    motion.accelerations(fields, rotor, pull, q, v, tau, motion.motion_scratch(d), out)
    assert np.allclose(out, pin.aba(model, model.createData(), q, v, tau), rtol=1e-10, atol=1e-10)


def test_every_body_is_off_the_file_and_the_same_for_a_seed():
    arm = motion.arm_of_urdf(URDF, JOINTS, 3)
    assert np.array_equal(arm.inertia, motion.arm_of_urdf(URDF, JOINTS, 3).inertia)
    assert not np.array_equal(arm.inertia, motion.arm_of_urdf(URDF, JOINTS, 4).inertia)
    model = pin.buildModelFromXML(URDF)
    mass = arm.inertia[:, 5, 5]
    off = np.abs(mass / [i.mass for i in model.inertias.tolist()[1:]] - 1)
    assert off.min() >= 0.05 and off.max() <= 0.15
    for inertia in arm.inertia:
        assert np.linalg.eigvalsh(inertia).min() > 0


def run(seed, hidden=(), truth=0):
    section = {"hidden": list(hidden), "truth_seed": truth}
    bench = open_bench({"arm": description()}, section, 2_000_000, seed)
    wire, seen = bench.wire("arm"), []
    wire.power(True)
    for k in range(100):
        wire.send(np.array([201, 1, -101, 301, 51, -201]) * (1 if k < 60 else -1))
        bench.advance((k + 1) * 2_000_000)
        seen.append(wire.counts.copy())
    return np.array(seen)


def test_a_session_is_the_same_for_a_seed_and_another_one_for_another():
    assert np.array_equal(run(5), run(5))
    assert not np.array_equal(run(5), run(6))
    assert not np.array_equal(run(5), run(5, truth=1))


@pytest.mark.parametrize("effect", sorted(HIDDEN_FIELDS))
def test_a_hidden_effect_changes_the_motion(effect):
    hidden = [{"effect": effect, "joint": "wrist_roll"}]
    assert not np.array_equal(run(5), run(5, hidden))


def test_a_simulated_arm_falls_along_the_gravity_of_its_description():
    """Without torque: down, not at all, and up under a ceiling."""

    def fallen(urdf):
        bench = open_bench({"arm": description(urdf)}, {}, 2_000_000, 0)
        bench.arms["arm"].p["noise"] = 0.0
        bench.wire("arm").power(True)
        bench.advance(200_000_000)
        return bench.arms["arm"].x["q"] - 0.2

    down, none, up = fallen(URDF), fallen(told(URDF, "0 0 0")), fallen(told(URDF, "0 0 9.80665"))
    assert np.abs(none).max() < 1e-6 < 1e-3 < np.abs(down).max()
    far = np.abs(down) > 1e-3
    assert np.all(np.sign(up[far]) == -np.sign(down[far]))


@pytest.mark.parametrize("word", ["down", "0 0", "0 0 nan", "0 0 -9.81</gravity><gravity>0 0 0"])
def test_a_gravity_that_is_no_vector_is_refused(word):
    with pytest.raises(ConfigError, match="three numbers"):
        open_bench({"arm": description(told(URDF, word))}, {}, 2_000_000, 0)


def test_the_brakes_hold_an_arm_without_power():
    bench = open_bench({"arm": description()}, {}, 2_000_000, 0)
    wire = bench.wire("arm")
    before = wire.counts.copy()
    bench.advance(100_000_000)
    assert np.array_equal(wire.counts, before)
    wire.power(True)
    bench.advance(200_000_000)
    assert not np.array_equal(wire.counts, before)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"hidden": [{"effect": "stribek", "joint": "elbow"}]}, "stribeck"),
        ({"hidden": [{"effect": "stribeck", "joint": "elbo"}]}, "elbow"),
        ({"hidden": [{"effect": "spring", "joint": "elbow", "arm": "amr"}]}, "arm"),
        ({"home": {"arm": [0.0]}}, "6 joint positions"),
        ({"truth": "nominal"}, "truth_seed"),
    ],
)
def test_mistakes_in_the_table_are_refused(section, said):
    with pytest.raises(ConfigError, match=said):
        open_bench({"arm": description()}, section, 2_000_000, 0)


def test_an_arm_that_nothing_touches_needs_no_laws_of_touch():
    """They take a third of what the first session after an installation compiles."""
    program = (
        "import test_joint_arm as t\n"
        "from hil.sim_devices.joints import motion, touch\n"
        "t.run(5)\n"
        "assert motion.run_arm.signatures and not touch.apply_touch.signatures\n"
    )
    path = str(Path(__file__).parent)
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {path!r})\n{program}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
