"""Bad input to `hil import`: one clear message, exit 2, nothing written over."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import plants
import pytest
from record_tables import URDF, columns, write_csv
from scipy.io import savemat

from hil.cli import main
from hil.errors import ConfigError, DataError
from hil.models.urdf import UrdfRobot
from hil.record import binary_tables
from hil.record.checks import check
from hil.record.mcap_read import load
from hil.record.sources import load_source
from hil.record.tables import import_table
from hil.record.urdf_checks import urdf_joints

Table = dict[str, np.ndarray]


@pytest.fixture
def refuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Import must fail with one line that holds some words, and leave the old output."""

    def run(table: Path, *words: str, options: tuple[str, ...] = ()) -> str:
        output = tmp_path / "s.mcap"
        output.write_bytes(b"old")
        before = {p.name for p in tmp_path.iterdir()}
        assert main(["import", str(table), "-o", str(output), *options]) == 2
        assert output.read_bytes() == b"old"
        assert {p.name for p in tmp_path.iterdir()} == before
        message = capsys.readouterr().err
        assert message.count("\n") == 1
        for word in words:
            assert word in message
        return message

    return run


def changed(tmp_path: Path, change: Callable[[Table], object], d: int = 2) -> Path:
    table = columns(plants.joints(d=d))
    change(table)
    return write_csv(tmp_path / "run.csv", table)


def put(name: str, where: int | slice, value: float) -> Callable[[Table], object]:
    def change(table: Table) -> None:
        table[name] = table[name].copy()
        table[name][where] = value

    return change


def test_missing_effort(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: c.pop("tau2")), "'tau2'", "It has: t, q1", "[columns]")


def test_missing_time(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: c.pop("t")), "'t'", "rate_hz")


def test_missing_all_positions(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: (c.pop("q1"), c.pop("q2"))), "'q1'")


def test_one_velocity_of_two(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: c.pop("qd1")), "'qd1'", "2 joints")


def test_more_efforts_than_joints(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: c.update(tau3=c["tau1"])), "tau3", "positions of 2 joints")


def test_force_incomplete(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: c.update(fx=c["tau1"])), "'fy'")


def test_not_a_number(tmp_path, refuse):
    table = changed(tmp_path, lambda c: None)
    lines = table.read_text().splitlines()
    cells = lines[41].split(",")
    cells[1] = "off"
    lines[41] = ",".join(cells)
    table.write_text("\n".join(lines))
    refuse(table, "row 42", "'q1'", "'off'")


def test_row_too_short(tmp_path, refuse):
    table = changed(tmp_path, lambda c: None)
    lines = table.read_text().splitlines()
    lines[10] = "1,2"
    table.write_text("\n".join(lines))
    refuse(table, "row 11", "2 cells", "expected 7")


def test_empty_cells_are_missing_values(tmp_path, refuse):
    table = tmp_path / "run.csv"
    rows = [f"{k * 0.001},{k * 0.01},{'' if k in (3, 7) else 1.0}" for k in range(100)]
    table.write_text("t,q1,tau1\n" + "\n".join(rows))
    refuse(table, "'tau1'", "2 missing", "rows 5, 9")


def test_nan_how_many_and_where(tmp_path, refuse):
    change = put("tau1", slice(10, 18), np.nan)
    refuse(changed(tmp_path, change), "'tau1'", "8 missing", "rows 12, 13, 14")


def strict(tmp_path: Path, key: str) -> str:
    (tmp_path / "strict.toml").write_text(f'[table]\n{key} = "refuse"\n')
    return str(tmp_path / "strict.toml")


def test_repeated_time_where_it_is_to_be_refused(tmp_path, refuse):
    table = changed(tmp_path, put("t", 100, 99 / 500))
    options = ("--map", strict(tmp_path, "repeated"))
    refuse(table, "1 repeated", "row 102", "repeated", options=options)


def test_backward_time(tmp_path, refuse):
    refuse(changed(tmp_path, put("t", 100, 0.0)), "backward", "row 102")


def test_jumping_time_where_it_is_to_be_refused(tmp_path, refuse):
    def jump(c: Table) -> None:
        c["t"] = c["t"] + np.where(np.arange(c["t"].size) >= 700, 5.0, 0.0)

    table = changed(tmp_path, jump)
    options = ("--map", strict(tmp_path, "gaps"))
    refuse(table, "jumps 1 times", "row 702", "gaps", options=options)


def test_time_in_milliseconds(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: c.update(t=1e3 * c["t"])), "milliseconds", 'unit = "ms"')


