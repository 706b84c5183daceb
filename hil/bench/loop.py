"""The loop beside cyclictest, plain `time.sleep` and the operator's page, in turns on one machine.

One of the runs has its slow side in a separate process, over a ring in shared memory.  That process
is forked before the loop is arranged, writes the same file, and takes no commands: what it lacks
would not make the loop later.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import mmap
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from hil import terminal
from hil.errors import ConfigError, DeviceError
from hil.record.mcap_read import read_metadata
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner, session
from hil.runtime.board import Ring
from hil.runtime.clock import SPIN_NS, MonotonicClock
from hil.runtime.realtime import arranged
from hil.runtime.statistics import Histogram
from hil.terminal import Found

#: Words that both processes see: rows in, rows out, time of tick 0, the loop has ended.
_HEAD, _TAIL, _EPOCH, _OVER, _WORDS = 0, 1, 2, 3, 8


class SharedRing(Ring):
    """A `Ring` whose rows and counters lie in memory that a forked process shares."""

    def __init__(self, rows: int, width: int) -> None:
        size = 8 * (_WORDS + rows * (2 + width))
        self._memory = mmap.mmap(-1, size)
        whole = np.frombuffer(self._memory, np.int64)
        self.words: NDArray[np.int64] = whole[:_WORDS]
        super().__init__(rows, width)
        stamps = whole[_WORDS : _WORDS + 2 * rows].reshape(rows, 2)
        self._stamps = stamps
        self._data = whole[_WORDS + 2 * rows :].view(np.float64).reshape(rows, width)

    @property
    def _head(self) -> int:
        return int(self.words[_HEAD])

    @_head.setter
    def _head(self, value: int) -> None:
        self.words[_HEAD] = value

    @property
    def _tail(self) -> int:
        return int(self.words[_TAIL])

    @_tail.setter
    def _tail(self, value: int) -> None:
        self.words[_TAIL] = value


class SeparateProcessSession(runner.Session):
    """`hil.runtime.runner.Session` with the slow side in a process."""

    ring_type = SharedRing

    def _real(self, progress: Callable[[int], None] | None) -> None:
        """Fast loop in this process, the slow side in a forked one."""
        words = self._words()
        told, tell = os.pipe()
        child = os.fork()
        if child == 0:
            self._child(words, tell)
        os.close(tell)
        self.writer.release()
        try:
            with arranged(self.config.loop.realtime) as self.arrangement:
                self._enable()
                words[_EPOCH] = self.timer.epoch_ns
                while not self.over():
                    self.loop.step()
        finally:
            try:
                self._release()
            finally:
                words[_OVER] = 1
                self._figures = _received_figures(told, child)

    def _words(self) -> NDArray[np.int64]:
        ring: Any = self.ring
        return np.asarray(ring.words)

    def _child(self, words: NDArray[np.int64], tell: int) -> None:
        """Drain at the slow rate until the loop has ended, close the file, tell the figures."""
        code = 1
        try:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            others = os.sched_getaffinity(0)
            if len(others) > 1:
                os.sched_setaffinity(0, others - {max(others)})
            while not words[_EPOCH]:
                time.sleep(1e-3)
            self.slow.note(0, int(words[_EPOCH]), "enabled")
            while not words[_OVER]:
                time.sleep(1.0 / self.config.loop.slow_hz)
                self.slow.step(0.0)
            self.slow.step(0.0)
            session.conclude(self.writer, self.statistics, self.arrangement)
            self.writer.close()
            os.write(tell, json.dumps(self.statistics.figures().as_dict()).encode())
            code = 0
        finally:
            os._exit(code)

    def _finish(self, name: str, told: dict[str, object]) -> None:
        """The process has closed the file."""

    def figures(self) -> dict[str, float]:
        """As the process has counted them."""
        return self._figures


def _received_figures(pipe: int, child: int) -> dict[str, float]:
    """Figures from the process, once it has ended."""
    with os.fdopen(pipe, "rb") as file:
        text = file.read()
    _, status = os.waitpid(child, 0)
    if status or not text:
        raise DeviceError(f"the process of the slow side ended with status {status}")
    return dict(json.loads(text))


_PERIOD_NS = 1_000_000
#: As in cyclictest's histogram: up to 100 ms, a microsecond a bin.
_BINS = 100_000
_NONE = float("nan")
_CYCLICTEST, _SPINS = "cyclictest -m -p 80 -a", "hil run, full recording"
_SLEEPS = _SPINS + ", sleeps to the tick"


@dataclass(frozen=True)
class LoopRun:
    """Wake-up latencies of one run [us].

    Parameters
    ----------
    name : str
        What ran.
    ticks, missed : int
        Periods done, and wake-ups more than a period late (skipped periods of the loop).
    p50, p99, p999, most : float
        [us].
    note : str
        What the operating system granted, or why there is no figure.
    share : float
        Processor time over time, of all threads and processes of the run [%].
    """

    name: str
    ticks: int
    missed: int
    p50: float
    p99: float
    p999: float
    most: float
    note: str = ""
    share: float = _NONE


def _processor_seconds() -> float:
    """Processor time of this process and of its children that have ended [s]."""
    who = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(u.ru_utime + u.ru_stime for u in map(resource.getrusage, who))


def hil_loop(
    seconds: float,
    what: str = "",
    kind: type[runner.Session] | None = None,
    spin_ns: int = SPIN_NS,
    **loop: Any,
) -> LoopRun:
    """The teleoperation rig in real time, with full recording; `loop` over its rig file."""
    config = load_rig(rig_path("teleop"), {"loop": loop})

    def timer(period_ns: int) -> MonotonicClock:
        return MonotonicClock(period_ns, spin_ns=spin_ns)

    with tempfile.TemporaryDirectory() as folder:
        path, used = Path(folder) / "loop.mcap", _processor_seconds()
        done = runner.run_session(config, seconds, 1, "real", path, kind=kind, timer=timer)
        used = _processor_seconds() - used
    f = done.figures
    lost = f"; {done.dropped} rows dropped" if done.dropped else ""
    return LoopRun(
        _SPINS + (f", {what}" if what else ""),
        done.ticks,
        done.missed,
        f["late_p50"],
        f["late_p99"],
        f["late_p999"],
        f["late_most"],
        (", ".join(done.granted) or "nothing granted") + lost,
        100.0 * used / done.wall_seconds,
    )


def sleeping_loop(seconds: float) -> LoopRun:
    """The loop without spinning, as cyclictest waits: it sleeps to the tick."""
    return hil_loop(seconds, "sleeps to the tick", spin_ns=0)


class _Load:
    """Work on all cores but the loop's, by stress-ng."""

    def __init__(self) -> None:
        self._program = shutil.which("stress-ng")
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> str:
        """Start it; why not, where it cannot be."""
        others = sorted(os.sched_getaffinity(0))[:-1]
        if self._program is None:
            return "stress-ng is not installed"
        if not others:
            return "there is one core"
        cores = ",".join(map(str, others))
        words = ["--cpu", str(len(others)), "--vm", "1", "--vm-bytes", "128M", "--taskset", cores]
        self._process = subprocess.Popen(
            [self._program, *words, "--quiet"], start_new_session=True, stdout=subprocess.DEVNULL
        )
        return ""

    def __exit__(self, *error: object) -> None:
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGTERM)
            self._process.wait()


