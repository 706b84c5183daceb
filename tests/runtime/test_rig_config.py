"""Rig files: mistakes are one sentence that names the nearest right thing."""

import re
import tomllib
from pathlib import Path

import pytest

from hil.cli import main
from hil.controllers.joint_tracking import JointTrackingConfig
from hil.errors import ConfigError
from hil.rig.config import BACKENDS, load_rig
from hil.rig.open import build_controller
from hil.runtime.session import rig_text, to_toml
from hil.toml import merge

RIGS = Path(__file__).parents[2] / "rigs"


@pytest.mark.parametrize(
    ("over", "says"),
    [
        ({"lop": {}}, "unknown key 'lop'. Did you mean 'loop'"),
        ({"loop": {"rate": 1000}}, "unknown key 'rate'. Did you mean 'rate_hz'"),
        ({"loop": {"rate_hz": "fast"}}, "should be of type float"),
        ({"loop": {"rate_hz": -1}}, "0 < slow_hz <= rate_hz"),
        ({"loop": {"seconds": 0}}, "must be positive"),
        ({"loop": {"clock": "lockstp"}}, "Did you mean 'lockstep'"),
        ({"loop": 3}, "a table is needed"),
        ({"backend": "usbb"}, "Did you mean 'usb'"),
        ({"schema": "hil.rig/9"}, "this version reads 'hil.rig/1'"),
        ({"devices": {"leader-arm": {"arm": "leeder"}}}, "Did you mean 'leader'"),
        ({"devices": {"new": {"arm": "leader"}}}, "the key 'driver' is missing"),
        ({"arms": {"leader": {"torque_limit": [1.0]}}}, "three entries"),
        ({"arms": {"leader": {"torque_limit": [1.0, 1.0, 0.0]}}}, "must be positive"),
        ({"controller": {"arms": ["leader", "x"]}}, "unknown arm"),
        ({"controller": {"arms": "leader"}}, "a list is needed"),
    ],
)
def test_mistakes_in_a_rig_are_named(over, says):
    with pytest.raises(ConfigError, match=says.replace("(", r"\(")):
        load_rig(RIGS / "teleop.toml", over)


@pytest.mark.parametrize(
    ("over", "says"),
    [
        ({"controller": {"name": "position-forse"}}, "Did you mean 'position-force'"),
        ({"controller": {"parameters": {"stifness": [1, 1, 1]}}}, "Did you mean 'stiffness'"),
        ({"controller": {"parameters": {"space": "jointt"}}}, "Did you mean 'joint'"),
        ({"controller": {"arms": ["leader"]}}, "needs leader and follower"),
    ],
)
def test_mistakes_in_a_controller_are_named(over, says):
    with pytest.raises(ConfigError, match=says):
        build_controller(load_rig(RIGS / "teleop.toml", over))


def test_the_command_line_answers_with_exit_code_2(tmp_path, capsys):
    assert main(["run", str(tmp_path / "no.toml"), "-o", str(tmp_path / "s.mcap")]) == 2
    assert "no such rig file" in capsys.readouterr().err
    bad = tmp_path / "bad.toml"
    bad.write_text("a = = 1")
    assert main(["run", str(bad), "-o", str(tmp_path / "s.mcap")]) == 2
    assert main(["run", str(RIGS / "teleop.toml"), "-o", "x.mcap", "--seed", "-1"]) == 2
    assert not Path("x.mcap").exists()


def test_overrides_do_not_change_what_they_are_merged_into():
    base = {"a": {"b": 1, "c": 2}}
    assert merge(base, {"a": {"b": 3}}) == {"a": {"b": 3, "c": 2}}
    assert base == {"a": {"b": 1, "c": 2}}


def test_the_attached_rig_is_toml_that_lacks_the_simulation():
    config = load_rig(RIGS / "teleop.toml")
    table = tomllib.loads(rig_text(config))
    assert "simulation" not in table
    assert table["devices"]["leader-force"]["options"]["model"] == "nano25"
    assert tomllib.loads(to_toml({"a": {"b": [1, 2.5, "x"], "c": {"d": True}}})) == {
        "a": {"b": [1, 2.5, "x"], "c": {"d": True}}
    }


@pytest.mark.parametrize("path", sorted(RIGS.glob("*.toml")), ids=lambda p: p.stem)
def test_a_rig_file_names_the_back_ends_beside_its_own(path):
    line = next(x for x in path.read_text().splitlines() if x.startswith("backend ="))
    named = re.findall(r'"([a-z-]+)"', line)
    assert {"sim", "sim-wire", "hardware"} == set(named) <= set(BACKENDS)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("seconds = 20.0", "seconds = inf", "beyond"),
        ("seconds = 20.0", "seconds = 20.0\nring_rows = 1_000_000_000_000", "ring_rows"),
        ("options.home = [0.0, 0.4, 0.3]", "options.home = [0.0, 0.4, -1e300]", "beyond"),
        ("below_home = 0.015", "below_home = []", "below_home"),
        ("below_home = 0.015", 'below_home = "x"', "below_home"),
        ("below_home = 0.015", "below_home = nan", "below_home"),
        ("\nhome = [0.0, 0.4, 0.3]", '\nhome = [0.0, 0.4, "x"]', "home"),
        ("\nhome = [0.0, 0.4, 0.3]", "\nhome = [0.0, [], 0.3]", "home"),
        ("\nhome = [0.0, 0.4, 0.3]", "\nhome = [0.0, 0.4]", "home"),
    ],
)
def test_values_that_no_rig_has(tmp_path, capsys, old, new, word):
    text = (RIGS / "teleop.toml").read_text()
    assert old in text
    (tmp_path / "r.toml").write_text(text.replace(old, new, 1))
    words = [str(tmp_path / "r.toml"), "--seconds", "0.01", "-o", str(tmp_path / "s.mcap")]
    assert main(["run", *words]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and word in said


@pytest.mark.parametrize(
    "change", ["period = 0.0", "blend = 0", "seed = -1", "amplitude = [1.0]", "gravity = [1.0]"]
)
def test_parameters_of_the_tracking_that_no_motion_has(change):
    with pytest.raises(ConfigError, match=change.split()[0]):
        JointTrackingConfig(
            **{k: tuple(v) if isinstance(v, list) else v for k, v in tomllib.loads(change).items()}
        )
