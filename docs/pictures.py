"""Pictures of the real pages: python docs/pictures.py [--all FOLDER]

Records a session with a hidden effect, opens report, studio and operator's page in Chromium, and
writes the pictures that the documentation shows.  With --all, every page wide and narrow, light and
dark, into a folder, to be looked at.  Needs playwright and Chromium (hil-teleop[test,ui]).
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

DOCS = Path(__file__).parent
#: Largest picture of the documentation [bytes].
LARGEST = 150_000
WIDE, NARROW = {"width": 1180, "height": 860}, {"width": 400, "height": 860}
#: Files of the documentation: page, size of the window, colours.
PICTURES = {
    "ladder.png": ("report", {"width": 1060, "height": 1010}, "light"),
    "studio.png": ("studio", WIDE, "light"),
    "operator.png": ("operator", {"width": 1180, "height": 1230}, "light"),
    "operator-narrow.png": ("operator", NARROW, "dark"),
}
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
def served(*words: str):
    """Address of a page of the program, which ends with the block."""
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
        yield found[0]
    finally:
        process.terminate()
        process.wait(30)
        process.stdout.close()


@contextmanager
def report(page: Page):
    """The report of a diagnosis."""
    page.goto(Path("why.html").resolve().as_uri())
    yield


@contextmanager
def studio(page: Page):
    """The studio with a diagnosis, and its model taken."""
    with served("studio", "fit.mcap", "--holdout", "test.mcap", "--arm", "follower") as address:
        page.goto(address)
        page.locator("#candidates tbody tr").first.wait_for()
        page.get_by_role("button", name="Diagnose").click()
        page.locator("#verdict").wait_for()
        page.get_by_role("button", name="Take the recommended model").click()
        page.locator("#ladder .rung.now", has_text="stribeck").wait_for()
        page.locator("#said", has_text="Ready.").wait_for()
        yield


@contextmanager
def operator(page: Page):
    """The operator's page while the rig works."""
    with served("ui", "teleop", "-o", ".") as address:
        page.goto(address)
        page.locator("#take:enabled").click()
        page.locator("#begin:enabled").click()
        page.locator("[data-say=start]:enabled").click()
        page.locator("#state", has_text="ENABLED").wait_for()
        page.wait_for_timeout(9_000)
        yield


PAGES = {"report": report, "studio": studio, "operator": operator}


def prepare() -> None:
    """Sessions and report, in this folder."""
    hil("init", "identify", "-o", "rig.toml")
    rig = Path("rig.toml")
    rig.write_text(rig.read_text() + HIDDEN)
    for name, seed in (("fit.mcap", "1"), ("test.mcap", "2")):
        hil("run", "rig.toml", "--seconds", "12", "--seed", seed, "-o", name)
    sessions = ["fit.mcap", "--arm", "follower", "--holdout", "test.mcap"]
    hil("diagnose", *sessions, "--report", "why.html")


def take(page: Page, path: Path, size: dict[str, int], colours: str, whole: bool) -> None:
    """One picture of the page as it is."""
    page.set_viewport_size(size)
    page.emulate_media(color_scheme=colours)
    page.wait_for_timeout(600)
    page.screenshot(path=path, full_page=whole)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    """Make the pictures."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--all", metavar="FOLDER", type=Path, help="every page in every form")
    options.add_argument("--only", choices=PAGES, action="append", help="these pages (repeatable)")
    args = options.parse_args()
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("no Chromium on this machine; install it first")
    folder = args.all.resolve() if args.all else DOCS
    folder.mkdir(exist_ok=True)
    sizes = {"wide": WIDE, "narrow": NARROW}
    every = {
        f"{name}-{wide}-{colours}.png": (name, size, colours)
        for name in PAGES
        for wide, size in sizes.items()
        for colours in ("light", "dark")
    }
    todo = every if args.all else PICTURES
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        os.chdir(place)
        prepare()
        window = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        for name, opened in PAGES.items():
            wanted = {f: row for f, row in todo.items() if row[0] == name}
            if not wanted or (args.only and name not in args.only):
                continue
            page = window.new_page(viewport=WIDE)
            page.set_default_timeout(120_000)
            with opened(page):
                for file, (_, size, colours) in wanted.items():
                    take(page, folder / file, size, colours, bool(args.all))
            page.close()
        window.close()
        os.chdir(DOCS)
    large = [f for f in PICTURES if not args.all and (DOCS / f).stat().st_size > LARGEST]
    if large:
        sys.exit(f"larger than {LARGEST / 1e3:.0f} kB: {', '.join(large)}")


if __name__ == "__main__":
    main()
