"""Gains and offsets of an arm with two joints: what the data cannot tell is said, not guessed."""

from dataclasses import replace
from functools import cache

import numpy as np
import plants
import pytest

import hil
from hil import work
from hil.diagnosis.residual_tests import changes
from hil.diagnosis.verbs import ladder


@cache
def diagnosed(elbow: float):
    """A run whose elbow has a gain, and its answer in one thread; several tests look at it."""
    run = plants.planar(1, gain=(1.0, elbow))
    with work.on_one_thread():
        return run, hil.diagnose([run], hil.base_model(run.robot))


@pytest.fixture
def gained():
    return diagnosed(1.2)


def test_with_nothing_hidden_the_model_is_adequate():
    assert diagnosed(1.0)[1].verdict == "adequate"


@pytest.mark.slow
@pytest.mark.parametrize("joint", ["shoulder", "elbow"])
def test_of_two_gains_the_one_is_named_beside_which_the_links_are_as_described(gained, joint):
    """The data know their ratio alone: without a look at the description each had even odds."""
    d = gained[1] if joint == "elbow" else of_shoulder()
    (f,) = d.findings
    assert (d.verdict, f.effect, f.joint) == ("missing-effect", "torque-gain", joint)
    assert f.confidence > 0.95 and not f.rivals
    g = next(v.value for n, v in f.parameters.items() if n.endswith(".g"))
    assert g == pytest.approx(0.2, rel=0.05)


def of_shoulder():
    run = plants.planar(1, gain=(1.2, 1.0))
    return hil.diagnose([run], hil.base_model(run.robot))


def test_every_rung_is_simulated_with_its_own_load(gained):
    run, d = gained
    last = ladder(d)[-1].multi_step
    again = hil.compare([run], d.model).multi_step
    assert last.relative == pytest.approx(again.relative, rel=0.35)
    assert np.all(last.relative < ladder(d)[0].multi_step.relative)


def test_a_rotor_that_turns_with_two_joints_is_named_with_its_ratio():
    """A wrist's differential; its inertia is one with those of the joints, its friction is not."""
    run, other = (plants.planar(k, seconds=12.0, shared=(0.02, 0.06)) for k in (1, 2))
    d = hil.diagnose([run], hil.base_model(run.robot), [other])
    (f,) = d.findings
    assert (d.verdict, f.effect, f.joint) == ("missing-effect", "coupled-transmission", "shoulder")
    values = {k.rsplit(".")[-1]: v.value for k, v in f.parameters.items()}
    assert (values["joint"], values["r"]) == (2.0, -1.0)
    assert values["fc"] == pytest.approx(0.06, rel=0.15)
    assert np.all(d.ladder[-1].heldout.rms < 1.1 * d.noise)


def test_an_offset_is_no_change_at_the_beginning():
    run = plants.planar(1, offset=(0.3, -0.2))
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert not changes(d.ladder[0].result)
    assert not [text for code, text in d.warnings if code == "changed"]


@pytest.mark.slow
def test_an_offset_in_both_runs_is_told_from_friction_that_differs_by_direction():
    runs = [plants.planar(k, offset=(0.0, -0.2)) for k in (1, 2)]
    d = hil.diagnose(runs, hil.base_model(runs[0].robot) - "torque-offset")
    (f,) = d.findings
    assert (f.joint, f.effect) == ("elbow", "torque-offset") and f.confidence > 0.9
    assert d.ladder[-1].heldout.relative[1] < 0.3


def test_exchanged_efforts_are_bad_data():
    run = plants.planar(1)
    d = hil.diagnose([replace(run, tau=run.tau[:, ::-1])], hil.base_model(run.robot))
    assert d.verdict == "bad-data" and "tau1 and tau2 (shoulder, elbow) are swapped" in str(
        d.warnings
    )


@pytest.mark.slow
@pytest.mark.parametrize("elbow", [1.0, 1.2])
def test_what_is_found_does_not_depend_on_the_threads(elbow, monkeypatch):
    run, one = diagnosed(elbow)
    monkeypatch.setattr(work, "LONG", 0)
    monkeypatch.setattr(work, "threads", lambda: 2)
    two = hil.diagnose([run], hil.base_model(run.robot))
    assert one.verdict == two.verdict
    assert [(f.effect, f.joint) for f in one.findings] == [
        (f.effect, f.joint) for f in two.findings
    ]
    for a, b in zip(one.first.candidates, two.first.candidates, strict=True):
        assert (a.term.key, a.term.shape, a.p_value) == (b.term.key, b.term.shape, b.p_value)
        assert a.gain == pytest.approx(b.gain, rel=1e-9, abs=1e-9)
