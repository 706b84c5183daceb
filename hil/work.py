"""Long work: how far it has come, and how many threads it may use.

**Progress.** The work says how far it is, and whoever listens shows it: it knows neither a terminal
nor a page, and pays nothing where nobody listens.

**Threads**, while their large arrays need no interpreter.  Each thing is computed as it would be
alone, so that results do not depend on how many there are.  A diagnosis of some minutes takes a
seventh to a quarter less with two; the many small steps of a short one wait for the interpreter, so
that it has one.

**One BLAS thread** for the many small matrices of an identification: several on matrices of a few
thousand rows gain nothing on an idle machine and cost a factor of a hundred on a busy one, where
they spin waiting for each other.
"""

from __future__ import annotations

import contextlib
import contextvars
import functools
import os
from collections.abc import Callable, Iterable, Iterator
from typing import ParamSpec, TypeVar

T = TypeVar("T")
R = TypeVar("R")
P = ParamSpec("P")

#: Told what is being done, and what share of all work lies behind it, from 0 to 1.
Listener = Callable[[str, float], None]
_listeners: list[Listener] = []


def at(what: str, done: float) -> None:
    """Say what begins now.

    Parameters
    ----------
    what : str
        The piece of work, in a few words.
    done : float
        Share of the whole work that lies behind, from 0 to 1.
    """
    for listener in _listeners:
        listener(what, done)


@contextlib.contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Give `listener` what is said, within."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


# ------------------------------------------------------------ threads

#: More than two have not been measured; each needs memory for its columns.
MAX_WORKERS = 2
#: Instants of all runs (200 a second, mostly) from which on they gain.
LONG = 2**13
_limit: contextvars.ContextVar[int] = contextvars.ContextVar("threads", default=MAX_WORKERS)


def threads() -> int:
    """How many threads there may be: processors of this process, and what the user asks for."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    most = int(asked) if asked.isdecimal() and int(asked) else MAX_WORKERS
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(_limit.get(), most, there or 1))


@contextlib.contextmanager
def on_one_thread() -> Iterator[None]:
    """No threads within: what is called here is one of several processes, or measured."""
    token = _limit.set(1)
    try:
        yield
    finally:
        _limit.reset(token)


def in_parallel(work: Callable[[T], R], things: Iterable[T], instants: int) -> list[R]:
    """Results of `work` for all things, in their order.

    Parameters
    ----------
    work : callable
        Of one thing; must not change what the others look at.  An error in one is raised here.
    things : iterable
        Each gets the context of the caller (`numpy.errstate` and its like) and no further threads.
    instants : int
        Length of the columns that are made of each thing.
    """
    waiting = list(things)
    count = min(threads(), len(waiting)) if instants >= LONG else 1
    if count < 2:
        return [work(x) for x in waiting]
    with on_one_thread():
        contexts = [contextvars.copy_context() for _ in waiting]
    # loaded here: every command imports this module, and most work alone
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(count, "in_parallel")
    try:
        done = list(pool.map(lambda context, x: context.run(work, x), contexts, waiting))
    except BaseException:
        # what still runs is of no use; an interruption does not wait for it
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
    return done


def single_threaded(function: Callable[P, R]) -> Callable[P, R]:
    """Run a function with one BLAS thread."""

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits  # as above

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
