"""Every way into the program: sources as labs have them, the command that takes them, the result.

One motion is written by the libraries that own the formats, brought in by the program as a user
types it, and compared with what was written.  Public recordings are taken where they are.  Ways out
and devices are tried in the same way: a model for another program, an arm of another make.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import hil
from hil import terminal
from hil.models.files import write_model
from hil.models.model import Range, RobotModel, Use, Value
from hil.models.robots import bare_robot
from hil.record.datasets import VARIABLE
from hil.record.export import write_recordings
from hil.record.recording import RobotSource
from hil.rigs import rig_path
from hil.terminal import Found

FloatArray = NDArray[np.float64]
N_SAMPLES, _HZ = 2000, 500.0
#: Joints of the motion, in the order of the robot.
_JOINTS = ("shoulder", "elbow")


@dataclass(frozen=True)
class Door:
    """One kind of source.

    Parameters
    ----------
    name : str
        What a lab calls it.
    make : callable
        Writes it into a folder; gives the words of the import, or the recording itself.
    needs : str
        Module that writes it, where that is none of the program's own.
    """

    name: str
    make: Callable[[Path], list[str] | Any]
    needs: str = ""


@dataclass(frozen=True)
class DoorRow:
    """What came out.

    Parameters
    ----------
    name, typed : str
        Source, and what was typed.
    seconds : float
        Time of the whole command [s]; NaN where it did not run.
    out : str
        What came out.
    good : bool
        Whether that is what was written; None where it was read and there is nothing to compare
        with, or where it did not run.
    source : bool
        Whether something comes in; a way out, or a device, otherwise.
    """

    name: str
    typed: str
    seconds: float
    out: str
    good: bool | None
    source: bool = True


def door_motion() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Time (n,) [s], positions, speeds and efforts (n, 2)."""
    t = np.arange(N_SAMPLES) / _HZ
    w = 2 * np.pi * np.array([0.7, 1.1])
    q, qd = np.sin(np.outer(t, w)), w * np.cos(np.outer(t, w))
    return t, q, qd, 2.0 * q + 0.3 * qd


_URDF = "".join(
    [
        '<robot name="arm"><link name="base"/>',
        *(
            f'<link name="{n}"><inertial><origin xyz="0 0 0.1"/><mass value="{m}"/>'
            '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>'
            for n, m in (("upper", 1.0), ("fore", 0.5), ("left", 0.05), ("right", 0.05))
        ),
        *(
            f'<joint name="{n}" type="{k}"><parent link="{a}"/><child link="{b}"/>'
            '<origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>'
            f'<limit lower="-3" upper="3" effort="9" velocity="20"/>{more}</joint>'
            for n, k, a, b, more in (
                ("shoulder", "revolute", "base", "upper", ""),
                ("elbow", "revolute", "upper", "fore", ""),
                ("finger", "prismatic", "fore", "left", ""),
                ("finger2", "prismatic", "fore", "right", '<mimic joint="finger"/>'),
            )
        ),
        "</robot>",
    ]
)


def columns(deg: bool = False) -> dict[str, FloatArray]:
    """The motion as columns of a table."""
    t, q, qd, tau = door_motion()
    f = 180.0 / np.pi if deg else 1.0
    out = {"t": t}
    for stem, x in (("q", f * q), ("qd", f * qd), ("tau", tau)):
        out |= {f"{stem}{k + 1}": x[:, k] for k in range(2)}
    return out


def _text(folder: Path, name: str, data: Mapping[str, Any], between: str = ",", **more: Any) -> str:
    rows = zip(*(list(v) for v in data.values()), strict=True)
    mark = more.get("decimal", ".")

    def cell(x: Any) -> str:
        return x if isinstance(x, str) else repr(float(x)).replace(".", mark)

    lines = [between.join(data), *(between.join(map(cell, row)) for row in rows)]
    (folder / name).write_text("\n".join(lines) + "\n", encoding=more.get("encoding", "utf-8"))
    return name


def _semicolons(folder: Path) -> list[str]:
    return [_text(folder, "run.csv", columns(), ";", decimal=",")]


