"""Every shell and Python block of the tutorials runs, page by page, in the order of the page.

- A block that begins with the comment ``# NAME`` (``# my_effects.py``) is saved as that file.
- ``<!-- not run: REASON -->`` in the line before a block keeps it from running; `NOT_RUN` lists
  all of them.
- Files of docs/examples that a page links to are in the folder, as the page tells the reader.
- An indented block that begins with ``Verdict:`` is what the page's commands print, line by line;
  ``...`` stands for anything.
- ``pip install -e .`` writes only the entry points of ./pyproject.toml.
"""

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = (
    "first-session", "own-recording", "missing-effect", "own-effects", "own-arm",
    "own-device", "own-controller", "hardware-day",
)  # fmt: skip
#: Blocks that are not run: page -> reasons, in the order of the page.
NOT_RUN = {
    "hardware-day": [
        "needs an index of packages",
        "needs hardware (changes the system's device rules)",
        "needs hardware",
        "needs hardware",
        "needs hardware",
        "needs hardware (the session of the step before)",
        "needs hardware",
    ],
    "own-device": ["needs an index of packages", "needs hardware (the microcontroller)"],
}
BLOCK = re.compile(r"(?:<!-- not run: (.+?) -->\n)?^```(\w*)[^\n]*\n(.*?)^```$", re.M | re.S)
FILE = re.compile(r"# ([\w.-]+\.(?:py|toml))\n")


QUOTE = re.compile(r"^    Verdict: .*\n(?:(?:    .*)?\n)*", re.M)


def quoted(page):
    """Lines that the commands of a tutorial print, as patterns."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    lines = [x.strip() for block in QUOTE.findall(text) for x in block.splitlines() if x.strip()]
    return [r"\s+".join(re.escape(w).replace(r"\.\.\.", ".*") for w in x.split()) for x in lines]


class Block(NamedTuple):
    """One fenced block: language, text, why it is not run, and the file that it is."""

    language: str
    text: str
    reason: str
    file: str


def blocks(page):
    """All fenced blocks of a tutorial."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    found = []
    for reason, language, body in BLOCK.findall(text):
        named = FILE.match(body)
        found.append(Block(language, body, reason, named[1] if named else ""))
    return found


PIP = f"""#!{sys.executable}
import sys, tomllib
from pathlib import Path

assert sys.argv[1:] == ["install", "-e", "."], sys.argv
project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
place = Path(f"{{project['name']}}.dist-info")
place.mkdir()
head = f"Metadata-Version: 2.1\\nName: {{project['name']}}\\nVersion: {{project['version']}}\\n"
(place / "METADATA").write_text(head)
groups = project["entry-points"].items()
lines = [f"[{{g}}]\\n" + "".join(f"{{k}} = {{v}}\\n" for k, v in t.items()) for g, t in groups]
(place / "entry_points.txt").write_text("".join(lines))
"""


@pytest.fixture
def environment(tmp_path):
    """Environment whose `hil`, `python` and `pip` are this checkout's, and its folder."""
    tools, folder = tmp_path / "tools", tmp_path / "folder"
    tools.mkdir()
    folder.mkdir()
    scripts = {
        "python": f'#!/bin/sh\nexec "{sys.executable}" "$@"\n',
        "hil": f'#!/bin/sh\nexec "{sys.executable}" -m hil "$@"\n',
        "pip": PIP,
    }
    for name, text in scripts.items():
        (tools / name).write_text(text, encoding="utf-8")
        (tools / name).chmod(0o755)
    path = os.pathsep.join([str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")])
    found = f"{tools}{os.pathsep}{os.environ['PATH']}"
    own = {"PATH": found, "PYTHONPATH": path.rstrip(os.pathsep), "OMP_NUM_THREADS": "1"}
    return {**os.environ, **own}, folder


def test_every_block_that_is_not_run_is_listed():
    found = {page: [b.reason for b in blocks(page) if b.reason] for page in PAGES}
    assert {page: reasons for page, reasons in found.items() if reasons} == NOT_RUN


def test_languages_are_known():
    """A block in another spelling of its language would not run."""
    known = {"sh", "python", "toml"}
    assert {b.language for page in PAGES for b in blocks(page)} <= known
    for page in PAGES:
        for b in blocks(page):
            if b.language == "toml":
                tomllib.loads(b.text)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_blocks_run(page, environment):
    settings, folder = environment
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    for name in set(re.findall(r"\]\(examples/([\w.]+)\)", text)):
        (folder / name).write_bytes((DOCS / "examples" / name).read_bytes())
    printed = ""
    for number, block in enumerate(blocks(page)):
        if block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")
        elif not block.reason and block.language in ("sh", "python"):
            words = ["bash", "-eu", "-o", "pipefail"]
            words = words if block.language == "sh" else [sys.executable]
            done = subprocess.run(
                [*words, "-c", block.text], cwd=folder, env=settings, capture_output=True,
                text=True, stdin=subprocess.DEVNULL, timeout=300,
            )  # fmt: skip
            assert done.returncode == 0, f"{page}, block {number}:\n{block.text}\n{done.stderr}"
            printed += done.stdout
    assert [x for x in quoted(page) if not re.search(x, printed)] == [], printed


def test_pages_quote_what_their_commands_print():
    assert [page for page in PAGES if quoted(page)] == ["missing-effect", "own-effects"]


#: What a notebook program does with the value of a cell's last line: it shows it, as HTML or more.
SHOW = """
import subprocess

def show(value):
    # plotly asks which program it is in before it shows a figure by itself
    made = getattr(value, "to_html", None) or getattr(value, "_repr_html_", None)
    if made is not None:
        assert made(), value
        print("shown:", type(value).__name__)

def shell(line):
    subprocess.run(line, shell=True, check=True)

"""


def program(cell):
    """Code of a cell as plain Python, its last line shown."""
    text = "".join(cell["source"])
    lines = [f"shell({x[1:]!r})" if x.startswith("!") else x for x in text.splitlines()]
    tree = ast.parse("\n".join(lines))
    last = tree.body[-1]
    if isinstance(last, ast.Expr) and not text.rstrip().endswith(";"):
        last.value = ast.Call(ast.Name("show", ast.Load()), [last.value], [])
    return ast.unparse(ast.fix_missing_locations(tree))


@pytest.mark.slow
def test_the_notebook_runs_and_shows_what_it_says(environment):
    settings, folder = environment
    notebook = json.loads((DOCS / "notebook.ipynb").read_text(encoding="utf-8"))
    cells = [c for c in notebook["cells"] if c["cell_type"] == "code"]
    assert not any(c["outputs"] or c["execution_count"] for c in cells), "outputs are committed"
    script = SHOW + "\n".join(program(c) for c in cells)
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=folder, env=settings, capture_output=True, text=True,
        stdin=subprocess.DEVNULL, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    shown = [x.partition(": ")[2] for x in done.stdout.splitlines() if x.startswith("shown: ")]
    kinds = ["Recording", "Comparison", "Figure", "Diagnosis", "Figure", "FitResult"]
    assert shown == [*kinds, "LadderWidget"]
    assert "stribeck joint2 confidence" in done.stdout
    assert (folder / "better.toml").exists() and (folder / "why.html").exists()
