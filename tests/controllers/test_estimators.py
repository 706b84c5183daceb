"""Estimators in the 1 kHz loop on the simulated rig, recorded, replayed, in a sensor's place."""

import re
import textwrap
import tomllib
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.controllers.estimators import forces, network, transmission, wavelets
from hil.controllers.estimators.transmission import TRANSMISSION_COLUMNS, TransmissionConfig
from hil.controllers.lawrence_config import PREMIUM
from hil.errors import ConfigError
from hil.estimate import elastic_ukf
from hil.estimate.elastic_ukf import UKF_DTYPE, ElasticUkf, UkfConfig
from hil.experiments import elastic_transmission
from hil.record.container import read
from hil.record.mcap_read import load
from hil.record.schema import decode_numbers
from hil.rig import estimators
from hil.rig.config import load_rig
from hil.rig.open import open_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.runtime.board import Ring
from hil.runtime.clock import VirtualClock
from hil.runtime.loop import Loop
from hil.runtime.replay import replay
from hil.toml import parse

MODEL = load_rig(rig_path("lawrence")).controller.parameters["follower_model"]
NETS = {"gain": 0.02}
KINDS = {
    "observer": {"name": "force"},
    "inverse": {"name": "force", "parameters": {"method": "inverse-dynamics"}},
    "network": {"name": "friction-network", "parameters": {"network": NETS}},
    "filters": {"name": "elastic-ukf"},
    "both": {"name": "elastic-ukf", "parameters": {"network": {"nodes": 60, "backbone": False}}},
}


def table(*names, **more):
    return {
        n: {
            "arm": "follower",
            **KINDS[n],
            **more,
            "parameters": {"model": MODEL, **KINDS[n].get("parameters", {})},
        }
        for n in names
    }


def test_the_tables_of_the_documentation_are_taken():
    text = (Path(__file__).parents[2] / "docs" / "teleoperation.md").read_text(encoding="utf-8")
    blocks = re.findall(r"(?:^    .*\n)+", text, re.M)
    shown = "".join(b for b in blocks if "[estimators." in b).replace("[...]", str(list(MODEL)))
    tables = tomllib.loads(textwrap.dedent(shown))["estimators"]
    assert tables["push"]["parameters"]["method"] == "inverse-dynamics"
    assert "model" not in tables["push"]["parameters"]
    open_rig(rig(tables), 0).close()
    for kind in (forces.ForcesConfig, network.NetworkConfig, TransmissionConfig):
        assert kind().model == PREMIUM  # as the page says: neither arm's own


