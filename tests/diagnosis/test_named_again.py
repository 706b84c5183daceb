"""Names that are looked at again: beside later effects, on the edge of a range, between rivals."""

from types import SimpleNamespace

import numpy as np
import pytest

from hil.bench import identify
from hil.bench.diagnosis import runner
from hil.bench.diagnosis.cases import HiddenEffect, SessionCase
from hil.diagnosis.engine import diagnose
from hil.diagnosis.grams import BlockErrors
from hil.diagnosis.naming import _gains
from hil.diagnosis.types import ranking
from hil.identify.problem import Problem
from hil.identify.projector import within
from hil.models import catalogue
from hil.models.effect import refused
from hil.models.model import base_model


def named(*hidden: HiddenEffect, noise: str, excitation: str, seed: int) -> dict[str, set[str]]:
    """Names with their rivals, for effects hidden in a session of the arm."""
    kind = "one" if len(hidden) == 1 else "two"
    train, other = runner.recordings(SessionCase(kind, "arm", hidden, noise, excitation, seed))
    found = diagnose(train, base_model(train[0].robot), other).findings
    return {f.effect: {f.effect, *f.rivals} for f in found}


@pytest.mark.slow
def test_forms_that_only_a_later_effect_tells_alike_are_rivals():
    # beside a missing torque over position a lag fits better than the delay that it is
    late, torque = HiddenEffect("delay", 1, 5.0), HiddenEffect("position-torque", 1, 5.0)
    found = named(late, torque, noise="white", excitation="strokes", seed=102)
    assert len(found) == 2 and "position-torque" in found
    assert any({"delay", "actuator-lag"} <= names for names in found.values())


@pytest.mark.slow
def test_a_later_effect_on_the_joint_may_change_the_name_of_the_first():
    stop, slow = HiddenEffect("end-stop", 2, 5.0), HiddenEffect("stribeck", 2, 5.0)
    found = named(stop, slow, noise="coloured", excitation="repeated", seed=100)
    assert set(found) == {"end-stop", "stribeck"}


@pytest.mark.slow
def test_a_scale_on_the_edge_is_a_name_where_next_to_nothing_is_left():
    wobble = HiddenEffect("encoder-eccentricity", 0, 5.0)
    assert set(named(wobble, noise="white", excitation="repeated", seed=0)) == {wobble.effect}


@pytest.mark.parametrize("bound", [0.9, 1.1])
def test_a_coefficient_on_its_bound_is_within_it_in_any_unit(bound: float) -> None:
    delay = catalogue.get("delay")
    for unit in np.geomspace(1e-3, 1e3, 997):
        assert within(delay, np.array([bound * unit]) / unit)
        assert not within(delay, np.array([bound + np.copysign(1e-6, bound - 1)]))


@pytest.mark.slow
def test_offsets_of_all_joints_are_the_base_models() -> None:
    train, other = (
        identify.simulate_run(15.0, seed, False).recording(f"run{seed}") for seed in (1, 2)
    )
    found = diagnose([train], base_model(train.robot), [other])
    assert found.verdict == "adequate"
    without = diagnose([train], base_model(train.robot) - "torque-offset", [other])
    # on a joint without friction of its own an offset and unequal friction are one
    assert without.findings
    assert all("torque-offset" in (f.effect, *f.rivals) for f in without.findings)


def test_of_equal_scores_the_one_with_less_to_fit_comes_first() -> None:
    scores = ((206178.2, 7), (206164.2, 1), (206211.2, 1), (206204.1, 2), (206900.0, 3))
    order = sorted(scores, key=lambda x: ranking(SimpleNamespace(score=x[0], dof=x[1])))
    assert order == [scores[4], scores[2], scores[1], scores[3], scores[0]]


@pytest.mark.parametrize(("share", "rival"), [(0.99, False), (0.9, True), (1.1, False)])
def test_a_law_that_contains_the_named_one_is_a_rival_if_it_foretells_more_by_what_is_worth_a_name(
    share: float, rival: bool
) -> None:
    """A polynomial over the position follows a pure sine, and a little of what others leave."""
    left = np.random.default_rng(1).uniform(0.9, 1.1, (96, 1))
    count = np.ones_like(left)
    now = SimpleNamespace(errors=BlockErrors(left, count))
    search = SimpleNamespace(problem=SimpleNamespace(holds=np.array([False])), now=now, moves=[0])
    assert _gains(search, BlockErrors(share * left, count)) == rival


@pytest.mark.slow
@pytest.mark.parametrize("gain", [1.1, 1.25])
def test_a_gain_of_one_joint_is_not_that_of_the_one_that_fails_most(gain: float) -> None:
    train, other = (
        identify.simulate_run(15.0, seed, False).recording(f"run{seed}") for seed in (1, 2)
    )
    for run in (train, other):
        # the last motor gives more than it is told to; the error is largest on the joint before it
        run.tau[:, 2] /= gain
    found = diagnose([train], base_model(train.robot), [other])
    # gains of the two other motors do as much, with masses that are all a tenth from the described
    assert found.verdict == "missing-effect"
    assert {(f.effect, f.joint) for f in found.findings} == {("torque-gain", "fore")}
    assert not found.findings[0].rivals
    assert np.all(found.ladder[-1].heldout.rms < 1.1 * found.noise)


@pytest.mark.parametrize("effect", ["spring", "position-torque"])
def test_what_does_not_vary_over_the_range_is_an_offset(effect: str) -> None:
    train = identify.simulate_run(10.0, 1, False).recording("run")
    motion = Problem([train], train.robot).motions[0]
    one, more = catalogue.get(effect), 6 if effect == "position-torque" else 1
    flat, sure = [0.0005] * more, [1e-4] * more
    values = [0.1, *flat] if more > 1 else [*flat, 0.1]
    errors = [1e-4, *sure] if more > 1 else [*sure, 1e-4]
    assert refused(one, motion, 0, (), values, errors)
    # what the data hardly see may vary
    errors = [1e-4, *([0.1] * more)] if more > 1 else [0.1, 1e-4]
    assert not refused(one, motion, 0, (), values, errors)


@pytest.mark.slow
def test_a_round_of_the_fit_that_a_bound_denies_is_taken_back() -> None:
    """Without the bounds a smaller exponent leaves less, beside a friction below zero."""
    bend = HiddenEffect("sublinear-viscous", 2, 5.0)
    assert set(named(bend, noise="white", excitation="strokes", seed=2)) == {bend.effect}
