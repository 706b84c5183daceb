"""Pictures of the real pages: python docs/pictures.py [--only SCENARIO] [--all FOLDER]

Records a session with a hidden effect, opens report, studio and operator's page in Chromium, does
what a person would, and writes the pictures that the documentation shows, each with few colours.
With --all, every moment wide and narrow, light and dark, whole, into a folder, to be looked at.
Needs playwright, Pillow and Chromium (pip install 'hil-teleop[test,ui]' pillow).
"""

import argparse
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from hil.record.mcap_read import load

DOCS = Path(__file__).parent
#: Largest picture of the documentation, and all of them [bytes].
LARGEST, ALL = 60_000, 600_000
#: Colours of a picture: the most frequent ones as they are, the others as the nearest of those.
COLOURS = 128
WIDE, NARROW = {"width": 1180, "height": 860}, {"width": 400, "height": 860}
LOW = {"width": 1180, "height": 440}
#: Files of the documentation, each a moment of a scenario: size of the window, colours.
PICTURES = {
    "ladder.png": ({"width": 1060, "height": 1010}, "light"),
    "studio.png": (WIDE, "light"),
    "studio-add.png": ({"width": 1180, "height": 650}, "light"),
    "studio-import.png": ({"width": 1180, "height": 960}, "light"),
    "operator.png": ({"width": 1180, "height": 1205}, "light"),
    "operator-narrow.png": (NARROW, "dark"),
    "operator-reload.png": (LOW, "light"),
    "operator-watches.png": (LOW, "light"),
    "operator-stopped.png": (LOW, "light"),
    "operator-slow.png": (LOW, "light"),
    "operator-gone.png": (LOW, "light"),
    "operator-back.png": (LOW, "light"),
}
#: A bad connection: delay of an answer [ms], bytes a second.
SLOW = {"latency": 400, "downloadThroughput": 50_000, "uploadThroughput": 50_000}
HIDDEN = """

[[simulation.hidden]]
effect = "stribeck"
arm = "follower"
joint = "joint2"
"""


def hil(*words: str) -> None:
    """Run a command of the program in this folder."""
    subprocess.run([sys.executable, "-m", "hil", "--quiet", *words], check=True, stdout=sys.stderr)


@contextmanager
def served(*words: str) -> Iterator[tuple[subprocess.Popen, str]]:
    """A page of the program and its address; it ends with the block."""
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", *words, "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        found = re.search(r"http\S+", process.stdout.readline())
        if found is None:
            sys.exit(f"hil {words[0]} did not begin; run it by hand to see why")
        yield process, found[0]
    finally:
        process.terminate()
        process.wait(30)
        process.stdout.close()


def opened(window: Browser) -> Page:
    """An empty tab."""
    page = window.new_page(viewport=WIDE)
    page.set_default_timeout(60_000)
    return page


#: A moment of a scenario: what is to be seen, and the file that shows it.
Moments = Iterator[tuple[Page, str]]


def report(window: Browser) -> Moments:
    """The report of a diagnosis."""
    page = opened(window)
    page.goto(Path("why.html").resolve().as_uri())
    yield page, "ladder.png"


def studio(window: Browser) -> Moments:
    """An effect added by hand; then a diagnosis, and its model taken."""
    words = ("studio", "fit.mcap", "--holdout", "test.mcap", "--arm", "follower")
    page = opened(window)
    with served(*words) as (_, address):
        page.goto(address)
        page.get_by_role("button", name=re.compile("Add stribeck")).first.click()
        page.locator("#ladder .rung.now", has_text="+ stribeck").wait_for()
        page.locator("#said", has_text="Ready.").wait_for()
        page.evaluate("scrollTo(0, 0)")
        yield page, "studio-add.png"
        page.get_by_role("button", name="Undo").click()
        page.locator("#said", has_text="Ready.").wait_for()
        page.get_by_role("button", name="Diagnose").click()
        page.locator("#verdict").wait_for()
        page.get_by_role("button", name="Take the recommended model").click()
        page.locator("#ladder .rung.now", has_text="diagnosis: stribeck").wait_for()
        page.locator("#said", has_text="Ready.").wait_for()
        page.evaluate("scrollTo(0, 0)")
        yield page, "studio.png"


def table(window: Browser) -> Moments:
    """A table with the names and units of a lab, its columns picked."""
    page = opened(window)
    with served("studio") as (_, address):
        page.goto(address)
        page.get_by_role("heading", name="Begin with a recording").wait_for()
        page.locator("#file-first").set_input_files("monday.csv")
        page.locator("#table-name", has_text="monday.csv").wait_for()
        for k in range(1, 4):
            page.get_by_label(f"drive {k} mA is", exact=True).select_option("tau")
            page.get_by_label(f"joint of drive {k} mA").select_option(str(k))
            page.get_by_label(f"unit of drive {k} mA").select_option("mA")
            page.get_by_label(f"Encoder {k} (deg) is", exact=True).select_option("q")
            page.get_by_label(f"joint of Encoder {k} (deg)").select_option(str(k))
        page.locator("#missing").select_option("interpolate")
        page.locator("#constant").fill("2.0")
        page.get_by_role("button", name="Check the recording").click()
        page.locator("#found-text", has_text="samples at").wait_for()
        page.evaluate("scrollTo(0, 0)")
        yield page, "studio-import.png"


