"""What was really recorded: jitter, repeats, holds, gaps and wrong values, each known here."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import plants
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.identify.bands import ACCELERATION_NOISE, choose, information
from hil.identify.clock import even
from hil.identify.fit import fit
from hil.identify.prepare import bridged, prepared, signal
from hil.identify.problem import Problem
from hil.identify.slow_motion import (
    CLEAR,
    _agreed,
    _middle,
    longest_shift,
    real_delay,
    sample_shift,
    slow_delay,
)
from hil.identify.timing import fit_aligned, late_effort, lateness, reading_notes, readings
from hil.models.model import Band, RobotModel, base_model
from hil.record.recording import Recording, RobotSource
from hil.record.urdf_checks import urdf_joints

AXIS = base_model(RobotSource("single-axis"))
FS = 1000.0
DATA = os.environ.get("HIL_DATA", "")


def floor(r: Recording) -> float:
    """Rms of what the base model leaves over."""
    problem = Problem([r], AXIS.robot, band=Band(60.0, 20.0))
    result = fit(problem, AXIS)
    left = problem.y - (result.x @ result.theta).reshape(problem.y.shape)
    return float(problem.rms(left)[0])


def test_an_even_recording_is_used_as_it_is() -> None:
    r = plants.counted_axis(5.0)
    (part,), timing = even(r)
    assert part.recording is r
    assert timing.even
    assert timing.rate == pytest.approx(FS)


@pytest.mark.parametrize("row", [777, 12345, 29000])
def test_a_lost_row_costs_nothing(row: int) -> None:
    whole = plants.counted_axis()
    assert floor(plants.without(whole, np.array([row]))) == pytest.approx(floor(whole), rel=0.02)


def test_many_lost_rows_cost_what_they_held() -> None:
    whole = plants.counted_axis()
    lost = np.random.default_rng(1).choice(np.arange(10, whole.n - 10), 300, replace=False)
    r = plants.without(whole, lost)
    (part,), timing = even(r)
    assert sum(g.rows for g in timing.gaps) == 300
    assert part.recording.n == whole.n
    assert floor(r) == pytest.approx(floor(whole), rel=0.03)


@settings(deadline=None, max_examples=20)
@given(first=st.integers(1000, 3000), length=st.integers(1, 800))
def test_a_bridge_has_the_length_of_the_gap_and_nothing_else_changes(
    first: int, length: int
) -> None:
    whole = plants.counted_axis(5.0)
    r = plants.without(whole, np.arange(first, first + length))
    (part,), timing = even(r)
    (gap,) = timing.gaps
    assert (gap.rows, gap.split) == (length, False)
    assert part.bridges.tolist() == [[first, first + length]]
    kept = np.r_[:first, first + length : whole.n]
    np.testing.assert_array_equal(part.recording.q[kept], whole.q[kept])
    np.testing.assert_allclose(part.recording.t, whole.t, atol=1e-9)
    assert np.ptp(np.diff(part.recording.t)) < 1e-9


def test_a_gap_of_three_seconds_splits_and_keeps_one_run() -> None:
    whole = plants.counted_axis(40.0)
    r = plants.without(whole, np.arange(15_000, 18_000))
    parts, timing = even(r)
    assert [p.recording.n for p in parts] == [15_000, 22_000]
    assert timing.gaps[0].split
    assert timing.gaps[0].length == pytest.approx(3.001)
    assert parts[1].start == pytest.approx(18.0)
    model = RobotModel(
        AXIS.robot, tuple(replace(u, options={}) for u in AXIS.effects), band=Band(60.0, 20.0)
    )
    problem = Problem([r, plants.counted_axis(10.0, seed=3)], model.robot, band=model.band)
    assert (len(problem.motions), problem.runs) == (3, 2)
    assert problem.whole.tolist() == [0, 0, 1]
    assert floor(r) == pytest.approx(floor(whole), rel=0.03)


def test_beside_a_gap_nothing_enters() -> None:
    """Nonsense on a bridge changes nothing of the fit."""
    whole = plants.counted_axis(20.0)
    r = plants.without(whole, np.arange(8000, 8400))
    (part,), _ = even(r)
    assert np.sum(bridged(part, 60.0)) == pytest.approx(400 + 2 * 34, abs=3)
    assert floor(r) == pytest.approx(floor(whole), rel=0.03)


def test_a_short_part_stays_behind_a_bridge() -> None:
    whole = plants.counted_axis(20.0)
    r = plants.without(whole, np.arange(17_000, 18_500))
    parts, timing = even(r)
    assert len(parts) == 1
    assert not timing.gaps[0].split


def test_stamps_that_stray_are_not_followed_by_the_positions() -> None:
    t = np.arange(10_000) / 200.0
    rng = np.random.default_rng(2)
    late = np.sort(t + 0.3 / 200 * rng.random(t.size))
    r = plants.counted_at(late, t, rng, 0.02)
    timing = even(r)[1]
    assert timing.reading == "even"
    assert timing.jitter == pytest.approx(0.3 / 200 / np.sqrt(12), rel=0.1)
    assert not timing.gaps
    assert timing.rate == pytest.approx(200.0, rel=1e-4)
    assert floor(r) == pytest.approx(
        floor(plants.counted_at(t, t, np.random.default_rng(2), 0.02)), rel=0.1
    )


def test_samples_that_stray_are_put_on_a_grid() -> None:
    rng = np.random.default_rng(3)
    t = np.sort(np.arange(6000) / 200.0 + 0.4 / 200 * (rng.random(6000) - 0.5))
    t -= t[0]
    parts, timing = even(plants.counted_at(t, t, rng, 0.02))
    assert timing.reading == "stamps"
    (part,) = parts
    np.testing.assert_allclose(
        part.recording.q[5:-5, 0], plants.counted_motion(part.recording.t[5:-5]), atol=5e-5
    )


def test_rows_of_an_uneven_clock_are_missing_only_where_time_passes_without_one() -> None:
    """Two rows that lie next to one place of the grid leave another one empty."""
    rng, fs = np.random.default_rng(7), 200.0
    t = np.sort(np.arange(6000) / fs + 0.15 / fs * rng.standard_normal(6000))
    t -= t[0]
    lost = rng.choice(np.arange(20, 5980, 4), 40, replace=False)
    kept = np.delete(np.arange(6000), lost)
    _, timing = even(plants.counted_at(t[kept], t[kept], rng, 0.02))
    assert timing.reading == "stamps"
    # some steps are as long as a lost row by themselves
    assert 40 <= len(timing.gaps) <= 60
    assert all(gap.length > 1.5 / fs for gap in timing.gaps)


@pytest.mark.parametrize("sizes", [(2, 3), (5, 6), (3, 13), (20, 21)])
@pytest.mark.parametrize("whole", [True, False])
def test_rows_from_a_queue_are_even(sizes: tuple[int, int], whole: bool) -> None:
    """Bursts within a tenth of a millisecond: the median step made 2 million rows of 30 000."""
    r = plants.queued(plants.counted_axis(), sizes)
    few = np.array([12_000, 12_001, 15_000])
    r = r if whole else plants.without(r, few, (7000, 7400), (16_000, 22_000))
    parts, timing = even(r)
    assert timing.rate == pytest.approx(1000.0, rel=1e-5)
    assert timing.queued == pytest.approx(sizes[1] - 1, abs=1)
    assert sum(g.rows for g in timing.gaps) == (0 if whole else 6403)
    assert len(parts) == (1 if whole else 2)
    assert any("as from a queue" in text for _, text in prepared(r).warnings)
    assert floor(r) == pytest.approx(floor(plants.counted_axis()), rel=0.02 if whole else 0.1)


def test_a_late_stamp_is_no_gap() -> None:
    r = plants.counted_axis(5.0)
    t = r.t.copy()
    t[2000] += 0.7e-3
    timing = even(replace(r, t=t))[1]
    assert not timing.gaps


def test_repeated_rows_are_left_out() -> None:
    r = plants.counted_axis(5.0)
    rows = np.sort(np.r_[np.arange(r.n), [500, 1200, 1201]])
    arrays = {k: getattr(r, k)[rows] for k in ("t", "q", "tau")}
    parts, timing = even(replace(r, **arrays))
    assert timing.repeated == 3
    np.testing.assert_array_equal(parts[0].recording.q, r.q)


def test_stale_rows_in_excess_are_left_out() -> None:
    """A logger a little faster than its source: 30 Hz of 29.4."""
    source = plants.counted_axis(60.0, 29.4)
    t = np.arange(int(59.9 * 30.0)) / 30.0
    newest = np.floor(t * 29.4 + 1e-9).astype(int)
    r = replace(source, t=t, q=source.q[newest], tau=source.tau[newest])
    (part,), timing = even(r)
    assert timing.excess
    assert timing.stale == pytest.approx(36, abs=2)
    assert timing.rate == pytest.approx(29.4, rel=1e-3)
    np.testing.assert_array_equal(part.recording.q, source.q[: part.recording.n])


def test_stale_rows_in_place_of_lost_ones_are_bridged() -> None:
    whole = plants.counted_axis(10.0, 100.0)
    q, tau = whole.q.copy(), whole.tau.copy()
    lost = np.array([200, 333, 410, 555, 620, 777, 850])
    q[lost], tau[lost] = q[lost - 1], tau[lost - 1]
    (part,), timing = even(replace(whole, q=q, tau=tau))
    assert (timing.excess, part.recording.n) == (False, whole.n)
    np.testing.assert_allclose(part.recording.q, whole.q, atol=1e-4)
    said = " ".join(prepared(replace(whole, q=q, tau=tau)).sentences)
    assert "7 rows missing or taken as missing in 7 gaps" in said


def test_a_slow_signal_logged_fast_has_its_own_rate() -> None:
    slow = plants.counted_axis(30.0, 100.0)
    rows = np.repeat(np.arange(slow.n), 10)
    r = replace(slow, t=np.arange(rows.size) / 1000.0, q=slow.q[rows], tau=slow.tau[rows])
    (part,), timing = even(r)
    assert timing.rate == pytest.approx(100.0, rel=1e-3)
    np.testing.assert_array_equal(part.recording.q, slow.q)
    assert Problem([r], AXIS.robot).rates == Problem([slow], AXIS.robot).rates
    assert floor(r) == pytest.approx(floor(slow), rel=0.01)


def test_efforts_that_are_held_alone_have_their_own_rate() -> None:
    fast = plants.counted_axis(30.0)
    tau = np.repeat(fast.tau[::10], 10, axis=0)
    r = replace(fast, tau=tau)
    timing = even(r)[1]
    assert timing.held == {"tau": 10}
    assert timing.source == pytest.approx(100.0)
    assert any(code == "held-samples" for code, _ in prepared(r).warnings)
    assert floor(r) < 5 * floor(fast)


@pytest.mark.parametrize("hold", [2, 5])
def test_positions_that_are_held_and_rest_are_filled_without_a_swing(hold: int) -> None:
    """Strokes with rests between them: a spline through the changes alone strayed by 0.2 rad."""
    fast = plants.ringing_axis(1, 20.0)
    rows = np.arange(fast.n) // hold * hold
    slow = replace(fast, q=fast.q[rows])
    (part,), timing = even(slow)
    assert timing.held == {"q": hold}
    stray = np.abs(part.recording.q - fast.q)[: part.recording.n]
    assert np.max(stray) < 2e-3 and np.sqrt(np.mean(stray**2)) < 3e-4
    # a rest of all channels is measured, too: no gap
    still = replace(slow, tau=np.sign(np.diff(slow.q, axis=0, append=slow.q[-1:]))[rows])
    assert not even(still)[1].gaps


def test_a_value_that_a_held_channel_lost_is_bridged() -> None:
    fast = plants.ringing_axis(1, 20.0)
    rows = np.arange(fast.n) // 5 * 5
    speed = np.abs(fast.q[rows + 4] - fast.q[rows])[:, 0]
    lost = 5 * np.flatnonzero(speed[::5] > 0.05)[::20]
    rows[np.isin(rows, lost)] -= 5
    (part,), timing = even(replace(fast, q=fast.q[rows]))
    assert timing.held == {"q": 5}
    assert np.max(np.abs(part.recording.q - fast.q)) < 0.02


def test_a_wrong_row_is_put_right() -> None:
    r = plants.counted_axis()
    q, tau = r.q.copy(), r.tau.copy()
    q[9000] += 0.5
    tau[20_000] -= 40.0
    wrong = replace(r, q=q, tau=tau)
    assert even(wrong)[1].wrong == 2
    assert floor(wrong) == pytest.approx(floor(r), rel=0.01)


@pytest.mark.parametrize("late", [-0.4, 0.3, 0.8])
def test_lateness_within_a_sample_is_found(late: float) -> None:
    fs = 200.0
    t = np.arange(int(40 * fs)) / fs
    rng = np.random.default_rng(4)
    seen, moved = (
        plants.counted_at(t, t, rng, 0.002),
        plants.counted_at(t, t + late / fs, rng, 0.002),
    )
    problem = Problem([replace(seen, tau=moved.tau)], AXIS.robot)
    fit_aligned(problem, AXIS)
    assert problem.shift == pytest.approx(late / fs, abs=0.1 / fs)
    ((code, text),) = late_effort(problem)
    assert code == "late-effort"
    assert ("early" if late > 0 else "late") in text
    assert longest_shift(problem) == pytest.approx(1.05 / fs)


def test_efforts_that_were_recorded_late_are_taken_earlier_and_early_ones_are_not() -> None:
    """No drive acts before its command: by more than a sample only the recording can be late."""
    run = plants.smooth_axis(7, extra=lambda t, q, v, a: 0.8 * np.sin(q))
    model = base_model(run.robot) + "spring"
    errors = {}
    for late in (0, 12, -12):
        problem = Problem([replace(run, tau=np.roll(run.tau, late, axis=0))], run.robot)
        errors[late] = float(fit_aligned(problem, model).rms[0])
        expected = -late / 500.0 if late > 0 else 0.0
        assert problem.shift == pytest.approx(expected, abs=0.001)
        said = late_effort(problem)
        assert [code for code, _ in said] == (["recorded-late"] if late > 0 else [])
    assert errors[12] < 1.3 * errors[0] < errors[-12]


def test_lateness_is_told_before_a_diagnosis() -> None:
    fs = 200.0
    t = np.arange(int(40 * fs)) / fs
    rng = np.random.default_rng(4)
    seen, moved = (
        plants.counted_at(t, t, rng, 0.002),
        plants.counted_at(t, t - 0.4 / fs, rng, 0.002),
    )
    found = lateness(replace(seen, tau=moved.tau, robot=AXIS.robot))
    assert found.seconds == pytest.approx(0.4 / fs, abs=0.1 / fs)
    assert found.samples == pytest.approx(0.4, abs=0.1)
    assert " late (" in found.text
    same = lateness(replace(seen, robot=AXIS.robot))
    assert same.seconds == pytest.approx(0.0, abs=0.1 / fs)
    two = replace(seen, joints=("a", "b"), q=np.tile(seen.q, 2), tau=np.tile(seen.tau, 2), qd=None)
    blind = lateness(replace(two, robot=AXIS.robot))
    assert blind.seconds is None and "--robot ARM.urdf" in blind.text
    given = replace(seen, robot=AXIS.robot, metadata={"signal_shift_s": "0.002"})
    assert lateness(given).seconds == -0.002
    moved = plants.counted_at(t, t - 4.0 / fs, rng, 0.002)
    beyond = lateness(replace(seen, tau=moved.tau, robot=AXIS.robot))
    assert beyond.samples == pytest.approx(4.0, abs=0.5) and " late" in beyond.text


def test_a_given_shift_is_taken() -> None:
    model = replace(AXIS, band=Band(shift_s=0.002))
    problem = Problem([plants.counted_axis(20.0)], model.robot, band=model.band)
    fit_aligned(problem, model)
    assert problem.shift == 0.002


def test_what_a_map_says_of_the_signal_holds_where_the_model_is_silent() -> None:
    r = replace(
        plants.counted_axis(5.0), metadata={"signal_effort_hz": "7.0", "signal_rate_hz": "990.0"}
    )
    assert signal(Band(), r).effort_hz == 7.0
    assert signal(Band(effort_hz=9.0), r) == Band(effort_hz=9.0, rate_hz=990.0)
    assert prepared(r).rates.effort == 7.0
    assert prepared(r).timing.rate == pytest.approx(990.0)


@pytest.mark.parametrize(("noise", "low", "high"), [(1e-5, 12.0, 12.0), (3e-3, 4.0, 8.0)])
def test_the_band_follows_signal_over_noise(noise: float, low: float, high: float) -> None:
    r = plants.counted_axis()
    q = plants.counted_motion(r.t)[:, None] + noise * np.random.default_rng(5).normal(
        size=r.q.shape
    )
    assert low <= choose([replace(r, q=q)], Band(), True).effort <= high


@pytest.mark.parametrize(("last", "least", "most"), [(5.0, 5.0, 25.0), (40.0, 26.0, 42.0)])
def test_a_motion_that_is_faster_than_the_widest_band_is_read_as_far_as_it_goes(
    last: float, least: float, most: float
) -> None:
    """A chirp through the resonances of a structure was cut at 25 Hz, and they with it."""
    t = np.arange(20_000) / 1000.0
    speed = np.sin(2 * np.pi * (0.5 * t + (last - 0.5) / 40.0 * t**2))
    r = replace(plants.counted_axis(20.0), t=t, q=np.cumsum(speed)[:, None] * 1e-4, qd=None)
    noise = 1e-7 * np.random.default_rng(5).normal(size=r.q.shape)
    effort = np.gradient(speed)[:, None] + 1e-4 * np.random.default_rng(6).normal(size=r.q.shape)
    found = choose([replace(r, q=r.q + noise, tau=effort)], Band(), True)
    assert least <= found.effort <= most and ("the motion itself" in found.why) == (last > 25.0)


@pytest.mark.parametrize("noise", [3e-5, 3e-4, 1e-3])
def test_acceleration_stands_clear_of_known_noise_up_to_a_known_frequency(noise: float) -> None:
    r = plants.counted_axis(60.0)
    q = plants.counted_motion(r.t)[:, None] + noise * np.random.default_rng(5).normal(
        size=r.q.shape
    )
    rms = np.sqrt((0.6 * (2 * np.pi * 0.37) ** 2) ** 2 + (0.2 * (2 * np.pi * 1.13) ** 2) ** 2)
    rms /= np.sqrt(2)
    known = (ACCELERATION_NOISE * rms / (noise * (2 * np.pi) ** 2) * np.sqrt(FS / 0.4)) ** 0.4
    (found,), _ = information(replace(r, q=q))
    assert found == pytest.approx(known, rel=0.1)


def test_one_bad_joint_does_not_set_the_band() -> None:
    r, rng = plants.counted_axis(), np.random.default_rng(6)
    three = np.repeat(r.q, 3, axis=1)
    three[:, 2] += 3e-3 * rng.normal(size=r.n)
    joints = ("a", "b", "c")
    arm = replace(r, joints=joints, q=three, tau=np.repeat(r.tau, 3, axis=1))
    alone = choose([r], Band(), True)
    assert choose([arm], Band(), True).effort == pytest.approx(alone.effort, rel=0.05)


def test_what_was_done_is_said() -> None:
    r = plants.without(plants.counted_axis(20.0), np.arange(8000, 8040))
    found = prepared(r)
    assert "40 rows missing in 1 gap" in " ".join(found.sentences)
    said = found.as_dict()
    assert said["gaps"] == [
        {"after_s": 7.999, "length_s": pytest.approx(0.041), "rows": 40, "split": False}
    ]
    assert found.left_out == pytest.approx(0.04, abs=0.2)


def recorded(case: str, kind: str = "train") -> list[Recording]:
    folder = Path(DATA) / case
    if not DATA or not folder.is_dir():
        pytest.skip(f"HIL_DATA has no {case}")
    urdf = (folder / "robot.urdf").read_text()
    names = tuple(j.name for j in urdf_joints(urdf))
    out = []
    for path in sorted(folder.glob(f"{kind}_*.npz")):
        x = np.load(path)
        q, tau = (
            np.stack([x[f"{stem}{k + 1}"] for k in range(len(names))], axis=1)
            for stem in ("q", "tau")
        )
        robot = RobotSource("", urdf, "")
        out.append(Recording(path.stem, "arm", names, x["t"], q, tau, robot=robot))
    return out


def test_thirty_hertz_of_seven_joints() -> None:
    (r,) = recorded("panda_30hz")
    found = prepared(r)
    assert (found.timing.stale, found.timing.excess) == (8, True)
    assert 5.0 <= found.rates.effort <= 6.5
    assert 6.0 <= found.rates.position <= 10.5
    assert Problem([r], r.robot).n > 200


def test_a_cable_arm() -> None:
    runs = recorded("wam_follower")
    problem = Problem(runs, runs[0].robot)
    assert 8.0 <= problem.rates.effort <= 16.0
    result = fit_aligned(problem, base_model(runs[0].robot))
    assert np.all(np.isfinite(result.theta))
    assert any(code == "excitation" for code, _ in prepared(runs[0]).warnings)


@pytest.mark.parametrize("what", ["clock", "velocity"])
def test_the_dynamics_tell_a_wrong_clock_from_wrong_velocities(what: str) -> None:
    """An arm that lifts itself: gravity stays, inertia goes with the square of the clock."""
    r = plants.spatial(3)
    r = replace(r, qd=np.gradient(r.q, r.t, axis=0))
    assert r.qd is not None
    assert readings(r) == []
    wrong = replace(r, t=2.0 * r.t) if what == "clock" else replace(r, qd=2.0 * r.qd)
    found = readings(wrong)
    assert {x.what for x in found} >= {"clock", "velocity"}
    assert found[0].what == what
    ((code, text),) = reading_notes(wrong)
    assert code == "velocity-scale"
    assert "the dynamics fit better if" in text


def test_degrees_in_one_position() -> None:
    r = plants.spatial(3)
    q, qd = r.q.copy(), np.gradient(r.q, r.t, axis=0)
    q[:, 1] *= 180 / np.pi
    found = readings(replace(r, q=q, qd=qd))
    assert found[0].what == "position"
    assert "upper" in found[0].text


@pytest.mark.parametrize(("error", "share"), [(0.0, 1.0), (0.5, 0.5), (0.25, 0.8)])
def test_what_is_hardly_known_of_a_lateness_is_hardly_taken_out(
    monkeypatch: pytest.MonkeyPatch, error: float, share: float
) -> None:
    """By its error in samples, against half a sample before the data are seen."""
    problem = Problem([plants.counted_axis(20.0)], AXIS.robot)
    result, longest = fit(problem, AXIS), longest_shift(problem)
    late = 0.6 * longest, max(error * longest, 1e-9) * 0.999
    monkeypatch.setattr("hil.identify.slow_motion.slow_delay", lambda *_, **__: late)
    assert sample_shift(result)[0] == pytest.approx(0.6 * share * longest, rel=2e-3)


def test_a_lateness_that_raises_the_error_of_the_whole_band_is_not_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However sure the slow motion is: the sign of friction may be blunt there."""
    problem = Problem([plants.counted_axis(20.0, noise=1e-3)], AXIS.robot)
    told = iter([(-0.8 * longest_shift(problem), 1e-9), (0.0, 0.0)])
    monkeypatch.setattr("hil.identify.timing.sample_shift", lambda *_: next(told))
    result = fit_aligned(problem, AXIS)
    assert problem.shift == 0.0
    assert result.relative[0] == pytest.approx(fit(problem, AXIS).relative[0])