def _dates(folder: Path) -> list[str]:
    data: dict[str, Any] = columns()
    start = np.datetime64("2026-03-01T12:00:00")
    stamps = start + np.round(data.pop("t") * 1e6).astype("timedelta64[us]")
    return [_text(folder, "run.csv", {"time": [f"{s}Z" for s in stamps], **data})]


def _currents(folder: Path) -> list[str]:
    data = columns()
    data |= {f"tau{k}": data[f"tau{k}"] / 12.5 for k in (1, 2)}
    return [_text(folder, "run.csv", data), "--torque-constant", "12.5"]


def _missing(folder: Path) -> list[str]:
    data: dict[str, Any] = columns()
    data["tau2"] = ["" if k in (700, 701) else repr(float(x)) for k, x in enumerate(data["tau2"])]
    return [_text(folder, "run.csv", data), "--missing", "interpolate"]


def _drive(folder: Path) -> list[str]:
    own = {"time_ms": "t", "a_rev": "q1", "b_rev": "q2", "a_Nmm": "tau1", "b_Nmm": "tau2"}
    scale = {"t": 1e3, "q1": 1 / (2 * np.pi), "q2": 1 / (2 * np.pi), "tau1": 1e3, "tau2": 1e3}
    (folder / "drive.toml").write_text(
        '[columns]\nt = "time_ms"\nq1 = "a_rev"\nq2 = "b_rev"\ntau1 = "a_Nmm"\ntau2 = "b_Nmm"\n'
        '[units]\nt = "ms"\nq = "rev"\ntau = "N mm"\n'
    )
    data = {name: columns()[of] * scale[of] for name, of in own.items()}
    return [_text(folder, "run.csv", data), "--map", "drive.toml"]


def _gripper(folder: Path) -> list[str]:
    (folder / "arm.urdf").write_text(_URDF)
    data = columns()
    turned = {"1": "2", "2": "1"}
    data = {n[:-1] + turned.get(n[-1], n[-1]): v for n, v in data.items()}
    words = ["--robot", "arm.urdf", "--joints", "elbow,shoulder", "--lock", "finger=0.02"]
    return [_text(folder, "run.csv", data), *words]


def _npz(folder: Path) -> list[str]:
    arrays: dict[str, Any] = columns()
    np.savez(folder / "run.npz", **arrays)
    return ["run.npz"]


def _npy(folder: Path) -> list[str]:
    data = columns()
    np.save(folder / "run.npy", np.stack(list(data.values()), axis=1))
    names = ", ".join(f'"{n}"' for n in data)
    (folder / "names.toml").write_text(f"[table]\ncolumns = [{names}]\n")
    return ["run.npy", "--map", "names.toml"]


def _mat(folder: Path) -> list[str]:
    from scipy.io import savemat

    savemat(folder / "run.mat", columns())
    return ["run.mat"]


def _hdf5(folder: Path) -> list[str]:
    import h5py

    with h5py.File(folder / "run.h5", "w") as file:
        for name, column in columns().items():
            file[f"log/{name}"] = column
    return ["run.h5"]


def _parquet(folder: Path) -> list[str]:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table(columns()), folder / "run.parquet")
    return ["run.parquet"]


def _feather(folder: Path) -> list[str]:
    import pyarrow as pa
    from pyarrow import feather

    feather.write_feather(pa.table(columns()), folder / "run.feather")
    return ["run.feather"]


def _xlsx(folder: Path) -> list[str]:
    from openpyxl import Workbook

    book = Workbook()
    sheet = book.active
    data = columns()
    sheet.append(list(data))
    for row in zip(*(v.tolist() for v in data.values()), strict=True):
        sheet.append(row)
    book.save(folder / "run.xlsx")
    return ["run.xlsx"]


def _lerobot(folder: Path) -> list[str]:
    import pyarrow as pa
    from pyarrow import parquet

    place = folder / "set" / "data" / "chunk-000"
    place.mkdir(parents=True)
    (folder / "set" / "meta").mkdir()
    (folder / "set" / "meta" / "info.json").write_text(json.dumps({"codebase_version": "v3.0"}))
    t, q, _, tau = door_motion()
    told = {"observation.state": q.tolist(), "observation.effort": tau.tolist(), "timestamp": t}
    table = pa.table({**told, "episode_index": np.zeros(N_SAMPLES, int)})
    parquet.write_table(table, place / "file-000.parquet")
    return ["set"]


