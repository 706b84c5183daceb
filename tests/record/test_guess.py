"""Maps proposed from the names of columns: names as programs and people write them."""

from __future__ import annotations

import tomllib

import numpy as np
import plants
import pytest
from hypothesis import given
from hypothesis import strategies as st
from record_tables import columns, write_csv

from hil.cli import main
from hil.errors import ConfigError
from hil.models.urdf import UrdfRobot
from hil.record.guess import propose, quantity
from hil.record.mapfile import parse_map
from hil.record.mcap_read import load


def _six(stem: str, first: int = 0) -> list[str]:
    return [f"{stem}{k}" for k in range(first, first + 6)]


def _read(names, joints=()):
    """Columns of the proposal, and its units."""
    found = propose(names, joints)
    assert found is not None
    data = tomllib.loads(found.text)
    parse_map(data, (1.0,))
    return data["columns"], data.get("units", {})


CASES = {
    "measured before commanded": (
        ["time", *_six("target_q_"), *_six("actual_q_"), *_six("actual_qd_")],
        {"q1": "actual_q_0", "q6": "actual_q_5", "qd2": "actual_qd_1"},
    ),
    "a current before an effort that was asked for": (
        [*_six("actual_q_"), *_six("target_moment_"), *_six("actual_current_")],
        {"q1": "actual_q_0", "tau3": "actual_current_2"},
    ),
    "brackets, and no estimate": (
        ["time", *(f"{s}[{k}]" for s in ("q", "dq", "tau_J", "tau_ext_hat") for k in range(2))],
        {"q1": "q[0]", "qd2": "dq[1]", "tau1": "tau_J[0]"},
    ),
    "capitals within names": (
        ["Time [s]", "ActualPositionJ1", "ActualPositionJ2", "MotorTorqueJ1", "MotorTorqueJ2"],
        {"t": "Time [s]", "q2": "ActualPositionJ2", "tau1": "MotorTorqueJ1"},
    ),
    "joints by word, in the order of the columns": (
        ["t", "pos_shoulder", "pos_elbow", "effort_elbow", "effort_shoulder"],
        {"q1": "pos_shoulder", "q2": "pos_elbow", "tau1": "effort_shoulder"},
    ),
    "short names": (["t", "th1", "th2", "u1", "u2"], {"q1": "th1", "tau2": "u2"}),
    "an external effort is not the motor's": (
        ["t", "pos1", "pos2", "ext_torque1", "ext_torque2", "trq1", "trq2"],
        {"tau1": "trq1", "tauext2": "ext_torque2"},
    ),
    "no acceleration is a position": (
        ["t", "acc_joint1", "pos_joint1", "torque_joint1"],
        {"q1": "pos_joint1", "tau1": "torque_joint1"},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_names_say(case):
    names, expected = CASES[case]
    found, _ = _read(names)
    assert {k: found.get(k) for k in expected} == expected
    assert len(set(found.values())) == len(found)
    assert "tau_ext_hat[0]" not in found.values()


@pytest.mark.parametrize(
    ("names", "units"),
    [
        (["t", "A1_pos_deg", "A1_vel_deg_s", "A1_torque_Nm"], {"q": "deg", "qd": "deg/s"}),
        (["t", "x1_pos_mm", "x1_force", "effort_1"], {"q": "mm"}),
        (["t", "pos1_rad", "cur1_mA"], {"q": "rad", "tau": {"unit": "mA"}}),
    ],
)
def test_units_that_names_say(names, units):
    _, found = _read(names)
    assert {k: found.get(k) for k in units} == units


def test_joints_of_the_robot_are_matched_by_name_and_in_its_order():
    names = ["t", "b_joint.position", "a_joint.position", "a_joint.effort", "b_joint.effort"]
    found = propose(names, ["a_joint", "b_joint", "gripper"])
    data = tomllib.loads(found.text)
    assert data["robot"]["joints"] == ["a_joint", "b_joint"]
    assert data["columns"]["q1"] == "a_joint.position"
    assert data["columns"]["tau2"] == "b_joint.effort"


def test_what_no_name_says_is_told():
    assert propose(["x", "y", "status"]) is None
    found = propose(["pos1", "pos2", "torque1"])
    assert found.missing == ("motor effort of joint 2", "the time (t)")
    assert found.fill == ("tau2", "t")
    assert found.columns == {"q1": "pos1", "q2": "pos2", "tau1": "torque1"}


GERMAN = (
    *("Zeit_ms", "Schulter Winkel [deg]", "Ellbogen Winkel [deg]"),
    *("Drehmoment Schulter (Nm)", "Drehmoment Ellbogen (Nm)"),
)


@pytest.mark.parametrize("joints", [("Schulter", "Ellbogen"), ()])
def test_units_say_what_no_word_says(joints):
    found, units = _read(GERMAN, joints)
    assert found == {
        "t": {"from": "Zeit_ms", "unit": "ms"},
        **{"q1": GERMAN[1], "q2": GERMAN[2], "tau1": GERMAN[3], "tau2": GERMAN[4]},
    }
    assert units == {"q": "deg", "tau": "Nm"}


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("jaw_deg", ("q", "deg")),
        ("motor_mNm", ("tau", "mNm")),
        ("wrist [N m]", ("tau", "Nm")),
        ("wrist (N·m)", ("tau", "Nm")),
        ("slide [mm]", ("q", "mm")),
        ("slide_m", ("q", "m")),
        ("drive (mA)", ("i", "mA")),
        ("drive_A", ("i", "A")),
        ("drive rpm", ("qd", "rpm")),
        ("shoulder [°/s]", ("qd", "deg/s")),
        ("Zeit [µs]", ("t", "us")),
        ("Zeit_s", ("t", "s")),
        ("torque_J1_mA", ("i", "mA")),
        ("supply [V]", ("", "")),
        ("u [V]", ("", "")),
        ("loadcell_N", ("", "")),
        ("pump", ("", "")),
    ],
)
def test_a_unit_tells_the_quantity(name, said):
    assert quantity(name) == said


