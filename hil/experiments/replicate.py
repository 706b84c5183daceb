"""A study with many seeds: in processes or on a cluster, resumed, the same numbers everywhere.

A job is a function of the study's name and a seed that gives plain data.  What is done is kept in a
folder, a file a job, so that nothing finished is lost where the program or a worker ends.
"""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from hil.errors import ConfigError, DataError, DeviceError, HilError

Data = dict[str, Any]
Job = Callable[[str, int], Data]
#: Key of the sentence that stands for the data of a run that failed.
FAILED = "failed"
#: How often a job whose worker was lost is given to another one.
TRIES = 3
#: How long a scheduler may take to answer [s].
PATIENCE = 10.0


def replicate(
    job: Job,
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
    workers : int
        Processes; 1 runs here.
    cluster : str
        Address of a Dask scheduler, in place of processes.
    folder : str or Path, optional
        Where finished runs are kept; those of the same version are not run again.
    version : str
        Of the program, as the files say it.
    done : callable
        Takes the seed of every run that is finished.

    Raises
    ------
    ConfigError
        If the folder is none, or the cluster cannot be reached.
    DeviceError
        If the worker of one job is lost time after time.
    """
    kept = _Kept(folder, name, version)
    found = {seed: data for seed in seeds if (data := kept.read(seed)) is not None}
    left = [seed for seed in seeds if seed not in found]
    run = partial(_run, job, name)
    results = _on_cluster(run, left, cluster) if cluster else _here(run, left, workers)
    for seed in found:
        done(seed)
    for seed, text in results:
        found[seed] = json.loads(text)
        kept.write(seed, found[seed])
        done(seed)
    return {seed: found[seed] for seed in seeds}


def _run(job: Job, name: str, seed: int) -> str:
    """One run on one thread, as text: every way there gives the same digits."""
    with threadpool_limits(1):
        try:
            return json.dumps(job(name, seed))
        except HilError as error:  # of this seed alone, e.g. a session that ended PAUSED
            return json.dumps({FAILED: str(error)})


def _here(
    run: Callable[[int], str], seeds: Sequence[int], workers: int
) -> Iterator[tuple[int, str]]:
    """Results of processes, as they come; lost ones are run again."""
    if workers == 1 or len(seeds) < 2:
        yield from ((seed, run(seed)) for seed in seeds)
        return
    left = list(seeds)
    for _ in range(TRIES):
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(workers, len(left)), context) as pool:
            jobs = {pool.submit(run, seed): seed for seed in left}
            for job in as_completed(jobs):
                try:
                    text = job.result()
                except BrokenProcessPool:  # this one, or another one of the pool
                    continue
                left.remove(jobs[job])
                yield jobs[job], text
        if not left:
            return
    raise DeviceError(
        f"the runs with the seeds {', '.join(map(str, left))} ended their process {TRIES} times; "
        "less memory may be free than they need: give fewer --workers"
    )


def _on_cluster(
    run: Callable[[int], str], seeds: Sequence[int], address: str
) -> Iterator[tuple[int, str]]:
    """Results of a Dask cluster, as they come; the scheduler gives lost ones to other workers."""
    try:
        import distributed
    except ImportError:
        raise ConfigError(
            "--cluster needs Dask: pip install 'hil-teleop[cluster]'; --workers works without it"
        ) from None
    try:
        client: Any = distributed.Client(address, timeout=PATIENCE)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise ConfigError(f"cluster {address} does not answer: {error}") from error
    with client:
        jobs = client.map(run, list(seeds), pure=False, retries=TRIES - 1)
        seed_of = dict(zip((j.key for j in jobs), seeds, strict=True))
        arrived: Any = distributed.as_completed(jobs, with_results=True)  # type: ignore[no-untyped-call]
        for job, text in arrived:
            yield seed_of[job.key], text
            job.release()  # the scheduler need not keep it


class _Kept:
    """Finished runs of a version in a folder, a file each."""

    def __init__(self, folder: str | Path | None, name: str, version: str) -> None:
        self.folder = None if folder is None else Path(folder)
        self.name, self.version = name, version
        if self.folder is not None:
            if self.folder.exists() and not self.folder.is_dir():
                raise ConfigError(f"--keep {folder}: a folder is needed, and this is a file")
            self.folder.mkdir(parents=True, exist_ok=True)

    def _path(self, seed: int) -> Path | None:
        return None if self.folder is None else self.folder / f"{self.name}-{seed}.json"

    def read(self, seed: int) -> Data | None:
        """Data of a run that was finished by this version."""
        path = self._path(seed)
        if path is None or not path.is_file():
            return None
        try:
            told: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            data, version = dict(told["data"]), told["version"]
        except (ValueError, KeyError, TypeError) as error:
            raise DataError(f"{path} is no finished run of a study: {error}; remove it") from error
        return data if version == self.version else None

    def write(self, seed: int, data: Data) -> None:
        """Keep a run; a file is whole or not there."""
        path = self._path(seed)
        if path is None:
            return
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_text(json.dumps({"version": self.version, "data": data}), encoding="utf-8")
        part.replace(path)