def _log(map_name: str, *heads: str) -> Callable[[Path], list[str]]:
    """Log of a known program: heads of time (with its factor), positions, speeds, efforts."""

    def make(folder: Path) -> list[str]:
        t, q, qd, tau = door_motion()
        time_head, _, factor = heads[0].partition("*")
        data = {time_head: t * float(factor or 1.0)}
        for head, x in zip(heads[1:], (q, qd, tau), strict=True):
            first = 1 if "{1}" in head else 0
            data |= {head.replace(f"{{{first}}}", str(k + first)): x[:, k] for k in range(2)}
        return [_text(folder, "log.csv", data), "--map", map_name]

    return make


def _bag(kind: str) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        return [_written(folder, kind)]

    return make


def _written(folder: Path, kind: str) -> str:
    """A bag with the joints in another order than the robot's, and the robot."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    first = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_JAZZY)
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    name = "run.bag" if first else "run"
    writer: Any = (
        Writer1(folder / name)
        if first
        else Writer2(folder / name, version=9, storage_plugin=plugin)
    )
    pack = store.serialize_ros1 if first else store.serialize_cdr
    state, header, stamp, string = (
        store.types[n]
        for n in (
            "sensor_msgs/msg/JointState",
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
            "std_msgs/msg/String",
        )
    )
    t, q, qd, tau = door_motion()
    start, names, more = 1_700_000_000_000_000_000, list(_JOINTS[::-1]), {"seq": 0} if first else {}
    with writer:
        joints = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        robot = writer.add_connection("/robot_description", string.__msgtype__, typestore=store)
        writer.write(robot, start, pack(string(_URDF), string.__msgtype__))
        for k in range(N_SAMPLES):
            ns = start + round(t[k] * 1e9)
            head = header(stamp=stamp(ns // 10**9, ns % 10**9), frame_id="", **more)
            rows = (x[k, ::-1].copy() for x in (q, qd, tau))
            writer.write(joints, ns, pack(state(head, names, *rows), state.__msgtype__))
    return name


def _frame(library: str) -> Callable[[Path], Any]:
    def make(folder: Path) -> Any:
        frames = importlib.import_module(library)
        return hil.from_arrays(frames.DataFrame(columns()))

    return make


def _arrays(folder: Path) -> Any:
    t, q, qd, tau = door_motion()
    return hil.from_arrays(t, q, tau, qd=qd)


DOORS: tuple[Door, ...] = (
    Door("CSV", lambda f: [_text(f, "run.csv", columns())]),
    Door("CSV, semicolons and decimal commas", _semicolons),
    Door("TSV", lambda f: [_text(f, "run.tsv", columns(), "\t")]),
    Door("text in UTF-16", lambda f: [_text(f, "run.csv", columns(), encoding="utf-16")]),
    Door("degrees", lambda f: [_text(f, "run.csv", columns(deg=True)), "--unit", "deg"]),
    Door("ISO dates", _dates),
    Door("motor currents", _currents),
    Door("missing values", _missing),
    Door("a drive's own names and units", _drive),
    Door("columns in another order, robot with a gripper", _gripper),
    Door("NPZ", _npz),
    Door("NPY", _npy),
    Door("MATLAB", _mat),
    Door("HDF5", _hdf5, "h5py"),
    Door("Parquet", _parquet, "pyarrow"),
    Door("Feather", _feather, "pyarrow"),
    Door("Excel", _xlsx, "openpyxl"),
    Door("LeRobot data set", _lerobot, "pyarrow"),
    Door("libfranka log", _log("libfranka", "time*1e3", "state.q[{0}]", "state.dq[{0}]",
                               "state.tau_J[{0}]")),
    Door("ur_rtde record", _log("ur-rtde", "timestamp", "actual_q_{0}", "actual_qd_{0}",
                                "actual_current_as_torque_{0}")),
    Door("dVRK capture", _log("dvrk", "TIMESTAMP", "POSITION_FEEDBACK_{1}",
                              "VELOCITY_FEEDBACK_{1}", "TORQUE_FEEDBACK_{1}")),
    Door("ROS 2 bag, MCAP", _bag("mcap"), "rosbags"),
    Door("ROS 2 bag, SQLite", _bag("db3"), "rosbags"),
    Door("ROS 1 bag", _bag("bag"), "rosbags"),
    Door("NumPy arrays", _arrays),
    Door("pandas frame", _frame("pandas"), "pandas"),
    Door("polars frame", _frame("polars"), "polars"),
)  # fmt: skip
#: Public recordings: name, words of the command; a path below the folder of recordings has an @.
PUBLIC = (
    ("EMPS, a prismatic drive", ("import", "emps/DATA_EMPS.mat", "-o", "s.mcap")),
    ("UR10, ROS 2 bag and its URDF", (
        "compare", "@ros2_bags/ur10_exciting_trajectory.db3", "--robot", "@ur10/robot.urdf")),
    ("Panda, ROS 2 bag with other joint names than the stock URDF's", (
        "compare", "@ros2_bags/panda_exciting_trajectory.db3", "--robot",
        "@panda_30hz/robot.urdf")),
)  # fmt: skip


#: A stiffness [N m/rad], and the friction of a presliding law in steady sliding [N m].
_STIFFNESS, _SLIDING = 1.5, (0.04, 0.03, 0.02, 0.01)


@dataclass(frozen=True)
class WayOut:
    """A way out of the house, or a device that it drives.

    Parameters
    ----------
    name : str
        What it is.
    words : callable
        Writes what the command needs into a folder; gives its words.
    look : callable
        ``look(folder)`` tells what came out, and whether it is right.
    needs : str
        Module without which it does not run.
    """

    name: str
    words: Callable[[Path], list[str]]
    look: Callable[[Path], tuple[str, bool]]
    needs: str = ""


def _model(folder: Path, *uses: Use) -> None:
    """The arm with its description's masses and some effects as a file, its motion as a session."""
    source = RobotSource("", _URDF.replace('type="prismatic"', 'type="fixed"'))
    robot = bare_robot(source, _JOINTS)
    friction = [
        Use(n, ("shoulder",), values={f"j1.{n}.{p}": Value(v, unit=u)})
        for n, p, v, u in (("coulomb", "fc", 0.1, "N m"), ("viscous", "fv", 0.2, "N m s/rad"))
    ]
    valid = tuple(Range(j, (-1.0, 1.0), (-7.0, 7.0), (-9.0, 9.0)) for j in _JOINTS)
    model = RobotModel(source, (Use("rigid-body"), *friction, *uses), valid=valid)
    write_model(model, folder / "m.toml")
    t = np.arange(N_SAMPLES) / _HZ
    w = 2 * np.pi * np.array([[0.35, 0.9, 1.7], [0.5, 1.1, 2.3]])
    size = np.array([0.5, 0.25, 0.1])
    q, qd, qdd = (
        np.stack([f(np.outer(t, row)) @ (size * row**k) for row in w], axis=1)
        for f, k in ((np.sin, 0), (np.cos, 1), (lambda x: -np.sin(x), 2))
    )
    tree: Any = robot.tree
    tau = tree.regressor(q, qd, qdd) @ (tree.spread @ robot.prior)
    tau[:, 0] += 0.1 * np.sign(qd[:, 0]) + 0.2 * qd[:, 0]
    tau[:, 1] += _STIFFNESS * q[:, 1]
    tau += 1e-3 * np.random.default_rng(1).standard_normal(tau.shape)
    run = replace(hil.from_arrays(t, q, tau, qd=qd, joints=_JOINTS), robot=source)
    write_recordings(folder / "s.mcap", [run])


