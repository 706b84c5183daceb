"""Failures: what is the user's is named with its place, what is ours asks for a report."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import plants
import pytest

import hil
from hil import trusted_code
from hil.cli import main
from hil.errors import families, unknown
from hil.models import catalogue
from hil.record.export import write_recordings
from hil.revision import PROGRAM

EFFECT = """
from dataclasses import dataclass
from hil.models.effect import Doc, Effect, Param

@dataclass(frozen=True)
class Broken(Effect):
    name, family = "{name}", "friction"
    doc = Doc(equation="tau = k q",
              signature="none", shown_by="none", source="none")
    params = (Param("k", "{{F}}", "stiffness", 0.0),)

    def columns(self, motion, j, shape):
        {body}

EFFECTS = (Broken(),)
"""
MODEL = 'schema = "hil.model/1"\nplugins = ["./mine.py"]\n[robot]\npreset = "single-axis"\n'
MODEL += "".join(f'[[effects]]\ntype = "{n}"\n' for n in ("rigid-body", "coulomb", "viscous"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A session of one axis, and the working directory beside it."""
    run = plants.two_tone_axis(6.0, (0.3, 0.2), (3.0, 7.3), 1.0, 0.3)
    write_recordings(tmp_path / "s.mcap", [replace(run, name="s")])
    monkeypatch.setattr(catalogue, "_table", dict(catalogue.table()))
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("hil_plugin_mine", None)


def own(folder, body, name="broken"):
    text = EFFECT.format(name=name, body=body)
    (folder / "mine.py").write_text(text)
    trusted_code.give(trusted_code.plugin(folder / "mine.py", text.encode()))
    (folder / "m.toml").write_text(MODEL + f'[[effects]]\ntype = "{name}"\n')


