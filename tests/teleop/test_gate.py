"""The gate: exact where the kernels are, over its whole set, and what the simulated rig does."""

import dataclasses
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from hil.cli import main
from hil.controllers import cartesian, joint_space, lawrence
from hil.controllers.lawrence_config import LawrenceConfig
from hil.errors import ConfigError, DeviceError
from hil.models.phantom import Premium
from hil.models.robots import bare_robot
from hil.record.recording import RobotSource
from hil.rig.check import arm_description
from hil.rig.config import load_rig
from hil.rig.open import open_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.runtime.session import plain, to_toml
from hil.teleop import (
    force_sensor_free,
    gate,
    law_parameters,
    rig_designs,
    sampled_loop,
)
from hil.teleop.architecture import FORCE_GAINS, RobotImpedance
from hil.toml import parse

T = 1e-3
RIG = load_rig("lawrence")


def law_of(name, wish, **changes):
    """Parameters of a named design for the rig's arms."""
    given = dict(RIG.controller.parameters) | changes
    base = parse(LawrenceConfig, {"c1": [0.0] * 3, "c7": [0.0] * 3} | given, "test")
    arms = rig_designs.ArmImpedances.of(base)
    return given | law_parameters.law_table(rig_designs.axis_designs(name, wish, arms))


def loops_of(law):
    return law_parameters.loops_of(parse(LawrenceConfig, law, "test"))


def pull(stiffness, damping, **more):
    both = {"master_stiffness": stiffness, "master_damping": damping}
    return {"stiffness": stiffness, "damping": damping} | both | more


@pytest.mark.parametrize(
    ("name", "wish"),
    [
        ("position-error", pull(150.0, 0.6)),
        ("position-force", pull(250.0, 1.0, share=0.8)),
        ("four-channel", pull(250.0, 1.0, share=0.5)),
    ],
)
def test_margins_are_those_of_the_kernels_eigenvalues(name, wish):
    """A delay line a tick below the margin is stable for the whole map, one above it is not."""
    law = law_of(name, wish, friction_damping=[0.0, 0.0], acceleration_hz=0.01)
    loop = replace(loops_of(law)[2], tips=())
    for zh in loop.operators[:3]:
        for ze in loop.environments[:2]:
            one = replace(loop, operators=(zh,), environments=(ze,))
            m = gate.axis_margins(one, T)
            whole = sampled_loop.dominant_mode(one, zh, ze, T)[0]
            assert m.radius == pytest.approx(whole, abs=1e-8)
            if not 0.0 < m.delay_s < 0.04:
                continue
            last = int(m.delay_s / T)
            sizes = []
            for d in (last, last + 1):
                late = replace(loop.real, forward_s=d * T)
                sizes.append(sampled_loop.dominant_mode(replace(one, real=late), zh, ze, T)[0])
            assert sizes[0] <= 1 + 1e-6 < sizes[1] + 1e-6
            assert sizes[1] > 1 + 1e-9


def test_a_delay_is_refused_for_the_shorter_ones_that_do_not_hold():
    """With the cable a longer delay can be stable where a shorter one is not."""
    loop = replace(loops_of(law_of("position-error", pull(250.0, 1.4), friction_damping=[0, 0]))[2])
    zh, ze = loop.operators[1], loop.environments[0]
    one = replace(loop, tips=(), operators=(zh,), environments=(ze,))
    sizes = [
        sampled_loop.dominant_mode(
            replace(one, real=replace(loop.real, forward_s=d * T)), zh, ze, T
        )[0]
        for d in range(12)
    ]
    stable = np.array(sizes) <= 1 + 1e-7
    again = np.flatnonzero(stable[1:] & ~stable[:-1])
    assert stable[0] and again.size  # not monotonic
    assert gate.axis_margins(one, T).delay_s < np.argmin(stable) * T
    late = replace(one, real=replace(loop.real, forward_s=(again[0] + 1) * T))
    with pytest.raises(ConfigError, match="beyond the margin"):
        gate.refuse([late], T)


