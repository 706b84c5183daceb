"""Tables as labs write them: formats, units, times, missing values, logs of known programs."""

from __future__ import annotations

import gzip
import json
import tomllib
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import h5py
import numpy as np
import openpyxl
import pandas as pd
import plants
import pyarrow as pa
import pytest
from pyarrow import feather, parquet
from record_tables import URDF, columns
from record_tables import write_csv as write_columns
from scipy.io import savemat

import hil
from hil.cli import main
from hil.errors import ConfigError, DataError
from hil.record.checks import check
from hil.record.guess import propose
from hil.record.mapfile import parse_map, read_map
from hil.record.mcap_read import load
from hil.record.sources import below, find
from hil.record.table_files import open_table, run_names, text_table
from hil.record.tables import import_table


def write_csv(path, table):
    return write_columns(path, {name: np.asarray(table[name]) for name in table})


@pytest.fixture(scope="module")
def run():
    return plants.joints(d=2)


@pytest.fixture(scope="module")
def frame(run):
    return pd.DataFrame(columns(run)).iloc[:200]


def npy(frame, path):
    np.save(path, frame.to_numpy())
    return parse_map({"table": {"columns": list(frame.columns)}})


def hdf5(frame, path):
    with h5py.File(path, "w") as file:
        for name in frame.columns:
            file.create_dataset(f"log/{name}", data=frame[name], compression="gzip")


def matlab(path, structs):
    """A file as MATLAB writes it with '-v7.3': 512 bytes of its own, all arrays transposed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, fields in structs.items():
            group = file.create_group(name)
            group.attrs["MATLAB_class"] = np.bytes_(b"struct")
            for field, value in fields.items():
                data = group.create_dataset(field, data=np.atleast_2d(value).T)
                data.attrs["MATLAB_class"] = np.bytes_(b"double")
        file.create_group("#refs#").create_dataset("a", data=np.zeros(3))
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512, b" "))


def json_lines(frame, path):
    """Lines as a robot's program logs them: lists, an object within, a value that is absent."""
    parts = (frame["t"], frame[["q1", "q2"]].to_numpy(), frame[["tau1", "tau2"]].to_numpy())
    rows = [
        {"t": t, "q": q.tolist(), "torque": {"motor": tau.tolist()}, "note": "free"}
        for t, q, tau in zip(*parts, strict=True)
    ]
    rows[3] |= {"event": 1}
    text = "\n".join(map(json.dumps, rows))
    path.write_text(text + '\n{"t": 0.4, "q": [0.')  # the program was killed
    return parse_map({"columns": {"tau1": "torque.motor1", "tau2": "torque.motor2"}})


def json_lists(frame, path):
    path.write_text(json.dumps(frame.to_dict("list"), indent=1))


T_S = np.arange(500) * 0.004
FORMATS = {
    ".parquet": lambda f, p: f.to_parquet(p),
    ".pq": lambda f, p: f.to_parquet(p),
    ".feather": lambda f, p: feather.write_feather(pa.Table.from_pandas(f), p),
    ".xlsx": lambda f, p: f.to_excel(p, index=False),
    ".npy": npy,
    ".h5": hdf5,
    ".hdf5": hdf5,
    ".csv": lambda f, p: f.to_csv(p, index=False, encoding="utf-16"),
    ".txt": lambda f, p: f.to_csv(p, index=False, sep=" "),
    ".csv.gz": lambda f, p: f.to_csv(p, index=False),
    ".tsv.bz2": lambda f, p: f.to_csv(p, index=False, sep="\t"),
    ".log.xz": lambda f, p: f.to_csv(p, index=False),
    ".jsonl": json_lines,
    ".ndjson": json_lines,
    ".json": json_lists,
}


@pytest.mark.parametrize("ending", FORMATS)
def test_every_format_is_the_same_recording(tmp_path, frame, ending):
    path = tmp_path / f"run{ending}"
    found = import_table(path, FORMATS[ending](frame, path)).recordings[0]
    np.testing.assert_allclose(found.t, frame["t"], atol=1e-12)
    np.testing.assert_allclose(found.q, frame[["q1", "q2"]], rtol=1e-14)
    np.testing.assert_allclose(found.tau, frame[["tau1", "tau2"]], rtol=1e-14)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_compressed_feather_needs_no_more_memory_than_it_may(tmp_path, run, compression):
    """Threads of the reader, with a heap each, once took the address space that is allowed."""
    every = pd.DataFrame(columns(run)).iloc[:5000]
    wide = every.assign(**{f"more{k}": np.sin(k * every["t"]) for k in range(12)})
    path = tmp_path / "run.feather"
    wide.to_feather(path, compression=compression)
    found = import_table(path).recordings[0]
    np.testing.assert_allclose(found.q, every[["q1", "q2"]], rtol=1e-14)


@pytest.mark.parametrize("ending", [".parquet", ".feather", ".xlsx", ".npy", ".h5"])
def test_a_damaged_file_is_a_sentence(tmp_path, ending):
    path = tmp_path / f"run{ending}"
    path.write_bytes(b"PAR1 nothing of this kind")
    with pytest.raises(DataError, match=r"run\.\w+ (is not an? \w+ file|cannot be read)"):
        import_table(path)


def test_units_of_columns(frame):
    given = parse_map(
        {
            "units": {"q": "deg", "tau": {"unit": "mA", "torque_constant": [2.0, 3.0]}},
            "columns": {"qd1": {"from": "q1", "unit": "rpm"}, "qd2": {"from": "q2", "unit": "rpm"}},
        }
    )
    assert given.rule("q1", "a").terms == {"a": pytest.approx(np.pi / 180)}
    assert given.rule("tau2", "a").terms == {"a": pytest.approx(3e-3)}
    assert given.rule("tau1", {"from": "a", "scale": 5}).terms == {"a": 5}
    assert given.arms[""]["qd1"].terms == {"q1": pytest.approx(2 * np.pi / 60)}
    rule = given.rule("temp1", {"from": "a", "unit": "K"})
    assert rule.apply({"a": np.array([300.0])}, 1) == pytest.approx([26.85])


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ({"units": {"q": "rpm"}}, "column 'q1': unknown unit 'rpm'.* Available: .*deg"),
        ({"units": {"x": "deg"}}, "unknown key in .units. 'x'"),
        ({"columns": {"tau1": {"from": "a", "unit": "mA"}}}, "a torque_constant .*--torque-consta"),
        ({"columns": {"q*": "angle"}}, r"names with one \* for the number"),
        ({"columns": {"fx*": "a*"}}, r"unknown column of a recording 'fx\*'"),
        ({"table": {"missing": "zero"}}, "unknown value of table.missing 'zero'"),
    ],
)
def test_a_unit_that_is_none_is_refused(table, sentence):
    with pytest.raises(ConfigError, match=sentence):
        parse_map(table)


