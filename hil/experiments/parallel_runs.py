"""Many runs of one function: in processes or on a cluster, resumed, the same numbers everywhere.

A study is run for many seeds, a folder of sessions diagnosed robot by robot, a benchmark case by
case.  At most a few runs are under way at a time, and no result is held longer than it is asked
for.  What is done is kept in a folder, a file a run, so that nothing finished is lost where the
program or a worker ends.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits
from tqdm import tqdm

import hil
from hil.errors import ConfigError, DataError, DeviceError, HilError
from hil.interrupt import held_back, with_its_parent
from hil.revision import source_revision
from hil.work import on_one_thread

Data = dict[str, Any]
RunOne = Callable[[str, int], Data]
T = TypeVar("T")
R = TypeVar("R")
#: Key of the sentence that stands for the data of a run that failed.
FAILED = "failed"
#: How often a job whose worker was lost is given to another one.
TRIES = 3
#: How long a scheduler may take to answer [s].
PATIENCE = 10.0
#: Runs of each process after which all are replaced, which gives back what they had grown by.
RUNS_OF_A_PROCESS = 50


@dataclass(frozen=True)
class LostRun:
    """What stands for the result of a run that ended its process time after time."""

    text: str = (
        f"it ended its process {TRIES} times; less memory may be free than it needs: give fewer "
        "--workers"
    )


@dataclass(frozen=True)
class Where:
    """Who computes.

    Parameters
    ----------
    workers : int
        Processes; 1 runs here.
    cluster : str
        Address of a Dask scheduler, in place of processes.
    """

    workers: int = 1
    cluster: str = ""


def computer(args: argparse.Namespace) -> Where:
    """Who computes, as --workers and --cluster say.

    Raises
    ------
    ConfigError
        If there is no worker.
    """
    if args.workers < 1:
        raise ConfigError(f"--workers {args.workers}: one or more is needed")
    return Where(args.workers, args.cluster)


def spread(
    work: Callable[[T], R], things: Sequence[T], where: Where
) -> Iterator[tuple[int, R | LostRun]]:
    """Number of a thing and what `work` made of it, in the order in which they are finished.

    Every run has one thread, so that all ways there give the same digits.  A run whose process or
    worker is lost is done again; one that loses it `TRIES` times gives `LostRun`, the others go on.

    Parameters
    ----------
    work : callable
        A function of a module, or a `partial` of one, so that other processes find it.
    things : sequence
        What it is given, one at a time.
    where : Where
        Who computes.

    Raises
    ------
    ConfigError
        If the cluster cannot be reached, has no worker, or another version of this program.
    DeviceError
        If the cluster goes away.
    """
    run = partial(_one_thread, work)
    if where.cluster:
        return _on_cluster(run, things, where.cluster)
    if where.workers == 1 or len(things) < 2:
        return ((k, run(thing)) for k, thing in enumerate(things))
    return _in_processes(run, things, where.workers)


def _one_thread(work: Callable[[T], R], thing: T) -> R:
    with on_one_thread(), threadpool_limits(1):
        return work(thing)


# ------------------------------------------------------------ processes of this machine


def _in_processes(
    run: Callable[[T], R], things: Sequence[T], workers: int
) -> Iterator[tuple[int, R | LostRun]]:
    """Results of processes; what was under way where one was lost is done again, one by one."""
    left = deque(range(len(things)))
    while left:
        under_way: dict[Future[R], int] = {}
        more = workers * RUNS_OF_A_PROCESS
        with _pool(min(workers, len(left))) as pool:
            try:
                while (left and more) or under_way:
                    while left and more and len(under_way) < workers:
                        under_way[_given(pool, run, things[left[0]])] = left[0]
                        left.popleft()
                        more -= 1
                    for job in wait(under_way, return_when=FIRST_COMPLETED).done:
                        result = job.result()
                        yield under_way.pop(job), result
            except BrokenProcessPool:  # whose run it was, nobody knows
                pass
        for k in under_way.values():
            yield k, _again(run, things[k])


@contextlib.contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes; where this one is interrupted they end at once, their runs are of no use."""
    others = multiprocessing.active_children()
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, with_its_parent)
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            if process not in others:
                process.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _given(pool: ProcessPoolExecutor, run: Callable[[T], R], thing: T) -> Future[R]:
    with held_back():  # an interruption is for this process, which ends the others
        return pool.submit(run, thing)


