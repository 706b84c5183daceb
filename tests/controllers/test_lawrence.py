"""The Lawrence law: channels, computed torque, sampled prediction, refusals; on the rig too."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import plants
import pytest

from hil.bench import teleop
from hil.cli import main
from hil.controllers import dynamics, lawrence, lawrence_config
from hil.controllers.lawrence import Lawrence, LawrenceConfig
from hil.controllers.lawrence_config import ChannelConfig
from hil.errors import ConfigError, DeviceError
from hil.models.phantom import Premium
from hil.record.container import read
from hil.record.mcap_read import load
from hil.record.schema import decode_numbers
from hil.rig.config import load_rig
from hil.runtime import runner
from hil.runtime.session import plain, to_toml
from hil.teleop import (
    architecture,
    gate,
    law_parameters,
    lawrence_filters,
    sampled_loop,
)
from hil.teleop.architecture import Design, MotionTerm, RobotImpedance
from hil.toml import parse

RIGS = Path(__file__).parents[2] / "rigs"
ARMS, T = ("leader", "follower"), 1e-3
LENGTHS = np.array([0.215, 0.170])
HOME = np.array([0.1, 0.4, 0.3])


def config(**changes):
    design = architecture.named_design(
        "position-force",
        architecture.Wish(stiffness=200, damping=1.5, share=0.5, master_damping=0.3),
    )
    return LawrenceConfig(**{**law_parameters.law_table([design]), **changes})


def at_home():
    u = np.zeros((2, 12))
    u[:, :3] = HOME
    return u


def drive(law, forces=None, steps=30, move=0.0):
    """Final torques and state; `forces` (2, 3) from the start, the leader moved by `move` rad."""
    n = len(law.state_names)
    x, following, y = np.zeros(n), np.zeros(n), np.zeros((2, 3))
    seen = []
    for k in range(1, steps + 1):
        u = at_home()
        if forces is not None:
            u[:, 6:9] = forces
        if k > 1:
            u[0, 0] += move
        law.update(k * T, x, u, following, y)
        x, following = following, x
        seen.append(y.copy())
    return np.array(seen), x


def test_the_law_is_pure_also_with_a_channel():
    law = Lawrence(config(forward=ChannelConfig(0.003), backward=ChannelConfig(0.002)), ARMS, T)
    rng = np.random.default_rng(0)
    n = len(law.state_names)
    x, u = rng.uniform(0.1, 1, n), rng.uniform(-0.3, 0.3, (2, 12))
    kept, answers = (x.copy(), u.copy()), []
    for _ in range(2):
        following, y = np.full(n, np.nan), np.full((2, 3), np.nan)
        law.update(1.234, x, u, following, y)
        answers.append((following, y))
    for a, b in zip(*answers, strict=True):
        assert np.isfinite(a).all()
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(x, kept[0])
    np.testing.assert_array_equal(u, kept[1])


def test_the_two_laws_on_an_axis():
    d = Design(
        MotionTerm(1, 2, 3),
        0.4,
        0.5,
        MotionTerm(4, 5, 6),
        0.6,
        0.7,
        MotionTerm(7, 8, 9),
        MotionTerm(10, 11, 12),
    )
    g = sampled_loop.gains(d)
    m, s = np.array([0.1, 0.2, 0.3, 0.4]), np.array([0.5, 0.6, 0.7, 0.8])
    terms = {
        n: np.array([getattr(d, n).k, getattr(d, n).b, getattr(d, n).a])
        for n in ("c1", "c4", "c7", "c8")
    }
    fcm = 0.7 * 0.4 - 0.4 * 0.8 - terms["c4"] @ s[:3] - terms["c8"] @ m[:3]
    fcs = terms["c1"] @ m[:3] + 0.5 * 0.4 - 0.6 * 0.8 - terms["c7"] @ s[:3]
    assert lawrence_filters.master(g, m, s) == pytest.approx(fcm)
    assert lawrence_filters.slave(g, m, s) == pytest.approx(fcs)


def test_the_follower_is_pulled_and_the_force_comes_back():
    law = Lawrence(config(force_hz=0.0), ARMS, T)
    rest, _ = drive(law)
    pulled, _ = drive(law, move=0.05)
    assert pulled[-1, 1, 0] > rest[-1, 1, 0] + 0.02
    force = np.array([0.3, -0.2, 1.0])
    pushed, x = drive(law, np.stack([np.zeros(3), force]))
    jacobian = np.zeros((3, 3))
    dynamics.jacobian(HOME, LENGTHS, jacobian)
    # the environment pushes the follower by +F, so f_s = -F and the leader gets +c2 F
    np.testing.assert_allclose(pushed[-1, 0] - rest[-1, 0], 0.5 * jacobian.T @ force, atol=1e-9)
    assert x.size == len(law.state_names)


def test_a_delayed_channel_delivers_late_and_a_lossy_one_holds():
    law = Lawrence(config(forward=ChannelConfig(0.004)), ARMS, T)
    moved, _ = drive(law, move=0.05)
    pull = moved[:, 1, 0] - moved[0, 1, 0]
    assert np.flatnonzero(np.abs(pull) > 1e-9)[0] == 1 + 4
    ages = lawrence_config.schedule(ChannelConfig(0.005, 0.003, 0.2), T, seed=3)
    # what takes 5 to 8 ms has arrived by the ticks 6 to 8
    assert ages.min() == 6 and 8 <= ages.max() < 40
    # the newest packet only ever gets newer
    assert (np.diff(np.arange(ages.size) - ages) >= 0).all()
    assert (lawrence_config.schedule(ChannelConfig(0.005), T, 0) == 5).all()
    none = lawrence_config.schedule(ChannelConfig(loss=0.3), T, 1)
    assert np.mean(none > 0) == pytest.approx(0.3, abs=0.02)
    with pytest.raises(ConfigError, match="loss"):
        ChannelConfig(loss=1.0)


@pytest.mark.parametrize(
    ("delay", "jitter", "least", "most"),
    [
        (0.0, 0.0, 0, 0),
        (0.005, 0.0, 5, 5),
        (0.3, 0.0, 300, 300),
        (0.0005, 0.0, 1, 1),
        (0.0015, 0.0, 2, 2),
        (0.0025, 0.0, 3, 3),
        (0.0123, 0.0, 13, 13),
        (0.0, 0.0009, 1, 1),
        (0.0, 0.005, 1, 5),
        (0.0102, 0.0003, 11, 11),
    ],
)
def test_no_packet_is_used_before_it_arrives(delay, jitter, least, most):
    way = ChannelConfig(delay, jitter)
    ages = lawrence_config.schedule(way, T, seed=3)
    assert ages.min() == least and ages.max() == most
    assert (ages * T >= delay - 1e-9).all()
    # the gate and the command have the longest of them
    assert architecture.ticks(delay + jitter, T) == most
    assert f"({f'{least} to {most}' if least < most else most} ticks)" in way.told(T)


def test_packets_arrive_at_the_tick_after_their_own_delay():
    """Draws of the same seed, whose newest packets are sought one by one."""
    way, n = ChannelConfig(0.0023, 0.004, 0.2), lawrence_config.CYCLE
    rng = np.random.default_rng([5, 0xC4A])
    there = np.arange(2 * n) * T + 0.0023 + rng.uniform(0.0, 0.004, 2 * n)
    there[rng.uniform(size=2 * n) < 0.2] = np.inf
    ages = lawrence_config.schedule(way, T, seed=5)
    for k in range(n, n + 300):
        assert ages[k - n] == k - np.flatnonzero(there <= k * T + 1e-8)[-1]


def test_inverse_dynamics_is_that_of_the_library():
    rng = np.random.default_rng(1)
    q, v, a = (rng.uniform(-1, 1, (200, 3)) for _ in range(3))
    wanted = Premium(()).regressor(q, v, a) @ np.array(lawrence_config.PREMIUM)
    out = np.zeros(3)
    for k in range(200):
        dynamics.premium_inverse_dynamics(q[k], v[k], a[k], np.array(lawrence_config.PREMIUM), out)
        np.testing.assert_allclose(out, wanted[k], atol=1e-15)
    np.testing.assert_allclose(Premium.prior, lawrence_config.PREMIUM)


def accelerated(q, v, tau, force, pi):
    """q'' of the model under tau and a tip force."""
    arm = Premium(())
    rest = arm.regressor(q[None], v[None], np.zeros((1, 3)))[0] @ pi
    m = np.stack([arm.regressor(q[None], v[None], e[None])[0] @ pi - rest for e in np.eye(3)], 1)
    jac = arm.jacobian(q[None])[0]
    return np.linalg.solve(m, tau + jac.T @ force - rest), jac


@pytest.mark.parametrize("shape", ["force", "acceleration"])
def test_computed_torque_makes_a_point_mass_of_the_arm(shape):
    """Mw p'' = F_c + F_s to rounding, at any pose, speed and force (ideal signals)."""
    rng = np.random.default_rng(2)
    law = config(shape=shape, leader_mass=(0.1, 0.2, 0.3), follower_mass=(0.15,))
    c = lawrence.constants(law, T)
    w, pi = np.zeros(1, lawrence.WORK)[0], np.array(lawrence_config.PREMIUM)
    arm, out = Premium(()), np.zeros(3)
    for arm_index in (0, 1):
        for _ in range(40):
            q = np.array([rng.uniform(-1, 1), rng.uniform(-0.3, 0.9), 0.0])
            q[2] = q[1] + rng.uniform(-0.6, 0.6)
            v, fc, fs = rng.uniform(-3, 3, 3), rng.normal(size=3), rng.normal(size=3)
            w["jacobian"][arm_index] = arm.jacobian(q[None])[0]
            sign = 1.0 if arm_index == 0 else -1.0
            w["signals"][arm_index, :, 3] = sign * fs
            eps = 1e-6
            ahead, behind = (arm.jacobian((q + h * v)[None])[0] @ v for h in (eps, -eps))
            bend = (ahead - behind) / (2 * eps)
            if shape == "acceleration":
                # the acceleration that the point mass would have, fed back
                w["signals"][arm_index, :, 2] = (fc + fs) / c["masses"][arm_index]
            lawrence.torque(arm_index, q, v, fc, c, w, out)
            qdd, jac = accelerated(q, v, out, fs, pi)
            got = jac @ qdd + bend
            np.testing.assert_allclose(c["masses"][arm_index] * got, fc + fs, atol=1e-6)


def test_near_a_singular_pose_torques_stay_finite():
    law = Lawrence(config(shape="force"), ARMS, T)
    n = len(law.state_names)
    u, following, y = np.zeros((2, 12)), np.zeros(n), np.zeros((2, 3))
    u[:, 1], u[:, 6:9] = np.pi / 2, 1.0
    law.update(T, np.zeros(n), u, following, y)
    assert np.isfinite(y).all()


BAD = [
    ({"c7": (-50.0, 1.0, 0.0)}, "c7 .* pushes the follower away"),
    ({"c8": (0.0, 0.3, 0.05), "acceleration_hz": 0.0}, "improper gain; set acceleration_hz"),
    ({"c5": (-1.5,)}, "c5 = -1.5 is improper"),
    ({"c2": (4.0,)}, "unstable, a pole at"),
    ({"c1": (300.0, 5.0, 0.0), "c7": (300.0, 5.0, 0.0)}, "not when sampled every 1 ms"),
    ({"backward": ChannelConfig(0.15)}, "round-trip delay of 150 ms is beyond the margin of"),
    ({"c1": (float("nan"), 0.0, 0.0)}, "not a finite number"),
]


@pytest.mark.parametrize(("changes", "says"), BAD)
def test_a_bad_design_is_refused_before_anything_moves(changes, says):
    with pytest.raises(ConfigError, match=says):
        Lawrence(config(**changes), ARMS, T)


WRONG = [
    ({"cable": (0.0, 0.0, 0.0)}, "cable = .* must be positive"),
    ({"seed": -1}, "seed = -1; a number from 0 on"),
    ({"pose": (0.0, 0.4, 0.4 + np.pi / 2)}, "rad is singular"),
    ({"follower_model": (0.0,) * 8}, "no positive inertia"),
    ({"motion_scale": 0.0}, "motion_scale must be positive"),
    ({"velocity_hz": -1.0}, "velocity_hz must not be negative"),
]


@pytest.mark.parametrize(("changes", "says"), WRONG)
def test_numbers_that_no_arm_has_are_refused_by_name(changes, says, tmp_path, capsys):
    with pytest.raises(ConfigError, match=says):
        Lawrence(config(**changes), ARMS, T)
    rig = tmp_path / "rig.toml"
    given = load_rig(RIGS / "lawrence.toml")
    law = {k: list(v) if isinstance(v, tuple) else v for k, v in changes.items()}
    own = replace(given.controller, parameters={**given.controller.parameters, **law})
    rig.write_text(to_toml(plain(replace(given, controller=own))))
    for words in (["design", str(rig)], ["run", str(rig), "-o", str(tmp_path / "s.mcap")]):
        assert main(words) == 2
        assert re.search(says, capsys.readouterr().err)


def test_an_infinite_wish_is_named(capsys):
    with pytest.raises(ConfigError, match="environment has a number that is not finite"):
        Lawrence(config(environment=(0.0, float("inf"), 1.0)), ARMS, T)
    rig = str(RIGS / "lawrence.toml")
    assert main(["design", rig, "--design", "position-error", "--set", "stiffness=inf"]) == 2
    assert "stiffness = inf must be a finite number" in capsys.readouterr().err
    assert main(["design", rig, "--design", "optimised", "--set", "max_stiffness=inf"]) == 2
    assert "stiffness = inf" in capsys.readouterr().err


def test_the_command_prints_and_writes_what_run_takes(tmp_path, capsys):
    rig, own = str(RIGS / "lawrence.toml"), str(tmp_path / "own.toml")
    words = [
        "design",
        rig,
        "--design",
        "position-error",
        "--set",
        "stiffness=150",
        "--set",
        "damping=1.2",
        "--set",
        "master_stiffness=150",
        "--set",
        "master_damping=1.2",
        "--set",
        "forward=0.002,0.001,0.05",
        "--set",
        "velocity_hz=30",
    ]
    page = tmp_path / "d.html"
    assert main([*words, "-o", own, "--report", str(page)]) == 0
    said = capsys.readouterr().out
    assert "may run" in said and "dz_t/dz_e" in said
    told = page.read_text()
    assert told.count("<figure>") == 4 and "may run: both conditions are met" in told
    # the policy of the page lets no other script draw
    assert told.count('<script type="application/json" class="figure">') == 4
    assert "Plotly.newPlot(" not in told.rpartition("</style>")[2].partition("<body>")[2]
    law = load_rig(own).controller
    assert law.name == "lawrence"
    assert law.parameters["c1"][:2] == (150.0, 1.2) or law.parameters["c1"][:2] == [150.0, 1.2]
    assert main(["run", own, "-o", str(tmp_path / "s.mcap"), "--seconds", "0.3"]) == 0


def test_goals_and_conditions_are_told_apart(capsys):
    rig = str(RIGS / "lawrence.toml")
    assert main(["design", rig]) == 0
    said = capsys.readouterr().out
    assert "absolute stability margin" in said and "the other rows are goals" in said
    assert "may run: both conditions are met" in said
    assert "axis x, y, z: c2 is 0.5, it should be 1\n" in said
    assert "axis y: c1 is 250/s + 1.5, it should be 250/s + 1.5 + 0.0744 s\n" in said
    assert main(["design", rig, "--design", "four-channel"]) == 2
    said = capsys.readouterr().out
    assert "unlimited" not in said
    assert next(x for x in said.splitlines() if "conditioning of Q" in x).count("infinite") == 3
    assert re.search(r"this pair is stable on paper, with its rightmost pole at -\d", said)


def test_rounding_is_not_said():
    law = Design(c1=MotionTerm(250.0, 1.5, 7.8e-18), c7=MotionTerm(250.0, 1.5, 0.0))
    texts = [c.text for c in architecture.conditions(law) if c.name == "c1"]
    assert texts[0].startswith("c1 is 250/s + 1.5, it")


def test_the_command_refuses_to_write_a_bad_design(tmp_path, capsys):
    rig, own = str(RIGS / "lawrence.toml"), tmp_path / "own.toml"
    words = ["design", rig, "--design", "four-channel", "-o", str(own)]
    assert main(words) == 2
    said = capsys.readouterr()
    assert "is not written" in said.err and "REFUSED" in said.out
    assert not own.exists()
    assert main(words[:-2]) == 2  # nothing to write, refused all the same
    said = capsys.readouterr()
    assert "would not start it" in said.err and "REFUSED" in said.out
    assert main([*words[:-2], "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["refused"]
    assert main([*words, "--fsf"]) == 2
    assert "singularity" in capsys.readouterr().err
    assert main(["design", rig, "--set", "stifness=3"]) == 2
    assert "Did you mean 'stiffness'" in capsys.readouterr().err
    assert main(["design", str(RIGS / "teleop.toml")]) == 2
    assert "--design" in capsys.readouterr().err


def session(tmp_path, over, seconds=3.0):
    from hil.runtime.runner import run_session

    run_session(load_rig(RIGS / "lawrence.toml", over), seconds, 3, output=tmp_path / "s.mcap")
    return [load(tmp_path / "s.mcap", arm) for arm in ARMS]


def test_the_simulated_rig_tracks_and_the_operator_feels_the_gel(tmp_path):
    over = {"simulation": {"gel": {"below_home": -0.002}}}
    leader, follower = session(tmp_path, over)
    tips = [Premium(()).tip(r.q) for r in (leader, follower)]
    tips = [p - p[0] for p in tips]
    assert tips[0].std(0).min() > 5e-3
    assert np.sqrt(np.mean((tips[0] - tips[1])[:, :2] ** 2)) < 1.5e-3
    touch = follower.wrench[:, 2] > 0.1
    assert touch.sum() > 200
    # the hand holds up against half of the gel's force
    assert np.corrcoef(leader.wrench[touch, 2], follower.wrench[touch, 2])[0, 1] < -0.3


def test_design_masses_and_rig_file_belong_together():
    law = LawrenceConfig(
        **{
            k: tuple(v) if isinstance(v, (list, tuple)) else v
            for k, v in load_rig(RIGS / "lawrence.toml").controller.parameters.items()
        }
    )
    for pi, mass in ((law.leader_model, law.leader_mass), (law.follower_model, law.follower_mass)):
        np.testing.assert_allclose(law_parameters.tip_mass(pi, law.pose), mass, atol=1e-4)
    assert replace(law, shape="force").shape == "force"
    assert RobotImpedance(0.1).m == 0.1


def energy(q, v, pi):
    """Kinetic and potential energy of the model: N = dU/dq."""
    arm = Premium(())
    still = arm.regressor(q[None], np.zeros((1, 3)), np.zeros((1, 3)))[0] @ pi
    m = [arm.regressor(q[None], np.zeros((1, 3)), e[None])[0] @ pi - still for e in np.eye(3)]
    return 0.5 * v @ np.stack(m, 1) @ v + pi[6] * np.sin(q[1]) - pi[7] * np.cos(q[2])


def test_the_torque_of_the_loops_model_conserves_energy():
    """q'^T tau = dE/dt at any state: M' - 2 C is skew, N is a gradient."""
    rng, out, pi = np.random.default_rng(5), np.zeros(3), np.array(lawrence_config.PREMIUM)
    for _ in range(200):
        q, v, a = rng.uniform(-1, 1, (3, 3)) * [[1], [4], [30]]
        dynamics.premium_inverse_dynamics(q, v, a, pi, out)
        h = 1e-6
        ahead, behind = (energy(q + s * v, v + s * a, pi) for s in (h, -h))
        assert v @ out == pytest.approx((ahead - behind) / (2 * h), abs=1e-7)


@pytest.mark.parametrize(("stiffness", "damping", "grows"), [(300, 1.0, False), (300, 2.5, True)])
def test_the_rig_does_what_the_check_with_the_cable_says(
    stiffness, damping, grows, tmp_path, monkeypatch
):
    """A design that a rigid arm would bear is refused, and does grow on the simulated rig."""
    given = load_rig(RIGS / "lawrence.toml").controller.parameters
    pull = [float(stiffness), damping, 0.0]
    back = [-float(stiffness), -damping, 0.0]
    law = {**given, "c1": pull, "c4": back, "c7": pull, "c8": pull, "c2": [0.0]}
    over = {"controller": {"parameters": law}}
    built = parse(LawrenceConfig, law, "test")
    if grows:
        with pytest.raises(ConfigError, match="not when sampled"):
            Lawrence(built, ARMS, T)
        gate.refuse(law_parameters.loops_of(replace(built, cable=())), T)  # rigid: accepted
        monkeypatch.setattr(lawrence, "refuse", lambda *_: None)
    try:
        leader, _ = session(tmp_path, over, 1.5)
    except DeviceError:  # a speed or torque limit ended it
        leader = load(tmp_path / "s.mcap", "leader")
    ripple = np.abs(np.diff(leader.qd, axis=0)).max()
    assert (ripple > 1.0) == grows


def test_the_observer_in_the_loop_sees_the_force_that_the_sensor_sees(tmp_path):
    machine = {"kind": "mechanical", "frequency": 1.0, "size": [0.0, 0.0, 0.008]}
    gel = {"below_home": -0.02, "stiffness": 500.0}
    _, follower = session(tmp_path, {"simulation": {"operator": machine, "gel": gel}}, 3.0)
    topic = read(tmp_path / "s.mcap").topics["/controller/state"]
    at = Lawrence.state_names.index("follower_observed_z")
    seen, kept = decode_numbers(topic)[:, at], np.array(topic.sequence) - 1
    sensor = follower.wrench[kept, 2]
    late = kept > 500
    assert sensor[late].std() > 0.1
    assert np.corrcoef(seen[late], sensor[late])[0, 1] > 0.95
    # what is left is the friction, not compensated here
    assert np.sqrt(np.mean((seen - sensor)[late] ** 2)) < 0.15


def test_momentum_terms_of_the_loop_are_those_of_the_model():
    rng, pi = np.random.default_rng(6), np.array(lawrence_config.PREMIUM)
    p, flow, room = np.zeros(3), np.zeros(3), np.zeros((6, 3))
    q, v = rng.uniform(-1, 1, (50, 3)), rng.uniform(-3, 3, (50, 3))
    m, rest = plants.premium_terms(pi, q, v)
    for k in range(50):
        dynamics.premium_momentum(q[k], v[k], pi, room[:2], p)
        dynamics.push(q[k], v[k], pi, room, flow)
        np.testing.assert_allclose(p, m[k] @ v[k], atol=1e-12)
        np.testing.assert_allclose(flow, rest[k], atol=1e-7)


@pytest.mark.parametrize("shape", lawrence_config.MASS_SHAPES)
def test_every_way_to_a_point_mass_runs_on_the_rig(shape, tmp_path):
    pull, back = [130.0, 0.8, 0.0], [-130.0, -0.8, 0.0]
    law = {
        "c1": pull,
        "c4": back,
        "c7": pull,
        "c8": pull,
        "shape": shape,
        "leader_mass": [0.12],
        "follower_mass": [0.08],
        "acceleration_hz": 5.0,
    }
    leader, follower = session(tmp_path, {"controller": {"parameters": law}}, 1.5)
    assert leader.n == 1500
    tips = [Premium(()).tip(r.q) for r in (leader, follower)]
    assert np.abs((tips[0] - tips[0][0]) - (tips[1] - tips[1][0])).max() < 6e-3
    assert np.abs(np.diff(leader.qd[100:], axis=0)).max() < 0.2


def test_a_varying_lossy_link_runs_and_tracks_later(tmp_path):
    errors = []
    for way in ({}, {"delay": 0.004, "jitter": 0.004, "loss": 0.2}):
        law = {"velocity_hz": 30.0, "forward": way, "backward": way}
        runs = session(tmp_path, {"controller": {"parameters": law}}, 1.5)
        tips = [Premium(()).tip(r.q) for r in runs]
        errors.append(np.sqrt(np.mean((tips[0] - tips[0][0] - tips[1] + tips[1][0])[:, :2] ** 2)))
        assert np.abs(np.diff(runs[0].qd[100:], axis=0)).max() < 0.2
    assert 1.2 * errors[0] < errors[1] < 2e-3


FOUR = {
    "c1": (130.0, 0.8, 0.0),
    "c4": (-130.0, -0.8, 0.0),
    "c7": (130.0, 0.8, 0.0),
    "c8": (130.0, 0.8, 0.0),
    "c2": (0.3,),
    "c3": (0.3,),
    "c5": (0.1,),
    "c6": (0.1,),
    "acceleration_hz": 5.0,
}


def test_forces_from_the_motion_are_the_force_sensor_free_form_of_linear_arms():
    """Class II on point masses commands, tick by tick, what the transformed class I does."""
    mass = {
        "shape": "acceleration",
        "leader_mass": (0.1, 0.12, 0.11),
        "follower_mass": (0.06, 0.07, 0.08),
    }
    own = LawrenceConfig(**FOUR, **mass, forces="estimated")
    loops = law_parameters.loops_of(own)
    free = law_parameters.law_table([loop.design for loop in loops])
    other = replace(
        own,
        forces="measured",
        **{k: tuple(v) if isinstance(v, list) else v for k, v in free.items() if k[0] == "c"},
    )
    rng, answers = np.random.default_rng(3), []
    waves = rng.uniform(-0.1, 0.1, (2, 3)), rng.uniform(2, 9, (2, 3))
    for law in (Lawrence(own, ARMS, T), Lawrence(other, ARMS, T)):
        n = len(law.state_names)
        x, following, y, seen = np.zeros(n), np.zeros(n), np.zeros((2, 3)), []
        for k in range(1, 200):
            u = at_home()
            u[:, :3] += waves[0] * np.sin(waves[1] * k * T)
            u[:, 3:6] = waves[0] * waves[1] * np.cos(waves[1] * k * T)
            u[:, 6:9] = rng.normal(size=(2, 3))  # a sensor that must not matter
            law.update(k * T, x, u, following, y)
            x, following = following, x
            seen.append(y.copy())
        answers.append(np.array(seen))
    assert np.abs(answers[0]).max() > 0.05
    np.testing.assert_allclose(answers[0], answers[1], atol=1e-10)


@pytest.mark.slow
def test_forces_from_the_motion_run_on_the_rig_and_are_the_sensors(tmp_path):
    machine = {"kind": "mechanical", "frequency": 0.5, "size": [0.02, 0.02, 0.012]}
    gel = {"below_home": -0.02, "stiffness": 500.0}
    law = {k: list(v) if isinstance(v, tuple) else v for k, v in FOUR.items()}
    law |= {"forces": "estimated", "friction_share": 1.0, **fitted(tmp_path)}
    runs = session(
        tmp_path,
        {"simulation": {"operator": machine, "gel": gel}, "controller": {"parameters": law}},
        5.0,
    )
    topic = read(tmp_path / "s.mcap").topics["/controller/state"]
    values, kept = decode_numbers(topic), np.array(topic.sequence) - 1
    late = kept > 1500
    for run, arm, sign in zip(runs, ARMS, (1.0, -1.0), strict=True):
        at = Lawrence.state_names.index(f"{arm}_estimate_z")
        sensor = sign * run.wrench[kept, 2][late]
        error = values[late, at] - sensor
        assert sensor.std() > 0.1
        assert np.corrcoef(values[late, at], sensor)[0, 1] > 0.97
        assert error.std() < 0.25 * sensor.std()


def fitted(tmp_path):
    """Identified rigid bodies and friction of both arms, as the law takes them."""
    from hil.experiments import transparency
    from hil.teleop import rig_designs

    models = transparency.identified_arms(tmp_path, 1)
    return rig_designs.models(models, load_rig(RIGS / "lawrence.toml"))


def test_forces_from_the_motion_are_refused_where_they_cannot_be():
    with pytest.raises(ConfigError, match="singularity"):
        Lawrence(
            LawrenceConfig(**{**FOUR, "c2": (1.05,), "c3": (1.05,)}, forces="estimated"), ARMS, T
        )
    with pytest.raises(ConfigError, match="without delay"):
        LawrenceConfig(**FOUR, forces="estimated", forward=ChannelConfig(0.002))
    with pytest.raises(ConfigError, match="without a filter"):
        Lawrence(LawrenceConfig(**{**FOUR, "acceleration_hz": 0.0}, forces="estimated"), ARMS, T)


def four_channel(**changes):
    """Parameters of the rig with four channels, see `hil.bench.teleop`."""
    given = dict(load_rig("lawrence").controller.parameters)
    return parse(LawrenceConfig, {**given, **teleop.FOUR_CHANNEL_PARAMETERS, **changes}, "test")


def drag_on_the_rig(folder, law):
    """Force over speed of the leader in free space at 1 Hz [N s/m], as `hil bench teleop`."""
    machine = {"kind": "mechanical", "frequency": 1.0, "size": [0.0, 0.0, 0.008], "onset": 1.0}
    config = teleop.rig_of_law("lawrence", law, machine, None)
    path = folder / "s.mcap"
    runner.run_session(
        config, teleop.SETTLING_S + teleop.MEASURED_PERIODS, 1, "lockstep", path
    ).enabled()
    return teleop.measured_impedances(path)[0].real


@pytest.mark.slow
def test_disturbance_observers_take_friction_away_that_no_model_holds(tmp_path):
    bare, observed = (
        drag_on_the_rig(tmp_path, {**teleop.FOUR_CHANNEL_PARAMETERS, **more})
        for more in ({}, teleop.OBSERVED)
    )
    assert bare > 1.5
    assert abs(observed) < 0.25 * bare


def test_the_gate_knows_the_disturbance_observers():
    rubbing = [
        replace(loop, friction=(2.0, 1.0))
        for loop in law_parameters.loops_of(four_channel(**teleop.OBSERVED))
    ]
    w = 2 * np.pi * np.array([0.3])
    for loop in rubbing:
        with_, without = (
            sampled_loop.hybrid_at(replace(loop, disturbance=d), w, T)[0, 0, 0].real
            for d in (1.0, 0.0)
        )
        assert without > 2.0 and abs(with_) < 0.2 * without
        # a fast observer drives the light rotor before its cable
        assert gate.passes(loop, T)
        assert not gate.passes(replace(loop, observer_hz=20.0), T)


def test_no_disturbance_is_seen_in_a_force_that_is_measured():
    """What the observer finds equals what the sensor says, to the low-pass that both have."""
    law = Lawrence(four_channel(disturbance=1.0, observer_hz=5.0), ARMS, T)
    n = len(law.state_names)
    x, following, y = np.zeros(n), np.zeros(n), np.zeros((2, 3))
    pi = np.array(law.config.leader_model)
    q, v = HOME.copy(), np.zeros(3)
    push = np.array([0.3, -0.2, 0.1])
    u = np.zeros((2, 12))
    for k in range(1, 60):
        u[0, :3], u[0, 3:6], u[0, 6:9] = q, v, push
        u[1, :3] = HOME
        law.update(k * T, x, u, following, y)
        x, following = following, x
        a, _ = accelerated(q, v, y[0], push, pi)
        q, v = q + T * v, v + T * a
    at = law.state_names.index("leader_observed_x")
    found, sensed = x[at : at + 3], x[at + 3 : at + 6]
    assert np.abs(sensed).max() > 0.2
    np.testing.assert_allclose(found, sensed, atol=0.02)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"disturbance": 1.5}, "disturbance = 1.5; a share"),
        ({"disturbance": 1.0, "observer_hz": 0.0}, "observer_hz above 0"),
        ({"disturbance": 1.0, "forces": "estimated"}, "beyond the measured force"),
    ],
)
def test_a_disturbance_needs_a_sensor_and_an_observer(change, said):
    with pytest.raises(ConfigError, match=said):
        config(**change)
