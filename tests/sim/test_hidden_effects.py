"""Hidden effects: each changes the torque that the same motion needs; none leaks."""

import zlib
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from hil.errors import ConfigError
from hil.record.mcap_read import load
from hil.rig.config import load_rig
from hil.runtime.runner import run_session
from hil.sim_devices.plants.build import HIDDEN_KINDS, RANDOM, draw_hidden

RIGS = Path(__file__).parents[2] / "rigs"


def recording(tmp_path, hidden, seconds=1.2, **simulation):
    over = {"simulation": {"hidden": hidden, **simulation}}
    path = tmp_path / "s.mcap"
    run_session(load_rig(RIGS / "identify.toml", over), seconds, seed=4, output=path)
    return load(path, "follower")


@pytest.fixture(scope="module")
def nominal(tmp_path_factory):
    return recording(tmp_path_factory.mktemp("nominal"), [])


@pytest.mark.parametrize("effect", sorted(HIDDEN_KINDS))
def test_each_effect_changes_the_session(effect, nominal, tmp_path):
    row = {"effect": effect, "joint": "all", "amplitude": 1.0 if effect == "delay" else 2.0}
    if effect == "end-stop":
        row["stop_at"] = 0.0
    changed = recording(tmp_path, [row])
    difference = np.sqrt(((changed.tau - nominal.tau) ** 2).mean(0)).max()
    assert difference > 5e-4


def test_amplitude_zero_changes_nothing(nominal, tmp_path):
    same = recording(tmp_path, [{"effect": "stribeck", "joint": "joint2", "amplitude": 0.0}])
    np.testing.assert_array_equal(same.q, nominal.q)


def test_random_depends_on_its_seed_alone():
    rows = [{"effect": "random"}]
    picks = [draw_hidden(rows, ["leader", "follower"], seed)[0] for seed in range(40)]
    assert picks[3] == draw_hidden(rows, ["leader", "follower"], 3)[0]
    assert {row["arm"] for row in picks} == {"follower"}
    assert len({row["effect"] for row in picks}) > len(RANDOM) / 2
    assert len({row["joint"] for row in picks}) == 3


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ({"effect": "stribek"}, "Did you mean 'stribeck'"),
        ({"effect": "spring", "joint": "joint9"}, "Did you mean"),
        ({"effect": "spring", "arm": "folower"}, "Did you mean 'follower'"),
        ({"effect": "spring", "stifness": 1.0}, "unknown key 'stifness'"),
        ({"effect": "coupled-friction", "joint": "joint1", "by": "joint1"}, "another joint"),
    ],
)
def test_mistakes_are_named(row, says, tmp_path):
    with pytest.raises(ConfigError, match=says):
        recording(tmp_path, [row], seconds=0.01)


def _text(data):
    """An attached file, or its packed copy."""
    return (zlib.decompress(data) if data[:1] == b"\x78" else data).decode()


def test_the_session_does_not_betray_the_truth(tmp_path):
    path = tmp_path / "s.mcap"
    over = {"simulation": {"hidden": [{"effect": "stribeck", "joint": "joint2"}]}}
    run_session(load_rig(RIGS / "identify.toml", over), 0.05, seed=1, output=path)
    with path.open("rb") as file:
        reader = make_reader(file)
        texts = [str(m.metadata) for m in reader.iter_metadata()]
        texts += [_text(a.data) for a in reader.iter_attachments()]
    assert texts
    for text in texts:
        assert "stribeck" not in text
        assert "[simulation" not in text
