"""`hil bench wire`: every driver has its row, and no time is counted twice."""

import pytest

from hil.bench import wire


@pytest.mark.slow
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
    assert list(found)[-1] == "whole tick"
    assert found[wire.WORLD].median > 0


@pytest.mark.real_time
def test_a_session_in_real_time_says_what_its_ticks_took():
    found = wire._tick_times(seconds=0.3)
    assert found.name == wire.SESSION
    assert 0 < found.median <= found.p99


def test_time_within_other_named_calls_is_theirs():
    now = [0]

    def work(ns):
        now[0] += ns

    watch = wire.Stopwatch(lambda: now[0])
    inner = watch.timed("inner", lambda: work(2))
    outer = watch.timed("outer", lambda: (work(1), inner(), inner()))
    outer()
    assert watch.now == {"inner": 4, "outer": 1}


def test_a_speed_is_that_of_a_whole_session():
    found = wire.session_speed("sim", seconds=0.2)
    assert found.wall > 0
    assert found.cpu > 0
    assert found.backend == "sim"
