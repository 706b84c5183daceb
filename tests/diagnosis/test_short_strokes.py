"""Strokes of a millimetre, of which the numbers are small in SI units."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil


def coil(seed: int) -> hil.Recording:
    """A chirp of two millimetres of a stage on a flexure: 0.45 kg, 4 N s/m, 900 N/m."""
    t = np.arange(0, 8, 5e-4)
    rate, phase = 1 + 3 * t, 2 * np.pi * (t + 1.5 * t**2)
    q = 2e-3 / (1 + (rate / 10) ** 2) * np.sin(phase)
    v = np.gradient(q, t)
    effort = 0.45 * np.gradient(v, t) + 4 * v + 900 * q
    noise = 0.02 * np.std(effort) * np.random.default_rng(seed).normal(size=t.size)
    return plants.single("coil", t, np.round(q / 5e-8) * 5e-8, effort + noise)


@pytest.mark.parametrize(("unit", "names"), [("rad", {"spring", "unbalance"}), ("m", {"spring"})])
def test_a_spring_over_a_short_stroke_is_one(unit, names):
    """Beside its rest position its stiffness is small: it was taken for part of the offset."""
    run = replace(coil(1), metadata={"unit": unit})
    d = hil.diagnose(run, hil.base_model(run.robot))
    (found,) = d.findings
    # over so small an angle a weight is a spring
    assert {found.effect, *found.rivals} == names
    fitted = hil.fit(run, hil.base_model(run.robot) + "spring")
    assert fitted.values["j1.spring.k"].value == pytest.approx(900, rel=0.01)
    assert d.ladder[-1].heldout.relative[0] < 1.1 * fitted.relative[0]
