"""`hil export` on the command line: what it prints, writes and refuses."""

import hashlib
import json
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.cli import main
from hil.export import target
from hil.models.files import read_model, write_model
from hil.models.model import Range, RobotModel, Use, Value
from hil.record.export import write_recordings
from hil.record.mcap_read import load
from hil.record.recording import RobotSource
from hil.record.tables import import_table


@pytest.fixture(scope="module")
def folder(tmp_path_factory, arm, made):
    """Two sessions and the fitted model of the arm."""
    place = tmp_path_factory.mktemp("export")
    for name, run in (("run1", arm.run), ("run2", arm.other)):
        write_recordings(place / f"{name}.mcap", [run])
    write_model(made("c").steps[-1].result.model, place / "arm.toml")
    return place


def test_a_refit_prints_both_errors_and_what_is_lost(folder, capsys):
    words = ["export", folder / "arm.toml", "--to", "mjcf", "-o", folder / "a.xml"]
    words += ["--data", folder / "run1.mcap", "--holdout", folder / "run2.mcap"]
    assert main([str(w) for w in words]) == 0
    said = capsys.readouterr().out
    assert "whole model" in said and "within the target" in said and "lost: stribeck" in said
    assert "values that take up what is lost: " in said and "without --data they stay" in said
    assert "<mujoco" in (folder / "a.xml").read_text()


def test_what_loses_nothing_has_one_error(made):
    assert [s.label for s in made("c").steps] == ["whole model"] and not made("c").lost


def test_values_that_the_data_move_are_told(folder, capsys):
    """Nothing is lost, and yet the file that was written had other values than the model."""
    words = ["export", folder / "arm.toml", "--to", "python", "--data", folder / "run1.mcap"]
    assert main([str(w) for w in [*words, "-o", folder / "same.py"]]) == 0
    assert "fitted anew" not in capsys.readouterr().out
    model = read_model(folder / "arm.toml")
    name, value = next((n, v) for n, v in model.values().items() if n.endswith("viscous.fv"))
    uses = tuple(
        replace(
            u, values={n: replace(v, value=3.0) if n == name else v for n, v in u.values.items()}
        )
        for u in model.effects
    )
    write_model(replace(model, effects=uses), folder / "other.toml")
    words[1] = folder / "other.toml"
    assert main([str(w) for w in [*words, "-o", folder / "other.py"]]) == 0
    said = capsys.readouterr().out
    assert f"fitted anew to --data: {name} 3 -> {value.value:.4g} " in said


def test_an_export_that_foretells_less_than_nothing_says_so(made):
    (step,) = made("c").steps
    joint = step.result.problem.joints[0]
    assert target._worthless([step, step]) == []
    worse = replace(step, heldout=replace(step.heldout, residual=9 * step.result.problem.effort))
    first, last = step.heldout.relative[0], worse.heldout.relative[0]
    assert last > 100
    (said,) = target._worthless([step, worse])
    assert said.startswith("warning: ") and f"{joint} {first:.3g} -> {last:.3g} %" in said
    assert target._worthless([worse, worse]) == []  # it was so before anything was lost