@pytest.mark.parametrize(
    ("period", "words"),
    [
        (0.2, ("5 Hz", "20 Hz is the slowest that is analysed", "Record faster")),
        (0.1, ("10 Hz", "without a word of its unit 20 Hz is the slowest", 'unit = "s"')),
        (5.0, ("it looks like milliseconds (200 Hz)", 'unit = "ms"')),
    ],
)
def test_a_slow_time_is_refused_for_what_it_is(tmp_path, refuse, period, words):
    def slower(c):
        c.update(t=period * np.arange(c["t"].size))

    refuse(changed(tmp_path, slower), *words)


@pytest.mark.parametrize(
    "said", ['[columns]\nt = { from = "t", unit = "s" }', "[table]\nrate_hz = 10"]
)
def test_ten_a_second_are_taken_where_the_map_says_so(tmp_path, said):
    """As benchmarks of large robots are thinned out to."""
    slow = tmp_path / "slow.csv"

    def slower(c):
        c.update(t=0.1 * np.arange(c["t"].size))

    slow.write_bytes(changed(tmp_path, slower).read_bytes())
    words = ["import", str(slow), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    place = tmp_path / "m.toml"
    place.write_text(f'schema = "hil.map/1"\n{said}\n')
    assert main([*words, "--map", str(place)]) == 0
    (fault,) = (f for f in check(load(tmp_path / "s.mcap")) if f.code == "sample-rate")
    assert fault.severity == "warning" and "10 Hz" in fault.text


@pytest.mark.parametrize("off", [-7e-16, 7e-16, 5e-4])
def test_twenty_a_second_are_taken_however_the_period_rounds(tmp_path, off):
    """A clock that is a hundredth slow, too: the same rig was refused in every second recording."""
    table = changed(tmp_path, lambda c: c.update(t=(0.05 + off) * np.arange(c["t"].size)))
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 0


def test_degrees_without_a_robot(tmp_path, refuse):
    table = changed(tmp_path, lambda c: c.update(q1=57.3 * c["q1"]))
    refuse(table, "q1", "degrees", "scale = 0.01745", 'unit = "rad"')


def test_a_wide_range_whose_unit_was_said_is_not_doubted(tmp_path, capsys):
    """A turntable turns more than once; the same numbers without a unit are refused."""

    def turning(c):
        turned = {"t": c["t"], "table angle": np.degrees(9.0 * c["q1"]), "tau1": c["tau1"]}
        c.clear()
        c.update(turned)

    table, said = changed(tmp_path, turning), tmp_path / "m.toml"
    start = "schema = 'hil.map/1'\n[columns]\nt = 't'\ntau1 = 'tau1'\nq1 = "
    said.write_text(start + "{ from = 'table angle' }")
    words = ["import", str(table), "--map", str(said), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    assert 'from = "table angle", scale' in capsys.readouterr().err
    said.write_text(start + "{ from = 'table angle', unit = 'deg' }")
    assert main(words) == 0
    assert np.ptp(load(tmp_path / "s.mcap").q[:, 0]) > 2 * np.pi
    assert main(["info", str(tmp_path / "s.mcap")]) == 0
    assert "is it in degrees" not in capsys.readouterr().out


def test_degrees_against_the_limits(tmp_path, refuse):
    (tmp_path / "two.urdf").write_text(URDF)
    table = changed(tmp_path, lambda c: c.update(q2=57.3 * c["q2"]))
    options = ("--robot", str(tmp_path / "two.urdf"))
    refuse(table, "q2 (elbow)", "degrees", "limits -2 to 2", options=options)


def test_degrees_beside_a_velocity_in_radians(tmp_path, refuse):
    table = changed(tmp_path, lambda c: c.update(q1=57.2958 * 0.1 * c["q1"], qd1=0.1 * c["qd1"]))
    refuse(table, "q1 is in degrees", "scale = 0.01745")


def test_preset_of_another_robot(tmp_path, refuse):
    (tmp_path / "m.toml").write_text("[robot]\npreset = 'phantom-premium-1.5'")
    table, options = changed(tmp_path, lambda c: None), ("--map", str(tmp_path / "m.toml"))
    refuse(table, "3 joints", "2 position columns", options=options)
    (tmp_path / "m.toml").write_text("[robot]\npreset = 'phantom'")
    refuse(table, "unknown robot preset 'phantom'", options=options)


def test_empty_file(tmp_path, refuse):
    (tmp_path / "run.csv").write_text("")
    refuse(tmp_path / "run.csv", "is empty")


def test_blank_file(tmp_path, refuse):
    (tmp_path / "run.csv").write_text("\n\n")
    refuse(tmp_path / "run.csv", "is empty")


def test_header_only(tmp_path, refuse):
    (tmp_path / "run.csv").write_text("t,q1,tau1\n")
    refuse(tmp_path / "run.csv", "no samples")


def test_no_header(tmp_path, refuse):
    (tmp_path / "run.csv").write_text("0,1,2\n1,2,3\n")
    refuse(tmp_path / "run.csv", "header row")


def test_column_twice(tmp_path, refuse):
    (tmp_path / "run.csv").write_text("t,q1,q1,tau1\n0,1,2,3\n")
    refuse(tmp_path / "run.csv", "'q1' stands twice")


def test_no_such_file(tmp_path, refuse):
    refuse(tmp_path / "nothing.csv", "No such file")


def test_unknown_format(tmp_path, refuse):
    (tmp_path / "run.xls").write_bytes(b"\xd0\xcf\x11\xe0" + bytes(600))
    refuse(tmp_path / "run.xls", ".xls", "expected text", ".xlsx")


def test_binary_named_csv(tmp_path, refuse):
    (tmp_path / "run.csv").write_bytes(bytes(range(128, 256)))
    refuse(tmp_path / "run.csv", "not a text file")


@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_damaged_arrays(tmp_path, refuse, suffix):
    (tmp_path / f"run.{suffix}").write_bytes(b"this is neither of the two formats" * 10)
    refuse(tmp_path / f"run.{suffix}", "is not a")


def test_text_in_arrays(tmp_path, refuse):
    np.savez(tmp_path / "run.npz", t=np.arange(9) / 100, q1=np.arange(9), tau1=np.array(["a"] * 9))
    refuse(tmp_path / "run.npz", "'tau1'", "expected numbers")


def test_arrays_of_different_lengths(tmp_path, refuse):
    np.savez(tmp_path / "run.npz", t=np.arange(9) / 100, q1=np.arange(8), tau1=np.arange(9))
    refuse(tmp_path / "run.npz", "different lengths", "q1 8")


def test_urdf_of_another_robot(tmp_path, refuse):
    (tmp_path / "two.urdf").write_text(URDF)
    options = ("--robot", str(tmp_path / "two.urdf"))
    table = changed(tmp_path, lambda c: None, d=3)
    refuse(table, "2 moving joints (shoulder, elbow)", "3 position", options=options)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("<robot", "does not parse"),
        ("<html/>", "<robot>"),
        ("<robot/>", "no moving joint"),
        (URDF.replace('"revolute"', '"floating"'), "floating"),
    ],
)
def test_urdf_that_is_none(tmp_path, refuse, text, word):
    (tmp_path / "bad.urdf").write_text(text)
    table = changed(tmp_path, lambda c: None)
    refuse(table, "bad.urdf", word, options=("--robot", str(tmp_path / "bad.urdf")))


