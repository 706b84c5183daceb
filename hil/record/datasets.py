"""Public recordings that tests and benchmarks use; the files are not part of the package.

The environment variable `HIL_DATA` names the folder that holds them, one folder a set.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hil.errors import DataError, unknown
from hil.record.mapfile import read_map
from hil.record.recording import Recording
from hil.record.table import import_table
from hil.record.tablefile import run_names

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
        Built-in map.
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


DATASETS = {
    "emps": Dataset(
        "emps",
        "EMPS: linear drive with friction, 1 kHz (Janot, Gautier, Brunot 2019)",
        "github.com/wmkouw/NSI-EMPS, commit d1137b8cc8a5ec3d75fe69c5d531075f7f6f616a, data/",
        "MIT (repository); data published for nonlinearbenchmark.org, cite Janot et al. 2019",
        "emps",
        "emps",
        {
            "DATA_EMPS.mat": "6cf6814ae14618795da0101aae2bb97ff0c6351b0501b5492751b02b07facf7e",
            "DATA_EMPS_PULSES.mat":
                "0eab75bb1f6b16228ee78791343a88bf9bfd9a51036ac9807d7b5fc11c0e1704",
        },
        ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"),
    ),
    "tue": Dataset(
        "tue",
        "TU/e: bilateral teleoperation with one degree of freedom, 55 runs, 2 kHz",
        "github.com/Ohara124c41/Haptics-Bilateral_Teleoperation-1DOF_Experiments, commit "
        "2ae23ed4f6e6b9726be4153a1f094085124c0c57 (the scope logs of its .mat files, one array "
        "(n, 7) a run)",
        "MIT",
        "tue_1dof_teleop",
        "tue-1dof",
        {"tue_1dof.npz": "3fce1fa32a5bc826a3af63eab148e5139ee5e9de7c6bdc78771dabc7109c0ca8"},
        ("tue_1dof.npz",),
    ),
    "tx40": Dataset(
        "tx40",
        "Staubli TX40: six axes, 9 s at 5 kHz, coupled wrist",
        "github.com/thanhndv212/figaroh-examples, commit "
        "c0b5c7f0fda10078be55104f9ee76ac106b7a5ee, examples/staubli_TX40/",
        "Apache-2.0",
        "tx40",
        "tx40",
        {
            "pos_read_data.csv": "5cc1cecc1024ef0e331d0caba06f689456ab789ec3f1e904599c0a8be5c27bc8",
            "curr_data.csv": "f4592f4ba4db42f5d7625688986be25b575ca34d0504b27979ca6b0276bd3af9",
            "tx40_mdh_modified.urdf":
                "3d00cbd46279c915d594b1bb4610dbac78d1e99ed27f95de70984bde13486074",
        },
        ("pos_read_data.csv",),
    ),
}  # fmt: skip


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
            if len(data.tables) == 1:  # its other files belong to it
                for other in data.sha256:
                    path(data.name, other)
            return path(data.name, file), data.mapping
    return None


def load_emps(pulses: bool = False) -> Recording:
    """EMPS, one linear axis [m, N]: the sine-like record, or the one with pulses."""
    file = path("emps", "DATA_EMPS_PULSES.mat" if pulses else "DATA_EMPS.mat")
    return import_table(file, read_map("emps")).recordings[0]


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
    for file in DATASETS["tx40"].sha256:
        path("tx40", file)
    table = path("tx40", "pos_read_data.csv")
    return import_table(table, read_map("tx40")).recordings[0]
