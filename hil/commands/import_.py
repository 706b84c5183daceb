"""`hil import`: tables or ROS bags of any rig into sessions.

It prints JSON, or the session, its faults and what to do next.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from hil import outputs, terminal, work
from hil.commands import common
from hil.errors import ConfigError, DataError, families, plural
from hil.models import catalogue
from hil.models.files import write_model
from hil.models.model import base_model
from hil.models.robots import make_robot, undescribed
from hil.record import datasets
from hil.record.bags import is_bag, read_bag
from hil.record.checks import check, column_unit, columns, joint_units
from hil.record.consistency import DataFault
from hil.record.export import write_recordings
from hil.record.guess import Proposal, propose
from hil.record.locked import free_joints
from hil.record.mapfile import Rule, TableMap, builtin_maps, parse_map, read_map
from hil.record.mcap_read import changed
from hil.record.recording import BEGAN, BEGAN_BY, TAGS, Recording, tag_record
from hil.record.sources import importable
from hil.record.table_files import ForeignTable, open_table, run_names
from hil.record.tables import Imported, import_table
from hil.record.text_tables import PACKED
from hil.record.units import axes_unit, epoch_unit
from hil.userfile import is_dataset, parse_toml, read_text, write_text


def as_dict(output: Path, found: Imported, model: tuple[Path, bool]) -> dict[str, object]:
    """`hil import --json`; the model with whether it was written now."""
    return {
        "schema": "hil.import/1",
        "session": str(output),
        "model": str(model[0]),
        "model_written": model[1],
        "arms": [
            {
                "name": r.arm,
                "joints": list(r.joints),
                "samples": r.n,
                "rate_hz": r.rate,
                **({"taken": note} if (note := r.metadata.get("note")) else {}),
            }
            for r in found.recordings
        ],
        "unused": list(found.unused),
        "notes": list(found.notes),
        "warnings": [
            {"code": f.code, "severity": f.severity, "text": f.text}
            for r in found.recordings
            for f in check(r)
        ],
    }


def text(output: Path, found: Imported, model: Path, written: bool) -> str:
    """What was imported, its faults, and what to do next; the errors alone where it is quiet."""
    if terminal.settings.quiet:
        bad = [f for r in found.recordings for f in check(r) if f.severity == "error"]
        return "".join(f"{_fault(f)}\n" for f in bad)
    lines = []
    for r in found.recordings:
        lines.append(
            f"{output}: arm {r.arm}, {plural(r.n, 'sample')} at {r.rate:.5g} Hz, "
            f"{plural(r.d, 'joint')} ({', '.join(r.joints)})"
        )
    lines += [f"taken from {note}" for r in found.recordings if (note := r.metadata.get("note"))]
    if shift := found.recordings[0].metadata.get("time_shift_s"):
        lines.append(f"time begins before 0: shifted by {float(shift):.6g} s")
    lines += found.notes
    if lacking := undescribed(found.recordings[0].robot, found.recordings[0].d):
        lines.append(f"note: {lacking}")
    if unused := [n for n in found.unused if n]:
        lines.append(f"not used: {', '.join(families(unused))}")
    lines.append(f"{model}: {'base model written' if written else _kept(model, found)}")
    faults = _faults(found)
    lines += [_fault(f) for f in faults if f.severity != "error"]
    own = ["--model", str(model)] if written or not _foreign(model, found) else []
    return "\n".join([*lines, *_next(output, own, faults)]) + "\n"


def _kept(model: Path, found: Imported) -> str:
    """What is said of a model that was there already, and whether it is of another robot."""
    if not _foreign(model, found):
        return "model kept as it was"
    return (
        "model kept as it was, of another robot than this session; delete it and "
        f"{model.with_suffix('.urdf').name} for a new one"
    )


def _foreign(model: Path, found: Imported) -> bool:
    """Whether a model that was there already is of another robot."""
    urdf = found.recordings[0].robot.urdf
    return bool(urdf) and not outputs.same_text(model.with_suffix(".urdf"), urdf)


def _next(output: Path, own: list[str], faults: list[DataFault]) -> list[str]:
    """What to do with the session: look at it and diagnose it, or mend it where it is worthless.

    `own` are the words for a model of its robot.
    """
    errors = [f for f in faults if f.severity == "error"]
    if not errors:
        words = (["info", str(output)], ["diagnose", str(output), *own])
        return ["next:", *(f"  {shlex.join(['hil', *some])}" for some in words)]
    return [
        *map(_fault, errors),
        f"{output} is written but cannot be fitted: {plural(len(errors), 'error')}, see above; "
        "mend the table and import it again",
    ]


def _faults(found: Imported) -> list[DataFault]:
    """Faults of every arm; its name stands before them where there are several."""
    several = len(found.recordings) > 1
    named = ((r.arm if several else "", f) for r in found.recordings for f in check(r))
    return [replace(f, joint=f"{arm} {f.joint}".strip()) for arm, f in named]


def _fault(f: DataFault) -> str:
    return f"{f.severity} [{f.code}] {f.sentence}"


def every_as_dict(found: Mapping[Path, Imported], model: tuple[Path, bool]) -> dict[str, object]:
    """`hil import --all-runs --json`."""
    sessions = [as_dict(path, one, model) for path, one in found.items()]
    return {"schema": "hil.import-all/1", "sessions": sessions}


def every(folder: Path, found: Mapping[Path, Imported], model: Path, written: bool) -> str:
    """Sessions, notes and data faults of all runs together, and which run to look at first.

    Where it is quiet, only which of them cannot be fitted.
    """
    faults = {p: [f for r in one.recordings for f in check(r)] for p, one in found.items()}
    bad = [p.name for p, some in faults.items() if any(f.severity == "error" for f in some)]
    useless = f"{len(bad)} of them cannot be fitted: {', '.join(bad)}\n" if bad else ""
    if terminal.settings.quiet:
        return useless and f"{folder}: {useless}"
    state = "base model written" if written else _kept(model, next(iter(found.values())))
    first = bad[0] if bad else next(iter(found)).name
    one = next(iter(found.values())).recordings[0]
    lacking = undescribed(one.robot, one.d)
    notes = [f"note: {lacking}\n"] if lacking else []
    notes += [
        f"taken from {note}\n"
        for x in found.values()
        for r in x.recordings
        if (note := r.metadata.get("note"))
    ]
    notes += [f"{note}\n" for note in dict.fromkeys(n for x in found.values() for n in x.notes)]
    said = "".join(notes) + (
        f"{folder}: {plural(len(found), 'session')}, "
        f"{plural(sum(map(len, faults.values())), 'data fault')}\n{model}: {state}\n"
        f"next:\n  {shlex.join(['hil', 'info', str(folder / first)])}\n"
        + ("" if bad else f"  {shlex.join(['hil', 'diagnose', str(folder)])}\n")
    )
    return said + useless


_Item = TypeVar("_Item")
EXAMPLE = "hil import run1.csv --robot arm.urdf -o run1.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "tables",
        nargs="+",
        metavar="TABLE",
        help="text, NPY, NPZ, MAT, HDF5, Parquet, Feather or XLSX file with columns t, q1.., "
        "tau1.. (SI); a ROS bag (.bag, .mcap, .db3 or a folder with metadata.yaml); the folder of "
        "a LeRobot data set; or a public recording, e.g. emps/DATA_EMPS.mat, found through "
        f"{datasets.VARIABLE}; several files, or a folder of them, are read with the same options",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="S.mcap",
        help="session to write; one that was imported from the same table is replaced, any other "
        "session there is kept under another name; of several files, the folder of their sessions",
    )
    _add_meaning(parser)
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="show what would be read, from which columns and in which units; write nothing",
    )
    parser.add_argument(
        "--propose-map",
        default="",
        metavar="MAP.toml",
        help="write a map that is made from the names of the columns, to check and to edit",
    )
    common.add_bag(parser)
    common.add_tags(parser)
    parser.add_argument("--json", action="store_true", help="summary as JSON on stdout")


def _add_meaning(parser: argparse.ArgumentParser) -> None:
    """Declare the options that say what the columns mean."""
    parser.add_argument(
        "--map",
        default="",
        metavar="MAP.toml",
        help="renames, scales, shifts and signs columns; or a built-in map: "
        + ", ".join(builtin_maps()),
    )
    parser.add_argument("--robot", default="", metavar="URDF", help="robot; default: of the map")
    parser.add_argument("--tip", default="", metavar="FRAME", help="frame of the measured force")
    parser.add_argument(
        "--force-axes",
        default="",
        metavar="LINK",
        help="link in whose axes the measured force is; default: of the map, else the base's axes",
    )
    parser.add_argument("--arm", default="", metavar="NAME", help="name of the arm (default arm)")
    parser.add_argument(
        "--all-runs",
        action="store_true",
        help="every run of a file with several, each as a session in the folder -o names",
    )
    common.add_table_words(parser)


def run(args: argparse.Namespace) -> int:
    """Import, write the session and, where there is none, the base model."""
    catalogue.load_installed()
    paths = [p for name in args.tables for p in _files(name)]
    if len(paths) > 1 or str(paths[0]) != args.tables[0]:
        return _several(args, paths)
    args.table = args.tables[0]
    work.at(f"read {Path(args.table).name}", 0.0)
    if is_bag(args.table):
        return _bag(args)
    common.refuse_topics(args)
    table, mapping = _source(args.table, args.map, common.torque_constants(args.torque_constant))
    if args.propose_map:
        return _propose(args, table, mapping)
    if args.dry_run:
        return _show(args, {table: _guessed(args, table, mapping)})
    if not args.output:
        raise ConfigError("-o S.mcap is missing; --dry-run shows what would be read without it")
    output = Path(args.output)
    if args.all_runs:
        return _every_run(args, table, mapping, output)
    outputs.check(output, ".mcap", _inputs(args, table))
    return _one(args, output, table, _read(args, table, mapping, args.which))


def _bag(args: argparse.Namespace) -> int:
    """Import a ROS bag."""
    bag = Path(args.table)
    _refuse_of_tables(args, bag)
    if args.dry_run:
        return _show(args, {bag: _of_bag(args, bag)})
    if not args.output:
        raise ConfigError("-o S.mcap is missing; --dry-run shows what would be read without it")
    output = Path(args.output)
    outputs.check(output, ".mcap", _inputs(args, bag))
    return _one(args, output, bag, _of_bag(args, bag))


def _refuse_of_tables(args: argparse.Namespace, bag: Path) -> None:
    """Refuse for a bag what is said of tables."""
    of_tables = (
        ("--map", args.map),
        ("--run", args.which),
        ("--unit", args.unit),
        ("--force-axes", args.force_axes),
        ("--torque-constant", args.torque_constant),
        ("--missing", args.missing),
        ("--rate", args.rate),
        ("--propose-map", args.propose_map),
    )
    for option, value in of_tables:
        if value:
            raise ConfigError(f"{bag} is a ROS bag, in SI units and of one run; leave {option} out")
    if args.all_runs:
        raise ConfigError(f"{bag} is a ROS bag, of one run; leave --all-runs out")


def _of_bag(args: argparse.Namespace, bag: Path) -> Imported:
    """What a bag holds; it has topics in place of columns, and so no rules."""
    return Imported(tuple(read_bag(bag, common.bag_choice(args))), ())


def _one(args: argparse.Namespace, output: Path, table: Path, found: Imported) -> int:
    """Write what was imported as one session, and the model."""
    place = output.with_name(f"{output.stem}.model.toml")
    _refuse_urdf(place, found.recordings)
    _write(output, found, table, args.tag)
    model = _model(place, found.recordings)
    if args.json:
        terminal.write_stdout(json.dumps(as_dict(output, found, model)) + "\n")
    else:
        terminal.write_stdout(terminal.sentences(text(output, found, *model)))
    return 0


def _inputs(args: argparse.Namespace, table: Path) -> list[Path]:
    """Files that the import reads."""
    return [table, *(Path(name) for name in (args.map, args.robot) if name)]


def _every_run(
    args: argparse.Namespace, table: Path, mapping: TableMap | None, folder: Path
) -> int:
    """Each run of a file as a session in one folder; all are read before any is written."""
    if args.which:
        raise ConfigError("--run and --all-runs exclude each other; give one of them")
    names = run_names(table, mapping.columns if mapping else ())
    if not names:
        raise ConfigError(f"table {table} does not hold several runs; leave --all-runs out")
    _refuse_folder(folder)
    found = {folder / f"{n}.mcap": _read(args, table, mapping, n) for n in _counted("read", names)}
    return _write_all(args, folder, found, dict.fromkeys(found, table))


def _files(name: str) -> list[Path]:
    """Files that a name of the command line stands for; a folder stands for those in it."""
    path = Path(name)
    folder = path.is_dir() and not (is_bag(path) or is_dataset(path))
    return importable(path) if folder else [path]


def _several(args: argparse.Namespace, paths: list[Path]) -> int:
    """Several files, read alike, each as a session in one folder; all are read before any write."""
    for option, value in (("--all-runs", args.all_runs), ("--propose-map", args.propose_map)):
        if value:
            raise ConfigError(f"{option} takes one file, got {len(paths)}; give one of them")
    args.table = ", ".join(args.tables)
    if not any(map(is_bag, paths)):
        common.refuse_topics(args)
    if args.dry_run:
        return _show(args, {p: _any(args, p) for p in _counted("read", paths)})
    if not args.output:
        raise ConfigError("-o FOLDER is missing; --dry-run shows what would be read without it")
    folder = Path(args.output)
    if folder.suffix == ".mcap":
        raise ConfigError(
            f"{args.table}: {plural(len(paths), 'recording')} would be written into a folder, and "
            f"{folder} names one session; give -o FOLDER, or one file"
        )
    _refuse_folder(folder)
    tables: dict[Path, Path] = {}
    for path in paths:
        place = folder / f"{_stem(path)}.mcap"
        if place in tables:
            raise ConfigError(
                f"{tables[place]} and {path} would both be written to {place}; import one of them "
                "apart"
            )
        tables[place] = path
    found = {p: _any(args, tables[p]) for p in _counted("read", list(tables))}
    _refuse_robots(found)
    return _write_all(args, folder, found, tables)


def _any(args: argparse.Namespace, path: Path) -> Imported:
    """What a table or a bag holds."""
    if is_bag(path):
        _refuse_of_tables(args, path)
        return _of_bag(args, path)
    constants = common.torque_constants(args.torque_constant)
    table, mapping = _source(str(path), args.map, constants)
    return _read(args, table, mapping, args.which)


def _stem(path: Path) -> str:
    """Name of a file without its endings; of a folder its name."""
    if path.is_dir():
        return path.name
    return Path(path.stem).stem if path.suffix.lower() in PACKED else path.stem


def _refuse_robots(found: Mapping[Path, Imported]) -> None:
    """Refuse recordings of several robots: they share one model."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for path, one in found.items():
        groups.setdefault(one.recordings[0].joints, []).append(path.stem)
    if len(groups) > 1:
        rows = [f"{', '.join(names)}: {', '.join(joints)}" for joints, names in groups.items()]
        raise ConfigError(
            f"the files are of {len(groups)} robots, by their joints: {'; '.join(rows)}. Import "
            "those of one robot at a time, or give the joints that all have with --joints"
        )


