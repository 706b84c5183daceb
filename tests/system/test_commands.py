"""The program as a user meets it: JSON contracts, exit codes, help with an example."""

import io
import json
import subprocess
import sys
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import numpy as np
import plants
import pytest

from hil.cli import COMMANDS, main
from hil.record.export import write_recordings
from hil.record.recording import Recording

IDEAL = str(Path(__file__).parents[2] / "rigs" / "lawrence.toml")


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Two sessions that every test here reads and none writes."""
    folder = tmp_path_factory.mktemp("sessions")
    path = folder / "s.mcap"
    write_recordings(path, [plants.bench_axis("s", 1, drag=0.01)])
    other = folder / "h.mcap"
    write_recordings(other, [plants.bench_axis("h", 2, drag=0.01)])
    return path, other


@pytest.fixture(scope="module")
def answer(session):
    """What commands say of both sessions, as JSON; several tests look at the same answer."""

    @cache
    def said(name):
        out = io.StringIO()
        with redirect_stdout(out):
            code = main([name, str(session[0]), "--holdout", str(session[1]), "--json"])
        return code, json.loads(out.getvalue())

    return said


def run(capsys, *words):
    code = main([str(w) for w in words])
    return code, json.loads(capsys.readouterr().out)


def test_compare_json(session, capsys):
    code, out = run(capsys, "compare", session[0], "--holdout", session[1], "--json")
    assert code == 0 and out["schema"] == "hil.compare/1"
    (joint,) = out["joints"]
    assert {"name", "rms", "relative", "noise_floor", "excess_share", "where"} <= set(joint)
    assert {"feature", "range", "rms", "share", "text"} <= set(joint["where"][0])
    assert out["multi_step"]["relative"]["joint1"] > 0 and "warnings" in out


def test_diagnose_json_names_the_drag(answer):
    code, out = answer("diagnose")
    assert code == 0 and out["schema"] == "hil.diagnose/1"
    assert out["verdict"] == "missing-effect"
    (finding,) = out["findings"]
    assert (finding["effect"], finding["joint"]) == ("quadratic-drag", "joint1")
    value = finding["parameters"]["j1.quadratic-drag.fd"]
    assert value["value"] == pytest.approx(0.01, abs=4 * value["stderr"])
    assert {"candidates", "remaining", "indistinguishable", "warnings"} <= set(out)


@pytest.mark.parametrize("name", ["diagnose", pytest.param("improve", marks=pytest.mark.slow)])
def test_both_errors_of_every_rung_are_shown(session, answer, capsys, name):
    assert main([name, str(session[0]), "--holdout", str(session[1]), "--verbose"]) == 0
    one, multi = capsys.readouterr().out.split("simulated error, 0.5 s")
    for text in (one, multi):
        assert "base model" in text and "+ quadratic-drag on joint1" in text
    code, out = answer(name)
    assert code == 0 and len(out["ladder"]) == 2 and out["ladder"][0]["multi_step"]["windows"]


def test_a_law_of_contact_has_no_multi_step_error(tmp_path, capsys):
    rng, t = np.random.default_rng(0), np.arange(6000) / 500
    q = 0.05 + 0.03 * np.sin(3 * t) + 0.02 * np.sin(7.3 * t)
    force = -80 * q + 0.05 * rng.standard_normal(t.size)
    path, model = tmp_path / "c.mcap", tmp_path / "c.toml"
    write_recordings(
        path,
        [Recording("c", "arm", ("joint1",), t, q[:, None], force[:, None], tau_ext=force[:, None])],
    )
    head = 'schema = "hil.model/1"\n[robot]\npreset = "single-axis"\nexplains = "external"\n'
    names = ("contact-stiffness", "torque-offset")
    model.write_text(head + "".join(f'[[effects]]\ntype = "{n}"\n' for n in names))
    assert main(["diagnose", str(path), "--model", str(model)]) == 0
    words = ["add", "contact-damping", "--model", str(model), "--session", str(path)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "simulated error" not in said and "inf" not in said


@pytest.mark.parametrize("name", [pytest.param("diagnose", marks=pytest.mark.slow), "improve"])
def test_the_improved_model_is_written_and_adequate(session, tmp_path, capsys, name):
    better = tmp_path / "better.toml"
    code, out = run(capsys, name, session[0], "--holdout", session[1], "-o", better, "--json")
    assert code == 0
    errors = [rung["relative_all"] for rung in out["ladder"]]
    assert errors[-1] < errors[0]
    _, again = run(capsys, "diagnose", session[0], "--model", better, "--json")
    assert again["verdict"] == "adequate" and not again["findings"]


def test_add_lowers_the_error(session, tmp_path, capsys):
    words = ("add", "quadratic-drag", "--session", session[0], "--holdout", session[1])
    code, out = run(capsys, *words, "-o", tmp_path / "m.toml", "--json")
    assert code == 0
    before, after = out["ladder"]
    assert after["relative"]["joint1"] < 0.9 * before["relative"]["joint1"]


def test_fit_json(session, capsys):
    code, out = run(capsys, "fit", session[0], "--json")
    assert code == 0 and {"parameters", "rank", "condition", "not_identifiable"} <= set(out)
    assert {"value", "stderr", "unit", "at_bound"} <= set(out["parameters"]["rigid-body.m"])


def test_fit_refined_on_the_simulated_motion(session, tmp_path, capsys):
    words = ("fit", session[0], "--simulate", "--window", "1", "--holdout", session[1])
    code, out = run(capsys, *words, "-o", tmp_path / "m.toml", "--json")
    found = out["simulated"]
    assert code == 0 and found["judged"] == pytest.approx(1, rel=0.01) and not found["free_run"]
    for where in ("heldout", "official"):
        assert {"one_step", "simulated"} <= set(found[where]["before"]) & set(found[where]["after"])
    if found["refined"]:
        after, before = (found["heldout"][k]["simulated"]["joint1"] for k in ("after", "before"))
        assert after < before
    assert main(["fit", str(session[0]), "--window", "1"]) == 2


def test_no_effect_no_finding(tmp_path, capsys):
    path = tmp_path / "n.mcap"
    write_recordings(path, [plants.bench_axis("n", 3)])
    _, out = run(capsys, "diagnose", path, "--json")
    assert out["verdict"] == "adequate" and out["findings"] == []


def test_standstill_is_not_a_result(tmp_path, capsys):
    rng = np.random.default_rng(0)
    still = plants.bench_axis("still", 1)
    q = 1e-6 * rng.standard_normal(still.q.shape)
    path = tmp_path / "still.mcap"
    write_recordings(path, [Recording("still", "arm", ("joint1",), still.t, q, still.tau)])
    code, out = run(capsys, "diagnose", path, "--json")
    assert code == 0 and out["verdict"] in ("not-identifiable", "bad-data")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("diagnose", "missing.mcap"), "missing.mcap"),
        (("add", "stribek", "--session", "SESSION"), "stribeck"),
        (("add", "stribeck", "--joint", "joint9", "--session", "SESSION"), "joint1"),
        (("fit", "SESSION", "--model", "none.toml"), "none.toml"),
        (("fit", "SESSION", "-o", "no/such/folder/m.toml"), "folder"),
        (("diagnose", "SESSION", "--arm", "left"), "arm"),
        (("effects", "friktion"), "friction"),
        (("fit", "SESSION", "-o", "SESSION"), ".toml"),
        (("compare", "SESSION", "--report", "SESSION"), ".html"),
        (("run", "no.toml", "-o", "x.mcap"), "no.toml"),
        (("run", IDEAL, "-o", "x.mcap", "--seconds", "-3"), "--seconds -3: a length above 0 s"),
        (("run", IDEAL, "-o", "x.mcap", "--seconds", "nan"), "--seconds nan: a length above 0 s"),
        (("run", IDEAL, "-o", "x.mcap", "--at", "-1 pause"), "--at '-1 pause': the session lasts"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_2(session, capsys, words, says):
    words = [str(session[0]) if w == "SESSION" else w for w in words]
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and says in captured.err and "Traceback" not in captured.err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("diagnose s.mcap --repot why.html", "unknown option --repot; did you mean --report?"),
        ("run --secnds 3", "unknown option --secnds; did you mean --seconds?"),
        ("diagnose", "required: S.mcap"),
        ("diagnose a.mcap --model m.toml b.mcap", "unexpected 'b.mcap'"),
        ("diagnose a.mcap --holdout b.mcap c.mcap", "--holdout before each held-out session"),
        ("import a.csv --torque-constant 10 9", "write several values of an option with commas"),
        ("info --frobnicate", "unknown option --frobnicate."),
        ("-x", "unknown option -x"),
        ("bench emsp", "argument NAME: unknown value 'emsp'. Did you mean 'emps'?"),
        ("run r.toml -o s.mcap --clock reel", "argument --clock: unknown value 'reel'. Did you"),
        ("", "name a command: demo, run"),
    ],
)
def test_wrong_usage_is_one_line(words, says, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words.split())
    error = capsys.readouterr().err
    assert stop.value.code == 2
    assert says in error and "--help'" in error
    assert error.count("\n") == 1


def test_an_unknown_command_is_one_line(capsys):
    assert main(["diagnos", "s.mcap"]) == 2
    error = capsys.readouterr().err
    assert "Did you mean 'diagnose'?" in error and error.count("\n") == 1


def test_add_takes_sessions_behind_the_effect_or_by_name(session, capsys):
    plain = run(capsys, "add", "quadratic-drag", session[0], "--json")
    assert plain == run(capsys, "add", "quadratic-drag", "--session", session[0], "--json")
    assert main(["add", "stribeck"]) == 2
    assert "hil add stribeck run.mcap" in capsys.readouterr().err


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_has_help_with_an_example(name, capsys):
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0 and f"hil {name}" in capsys.readouterr().out.split("example:")[1]


def test_the_list_of_commands_loads_none_of_them():
    ask = "import sys, hil.cli; hil.cli.build_parser().format_help(); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    assert not {"numpy", "scipy", "numba"} & set(done.stdout.split())


def test_results_are_the_same_twice(session, answer, capsys):
    again = run(capsys, "diagnose", session[0], "--holdout", session[1], "--json")
    assert again == answer("diagnose")
