"""Bad input to `hil import`: one clear message, exit 2, nothing written over."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from record_tables import URDF, columns, recording, write_csv

from hil.cli import main

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
    table = columns(recording(d=d))
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
    refuse(changed(tmp_path, lambda c: c.update(tau3=c["tau1"])), "tau3", "only 2 joints")


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
    refuse(changed(tmp_path, lambda c: c.update(t=1e3 * c["t"])), "milliseconds", "scale = 0.001")


def test_degrees_without_a_robot(tmp_path, refuse):
    table = changed(tmp_path, lambda c: c.update(q1=57.3 * c["q1"]))
    refuse(table, "q1", "degrees", "scale = 0.01745", 'unit = "rad"')


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
    (tmp_path / "run.xls").write_text("x")
    refuse(tmp_path / "run.xls", ".xls", ".csv")


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
