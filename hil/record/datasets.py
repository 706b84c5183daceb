"""Public recordings that tests and benchmarks use; the files are not part of the package.

The environment variable `HIL_DATA` names the folder that holds them, one folder a set.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from hil.errors import DataError, unknown
from hil.record.mapfile import read_map
from hil.record.recording import Recording
from hil.record.table_files import run_names
from hil.record.tables import import_table

VARIABLE = "HIL_DATA"


@dataclass(frozen=True)
class Dataset:
    """A public set of recordings.

    Parameters
    ----------
    name, title : str
        Short name and description.
    source : str
        Public repository, commit and folder.
    licence : str
        Licence as published.
    folder : str
        Folder under the one that the environment variable names.
    mapping : str
        Built-in map; ``""`` where columns bear their own names.
    sha256 : mapping of str to str
        Checksum of each file.
    tables : tuple of str
        Files that can be imported.
    """

    name: str
    title: str
    source: str
    licence: str
    folder: str
    mapping: str
    sha256: Mapping[str, str]
    tables: tuple[str, ...]


def _read() -> dict[str, Dataset]:
    """The sets that ``datasets.toml`` lists, by name."""
    text = resources.files("hil.record").joinpath("datasets.toml").read_text("utf-8")
    return {
        name: Dataset(
            name=name,
            title=entry["title"],
            source=" ".join(entry["source"].split()),
            licence=entry["licence"],
            folder=entry["folder"],
            mapping=entry["map"],
            sha256=entry["sha256"],
            tables=tuple(entry["tables"]),
        )
        for name, entry in tomllib.loads(text).items()
    }


DATASETS = _read()


def path(name: str, file: str) -> Path:
    """Local copy of a file of a set, its checksum verified.

    Raises
    ------
    DataError
        If the set or file is unknown, is not there, or differs from the published one.
    """
    if name not in DATASETS:
        raise DataError(unknown("data set", name, DATASETS))
    data = DATASETS[name]
    if file not in data.sha256:
        raise DataError(f"data set {name!r}: " + unknown("file", file, data.sha256))
    root = os.environ.get(VARIABLE, "")
    local = Path(root) / data.folder / file
    if not root or not local.is_file():
        state = f"is not at {local}" if root else f"is not found: {VARIABLE} is not set"
        raise DataError(
            f"{file} of {data.title} {state}. Get it from {data.source}, put it into "
            f"<folder>/{data.folder}/ and set {VARIABLE}=<folder>"
        )
    digest = hashlib.sha256(local.read_bytes()).hexdigest()
    if digest != data.sha256[file]:
        raise DataError(
            f"{local} has the checksum {digest}, expected {data.sha256[file]}; "
            f"get the published file from {data.source}"
        )
    return local


def resolve(table: str) -> tuple[Path, str] | None:
    """File and built-in map of a shorthand such as ``emps/DATA_EMPS.mat``, else None.

    Raises
    ------
    DataError
        If it names a file of a set that is not there or differs.
    """
    folder, _, file = table.replace("\\", "/").rpartition("/")
    for data in DATASETS.values():
        if folder in (data.name, data.folder) and file in data.tables:
            return _table(data, file), data.mapping
    return None


def _table(data: Dataset, file: str) -> Path:
    """Local copy of a table, after checking the files that belong to it."""
    for other in data.sha256:
        if other not in data.tables:
            path(data.name, other)
    return path(data.name, file)


def load_set(name: str, part: str = "") -> list[Recording]:
    """Recordings of a set of which every table is one run.

    Parameters
    ----------
    name : str
        The set, such as ``"ur10"``.
    part : str
        First letters of the files to take: ``"train"``, ``"hold"``, ``""`` = all.

    Returns
    -------
    list of Recording
        In the order of the set's table; stamps as recorded, evenly spaced or not.

    Raises
    ------
    DataError
        If the set is unknown, has no such file, or a file is not there or differs.
    """
    if name not in DATASETS:
        raise DataError(unknown("data set", name, DATASETS))
    data = DATASETS[name]
    files = [f for f in data.tables if f.startswith(part)]
    if not files:
        raise DataError(f"data set {name!r}: " + unknown("file", part, data.tables))
    mapping = read_map(data.mapping) if data.mapping else None
    return [import_table(_table(data, f), mapping).recordings[0] for f in files]


def load_emps(pulses: bool = False) -> Recording:
    """EMPS, one linear axis [m, N]: the sine-like record, or the one with pulses."""
    return load_set("emps", "DATA_EMPS_PULSES" if pulses else "DATA_EMPS.")[0]


def tue_runs() -> list[str]:
    """Names of the 55 runs of the TU/e rig, such as ``m2_question1a_foam2``."""
    return run_names(path("tue", "tue_1dof.npz"), read_map("tue-1dof").columns)


def load_tue(run: str) -> dict[str, Recording]:
    """Leader and follower of one run of the TU/e rig [rad, N m].

    Raises
    ------
    DataError
        If there is no such run.
    """
    found = import_table(path("tue", "tue_1dof.npz"), read_map("tue-1dof"), run=run)
    return {r.arm: r for r in found.recordings}


def load_tx40() -> Recording:
    """Staubli TX40, six joints [rad, N m], motor encoders and torques brought to the joints."""
    return load_set("tx40")[0]