def _spring(folder: Path) -> list[str]:
    _model(folder, Use("spring", ("elbow",)))
    return ["export", "m.toml", "--to", "sdf", "-o", "arm.sdf", "--data", "s.mcap", "--feasible"]


def _stiffness(folder: Path) -> tuple[str, bool]:
    found = ET.parse(folder / "arm.sdf").find(".//joint[@name='elbow']//spring_stiffness")
    k = float(found.text or 0.0) if found is not None else 0.0
    said = f"spring_stiffness {k:.3f} N m/rad, that of the motion is {_STIFFNESS}"
    return said, abs(k - _STIFFNESS) < 0.02 * _STIFFNESS


def _presliding(folder: Path) -> list[str]:
    values = dict(zip(("f0", "f1", "f2", "f3"), _SLIDING, strict=True))
    values |= {"s": 1e-3, "form": 1.0, "v0": 0.01, "vs": 0.0}
    told = {f"j2.presliding.{k}": Value(v) for k, v in values.items()}
    _model(folder, Use("presliding", ("elbow",), values=told))
    return ["export", "m.toml", "--to", "urdf", "-o", "arm.urdf"]


def _friction(folder: Path) -> tuple[str, bool]:
    found = ET.parse(folder / "arm.urdf").find("joint[@name='elbow']/dynamics")
    f = float(found.get("friction", 0.0)) if found is not None else 0.0
    said = f"friction {f:.3f} N m, that of the law in steady sliding is {sum(_SLIDING):.3f}"
    return said, abs(f - sum(_SLIDING)) < 0.01 * sum(_SLIDING)


