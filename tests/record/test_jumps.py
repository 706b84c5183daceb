"""Jumps of a recorded position, found sample by sample."""

import json

import numpy as np
import pytest
from record_tables import write_csv

import hil
from hil.cli import main
from hil.record.checks import check
from hil.record.jumps import jumps, periods, resolution, wraps

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


# ------------------------------------------------------------ wraps

T = np.arange(3000) * 0.01
#: Turns one way, at a changing speed, then back.
ANGLE = 9.0 * np.sin(0.2 * T) + 0.3 * np.sin(7 * T)


def within(x, period, low=0.0):
    """A position as an encoder of one turn tells it."""
    return low + (x - low) % period


@pytest.mark.parametrize(
    ("low", "period", "entry"),
    [
        (0.0, 2 * np.pi, {}),
        (-np.pi, 2 * np.pi, {}),
        (0.0, 360.0, {"unit": "deg"}),
        (0.0, 1.0, {"unit": "rev"}),
        (0.0, 65536, {"scale": 2 * np.pi / 65536}),
        (-32768, 65536, {"scale": 2 * np.pi / 65536}),
        (0.0, 2000.0, {"scale": 2 * np.pi / 2000}),
    ],
)
def test_a_position_that_wraps_is_made_continuous_at_import(tmp_path, capsys, low, period, entry):
    x = within(ANGLE * period / (2 * np.pi), period, low)
    x = np.floor(x) if period > 1000 else x
    table = write_csv(tmp_path / "a.csv", {"t": T, "phi": x, "tau1": np.sin(T)})
    rule = ", ".join(f"{k} = {json.dumps(v)}" for k, v in {"from": "phi", **entry}.items())
    place, session = tmp_path / "m.toml", tmp_path / "s.mcap"
    place.write_text(f"[columns]\nq1 = {{ {rule} }}\n")
    assert main(["import", str(table), "--map", str(place), "-o", str(session)]) == 0
    assert "q1 wraps at " in capsys.readouterr().out
    back = hil.load(session)
    shift = back.q[:, 0] - ANGLE
    assert np.ptp(shift) < 2 * np.pi / 1900
    assert not [f for f in check(back) if f.code in ("wrap", "step", "spike")]
    assert main(["info", str(session)]) == 0
    assert ": unwrapped" in capsys.readouterr().out

    place.write_text(f"[columns]\nq1 = {{ {rule}, unwrap = false }}\n")
    assert main(["import", str(table), "--map", str(place), "-o", str(session)]) == 0
    assert np.ptp(hil.load(session).q) <= 2 * np.pi
    assert [f.code for f in check(hil.load(session)) if f.code == "wrap"]


@pytest.mark.parametrize(
    ("period", "unit"), [(360.0, 'unit = "deg"'), (1.0, 'unit = "rev"'), (4096, "scale = ")]
)
def test_a_position_of_no_unit_that_wraps_is_not_taken_for_radians(tmp_path, capsys, period, unit):
    x = within(ANGLE * period / (2 * np.pi), period)
    x = np.floor(x) if period > 1000 else x
    table = write_csv(tmp_path / "a.csv", {"t": T, "q1": x, "tau1": np.sin(T)})
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 2
    told = capsys.readouterr().err
    assert f"q1 wraps at {period:g}" in told
    assert unit in told


def test_arrays_that_wrap_are_unwrapped():
    run = hil.from_arrays(T, within(ANGLE, 2 * np.pi), np.sin(T))
    assert np.ptp(run.q[:, 0] - ANGLE) < 1e-9
    assert "q1 wraps at 2 pi" in run.metadata["unwrapped"]


def test_a_gap_and_noise_at_the_end_of_a_turn_do_not_matter():
    noise = 0.004 * np.random.default_rng(1).standard_normal(T.size)
    x = np.minimum(4.2 * T, 60.0 * np.pi / 5) + noise  # it ends where the turn does
    keep = (T < 5.0) | (T > 5.7)
    found = wraps(T[keep], within(x, 2 * np.pi)[keep], [(2 * np.pi, "2 pi")])
    assert np.ptp(found.values - x[keep]) < 1e-9


@pytest.mark.parametrize("lost", [3.3, 5.9, 6.0, -4.0])
def test_lost_counts_are_no_wraps(lost):
    t, q = motion()
    q[9000:] += lost
    assert wraps(t, q, periods(q)) is None
    turning = within(ANGLE, 2 * np.pi)
    turning[1500:] = within(turning[1500:] + 1.0, 2 * np.pi)
    found = wraps(T, turning, periods(turning))
    jump = np.diff(found.values - ANGLE)
    assert np.flatnonzero(np.abs(jump) > 1e-6).tolist() == [1499]


@pytest.mark.parametrize("fault", [blow, spike, stale, shaking])
def test_other_faults_are_no_wraps(fault):
    t, q = motion()
    x = fault(t, q)
    assert wraps(t, x, periods(x)) is None
    whole = np.round(x / COUNT)
    assert wraps(t, whole, periods(whole)) is None


COARSE = 2 * np.pi / 8192


def counted(n=20000):
    """A position in counts that moves by less than one a row for most of the time."""
    t = np.arange(n) / 2000.0
    q = 0.8 * np.sin(1.3 * t) + 0.3 * np.sin(4.1 * t)
    return np.round(q / COARSE) * COARSE


def test_a_count_is_found_through_a_table_that_writes_it_in_two_ways():
    q = np.round(counted(), 9)
    q[[700, 3100, 9000]] += 1.39e-9  # another last digit
    assert resolution(q, exact=True) == pytest.approx(COARSE, rel=1e-3)
    assert resolution(q) == pytest.approx(COARSE, rel=1e-3)


@pytest.mark.parametrize("gaps", [20, 40])
def test_a_count_is_found_beside_rows_that_were_filled_in(gaps):
    rng, q = np.random.default_rng(3), counted()
    for k in rng.choice(np.arange(100, len(q) - 100), gaps, replace=False).tolist():
        length = int(rng.integers(2, 8))
        q[k : k + length + 1] = np.linspace(q[k], q[k + length], length + 1)
    assert resolution(q, exact=True) == pytest.approx(COARSE, rel=1e-3)


def test_a_count_times_a_whole_number_is_one_kind_of_step():
    """In binary every position rounds on its own, so that one step has many last digits."""
    q = np.cumsum(np.random.default_rng(2).integers(-20, 21, 20000)) * COARSE
    assert np.unique(np.abs(np.diff(q))).size > 5 * 21
    assert resolution(q) == pytest.approx(COARSE, rel=1e-6)


def test_noise_is_not_in_counts():
    q = np.cumsum(np.random.default_rng(1).normal(0.0, 1e-3, 20000))
    assert resolution(q, exact=True) == 0.0
