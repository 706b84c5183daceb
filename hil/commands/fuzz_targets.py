"""Every parser of the program as a target of `hil bench fuzz`: what it is given, and small seeds.

A target does with an input what a command does with a user's file.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from hil import terminal
from hil.bench import fuzz
from hil.bench.diagnosis.runner import resumed, revision
from hil.bench.fuzz import Target
from hil.commands import info
from hil.drivers.netcanoem import codec as netcanoem
from hil.drivers.usb_31xx import codec as usb_31xx
from hil.drivers.usb_quad08 import codec as usb_quad08
from hil.errors import ConfigError, unknown
from hil.excite import trajectory
from hil.models.files import read_model
from hil.models.urdf import UrdfRobot
from hil.record import frames
from hil.record.bags import read_bag
from hil.record.binary_tables import reading_here
from hil.record.checks import check
from hil.record.container import read
from hil.record.export import write_recordings
from hil.record.mapfile import read_map
from hil.record.mcap_read import load_arms
from hil.record.recording import Recording, RobotSource
from hil.record.recovery import recover
from hil.record.tables import import_table
from hil.record.urdf_checks import urdf_joints
from hil.rig.config import RigConfig, load_rig
from hil.rig.operator import Shop
from hil.rigs import rig_path
from hil.runtime import commands, replay
from hil.terminal import Found

#: Samples of a seed: enough for every check, small enough for many inputs a second.
_SAMPLES = 40


def _put(data: bytes, folder: Path, name: str) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def _imported(name: str, data: bytes, folder: Path) -> object:
    """`hil import` of a table, up to the session."""
    found = import_table(_put(data, folder, name))
    write_recordings(folder / "s.mcap", found.recordings, {}, found.extras)
    return [check(r) for r in found.recordings]


def _columns() -> dict[str, np.ndarray]:
    t = np.arange(_SAMPLES) / 500
    q = np.sin(9 * t)
    return {"t": t, "q1": q, "tau1": 3 * q, "qd1": 9 * np.cos(9 * t), "fx": q, "fy": q, "fz": q}


def _csv() -> list[bytes]:
    table = {k: v[:12] for k, v in _columns().items()}
    rows = [[f"{x:.6g}" for x in row] for row in zip(*table.values(), strict=True)]
    plain = "\n".join([",".join(table), *map(",".join, rows)])
    comma = "\n".join([";".join(table), *(";".join(r).replace(".", ",") for r in rows)])
    return [
        plain.encode(),
        comma.encode(),
        ("# " + plain).encode(),
        plain.replace(",", "\t").encode(),
        b't,q1,tau1\n0,"1",2\n0.001,,3\n',
    ]


def _read_here(name: str, data: bytes, folder: Path) -> object:
    """The same without a process for each input, for readers in Python."""
    with reading_here():
        return _imported(name, data, folder)


def _npz() -> list[bytes]:
    out = []
    for save in (np.savez, np.savez_compressed):
        file = io.BytesIO()
        both = np.stack([_columns()["q1"], _columns()["tau1"]], axis=1)
        save(file, **{**_columns(), "x": both, "name": np.array("text")})  # type: ignore[arg-type]
        out.append(file.getvalue())
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as box:
        box.writestr("README.txt", "text")
    return [*out, file.getvalue()]


def _mat() -> list[bytes]:
    from scipy.io import savemat

    table = {**_columns(), "s": {"a": np.arange(9.0)}}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "seed.mat"
        out = []
        for packed in (False, True):
            savemat(str(path), table, do_compression=packed)
            out.append(path.read_bytes())
    return out


def _parquet() -> list[bytes]:
    import pyarrow as pa
    from pyarrow import parquet

    out = []
    for packed in ("none", "zstd"):
        file = io.BytesIO()
        lists = pa.array([[1.0, 2.0]] * _SAMPLES)
        table = pa.table({**_columns(), "state": lists, "word": ["x"] * _SAMPLES})
        parquet.write_table(table, file, compression=packed)
        out.append(file.getvalue())
    return out


def _xlsx() -> list[bytes]:
    from openpyxl import Workbook

    book, file = Workbook(), io.BytesIO()
    for row in [list(_columns()), *zip(*(v.tolist() for v in _columns().values()), strict=True)]:
        book.active.append(row)
    book.save(file)
    return [file.getvalue()]


def _bag(name: str, data: bytes, folder: Path) -> object:
    """`hil import` of a bag in one file; its reader runs here, whose memory and time are limited.

    The process of `read_arrays` costs a second for each input, and hides which lines it reaches.
    """
    return _kept(_put(data, folder, name), folder)


def _kept(bag: Path, folder: Path) -> object:
    with reading_here():
        found = read_bag(bag)
    write_recordings(folder / "bag-session.mcap", found)
    return [check(r) for r in found]


def _bag_folder(data: bytes, folder: Path) -> object:
    """The same of a folder whose ``metadata.yaml`` is the input."""
    bag = folder / "bag"
    if not bag.exists():
        bag.mkdir()
        (bag / "bag.db3").write_bytes(_bags("db3")[0])
    _put(data, bag, "metadata.yaml")
    return _kept(bag, folder)


@cache
def _bags(kind: str) -> tuple[bytes, bytes]:
    """A bag's file, as rosbags writes it, and its ``metadata.yaml``; without one for ROS 1."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    first = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_JAZZY)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "bag"
        if first:
            writer: Any = rosbag1.Writer(path)
        else:
            plugins = rosbag2.StoragePlugin
            plugin = plugins.MCAP if kind == "mcap" else plugins.SQLITE3
            writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        with writer:
            _messages(writer, store, first)
        if first:
            return path.read_bytes(), b""
        return (path / f"bag.{kind}").read_bytes(), (path / "metadata.yaml").read_bytes()


