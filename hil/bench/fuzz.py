"""Parsers under mutated input, guided by which lines of the program an input reaches.

Each target runs in a process of its own, with limits of memory and of time for one input.  What
is no refusal in the program's own words is a finding: another error, a crash of a library, an
input that takes too long.  The input that did it is kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import mmap
import multiprocessing
import os
import random
import re
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from hil.errors import ConfigError, HilError, plural
from hil.interrupt import held_back, with_its_parent

#: Longest input [byte]; time for one input [s]; memory beyond what the program itself takes [byte].
LONGEST_INPUT, SLOW_S, _MEMORY = 2**20, 20.0, 2**31
#: Inputs that are kept to be mutated further.
MOST_KEPT = 2000
#: Every so often a worker says how far it is [s].
_REPORT_S = 1.0
#: What a process that ended at once counts of its target's time [s].
_LEAST_S = 1.0
#: Files whose lines count: of this program, and of libraries' parsers in Python.
_COUNTED = re.compile(r"[/\\](hil|drivers|tomllib|rosbags|openpyxl)[/\\]")
_OWN = re.compile(r"[/\\](hil|drivers)[/\\]")
_NUMBERS = [b"nan", b"inf", b"-1", b"0", b"1e400", b"-1e-320", b"1" * 30, b"65536", b"1e15", b""]
#: Numbers of 1, 4 and 8 bytes at their ends; then marks of text, among them what a terminal obeys.
_WORDS = [
    bytes.fromhex(x)
    for x in "00 ff 00000000 01000000 ffffffff ffffff7f 00000080 0000000000000000 "
    "ffffffffffffffff 0000000000000080 0d0a efbbbf e280ae 1b5b324a eda080".split()
] + [c.encode() for c in "\n\"'[{,;=.#\\<>/%"]
_DIGITS = re.compile(rb"[-+]?\d[\d.eE+-]*")


@dataclass(frozen=True)
class Target:
    """One parser.

    Parameters
    ----------
    name : str
        Of the parser.
    use : callable
        Takes an input and a folder for files; may refuse with a `HilError`.
    seeds : callable
        Gives small inputs that are right.
    """

    name: str
    use: Callable[[bytes, Path], object]
    seeds: Callable[[], Sequence[bytes]]


@dataclass(frozen=True)
class FuzzFinding:
    """An input that was not refused as it should be.

    Parameters
    ----------
    what : str
        Error with its place, crash, or time.
    data : bytes
        The input.
    """

    what: str
    data: bytes


@dataclass
class Explored:
    """What came of one target.

    Parameters
    ----------
    name : str
        Of the target.
    seconds : float
        Processor time that was spent.
    runs, lines, kept : int
        Inputs that were run, pairs of successive lines that they reached, inputs that were kept.
    findings : list of Finding
        One of each kind.
    """

    name: str
    seconds: float = 0.0
    runs: int = 0
    lines: int = 0
    kept: int = 0
    findings: list[FuzzFinding] = field(default_factory=list)


class LineCoverage:
    """Pairs of successive lines of the counted files that run within `watch`."""

    def __init__(self) -> None:
        self.seen: set[tuple[CodeType, int, int]] = set()
        self._counted: dict[CodeType, bool] = {}
        self._last = 0

    @contextlib.contextmanager
    def watch(self) -> Iterator[None]:
        """Count what runs within."""
        before, self._last = sys.gettrace(), 0
        sys.settrace(self._call)
        try:
            yield
        finally:
            sys.settrace(before)

    def _call(self, frame: FrameType, event: str, _: Any) -> Callable[..., Any] | None:
        code = frame.f_code
        counted = self._counted.get(code)
        if counted is None:
            counted = self._counted[code] = bool(_COUNTED.search(code.co_filename))
        return self._line if counted else None

    def _line(self, frame: FrameType, event: str, _: Any) -> Callable[..., Any]:
        if event == "line":
            self.seen.add((frame.f_code, self._last, frame.f_lineno))
            self._last = frame.f_lineno
        return self._line


def mutated(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """An input with one to five changes; `others` give parts of theirs."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 5))):
        data = rng.choice(_CHANGES)(data, others, rng)
    return data[:LONGEST_INPUT]