def test_urdf_missing(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: None), "no.urdf", options=("--robot", "no.urdf"))


def test_unknown_tip(tmp_path, refuse):
    (tmp_path / "two.urdf").write_text(URDF)
    options = ("--robot", str(tmp_path / "two.urdf"), "--tip", "handd")
    refuse(changed(tmp_path, lambda c: None), "Did you mean 'hand'", options=options)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("[columns]\nq1 = 'angle'", "unknown column 'angle'"),
        ("[colums]\nq1 = 'q1'", "Did you mean 'columns'"),
        ("[columns]\nspeed1 = 'qd1'", "unknown column of a recording 'speed1'"),
        ("[columns]\nq1 = { from = 'q1', factor = 2 }", "'factor'"),
        ("[columns]\nq1 = { from = 'q1', scale = 'two' }", "expected a number"),
        ("[columns]\nq1 = { from = 'q1', sign = 2 }", "1 or -1"),
        ("[columns]\nq1 = { scale = 2 }", "'from' and 'sum'"),
        ("[columns]\nq1 = true", "expected a name"),
        ("columns = 3", "must be a table"),
        ("[robot]\nunit = 'deg'", "unknown unit 'deg'"),
        ("[robot]\nurdf = 'a'\npreset = 'b'", "keep one"),
        ("[table]\ngaps = 'some'", "table.gaps"),
        ("[table]\nrate_hz = 'fast'", "expected a number"),
        ("[offsets.run]\nq7 = 1.0", "unknown column 'q7'"),
        ("[offsets.run]\nleft.q1 = 1.0", "unknown arm 'left'"),
        ("schema = 'hil.model/1'", "expected 'hil.map/1'"),
        ("[columns", "cannot be read"),
        ("[extras]\nq1 = 'q1'", "name it in [columns]"),
        ("[extras]\nqg = 'none'", "unknown column 'none'"),
        ("[extras]\nQ_ = 'q1'", "field 'Q_'"),
        ("[table]\njoin = { other = 'none.csv' }", "none.csv"),
    ],
)
def test_bad_map(tmp_path, refuse, text, word):
    (tmp_path / "m.toml").write_text(text)
    refuse(changed(tmp_path, lambda c: None), word, options=("--map", str(tmp_path / "m.toml")))


