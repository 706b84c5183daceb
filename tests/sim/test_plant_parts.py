"""Friction, gel, drive and sensors of the simulator."""

import numpy as np
import pytest

from hil.sim_devices.bench import open_bench
from hil.sim_devices.plants import friction, world
from hil.sim_devices.plants.layout import ELEMENTS, GEL, STATE

ARMS = {"leader": "nano25", "follower": "nano17"}


def test_maxwell_slip_saturates_and_reverses_over_twice_the_breakaway():
    z, limit = np.zeros(ELEMENTS), np.full(ELEMENTS, 1e-3)
    weight = np.full(ELEMENTS, 1 / ELEMENTS)
    assert friction.slip(z, limit, weight, 1.0, 0.01) == pytest.approx(1.0)
    # back by the breakaway distance: friction is zero; by twice: it is reversed
    assert friction.slip(z, limit, weight, -1.0, 1e-3) == pytest.approx(0.0, abs=1e-12)
    assert friction.slip(z, limit, weight, -1.0, 1e-3) == pytest.approx(-1.0)


def test_nested_elements_remember():
    z, weight = np.zeros(ELEMENTS), np.full(ELEMENTS, 1 / ELEMENTS)
    limit = np.array([1e-3, 2e-3, 4e-3, 8e-3])
    for _ in range(20):
        friction.slip(z, limit, weight, 1.0, 1e-3)
    before = friction.slip(z, limit, weight, 0.0, 1e-3)
    friction.slip(z, limit, weight, -1.0, 3e-3)
    assert friction.slip(z, limit, weight, 1.0, 3e-3) == pytest.approx(before)


def test_gel_pushes_only_and_dissipates():
    gel, x = np.zeros(1, GEL), np.zeros(1, STATE)
    gel["stiffness"], gel["power"], gel["damping"] = 700.0, 1.3, 0.8
    gel["branch"], gel["relaxation"], gel["on"] = 60.0, 1.0, 1
    work, dt = 0.0, 1e-4
    for t in np.arange(0, 1, dt):
        x["tip"][0, 2] = -0.005 * np.sin(2 * np.pi * t)
        x["tip_v"][0, 2] = -0.01 * np.pi * np.cos(2 * np.pi * t)
        x["force"] = 0.0
        world.press(gel[0], x[0], dt)
        assert x["force"][0, 2] >= 0.0
        work += x["force"][0, 2] * x["tip_v"][0, 2] * dt
    assert work < -1e-6


def test_a_docked_arm_does_not_move_and_a_free_one_falls():
    bench = open_bench(ARMS, {}, 1_000_000, 1)
    leader = bench.wire("leader")
    bench.wire("follower").power(True)
    rest = leader.counts.copy(), bench.wire("follower").counts.copy()
    leader.receive(300_000_000)
    assert (leader.counts == rest[0]).all()
    assert (bench.wire("follower").counts != rest[1]).any()


def test_counts_are_whole_and_stand_for_the_motor_angle():
    bench = open_bench(ARMS, {"home": [0.1, 0.5, 0.2]}, 1_000_000, 1)
    counts = bench.wire("leader").counts
    per_radian = np.array([13.3, 11.2, 11.2]) * 4096 / (2 * np.pi)
    np.testing.assert_array_equal(counts, np.floor(np.array([0.1, 0.5, 0.2]) * per_radian))


def test_the_noise_of_a_seed_is_its_own():
    words = []
    for seed in (1, 1, 2):
        bench = open_bench(ARMS, {}, 1_000_000, seed)
        bench.advance(50_000_000)
        words.append(bench.gauges.copy())
    assert (words[0] == words[1]).all()
    assert (words[0] != words[2]).any()
