"""The committed comparison of velocity estimators is what its command prints."""

from pathlib import Path

import numpy as np

from hil.bench import velocity

PAGE = Path(__file__).parents[2] / "docs" / "bench" / "velocity.md"


def test_the_committed_tables_are_the_commands():
    text = PAGE.read_text(encoding="utf-8").splitlines()
    fresh = velocity.velocity_table(
        velocity.compare_estimators(["1 Hz, 0.02 rad/s", "1 Hz, 3 rad/s"]), 4
    )
    assert [line for line in fresh if line not in text] == []


def test_delay_is_found_where_it_is_put():
    t = np.arange(4000) * 1e-3
    sines = velocity.VELOCITY_MOTIONS["hand"]
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(t))
    late = velocity.velocity(sines, t - 4.3e-3)

    def true(x):
        return velocity.velocity(sines, x)

    row = velocity.judge_estimate("x", "hand", t, late + noise, true)
    assert abs(row.delay_ms - 4.3) < 0.3
    assert abs(row.noise - 0.01) < 0.001
    assert np.isnan(velocity.judge_estimate("x", "hand", t, late + 100 * noise, true).delay_ms)


def test_positions_and_accelerations_belong_to_the_velocity():
    t = np.arange(0, 1, 1e-5)
    for sines in velocity.VELOCITY_MOTIONS.values():
        v = velocity.velocity(sines, t)
        np.testing.assert_allclose(
            np.gradient(velocity.true_position(sines, t), t)[1:-1], v[1:-1], atol=1e-4
        )
        slope = np.gradient(v, t)[1:-1]
        np.testing.assert_allclose(slope, velocity.acceleration(sines, t)[1:-1], atol=1e-3)
