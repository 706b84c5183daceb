"""Which candidates look alike beside what the model has already."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.attribution import overlap
from hil.diagnosis.equivalence import sets_of
from hil.diagnosis.evidence import gather
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.model import base_model


@pytest.fixture(scope="module")
def evidence():
    run = plants.smooth_axis(2, seconds=20.0, rate=250.0, extra=lambda t, q, v, a: 0.12 * q)
    model = base_model(run.robot)
    return gather(fit(Problem([run], model.robot), model))


@pytest.mark.parametrize("other", ["unbalance", "position-torque"])
def test_a_column_that_the_model_holds_tells_nothing_apart(evidence, other):
    """The spring's second column is the offset that the model has: it leaves rounding alone."""
    found = {c.name: c for c in evidence.candidates}
    assert overlap(found["spring"], found[other], evidence.projector) > 0.99


def test_a_wave_is_no_spring(evidence):
    found = {c.name: c for c in evidence.candidates}
    assert overlap(found["spring"], found["cogging"], evidence.projector) < 0.9


def upwards(seed: int, speed: float) -> hil.Recording:
    """A screw that is driven one way at one speed; its friction rises towards rest."""
    t, rng = np.arange(0, 20, 0.002), np.random.default_rng(seed)
    v = speed * (1 + 0.05 * np.sin(2 * np.pi * 0.4 * t + seed))
    q = np.cumsum(v) * 0.002
    tau = 2 * np.gradient(v, t) + 14 + 12 * np.exp(-v / 0.008) + 40 * v
    noisy = tau + 0.05 * rng.normal(size=t.size)
    run = plants.single(f"up{seed}", t, np.round(q / 1e-6) * 1e-6, noisy)
    return replace(run, metadata={"unit": "m"})


def test_a_motion_tells_a_law_from_values_of_every_run() -> None:
    """In one planned run an offset of every run is the model's own: no motion was said to do."""
    runs = [upwards(1, 0.004), upwards(2, 0.009)]
    d = hil.diagnose(runs, hil.base_model(runs[0].robot))
    (found,) = d.findings
    assert {found.effect, *found.rivals} == {"stribeck", "torque-offset"}
    (both,) = (s for s in sets_of(d) if set(s.effects) == {"stribeck", "torque-offset"})
    assert "no motion" not in both.experiment and "--for" in both.command
