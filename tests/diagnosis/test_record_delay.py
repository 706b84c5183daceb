"""The effort of one joint that was recorded late, beside others that were in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.record.recording import Recording


def recorded_late(samples: tuple[int, int], seed: int = 1) -> Recording:
    """`two_axes` whose efforts were recorded some samples of 2 ms after they acted, by joint."""
    run, n = plants.two_axes("", seed, "late"), max(samples)
    tau = np.stack([run.tau[n - k : len(run.t) - k, j] for j, k in enumerate(samples)], axis=1)
    return replace(run, t=run.t[n:] - run.t[n], q=run.q[n:], tau=tau)


@pytest.mark.parametrize(
    ("samples", "seed"), [((0, 6), 1), pytest.param((4, 0), 2, marks=pytest.mark.slow)]
)
def test_an_effort_that_one_joint_records_late_has_a_name(samples, seed):
    """It was unexplained, with a damped mode that would do most: no delay goes that way."""
    run = recorded_late(samples, seed)
    d = hil.diagnose([run], hil.base_model(run.robot))
    (found,) = d.findings
    j = int(np.argmax(samples))
    assert (found.effect, found.joint) == ("record-delay", f"joint{j + 1}")
    assert found.confidence > 0.95
    late = found.parameters[f"j{j + 1}.record-delay.T"].value
    assert late == pytest.approx(0.002 * samples[j], rel=0.1)


@pytest.mark.slow
def test_efforts_that_all_joints_record_late_are_the_recordings():
    run = recorded_late((6, 6))
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert not any(f.effect == "record-delay" for f in d.findings)
    assert d.result.problem.alignment.late == pytest.approx(0.012, rel=0.1)


@pytest.mark.slow
def test_a_command_that_acts_late_is_no_late_record():
    run = plants.late_axes((0, 6))
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert {f.effect for f in d.findings} <= {"delay", "actuator-lag"}
    assert d.findings[0].joint == "joint2"
