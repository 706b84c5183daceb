"""Elasticity, lag, ripple and a resonance, hidden in a motor with a link: named, or said."""

from __future__ import annotations

import pytest
from compare_transmission import transmission_run

from hil.compare import analysis
from hil.compare.diagnose import diagnose
from hil.models.kernels import gap, lag, resonator
from hil.models.model import base_model


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("fast", [0.5, 1.0])
def test_a_rigid_drive_lacks_nothing(seed: int, fast: float) -> None:
    run = transmission_run(seed, fast=fast)
    assert diagnose([run], base_model(run.robot)).verdict == "adequate"


@pytest.mark.parametrize(
    ("hidden", "effect", "parameter", "value"),
    [
        ({"lag": 0.02}, "actuator-lag", "T", 0.02),
        ({"lag": 0.05}, "actuator-lag", "T", 0.05),
        ({"ripple": 0.05}, "torque-ripple", "p", 9 / 6.2832),
        ({"ripple": 0.15}, "torque-ripple", "p", 9 / 6.2832),
    ],
)
def test_named(hidden: dict[str, float], effect: str, parameter: str, value: float) -> None:
    run = transmission_run(1, **hidden)
    d = diagnose([run], base_model(run.robot))
    assert d.verdict == "missing-effect"
    assert [f.effect for f in d.findings] == [effect]
    found = d.findings[0].parameters[f"j1.{effect}.{parameter}"].value
    assert found == pytest.approx(value, rel=0.05)


@pytest.mark.parametrize(
    ("hidden", "resonance"),
    [({"frequency": 12.0}, 12.0), ({"mode": 0.01}, 9.0), ({"mode": 0.03, "mode_hz": 15.0}, 15.0)],
)
def test_a_resonance_is_found_and_its_two_causes_are_both_said(
    hidden: dict[str, float], resonance: float
) -> None:
    run = transmission_run(2, **hidden)
    d = diagnose([run], base_model(run.robot))
    first = d.findings[0]
    assert d.verdict == "ambiguous"
    assert {first.effect, *first.rivals} == {"elastic-transmission", "vibration-mode"}
    assert first.parameters[f"j1.{first.effect}.f"].value == pytest.approx(resonance, rel=0.1)


def test_a_short_lag_may_be_a_delay() -> None:
    run = transmission_run(1, lag=0.005)
    d = diagnose([run], base_model(run.robot))
    assert d.verdict == "ambiguous"
    assert {d.findings[0].effect, *d.findings[0].rivals} == {"actuator-lag", "delay"}


@pytest.mark.parametrize("effect", ["hardening-cable", "backlash"])
def test_effects_that_are_added_by_hand_fit(effect: str) -> None:
    run = transmission_run(1, frequency=15.0, harden=3.0)
    before, after = analysis.add([run], base_model(run.robot), effect)
    assert after.step.heldout.rms[0] < 1.01 * before.step.heldout.rms[0]


def test_states_follow_their_equations() -> None:
    import numpy as np

    t = np.arange(0, 2, 1e-3)
    u = np.sin(2 * np.pi * 2 * t)
    s = 2j * np.pi * 2
    w, zeta, time = 2 * np.pi * 10, 0.3, 0.03
    for y, h in (
        (lag(u, 1e-3, time), 1 / (1 + time * s)),
        (resonator(u, 1e-3, 10.0, zeta), w**2 / (s**2 + 2 * zeta * w * s + w**2)),
    ):
        expected = np.abs(h) * np.sin(2 * np.pi * 2 * t + np.angle(h))
        assert np.max(np.abs(y - expected)[1000:]) < 0.01
    q = np.array([0.0, 0.1, 0.2, 0.1, 0.0, -0.1])
    push = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    assert gap(q, push, 0.15).tolist() == [0, 0, 0, 1, 0, 0]
