"""Every public recording: the given model, a person's script and the tool, on the same rows.

Each case is a robot's runs to fit and runs to judge on.  It runs in a process of its own, so that
neither its memory nor a crash reaches the next.  What is asked of our side is asked in `ours`.
"""

from __future__ import annotations

import multiprocessing
import resource
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hil
from hil.bench import least_squares_script
from hil.diagnosis.heldout import Examiner
from hil.errors import DataError, unknown
from hil.experiments.replicate import LostRun, Where, spread
from hil.identify.context import renew
from hil.identify.parallel import alone
from hil.identify.problem import Problem
from hil.interrupt import held_back, with_its_parent
from hil.models.model import RobotModel, Use, base_model
from hil.record import datasets
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: Runs to fit, and runs to judge on.
Split = tuple[list[Recording], list[Recording]]
#: A case that has said nothing after this time has failed [s].
_LIMIT_S = 3600.0
_HERE = Where()


@dataclass(frozen=True)
class RealCase:
    """One benchmark case.

    Parameters
    ----------
    name, kind : str
        Name of the case, and the kind of robot it is a sample of.
    load : callable
        Gives its runs.
    explains : str
        ``"motor"``: the model explains the motor's effort, beginning with the base model;
        ``"external"``: what an object does, beginning with a spring and an offset.
    complete : bool
        Nothing is known to be missing: no name is to be given.
    """

    name: str
    kind: str
    load: Callable[[], Split]
    explains: str = "motor"
    complete: bool = False

    def model(self, robot: Recording) -> RobotModel:
        """The given model."""
        if self.explains == "motor":
            return base_model(robot.robot)
        law = (Use("contact-stiffness"), Use("torque-offset"))
        return RobotModel(robot.robot, law, explains=self.explains)


@dataclass(frozen=True)
class ScriptErrors:
    """What the person's script reached.

    Parameters
    ----------
    given, final : list of float
        Held-out relative error of each joint [%] with rigid body, friction and an offset (or
        spring and offset), and with the features.
    features : list of list of str
        By joint.
    seconds : float
        Time that it took.
    """

    given: list[float]
    final: list[float]
    features: list[list[str]]
    seconds: float


@dataclass(frozen=True)
class Ours:
    """What the tool reached.

    Parameters
    ----------
    verdict : str
        Of the diagnosis.
    names : list of (str, float)
        Effect with its joint, and confidence.
    labels : list of str
        Rungs of the ladder, the given model first; empty where nothing was fitted.
    ladder : list of list of float
        Held-out relative error of each joint [%], by rung.
    written : int
        The rung whose model `hil improve` writes.
    floor : list of float
        Noise floor of each joint, relative to the held-out effort [%].
    refitted : bool
        Whether the written model gives every run coefficients of its own (an offset, say): then
        these are estimated on the judged runs, too, and the error is not quite held out.
    seconds : float
        Time that it took.
    """

    verdict: str
    names: list[tuple[str, float]]
    labels: list[str]
    ladder: list[list[float]]
    written: int
    floor: list[float]
    refitted: bool
    seconds: float
    #: Error of each joint [%] of the model that is written where the tool sees no judged run.
    blind: tuple[float, ...] = ()


@dataclass(frozen=True)
class RealRow:
    """Outcome of one case.

    Parameters
    ----------
    case, kind : str
        Of the case.
    complete : bool
        Nothing is known to be missing.
    joints : list of str
        Their names.
    holds : list of bool
        Joints that only hold their place; their errors do not count.
    script : Script or str
        Of the person; text where it failed.
    ours : Ours or str
        Of the tool; text where it failed: an internal error.
    mebibytes : float
        Largest memory of the process [MiB].
    """

    case: str
    kind: str
    complete: bool
    joints: list[str]
    holds: list[bool]
    script: ScriptErrors | str
    ours: Ours | str
    mebibytes: float

    def whole(self, relative: Sequence[float]) -> float:
        """Error over the joints that move, each in its own effort's scale [%]."""
        moving = [x for x, holds in zip(relative, self.holds, strict=True) if not holds]
        return float(np.sqrt(np.mean(np.square(moving)))) if moving else float("nan")