@pytest.mark.parametrize("body", ["return 1 / 0", "return open('none.csv')", "return motion.nix"])
def test_a_mistake_in_an_own_effect_is_named_with_its_line(folder, capsys, body):
    own(folder, body)
    assert main(["fit", "s.mcap", "--model", "m.toml"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "mine.py, line 13" in said and "Error" in said
    with pytest.raises((ZeroDivisionError, OSError, AttributeError)):
        main(["--debug", "fit", "s.mcap", "--model", "m.toml"])
    with pytest.raises((ZeroDivisionError, OSError, AttributeError)):
        main(["fit", "s.mcap", "--model", "m.toml", "--debug"])


@pytest.mark.parametrize(("text", "line"), [("x = 1\ny = 1 / 0\n", 2), ("x = 1\n\ndef (\n", 3)])
def test_a_plugin_that_does_not_run_is_named_with_its_line(folder, capsys, text, line):
    (folder / "mine.py").write_text(text)
    assert main(["effects", "--plugin", "mine.py"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and f"mine.py, line {line}" in said


def test_the_unexpected_is_an_internal_error(folder, capsys, monkeypatch):
    def broken(*_):
        raise KeyError("nobody thought of this")

    monkeypatch.setattr("hil.diagnosis.verbs.fit", broken)
    assert main(["fit", "s.mcap"]) == 1
    said = capsys.readouterr().err
    assert said.splitlines()[-1].startswith("hil fit: internal error: KeyError")
    assert "--debug" in said and "report" in said and "Traceback" not in said


def test_a_package_whose_effects_do_not_load_is_left_out(folder, capsys, monkeypatch):
    (folder / "later_package.py").write_text(
        EFFECT.format(name="later", body="return motion.q[:, [j]]")
    )
    monkeypatch.syspath_prepend(str(folder))
    points = [
        EntryPoint("gone", "no_such_package_anywhere", "hil.effects"),
        EntryPoint("later", "later_package", "hil.effects"),
    ]
    monkeypatch.setattr(catalogue, "_table", {})
    monkeypatch.setattr(catalogue, "entry_points", lambda group: points)
    assert main(["effects", "--json"]) == 0
    said = capsys.readouterr()
    names = {e["name"] for e in json.loads(said.out)["effects"]}
    assert {"stribeck", "later"} <= names
    assert "'gone'" in said.err and said.err.count("\n") == 1
    sys.modules.pop("later_package")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ('schema = "hil.rig/1"\n', "is not a model file"),
        ("x = 1\n", "is not a model file"),
    ],
)
def test_a_file_that_is_no_model(folder, capsys, text, says):
    (folder / "m.toml").write_text(text)
    assert main(["fit", "s.mcap", "--model", "m.toml"]) == 2
    said = capsys.readouterr().err
    assert says in said and 'starts with schema = "hil.model/1"' in said and "None" not in said


def test_only_near_names_are_proposed(capsys):
    assert "Did you mean" not in unknown("effect", "bogus", ["viscous", "coulomb"])
    assert "Did you mean 'stribeck'" in unknown("effect", "stribek", ["stribeck", "coulomb"])
    assert main(["effects", "bogus"]) == 2
    said = capsys.readouterr().err
    assert "--plugin" in said and "Did you mean" not in said and "viscous" in said


def test_a_missing_urdf_is_told_once(folder, capsys):
    (folder / "t.csv").write_text("t,q1,tau1\n0,0,0\n")
    assert main(["import", "t.csv", "--robot", "no.urdf", "-o", "x.mcap"]) == 2
    said = capsys.readouterr().err
    assert said.count("no.urdf") == 1 and "Errno" not in said


def test_an_effect_without_benefit_is_called_that(folder, capsys):
    assert main(["add", "asymmetric-coulomb", "--session", "s.mcap"]) == 0
    said = capsys.readouterr().out
    assert "no significant benefit" in said and "joint1" in said
    assert "j1.asymmetric-coulomb." in said
    assert main(["add", "asymmetric-coulomb", "--session", "s.mcap", "--json"]) == 0
    codes = [w["code"] for w in json.loads(capsys.readouterr().out)["warnings"]]
    assert "no-benefit" in codes


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_standard_output_is_one_sentence():
    with open("/dev/full", "w") as full:
        words = [sys.executable, "-m", "hil.cli", "effects"]
        done = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and "standard output" in done.stderr


@pytest.mark.parametrize(
    "text", ["raise ValueError('mine')", "raise SystemExit", "loads = None", "def ("]
)
def test_a_file_named_as_a_module_of_python_is_refused_in_one_line(tmp_path, text):
    (tmp_path / "json.py").write_text(text + "\n")
    path = os.pathsep.join([str(tmp_path), str(Path(hil.__file__).parents[1])])
    words = [sys.executable, "-c", "from hil.__main__ import program; program()", "info", "x.mcap"]
    ran = subprocess.run(
        words, cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True
    )
    assert ran.returncode == 2 and ran.stdout == "", ran.stderr
    assert ran.stderr.count("\n") == 1 and "json.py' takes the place of Python's own" in ran.stderr


def test_the_module_imports_nothing_of_the_working_directory(tmp_path):
    (tmp_path / "json.py").write_text("raise SystemExit\n")
    words = [sys.executable, "-m", "hil", "info", "x.mcap"]
    path = str(Path(hil.__file__).parents[1])
    ran = subprocess.run(
        words, cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True
    )
    assert ran.returncode == 2 and "x.mcap: No such file" in ran.stderr


def test_names_that_count_up_are_one_in_a_message():
    """A log has hundreds of columns; a message that lists each is not read."""
    names = ["t", "q1", "i1", "q2", "i2", "q3", "i3", "x[0]", "x[2]", "x[3]", "a1b1", "a1b2"]
    found = ["t", "q1 .. q3", "i1 .. i3", "x[0]", "x[2]", "x[3]", "a1b1", "a1b2"]
    assert families(names) == found
    assert families([f"a{k}b{k}" for k in range(4)]) == [f"a{k}b{k}" for k in range(4)]
    assert families([f"j{k}.q" for k in range(1, 8)]) == ["j1.q .. j7.q"]


def test_a_link_to_itself_is_a_sentence(tmp_path, capsys):
    (tmp_path / "a.csv").symlink_to(tmp_path / "b.csv")
    (tmp_path / "b.csv").symlink_to(tmp_path / "a.csv")
    assert main(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "x.mcap")]) == 2
    said = capsys.readouterr().err
    assert "internal error" not in said and str(tmp_path / "a.csv") in said