def test_no_such_map(tmp_path, refuse):
    options = ("--map", "none.toml")
    refuse(changed(tmp_path, lambda c: None), "no built-in map", "emps", options=options)


def test_run_of_a_table_without_runs(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: None), "--run", options=("--run", "first"))


def test_unknown_run(tmp_path, refuse):
    np.savez(tmp_path / "runs.npz", alpha=np.ones((9, 3)), beta=np.ones((9, 3)))
    (tmp_path / "m.toml").write_text("[table]\ncolumns = ['t', 'q1', 'tau1']")
    options = ("--map", str(tmp_path / "m.toml"))
    refuse(tmp_path / "runs.npz", "2 runs", "alpha, beta", options=options)
    refuse(tmp_path / "runs.npz", "'alpha'", options=(*options, "--run", "alpa"))


def test_missing_output_folder(tmp_path, capsys):
    table = changed(tmp_path, lambda c: None)
    assert main(["import", str(table), "-o", str(tmp_path / "none" / "s.mcap")]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_output_is_the_table(tmp_path, capsys):
    table = changed(tmp_path, lambda c: None)
    before = table.read_text()
    assert main(["import", str(table), "-o", str(table)]) == 2
    assert table.read_text() == before


def test_time_that_no_session_can_hold(tmp_path, refuse):
    refuse(changed(tmp_path, lambda c: c.update(t=c["t"] + 1.7e12)), "expected seconds")


def test_all_runs_of_one(tmp_path, refuse):
    table = changed(tmp_path, lambda c: None)
    refuse(table, "leave --all-runs out", options=("--all-runs",))


# what a file claims, and what no table of samples has


def test_a_cell_of_many_characters(tmp_path, refuse):
    (tmp_path / "run.csv").write_text("t,q1,tau1\n0,1,2\n1," + "7" * 200_000 + ",x\n")
    refuse(tmp_path / "run.csv", "row 3", "field limit")
    (tmp_path / "run.csv").write_text("t,q1,tau1\n0,1,2\n1," + "x" * 50_000 + ",3\n")
    assert len(refuse(tmp_path / "run.csv", "row 3", "'q1'", "...")) < 1000
    (tmp_path / "run.csv").write_text("t,q1,tau1\n" + "7" * 2**21 + "\n")
    refuse(tmp_path / "run.csv", "row 2", "characters")
    (tmp_path / "run.csv").write_text('t,q1,tau1\n0,"' + "1\n" * 100_000)  # a quote never closed
    refuse(tmp_path / "run.csv", "row")
    (tmp_path / "run.csv").write_text("t,q1,tau1\n0,1,\0\n")
    refuse(tmp_path / "run.csv", "row 2")


def test_a_header_of_many_columns(tmp_path, refuse):
    (tmp_path / "run.csv").write_text(",".join(f"c{k}" for k in range(100_000)) + "\n1,2\n")
    refuse(tmp_path / "run.csv", "100000 columns", "at most 4096")
    (tmp_path / "run.csv").write_text("t,q1,tau1," + "n" * 5000 + "\n0,1,2,3\n")
    refuse(tmp_path / "run.csv", "5000 characters")
    np.savez(tmp_path / "run.npz", t=np.arange(9.0), q=np.zeros((2, 9000)))
    refuse(tmp_path / "run.npz", "'q'", "9000 columns", "exchanged")
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pa.table({f"c{k}": [0.0] for k in range(5000)}), tmp_path / "run.parquet")
    refuse(tmp_path / "run.parquet", "5000 arrays", "at most 4096")


def test_what_is_no_regular_file(tmp_path, refuse):
    os.mkfifo(tmp_path / "run.csv")
    (tmp_path / "run.npz").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "run.mat")
    for name in ("run.csv", "run.npz", "run.mat"):
        refuse(tmp_path / name, name, "regular file")
    (tmp_path / "run.csv").unlink()
    (tmp_path / "map.toml").symlink_to("/dev/zero")
    table = changed(tmp_path, lambda c: None)
    refuse(table, "map.toml", "not a regular file", options=("--map", str(tmp_path / "map.toml")))


