"""Every public recording: the given model, a person's script and the tool, on the same rows.

Each case is a robot's runs to fit and runs to judge on.  It runs in a process of its own, so that
neither its memory nor a crash reaches the next.  What is asked of our side is asked in `ours`.

The outcome of `hil bench real` as tables: errors by kind, by joint, and what is aimed at.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import resource
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hil
from hil import terminal
from hil.bench import least_squares_script
from hil.bench.diagnosis import runner
from hil.diagnosis.heldout import Examiner
from hil.errors import DataError, unknown
from hil.experiments.parallel_runs import LostRun, Where, computer, counted, spread
from hil.identify.context import renew
from hil.identify.problem import Problem
from hil.interrupt import held_back, with_its_parent
from hil.models.model import RobotModel, Use, base_model
from hil.record import datasets
from hil.record.recording import Recording
from hil.terminal import Found
from hil.work import on_one_thread

FloatArray = NDArray[np.float64]
#: Runs to fit, and runs to judge on.
SessionSplit = tuple[list[Recording], list[Recording]]
#: A case that has said nothing after this time has failed [s].
_LIMIT_S = 3600.0
_HERE = Where()
#: Largest ratio of our error to the person's that is aimed at.
_AIM = 1.1
#: An error is worse than the given model's from this ratio on: two fits differ by rounding.
_WORSE = 1.001
REAL_HEAD = (
    "case", "given", "with offset", "person", "ours", "blind", "floor", "ours / person",
    "verdict", "named", "person s", "ours s", "MiB",
)  # fmt: skip
JOINT_HEAD = (
    "case",
    "joint",
    "given",
    "with offset",
    "person",
    "ours",
    "floor",
    "person's features",
)
INTERNAL_ERROR = "internal error"
_NOTHING = "-"


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
    load: Callable[[], SessionSplit]
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
    """The person's script; arguments as of `hil.bench.least_squares_script.cross_validated`."""
    begun = time.perf_counter()
    found = least_squares_script.cross_validated(train, hold, train[0].robot, explains)
    seconds = time.perf_counter() - begun
    features = [list(names) for names in found.chosen]
    return ScriptErrors(found.given.tolist(), found.final.tolist(), features, seconds)


def examine_case(case: RealCase) -> RealRow:
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
    with on_one_thread():
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


