"""An amplifier at its limit and one that leaks, hidden in plants of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.identify.problem import Problem
from hil.models.catalogue import get


@pytest.mark.parametrize(
    ("gives", "limit", "order", "accuracy"),
    [
        (lambda u: min(max(u, -1.0), 1.0), 1.0, 0.0, 0.02),
        # another law than any of the catalogue: as steep at zero, a tenth more bent at the top
        (lambda u: 1.5 * np.tanh(u / 1.5), 1.5, 2.0, 0.25),
    ],
    ids=["clips", "bends"],
)
def test_a_limit_is_named_and_found(gives, limit, order, accuracy) -> None:
    train, other = (plants.axis(k, gives=gives) for k in (3, 4))
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert d.verdict == "missing-effect"
    assert [f.effect for f in d.findings] == ["torque-saturation"]
    values = {k.rsplit(".")[-1]: v.value for k, v in d.findings[0].parameters.items()}
    assert values["p"] == order or (order > 0.0 and values["p"] > 0.0)  # either knee is near
    assert values["L"] == pytest.approx(limit, rel=accuracy)
    last = d.ladder[-1].heldout.rms / d.noise
    assert last.max() < 1.1


def test_a_limit_that_is_not_reached_is_not_named() -> None:
    train, other = (plants.axis(k, gives=lambda u: min(max(u, -2.0), 2.0)) for k in (3, 4))
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert d.verdict == "adequate"


@pytest.mark.parametrize(
    ("j", "k", "share"),
    [(0, 1, 0.08), (1, 2, -0.1), pytest.param(2, 1, 0.05, marks=pytest.mark.slow)],
)
def test_a_leak_is_named_with_its_source_and_its_size(j: int, k: int, share: float) -> None:
    def leaks(seed: int):
        run = plants.arm(seed)
        mix = np.eye(3)
        mix[j, k] = share
        return replace(run, tau=run.tau @ np.linalg.inv(mix).T)

    train, other = leaks(1), leaks(2)
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert d.verdict == "missing-effect"
    (found,) = d.findings
    assert (found.effect, found.joint) == ("torque-crosstalk", f"joint{j + 1}")
    values = {key.rsplit(".")[-1]: v.value for key, v in found.parameters.items()}
    assert values["joint"] == k + 1
    assert values["e"] == pytest.approx(share, rel=0.15)


@pytest.mark.parametrize(
    ("j", "k"),
    [
        (1, 2),
        pytest.param(2, 1, marks=pytest.mark.slow),
        pytest.param(0, 1, marks=pytest.mark.slow),
    ],
)
def test_a_hose_between_two_joints_is_no_leak(j: int, k: int) -> None:
    def hose(seed: int):
        run = plants.arm(seed)
        tau = run.tau.copy()
        stretch = 1.5 * run.q[:, k] - 0.8 * run.q[:, j] + 0.2
        tau[:, j] -= 0.8 * 0.02 * stretch * np.abs(stretch)
        tau[:, k] += 1.5 * 0.02 * stretch * np.abs(stretch)
        return replace(run, tau=tau)

    train, other = hose(1), hose(2)
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert d.verdict != "adequate"
    assert "torque-crosstalk" not in [f.effect for f in d.findings]


def test_of_one_motor_nothing_leaks() -> None:
    run = plants.axis(0, seconds=4.0)
    motion = Problem([run], hil.base_model(run.robot).robot).motions[0]
    assert "one joint" in get("torque-crosstalk").scope.lacks(motion, 0)
    assert get("torque-saturation").scope.lacks(motion, 0) == ""
