"""The search end to end on axes whose truth is known."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import plants
import pytest

import hil
from hil.bench.diagnosis import cases, runner
from hil.commands.diagnose import short
from hil.diagnosis import rules
from hil.diagnosis.evidence import terms_to_try
from hil.diagnosis.verbs import ladder
from hil.models.kernels import dahl_state
from hil.models.model import Use, base_model
from hil.report.data import Files, from_diagnosis
from hil.report.text import details


def said(run, *more, holdout=None):
    model = hil.base_model(run.robot)
    for name in more:
        model = model + name
    return hil.diagnose([run], model, holdout)


def named(d):
    return [f.effect for f in d.findings]


def test_nothing_hidden_is_adequate_with_any_offset():
    assert said(plants.smooth_axis(1)).verdict == "adequate"


def test_what_is_less_than_efforts_are_known_to_is_no_effect():
    quiet = plants.smooth_axis(1, noise=1e-5, extra=lambda t, q, v, a: 2e-4 * np.sin(9 * q))
    assert said(quiet).verdict == "adequate"


def test_one_effect_is_named_and_the_error_falls_to_the_floor():
    d = said(
        plants.smooth_axis(
            2, extra=lambda t, q, v, a: 0.15 * np.exp(-((v / 0.4) ** 2)) * np.tanh(v / 0.02)
        )
    )
    assert d.verdict == "missing-effect" and named(d) == ["stribeck"]
    assert d.ladder[-1].heldout.rms[0] < 1.15 * d.noise[0]


def test_the_search_ends_where_no_fit_holds(monkeypatch):
    """What was fitted and did not hold is not tried again, whichever rule is asked or not."""
    asked = []

    def never(case):
        asked.append(case.rated.candidate.term.key)
        return "nothing holds"

    monkeypatch.setattr(rules, "FIT", {"never": never})
    d = said(
        plants.smooth_axis(
            2, extra=lambda t, q, v, a: 0.15 * np.exp(-((v / 0.4) ** 2)) * np.tanh(v / 0.02)
        )
    )
    assert asked and len(asked) == len(set(asked))
    assert d.verdict == "unexplained" and not d.findings


def test_a_second_effect_is_judged_by_what_is_left_now():
    """A spring of a twentieth of the first effect's power is named all the same."""

    def extra(t, q, v, a):
        return 0.12 * q + 0.25 * np.abs(v)

    d = said(plants.smooth_axis(3, extra=extra))
    assert set(named(d)) == {"asymmetric-viscous", "spring"}


@pytest.mark.slow
def test_what_did_not_hold_may_hold_beside_a_larger_model(monkeypatch):
    """The first of two effects that is asked holds beside the other one alone: it comes second."""
    asked = []

    def extra(t, q, v, a):
        return 0.2 * np.sin(9 * q) + 0.15 * np.abs(v)

    def alone(case):
        asked.append(case.rated.candidate.term.effect.name)
        others = {"cogging", "asymmetric-viscous"} - {asked[0]}
        terms = {t.effect.name for t in case.after.result.terms}
        return "only beside the other one" if asked[-1] == asked[0] and others - terms else ""

    monkeypatch.setitem(rules.FIT, "alone", alone)
    d = said(plants.smooth_axis(3, extra=extra))
    assert asked.count(asked[0]) == 2
    assert set(named(d)) == {"asymmetric-viscous", "cogging"}


def test_the_weight_of_an_axis_without_a_description_is_no_spring():
    """The commonest bench: one axis with a load beside it, swung through half a turn and more."""

    def weight(t, q, v, a):
        return 0.8 * np.sin(1.0 + q)

    run = plants.smooth_axis(3, extra=weight)
    assert np.ptp(run.q) > 2.0
    d = said(run)
    assert named(d) == ["unbalance"] and d.findings[0].confidence > 0.9
    size = [v.value for v in d.findings[0].parameters.values()]
    assert np.hypot(*size) == pytest.approx(0.8, rel=0.02)