def rig(estimators, **simulation):
    hand = {"kind": "hand", "frequency": 0.5, "size": [0.05, 0.05, 0.05]}
    over = {"operator": hand, "gel": {"below_home": 0.01}, **simulation}
    return load_rig(rig_path("lawrence"), {"estimators": estimators, "simulation": over})


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Ten seconds with all estimators: the hand moves freely and touches the gel."""
    path = tmp_path_factory.mktemp("estimators") / "s.mcap"
    runner.run_session(rig(table(*KINDS)), 10.0, 2, "lockstep", path)
    return path


@pytest.mark.slow
def test_every_estimator_is_a_channel_at_every_tick_and_replays(session):
    box = read(session)
    for name in KINDS:
        assert len(box.topics[f"/estimate/{name}"].times) == 10_000
        assert np.isfinite(decode_numbers(box.topics[f"/estimate/{name}"])).all()
    again = replay(session)
    assert again.compared == 10_000 and again.differ == 0


def test_the_forces_are_those_of_the_sensor(session):
    """After five seconds: what learns knows the friction, what does not keeps it as an error."""
    box, run = read(session), load(session, "follower")
    free = np.abs(run.wrench[:, :3]).max(axis=1) < 0.05
    free[:5000] = False
    rms = {}
    for name in KINDS:
        force = decode_numbers(box.topics[f"/estimate/{name}"])[:, :3]
        rms[name] = np.sqrt(np.mean((force - run.wrench[:, :3])[free] ** 2))
        touch = ~free & (np.arange(10_000) > 5000)
        late = np.convolve(run.wrench[:, 2], np.exp(-np.arange(200) / 16) / 16.5)[:10_000]
        assert np.corrcoef(force[touch, 2], late[touch])[0, 1] > 0.97
    assert 0.03 < rms["observer"] < 0.1
    assert abs(rms["inverse"] / rms["observer"] - 1) < 0.05
    for name in ("network", "filters", "both"):
        assert rms[name] < 0.4 * rms["observer"]


def test_the_filters_see_the_cables(session):
    values = decode_numbers(read(session).topics["/estimate/filters"])
    found = dict(zip(TRANSMISSION_COLUMNS, values[-1], strict=True))
    # data sheet: 3.5 N/mm at 0.2 m is 140 N m/rad
    for j in (1, 2, 3):
        assert 90 < found[f"stiffness{j}"] < 260
    run = load(session, "follower")
    names = TRANSMISSION_COLUMNS
    cable = values[5000:, [names.index(f"cable{j}") for j in (1, 2, 3)]]
    assert np.corrcoef(cable[:, 0], run.tau[5000:, 0])[0, 1] > 0.8


def test_a_law_runs_on_an_estimate_instead_of_its_sensor(tmp_path):
    """The operator feels the gel through the observer; the law never sees the sensor."""
    fed = rig(table("network", replaces_force=True), gel={"below_home": -0.002})
    path = tmp_path / "s.mcap"
    runner.run_session(fed, 5.0, 3, "lockstep", path)
    leader, follower = load(path, "leader"), load(path, "follower")
    touch = follower.wrench[:, 2] > 0.1
    assert touch.sum() > 200
    assert np.corrcoef(leader.wrench[touch, 2], follower.wrench[touch, 2])[0, 1] < -0.3
    assert np.abs(np.diff(leader.qd[100:], axis=0)).max() < 0.6
    at = estimators.bare_law(open_law(fed)).state_names.index("follower_force_z")
    box = read(path)
    law = decode_numbers(box.topics["/controller/state"])
    kept = np.array(box.topics["/controller/state"].sequence) - 1
    estimate = decode_numbers(box.topics["/estimate/network"])[kept, 2]
    # the law's filtered force follows the estimate (f_s = -F), with nothing of the sensor's noise
    assert np.corrcoef(-law[50:, at], estimate[50:])[0, 1] > 0.99


def open_law(config):
    from hil.rig.open import build_controller

    return build_controller(config)


def test_an_operator_commands_a_session_with_estimators(tmp_path):
    """Other parameters, a pause, another law: estimates stay in their columns, and all replays."""
    fed = rig(table("network", replaces_force=True), gel={"below_home": 1.0})
    orders = ((0.4, "set friction_share 0.5"), (0.8, "pause"), (0.9, "resume"), (1.4, "home"))
    path = tmp_path / "s.mcap"
    summary = runner.run_session(
        fed, 2.0, 1, "lockstep", path, operator=runner.Operator(schedule=orders)
    )
    assert summary.state == "ENABLED"
    again = replay(path)
    assert again.compared == 2000 and again.differ == 0
    values = decode_numbers(read(path).topics["/estimate/network"])
    at = network.NETWORK_COLUMNS.index("nodes")
    assert np.isfinite(values).all() and set(np.unique(values[:, at - 1])) <= {0.0, 1.0}
    assert (
        values[798, at] >= 1.0 and values[902, at] >= values[798, at]
    )  # what was learnt survived the pause


def test_an_estimate_that_lags_too_much_is_refused():
    slow = table("observer", replaces_force=True)
    slow["observer"]["parameters"]["corner_hz"] = 0.5
    given = {"c5": [2.0]}
    over = {"controller": {"parameters": given}, "estimators": slow}
    with pytest.raises(ConfigError, match=r"axis x.*unstable, a pole at"):
        open_law(load_rig(rig_path("lawrence"), over))
    open_law(load_rig(rig_path("lawrence"), {"controller": {"parameters": given}}))


def test_design_judges_a_law_with_the_estimate_that_feeds_it(tmp_path, capsys):
    text = rig_path("lawrence").read_text(encoding="utf-8")
    for corner, code in ((0.5, 2), (10.0, 0)):
        own = tmp_path / "own.toml"
        own.write_text(
            f"""{text}
