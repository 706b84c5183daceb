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
    assert names[0] == names[-1] == "cyclictest" and len(names) == 8
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
