"""How many files and shared names the house has, so that neither can silently grow.

Lower a bound when one is met.
"""

import ast
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

import plants

from hil import registry
from hil.cli import COMMANDS
from hil.commands.bench import BENCHES
from hil.commands.experiment import EXPERIMENTS
from hil.models import catalogue
from hil.record import binary_tables
from hil.record.export import write_recordings
from hil.sim_devices import bench
from hil.sim_devices.joints import bench as joint_bench

ROOT = Path(__file__).parents[2]
#: Most modules; most modules that exactly one other imports; most of these that no table names: a
#: module that a table loads by its name is found there, and one import more is no reason to merge.
MODULES, ONE_IMPORTER, UNNAMED = 340, 25, 14
#: Most modules (packages apart) that one diagnosis of a session loads.
OF_A_DIAGNOSIS = 90
#: What every command, study, benchmark, driver, law, file of effects or simulated session has, or
#: may have, by one name: its table or its caller finds it so.
ROLES = frozenset(
    """
    main run configure command EXAMPLE text as_dict
    study PAGE page report rows steps verdict HEAD
    Config build law constants open_device
    open_box attached BUS ADDRESS put BOXES
    EFFECTS SCHEMA TARGET kinds simulate TYPE_CHECKING
    """.split()
)
#: Most public functions and constants that share their name with another one.
SHARED = 149
#: Most places that keep the formatter off.
UNFORMATTED = 49
_COUNT = """
import sys
from hil.cli import main
assert main(["diagnose", sys.argv[1], "--quiet", "--json"]) == 0
files = [getattr(m, "__file__", None) or "" for n, m in sys.modules.items() if n[:4] == "hil."]
print(*sorted(f for f in files if f and not f.endswith("__init__.py")), file=sys.stderr)
"""


def _modules() -> dict[str, Path]:
    """Dotted name -> file of the product, by the names under which it is installed."""
    found = {}
    for folder in ("hil", "controllers", "drivers", "sim_devices"):
        for path in (ROOT / folder).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            parts = parts if folder == "hil" else ("hil", *parts)
            found[".".join(parts).removesuffix(".__init__")] = path
    return {name: path for name, path in found.items() if not _linked(path)}


def _linked(path: Path) -> bool:
    """Whether a path runs through one of the links in `hil` (its files are counted once)."""
    return any(parent.is_symlink() for parent in path.parents if ROOT in parent.parents)


def _imports(name: str, path: Path, known: dict[str, Path]) -> set[str]:
    """Modules of the product that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert not node.level, f"{name} imports relative to itself"
            inner = {f"{node.module}.{a.name}" for a in node.names}
            found |= (inner & known.keys()) or {node.module}
    return (found & known.keys()) - {name}


def _named_by_tables() -> set[str]:
    """Modules that the tables of the product load by name."""
    rows = [place for group in registry.BUILT_IN.values() for place in group.values()]
    rows += [row.module for row in COMMANDS.values()]
    rows += [row.place for row in (*BENCHES.values(), *EXPERIMENTS.values())]
    rows += [*catalogue.MODULES, *bench.BOXES.values()]
    rows += [place for place, _, _ in binary_tables.READERS.values()]
    rows += [module for module, _ in joint_bench.BOXES.values()]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for group in (project["scripts"], *project["entry-points"].values()):
        rows += group.values()
    return {row.partition(":")[0] for row in rows}


def test_the_house_does_not_grow_silently():
    known = _modules()
    importers = defaultdict(set)
    for name, path in known.items():
        for other in _imports(name, path, known):
            importers[other].add(name)
    one = sorted(name for name, by in importers.items() if len(by) == 1)
    assert len(known) > 200, "the files were not found"
    assert len(known) <= MODULES
    assert len(one) <= ONE_IMPORTER, "\n".join(one)
    named = _named_by_tables()
    assert named <= known.keys(), named - known.keys()
    unnamed = [name for name in one if name not in named]
    assert len(unnamed) <= UNNAMED, "\n".join(unnamed)


def _public(tree: ast.Module) -> dict[str, tuple[type, str]]:
    """Public names that a module defines at its top level: kind and definition."""
    found = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found[node.name] = (type(node), ast.unparse(node))
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            value = ast.unparse(node.value) if node.value else ""
            for target in targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                # of several at once each stands for something of its own
                text = value if len(names) == 1 else f"{value} line {node.lineno}"
                found |= {n.id: (ast.Assign, text) for n in names if isinstance(n, ast.Name)}
    return {name: entry for name, entry in found.items() if name[:1] != "_"}


def test_no_two_public_things_share_a_name():
    """What only its own file uses begins with an underscore; the same alias twice is one thing."""
    defined = defaultdict(list)
    for path in _modules().values():
        for name, entry in _public(ast.parse(path.read_text())).items():
            defined[name].append((*entry, path.relative_to(ROOT).as_posix()))
    shared = {
        name: entries
        for name, entries in defined.items()
        if name not in ROLES and len({text for _, text, _ in entries}) > 1
    }
    places = {name: [path for _, _, path in entries] for name, entries in shared.items()}
    assert len(defined) > 1000, "the names were not found"
    classes = [n for n, entries in shared.items() if any(k is ast.ClassDef for k, _, _ in entries)]
    assert not classes, {name: places[name] for name in classes}
    assert len(shared) <= SHARED, "\n".join(f"{n}: {', '.join(p)}" for n, p in places.items())


def test_the_formatter_is_rarely_kept_off():
    folders = ("hil", "controllers", "drivers", "sim_devices", "tests", "docs")
    files = [p for f in folders for p in (ROOT / f).rglob("*.py") if not _linked(p)]
    assert sum(p.read_text().count("# fmt: " + "skip") for p in files) <= UNFORMATTED


def test_what_a_table_loads_by_name_is_there():
    for name, row in {**BENCHES, **EXPERIMENTS}.items():
        assert callable(row.load()), name


def test_a_diagnosis_touches_few_files(tmp_path):
    run = plants.two_tone_axis(6.0, (0.3, 0.2), (3.0, 7.3), 1.0, 0.3)
    write_recordings(tmp_path / "s.mcap", [run], {})
    words = [sys.executable, "-c", _COUNT, str(tmp_path / "s.mcap")]
    ran = subprocess.run(words, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    files = ran.stderr.splitlines()[-1].split()
    assert 60 < len(files) <= OF_A_DIAGNOSIS, "\n".join(files)