@pytest.mark.slow
def test_what_replaces_friction_has_the_shape_that_does_most_in_its_place():
    """Beside Coulomb friction the best shape of presliding is another one, and worth nothing."""
    pytest.importorskip("mujoco")
    case = next(
        c for c in cases.mujoco_plan(True, cases.SEEDS_PER_CASE) if "presliding@1x1.5" in c.name
    )
    train, holdout = runner.recordings(case)
    d = hil.diagnose(train, cases.suspected(case, train[0].robot), holdout)
    assert named(d) == ["presliding"]


@pytest.mark.slow
def test_friction_with_load_is_a_level_of_the_state_that_presliding_has():
    """Loops whose size follows an external load: a hysteresis and a level, not two frictions."""

    def push(t, q, v):
        return 1.5 * np.sin(0.9 * t) ** 2 * np.sign(np.sin(0.23 * t))

    def extra(t, q, v, a):
        z = dahl_state(np.ascontiguousarray(q), 0.08)
        load = 0.1 * a - push(t, q, v)
        return (0.4 + 0.3 * np.abs(load)) * z - 0.3 * np.tanh(v / 0.02)

    d = said(plants.smooth_axis(4, seconds=40.0, push=push, extra=extra))
    assert named(d)[:2] == ["presliding", "load-friction"]
    mu = next(f for f in d.findings if f.effect == "load-friction").parameters
    assert mu["j1.load-friction.mu"].value == pytest.approx(0.3, rel=0.15)


def test_the_ladder_never_rises_and_its_last_model_is_what_is_written():
    run, other = (
        plants.smooth_axis(5, extra=lambda t, q, v, a: 0.2 * v * np.abs(v)),
        plants.smooth_axis(6),
    )
    d = said(run, holdout=[other])  # the held-out run lacks the effect
    errors = [s.heldout.rms[0] for s in d.ladder]
    assert all(b <= a for a, b in pairwise(errors))
    assert named(d) == []
    assert d.model is d.ladder[-1].result.model


def test_held_out_runs_confirm_a_name():
    def drag(t, q, v, a):
        return 0.2 * v * np.abs(v)

    d = said(plants.smooth_axis(5, extra=drag), holdout=[plants.smooth_axis(6, extra=drag)])
    assert named(d) == ["quadratic-drag"]


def test_a_rule_that_stopped_a_candidate_says_which_and_why():
    """Every stop has a code of the registry, a sentence and its numbers."""
    from hil.diagnosis.grams import split
    from hil.diagnosis.heldout import Examiner
    from hil.diagnosis.search import Search
    from hil.identify.problem import Problem

    run = plants.smooth_axis(1, seconds=15.0)
    problem = Problem([run], run.robot)
    search = Search(problem, split(problem), Examiner(problem, []))
    search.rungs.append(search.rung("base model", hil.base_model(run.robot)))
    search.forward()
    assert search.stops
    for stop in search.stops.values():
        assert stop.code in {**rules.CANDIDATE, **rules.FIT}
        assert stop.reason and stop.evidence["before"] > 0


@pytest.mark.parametrize("code", sorted(rules.CANDIDATE))
def test_a_rule_that_is_off_is_not_asked(code, monkeypatch):
    monkeypatch.setitem(rules.CANDIDATE, code, lambda case: "asked")
    monkeypatch.setattr(rules, "OFF", set(rules.CANDIDATE) - {code})
    case = rules.RuleCase(SimpleNamespace(fired={}), _Rated(), None)  # type: ignore[arg-type]
    assert rules.stopped(case).code == code
    monkeypatch.setattr(rules, "OFF", set(rules.CANDIDATE))
    assert rules.stopped(case) is None


class _Rated:
    before, after, sureness = 1.0, 0.5, 3.0


# ---------------------------------------------------------------------- the external effort


