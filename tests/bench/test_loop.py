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
    done = runner.run(config, 0.3, 1, "real", path, kind=SeparateProcessSession)
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
        runner.run(config, 0.05, 1, "real", tmp_path / "s.mcap", kind=SeparateProcessSession)


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
    done = runner.run(config, 0.5, 1, "lockstep", path)
    assert (done.ticks, done.state) == (rate // 2, "ENABLED")
    times = np.array(read(path).topics["/loop/timing"].times)
    assert set(np.diff(times).tolist()) == {10**9 // rate}
    found = replay(path)
    assert (found.compared, found.differ) == (rate // 2, 0)


def test_the_median_of_the_turns_is_published():
    turns = [loop.LoopRun("a", 100, m, 1.0 * m, 2.0, 3.0, 4.0, share=m) for m in (3, 1, 2)]
    found = loop.median(turns)
    assert (found.ticks, found.missed, found.p50, found.p99, found.share) == (100, 2, 2.0, 2.0, 2.0)


def test_like_for_like_is_said():
    names = ("cyclictest -m -p 80 -a", "hil run, full recording, sleeps to the tick")
    found = [
        loop.LoopRun(name + load, 1000, k, 1.0, 10.0 * k, 2.0, 3.0, share=5.0 * k)
        for load in ("", ", under load")
        for k, name in enumerate((*names, "hil run, full recording"), 1)
    ]
    said = loop.verdict(found).splitlines()
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
