"""A name that a function without a name beats is none; one that is right is beaten by none."""

import compare_plants as plants
import numpy as np
import pytest

import hil
from hil.commands.diagnosetext import text
from hil.compare import outdone, words
from hil.compare.analysis import ladder
from hil.compare.findings import Finding
from hil.compare.leftout import Folds
from hil.compare.material import from_diagnosis


def told(run, effect):
    """What would be said if this effect had been named."""
    rungs = hil.add([run], hil.base_model(run.robot), effect)
    d = hil.diagnose([run], hil.base_model(run.robot))
    named = [Finding(effect, "joint1", 1.0, 5.0, 2.0, 0.1, 0.8, {}, [])]
    return outdone.outdone([r.step for r in rungs], named, d.first.floor.rms)


def brake(t, q, v):
    """A magnet that brakes where it is: drag over a place."""
    return 0.25 * v * np.exp(-(((q - 0.3) / 0.35) ** 2))


@pytest.mark.parametrize("effect", ["load-friction", "quadratic-drag", "position-torque"])
def test_a_wrong_law_is_beaten_by_a_function(effect):
    (found,) = told(plants.axis(1, extra=brake), effect)
    assert found.joint == "joint1" and found.text.startswith(f"joint1: {effect} would explain ")
    assert "a function of its position and speed" in found.text
    best = max(found.shares, key=lambda s: s.share)
    assert best.feature == "network: q,qd of joint1" and best.share > 0.9


@pytest.mark.parametrize(
    ("effect", "extra"),
    [
        ("quadratic-drag", lambda t, q, v: 0.2 * v * abs(v)),
        ("position-torque", lambda t, q, v: 0.1 * q * q),
        ("stribeck", lambda t, q, v: 0.15 * np.sign(v) / (1 + (v / 0.1) ** 2)),
        ("end-stop", lambda t, q, v: 4.0 * max(q - 0.6, 0.0) ** 1.3),
    ],
)
def test_the_law_itself_is_beaten_by_none(effect, extra):
    assert told(plants.axis(1, extra=extra), effect) == []


def test_of_what_is_beaten_the_answer_says_so(monkeypatch):
    run = plants.axis(2, extra=lambda t, q, v: 0.2 * v * abs(v))
    model = hil.base_model(run.robot)
    assert hil.diagnose([run], model).verdict == "missing-effect"
    shares = [outdone.Share("joint1", "network: t", 0.9, "joint1: any function of time", "time")]
    sentence = "joint1: quadratic-drag would explain 40 % and a function 90 %"
    beaten = outdone.Outdone("joint1", shares, sentence)
    monkeypatch.setattr("hil.compare.outdone.outdone", lambda *a: [beaten])
    d = hil.diagnose([run], model)
    assert d.verdict == "unexplained" and not d.findings and d.network == shares
    assert [f.effect for f in d.partial] == ["quadratic-drag"]
    shown = text(d, ladder(d))
    assert (
        "quadratic-drag on joint1 (a function without a name explains more)" in shown
        and sentence in shown
    )
    assert any(
        "a function without a name explains more" in x for x in words.details(from_diagnosis(d))
    )


def test_what_acts_at_one_place_of_the_recording_alone_is_not_to_be_learnt_elsewhere():
    run = plants.axis(1, extra=lambda t, q, v: 4.0 * max(q - 0.6, 0.0) ** 1.3)
    d = hil.diagnose([run], hil.base_model(run.robot))
    (stop,), last = d.findings, d.ladder[-1].result
    j, fold = 0, Folds(last).fold
    assert not outdone._alone(last, stop, j, fold)
    own = [k for k, name in enumerate(last.names) if name in stop.parameters]
    acts = np.any(last.x.reshape(-1, last.x.shape[1])[:, own] != 0, axis=1)
    assert outdone._alone(last, stop, j, np.where(acts, 0, fold))