def _again(run: Callable[[T], R], thing: T) -> R | LostRun:
    """Result of a run in a process of its own, where an earlier one was lost."""
    for _ in range(TRIES - 1):
        with _pool(1) as pool, contextlib.suppress(BrokenProcessPool):
            return _given(pool, run, thing).result()
    return LostRun()


# ------------------------------------------------------------ a Dask cluster


def _on_cluster(
    run: Callable[[T], R], things: Sequence[T], address: str
) -> Iterator[tuple[int, R | LostRun]]:
    """Results of a Dask cluster; the scheduler gives the runs of lost workers to other ones.

    A run may be lost with workers that another one ended: it is tried again when nothing else runs,
    and lost if it ends them by itself.
    """
    distributed = _dask()
    with _client(distributed, address) as client:
        at_once = 2 * max(1, sum(client.nthreads().values()))
        left, number = deque(range(len(things))), dict[str, int]()
        suspected, alone = deque[int](), set[int]()

        def given(k: int) -> Any:
            job = client.submit(_versioned, run, things[k], pure=False)
            number[job.key] = k
            return job

        first = [given(left.popleft()) for _ in range(min(at_once, len(left)))]
        arrived: Any = distributed.as_completed(first)
        for job in arrived:
            version, result = hil.__version__, None
            try:
                version, result = job.result()
            except distributed.KilledWorker:
                result = LostRun()
            except (CancelledError, distributed.comm.CommClosedError) as error:
                raise DeviceError(
                    f"cluster {address} went away before all was done; start it again, then type "
                    "the same command: what was kept is not done again"
                ) from error
            except ImportError as error:
                raise ConfigError(
                    f"a worker of cluster {address} cannot run this: {error}; install hil-teleop "
                    f"{hil.__version__} with the same extras there"
                ) from error
            if version != hil.__version__:
                raise ConfigError(
                    f"a worker of cluster {address} has hil-teleop {version}, and this is "
                    f"{hil.__version__}; install the same version there: numbers of two versions "
                    "are not to be mixed"
                )
            k = number.pop(job.key)
            job.release()  # the scheduler need not keep it
            if isinstance(result, LostRun) and k not in alone:
                suspected.append(k)
            else:
                yield k, result
            if left:
                arrived.add(given(left.popleft()))
            elif suspected and not number:
                alone.add(suspected[0])
                arrived.add(given(suspected.popleft()))


def _versioned(run: Callable[[T], R], thing: T) -> tuple[str, R]:
    return hil.__version__, run(thing)


def _dask() -> Any:
    try:
        import distributed
    except ImportError:
        raise ConfigError(
            "--cluster needs Dask: pip install 'hil-teleop[cluster]'; --workers works without it"
        ) from None
    return distributed


def _client(distributed: Any, address: str) -> Any:
    """Connection to a cluster that has a worker."""
    try:
        client = distributed.Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise ConfigError(f"cluster {address} does not answer: {error}") from error
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        client.close()
        raise ConfigError(
            f"cluster {address} has no worker; start some with 'dask worker {address}'"
        ) from None
    return client


# ------------------------------------------------------------ progress, and what is kept


def counted(results: Iterator[R], total: int, unit: str, shown: bool = True) -> Iterator[R]:
    """Results as they come, with progress on stderr: a bar, or in a file ten lines.

    Parameters
    ----------
    results : iterator
        As `spread` gives them.
    total : int
        How many there will be.
    unit : str
        What one of them is.
    shown : bool
        Whether progress is wanted.
    """
    terminal = sys.stderr.isatty()
    with tqdm(total=total, unit=unit, disable=not (terminal and shown), leave=False) as bar:
        for k, result in enumerate(results, 1):
            bar.update()
            if shown and not terminal and total > 1 and 10 * k // total > 10 * (k - 1) // total:
                sys.stderr.write(f"{k} of {total} {unit}s\n")
            yield result


