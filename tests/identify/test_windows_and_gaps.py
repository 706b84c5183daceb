"""Simulated windows stop at gaps: at bridges over missing rows, and where a run is split."""

import plants
import pytest
from test_simulated_fit import AXIS

from hil.identify import multistep, simulated
from hil.identify.fit import fit
from hil.identify.outputerror import Simulator
from hil.identify.problem import Problem
from hil.identify.simulated import free_run, refine
from hil.models.model import base_model
from hil.record.recording import Recording

#: Rows that are lost: from 10.0 to 10.15 s, a bridge; with the second one a split as well.
BRIDGE, SPLIT = (5000, 5075), (6500, 8300)


@pytest.fixture(scope="module")
def whole() -> Recording:
    return plants.pushed_axes(5, 1e-5, seconds=24.0)


def test_a_bridge_parts_a_run(whole: Recording) -> None:
    assert len(Problem([whole], AXIS).stretches(0)) == 1
    problem = Problem([plants.without(whole, BRIDGE)], AXIS)
    (_, one), (two, _) = problem.stretches(0)
    t = problem.motions[0].t
    assert t[one - 1] < 10.0 and t[two] > 10.15
    both = Problem([plants.without(whole, BRIDGE, SPLIT)], AXIS)
    assert [len(both.stretches(k)) for k in range(len(both.motions))] == [2, 1]


@pytest.mark.parametrize(("seconds", "servo"), [(0.5, 0.0), (2.5, 1.0)])
def test_no_window_of_a_multi_step_error_leaves_its_stretch(
    whole: Recording, seconds: float, servo: float
) -> None:
    problem = Problem([plants.without(whole, BRIDGE, SPLIT)], AXIS)
    total = 0
    for k, motion in enumerate(problem.motions):
        some = problem.stretches(k)
        starts, horizon = multistep._windows(motion, some, seconds, servo)
        total += starts.size
        assert all(any(a <= s and s + horizon < b for a, b in some) for s in starts.tolist())
    assert 0 < total <= 2 * multistep.WINDOWS


def test_the_multi_step_error_is_that_of_what_was_recorded(whole: Recording) -> None:
    """The force that the lost rows held is known to nobody: windows across would go astray."""
    errors = []
    for run in (whole, plants.without(whole, BRIDGE)):
        problem = Problem([run], AXIS)
        errors.append(multistep.simulate(fit(problem, base_model(AXIS)), problem).rms[0])
    assert errors[1] < 1.2 * errors[0]


@pytest.mark.slow
def test_a_refinement_and_a_free_run_stop_at_gaps(
    whole: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = plants.without(whole, BRIDGE)
    problem = Problem([run], AXIS)
    result = fit(problem, base_model(AXIS))
    asked = []
    simulate = Simulator.__call__

    def noted(self, jobs):
        asked.extend((self.problem, job) for job in jobs)
        return simulate(self, jobs)

    monkeypatch.setattr(Simulator, "__call__", noted)
    # which windows are asked for does not depend on how far a descent goes
    monkeypatch.setattr(simulated, "STEPS", 2)
    monkeypatch.setattr(simulated, "LAST", 2)
    assert refine(result, [run], window=1.0).official is not None
    free_run(result, [run])
    assert asked
    for where, job in asked:
        for k, starts in enumerate(job.starts):
            some = where.stretches(k)
            ends = starts + job.horizon
            pairs = zip(starts.tolist(), ends.tolist(), strict=True)
            assert all(any(a <= x and y < b for a, b in some) for x, y in pairs)
