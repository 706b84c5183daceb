"""An amplifier at its limit and one that leaks, hidden in plants of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.identify.problem import Problem
from hil.models.catalogue import get
from hil.models.effect import refused
from hil.record.recording import Recording


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


def _weighted(seed: int, command) -> Recording:
    """A pendulum; `command` is what the amplifier is told to give an effort."""
    run = plants.smooth_axis(seed, extra=lambda t, q, v, a: 0.8 * np.sin(q), noise=0.005)
    return replace(run, tau=command(run.tau))


def _gradually(effort: np.ndarray) -> np.ndarray:
    """Command u of which 0.12 tanh(u / 0.12) is lost."""
    u = np.linspace(-5.0, 5.0, 20001)
    return np.interp(effort, u - 0.12 * np.tanh(u / 0.12), u)


@pytest.mark.parametrize(
    ("command", "accuracy"),
    # another law than that of the catalogue: it closes gradually
    [
        (lambda u: u + 0.12 * np.sign(u), 0.05),
        plants.further(_gradually, 0.2),
    ],
    ids=["sharp", "gradual"],
)
def test_a_dead_zone_is_named_with_its_width(command, accuracy) -> None:
    train, other = (_weighted(k, command) for k in (3, 4))
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert d.verdict == "missing-effect"
    assert {f.effect for f in d.findings} == {"unbalance", "dead-zone"}
    (zone,) = (f for f in d.findings if f.effect == "dead-zone")
    values = {k.rsplit(".")[-1]: v.value for k, v in zone.parameters.items()}
    # of a joint that never rests no command lies within it: share and width make one step
    assert values["a"] * values["D"] == pytest.approx(0.12, rel=accuracy)


def test_where_friction_is_all_the_effort_a_dead_zone_is_friction() -> None:
    train, other = (plants.axis(k, gives=lambda u: u - min(max(u, -0.1), 0.1)) for k in (3, 4))
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert "dead-zone" not in [f.effect for f in d.findings]


def test_a_command_that_is_always_beyond_it_shows_no_dead_zone() -> None:
    """Of one sign it is an offset."""
    run = plants.smooth_axis()
    motion = Problem([run], run.robot).motions[0]
    assert not refused(get("dead-zone"), motion, 0, (0.3,), (1.0,), (0.1,))
    heavy = motion.with_(tau=motion.tau + 30.0)
    assert refused(get("dead-zone"), heavy, 0, (0.3,), (1.0,), (0.1,))
    pushing = motion.with_(tau=np.abs(motion.tau) * np.sign(motion.qd))
    assert refused(get("dead-zone"), pushing, 0, (0.3,), (1.0,), (0.1,)) == "unbraked"


def test_a_limit_that_is_not_reached_is_not_named() -> None:
    train, other = (plants.axis(k, gives=lambda u: min(max(u, -2.0), 2.0)) for k in (3, 4))
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert d.verdict == "adequate"


@pytest.mark.parametrize(
    ("j", "k", "share"),
    [
        (0, 1, 0.08),
        plants.further(1, 2, -0.1),
        plants.further(2, 1, 0.05),
    ],
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("j", "k"),
    [
        (1, 2),
        (2, 1),
        (0, 1),
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