def _inverse(folder: Path) -> tuple[str, bool]:
    run = hil.load(folder / "s.mcap")
    held = float(np.ptp(run.q, axis=0).max())
    said = f"joints {', '.join(run.joints)}, {run.n} samples; the cursor stays within {held:.0e} m"
    return said, run.joints == ("x", "y", "z") and run.n == 1000 and 0.0 < held < 5e-3


def _uldaq(folder: Path) -> list[str]:
    text = rig_path("teleop").read_text("utf-8")
    text = text.replace('driver = "usb-quad08"', 'driver = "usb-quad08"\noptions.route = "uldaq"')
    (folder / "rig.toml").write_text(text)
    return ["devices", "rig.toml"]


WAYS: tuple[WayOut, ...] = (
    WayOut("SDF, a joint with a spring", _spring, _stiffness),
    WayOut(
        "URDF without data, presliding in the place of Coulomb friction", _presliding, _friction
    ),
    WayOut(
        "Haply Inverse3 at its simulated service",
        lambda folder: ["run", "inverse3", "--seconds", "1", "-o", "s.mcap"],
        _inverse,
        "websockets",
    ),
    WayOut(
        "USB-QUAD08 by the vendor's library",
        _uldaq,
        lambda folder: ("the rig's boxes are listed", True),
        "uldaq",
    ),
)


def study(done: Callable[[], object] = lambda: None) -> Iterator[DoorRow]:
    """Every door, then the public recordings where they are."""
    for door in DOORS:
        if door.needs and importlib.util.find_spec(door.needs) is None:
            yield DoorRow(door.name, "-", float("nan"), f"{door.needs} is not installed", None)
        else:
            with tempfile.TemporaryDirectory() as folder:
                yield _through(door, Path(folder))
        done()
    for name, words in PUBLIC:
        yield _public(name, words)
        done()
    for way in WAYS:
        with tempfile.TemporaryDirectory() as folder:
            yield _went(way, Path(folder))
        done()


def steps() -> int:
    """How often `study` says that one is done."""
    return len(DOORS) + len(PUBLIC) + len(WAYS)


def _went(way: WayOut, folder: Path) -> DoorRow:
    words = way.words(folder)
    if way.needs and importlib.util.find_spec(way.needs) is None:
        missing = f"{way.needs} is not installed"
        return DoorRow(way.name, _shown(words), float("nan"), missing, None, False)
    seconds, code, said = _typed(words, folder)
    good = code == 0
    if good:
        said, good = way.look(folder)
    return DoorRow(way.name, _shown(words), seconds, said, good, False)


def _through(door: Door, folder: Path) -> DoorRow:
    began = time.perf_counter()
    made = door.make(folder)
    if not isinstance(made, list):
        seconds = time.perf_counter() - began
        source = door.name.partition(" ")[0]
        typed = "hil.from_arrays(t, q, tau)" if source == "NumPy" else "hil.from_arrays(frame)"
        return _compared(door.name, typed, seconds, made)
    words = ["import", *made, "-o", "s.mcap"]
    seconds, code, said = _typed(words, folder)
    if code:
        return DoorRow(door.name, _shown(words), seconds, said, False)
    return _compared(door.name, _shown(words), seconds, hil.load(folder / "s.mcap"))


