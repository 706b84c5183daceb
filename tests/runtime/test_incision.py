"""Two arms of six joints, coupled at their tips; the instrument goes through an incision."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from hil.errors import ConfigError
from hil.rig.config import load_rig
from hil.rig.open import build_controller, open_rig
from hil.runtime import runner

#: When the hand has begun to move [s].
BEGUN_S = 3.0


def session(path, seconds=5.0, **law):
    """What the simulation knows of a session: shaft, tips, and force on the wall."""
    rows = []

    def opener(config, seed):
        rig = open_rig(config, seed)
        hand, tool = (rig.bench.arms[name].touched[0] for name in ("leader", "follower"))
        seen = (tool["wall_off"], tool["wall_force"], hand["tip"], tool["tip"])
        rig.bench.after.append(lambda t: rows.append([x.copy() for x in seen]))
        return rig

    config = load_rig("surgical", {"controller": {"parameters": law}} if law else {})
    ended = runner.run_session(config, seconds, 1, "lockstep", path, opener=opener)
    begun = int(BEGUN_S / seconds * len(rows))
    off, force, leader, follower = (np.array(x)[begun:] for x in zip(*rows, strict=True))
    track = follower - follower[0] - 0.5 * (leader - leader[0])  # motion_scale of the rig
    return ended, {"off": rms(off), "force": rms(force), "track": rms(track), "tip": follower}


def rms(x):
    """Root mean square length of vectors (n, 3)."""
    return float(np.sqrt(np.mean(np.sum(x**2, axis=1))))


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("incision")
    # with the rig's own stiffness, the law that holds no shaft is refused
    soft = {"stiffness": 1000.0, "damping": 12.0}
    free = session(folder / "free.mcap", incision_depth=0.0, **soft)
    return session(folder / "held.mcap", **soft), free


def test_the_rig_runs_to_its_end_with_and_without_the_constraint(sessions):
    for ended, seen in sessions:
        assert ended.state == "ENABLED" and ended.limited == 0
        assert np.all(np.ptp(seen["tip"], axis=0) > 5e-3)


def test_the_constraint_keeps_the_shaft_in_the_incision(sessions):
    """Lateral motion and force on the wall fall by more than five; the tips follow no worse."""
    (_, held), (_, free) = sessions
    assert held["off"] < free["off"] / 5 and held["off"] < 1e-3
    assert held["force"] < free["force"] / 5
    assert held["track"] < 1.2 * free["track"]


def test_the_law_allocates_nothing_that_stays():
    config = load_rig("surgical")
    law, period = build_controller(config), config.loop.period_ns * 1e-9
    n = len(law.state_names)
    x, x_next, u, y = np.zeros(n), np.zeros(n), np.zeros((2, 18)), np.zeros((2, 6))
    tracemalloc.start()
    for k in range(500):
        law.update(k * period, x, u, x_next, y)
    before = tracemalloc.take_snapshot()
    for k in range(500):
        law.update(k * period, x, u, x_next, y)
    grown = tracemalloc.take_snapshot().compare_to(before, "filename")
    tracemalloc.stop()
    assert np.isfinite(y).all()
    assert sum(s.size_diff for s in grown if "controllers" in s.traceback[0].filename) < 512


def test_a_force_sensor_that_would_be_turned_by_the_joints_of_another_arm_is_refused():
    sensor = {
        "driver": "ft-sensor",
        "arm": "follower",
        "channels": {"gauges": ["tool-ft/0"]},
        "options": {"model": "nano17"},
    }
    box = {"driver": "netft-rdt", "address": "192.168.1.1"}
    config = load_rig("surgical", {"devices": {"tool-force": sensor}, "boxes": {"tool-ft": box}})
    with pytest.raises(ConfigError, match="'tool-force' turns what it reads by the joints"):
        open_rig(config, 1)
