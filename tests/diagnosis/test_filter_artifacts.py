"""Reversals that the positions' filter blurs are no missing physics, and hide none."""

from dataclasses import replace

import plants
import pytest

import hil
from hil.commands.diagnose import text, verdict_sentence
from hil.diagnosis import artefacts
from hil.diagnosis.verbs import ladder
from hil.diagnosis.verdict import of_noise
from hil.record.consistency import Note
from hil.report import text as report_text
from hil.report.data import from_diagnosis


def diagnosed(run):
    return hil.diagnose([run], hil.base_model(run.robot))


def share(d):
    first = d.ladder[0].result
    return float((artefacts.blurred_parts(d.first, first) / first.rms**2)[0])


@pytest.mark.parametrize("seed", plants.seeds(1, 2))
@pytest.mark.slow
def test_exact_dry_friction_at_quick_reversals_is_adequate(seed):
    d = diagnosed(plants.quick_axis(seed, noise=0.01))
    assert d.verdict == "adequate" and not d.findings
    assert share(d) > 0.3
    (said,) = [text for code, text in d.warnings if code == artefacts.BLURRED]
    assert "from the filter at reversals" in said and "position_hz above 36" in said
    assert said in text(d, ladder(d)) and f"{said}." in report_text.details(from_diagnosis(d))


@pytest.mark.slow
def test_an_adequate_error_above_its_floor_is_called_what_it_is():
    d = diagnosed(plants.quick_axis(2))
    ratio = float((d.ladder[-1].heldout.rms / d.noise)[0])
    above = ratio > 1.1
    shown = text(d, ladder(d)).splitlines()[0]
    assert ("a filter artifact at reversals" in shown) == above
    assert ("a filter artifact at reversals" in report_text.headline(from_diagnosis(d))) == above
    assert above == artefacts.blurred_above(d.warnings, {"joint1": ratio})


def test_only_a_joint_that_is_said_to_be_blurred_counts():
    words = "joint1: 40 % of the squared error is at reversals"
    said = [Note(artefacts.BLURRED, words, "joint1"), ("other", words)]
    assert artefacts.blurred_above(said, {"joint1": 1.3, "joint2": 1.0})
    assert not artefacts.blurred_above(said, {"joint1": 1.05, "joint2": 1.3})
    assert not artefacts.blurred_above([], {"joint1": 1.3})


def test_smooth_friction_leaves_nothing_to_blur():
    d = diagnosed(plants.quick_axis(1, width=0.02))
    assert d.verdict == "adequate" and share(d) < 0.1
    assert artefacts.BLURRED not in [code for code, _ in d.warnings]


@pytest.mark.parametrize("seed", plants.seeds(1, 2, 6))
@pytest.mark.slow
def test_a_law_that_a_blunt_sign_stands_for_is_no_filter(seed):
    """No filter blunts a sign over several rad/s, and no Stribeck begins at the width of such one.

    What is left beside it follows the speed.
    """
    d = diagnosed(plants.braked_axis(seed))
    assert d.verdict == "unexplained" and not d.findings
    assert artefacts.BLURRED not in [code for code, _ in d.warnings]
    assert "at reversals" not in report_text.headline(from_diagnosis(d))
    assert [c.effect for c in d.corrections] == ["correction-speed"]
    assert d.ladder[-1].heldout.rms[0] < 1.1 * d.noise[0]


@pytest.mark.slow
def test_a_sign_is_sharp_again_beside_the_correction_that_it_stood_for():
    d = diagnosed(plants.braked_axis(18))
    before, after = (r.values["j1.coulomb.v0"] for r in (d.explained.result, d.ladder[-1].result))
    assert before.at_bound and before.value > 1.0
    assert after.value < 0.1
    assert d.ladder[-1].result.values["j1.coulomb.fc"].value == pytest.approx(0.11, rel=0.1)


@pytest.mark.slow
def test_a_real_effect_beside_blurred_reversals_keeps_its_name():
    d = diagnosed(plants.quick_axis(1, extra=0.15))
    assert [f.effect for f in d.findings] == ["stribeck"]
    first = next(c for c in d.first.candidates if c.name == "stribeck")
    assert not first.blurred


def test_candidates_that_explain_only_that_are_marked():
    d = diagnosed(plants.quick_axis(2))
    strong = [c for c in d.first.candidates if c.p_value <= 0.01 and c.score > 0]
    assert strong and all(c.blurred for c in strong if c.name in ("stribeck", "torque-ripple"))


def test_without_dry_friction_in_the_model_nothing_is_said():
    run = plants.quick_axis(1)
    model = hil.base_model(run.robot)
    rest = [u for u in model.effects if u.type != "coulomb"]
    bare = type(model)(robot=model.robot, effects=tuple(rest))
    result = hil.fit([run], bare)
    d = diagnosed(run)
    assert d.first.projector is not None
    assert artefacts.blur(result, d.first.projector, 0).gain == 0.0


def test_a_held_out_error_is_excused_by_what_reversals_make_of_the_fitted_one(monkeypatch):
    """By its power there and no share of more: what is new on the held-out runs is not excused."""
    d = diagnosed(plants.quick_axis(1))
    step, fitted = d.explained, d.explained.result.rms**2
    one = step.heldout.residual / step.heldout.rms[:, None]
    monkeypatch.setattr(artefacts, "blurred_parts", lambda *_: 0.8 * fitted)
    there = 0.8 * step.result.rms
    for times, excused in ((1.1, True), (2.0, False)):
        held = replace(step.heldout, residual=times * step.result.rms[:, None] * one)
        assert held.rms == pytest.approx(times * step.result.rms)
        assert of_noise(replace(step, heldout=held), d.last, there, there=True).tolist() == [
            excused
        ]


@pytest.mark.slow
def test_what_is_left_at_reversals_is_no_missing_effect(monkeypatch):
    d = diagnosed(plants.quick_axis(1))
    floor, most = 0.5 * d.explained.heldout.rms, d.explained.result.rms**2
    d.verdict, d.floor, d.heldout_floor = "unexplained", floor, None
    for part, said in ((0.8, True), (0.3, False)):
        monkeypatch.setattr(artefacts, "blurred_parts", lambda *_, p=part: p * most)
        assert artefacts.at_reversals(d.explained, d.last, floor) is said
        assert not artefacts.at_reversals(d.explained, d.last, 4 * floor)
        assert ("at reversals" in verdict_sentence(d)) is said
        assert ("at reversals" in report_text.headline(from_diagnosis(d))) is said