def begun(page: Page, address: str, seconds: float) -> None:
    """A session that has run so long."""
    page.goto(address)
    page.locator("#take:enabled").click()
    page.locator("#begin:enabled").click()
    page.locator("[data-say=start]:enabled").click()
    page.locator("#state", has_text="ENABLED").wait_for()
    page.wait_for_timeout(1_000 * seconds)


def operator(window: Browser) -> Moments:
    """From the start to the emergency stop, loaded anew and beside a second tab."""
    page = opened(window)
    with served("ui", "teleop", "-o", ".") as (_, address):
        begun(page, address, 9.0)
        yield page, "operator.png"
        yield page, "operator-narrow.png"
        page.reload()
        page.locator("#state", has_text="ENABLED").wait_for()
        page.wait_for_timeout(4_000)
        yield page, "operator-reload.png"
        other = opened(window)
        other.goto(address)
        other.locator("#state", has_text="ENABLED").wait_for()
        yield other, "operator-watches.png"
        other.close()
        page.keyboard.press("Escape")
        page.locator("#state", has_text="ended (0)").wait_for()
        yield page, "operator-stopped.png"


def network(window: Browser) -> Moments:
    """A slow network; then the program is gone, and another one in its place."""
    page = opened(window)
    wire = page.context.new_cdp_session(page)
    wire.send("Network.enable")
    wire.send("Network.emulateNetworkConditions", {"offline": False, **SLOW})
    with served("ui", "teleop", "-o", ".") as (process, address):
        begun(page, address, 5.0)
        page.set_viewport_size(LOW)
        page.evaluate("scrollTo(0, document.body.scrollHeight)")
        yield page, "operator-slow.png"
        page.evaluate("scrollTo(0, 0)")
        process.terminate()
        process.wait(30)
        page.locator("#state", has_text="unknown").wait_for()
        yield page, "operator-gone.png"
    port = re.search(r":(\d+)/", address)[1]
    with served("ui", "teleop", "-o", ".", "--port", port):
        page.locator("#next", has_text="that the new one printed").wait_for()
        yield page, "operator-back.png"


SCENARIOS = {
    "report": report,
    "studio": studio,
    "table": table,
    "operator": operator,
    "network": network,
}


def prepare() -> None:
    """Sessions and report, in this folder."""
    hil("init", "identify", "-o", "rig.toml")
    rig = Path("rig.toml")
    rig.write_text(rig.read_text() + HIDDEN)
    for name, seed in (("fit.mcap", "1"), ("test.mcap", "2")):
        hil("run", "rig.toml", "--seconds", "12", "--seed", seed, "-o", name)
    run = load(Path("fit.mcap"), "follower")
    columns = [run.t * 1e3, np.degrees(run.q), run.tau * 500, np.arange(run.n)]
    values = np.column_stack(columns)
    values[1000:1004, 5] = np.nan
    angles = [f"Encoder {k} (deg)" for k in (1, 2, 3)]
    drives = [f"drive {k} mA" for k in (1, 2, 3)]
    head = ";".join(["time [ms]", *angles, *drives, "loop count"])
    np.savetxt("monday.csv", values, "%.9g", ";", header=head, comments="")
    sessions = ["fit.mcap", "--arm", "follower", "--holdout", "test.mcap"]
    hil("diagnose", *sessions, "--report", "why.html")


def take(page: Page, path: Path, size: dict[str, int], scheme: str, whole: bool) -> None:
    """One picture of the page as it is."""
    page.set_viewport_size(size)
    page.emulate_media(color_scheme=scheme)
    page.wait_for_timeout(600)
    taken = Image.open(io.BytesIO(page.screenshot(full_page=whole))).convert("RGB")
    colours, which, count = np.unique(
        np.asarray(taken).reshape(-1, 3), axis=0, return_inverse=True, return_counts=True
    )
    often = colours[np.argsort(-count)[:COLOURS]].astype(int)
    apart = ((colours[:, None].astype(int) - often) ** 2).sum(2)
    few = Image.fromarray(apart.argmin(1)[which].reshape(taken.height, -1).astype(np.uint8), "P")
    few.putpalette(often.astype(np.uint8).tobytes())
    few.save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    """Make the pictures."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--all", metavar="FOLDER", type=Path, help="every moment in every form")
    options.add_argument("--only", choices=SCENARIOS, action="append", help="these (repeatable)")
    args = options.parse_args()
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("no Chromium on this machine; install it first")
    folder = args.all.resolve() if args.all else DOCS
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        os.chdir(place)
        if not args.only or {"report", "studio", "table"} & set(args.only):
            prepare()
        for name in args.only or SCENARIOS:
            window = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
            for page, file in SCENARIOS[name](window):
                if not args.all:
                    take(page, folder / file, *PICTURES[file], whole=False)
                    continue
                for form, size in (("wide", WIDE), ("narrow", NARROW)):
                    for colours in ("light", "dark"):
                        path = folder / f"{Path(file).stem}-{form}-{colours}.png"
                        take(page, path, size, colours, whole=True)
            window.close()
        os.chdir(DOCS)
    sizes = {file: (DOCS / file).stat().st_size for file in PICTURES if (DOCS / file).exists()}
    large = [file for file, size in sizes.items() if size > LARGEST]
    if large and not args.all:
        sys.exit(f"larger than {LARGEST / 1e3:.0f} kB: {', '.join(large)}")
    if sum(sizes.values()) > ALL and not args.all:
        sys.exit(f"all pictures together are larger than {ALL / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
