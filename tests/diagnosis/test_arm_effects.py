"""What a described arm alone can tell: a soft belt, a base on a slope, a hand at the tip."""

from __future__ import annotations

import math

import plants
import pytest

from hil.diagnosis import rules
from hil.diagnosis.engine import diagnose
from hil.models.model import base_model


def _answer(**hidden):
    runs = [plants.spatial(k, **hidden) for k in (1, 2)]
    return diagnose(runs[:1], base_model(runs[0].robot), runs[1:])


@pytest.mark.slow
def test_a_soft_belt_is_named_on_its_joint_and_felt_by_the_others():
    found = _answer(belt=300.0)
    assert [(f.effect, f.joint) for f in found.findings] == [("elastic-transmission", "upper")]
    before, after = found.ladder[0].heldout.rms, found.explained.heldout.rms
    # the third joint moves a link that hangs on the belt: that is in no other effect of the model
    assert all(after[1:] < 0.6 * before[1:])
    assert all(after < 1.2 * found.noise)


@pytest.mark.slow
def test_a_spring_is_as_stiff_in_another_run_in_another_posture():
    """Its rotor is no part of the description, and what swings on it changes with the posture."""
    homes = ((0.0, 0.2, 0.3), (0.0, -0.6, 1.6))
    first, second = (
        plants.spatial(k, belt=60.0, driven=0, home=home) for k, home in enumerate(homes, start=1)
    )
    alone, both = (
        diagnose(runs, base_model(first.robot), held)
        for runs, held in (([first], [second]), ([second], [first]))
    )
    for found in (alone, both):
        assert [(f.effect, f.joint) for f in found.findings] == [("elastic-transmission", "base")]
        values = found.findings[0].parameters
        assert values["j1.elastic-transmission.k"].value == pytest.approx(60.0, rel=0.05)
        before, after = found.ladder[0].heldout.rms, found.explained.heldout.rms
        assert all(after < 0.35 * before)


@pytest.mark.slow
def test_a_play_before_a_link_has_its_motor_on_the_other_side():
    homes = ((0.0, 0.2, 0.3), (0.0, -0.6, 1.6))
    runs = [
        plants.spatial(k, play=0.02, driven=0, rotor=0.25, home=home)
        for k, home in enumerate(homes, start=1)
    ]
    found = diagnose(runs[:1], base_model(runs[0].robot), runs[1:])
    assert [(f.effect, f.joint) for f in found.findings] == [("backlash", "base")]
    values = found.findings[0].parameters
    assert values["j1.backlash.b"].value == pytest.approx(0.02, rel=0.2)
    # the motor's inertia: its rotor's, and what the masses hold of it
    rotor = values["j1.backlash.i"].value + found.model.values()["j1.armature.ia"].value
    assert rotor == pytest.approx(0.25, rel=0.1)
    before, after = found.ladder[0].heldout.rms, found.explained.heldout.rms
    assert all(after < 0.5 * before)


@pytest.mark.slow
def test_a_base_on_a_slope_is_named_with_its_angle():
    found = _answer(tilt=(0.10, -0.06))
    assert [(f.effect, f.joint) for f in found.findings] == [("base-tilt", None)]
    values = found.findings[0].parameters
    assert values["base-tilt.rx"].value == pytest.approx(0.10, abs=0.01)
    assert values["base-tilt.ry"].value == pytest.approx(-0.06, abs=0.01)
    assert all(found.explained.heldout.rms < 1.2 * found.noise)


@pytest.mark.slow
def test_a_cart_that_leans_explains_all_where_masses_are_known_in_combination_alone():
    """Gravity from another side acts on what the level arm does not show, near the first axis."""
    runs = [plants.cart_arm(seed) for seed in (1, 2)]
    found = diagnose(runs[:1], base_model(runs[0].robot), runs[1:])
    assert [(f.effect, f.joint) for f in found.findings] == [("base-tilt", None)]
    assert not found.corrections
    for name, true in (("rx", 0.06), ("ry", -0.035)):
        value = found.findings[0].parameters[f"base-tilt.{name}"]
        assert abs(value.value - true) < 4 * value.stderr + 0.001
    assert all(found.explained.heldout.rms < 1.1 * found.noise)


@pytest.mark.slow
def test_an_arm_that_stands_upright_lacks_neither():
    found = _answer()
    assert found.verdict == "adequate" and not found.findings


def test_the_angle_of_a_base_is_said_in_degrees():
    from hil.models import catalogue

    said = catalogue.get("base-tilt").doc.remark({"rx": math.radians(3), "ry": math.radians(4)}, {})
    assert said == "tilted by 5 degrees"


@pytest.mark.parametrize("d", [3, pytest.param(6, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_hand_at_the_tip_is_named_with_its_stiffness_and_damping(d):
    runs = [plants.serial_arm(d, seed, hand=True) for seed in (1, 2)]
    found = diagnose(runs[:1], base_model(runs[0].robot), runs[1:])
    assert [(f.effect, f.joint) for f in found.findings] == [("tip-impedance", None)]
    _, b, k, rest = plants.HAND
    got = {n: found.findings[0].parameters[f"tip-impedance.{n}"] for n in ("k", "b", "fx", "fy")}
    for name, true in {"k": k, "b": b, "fx": -k * rest[0], "fy": -k * rest[1]}.items():
        assert abs(got[name].value - true) < 3 * got[name].stderr + 0.02 * abs(true)
    assert all(found.explained.heldout.rms < 1.2 * found.noise)


@pytest.mark.slow
def test_a_law_of_posture_is_doubtful_beside_masses_that_are_none(monkeypatch):
    """As of a hand that holds the tip sideways alone: gravity makes up for what the law has not."""
    runs = [plants.serial_arm(3, seed, hand=True) for seed in (1, 2)]
    monkeypatch.setattr(rules, "upwards", lambda result: [2])
    d = diagnose(runs[:1], base_model(runs[0].robot), runs[1:])
    (found,) = d.findings
    assert (found.effect, found.confidence, d.verdict) == ("tip-impedance", 0.5, "ambiguous")
    assert "gravity of joint3 acts upwards" in found.reason


def test_where_a_hand_rests_is_said_if_it_has_a_stiffness():
    from hil.models import catalogue

    remark = catalogue.get("tip-impedance").doc.remark
    values = {"k": 50.0, "b": 2.0, "fx": -10.0, "fy": 0.0, "fz": 5.0}
    assert remark(values, {"k": 1.0}) == "at rest with the tip at (0.2, 0, -0.1) m"
    assert remark(values, {"k": 40.0}) == ""
