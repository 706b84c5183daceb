"""A body on a link in one of two runs: its link, its values, and that nothing else is one."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import hil
from hil.commands.diagnose import text
from hil.diagnosis.types import Diagnosis
from hil.models.files import read_model, write_model
from hil.models.model import Use, Value, base_model
from hil.record.recording import Recording, RobotSource
from hil.report.html import diagnosis_report
from hil.report.json import diagnosis_json

AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "1 0 0", "0 1 0")
FRICTION = np.array([1.5, 6.0, 3.0, 1.0, 0.6, 0.4, 0.3])
MASS, CENTRE, ABOUT = 0.5, np.array([0.03, 0.02, 0.1]), np.diag([0.003, 0.004, 0.002])


def arm(d: int, axes: tuple[str, ...] = AXES) -> str:
    """URDF of a serial arm."""
    out = '<robot name="arm"><link name="l0"/>'
    for k in range(1, d + 1):
        up = 0.1 if k == 1 else 0.22
        out += (
            f'<link name="l{k}"><inertial><origin xyz="0.01 0.005 0.1"/><mass value="{4 / k}"/>'
            f'<inertia ixx="{0.02 / k}" ixy="0" ixz="0" iyy="{0.018 / k}" iyz="0" '
            f'izz="{0.006 / k}"/></inertial></link><joint name="joint{k}" type="revolute">'
            f'<parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="0 0 {up}"/>'
            f'<axis xyz="{axes[k - 1]}"/><limit lower="-3" upper="3" effort="200" velocity="10"/>'
            "</joint>"
        )
    end = '<link name="tip"/><joint name="end" type="fixed"><parent link="l{}"/><child link="tip"/>'
    return out + end.format(d) + '<origin xyz="0 0 0.15"/></joint></robot>'


def run(
    d: int, seed: int, link: int = 0, wrong: int = 0, axes: tuple[str, ...] = AXES
) -> Recording:
    """The arm on four tones a joint; its effort is Pinocchio's, with friction and noise."""
    text, rng, t = arm(d, axes), np.random.default_rng(seed), np.arange(0.0, 20.0, 0.004)
    w = 2 * np.pi * rng.uniform(0.08, 0.7, (d, 4))
    angle = t[:, None, None] * w + rng.uniform(0, 6.28, (d, 4))
    size = 0.35 / w**0.5
    q, v, a = (size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle))
    q, v, a = (x.sum(axis=2) for x in (q, v, a))
    model = pin.buildModelFromXML(text)
    if wrong:
        factors = 1 + 0.05 * np.random.default_rng(wrong).standard_normal((d, 3))
        for body, f in zip(list(model.inertias)[1:], factors, strict=True):
            body.mass, body.lever, body.inertia = (
                body.mass * f[0],
                body.lever * f[1],
                body.inertia * f[2],
            )
    if link:
        model.appendBodyToJoint(link, pin.Inertia(MASS, CENTRE, ABOUT), pin.SE3.Identity())
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)])
    held = FRICTION[:d] / d**0.5
    tau += held * (0.1 * np.tanh(v / 0.01) + 0.1 * v + 0.03 * rng.standard_normal(tau.shape))
    q = q + 1e-6 * rng.standard_normal(q.shape)
    joints = tuple(f"joint{k}" for k in range(1, d + 1))
    return Recording(f"run{seed}", "arm", joints, t, q, tau, robot=RobotSource("", text))


def values(d: Diagnosis) -> dict[str, float]:
    """Values of the payload by short names; it is the only finding."""
    assert d.verdict == "missing-effect"
    assert [(f.effect, f.joint) for f in d.findings] == [("payload", None)]
    assert d.findings[0].confidence > 0.9
    return {
        k.removeprefix("payload.").split("[")[0]: v.value
        for k, v in d.findings[0].parameters.items()
    }


@pytest.mark.parametrize(
    ("d", "link"),
    [
        (2, 2),
        (3, 3),
        (3, 2),
        pytest.param(4, 4, marks=pytest.mark.slow),
        pytest.param(6, 6, marks=pytest.mark.slow),
        pytest.param(6, 3, marks=pytest.mark.slow),
        pytest.param(7, 7, marks=pytest.mark.slow),
    ],
)
def test_a_body_in_one_of_two_runs_is_named_with_its_link(d: int, link: int) -> None:
    axes = ("0 1 0", "0 1 0") if d == 2 else AXES
    runs = [run(d, 1, axes=axes), run(d, 2, link, axes=axes)]
    answer = hil.diagnose(runs, base_model(runs[0].robot))
    found = values(answer)
    assert found["joint"] == link
    about_tip = CENTRE - np.array([0.0, 0.0, 0.15]) * (link == d)
    if link == d:
        assert found["m"] == pytest.approx(MASS, rel=0.05)
    np.testing.assert_allclose(found["mx"], MASS * about_tip[0], atol=0.003)
    last = answer.ladder[-1]
    assert np.all(last.result.rms < 1.1 * answer.floor)


