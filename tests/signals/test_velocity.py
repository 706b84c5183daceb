"""Every estimator of the registry: right at steady speed, honest about gaps, as written."""

from pathlib import Path

import numpy as np
import pytest

from hil.errors import ConfigError
from hil.record.mcap_read import load
from hil.rig.config import load_rig
from hil.runtime import runner
from hil.signals.velocity import FilteredAcceleration, estimator, estimator_names, low_pass

T = 1e-3
RIG = Path(__file__).parents[2] / "rigs" / "identify.toml"
#: Largest error at steady speed [counts per period].
STEADY = {
    "first-difference": 1.0,
    "filtered-difference": 0.3,
    "foaw-end-fit": 0.1,
    "foaw-best-fit": 0.1,
    "kalman": 0.3,
}


def follow(name, counts, steps=None, **options):
    """Rates [counts per period] along counts (n,)."""
    method = estimator(name, options, 1, T)
    method.reset(np.array(counts[:1], np.int64))
    rate, out = np.zeros(1), []
    for k in range(1, len(counts)):
        method.update(np.array([counts[k]], np.int64), 1 if steps is None else steps[k], rate)
        out.append(rate[0])
    return np.array(out)


def ramp(speed, n=400, start=0.3):
    return np.floor(start + speed * np.arange(n)).astype(int)


@pytest.mark.parametrize("name", estimator_names())
@pytest.mark.parametrize("speed", [0.0, 0.037, 0.61, 2.9, -14.3, 210.0])
def test_a_steady_speed_is_found(name, speed):
    out = follow(name, ramp(speed))
    assert np.abs(out[100:] - speed).max() <= STEADY.get(name, 0.3)
    assert np.mean(out[100:]) == pytest.approx(speed, abs=0.02)


@pytest.mark.parametrize("name", estimator_names())
def test_missed_ticks_are_not_a_jump(name):
    every = np.floor(0.3 + 5.3 * np.arange(600)).astype(int)
    kept = [k for k in range(600) if not 300 <= k < 317]
    steps = np.diff(kept, prepend=-1)
    out = follow(name, every[kept], steps)
    assert np.abs(out[100:] - 5.3).max() < 1.01


@pytest.mark.parametrize("name", estimator_names())
def test_channels_do_not_touch_each_other(name):
    method = estimator(name, {}, 2, T)
    alone = follow(name, ramp(3.7))
    rate, both = np.zeros(2), []
    method.reset(np.array([0, 0]))
    for a, b in zip(ramp(3.7)[1:], ramp(-0.2)[1:], strict=True):
        method.update(np.array([a, b]), 1, rate)
        both.append(rate[0])
    np.testing.assert_allclose(both, alone, atol=1e-12)


@pytest.mark.parametrize("name", estimator_names())
def test_a_large_count_is_as_good_as_a_small_one(name):
    out = follow(name, ramp(1.7, start=2.0**40))
    np.testing.assert_allclose(out[50:], follow(name, ramp(1.7, start=0.0))[50:], atol=1e-3)


def foaw(counts, noise, window, best):
    """Janabi-Sharifi, Hayward & Chen 2000, written out with numpy."""
    y, found = counts[::-1].astype(float), 0.0
    for n in range(1, min(window, len(y))):
        i = np.arange(n + 1)
        b = (
            (6 * np.sum((n - 2 * i) * y[: n + 1]) / (n * (n + 1) * (n + 2)))
            if best
            else (y[0] - y[n]) / n
        )
        j = np.arange(1, n)
        if np.any(np.abs(y[0] - b * j - y[j]) > noise):
            break
        found = b
    return found


@pytest.mark.parametrize(("name", "best"), [("foaw-end-fit", False), ("foaw-best-fit", True)])
def test_adaptive_windowing_is_as_published(name, best):
    t = np.arange(1200) * T
    counts = np.floor(8670.0 * 0.05 * np.sin(2 * np.pi * 1.5 * t)).astype(int)
    out = follow(name, counts, window=16)
    for k in range(40, 1199, 7):
        assert out[k] == pytest.approx(foaw(counts[: k + 2], 1.0, 16, best), abs=1e-9)


def test_kalman_settles_to_the_gain_of_its_riccati_equation():
    from scipy.linalg import solve_discrete_are

    drive = (2e4 * T * T) ** 2
    f, q = np.array([[1.0, 1.0], [0.0, 1.0]]), drive * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    p = solve_discrete_are(f.T, np.array([[1.0], [0.0]]), q, np.array([[1 / 12]]))
    gain = p[:, 0] / (p[0, 0] + 1 / 12)
    # one count out of line after a long rest moves the rate by the gain
    counts = np.r_[np.zeros(2000, int), 1]
    out = follow("kalman", counts, acceleration=2e4)
    assert out[-1] == pytest.approx(gain[1], rel=1e-6)


def test_filtered_acceleration_has_its_noise_and_its_delay():
    beta, noise = low_pass(30.0, T), 0.01
    method, out = FilteredAcceleration(1, T), np.zeros(1)
    seen = []
    for v in noise * np.random.default_rng(1).standard_normal(40_000):
        method.update(np.array([v]), 1, out)
        seen.append(out[0])
    expected = noise / T * beta * np.sqrt(2 / (2 - beta))
    assert np.std(seen) == pytest.approx(expected, rel=0.03)
    method.reset(np.array([0.0]))
    for k in range(1, 400):
        method.update(np.array([3.0 * k * T]), 1, out)
    assert out[0] == pytest.approx(3.0, rel=1e-6)


@pytest.mark.parametrize("name", estimator_names())
def test_a_rig_file_chooses_it(name, tmp_path):
    arm = {"driver": "premium", "arm": "follower", "options": {"velocity": name}}
    config = load_rig(RIG, {"devices": {"follower-arm": arm}})
    runner.run_session(config, 0.3, seed=1, output=tmp_path / "s.mcap")
    run = load(tmp_path / "s.mcap", "follower")
    slope = np.gradient(run.q, run.t, axis=0)
    assert np.abs(run.qd - slope)[50:].max() < 0.2


def test_mistakes_are_named():
    with pytest.raises(ConfigError, match="Did you mean 'kalman'"):
        estimator("kalmann", {}, 1, T)
    with pytest.raises(ConfigError, match="half the sample rate"):
        estimator("filtered-difference", {"cutoff_hz": 900.0}, 1, T)
    with pytest.raises(ConfigError, match="unknown key"):
        estimator("first-difference", {"cutoff_hz": 9.0}, 1, T)
    for name, options in (
        ("foaw-end-fit", {"window": 1}),
        ("foaw-best-fit", {"noise": float("nan")}),
        ("kalman", {"acceleration": -1.0}),
        ("kalman", {"acceleration": float("nan")}),
        ("filtered-difference", {"cutoff_hz": float("nan")}),
    ):
        with pytest.raises(ConfigError):
            estimator(name, options, 1, T)


@pytest.mark.parametrize("name", estimator_names())
def test_counts_and_rates_are_as_many_as_the_channels(name):
    method = estimator(name, {}, 2, T)
    method.reset(np.zeros(2, np.int64))
    for counts, rates, steps in ((3, 2, 1), (2, 1, 1), (2, 2, 0)):
        with pytest.raises(ConfigError, match="2 channels"):
            method.update(np.zeros(counts, np.int64), steps, np.zeros(rates))
    with pytest.raises(ConfigError, match="2 channels"):
        FilteredAcceleration(2, T).update(np.zeros(3), 1, np.zeros(3))
