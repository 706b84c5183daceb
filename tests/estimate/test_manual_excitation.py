"""What manual excitation can determine, and what it says of the rest."""

import numpy as np
import pytest

from hil.errors import FitError
from hil.experiments import manual_excitation
from hil.models.phantom import Premium

TRUE = np.array([*Premium.prior, 0.012, 0.001, 0.010, 0.0008, 0.009, 0.0006, 1.04, 0.97, 1.02])


def hand_like(n=4000, seed=0, sines=12):
    rng, t = np.random.default_rng(seed), np.arange(n) * 4e-3
    q, qd, qdd = (np.zeros((n, 3)) for _ in range(3))
    for j in range(3):
        for _ in range(sines):
            w, a = 2 * np.pi * rng.uniform(0.2, 3.0), rng.uniform(0.02, 0.08)
            p = rng.uniform(0, 2 * np.pi)
            q[:, j] += a * np.sin(w * t + p)
            qd[:, j] += a * w * np.cos(w * t + p)
            qdd[:, j] -= a * w**2 * np.sin(w * t + p)
    return q + np.array([0.0, 0.4, 0.3]), qd, qdd, t


def efforts(q, qd, qdd, u):
    """tau_s that belongs to motor commands u."""
    return (manual_excitation.hand_regressor(q, qd, qdd, u) @ TRUE).reshape(-1, 3)


def test_hand_and_motor_torque_determine_everything_motor_constants_included():
    q, qd, qdd, t = hand_like()
    u = 0.02 * np.sin(2 * np.pi * t[:, None] * [1.1, 1.7, 0.6] + [0, 1, 2])
    tau_s = efforts(q, qd, qdd, u) + 1e-3 * np.random.default_rng(1).normal(size=q.shape)
    found = manual_excitation.identify_with_rank(q, qd, qdd, u, tau_s)
    assert found.rank == 17 and not found.undetermined
    for name, true in zip(manual_excitation.PARAMETER_NAMES, TRUE, strict=True):
        assert abs(found.values[name] - true) < 4.5 * found.stderr[name]
    for j, true in zip((1, 2, 3), TRUE[14:], strict=True):
        assert found.values[f"j{j}.kappa"] == pytest.approx(true, rel=0.01)


def test_motors_alone_give_ratios_only():
    q, qd, qdd, _ = hand_like()
    u = efforts(q, qd, qdd, np.zeros_like(q)) / TRUE[14:]
    found = manual_excitation.identify_with_rank(q, qd, qdd, u, np.zeros_like(q))
    assert found.rank == 16
    assert set(found.undetermined) >= {"pi1", "j1.kappa", "j2.fc"}
    assert "only ratios" in found.text
    # the direction that is lost is the truth itself
    assert np.abs(manual_excitation.hand_regressor(q, qd, qdd, u) @ TRUE).max() < 1e-12


def test_a_hand_alone_says_nothing_of_the_motors():
    q, qd, qdd, _ = hand_like()
    u = np.zeros_like(q)
    found = manual_excitation.identify_with_rank(q, qd, qdd, u, efforts(q, qd, qdd, u))
    assert found.rank == 14
    assert found.undetermined == ("j1.kappa", "j2.kappa", "j3.kappa")
    assert np.isinf(found.stderr["j1.kappa"]) and np.isnan(found.values["j1.kappa"])
    assert found.values["pi5"] == pytest.approx(TRUE[4], rel=1e-6)
    assert "dither" in found.text


def test_a_hand_is_richer_than_a_sine():
    q, qd, qdd, _ = hand_like()
    one, oned, onedd, _ = hand_like(sines=1)
    rich, poor = (
        manual_excitation.richness(q, qd, qdd),
        manual_excitation.richness(one, oned, onedd),
    )
    # single sines of unlike frequency fill the cells too: that measure is no measure of rank
    assert all(rich[k] > poor[k] for k in ("inverse_condition", "log_det"))


def test_standstill_is_refused():
    still = np.tile([0.0, 0.4, 0.3], (50, 1))
    with pytest.raises(FitError, match="does not move"):
        manual_excitation.identify_with_rank(still, 0 * still, 0 * still, 0 * still, 0 * still)
