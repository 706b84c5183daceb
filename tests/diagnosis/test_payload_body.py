"""A body on a link in one of two runs: its link, its values, and that nothing else is one."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.commands.diagnose import text
from hil.diagnosis.attribution import Named
from hil.diagnosis.types import Candidate, Diagnosis
from hil.errors import ConfigError
from hil.identify.design import Term
from hil.models import catalogue
from hil.models.files import read_model, write_model
from hil.models.model import Use, Value, base_model
from hil.record.recording import Recording, RobotSource
from hil.report.data import diagnosis_json
from hil.report.html import diagnosis_report

#: Axes of two joints that gravity turns.
PITCH = ("0 1 0", "0 1 0")


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
        plants.further(3, 3),
        plants.further(3, 2),
        plants.further(4, 4),
        plants.further(6, 6),
        plants.further(6, 3),
        plants.further(7, 7),
    ],
)
def test_a_body_in_one_of_two_runs_is_named_with_its_link(d: int, link: int) -> None:
    axes = PITCH if d == 2 else plants.AXES
    runs = [plants.serial_arm(d, k, of, axes=axes, seconds=12.0) for k, of in ((1, 0), (2, link))]
    answer = hil.diagnose(runs, base_model(runs[0].robot))
    found = values(answer)
    assert found["joint"] == link
    about_tip = plants.BODY_AT - np.array([0.0, 0.0, 0.15]) * (link == d)
    if link == d:
        assert found["m"] == pytest.approx(plants.BODY, rel=0.05)
    np.testing.assert_allclose(found["mx"], plants.BODY * about_tip[0], atol=0.003)
    last = answer.ladder[-1]
    assert np.all(last.result.rms < 1.1 * answer.floor)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("d", "size", "held"),
    [
        # two joints in a plane feel m, mx, mz and one moment of inertia
        pytest.param(2, 4, (0,), id="bare"),
        plants.further(3, 10, (3,), id="loaded"),
        plants.further(2, 4, (0, 2), id="both"),
    ],
)
def test_held_out_runs_with_and_without_the_body(
    d: int, size: int, held: tuple[int, ...], tmp_path
) -> None:
    """A relative payload with one held-out run: it has no other run to differ from."""
    axes = PITCH if d == 2 else plants.AXES

    def run(seed: int, link: int) -> Recording:
        return plants.serial_arm(d, seed, link, axes=axes, seconds=12.0)

    runs, others = [run(1, 0), run(2, d)], [run(5 + k, link) for k, link in enumerate(held)]
    answer = hil.diagnose(runs, base_model(runs[0].robot), others)
    assert values(answer)["m"] == pytest.approx(plants.BODY, rel=0.05)
    (said,) = [text for code, text in answer.warnings if code == "held-out-values"]
    assert (
        f"payload ({size} values a run)" in said
        and f"{size * len(held)} values were fitted" in said
    )
    assert said in text(answer, hil.ladder(answer))
    assert said in [w["text"] for w in diagnosis_json(answer)["warnings"]]
    diagnosis_report(answer, tmp_path / "r.html")
    assert said in (tmp_path / "r.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", [plants.further("offsets"), "body"])
@pytest.mark.slow
def test_offsets_of_a_run_are_told_from_a_body_in_a_small_motion(kind: str) -> None:
    """Offsets as large as the mean effort of a body: two values, and fewer than a body has."""
    still = {"axes": PITCH, "seconds": 10.0, "reach": 0.03, "posture": 0.8}
    first, second, loaded = (
        plants.serial_arm(2, k, of, **still) for k, of in ((1, 0), (2, 0), (2, 2))
    )
    more = (loaded.tau - second.tau).mean(axis=0)
    other = loaded if kind == "body" else replace(second, tau=second.tau + more)
    answer = hil.diagnose([first, other], base_model(first.robot))
    names = {"offsets": {"torque-offset"}, "body": {"payload"}}[kind]
    assert answer.verdict == "missing-effect" and {f.effect for f in answer.findings} == names
    assert all(f.confidence > 0.9 for f in answer.findings)


@pytest.mark.slow
def test_offsets_of_every_joint_and_run_hide_no_friction() -> None:
    """One payload had been named for three offsets, and beside it no other effect was sure."""
    runs = []
    for k, offsets in ((1, [0.08, -0.92, 0.85]), (2, [0.07, 0.18, 0.47])):
        run = plants.serial_arm(3, k, axes=("0 1 0",) * 3, seconds=10.0, reach=0.3, posture=0.8)
        v = np.gradient(run.q[:, 1], run.t)
        tau = run.tau + offsets
        tau[:, 1] += np.exp(-((v / 0.05) ** 2)) * np.tanh(v / 0.01)
        runs.append(replace(run, tau=tau))
    answer = hil.diagnose(runs, base_model(runs[0].robot))
    named = {(f.effect, f.joint) for f in answer.findings if f.confidence > 0.75}
    assert ("stribeck", "joint2") in named
    assert {("torque-offset", f"joint{k}") for k in (2, 3)} <= named
    assert "payload" not in {effect for effect, _ in named}


def test_another_explanation_of_several_effects_is_weighed_as_one() -> None:
    """It takes the place of one of its effects that was a rival alone, and shares what is left."""
    own, one, other = (
        Candidate(Term(catalogue.get("torque-offset"), j, per_run=True), 0.0, 0.0)
        for j in (0, 1, 2)
    )
    before = Named(own, 0.6, [one], [(0.4, 0.3)], (0.6, 0.7))
    after = before.against([one, other], (0.5, 0.8))
    assert after.rivals == [one, other] and after.confidence == pytest.approx(0.5)
    for way, share in ((0, 0.5), (1, 0.8)):
        assert after.own[way] == pytest.approx(share)
        assert after.odds[0][way] == pytest.approx(1.0 - share)
    assert before.against([other], (0.99, 0.98)).rivals == [one]


def test_an_offset_of_a_held_out_run_s_own_is_said() -> None:
    runs = [plants.serial_arm(2, k, seconds=8.0) for k in (1, 2, 3)]
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


@pytest.mark.slow
def test_the_run_that_carries_a_body_has_it_where_it_comes_first() -> None:
    """It was minus four kilograms on the empty run, and the model of all others carried it."""
    runs = [plants.serial_arm(2, k, link, axes=PITCH, seconds=12.0) for k, link in ((2, 2), (1, 0))]
    answer = hil.diagnose(runs, base_model(runs[0].robot))
    assert values(answer)["m"] == pytest.approx(plants.BODY, rel=0.05)
    assert f"payload.m[{runs[0].name}]" in answer.findings[0].parameters
    empty = plants.serial_arm(2, 5, axes=PITCH, seconds=12.0)
    model = answer.ladder[-1].result.model.as_it_is()
    assert np.all(hil.fit(empty, model).relative < 2 * answer.ladder[-1].result.relative)


@pytest.mark.slow
def test_the_order_of_the_runs_changes_once(monkeypatch) -> None:
    """Where two runs carry as much, each may seem the lighter one beside the other."""
    runs = [plants.serial_arm(2, k, axes=PITCH, seconds=8.0) for k in (1, 2)]
    asked: list[Diagnosis] = []
    monkeypatch.setattr("hil.diagnosis.engine._lightest", lambda out: asked.append(out) or 1)
    answer = hil.diagnose(runs, base_model(runs[0].robot))
    names = [r.name for r in answer.ladder[0].result.problem.recordings]
    assert names == [runs[1].name, runs[0].name]
    assert len(asked) == 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", plants.seeds(1, 2, 3))
def test_two_runs_alike_have_no_payload(seed: int) -> None:
    runs = [plants.serial_arm(3, 10 * seed), plants.serial_arm(3, 10 * seed + 1)]
    answer = hil.diagnose(runs, base_model(runs[0].robot))
    assert answer.verdict == "adequate"


@pytest.mark.slow
@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("wrong", plants.seeds(1, 2))
def test_a_description_that_is_a_bit_wrong_is_no_payload(wrong: int, fixed: bool) -> None:
    """Masses, centres and inertias of all links are wrong by 5 %; fitted, or kept as they are."""
    runs = [plants.serial_arm(3, 1, wrong=wrong), plants.serial_arm(3, 2, wrong=wrong)]
    model = base_model(runs[0].robot)
    if fixed:
        effects = [replace(u, options={"fixed": u.type == "rigid-body"}) for u in model.effects]
        model = replace(model, effects=tuple(effects))
    for some in (runs, runs[:1]):
        answer = hil.diagnose(some, model)
        assert "payload" not in {f.effect for f in (*answer.findings, *answer.partial)}


def test_a_spring_that_one_session_has_is_no_payload() -> None:
    """A payload of ten values took 98 % of it, at 1.00, and a stop the rest."""
    one, two = (plants.serial_arm(2, k, noise=0.003) for k in (1, 2))
    d = hil.diagnose([one, replace(two, tau=two.tau + 6.0 * two.q * [0, 1])], base_model(one.robot))
    assert d.verdict == "unexplained" and not d.findings
    assert "another stiffness in run2 (+6 N m/rad) explains most" in str(d)
    assert all(f.reason.endswith("explains the same error better") for f in d.partial)


def test_a_model_with_a_mass_at_the_tip_still_reads(tmp_path) -> None:
    """A file from before bodies had a centre: its mass sits at the tip."""
    runs = [plants.serial_arm(2, 1), plants.serial_arm(2, 2, 2)]
    old = Use("payload", options={"per_run": True}, values={"payload.m[run2]": Value(0.4)})
    write_model(base_model(runs[0].robot) + old, tmp_path / "m.toml")
    result = hil.fit(runs, read_model(tmp_path / "m.toml"))
    assert result.values["payload.joint"].value == 2.0
    kept = replace(old, options={"per_run": True, "fixed": True})
    result = hil.fit(runs, base_model(runs[0].robot) + kept)
    assert result.values["payload.m[run2]"].value == 0.4
    assert result.values["payload.mx[run2]"].value == 0.0


@pytest.mark.parametrize(
    ("robot", "amplitude"),
    [
        plants.further("planar2", 5.0),
        plants.further("elbow3", 5.0),
        plants.further("elbow3", 0.0),
    ],
)
def test_a_mujoco_arm_under_control_with_a_mass_at_its_tip(robot: str, amplitude: float) -> None:
    """Its description is wrong by up to a fifth, which is no payload."""
    pytest.importorskip("mujoco")
    from hil.sim_devices.mujoco_plants import session
    from hil.sim_devices.mujoco_plants.describe import load_mass
    from hil.sim_devices.mujoco_plants.laws import EffectPlace
    from hil.sim_devices.mujoco_plants.robots import ROBOTS

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
    mass = load_mass(EffectPlace(ROBOTS[robot], 0, amplitude, np.random.default_rng(0)))
    found = values(answer)
    assert found["joint"] == len(told["joints"])
    assert found["m"] == pytest.approx(mass, rel=0.02)


def test_differences_between_runs_say_from_which_run_they_count(tmp_path) -> None:
    """The run that carries more was foretold without it where it came alone."""
    runs = [plants.serial_arm(2, k, link, axes=PITCH, seconds=8.0) for k, link in ((1, 0), (2, 2))]
    body = Use("payload", options={"per_run": True}, values={"payload.joint": Value(2.0)})
    result = hil.fit(runs, base_model(runs[0].robot) + body)
    write_model(result.model, tmp_path / "m.toml")
    model = read_model(tmp_path / "m.toml")
    (use,) = (u for u in model.effects if u.type == "payload")
    assert use.options["reference"] == runs[0].name
    for run in runs:
        alone = hil.compare([run], model, as_is=True, simulate=False)
        assert np.all(alone.result.relative < 1.3 * result.relative)
        assert "other-runs" not in [f.code for f in alone.faults]
    other = hil.compare([replace(runs[1], name="new")], model, as_is=True, simulate=False)
    mass = result.values[f"payload.m[{runs[1].name}]"].value
    assert other.result.values["payload.m[new]"].value == pytest.approx(mass / 2)
    (said,) = [f.text for f in other.faults if f.code == "other-runs"]
    assert "payload has values of" in said and "for new their median is taken" in said
    # it carries what one of the fitted runs carried: the answer says which, and it can be chosen
    assert f"(--like {runs[1].name})" in said
    new = [replace(runs[1], name="new")]
    like = hil.compare(new, model, as_is=True, like=runs[1].name, simulate=False)
    assert np.all(like.result.relative < 1.3 * result.relative)
    (said,) = [f.text for f in like.faults if f.code == "other-runs"]
    assert f"for new those of {runs[1].name} are taken" in said and "--like" not in said
    with pytest.raises(ConfigError, match="unknown run with values of its own 'monday'"):
        hil.compare(new, model, as_is=True, like="monday")
    with pytest.raises(ConfigError, match="like is of as_is"):
        hil.compare(new, model, like=runs[1].name)
