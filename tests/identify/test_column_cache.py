"""Columns are made again when what an effect looked at has changed, and only then."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import plants
import pytest

from hil.identify import column_cache
from hil.identify.column_cache import Kept, watched
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.motion import FloatArray
from hil.record.recording import RobotSource

#: Effect, its shape, and which changes reach it on joint 1.
CASES = [
    ("cogging", (2.0,), ()),
    ("stribeck", (0.1, 2.0), ("v0",)),
    ("coulomb", (0.01,), ()),
    ("load-friction", (0.0, 0.0), ("v0", "load")),
    ("delay", (0.01,), ("effort",)),
]


@pytest.fixture
def problem() -> Problem:
    return Problem([plants.spatial(1, 8.0)], RobotSource("", plants.spatial_urdf()))


def change(problem: Problem, what: str) -> None:
    m = problem.motions[0]
    if what == "effort":
        problem.shift_effort(1e-4)
    elif what == "load":
        problem.set_context(load=m.load + 1.0, static=m.static)
    else:
        v0 = m.v0.copy()
        v0[1 if what == "v0" else 0] *= 2
        problem.set_context(v0=v0, contact=m.contact)


def counting(problem: Problem) -> Callable[[], int]:
    calls, gated = Counter[str](), problem.gated

    def counted(parts: list[FloatArray], j: int) -> FloatArray:
        calls["filtered"] += 1
        return gated(parts, j)

    problem.gated = counted  # type: ignore[method-assign]
    return lambda: calls["filtered"]


@pytest.mark.parametrize(("name", "shape", "reached"), CASES)
def test_only_what_was_looked_at_counts(
    problem: Problem, name: str, shape: tuple[float, ...], reached: tuple[str, ...]
) -> None:
    effect = catalogue.get(name)
    for what in ("v0", "v0 of another joint", "load", "effort"):
        old = problem.columns(effect, 1, shape)
        change(problem, what)
        before = counting(problem)
        new = problem.columns(effect, 1, shape)
        assert bool(before()) == (what in reached), what
        alone = Problem([plants.spatial(1, 8.0)], RobotSource("", plants.spatial_urdf()))
        alone.motions = problem.motions
        assert np.array_equal(new, alone.columns(effect, 1, shape))
        assert (what in reached) or new is old


def test_what_was_looked_at_has_one_order(problem: Problem) -> None:
    """Sets of names have none: the same fields may be met in another one."""
    effect = catalogue.get("load-friction")
    orders = {watched(effect, [m], 1, (0.0, 0.0))[1] for m in problem.motions for _ in range(3)}
    assert orders == {tuple(sorted(seen, key=str)) for seen in orders} and len(orders) == 1


def test_what_was_tried_last_is_kept_and_what_is_needed_never_goes(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, motions, one = Kept(), problem.motions, np.zeros((100, 1))
    monkeypatch.setattr(column_cache, "CACHE_BYTES", 10 * one.nbytes)
    kept._room = 10 * one.nbytes
    kept.put(("needed",), one, (), motions)
    for k in range(30):
        kept.put(("tried", 0, k), one.copy(), (), motions, spare=True)
    there = [k for k in range(30) if kept.get(("tried", 0, k), motions) is not None]
    assert there[-9:] == list(range(21, 30))
    assert len(there) <= 10
    assert kept.get(("needed",), motions) is one