@pytest.mark.parametrize("held", [(0,), (3,), (0, 3)], ids=["bare", "loaded", "both"])
def test_held_out_runs_with_and_without_the_body(held: tuple[int, ...], tmp_path) -> None:
    """A relative payload with one held-out run: it has no other run to differ from."""
    runs = [run(3, 1), run(3, 2, 3)]
    answer = hil.diagnose(
        runs, base_model(runs[0].robot), [run(3, 5 + k, link) for k, link in enumerate(held)]
    )
    assert values(answer)["m"] == pytest.approx(MASS, rel=0.05)
    (said,) = [text for code, text in answer.warnings if code == "held-out-values"]
    assert "payload (10 values a run)" in said and f"{10 * len(held)} values were fitted" in said
    assert said in text(answer, hil.ladder(answer))
    assert said in [w["text"] for w in diagnosis_json(answer)["warnings"]]
    diagnosis_report(answer, tmp_path / "r.html")
    assert said in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_an_offset_of_a_held_out_run_s_own_is_said() -> None:
    runs = [run(2, k) for k in (1, 2, 3)]
    effects = tuple(
        replace(u, options={"per_run": u.type == "torque-offset"})
        for u in base_model(runs[0].robot).effects
    )
    model = replace(base_model(runs[0].robot), effects=effects)
    compared = hil.compare(runs[:2], model, runs[2:])
    (said,) = [f.text for f in compared.faults if f.code == "held-out-values"]
    assert "torque-offset on joint1, joint2 (2 values a run): 2 values were fitted to run3" in said
    assert not [f for f in hil.compare(runs[:2], model).faults if f.code == "held-out-values"]
    _, after = hil.add(runs[:2], model, "payload", holdout=runs[2:])
    assert "held-out-values" in [code for code, _ in after.step.result.warnings]


def test_the_first_run_may_be_the_loaded_one() -> None:
    runs = [run(3, 2, 3), run(3, 1)]
    assert values(hil.diagnose(runs, base_model(runs[0].robot)))["m"] == pytest.approx(-MASS, 0.05)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_runs_alike_have_no_payload(seed: int) -> None:
    runs = [run(3, 10 * seed), run(3, 10 * seed + 1)]
    answer = hil.diagnose(runs, base_model(runs[0].robot))
    assert answer.verdict == "adequate"


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("wrong", [1, 2])
def test_a_description_that_is_a_bit_wrong_is_no_payload(wrong: int, fixed: bool) -> None:
    """Masses, centres and inertias of all links are wrong by 5 %; fitted, or kept as they are."""
    runs = [run(3, 1, wrong=wrong), run(3, 2, wrong=wrong)]
    model = base_model(runs[0].robot)
    if fixed:
        effects = [replace(u, options={"fixed": u.type == "rigid-body"}) for u in model.effects]
        model = replace(model, effects=tuple(effects))
    for some in (runs, runs[:1]):
        answer = hil.diagnose(some, model)
        assert "payload" not in {f.effect for f in (*answer.findings, *answer.partial)}


def test_a_model_with_a_mass_at_the_tip_still_reads(tmp_path) -> None:
    """A file from before bodies had a centre: its mass sits at the tip."""
    runs = [run(2, 1), run(2, 2, 2)]
    old = Use("payload", options={"per_run": True}, values={"payload.m[run2]": Value(0.4)})
    write_model(base_model(runs[0].robot) + old, tmp_path / "m.toml")
    result = hil.fit(runs, read_model(tmp_path / "m.toml"))
    assert result.values["payload.joint"].value == 2.0
    kept = replace(old, options={"per_run": True, "fixed": True})
    result = hil.fit(runs, base_model(runs[0].robot) + kept)
    assert result.values["payload.m[run2]"].value == 0.4
    assert result.values["payload.mx[run2]"].value == 0.0


@pytest.mark.parametrize(
    ("robot", "amplitude"), [("planar2", 5.0), ("elbow3", 5.0), ("elbow3", 0.0)]
)
def test_a_mujoco_arm_under_control_with_a_mass_at_its_tip(robot: str, amplitude: float) -> None:
    """Its description is wrong by up to a fifth, which is no payload."""
    pytest.importorskip("mujoco")
    from hil.sim_devices.mujoco_plants import session
    from hil.sim_devices.mujoco_plants.laws import Place
    from hil.sim_devices.mujoco_plants.robots import ROBOTS
    from hil.sim_devices.mujoco_plants.structure import load_mass

    told, runs = session.robots()[robot], []
    hidden = [{"effect": "payload", "joint": 0, "amplitude": amplitude}] if amplitude else []
    for k, some in enumerate(([], hidden)):
        rows = session.simulate(robot, ("wander", 1 + k), some, seed=k)
        source = RobotSource("", str(told["urdf"]))
        q, tau = rows["q"], rows["tau"]
        runs.append(Recording(f"run{k}", "arm", told["joints"], rows["t"], q, tau, robot=source))
    answer = hil.diagnose(runs, base_model(runs[0].robot))
    if not amplitude:
        assert answer.verdict == "adequate"
        return
    mass = load_mass(Place(ROBOTS[robot], 0, amplitude, np.random.default_rng(0)))
    found = values(answer)
    assert found["joint"] == len(told["joints"])
    assert found["m"] == pytest.approx(mass, rel=0.02)
