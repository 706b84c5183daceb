"""Friction, gel, drive and sensors of the simulator."""

import numpy as np
import pytest

from hil.sim_devices.bench import open_bench
from hil.sim_devices.plants import world
from hil.sim_devices.plants.layout import ARM_STATE_DTYPE, ELEMENTS, GEL_DTYPE

ARMS = {"leader": "nano25", "follower": "nano17"}


def test_maxwell_slip_saturates_and_reverses_over_twice_the_breakaway():
    z, limit = np.zeros(ELEMENTS), np.full(ELEMENTS, 1e-3)
    weight = np.full(ELEMENTS, 1 / ELEMENTS)
    assert world.slip(z, limit, weight, 1.0, 0.01) == pytest.approx(1.0)
    # back by the breakaway distance: friction is zero; by twice: it is reversed
    assert world.slip(z, limit, weight, -1.0, 1e-3) == pytest.approx(0.0, abs=1e-12)
    assert world.slip(z, limit, weight, -1.0, 1e-3) == pytest.approx(-1.0)


def test_nested_elements_remember():
    z, weight = np.zeros(ELEMENTS), np.full(ELEMENTS, 1 / ELEMENTS)
    limit = np.array([1e-3, 2e-3, 4e-3, 8e-3])
    for _ in range(20):
        world.slip(z, limit, weight, 1.0, 1e-3)
    before = world.slip(z, limit, weight, 0.0, 1e-3)
    world.slip(z, limit, weight, -1.0, 3e-3)
    assert world.slip(z, limit, weight, 1.0, 3e-3) == pytest.approx(before)


def test_a_bolt_stiffens_the_gel_above_it_and_its_flank_makes_no_energy():
    gel, x = np.zeros(1, GEL_DTYPE), np.zeros(1, ARM_STATE_DTYPE)
    gel["stiffness"], gel["power"], gel["relaxation"], gel["on"] = 250.0, 1.3, 1.0, 1
    gel["bolt"], gel["bolt_y"], gel["bolt_width"] = 1.5, 0.01, 0.007

    def pushed(y, z):
        x["tip"][0], x["force"] = (0.0, y, z), 0.0
        world.press_gel(gel[0], x[0], 1e-6)
        return x["force"][0].copy()

    above, beside = pushed(0.01, -0.005), pushed(0.05, -0.005)
    assert above[2] == pytest.approx(2.5 * beside[2], rel=1e-6)
    assert above[1] == pytest.approx(0.0, abs=1e-12) and beside[1] == pytest.approx(0.0, abs=1e-6)
    assert pushed(0.005, -0.005)[1] < -0.05 and pushed(0.015, -0.005)[1] > 0.05
    # around a closed way without speed: no work
    angle = np.linspace(0.0, 2 * np.pi, 2001)
    way = np.stack([0.01 + 0.008 * np.cos(angle), -0.006 + 0.004 * np.sin(angle)], 1)
    forces = np.array([pushed(*p)[1:] for p in 0.5 * (way[1:] + way[:-1])])
    parts = np.sum(forces * np.diff(way, axis=0), axis=1)
    assert abs(parts.sum()) < 1e-5 * np.abs(parts).sum()


@pytest.mark.parametrize(
    ("bolt", "said"),
    [
        ({"depth": 0.03}, "depth = 0.03 m"),
        ({"radius": 0.0}, "radius = 0 m"),
        ({"deep": 0.01}, "Did you mean 'depth'"),
    ],
)
def test_a_bolt_that_cannot_be_is_refused(bolt, said):
    with pytest.raises(ValueError, match=said):
        open_bench(ARMS, {"gel": {"arm": "follower", "bolt": bolt}}, 1_000_000, 0)


def test_gel_pushes_only_and_dissipates():
    gel, x = np.zeros(1, GEL_DTYPE), np.zeros(1, ARM_STATE_DTYPE)
    gel["stiffness"], gel["power"], gel["damping"] = 700.0, 1.3, 0.8
    gel["branch"], gel["relaxation"], gel["on"] = 60.0, 1.0, 1
    work, dt = 0.0, 1e-4
    for t in np.arange(0, 1, dt):
        x["tip"][0, 2] = -0.005 * np.sin(2 * np.pi * t)
        x["tip_v"][0, 2] = -0.01 * np.pi * np.cos(2 * np.pi * t)
        x["force"] = 0.0
        world.press_gel(gel[0], x[0], dt)
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
