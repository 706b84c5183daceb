"""The filters: exactly linear, zero phase, accurate derivatives."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.fft import next_fast_len

from hil.errors import DataError
from hil.identify.bands import (
    apart,
    choose,
    derivatives,
    encoder_noise,
    every,
    motion_bandwidth,
    nearest,
    position_noise,
    smooth,
)
from hil.identify.prepare import Decimator
from hil.models.kernels import slope
from hil.models.model import Band
from hil.record.recording import Recording

numbers = st.floats(-1e3, 1e3, allow_subnormal=False)


def recording(q: np.ndarray, fs: float) -> Recording:
    t = np.arange(len(q)) / fs
    return Recording("run", "arm", ("a",), t, q[:, None], np.zeros((len(q), 1)))


@settings(deadline=None, max_examples=50)
@given(
    n=st.integers(60, 700),
    cutoff=st.floats(3.0, 25.0),
    x=arrays(float, (700, 3), elements=numbers),
    theta=arrays(float, (3,), elements=numbers),
)
def test_decimator_is_exactly_linear(
    n: int, cutoff: float, x: np.ndarray, theta: np.ndarray
) -> None:
    """Y = X theta before it means y = X theta after it."""
    filtered = Decimator(n, 100.0, cutoff)
    x = x[:n]
    scale = float(np.abs(x).max() * np.abs(theta).max()) + 1e-300
    difference = filtered(x @ theta) - filtered(x) @ theta
    assert np.abs(difference).max() <= 1e-13 * n * scale


@given(n=st.integers(60, 700), cutoff=st.floats(3.0, 25.0))
def test_decimator_keeps_a_constant(n: int, cutoff: float) -> None:
    filtered = Decimator(n, 100.0, cutoff)
    np.testing.assert_allclose(filtered(np.full((n, 2), 3.0)), 3.0, rtol=1e-12)
    assert filtered(np.ones(n)).shape == filtered.times.shape


@pytest.mark.parametrize("f", [0.4, 2.0, 5.0, 9.0, 12.0])
@pytest.mark.parametrize("n", [1000, 1009])
def test_decimator_has_its_gain_and_no_phase(f: float, n: int) -> None:
    fs, cutoff = 100.0, 10.0
    filtered = Decimator(n, fs, cutoff)
    wave = filtered(np.exp(2j * np.pi * f * np.arange(n) / fs).real)
    shift = filtered(np.exp(2j * np.pi * f * np.arange(n) / fs).imag)
    expected = np.exp(2j * np.pi * f * filtered.times) / (1 + (f / cutoff) ** 8)
    middle = slice(10, -10)
    got = wave[middle] + 1j * shift[middle]
    np.testing.assert_allclose(got, expected[middle], atol=0.01)
    assert abs(np.angle(np.vdot(expected[middle], got))) < 1e-3


def test_decimator_stops_what_lies_above_its_cutoff() -> None:
    filtered = Decimator(2000, 200.0, 10.0)
    wave = filtered(np.sin(2 * np.pi * 30.0 * np.arange(2000) / 200.0))
    assert np.sqrt(np.mean(wave**2)) < 2e-3
    assert filtered.rate == pytest.approx(30.0, rel=0.05)


def test_derivatives_of_a_sine() -> None:
    fs, w = 1000.0, 2 * np.pi * np.array([0.5, 2.0])
    t = np.arange(4000) / fs
    q, qd, qdd = derivatives(np.sin(w * t[:, None]), fs, 40.0)
    middle = slice(300, -300)
    wt = (w * t[:, None])[middle]
    np.testing.assert_allclose(q[middle], np.sin(wt), atol=1e-6)
    np.testing.assert_allclose(qd[middle] / w, np.cos(wt), atol=1e-4)
    np.testing.assert_allclose(qdd[middle] / w**2, -np.sin(wt), atol=2e-4)


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2])
def test_slopes_are_exact_up_to_the_fifth_of_the_rate(share: float) -> None:
    fs, w = 50.0, 2 * np.pi * share * 50.0
    t = np.arange(300) / fs
    speed = slope(np.sin(w * t), fs)[6:-6]
    missed = np.max(np.abs(speed / w - np.cos(w * t)[6:-6]))
    assert missed < 1.05 * (2 * np.pi * share) ** 8 / 630 + 1e-12


def test_slopes_of_a_parabola_are_exact_next_to_the_ends() -> None:
    t = np.arange(12) / 10.0
    np.testing.assert_allclose(slope(2 * t + 3 * t**2, 10.0)[1:-1], (2 + 6 * t)[1:-1], rtol=1e-12)
    np.testing.assert_allclose(slope(2 * t, 10.0), 2.0, rtol=1e-12)


def test_derivatives_of_a_parabola_are_exact_away_from_the_ends() -> None:
    t = np.arange(3000) / 500.0
    _, qd, qdd = derivatives((1 + 2 * t + 3 * t**2)[:, None], 500.0, 30.0)
    middle = slice(300, -300)
    np.testing.assert_allclose(qd[middle, 0], (2 + 6 * t)[middle], rtol=1e-6)
    np.testing.assert_allclose(qdd[middle, 0], 6.0, rtol=1e-5)


def test_filters_are_time_symmetric() -> None:
    x = np.random.default_rng(0).normal(size=(500, 1))
    np.testing.assert_allclose(
        smooth(x[::-1], 100.0, 10.0)[::-1][100:-100], smooth(x, 100.0, 10.0)[100:-100], atol=1e-6
    )


def test_a_short_run_is_refused() -> None:
    with pytest.raises(DataError, match="59 samples is too short"):
        derivatives(np.zeros((59, 1)), 1000.0, 30.0)


def test_bandwidth_is_the_motion_s_not_the_quantisation_s() -> None:
    t = np.arange(20000) / 1000.0
    wave = 0.5 * np.sin(2 * np.pi * 0.5 * t) + 0.1 * np.sin(2 * np.pi * 3.0 * t)
    rounded = np.round(wave / 1e-4) * 1e-4
    assert motion_bandwidth(recording(wave, 1000.0)) == pytest.approx(3.0, abs=0.3)
    assert motion_bandwidth(recording(rounded, 1000.0)) == pytest.approx(3.0, abs=0.3)
    assert motion_bandwidth(recording(0 * wave, 1000.0)) == 0.0


def test_band_is_given_or_chosen_and_never_above_the_rate() -> None:
    t = np.arange(4000) / 1000.0
    slow = recording(np.sin(2 * np.pi * 0.5 * t), 1000.0)
    assert choose([slow], Band()).effort == 12.0
    assert choose([slow], Band(50.0, 8.0)).position == 50.0
    assert choose([slow], Band(50.0, 8.0)).effort == 8.0
    coarse = recording(np.sin(2 * np.pi * 0.5 * t[::20]), 50.0)
    rates = choose([slow, coarse], Band(100.0, 100.0))
    assert rates.effort <= 50.0 / 5 + 1e-9 and rates.position < 25.0


@given(n=st.integers(60, 90_000), cutoff=st.floats(3.0, 40.0))
def test_the_transform_back_has_no_large_prime_factor(n: int, cutoff: float) -> None:
    decimator = Decimator(n, 500.0, cutoff)
    rows = decimator._out
    assert rows == next_fast_len(rows, real=True) or rows >= n - 1
    assert decimator.rate > 2.0 * cutoff or rows >= n - 1


@pytest.mark.parametrize("rows", [1 / 2, 1 / 5])
def test_a_filtered_signal_is_known_between_its_rows(rows: float) -> None:
    """Up to what the widest position filter passes, 0.35 of the rate."""
    fs, more = 50.0, round(1 / rows)
    t, fine = np.arange(1000) / fs, np.arange(999 * more + 1) / fs / more
    for f in (0.3, 4.0, 0.35 * fs):
        x, wanted = (np.sin(2 * np.pi * f * u + 0.3)[:, None] for u in (t, fine))
        between = every(x, rows)
        assert between.shape == wanted.shape
        inside = slice(70 * more, -70 * more)
        np.testing.assert_allclose(between[inside], wanted[inside], atol=1e-4)
        np.testing.assert_allclose(between[::more][70:-70], x[70:-70], atol=1e-4)


@pytest.mark.parametrize(
    ("fs", "cutoff", "rows"),
    [(1000.0, 60.0, 3.0), (250.0, 75.0, 1.0), (100.0, 35.0, 0.5), (50.0, 17.5, 0.5)],
)
def test_a_motion_is_evaluated_often_enough_for_its_filter(fs, cutoff, rows) -> None:
    assert apart(fs, cutoff) == rows
    assert fs / rows >= 3.0 * cutoff


def test_of_a_mask_the_nearer_row_counts() -> None:
    assert nearest(np.array([0.0, 1.0, 0.0]), 1 / 2).tolist() == [0.0, 1.0, 1.0, 0.0, 0.0]
    assert nearest(np.arange(7.0), 3.0).tolist() == [0.0, 3.0, 6.0]


def test_a_fast_motion_between_two_rows_is_no_noise_of_the_encoder() -> None:
    count, t = 1e-5, np.arange(0, 40, 0.02)
    q = np.round(0.3 * np.sin(2 * np.pi * (1.3 * t + 0.3 * np.sin(0.7 * t))) / count) * count
    run = recording(q, 50.0)
    true = count / np.sqrt(12)
    assert position_noise(run.q)[0] > 100 * true
    assert encoder_noise(run)[0] == pytest.approx(true, rel=0.5)
    # an encoder's steps stay, however slow the motion between them is
    slow = recording(np.round(1e-3 * t / count) * count, 50.0)
    assert encoder_noise(slow)[0] >= true * (1 - 1e-9)
