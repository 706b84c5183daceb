"""The studio's pages: only for who has the token, nothing from outside, and as a person uses it."""

import asyncio
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import plants
import pytest

from hil.commands.studio import studio_application
from hil.errors import ConfigError
from hil.record.export import write_recordings
from hil.web.site import LARGEST_REQUEST, POLICY, Hosts

TestClient = pytest.importorskip("starlette.testclient").TestClient
TOKEN = "secret"


class Worker:
    """What the server needs of a worker."""

    def __init__(self):
        self.asked, self.state = [], {"at": 0}

    def ask(self, verb, given):
        if verb != "undo":
            raise ConfigError(f"no request {verb!r}")
        self.asked.append((verb, given))
        return len(self.asked)

    def status(self):
        return {"running": "", "error": ""}

    def cancel(self):
        self.asked.append(("cancel", {}))


@pytest.fixture
def page():
    worker = Worker()
    app = studio_application(worker, TOKEN, Hosts("testserver"))
    return TestClient(app), worker


def test_the_page_is_for_who_has_the_address(page):
    client, _ = page
    assert client.get("/").status_code == 403
    assert client.get("/?token=wrong").status_code == 403
    found = client.get(f"/?token={TOKEN}")
    assert found.status_code == 200 and "<h1>hil studio</h1>" in found.text
    assert found.headers["content-security-policy"] == POLICY
    for reply, status in ((client.get("/nothing"), 404), (client.put("/api/ask"), 405)):
        assert reply.status_code == status
        assert reply.headers["content-security-policy"] == POLICY
    assert found.headers["referrer-policy"] == "no-referrer"


def test_nothing_is_loaded_from_outside(page):
    client, _ = page
    for name in (
        "studio.js",
        "page.js",
        "intake.js",
        "studio.css",
        "plot.js",
        "base.css",
        "icon.svg",
    ):
        found = client.get(f"/static/{name}")
        assert found.status_code == 200
        outside = re.findall(r"https?://[^\s\"')]+", found.text)
        assert set(outside) <= {"http://www.w3.org/2000/svg"}
    assert "'unsafe" not in POLICY and "http" not in POLICY
    for name in ("index.html", "../server.py", "%2e%2e/server.py", "x.js"):
        assert client.get(f"/static/{name}").status_code in (403, 404)


def test_requests_of_others_are_refused(page):
    client, worker = page
    head = {"X-Hil-Token": TOKEN}
    for given in ({}, {"X-Hil-Token": "guess"}, {"X-Hil-Token": ""}):
        assert client.post("/api/ask", json={"verb": "undo"}, headers=given).status_code == 403
        assert client.get("/api/state", headers=given).status_code == 403
    assert client.get("/api/state", headers=head | {"Host": "evil.example"}).status_code == 400
    assert not worker.asked
    assert client.post("/api/ask", json={"verb": "undo"}, headers=head).json() == {"number": 1}
    assert client.get("/api/state", headers=head).json() == {"at": 0}
    client.post("/api/cancel", json={}, headers=head)
    assert worker.asked == [("undo", {}), ("cancel", {})]


@pytest.mark.parametrize(
    ("body", "status"),
    [(b"", 400), (b"[1]", 400), (b"{", 400), (b'{"verb": 3}', 400), (b"\xff", 400),
     (b'{"verb": "kill"}', 400), (b"[" * 60_000, 400), (b'{"verb": "\\ud800"}', 400),
     (b'{"verb": "undo", "at": "\\udfff"}', 400), (b"x" * (LARGEST_REQUEST + 1), 413)],
)  # fmt: skip
def test_what_is_no_request_is_said(page, body, status):
    client, worker = page
    found = client.post("/api/ask", content=body, headers={"X-Hil-Token": TOKEN})
    assert found.status_code == status and found.json()["error"]
    assert not worker.asked


@pytest.mark.parametrize("place", ["/api/ask", "/api/file"])
def test_a_browser_that_leaves_within_a_request_leaves_no_trace(place, tmp_path):
    worker, sent = Worker(), []
    app = studio_application(worker, TOKEN, Hosts("testserver"), tmp_path)
    parts = [{"type": "http.request", "body": b"{", "more_body": True}, {"type": "http.disconnect"}]

    async def receive():
        return parts.pop(0)

    async def send(message):
        sent.append(message)

    head = [(b"host", b"testserver"), (b"x-hil-token", TOKEN.encode())]
    scope = {"type": "http", "method": "POST", "path": place, "query_string": b"name=run.csv"}
    scope |= {"headers": head, "http_version": "1.1", "scheme": "http", "root_path": ""}
    asyncio.run(app(scope, receive, send))
    assert sent[0]["status"] == 400 and not worker.asked
    assert not [p for p in tmp_path.iterdir() if p.name == "run.csv"]


