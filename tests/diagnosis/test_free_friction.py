"""Grease that thins has a name; what has none leaves the model's values what they mean."""

from __future__ import annotations

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.engine import diagnose
from hil.identify.regression import inflation


def _axis(law, seed):
    return plants.smooth_axis(seed, 20.0, extra=lambda t, q, v, a: law(v), noise=0.005)


def test_grease_that_thins_is_named_with_its_exponent():
    runs = [_axis(lambda v: 1.1 * np.sign(v) * np.abs(v) ** 0.6, k) for k in (1, 2)]
    found = diagnose(runs[:1], hil.base_model(runs[0].robot), runs[1:])
    assert [f.effect for f in found.findings] == ["sublinear-viscous"]
    values = found.findings[0].parameters
    assert values["j1.sublinear-viscous.p"].value == pytest.approx(0.6, abs=0.08)
    assert all(found.explained.heldout.rms < 1.2 * found.noise)


@pytest.mark.slow
def test_friction_that_its_own_losses_warm_away_drifts_with_the_motion():
    runs = [plants.warming_axis(k) for k in (1, 2)]
    found = diagnose(runs[:1], hil.base_model(runs[0].robot), runs[1:])
    assert [f.effect for f in found.findings] == ["friction-drift"]
    values = found.findings[0].parameters
    assert values["j1.friction-drift.of"].value == 2.0
    assert values["j1.friction-drift.T"].value == pytest.approx(12.0, rel=0.3)
    before, after = (found.ladder[k].heldout.relative[0] for k in (0, -1))
    assert after < 0.25 * before


def test_a_correction_leaves_the_offset_and_the_viscous_friction_where_they_were():
    runs = [_axis(lambda v: 0.25 * np.sin(5.0 * v), k) for k in (1, 2)]
    model = hil.base_model(runs[0].robot)
    plain = hil.fit(runs, model)
    free = hil.fit(runs, model + "correction-speed")
    assert free.rms[0] < 0.8 * plain.rms[0]
    for name, most in (("j1.torque-offset.t0", 0.02), ("j1.viscous.fv", 0.3)):
        value = free.values[name]
        # |sgn v| is an offset while the joint moves, and v is viscous friction
        assert abs(value.value - plain.values[name].value) < most
        assert value.identifiable and value.stderr < 2 * most


def test_a_slow_remainder_says_little_of_a_slow_law_and_much_of_a_fast_one():
    rng, n = np.random.default_rng(3), 6000
    slow = np.cumsum(rng.normal(size=n))
    slow -= np.convolve(slow, np.ones(600) / 600, "same")
    run, t = np.zeros(n, dtype=int), np.arange(n)
    whole = inflation(slow, run)
    assert inflation(slow, run, slow) > 0.3 * whole
    assert inflation(slow, run, np.sin(0.5 * t)) < 0.05 * whole


@pytest.mark.slow
def test_a_stop_that_the_first_run_does_not_reach_is_judged_in_the_one_that_does():
    runs = [plants.axis_with_stop(swing, k) for k, swing in enumerate((0.5, 1.0, 1.0), 1)]
    found = diagnose(runs[:2], hil.base_model(runs[0].robot), runs[2:])
    assert "end-stop" in {f.effect for f in found.findings}


@pytest.mark.slow
def test_friction_that_changes_at_an_instant_does_not_drift():
    """Somebody has put oil on it: the time is said, and no drift that would go on."""

    def oiled(t, v):
        rubs = 0.25 * np.tanh(v / 0.02) + 0.08 * v
        return np.where(t > 13.0, -0.4 * rubs, 0.0)

    runs = [plants.smooth_axis(k, extra=lambda t, q, v, a: oiled(t, v)) for k in (3, 4)]
    d = hil.diagnose(runs[:1], hil.base_model(runs[0].robot))
    assert "friction-drift" not in [f.effect for f in d.findings]
    (said,) = (text for code, text in d.warnings if code == "changed")
    assert "from 1" in said