def test_a_file_of_the_working_directory_does_not_take_the_place_of_the_program(tmp_path):
    (tmp_path / "hil.py").write_text("raise SystemExit(77)")
    done = subprocess.run([*PROGRAM, "--version"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("hil ")


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_a_closed_standard_stream_takes_what_is_printed_nowhere(closed, tmp_path):
    there = "1>'seen'" if closed == "2>&-" else "2>'seen'" if closed == ">&-" else ""
    line = f"'{sys.executable}' -m hil effects stribeck {there} {closed}"
    assert subprocess.run(["/bin/sh", "-c", line], cwd=tmp_path).returncode == 0
    assert "Traceback" not in ((tmp_path / "seen").read_text() if there else "")


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (f"info '{Path(__file__).parents[1] / 'record' / 'small.mcap'}'", 0),
        ("run identify -o s.mcap --seconds 0.1 --clock lockstep", 0),
        ("run identify -o t.mcap --seconds 0.1 --clock lockstep --operator", 0),
        ("info none.mcap", 2),
        ("nonsense", 2),
    ],
)
def test_a_process_without_any_standard_stream_does_its_work(words, code, tmp_path):
    line = f"'{sys.executable}' -m hil {words} <&- >&- 2>&-"
    done = subprocess.run(["/bin/sh", "-c", line], cwd=tmp_path, timeout=60)
    assert done.returncode == code


SMALL = Path(__file__).parents[1] / "record" / "small.mcap"
SHORT = ["--seconds", "0.1", "--clock", "lockstep", "-o", "OUT.mcap"]


@pytest.mark.parametrize("kind", ["pipe", "loop", "device"])
@pytest.mark.parametrize(
    "words",
    [
        ["run", "identify", *SHORT, "--model", "X"],
        ["run", "identify", *SHORT, "--trajectory", "X"],
        ["run", "X", *SHORT],
        ["replay", str(SMALL), "--against", "X"],
        ["replay", "X"],
        ["info", "X"],
        ["view", "X", "--live", "8799"],
        ["export", "X", "--to", "csv", "-o", "OUT"],
        ["import", "X", "-o", "OUT.mcap"],
        ["import", "none.csv", "--map", "X", "-o", "OUT.mcap"],
        ["trust", "X"],
        ["design", "X"],
    ],
    ids=" ".join,
)
def test_what_is_no_regular_file_is_refused_at_once(kind, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if kind == "pipe":
        os.mkfifo("X.toml")
    else:
        Path("X.toml").symlink_to("X.toml" if kind == "loop" else "/dev/zero")
    began = time.monotonic()
    assert main([w.replace("X", "X.toml") if w == "X" else w for w in words]) == 2
    assert time.monotonic() - began < 10.0
    said = capsys.readouterr().err
    assert "X.toml" in said and "Error:" not in said and said.count("\n") == 1


def test_a_pipe_that_nobody_reads_is_no_output(tmp_path, capsys):
    os.mkfifo(tmp_path / "x.mcap")
    (tmp_path / "a.csv").write_text("t,q1,tau1\n0,0,0\n0.01,0.1,0\n")
    assert main(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "x.mcap")]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_a_session_without_a_name_is_a_sentence(capsys):
    assert main(["run", "identify", "--seconds", "0.1", "-o", ""]) == 2
    assert "it is a folder; name a file" in capsys.readouterr().err
