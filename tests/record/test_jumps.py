"""Jumps of a recorded position, found sample by sample."""

import numpy as np
import pytest

from hil.record.jumps import jumps

COUNT = 1e-4


def motion(n=20000, seed=0, count=COUNT):
    """Sines up to 2 Hz at 1 kHz, in counts."""
    rng, t = np.random.default_rng(seed), np.arange(n) * 1e-3
    w = 2 * np.pi * rng.uniform(0.1, 2.0, (12, 1))
    q = np.sum(0.6 / w * np.sin(w * t + rng.uniform(0, 6.28, (12, 1))), axis=0)
    return t, count * np.floor(q / count) if count else q


def test_lost_counts_are_found_at_their_instants_with_their_sizes():
    t, q = motion()
    lost = {3001: 6, 9000: -12, 9030: 40, 15500: -7}
    for at, size in lost.items():
        q[at:] += size * COUNT
    found = jumps(t, q)
    assert dict(zip(found.at.tolist(), np.round(found.size / COUNT).tolist(), strict=True)) == (
        pytest.approx(lost, abs=1)
    )
    assert found.count == pytest.approx(COUNT)
    assert found.shift(t.size)[-1] == pytest.approx(27 * COUNT, abs=4.1 * COUNT)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [0.0, COUNT, 2e-3])
def test_smooth_motion_has_no_jumps(seed, count):
    assert not jumps(*motion(seed=seed, count=count)).at.size


def blow(t, q):
    """The speed changes at once, twice."""
    return q + 1.5 * np.clip(t - 5.0, 0.0, 0.4)


def spike(t, q):
    q[7000] += 30 * COUNT
    return q


def stale(t, q):
    """Readings that came late, and all at once."""
    for at in (4000, 8000, 12000):
        q[at : at + 12] = q[at]
    return q


def shaking(t, q):
    rng = np.random.default_rng(3)
    q[6000:6060] += 20 * COUNT * rng.standard_normal(60)
    return q


@pytest.mark.parametrize("fault", [blow, spike, stale, shaking])
def test_what_is_no_lost_count_is_no_jump(fault):
    t, q = motion()
    assert not jumps(t, COUNT * np.round(fault(t, q) / COUNT)).at.size


def test_a_gap_in_time_is_no_jump():
    t, q = motion()
    keep = (t < 6.0) | (t > 6.05)
    assert not jumps(t[keep], q[keep]).at.size
