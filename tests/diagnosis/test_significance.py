"""Coefficients that chance makes, and those that are there, under white and coloured noise."""

import numpy as np
import plants
import pytest
import scipy.signal

from hil.diagnosis.attribution import by_chance, chance
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.model import Use, Value, base_model
from hil.record.recording import Recording

RUN = plants.two_axes("", 1, "quiet")
WAVE = Use("cogging", ("joint2",), {"fixed_shape": True}, {"j2.cogging.p": Value(3.0)})


def fitted(seed: int, rho: float, size: float) -> FitResult:
    """A wave of some size on joint 2, in noise of 0.02 N m more."""
    white = np.random.default_rng(seed).normal(size=RUN.q.shape)
    noise = scipy.signal.lfilter([np.sqrt(1 - rho**2)], [1, -rho], white, axis=0)
    tau = RUN.tau + 0.02 * noise
    tau[:, 1] += size * np.sin(6 * np.pi * RUN.q[:, 1])
    run = Recording("run", "arm", RUN.joints, RUN.t, RUN.q, tau)
    model = base_model(run.robot) + WAVE
    return fit(Problem([run], model.robot), model)


@pytest.mark.parametrize("rho", [0.0, pytest.param(0.98, marks=pytest.mark.slow)])
def test_chance_is_uniform_where_nothing_is_there(rho: float) -> None:
    p = np.array([chance(fitted(s, rho, 0.0), ("cogging", 1)) for s in range(60)])
    for level in (0.1, 0.3, 0.5):
        # three standard errors of a share of 60
        assert abs(np.mean(p < level) - level) < 3 * np.sqrt(level * (1 - level) / 60)


@pytest.mark.parametrize("rho", [0.0, 0.98])
def test_what_is_there_is_no_chance(rho: float) -> None:
    assert not by_chance(fitted(0, rho, 0.02), ("cogging", 1))
    assert not by_chance(fitted(0, rho, 0.02), ("cogging", 0))  # no such term