def _messages(writer: Any, store: Any, first: bool) -> None:
    """Joint states of two joints and the description of a robot, in the types of a store."""
    pack = store.serialize_ros1 if first else store.serialize_cdr
    kinds = ("sensor_msgs/msg/JointState", "std_msgs/msg/String")
    state, text = (store.types[k] for k in kinds)
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    topics = ("/joint_states", "/robot_description")
    on = [writer.add_connection(t, k, typestore=store) for t, k in zip(topics, kinds, strict=True)]
    writer.write(on[1], 10**18, pack(text(_FREE), kinds[1]))
    c = _columns()
    for k in range(_SAMPLES):
        values = [np.array([c[n][k]] * 2) for n in ("q1", "qd1", "tau1")]
        stamp = 10**18 + 2_000_000 * k
        own = header(stamp=time(10**9, 2_000_000 * k), frame_id="", **({"seq": k} if first else {}))
        writer.write(on[0], stamp, pack(state(own, ["j", "k"], *values), kinds[0]))


def _bag_seeds(kind: str) -> list[bytes]:
    return [_bags(kind)[0]]


def _metadata() -> list[bytes]:
    return [_bags("db3")[1]]


def _npy() -> list[bytes]:
    file, c = io.BytesIO(), _columns()
    kind = np.dtype([(n, float) for n in c])
    np.save(file, np.rec.fromarrays(list(c.values()), dtype=kind))
    return [file.getvalue()]


def _feather() -> list[bytes]:
    import pyarrow as pa
    from pyarrow import feather

    out = []
    for packed in ("uncompressed", "lz4"):
        file = io.BytesIO()
        feather.write_feather(pa.table(_columns()), file, compression=packed)
        out.append(file.getvalue())
    return out


def _hdf5() -> list[bytes]:
    import h5py

    out = []
    for packed, group in ((None, "log/"), ("gzip", "")):
        file = io.BytesIO()
        with h5py.File(file, "w") as target:
            for name, column in _columns().items():
                target.create_dataset(group + name, data=column, compression=packed)
        out.append(file.getvalue())
    return out


def _gzip() -> list[bytes]:
    return [gzip.compress(data) for data in _csv()]


def _json() -> list[bytes]:
    table = {name: column.tolist() for name, column in _columns().items()}
    rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
    nested = [{"t": row.pop("t"), "state": dict(row), "q": [row["q1"]], **row} for row in rows]
    lines = "\n".join(map(json.dumps, nested))
    return [lines.encode(), *(json.dumps(x).encode() for x in (rows, table, {"a": table}))]