@pytest.mark.parametrize(
    ("late", "error", "taken"), [(-1.2, 0.1, -1.0), (1.2, 0.1, 0.0), (-1.2, 0.01, 0.0)]
)
def test_efforts_late_by_hardly_more_than_a_sample_are_so_by_one(
    monkeypatch: pytest.MonkeyPatch, late: float, error: float, taken: float
) -> None:
    """An early one may be a drive's delay; what is late by more for sure was recorded so."""
    problem = Problem([plants.counted_axis(20.0)], AXIS.robot)
    result, longest = fit(problem, AXIS), longest_shift(problem)
    told = late * longest, error * longest
    monkeypatch.setattr("hil.identify.slow_motion.slow_delay", lambda *_, **__: told)
    assert sample_shift(result)[0] == pytest.approx(taken * longest)


@pytest.mark.parametrize("late", [1.02, 1.08, 1.15, 1.3])
def test_no_lateness_between_one_sample_and_more_stays(late: float) -> None:
    fs = 200.0
    t = np.arange(int(40 * fs)) / fs
    rng = np.random.default_rng(4)
    seen, moved = (plants.counted_at(t, t - d / fs, rng, 0.02) for d in (0.0, late))
    problem = Problem([replace(seen, tau=moved.tau)], AXIS.robot)
    fit_aligned(problem, AXIS)
    # one sample for 1.3 of them is just as far as that
    assert problem.shift == pytest.approx(-late / fs, abs=(0.3 + 1e-9) / fs)


