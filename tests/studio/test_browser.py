"""The studio as a person uses it, in Chromium: a table picked column by column, an own effect."""

import os
import re
import shutil
import subprocess
import sys

import numpy as np
import plants
import pytest

from hil.studio.intake import TEMPLATE

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
sync = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where a lab keeps its tables."""
    folder = tmp_path_factory.mktemp("lab")
    for name, seed in (("monday.csv", 1), ("tuesday.csv", 2)):
        r = plants.stribeck_axis(seed)
        columns = np.column_stack([r.t * 1e3, np.degrees(r.q), r.tau * 500, np.arange(r.n)])
        head = "time [ms];Encoder angle (deg);drive mA;loop count"
        np.savetxt(folder / name, columns, "%.9g", ";", header=head, comments="")
    return folder


@pytest.fixture
def page(folder):
    """A page of a studio that was opened with nothing; what went wrong in it is an error."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "HIL_STATE": str(folder / "state"),
    }
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", "studio", "--no-browser"],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment,
    )  # fmt: skip
    problems = []
    with sync.sync_playwright() as playwright:
        window = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        page = window.new_page(viewport={"width": 1200, "height": 1000})
        page.set_default_timeout(60_000)
        page.on("pageerror", lambda e: problems.append(str(e)))
        page.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
        outside = []
        page.on("request", lambda r: outside.append(r.url) if "127.0.0.1" not in r.url else None)
        page.goto(re.search(r"http\S+", process.stdout.readline())[0])
        yield page
        window.close()
    process.terminate()
    process.wait(20)
    process.stdout.close()
    assert not problems and not outside


def accessible(page):
    """No violation that axe knows."""
    found = axe.Axe().run(page).response["violations"]
    assert not [(v["id"], [n["target"] for n in v["nodes"]]) for v in found]


def bring(page, name):
    """Pick the columns of the table that is open, and bring it in."""
    page.locator("#table-name", has_text=name).wait_for()
    assert page.get_by_label("time [ms] is", exact=True).input_value() == "t"
    accessible(page)
    page.get_by_label("drive mA is", exact=True).select_option("tau")
    page.get_by_label("unit of drive mA").select_option("mA")
    if not page.get_by_label("Effort at the joint by ampere").input_value():
        page.get_by_role("button", name="Check the recording").click()
        page.locator("#said", has_text="give the effort by ampere").wait_for()
    page.get_by_label("Effort at the joint by ampere").fill("2.0")
    page.get_by_role("button", name="Check the recording").click()
    page.locator("#found-text", has_text="samples at").wait_for()
    assert "Not used: loop count" in page.locator("#found-faults").inner_text()
    page.get_by_role("button", name="Bring it in").click()


def test_a_table_is_picked_and_an_own_effect_ranked_and_the_model_exported(page, folder):
    page.get_by_role("heading", name="Begin with a recording").wait_for()
    page.locator("#file-first").set_input_files(folder / "monday.csv")
    bring(page, "monday.csv")
    page.locator("#ladder .rung").nth(1).wait_for()
    assert "monday.mcap" in page.locator("#sessions").inner_text()
    assert "hil import monday.csv" in page.locator("#commands").inner_text()
    # a second table, to judge on
    page.locator("#file").set_input_files(folder / "tuesday.csv")
    page.locator("#use").select_option("holdout")
    bring(page, "tuesday.csv")
    page.locator("#sessions", has_text="judged on tuesday.mcap").wait_for()
    page.get_by_text("An effect of your own").click()
    page.locator("#own-text").fill(TEMPLATE)
    page.get_by_role("button", name="Check and rank").click()
    page.locator("#status.error", has_text="agree to it").wait_for()
    page.get_by_label("I have read this text").check()
    page.get_by_role("button", name="Check and rank").click()
    page.locator("#candidates tr", has_text="eyelet-drag").get_by_text("yours").wait_for()
    page.get_by_role("button", name=re.compile("Add stribeck")).click()
    page.locator("#ladder .rung.now", has_text="+ stribeck").wait_for()
    page.locator("#said", has_text="Ready.").wait_for()
    # laws side by side keep their shape, and show the part that is dragged over
    page.get_by_role("button", name=re.compile("Add eyelet-drag")).click()
    page.locator("#ladder .rung.now", has_text="+ eyelet-drag").wait_for()
    page.locator("#said", has_text="Ready.").wait_for()
    sizes = page.locator("#learnt canvas").evaluate_all(
        "all => all.map(c => c.width - c.clientWidth * window.devicePixelRatio)"
    )
    assert len(sizes) == 2 and all(abs(x) <= 1 for x in sizes)
    picture = page.locator("#learnt canvas").first.evaluate("c => c.toDataURL()")
    page.locator("#residual").focus()
    page.keyboard.press("ArrowRight")
    told = page.locator("#brushed").inner_text()
    assert re.search(r"error [\d.e-]+ N m, [\d.]+ times the floor", told)
    assert page.locator("#learnt canvas").first.evaluate("c => c.toDataURL()") != picture
    page.get_by_role("button", name="Whole recording").click()
    assert page.locator("#learnt canvas").first.evaluate("c => c.toDataURL()") == picture
    page.locator("#beside").select_option(label="base model")
    page.locator("#key-beside", has_text="base model").wait_for()
    page.locator("#said", has_text="Ready.").wait_for()
    page.locator("#kind").select_option("c")
    page.get_by_role("button", name="Export").click()
    page.locator("#said", has_text="written").wait_for()
    assert (folder / "robot-c.h").stat().st_size > 500
    page.screenshot(path=str(folder / "studio.png"), full_page=True)
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        accessible(page)
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
