"""What decides has one home; what is left elsewhere is arithmetic, bases and limits of memory."""

import ast
from pathlib import Path

import hil.diagnosis
from hil.diagnosis import constants

#: Numbers that decide something, at most.
_MOST = 40
#: Words on a simulated motion: one percent.
_HELD = {"verbs": {1.0, 0.99, 1.01}}
#: Numbers that decide nothing: rounding, bases, grids, draws, rows.
_ARITHMETIC = {
    "artefacts": {
        *("WIDER", "WIDEST", "CUTS"),
        *("STEPS", "LEAST", "FINE", "MOST", "OVERTONES", "HILLS", "PEAKS", "ABOUT"),
    },
    "attribution": {"FURTHER", "OVERFLOW"},
    "candidates": {"DRAWS", "SHRINK", "SPEEDS", "WIDTH", "PLACES", "NARROW", "CREEPS", "KNOTS"},
    "joint_zeros": {
        "INSTANTS", "STEPS", "OWN_LAWS", "EARTH", "SAME", "MILLIMETRES", "OTHER_LENGTHS",
    },
    "engine": {"CUTS"},
    "equivalence": {"PROBE", "UNSHOWN", "MAX_RIVALS"},
    "evidence": {"DEPENDENT"},
    "floor": {
        "RANK", "FLOOR_STEPS", "FULL", "STRENGTHS", "FOLDS", "SECONDS", "MAX_ROWS", "FINE",
        "COARSE", "NEAR", "POSES", "HIDDEN_SHARE", "TREND", "STIR",
    },
    "grams": {"BOUND_ROUNDS"},
    "heldout": {"RESOLUTION_RATIO"},
    "naming": {"STARTS", "ROUNDS"},
    "preconditions": {"POSTURES", "STEPS"},
    "residual_tests": {
        "INSTANTS", "AROUND", "OWN_SHARE", "PARTS", "LAGS", "NAMED_INSTANTS", "PADDED",
    },
    "residuals": {"HIGHEST_ORDER"},
    "search": {"HINTS"},
    "touches": {"FORCE"},
    "types": {"FLIPS", "NONE"},
}  # fmt: skip


def numbers(path):
    """Names at the top of a module that are bound to numbers."""
    for node in ast.parse(path.read_text()).body:
        if not isinstance(node, ast.Assign):
            continue
        leaves = [n for n in ast.walk(node.value) if isinstance(n, ast.Constant)]
        if leaves and all(isinstance(n.value, int | float) for n in leaves):
            yield from (n.id for t in node.targets for n in ast.walk(t) if isinstance(n, ast.Name))


def leaves(node):
    """Numbers in a part of a program, but for 1 and for what a formula squares."""
    found = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]
    return [x for x in found if isinstance(x, int | float)]


def test_few_numbers_decide():
    body = ast.parse(Path(constants.__file__).read_text()).body
    made = [n for n in body if isinstance(n, ast.Assign | ast.AnnAssign)]
    plain = [n for n in made if len(leaves(n)) == 1 and not names(n.value)]
    derived = [n for n in made if n not in plain]
    assert 20 < len(plain) <= _MOST
    page = (Path(__file__).parents[2] / "docs" / "diagnosis.md").read_text()
    assert f"every number that decides something: {len(plain)}," in page
    # what is derived from them brings no number of its own, but squares, halves and differences
    assert all(names(n.value) and set(leaves(n.value)) <= {1, 2} for n in derived)


def names(node):
    """Names that a part of a program reads."""
    return [n.id for n in ast.walk(node) if isinstance(n, ast.Name)]


def test_nothing_is_held_against_a_number_of_its_own():
    """A share, a factor or a level in a comparison has a name; roundings need none."""
    for path in Path(hil.diagnosis.__file__).parent.glob("*.py"):
        compared = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Compare)]
        found = [x for n in compared for x in leaves(n) if isinstance(x, float)]
        assert {x for x in found if 1e-2 < abs(x) < 1e3} <= _HELD.get(path.stem, {1.0}), path.name


def test_what_decides_stands_in_one_file():
    for path in Path(hil.diagnosis.__file__).parent.glob("*.py"):
        if path.stem != "constants":
            there = {n.lstrip("_") for n in numbers(path) if n.isupper()}
            assert there <= _ARITHMETIC.get(path.stem, set()), path.name


def test_every_constant_says_what_it_decides():
    text = Path(hil.diagnosis.__file__).with_name("constants.py").read_text()
    lines = text[text.index("import annotations") :].splitlines()
    for k, line in enumerate(lines):
        if line.split(",")[0].split(" ")[0].isupper():
            assert lines[k - 1].startswith("#:"), line
