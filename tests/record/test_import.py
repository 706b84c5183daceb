"""`hil import`: what it brings in."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import plants
import pytest
from record_tables import URDF, columns, write_csv
from scipy.io import savemat

import hil
from hil.cli import main
from hil.models.files import read_model
from hil.models.model import base_model
from hil.record.mcap_read import load, summary
from hil.record.recording import RobotSource
from hil.record.schema import read_fields


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_csv_comes_back_exactly(tmp_path, delimiter):
    r = plants.joints(d=3)
    table = write_csv(tmp_path / "run.csv", columns(r), delimiter)
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 0
    back = load(tmp_path / "s.mcap")
    np.testing.assert_array_equal(back.q, r.q)
    np.testing.assert_array_equal(back.qd, r.qd)
    np.testing.assert_array_equal(back.tau, r.tau)
    np.testing.assert_allclose(back.t, r.t, atol=1e-9)
    assert back.joints == ("joint1", "joint2", "joint3")
    assert back.arm == "arm"


def test_comma_as_decimal_mark(tmp_path):
    table = tmp_path / "run.csv"
    rows = [f"0,{k:03d};0,5{k};-1,25" for k in range(1, 60)]
    table.write_text("t;q1;tau1\n" + "\n".join(rows))
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 0
    assert load(tmp_path / "s.mcap").tau[0, 0] == -1.25


@pytest.mark.parametrize("kind", ["npz", "mat"])
@pytest.mark.parametrize("stacked", [True, False])
def test_arrays_by_name(tmp_path, kind, stacked):
    r = plants.joints(d=2)
    data = {"t": r.t, "q": r.q, "tau": r.tau} if stacked else columns(r)
    data = {**data, "gain": np.array(3.0)}
    path = tmp_path / f"run.{kind}"
    if kind == "npz":
        np.savez(path, **data)
    else:
        savemat(path, data)
    assert main(["import", str(path), "-o", str(tmp_path / "s.mcap")]) == 0
    np.testing.assert_array_equal(load(tmp_path / "s.mcap").q, r.q)


def test_force_temperature_current(tmp_path):
    r = plants.joints(d=1)
    extra = {n: np.full(r.n, k + 1.0) for k, n in enumerate(("fx", "fy", "fz", "i1", "temp1"))}
    table = write_csv(tmp_path / "run.csv", {**columns(r), **extra})
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 0
    back = load(tmp_path / "s.mcap")
    assert back.wrench[5].tolist() == [1, 2, 3, 0, 0, 0]
    assert back.current[5, 0] == 4
    assert back.temperature[5, 0] == 5


def test_urdf_names_the_joints_and_travels_along(tmp_path):
    (tmp_path / "two.urdf").write_text(URDF)
    table = write_csv(tmp_path / "run.csv", columns(plants.joints()))
    words = ["import", str(table), "-o", str(tmp_path / "s.mcap"), "--tip", "hand"]
    assert main([*words, "--robot", str(tmp_path / "two.urdf"), "--arm", "left"]) == 0
    back = load(tmp_path / "s.mcap")
    assert (back.joints, back.arm) == (("shoulder", "elbow"), "left")
    assert (back.robot.urdf, back.robot.tip) == (URDF, "hand")


def _named(r, form, degrees=False):
    """Columns with the joints' names, the second joint first; positions in degrees on request."""
    out = {"time": r.t}
    for k, joint in ((1, "elbow"), (0, "shoulder")):
        for what, x in (("position", r.q), ("velocity", r.qd), ("effort", r.tau)):
            if x is not None:
                unit = " [deg]" if degrees and what == "position" else ""
                scale = 180 / np.pi if unit else 1.0
                out[form.format(joint, what) + unit] = scale * x[:, k]
    return out


@pytest.mark.parametrize("degrees", [False, True])
@pytest.mark.parametrize("form", ["{1}.{0}", "/joint_states/{0}/{1}", "{0}_{1}"])
def test_columns_that_name_joints_of_the_robot_need_no_map(tmp_path, capsys, form, degrees):
    (tmp_path / "two.urdf").write_text(URDF)
    r = plants.joints()
    table = write_csv(tmp_path / "run.csv", _named(r, form, degrees))
    words = ["import", str(table), "-o", str(tmp_path / "s.mcap")]
    assert main([*words, "--robot", str(tmp_path / "two.urdf")]) == 0
    said = capsys.readouterr().out
    assert "by the joints and units that their names say: t = time, q1 = " in said
    back = load(tmp_path / "s.mcap")
    assert back.joints == ("shoulder", "elbow")
    np.testing.assert_allclose(back.q, r.q, atol=1e-12)
    np.testing.assert_array_equal(back.tau, r.tau)