def pushed(scale):
    def push(t, q, v):
        return 1.5 * np.sin(0.9 * t) + 0.5 * np.sin(2.3 * t + 1.0)

    run = plants.smooth_axis(7, push=push)
    return replace(run, tau_ext=scale * run.tau_ext)


def test_an_external_effort_of_the_wrong_sign_is_bad_data_with_the_map_line():
    d = said(pushed(-1.0))
    assert d.verdict == "bad-data"
    assert d.warnings[0][0] == "external-sign" and "tauext1" in d.warnings[0][1]


def test_another_ratio_is_said_and_no_offset_is_named_for_it():
    d = said(pushed(0.4))
    assert "external-ratio" in [code for code, _ in d.warnings]
    assert "torque-offset" not in named(d)


def test_the_right_ratio_needs_no_word():
    d = said(pushed(1.0))
    assert d.verdict == "adequate"
    assert not {"external-ratio", "external-sign"} & {code for code, _ in d.warnings}


def test_several_joints_without_geometry_are_said():
    a, b = plants.smooth_axis(1), plants.smooth_axis(2)
    both = replace(
        a, joints=("joint1", "joint2"), q=np.hstack([a.q, b.q]), tau=np.hstack([a.tau, b.tau])
    )
    assert said(both).warnings[0][0] == "no-geometry"


def sprung_cogging(noise):
    """Two runs of an axis with strong cogging and a weak spring."""

    def extra(t, q, v, a):
        return 0.9 * np.sin(2 * np.pi * 1.9 * q) + 0.15 * q

    return [plants.smooth_axis(seed, 20.0, extra=extra, noise=noise) for seed in (1, 2)]


def test_a_weak_law_of_position_beside_a_strong_wave_is_named_where_noise_is_less():
    """It takes nearly all that is left, down to the floor: more than cogging can be wrong by."""
    run, other = sprung_cogging(0.005)
    found = said(run, holdout=[other])
    assert [len(named(found)), named(found)[0]] == [2, "cogging"]
    assert named(found)[1] in ("spring", "position-torque")
    first, last = (found.ladder[k].heldout.relative[0] for k in (1, -1))
    assert last < first / 5


@pytest.mark.slow
def test_a_correction_is_told_with_the_law_that_would_do_as_much():
    """A spring too weak for a name beside a strong cogging is a hint: it can be tried by hand.

    In a quieter recording it is named, see above.
    """
    run, other = sprung_cogging(0.05)
    found = said(run, holdout=[other])
    assert named(found) == ["cogging"]
    (one,) = found.corrections
    assert one.effect == "correction-position" and one.alike == ("spring", "unbalance")
    typed = Files(("a b.csv",), ("h.csv",), "", "", ("--joints", "1"))
    words = short(found, ladder(found), typed)
    assert "On joint1, spring would explain as much as the correction (as would unbalance" in words
    adds = "hil add spring --joint joint1 --session 'a b.csv' --holdout h.csv --joints 1"
    assert adds in [line.strip() for line in words.splitlines()]
    assert adds in " ".join(details(from_diagnosis(found, simulated=False), typed))
    after = hil.add([run], found.explained.result.model, "spring", holdout=[other])[1]
    assert after.step.heldout.rms[0] < 1.1 * found.ladder[-1].heldout.rms[0]


def test_what_steps_back_behind_another_effect_is_not_tried_again():
    """Internal error: "the model already has 'coupled-transmission' on j2; remove it first"."""
    run = plants.serial_arm(2, 1, seconds=6.0)
    model = base_model(run.robot)
    model = model + Use("coupled-transmission", ("joint1",)) + Use("differential", ("joint1",))
    result = hil.fit([run], model)
    key = ("coupled-transmission", 0)
    assert key not in {t.key for t in result.terms}
    terms, _ = terms_to_try(result)
    assert key not in {t.key for t in terms}
    assert key in {t.key for t in terms_to_try(hil.fit([run], base_model(run.robot)))[0]}
    for t in terms:  # every one that is tried can be added
        assert model + Use(t.effect.name, (run.joints[t.joint],))
