"""What a user's file may declare: names of other effects stand in a tuple, and exist."""

from dataclasses import replace
from pathlib import Path

import pytest

from hil.errors import ConfigError
from hil.models import catalogue
from hil.models.friction import Stribeck
from hil.testing.effects import ConformanceError, check_effect

FILE = """
from dataclasses import replace
from hil.models.friction import Stribeck

class Rub(Stribeck):
    name = "rub"
    doc = replace(Stribeck.doc, confused_with=("stribeck"))

EFFECTS = (Rub(),)
"""


def test_a_name_without_its_tuple_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rub.py"
    path.write_text(FILE, encoding="utf-8")
    with pytest.raises(ConfigError, match="confused_with is 'stribeck', expected a tuple"):
        catalogue.load_plugin(path)
    assert "rub" not in catalogue.table()


@pytest.mark.parametrize(("part", "names"), [("doc", "confused_with"), ("relations", "replaces")])
def test_names_that_no_effect_has_are_refused(part: str, names: str) -> None:
    changed = replace(getattr(Stribeck, part), **{names: ("stribek",)})
    kind = type("Rub", (Stribeck,), {"name": "rub", part: changed})
    with pytest.raises(ConformanceError, match="Did you mean 'stribeck'"):
        check_effect(kind())
