"""The law over a channel with delay: energy is never made, places agree in the end, walls push."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.bench import teleop
from hil.cli import main
from hil.controllers import delayed as k
from hil.controllers import dynamics, fixtures
from hil.controllers.delayed import SCHEMES, Delayed, DelayedConfig, WallConfig
from hil.controllers.fixtures import FixtureConfig
from hil.controllers.lawrence_config import ChannelConfig
from hil.errors import ConfigError
from hil.record.mcap_read import load
from hil.rig.config import ControllerConfig, load_rig
from hil.runtime import runner
from hil.runtime.replay import replay
from hil.runtime.session import plain, to_toml

T, HOME = 1e-3, np.array([0.0, 0.4, 0.3])


class Arms:
    """Two arms that are led along paths, or follow the law as point masses in their joints."""

    def __init__(self, law, inertia=2e-3, rub=0.02):
        self.law, self.inertia, self.rub = law, inertia, rub
        self.u, self.tick = np.zeros((2, 12)), 0
        self.u[:, :3] = HOME
        self.x, self.y = np.zeros(len(law.state_names)), np.zeros((2, 3))

    def step(self, leader, push=None):
        self.tick += 1
        self.u[0, 3:6] = (HOME + leader - self.u[0, :3]) / T
        self.u[0, :3] = HOME + leader
        x_next = np.zeros_like(self.x)
        self.law.update(self.tick * T, self.x, self.u, x_next, self.y)
        self.x = x_next
        torque = self.y[1] - self.law._w["gravity"][1] - self.rub * self.u[1, 3:6]
        if push is not None:
            torque = torque + push(self.u[1])
        self.u[1, 3:6] += T * torque / self.inertia
        self.u[1, :3] += T * self.u[1, 3:6]
        return self.x[k.HEAD :].reshape(2, 3, k.FIELDS)


links = st.builds(
    ChannelConfig,
    delay=st.sampled_from([0.0, 0.01, 0.1]),
    jitter=st.sampled_from([0.0, 0.02]),
    loss=st.sampled_from([0.0, 0.3]),
)


def paths(seed, n):
    rng = np.random.default_rng(seed)
    t = np.arange(n) * T
    waves = rng.uniform(0.5, 3.0, (3, 3)), rng.uniform(0, 6, (3, 3)), rng.uniform(0, 0.06, (3, 3))
    ramp = np.minimum(t / 0.3, 1.0)
    return np.column_stack(
        [
            ramp * sum(a * np.sin(2 * np.pi * f * t + p) for f, p, a in zip(*w, strict=True))
            for w in zip(*waves, strict=True)
        ]
    )


@settings(max_examples=15, deadline=None)
@given(link=links, seed=st.integers(0, 1000))
def test_waves_give_out_no_more_energy_than_was_put_in(link, seed):
    arms = Arms(Delayed(DelayedConfig("waves", forward=link, backward=link, seed=seed), "lf", T))
    for leader in paths(seed, 600):
        f = arms.step(leader)
        for a in range(2):
            used, sent = f[a, :, k.USED_POWER], f[1 - a, :, k.SENT_POWER]
            assert np.all(used <= sent * (1 + 1e-9) + 1e-12)


@settings(max_examples=15, deadline=None)
@given(link=links, seed=st.integers(0, 1000))
def test_the_observer_lets_out_no_more_than_came_in_and_its_reserve(link, seed):
    config = DelayedConfig("passivity", forward=link, backward=link, seed=seed)
    arms = Arms(Delayed(config, "lf", T))
    for leader in paths(seed, 600):
        f = arms.step(leader)
        # of the follower's side, whose port is the law's own
        assert np.all(f[1, :, k.OUT] <= f[0, :, k.INTO] + 1.02 * config.reserve)


@settings(max_examples=15, deadline=None)
@given(link=links, seed=st.integers(0, 1000))
def test_tanks_hold_no_more_than_they_should_and_share_what_they_send(link, seed):
    config = DelayedConfig("tanks", forward=link, backward=link, seed=seed)
    arms = Arms(Delayed(config, "lf", T))
    for leader in paths(seed, 600):
        f = arms.step(leader)
        assert np.all(f[:, :, k.TANK] <= config.level * (1 + 1e-12))
        for a in range(2):
            assert np.all(f[a, :, k.USED] <= f[1 - a, :, k.SENT] + 1e-15)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_follower_comes_to_the_leaders_place_whatever_was_lost(scheme):
    link = ChannelConfig(0.05, 0.02, 0.3)
    arms = Arms(Delayed(DelayedConfig(scheme, forward=link, backward=link), "lf", T))
    end = np.array([0.1, 0.05, -0.08])
    for n in range(4000):
        arms.step(end * min(n / 500, 1.0))
    tip = np.zeros((2, 3))
    for a in range(2):
        dynamics.forward_kinematics(arms.u[a], np.array(dynamics.LINK_LENGTHS), tip[a])
    assert np.linalg.norm(tip[1] - tip[0]) < 2e-3


def test_the_model_learns_what_the_follower_presses_into():
    config = DelayedConfig("model", forward=ChannelConfig(0.1), backward=ChannelConfig(0.1))
    arms = Arms(Delayed(config, "lf", T))
    lengths, start = np.array(dynamics.LINK_LENGTHS), np.zeros(3)
    dynamics.forward_kinematics(HOME, lengths, start)

    def gel(u):
        tip, jacobian = np.zeros(3), np.zeros((3, 3))
        dynamics.forward_kinematics(u, lengths, tip)
        dynamics.jacobian(u, lengths, jacobian)
        u[6:9] = 0.0
        u[8] = 300.0 * max(start[2] - 0.004 - tip[2], 0.0)
        return jacobian.T @ u[6:9]

    for n in range(4000):
        # down and up at 1 Hz
        f = arms.step(np.array([0.0, -0.04 * (1 - np.cos(2 * np.pi * n * T)), 0.0]), gel)
    assert f[1, 2, k.STIFFNESS] == pytest.approx(300.0, rel=0.02)
    assert f[0, 2, k.STIFFNESS] == pytest.approx(300.0, rel=0.05)
    assert f[0, 2, k.PUSH] == pytest.approx(-0.004, abs=3e-4)
    # nothing else was touched
    assert np.all(f[:, :2, k.STIFFNESS] == 0.0)


def test_after_a_pause_nothing_of_before_is_heard():
    link = ChannelConfig(0.05)
    arms = Arms(Delayed(DelayedConfig("waves", forward=link, backward=link), "lf", T))
    for leader in paths(1, 300):
        arms.step(leader)
    arms.x[:] = 0.0  # the loop sets the state back
    arms.u[1, 3:6] = 0.0
    leader = arms.u[0, :3] - HOME
    for _ in range(200):
        f = arms.step(leader)
        assert np.abs(f[:, :, k.FORCE]).max() < 0.05


def test_a_wall_pushes_along_its_normal_and_never_pulls():
    wall = WallConfig((0.0, 0.0, 2.0), 0.002, 500.0, 5.0 / 10)
    law = Delayed(DelayedConfig("model", wall=wall, leader_gravity=(0.0, 0.0)), "lf", T)
    arms = Arms(law)
    arms.step(np.zeros(3))
    heights = []
    for n in range(200):
        arms.step(np.array([0.0, -8e-4 * n if n < 100 else -8e-4 * (200 - n), 0.0]))
        tip, jacobian = np.zeros(3), np.zeros((3, 3))
        dynamics.forward_kinematics(arms.u[0], np.array(dynamics.LINK_LENGTHS), tip)
        dynamics.jacobian(arms.u[0], np.array(dynamics.LINK_LENGTHS), jacobian)
        torque = arms.y[0] + law.config.leader_damping * arms.u[0, 3:6]
        heights.append((tip[2], np.linalg.solve(jacobian.T, torque)[2]))
    z, force = np.array(heights).T
    depth = z[0] - 0.002 - z
    assert np.all(force[depth < -1e-4] == pytest.approx(0.0, abs=1e-9))
    assert np.all(force >= -1e-9)
    deep = force[depth > 0.008]
    assert deep.size and np.all(deep > 0.8 * 500.0 * 0.008)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"scheme": "wave"}, "Did you mean 'waves'"),
        ({"stiffness": 0.0}, "stiffness = 0; above 0"),
        ({"reserve": float("nan")}, "reserve = nan"),
        ({"forget": 1.5}, "within 0.9 and 1"),
        ({"wall": WallConfig((0.0, 0.0, 0.0))}, "a direction"),
    ],
)
def test_what_cannot_be_is_refused(change, said):
    with pytest.raises(ConfigError, match=said):
        DelayedConfig(**change)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"damping": 4.0}, "stiffness and damping ask for"),
        ({"scheme": "waves", "wave": 5.0}, "wave, the leader's damper"),
        ({"wall": WallConfig(stiffness=8000.0)}, "wall.stiffness"),
        ({"level": 1.0}, "fill level"),
    ],
)
def test_what_no_period_of_a_millisecond_can_render_is_refused(change, said):
    with pytest.raises(ConfigError, match=said):
        Delayed(DelayedConfig(**change), ("leader", "follower"), T)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_hand_presses_into_a_gel_over_a_tenth_of_a_second(scheme, tmp_path):
    way = {"delay": 0.1, "jitter": 0.02, "loss": 0.1}
    law = {"scheme": scheme, "forward": way, "backward": way}
    config = teleop.rig_of_law("delayed", law, {"kind": "hand", "arm": "leader"}, 400.0)
    path = tmp_path / "s.mcap"
    done = runner.run_session(config, 2.0, 1, "lockstep", path)
    assert done.state == "ENABLED"
    found = replay(path)
    assert (found.compared, found.differ) == (done.ticks, 0)


@pytest.mark.slow
def test_model_mediated_feels_the_gel_that_is_there(tmp_path):
    found = teleop.measured_row(
        *teleop.COMPARED_LAWS[-1], teleop.CommunicationLink(0.1), tmp_path, 1
    )
    assert found.share == pytest.approx(1.0, abs=0.1)
    refused = teleop.measured_row(
        *teleop.COMPARED_LAWS[0], teleop.CommunicationLink(0.1), tmp_path, 1
    )
    assert refused.why == "refused: not stable"


def test_a_law_for_two_arms():
    with pytest.raises(ConfigError, match="not 1 arms"):
        Delayed(DelayedConfig(), ("leader",), T)
    config = load_rig("lawrence")
    law = ControllerConfig("delayed", config.controller.arms, {"scheme": "tank"})
    with pytest.raises(ConfigError, match="Did you mean 'tanks'"):
        runner.run_session(
            dataclasses.replace(config, controller=law), 0.1, 0, "lockstep", "never.mcap"
        )


# --- virtual fixtures ------------------------------------------------------------------------

KINDS = {
    "wall": FixtureConfig("wall", (0.0, 0.0, -0.01), (0.0, 0.0, 2.0)),
    "ball": FixtureConfig("ball", (0.01, 0.0, 0.0), radius=0.005),
    "line": FixtureConfig("line", (0.0, 0.0, 0.001), (0.0, 1.0, 0.0)),
    "plane": FixtureConfig("plane", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), radius=0.002),
}


def pushed(fixture, x, v=(0.0, 0.0, 0.0)):
    force = np.zeros(3)
    where = np.asarray(x, float), np.asarray(v, float)
    fixtures.fixture_force(fixtures.fixture_records([fixture]), *where, np.zeros(3), force)
    return force


@pytest.mark.parametrize(
    ("kind", "x", "depth", "out"),
    [
        ("wall", (0.3, 0.2, -0.013), 0.003, (0, 0, 1)),
        ("wall", (0.3, 0.2, -0.009), 0.0, (0, 0, 1)),
        ("ball", (0.013, 0.0, 0.0), 0.002, (1, 0, 0)),
        ("ball", (0.0, 0.0, 0.0), 0.0, (-1, 0, 0)),
        ("line", (0.0, 5.0, 0.004), 0.003, (0, 0, -1)),
        ("line", (0.0, 5.0, 0.001), 0.0, (0, 0, -1)),
        ("plane", (0.005, 1.0, 1.0), 0.003, (-1, 0, 0)),
        ("plane", (-0.001, 1.0, 1.0), 0.0, (1, 0, 0)),
    ],
)
def test_a_fixture_pushes_out_of_what_is_forbidden(kind, x, depth, out):
    wanted = 400.0 * depth * np.array(out, float)
    np.testing.assert_allclose(pushed(KINDS[kind], x), wanted, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fixture_never_pulls_and_gives_out_no_more_than_its_spring_holds(kind):
    rng = np.random.default_rng(1)
    w, phase = 2 * np.pi * rng.uniform(0.5, 2.0, 3), rng.uniform(0.0, 6.0, 3)
    t = np.arange(0.0, 20.0, 1e-3)
    x = 0.02 * np.sin(t[:, None] * w + phase)
    v = 0.02 * w * np.cos(t[:, None] * w + phase)
    f, n, work, least = KINDS[kind], np.zeros(3), 0.0, 0.0
    numbers = f.numbers()
    first = max(fixtures.off(numbers, x[0], n), 0.0)
    for a, b in zip(x, v, strict=True):
        depth = fixtures.off(numbers, a, n)
        force = pushed(f, a, b)
        assert force @ n >= -1e-12 and (depth > 0.0 or not force.any())
        work += float(force @ b) * 1e-3
        least = max(least, work)
    # what it has given back is at most what was stored in it when this began
    assert least <= 0.5 * f.stiffness * first**2 + 1e-4
    assert work < -1e-3


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"kind": "bal"}, "Did you mean 'ball'"),
        ({"direction": (0.0, 0.0, 0.0)}, "a direction is needed"),
        ({"kind": "ball"}, "radius = 0 forbids nothing"),
        ({"stiffness": -1.0}, "must not be negative"),
        ({"place": (0.0, float("nan"), 0.0)}, "must be finite"),
    ],
)
def test_a_fixture_that_cannot_be_is_refused(words, said):
    with pytest.raises(ConfigError, match=said):
        FixtureConfig(**words)


@pytest.mark.slow
def test_fixtures_guide_a_hand_and_its_follower(tmp_path):
    for row in teleop.fixture_rows(tmp_path, laws=teleop.GUIDED[:1]):
        assert row.state == "ENABLED", row
        assert max(row.guided) < 0.6 * min(row.without), row


@pytest.mark.slow
def test_a_fixture_that_the_rig_cannot_render_is_refused_before_the_start(tmp_path, capsys):
    hard = [{"kind": "wall", "place": [0.0, 0.0, -0.01], "stiffness": 9000.0, "damping": 0.5}]
    with pytest.raises(ConfigError, match="fixture wall ask for"):
        Delayed(DelayedConfig(fixtures=(FixtureConfig(**hard[0]),)), ("leader", "follower"), T)
    config = load_rig("lawrence", {"controller": {"parameters": {"fixtures": hard}}})
    rig = tmp_path / "rig.toml"
    rig.write_text(to_toml(plain(config)))
    assert main(["design", str(rig)]) == 2
    assert "in the virtual fixtures" in capsys.readouterr().err
    rig.write_text(rig.read_text().replace("9000.0", "400.0"))
    assert main(["design", str(rig), "-o", str(tmp_path / "own.toml")]) == 0
    law = load_rig(tmp_path / "own.toml").controller.parameters
    assert law["fixtures"][0]["stiffness"] == 400.0
    words = ["--seconds", "0.1", "-o", str(tmp_path / "s.mcap")]
    assert main(["run", str(tmp_path / "own.toml"), *words]) == 0


@pytest.mark.parametrize("delay", [0.0, 0.001])
def test_waves_meet_a_gel_calmly_however_short_the_channel(delay, tmp_path):
    """Given out at once, they rang from tick to tick on a channel without delay, up to a FAULT."""
    way = {"delay": delay, "jitter": 0.0, "loss": 0.0}
    machine = {"kind": "mechanical", "frequency": 1.0, "size": [0.0, 0.0, 0.008], "onset": 1.0}
    law = {"scheme": "waves", "forward": way, "backward": way}
    config = teleop.rig_of_law("delayed", law, machine, 400.0)
    assert runner.run_session(config, 1.5, 1, "lockstep", tmp_path / "s.mcap").state == "ENABLED"


@pytest.mark.parametrize(
    ("scheme", "delay", "seconds"),
    [("passivity", 0.005, 5.0), ("passivity", 0.025, 7.5), ("tanks", 0.002, 7.0)],
)
def test_a_stiff_drive_does_not_shake_in_contact(scheme, delay, seconds, tmp_path):
    """Three ways to ring: the damper's force round the channel at the cables' resonance; a tank
    that fades as a spring of 10 kN/m; a goal that makes up millimetres of drift in one tick."""
    way = {"delay": delay, "jitter": 0.0, "loss": 0.0}
    law = {"scheme": scheme, "stiffness": 500.0, "forward": way, "backward": way}
    over = {"simulation": {"gel": {"arm": "follower", "below_home": 0.005, "stiffness": 900.0}}}
    config = dataclasses.replace(
        load_rig("lawrence", over),
        controller=ControllerConfig("delayed", ("leader", "follower"), law),
    )
    runner.run_session(config, seconds, 0, "lockstep", tmp_path / "s.mcap")
    for arm in ("leader", "follower"):
        found = load(tmp_path / "s.mcap", arm)
        assert np.abs(found.tau).max() < 0.75 and np.abs(found.qd).max() < 1.5


def test_a_force_that_would_ring_round_the_channel_is_refused_with_what_would_not():
    config = DelayedConfig("passivity", stiffness=2000.0)
    with pytest.raises(ConfigError, match=r"ring between leader and follower.*stiffness = ") as e:
        Delayed(config, "lf", T)
    nearest = float(str(e.value).rpartition("= ")[2])
    assert 500.0 < nearest < 2000.0
    Delayed(dataclasses.replace(config, stiffness=nearest), "lf", T)
    # no force goes round, and a share of it less so
    Delayed(dataclasses.replace(config, scheme="model"), "lf", T)
    Delayed(dataclasses.replace(config, force_scale=0.1), "lf", T)
