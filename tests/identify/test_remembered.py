"""What is computed once for the same arrays is computed again for others."""

import gc

import numpy as np
import plants
import pytest

from hil.identify.fit import fit, identified
from hil.identify.problem import AUTOMATIC, Problem
from hil.identify.slow_motion import slow_delay
from hil.models import catalogue
from hil.models.model import Band, base_model
from hil.record.recording import RobotSource


@pytest.fixture
def problem() -> Problem:
    return Problem([plants.spatial(1, 8.0)], RobotSource("", plants.spatial_urdf()))


def test_only_the_very_same_objects_are_known(problem: Problem) -> None:
    made: list[int] = []

    def ask(*things: np.ndarray) -> int:
        return problem.remembered(("thing",), things, lambda: made.append(0) or len(made))

    a, b = np.zeros(3), np.zeros(3)
    assert [ask(a), ask(a), ask(b), ask(b), ask(a), ask(a, b), ask(a, b)] == [1, 1, 2, 2, 3, 4, 4]


def test_nothing_is_kept_alive_and_what_is_gone_is_not_known(problem: Problem) -> None:
    for k in range(5):
        # an array at the place of the one before
        x = np.full(1000, k, dtype=float)
        assert problem.remembered(("sum",), [x], lambda x=x: float(x.sum())) == 1000.0 * k
        del x
        gc.collect()
    assert [ref() for ref in problem.memo["sum",][0]] == [None]


def test_a_grid_is_that_of_the_motion_as_it_is_now(problem: Problem) -> None:
    effect = catalogue.get("coulomb")
    before = problem.grid(effect, 0)
    assert problem.grid(effect, 0) is before and problem.grid(effect, 1) != before
    m = problem.motions[0]
    problem.motions = [m.with_(resolution=2 * m.resolution)]
    assert problem.grid(effect, 0) == effect.search.grid(problem.motions[0], 0) != before


def test_a_range_of_loads_is_that_of_the_present_load(problem: Problem) -> None:
    before = identified(problem)
    m = problem.motions[0]
    problem.set_context(load=m.load + 1.0, static=m.static)
    after = identified(problem)
    assert [r.position for r in after] == [r.position for r in before]
    for new, old in zip(after, before, strict=True):
        assert np.subtract(new.load, old.load) == pytest.approx(1.0)


def test_a_slow_delay_follows_a_shift_of_the_effort(problem: Problem) -> None:
    result = fit(problem, base_model(problem.source))
    late, _ = slow_delay(result, 1)
    assert slow_delay(result, 1)[0] == late
    problem.shift_effort(0.002)
    assert slow_delay(result, 1)[0] - late == pytest.approx(-0.002, abs=1e-4)


def test_a_problem_begins_again_for_the_very_same_runs_with_their_columns() -> None:
    run, source = plants.spatial(1, 8.0), RobotSource("", plants.spatial_urdf())
    used, effect = Problem([run], source), catalogue.get("viscous")
    y = used.y.copy()
    with used.aside():
        made = used.columns(effect, 0, ())
    used.shift_effort(0.002)
    used.asked_late = used.aligned = True
    again = used.again([run], source, "motor", AUTOMATIC)
    assert again is not None and not again.asked_late and not again.aligned
    assert again.shift == 0.0 and used.shift == 0.002
    assert np.array_equal(again.y, y) and not np.array_equal(used.y, y)
    assert again.columns(effect, 0, ()) is made
    # a shift of the one is none of the other
    again.shift_effort(0.001)
    assert (used.shift, again.shift) == (0.002, 0.001)
    for asked in (
        ([plants.spatial(1, 8.0)], source, "motor", AUTOMATIC),  # alike, but not the same
        ([run, run], source, "motor", AUTOMATIC),
        ([run], source, "external", AUTOMATIC),
        ([run], source, "motor", Band(position_hz=20.0)),
        ([run], RobotSource("single-axis"), "motor", AUTOMATIC),
    ):
        assert used.again(*asked) is None