def _map(data: bytes, folder: Path) -> object:
    path, table = _put(data, folder, "map.toml"), _put(_csv()[0], folder, "run.csv")
    return import_table(table, read_map(path))


def _maps() -> list[bytes]:
    files = resources.files("hil.record").joinpath("maps").iterdir()
    own = (
        b'[robot]\nunit = "rad"\narm = "a"\n[table]\ngaps = "keep"\nrate_hz = 500\n[columns]\n'
        b'q1 = { from = "q1", scale = 2, sign = -1, shift = 0.1 }\ntau1 = { sum = { q1 = 0.5 } }\n'
        b'[extras]\nx = { from = "fx", unit = "N" }\n[offsets.run]\ntau1 = -0.3\n'
    )
    return [own, *(f.read_bytes() for f in files if f.name.endswith(".toml"))]


_URDF = (
    '<robot name="r"><link name="a"/><link name="b"><inertial><origin xyz="0 0 1" rpy="0 0 0"/>'
    '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<link name="c"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
    '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    '<joint name="k" type="prismatic"><parent link="b"/><child link="c"/>'
    '<mimic joint="j" multiplier="2" offset="0"/><limit effort="1" velocity="1"/></joint></robot>'
)
#: The same with two free joints.
_FREE = _URDF.replace('<mimic joint="j" multiplier="2" offset="0"/>', "")


def _urdf(data: bytes, folder: Path) -> object:
    text = data.decode("utf-8", "replace")
    urdf_joints(text)
    robot = UrdfRobot(text)
    q = np.zeros((2, len(robot.joints)))
    return robot.tip(q), robot.jacobian(q)


def _urdfs() -> list[bytes]:
    return [_URDF.encode()]


def _model(data: bytes, folder: Path) -> object:
    # what executes is a matter of consent and not of parsing
    return None if b"plugins" in data else read_model(_put(data, folder, "m.toml"))


def _models() -> list[bytes]:
    head = b'schema = "hil.model/1"\n[robot]\npreset = "single-axis"\n'
    value = (
        b'[[effects]]\ntype = "coulomb"\njoints = ["joint1"]\n[effects.parameters]\n'
        b'"j1.coulomb.Fc" = { value = 0.1, stderr = 0.01, unit = "N m", bounds = [0.0, inf] }\n'
    )
    ranges = b"[valid.joint1]\nposition = [0, 1]\nspeed = [0, 1]\nload = [0, 1]\n"
    signal = b"[signal]\nposition_hz = 20.0\neffort_hz = 20\n"
    return [head, head + signal + value + ranges, head + b'explains = "external"\n' + value]


def _rig(data: bytes, folder: Path) -> object:
    return load_rig(_put(data, folder, "rig.toml"))


def _rigs() -> list[bytes]:
    return [rig_path(name).read_bytes() for name in ("teleop", "identify")]


def _trajectory(data: bytes, folder: Path) -> object:
    return trajectory.read_trajectory(_put(data, folder, "t.toml"))


def _trajectories() -> list[bytes]:
    head = b'schema = "hil.trajectory/1"\nname = "x"\njoints = ["joint1"]\nperiod = 2.0\n'
    path = b"[path]\nt = [0.0, 1.0, 2.0]\nblend = [0.1, 0.1, 0.1]\nq = [[0.0], [1.0], [0.0]]\n"
    return [head + path, head + path + b"[fourier]\nsin = [[0.1]]\ncos = [[0.2]]\n"]


def _session(data: bytes, folder: Path) -> object:
    """`hil info` of a session, as text and as JSON, and what is left of it as another one."""
    path, new = _put(data, folder, "s.mcap"), folder / "new.mcap"
    new.unlink(missing_ok=True)
    parser = argparse.ArgumentParser()
    info.configure(parser)
    for words in ([str(path)], [str(path), "--json"]):
        info.run(parser.parse_args(words))
    recover(path, new)
    return [check(r) for r in load_arms(path)]


