"""The operator's page as a person uses it, in Chromium: start, mark, a second tab, Escape."""

import json
import re
import shutil
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager

import pytest

from hil.record.container import read
from hil.record.mcap_read import load
from hil.ui.desk import SILENCE_S

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
sync = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine"),
    pytest.mark.real_time,
]


@contextmanager
def served(folder, *more):
    """The page's program and its address."""
    words = [sys.executable, "-m", "hil", "ui", "teleop", "--no-browser", "-o", str(folder), *more]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        yield process, re.search(r"http\S+", process.stdout.readline())[0]
    finally:
        process.terminate()
        process.wait(30)
        process.stdout.close()


@pytest.fixture
def address(tmp_path):
    with served(tmp_path) as (_, address):
        yield address


#: Pixels of a canvas that are greener than anything but the gel.
GREEN = """id => {
  const c = document.getElementById(id), d = c.getContext("2d").getImageData(0, 0, c.width,
    c.height).data;
  let n = 0;
  for (let k = 0; k < d.length; k += 4)
    if (d[k + 3] && d[k + 1] > d[k] + 8 && d[k + 1] > d[k + 2] + 3) n++;
  return n;
}"""


def test_a_person_starts_a_session_and_stops_it_by_the_key(address, tmp_path):
    problems, outside = [], []
    with sync.sync_playwright() as playwright:
        window = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        page = window.new_page(viewport={"width": 1200, "height": 900})
        page.set_default_timeout(60_000)
        page.on("pageerror", lambda e: problems.append(str(e)))
        page.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
        page.on("request", lambda r: outside.append(r.url) if "127.0.0.1" not in r.url else None)
        page.goto(address)
        page.locator("#take:enabled").click()
        page.locator("#begin:enabled").click()
        page.locator("#state", has_text="DISABLED").wait_for()
        # a second tab watches
        other = window.new_page()
        other.goto(address)
        other.locator("#next", has_text="this one watches").wait_for(timeout=60_000)
        assert other.get_by_role("button", name="Start").is_disabled()
        page.get_by_role("button", name="Start").click()
        page.locator("#state", has_text="ENABLED").wait_for()
        assert page.get_by_role("button", name="Start").is_disabled()
        # the emergency stop stays in the window
        page.evaluate("scrollTo(0, document.body.scrollHeight)")
        assert page.locator("#emergency").bounding_box()["y"] >= 0
        assert page.locator("#state").bounding_box()["y"] >= 0
        # lamps of the sensors' ranges, and the gel from both sides
        page.locator("#forces .lamp[data-level=good]", has_text="follower").wait_for()
        page.locator("#forces .lamp[data-level=good]", has_text="leader").wait_for()
        assert page.evaluate(GREEN, "space") > 500 and page.evaluate(GREEN, "above") > 5_000
        # the page that commands is loaded anew: it goes on commanding, and nothing pauses
        page.reload()
        page.locator("#state", has_text="ENABLED").wait_for()
        page.wait_for_timeout(1_000 * SILENCE_S + 1_000)
        assert page.locator("#state").inner_text() == "ENABLED"
        assert page.get_by_role("button", name="Take command").is_disabled()
        page.get_by_role("button", name="Mark").click()
        page.locator("#said", has_text="note mark").first.wait_for()
        page.get_by_role("button", name="Record off").click()
        page.locator("#recording", has_text="not recording").wait_for()
        page.get_by_role("button", name="Record on").click()
        page.locator("#recording", has_text=re.compile("^recording")).wait_for()
        page.locator("#devices li", has_text="leader-arm").get_by_text("ENABLED").wait_for()
        page.locator("#margin-text", has_text="No margin is computed").wait_for()
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            assert not [v["id"] for v in axe.Axe().run(page).response["violations"]]
        page.set_viewport_size({"width": 390, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        # the emergency stop is everybody's, by key as well
        other.bring_to_front()
        other.keyboard.press("Escape")
        page.locator("#state", has_text="ended (0)").wait_for()
        window.close()
    (session,) = tmp_path.glob("*.mcap")
    assert load(session, "follower").n > 100
    assert b"mark" in b"".join(read(session).topics["/events"].data)
    assert not problems and not outside


#: A slow network: delay of every answer [ms], bytes a second each way.
LATENCY, RATE = 400, 50_000
#: From the key to the program of the session having ended, and to the page saying so [s]: the
#: delay, the end of the loop and of its file, and the page's next question with the delay again.
ENDED, TOLD = 3.0, 5.0


@pytest.mark.slow
def test_on_a_slow_network_the_page_is_used_and_stopped(tmp_path):
    """State, start, marks and the emergency stop over a phone's bad connection."""
    problems, waiting, most = [], [], [0]

    def asked(request):
        waiting.append(request)
        most[0] = max(most[0], sum("/api/view" in r.url for r in waiting))

    with sync.sync_playwright() as playwright, served(tmp_path) as (_, address):
        window = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        page = window.new_page(viewport={"width": 390, "height": 800})
        page.set_default_timeout(60_000)
        page.on("pageerror", lambda e: problems.append(str(e)))
        page.on("request", asked)
        page.on("requestfinished", lambda r: waiting.remove(r))
        page.on("requestfailed", lambda r: problems.append(f"{r.url}: {r.failure}"))
        network = page.context.new_cdp_session(page)
        network.send("Network.enable")
        slow = {"latency": LATENCY, "downloadThroughput": RATE, "uploadThroughput": RATE}
        network.send("Network.emulateNetworkConditions", {"offline": False, **slow})
        page.goto(address)
        page.locator("#state", has_text="no session").wait_for(timeout=10_000)
        page.locator("#take:enabled").click()
        page.locator("#begin:enabled").click()
        page.locator("[data-say=start]:enabled").click()
        page.locator("#state", has_text="ENABLED").wait_for()
        page.locator("#health", has_text="slow network").wait_for()
        # its heartbeat is heard: nothing pauses; and it keeps up with the session
        for _ in range(5):
            page.get_by_role("button", name="Mark").click()
        page.wait_for_timeout(1_000 * SILENCE_S + 4_000)
        assert page.locator("#state").inner_text() == "ENABLED"
        token = address.partition("?token=")[2]
        direct = urllib.request.Request(
            address.partition("?")[0] + "api/view?page=page-that-watches",
            headers={"X-Hil-Token": token},
        )

        def now():
            with urllib.request.urlopen(direct, timeout=10) as reply:
                return json.load(reply)

        behind = now()["session"]["seconds"] - float(
            re.search(r"([\d.]+) s, tick", page.locator("#health").inner_text())[1]
        )
        assert behind < 2.0, f"the page shows what was {behind:.1f} s ago"
        # one question at a time, and no command left over
        assert most[0] == 1 and len(waiting) <= 1
        assert sum(line == "note mark" for line in now()["log"]) == 5
        # a person presses the key more than once
        since = time.monotonic()
        for _ in range(4):
            page.keyboard.press("Escape")
        while now()["running"]:
            assert time.monotonic() - since < ENDED, "the emergency stop takes too long"
            page.wait_for_timeout(50)
        left = TOLD - (time.monotonic() - since)
        page.locator("#state", has_text="ended (0)").wait_for(timeout=1_000 * left)
        assert sum(line == "stop" for line in now()["log"]) == 1
        window.close()
    assert not problems
    (session,) = tmp_path.glob("*.mcap")
    assert not read(session).truncated and load(session, "follower").n > 100


@pytest.mark.slow
def test_what_a_page_does_not_know_it_does_not_show(tmp_path):
    """A program that is ended ends its session; its page says so, also beside a new one."""
    with sync.sync_playwright() as playwright:
        window = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        page = window.new_page()
        page.set_default_timeout(60_000)
        problems = []
        page.on("pageerror", lambda e: problems.append(str(e)))
        with served(tmp_path) as (process, address):
            page.goto(address)
            page.locator("#take:enabled").click()
            page.locator("#begin:enabled").click()
            page.locator("#state", has_text="DISABLED").wait_for()
            assert page.locator("#joint option").all_inner_texts() == ["joint1", "joint2", "joint3"]
            assert page.locator("#value").input_value() == "8 8 4"  # what is in force
            page.locator("#health", has_text="left on the disk").wait_for()
            # an emergency stop that the network keeps back arrives when it is there again
            page.context.set_offline(True)
            page.locator("#state", has_text="unknown").wait_for()
            page.keyboard.press("Escape")
            page.locator("#next", has_text="in the power line").wait_for()
            page.wait_for_timeout(2_500)  # and the command is free
            page.context.set_offline(False)
            page.locator("#state", has_text="ended (0)").wait_for()
            page.locator("#take:enabled").click()
            page.locator("#begin:enabled").click()
            page.locator("#next", has_text="clear of the arms").wait_for()
            process.terminate()
            process.wait(30)
            assert process.returncode == 143
            page.locator("#state", has_text="unknown").wait_for()
            assert page.locator("main button:enabled").all_inner_texts() == ["Clear the trail"]
        sessions = sorted(tmp_path.glob("*.mcap"))
        assert [read(path).truncated for path in sessions] == [False, False]
        port = re.search(r":(\d+)/", address)[1]
        with served(tmp_path, "--port", port):
            page.locator("#next", has_text="that the new one printed").wait_for()
        window.close()
    assert not problems


def test_on_another_address_a_person_needs_the_token(tmp_path):
    """Without, with a wrong and a guessed token, from another site, in a frame, by another name."""
    problems = []
    with (
        sync.sync_playwright() as playwright,
        served(tmp_path, "--host", "0.0.0.0") as (program, _),
    ):
        told = program.stdout.readline()
        there = re.search(r"http\S+", told)
        if there is None:
            pytest.skip("this machine has no address but its own")
        base, _, token = there[0].partition("?token=")
        number = re.search(r"//(.+):\d+/", base)[1]
        rules = f"--host-resolver-rules=MAP evil.example {number}"
        flags = ["--no-sandbox", rules]
        window = playwright.chromium.launch(executable_path=BROWSER, args=flags)
        page = window.new_page()
        page.set_default_timeout(60_000)
        guess = token[:-1] + ("A" if token[-1] != "A" else "B")
        for wrong in ("", "?token=", "?token=wrong", f"?token={guess}"):
            reply = page.goto(base + wrong)
            assert reply.status == 403 and "Emergency" not in page.content()
        assert page.goto(there[0].replace(number, "evil.example")).status == 400
        page.goto("data:text/html,<p>elsewhere</p>")
        asked = page.evaluate(
            """async (url) => {
              const body = JSON.stringify({ page: "page-of-evil", number: 1, text: "stop" });
              try { return (await fetch(url, { method: "POST", mode: "no-cors", body })).type; }
              catch (e) { return "refused"; }
            }""",
            f"{base}api/command",
        )
        assert asked in ("opaque", "refused")  # and it is a 403 that nobody can read
        with_token = "url => fetch(url, { headers: { 'X-Hil-Token': 'x' } }).then(() => 1, () => 0)"
        assert page.evaluate(with_token, f"{base}api/view?page=page-of-evil") == 0
        page.goto(f"data:text/html,<iframe src='{there[0]}'></iframe>")
        page.wait_for_timeout(500)
        assert page.frames[1].url.startswith("chrome-error:")
        page.on("pageerror", lambda e: problems.append(str(e)))
        page.goto(there[0])
        page.locator("#take:enabled").click()
        page.locator("#begin:enabled").wait_for()
        window.close()
    assert not problems and not list(tmp_path.glob("*.mcap"))