@pytest.fixture
def drop(tmp_path):
    client = TestClient(studio_application(Worker(), TOKEN, Hosts("testserver"), tmp_path))

    def send(name, content, token=TOKEN):
        head = {"X-Hil-Token": token}
        return client.post("/api/file", params={"name": name}, content=content, headers=head)

    return send, tmp_path


def test_a_file_that_is_dropped_is_kept_and_none_is_written_over(drop):
    send, folder = drop
    assert send("run.csv", b"t,q1").json() == {"path": "run.csv"}
    assert send("run.csv", b"t,q1").json() == {"path": "run.csv"}
    refused = send("run.csv", b"other")
    assert refused.status_code == 400 and "another file run.csv" in refused.json()["error"]
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == {"run.csv": b"t,q1"}


@pytest.mark.parametrize(
    "name", ["", ".bashrc", "../up.csv", "a/b.csv", "a\\b.csv", "a\0b", "x" * 300]
)
def test_a_name_that_leads_elsewhere_is_refused(drop, name):
    send, folder = drop
    assert send(name, b"x").status_code == 400
    assert not list(folder.iterdir()) and not (folder.parent / "up.csv").exists()


def test_a_file_of_others_is_refused(drop, monkeypatch):
    send, folder = drop
    assert send("run.csv", b"x", "guess").status_code == 403
    monkeypatch.setattr("hil.web.site.LARGEST_FILE", 10)
    assert "larger than" in send("run.csv", b"x" * 11).json()["error"]
    assert not list(folder.iterdir())


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """A studio of its own process on a small session; its address."""
    folder = tmp_path_factory.mktemp("studio")
    for name, seed in (("a.mcap", 1), ("b.mcap", 2)):
        write_recordings(folder / name, [plants.stribeck_axis(seed)])
    words = [sys.executable, "-m", "hil", "studio", "a.mcap", "--holdout", "b.mcap"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen(
        [*words, "--no-browser"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=environment,
    )
    line = process.stdout.readline()
    yield re.search(r"http\S+", line)[0], folder
    process.terminate()
    process.wait(20)
    process.stdout.close()


def test_a_person_adds_an_effect_and_sees_the_ladder_fall(studio):
    sync = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium on this machine")
    address, folder = studio
    problems = []
    with sync.sync_playwright() as playwright:
        window = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = window.new_page(viewport={"width": 1200, "height": 900})
        page.on("pageerror", lambda e: problems.append(str(e)))
        page.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
        page.goto(address)
        said = page.locator("#said")
        ready = page.locator("#said", has_text="Ready.")
        ready.wait_for(timeout=60_000)
        assert page.locator("#ladder .rung").count() == 2
        # by keyboard alone
        page.get_by_role("button", name=re.compile("Add stribeck")).focus()
        page.keyboard.press("Enter")
        page.locator("#ladder .rung.now", has_text="+ stribeck").wait_for(timeout=60_000)
        assert page.locator("#ladder .rung.now .bar.met").count() == 1
        ready.wait_for(timeout=60_000)  # the ladder falls before the rest is there
        assert page.get_by_role("heading", name="Learnt effects over the data").is_visible()
        # a part of the recording, by keyboard
        ready.wait_for()
        page.locator("#residual").focus()
        page.keyboard.press("ArrowRight")
        assert " s" in page.locator("#brushed").inner_text()
        page.locator("#path").fill("found.toml")
        page.get_by_role("button", name="Save").click()
        page.locator("#said", has_text="written").wait_for(timeout=60_000)
        assert Path(folder / "found.toml").read_text().startswith("schema")
        # a narrow window has no sideways scrolling
        page.set_viewport_size({"width": 390, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        page.reload()
        page.locator("#ladder .rung").nth(2).wait_for(timeout=60_000)
        page.get_by_role("button", name="Undo").click()
        page.locator("#ladder .rung.gone", has_text="+ stribeck").wait_for(timeout=60_000)
        assert said.is_visible()
        window.close()
    assert not problems