def test_the_analyses_read_such_a_table_too_and_say_so(tmp_path):
    (tmp_path / "two.urdf").write_text(URDF)
    table = write_csv(tmp_path / "run.csv", _named(plants.joints(), "{1}_{0}", True))
    read = hil.load(table, robot=tmp_path / "two.urdf")
    assert "run.csv: columns by their names; columns are taken by" in read.metadata["note"]
    assert "SI" not in read.metadata["note"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("effort_elbow", "effort_wheel"),  # of no joint
        ("effort_", "torque_cmd_"),  # asked for, not measured
        ("effort_", "current_A_"),  # a factor is lacking
        ("position_elbow", "elbow"),  # its quantity is not said
        ("velocity_elbow", "speed_of_elbow_in_furlongs [furlong/s]"),
    ],
)
def test_names_that_leave_a_doubt_are_refused_with_the_way_out(tmp_path, capsys, old, new):
    (tmp_path / "two.urdf").write_text(URDF)
    r = plants.joints()
    made = _named(replace(r, qd=0 * r.q), "{1}_{0}")
    table = write_csv(tmp_path / "run.csv", {n.replace(old, new): x for n, x in made.items()})
    words = ["import", str(table), "-o", str(tmp_path / "s.mcap")]
    assert main([*words, "--robot", str(tmp_path / "two.urdf")]) == 2
    assert "--propose-map" in capsys.readouterr().err
    assert not (tmp_path / "s.mcap").exists()


def test_default_names_go_before_names_of_joints(tmp_path):
    (tmp_path / "two.urdf").write_text(URDF)
    r = plants.joints()
    table = write_csv(tmp_path / "run.csv", {**columns(r), "position_elbow": 0 * r.t})
    read = hil.load(table, robot=tmp_path / "two.urdf")
    np.testing.assert_array_equal(read.q, r.q)