def _plain_session(path: Path, chunks: bool) -> bytes:
    """A session without compression and checksums, so that a changed byte is read as it is."""
    box, file = read(path), io.BytesIO()
    writer = Writer(
        file,
        compression=CompressionType.NONE,
        enable_crcs=False,
        enable_data_crcs=False,
        use_chunking=chunks,
    )
    writer.start(profile="ros2", library="hil")
    for name, record in box.metadata.items():
        writer.add_metadata(name, record)
    for name, attached in box.attachments.items():
        writer.add_attachment(0, 0, name, "text/plain", attached)
    for topic in box.topics.values():
        schema = writer.register_schema(topic.schema, topic.schema_encoding, topic.schema_text)
        channel = writer.register_channel(topic.name, topic.encoding, schema)
        for k, payload in enumerate(topic.data):
            writer.add_message(channel, topic.times[k], payload, topic.times[k], topic.sequence[k])
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


@cache
def _sessions() -> list[bytes]:
    c = _columns()
    column = {k: v[:, None] for k, v in c.items()}
    wrench = np.zeros((_SAMPLES, 6))
    plain = Recording("s", "arm", ("j",), c["t"], column["q1"], column["tau1"])
    full = Recording(
        "s",
        "arm",
        ("j",),
        c["t"],
        column["q1"],
        column["tau1"],
        column["qd1"],
        wrench,
        column["tau1"],
        robot=RobotSource("", _URDF),
    )
    with tempfile.TemporaryDirectory() as folder:
        out = []
        for k, recording in enumerate((full, plain)):
            write_recordings(Path(folder) / f"{k}.mcap", [recording])
            out.append(_plain_session(Path(folder) / f"{k}.mcap", chunks=bool(k)))
        packed = (Path(folder) / "1.mcap").read_bytes()
        return [*reversed(out), packed, *_replays()[1:]]


def _replay(data: bytes, folder: Path) -> object:
    return replay.played_boxes(read(_put(data, folder, "s.mcap")), folder)


@cache
def _replays() -> list[bytes]:
    """A session of the loop of a few ticks and with a command, packed and plain."""
    from hil.runtime import runner

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s.mcap"
        operator = runner.Operator([(0.005, "pause")], lambda text: None)
        rig = load_rig("teleop")
        runner.run_session(rig, 0.02, clock="lockstep", output=path, operator=operator)
        return [path.read_bytes(), _plain_session(path, chunks=False)]


def _frame(data: bytes, folder: Path) -> object:
    return frames.decode(data)


def _frames() -> list[bytes]:
    one = frames.Frame(12, frames.RX, "bulk:1", b"data")
    return [frames.encode(one, 5), frames.encode(frames.Frame(0, frames.START), 0)]


def _answer(data: bytes, folder: Path) -> object:
    """Answers of the boxes, by the first byte; the drivers take those of the right length alone."""
    which, rest = data[:1], data[1:]
    gauges = np.zeros(6)
    eight = rest[:8].ljust(8, b"\0")
    asked: dict[bytes, Callable[[], object]] = {
        b"0": lambda: netcanoem.first_half(eight, gauges),
        b"1": lambda: netcanoem.second_half(eight[:6], gauges),
        b"2": lambda: netcanoem.matrix_pair(rest),
        b"3": lambda: netcanoem.serial_number(rest),
        b"4": lambda: netcanoem.counts_per_unit(rest),
        b"5": lambda: netcanoem.unit_codes(rest),
        b"6": lambda: netcanoem.firmware(rest),
        b"7": lambda: usb_31xx.decode_calibration(eight, "channel 0"),
        b"8": lambda: usb_quad08.hex_records(rest.decode("utf-8", "replace"), "image"),
        b"9": lambda: netcanoem.describe_status(int.from_bytes(rest[:2], "big")),
    }
    return asked[which]() if which in asked else None


def _answers() -> list[bytes]:
    image = b"8:10010000214601360121470136007EFE09D2190140\n:00000001FF"
    return [b"%d" % k + b"\x3f\x80\0\0\0\0\0\0" for k in range(8)] + [image, b"9\x40\0"]


@cache
def _teleop() -> RigConfig:
    return load_rig("teleop")