def test_the_set_is_what_the_declared_pair_and_pose_do_not_show():
    """A pair at the pose may hold where a firmer operator or another pose does not."""
    real = {"acceleration_hz": 1.0, "force_hz": 30.0, "friction_damping": [0.5, 0.5]}
    found = 0
    for damping in (0.3, 0.6):
        loop = loops_of(law_of("four-channel", pull(250.0, damping), **real))[0]
        few = replace(
            loop, tips=(), operators=loop.operators[:2], environments=loop.environments[:2]
        )
        found += gate.passes(few, T) and not gate.passes(loop, T)
    assert found


def test_poses_are_the_corners_of_the_workspace():
    pose, extent = (0.0, 0.4, 0.3), (0.05, 0.06, 0.05)
    tips = Premium(()).tip(np.array(law_parameters.judged_poses(pose, extent)))
    centre = Premium(()).tip(np.array([pose]))[0]
    np.testing.assert_allclose(np.abs(tips - centre), np.tile(extent, (8, 1)), atol=1e-12)
    with pytest.raises(ConfigError, match=r"workspace: its corner .* is out of the arms' reach"):
        law_parameters.judged_poses(pose, (0.3, 0.3, 0.3))


def test_friction_counts_and_its_compensation_takes_it_away():
    """What the arms' friction allows, a compensation of more than is certain forbids."""
    fitted = {f"j{j}.coulomb.{n}": v for j in (1, 2, 3) for n, v in (("fc", 0.02), ("v0", 0.01))}
    effects = {"leader_effects": fitted, "follower_effects": fitted}
    wish, none = pull(150.0, 0.3, share=0.8), {"friction_damping": [0.0, 0.0]}
    bare = gate.axis_margins(loops_of(law_of("position-force", wish, **none))[0], T)
    found = []
    for share in (0.0, 0.5, 1.0):
        law = law_of("position-force", wish, **none, **effects, friction_share=share)
        loop = loops_of(law)[0]
        assert loop.friction[0] > 0.0
        assert loop.compensated[0] == pytest.approx(share / 0.9 * loop.friction[0])
        found.append(gate.axis_margins(loop, T))
    assert found[0].delay_s > found[1].delay_s > bare.delay_s >= found[2].delay_s
    assert found[2].radius > 1.0 + 1e-6 >= found[0].radius


RUNS = [
    ("position-error", pull(250.0, 0.6), {}, True),
    ("position-force", pull(150.0, 0.3, share=0.3), {"forward": {"delay": 0.02}}, True),
    ("four-channel", pull(100.0, 1.0, share=0.3), {"acceleration_hz": 0.01}, True),
    ("position-error", pull(100.0, 1.8), {"forward": {"delay": 0.002}}, False),
    ("four-channel", pull(50.0, 2.2), {"acceleration_hz": 5.0}, False),
    ("four-channel", pull(400.0, 1.4, share=0.8), {"forward": {"delay": 0.01}}, False),
]


@pytest.mark.parametrize(("name", "wish", "changes", "calm"), RUNS)
def test_what_passes_stays_calm_on_the_rig_and_what_diverges_is_refused(
    name, wish, changes, calm, tmp_path, monkeypatch
):
    """A machine moves the leader while the follower presses into a gel."""
    law = law_of(name, wish, **{"acceleration_hz": 0.01, **changes})
    assert all(gate.passes(x, T) for x in loops_of(law)) == calm
    monkeypatch.setattr(lawrence, "refuse", lambda *_: None)
    machine = {"kind": "mechanical", "frequency": 1.0, "size": [0.01, 0.01, 0.02]}
    simulation = {"operator": machine, "gel": {"below_home": -0.01, "stiffness": 500.0}}
    config = load_rig("lawrence", {"simulation": simulation})
    controller = dataclasses.replace(config.controller, parameters=law)
    try:
        done = runner.run_session(
            dataclasses.replace(config, controller=controller), 2.0, 1, output=tmp_path / "s.mcap"
        )
        state = done.state
    except DeviceError:
        state = "FAULT"
    assert (state == "ENABLED") == calm


