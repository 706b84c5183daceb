"""Files that come in through the page: picked columns, what is wrong, own effects, export."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import plants
import pytest

from hil import trusted_code
from hil.cli import main
from hil.errors import ConfigError, DataError, HilError
from hil.models import catalogue
from hil.models.files import read_model
from hil.models.model import base_model
from hil.record import mcap_read
from hil.record.export import write_recordings
from hil.record.mapfile import read_map
from hil.record.tables import import_table
from hil.studio import intake, worker
from hil.studio.intake import TEMPLATE
from hil.studio.workbench import Inputs
from hil.studio.worker import StudioSession

OURS = {
    "time [ms]": ("t", "ms", False),
    "Encoder angle (deg)": ("q", "deg", True),
    "drive current mA": ("tau", "mA", False),
}


def messy(path, seed=1, note=True):
    """A recording as a lab may have it: odd names, other units, a sign, a column of no use."""
    r = plants.stribeck_axis(seed)
    columns = [r.t * 1e3, -np.degrees(r.q[:, 0]), r.tau[:, 0] * 1e3 / 2.0, np.arange(r.n)]
    head = [*OURS, "loop count"]
    np.savetxt(path, np.column_stack(columns), "%.9g", ";", header=";".join(head), comments="")
    return r


def picks(constant="2.0", **more):
    columns = [
        {"column": n, "kind": k, "joint": 1, "unit": u, "flip": f} for n, (k, u, f) in OURS.items()
    ]
    return {"columns": columns, "urdf": "", "constant": constant, "rate": ""} | more


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(trusted_code.STATE_VARIABLE, str(tmp_path / "state"))
    return tmp_path


def test_the_columns_of_a_table_are_shown_with_a_guess(here):
    messy(here / "run.csv")
    shown = intake.shown(here / "run.csv")
    found = {c["name"]: c["guess"] for c in shown["columns"]}
    assert found["time [ms]"] == {"kind": "t", "joint": 1, "unit": "ms"}
    assert found["Encoder angle (deg)"] == {"kind": "q", "joint": 1, "unit": "deg"}
    assert (found["drive current mA"]["kind"], found["drive current mA"]["unit"]) == ("i", "mA")
    assert found["loop count"]["kind"] == ""
    assert shown["output"] == "run.mcap" and len(shown["columns"][0]["first"]) == 3
    json.dumps(shown, allow_nan=False)


def test_the_joints_are_counted_by_kind():
    found = intake.guess(["t", "q1", "q2", "qd1", "qd2", "tau1", "tau2", "tau_ext1", "temp"])
    kinds = [(g["kind"], g["joint"]) for g in found.values()]
    assert kinds[1:] == [
        ("q", 1),
        ("q", 2),
        ("qd", 1),
        ("qd", 2),
        ("tau", 1),
        ("tau", 2),
        ("tauext", 1),
        ("temp", 1),
    ]


@pytest.mark.slow
def test_a_messy_table_becomes_a_session_that_the_command_line_repeats(here):
    r = messy(here / "run.csv")
    session = StudioSession()
    assert session.ask("start", {}) == {"intake": None}
    assert session.ask("open", {"path": "run.csv", "use": "new"})["intake"]["file"] == "run.csv"
    told = session.ask("preview", {"picks": json.dumps(picks())})["preview"]
    assert told["good"] and told["unused"] == ["loop count"]
    state = session.ask("bring", {"picks": json.dumps(picks()), "output": "run.mcap", "use": "new"})
    assert state["sessions"] == ["run.mcap"] and state["candidates"]
    assert state["commands"] == [
        "hil import run.csv --map run.map.toml -o run.mcap",
        "hil compare run.mcap",
    ]
    held = mcap_read.load(here / "run.mcap", None)
    assert held.q[:, 0] == pytest.approx(r.q[:, 0], abs=1e-7)
    assert held.tau[:, 0] == pytest.approx(r.tau[:, 0], abs=1e-6)
    (again,) = import_table(here / "run.csv", read_map(here / "run.map.toml")).recordings
    assert np.array_equal(again.q, held.q) and np.array_equal(again.tau, held.tau)
    # a second one, to judge on
    messy(here / "other.csv", 2)
    session.ask("open", {"path": "other.csv", "use": "holdout"})
    given = {"picks": json.dumps(picks()), "output": "other.mcap", "use": "holdout"}
    assert session.ask("bring", given)["holdout"] == ["other.mcap"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"constant": ""}, "effort by ampere"),
        ({"constant": "much"}, "expected a number"),
        ({"columns": []}, "no column"),
        ({"columns": [{"column": "time [ms]"}]}, "a pick has"),
        ({"missing": "guess"}, "missing"),
    ],
)
def test_what_was_picked_wrongly_is_said(here, change, said):
    messy(here / "run.csv")
    session = StudioSession(table="run.csv")
    with pytest.raises(HilError, match=said):
        session.ask("preview", {"picks": json.dumps(picks() | change)})


def test_an_error_says_what_to_do_on_the_page(here):
    """None of these errors speaks of options, maps and commands."""
    messy(here / "run.csv")
    (here / "empty").mkdir()
    (here / "no.mcap").write_bytes(b"t,q1")
    rows = np.c_[np.arange(500) / 500, np.ones(500), np.ones(500)]
    rows[200:, 0] += 3.0
    rows[300, 1] = np.nan
    np.savetxt("gap.csv", rows, "%.6g", ",", header="clock,q1,tau1", comments="")
    plain = [
        {"column": n, "kind": k, "joint": 1, "unit": u, "flip": False}
        for n, k, u in (("clock", "t", "s"), ("q1", "q", "rad"), ("tau1", "tau", "Nm"))
    ]
    quick = [plain[0] | {"unit": "ns"}, *plain[1:]]
    lab = picks()["columns"]
    asked = {
        "A table with columns": ("run.csv", "open", {"path": "empty", "use": "new"}),
        "not an MCAP": ("run.csv", "open", {"path": "no.mcap", "use": "new"}),
        "Sample rate": ("gap.csv", "preview", picks(columns=plain[1:])),
        "in what unit": ("gap.csv", "preview", picks(columns=quick, missing="drop")),
        "which column it is": ("run.csv", "preview", picks(columns=lab[:2])),
        "into Robot": ("run.csv", "preview", picks(urdf="none.urdf")),
        "Missing values": ("gap.csv", "preview", picks(columns=plain)),
    }
    for said, (table, verb, given) in asked.items():
        words = given if verb == "open" else {"picks": json.dumps(given)}
        data, text = worker.answer_request(StudioSession(table=table), verb, words)
        assert data is None and said in text, text
        for word in ("hil ", " map", "--", "[table]", "rate_hz"):
            assert word not in text, text


def test_every_topic_of_an_error_has_an_advice_on_the_page():
    source = "".join(p.read_text() for p in Path(intake.__file__).parents[1].rglob("*.py"))
    topics = set(re.findall(r"""\.about\((?:"time" if .* else )?"([a-z]+)",""", source))
    assert topics | {"time"} == intake.PAGE_ADVICE.keys()


def test_two_columns_for_one_thing_are_refused():
    twice = picks()
    twice["columns"].append(twice["columns"][1] | {"column": "loop count"})
    with pytest.raises(ConfigError, match="both picked as q1"):
        intake.Picked.parse(json.dumps(twice)).table()


def test_what_is_wrong_with_the_recording_is_said_and_not_brought_in(here):
    rows = np.c_[np.arange(500) / 500, np.zeros(500), np.zeros(500)]
    np.savetxt("still.csv", rows, "%.6g", ",", header="t,q1,tau1", comments="")
    plain = {
        "columns": [
            {"column": n, "kind": k, "joint": 1, "unit": u, "flip": False}
            for n, k, u in (("t", "t", "s"), ("q1", "q", "rad"), ("tau1", "tau", "Nm"))
        ]
    }
    session = StudioSession(table="still.csv")
    told = session.ask("preview", {"picks": json.dumps(plain)})["preview"]
    assert not told["good"] and any(f["severity"] == "error" for f in told["faults"])
    with pytest.raises(ConfigError, match="cannot be fitted"):
        session.ask("bring", {"picks": json.dumps(plain), "output": "s.mcap", "use": "new"})
    assert not (here / "s.mcap").exists() and session.bench is None


def test_nothing_is_written_over_and_a_session_of_another_robot_is_refused(here):
    messy(here / "run.csv")
    (here / "run.mcap").write_text("mine")
    session = StudioSession(table="run.csv")
    with pytest.raises(ConfigError, match="a file is there"):
        session.ask("bring", {"picks": json.dumps(picks()), "output": "run.mcap", "use": "new"})
    with pytest.raises(ConfigError, match=r"ends in \.mcap"):
        session.ask("bring", {"picks": json.dumps(picks()), "output": "run.txt", "use": "new"})
    assert (here / "run.mcap").read_text() == "mine"
    r = plants.slow_axes(1)
    bench = StudioSession(Inputs((r,), (), base_model(r.robot), ("a.mcap",)), table="run.csv")
    with pytest.raises(ConfigError, match="two robots"):
        bench.ask("bring", {"picks": json.dumps(picks()), "output": "b.mcap", "use": "fit"})


def test_without_a_session_the_bench_says_what_to_do():
    with pytest.raises(ConfigError, match="drop a file"):
        StudioSession().ask("diagnose", {})
    with pytest.raises((ConfigError, DataError), match="no"):
        StudioSession().ask("open", {"path": "nowhere.mcap", "use": "new"})


@pytest.fixture
def begun(here):
    r = plants.stribeck_axis(1)
    table = dict(catalogue.table())
    session = StudioSession(Inputs((r,), (), base_model(r.robot), ("a.mcap",)))
    yield session, here
    catalogue.table().clear()
    catalogue.table().update(table)


@pytest.mark.slow
def test_an_own_effect_is_agreed_to_checked_and_ranked(begun):
    session, folder = begun
    given = {"path": "my_effects.py", "text": TEMPLATE, "agreed": ""}
    with pytest.raises(ConfigError, match="agree to it"):
        session.ask("learn", given)
    assert not (folder / "my_effects.py").exists() and "eyelet-drag" not in catalogue.table()
    state = session.ask("learn", given | {"agreed": "yes"})
    (mine,) = [c for c in state["candidates"] if c["own"]]
    assert mine["effect"] == "eyelet-drag" and state["own"] == ["eyelet-drag"]
    assert trusted_code.plugin(folder / "my_effects.py", TEMPLATE.encode()).trusted
    added = session.ask("add", {"effect": "eyelet-drag", "joint": state["joints"][0]})
    assert "eyelet-drag" in [u["effect"] for u in added["model"]]
    # the file that is saved names the effects, and a new process knows them
    session.ask("save", {"path": "mine.toml"})
    assert 'plugins = ["my_effects.py"]' in (folder / "mine.toml").read_text()
    renamed = TEMPLATE.replace("eyelet-drag", "eyelet-rub")
    with pytest.raises(ConfigError, match="a model has eyelet-drag"):
        session.ask("learn", given | {"text": renamed, "agreed": "yes"})
    assert "eyelet-rub" not in catalogue.table()
    assert (folder / "my_effects.py").read_text() == TEMPLATE
    session.ask("learn", given | {"text": renamed, "agreed": "yes", "path": "more.py"})
    assert "eyelet-rub" in catalogue.table()


@pytest.mark.slow
def test_the_commands_that_are_shown_make_the_same_models(begun, capsys):
    """Every command takes the model that the last one wrote, own effects and removals too."""
    _, folder = begun
    for name, seed in (("a.mcap", 1), ("b.mcap", 2)):
        run = plants.stribeck_axis(seed)
        write_recordings(folder / name, [plants.without(run, (5000, run.n))])
    session = StudioSession()
    session.ask("open", {"path": "a.mcap", "use": "fit"})
    first = session.ask("open", {"path": "b.mcap", "use": "holdout"})
    session.ask("learn", {"path": "my_effects.py", "text": TEMPLATE, "agreed": "yes"})
    (joint,) = first["joints"]
    states = [
        session.ask("add", {"effect": "eyelet-drag", "joint": joint}),
        session.ask("add", {"effect": "stribeck", "joint": joint}),
        session.ask("remove", {"effect": "eyelet-drag", "joint": joint}),
    ]
    judged, plugin = "--holdout b.mcap", folder / "my_effects.py"
    steps = [
        f"hil add eyelet-drag a.mcap --plugin {plugin} {judged} --joint {joint} -o better.toml",
        f"hil add stribeck a.mcap --model better.toml {judged} --joint {joint} -o better2.toml",
        f"hil fit a.mcap --model better2.toml --without eyelet-drag:{joint} -o better3.toml",
    ]
    for k, (state, name) in enumerate(zip(states, ("", "2", "3"), strict=True)):
        shown = f"hil compare a.mcap --model better{name}.toml {judged}"
        assert state["commands"] == [*steps[: k + 1], shown]
        assert main(shlex.split(steps[k])[1:]) == 0
        capsys.readouterr()
        assert main([*shlex.split(shown)[1:], "--json"]) == 0
        (answer,) = json.loads(capsys.readouterr().out)["joints"]
        (there,) = state["ladder"][-1]["joints"]
        assert answer["relative"] == pytest.approx(there["relative"], rel=2e-3)
        made, model = read_model(folder / f"better{name}.toml"), session.bench.stack[k + 1].model
        assert made.names() == model.names()
    # where a model was left, its commands are left too
    assert session.ask("go", {"at": "1"})["commands"] == states[0]["commands"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("EFFECTS = ()", "no EFFECTS"),
        ("def", "does not run"),
        (TEMPLATE.replace("[:, None]", ""), "eyelet-drag"),
        (TEMPLATE.replace('"eyelet-drag"', '"coulomb"'), "already defined"),
    ],
)
def test_a_wrong_effect_leaves_the_catalogue_as_it_was(begun, text, said):
    session, _ = begun
    before = dict(catalogue.table())
    with pytest.raises(HilError, match=said):
        session.ask("learn", {"path": "my_effects.py", "text": text, "agreed": "yes"})
    assert catalogue.table() == before


def wrong(line):
    """The template with a wrong line in its columns."""
    return TEMPLATE.replace("        wound = ", f"        {line}\n        wound = ")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "x = 1\ndef x(:\n",
            "plugin my_effects.py does not run: SyntaxError: invalid syntax "
            "(my_effects.py, line 2)",
        ),
        (
            "\n\n1 / 0",
            "plugin my_effects.py does not run: ZeroDivisionError: division by zero "
            "(my_effects.py, line 3)",
        ),
        (
            wrong("motion.nothing"),
            "effect 'eyelet-drag' (1 joint moving, without external effort, joint 1) fails with "
            "AttributeError: 'Motion' object has no attribute 'nothing' (my_effects.py, line 20)",
        ),
        (
            wrong("motion.q[10**9] if len(motion.q) != 2000 else 0"),
            "an effect of your own failed in my_effects.py, line 20: IndexError: index 1000000000 "
            "is out of bounds for axis 0 with size",
        ),
    ],
)
def test_an_error_of_an_own_effect_names_its_file_and_line(begun, text, said):
    session, _ = begun
    given = {"path": "my_effects.py", "text": text, "agreed": "yes"}
    answer = worker.answer_request(session, "learn", given)
    assert answer[0] is None and said in answer[1]
    for word in ("/tmp", "hil_plugin", "(<", "Error("):
        assert word not in answer[1]


def test_an_own_effect_that_another_file_defines_is_said_with_that_file(begun):
    session, _ = begun
    given = {"text": TEMPLATE, "agreed": "yes"}
    session.ask("learn", given | {"path": "first.py"})
    _, said = worker.answer_request(session, "learn", given | {"path": "second.py"})
    assert said == (
        "effect 'eyelet-drag' of second.py is already defined in first.py; give it another name"
    )


def test_a_file_of_the_users_is_not_written_over_by_the_editor(begun):
    session, folder = begun
    (folder / "mine.py").write_text("x = 1\n")
    with pytest.raises(ConfigError, match="a file is there"):
        session.ask("learn", {"path": "mine.py", "text": TEMPLATE, "agreed": "yes"})
    with pytest.raises(ConfigError, match=r"NAME\.py"):
        session.ask("learn", {"path": "mine.txt", "text": TEMPLATE, "agreed": "yes"})
    assert (folder / "mine.py").read_text() == "x = 1\n"


@pytest.mark.slow
def test_a_model_is_exported_and_models_are_compared(begun):
    session, folder = begun
    joint = session.ask("start", {})["joints"][0]
    state = session.ask("add", {"effect": "stribeck", "joint": joint})
    kinds = {x["name"]: x["ending"] for x in state["exports"]}
    assert "c" in kinds or any(".h" in e or ".c" in e for e in kinds.values())
    name = next(n for n, e in kinds.items() if e == ".h")
    saved = session.ask("export", {"kind": name, "path": "arm.h"})
    assert (folder / "arm.h").read_text() and "arm.h" in saved["saved"]
    with pytest.raises(ConfigError, match="a file is there"):
        session.ask("export", {"kind": name, "path": "arm.h"})
    with pytest.raises(ConfigError, match=r"ends in \.h"):
        session.ask("export", {"kind": name, "path": "arm.txt"})
    beside = session.ask("beside", {"at": "0"})["beside"]
    assert beside["label"] == "base model"
    rms = [
        np.sqrt(np.mean(np.square(y)))
        for y in (beside["joints"][0]["y"], state["series"]["joints"][0]["trace"]["y"])
    ]
    assert rms[0] > 1.3 * rms[1]
    assert session.ask("go", {"at": "0"})["at"] == 0
    for wrong in ("9", "-1", "x"):
        with pytest.raises(ConfigError, match="no model"):
            session.ask("go", {"at": wrong})