def under_load(run: Callable[[float], LoopRun]) -> Callable[[float], LoopRun]:
    """The same run while stress-ng works on the other cores."""

    def loaded(seconds: float) -> LoopRun:
        with _Load() as why:
            if why:
                return LoopRun(f"{run.__name__}, under load", 0, 0, *(_NONE,) * 4, note=why)
            found = run(seconds)
        return replace(found, name=f"{found.name}, under load")

    return loaded


def separate_process(seconds: float) -> LoopRun:
    """The slow side in a process of its own; not on systems that cannot fork."""
    if not hasattr(os, "fork"):
        nan = (_NONE,) * 4
        return LoopRun("hil run, slow side in a process", 0, 0, *nan, "needs fork")
    return hil_loop(seconds, "slow side in a process (shared memory ring)", SeparateProcessSession)


def plain_sleep(seconds: float) -> LoopRun:
    """What a user would write: sleep to the next tick, the same arithmetic of one rig's tick."""
    late, work, missed = [], np.zeros(64), 0
    zero = time.monotonic_ns()
    for k in range(1, round(seconds * 1e9 / _PERIOD_NS) + 1):
        due = zero + k * _PERIOD_NS
        time.sleep(max(0, due - time.monotonic_ns()) * 1e-9)
        now = time.monotonic_ns() - due
        late.append(now)
        missed += now > _PERIOD_NS
        for _ in range(20):
            work += 0.5 * work
    return _run("plain time.sleep, nothing recorded", np.array(late, float), missed)