def test_parts_that_contradict_each_other_know_little() -> None:
    covariance = 1e-8 * np.eye(4)
    mean, error = _agreed(np.array([1.0, 1.1, 0.9, 1.0]) * 1e-3, covariance)
    assert mean == pytest.approx(1e-3) and error == pytest.approx(5e-5, rel=0.2)
    mean, error = _agreed(np.array([1.0, -1.0, 3.0, 1.0]) * 1e-3, covariance)
    assert mean == pytest.approx(1e-3) and error == pytest.approx(8.2e-4, rel=0.01)


def test_one_late_joint_beside_one_in_time_is_late_itself() -> None:
    """All joints share their stamps, so that less than a sample is its own: no alignment."""
    run = plants.late_axes((0, 1))
    coarse = replace(run, t=run.t[::2], q=run.q[::2], tau=run.tau[::2])
    model = base_model(run.robot)
    result = fit(Problem([coarse], run.robot), model)
    late, error = slow_delay(result, 1)
    assert CLEAR * error < late < longest_shift(result.problem)
    assert real_delay(result, 1, late)
    alone = replace(coarse, joints=("joint2",), q=coarse.q[:, 1:], tau=coarse.tau[:, 1:])
    result = fit(Problem([alone], run.robot), model)
    assert not real_delay(result, 0, late)


