"""Pages of the site: each is in the table of contents; the page of commands is complete."""

import base64
import gc
import hashlib
import pkgutil
import re
import shlex
from html.parser import HTMLParser
from pathlib import Path

import pytest
from test_blocks import DOCS, PAGES, ROOT

from hil import registry
from hil.cli import COMMANDS, build_parser, main

SITE = ROOT / "mkdocs.yml"
#: Printed by a command, not written.
PRINTED = DOCS / "bench"


def test_every_page_is_in_the_table_of_contents():
    nav = SITE.read_text(encoding="utf-8").partition("\nnav:\n")[2]
    listed = re.findall(r": ([\w/-]+\.md)$", nav, re.M)
    there = [p.relative_to(DOCS).as_posix() for p in DOCS.glob("**/*.md")]
    assert sorted(listed) == sorted(there)


def test_every_tutorial_is_run():
    nav = SITE.read_text(encoding="utf-8").partition("- Tutorials:\n")[2].partition("\n  - ")[0]
    assert re.findall(r": ([\w-]+)\.md$", nav, re.M) == list(PAGES)


def test_the_page_of_commands_has_all_and_no_other():
    page = (DOCS / "commands.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `hil ([\w-]+)` \| .+ \| `hil ([\w-]+) ?[^`]*` \|$", page, re.M)
    assert [a for a, _ in rows] == list(COMMANDS) and all(a == b for a, b in rows)


#: Examples of the page of commands that are only read: command -> reason.
ONLY_READ = {
    **dict.fromkeys(("demo", "experiment", "bench"), "takes minutes, and has tests of its own"),
    **dict.fromkeys(("ui", "studio"), "serves a page until it is ended"),
    "selftest": "asks for a word before the motors move",
    **dict.fromkeys(("import", "info", "fit", "compare", "diagnose"), "the reader's recording"),
    **dict.fromkeys(("add", "improve", "export", "trust"), "the reader's recording or model"),
    "list": "the reader's folder",
}


def _examples():
    """Command lines of the examples, command by command."""
    page = (DOCS / "commands.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| `hil [\w-]+` \| .+ \| `hil ([^`]+)` \|$", page, re.M)
    return {words[0]: words for words in map(shlex.split, found)}


def test_examples_of_the_page_of_commands_have_the_options_that_there_are():
    for name, words in _examples().items():
        _, rest = build_parser(name).parse_known_args(words)
        assert not rest, words


def test_examples_of_the_page_of_commands_run(tmp_path, monkeypatch, capsys):
    """In the order of the page; a later one may take the file of an earlier one."""
    monkeypatch.chdir(tmp_path)
    assert set(ONLY_READ) < set(COMMANDS)
    run = {name: words for name, words in _examples().items() if name not in ONLY_READ}
    assert {"run", "init", "devices", "replay", "view", "excite", "design"} <= set(run)
    for words in run.values():
        assert main(words) == 0, (words, capsys.readouterr().err)


def test_files_that_pages_name_exist():
    names = re.compile(r"`((?:hil|tests|drivers|controllers|sim_devices|rigs)/[\w/.-]+)`")
    for page in DOCS.glob("**/*.md"):
        if PRINTED not in page.parents:
            for name in names.findall(page.read_text(encoding="utf-8")):
                assert (ROOT / name).exists(), f"{page.name}: {name}"


def test_python_names_that_pages_give_exist():
    """Whole names on every page; of teleoperation's list each one, in `hil.teleop` if short."""
    pages = "".join(p.read_text(encoding="utf-8") for p in DOCS.glob("*.md"))
    names = set(re.findall(r"`(hil(?:\.[A-Za-z_]\w*)+)(?:\([^`]*\))?`", pages))
    page = (DOCS / "teleoperation.md").read_text(encoding="utf-8").partition("## From Python")[2]
    module = ""
    for name in re.findall(r"`((?:hil\.)?\w*\.[\w.]+)`", page):
        whole = f"{module}{name}" if name.startswith(".") else name
        whole = whole if whole.startswith("hil.") else f"hil.teleop.{whole}"
        module = whole.rpartition(".")[0]
        names.add(whole)
    assert len(names) > 30 and "hil.teleop.force_sensor_free.nearest" in names
    missing = []
    groups = registry.BUILT_IN.keys() | {"hil.effects"}  # of entry points: no modules
    for name in sorted(names - groups):
        try:
            pkgutil.resolve_name(name)
        except (AttributeError, ImportError):
            missing.append(name)
    assert not missing


def test_pictures_are_small_and_made_by_the_script():
    made = re.findall(r'^    "([\w-]+\.png)": \(', (DOCS / "pictures.py").read_text(), re.M)
    assert sorted(made) == sorted(p.name for p in DOCS.rglob("*.png"))
    sizes = [(DOCS / name).stat().st_size for name in made]
    assert max(sizes) <= 60_000 and sum(sizes) <= 600_000
    pages = "".join(p.read_text(encoding="utf-8") for p in DOCS.glob("*.md"))
    assert all(f"]({name})" in pages for name in made)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_site_is_built_without_a_warning(tmp_path):
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    build(load_config(str(SITE), site_dir=str(tmp_path / "site"), strict=True))
    assert (Path(tmp_path) / "site" / "python.html").stat().st_size > 100_000
    gc.collect()  # what MkDocs leaves open is not charged to the next test
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        _check_policy(page.read_text())


def _check_policy(page):
    """One policy, first in the head; each script of the page runs by its digest or its place."""
    tags = re.findall(
        r'<head[^>]*><meta http-equiv="Content-Security-Policy" content="([^"]*)">', page
    )
    assert len(tags) == 1
    (scripts,) = re.findall(r"script-src ([^;]*)", tags[0])
    assert "unsafe" not in scripts and "default-src 'none'" in tags[0]
    parser = _Scripts()
    parser.feed(page)
    for text in parser.texts:
        assert base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() in scripts
    assert all(not re.match(r"(https?:)?//", place) for place in parser.places)
    assert not parser.handlers


class _Scripts(HTMLParser):
    """Scripts of a page: their texts, where others come from, and attributes that run."""

    def __init__(self):
        super().__init__()
        self.texts, self.places, self.handlers, self._inside = [], [], [], False

    def handle_starttag(self, tag, attrs):
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        found = dict(attrs)
        if tag == "script" and "src" in found:
            self.places.append(found["src"])
        self._inside = tag == "script" and "src" not in found and found.get("type") is None

    def handle_data(self, data):
        if self._inside:
            self.texts.append(data)
            self._inside = False
