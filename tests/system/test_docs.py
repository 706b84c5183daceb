"""What the documentation tells a user to type works."""

import re
from pathlib import Path

import pytest

from hil.cli import main
from hil.models import catalogue
from hil.record.mapfile import _ROBOT, _TABLE, _TOP
from hil.record.mcap_read import load
from hil.testing import check_effect

DOCS = Path(__file__).parents[2] / "docs"


def test_own_effect_of_the_tutorial_conforms(tmp_path, monkeypatch):
    text = (DOCS / "own-effects.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(.*?)```", text, re.S).group(1)
    assert len(code.splitlines()) <= 32
    file = tmp_path / "my_effects.py"
    file.write_text(code, encoding="utf-8")
    monkeypatch.setattr(catalogue, "_table", dict(catalogue.table()))
    catalogue.load_plugin(file)
    check_effect(catalogue.get("eyelet-drag"))


def test_map_of_the_import_page_does_what_the_page_says(tmp_path, monkeypatch, capsys):
    text = (DOCS / "import.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for language, name in (("csv", "run7.csv"), ("toml", "rig.toml")):
        code = re.search(rf"```{language}\n(.*?)```", text, re.S).group(1)
        Path(name).write_text(code, encoding="utf-8")
    (command,) = re.findall(r"^hil (import run7.*)$", text, re.M)
    assert main(command.split()) == 0
    assert "cannot be fitted" in capsys.readouterr().out.splitlines()[-1]
    run = load("run7.mcap")
    assert (run.arm, run.t[0], run.q[0, 0]) == ("elbow", 0.0, 0.1)
    assert run.tau[0, 0] == pytest.approx(-1.044) and run.t[4] == pytest.approx(0.004)
    for key in (*_TOP[1:], *_TABLE, *_ROBOT):
        assert f"`{key}`" in text or f"[{key}" in text or f"`{key} " in text, key


def test_links_of_readme_and_docs_exist():
    root = DOCS.parent
    for page in [root / "README.md", *DOCS.glob("**/*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
