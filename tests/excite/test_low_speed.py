"""An effect of low speeds asks for a motion that dwells there, after which it is named."""

import json

import numpy as np
import plants
import pytest

from hil.cli import main
from hil.diagnosis.engine import diagnose
from hil.excite import trajectory
from hil.excite.trajectory import sample
from hil.models.model import base_model
from hil.record.recording import Recording, RobotSource

AXIS = """<robot name="axis"><link name="base"/><link name="rod"><inertial><mass value="1"/>
<inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="axis" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="5" velocity="{speed}"/></joint></robot>"""


def planned(folder, capsys, effect: str, motion: str = "", speed: float = 3.0) -> dict:
    """Answer of `hil excite` for the axis; the motion is in axis.toml."""
    (folder / "axis.urdf").write_text(AXIS.format(speed=speed), encoding="utf-8")
    words = ["excite", str(folder / "axis.urdf"), "--for", effect, "-o", str(folder / "axis.toml")]
    assert main([*words, "--json", *(["--motion", motion] if motion else [])]) == 0
    return json.loads(capsys.readouterr().out)


def played(folder, vs: float, fs: float) -> Recording:
    """The axis on that motion: inertia, viscous, dry and Stribeck friction, and noise."""
    x = trajectory.read_trajectory(folder / "axis.toml")
    t = np.arange(0, x.period, 1e-3)
    q, v, a = (s[:, 0] for s in sample(x, t))
    rng = np.random.default_rng(1)
    # tau = J a + b v + (fc + fs exp(-(v / vs)^2)) sgn v
    tau = 0.05 * a + 0.05 * v + (0.1 + fs * np.exp(-((v / vs) ** 2))) * np.sign(v)
    tau, q = tau + 0.004 * rng.normal(size=t.size), q + 2e-5 * rng.normal(size=t.size)
    robot = RobotSource("", (folder / "axis.urdf").read_text(encoding="utf-8"))
    return Recording("run", "arm", ("axis",), t, q[:, None], tau[:, None], robot=robot)


@pytest.mark.parametrize(
    ("vs", "fs"), [(0.05, 0.03), pytest.param(0.2, 0.03, marks=pytest.mark.slow)]
)
@pytest.mark.slow
def test_stribeck_is_named_after_the_motion_proposed_and_not_after_a_fast_one(
    vs, fs, tmp_path, capsys
):
    answer = planned(tmp_path, capsys, "stribeck")
    order = [row["motion"] for row in answer["menu"]]
    assert answer["motion"] == order[0] == "speed-ladder"
    assert order.index("fast-strokes") > order.index("chirp")
    run = played(tmp_path, vs, fs)
    found = diagnose([run], base_model(run.robot))
    assert found.verdict == "missing-effect"
    assert [f.effect for f in found.findings] == ["stribeck"]

    assert planned(tmp_path, capsys, "stribeck", "fast-strokes")["motion"] == "fast-strokes"
    run = played(tmp_path, vs, fs)
    assert diagnose([run], base_model(run.robot)).verdict == "adequate"


@pytest.mark.parametrize("speed", [3.0, 10.0])
@pytest.mark.parametrize("effect", plants.seeds("stribeck", "presliding", "stribeck,presliding"))
def test_a_motion_that_dwells_at_low_speed_comes_before_fast_strokes(
    effect, speed, tmp_path, capsys
):
    answer = planned(tmp_path, capsys, effect, speed=speed)
    order = [row["motion"] for row in answer["menu"]]
    assert order.index("fast-strokes") >= 4 and order[0] not in ("rests", "postures")


def test_what_the_menu_assumes_is_printed(tmp_path, capsys):
    (tmp_path / "axis.urdf").write_text(AXIS.format(speed=3), encoding="utf-8")
    words = ["excite", str(tmp_path / "axis.urdf"), "--for", "stribeck"]
    assert main([*words, "-o", str(tmp_path / "axis.toml")]) == 0
    text = capsys.readouterr().out
    assert "assumed: an effect of 0.5 % of the torque limit, a noise of 0.1 %" in text
    assert "stribeck with vs = 0.175 rad/s, n = 1" in text