def ours(train: list[Recording], hold: list[Recording], model: RobotModel) -> Ours:
    """The tool with default settings: all that this benchmark asks of a diagnosis.

    Parameters
    ----------
    train, hold : list of Recording
        Runs to fit and runs to judge on.
    model : RobotModel
        The given model.

    Returns
    -------
    Ours
        With an empty ladder where the verdict is ``"bad-data"``.
    """
    begun = time.perf_counter()
    d = hil.diagnose(train, model, hold)
    seconds = time.perf_counter() - begun
    names = [
        (f"{f.effect} on {f.joint}" if f.joint else f.effect, float(f.confidence))
        for f in d.findings
    ]
    if not d.ladder:
        return Ours(d.verdict, names, [], [], 0, [], False, seconds)
    effort = np.maximum(d.ladder[-1].heldout.effort_rms, 1e-300)
    return Ours(
        verdict=d.verdict,
        names=names,
        labels=[s.label for s in d.ladder],
        ladder=[s.heldout.relative.tolist() for s in d.ladder],
        written=next(k for k, s in enumerate(d.ladder) if s.result.model is d.model),
        floor=(100 * d.noise / effort).tolist(),
        refitted=any(bool(u.options.get("per_run")) for u in d.model.effects),
        seconds=seconds,
        blind=blind(train, hold, model),
    )


def blind(train: list[Recording], hold: list[Recording], model: RobotModel) -> tuple[float, ...]:
    """Errors of the joints [%] on runs that the tool had not seen when it chose its model."""
    d = hil.diagnose(train, model)
    if not d.ladder:
        return ()
    renew(d.result)
    return tuple(Examiner(d.result.problem, hold)(d.result).relative.tolist())


def script(train: list[Recording], hold: list[Recording], explains: str) -> ScriptErrors:
    """The person's script; arguments as of `hil.bench.least_squares_script.run`."""
    begun = time.perf_counter()
    found = least_squares_script.run(train, hold, train[0].robot, explains)
    seconds = time.perf_counter() - begun
    features = [list(names) for names in found.chosen]
    return ScriptErrors(found.given.tolist(), found.final.tolist(), features, seconds)


def examine(case: RealCase) -> RealRow:
    """Person and tool on one case, in this process.

    Raises
    ------
    DataError
        If a recording is not there.
    """
    train, hold = case.load()
    problem = Problem(train, train[0].robot, case.explains)
    holds, joints = problem.holds.tolist(), list(problem.joints)
    del problem
    with alone():
        theirs = _tried(lambda: script(train, hold, case.explains))
        own = _tried(lambda: ours(train, hold, case.model(train[0])))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return RealRow(case.name, case.kind, case.complete, joints, holds, theirs, own, peak)


def _tried(work: Callable[[], Any]) -> Any:
    """What `work` gives; the last line of its traceback where it fails in any way."""
    try:
        return work()
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{last.filename.rpartition('/')[2]}:{last.lineno}"
        return f"{type(error).__name__} at {place}: {error}"


def run(
    todo: Sequence[RealCase],
    where: Where = _HERE,
    work: Callable[[RealCase], RealRow] = examine,
) -> Iterator[RealRow]:
    """Rows in the order in which they end.

    Here each case has a process of its own, `where.workers` at a time.  On a cluster it has a
    worker, whose largest memory is that of all that it did so far.

    Raises
    ------
    DataError
        If a recording is not there.
    """
    if where.cluster:
        for k, found in spread(partial(_answer, work), todo, where):
            yield _row(todo[k], found.text if isinstance(found, LostRun) else found)
        return
    with ThreadPoolExecutor(max(1, where.workers)) as pool:
        waiting = [pool.submit(_apart, case, work) for case in todo]
        try:
            for done in as_completed(waiting):
                yield done.result()
        finally:
            for other in waiting:
                other.cancel()


def _apart(case: RealCase, work: Callable[[RealCase], RealRow]) -> RealRow:
    """One case in a process; a row that says so where the process ends without an answer."""
    context = multiprocessing.get_context("spawn")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(send, case, work), daemon=True)
    with held_back():  # an interruption is for the process that started this one, and ends it
        process.start()
    send.close()
    try:
        found = receive.recv() if receive.poll(_LIMIT_S) else f"no answer in {_LIMIT_S:g} s"
    except EOFError:
        process.join()
        found = f"its process ended with status {process.exitcode}"
    finally:
        process.kill()
        process.join()
        process.close()
        receive.close()
    return _row(case, found)


