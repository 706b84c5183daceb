"""What is less than a percent of the effort needs a sure name, or the model is adequate."""

from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis import engine
from hil.diagnosis.constants import ADEQUATE
from hil.diagnosis.engine import HARDLY, UNMOVED, UNSURE
from hil.diagnosis.floor import alarming, practical
from hil.diagnosis.types import Finding
from hil.diagnosis.verdict import alarms
from hil.models.parts import AT_AN_INSTANT, NEVER


def searched(accuracy=0.0, explains="motor"):
    problem = SimpleNamespace(accuracy=accuracy, joints=("a", "b"))
    now = SimpleNamespace(result=SimpleNamespace(model=SimpleNamespace(explains=explains)))
    keys = [set(), {("presliding", 0)}]
    rungs = [SimpleNamespace(keys=k, step=SimpleNamespace(result=i)) for i, k in enumerate(keys)]
    return SimpleNamespace(problem=problem, now=now, rungs=rungs, stands_for={})


def found(before, after, confidence, joint="a", rivals=(), variation=NEVER):
    own, *others = (
        SimpleNamespace(
            term=SimpleNamespace(
                key=("presliding", 0),
                shape=(),
                per_run=False,
                joint=j,
                effect=SimpleNamespace(
                    relations=SimpleNamespace(causes=causes), variation=variation
                ),
            )
        )
        for causes, j in [(("lateness",), 0), *rivals]
    )
    name = SimpleNamespace(candidate=own, rivals=others)
    return Finding(
        "presliding", joint, confidence, before, after, 0.0, 1.0, {}, [], "as well"
    ), name


def sized(some, search, monkeypatch, worse=False, better=False):
    step = SimpleNamespace(rises=lambda _, j, factor: worse if factor == ADEQUATE else better)
    monkeypatch.setattr(engine.multistep, "each", lambda results, problem: [step, step])
    every, named = zip(*some, strict=True)
    return engine._of_no_size(list(every), list(named), search)


@pytest.mark.parametrize(
    ("before", "after", "confidence", "worse", "why"),
    [
        (0.9, 0.3, 0.5, False, UNSURE),  # little, and perhaps something else
        (0.9, 0.3, 1.0, False, ""),  # little, sure, and the arm moves by it
        (0.9, 0.3, 1.0, True, UNMOVED),  # little, and the arm does not move by it
        (1.3, 0.3, 0.5, False, ""),  # of size
        (1.3, 0.3, 1.0, True, ""),  # of size: a simulation is no veto
    ],
)
def test_a_little_effect_needs_a_sure_name(monkeypatch, before, after, confidence, worse, why):
    """Clean arms whose sharp friction a filter blurs had a cable or a gear at up to 1.00."""
    (f,) = sized([found(before, after, confidence)], searched(), monkeypatch, worse)
    assert f.of_no_size is bool(why)
    assert f.reason == (why.format(1.0) if why else "as well")
    verdict = engine._verdict([], [f], False)
    assert verdict == ("adequate" if why else "unexplained")


def test_an_effect_that_the_arm_moves_by_is_there_whatever_its_name(monkeypatch):
    """A gain of a tenth: 0.79 % of the effort, and 12.6 -> 1.2 % of the simulated motion."""
    (f,) = sized([found(0.79, 0.12, 0.52)], searched(), monkeypatch, better=True)
    assert not f.of_no_size


def test_what_the_left_out_data_hardly_show_has_no_name(monkeypatch):
    """A cable of 0.44 -> 0.41 % at 1.00 beside a motor that saturates on another joint."""
    (f,) = sized([found(0.44, 0.41, 1.0)], searched(), monkeypatch, better=True)
    assert f.of_no_size and f.reason == HARDLY
    # by more than a tenth they show it, however little it is
    (f,) = sized([found(0.22, 0.09, 1.0)], searched(), monkeypatch)
    assert not f.of_no_size
    # what acted at an instant of a fitted run is not to be seen elsewhere
    (f,) = sized([found(0.44, 0.44, 1.0, variation=AT_AN_INSTANT)], searched(), monkeypatch)
    assert not f.of_no_size


@pytest.mark.parametrize(
    ("rivals", "size"),
    [
        ([(("lateness",), 0)], False),  # a delay or a lag: late it is
        ([(("lateness",), 1)], True),  # of another joint
        ([(("lateness",), 0), (("resonance",), 0)], True),
        ([], True),  # none, and not sure for another reason
    ],
)
def test_rivals_of_one_cause_leave_no_doubt_of_it(monkeypatch, rivals, size):
    """A delay of three samples beside stiction, or a lag of one pole, at even odds."""
    (f,) = sized([found(0.9, 0.3, 0.5, rivals=rivals)], searched(), monkeypatch)
    assert f.of_no_size is size


def test_several_little_effects_of_a_joint_are_one_of_size(monkeypatch):
    two = [found(0.9, 0.1, 0.5), found(0.9, 0.1, 0.5)]
    assert not any(f.of_no_size for f in sized(two, searched(), monkeypatch))
    apart = [found(0.9, 0.1, 0.5), found(0.9, 0.1, 0.5, "b")]
    assert all(f.of_no_size for f in sized(apart, searched(), monkeypatch))


def test_what_the_user_says_of_the_efforts_counts(monkeypatch):
    assert alarming(SimpleNamespace(accuracy=0.0)) > practical(SimpleNamespace(accuracy=0.0))
    assert alarming(SimpleNamespace(accuracy=0.05)) == practical(SimpleNamespace(accuracy=0.05))
    (f,) = sized([found(4.0, 1.0, 0.5)], searched(accuracy=0.05), monkeypatch)
    assert f.of_no_size and f.reason == UNSURE.format(5.0)


def test_a_law_of_contact_has_no_motion_to_be_simulated(monkeypatch):
    (f,) = sized([found(0.9, 0.3, 1.0)], searched(explains="external"), monkeypatch, worse=True)
    assert not f.of_no_size
    (f,) = sized([found(0.9, 0.3, 1.0, None)], searched(), monkeypatch, worse=True)
    assert not f.of_no_size


def test_joints_alarm_from_a_percent_on():
    """A third of a percent above the floor was *unexplained*."""
    problem = SimpleNamespace(
        accuracy=0.0, effort=np.ones((2, 1)), rms=lambda x: x[:, 0], holds=np.zeros(2, dtype=bool)
    )
    result = SimpleNamespace(rms=np.array([0.005, 0.02]), problem=problem)
    assert alarms(result).tolist() == [False, True]
