"""Sessions that differ: which one holds what, and which effect would explain it."""

from dataclasses import replace
from functools import cache

import numpy as np
import plants
import pytest

import hil
from hil.commands.compare import text as compared
from hil.commands.diagnose import text
from hil.diagnosis import equivalence
from hil.diagnosis.engine import diagnose
from hil.diagnosis.heldout import (
    BOTH,
    DIFFER,
    HELD_OUT_ADVICE,
    RIG_STATE,
    _ours,
    _Pair,
    still_differ,
)
from hil.diagnosis.residual_tests import FIT_APART
from hil.diagnosis.types import Finding
from hil.diagnosis.verbs import compare, ladder
from hil.models.model import base_model
from hil.record.consistency import Note
from hil.report.data import diagnosis_json, from_diagnosis
from hil.report.html import diagnosis_report
from hil.report.text import AGAIN, headline, next_steps


@cache
def answer(ours: str, theirs: str):
    """Several tests look at the same answer."""
    fit, held = plants.two_axes(ours, 1, "monday"), plants.two_axes(theirs, 2, "friday")
    return diagnose([fit], base_model(fit.robot), [held])


def said(d) -> list[str]:
    return [text for code, text in d.warnings if code == DIFFER]


@pytest.mark.parametrize(
    ("ours", "theirs", "says"),
    [
        (
            "cogging",
            "",
            "cogging would explain 100 % of the error above the noise in monday, and "
            "friday does not show it",
        ),
        plants.further(
            "",
            "cogging",
            "cogging would explain 100 % of the error above the noise in friday, and "
            "monday does not show it",
        ),
        ("", "stribeck", "stribeck would explain"),
        pytest.param("", "offset", "torque-offset", marks=pytest.mark.slow),
        pytest.param("offset", "", "torque-offset", marks=pytest.mark.slow),
        ("", "coulomb", "another j2.coulomb.fc (+0.25 N m) would explain 100 %"),
        plants.further("", "gain", "all efforts of the joint scaled by 1.15"),
    ],
)
def test_what_only_one_session_holds_is_said_with_its_effect(ours, theirs, says):
    d = answer(ours, theirs)
    (sentence,) = said(d)
    assert sentence.startswith("joint2: the sessions differ: ") and says in sentence
    assert "Fit the held-out session, too" in sentence and "[offsets]" in sentence
    assert sentence in [w["text"] for w in diagnosis_json(d)["warnings"]]
    shown = text(d, ladder(d))
    assert shown.count(sentence) == 1 and shown.index(sentence) < shown.index("held-out error")
    assert d.verdict in ("adequate", "unexplained")
    if not ours:
        (verdict,) = (line for line in shown.splitlines() if line.startswith("Verdict: "))
        assert "but not the held-out data" in verdict


@pytest.mark.parametrize("law", ["", "cogging"])
def test_sessions_of_one_rig_do_not_differ(law):
    assert said(answer(law, law)) == []


def test_a_motion_that_says_too_little_is_told_from_another_rig():
    # the slow session leaves the inertia open; the fast one is the same rig
    fit, held = plants.two_axes("", 1, "slow", 0.08), plants.two_axes("", 2, "fast")
    d = diagnose([fit], base_model(fit.robot), [held])
    assert all("the sessions differ" not in x or "leaves the range of slow" in x for x in said(d))
    assert any("does not determine the parameters that matter in fast" in x for x in said(d))


@pytest.mark.slow
def test_what_the_fitted_motion_could_not_show_is_no_difference():
    # fast strokes hide what happens at low speed
    fit, held = (
        plants.two_axes("stribeck", 1, "fast", 3.0),
        plants.two_axes("stribeck", 2, "slow", 0.2),
    )
    sentences = said(diagnose([fit], base_model(fit.robot), [held]))
    assert any("the motion of fast can hardly show it" in x for x in sentences)
    assert all("the sessions differ" not in x for x in sentences)


def test_what_a_model_lacks_in_both_sessions_is_no_other_rig():
    """A drag in all runs: each session gives friction another share of it."""
    runs = []
    for seed, slow in ((1, 1.0), (2, 3.0)):
        r = plants.two_axes("", seed, f"run{seed}", slow)
        v = np.gradient(r.q[:, 1], r.t)
        runs.append(replace(r, tau=r.tau + np.outer(v * np.abs(v), [0.0, 1.0])))
    c = compare(runs[:1], base_model(runs[0].robot), runs[1:])
    (told,) = (f.text for f in c.faults if f.code == DIFFER and f.text.startswith("joint2"))
    assert "The model is incomplete" in told and "for that reason" in told
    assert "the sessions differ" not in told and "one state of the rig" not in told