@pytest.mark.parametrize(("error", "shifted"), [(0.3, False), (0.05, True)])
def test_an_unsure_lateness_that_the_whole_band_denies_is_not_taken_out(
    monkeypatch: pytest.MonkeyPatch, error: float, shifted: bool
) -> None:
    """Dry friction about reversals looks early or late in short runs with stops."""
    problem = Problem([plants.counted_axis(20.0)], AXIS.robot)
    longest = longest_shift(problem)
    told = 0.6 * longest, error * longest
    monkeypatch.setattr("hil.identify.slow_motion.slow_delay", lambda *_, **__: told)
    monkeypatch.setattr("hil.identify.timing._ratio", lambda *_: 1.1)
    assert bool(fit_aligned(problem, AXIS).problem.shift) is shifted


def test_joints_that_differ_know_their_common_lateness_as_badly_as_they_differ() -> None:
    value, error = _middle([(1.0, 0.1), (1.1, 0.1), (0.9, 0.1)], 0.01)
    assert (value, error) == (1.0, pytest.approx(0.1 / np.sqrt(3)))
    assert _middle([(1.0, 0.1), (3.0, 0.1), (-1.0, 0.1)], 0.01)[1] > 1.0


@pytest.mark.parametrize("of_instants", [True, False])
def test_efforts_of_instants_have_no_value_between_slow_rows(of_instants: bool) -> None:
    t, fine = np.arange(0, 60, 1e-3), 20
    size, phase = np.array([0.3, 0.1, 0.05]), np.random.default_rng(1).uniform(0, 2 * np.pi, 3)
    q, v, a = plants.sines(t, 2 * np.pi * np.array([0.37, 0.83, 1.31]), size, phase)
    effort = 2 * a + 1.5 * np.sign(v)
    if not of_instants:
        effort = np.convolve(effort, np.full(fine + 1, 1 / (fine + 1)), "same")
    rows = slice(fine // 2, None, fine)
    noise = 0.01 * np.random.default_rng(2).normal(size=t[rows].size)
    run = plants.single("slow", t[rows], np.round(q[rows] / 1e-6) * 1e-6, effort[rows] + noise)
    problem = Problem([run], run.robot)
    (motion,) = problem.motions
    assert problem.of_instants is of_instants
    # averages are asked for at instants between the rows, each over a row
    assert motion.n == (run.n if of_instants else 2 * run.n - 1)
    assert motion.average == (0.0 if of_instants else pytest.approx(run.period))
