"""`hil bench wire`: every driver has its row, and no time is counted twice."""

import time

from hil.bench import wire


def test_every_driver_and_box_has_a_row():
    found = {c.name: c for c in wire.costs(ticks=40)}
    boxes = {
        "box encoders",
        *(f"box {a}-motor{k}" for a in ("leader", "follower") for k in (1, 2, 3)),
    }
    assert boxes <= set(found)
    for arm in ("leader", "follower"):
        rows = (f"{arm}-arm measured_js", f"{arm}-arm servo_jf", f"{arm}-force measured_cf")
        assert all(0 < found[r].median <= found[r].p99 for r in rows)
    whole = found["whole tick"].median
    parts = sum(c.median for name, c in found.items() if not name.startswith("whole"))
    assert 0.3 * whole < parts < 1.2 * whole


def test_time_within_other_named_calls_is_theirs():
    watch = wire.Stopwatch()

    def spin(ns):
        until = time.perf_counter_ns() + ns
        while time.perf_counter_ns() < until:
            pass

    inner = watch.timed("inner", lambda: spin(2_000_000))
    outer = watch.timed("outer", lambda: (spin(1_000_000), inner(), inner()))
    outer()
    assert watch.now["inner"] >= 4_000_000
    assert 1_000_000 <= watch.now["outer"] < 4_000_000


def test_a_speed_is_that_of_a_whole_session():
    found = wire.speed("sim", seconds=0.2)
    assert found.wall > 0
    assert found.cpu > 0
    assert found.backend == "sim"