def test_a_force_is_an_effort_of_what_slides_alone():
    found, units = _read(["time_s", "slide_mm", "motor_N", "loadcell_N"])
    assert (found["tau1"], found["tauext1"]) == ("motor_N", "loadcell_N")
    assert units == {"q": "mm", "tau": "N", "tauext": "N"}
    turning = propose(["time_s", "jaw_deg", "motor_mNm", "loadcell_N"])
    assert '# not understood: "loadcell_N" (a force in N, where the joints turn' in turning.text
    assert turning.fill == ()


def test_joints_of_several_units_and_one_without_an_effort():
    names = ["t", "shoulder_deg", "lift_mm", "shoulder_Nm", "pump"]
    found = propose(names, ["shoulder_joint", "lift_joint"])
    data = tomllib.loads(found.text)
    assert data["columns"]["q2"] == {"from": "lift_mm", "unit": "mm"}
    assert data["columns"]["q1"] == {"from": "shoulder_deg", "unit": "deg"}
    assert found.fill == ("tau2",)
    assert '# tau2 = "..."' in found.text and '# not understood: "pump"' in found.text


def test_letters_that_count_are_no_units():
    assert propose(["leg_A", "leg_B"]) is None
    assert _read(["t", "pos_A", "pos_N", "torque_A", "torque_N"])[0]["tau2"] == "torque_N"


def test_nothing_understood_is_an_error_that_says_where_to_read_on(tmp_path, capsys):
    two = np.arange(2.0)
    run = write_csv(tmp_path / "run.csv", {"foo": two, "bar": two})
    place = tmp_path / "map.toml"
    assert main(["import", str(run), "--propose-map", str(place)]) == 2
    assert "docs/import.md" in capsys.readouterr().err
    assert not place.exists()
    run = write_csv(tmp_path / "part.csv", {"jaw_deg": two, "bar": two})
    assert main(["import", str(run), "-o", str(tmp_path / "s.mcap")]) == 2
    assert "--propose-map MAP.toml' writes one to complete" in capsys.readouterr().err
    assert main(["import", str(run), "--propose-map", str(place)]) == 0
    assert "fill in tau1, t under [columns] (docs/import.md)" in capsys.readouterr().out


