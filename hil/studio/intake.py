"""What a user brings to the studio: tables that become sessions, and effects of their own.

A table that was dropped has columns, and what was picked for each; the picks are a map as
`hil import --map` reads it, so that the command line can repeat them.

The text of an own effect runs as a Python program with the user's rights.  It runs only in the
process that computes, and only after the user has agreed to this very text.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil import trusted_code
from hil.errors import ConfigError, HilError, with_place
from hil.models import catalogue
from hil.models.robots import make_robot, undescribed
from hil.record.checks import check
from hil.record.export import write_recordings
from hil.record.guess import quantity
from hil.record.mapfile import SCHEMA, parse_map
from hil.record.recording import Recording
from hil.record.table_files import ForeignTable, open_table
from hil.record.tables import Imported, import_table
from hil.record.units import FACTORS, axis_of
from hil.report.data import rounded
from hil.testing.effects import check_effect
from hil.userfile import LARGEST_TEXT, read_bytes, write_text

#: What to do on the page, by the topic of an error (`HilError.about`).
PAGE_ADVICE = {
    "tables": "A table with columns is dropped on the page, or opened by its own path",
    "time": (
        "Say above which column is the time and in what unit, or leave it 'not used' and fill in "
        "Sample rate"
    ),
    "column": "Say above which column it is, with its joint",
    "joints": (
        "Say above which column is the position of each joint, or leave Robot empty; the page "
        "cannot lock a joint"
    ),
    "urdf": "Put the path of one into Robot, or leave it empty",
    "missing": "Cut or repair them, or choose what to do with them under Missing values",
    "faults": "Mend or cut the recording, then bring it in again",
    "trust": "Look at it, then agree to it in the editor, in a text that imports no file beside it",
}
#: Rows of a column that are shown.
_FIRST = 3
#: What a column of a table can be: stem, name on the page, units that are offered, SI first.
_KINDS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("t", "time", tuple(FACTORS["t"])),
    ("q", "position", ("rad", "deg", "rev", "mrad", "m", "mm", "cm")),
    ("tau", "effort", ("Nm", "mNm", "Ncm", "N", "mN", "A", "mA")),
    ("qd", "speed", ("rad/s", "deg/s", "rpm", "rev/s", "m/s", "mm/s")),
    ("i", "motor current", ("A", "mA")),
    ("tauext", "outside effort", ("Nm", "mNm", "N", "mN")),
    ("temp", "temperature", ("degC", "K")),
)
_STEMS = {stem: units for stem, _, units in _KINDS}
_KEYS = {"column", "kind", "joint", "unit", "flip"}


@dataclass(frozen=True)
class Picked:
    """What the page says of a table.

    Parameters
    ----------
    columns : tuple of mapping
        Each ``column``, ``kind`` (a stem of `_KINDS`), ``joint`` (from 1), ``unit``, ``flip``.
    urdf : str
        File of the robot; empty without one.
    constant : str
        Effort by ampere where efforts are currents.
    rate : str
        Sample rate [Hz] where no column is the time.
    missing : str
        As `TableMap.missing`.
    """

    columns: tuple[Mapping[str, Any], ...]
    urdf: str = ""
    constant: str = ""
    rate: str = ""
    missing: str = "refuse"

    @classmethod
    def parse(cls, text: str) -> Picked:
        """Picks from the JSON of a request.

        Raises
        ------
        ConfigError
            If it is none.
        """
        try:
            data = json.loads(text)
        except ValueError as error:
            raise ConfigError(f"the picks are not JSON: {error}") from error
        rows = data.get("columns") if isinstance(data, dict) else None
        if not isinstance(rows, list) or not all(isinstance(r, dict) for r in rows):
            raise ConfigError("the picks are an object with a list 'columns'")
        for row in rows:
            if set(row) != _KEYS or row["kind"] not in _STEMS:
                raise ConfigError(
                    f"a pick has {', '.join(sorted(_KEYS))}, its kind one of "
                    f"{', '.join(_STEMS)}; got {row}"
                )
        words = {k: str(data.get(k, "")).strip() for k in ("urdf", "constant", "rate")}
        return cls(tuple(rows), missing=str(data.get("missing") or "refuse"), **words)

    def table(self) -> dict[str, Any]:
        """The same as tables of a map file.

        Raises
        ------
        ConfigError
            If two columns are picked for one thing, or a number is none.
        """
        columns: dict[str, Any] = {}
        for row in self.columns:
            target = "t" if row["kind"] == "t" else f"{row['kind']}{int(row['joint'])}"
            if target in columns:
                raise ConfigError(
                    f"columns {columns[target]['from']!r} and {row['column']!r} are both picked as "
                    f"{target}; choose another joint or 'not used' for one of them"
                )
            columns[target] = self._rule(row)
        out: dict[str, Any] = {"schema": SCHEMA, "columns": columns}
        placed = sorted(
            (int(r["joint"]), axis_of("q", r["unit"]) or "rad")
            for r in self.columns
            if r["kind"] == "q"
        )
        robot = {"urdf": self.urdf} if self.urdf else {}
        if placed and not self.urdf:
            robot["unit"] = " ".join(axis for _, axis in placed)
        table: dict[str, Any] = {"missing": self.missing}
        if self.rate and "t" not in columns:
            table["rate_hz"] = _float(self.rate, "the sample rate")
        return out | {"table": table} | ({"robot": robot} if robot else {})

    def _rule(self, row: Mapping[str, Any]) -> dict[str, Any]:
        rule: dict[str, Any] = {"from": str(row["column"]), "unit": str(row["unit"])}
        if row["flip"]:
            rule["sign"] = -1
        if row["kind"] == "tau" and row["unit"] in ("A", "mA"):
            if not self.constant:
                raise ConfigError(
                    f"column {row['column']!r} is a current; give the effort by ampere at the "
                    "joint, gear included, below the table"
                )
            rule["torque_constant"] = _float(self.constant, "the effort by ampere")
        return rule


def _float(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{what} is {text!r}; expected a number") from None


def on_page(error: HilError) -> str:
    """The message of an error with what to do on the page.

    Parameters
    ----------
    error : HilError
        The error.
    """
    if error.topic in PAGE_ADVICE:
        return f"{error.what}. {PAGE_ADVICE[error.topic]}."
    return with_place(error)


def shown(path: Path) -> dict[str, Any]:
    """Columns of a table with their first values, range and a first guess of what each is.

    Raises
    ------
    DataError
        If it is no table.
    """
    table = open_table(path)
    guesses = guess(table.names)
    return {
        "file": path.name,
        "kinds": [{"stem": s, "name": n, "units": list(u)} for s, n, u in _KINDS],
        "columns": [_column(table, name, guesses[name]) for name in table.names],
        "output": f"{path.stem}.mcap",
    }


def _column(table: ForeignTable, name: str, guessed: Mapping[str, Any]) -> dict[str, Any]:
    values = table.columns([name])[name]
    fine = values[np.isfinite(values)]
    low, high = (float(fine.min()), float(fine.max())) if fine.size else (np.nan, np.nan)
    return {
        "name": name,
        "first": [rounded(float(v), 5) for v in values[:_FIRST]],
        "low": rounded(low, 4),
        "high": rounded(high, 4),
        "missing": int(values.size - fine.size),
        "guess": guessed,
    }


def guess(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """What each column may be, from its name: kind (empty: not used), joint from 1, unit."""
    counts: dict[str, int] = {}
    out: dict[str, dict[str, Any]] = {}
    for name in names:
        stem, unit = quantity(name)
        if stem == "t" and "t" in counts:
            stem, unit = "", ""
        counts[stem] = counts.get(stem, 0) + 1
        offered = _STEMS.get(stem, ("",))
        out[name] = {
            "kind": stem,
            "joint": counts[stem],
            "unit": unit if unit in offered else offered[0],
        }
    return out


def read_upload(path: Path, picked: Picked) -> Imported:
    """Read the table as it was picked; nothing is written.

    Raises
    ------
    ConfigError, DataError
        As `hil.record.tables.import_table`.
    """
    found = import_table(path, parse_map(picked.table()), urdf=picked.urdf)
    for r in found.recordings:
        if not r.robot.urdf:
            make_robot(r.robot, r)
    return found


def upload_summary(found: Imported) -> dict[str, Any]:
    """What would be read, and what is wrong with it, for the page."""
    r = found.recordings[0]
    faults = [f for x in found.recordings for f in check(x)]
    lacking = undescribed(r.robot, r.d)
    return {
        "text": f"{r.n} samples at {r.rate:.5g} Hz, {r.t[-1] - r.t[0]:.1f} s, "
        f"joints {', '.join(r.joints)}",
        "faults": [{"severity": f.severity, "text": f.sentence} for f in faults],
        "notes": [*found.notes, *([lacking] if lacking else [])],
        "unused": list(found.unused),
        "good": not any(f.severity == "error" for f in faults),
    }


def write_session(
    found: Imported, picked: Picked, table: Path, output: Path
) -> tuple[Recording, str]:
    """Write the session and its map beside it; the recording and the command that repeats it.

    Raises
    ------
    ConfigError
        If a file is there already, or the place cannot be written.
    """
    if output.suffix != ".mcap":
        raise ConfigError(f"cannot write {output}: a session ends in .mcap")
    beside = output.with_suffix(".map.toml")
    for place in (output, beside):
        if place.exists():
            raise ConfigError(f"cannot write {place}: a file is there; choose another name")
    try:
        write_text(beside, _toml(picked.table()))
        write_recordings(output, found.recordings, {"import": {"table": table.name}}, found.extras)
    except OSError as error:
        raise ConfigError(f"cannot write {output}: {error.strerror}") from error
    words = ["hil", "import", table.name, "--map", beside.name, "-o", output.name]
    return found.recordings[0], shlex.join(words)


def _toml(data: Mapping[str, Any]) -> str:
    """A map file; JSON's texts and numbers are TOML's."""
    lines = [f"schema = {json.dumps(data['schema'])}"]
    for name in ("robot", "table", "columns"):
        if entries := data.get(name):
            lines += ["", f"[{name}]", *(f"{k} = {_inline(v)}" for k, v in entries.items())]
    return "\n".join(lines) + "\n"


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_inline(v)}" for k, v in value.items()) + " }"
    return json.dumps(value)


#: Largest text of the editor [character].
_LARGEST = 12_000
TEMPLATE = '''"""One effect of our own."""

from hil.models.effect import Doc, Effect, Param


class EyeletDrag(Effect):
    """A cable that drags over a fixed eyelet."""

    name, family = "eyelet-drag", "friction"
    doc = Doc(
        equation="tau = fe (q - q_low) tanh(v / v0)",
        signature="friction that grows from one end of the range to the other",
        confused_with=("position-friction", "load-friction"),
        shown_by="slow strokes over the whole range, both directions",
        source="where it comes from",
    )
    params = (Param("fe", "{F}/{x}", "friction per wound-up angle", 0.0),)

    def columns(self, motion, j, shape):
        wound = motion.q[:, j] - motion.span[j, 0]
        return (wound * motion.sign(j))[:, None]


EFFECTS = (EyeletDrag(),)
'''


def again(paths: Iterable[str]) -> None:
    """Load the effects that models name into a new process; only what was agreed to runs."""
    for path in paths:
        catalogue.load_plugin(Path(path), said_in=Path(path))


def learn_effects(
    path: Path, text: str, agreed: bool, ours: bool, needed: Collection[str] = ()
) -> list[str]:
    """Write, load and check the effects of an editor; their names.

    Parameters
    ----------
    path : Path
        File to write, ending in ``.py``.
    text : str
        Its content.
    agreed : bool
        Whether the user agreed that this text runs.
    ours : bool
        Whether the file was written by this studio, and may be written over.
    needed : collection of str
        Effects that the models have; a text that no longer holds one of its own is refused.

    Raises
    ------
    ConfigError
        If the user has not agreed, or the file must not be written, holds no effects, or
        lacks one that is needed; the file and the catalogue are as before.
    ConformanceError
        If an effect breaks the contract; the catalogue is as before.
    """
    if not agreed:
        raise ConfigError(
            "this text runs as a program with your rights; agree to it below the editor first"
        )
    if path.suffix != ".py" or not path.stem.isidentifier():
        raise ConfigError(f"cannot write {path}: a file of effects is called NAME.py")
    if len(text) > _LARGEST:
        raise ConfigError(f"the text has {len(text)} characters; at most {_LARGEST} are taken")
    source = text.encode()
    if path.exists() and not ours and read_bytes(path, LARGEST_TEXT) != source:
        raise ConfigError(f"cannot write {path}: a file is there; choose another name")
    trusted_code.give(trusted_code.plugin(path, source))
    # tried before it is written: one that never ends must not be loaded again by the next process
    names = _load(path, source, needed)
    try:
        path.write_bytes(source)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
    return names


def _load(path: Path, source: bytes, needed: Collection[str]) -> list[str]:
    """Names of the effects of a text, checked; the catalogue is as before where one fails."""
    table = catalogue.table()
    before = dict(table)
    module = f"hil_plugin_{path.stem}"
    try:
        for name in [n for n, e in table.items() if type(e).__module__ == module]:
            del table[name]  # an effect that was renamed in the editor
        catalogue.load_text(path, source, said_in=path)
        names = [n for n, e in table.items() if type(e).__module__ == module]
        for name in names:
            check_effect(table[name])
        if gone := sorted(set(needed) & set(before) - set(table)):
            raise ConfigError(
                f"a model has {', '.join(gone)}, which this text no longer holds; keep the name, "
                "or keep the new effect in a file of its own"
            )
    except BaseException:
        table.clear()
        table.update(before)
        raise
    return names
