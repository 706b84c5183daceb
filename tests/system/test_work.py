"""Several threads give what one gives, in the same order."""

import threading

import numpy as np
import pytest

from hil import work as module
from hil.work import LONG, in_parallel, on_one_thread, threads


@pytest.fixture(autouse=True)
def two(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setattr(module.os, "sched_getaffinity", lambda _: {0, 1}, raising=False)


def together(work, count=2):
    """Work that goes on only when `count` threads are at it: what does not wait is no proof."""
    gate = threading.Barrier(count)

    def waiting(x):
        gate.wait(timeout=20)
        return work(x)

    return waiting


def test_two_work_at_once_and_results_keep_their_order():
    assert in_parallel(together(lambda x: x * x), range(6), LONG) == [0, 1, 4, 9, 16, 25]


@pytest.mark.parametrize("limit", ["short", "alone", "asked", "nested", "one"])
def test_where_one_is_enough_the_caller_does_it(monkeypatch, limit):
    def where(_):
        return threading.current_thread()

    own = where(0)
    if limit == "short":
        assert set(in_parallel(where, range(4), LONG - 1)) == {own}
    elif limit == "alone":
        with on_one_thread():
            assert set(in_parallel(where, range(4), LONG)) == {own}
        assert threads() == 2
    elif limit == "asked":
        monkeypatch.setenv("OMP_NUM_THREADS", "1")
        assert set(in_parallel(where, range(4), LONG)) == {own}
    elif limit == "one":
        assert in_parallel(where, [0], LONG) == [own]
    else:
        inner = in_parallel(
            lambda x: (where(x), set(in_parallel(where, range(3), LONG))), range(4), LONG
        )
        assert all(found == {outer} for outer, found in inner)


def test_what_the_caller_set_holds_in_the_threads_too():
    def divided(x):
        return float(np.array([1.0])[0] / np.float64(x))

    with np.errstate(divide="ignore"):
        assert in_parallel(together(divided), [0.0, 2.0], LONG) == [np.inf, 0.5]
    with pytest.raises(FloatingPointError), np.errstate(divide="raise"):
        in_parallel(divided, [0.0, 2.0, 4.0], LONG)


def test_nonsense_in_the_environment_is_no_limit(monkeypatch):
    for text in ("", "0", "many", "-3"):
        monkeypatch.setenv("OMP_NUM_THREADS", text)
        assert threads() == 2
    monkeypatch.setattr(module.os, "sched_getaffinity", lambda _: {3})
    assert threads() == 1
