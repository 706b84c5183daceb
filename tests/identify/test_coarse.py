"""A coarse encoder in a velocity loop: the band narrows until the counts are not the message."""

import numpy as np
import plants
import pytest

from hil.diagnosis.engine import diagnose
from hil.identify.bands import CLEAR, choose
from hil.identify.problem import Problem
from hil.models.model import Band, base_model
from hil.record.recording import RobotSource

AXIS = base_model(RobotSource("single-axis"))


@pytest.mark.parametrize("peak", [pytest.param(0.0, marks=pytest.mark.slow), 2.0])
def test_noise_of_two_thousand_counts_gets_no_name(peak: float) -> None:
    d = diagnose([plants.geared_axis(2000, 1, peak)], AXIS, [plants.geared_axis(2000, 2, peak)])
    assert {f.effect for f in d.findings} <= ({"stribeck"} if peak else set())
    assert d.ladder[0].heldout.relative[0] < 5.0  # behind a filter of 25 Hz 22 %


def test_the_band_narrows_only_as_far_as_the_counts_ask() -> None:
    coarse, fine = plants.geared_axis(2000, 1), plants.geared_axis(200_000, 1)
    narrow, wide = (choose([r], Band(), moving=True) for r in (coarse, fine))
    assert narrow.effort < 12.0 <= wide.effort
    assert wide == choose([fine], Band())
    problem = Problem([coarse], AXIS.robot)
    rms = np.sqrt(np.mean(problem.qd**2))
    assert rms > 0.8 * CLEAR * problem.speed_noise[0]
    given = Band(position_hz=75.0, effort_hz=25.0)
    assert choose([coarse], given, moving=True) == choose([coarse], given)