def examine_cases(
    todo: Sequence[RealCase],
    where: Where = _HERE,
    work: Callable[[RealCase], RealRow] = examine_case,
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


def _set(name: str) -> SessionSplit:
    return datasets.load_set(name, "train"), datasets.load_set(name, "hold")


def _emps() -> SessionSplit:
    return [datasets.load_emps()], [datasets.load_emps(pulses=True)]


def _halves(recording: Recording) -> SessionSplit:
    """First half to fit, second to judge on."""
    half = recording.n // 2
    return [recording.slice(0, half)], [recording.slice(half, recording.n)]


def _tx40() -> SessionSplit:
    return _halves(datasets.load_tx40())


def _lever(run: str) -> Recording:
    """A run of the second series of the TU/e rig; the first one's sensors disagree."""
    return datasets.load_tue(f"m2_question1{run}")["follower"]


def _free() -> SessionSplit:
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


def _touched(run: str) -> SessionSplit:
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


def ratio(row: RealRow) -> float:
    """Our written model's error over the person's; NaN where either is missing."""
    if (
        not isinstance(row.ours, Ours)
        or not isinstance(row.script, ScriptErrors)
        or not row.ours.ladder
    ):
        return math.nan
    return row.whole(row.ours.ladder[row.ours.written]) / row.whole(row.script.final)


def blind_ratio(row: RealRow) -> float:
    """The same for the model that was chosen without the judged runs."""
    if (
        not isinstance(row.ours, Ours)
        or not isinstance(row.script, ScriptErrors)
        or not row.ours.blind
    ):
        return math.nan
    return row.whole(row.ours.blind) / row.whole(row.script.final)


def blindly_worse(row: RealRow) -> bool:
    """Whether that model is worse than the given one."""
    if not isinstance(row.ours, Ours) or not row.ours.blind:
        return False
    return row.whole(row.ours.blind) > _WORSE * row.whole(row.ours.ladder[0])


def worse(row: RealRow) -> bool:
    """Whether the written model is worse than the given one."""
    if not isinstance(row.ours, Ours) or not row.ours.ladder:
        return False
    given, written = (row.whole(row.ours.ladder[k]) for k in (0, row.ours.written))
    return written > _WORSE * given


def case_line(row: RealRow) -> list[str]:
    """One case: errors in %, what was named, seconds and memory."""
    errors = [_NOTHING] * 6
    named = verdict = person_s = ours_s = _NOTHING
    if isinstance(row.script, ScriptErrors):
        errors[1], errors[2] = (_number(row.whole(x)) for x in (row.script.given, row.script.final))
        person_s = f"{row.script.seconds:.1f}"
    if isinstance(row.ours, Ours):
        verdict, ours_s = row.ours.verdict, f"{row.ours.seconds:.1f}"
        named = ", ".join(f"{name} ({p:.2f})" for name, p in row.ours.names) or _NOTHING
        if whole := [row.whole(x) for x in row.ours.ladder]:
            unseen = row.whole(row.ours.blind) if row.ours.blind else math.nan
            mine = (whole[0], whole[row.ours.written], unseen, row.whole(row.ours.floor))
            errors[0], errors[3], errors[4], errors[5] = map(_number, mine)
    else:
        verdict = INTERNAL_ERROR
    far, star = ratio(row), "*" if isinstance(row.ours, Ours) and row.ours.refitted else ""
    return [
        row.case,
        *errors,
        _NOTHING if math.isnan(far) else f"{far:.2f}{star}",
        verdict,
        named,
        person_s,
        ours_s,
        _NOTHING if math.isnan(row.mebibytes) else f"{row.mebibytes:.0f}",
    ]


def joint_lines(row: RealRow) -> list[list[str]]:
    """Errors of each joint of a case [%]; a joint that only holds its place has none."""
    out = []
    for j, joint in enumerate(row.joints):
        errors = [_NOTHING] * 5
        features = _NOTHING
        if isinstance(row.script, ScriptErrors):
            features = ", ".join(row.script.features[j]) or _NOTHING
            errors[1], errors[2] = _number(row.script.given[j]), _number(row.script.final[j])
        if isinstance(row.ours, Ours) and row.ours.ladder:
            rungs = row.ours.ladder
            errors[0], errors[3] = _number(rungs[0][j]), _number(rungs[row.ours.written][j])
            errors[4] = _number(row.ours.floor[j])
        if row.holds[j]:
            joint, errors = f"{joint} (holds)", [_NOTHING] * 5
        out.append([row.case, joint, *errors, features])
    return out


def aims(rows: Sequence[RealRow]) -> list[str]:
    """What is aimed at, and how many cases reach it."""
    known = [(r, r.script) for r in rows if isinstance(r.script, ScriptErrors)]
    complete = [r for r in rows if r.complete]
    named = [r.case for r in complete if isinstance(r.ours, Ours) and r.ours.names]
    broken = [r.case for r in rows if not isinstance(r.ours, Ours)]
    late = [r.case for r in rows if worse(r)]
    alone = [r.case for r in rows if not isinstance(r.script, ScriptErrors)]
    near, below = sum(ratio(r) <= _AIM for r, _ in known), sum(ratio(r) < 1 for r, _ in known)
    own = [r.case for r in rows if isinstance(r.ours, Ours) and r.ours.refitted]
    blinds = (
        sum(blind_ratio(r) <= _AIM for r, _ in known),
        sum(blind_ratio(r) < 1 for r, _ in known),
    )
    harmed = [r.case for r in rows if blindly_worse(r)]
    lines = [
        f"at most {_AIM:g} times the person's error: {near} of {len(known)} cases (aim: all)",
        f"below the person's error: {below} of {len(known)} cases (aim: half)",
        f"worse than the given model: {_some(late)} (aim: none)",
        f"chosen without a look at the judged runs: at most {_AIM:g} times {blinds[0]}, below "
        f"{blinds[1]}, worse than the given model {_some(harmed)}",
        f"internal errors: {_some(broken)} (aim: none)",
        f"named where nothing is missing: {_some(named)} of {len(complete)} cases (aim: none)",
    ]
    low = [r.case for r, script in known if _floor(r) > r.whole(script.final)]
    lines.append(f"noise floor stated above the person's error: {_some(low)} (aim: none)")
    if own:
        lines.append(f"* a value of every run by itself, judged runs included: {_some(own)}")
    return lines + ([f"the person's script failed: {_some(alone)}"] if alone else [])


def _floor(row: RealRow) -> float:
    """Noise floor that is stated [%]; NaN without any."""
    return row.whole(row.ours.floor) if isinstance(row.ours, Ours) and row.ours.ladder else math.nan


def _kinds(rows: Sequence[RealRow]) -> dict[str, list[RealRow]]:
    """Rows by kind of robot, in the order in which they come."""
    out: dict[str, list[RealRow]] = {}
    for row in rows:
        out.setdefault(row.kind, []).append(row)
    return out


def by_kind(rows: Sequence[RealRow]) -> list[list[str]]:
    """How many cases of each kind reach the aim, and the median ratio."""
    out = []
    for kind, some in _kinds(rows).items():
        ratios = sorted(math.inf if math.isnan(x) else x for x in map(ratio, some))
        near, below = sum(x <= _AIM for x in ratios), sum(x < 1 for x in ratios)
        middle = (ratios[(len(ratios) - 1) // 2] + ratios[len(ratios) // 2]) / 2
        out.append(
            [
                kind,
                str(len(some)),
                str(near),
                str(below),
                str(sum(map(worse, some))),
                _NOTHING if math.isinf(middle) else f"{middle:.2f}",
            ]
        )
    return out


KIND_HEAD = ("kind", "cases", f"at most {_AIM:g}", "below", "worse than given", "median ratio")


def failures(rows: Sequence[RealRow]) -> list[str]:
    """What failed on which case."""
    out = [f"{r.case}: {r.ours}" for r in rows if isinstance(r.ours, str)]
    return out + [f"{r.case}, person: {r.script}" for r in rows if isinstance(r.script, str)]


def json_rows(rows: Sequence[RealRow]) -> list[dict[str, Any]]:
    """For JSON; what is no number is null."""
    return [{key: _plain_data(x) for key, x in asdict(row).items()} for row in rows]


def _plain_data(x: Any) -> Any:
    if isinstance(x, dict):
        return {key: _plain_data(value) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [_plain_data(value) for value in x]
    return None if isinstance(x, float) and not math.isfinite(x) else x


def text(rows: Sequence[RealRow]) -> str:
    """For the terminal; `table` lays out a head and its rows."""
    parts = []
    for kind, some in _kinds(rows).items():
        parts += [kind, terminal.table(list(REAL_HEAD), [case_line(r) for r in some]), ""]
    parts += [terminal.table(list(KIND_HEAD), by_kind(rows)), ""]
    return "\n".join([*parts, *(f"  {x}" for x in (*aims(rows), *failures(rows)))])


def page(rows: Sequence[RealRow], command: str, revision: str) -> str:
    """For the documentation."""
    parts = [
        "# Real recordings",
        "",
        f"Printed by `{command} --report docs/bench/real.md`",
        f"at revision {revision}.  Every public recording that the package can load, default",
        "settings.  Some runs are fitted and others judged: the split of the set, else first and",
        "second half; EMPS: the sine-like record, and the one with pulses; the lever in free",
        "motion: every other run.  Errors are rms residuals over rms effort on the runs that were",
        "not fitted, in %, over the joints that move (each in its own effort's scale).",
        "",
        "- *given*: the base model as `hil import` writes it (on foam and springs a linear spring",
        "  and an offset); *with offset*: the same by the person's script, with an offset on every",
        "  joint;",
        "- *person*: greedy least squares on hand-made features "
        "(`hil/bench/least_squares_script.py`),",
        "  chosen on the training runs alone; same rows and band;",
        "- *ours*: the model that `hil improve` writes where the judged runs are given as held-out",
        "  runs (no rung of its ladder may raise their error); *blind*: where it does not see them",
        "  at all, as the person's script; *floor*: the noise floor that it states;",
        "- *named*: with the confidence stated; seconds and memory of one process on one core;",
        "- \\*: the written model has a value of every run by itself (an offset, say), which is",
        "  estimated on the judged runs, too; the person's script has one value for all runs.",
        "",
        "## What is aimed at",
        "",
        *(f"- {x}" for x in map(_plain, aims(rows))),
        "",
        *_markdown(KIND_HEAD, by_kind(rows)),
        "",
    ]
    for kind, some in _kinds(rows).items():
        missing = "; nothing is known to be missing" if all(r.complete for r in some) else ""
        parts += [f"## {kind[0].upper()}{kind[1:]}{missing}", ""]
        parts += [*_markdown(REAL_HEAD, [case_line(r) for r in some]), ""]
    parts += ["## Joint by joint, and what the person's script took", ""]
    parts += [*_markdown(JOINT_HEAD, [x for r in rows for x in joint_lines(r)]), ""]
    if broken := failures(rows):
        parts += ["## What failed", "", *(f"- {x}" for x in broken), ""]
    return "\n".join(parts)


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    body = ("| " + " | ".join(_plain(x) for x in row) + " |" for row in rows)
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *body]


def _plain(words: str) -> str:
    """Words in which Markdown finds nothing to set."""
    return words.replace("|", "/").replace("*", "\\*").replace("_", "\\_")


def _number(x: float) -> str:
    return _NOTHING if math.isnan(x) else f"{x:.3g}" if abs(x) < 1 else f"{x:.1f}"


def _some(names: Sequence[str]) -> str:
    return f"{len(names)} ({', '.join(names)})" if names else "0"


def command(args: argparse.Namespace) -> Found:
    """Every public recording: the given model, a person's script, and the tool beside them."""
    terminal.check_page(args.report)
    todo, kept, made_by = cases(args.only), runner.resumed(args.resume), runner.revision()
    names = {c.name for c in todo}
    before = runner.read(kept) if kept else []
    found = {
        r["case"]["case"]: from_data(r["case"])
        for r in before
        if r["revision"] == made_by and r["case"]["case"] in names
    }
    left = [c for c in todo if c.name not in found]
    for row in counted(examine_cases(left, computer(args)), len(left), "case"):
        found[row.case] = row
        if kept:
            runner.append(kept, {"revision": made_by, "case": to_data(row)})
    rows = [found[c.name] for c in todo]
    only = "".join(f" --only {word}" for word in args.only)
    command = f"hil bench real{only} --workers {args.workers}"
    terminal.write_page(args.report, page(rows, command, made_by))
    return text(rows), {"revision": made_by, "cases": json_rows(rows)}
