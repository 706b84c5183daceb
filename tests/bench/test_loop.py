"""What `hil bench loop` measures: arrangements of loop and slow side that all record everything."""

import os

import numpy as np
import pytest

from hil.bench import loop
from hil.bench.loop import SeparateProcessSession, SharedRing
from hil.record.container import read
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.runtime.replay import replay

needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


@pytest.mark.real_time
@needs_fork
def test_a_slow_side_in_a_process_writes_the_whole_session(tmp_path):
    path = tmp_path / "s.mcap"
    config = load_rig(rig_path("teleop"), {"loop": {"realtime": False}})
    done = runner.run_session(config, 0.3, 1, "real", path, kind=SeparateProcessSession)
    box = read(path)
    assert not box.truncated and len(box.topics["/loop/timing"].times) == done.ticks
    assert done.figures["ticks"] == done.ticks
    # late at the end, the last tick lies behind it
    assert done.ticks + done.missed == round(1000 * done.seconds) >= 300
    assert "loop" in box.metadata
    found = replay(path)
    assert found.compared == done.ticks and found.differ == 0


@needs_fork
def test_the_shared_ring_is_a_ring_across_processes():
    ring = SharedRing(4, 2)
    child = os.fork()
    if child == 0:
        for k in range(6):
            ring.push(k, 10 * k, np.array([k, -k], float))
        os._exit(ring.dropped)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 2
    stamps, data = ring.take()
    assert stamps[:, 0].tolist() == [0, 1, 2, 3] and data[:, 1].tolist() == [0, -1, -2, -3]
    assert len(ring) == 0


@pytest.mark.real_time
@needs_fork
def test_a_process_that_dies_is_an_error_and_not_a_figure(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.bench.loop.session.conclude", lambda *a: 1 / 0)
    config = load_rig(rig_path("teleop"), {"loop": {"realtime": False}})
    with pytest.raises(OSError, match="process of the slow side ended with status"):
        runner.run_session(
            config, 0.05, 1, "real", tmp_path / "s.mcap", kind=SeparateProcessSession
        )


@pytest.mark.real_time
def test_the_rows_are_those_that_are_promised():
    names = [run.__name__ for run in loop.RUNS]
    assert names[:3] == ["cyclictest", "sleeping_loop", "hil_loop"] and len(names) == 11
    assert names[3:6] == ["loaded"] * 3
    found = loop.hil_loop(0.05, "2 kHz", rate_hz=2000.0, realtime=False)
    assert found.name.endswith("2 kHz") and found.ticks + found.missed >= 100


@pytest.mark.parametrize("rate", [2000, 4000])
@pytest.mark.parametrize("rig", ["teleop", "identify"])
def test_faster_loops_record_every_tick_and_are_reproduced(rate, rig, tmp_path):
    path = tmp_path / "s.mcap"
    config = load_rig(rig_path(rig), {"loop": {"rate_hz": float(rate)}})
    done = runner.run_session(config, 0.5, 1, "lockstep", path)
    assert (done.ticks, done.state) == (rate // 2, "ENABLED")
    times = np.array(read(path).topics["/loop/timing"].times)
    assert set(np.diff(times).tolist()) == {10**9 // rate}
    found = replay(path)
    assert (found.compared, found.differ) == (rate // 2, 0)


def test_the_median_of_the_turns_is_published():
    turns = [loop.LoopRun("a", 100, m, 1.0 * m, 2.0, 3.0, 4.0, share=m) for m in (3, 1, 2)]
    found = loop.median_run(turns)
    assert (found.ticks, found.missed, found.p50, found.p99, found.share) == (100, 2, 2.0, 2.0, 2.0)


def test_like_for_like_is_said():
    names = ("cyclictest -m -p 80 -a", "hil run, full recording, sleeps to the tick")
    found = [
        loop.LoopRun(name + load, 1000, k, 1.0, 10.0 * k, 2.0, 3.0, share=5.0 * k)
        for load in ("", ", under load")
        for k, name in enumerate((*names, "hil run, full recording"), 1)
    ]
    said = loop.loop_verdict(found).splitlines()
    assert len(said) == 2
    assert said[1].startswith("p99, under load: cyclictest 10 us; the loop 20 us where it sleeps")
    assert "(10 % of a core), 30 us where it spins" in said[1]


@pytest.mark.real_time
def test_a_loop_that_sleeps_to_the_tick_takes_less_of_the_processor():
    spins, sleeps = (
        loop.hil_loop(1.0, realtime=False),
        loop.hil_loop(1.0, spin_ns=0, realtime=False),
    )
    assert 0.0 < sleeps.share < spins.share < 300.0


def test_what_lacks_for_the_load_is_said(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    found = loop.under_load(loop.hil_loop)(1.0)
    assert (found.ticks, found.note) == (0, "stress-ng is not installed")


def page_run(name, p99, note=""):
    return loop.LoopRun(name, 1000, 0, 1.0, p99, 10.0, 20.0, note)


def page_table(once_more, opened):
    """Table of two turns: p99 without a page 2 us, and of the other runs as given."""
    closed = [page_run("no page", 2.0)] * 2
    others = {"no page, once more": once_more, "page open": opened}
    rows = [loop.page_row(closed, closed)]
    return rows + [
        loop.page_row([page_run(name, x) for x in p99], closed) for name, p99 in others.items()
    ]


def test_a_page_within_what_two_runs_without_it_differ_by_is_not_seen():
    found = page_table((1.0, 3.0), (2.5, 3.5))
    assert found[2].p99 == (1.25, 1.5, 1.75)
    assert "does not feel the page" in loop.page_verdict(found)
    cells = loop.page_rows(found)
    assert all(len(row) == len(loop.PAGE_HEAD) for row in cells)
    assert "1.50 (1.25-1.75)" in cells[2]


def test_a_page_that_makes_the_loop_late_is_named():
    assert "page open 4.50" in loop.page_verdict(page_table((1.8, 2.2), (8.0, 10.0)))


def test_without_a_browser_the_table_says_what_is_needed(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    opened = loop.beside_page(1.0, 1)
    assert "Chromium" in opened.note
    closed = [page_run("no page", 2.0)]
    found = [loop.page_row(x, closed) for x in (closed, closed, [opened])]
    assert "nothing to compare" in loop.page_verdict(found)
    assert "-" in loop.page_rows(found)[2]
