"""A floor that is much of the effort: whether noise of the sensor can make it is measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plants
import pytest
import scipy.signal

import hil
from hil.commands.diagnose import verdict_sentence
from hil.diagnosis.verdict import HIGH_FLOOR
from hil.models.model import Band
from hil.record.recording import Recording
from hil.report.data import from_diagnosis
from hil.report.text import headline


def leant_on(noise: float, hand: float) -> Recording:
    """An axis with sensor noise, and a hand that does as it likes below 4 Hz, shares of effort."""
    rng, t = np.random.default_rng(5), np.arange(25000) / 1000.0
    w = 2 * np.pi * np.array([0.11, 0.37, 0.9])
    q, v, a = plants.sines(t, w, np.array([0.5, 0.3, 0.1]), np.array([1.0, 2.0, 3.0]))
    tau = 0.5 * a + 0.8 * v + 0.3 * np.tanh(v / 1e-3)
    size = float(np.sqrt(np.mean(tau**2)))
    slow = scipy.signal.sosfilt(
        scipy.signal.butter(2, 4.0, fs=1000.0, output="sos"), rng.standard_normal(t.size)
    )
    tau += size * (hand * slow / slow.std() + noise * rng.standard_normal(t.size))
    return plants.single("hand", t, q + 1e-6 * rng.standard_normal(t.size), tau)


def said(run: Recording) -> str:
    d = hil.diagnose([run], hil.base_model(run.robot))
    return " ".join(text for code, text in d.warnings if code == HIGH_FLOOR)


def test_what_no_noise_of_the_sensor_makes_may_be_a_hand():
    run = leant_on(0.02, 0.4)
    told = said(run)
    assert "a hand, a wearer, a cable" in told and told.endswith("?")
    measured = replace(run, tau_ext=np.zeros_like(run.tau) + 1e-3 * np.sin(run.t)[:, None])
    assert "a wearer" not in said(measured)


@pytest.mark.parametrize("hand", [0.0, 0.4])
def test_beside_a_poor_sensor_nothing_is_suspected(hand):
    told = said(leant_on(1.5, hand))
    assert "a poor sensor" in told and "wearer" not in told


@pytest.mark.slow
def test_a_floor_that_no_noise_makes_stands_in_the_verdict():
    """It was adequate, with words on what that is worth; of causes, what was tried."""

    def wanders(t, q, v, a):
        white = np.random.default_rng(5).normal(size=t.size)
        return 0.3 * scipy.signal.lfilter([0.2], [1.0, -0.98], white)

    run = plants.smooth_axis(2, rate=200.0, extra=wanders)
    d = hil.diagnose([run], hil.base_model(run.robot))
    told = " ".join(text for code, text in d.warnings if code == HIGH_FLOOR)
    assert "that was tried" in told and "recorded motion" not in told
    assert d.verdict == "unexplained"
    for sentence in (headline(from_diagnosis(d)), verdict_sentence(d)):
        assert "is a large part of the effort, and no sensor noise" in sentence
        assert "% on joint1" in sentence


def test_a_floor_that_a_poor_sensor_makes_is_no_doubt():
    run = leant_on(1.5, 0.0)
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert d.verdict == "adequate" and "does not show" not in verdict_sentence(d)


def test_what_a_user_says_of_the_efforts_is_no_floor_to_wonder_at():
    """With `accuracy` of a fifth any recording was, at a tenth of the effort."""
    run = leant_on(0.02, 0.15)
    d = hil.diagnose([run], replace(hil.base_model(run.robot), band=Band(accuracy=0.2)))
    assert d.verdict == "adequate" and HIGH_FLOOR not in {code for code, _ in d.warnings}