def _row(case: RealCase, found: RealRow | DataError | str) -> RealRow:
    """Row of an answer; one that is a sentence is why there is none."""
    if isinstance(found, DataError):
        raise found
    if isinstance(found, str):
        return RealRow(case.name, case.kind, case.complete, [], [], found, found, float("nan"))
    return found


def _child(send: Connection, case: RealCase, work: Callable[[RealCase], RealRow]) -> None:
    with_its_parent()
    send.send(_answer(work, case))


def _answer(work: Callable[[RealCase], RealRow], case: RealCase) -> RealRow | DataError:
    """A row, or the error of a recording that is not there."""
    try:
        return work(case)
    except DataError as error:
        return error


def to_data(row: RealRow) -> dict[str, Any]:
    """A row as plain data; `from_data` makes it again, to the last digit."""
    return asdict(row)


def from_data(data: dict[str, Any]) -> RealRow:
    """A row of plain data.

    Raises
    ------
    DataError
        If they are not those of a row.
    """
    try:
        own, script = data["ours"], data["script"]
        if isinstance(own, dict):
            named = [(str(n), float(x)) for n, x in own["names"]]
            own = Ours(**{**own, "names": named, "blind": tuple(own["blind"])})
        script = ScriptErrors(**script) if isinstance(script, dict) else script
        return RealRow(**{**data, "ours": own, "script": script})
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"these are no results of 'hil bench real': {error}") from error


def _set(name: str) -> Split:
    return datasets.load_set(name, "train"), datasets.load_set(name, "hold")


def _emps() -> Split:
    return [datasets.load_emps()], [datasets.load_emps(pulses=True)]


def _halves(recording: Recording) -> Split:
    """First half to fit, second to judge on."""
    half = recording.n // 2
    return [recording.slice(0, half)], [recording.slice(half, recording.n)]


def _tx40() -> Split:
    return _halves(datasets.load_tx40())


def _lever(run: str) -> Recording:
    """A run of the second series of the TU/e rig; the first one's sensors disagree."""
    return datasets.load_tue(f"m2_question1{run}")["follower"]


def _free() -> Split:
    """Half a run is too short for motor efforts: every other run, and the rest to judge on."""
    runs = [_lever(f"{k}_free_motion") for k in "abcdef"]
    return runs[0::2], runs[1::2]


def _contact(kind: str, runs: str, thing: str, complete: bool = False) -> list[RealCase]:
    """What a thing does to the lever, run by run: offset and place differ."""
    names = [f"{run[0]}_{thing}{run[1:]}" for run in runs.split()]
    loads = [partial(_touched, name) for name in names]
    return [
        RealCase(f"tue {name}", kind, load, "external", complete)
        for name, load in zip(names, loads, strict=True)
    ]


def _touched(run: str) -> Split:
    return _halves(_lever(run))


CASES = (
    RealCase("umn_grasper", "surgical tool", partial(_set, "umn_grasper")),
    RealCase("wam_follower", "cable arm", partial(_set, "wam_follower")),
    RealCase("ur10", "arm with gears", partial(_set, "ur10")),
    RealCase("panda_30hz", "arm with gears", partial(_set, "panda_30hz"), complete=True),
    RealCase("tx40", "arm with gears", _tx40),
    RealCase("tiago", "mobile manipulator", partial(_set, "tiago")),
    RealCase("emps", "drive", _emps),
    RealCase("tue free_motion", "lever, free motion", _free),
    *_contact("lever on springs", "a b c d e f", "spring", complete=True),
    *_contact("lever on foam", "a a2 a3 b b2 b3 c c2 d d2 e e2 f f2", "foam"),
)


def cases(only: Sequence[str] = ()) -> list[RealCase]:
    """Cases whose name or kind holds one of the given words; all without any.

    Raises
    ------
    DataError
        If a word fits none.
    """
    for word in only:
        if not any(word in c.name or word in c.kind for c in CASES):
            raise DataError(unknown("case", word, [c.name for c in CASES]))
    return [c for c in CASES if not only or any(w in c.name or w in c.kind for w in only)]
