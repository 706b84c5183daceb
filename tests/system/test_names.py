"""One meaning, one name: a class of the house has a name that no other class has."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

HOUSE = Path(__file__).parents[2]
SHIPPED = ("hil", "drivers", "controllers")


def _classes() -> dict[str, list[str]]:
    """Files of every public class by its name."""
    found = defaultdict(list)
    for folder in SHIPPED:
        for path in sorted((HOUSE / folder).rglob("*.py")):
            if path.resolve() != (HOUSE.resolve() / path.relative_to(HOUSE)):
                continue  # the links of the namespace
            tree = ast.parse(path.read_text(encoding="utf-8"))
            for node in tree.body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    found[node.name].append(str(path.relative_to(HOUSE)))
    return found


def test_no_two_public_classes_share_a_name():
    found = _classes()
    assert len(found) > 200
    assert {name: paths for name, paths in found.items() if len(paths) > 1} == {}
