"""A motor that weakens as it warms is no offset that drifts, and an offset or friction is none."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.types import Diagnosis
from hil.models.disturbance import OWN_EFFORT, THERMOMETER
from hil.record.recording import Recording

TONES = 2 * np.pi * np.array([0.09, 0.21, 0.5, 1.1])
SIZES = np.array([0.5, 0.3, 0.12, 0.05])
Array = np.ndarray


def demanded(q: Array, v: Array, a: Array) -> Array:
    """A pendulum with friction [N m]."""
    return 0.3 * a + 0.4 * v + 0.5 * np.tanh(v / 0.01) + 4.0 * np.sin(q + 0.6)


def pendulum(
    seed: int,
    sent: Callable[[Array, Array, Array], Array] = lambda t, v, tau: tau,
    seconds: float = 45.0,
) -> Recording:
    """An axis under gravity; `sent` makes of time, speed and demand the effort that was sent."""
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * 200)) / 200
    q, v, a = plants.sines(t, TONES, SIZES, rng.uniform(0, 6.28, TONES.size))
    tau = sent(t, v, demanded(q, v, a))
    tau = tau + 3e-3 * np.std(tau) * rng.normal(size=t.size)
    return plants.single(f"run{seed}", t, q + 2e-6 * rng.normal(size=t.size), tau)


def warmth(t: Array, slow: float = 15.0) -> Array:
    return 1.0 - np.exp(-t / slow)


def weakening(t: Array, v: Array, tau: Array) -> Array:
    return tau / (1.0 - 0.12 * warmth(t))


def diagnosed(sent: Callable[[Array, Array, Array], Array]) -> Diagnosis:
    run, hold = (pendulum(seed, sent) for seed in (1, 2))
    return hil.diagnose([run], hil.base_model(run.robot) + "unbalance", [hold])


def test_a_motor_that_weakens_has_a_gain_that_drifts() -> None:
    d = diagnosed(weakening)
    assert (d.verdict, [f.effect for f in d.findings]) == ("missing-effect", ["gain-drift"])
    (found,) = d.findings
    assert found.confidence > 0.95 and found.rivals == []
    assert found.parameters["j1.gain-drift.g"].value == pytest.approx(0.12, rel=0.05)
    assert found.parameters["j1.gain-drift.T"].value == pytest.approx(15.0, rel=0.1)
    assert d.ladder[0].heldout.relative[0] > 2.0
    assert d.ladder[-1].heldout.relative[0] < 0.08


def heated(t: Array, v: Array, tau: Array) -> Array:
    """A winding that is warmed by its losses, step by step; its torque falls by 2 % a (N m)^2."""
    out, heat = np.empty(t.size), 0.0
    for k in range(t.size):
        out[k] = tau[k] / (1.0 - 0.02 * heat)
        heat += (out[k] ** 2 - heat) / 15.0 * (t[1] - t[0])
    return out


@pytest.mark.slow
def test_a_motor_that_its_own_effort_warms() -> None:
    d = diagnosed(heated)
    assert [f.effect for f in d.findings] == ["gain-drift"]
    values = d.findings[0].parameters
    assert values["j1.gain-drift.of"].value == OWN_EFFORT
    assert values["j1.gain-drift.g"].value == pytest.approx(0.02, rel=0.05)
    assert values["j1.gain-drift.T"].value == pytest.approx(15.0, rel=0.1)
    before, after = (rung.heldout.relative[0] for rung in (d.ladder[0], d.ladder[-1]))
    assert after < before / 10


@pytest.mark.slow
def test_a_gain_follows_the_measured_temperature() -> None:
    runs = [pendulum(seed, weakening) for seed in (1, 2)]
    warm = [replace(r, temperature=25.0 + 60.0 * warmth(r.t)[:, None]) for r in runs]
    d = hil.diagnose(warm[:1], hil.base_model(runs[0].robot) + "unbalance", warm[1:])
    (found,) = d.findings
    assert found.effect == "gain-drift"
    assert found.parameters["j1.gain-drift.of"].value == THERMOMETER
    assert found.parameters["j1.gain-drift.g"].value == pytest.approx(0.002, rel=0.05)


@pytest.mark.slow
def test_an_offset_that_drifts_under_gravity_is_no_gain() -> None:
    d = diagnosed(lambda t, v, tau: tau + 0.4 * warmth(t))
    assert {f.effect for f in d.findings} == {"offset-drift"}


@pytest.mark.slow
def test_friction_that_cools_under_gravity_is_no_gain() -> None:
    d = diagnosed(lambda t, v, tau: tau - 0.15 * warmth(t) * np.tanh(v / 0.01))
    assert {f.effect for f in d.findings} == {"friction-drift"}


@pytest.mark.slow
def test_a_gain_that_stays_does_not_drift() -> None:
    d = diagnosed(lambda t, v, tau: tau)
    assert (d.verdict, d.findings) == ("adequate", [])


@pytest.mark.slow
def test_a_gain_that_jumps_is_no_drift() -> None:
    d = diagnosed(lambda t, v, tau: tau * (1.0 + 0.12 * (t > 17.0)))
    assert all(f.confidence < 0.5 for f in d.findings if f.effect == "gain-drift")