[estimators.grip]
name = "force"
arm = "follower"
replaces_force = true
[estimators.grip.parameters]
corner_hz = {corner}
""".replace("c2 = [0.5] ", "c2 = [0.5]\nc5 = [2.0] "),
            encoding="utf-8",
        )
        assert main(["design", str(own)]) == code
        assert ("REFUSED" in capsys.readouterr().out) == (code == 2)


def test_two_in_one_place_and_unknown_ones_are_refused():
    twice = table("observer", "network", replaces_force=True)
    with pytest.raises(ConfigError, match="replaces the force of arm 'follower' already"):
        open_law(rig(twice))
    wrong = {"a": {"name": "forse", "arm": "follower"}}
    with pytest.raises(ConfigError, match="Did you mean 'force'"):
        open_law(rig(wrong))
    with pytest.raises(ConfigError, match="arm of an estimator"):
        rig({"a": {"name": "force", "arm": "folower"}})


@pytest.mark.parametrize("kind", [forces, network, transmission])
def test_an_estimator_is_pure(kind):
    rng = np.random.default_rng(0)
    made = kind.build(parse(kind.Config, {"model": MODEL}, "test"), 1e-3)
    u, sent = rng.uniform(-0.3, 0.3, 12), rng.uniform(-0.1, 0.1, 3)
    past, now = np.zeros(made.memory), np.zeros(made.memory)
    out = np.zeros(len(made.names))
    for k in range(5):
        made.update(2 if k else 0, past, u + 1e-4 * k, sent, now, out)
        past, now = now, past
    kept, answers = past.copy(), []
    for _ in range(2):
        now, out = np.full(made.memory, np.nan), np.full(len(made.names), np.nan)
        made.update(2, past, u, sent, now, out)
        answers.append((now, out))
    np.testing.assert_array_equal(past, kept)
    for a, b in zip(*answers, strict=True):
        assert np.isfinite(a).all()
        np.testing.assert_array_equal(a, b)


def test_estimators_keep_no_memory_in_the_hot_path(memory_growth):
    config = rig(table(*KINDS))
    opened = open_rig(config, 0)
    layout = estimators.layout(2, 3, opened.controller)
    ring = Ring(100, layout.width)
    loop = Loop(
        opened.ports,
        opened.controller,
        VirtualClock(1_000_000),
        ring,
        layout,
        1_000_000,
        opened.origin_ns,
    )
    loop.rehearse()
    opened.enable()
    grown = memory_growth(loop.step)
    opened.close()
    assert grown < 2000


def test_predict_then_correct_is_the_filter_that_agrees_with_filterpy():
    plant = elastic_transmission.TwoMassPlant()
    run = elastic_transmission.record_arm(plant, 0.3, 1)
    known = ElasticUkf(UkfConfig(), float(run.y[0]))
    other = ElasticUkf(UkfConfig(), float(run.y[0]))
    f = other._f
    elastic_ukf.correct(f["x"], f["p"], run.y[0], float(f["variance"]), f["gain"])
    f = np.array([f], UKF_DTYPE)[0]
    known.step(run.y[0], run.u[0], 1e-3)
    for k in range(1, 300):
        assert elastic_ukf.foresee(f, run.u[k - 1], 1e-3, 1)
        elastic_ukf.correct(f["x"], f["p"], run.y[k], float(f["variance"]), f["gain"])
        known.step(run.y[k], run.u[k], 1e-3)
        np.testing.assert_allclose(f["x"], known.state, rtol=1e-9, atol=1e-12)


def taught(nodes, seconds=30):
    """Networks after some seconds of friction of two speeds, their error in the last four [N m]."""
    config = network.WaveletConfig(nodes=nodes, gain=0.5, zone=1e-4, soft=0.05, dwell=0.2)
    c, m = config.record(1.0, 1e-3), np.zeros(wavelets.memory_size(nodes))
    wavelets.clear(m)
    psi, now, seen, errors = np.zeros(6 + nodes), np.zeros(3), np.zeros(3), []
    for v in ways(seconds * 1000):
        target = 0.01 * np.tanh(v / 0.05) + 0.006 * np.tanh((v + np.roll(v, 1)) / 0.3)
        wavelets.predict_network(v, c, m, psi, now, seen)
        errors.append(target - now)
        wavelets.learn_weights(target, seen, c, m)
        if nodes:
            wavelets.adapt_structure(v, c, m)
    return c, m, np.sqrt(np.mean(np.square(errors[-4000:])))


def ways(n):
    """Speeds of three joints, n ticks."""
    rng = np.random.default_rng(4)
    w, phase = rng.uniform(1, 9, (3, 4)), rng.uniform(0, 6.28, (3, 4))
    for k in range(n):
        yield 0.4 * np.sin(w * k * 1e-3 + phase).sum(1)


@pytest.mark.slow
def test_the_networks_learn_what_coulomb_and_viscous_friction_cannot():
    """On line, from an empty structure; and over it the distance of the weights never grows."""
    _, _, plain = taught(0)
    c, m, with_it = taught(120)
    assert with_it < 0.5 * plain
    assert 5 < network.count(m) <= 120
    psi, now, seen = np.zeros(126), np.zeros(3), np.zeros(3)
    # a target within the span of the structure: the distance of the weights to it never grows
    goal = m.copy()
    nodes = [
        at + 7 + j
        for at in range(wavelets.HEAD_NUMBERS, m.size, wavelets.NODE)
        if m[at] != wavelets.NONE
        for j in range(3)
    ] + list(range(6))
    m[nodes] = 0.0
    distance = np.inf
    for v in ways(2000):
        wavelets.predict_network(v, c, goal, psi, now, seen)
        target = seen.copy()
        wavelets.predict_network(v, c, m, psi, now, seen)
        wavelets.learn_weights(target, seen, c, m)
        gap = float(np.sum((goal[nodes] - m[nodes]) ** 2))
        assert gap <= distance * (1 + 1e-9)
        distance = gap


@pytest.mark.parametrize(
    "wrong",
    [
        {"corner_hz": float("nan")},
        {"model": (float("nan"),) * 8},
        {"model": (0.0,) * 8},
        {"lengths": (0.0, 0.2)},
        {"span": (float("inf"),) * 6},
    ],
)
def test_settings_of_a_force_estimator_are_numbers_of_an_arm(wrong):
    with pytest.raises(ConfigError, match=r"must be finite, lengths positive|must be positive"):
        forces.ForcesConfig(**wrong)
