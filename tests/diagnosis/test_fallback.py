"""Where nothing named explains the excess, the network says which variables carry it."""

import json
from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.floor import function_sentences
from hil.diagnosis.types import Explainable
from hil.models import catalogue
from hil.report.data import diagnosis_json


@pytest.fixture(scope="module")
def unnamed():
    """Structure in position and speed together that no effect of the catalogue has."""
    run = plants.axis(1, extra=lambda t, q, v: 0.15 * np.tanh(4 * q) * v * np.cos(3 * v))
    return run, hil.diagnose([run], hil.base_model(run.robot))


@pytest.mark.slow
def test_shares_say_which_variables_carry_the_structure(unnamed):
    _, d = unnamed
    assert d.verdict == "unexplained"
    share = {s.feature.removeprefix("network: "): s.share for s in d.network}
    assert share["q,qd of joint1"] > 0.8
    assert max(share["qd of joint1"], share["t"]) < 0.5


@pytest.mark.slow
def test_another_joints_speed_is_told(unnamed):
    run = plants.arm(1)
    v = np.gradient(run.q, run.t, axis=0)
    tau = run.tau.copy()
    tau[:, 1] += 0.01 * np.sin(3 * v[:, 0]) * np.cos(4 * v[:, 1]) * np.sign(v[:, 0] * v[:, 1])
    run = replace(run, tau=tau)
    d = hil.diagnose([run], hil.base_model(run.robot))
    best = max(d.network, key=lambda s: s.share)
    assert best.feature == "network: qd of joint2 and joint1" and best.share > 0.9
    assert {s.joint for s in d.network} == {"joint2"}


def test_shares_are_in_json_text_and_report(unnamed, tmp_path):
    from hil.commands.diagnose import text
    from hil.diagnosis.verbs import ladder
    from hil.report.html import diagnosis_report

    _, d = unnamed
    rows = json.loads(json.dumps(diagnosis_json(d)))["remaining"]["structure"]
    row = next(r for r in rows if r["feature"] == "network: q,qd of joint1")
    assert row["joint"] == "joint1" and row["share"] > 0.8 and "position and speed" in row["text"]
    assert "a function of its position and speed could explain" in text(d, ladder(d))
    diagnosis_report(d, tmp_path / "r.html")
    assert "remaining error functions of these variables could explain" in (
        tmp_path / "r.html"
    ).read_text("utf-8")


@pytest.mark.slow
def test_network_fits_and_lowers_the_heldout_error(unnamed):
    run, _ = unnamed
    before, after = hil.add([run], hil.base_model(run.robot), "friction-network")
    old, new = before.step.heldout.relative[0], after.step.heldout.relative[0]
    assert new < 0.6 * old
    names = after.step.result.values
    assert names["j1.friction-network.inputs"].value == -1.0


def test_nothing_left_nothing_said():
    run = plants.axis(2)
    assert not hil.diagnose([run], hil.base_model(run.robot)).network


def test_one_line_a_joint_tells_the_shares():
    shares = [
        Explainable("a", "network: t", 0.2, "", "time"),
        Explainable("a", "network: qd of a", 0.9, "", "speed"),
        Explainable("a", "network: q,qd of a", 0.0, "", "place"),
        Explainable("b", "t", 0.0, "", "time"),
    ]
    assert function_sentences(shares) == [
        "a: a function of speed could explain 90 %, of time 20 %",
        "b: functions of time explain none of it",
    ]


@pytest.mark.slow
def test_a_torque_over_two_positions_is_found_in_the_floor():
    run = plants.arm(1)
    tau = run.tau.copy()
    tau[:, 1] += 0.02 * np.sin(5 * run.q[:, 0]) * np.cos(4 * run.q[:, 1])
    d = hil.diagnose([replace(run, tau=tau)], hil.base_model(run.robot))
    assert d.verdict == "unexplained"
    best = max(d.network, key=lambda s: s.share)
    assert best.feature == "network: q of joint2 and joint1" and best.joint == "joint2"
    assert "its position and that of joint1" in best.text


def harness():
    """An arm of which a harness pulls two joints, by the third power of its stretch; two runs."""
    runs = []
    for seed in (1, 2):
        run = plants.arm(seed, seconds=12.0)
        stretch = run.q[:, 0] + 0.6 * run.q[:, 1] - 0.1
        pull = np.outer(0.4 * stretch**3, [1.0, 0.6, 0.0][: run.d])
        runs.append(replace(run, tau=run.tau + pull))
    return runs


@pytest.mark.slow
def test_a_harness_over_two_joints_has_its_name_and_its_ratio():
    run, other = harness()
    d = hil.diagnose(run, hil.base_model(run.robot), other)
    assert [f.effect for f in d.findings] == ["coupled-spring"] and not d.corrections
    values = {k.rsplit(".", 1)[1]: v.value for k, v in d.findings[0].parameters.items()}
    assert values["k3"] == pytest.approx(0.4, rel=0.02)
    assert values["r"] == pytest.approx(0.6, rel=0.02)


@pytest.mark.slow
def test_what_pulls_by_two_positions_and_has_no_law_is_foretold_by_both(monkeypatch):
    """The answer had said which two variables carry it, and no correction followed them."""
    monkeypatch.delitem(catalogue.table(), "coupled-spring")
    run, other = harness()
    d = hil.diagnose(run, hil.base_model(run.robot), other)
    assert {c.effect for c in d.corrections} >= {"correction-posture"}
    assert "its position and another joint's" in {c.of for c in d.corrections}
    after, before = d.ladder[-1].heldout.rms[:2], d.ladder[0].heldout.rms[:2]
    assert np.all(after < 0.45 * before)