def npy(claimed: str, kind: str, data: bytes) -> bytes:
    """File of one array that claims a shape."""
    head = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {claimed}, }}"
    head += " " * (-(len(head) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode() + data


def test_an_array_that_claims_more_than_it_has(tmp_path, refuse):
    for claimed in ("(1000000000000,)", "(3000000000,)", "(2147483648, 4611686018427387904)"):
        with zipfile.ZipFile(tmp_path / "run.npz", "w") as box:
            box.writestr("t.npy", npy(claimed, "<f8", b"12345678"))
        refuse(tmp_path / "run.npz", "'t'", "claims")


def test_an_archive_that_unpacks_to_a_thousand_times_its_size(tmp_path, refuse):
    with zipfile.ZipFile(tmp_path / "run.npz", "w", zipfile.ZIP_DEFLATED) as box:
        data = bytes(8 * 10**6)
        for k in range(12):
            box.writestr(f"q{k + 1}.npy", npy("(1000000,)", "<f8", data))
    assert (tmp_path / "run.npz").stat().st_size < 10**6
    refuse(tmp_path / "run.npz", "claims 91.", "MiB")


def test_members_that_are_no_arrays_are_left_out(tmp_path, capsys):
    table = columns(plants.joints(d=1))
    np.savez(tmp_path / "run.npz", **table)
    with zipfile.ZipFile(tmp_path / "run.npz", "a") as box:
        box.writestr("README.txt", "recorded on a Monday")
    assert main(["import", str(tmp_path / "run.npz"), "-o", str(tmp_path / "s.mcap")]) == 0
    assert "1 joint" in capsys.readouterr().out


def test_columns_that_hold_no_real_numbers(tmp_path, refuse):
    table = columns(plants.joints(d=1))
    np.savez(tmp_path / "run.npz", **{**table, "tau1": table["tau1"] + 1j})
    refuse(tmp_path / "run.npz", "'tau1'", "complex128")
    np.savez(tmp_path / "run.npz", **{**table, "tau1": table["tau1"].astype("datetime64[s]")})
    refuse(tmp_path / "run.npz", "'tau1'", "expected numbers")
    savemat(tmp_path / "run.mat", {**table, "tau1": table["tau1"] * 1j})
    refuse(tmp_path / "run.mat", "'tau1'", "complex128")
    cells = np.empty(table["t"].size, object)
    cells[:] = "x"
    np.savez(tmp_path / "run.npz", **{**table, "tau1": cells})
    refuse(tmp_path / "run.npz", "'tau1'", "object")


def test_a_damaged_matlab_file(tmp_path, refuse, capsys):
    savemat(tmp_path / "good.mat", columns(plants.joints(d=1, seconds=1.0)), do_compression=False)
    good = (tmp_path / "good.mat").read_bytes()
    # a size of 2 GiB, a type that there is none of, an array of minus one row, a file cut off
    for at, new in ((132, b"\xff\xff\xff\x7f"), (128, b"\x63\0\0\0"), (160, b"\xff\xff\xff\xff")):
        (tmp_path / "run.mat").write_bytes(good[:at] + new + good[at + len(new) :])
        assert main(["import", str(tmp_path / "run.mat"), "-o", str(tmp_path / "x.mcap")]) in (0, 2)
    capsys.readouterr()
    (tmp_path / "run.mat").write_bytes(good[: len(good) // 2])
    refuse(tmp_path / "run.mat", "run.mat")


def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> Path:
    """A table whose reader does what `text` says."""
    (tmp_path / "reader.py").write_text(text)
    monkeypatch.setattr(binary_tables, "_WORDS", (sys.executable, str(tmp_path / "reader.py")))
    np.savez(tmp_path / "run.npz", t=np.arange(9.0))
    return tmp_path / "run.npz"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", ("signal 11", "damaged")),
        ("raise SystemExit(3)", ("wrote nothing", "damaged")),
        ("import sys; sys.stdout.write('x' * 100)", ("wrote nothing", "damaged")),
        ("import time; time.sleep(60)", ("not read within", "damaged")),
    ],
)
def test_a_reader_that_fails_or_hangs(tmp_path, refuse, monkeypatch, text, words):
    monkeypatch.setattr(binary_tables, "PATIENCE_S", 0.5)
    refuse(reader(tmp_path, monkeypatch, text), *words)


def test_what_a_reader_answers_is_checked_again(tmp_path, refuse, monkeypatch):
    for shape in ([10**12], [-1], [3, -5]):
        told = json.dumps({"arrays": [["t", None, "<f8", shape]]}).encode()
        answer = len(told).to_bytes(8, "little") + told
        text = f"import sys; sys.stdout.buffer.write({answer!r})"
        refuse(reader(tmp_path, monkeypatch, text), "it wrote too")


def test_memory_of_a_reader_is_limited(tmp_path):
    (tmp_path / "run.npz").write_bytes(b"x")
    script = (
        "from hil.record import binary_tables, readers\n"
        "readers.npz = lambda path, most: iter([('t', bytearray(2**33))])\n"
        f"print(binary_tables._answer({str(tmp_path / 'run.npz')!r}))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert "claims more memory than a file of its size may (64 MiB)" in done.stdout


def test_time_steps_of_a_femtosecond(tmp_path, refuse):
    table = changed(tmp_path, lambda c: c.update(t=1e-15 * np.arange(c["t"].size)))
    refuse(table, "1e-15 s a sample", "Scale it to seconds")


@pytest.mark.parametrize("name", ["a/b", "..", "a b", "a\nb", "x" * 65, "/"])
def test_an_arm_that_is_no_part_of_a_topic(tmp_path, refuse, name):
    refuse(changed(tmp_path, lambda c: None), "arm", "needed", options=("--arm", name))


def test_an_arm_of_a_map_that_is_no_part_of_a_topic(tmp_path, refuse):
    (tmp_path / "m.toml").write_text('[arms."a/b".columns]\nq1 = "q1"\n')
    table = changed(tmp_path, lambda c: None)
    refuse(table, "arm 'a/b'", options=("--map", str(tmp_path / "m.toml")))


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 10_000,
        "a." * 50_000 + "a = 1",
        "[" + "a." * 50_000 + "a]",
        "[table]\nrate_hz = 1" + "0" * 400,
        "[table]\nrate_hz = 1" + "0" * 5000,
        "x = 1\n" * 10**6,
    ],
)
def test_a_map_that_is_deeper_or_larger_than_any(tmp_path, refuse, text):
    (tmp_path / "m.toml").write_text(text)
    refuse(changed(tmp_path, lambda c: None), "m.toml", options=("--map", str(tmp_path / "m.toml")))


# robots that there are none of

LINK = '<link name="b"><inertial><mass value="{}"/><inertia ixx="{}" iyy="1" izz="1"/></inertial>'


def chain(n: int, kind: str = "revolute") -> str:
    joints = "".join(
        f'<link name="l{k + 1}"/><joint name="j{k}" type="{kind}"><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/><limit effort="1" velocity="1"/></joint>'
        for k in range(n)
    )
    return f'<robot name="r"><link name="l0"/>{joints}</robot>'


def with_mass(mass: str, moment: str = "1") -> str:
    return (
        f'<robot name="r"><link name="a"/>{LINK.format(mass, moment)}</link><joint name="j" '
        'type="continuous"><parent link="a"/><child link="b"/></joint></robot>'
    )


@pytest.mark.parametrize(
    ("urdf", "words"),
    [
        (with_mass("-1"), ("'b'", "mass", "not negative")),
        (with_mass("nan"), ("'b'", "mass", "expected 1 number")),
        (with_mass("1e300"), ("'b'", "mass", "SI units")),
        (with_mass("heavy"), ("'b'", "mass", "expected 1 number")),
        (with_mass("1", "-2"), ("'b'", "ixx", "not negative")),
        (chain(3000), ("3001 links", "at most 1000")),
        (chain(310), ("310 moving joints", "at most 300")),
        (chain(20) + "<", ("XML",)),
        (chain(2).replace('child link="l2"', 'child link="l0"'), ("loop",)),
        (chain(2).replace('child link="l2"', 'child link="l1"'), ("'l1'", "two parents")),
        (chain(2).replace('name="j1"', 'name="j0"'), ("'j0'", "twice")),
        ('<!DOCTYPE r [<!ENTITY a "aaaa">]>' + chain(1), ("document type",)),
        (chain(1).replace('effort="1"', 'effort="1 2"'), ("limit", "expected 1 number")),
        (chain(1).replace("<limit", '<origin xyz="0 0"/><limit'), ("origin", "3 numbers")),
        (chain(1).replace("<limit", '<mimic joint="x" offset="a"/><limit'), ("mimic",)),
        ("<a>" * 100_000, ("XML",)),
        (chain(1).replace("<limit", '<axis xyz="0 0 0"/><limit'), ("'j0'", "axis", "0 0 1")),
        (chain(1).replace("<joint", '<link name="lamp"/><joint'), ("l0, lamp", "the base")),
        (chain(2).replace('parent link="l1"', 'parent link="l9"'), ("'j1'", "link 'l9'", "l0, l1")),
        (chain(2).replace('child link="l2"', 'child link="l8"'), ("'j1'", "link 'l8'")),
        (chain(1).replace('effort="1"', 'effort="1_0"'), ("limit", "expected 1 number")),
        (with_mass("1_000"), ("'b'", "mass", "expected 1 number")),
        (with_mass("\u0661"), ("'b'", "mass", "expected 1 number")),
    ],
)
def test_a_robot_that_there_is_none_of(tmp_path, refuse, urdf, words):
    (tmp_path / "r.urdf").write_text(urdf)
    refuse(changed(tmp_path, lambda c: None), *words, options=("--robot", str(tmp_path / "r.urdf")))
    with pytest.raises(ConfigError):  # where it comes with a model or a session
        UrdfRobot(urdf)


def test_an_axis_of_a_joint_that_does_not_move_and_a_link_for_the_world_are_no_matter():
    text = chain(1).replace('"l0"', '"world"').replace("<limit", '<axis xyz="0 -1E0 .5"/><limit')
    text = text.replace("</robot>", '<link name="x"/><joint name="f" type="fixed"><parent ')
    text += 'link="l1"/><child link="x"/><axis xyz="0 0 0"/></joint></robot>'
    assert [j.name for j in urdf_joints(text)] == ["j0"]
    assert UrdfRobot(text).joints == ("j0",)


def test_a_long_chain_of_fixed_links_is_no_matter():
    text = chain(900, "fixed").replace("</robot>", "")
    text += (
        '<link name="x"/><joint name="j" type="continuous"><parent link="l900"/><child link="x"/>'
        "</joint></robot>"
    )
    assert [j.name for j in urdf_joints(text)] == ["j"]
    assert UrdfRobot(text).joints == ("j",)


@pytest.mark.parametrize(
    ("kind", "limits", "kept"),
    [
        ("revolute", 'lower="0" upper="0"', True),  # as exporters write where nobody filled it in
        ("revolute", 'velocity="1"', True),
        ("prismatic", 'lower="-0.1"', True),
        ("continuous", 'lower="2" upper="-1"', True),  # turns on, whatever stands there
        ("revolute", 'lower="2" upper="-1"', False),
        ("prismatic", 'lower="0.3" upper="0.3"', False),
        ("revolute", 'lower="1"', False),
    ],
)
def test_a_joint_that_its_limits_leave_no_range_is_refused_by_its_name(kind, limits, kept):
    text = chain(1, "fixed").replace("</robot>", "")
    text += (
        f'<link name="x"/><joint name="elbow" type="{kind}"><parent link="l1"/><child link="x"/>'
        f"<limit {limits}/></joint></robot>"
    )
    if kept:
        assert [j.name for j in urdf_joints(text)] == ["elbow"]
        return
    for read, error in ((urdf_joints, DataError), (UrdfRobot, ConfigError)):
        with pytest.raises(error, match=r"joint 'elbow'.* expected lower below upper"):
            read(text)


HOSTILE = {
    "words": "a,b,c\n" * 50_000,
    "commas": ("," * 1000 + "\n") * 300,
    "an open quote": '"' + "1,2\n" * 75_000,
    "blank rows": "\n" * 300_000,
    "long numbers": f"0,{'9' * 100_000},1\n" * 3,
    "zero bytes": "\0" * 300_000,
    "one long row": "1," * 150_000,
    "missing values": "nan,nan,nan\n" * 25_000,
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_text_table_takes_memory_in_proportion_to_its_size(tmp_path, text):
    """So text is read in this process."""

    def cost(name, body):
        path = tmp_path / name
        path.write_text("t,q1,tau1\n" + body)
        tracemalloc.start()
        try:
            import_table(path)
        except DataError as error:
            assert len(str(error)) < 1000
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    good = "".join(f"{k / 1000:.3f},{k % 7},{k % 5}\n" for k in range(25_000))
    peak, larger = cost("good.csv", good), cost("bad.csv", text)
    assert larger < max(peak, 64 * len(text)) and larger < 2**25


def test_cells_beyond_the_header_are_told(tmp_path, refuse):
    """A comma as decimal mark between commas: values were taken from the wrong cells."""
    table = tmp_path / "run.csv"
    table.write_text("t,q1,tau1\n0,0,0,2,1,5\n0,01,0,3,1,6\n")
    refuse(table, "row 2: 6 cells; expected 3", "decimal mark", "semicolons or tabs")
    longer = write_csv(tmp_path / "longer.csv", columns(plants.joints(d=1)))
    rows = longer.read_text().splitlines()
    rows[9] += ",1.0"
    longer.write_text("\n".join(rows) + "\n")
    refuse(longer, "row 10: 5 cells; expected 4")


def test_joints_that_are_counted_from_0(tmp_path, capsys, refuse):
    def shifted(c):
        for k in (1, 2):
            for stem in ("q", "qd", "tau"):
                c[f"{stem}{k - 1}"] = c.pop(f"{stem}{k}")

    table = changed(tmp_path, shifted)
    output = tmp_path / "s0.mcap"
    assert main(["import", str(table), "-o", str(output)]) == 0
    assert "count joints from 0: q0, qd0, tau0 are of the first one" in capsys.readouterr().out
    got, true = load(output), plants.joints(d=2)
    np.testing.assert_allclose(got.q, true.q, atol=1e-9)
    np.testing.assert_allclose(got.tau, true.tau, atol=1e-6)
    mixed = changed(tmp_path, lambda c: (shifted(c), c.update(tau2=c.pop("tau0"))))
    refuse(mixed, "q0 counts the joints from 0, and tau from 1")


def test_a_map_reads_the_unit_that_a_name_says(tmp_path, capsys):
    def named(c):
        turned = {"Time [ms]": 1e3 * c["t"], "p [deg]": np.degrees(c["q1"])}
        turned["motor (mNm)"] = 1e3 * c["tau1"]
        c.clear()
        c.update(turned)

    table, said = changed(tmp_path, named, d=1), tmp_path / "m.toml"
    rules = "t = 'Time [ms]'\nq1 = 'p [deg]'\ntau1 = 'motor (mNm)'\n"
    said.write_text(f"schema = 'hil.map/1'\n[columns]\n{rules}")
    output = tmp_path / "s.mcap"
    assert main(["import", str(table), "--map", str(said), "-o", str(output)]) == 0
    told = capsys.readouterr().out
    assert "q1 is read in deg" in told and "tau1 is read in mNm" in told
    got, true = load(output), plants.joints(d=1)
    np.testing.assert_allclose(got.q, true.q, atol=1e-9)
    np.testing.assert_allclose(got.tau, true.tau, rtol=1e-6, atol=1e-9)
    said.write_text(
        said.read_text().replace("'motor (mNm)'", "{ from = 'motor (mNm)', scale = 2 }")
    )
    assert main(["import", str(table), "--map", str(said), "-o", str(output)]) == 0
    np.testing.assert_allclose(load(output).tau, 2e3 * true.tau, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: 1e6 * t, ("microseconds", 'unit = "us"')),
        (lambda t: np.round(t * 500), ("it counts samples", "rate_hz")),
        (lambda t: np.floor(t) + 1.7e9, ("whole seconds", "rate_hz")),
    ],
)
def test_a_time_in_other_units_gets_the_advice_that_mends_it(tmp_path, refuse, change, words):
    refuse(changed(tmp_path, lambda c: c.update(t=change(c["t"]))), *words)


