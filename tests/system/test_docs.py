"""What the documentation tells a user to type works."""

import re
from pathlib import Path

from hil.models import catalogue
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


def test_links_of_readme_and_docs_exist():
    root = DOCS.parent
    for page in [root / "README.md", *DOCS.glob("**/*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
