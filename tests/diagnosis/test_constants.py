"""What decides has one home; what is left elsewhere is arithmetic, bases and limits of memory."""

import ast
from pathlib import Path

import hil.diagnosis

#: Numbers that decide nothing: rounding, bases, grids, draws, rows.
_ARITHMETIC = {
    "artefacts": {"WIDER", "WIDEST", "CUTS"},
    "attribution": {"RICHER", "FURTHER"},
    "competitors": {"SHRINK", "SPEEDS", "WIDTH", "PLACES", "NARROW", "CREEPS", "KNOTS"},
    "equivalence": {"PROBE", "MAX_RIVALS"},
    "evidence": {"DEPENDENT"},
    "floor": {"RANK", "FLOOR_STEPS", "FULL", "STRENGTHS"},
    "grams": {"BOUND_ROUNDS"},
    "heldout": {"ROOM_TO_GAIN", "RESOLUTION_RATIO"},
    "naming": {"DRAWS"},
    "residual_tests": {"INSTANTS", "AROUND", "OWN_SHARE", "PARTS", "LAGS", "NAMED", "PADDED"},
    "residuals": {"HIGHEST_ORDER"},
    "types": {"FLIPS"},
    "unnamed": {
        "FOLDS", "SECONDS", "STRENGTHS", "MAX_ROWS", "FINE", "COARSE", "NEAR", "POSES",
        "HIDDEN_SHARE", "TREND",
    },
}  # fmt: skip


def numbers(path):
    """Names at the top of a module that are bound to numbers."""
    for node in ast.parse(path.read_text()).body:
        if not isinstance(node, ast.Assign):
            continue
        leaves = [n for n in ast.walk(node.value) if isinstance(n, ast.Constant)]
        if leaves and all(isinstance(n.value, int | float) for n in leaves):
            yield from (n.id for t in node.targets for n in ast.walk(t) if isinstance(n, ast.Name))


def test_what_decides_stands_in_one_file():
    for path in Path(hil.diagnosis.__file__).parent.glob("*.py"):
        if path.stem != "constants":
            public = {n for n in numbers(path) if n.isupper() and not n.startswith("_")}
            assert public <= _ARITHMETIC.get(path.stem, set()), path.name


def test_every_constant_says_what_it_decides():
    text = Path(hil.diagnosis.__file__).with_name("constants.py").read_text()
    lines = text[text.index("import annotations") :].splitlines()
    for k, line in enumerate(lines):
        if line.split(",")[0].split(" ")[0].isupper():
            assert lines[k - 1].startswith("#:"), line