def _compared(name: str, typed: str, seconds: float, run: Any) -> DoorRow:
    """A recording beside the motion that was written."""
    t, q, qd, tau = door_motion()
    size = (run.n, run.d) == q.shape
    pairs = [(run.q, q), (run.tau, tau), *([] if run.qd is None else [(run.qd, qd)])]
    far = max((float(np.abs(a - b).max()) for a, b in pairs), default=0.0) if size else float("inf")
    late = float(np.abs(run.t - run.t[0] - t).max()) if size else float("inf")
    exact = "values exact" if not far else f"values within {far:.0e}"
    out = f"{run.d} joints, {run.n} samples; {exact}, times within {late:.0e} s"
    return DoorRow(name, typed, seconds, out, size and far < 5e-4 and late < 2e-6)


def _public(name: str, words: tuple[str, ...]) -> DoorRow:
    """A public recording; what came out is the program's own first line."""
    place = os.environ.get(VARIABLE, "")
    shown = _shown([w.removeprefix("@") for w in words])
    if not place:
        return DoorRow(name, shown, float("nan"), f"{VARIABLE} names no folder", None)
    found = [str(Path(place) / w[1:]) if w.startswith("@") else w for w in words]
    with tempfile.TemporaryDirectory() as folder:
        seconds, code, said = _typed(found, Path(folder))
    return DoorRow(name, shown, seconds, said, False if code else None)


def _typed(words: list[str], folder: Path) -> tuple[float, int, str]:
    """Time of a whole command, its exit code, and the first line that it says of the data."""
    path = os.pathsep.join(p for p in (str(Path(hil.__file__).parents[1]), *sys.path) if p)
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "hil", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    seconds = time.perf_counter() - began
    text = done.stderr if done.returncode else f"{done.stderr}\n{done.stdout}"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    first = lines[0].replace(f"{folder}{os.sep}", "") if lines else ""
    return seconds, done.returncode, first[:160]


def _shown(words: list[str]) -> str:
    return shlex.join(["hil", *words])


_HEAD = ("source", "typed", "s", "what came out", "right")


def _cells(rows: list[DoorRow]) -> list[list[str]]:
    """Rows of the table."""
    marks = {True: "yes", False: "NO"}
    out = []
    for r in rows:
        seconds = "-" if r.seconds != r.seconds else f"{r.seconds:.1f}"
        mark = "-" if seconds == "-" else "read" if r.good is None else marks[r.good]
        out.append([r.name, r.typed, seconds, r.out, mark])
    return out


def page(rows: list[DoorRow], command: str) -> str:
    """Page for the documentation."""
    into, others = ([r for r in rows if r.source is way] for way in (True, False))
    marks = [row[-1] for row in _cells(into)]
    compared = marks.count("yes") + marks.count("NO")
    lines = [
        "# Doors: what comes in, and how",
        "",
        f"Printed by `{command}`: {marks.count('yes')} of {compared} sources come in as they "
        f"were written, {marks.count('read')} public recordings are read.",
        "",
        "One motion of two joints is written by the libraries that own the formats and brought in "
        "by the command as",
        "it is typed; its values and times are compared with what was written. *s* is the whole "
        "command. Public",
        f"recordings are taken from the folder that `{VARIABLE}` names; of those the first line "
        "of the answer is shown.",
        "",
        *_table(into),
        "",
        "## What goes out, and what is driven",
        "",
        "Models are exported for another program and read back; a device is driven at its "
        "simulated end.",
        "",
        *_table(others),
    ]
    return "\n".join([*lines, ""])


def _table(rows: list[DoorRow]) -> list[str]:
    lines = ["| " + " | ".join(_HEAD) + " |", "|" + "---|" * len(_HEAD)]
    for row in _cells(rows):
        row[1] = f"`{row[1]}`"
        lines.append("| " + " | ".join(x.replace("|", "\\|") for x in row) + " |")
    return lines


def command(args: argparse.Namespace) -> Found:
    """Sources as labs have them, the command that takes each, and what comes out."""
    terminal.check_page(args.report)
    with tqdm(total=steps(), unit="source", disable=not sys.stderr.isatty()) as bar:
        rows = list(study(bar.update))
    terminal.write_page(args.report, page(rows, "hil bench doors"))
    text = terminal.table(list(_HEAD), _cells(rows), (0, 1, 3, 4))
    return text, {"doors": [terminal.json_value(asdict(r)) for r in rows]}
