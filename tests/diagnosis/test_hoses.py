"""A hose, a cable or a muscle over two joints pulls on both: the slope of one energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.columns import mistaken
from hil.record.recording import Recording
from hil.report.effects import learnt, stretch

#: Stiffness of the hose of the tests at rest [N m/rad].
K = 1.0


def hosed(seed: int, ratio: float, stiffens: float = 0.0, k: float = K) -> Recording:
    """Three joints under gravity; the hose lies along the second and the third."""
    run = plants.serial_arm(3, seed, seconds=30.0)
    d = run.q[:, 1] + ratio * run.q[:, 2] - 0.2
    pull = k * (d + stiffens * d**3)
    tau = run.tau.copy()
    tau[:, 1] += pull
    tau[:, 2] += ratio * pull
    return replace(run, tau=tau)


@pytest.mark.parametrize(
    ("ratio", "stiffens"), [(-0.8, 1.2), plants.further(0.7, 0.0), plants.further(0.7, 0.6)]
)
def test_a_hose_over_two_joints_is_one_name(ratio, stiffens) -> None:
    """It was a spring of -0.5 N m/rad beside gravity, or another torque constant of a third joint.

    Sought on one joint at a time neither half of it gains anything: gravity follows the other one.
    """
    run, other = (hosed(seed, ratio, stiffens) for seed in (1, 2))
    d = hil.diagnose([run], hil.base_model(run.robot), [other])
    (found,) = d.findings
    assert (found.effect, found.joint) == ("coupled-spring", "joint2") and found.confidence > 0.9
    values = found.parameters
    assert values["j2.coupled-spring.joint"].value == 3.0
    assert values["j2.coupled-spring.r"].value == pytest.approx(ratio, abs=0.02)
    if not stiffens:
        assert values["j2.coupled-spring.k"].value == pytest.approx(K, rel=0.1)
    assert np.all(d.ladder[-1].heldout.rms < 1.2 * d.noise)
    drawn = stretch(d.result, learnt(d.result, "coupled-spring", "joint2"))
    sign = "+" if ratio > 0 else "\u2212"
    assert drawn.label.startswith(f"position of joint2 {sign} 0.")
    np.testing.assert_allclose(
        drawn.x, d.result.problem.q[1] + values["j2.coupled-spring.r"].value * d.result.problem.q[2]
    )


def test_efforts_are_not_exchanged_where_more_than_half_of_them_is_left() -> None:
    """A strong hose was bad data, though an exchange left 55 and 59 % of the efforts."""
    run = hosed(1, -0.8, 1.2, k=4.0)
    said = mistaken(hil.fit([run], hil.base_model(run.robot)), [run])
    assert "swapped" not in {code for code, _ in said}


@pytest.mark.parametrize("axes", [("0 0 1", "1 0 0"), ("0 1 0", "1 0 0")])
@pytest.mark.parametrize("k", [1.0, 4.0])
def test_a_hose_over_both_joints_is_no_gravity_from_another_side(axes, k) -> None:
    """It was bad data, with a gravity to write that pulled upwards."""
    run = plants.serial_arm(2, 1, axes=axes, seconds=20.0)
    pull = k * (run.q[:, 0] + 0.6 * run.q[:, 1])
    sprung = replace(run, tau=run.tau + np.outer(pull, [1.0, 0.6]))
    assert mistaken(hil.fit([sprung], hil.base_model(run.robot)), [sprung]) == []


@pytest.mark.parametrize(
    ("gravity", "told"), [("0 9.81 0", "description-gravity"), ("9.81 0 0", "posture")]
)
def test_a_gravity_from_another_side_is_still_told_without_a_hose(gravity, told) -> None:
    run = plants.serial_arm(2, 1, axes=("0 1 0", "1 0 0"), seconds=20.0)
    described = run.robot.urdf.replace("<link", f"<gravity>{gravity}</gravity><link", 1)
    wrong = replace(run, robot=replace(run.robot, urdf=described))
    ((code, _),) = mistaken(hil.fit([wrong], hil.base_model(wrong.robot)), [wrong])
    assert code == told