def test_more_torque_constants_than_joints(tmp_path, refuse):
    table = changed(tmp_path, lambda c: None)
    refuse(table, "3 torque constants for 2 joints", options=("--torque-constant", "1,2,3"))


def test_two_tables_at_once_are_refused_for_what_they_are(tmp_path, capsys):
    """Of one command that takes one; of an import, where -o names one session."""
    with pytest.raises(SystemExit) as stopped:
        main(["export", "a.toml", "b.toml", "--to", "c", "-o", str(tmp_path / "m.h")])
    assert stopped.value.code == 2
    assert "unexpected 'b.toml'; the command takes M.toml and options" in capsys.readouterr().err
    assert main(["import", "a.csv", "b.csv", "-o", str(tmp_path / "s.mcap")]) == 2
    said = capsys.readouterr().err
    assert "a.csv, b.csv: 2 recordings would be written into a folder" in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("rig.toml", '# mine\nschema = "hil.rig/1"\n', "it is a rig file: 'hil run "),
        ("m.toml", 'schema = "hil.model/1"\n', "it is a model file: give it with --model"),
        ("map.toml", 'schema = "hil.map/1"\n', "it is a map file: give it with --map"),
        ("arm.urdf", "<?xml version='1.0'?>\n<robot/>\n", "it is XML, as a robot's description"),
        ("s.mcap", "\x89MCAP0\r\n", "it is a session already (or a damaged one): 'hil info"),
    ],
)
def test_a_file_of_another_kind_is_told_as_what_it_is(tmp_path, capsys, name, text, said):
    path = tmp_path / name
    path.write_bytes(text.encode("latin-1"))
    assert main(["import", str(path), "-o", str(tmp_path / "o.mcap")]) == 2
    error = capsys.readouterr().err
    assert f"{name} is no table, {said}" in error and error.count("\n") == 1
    if name.endswith("toml"):
        assert main(["fit", str(path)]) == 2
        assert said in capsys.readouterr().err
        with pytest.raises(DataError, match=f"{name} is no table, it is a "):
            load_source(path)