def test_degrees_and_currents_from_the_command_line(tmp_path, frame, capsys):
    other = frame.assign(q1=np.degrees(frame["q1"]), q2=np.degrees(frame["q2"]))
    table = write_csv(tmp_path / "run.csv", other)
    words = ["import", str(table), "--dry-run", "--json", "--unit", "deg"]
    assert main([*words, "--torque-constant", "2,4"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["columns"][0]["tau2"] == {"tau2": 4.0} and told["session"] is None
    first = [float(x) for x in told["first_rows"][0][0]]
    assert first[1] == pytest.approx(frame["q1"][0], rel=1e-4)
    assert main([*words, "--torque-constant", "2;4"]) == 2
    assert "expected numbers with commas" in capsys.readouterr().err


def test_degrees_reach_the_columns_that_a_map_names_without_a_unit(tmp_path, frame, capsys):
    other = pd.DataFrame({"t": frame["t"], "a": np.degrees(frame["q1"]), "b": frame["q2"]})
    other = other.assign(va=np.degrees(np.gradient(frame["q1"], frame["t"])), fa=frame["tau1"])
    table = write_csv(tmp_path / "run.csv", other.assign(fb=frame["tau2"]))
    place = tmp_path / "m.toml"
    place.write_text(
        '[columns]\nq1 = "a"\nq2 = { from = "b", unit = "rad" }\nqd1 = "va"\nqd2 = 0.0\n'
        'tau1 = "fa"\ntau2 = "fb"\n'
    )
    words = ["import", str(table), "--map", str(place), "--unit", "deg", "--dry-run", "--json"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)["columns"][0]
    degree = pytest.approx(np.pi / 180)
    assert told["q1"] == {"a": degree} and told["qd1"] == {"va": degree}
    assert told["q2"] == {"b": 1.0} and told["tau1"] == {"fa": 1.0}


def test_positions_beyond_the_joints_range_are_asked_whether_they_are_degrees(tmp_path, capsys):
    q = {f"q{k + 1}": 60.0 * x for k, x in enumerate(np.sin([3 * T_S, 5 * T_S]))}
    table = write_csv(tmp_path / "run.csv", {"t": T_S, **q, "tau1": 0 * T_S, "tau2": T_S})
    robot = tmp_path / "arm.urdf"
    robot.write_text(URDF)
    words = ["import", str(table), "--robot", str(robot), "--dry-run"]
    assert main(words) == 2
    assert "Say --unit deg where all are, or scale" in capsys.readouterr().err
    assert main([*words, "--unit", "deg"]) == 0


def test_a_proposed_map_as_json_or_in_quiet(tmp_path, frame, capsys):
    names = {"q1": "pos1_deg", "q2": "pos2_deg", "tau1": "trq1", "tau2": "trq2"}
    table = write_csv(tmp_path / "run.csv", frame.rename(columns=names))
    place = tmp_path / "m.toml"
    words = ["import", str(table), "--propose-map", str(place)]
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["text"] == place.read_text() and told["missing"] == [] and told["map"] == str(place)
    place.unlink()
    assert main([*words, "--quiet"]) == 0
    assert not any(capsys.readouterr()) and place.exists()


def test_a_dry_run_shows_what_names_and_units_say_where_there_is_no_map(tmp_path, frame, capsys):
    """What it shows is what the proposed map reads; names that say too little are refused."""
    names = {"t": "time_ms", "q1": "pos_deg_J1", "q2": "pos_deg_J2"}
    names |= {"tau1": "trq_Nm_J1", "tau2": "trq_Nm_J2"}
    other = frame[list(names)].rename(columns=names)
    other["time_ms"] *= 1e3
    table, place = write_csv(tmp_path / "lab.csv", other), tmp_path / "m.toml"
    assert main(["import", str(table), "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert "0.0174533 * pos_deg_J1" in shown and "guessed: " in shown
    assert shown.endswith("nothing was written\n") and list(tmp_path.iterdir()) == [table]
    assert main(["import", str(table), "--propose-map", str(place), "--quiet"]) == 0
    assert main(["import", str(table), "--dry-run", "--json"]) == 0
    guessed = json.loads(capsys.readouterr().out)
    assert main(["import", str(table), "--dry-run", "--json", "--map", str(place)]) == 0
    known = json.loads(capsys.readouterr().out)
    assert guessed["notes"].pop(0).startswith("guessed: ") and guessed == known
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 2
    bare = write_csv(
        tmp_path / "bare.csv", other.rename(columns={"trq_Nm_J1": "x", "trq_Nm_J2": "y"})
    )
    capsys.readouterr()
    assert main(["import", str(bare), "--dry-run"]) == 2
    assert "no column's name says what is motor efforts (tau)" in capsys.readouterr().err


def test_every_run_in_quiet(tmp_path, frame, capsys):
    """Nothing where all is well; else what cannot be fitted."""
    table = tmp_path / "two.xlsx"
    with pd.ExcelWriter(table) as file:
        frame.to_excel(file, sheet_name="a", index=False)
        frame.assign(tau1=0.0, tau2=0.0, q1=0.25, q2=0.5).to_excel(
            file, sheet_name="b", index=False
        )
    words = ["import", str(table), "--all-runs", "-o", str(tmp_path / "out")]
    assert main([*words, "--quiet"]) == 0
    out, err = capsys.readouterr()
    assert out == f"{tmp_path / 'out'}: 1 of them cannot be fitted: b.mcap\n" and not err
    assert main(words) == 0
    assert "1 of them cannot be fitted: b.mcap\n" in capsys.readouterr().out


def test_columns_of_the_only_joint_need_no_number(tmp_path, frame, capsys):
    one = frame[["t", "q1", "tau1"]].rename(columns={"q1": "q", "tau1": "tau"})
    table = write_csv(tmp_path / "one.csv", one.assign(i=range(len(one))))
    assert main(["import", str(table), "-o", str(tmp_path / "one.mcap")]) == 0
    said = "".join(capsys.readouterr())
    assert "taken as the columns of the only joint: q, tau" in said
    assert "not used: i" in said
    found = load(tmp_path / "one.mcap")
    assert np.array_equal(found.q[:, 0], frame["q1"]) and found.tau.shape == (len(one), 1)


def test_a_column_without_a_number_beside_numbered_ones_is_none_of_a_joint(tmp_path, frame, capsys):
    table = write_csv(tmp_path / "two.csv", frame.assign(q=1.0, tau=2.0))
    assert main(["import", str(table), "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "not used: q, tau" in out and "only joint" not in out


def test_a_sensor_that_one_joint_has_does_not_stop_the_others(tmp_path, frame):
    """The only temperature of a logger was refused, with advice that nobody could follow."""
    path = write_csv(tmp_path / "run.csv", frame.assign(temp1=35.0))
    found = import_table(path)
    assert found.recordings[0].temperature is None
    assert any(note.startswith("temp1: not read") for note in found.notes)
    two = import_table(write_csv(tmp_path / "two.csv", frame.assign(temp1=35.0, temp2=36.0)))
    assert two.recordings[0].temperature is not None
    with pytest.raises(DataError, match="temp2"):  # a map asks for it
        import_table(path, parse_map({"columns": {"temp1": "temp1"}}))


@pytest.mark.parametrize(
    ("more", "sign", "zero"), [({"sign": -1}, -1, 0), ({"shift": 0.5}, 1, 0.5)]
)
def test_the_unit_of_a_name_counts_beside_a_sign(tmp_path, frame, more, sign, zero):
    """The line that a wrong sign is answered with had dropped the unit of the column's name."""
    turned = frame.assign(q2=np.degrees(frame["q2"])).rename(columns={"q2": "elbow [deg]"})
    path = write_csv(tmp_path / "run.csv", turned)
    found = import_table(path, parse_map({"columns": {"q2": {"from": "elbow [deg]", **more}}}))
    np.testing.assert_allclose(found.recordings[0].q[:, 1], sign * frame["q2"] + zero, atol=1e-12)


def test_a_dry_run_shows_and_writes_nothing(tmp_path, frame, capsys):
    frame = frame.assign(tauext1=0.25, tauext2=0.5)
    table = write_csv(tmp_path / "run.csv", frame.rename(columns={"t": "time_s"}).assign(pump=1.0))
    assert main(["import", str(table), "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "the column 'time_s' is taken as the time" in out and "not used: pump" in out
    assert "tauext2 [N m]" in out and "0.25" in out
    assert "q1 [rad]" in out and f"{frame['tau1'][0]:.6g}" in out and "nothing was written" in out
    assert [p.name for p in tmp_path.iterdir()] == ["run.csv"]
    assert main(["import", str(table)]) == 2
    assert "--dry-run shows what would be read" in capsys.readouterr().err


BEGIN = datetime(2024, 5, 1, 12, 0, 0, tzinfo=UTC)


@pytest.mark.parametrize(
    ("name", "time", "said"),
    [
        (
            "t",
            lambda t: 1e3 * (t + BEGIN.timestamp()),
            "is in ms since 1970; it begins at 2024-05-01 12",
        ),
        ("t", lambda t: 1e6 * (t + BEGIN.timestamp()), "is in us since 1970"),
        ("t", lambda t: (1e9 * (t + BEGIN.timestamp())).astype(np.int64), "is in ns since 1970"),
        ("time_ms", lambda t: 1e3 * t, "'time_ms' is in ms"),
        ("Time [us]", lambda t: 1e6 * t, "is in us"),
        (
            "timestamp",
            lambda t: [(BEGIN + timedelta(seconds=x)).isoformat() for x in t],
            "since 1970",
        ),
        (
            "stamp",
            lambda t: [f"{BEGIN + timedelta(seconds=x):%Y-%m-%d %H:%M:%S.%f}Z" for x in t],
            "taken",
        ),
    ],
)
def test_times_are_recognised_and_said(tmp_path, frame, name, time, said):
    t = frame["t"].to_numpy()
    other = frame.drop(columns="t").assign(**{name: time(t)})
    path = tmp_path / "run.csv"
    other.to_csv(path, index=False)
    found = import_table(path)
    np.testing.assert_allclose(
        found.recordings[0].t - found.recordings[0].t[0], t - t[0], atol=2e-6
    )
    assert any(said in note for note in found.notes)


def test_times_of_arrow_are_dates(tmp_path, frame):
    other = frame.assign(t=pd.to_datetime(frame["t"], unit="s", origin="2024-05-01"))
    other.to_parquet(tmp_path / "run.parquet")
    found = import_table(tmp_path / "run.parquet")
    assert "begins at 2024-05-01" in found.notes[0]
    assert found.recordings[0].period == pytest.approx(0.002, rel=1e-3)


def test_missing_values(tmp_path, frame):
    holed = frame.copy()
    holed.loc[50:52, "q1"] = np.nan
    holed.loc[100:140, "tau2"] = np.nan
    path = tmp_path / "run.csv"
    holed.to_csv(path, index=False)
    with pytest.raises(DataError, match="column 'q1' has 3 missing"):
        import_table(path)
    dropped = import_table(path, missing="drop")
    assert dropped.recordings[0].n == 200 - 3 - 41
    assert dropped.notes == ("44 rows with missing values left out",)
    filled = import_table(path, parse_map({"table": {"missing": "interpolate"}}))
    assert filled.recordings[0].n == 200 - 41
    assert filled.notes[0].startswith("3 missing values interpolated; 41 rows")
    np.testing.assert_allclose(filled.recordings[0].q[50:53, 0], frame["q1"][50:53], atol=1e-3)


def log(d, names, t, more=()):
    """A table of a program: time, and groups of d columns."""
    out = {names[0]: t, **dict(more)}
    for k, name in enumerate(names[1:], 1):
        wave = np.sin(np.outer(t, np.arange(1, d + 1))) * k
        out |= {name.format(i): wave[:, i] for i in range(d)}
    return out


def test_a_log_of_libfranka(tmp_path):
    t = np.arange(300) / 1000
    data = log(7, ("time", "state.q[{}]", "state.q_d[{}]", "state.dq[{}]", "state.tau_J[{}]"), t)
    data["time"] = np.arange(300)
    rows = [
        ", ".join(data),
        *(",".join(f"{x:.9g}" for x in r) for r in zip(*data.values(), strict=True)),
    ]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    found = import_table(tmp_path / "log.csv", read_map("libfranka")).recordings[0]
    assert found.d == 7 and found.rate == pytest.approx(1000)
    np.testing.assert_allclose(found.q[:, 2], np.sin(3 * t), atol=1e-8)
    np.testing.assert_allclose(found.tau[:, 6], 4 * np.sin(7 * t), atol=1e-8)
    assert found.qd is not None and found.tau_ext is None


def test_a_log_of_ur_rtde(tmp_path):
    t = np.arange(300) / 500
    data = log(
        6, ("timestamp", "target_q_{}", "actual_q_{}", "actual_qd_{}", "actual_current_{}"), t
    )
    table = write_csv(tmp_path / "robot_data.csv", data)
    with pytest.raises(ConfigError, match="column 'tau1' is a current in A"):
        import_table(table, read_map("ur-rtde"))
    constants = (10.0, 10.0, 8.0, 7.0, 7.0, 7.0)
    found = import_table(table, read_map("ur-rtde"), torque_constant=constants).recordings[0]
    np.testing.assert_allclose(found.tau, found.current * constants)
    data |= {f"actual_current_as_torque_{k}": np.full(300, k + 0.5) for k in range(6)}
    table = write_csv(tmp_path / "robot_data.csv", data)
    found = import_table(table, read_map("ur-rtde")).recordings[0]
    assert found.tau[3].tolist() == [0.5, 1.5, 2.5, 3.5, 4.5, 5.5]


def test_a_capture_of_the_dvrk(tmp_path):
    t = np.arange(300) / 1000
    kinds = ("TORQUE_FEEDBACK", "TORQUE_COMMAND", "POSITION_FEEDBACK", "VELOCITY_FEEDBACK")
    data = log(7, ("TIMESTAMP", *(f"{k}_{{}}" for k in kinds)), t)
    data = {(n if n == "TIMESTAMP" else f"{n[:-1]}{int(n[-1]) + 1}"): v for n, v in data.items()}
    found = import_table(write_csv(tmp_path / "c.csv", data), read_map("dvrk")).recordings[0]
    np.testing.assert_allclose(found.q[:, 0], 3 * np.sin(t), atol=1e-12)
    np.testing.assert_allclose(found.tau[:, 6], np.sin(7 * t), atol=1e-12)


@pytest.mark.parametrize("version", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_a_data_set_of_lerobot(tmp_path, version, capsys):
    folder = tmp_path / "set"
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(f'{{"codebase_version": "v{version}.0"}}')
    (folder / "data" / "chunk-000").mkdir(parents=True)
    tables, t = [], np.arange(100) / 50
    for k in range(2):
        state = np.sin(np.outer(t, [1.0, 2.0])) + k
        columns = {
            "observation.state": pa.array(state.tolist(), pa.list_(pa.float64(), 2)),
            "observation.effort": pa.array((2 * state).tolist()),
            "action": pa.array(state.tolist()),
            "timestamp": t,
            "episode_index": np.full(100, k),
        }
        tables.append(pa.table(columns))
    if version == 2:
        for k, table in enumerate(tables):
            parquet.write_table(table, folder / "data" / "chunk-000" / f"episode_{k:06d}.parquet")
    else:
        parquet.write_table(
            pa.concat_tables(tables), folder / "data" / "chunk-000" / "file-000.parquet"
        )
    with pytest.raises(DataError, match=r"holds 2 episodes .*with --run, .*--all-runs"):
        import_table(folder, read_map("lerobot"))
    found = import_table(folder, read_map("lerobot"), run="episode_000001").recordings[0]
    np.testing.assert_allclose(found.q, np.sin(np.outer(t, [1.0, 2.0])) + 1, atol=1e-12)
    np.testing.assert_allclose(found.tau, 2 * found.q)
    assert main(["import", str(folder), "--all-runs", "-o", str(tmp_path / "out")]) == 0
    assert {p.name for p in (tmp_path / "out").glob("*.mcap")} == {
        f"episode_00000{k}.mcap" for k in (0, 1)
    }
    # the analyses take it, too, one episode at a time
    capsys.readouterr()
    assert main(["compare", str(folder)]) == 2
    assert "holds 2 episodes" in capsys.readouterr().err
    said = hil.load(folder, run="1")  # its number stands for its name
    np.testing.assert_allclose(said.q, found.q)
    assert "by the map lerobot" in said.metadata["note"]
    assert find([folder]) == below([folder]) == [folder]
    assert main(["info", str(folder), "--run", "episode_000000"]) == 0


def test_a_data_set_without_efforts_says_so(tmp_path):
    folder = tmp_path / "set"
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text("{}")
    (folder / "data" / "chunk-000").mkdir(parents=True)
    t = np.arange(50) / 50
    table = pa.table({"observation.state": pa.array(np.c_[t, t].tolist()), "timestamp": t})
    parquet.write_table(table, folder / "data" / "chunk-000" / "episode_000000.parquet")
    with pytest.raises(DataError, match="no column 'tau1', 'tau2'"):
        import_table(folder, read_map("lerobot"))
    for run in ("1", "episode_1"):
        with pytest.raises(DataError, match=f"unknown episode '{run}'"):
            import_table(folder, read_map("lerobot"), run=run)


def test_sheets_of_a_workbook_are_runs(tmp_path, frame):
    path = tmp_path / "lab.xlsx"
    with pd.ExcelWriter(path) as book:
        for name in ("first", "second"):
            frame.to_excel(book, sheet_name=name, index=False)
    with pytest.raises(DataError, match="holds 2 runs; choose one with --run: first, second"):
        import_table(path)
    assert import_table(path, run="second").recordings[0].name == "second"


def test_a_sheet_of_notes_is_no_run(tmp_path, frame):
    path = tmp_path / "lab.xlsx"
    with pd.ExcelWriter(path) as book:
        frame.to_excel(book, sheet_name="Data", index=False)
        pd.DataFrame({"who": ["A. B."], "what": ["warm"]}).to_excel(book, sheet_name="Notes")
    found = import_table(path)
    assert found.recordings[0].name == "Data"
    assert "read is 'Data'; no samples are in Notes" in found.notes


def as_text(tmp_path, header, rows):
    table = tmp_path / "run.csv"
    table.write_text("\n".join([*header, *rows]) + "\n")
    return table


def _demos(frame, path):
    """Two runs, as data sets of demonstrations keep them: positions and efforts of all joints."""
    with h5py.File(path, "w") as file:
        for k in (0, 1):
            demo = file.create_group(f"data/demo_{k}")
            demo["t"] = frame["t"].to_numpy()
            demo["obs/q"] = frame[["q1", "q2"]].to_numpy() + k
            demo["obs/tau"] = frame[["tau1", "tau2"]].to_numpy()
            demo["note"] = "as spoken"
    return {"t": "t", "q": "obs.q", "tau": "obs.tau"}


def _structs(frame, path):
    one = {"time": frame["t"].to_numpy(), "pos": frame[["q1", "q2"]].to_numpy()}
    one["torque"] = frame[["tau1", "tau2"]].to_numpy()
    matlab(path, {"demo_0": one, "demo_1": one | {"pos": one["pos"] + 1}})
    return {"t": "time", "q": "pos", "tau": "torque"}


@pytest.mark.parametrize(("ending", "write"), [(".hdf5", _demos), (".mat", _structs)])
def test_groups_of_the_same_arrays_are_runs(tmp_path, frame, ending, write):
    names = write(frame, tmp_path / f"demos{ending}")
    table = {"t": names["t"]} | {f"{n}{k}": f"{names[n]}{k}" for n in ("q", "tau") for k in (1, 2)}
    given = parse_map({"columns": table})
    with pytest.raises(DataError, match="holds 2 runs; choose one with --run: demo_0, demo_1"):
        import_table(tmp_path / f"demos{ending}", given)
    for k in (0, 1):
        made = import_table(tmp_path / f"demos{ending}", given, run=f"demo_{k}").recordings[0]
        np.testing.assert_allclose(made.q, frame[["q1", "q2"]] + k, rtol=1e-14)
        np.testing.assert_allclose(made.tau, frame[["tau1", "tau2"]], rtol=1e-14)


def test_one_struct_of_a_new_mat_file_is_the_table(tmp_path, frame):
    matlab(tmp_path / "run.mat", {"log": {n: frame[n].to_numpy() for n in frame.columns}})
    found = import_table(tmp_path / "run.mat").recordings[0]
    np.testing.assert_allclose(found.q, frame[["q1", "q2"]], rtol=1e-14)


def test_groups_of_other_arrays_are_parts_of_one_table(tmp_path, frame):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["clock/t"], file["robot/q"] = frame["t"].to_numpy(), frame[["q1", "q2"]].to_numpy()
        file["robot/tau"] = frame[["tau1", "tau2"]].to_numpy()
        file["away"] = h5py.ExternalLink("other.h5", "/q")  # never followed
        file["again"] = h5py.SoftLink("/robot")
        (tmp_path / "far.raw").write_bytes(frame["t"].to_numpy().tobytes())
        there = [(str(tmp_path / "far.raw"), 0, h5py.h5f.UNLIMITED)]
        file.create_dataset("far", (len(frame),), "f8", external=there)  # nor read
    names = {"t": "clock.t"} | {f"{n}{k}": f"robot.{n}{k}" for n in ("q", "tau") for k in (1, 2)}
    found = import_table(tmp_path / "run.h5", parse_map({"columns": names})).recordings[0]
    np.testing.assert_allclose(found.q, frame[["q1", "q2"]], rtol=1e-14)
    far = parse_map({"columns": names | {"t": "far"}})
    with pytest.raises(DataError, match="far"):
        import_table(tmp_path / "run.h5", far)


def test_objects_of_json_beside_each_other_are_runs(tmp_path, frame):
    one = frame.to_dict("list")
    path = tmp_path / "runs.json"
    path.write_text(json.dumps({"a": one, "b": one | {"q1": [x + 1 for x in one["q1"]]}}))
    with pytest.raises(DataError, match="holds 2 runs; choose one with --run: a, b"):
        import_table(path)
    found = import_table(path, run="b").recordings[0]
    np.testing.assert_allclose(found.q, frame[["q1", "q2"]] + [1, 0], rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[1, 2]", "sample 1 is no object of JSON: '1'"),
        ('{"t": 0}\n{"t": \n{"t": 1}', "holds no JSON in line 2; expected an object a line"),
        ("{" * 99999, "is not a JSON file"),
        ('"text"', "holds no objects of JSON"),
        ('{"t": [0, 1], "q1": ["a", "b"], "tau1": [0, 1]}', "'q1' is of type object"),
    ],
)
def test_json_that_is_no_table_is_a_sentence(tmp_path, text, sentence):
    path = tmp_path / "run.json"
    path.write_text(text)
    with pytest.raises(DataError, match=sentence):
        import_table(path)


def test_dates_in_json_are_times_and_what_is_absent_is_missing(tmp_path, frame):
    rows = frame[["q1", "tau1"]].to_dict("records")
    start = datetime(2026, 5, 1, 12, tzinfo=UTC)
    rows = [
        r | {"t": (start + k * timedelta(seconds=0.01)).isoformat()} for k, r in enumerate(rows)
    ]
    del rows[5]["tau1"]
    path = tmp_path / "run.json"
    path.write_text(json.dumps(rows))
    found = open_table(path).columns(["t", "tau1"])
    np.testing.assert_allclose(np.diff(found["t"]), 0.01, atol=1e-6)
    assert np.flatnonzero(np.isnan(found["tau1"])).tolist() == [5]


def test_a_packed_table_that_is_cut_off_or_claims_too_much_is_a_sentence(tmp_path, frame):
    cut, bomb = tmp_path / "cut.csv.gz", tmp_path / "bomb.csv.gz"
    frame.to_csv(cut, index=False)
    cut.write_bytes(cut.read_bytes()[:-2000])
    with pytest.raises(DataError, match=r"unpacked behind row \d+: .* Unpack what is left"):
        import_table(cut)
    with gzip.open(bomb, "wb") as file:
        file.write(b"t,q1,tau1\n")
        for _ in range(80):
            file.write(b"\n" * 2**20)
    # some MiB, and so many times the file: a reader of text takes a second for each
    with pytest.raises(DataError, match=r"unpacks to more than 8\.\d* MiB"):
        import_table(bomb)
    with gzip.open(tmp_path / "run.npy.gz", "wb") as file:
        np.save(file, frame.to_numpy())
    with pytest.raises(DataError, match=r"format '\.npy'; .*unpack the file first"):
        import_table(tmp_path / "run.npy.gz")


def test_a_packed_table_of_many_rows_is_refused_before_its_rows_are_read(tmp_path, monkeypatch):
    with gzip.open(tmp_path / "bomb.csv.gz", "wb") as file:
        file.write(b"t,q1,tau1\n" + b"0,0,0\n" * 2_000_000)
    seen = []
    monkeypatch.setattr(np, "loadtxt", lambda rows, **_: seen.append(rows))
    with pytest.raises(DataError, match="unpacks to more than"):
        import_table(tmp_path / "bomb.csv.gz")
    assert not seen


def test_what_an_hdf5_file_claims_has_a_bound(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.create_dataset("q1", shape=(2**32,), dtype="f8", chunks=(2**16,))  # all zeros
    with pytest.raises(DataError, match="claims more memory"):
        import_table(tmp_path / "run.h5")


def test_a_second_header_row_with_units_is_used(tmp_path, capsys):
    t = np.arange(0, 6, 0.002)
    rows = [f"{x:.3f},{50 * np.sin(2 * x):.5f},{np.cos(x):.5f}" for x in t]
    table = as_text(tmp_path, ["Time,Angle,Torque", "s,deg,Nm"], rows)
    made = tmp_path / "m.toml"
    assert main(["import", str(table), "--propose-map", str(made)]) == 0
    assert main(["import", str(table), "--map", str(made), "-o", str(tmp_path / "s.mcap")]) == 0
    assert np.ptp(load(tmp_path / "s.mcap").q) == pytest.approx(np.radians(100.0), rel=1e-3)
    # names of a recording in its own units stay what they are
    table = as_text(tmp_path, ["t,q1,tau1", "[s],[rad],[Nm]"], rows)
    assert main(["import", str(table), "--unit", "rad", "-o", str(tmp_path / "s.mcap")]) == 0
    table = as_text(tmp_path, ["t,q1,tau1", "a,b,c"], rows)
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 2
    assert "a second row may hold their units" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("form", "first"),
    [("{:02d}:00:{:06.3f}", 10.0 * 3600), ("01.05.2024 {:02d}:00:{:06.3f}", 1714557600.0)],
)
def test_times_of_day_and_german_dates_are_read(tmp_path, form, first):
    t = np.arange(0, 6, 0.002)
    rows = [
        f"{form.format(10, x)};{np.sin(2 * x):.5f};{np.cos(x):.5f}".replace(".", ",") for x in t
    ]
    rows = [r.replace("01,05,2024", "01.05.2024") for r in rows]
    table = as_text(tmp_path, ["Zeitstempel;q1;tau1"], rows)
    assert text_table(table).columns(["Zeitstempel"])["Zeitstempel"][0] == pytest.approx(first)
    made = tmp_path / "m.toml"
    assert main(["import", str(table), "--propose-map", str(made)]) == 0
    assert main(["import", str(table), "--map", str(made), "-o", str(tmp_path / "s.mcap")]) == 0
    assert load(tmp_path / "s.mcap").rate == pytest.approx(500.0, rel=1e-3)


@pytest.mark.parametrize(
    ("form", "first"),
    [
        ("{}/05/2024 {}:00:{:06.3f} PM", 1714946400.0),  # as Excel and LabVIEW write it
        ("{}/28/2024, {}:00:{:06.3f} AM", 1716890400.0),
        ("28/{}/2024 {}:00:{:06.3f}", 1716890400.0),  # the first number can be no month
        ("{1}:00:{2:06.3f} pm", 22 * 3600.0),
    ],
)
def test_american_dates_are_read(tmp_path, form, first):
    t = np.arange(0, 6, 0.002)
    rows = [f"{form.format(5, 10, x)}\t{np.sin(2 * x):.5f}\t{np.cos(x):.5f}" for x in t]
    table = as_text(tmp_path, ["Time\tq1\ttau1"], rows)
    assert text_table(table).columns(["Time"])["Time"][0] == pytest.approx(first)
    made = tmp_path / "m.toml"
    assert main(["import", str(table), "--propose-map", str(made)]) == 0
    assert main(["import", str(table), "--map", str(made), "-o", str(tmp_path / "s.mcap")]) == 0
    assert load(tmp_path / "s.mcap").rate == pytest.approx(500.0, rel=1e-3)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_spans_of_time_in_parquet_are_seconds(tmp_path, frame, unit):
    spans = pa.array(range(len(frame)), pa.duration(unit))
    table = pa.table({"t": spans, "q1": frame["q1"], "tau1": frame["tau1"]})
    parquet.write_table(table, tmp_path / "run.parquet")
    found = open_table(tmp_path / "run.parquet").columns(["t"])["t"]
    step = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    np.testing.assert_allclose(found, np.arange(len(frame)) * step, rtol=1e-12)


def test_a_share_of_a_rated_torque_is_no_torque():
    said = propose(["t", "axis1.ActPos(deg)", "axis1.ActTorque(% of rated)"])
    assert 'unit = "%"' in said.text
    with pytest.raises(ConfigError, match="tau1 in %: effort at the joint at 100 %"):
        parse_map(tomllib.loads(said.text))


def test_german_names_and_the_stamp_of_a_message_are_understood():
    assert propose(["Zeit", "Winkel", "Moment"]).columns["t"] == "Zeit"
    said = propose(["Zeitstempel", "Position [Grad]", "Drehmoment [Nm]"])
    assert said.columns == {
        "t": "Zeitstempel",
        "q1": "Position [Grad]",
        "tau1": "Drehmoment [Nm]",
    }
    assert 'q = "deg"' in said.text
    flat = ["%time", "field.header.stamp", "field.position0", "field.effort0"]
    assert propose(flat).columns["t"] == "field.header.stamp"


def test_missing_cells_are_refused_with_what_to_say(tmp_path, capsys):
    rows = [f"{x:.3f},{'' if k == 7 else x},{x}" for k, x in enumerate(np.arange(0, 6, 0.002))]
    table = as_text(tmp_path, ["t,q1,tau1"], rows)
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 2
    assert "--missing drop or --missing interpolate" in capsys.readouterr().err


def test_every_column_with_missing_cells_is_named_the_worst_first(tmp_path, capsys):
    names = ["q1", "q2", "q3", "tau1", "tau2", "tau3"]
    cells = np.arange(6)[None, :] + np.linspace(0, 1, 400)[:, None]
    for k, bad in ((0, [7]), (2, range(40, 160)), (4, range(9)), (5, [3, 5])):
        cells[list(bad), k] = np.nan
    rows = [",".join([f"{k / 500:.3f}", *map(str, row)]) for k, row in enumerate(cells)]
    table = as_text(tmp_path, [",".join(["t", *names])], rows)
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 2
    said = capsys.readouterr().err
    worst = "column 'q3' has 120 missing, NaN or infinite values of 400, in rows 42, 43, 44,"
    assert worst in said and "column 'tau3' has 2 " in said and "further columns: 'q1' 1;" in said
    assert said.index("'q3'") < said.index("'tau2' has 9") < said.index("'tau3'")


def test_a_velocity_that_was_never_filled_is_said():
    run = plants.smooth_axis(1)
    told = [f for f in check(replace(run, qd=np.zeros_like(run.q))) if f.code == "velocity-empty"]
    assert len(told) == 1 and "never filled" in told[0].text
    assert not [f for f in check(run) if f.code == "velocity-empty"]


LABVIEW = ["Logger 7", "Operator;Miller", "Rate;500", "Comment;none"]


@pytest.mark.parametrize("units", [[], ["s;rad;Nm"]])
def test_lines_before_the_header_are_left_out(tmp_path, units):
    rows = [f"{k / 500};{k / 7};{k / 3}" for k in range(9)]
    for head in (LABVIEW, []):
        table = text_table(as_text(tmp_path, [*head, "t;q1;tau1", *units], rows))
        assert table.names == ("t", "q1", "tau1")
        assert table.columns(["q1"])["q1"] == pytest.approx(np.arange(9) / 7)


def test_a_map_says_which_of_two_rows_holds_the_names(tmp_path, capsys):
    rows = [f"{k / 500};{np.sin(k / 50)};{np.cos(k / 50)}" for k in range(2000)]
    table = as_text(tmp_path, ["Name;Pos;Trq", "t;q1;tau1"], rows)
    words = ["import", str(table), "--unit", "rad", "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    assert "[table] header_row = 2" in capsys.readouterr().err
    place = tmp_path / "m.toml"
    place.write_text("[table]\nheader_row = 2\n")
    assert main([*words, "--map", str(place), "--quiet"]) == 0
    assert not any(capsys.readouterr())
    for row, said in (("9999", "empty or absent"), ('"two"', "expected the number of a row")):
        place.write_text(f"[table]\nheader_row = {row}\n")
        assert main([*words, "--map", str(place)]) == 2
        assert said in capsys.readouterr().err


def test_a_time_of_day_over_midnight_is_refused_as_such(tmp_path, capsys):
    clock = ["23:59:59.996", "23:59:59.998", "00:00:00.000", "00:00:00.002"]
    table = as_text(tmp_path, ["t,q1,tau1"], [f"{c},{k},{k}" for k, c in enumerate(clock)])
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 2
    assert "passes midnight in row 4" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("clock", "how"),
    [
        (["12:59:59.996", "12:59:59.998", "01:00:00.000", "01:00:00.002"], "back by 12 hours"),
        (["12:59:59.996", "12:59:59.998", "1:00:00.000", "1:00:00.002"], "back by 12 hours"),
        (["43199.996", "43199.998", "0.000", "0.002"], "back by 12 hours"),
        (
            [
                "05/01/2024 11:59:59.996",
                "05/01/2024 11:59:59.998",
                "05/02/2024 12:00:00.000",
                "05/02/2024 12:00:00.002",
            ],
            "ahead by 24 hours",
        ),
    ],
)
def test_a_clock_of_twelve_hours_is_refused_as_such(clock, how, tmp_path, capsys):
    """With dates it had been a run with a gap of a day, without them time ran backward."""
    table = as_text(tmp_path, ["t,q1,tau1"], [f"{c},{k},{k}" for k, c in enumerate(clock)])
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 2
    said = capsys.readouterr().err
    assert how in said and "in row 4" in said and "neither AM nor PM" in said
    afternoon = [f"{c} PM" for c in ("12:59:59.996", "12:59:59.998", "1:00:00.000", "1:00:00.002")]
    rows = [f"{c},{k},{k}" for k, c in enumerate(afternoon)]
    read = text_table(as_text(tmp_path, ["t,q1,tau1"], rows)).columns(["t"])["t"]
    np.testing.assert_allclose(np.diff(read), 0.002, atol=1e-9)


def test_a_time_without_its_hour_is_refused_as_such(tmp_path):
    table = as_text(tmp_path, ["t,q1,tau1"], [f"59:58.{k},{k},{k}" for k in range(4)])
    with pytest.raises(DataError, match=r"'59:58\.0', minutes and seconds .* hh:mm:ss"):
        text_table(table).columns(["t"])


# ------------------------------------------------------------ logs of Simulink


def _timeseries(run, to, **more):
    """A signal as a timeseries exported as a struct, and as a structure with time."""
    return {
        "timeseries": {"Name": "s", **more, "Time": run.t[to][:, None], "Data": run.q[to]},
        "with time": {
            "time": run.t[to][:, None],
            "signals": {"values": run.q[to], "dimensions": run.d, "label": "s"},
            "blockName": "m/s",
        },
        "pages": {
            "time": run.t[to][:, None],
            "signals": {"values": run.q[to].T[:, None, :], "dimensions": run.d},
        },
    }


@pytest.mark.parametrize("kind", ["timeseries", "with time", "pages"])
@pytest.mark.parametrize("within", ["", "logs."])
def test_structs_of_signals_with_times_are_read_by_their_paths(run, tmp_path, kind, within):
    tau = replace(run, q=run.tau)
    signals = {
        "pos": _timeseries(run, slice(None))[kind],
        "torque": _timeseries(tau, slice(10, -10, 2))[kind],
    }
    place, made = tmp_path / "s.mat", tmp_path / "m.toml"
    savemat(place, {"logs": signals, "ans": 1.0} if within else signals)
    assert main(["import", str(place), "--propose-map", str(made)]) == 0
    said = tomllib.loads(made.read_text())["columns"]
    data = "Data" if kind == "timeseries" else "signals.values"
    assert said["q2"] == f"{within}pos.{data}2"
    assert said["tau1"] == f"{within}torque.{data}1"
    assert said["t"] == f"{within}pos.{'Time' if kind == 'timeseries' else 'time'}"
    found = import_table(place, read_map(made))
    back = found.recordings[0]
    inner = slice(10, 10 + back.n)
    np.testing.assert_allclose(back.t, run.t[inner])
    np.testing.assert_array_equal(back.q, run.q[inner])
    np.testing.assert_allclose(back.tau[::2], run.tau[inner][::2], atol=1e-12)
    assert any("interpolated at the times of" in text for text in found.notes)


# ------------------------------------------------------------ text of any ending

LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t{point}
Multi_Headings\tNo
X_Columns\tOne
Date\t2026/11/25
Time\t10:00:00.0
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t200\t200\t
Date\t2026/11/25\t2026/11/25\t
X_Dimension\tTime\tTime\t
X0\t0\t0\t
Delta_X\t0{point}002\t0{point}002\t
***End_of_Header***\t\t\t
X_Value\tangle_deg\tmotor_Nm\tComment
"""


@pytest.mark.parametrize("point", [".", ","])
@pytest.mark.parametrize("ending", ["", "\t"])
def test_measurement_files_of_labview_are_read(run, tmp_path, point, ending):
    rows = zip(run.t[:200], np.degrees(run.q[:200, 0]), run.tau[:200, 0], strict=True)
    text = "".join("\t".join(f"{x:.9f}" for x in row) + ending + "\n" for row in rows)
    place, made = tmp_path / "a.lvm", tmp_path / "m.toml"
    place.write_text(LVM.format(point=point) + text.replace(".", point))
    assert main(["import", str(place), "--propose-map", str(made)]) == 0
    back = import_table(place, read_map(made)).recordings[0]
    np.testing.assert_allclose(back.q[:, 0], run.q[:200, 0], atol=1e-9)
    np.testing.assert_allclose(back.tau[:, 0], run.tau[:200, 0], atol=1e-8)


@pytest.mark.parametrize("ending", [".asc", ".log", ".dat", ".prn", ""])
def test_text_is_a_table_whatever_its_ending(run, tmp_path, ending):
    table = write_columns(tmp_path / "a.csv", columns(run), "\t")
    table.rename(tmp_path / f"a{ending}")
    assert np.array_equal(import_table(tmp_path / f"a{ending}").recordings[0].q, run.q)


def test_what_is_no_text_is_refused_as_such(tmp_path):
    (tmp_path / "a.rec").write_bytes(b"\x89REC\r\n\x1a\n\0\0\0")
    with pytest.raises(DataError, match=r"format '.rec'; expected text of any ending"):
        import_table(tmp_path / "a.rec")


def test_a_sheet_may_have_titles_and_units_around_its_names(tmp_path, frame):
    """Title, a blank row, who did it, names, units, numbers: as people write workbooks."""
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Messung vom 12.03.2026"])
    sheet.append([])
    sheet.append(["operator", "A. B."])
    sheet.append(["time", *frame.columns[1:]])
    sheet.append(["ms", *("rad" if n[:2] != "ta" else "Nm" for n in frame.columns[1:])])
    for row in frame.itertuples(index=False):
        sheet.append([1e3 * row[0], *row[1:]])
    path = tmp_path / "lab.xlsx"
    book.save(path)
    plain = tmp_path / "plain.csv"
    frame.to_csv(plain, index=False)
    found, same = (import_table(p).recordings[0] for p in (path, plain))
    np.testing.assert_allclose(found.t, same.t, atol=1e-12)
    np.testing.assert_allclose(found.q, same.q, rtol=1e-14)  # a workbook keeps 16 digits
    np.testing.assert_allclose(found.tau, same.tau, rtol=1e-14)


def test_times_of_day_in_a_sheet_are_times(tmp_path, frame):
    """A cell of a time of day, or of a time span, is in seconds."""
    seconds = frame["t"].round(6)
    for k, kind in enumerate(("time", "span")):
        spans = [timedelta(seconds=float(x)) for x in seconds]
        noon = datetime(2026, 3, 12, 12)
        cells = [(noon + s).time() for s in spans] if kind == "time" else spans
        path, book = tmp_path / f"{k}.xlsx", openpyxl.Workbook()
        book.active.append(list(frame.columns))
        for cell, row in zip(cells, frame.itertuples(index=False), strict=True):
            book.active.append([cell, *row[1:]])
        book.save(path)
        t = import_table(path).recordings[0].t
        np.testing.assert_allclose(t - t[0], seconds - seconds[0], atol=2e-3)


def test_the_signs_of_an_older_program_are_read(tmp_path, frame):
    """A degree sign in Latin-1, as spreadsheets of Windows write it; other bytes are no text."""
    path = tmp_path / "old.csv"
    text = frame.assign(q1=np.degrees(frame["q1"])).to_csv(index=False)
    text = text.replace("q1,", "Winkel [°],", 1)
    path.write_bytes(text.encode("cp1252"))
    rules = {"columns": {"q1": {"from": "Winkel [°]", "unit": "deg"}}}
    found = import_table(path, parse_map(rules)).recordings[0]
    np.testing.assert_allclose(found.q[:, 0], frame["q1"], rtol=1e-12)
    path.write_bytes(text.encode("cp1252").replace(b"\xb0", b"\x81"))
    with pytest.raises(DataError, match=r"behind row 0 are bytes that are no letters"):
        import_table(path)


def test_a_log_of_a_known_program_is_recognised_where_it_is_refused(tmp_path, frame):
    renamed = {"t": "time"}
    for k in range(1, 1 + sum(n.startswith("tau") for n in frame.columns)):
        renamed |= {f"q{k}": f"state.q[{k - 1}]", f"tau{k}": f"state.tau_J[{k - 1}]"}
    path = tmp_path / "log.csv"
    frame.rename(columns=renamed).to_csv(path, index=False)
    with pytest.raises(DataError, match=r"columns of a libfranka log: read it with --map libfra"):
        import_table(path)


def test_a_data_set_without_efforts_says_that_these_are_needed(tmp_path, frame):
    """Most LeRobot sets have positions and commands alone."""
    place = tmp_path / "set" / "data" / "chunk-000"
    place.mkdir(parents=True)
    (tmp_path / "set" / "meta").mkdir()
    (tmp_path / "set" / "meta" / "info.json").write_text('{"codebase_version": "v2.1"}')
    q = frame[["q1", "q2"]].to_numpy().tolist()
    told = {"observation.state": q, "action": q, "timestamp": frame["t"]}
    parquet.write_table(pa.table(told), place / "episode_000000.parquet")
    needed = r"no column 'tau1', 'tau2' .*without the motors' efforts no model.*import TABLE"
    with pytest.raises(DataError, match=needed):
        import_table(tmp_path / "set", read_map("lerobot"))


def test_words_for_nothing_are_missing_values(tmp_path):
    table = tmp_path / "run.csv"
    rows = [f"{0.01 * k},{0.1 * k},{0.2 * k}" for k in range(40)]
    for at, word in zip((5, 9, 14, 20, 26), ("N/A", "null", "-", "None", ""), strict=True):
        rows[at] = f"{0.01 * at},{word},{0.2 * at}"
    table.write_text("t,q1,tau1\n" + "\n".join(rows) + "\n")
    (found,) = import_table(table, missing="drop").recordings
    assert found.n == 35
    (filled,) = import_table(table, missing="interpolate").recordings
    np.testing.assert_allclose(filled.q[:, 0], 0.1 * np.arange(40), atol=1e-12)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_wide_letters_without_a_mark(tmp_path, encoding):
    table = tmp_path / "run.csv"
    rows = "".join(f"{0.01 * k:.2f},{0.1 * k:.1f},0.5\n" for k in range(30))
    table.write_bytes(("t,q1,tau1\n" + rows).encode(encoding))
    (found,) = import_table(table).recordings
    assert found.n == 30 and found.q[3, 0] == 0.3


def test_what_a_time_is_is_said(tmp_path):
    def told(first, step):
        table = tmp_path / "run.csv"
        cells = [
            f"{first + step * k:.3f}" if isinstance(first, float) else first(k) for k in range(30)
        ]
        table.write_text(
            "t,q1,tau1\n" + "".join(f"{c},{0.1 * k},0.5\n" for k, c in enumerate(cells))
        )
        found = import_table(table)
        assert found.recordings[0].period == pytest.approx(0.01, abs=1e-5)
        return " ".join(found.notes)

    assert "is the time of day" in told(lambda k: f"12:00:00.{10 * k:03d}", 0.0)
    assert "since 1904; it begins at 2025-12-31" in told(3850000000.0, 0.01)


def test_saved_objects_are_refused_in_a_sentence(tmp_path):
    np.save(tmp_path / "p.npy", np.array([{"q": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(DataError, match="holds Python objects, which are never read"):
        import_table(tmp_path / "p.npy")


def test_the_rate_of_rows_whose_stamps_mostly_repeat_is_finite(tmp_path):
    table = tmp_path / "run.csv"
    rows = "".join(f"{0.01 * (k // 3):.2f},{0.1 * k},0.5\n" for k in range(60))
    table.write_text("t,q1,tau1\n" + rows)
    (found,) = import_table(table).recordings
    assert found.rate == pytest.approx(59 / 0.19)


def _rows_of_samples(run):
    """Arrays with a sample a column, as signal processing has them."""
    return {
        "time": run.t[:200][None],
        "u": np.hstack([run.q, run.qd])[:200].T,
        "y": run.tau[:200].T,
    }


def test_arrays_with_a_sample_a_column_are_turned_and_it_is_said(tmp_path, run, capsys):
    savemat(tmp_path / "run.mat", _rows_of_samples(run))
    names = {"t": "time", "q1": "u1", "q2": "u2", "qd1": "u3", "qd2": "u4", "tau1": "y1"}
    mapping = parse_map({"columns": {**names, "tau2": "y2"}})
    found = import_table(tmp_path / "run.mat", mapping)
    assert np.array_equal(found.recordings[0].q, run.q[:200])
    assert np.array_equal(found.recordings[0].tau, run.tau[:200])
    assert found.notes[0].endswith("a sample is a column: u (4 x 200), y (2 x 200)")
    # not where an array beside them has as many rows
    square = {**_rows_of_samples(run), "other": np.zeros((200, 2))}
    savemat(tmp_path / "both.mat", square)
    assert "u200" in open_table(tmp_path / "both.mat").names


def _of_two_runs(run, test):
    """As benchmarks have it: inputs and outputs to fit and to test on, in one file."""
    return {
        "time_train": run.t[None, :200], "u_train": run.tau[:200].T, "y_train": run.q[:200].T,
        f"time_{test}": run.t[None, :90], f"u_{test}": run.tau[:90].T, f"y_{test}": run.q[:90].T,
    }  # fmt: skip


def test_arrays_of_two_runs_in_one_file_are_two_runs(tmp_path, run, capsys):
    savemat(tmp_path / "run.mat", _of_two_runs(run, "test"))
    assert run_names(tmp_path / "run.mat") == ["train", "test"]
    names = {"t": "time", "q1": "y1", "q2": "y2", "tau1": "u1", "tau2": "u2"}
    for name, n in (("train", 200), ("test", 90)):
        found = import_table(tmp_path / "run.mat", parse_map({"columns": names}), run=name)
        assert np.array_equal(found.recordings[0].q, run.q[:n])
        assert np.array_equal(found.recordings[0].tau, run.tau[:n])


def test_arrays_of_one_length_with_alike_endings_are_one_run(tmp_path, run):
    alike = {f"{k}_{arm}": run.t[:200] + n for n, arm in enumerate(("a", "b")) for k in ("q", "u")}
    np.savez(tmp_path / "run.npz", **alike)
    assert run_names(tmp_path / "run.npz") == []
    assert open_table(tmp_path / "run.npz").names == tuple(alike)
    # the endings say it where the lengths do not
    same = {f"{k}_{run_}": run.t[:200] for run_ in ("train", "val") for k in ("q", "u")}
    np.savez(tmp_path / "same.npz", **same)
    assert run_names(tmp_path / "same.npz") == ["train", "val"]
    # an array more belongs to no run
    np.savez(tmp_path / "more.npz", **_of_two_runs(run, "x"), gain=run.t[:7])
    assert run_names(tmp_path / "more.npz") == []


def test_a_bare_array_with_a_sample_a_column_is_turned(tmp_path, frame):
    np.save(tmp_path / "run.npy", frame.to_numpy().T)
    found = import_table(tmp_path / "run.npy", npy(frame, tmp_path / "other.npy"))
    assert np.array_equal(found.recordings[0].q[:, 0], frame["q1"])
    assert "rows and columns exchanged" in found.notes[0]


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_text_without_a_header_row_gets_its_names_from_a_map(tmp_path, frame, delimiter):
    names = ", ".join(repr(n) for n in frame.columns)
    (tmp_path / "names.toml").write_text(f"[table]\ncolumns = [{names}]\n")
    path = tmp_path / "run.txt"
    rows = frame.to_csv(index=False, header=False, sep=delimiter)
    path.write_text(f"recorded by hand\n\n{rows}")
    found = import_table(path, read_map(tmp_path / "names.toml"))
    assert np.array_equal(found.recordings[0].tau[:, 1], frame["tau2"])
    assert found.recordings[0].n == len(frame)


def test_text_without_a_header_row_and_without_names_says_what_to_write(tmp_path, frame):
    path = tmp_path / "run.csv"
    frame.to_csv(path, index=False, header=False)
    with pytest.raises(DataError, match=r"row 1 holds numbers.*their 7 names in a map: \[table\]"):
        import_table(path)
    with pytest.raises(DataError, match=r"the map names 2 columns.*its rows hold 7 numbers"):
        import_table(path, parse_map({"table": {"columns": ["t", "q1"]}}))
    path.write_text("nothing\nof this\n")
    with pytest.raises(DataError, match="no row near its begin holds numbers alone"):
        import_table(path, parse_map({"table": {"columns": ["t", "q1"]}}))


def test_a_rate_stands_for_the_times_that_a_table_lacks(tmp_path, frame, capsys):
    path, out = tmp_path / "run.csv", str(tmp_path / "s.mcap")
    frame.drop(columns="t").to_csv(path, index=False)
    assert main(["import", str(path), "-o", out]) == 2
    assert "--rate HZ" in capsys.readouterr().err
    assert main(["import", str(path), "-o", out, "--rate", "250"]) == 0
    assert load(out).t[-1] == pytest.approx(199 / 250)
    for wrong in ("0", "-5", "fast", "inf", "nan"):
        with pytest.raises(SystemExit) as ended:
            main(["import", str(path), "-o", out, f"--rate={wrong}"])
        assert ended.value.code == 2
        assert "samples per second" in capsys.readouterr().err


def test_columns_of_a_map_that_an_array_has_not_are_told_with_those_that_it_has(tmp_path):
    np.save(tmp_path / "run.npy", np.zeros((30, 5)))
    given = parse_map({"table": {"columns": ["t", "q1", "tau1", "qd1"]}})
    with pytest.raises(DataError, match=r"no 2-D array of 4 columns.*; it has \w+ \(30, 5\)$"):
        import_table(tmp_path / "run.npy", given)


@pytest.mark.parametrize(
    ("times", "mapped", "said"),
    [
        (lambda t: t, "", "the rate of 100 Hz is taken, and not the column 't', which in seconds"),
        (lambda t: t, 't = "t"', "the rate of 100 Hz is not taken: the map names the column of"),
        (lambda t: np.arange(t.size), "", ""),
        (lambda t: 5 * t, "", ""),  # of 500 Hz
        (lambda t: 5e3 * t, "", ""),
        (lambda t: t[::-1], "", ""),
    ],
)
def test_a_rate_beside_times_that_contradict_it_is_told(tmp_path, frame, times, mapped, said):
    path = tmp_path / "run.csv"
    frame.assign(t=times(0.002 * np.arange(len(frame)))).to_csv(path, index=False)
    notes = import_table(path, parse_map(tomllib.loads(f"[columns]\n{mapped}")), rate_hz=100).notes
    assert [n for n in notes if "the rate of" in n] == [n for n in notes if said and said in n]
    assert bool(said) == any(said in n for n in notes if said)


def test_a_table_in_si_units_is_analysed_as_it_is(tmp_path, run, capsys):
    path, session = tmp_path / "run.csv", str(tmp_path / "s.mcap")
    pd.DataFrame(columns(run)).assign(room=21.0).to_csv(path, index=False)
    assert main(["import", str(path), "-o", session]) == 0
    capsys.readouterr()
    assert main(["compare", session, "--json"]) == 0
    brought_in = json.loads(capsys.readouterr().out)
    assert main(["compare", str(path), "--json"]) == 0
    said = capsys.readouterr()
    as_it_is = json.loads(said.out)
    assert as_it_is["joints"] == brought_in["joints"]
    assert "run.csv: columns by their names, in SI units" in said.err
    assert "unit m is for axes that slide); not used: room" in said.err
    one, two = hil.load(path, joints=["joint2"]), hil.load(session, joints=["joint2"])
    assert one.joints == ("joint2",) == two.joints
    assert np.array_equal(one.q, two.q)


def test_a_table_that_needs_a_map_says_which_command_takes_one(tmp_path, run, capsys):
    path = tmp_path / "run.csv"
    frame = pd.DataFrame(columns(run)).rename(columns={"q1": "shoulder [deg]"})
    frame.to_csv(path, index=False)
    assert main(["diagnose", str(path)]) == 2
    said = capsys.readouterr().err
    assert "has no column" in said
    assert "'hil import" in said
