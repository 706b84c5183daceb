"""The loop with the operator's page closed, open, and open in two windows, in turns."""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from hil import terminal
from hil.bench import loop
from hil.errors import ConfigError, DeviceError
from hil.record.mcap_read import read_metadata
from hil.terminal import Found

_CLOSED = "no page"
#: Windows of the browser that a run has, by its name; the first is the reference, the second the
#: same once more: how far two runs differ that differ in nothing.
WINDOWS = {_CLOSED: 0, "no page, once more": 0, "page open": 1, "page open in two windows": 2}
#: What the page needs of the machine, and how long it may take to begin [s].
_NEEDS = "needs playwright (hil-teleop[test]) and Chromium"
_BEGIN_S = 60.0


def beside_page(seconds: float, windows: int) -> loop.LoopRun:
    """The teleoperation rig in real time: alone, or with the operator's page in a browser.

    Parameters
    ----------
    seconds : float
        Length [s].
    windows : int
        How many windows show the page; one of them commands.
    """
    name = list(WINDOWS)[[*WINDOWS.values()].index(windows)]
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if windows and (importlib.util.find_spec("playwright") is None or browser is None):
        return loop.LoopRun(name, 0, 0, *(math.nan,) * 4, note=_NEEDS)
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
    return loop.LoopRun(name, int(f["ticks"]), int(f["missed"]), *late, note=note)


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
    run : loop.LoopRun
        Median of the turns.
    p50, p99, p999 : tuple of float
        Ratio to *no page* of the same turn: lowest, loop.median, highest.
    """

    run: loop.LoopRun
    p50: tuple[float, float, float]
    p99: tuple[float, float, float]
    p999: tuple[float, float, float]


def beside_pages(
    seconds: float, turns: int, done: Callable[[], object] = lambda: None
) -> list[PageRow]:
    """All runs of `WINDOWS`, in turns."""
    found: dict[str, list[loop.LoopRun]] = {name: [] for name in WINDOWS}
    for _ in range(turns):
        for name, windows in WINDOWS.items():
            found[name].append(replace(beside_page(seconds, windows), name=name))
            done()
    return [page_row(same, found[_CLOSED]) for same in found.values()]


def page_row(same: list[loop.LoopRun], closed: list[loop.LoopRun]) -> PageRow:
    """Figures of the turns of one run, and their ratios to those without a page."""

    def ratio(name: str) -> tuple[float, float, float]:
        pairs = zip(same, closed, strict=True)
        r = [getattr(a, name) / max(getattr(b, name), 0.1) for a, b in pairs]
        return min(r), float(np.median(r)), max(r)

    return PageRow(loop.median(same), ratio("p50"), ratio("p99"), ratio("p999"))


PAGE_HEAD = (*loop.HEAD[:-2], "p50 ratio", "p99 ratio", "p99.9 ratio", "")


def page_rows(found: list[PageRow]) -> list[list[str]]:
    """Cells of the table."""
    out = []
    for row, cells in zip(found, loop.rows([r.run for r in found]), strict=True):
        ratios = ("-" if math.isnan(r[1]) else f"{r[1]:.2f} ({r[0]:.2f}-{r[2]:.2f})"
                  for r in (row.p50, row.p99, row.p999))  # fmt: skip
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


def command(args: argparse.Namespace) -> Found:
    """The loop with the operator's page open and closed: how late its ticks are."""
    if args.turns < 1 or not 1.0 <= args.seconds <= 3600.0:
        raise ConfigError(
            f"--turns {args.turns} --seconds {args.seconds:g}: at least one turn of 1 s is needed"
        )
    total = args.turns * len(WINDOWS)
    with tqdm(total=total, unit="run", disable=not sys.stderr.isatty()) as bar:
        found = beside_pages(args.seconds, args.turns, bar.update)
    table = terminal.table(list(PAGE_HEAD), page_rows(found))
    return f"{table}\n\n{page_verdict(found)}", {
        "runs": [terminal.finite(asdict(r)) for r in found]
    }