@pytest.mark.slow
def test_the_proposed_design_works(tmp_path, capsys):
    """The numbers that a refusal of --fsf names run when they are written into the rig file."""
    gains = {"c1": [60.0, 0.4, 0.0], "c4": [-60.0, -0.4, 0.0], "c7": [60.0, 0.4, 0.0]}
    gains |= {"c8": [60.0, 0.4, 0.0], "c2": [1.2], "c3": [0.95], "c5": [0.1], "c6": [0.1]}
    path = tmp_path / "rig.toml"

    def written(more):
        law = dict(RIG.controller.parameters) | gains | {"acceleration_hz": 5.0} | more
        own = dataclasses.replace(RIG.controller, parameters=law)
        path.write_text(to_toml(plain(dataclasses.replace(RIG, controller=own))))
        return main(["design", str(path), "--fsf"])

    assert written({}) == 2
    said = capsys.readouterr().err
    found = {
        c: [float(re.search(rf"\b{c} = (-?[\d.e-]+)", said[said.index("nearest") :])[1])]
        for c in FORCE_GAINS
    }
    assert written(found) == 0
    assert "may run" in capsys.readouterr().out


def test_where_no_force_gains_help_it_says_so():
    d = replace(loops_of(law_of("four-channel", pull(100.0, 1.0)))[0].design, name="x")
    with pytest.raises(ConfigError, match=r"no other c2, c3, c5, c6 near these work"):
        force_sensor_free.transform(d, runs=lambda _: False)