@pytest.mark.slow
def test_fitted_sessions_of_two_states_get_one_piece_of_advice():
    """A brake that drags in one of two fitted sessions; the held-out one is like the other."""
    runs = [
        plants.two_axes(law, k, f"run{k}") for k, law in enumerate(("", "coulomb", ""), start=1)
    ]
    d = diagnose(runs[:2], base_model(runs[0].robot), runs[2:])
    (sentence,) = said(d)
    assert "The fitted sessions themselves differ there" in sentence and BOTH not in sentence
    assert next_steps(from_diagnosis(d, simulated=False)) == [f"{FIT_APART}.", AGAIN]


def test_compare_and_the_report_say_it_too(tmp_path):
    fit, held = plants.two_axes("", 1, "monday"), plants.two_axes("coulomb", 2, "friday")
    assert "another j2.coulomb.fc" in compared(compare([fit], base_model(fit.robot), [held]))
    page = tmp_path / "r.html"
    d = answer("", "coulomb")
    diagnosis_report(d, page)
    shown = page.read_text(encoding="utf-8")
    assert "explains the fitted data, but not joint2 in the held-out data" in shown
    assert "another j2.coulomb.fc" in shown and "Use the model within the range" not in shown


def test_held_out_runs_far_above_their_floor_refute_the_model():
    assert answer("", "coulomb").verdict == answer("", "gain").verdict == "unexplained"
    assert answer("", "").verdict == "adequate"


def test_sessions_do_not_differ_on_joints_that_the_corrected_model_serves():
    """The advice to fit the held-out session too had been the only one of a model at its floor."""
    d = answer("", "coulomb")  # on joint2 alone
    (sentence,) = said(d)
    assert still_differ(d) == d.warnings
    served = replace(d, heldout_floor=10 * d.ladder[-1].heldout.rms)
    assert still_differ(served) == [w for w in d.warnings if w[0] != DIFFER]
    # what to do stands behind the last sentence that is left
    bare = sentence.removesuffix(HELD_OUT_ADVICE).removesuffix(". ")
    one, other = "joint1: it was another one", "joint1"
    two = [
        Note(DIFFER, bare, "joint2", bare, RIG_STATE),
        Note(DIFFER, f"{one}. {HELD_OUT_ADVICE}", other, one),
    ]
    assert still_differ(replace(d, warnings=two)) == [(DIFFER, sentence)]


def test_what_explains_an_error_at_its_floor_in_one_session_is_no_difference():
    """A joint at 1.01 floors: all of the error above the noise was another gain's, and said so."""
    fit, held = plants.two_axes("cogging", 1, "monday"), plants.two_axes("", 2, "friday")
    model = base_model(fit.robot)
    d = replace(answer("cogging", ""), verdict="unexplained")
    first = replace(d, last=d.first)
    pair = _Pair(d.ladder[0].result, d.ladder[0].heldout, hil.fit([held], model))
    ((joint, text),) = _ours(first, pair, [0, 1])
    assert joint == 1 and "cogging would explain 100 %" in text
    floor = replace(d.first.floor, rms=pair.fitted.rms, scale=pair.fitted.rms)
    assert _ours(replace(first, last=replace(d.first, floor=floor)), pair, [0, 1]) == []


def test_the_headline_is_about_the_joint_that_is_worst_now():
    """A name withheld on a joint at its floor came before another one at 18 floors."""
    m = from_diagnosis(answer("", "coulomb"), simulated=False)
    withheld = Finding("cogging", "joint1", 0.2, 2.0, 1.0, 0.1, 0.6, {}, [])
    assert "joint2" in headline(replace(m, partial=[withheld]))


@pytest.mark.slow
def test_without_held_out_sessions_nothing_is_compared():
    run = plants.two_axes("cogging", 1, "monday")
    assert said(diagnose([run], base_model(run.robot))) == []


@pytest.mark.slow
def test_motions_are_foreseen_once_for_all_that_cannot_be_told_apart(monkeypatch):
    d, seen, asked = answer("cogging", ""), [], []
    menu, look = equivalence.choose.menu, equivalence.Planner._look

    def once(question, stage, joint, names):
        seen.append((joint, names))
        return menu(question, stage, joint, names)

    def each(self, among, stage):
        asked.append(among)
        found = look(self, among, stage)
        # what another set has foreseen says the same as what is foreseen for this one alone
        alone = look(equivalence.Planner(self.result, self.evidence), among, stage)
        for ours, theirs in zip(found[0].grams, alone[0].grams, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        return found

    monkeypatch.setattr(equivalence.choose, "menu", once)
    monkeypatch.setattr(equivalence.Planner, "_look", each)
    monkeypatch.setattr(d, "sets", None)
    assert equivalence.sets_of(d)
    assert len(asked) > 1 and len(seen) == len(asked) + len(set(seen))