def _run(name: str, late_ns: NDArray[np.float64], missed: int, note: str = "") -> LoopRun:
    h = Histogram()
    h.add(late_ns)
    p50, p99, p999 = (h.quantile(q) * 1e-3 for q in (0.5, 0.99, 0.999))
    return LoopRun(name, h.n, missed, p50, p99, p999, h.most * 1e-3, note)


def cyclictest(seconds: float) -> LoopRun:
    """`cyclictest -m -p 80 -a`: what the machine allows any program."""
    name = _CYCLICTEST
    program = shutil.which("cyclictest")
    if program is None:
        return LoopRun(name, 0, 0, _NONE, _NONE, _NONE, _NONE, "not installed (package rt-tests)")
    words = [program, "-m", "-p", "80", "-a", "-t", "1", "-i", "1000", "-q",
             "-D", f"{max(1, round(seconds))}", "-h", str(_BINS)]  # fmt: skip
    used = _processor_seconds()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    share = 100.0 * (_processor_seconds() - used) / max(1, round(seconds))
    if done.returncode != 0:
        why = (done.stderr or done.stdout).strip().splitlines()
        return LoopRun(name, 0, 0, _NONE, _NONE, _NONE, _NONE, why[-1] if why else "failed")
    rows = re.findall(r"^(\d{6}) (\d+)", done.stdout, re.M)
    us, counts = (np.array([int(r[k]) for r in rows], np.int64) for k in (0, 1))
    most = int(re.findall(r"Max Latencies:\s*(\d+)", done.stdout)[0])
    total = np.cumsum(counts)
    overflow = sum(int(x) for x in re.findall(r"Histogram Overflows:\s*(\d+)", done.stdout))
    p50, p99, p999 = (
        float(us[int(np.searchsorted(total, q * total[-1]))]) for q in (0.5, 0.99, 0.999)
    )
    missed = int(counts[us >= _PERIOD_NS // 1000].sum()) + overflow
    return LoopRun(
        name, int(total[-1]) + overflow, missed, p50, p99, p999, float(most), share=share
    )


#: In turns, so that a busy minute of the machine falls on all.
RUNS: tuple[Callable[[float], LoopRun], ...] = (
    cyclictest,
    sleeping_loop,
    hil_loop,
    under_load(cyclictest),
    under_load(sleeping_loop),
    under_load(hil_loop),
    separate_process,
    lambda seconds: hil_loop(seconds, "no real-time class", realtime=False),
    plain_sleep,
    lambda seconds: hil_loop(seconds, "2 kHz", rate_hz=2000.0),
    lambda seconds: hil_loop(seconds, "4 kHz", rate_hz=4000.0),
)


def _compare(seconds: float, turns: int) -> list[LoopRun]:
    """All runs, each for so long [s], in turns; of every figure the median of the turns."""
    hil_loop(0.3)  # compiled code into the cache
    found = [[run(seconds) for run in RUNS] for _ in range(turns)]
    return [median_run(list(same)) for same in zip(*found, strict=True)]


_FIGURES = ("ticks", "missed", "p50", "p99", "p999", "most", "share")


def median_run(turns: list[LoopRun]) -> LoopRun:
    """The same run of several turns: the median of every figure."""
    middle: dict[str, Any] = {
        name: float(np.median([getattr(r, name) for r in turns])) for name in _FIGURES
    }
    middle |= {name: round(middle[name]) for name in ("ticks", "missed")}
    return replace(turns[-1], **middle)


HEAD = (
    "run",
    "ticks",
    "missed",
    "p50 [us]",
    "p99 [us]",
    "p99.9 [us]",
    "most [us]",
    "processor [%]",
    "",
)


def rows(found: list[LoopRun]) -> list[list[str]]:
    """Cells of the table."""
    return [
        [
            r.name,
            str(r.ticks),
            str(r.missed),
            *(f"{v:.1f}" for v in (r.p50, r.p99, r.p999, r.most)),
            f"{r.share:.0f}" if r.share == r.share else "-",
            r.note,
        ]
        for r in found
    ]


def loop_verdict(found: list[LoopRun]) -> str:
    """The loop against the machine's own limit, like for like."""
    lines = []
    for load in ("", ", under load"):
        at = {r.name: r for r in found if r.ticks and r.name.endswith(load)}
        test = at.get(_CYCLICTEST + load)
        sleeps, spins = (at.get(name + load) for name in (_SLEEPS, _SPINS))
        if test is None:
            lines.append(
                f"cyclictest{load} did not run: there is nothing to compare the loop with."
            )
        elif sleeps is not None and spins is not None:
            lines.append(
                f"p99{load}: cyclictest {test.p99:.0f} us; the loop {sleeps.p99:.0f} us where it "
                f"sleeps to the tick as cyclictest does ({sleeps.share:.0f} % of a core), "
                f"{spins.p99:.0f} us where it spins for the last {SPIN_NS // 1000} us "
                f"({spins.share:.0f} %). Wake-ups later than a period: {test.missed}, "
                f"{sleeps.missed}, {spins.missed}."
            )
    return "\n".join(lines)


def table(found: list[LoopRun]) -> str:
    """Table for the terminal."""
    cells = [list(HEAD), *rows(found)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(HEAD))]
    lines = [
        "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in cells
    ]
    return "\n".join([*lines, "", loop_verdict(found)])


def page(found: list[LoopRun], command: str) -> str:
    """Page for the documentation."""
    return "\n".join(
        [
            "# The loop beside cyclictest",
            "",
            f"Printed by `{command}`; the median of the turns,",
            "at 1 kHz where nothing else is said. `missed`: periods that were skipped; of "
            "cyclictest and",
            "plain code, wake-ups later than a period. Latencies are those of the wake-up. The "
            "loop spins for",
            f"the last {SPIN_NS // 1000} us before it, which cyclictest does not; *sleeps to the "
            "tick* is the loop without that.",
            "*Under load*: stress-ng works on all other cores. *processor*: of all threads, 100 "
            "is one core.",
            "",
            "| " + " | ".join(HEAD) + " |",
            "|" + "---|" * len(HEAD),
            *("| " + " | ".join(r) + " |" for r in rows(found)),
            "",
            loop_verdict(found),
            "",
        ]
    )


def command(args: argparse.Namespace) -> Found:
    """The loop under load: how late its ticks are, beside cyclictest."""
    terminal.check_page(args.report)
    if args.turns < 1:
        raise ConfigError(f"--turns {args.turns}: one or more is needed")
    found = _compare(args.seconds, args.turns)
    command = f"hil bench loop --seconds {args.seconds:g} --turns {args.turns}"
    terminal.write_page(args.report, page(found, command))
    return table(found), {"runs": [asdict(r) for r in found]}


# ------------------------------------------------------------ beside the operator's page

_CLOSED = "no page"
#: Windows of the browser that a run has, by its name; the first is the reference, the second the
#: same once more: how far two runs differ that differ in nothing.
_WINDOWS = {_CLOSED: 0, "no page, once more": 0, "page open": 1, "page open in two windows": 2}
#: What the page needs of the machine, and how long it may take to begin [s].
_NEEDS = "needs playwright (hil-teleop[test]) and Chromium"
_BEGIN_S = 60.0


def beside_page(seconds: float, windows: int) -> LoopRun:
    """The teleoperation rig in real time: alone, or with the operator's page in a browser.

    Parameters
    ----------
    seconds : float
        Length [s].
    windows : int
        How many windows show the page; one of them commands.
    """
    name = list(_WINDOWS)[[*_WINDOWS.values()].index(windows)]
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if windows and (importlib.util.find_spec("playwright") is None or browser is None):
        return LoopRun(name, 0, 0, *(math.nan,) * 4, note=_NEEDS)
    with tempfile.TemporaryDirectory() as folder:
        if windows:
            _through_the_page(Path(folder), seconds, windows, str(browser))
        else:
            words = ["run", "teleop", "--clock", "real", "--seconds", f"{seconds:g}", "--plain"]
            _hil([*words, "-o", str(Path(folder) / "s.mcap")]).communicate()
        (session,) = Path(folder).glob("*.mcap")
        told = read_metadata(session)["loop"]
    f = json.loads(told["figures"])
    late = (f["late_p50"], f["late_p99"], f["late_p999"], f["late_most"])
    note = told["granted"].replace(";", ",") or "nothing granted"
    return LoopRun(name, int(f["ticks"]), int(f["missed"]), *late, note=note)


def _hil(words: list[str]) -> subprocess.Popen[str]:
    """The program itself, with these words."""
    return subprocess.Popen(
        [sys.executable, "-m", "hil", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )


def _through_the_page(folder: Path, seconds: float, windows: int, browser: str) -> None:
    """A session as an operator runs it: begin, start, watch, end."""
    from playwright.sync_api import sync_playwright

    words = ["ui", "teleop", "--no-browser", "-o", str(folder), "--seconds", f"{seconds:g}"]
    served = _hil(words)
    try:
        line = served.stdout.readline() if served.stdout else ""
        address = re.search(r"http\S+", line)
        if address is None:
            raise DeviceError("hil ui did not begin; run it by hand to see why")
        with sync_playwright() as playwright:
            window = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
            pages = [window.new_page() for _ in range(windows)]
            for page in pages:
                page.set_default_timeout(1e3 * (_BEGIN_S + seconds))
                page.goto(address[0])
            first = pages[0]
            first.locator("#take:enabled").click()
            first.locator("#begin:enabled").click()
            first.locator("[data-say=start]:enabled").click()
            first.locator("#state", has_text="ended").wait_for()
            window.close()
    finally:
        served.terminate()
        served.communicate()


@dataclass(frozen=True)
class PageRow:
    """Latency of the loop with so many windows, beside that without, turn by turn.

    Parameters
    ----------
    run : LoopRun
        Median of the turns.
    p50, p99, p999 : tuple of float
        Ratio to *no page* of the same turn: lowest, median, highest.
    """

    run: LoopRun
    p50: tuple[float, float, float]
    p99: tuple[float, float, float]
    p999: tuple[float, float, float]


def beside_pages(
    seconds: float, turns: int, done: Callable[[], object] = lambda: None
) -> list[PageRow]:
    """All runs of `_WINDOWS`, in turns."""
    found: dict[str, list[LoopRun]] = {name: [] for name in _WINDOWS}
    for _ in range(turns):
        for name, windows in _WINDOWS.items():
            found[name].append(replace(beside_page(seconds, windows), name=name))
            done()
    return [page_row(same, found[_CLOSED]) for same in found.values()]


def page_row(same: list[LoopRun], closed: list[LoopRun]) -> PageRow:
    """Figures of the turns of one run, and their ratios to those without a page."""

    def ratio(name: str) -> tuple[float, float, float]:
        pairs = zip(same, closed, strict=True)
        r = [getattr(a, name) / max(getattr(b, name), 0.1) for a, b in pairs]
        return min(r), float(np.median(r)), max(r)

    return PageRow(median_run(same), ratio("p50"), ratio("p99"), ratio("p999"))


PAGE_HEAD = (*HEAD[:-2], "p50 ratio", "p99 ratio", "p99.9 ratio", "")


def page_rows(found: list[PageRow]) -> list[list[str]]:
    """Cells of the table."""
    out = []
    for row, cells in zip(found, rows([r.run for r in found]), strict=True):
        ratios = (
            "-" if math.isnan(r[1]) else f"{r[1]:.2f} ({r[0]:.2f}-{r[2]:.2f})"
            for r in (row.p50, row.p99, row.p999)
        )
        out.append([*cells[:-2], *ratios, cells[-1]])
    return out


def page_verdict(found: list[PageRow]) -> str:
    """Whether the page is more than what two runs without it differ by."""
    again, opened = found[1], found[2:]
    if any(math.isnan(r.p99[1]) for r in opened):
        return "The page was not opened; there is nothing to compare."
    noise = max(again.p99[2], 1.0 / again.p99[0])
    told = f"runs without a page differ by up to a factor of {noise:.2f} in p99"
    apart = ", ".join(f"{r.run.name} {r.p99[1]:.2f}" for r in opened if r.p99[1] > noise)
    if apart:
        return f"The loop feels the page: {told}; {apart}."
    return f"The loop does not feel the page: {told}; with the page open it is no later than that."


def page_command(args: argparse.Namespace) -> Found:
    """The loop with the operator's page open and closed: how late its ticks are."""
    if args.turns < 1 or not 1.0 <= args.seconds <= 3600.0:
        raise ConfigError(
            f"--turns {args.turns} --seconds {args.seconds:g}: at least one turn of 1 s is needed"
        )
    total = args.turns * len(_WINDOWS)
    with tqdm(total=total, unit="run", disable=not sys.stderr.isatty()) as bar:
        found = beside_pages(args.seconds, args.turns, bar.update)
    table = terminal.table(list(PAGE_HEAD), page_rows(found))
    return f"{table}\n\n{page_verdict(found)}", {
        "runs": [terminal.json_value(asdict(r)) for r in found]
    }