@pytest.mark.parametrize("accelerations", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_transparent_design_is_found_that_runs(accelerations, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(rig_designs, "_STIFFNESS", (250.0,))
    monkeypatch.setattr(rig_designs, "_DAMPING", (0.6,))
    monkeypatch.setattr(rig_designs, "_LOCAL_FORCES", (0.0, -0.3))
    own = tmp_path / "own.toml"
    words = ["--design", "transparent", "--set", f"accelerations={int(accelerations)}"]
    assert main(["design", "lawrence", *words, "-o", str(own)]) == 0
    assert "from the transparent hybrid matrix" in capsys.readouterr().out
    law = parse(LawrenceConfig, load_rig(own).controller.parameters, "test")
    for d, m in zip(law_parameters.designs_of(law), law.masses().T, strict=True):
        assert d.c2 == pytest.approx(1 + d.c6) and d.c3 == pytest.approx(1 + d.c5)
        assert (d.c1.a != 0.0) == accelerations
        if accelerations:
            assert d.c1.a == pytest.approx(RobotImpedance(m[1]).m + d.c7.a)
    assert main(["run", str(own), "-o", str(tmp_path / "s.mcap"), "--seconds", "1.5"]) == 0


@pytest.mark.slow
def test_a_delay_counts_in_the_ticks_that_the_loop_has(tmp_path, capsys):
    """1.6 ms are two ticks, which this loop does not bear; its margin is 1.7 ms."""
    words = ["design", "lawrence", "--design", "position-error", "--set", "velocity_hz=1e6"]
    own = tmp_path / "edge.toml"
    for delay in ("0.0016", "0.002", "0.0011"):
        assert main([*words, "--set", f"forward={delay}", "-o", str(own)]) == 2
        said = capsys.readouterr()
        assert "round-trip delay of 2 ms is beyond the margin of 1.7 ms" in said.err
        assert "channel in ticks of 1 ms: there 2 ms (2 ticks); back 0 ms (0 ticks)" in said.out
    assert main([*words, "--set", "forward=0.0009", "-o", str(own)]) == 0
    # the whole map with two ticks has an eigenvalue beyond 1 somewhere in the set
    law = law_of("position-error", {}, velocity_hz=1e6, forward={"delay": 0.0016})
    loop = loops_of(law)[0]
    sizes = [
        sampled_loop.dominant_mode(replace(one, tip=loop.tips[0]), zh, ze, T)[0]
        for one in (loop, gate._sliding(loop))
        for zh in loop.operators
        for ze in loop.environments
    ]
    assert max(sizes) > 1.0 + 1e-4


def test_the_compensation_of_negative_friction_is_judged_and_named():
    """It brakes by its damping, which the cable bears no more than that of c8."""
    given = dict(RIG.controller.parameters) | {"friction_share": 0.9}

    def negative(value):
        effects = {f"j{j}.viscous.fv": value for j in (1, 2, 3)}
        return loops_of(given | {"leader_effects": effects})

    loops = negative(-0.3)
    assert loops[0].compensated[0] < -5.0 and loops[0].friction[0] == 0.2
    with pytest.raises(ConfigError, match=r"brakes by .* N s/m at the tip, .* check the signs"):
        gate.refuse(loops, T)
    c8 = loops[0].design.c8
    design = replace(loops[0].design, c8=replace(c8, b=c8.b - loops[0].compensated[0]))
    damper = replace(loops[0], compensated=(0.0, 0.0), design=design)
    assert not gate.passes(damper, T)
    assert all(gate.passes(x, T) for x in negative(-0.001))


@pytest.mark.parametrize(
    "setting", [pytest.param("observer_hz=5", marks=pytest.mark.slow), "disturbance=0.1"]
)
def test_the_advice_against_an_observer_is_to_lower_it(setting, capsys):
    words = ["design", "lawrence", "--set", "disturbance=1", "--set", "observer_hz=20"]
    assert main(words) == 2
    assert capsys.readouterr().err.strip().endswith("; lower observer_hz or disturbance")
    assert main([*words, "--set", setting]) == 0


# ------------------------------------------------------------ scales of motion and force

SCALED = {"motion_scale": 3.0, "force_scale": 0.2}


def scaled_rig(tmp_path, **changes):
    law = dict(RIG.controller.parameters) | SCALED | changes
    own = dataclasses.replace(RIG.controller, parameters=law)
    path = tmp_path / "scaled.toml"
    path.write_text(to_toml(plain(dataclasses.replace(RIG, controller=own))))
    return str(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "position-error",
        "position-force",
        pytest.param("transparent", marks=pytest.mark.slow),
        pytest.param("optimised", marks=pytest.mark.slow),
    ],
)
def test_a_new_design_keeps_the_scales_of_the_rig(name, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(rig_designs, "_STIFFNESS", (60.0, 120.0))
    monkeypatch.setattr(rig_designs, "_DAMPING", (0.3, 0.6))
    monkeypatch.setattr(rig_designs.optimise, "_OPTIONS", {"maxiter": 15, "ftol": 1e-3})
    own = tmp_path / "own.toml"
    words = ["design", scaled_rig(tmp_path, acceleration_hz=5.0), "--design", name, "-o", str(own)]
    if name.startswith("position"):
        words += ["--set", "stiffness=60", "--set", "damping=0.3", "--set", "master_damping=0.3"]
    assert main(words) == 0, capsys.readouterr().err
    law = load_rig(own).controller.parameters
    assert {k: law[k] for k in SCALED} == SCALED
    if name.startswith("position"):
        assert law["c1"][0] == pytest.approx(3.0 * law["c7"][0])


def test_a_law_over_a_delay_keeps_the_force_scale_and_no_other(tmp_path, capsys):
    own = tmp_path / "own.toml"
    words = ["--design", "waves", "-o", str(own)]
    assert main(["design", scaled_rig(tmp_path), *words]) == 2
    assert "has motion_scale = 3, and --design waves moves" in capsys.readouterr().err
    assert main(["design", scaled_rig(tmp_path, motion_scale=1.0), *words]) == 0
    assert load_rig(own).controller.parameters["force_scale"] == 0.2


def test_a_scaled_transparent_design_is_told_to_be_so(tmp_path, capsys):
    """z_t = kp kf z_e: over kp kf the slope is 1, whatever the scales."""
    words = ["--design", "four-channel", "--set", "motion_scale=3", "--set", "force_scale=0.2"]
    page = tmp_path / "d.html"
    assert main(["design", "lawrence", *words, "--report", str(page)]) == 2
    said = capsys.readouterr().out
    rest = re.search(r"dz_t/dz_e / \(kp kf\) at rest +([\d.]+)", said)
    assert float(rest[1]) == pytest.approx(1.0, rel=1e-3) and "transparent: yes" in said
    assert "h12 = 0.2, h21 = -3." in page.read_text()


# ------------------------------------------------------------ a law of two whole arms


def coupled(**law):
    config = load_rig("surgical", {"controller": {"parameters": law}})
    own = parse(cartesian.CartesianCouplingConfig, config.controller.parameters, "test")
    arms = config.controller.arms
    return cartesian.margin(own, arms, T, tuple(arm_description(config.arms[a]) for a in arms))


#: Two arms of six joints, their rotors, and where the gate finds the worst of them.
ARMATURE = (0.03, 0.06, 0.03, 0.01, 0.01, 0.01)
ARM6 = rig_path("arm6").with_name("arm6.urdf")


def two_arms(tmp_path, **law):
    """Rig file of two arms of six joints that are coupled joint by joint."""
    told = plain(load_rig("arm6"))
    path = tmp_path / "two.toml"
    arm = {"robot": str(ARM6)}
    drives = {"driver": "damiao"}
    table = {
        "schema": "hil.rig/1",
        "name": "two",
        "loop": told["loop"],
        "arms": {"one": arm, "two": arm},
        "devices": {
            n: {**drives, "arm": a, "channels": {"drives": [f"{n}/{k}" for k in range(1, 7)]}}
            for n, a in (("left", "one"), ("right", "two"))
        },
        "boxes": {
            n: {"driver": "damiao-can", "address": f"can{k}"}
            for k, n in enumerate(("left", "right"))
        },
        "controller": {
            "name": "joint-coupling",
            "arms": ["one", "two"],
            "parameters": {"armature": list(ARMATURE), **law},
        },
    }
    path.write_text(to_toml(table), encoding="utf-8")
    return path


def margin_of(path):
    config = load_rig(path)
    own = parse(joint_space.JointCouplingConfig, config.controller.parameters, "test")
    robots = tuple(arm_description(a) for a in config.arms.values())
    return joint_space.coupling_margin(own, ("one", "two"), 2e-3, robots), own, robots


NO_FRICTION = {"leader_friction": [], "follower_friction": []}


def test_the_law_of_the_packaged_rig_is_stable_over_postures_hands_and_contacts():
    found = coupled()
    assert found.members > 200 and 0.0 < found.delay_s < T
    assert found.radius < 1.0 + gate.DRIFT * T


def test_a_law_of_whole_arms_that_is_judged_unstable_rings_in_the_simulator(tmp_path, monkeypatch):
    """Springs of turning that are as stiff as the law allows; arms without friction, let go."""
    stiff = {"turn_stiffness": 55.0}
    assert coupled(**stiff).delay_s < 0.0
    monkeypatch.setattr(gate, "refuse_coupled", lambda found, period: None)

    def speeds(**law):
        rows = []

        def opener(config, seed):
            rig = open_rig(config, seed)
            for arm in rig.bench.arms.values():
                arm.p["coulomb"] = 0.0
                arm.p["viscous"] = 1e-4
                arm.p["lag"] = T
            follower = rig.bench.arms["follower"]
            rig.bench.after.append(lambda _: rows.append(np.abs(follower.x["v"]).max()))
            return rig

        config = load_rig("surgical", {"controller": {"parameters": {**NO_FRICTION, **law}}})
        alone = replace(config, simulation={})
        runner.run_session(alone, 1.0, 1, "lockstep", tmp_path / "s.mcap", opener=opener)
        return max(rows[-500:])

    assert speeds(**stiff) > 3.0 * speeds()


@pytest.mark.parametrize("law", [{"turn_stiffness": 55.0}, {"incision_stiffness": 0.0}])
def test_hil_run_starts_no_law_of_whole_arms_that_hil_design_refuses(law, tmp_path, capsys):
    """Before any device opens; the same sentence from both."""
    config = load_rig("surgical", {"controller": {"parameters": law}})
    own = tmp_path / "own.toml"
    own.write_text(to_toml(plain(config)))
    for text in ("surgical-leader.urdf", "surgical-follower.urdf"):
        (tmp_path / text).write_text((rig_path("surgical").parent / text).read_text())
    assert main(["design", str(own)]) == 2
    said = capsys.readouterr()
    assert "REFUSED" in said.out and "the law is unstable: with " in said.err
    assert main(["run", str(own), "-o", str(tmp_path / "s.mcap")]) == 2
    assert said.err.partition("the law is")[2] == capsys.readouterr().err.partition("the law is")[2]
    assert not (tmp_path / "s.mcap").exists()


def test_hil_design_judges_a_law_of_whole_arms(capsys):
    assert main(["design", "surgical"]) == 0
    said = capsys.readouterr().out
    assert "may run" in said and "ms at most" in said
    assert main(["design", "surgical", "-o", "x.toml"]) == 2
    assert "means nothing for cartesian-coupling" in capsys.readouterr().err
    assert main(["design", "surgical", "--design", "position-error"]) == 2
    assert "arm 'leader' has 6 joints" in capsys.readouterr().err


# ------------------------------------------------------------ two arms coupled joint by joint


def swung(own, robots, posture, share, wall, seconds):
    """Speed of the follower's joints (n, 6): bodies of an independent library against a wall.

    All motion counts, not the small one alone; efforts act a tick after what they answer to.
    """
    period, steps = 2e-3, 8
    law = joint_space.JointCoupling(own, ("one", "two"), period, robots, judged=False)
    (q,) = (q for name, q in gate._postures(robots) if name == posture)
    model = pin.buildModelFromXML(robots[0].urdf)
    data, tip = model.createData(), model.nframes - 1
    q, v = np.array(q), 1e-6 * np.random.default_rng(1).normal(size=(2, 6))
    pin.framesForwardKinematics(model, data, q[1])
    touched = data.oMf[tip].translation.copy()
    n = len(law.state_names)
    x, x_next, u, y = np.zeros(n), np.zeros(n), np.zeros((2, 18)), np.zeros((2, 6))
    sent, seen = None, []
    for k in range(round(seconds / period)):
        u[:, :6], u[:, 6:12] = q, v
        law.update(k * period, x, u, x_next, y)
        x, x_next = x_next, x
        sent = y.copy() if sent is None else sent
        for _ in range(steps):
            for a in range(2):
                mass = share * (pin.crba(model, data, q[a]) + np.diag(own.rotors(6)))
                tau = sent[a] - pin.nle(model, data, q[a], v[a])
                if a == 1:
                    jac = pin.computeFrameJacobian(
                        model, data, q[a], tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
                    )
                    pin.framesForwardKinematics(model, data, q[a])
                    tau -= jac[:3].T @ (wall * (data.oMf[tip].translation - touched))
                v[a] += period / steps * np.linalg.solve(mass, tau)
                q[a] += period / steps * v[a]
        sent = y.copy()
        seen.append(v[1].copy())
    return np.array(seen)


@pytest.mark.slow
def test_what_the_gate_says_of_joint_coupling_is_what_the_bodies_do(tmp_path):
    """Refused: the mode that is named grows as told; let pass: none does, in the same place."""
    worst, own, robots = margin_of(two_arms(tmp_path, bandwidth_hz=12.0))
    posture, masses, hand, contact = worst.where.split(", ")
    assert worst.delay_s < 0.0 and (hand, contact) == ("let go", "a wall of 3000 N/m")
    place = (robots, posture, float(masses.split()[0]) / 100.0, 3000.0)
    swings = swung(own, *place, 1.1)
    early, late = (np.abs(swings[at : at + 100]).max() for at in (200, 450))
    growth = np.log(worst.radius) / 2e-3
    assert np.log(late / early) / 0.5 == pytest.approx(growth, rel=0.1)
    end = swings[250:550, 4]
    beats = np.fft.rfftfreq(end.size, 2e-3)[np.abs(np.fft.rfft(end)).argmax()]
    assert beats == pytest.approx(worst.hz, abs=2.0)
    good, own, robots = margin_of(two_arms(tmp_path))
    assert good.delay_s >= 0.0
    calm = swung(own, *place, 1.1)
    # what is left of the start turns to and fro at 1 Hz; of what is fast, less and less
    assert np.abs(calm[450:550]).max() < 1.3 * np.abs(calm[200:300]).max()
    fast = np.abs(np.diff(calm, n=2, axis=0)).max(axis=1)
    assert fast[450:550].max() < 0.05 * fast[:50].max()


def test_joint_coupling_is_asked_for_by_design_and_by_run(tmp_path, capsys):
    good, bad = two_arms(tmp_path), tmp_path / "bad.toml"
    session = str(tmp_path / "s.mcap")
    assert main(["design", str(good)]) == 0
    said = capsys.readouterr().out
    assert "law joint-coupling" in said and "may run" in said
    assert main(["run", str(good), "-o", session, "--seconds", "1"]) == 0
    assert "ENABLED" in capsys.readouterr().out
    bad.write_text(good.read_text("utf-8") + "bandwidth_hz = 12.0\n", encoding="utf-8")
    for words in (["design", str(bad)], ["run", str(bad), "-o", session, "--seconds", "1"]):
        assert main(words) == 2
        error = capsys.readouterr().err
        assert "the law is unstable: with posture 6" in error
        assert "lower bandwidth_hz, or give the rotors (armature)" in error
    # of an arm whose rotors are not told, nothing but its light bodies is sure
    assert margin_of(two_arms(tmp_path, armature=[]))[0].delay_s < 0.0
    good = two_arms(tmp_path)
    with pytest.raises(ConfigError, match="unstable"):
        open_rig(load_rig(bad), 1)
    assert main(["design", str(good), "--set", "share=0.5"]) == 2
    assert "means nothing for joint-coupling" in capsys.readouterr().err


def test_weight_that_is_compensated_late_drifts_as_told_and_is_left_out():
    """Arms without rotors in the postures of the set: slow growth of T max eig(M^-1 G) at most."""
    whole_range = arm_description(load_rig("arm6").arms["arm"])
    told = replace(whole_range, low=(-1.0,) * 6, high=(1.0,) * 6, center=(0.1,) * 6)
    law = joint_space.JointCouplingConfig()
    free = joint_space.JointCoupling(law, ("a", "b"), 2e-3, (told, told), judged=False)
    none = [np.zeros(6)] * 2
    whole, less = (
        gate.coupled(free, (told, told), none, 2e-3, latest=gate.USUAL_DELAY_TICKS, drifts=d)
        for d in (False, True)
    )
    assert whole.hz < 0.5 and np.log(whole.radius) / 2e-3 > gate.DRIFT
    assert less.radius < 1.0 + gate.DRIFT * 2e-3
    # both arms alike, in one posture: the whole of it
    robot = bare_robot(RobotSource("", told.urdf), told.joints)
    q = [np.array(told.center)] * 2
    near = gate._Near(free, q)
    arms = [gate._Arm(robot, x, 1.0, np.zeros(6), 2e-3, (0.0,) * 4) for x in q]
    for late in (1.0, 3.0):
        values = np.linalg.eigvals(near.closed(*arms, late))
        slow = np.abs(values[np.abs(np.angle(values)) < 2 * np.pi * 0.5 * 2e-3]).max()
        assert np.log(slow) / 2e-3 == pytest.approx(arms[0].falls * (late + 0.5) * 2e-3, rel=0.02)
