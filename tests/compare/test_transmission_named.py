"""Elasticity, lag, ripple and a resonance, hidden in a motor with a link: named, or said."""

from __future__ import annotations

import numpy as np
import pytest
from compare_transmission import transmission_run

from hil.compare import analysis
from hil.compare.diagnose import diagnose
from hil.models.kernels import lag, play, resonator
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
    [({"frequency": 12.0}, 12.0), ({"mode": 0.03, "mode_hz": 15.0}, 15.0)],
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


def test_a_mass_that_is_an_eighth_of_the_link_hangs_on_it_and_is_not_the_link() -> None:
    run = transmission_run(2, mode=0.01)
    d = diagnose([run], base_model(run.robot))
    assert [(f.effect, f.rivals) for f in d.findings] == [("vibration-mode", [])]
    assert d.findings[0].parameters["j1.vibration-mode.f"].value == pytest.approx(9.0, rel=0.02)
    assert d.findings[0].parameters["j1.vibration-mode.m"].value == pytest.approx(0.01, rel=0.2)


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


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_a_link_flies_through_its_play_and_hands_its_momentum_over(friction: float) -> None:
    """Pushed, then braked with -L: free flight r = (L - F) t^2 / 2 I until the other flank."""
    n, dt, inertia, width = 400, 1e-3, 0.05, 0.01
    load = np.where(np.arange(n) < 100, 1.0, -2.0)
    passed = play(load, np.zeros(n), np.full(n, inertia), dt, width, friction, 1e-6)
    flight = np.sqrt(2 * width * inertia / (2.0 - friction))
    meets = 100 + round(flight / dt)
    assert np.all(passed[:100] == 1.0)
    assert np.all(passed[100 : meets - 2] == 0.0) and np.all(passed[meets + 2 :] == -2.0)
    # the speed of the link at the flank, (L - F) t / I, times its inertia
    hit = (friction - 2.0) * flight
    assert passed[meets - 2 : meets + 2].min() * dt == pytest.approx(hit, rel=0.1)


@pytest.mark.parametrize("width", [0.01, 0.015])
def test_backlash_is_named(width: float) -> None:
    run = transmission_run(3, gravity=0.6, frequency=40.0, zeta=0.3, width=width)
    d = diagnose([run], base_model(run.robot) + "position-torque")
    assert d.findings[0].effect == "backlash", [(f.effect, f.confidence) for f in d.findings]
    assert d.findings[0].parameters["j1.backlash.b"].value == pytest.approx(width, rel=0.4)