_PARTS = st.sampled_from(["pos", "j1", "a", "[deg]", "(Nm)", "_N", " mm", "A", "target", "t", "°"])


@given(st.lists(st.text(max_size=30) | st.lists(_PARTS, max_size=5).map("".join), max_size=12))
def test_any_proposal_is_a_map_of_columns_that_are_there(names):
    found = propose(names)
    if found is not None:
        taken = tomllib.loads(found.text)["columns"]
        parse_map(tomllib.loads(found.text), (1.0,))
        assert set(found.columns.values()) <= set(names)
        assert set(taken) == set(found.columns)


def test_from_a_strange_header_to_a_session(tmp_path, capsys):
    r = plants.joints(d=2)
    strange = {"t": "Time [s]", "q": "ActPos_deg_J", "qd": "ActVel_deg_s_J", "tau": "MotorTrq_J"}
    table = {}
    for name, values in columns(r).items():
        stem = name.rstrip("0123456789")
        factor = 180 / 3.141592653589793 if stem in ("q", "qd") else 1.0
        table[strange[stem] + name[len(stem) :]] = factor * values
    run = write_csv(tmp_path / "run.csv", table)
    place = tmp_path / "rig.toml"
    assert main(["import", str(run), "-o", str(tmp_path / "s.mcap")]) == 2
    assert "--propose-map MAP.toml" in capsys.readouterr().err
    assert main(["import", str(run), "--propose-map", str(place)]) == 0
    assert "--dry-run" in capsys.readouterr().out
    words = ["import", str(run), "--map", str(place), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 0
    back = load(tmp_path / "s.mcap")
    assert back.q == pytest.approx(r.q, abs=1e-12)
    assert back.tau == pytest.approx(r.tau)
    before = place.read_text()
    assert main(["import", str(run), "--propose-map", str(place)]) == 2
    assert place.read_text() == before


def test_torque_constants_of_the_command_line_serve_a_map_of_currents(tmp_path):
    r = plants.joints(d=2)
    table = {n.replace("tau", "cur_A_"): v for n, v in columns(r).items() if n[:2] != "qd"}
    run, place = write_csv(tmp_path / "run.csv", table), tmp_path / "rig.toml"
    assert main(["import", str(run), "--propose-map", str(place)]) == 0
    words = ["import", str(run), "--map", str(place), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    assert main([*words, "--torque-constant", "2,3"]) == 0
    assert load(tmp_path / "s.mcap").tau == pytest.approx(r.tau * [2.0, 3.0])


def test_of_one_joint_the_names_need_not_agree():
    found, units = _read(["time [ms]", "Encoder angle (deg)", "drive current mA"])
    assert (found["q1"], found["tau1"]) == ("Encoder angle (deg)", "drive current mA")
    assert units["q"] == "deg" and units["tau"]["unit"] == "mA"


@pytest.mark.parametrize(
    ("names", "units", "asked"),
    [
        (
            ["Time_us", "PosActual_inc", "TorqueActual_permille"],
            {"q1": "counts", "tau1": "permille"},
            ("q1 in counts", "tau1 in permille"),
        ),
        (
            ["t", "present_position", "present_current"],
            {"q1": "counts", "tau1": "counts"},
            ("q1 in counts", "tau1 in counts"),
        ),
        (
            ["t", "x_pos_mm", "y_pos_mm", "x ActTorque [%]", "y ActTorque [%]"],
            {"tau1": "%", "tau2": "%"},
            ("tau1, tau2 in %",),
        ),
        (
            ["t", "encoder_ticks", "vel_ticks", "motor_Nm"],
            {"q1": "counts", "qd1": "counts/s"},
            ("q1 in counts", "qd1 in counts/s"),
        ),
    ],
)
def test_units_of_drives_are_proposed_and_their_scale_is_asked_for(names, units, asked):
    data = tomllib.loads(propose(names).text)
    columns = data["columns"]
    assert {k: columns[k]["unit"] for k in units} == units
    with pytest.raises(ConfigError) as told:
        parse_map(data)
    assert all(text in str(told.value) for text in asked)
    for target in units:
        columns[target]["scale"] = 0.01
    rules = parse_map(data).arms[""]
    assert all(list(rules[k].terms.values()) == [0.01] and rules[k].stated for k in units)


@pytest.mark.parametrize(
    "names",
    [
        ["t", "axis0.pos_estimate", "axis0.vel_estimate", "axis0.Iq_measured"],
        ["t", "servo1.position", "servo1.velocity", "servo1.q_current_A"],
    ],
)
def test_drives_that_count_turns_are_not_in_radians(names):
    found, units = _read(names)
    assert (found["q1"], found["qd1"], found["tau1"]) == tuple(names[1:])
    assert (units["q"], units["qd"]) == ("rev", "rev/s")


def test_whole_numbers_over_hundreds_of_radians_are_doubted(tmp_path, capsys):
    t = np.arange(2000) * 0.01
    table = write_csv(
        tmp_path / "a.csv", {"t": t, "q1": np.round(9000 * np.sin(t)), "tau1": np.cos(t)}
    )
    words = ["import", str(table), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    assert "q1 (joint1) holds whole numbers only" in capsys.readouterr().err
    assert main([*words, "--unit", "rad"]) == 0
    assert "holds whole numbers only" in capsys.readouterr().out


def test_a_unit_that_was_said_is_not_doubted_afterwards(tmp_path, capsys):
    t = np.arange(4000) * 0.01
    turning = {"t": t, "q1": 40.0 * np.sin(0.3 * t), "tau1": np.cos(0.3 * t)}
    table = write_csv(tmp_path / "a.csv", turning)
    words = ["import", str(table), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    assert "in rad or in degrees? Say --unit rad" in capsys.readouterr().err
    assert main([*words, "--unit", "rad"]) == 0
    assert main(["info", str(tmp_path / "s.mcap")]) == 0
    assert "in degrees?" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("of_map", "option", "known"), [("tip", "", True), ("hand", "tip", True), ("hand", "", False)]
)
def test_a_map_or_an_option_says_in_whose_axes_the_force_is(
    tmp_path, capsys, of_map, option, known
):
    run = plants.serial_arm(3, 1, seconds=4.0)
    (tmp_path / "arm.urdf").write_text(run.robot.urdf)
    (tmp_path / "m.toml").write_text(f'[robot]\nforce_axes = "{of_map}"\n')
    columns = {"t": run.t}
    for k in range(3):
        columns |= {f"q{k + 1}": run.q[:, k], f"tau{k + 1}": run.tau[:, k]}
    force = np.stack([np.sin(run.t), np.cos(2 * run.t), 0.3 * run.t], axis=1)
    columns |= dict(zip(("fx", "fy", "fz"), force.T, strict=True))
    table = write_csv(tmp_path / "a.csv", columns)
    words = ["import", str(table), "--map", str(tmp_path / "m.toml")]
    words += ["-o", str(tmp_path / "s.mcap"), "--robot", str(tmp_path / "arm.urdf")]
    code = main([*words, *(("--force-axes", option) if option else ())])
    if not known:
        said = capsys.readouterr().err
        assert code == 2 and "no such link" in said and "--force-axes" in said
        return
    assert code == 0
    axes = UrdfRobot(run.robot.urdf).tip_axes(run.q)
    wanted = np.einsum("nij,nj->ni", axes, force)
    np.testing.assert_allclose(load(str(tmp_path / "s.mcap")).wrench[:, :3], wanted, atol=1e-6)


def test_a_unit_that_no_map_knows_is_never_taken_as_si():
    text = propose(("t", "q1", "tau1 [dyn cm]")).text
    assert 'tau1 = { from = "tau1 [dyn cm]", unit = "dyn cm" }  # add scale' in text
    with pytest.raises(ConfigError, match="unknown unit 'dyn cm'"):
        parse_map(tomllib.loads(text))
    # a word in brackets that is no unit says nothing of one
    assert 'tau1 = "torque [elbow]"' in propose(("t", "pos [elbow]", "torque [elbow]")).text


@pytest.mark.parametrize(
    ("name", "newtonmetres"),
    [
        ("tau1 [oz-in]", 7.0615518e-3),
        ("tau1 (lbf.ft)", 1.35581795),
        ("tau1 [in-lb]", 0.112984829),
        ("tau1 [kgf cm]", 0.0980665),
        ("torque_1_kgf.cm", 0.0980665),
        ("torque 1 [kp cm]", 0.0980665),
        ("torque_1_ft-lb", 1.35581795),
        ("torque_1_in-lb", 0.112984829),
        ("torque_1_oz-in", 7.0615518e-3),
        ("torque_1_N.mm", 1e-3),
        ("torque_1_cNm", 0.01),
        ("torque 1 [cN m]", 0.01),
        ("torque 1 [dNm]", 0.1),
        ("torque_1_daNm", 10.0),
        ("torque_1_uNm", 1e-6),
        ("torque 1 [mN·m]", 1e-3),
    ],
)
def test_units_of_torque_that_are_not_metric(name, newtonmetres):
    rules = parse_map(tomllib.loads(propose(("t", "q1", name)).text)).arms[""]
    assert rules["tau1"].terms == {name: pytest.approx(newtonmetres, rel=1e-7)}


def test_a_unit_that_its_quantity_cannot_have_is_asked_and_not_left_out():
    """An effort in cm had been one in N m."""
    for name, lacks in (("torque_1 [cm]", "tau1"), ("pos_1 [mA]", "q1")):
        found = propose(("t", "pos_1", name) if lacks == "tau1" else ("t", name, "torque_1"))
        assert found.fill == (lacks,)
        assert f'write {{ from = "{name}", scale = (SI unit by this one) }}' in found.text
    # letters in brackets, and words, are no units
    assert propose(("t", "pos (a)", "torque (in)")).missing == ()


def test_currents_in_two_units_keep_both():
    found = propose(("t", "pos_1", "pos_2", "cur_1_mA", "cur_2_A"))
    rules = parse_map(tomllib.loads(found.text), (2.0,)).arms[""]
    assert [*rules["tau1"].terms.values(), *rules["tau2"].terms.values()] == [0.002, 2.0]


def test_the_first_row_of_a_ros_log_says_whose_each_number_is():
    names = [f"field.{what}{k}" for what in ("name", "position", "effort") for k in (0, 1)]
    first = {"field.name0": "elbow", "field.name1": "shoulder"}
    found = propose(("%time", *names), ("shoulder", "elbow"), first)
    assert found.columns["q1"] == "field.position1" and found.columns["tau2"] == "field.effort0"


def test_the_bare_name_of_a_joint_is_its_position():
    names = ("t", "shoulder", "elbow", "tau_shoulder", "tau_elbow")
    found = propose(names, ("shoulder", "elbow")).columns
    assert (found["q1"], found["q2"], found["tau2"]) == ("shoulder", "elbow", "tau_elbow")
    assert "q1" not in propose(names).columns


def test_a_log_of_dvrk_has_its_own_words_and_a_time_of_two_parts():
    each = [f"{kind}_{k}" for kind in ("jp", "jv", "jf", "setpoint_jp") for k in range(2)]
    found = propose(("stamp_sec", "stamp_nsec", *each))
    assert parse_map(tomllib.loads(found.text)).arms[""]["t"].terms == {
        "stamp_sec": 1.0,
        "stamp_nsec": 1e-9,
    }
    told = {k: v for k, v in found.columns.items() if k != "t"}
    assert told == {
        "q1": "jp_0", "q2": "jp_1", "qd1": "jv_0", "qd2": "jv_1", "tau1": "jf_0", "tau2": "jf_1"
    }  # fmt: skip
    other = parse_map(tomllib.loads(propose(("sec", "usec", "q", "tau")).text))
    assert other.arms[""]["t"].terms == {"sec": 1.0, "usec": 1e-6}


def test_seconds_and_nanoseconds_are_one_time():
    head = "/joint_states/header/stamp/"
    found = propose((f"{head}sec", f"{head}nanosec", "__time", "position_0", "effort_0"))
    rule = parse_map(tomllib.loads(found.text)).arms[""]["t"]
    assert rule.terms == {f"{head}sec": 1.0, f"{head}nanosec": 1e-9}
    assert not found.missing


def test_words_that_look_like_units_are_none():
    """An input is no inch, a wrist sensor no foot, and letters in brackets count joints."""
    assert quantity("theta_in") == ("q", "") and quantity("theta [in]") == ("q", "in")
    assert quantity("torque_ft") == ("tau", "")
    text = propose(("t", "pos (a)", "pos (b)", "torque (a)", "torque (b)")).text
    assert "unit" not in text.split("[columns]")[1]
    assert quantity("pos (min)")[1] == ""


@pytest.mark.parametrize(("unit", "size"), [("", 1.0), (" [A]", 1.0), (" [mA]", 1e-3)])
def test_currents_are_the_efforts_of_a_table_without_where_constants_are_given(
    tmp_path, capsys, unit, size
):
    r = plants.joints(d=2)
    table = {
        f"i{n[3:]}{unit}" if n.startswith("tau") else n: v / (size if n.startswith("tau") else 1.0)
        for n, v in columns(r).items()
    }
    run = write_csv(tmp_path / "run.csv", table)
    words = ["import", str(run), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    assert main([*words, "--torque-constant", "2,3"]) == 0
    assert "torque constants times the currents i1" in "".join(capsys.readouterr())
    assert load(tmp_path / "s.mcap").tau == pytest.approx(r.tau * [2.0, 3.0])


def test_a_current_given_as_a_torque_is_the_effort_beside_the_current_itself():
    """It had been left out, and the current was refused for want of a torque constant."""
    names = ["timestamp", "actual_q_0", "actual_current_0", "actual_current_as_torque_0"]
    found, units = _read(names)
    assert found == {
        "t": "timestamp",
        "q1": "actual_q_0",
        "i1": "actual_current_0",
        "tau1": "actual_current_as_torque_0",
    }
    assert units == {}


@pytest.mark.parametrize(
    ("head", "row", "said", "why"),
    [
        ("time_ms,pos1_deg,cur1_mA", "{0},{1},{2}", ["tau1", "cur1_mA"], "torque-constant"),
        ("time,q1,tau1", "{3},{1},{2}", ["t", "time"], '{ from = "time", unit = "ms" }'),
        ("stamp [s],pos1_deg", "{0},{1}", ["q1", "pos1_deg"], "motor efforts (tau)"),
    ],
)
def test_a_dry_run_shows_what_it_guessed_also_of_what_cannot_be_read(
    tmp_path, monkeypatch, capsys, head, row, said, why
):
    monkeypatch.chdir(tmp_path)
    rows = [row.format(4 * k, np.sin(k / 9), np.cos(k / 9), 5.0 * k) for k in range(400)]
    (tmp_path / "log.csv").write_text("\n".join([head, *rows]) + "\n")
    assert main(["import", "log.csv", "--dry-run"]) == 2
    out, err = capsys.readouterr()
    lines = [line.split() for line in out.splitlines()]
    assert any(line[:2] == said for line in lines), out
    assert why in err