def test_base_model_is_made_once(tmp_path, capsys):
    table = write_csv(tmp_path / "run.csv", columns(plants.joints()))
    words = ["import", str(table), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 0
    model = tmp_path / "s.model.toml"
    assert read_model(model).names() == base_model(RobotSource()).names()
    assert f"hil diagnose {tmp_path / 's.mcap'} --model {model}" in capsys.readouterr().out
    model.write_text("mine")
    assert main(words) == 0
    assert model.read_text() == "mine"


def test_json_is_alone_on_stdout(tmp_path, capsys):
    table = write_csv(tmp_path / "run.csv", {**columns(plants.joints()), "note": np.arange(3000.0)})
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "hil.import/1"
    assert found["unused"] == ["note"]
    assert found["arms"][0]["samples"] == 3000


def test_two_arms_and_runs_from_one_file(tmp_path, capsys):
    r = plants.joints(d=1)
    array = np.stack([r.t, r.q[:, 0], -r.q[:, 0], r.tau[:, 0]], axis=1)
    np.savez(tmp_path / "runs.npz", first=array, second=2 * array)
    (tmp_path / "m.toml").write_text("""
[table]
columns = ["t", "a", "b", "effort"]
[columns]
tau1 = "effort"
[arms.leader.columns]
q1 = "a"
[arms.follower.columns]
q1 = { from = "b", scale = 3.0, sign = -1, shift = 1.0 }
[offsets.first]
leader.q1 = 0.5
""")
    words = ["import", str(tmp_path / "runs.npz"), "--map", str(tmp_path / "m.toml")]
    assert main([*words, "--run", "first", "-o", str(tmp_path / "s.mcap")]) == 0
    assert summary(tmp_path / "s.mcap").arms == ("leader", "follower")
    np.testing.assert_allclose(load(tmp_path / "s.mcap", "leader").q, r.q + 0.5)
    np.testing.assert_allclose(load(tmp_path / "s.mcap", "follower").q, 3 * r.q + 1)
    assert main([*words, "--run", "second", "--arm", "leader", "-o", str(tmp_path / "l.mcap")]) == 0
    assert summary(tmp_path / "l.mcap").arms == ("leader",)
    assert "the offsets of the map are of first, none of second" in capsys.readouterr().out


def test_joined_table_without_time(tmp_path):
    r = plants.joints(d=1)
    write_csv(tmp_path / "effort.csv", {"value": r.tau[:, 0]})
    table = write_csv(tmp_path / "pos.csv", {"value": r.q[:, 0]})
    (tmp_path / "m.toml").write_text("""
[table]
rate_hz = 500
join = { drive = "effort.csv" }
[columns]
q1 = "value"
tau1 = { sum = { "drive.value" = 2.0, value = 1.0 } }
""")
    words = ["import", str(table), "--map", str(tmp_path / "m.toml")]
    assert main([*words, "-o", str(tmp_path / "s.mcap")]) == 0
    back = load(tmp_path / "s.mcap")
    np.testing.assert_allclose(back.tau, 2 * r.tau + r.q)
    assert back.rate == pytest.approx(500)


def test_declared_unit_settles_the_doubt(tmp_path):
    r = plants.joints(d=1)
    table = write_csv(tmp_path / "run.csv", {**columns(r), "q1": 60 * r.q[:, 0]})
    words = ["import", str(table), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    assert main([*words, "--unit", "rad"]) == 0


def test_gaps_and_repeats_on_request(tmp_path):
    r = plants.joints(d=1)
    t = r.t.copy()
    t[1000:] += 1.0
    t[50] = t[49]
    table = write_csv(tmp_path / "run.csv", {**columns(r), "t": t})
    (tmp_path / "m.toml").write_text('[table]\ngaps = "keep"\nrepeated = "drop"\n')
    words = ["import", str(table), "--map", str(tmp_path / "m.toml")]
    assert main([*words, "-o", str(tmp_path / "s.mcap")]) == 0
    assert load(tmp_path / "s.mcap").n == r.n - 1


def test_rows_that_were_stamped_as_they_came_from_a_queue(tmp_path, capsys):
    """The median step was 3 us: no rig samples faster than 20 000 Hz."""
    table = write_csv(tmp_path / "run.csv", columns(plants.queued(plants.joints(), (20, 21))))
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 0
    assert "up to 20 rows come at once" in capsys.readouterr().out
    assert main(["info", str(tmp_path / "s.mcap")]) == 0
    assert "as evenly spaced, 500.0" in capsys.readouterr().out


def test_time_before_zero_is_shifted_and_told(tmp_path, capsys):
    r = plants.joints(d=1)
    table = write_csv(tmp_path / "run.csv", {**columns(r), "t": r.t - 1.5})
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap")]) == 0
    assert "shifted by 1.5 s" in capsys.readouterr().out
    np.testing.assert_allclose(load(tmp_path / "s.mcap").t, r.t, atol=2e-9)
    assert summary(tmp_path / "s.mcap").metadata["import"]["time_shift_s"] == "1.5"


@pytest.mark.parametrize("kind", ["npz", "mat"])
def test_structured_array(tmp_path, kind):
    r = plants.joints(d=1)
    table = columns(r)
    if kind == "npz":
        np.savez(tmp_path / "run.npz", log=np.rec.fromarrays(table.values(), names=list(table)))
    else:
        savemat(tmp_path / "run.mat", {"log": table})
    for k, options in enumerate(([], ["--run", "log"])):
        path = tmp_path / f"s{k}.mcap"
        assert main(["import", str(tmp_path / f"run.{kind}"), "-o", str(path), *options]) == 0
        np.testing.assert_array_equal(load(path).tau, r.tau)


@pytest.mark.parametrize("stacked", [True, False])
def test_every_run_into_a_folder(tmp_path, capsys, stacked):
    runs = {f"run_{k}": columns(plants.joints(d=1, seed=k)) for k in range(3)}
    options = ["--all-runs", "-o", str(tmp_path / "out"), "--json"]
    if stacked:
        np.savez(tmp_path / "f.npz", **{n: np.stack(list(c.values()), 1) for n, c in runs.items()})
        (tmp_path / "m.toml").write_text("[table]\ncolumns = ['t', 'q1', 'qd1', 'tau1']")
        options += ["--map", str(tmp_path / "m.toml")]
        table = tmp_path / "f.npz"
    else:
        savemat(tmp_path / "f.mat", runs)
        table = tmp_path / "f.mat"
    assert main(["import", str(table), *options]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [s["session"].split("/")[-1] for s in found["sessions"]] == [
        "run_0.mcap",
        "run_1.mcap",
        "run_2.mcap",
    ]
    for name, table_ in runs.items():
        np.testing.assert_array_equal(
            load(tmp_path / "out" / f"{name}.mcap").tau[:, 0], table_["tau1"]
        )
    assert read_model(tmp_path / "out" / "model.toml")


def test_one_bad_run_of_several_writes_nothing(tmp_path, capsys):
    runs = {f"run_{k}": columns(plants.joints(d=1, seed=k)) for k in range(3)}
    runs["run_2"]["q1"] = np.where(np.arange(3000) == 7, np.nan, runs["run_2"]["q1"])
    savemat(tmp_path / "f.mat", runs)
    assert main(["import", str(tmp_path / "f.mat"), "--all-runs", "-o", str(tmp_path / "o")]) == 2
    assert "'q1' has 1 missing" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_extra_columns_come_along(tmp_path, capsys):
    r = plants.joints(d=1)
    table = write_csv(tmp_path / "run.csv", {**columns(r), "reference": r.q[:, 0] * 1e3})
    entry = "{ from = 'reference', scale = 0.001, unit = 'rad' }"
    (tmp_path / "m.toml").write_text(f"[extras]\nqg = {entry}")
    words = ["import", str(table), "--map", str(tmp_path / "m.toml")]
    assert main([*words, "-o", str(tmp_path / "s.mcap")]) == 0
    assert "not used" not in capsys.readouterr().out
    t, fields = read_fields(tmp_path / "s.mcap", "/extras")
    np.testing.assert_allclose(fields["qg"], r.q[:, 0], rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(t, load(tmp_path / "s.mcap").t)


def test_the_commands_that_follow_can_be_typed_where_names_have_blanks(tmp_path, capsys):
    table = write_csv(tmp_path / "my run.csv", columns(plants.joints(d=1)))
    assert main(["import", str(table), "-o", str(tmp_path / "my run.mcap")]) == 0
    assert f"hil info '{tmp_path / 'my run.mcap'}'" in capsys.readouterr().out


def test_sessions_below_a_folder_that_has_some_are_told(tmp_path):
    from hil.record.sources import find, passed_over

    deep = tmp_path / "day2"
    deep.mkdir()
    for place in (tmp_path / "a.mcap", deep / "b.mcap"):
        place.write_bytes(b"")
    assert find([tmp_path]) == [tmp_path / "a.mcap"]
    (told,) = passed_over([tmp_path])
    assert "1 session in the folders below it left out" in told
    assert passed_over([deep]) == []


TURNS_AND_SLIDES = ["t", "rot [deg]", "z [mm]", "tau1 [mNm]", "tau2 [N]"]


@pytest.mark.parametrize(
    ("names", "given", "options"),
    [
        (TURNS_AND_SLIDES, {"q1": "rot [deg]", "q2": "z [mm]"}, []),  # the columns say it
        (["t", "a", "b", "c", "d"], {"q1": "a", "q2": "b"}, ["--unit", "rad,m"]),
        (["t", "a", "b", "c", "d"], {"q1": "a", "q2": "b", "unit": ["rad", "m"]}, []),
    ],
)
def test_an_axis_that_turns_stands_beside_one_that_slides(tmp_path, names, given, options, capsys):
    t = np.arange(0, 8, 0.004)
    q = np.stack([0.6 * np.sin(2 * t), 0.03 * np.sin(3 * t + 1)], axis=1)
    tau = np.stack([-0.02 * 4 * q[:, 0], -1.5 * 9 * q[:, 1]], axis=1)
    scale = np.array([180 / np.pi, 1e3, 1e3, 1.0]) if "z [mm]" in names else np.ones(4)
    table = write_csv(
        tmp_path / "run.csv",
        dict(zip(names, [t, *(np.hstack([q, tau]) * scale).T], strict=True)),
    )
    unit = given.pop("unit", None)
    lines = ["[robot]", f"unit = {json.dumps(unit)}"] if unit else []
    lines += ["[columns]", f't = "{names[0]}"', *(f'{k} = "{v}"' for k, v in given.items())]
    lines += [f'tau1 = "{names[3]}"', f'tau2 = "{names[4]}"']
    (tmp_path / "m.toml").write_text("\n".join(lines))
    made = tmp_path / "s.mcap"
    words = ["import", str(table), "--map", str(tmp_path / "m.toml"), "-o", str(made), *options]
    assert main(words) == 0, capsys.readouterr().err
    found = load(made)
    assert found.units == ("rad", "m")
    np.testing.assert_allclose(found.q, q, atol=1e-6)
    capsys.readouterr()
    model = made.with_suffix(".model.toml")
    assert main(["fit", str(made), "--model", str(model), "--json"]) == 0
    units = {n: v["unit"] for n, v in json.loads(capsys.readouterr().out)["parameters"].items()}
    assert (units["rigid-body.m1"], units["rigid-body.m2"]) == ("kg m^2", "kg")
    assert (units["j1.viscous.fv"], units["j2.viscous.fv"]) == ("N m s/rad", "N s/m")


@pytest.mark.parametrize(
    ("unit", "sentence"),
    [("rad,m,m", "is of 3 joints, but there are 1"), ("inch", "unknown unit 'inch'")],
)
def test_a_unit_of_the_axes_that_cannot_be_is_refused(tmp_path, unit, sentence, capsys):
    table = write_csv(
        tmp_path / "run.csv", {"t": np.arange(9) * 0.01, "q": np.arange(9) * 0.1, "tau": np.ones(9)}
    )
    assert main(["import", str(table), "--unit", unit, "-o", str(tmp_path / "s.mcap")]) == 2
    assert sentence in capsys.readouterr().err


def test_several_files_and_a_folder_of_them_are_read_alike(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    runs = [plants.joints(seed=k) for k in range(2)]
    for k, r in enumerate(runs):
        own = {f"b_{n}" if n[0] in "qt" and n != "t" else n: v for n, v in columns(r).items()}
        write_csv(tmp_path / "runs" / f"day{k}.csv", own)
    rows = "".join(f'{n} = "b_{n}"\n' for n in ("q1", "q2", "tau1", "tau2"))
    (tmp_path / "m.toml").write_text(f'schema = "hil.map/1"\n[columns]\n{rows}')
    words = ["--map", "m.toml", "--tag", "two"]
    assert main(["import", "runs/day0.csv", "runs/day1.csv", *words, "-o", "out"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("note: 2 joints without a robot description: ")
    assert "out: 2 sessions, 0 data faults" in said and "hil diagnose out" in said
    for k, r in enumerate(runs):
        np.testing.assert_array_equal(load(tmp_path / "out" / f"day{k}.mcap").q, r.q)
    assert main(["import", "runs", *words, "-o", "again", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [s["session"] for s in told["sessions"]] == ["again/day0.mcap", "again/day1.mcap"]
    assert main(["import", "runs", *words, "--dry-run", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)["sessions"]
    assert [s["arms"][0]["samples"] for s in shown] == [r.n for r in runs]
    assert main(["import", "runs", *words, "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "runs/day0.csv: arm arm" in said and said.count("nothing was written") == 1


def test_several_files_that_cannot_stand_together_write_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, two = columns(plants.joints(d=1)), columns(plants.joints(d=2))
    for name, table in (("a.csv", one), ("b.csv", two), ("c.csv", {"x": one["t"]})):
        write_csv(tmp_path / name, table)
    np.savez("a.npz", **one)
    (tmp_path / "empty").mkdir()
    for files, why in (
        (["a.csv", "b.csv"], "of 2 robots, by their joints: a: joint1; b: joint1, joint2"),
        (["a.csv", "a.npz"], "a.csv and a.npz would both be written to out/a.mcap"),
        (["a.csv", "c.csv"], "table c.csv has no column"),
        (["a.csv", "no.csv"], "no.csv"),
        (["empty"], "folder empty holds no table and no ROS bag"),
        (["a.csv", "a.csv", "--all-runs"], "--all-runs takes one file, got 2"),
        (["a.csv", "b.csv", "--topic", "/x"], "--topic is for ROS bags; a.csv, b.csv is none"),
    ):
        assert main(["import", *files, "-o", "out"]) == 2
        assert why in capsys.readouterr().err
        assert not (tmp_path / "out").exists()
    assert main(["import", "a.csv", "b.csv"]) == 2
    assert "-o FOLDER is missing" in capsys.readouterr().err
