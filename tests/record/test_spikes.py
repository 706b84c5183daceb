"""Single samples that stand out: found, and nothing else taken for one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hil.record.consistency import reached, spikes

T = np.arange(4000) * 1e-3


def signal(seed, grain=0.0):
    rng = np.random.default_rng(seed)
    x = np.sin(2 * np.pi * T) + 1e-3 * rng.standard_normal(T.size)
    return np.round(x / grain) * grain if grain else x


@pytest.mark.parametrize("grain", [0.0, 1e-2])
@pytest.mark.parametrize("size", [0.5, -3.0])
def test_a_single_sample_is_found(grain, size):
    x = signal(1, grain)
    x[[700, 2500]] += size
    assert spikes(x).tolist() == [700, 2500]


@pytest.mark.parametrize("seed", range(5))
def test_noise_steps_and_dry_friction_are_none(seed):
    x = signal(seed)
    assert not spikes(x).size
    assert not spikes(x + 5 * (T > 1.7)).size
    assert not spikes(x + 2 * np.sign(np.cos(2 * np.pi * T))).size
    assert not spikes(signal(seed, 0.05)).size
    assert not spikes(np.zeros(4000)).size


@given(arrays(np.float64, st.integers(1, 400), elements=st.floats(0, 1, width=16)), st.floats(0, 1))
def test_what_is_reached_at_once_is_reached_by_the_quantile(sizes, level):
    if reached(sizes, level):
        assert np.quantile(sizes, 0.99) >= level
    assert reached(np.full(1000, level), level)