def _write_all(
    args: argparse.Namespace,
    folder: Path,
    found: Mapping[Path, Imported],
    tables: Mapping[Path, Path],
) -> int:
    """Write sessions, each of its table, and one model into a folder."""
    _refuse_urdf(folder / "model.toml", next(iter(found.values())).recordings)
    outputs.make_folder(folder)
    for path, table in tables.items():
        outputs.check(path, ".mcap", _inputs(args, table))
    for path in _counted("write", list(found), 0.9, 1.0):
        _write(path, found[path], tables[path], args.tag)
    model = _model(folder / "model.toml", next(iter(found.values())).recordings)
    if args.json:
        text = json.dumps(every_as_dict(found, model)) + "\n"
    else:
        text = terminal.sentences(every(folder, found, *model))
    terminal.write_stdout(text)
    return 0


def _refuse_folder(folder: Path) -> None:
    """Refuse a place where no folder can be made, before the runs are read."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError(
            f"cannot write into {folder}: several sessions (several files, or --all-runs) need a "
            "folder"
        )


def _counted(
    what: str, items: list[_Item], first: float = 0.0, last: float = 0.9
) -> Iterator[_Item]:
    """Items, while progress says how many lie behind: from a share of all work to another."""
    for k, item in enumerate(items):
        work.at(f"{what} {k + 1} of {len(items)}", first + (last - first) * k / len(items))
        yield item


def _read(args: argparse.Namespace, table: Path, mapping: TableMap | None, which: str) -> Imported:
    found = import_table(
        table,
        mapping,
        urdf=args.robot,
        tip=args.tip,
        force_axes=args.force_axes,
        arm=args.arm,
        run=which,
        unit=axes_unit(args.unit, ["deg"]),
        torque_constant=common.torque_constants(args.torque_constant),
        missing=args.missing,
        rate_hz=args.rate,
        joints=common.bag_joints(args),
        lock=common.bag_locks(args),
    )
    for recording in found.recordings:
        if not recording.robot.urdf:
            make_robot(recording.robot, recording)  # refuses an unknown preset, or another robot
    return found


#: How the note begins on a table that is shown by a map that does not exist yet.
GUESSED = "guessed"


def _guessed(args: argparse.Namespace, table: Path, mapping: TableMap | None) -> Imported:
    """A table as an import would read it; one of other names by the map that they propose."""
    try:
        return _read(args, table, mapping, args.which)
    except (DataError, ConfigError) as error:
        if mapping is not None:
            raise
        opened = open_table(table, run=args.which)
        found = _proposal(args, opened)
        if found is None:
            raise
        if "has no column" not in str(error):
            _show_guess(args, opened, found)
            raise
        if found.missing:
            _show_guess(args, opened, found)
            raise ConfigError(
                f"table {table}: no column's name says what is {' or '.join(found.missing)}. It "
                f"has: {', '.join(families(list(opened.names)))}. '{_to_propose(table)}' writes "
                "what was understood as a map, to be completed"
            ) from error
    try:
        given = parse_map(parse_toml(found.text), common.torque_constants(args.torque_constant))
        made = _read(args, table, given, args.which)
    except (DataError, ConfigError):
        _show_guess(args, opened, found)
        raise
    note = (
        f"{GUESSED}: the columns have other names than 'hil import' knows, and are shown as their "
        f"names and units say. '{_to_propose(table)}' writes this as a map; check its units and "
        "signs, and give it with --map"
    )
    return replace(made, notes=(note, *made.notes))


def _to_propose(table: Path) -> str:
    """The command that writes the map."""
    return shlex.join(["hil", "import", str(table), "--propose-map", "MAP.toml"])


def _show_guess(args: argparse.Namespace, table: ForeignTable, found: Proposal) -> None:
    """What would be read of a table that cannot be read yet; why not is the error that follows."""
    if args.json:
        return
    columns = {target: Rule({name: 1.0}) for target, name in found.columns.items()}
    order = [target for target, _ in sorted(columns.items(), key=_place)]
    rows = [[n, found.columns[n], table.first.get(found.columns[n], "")] for n in order]
    terminal.out(terminal.table(["column", "would be read from", "first row"], rows, (0, 1)))


def _proposal(args: argparse.Namespace, table: ForeignTable) -> Proposal | None:
    """The map that the names of the columns propose, with the joints of --robot."""
    joints = [j.name for j in free_joints(read_text(Path(args.robot)))] if args.robot else []
    return propose(table.names, joints, table.first)


def _propose(args: argparse.Namespace, path: Path, mapping: TableMap | None) -> int:
    """Write a map from the names of the columns; an existing file is left as it is."""
    if mapping is not None:
        raise ConfigError("--map and --propose-map exclude each other; give one of them")
    place = Path(args.propose_map)
    table = open_table(path, run=args.which)
    found = _proposal(args, table)
    if found is None:
        raise DataError(
            f"table {path}: no column's name says a quantity or a unit. It has: "
            f"{', '.join(families(table.names)[:40])}. Write the map yourself (docs/import.md): "
            '[columns] t = "...", q1 = "...", tau1 = "..."'
        )
    if place.exists():
        raise ConfigError(f"{place} exists; give another name, or delete it first")
    try:
        write_text(place, found.text)
    except OSError as error:
        raise ConfigError(f"cannot write {place}: {error.strerror}") from error
    if args.json:
        lacking = {"missing": list(found.missing), "fill": list(found.fill)}
        said = {"schema": "hil.propose-map/1", "map": str(place), "text": found.text}
        terminal.write_stdout(json.dumps(said | lacking) + "\n")
        return 0
    lacks = ""
    if found.missing:
        lacks = (
            f"\nno column's name says {', '.join(found.missing)}: fill in {', '.join(found.fill)} "
            "under [columns] (docs/import.md)"
        )
    if terminal.settings.quiet:
        terminal.write_stdout(lacks.lstrip("\n") + ("\n" if lacks else ""))
        return 0
    robot = ["--robot", args.robot] if args.robot else []
    words = shlex.join(["hil", "import", str(path), "--map", str(place), *robot, "--dry-run"])
    terminal.write_stdout(f"{found.text}\n{place}: written, check it{lacks}\nnext:\n  {words}\n")
    return 0


#: Rows that `--dry-run` shows.
FIRST_ROWS = 5


def _show(args: argparse.Namespace, found: Mapping[Path, Imported]) -> int:
    """What an import would read; nothing is written."""
    if args.json:
        shown = [_shown(one) for one in found.values()]
        several = {"schema": "hil.import-all/1", "sessions": shown}
        terminal.write_stdout(json.dumps(several if len(shown) > 1 else shown[0]) + "\n")
        return 0
    said = "\n".join(preview(table, one) for table, one in found.items())
    guessed = any(note.startswith(GUESSED) for one in found.values() for note in one.notes)
    how = "" if guessed else "; to write it, give -o S.mcap instead of --dry-run"
    terminal.write_stdout(terminal.sentences(f"{said}nothing was written{how}\n"))
    return 0


def _shown(found: Imported) -> dict[str, object]:
    """`hil import --dry-run --json`."""
    nothing = as_dict(Path(), found, (Path(), False)) | {"session": None, "model": None}
    rules = [{t: dict(r.terms) for t, r in some.items()} for some in found.rules]
    first = [first_rows(r)[1] for r in found.recordings]
    return nothing | {"columns": rules, "first_rows": first}


def preview(table: Path, found: Imported) -> str:
    """Columns as they would be read, the first rows, what was guessed, and the faults."""
    lacking = undescribed(found.recordings[0].robot, found.recordings[0].d)
    parts = [f"note: {lacking}"] if lacking else []
    for k, r in enumerate(found.recordings):
        parts.append(
            f"{table}: arm {r.arm}, {plural(r.n, 'sample')} at {r.rate:.5g} Hz, "
            f"{plural(r.d, 'joint')} ({', '.join(r.joints)})"
        )
        if found.rules:  # of a table; a bag has topics
            rules = sorted(found.rules[k].items(), key=_place)
            rows = [[target, _formula(rule)] for target, rule in rules]
            parts.append(terminal.table(["column", "is read as"], rows, (0, 1)))
        if note := r.metadata.get("note"):
            parts.append(f"taken from {note}")
        parts.append(terminal.table(*first_rows(r), ()))
        parts += [_fault(f) for f in check(r)]
    parts += found.notes
    unused = [n for n in found.unused if n]
    parts += [f"not used: {', '.join(families(unused))}"] if unused else []
    return "\n".join(parts) + "\n"


def _place(item: tuple[str, Rule]) -> tuple[int, int]:
    """Order of columns: time, positions, efforts, the others, each by joint."""
    stem, number = item[0].rstrip("0123456789"), item[0][len(item[0].rstrip("0123456789")) :]
    order = ("t", "q", "qd", "tau", "tauext", "i", "temp")
    return order.index(stem) if stem in order else len(order), int(number or 0)


def _formula(rule: Rule) -> str:
    """E.g. ``0.01745 * pos_deg + 0.1``."""
    terms = [n if w == 1 else f"{w:.6g} * {n}" for n, w in rule.terms.items()]
    return " + ".join([*terms, *([f"{rule.shift:.6g}"] if rule.shift or not terms else [])])


def first_rows(r: Recording) -> tuple[list[str], list[list[str]]]:
    """Names of the columns of a recording, with units, and its first rows."""
    axes = dict(zip(r.joints, joint_units(r), strict=True))
    every = list(columns(r))
    head = ["t [s]", *(f"{name} [{column_unit(name, axes.get(j, ''))}]" for name, j, _ in every)]
    values = np.column_stack([r.t, *(v for _, _, v in every)])[:FIRST_ROWS]
    return head, [[f"{row[0]:.13g}", *(f"{x:.6g}" for x in row[1:])] for row in values]


def _source(
    table: str, mapping: str | None, torque_constant: Sequence[float] = ()
) -> tuple[Path, TableMap | None]:
    """The file, and its map: the given one, or that of a public set."""
    path, known = Path(table), None
    if not path.exists():
        resolved = datasets.resolve(table)
        if resolved:
            path, known = resolved
    if is_dataset(path):
        known = "lerobot"
    name = mapping or known
    return path, read_map(name, torque_constant) if name else None


def _write(output: Path, found: Imported, table: Path, tags: Sequence[str]) -> None:
    """Write beside the output and move into place, so that a failure leaves the old one."""
    first = found.recordings[0]
    source = {"import": {"table": table.name, "run": first.name}}
    same = dict(source["import"])
    source |= {TAGS: tag_record(tags)} if tags else {}
    handle, temporary = tempfile.mkstemp(suffix=".mcap", dir=output.parent or ".")
    os.close(handle)
    try:
        if shift := first.metadata.get("time_shift_s"):
            source["import"]["time_shift_s"] = shift
        source["import"] |= _began(first, table)
        write_recordings(temporary, found.recordings, source, found.extras)
        mask = os.umask(0)
        os.umask(mask)
        Path(temporary).chmod(0o666 & ~mask)
        outputs.keep_unless(output, "import", same)
        Path(temporary).replace(output)
    except OSError as error:
        raise ConfigError(f"cannot write {output}: {error.strerror}") from error
    finally:
        Path(temporary).unlink(missing_ok=True)


def _began(first: Recording, table: Path) -> dict[str, str]:
    """When the recording began, where its own times do not say it; else when the table changed."""
    if epoch_unit(float(first.t[0])) == "s":
        return {}
    if BEGAN in first.metadata:
        return {BEGAN: first.metadata[BEGAN], BEGAN_BY: "stamps"}
    return {BEGAN: f"{changed(table):.3f}", BEGAN_BY: "table"}


def _refuse_urdf(model: Path, recordings: tuple[Recording, ...]) -> None:
    """Refuse, before anything is written, a new model whose URDF would replace another robot."""
    if not model.exists():
        outputs.refuse_urdf(model, recordings[0].robot.urdf)


def _model(path: Path, recordings: tuple[Recording, ...]) -> tuple[Path, bool]:
    """Path of the model beside the session, and whether it was written now."""
    if path.exists():
        return path, False
    write_model(base_model(recordings[0].robot), path)
    return path, True