def test_json(folder, capsys):
    words = ["export", folder / "arm.toml", "--to", "python", "-o", folder / "a.py", "--json"]
    assert main([str(w) for w in words]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["schema"] == "hil.export/1" and told["held_out"] == []
    assert told["files"] == [str(folder / "a.py")] and "cost of a call" in told["notes"][-1]


@pytest.mark.slow
def test_a_card_says_what_is_known_and_what_is_not(folder, made):
    card, file = folder / "card.md", folder / "arm.toml"
    assert main(["export", str(file), "--to", "card", "-o", str(card)]) == 0
    text = card.read_text()
    description = (folder / "arm.urdf").read_bytes()
    assert hashlib.sha256(file.read_bytes() + b"\0" + description).hexdigest() in text
    values = made("c").steps[-1].result.values
    assert all(f"| {name.replace('_', chr(92) + '_')} |" in text for name in values)
    assert "fit of run1" in text and "| fore | " in text and "| numpy | " in text
    assert "Unknown: no recording was given" in text
    words = ["--data", str(folder / "run1.mcap"), "--holdout", str(folder / "run2.mcap")]
    assert main(["export", str(file), "--to", "card", "-o", str(card), *words]) == 0
    text = card.read_text()
    assert "Unknown" not in text and "held out: other sessions" in text


def refused(capsys, *words):
    """The one line of a refusal."""
    try:
        code = main([str(w) for w in words])
    except SystemExit as left:  # a mistake in the words themselves
        code = left.code
    said = capsys.readouterr().err
    assert code == 2 and said.count("\n") == 1 and "Traceback" not in said
    return said


def test_refusals(folder, capsys):
    model, foreign = folder / "arm.toml", folder / "mine.urdf"
    foreign.write_text("<robot name='mine'/>")
    start = ("export", model, "--to")
    assert "a file is there" in refused(capsys, *start, "urdf", "-o", foreign)
    assert foreign.read_text() == "<robot name='mine'/>"
    # the robot of the model itself
    assert "a file is there" in refused(capsys, *start, "urdf", "-o", folder / "arm.urdf")
    assert ".xml" in refused(capsys, *start, "mjcf", "-o", folder / "a.urdf")
    held = ("--holdout", folder / "run1.mcap")
    assert "needs --data" in refused(capsys, *start, "c", "-o", folder / "b.h", *held)
    assert "unknown value" in refused(capsys, *start, "nonsense", "-o", folder / "b.h")
    none = folder / "none.toml"
    assert "none.toml" in refused(capsys, "export", none, "--to", "c", "-o", folder / "b.h")


def test_the_robot_beside_a_file_is_no_users_file(folder, capsys):
    """A second file beside the output never takes the place of another one."""
    (folder / "i.urdf").write_text("<robot name='mine'/>")
    words = ("export", folder / "arm.toml", "--to", "isaac", "-o", folder / "i.yaml", "--feasible")
    assert "a file is there" in refused(capsys, *words)
    assert not (folder / "i.yaml").exists() and "mine" in (folder / "i.urdf").read_text()


def test_every_target_says_what_it_is():
    for name in target.names():
        found = target.get(name)
        assert found.what and found.ending.startswith(".")


def friction_of(path, joint):
    """Friction and damping that a URDF has of a joint."""
    found = ET.parse(path).find(f"joint[@name='{joint}']/dynamics").attrib
    return float(found["friction"]), float(found["damping"])


def without_data(folder, model, capsys):
    """What the export of a model to a URDF without a recording says; the file is said.urdf."""
    write_model(model, folder / "bare.toml")
    words = ["export", folder / "bare.toml", "--to", "urdf", "-o", folder / "said.urdf"]
    assert main([*map(str, words), "--feasible"]) == 0
    return capsys.readouterr().out


def test_without_data_a_lost_peak_goes_into_friction_and_damping(folder, made, capsys):
    model = made("c").steps[-1].result.model
    said = without_data(folder, model, capsys)
    x = {k: v.value for k, v in model.values().items()}
    (top,) = (max(map(abs, r.speed)) for r in model.valid if r.joint == "base")
    v = top * np.linspace(1 / 40, 1, 40)
    peak = x["j1.stribeck.fs"] * np.exp(-((v / x["j1.stribeck.vs"]) ** x["j1.stribeck.n"]))
    law = x["j1.coulomb.fc"] + x["j1.viscous.fv"] * v + peak
    nearest = np.linalg.lstsq(np.stack([np.ones(40), v], 1), law)[0]
    assert nearest[0] > 1.2 * x["j1.coulomb.fc"]
    assert friction_of(folder / "said.urdf", "base") == pytest.approx(nearest, rel=2e-2)
    assert "friction of base is" in said and "the nearest to stribeck in steady sliding" in said
    # joints whose friction is all said keep it
    assert friction_of(folder / "said.urdf", "upper")[0] == pytest.approx(x["j2.coulomb.fc"])


def test_without_data_a_law_in_the_place_of_coulomb_friction_is_written(folder, made, capsys):
    model = made("c").steps[-1].result.model
    unit = dict.fromkeys(("f0", "f1", "f2", "f3"), 0.1) | {"f3": 0.0}
    shape = {"s": 1e-3, "form": 1.0, "v0": 0.02, "vs": 0.0}
    values = {f"j3.presliding.{k}": Value(v, unit="N m") for k, v in (unit | shape).items()}
    effects = tuple(
        replace(u, joints=("base", "upper")) if u.type in ("coulomb", "viscous") else u
        for u in model.effects
    )
    model = replace(model, effects=(*effects, Use("presliding", ("fore",), values=values)))
    said = without_data(folder, model, capsys)
    assert "the nearest to presliding in steady sliding" in said
    assert friction_of(folder / "said.urdf", "fore") == pytest.approx((0.3, 0.0), abs=1e-3)
    said = without_data(folder, replace(model, valid=()), capsys)
    assert "no friction of presliding on fore is written" in said and "--data" in said
    assert friction_of(folder / "said.urdf", "fore") == (0.0, 0.0)


def test_without_data_a_spring_needs_the_range_that_it_refers_to(folder, made, capsys):
    """The model states it; a file of an earlier version does not."""
    model = made("c").steps[-1].result.model
    old = replace(model, valid=tuple(replace(r, span=None) for r in model.valid))
    for name, kept in (("new", model), ("old", old)):
        write_model(kept, folder / f"{name}.toml")
        words = ["export", folder / f"{name}.toml", "--to", "sdf", "-o", folder / f"{name}.sdf"]
        assert main([*map(str, words), "--feasible"]) == 0
        said = capsys.readouterr().out
        lost = "lost: spring on upper: its law is about the recorded span; give the recording"
        assert (lost in said) == (name == "old")
        beside = "lost: torque-offset on upper: the target can say it only beside an effect"
        assert (beside in said) == (name == "old")
        written = (folder / f"{name}.sdf").read_text().split("<sdf")[1]
        assert ("spring_stiffness" in written) == (name == "new")


@pytest.mark.parametrize(
    ("unit", "kind", "said"),
    [("m", "prismatic", "N and 4 N s/m"), ("rad", "continuous", "N m and 4 N m s/rad")],
)
def test_without_data_axes_whose_inertia_is_a_mass_slide(tmp_path, capsys, unit, kind, said):
    f, inertia = ("N", "kg") if unit == "m" else ("N m", "kg m^2")
    values = {
        "rigid-body": {"rigid-body.m": Value(2.0, unit=inertia)},
        "coulomb": {
            "j1.coulomb.fc": Value(3.0, unit=f),
            "j1.coulomb.v0": Value(1e-3, unit=f"{unit}/s"),
        },
        "viscous": {"j1.viscous.fv": Value(4.0, unit=f"{f} s/{unit}")},
        "quadratic-drag": {"j1.quadratic-drag.fd": Value(0.0, unit=f"{f} s^2/{unit}^2")},
    }
    uses = tuple(Use(name, values=some) for name, some in values.items())
    seen = Range("slide", (0.0, 1.0), (-1.0, 1.0), (-9.0, 9.0))
    model = RobotModel(RobotSource("single-axis"), uses, valid=(seen,))
    told = without_data(tmp_path, model, capsys)
    assert f"friction of slide is 3 {said}" in told
    joint = ET.parse(tmp_path / "said.urdf").find("joint[@name='slide']")
    assert joint.attrib["type"] == kind
    assert friction_of(tmp_path / "said.urdf", "slide") == pytest.approx((3.0, 4.0), rel=1e-6)


def test_the_samples_of_a_session_are_a_table_that_an_import_reads(tmp_path, capsys):
    leader = plants.joints(d=2)
    follower = replace(leader, arm="follower", q=leader.q + 1.0)
    leader = replace(leader, arm="leader", wrench=np.full((leader.n, 6), 0.5))
    session = tmp_path / "s.mcap"
    write_recordings(session, [leader, follower])
    assert main(["export", str(session), "--to", "csv", "-o", str(tmp_path / "run.csv")]) == 0
    said = capsys.readouterr().out
    for one in (leader, follower):
        table = tmp_path / f"run-{one.arm}.csv"
        assert str(table) in said
        back, kept = import_table(table).recordings[0], load(session, one.arm)
        for key in ("t", "q", "tau"):
            np.testing.assert_allclose(getattr(back, key), getattr(kept, key), rtol=1e-14)
    words = ["export", str(session), "--to", "csv", "--arm", "leader", "--json"]
    assert main([*words, "-o", str(tmp_path / "run-leader.csv")]) == 0  # its own file
    assert json.loads(capsys.readouterr().out)["files"] == [str(tmp_path / "run-leader.csv")]
    found = import_table(tmp_path / "run-leader.csv").recordings[0]
    np.testing.assert_allclose(found.wrench, 0.5, atol=1e-3)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["arm.toml", "--to", "csv"], "takes a session"),
        (["run1.mcap", "--to", "urdf"], "takes a model, and"),
        (["run1.mcap", "--to", "csv", "--data", "run2.mcap"], "refit a model"),
        (["run1.mcap", "--to", "csv", "--arm", "nobody"], "unknown arm 'nobody'"),
    ],
)
def test_a_session_and_a_model_are_not_mistaken(folder, words, said, capsys):
    given = [str(folder / w) if "." in w else w for w in words]
    assert main(["export", *given, "-o", str(folder / "x.csv")]) == 2
    assert said in capsys.readouterr().err