def _bit(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    if not data:
        return b"\0"
    k = rng.randrange(len(data))
    return data[:k] + bytes([data[k] ^ 1 << rng.randrange(8)]) + data[k + 1 :]


def _word(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    k, word = rng.randint(0, len(data)), rng.choice(_WORDS)
    return data[:k] + word + data[k + rng.choice((0, len(word))) :]


def _number(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    found = list(_DIGITS.finditer(data))
    if not found:
        return _word(data, others, rng)
    at = rng.choice(found)
    return data[: at.start()] + rng.choice(_NUMBERS) + data[at.end() :]


def _cut(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    a, b = sorted(rng.randint(0, len(data)) for _ in "ab")
    return data[:a] + data[min(b, a + rng.choice((1, 8, 64, 4096))) :]


def _end(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    return data[: rng.randint(0, len(data))]


def _again(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    a, b = sorted(rng.randint(0, len(data)) for _ in "ab")
    times = rng.choice((1, 1, 1, 2, 20))
    return data[:b] + data[a : a + min(b - a, 4096)] * times + data[b:]


def _spliced(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    other = rng.choice(others)
    a, b = sorted(rng.randint(0, len(other)) for _ in "ab")
    k = rng.randint(0, len(data))
    return data[:k] + other[a:b] + data[k + rng.choice((0, b - a)) :]


_CHANGES = (_bit, _bit, _word, _number, _number, _cut, _end, _again, _spliced)


def tried_input(target: Target, data: bytes, folder: Path) -> str:
    """Run one input; what is wrong, empty if it was taken or refused properly."""
    try:
        with (
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("error", RuntimeWarning)  # it would be a line of its own
            target.use(data, folder)
    except HilError as error:
        return "" if str(error) else "a refusal without a word"
    except Exception as error:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename != __file__]
        own = [f for f in frames if _OWN.search(f.filename)]
        place = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
        return f"{type(error).__name__} in {place}"
    return ""


def explore_target(
    target: Target, seconds: float, seed: int = 0, report: Callable[[Any], None] = lambda _: None
) -> Explored:
    """Mutate and run in this process; `report` gets every input before it runs, then the state."""
    rng, lines, out = random.Random(seed), LineCoverage(), Explored(target.name)
    began = _processor_s()
    kinds: set[str] = set()
    kept: list[bytes] = []
    with tempfile.TemporaryDirectory() as name:
        waiting = list(target.seeds())[::-1]
        while _processor_s() - began < seconds or waiting:
            now = _processor_s()
            data = waiting.pop() if waiting else mutated(_chosen(kept, rng), kept or [b""], rng)
            report(data)
            before = len(lines.seen)
            with lines.watch():
                wrong = tried_input(target, data, Path(name))
            took = _processor_s() - now
            wrong = wrong or (f"takes {took:.0f} s" if took > SLOW_S else "")
            if wrong and wrong.split(" s")[0] not in kinds:
                kinds.add(wrong.split(" s")[0])
                out.findings.append(FuzzFinding(wrong, data))
            elif len(lines.seen) > before or not out.runs:
                kept = [*kept, data][-MOST_KEPT:]
            out.runs += 1
            out.seconds, out.lines, out.kept = _processor_s() - began, len(lines.seen), len(kept)
            report(out)
    return out


def _processor_s() -> float:
    """Processor time of this process and of the readers that it has waited for [s].

    A machine that does other work too then tries as many inputs a minute as a quiet one.
    """
    return sum(os.times()[:4])


def _chosen(kept: Sequence[bytes], rng: random.Random) -> bytes:
    """An input to mutate, half the time one of the latest."""
    some = kept[-20:] if rng.random() < 0.5 else kept
    return rng.choice(some) if some else b""


# ------------------------------------------------------------ each target in a process


def explore_guarded(target: Target, seconds: float, seed: int = 0) -> Explored:
    """Explore in a process; it is started again after a crash or a hang until the time is over."""
    total, lines = Explored(target.name), 0
    while (left := seconds - total.seconds) > 0:
        some = _one_process(target, left, seed)
        total.seconds += max(some.seconds, _LEAST_S)
        seed += 1
        total.runs += some.runs
        total.kept, lines = max(total.kept, some.kept), max(lines, some.lines)
        known = {f.what for f in total.findings}
        total.findings += [f for f in some.findings if f.what not in known]
    total.lines = lines
    return total


def _one_process(target: Target, seconds: float, seed: int) -> Explored:
    context = multiprocessing.get_context("spawn")
    receive, send = context.Pipe(duplex=False)
    with tempfile.NamedTemporaryFile() as file:
        file.truncate(LONGEST_INPUT + 8)
        with held_back():  # an interruption is for the process that waits here
            child = context.Process(target=_work, args=(send, file.name, target, seconds, seed))
            child.daemon = False  # it may start readers of its own
            child.start()
        send.close()
        state, why = Explored(target.name), ""
        try:
            while child.is_alive() or receive.poll():
                # the first input waits for imports and compilers
                patience = 3 * SLOW_S if state.runs else 15 * SLOW_S
                if not receive.poll(patience):
                    why = f"does not end within {patience:.0f} s"
                    break
                try:
                    state = receive.recv()
                except EOFError:
                    child.join(SLOW_S)
                    break
        finally:
            child.kill()
            child.join()
        code = child.exitcode or 0
        if not why and code:
            why = f"ends the process with {f'signal {-code}' if code < 0 else f'status {code}'}"
        if why:
            data = Path(file.name).read_bytes()
            size = int.from_bytes(data[:8], "little")
            state.findings.append(FuzzFinding(why, data[8 : 8 + size]))
    return state


def _work(send: Connection, name: str, target: Target, seconds: float, seed: int) -> None:
    """In the process: each input is written down before it runs, and what came of it told."""
    with_its_parent()
    _limit()
    with open(name, "r+b") as file, mmap.mmap(file.fileno(), LONGEST_INPUT + 8) as page:
        told = time.monotonic() - _REPORT_S

        def report(what: bytes | Explored) -> None:
            nonlocal told
            if isinstance(what, bytes):
                page[: 8 + len(what)] = len(what).to_bytes(8, "little") + what
            elif time.monotonic() - told > _REPORT_S:
                told = time.monotonic()
                send.send(what)

        send.send(explore_target(target, seconds, seed, report))


def _limit() -> None:
    import resource

    with open("/proc/self/statm", "rb") as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + _MEMORY, now + _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


# ------------------------------------------------------------ what is said

TABLE_HEAD = ("target", "minutes", "inputs", "line pairs", "kept", "findings", "minutes since")


@dataclass
class Sum:
    """What came of all turns of one target.

    Parameters
    ----------
    name : str
        Of the target.
    seconds, clean : float
        Time of all turns, and of those after the last one with a finding.
    runs, lines, kept : int
        Inputs of all turns; most line pairs and kept inputs of one.
    findings : list of str
        What was found, in the order of the turns.
    """

    name: str
    seconds: float = 0.0
    clean: float = 0.0
    runs: int = 0
    lines: int = 0
    kept: int = 0
    findings: list[str] = field(default_factory=list)

    def add(self, turn: Mapping[str, Any]) -> None:
        """Add a turn as `remember` writes it."""
        self.seconds += turn["seconds"]
        self.clean = 0.0 if turn["findings"] else self.clean + turn["seconds"]
        self.runs += turn["runs"]
        self.lines = max(self.lines, turn["lines"])
        self.kept = max(self.kept, turn["kept"])
        self.findings += [f for f in turn["findings"] if f not in self.findings]

    def row(self) -> list[str]:
        """Row of the table."""
        return [
            self.name,
            f"{self.seconds / 60:.1f}",
            str(self.runs),
            str(self.lines),
            str(self.kept),
            "; ".join(self.findings) or "none",
            f"{self.clean / 60:.1f}",
        ]


def remembered_turn(found: Explored, revision: str) -> dict[str, Any]:
    """A turn as it is remembered."""
    told = {k: getattr(found, k) for k in ("name", "runs", "lines", "kept")}
    what = [f.what for f in found.findings]
    return {**told, "seconds": round(found.seconds, 1), "findings": what, "revision": revision}


def remember(path: Path, one: Mapping[str, Any]) -> None:
    """Add a turn to a file of turns, a line each."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(one) + "\n")


def remembered(path: Path) -> list[dict[str, Any]]:
    """Turns of a file; none where there is no file.

    Raises
    ------
    ConfigError
        If a line is no turn.
    """
    if not path.exists():
        return []
    out = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            one = json.loads(line)
            Sum(str(one["name"])).add(one)
        except (ValueError, KeyError, TypeError) as error:
            raise ConfigError(
                f"{path}, line {number}: no turn of 'hil bench fuzz' ({error}); take another file"
            ) from error
        out.append(one)
    return out


def summed(turns: Sequence[Mapping[str, Any]], order: Sequence[str]) -> list[Sum]:
    """One sum a target, in an order; targets without a turn are left out."""
    out = {name: Sum(name) for name in order}
    for one in turns:
        if one["name"] in out:
            out[one["name"]].add(one)
    return [s for s in out.values() if s.seconds]


def keep(found: Sequence[Explored], folder: Path) -> list[Path]:
    """Write the inputs of all findings; none makes no folder."""
    out = []
    for explored in found:
        for f in explored.findings:
            folder.mkdir(parents=True, exist_ok=True)
            digest = hashlib.sha256(f.data).hexdigest()[:12]
            out.append(folder / f"{explored.name}-{digest}.bin")
            out[-1].write_bytes(f.data)
    return out


def fuzz_verdict(found: Sequence[Sum]) -> str:
    """What all targets together came to."""
    count = sum(len(e.findings) for e in found)
    runs, minutes = sum(e.runs for e in found), sum(e.seconds for e in found) / 60
    return (
        f"{plural(count, 'finding')} in {plural(len(found), 'target')}, {runs} inputs, "
        f"{minutes:.1f} minutes"
    )


_PAGE = (
    "# Parsers under mutated input\n\n"
    "Made by `{command}` with Python {python} on {processors} processors, which did other work "
    "too. The minutes of several turns add up (revisions {revisions}). They are minutes of "
    "processor time, and up to revision 8fb4cd9 of the clock.\n\n"
    "Inputs are changed at random; those that reach new lines of the program are changed further. "
    "A finding is an error that is no refusal in the program's own words, a warning, a crash, an "
    "input that takes more than {slow:.0f} s, or more memory than {memory:.0f} GiB. The last "
    "column counts the minutes after the last turn with a finding. Inputs that were found are "
    "mended and kept in `tests/bench/fuzz_seeds`; they are run with the tests. Targets that start "
    "a reader's process for each input, or run whole commands, try few inputs a minute.\n\n"
    "{table}\n\n{verdict}.\n"
)


def page(found: Sequence[Sum], command: str, revisions: Sequence[str]) -> str:
    """The table as a page."""
    rows = [TABLE_HEAD, ["---"] * len(TABLE_HEAD), *(e.row() for e in found)]
    return _PAGE.format(
        command=command,
        python=f"{sys.version_info.major}.{sys.version_info.minor}",
        processors=os.cpu_count(),
        revisions=", ".join(revisions),
        slow=SLOW_S,
        memory=_MEMORY / 2**30,
        table="\n".join(f"| {' | '.join(r)} |" for r in rows),
        verdict=fuzz_verdict(found),
    )