def _command(data: bytes, folder: Path) -> object:
    text = data.decode("utf-8", "replace")
    shop = Shop(None, _teleop())
    return [commands.parse_command(line, shop) for _, line in commands.scheduled([text])]


def _commands() -> list[bytes]:
    texts = ("2.5 pause", "3 set force_scale 0.5", "0 start", "1 resume", "4 controller lawrence")
    return [t.encode() for t in texts]


TARGETS: Sequence[Target] = (
    Target("csv", partial(_imported, "run.csv"), _csv),
    Target("csv-gzip", partial(_imported, "run.csv.gz"), _gzip),
    Target("json", partial(_read_here, "run.jsonl"), _json),
    Target("npz", partial(_read_here, "run.npz"), _npz),
    Target("mat", partial(_imported, "run.mat"), _mat),
    Target("parquet", partial(_imported, "run.parquet"), _parquet),
    Target("xlsx", partial(_read_here, "run.xlsx"), _xlsx),
    Target("npy", partial(_read_here, "run.npy"), _npy),
    Target("feather", partial(_imported, "run.feather"), _feather),
    Target("hdf5", partial(_imported, "run.h5"), _hdf5),
    Target("bag1", partial(_bag, "run.bag"), partial(_bag_seeds, "bag")),
    Target("bag2-mcap", partial(_bag, "run.mcap"), partial(_bag_seeds, "mcap")),
    Target("bag2-sqlite", partial(_bag, "run.db3"), partial(_bag_seeds, "db3")),
    Target("bag2-folder", _bag_folder, _metadata),
    Target("map", _map, _maps),
    Target("urdf", _urdf, _urdfs),
    Target("model", _model, _models),
    Target("rig", _rig, _rigs),
    Target("trajectory", _trajectory, _trajectories),
    Target("session", _session, _sessions),
    Target("replay", _replay, _replays),
    Target("frame", _frame, _frames),
    Target("answer", _answer, _answers),
    Target("command", _command, _commands),
)


#: Folder for inputs that were not refused properly.
FINDINGS = "fuzz-findings"


def command(args: argparse.Namespace) -> Found:
    """Every parser under mutated input; inputs that are not refused properly are kept."""
    terminal.check_page(args.report)
    targets = [t for t in TARGETS if not args.only or any(w in t.name for w in args.only)]
    if not targets:
        raise ConfigError(unknown("target", " ".join(args.only), [t.name for t in TARGETS]))
    if not 0 <= args.minutes <= 10_000:
        raise ConfigError(f"--minutes {args.minutes:g}: a time of 0 or more is needed")
    kept = resumed(args.resume)
    turns = fuzz.remembered(kept) if kept else []
    inputs = []
    for target in targets if args.minutes else ():
        terminal.log(f"{target.name} ...")
        earlier = sum(one["name"] == target.name for one in turns)
        seed = 1000 * earlier + (args.seeds or 0)  # no turn repeats an earlier one
        found = fuzz.explore_guarded(target, 60 * args.minutes, seed)
        inputs += fuzz.keep([found], Path(FINDINGS))
        turns.append(fuzz.remembered_turn(found, revision()))
        if kept:
            fuzz.remember(kept, turns[-1])
    sums = fuzz.summed(turns, [t.name for t in TARGETS])
    again = [f"--resume {kept}"] if kept else []
    only = [f"--only {word}" for word in args.only]
    command = " ".join(["hil bench fuzz", f"--minutes {args.minutes:g}", *only, *again])
    revisions = list(dict.fromkeys(one["revision"] for one in turns))
    terminal.write_page(args.report, fuzz.page(sums, command, revisions))
    said = (
        f"{terminal.table(fuzz.TABLE_HEAD, [e.row() for e in sums])}\n\n{fuzz.fuzz_verdict(sums)}"
    )
    if inputs:
        said += f"; the inputs are in {FINDINGS}/: {', '.join(p.name for p in inputs)}"
    rows = [dict(zip(fuzz.TABLE_HEAD, e.row(), strict=True)) for e in sums]
    return said, {"targets": rows, "inputs": [str(p) for p in inputs]}