@cache
def made_by() -> str:
    """What finished runs were made by; of a source that was changed, this very process."""
    revision, dirty = source_revision()
    return f"{hil.__version__} {revision}" + (f" {os.getpid()}" if dirty == "true" else "")


class KeptRuns:
    """Finished runs of a version in a folder, a file each.

    Parameters
    ----------
    folder : str, Path or None
        None keeps nothing.
    version : str
        Of the program; runs of another one are done again.

    Raises
    ------
    ConfigError
        If the folder is none.
    """

    def __init__(self, folder: str | Path | None, version: str) -> None:
        self.folder = None if folder is None else Path(folder)
        self.version = version
        if self.folder is not None:
            if self.folder.exists() and not self.folder.is_dir():
                raise ConfigError(f"--keep {folder}: a folder is needed, and this is a file")
            self.folder.mkdir(parents=True, exist_ok=True)

    def _path(self, name: str) -> Path | None:
        return None if self.folder is None else self.folder / f"{name}.json"

    def read(self, name: str) -> Data | None:
        """Data of a run that was finished by this version."""
        path = self._path(name)
        if path is None or not path.is_file():
            return None
        try:
            told: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            data, version = dict(told["data"]), told["version"]
        except (ValueError, KeyError, TypeError) as error:
            raise DataError(f"{path} is no finished run: {error}; remove it") from error
        return data if version == self.version else None

    def write(self, name: str, data: Data) -> None:
        """Keep a run; a file is whole or not there."""
        path = self._path(name)
        if path is None:
            return
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_text(json.dumps({"version": self.version, "data": data}), encoding="utf-8")
        part.replace(path)


# ------------------------------------------------------------ a study with many seeds


def replicate(
    job: RunOne,
    name: str,
    seeds: Sequence[int],
    *,
    workers: int = 1,
    cluster: str = "",
    folder: str | Path | None = None,
    version: str = "",
    done: Callable[[int], object] = lambda _: None,
) -> dict[int, Data]:
    """Data of a study for each seed, in the order of the seeds.

    A seed whose run raises an error of the program gives ``{FAILED: sentence}``; the others count.

    Parameters
    ----------
    job : callable
        A function of a module, so that other processes find it.
    name : str
        Of the study.
    seeds : sequence of int
        One run each.
    workers, cluster
        As of `Where`.
    folder : str or Path, optional
        Where finished runs are kept; those of the same version are not run again.
    version : str
        Of the program, as the files say it.
    done : callable
        Takes the seed of every run that is finished.

    Raises
    ------
    ConfigError, DeviceError
        As `spread`; also if the folder is none, or the worker of one run is lost time after time.
    """
    kept = KeptRuns(folder, version)
    found = {s: data for s in seeds if (data := kept.read(f"{name}-{s}")) is not None}
    left = [seed for seed in seeds if seed not in found]
    for seed in found:
        done(seed)
    lost = []
    for k, text in spread(partial(_run, job, name), left, Where(workers, cluster)):
        seed = left[k]
        if isinstance(text, LostRun):
            lost.append(str(seed))
            continue
        found[seed] = json.loads(text)
        kept.write(f"{name}-{seed}", found[seed])
        done(seed)
    if lost:
        raise DeviceError(f"seed {', '.join(lost)}: {LostRun().text}")
    return {seed: found[seed] for seed in seeds}


def _run(job: RunOne, name: str, seed: int) -> str:
    """One run as text: every way there gives the same digits."""
    try:
        return json.dumps(job(name, seed))
    except HilError as error:  # of this seed alone, e.g. a session that ended PAUSED
        return json.dumps({FAILED: str(error)})
