"""The list of places answers with files that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_place_exists():
    text = (ROOT / "docs" / "where.md").read_text("utf-8")
    places = re.findall(r"^\| .*\? \| `([^`]+)` \|$", text, re.M)
    assert len(places) >= 30
    assert [p for p in places if not (ROOT / p).is_file()] == []


def test_the_map_of_the_house_names_every_package():
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    packages = {p.parent.name for p in (ROOT / "hil").glob("*/__init__.py")} - {"rigs"}
    assert [p for p in sorted(packages) if f"`{p}`" not in text and f"hil/{p}`" not in text] == []
