"""The studio's bench: every request is a verb of the library, and the ladder falls."""

import json
import os
import pickle
import re
import shlex
import threading

import plants
import pytest

from hil.cli import main
from hil.errors import ConfigError, DataError
from hil.models import catalogue
from hil.models.files import read_model
from hil.models.model import base_model
from hil.record.export import write_recordings
from hil.report.effects import PAIRS, POINTS
from hil.studio import workbench
from hil.studio import worker as worker_module
from hil.studio.workbench import VERBS, Inputs, Workbench
from hil.studio.worker import BenchState, StudioSession, Worker, _kept, checked_request


def inputs():
    a, b = plants.stribeck_axis(1), plants.stribeck_axis(2)
    return Inputs((a,), (b,), base_model(a.robot), ("a.mcap",), ("b.mcap",), "", "")


@pytest.fixture(scope="module")
def begun():
    bench = Workbench(inputs())
    return bench, bench.start()


@pytest.mark.slow
def test_the_first_answer_shows_everything_as_json(begun):
    _, state = begun
    text = json.dumps(state, allow_nan=False)
    assert len(text) < 2_000_000
    joint = state["joints"][0]
    assert [r["label"] for r in state["ladder"]] == ["base model"]
    assert state["ladder"][0]["joints"][0]["ratio"] > 1.5
    assert state["candidates"][0]["effect"] == "stribeck"
    assert state["candidates"][0]["joint"] == joint and state["candidates"][0]["meaning"]
    assert state["where"][joint]
    series = state["series"]
    assert len(series["t"]) == len(series["joints"][0]["residual"]) <= POINTS
    trace = series["joints"][0]["trace"]
    assert len(trace["t"]) == len(trace["y"]) == len(trace["run"]) <= 2 * PAIRS
    # no peak is lost
    residual = begun[0].compared().result.residual[0]
    assert max(map(abs, trace["y"])) == pytest.approx(abs(residual).max(), rel=1e-3)
    assert (state["sessions"], state["holdout"]) == (["a.mcap"], ["b.mcap"])
    assert not state["learnt"] and state["diagnosis"] is None
    assert state["commands"] == ["hil compare a.mcap --holdout b.mcap"]


def test_adding_an_effect_lets_the_ladder_fall_and_undo_raises_it(begun, tmp_path):
    bench, first = begun
    joint = first["joints"][0]
    added = bench.add("stribeck", joint)
    before, after = (r["joints"][0]["ratio"] for r in added["ladder"])
    assert after < 1.15 < 1.5 < before
    assert added["at"] == 1
    assert "stribeck" not in [c["effect"] for c in added["candidates"]]
    (learnt,) = added["learnt"]
    assert (learnt["effect"], learnt["joint"]) == ("stribeck", joint)
    assert len(learnt["x"]) == len(learnt["data"]) == len(learnt["law"]) > 5
    assert added["commands"] == [
        f"hil add stribeck a.mcap --holdout b.mcap --joint {joint} -o better.toml",
        "hil compare a.mcap --model better.toml --holdout b.mcap",
    ]
    path = tmp_path / "better.toml"
    assert bench.save(str(path))["saved"] == str(path.resolve())
    assert "stribeck" in read_model(path).names()
    assert bench.undo()["at"] == 0
    assert bench.redo()["at"] == 1
    taken = bench.remove("stribeck")
    assert [r["label"] for r in taken["ladder"]][-1] == "- stribeck"
    assert taken["ladder"][-1]["joints"][0]["ratio"] == pytest.approx(before, rel=1e-6)


def test_the_ladder_falls_before_the_candidates_are_ranked(begun):
    bench, first = begun
    looks = []
    bench.early = looks.append
    bench.go("0")
    state = bench.add("stribeck", first["joints"][0])
    bench.early = lambda look: None
    rows = looks[0]["ladder"]
    assert [r["label"] for r in rows] == [r["label"] for r in state["ladder"]]
    early, last = (x[-1]["joints"][0] for x in (rows, state["ladder"]))
    assert early["relative"] == last["relative"]  # the error is final, its floor is not
    assert early["ratio"] == pytest.approx(last["ratio"], rel=0.2)
    assert len(bench.stack) == 2
    # then what the fit alone tells, and it is final
    assert len(looks) == 2 and looks[1]["ladder"] == rows
    assert looks[1]["model"] == state["model"] and looks[1]["learnt"] == state["learnt"]
    shown = looks[1]["series"]["joints"][0]
    assert shown["residual"] == state["series"]["joints"][0]["residual"]
    assert shown["floor"] == first["series"]["joints"][0]["floor"]


def test_all_models_of_the_ladder_are_divided_by_the_lowest_floor_of_them(begun):
    bench, first = begun
    bench.go("0")
    added = bench.add("stribeck", first["joints"][0])
    floors = [r.found.noise[0] for r in bench.stack]
    assert floors[0] != floors[1]
    for state in (added, bench.undo()):
        for rung, shown in zip(bench.stack, state["ladder"], strict=True):
            error = rung.found.heldout.rms[0]
            assert shown["joints"][0]["ratio"] == pytest.approx(error / min(floors), rel=1e-3)
            assert shown["joints"][0]["ratio"] >= 1.0


def test_a_model_that_was_shown_is_shown_again_without_a_fit(begun, monkeypatch):
    bench, first = begun
    bench.go("0")
    bench.add("stribeck", first["joints"][0])

    def refuse(*args, **more):
        raise AssertionError("fitted again")

    monkeypatch.setattr(workbench, "compare", refuse)
    assert [bench.undo()["at"], bench.redo()["at"], bench.go("0")["at"]] == [0, 1, 0]


@pytest.mark.slow
def test_columns_of_the_comparison_before_change_no_number(begun):
    kept, first = begun
    kept.go("0")
    with_them = kept.add("stribeck", first["joints"][0])
    bench = Workbench(inputs())
    bench.start()
    made, bench.before = bench.before, None
    alone = bench.add("stribeck", first["joints"][0])
    assert made.result.problem is not bench.before.result.problem
    for part in ("ladder", "candidates", "model", "series", "where", "warnings", "learnt"):
        assert with_them[part] == alone[part], part


@pytest.mark.slow
def test_an_effect_is_removed_from_the_joint_of_its_row_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = plants.slow_axes(1, 0.1, d=2)
    write_recordings(tmp_path / "a.mcap", [run])
    bench = Workbench(Inputs((run,), (), base_model(run.robot), ("a.mcap",)))
    bench.add("stribeck", "joint1")
    bench.add("stribeck", "joint2")
    both = bench.state()
    rows = [r["joint"] for r in both["model"] if r["effect"] == "stribeck"]
    assert rows == ["joint1", "joint2"]
    left = bench.remove("stribeck", "joint1")
    assert [r["joint"] for r in left["model"] if r["effect"] == "stribeck"] == ["joint2"]
    assert left["ladder"][-1]["label"] == "- stribeck on joint1"
    here = [x["relative"] for x in left["ladder"][-1]["joints"]]
    assert here[1] == pytest.approx(both["ladder"][-1]["joints"][1]["relative"], rel=0.02)
    # one of an effect that all joints have, by the command that the page shows
    state = bench.remove("viscous", "joint2")
    assert {r["joint"] for r in state["model"] if r["effect"] == "viscous"} == {"joint1"}
    for line in state["commands"]:
        capsys.readouterr()
        assert main([*shlex.split(line)[1:], "--json"]) == 0
    assert "--without viscous:joint2" in "\n".join(state["commands"])
    told = [j["relative"] for j in json.loads(capsys.readouterr().out)["joints"]]
    shown = [x["relative"] for x in state["ladder"][-1]["joints"]]
    assert told == pytest.approx(shown, rel=2e-3)


@pytest.mark.slow
def test_an_export_names_the_file_of_the_model_that_it_was_made_of(begun, tmp_path):
    bench, _ = begun
    bench.now.file = ""
    found = bench.export("card", str(tmp_path / "robot.md"))
    assert found["saved"] == f"{tmp_path / 'robot.md'}, {tmp_path / 'robot.toml'}"
    assert "# Model card: robot.toml" in (tmp_path / "robot.md").read_text()
    read_model(tmp_path / "robot.toml")
    # one that was saved is named, and no other is written
    bench.save(str(tmp_path / "mine.toml"))
    assert bench.export("c", str(tmp_path / "a.h"))["saved"] == str(tmp_path / "a.h")
    assert "mine.toml" in (tmp_path / "a.h").read_text()
    # a file of somebody else stays, and of a refused export nothing is left
    bench.now.file = ""
    with pytest.raises(ConfigError, match=r"robot\.toml beside"):
        bench.export("c", str(tmp_path / "robot.h"))
    with pytest.raises(ConfigError, match=r"a\.h: a file is there"):
        bench.export("c", str(tmp_path / "a.h"))
    assert not (tmp_path / "a.toml").exists()


@pytest.mark.slow
def test_an_export_shows_the_error_of_the_whole_model_and_within_the_target(begun, tmp_path):
    """As the command line does; a description has no law of Stribeck, and the error rises."""
    bench, first = begun
    bench.go("0")
    joint = first["joints"][0]
    added = bench.add("stribeck", joint)
    notes = bench.export("ros2", str(tmp_path / "whole.yaml"))["notes"]
    said = [re.fullmatch(rf"held-out error, (.+): {joint} ([\d.]+) %", x) for x in notes]
    assert [m[1] for m in said if m] == ["whole model"]
    bench.add("presliding", joint)
    notes = bench.export("ros2", str(tmp_path / "left.yaml"))["notes"]
    errors = {
        m[1]: float(m[2])
        for x in notes
        if (m := re.fullmatch(rf"held-out error, (.+): {joint} ([\d.]+) %", x))
    }
    assert list(errors) == ["whole model", "within the target"]
    shown = added["ladder"][-1]["joints"][0]["relative"]
    assert errors["within the target"] == pytest.approx(shown, abs=0.01)
    assert any(x.startswith("lost: presliding") for x in notes)
    assert notes[:2] == [f"held-out error, {k}: {joint} {v:.2f} %" for k, v in errors.items()]


@pytest.mark.slow
def test_a_described_arm_is_exported_as_a_description_and_a_refused_export_leaves_nothing(tmp_path):
    """The model that is written beside has a description, too: not where the exported one goes."""
    run = plants.spatial(1, 6.0)
    bench = Workbench(Inputs((run,), (), base_model(run.robot), ("a.mcap",)))
    bench.start()
    taken = tmp_path / "taken.xml"
    taken.write_text("mine")
    with pytest.raises(ConfigError, match="a file is there"):
        bench.export("mjcf", str(taken))
    assert [p.name for p in tmp_path.iterdir()] == ["taken.xml"] and taken.read_text() == "mine"
    saved = bench.export("urdf", str(tmp_path / "robot.urdf"))["saved"]
    names = ["robot.model.toml", "robot.model.urdf", "robot.urdf"]
    assert sorted(saved.split(", ")) == [str(tmp_path / n) for n in names]
    assert "<robot" in (tmp_path / "robot.urdf").read_text()
    assert read_model(tmp_path / "robot.model.toml").names() == bench.now.model.names()


def test_what_cannot_be_added_leaves_the_stack(begun):
    bench, _ = begun
    count = len(bench.stack)
    with pytest.raises(ConfigError, match="no joint 'elbow'"):
        bench.add("stribeck", "elbow")
    with pytest.raises(ConfigError, match="Did you mean 'stribeck'"):
        bench.add("stribek", "")
    with pytest.raises((ConfigError, DataError)):
        bench.add("coulomb", bench.inputs.runs[0].joints[0])
    assert len(bench.stack) == count


@pytest.mark.slow
def test_nothing_of_the_users_is_written_over(begun, tmp_path):
    bench, _ = begun
    for name, write in (("notes.toml", bench.save), ("page.html", bench.report)):
        path = tmp_path / name
        path.write_text("mine")
        with pytest.raises(ConfigError, match="a file is there"):
            write(str(path))
        assert path.read_text() == "mine"
    with pytest.raises(ConfigError, match=r"ends in \.toml"):
        bench.save("model.txt")
    page = tmp_path / "r.html"
    bench.report(str(page))
    assert "Comparison" in page.read_text()[:2000]


OWN = """from hil.models.effect import Doc, Effect, Param


class Drag(Effect):
    name, family = "{name}", "friction"
    doc = Doc("tau = c v^3", signature="grows with it", shown_by="fast strokes", source="test")
    params = (Param("c", "{{F}} s^3/{{x}}^3", "size"),)

    def columns(self, motion, j, shape):
        return motion.qd[:, j : j + 1] ** 3


EFFECTS = (Drag(),)
"""


@pytest.mark.slow
def test_an_own_effect_is_saved_with_its_file_whatever_model_it_was_learnt_beside(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(catalogue, "_table", dict(catalogue.table()))
    session = StudioSession(inputs())
    session.ask("start", {})
    session.ask("add", {"effect": "spring", "joint": "joint1"})
    place = str(tmp_path / "own_drag.py")
    text = OWN.format(name="own-drag")
    session.ask("learn", {"path": place, "text": text, "agreed": "yes"})
    session.ask("undo", {})
    state = session.ask("add", {"effect": "own-drag", "joint": "joint1"})
    assert f"--plugin {place}" in "\n".join(state["commands"])
    saved = session.ask("save", {"path": str(tmp_path / "m.toml")})["saved"]
    assert read_model(saved).plugins == (place,)


@pytest.mark.slow
def test_what_a_diagnosis_recommends_outlives_its_process(tmp_path):
    session = StudioSession(inputs())
    shown = session.ask("diagnose", {})["diagnosis"]
    assert shown["of"] == "base model"
    kept = pickle.loads(pickle.dumps(_kept(session)))
    again = StudioSession(kept.inputs, list(kept.stack), kept.at, recommended=kept.recommended)
    assert again.ask("start", {})["diagnosis"] == shown
    with pytest.raises(ConfigError, match="press Diagnose again"):
        again.ask("report", {"path": str(tmp_path / "r.html")})
    taken = again.ask("take", {})
    assert taken["ladder"][-1]["label"].startswith("diagnosis: ")
    # beside another model the verdict is still that of the base model, and the report says so
    note = session.ask("report", {"path": str(tmp_path / "d.html")})["notes"]
    assert note == ["it is of the diagnosis of 'base model'"]


IMPOSSIBLE = (
    ("report", {"path": "nowhere/r.html"}, "report did not reach .*nowhere.*No such file"),
    ("export", {"kind": "mjcf", "path": "nowhere/a.xml"}, "folder nowhere does not exist"),
    ("save", {"path": "folder.toml"}, "folder.toml: it is a folder; name a file in it"),
    ("save", {"path": "latin.toml"}, "a file is there that is not a model file"),
    ("save", {"path": "x" * 300 + ".toml"}, "save did not reach .*too long"),
    ("save", {"path": "a\0.toml"}, "ValueError.*The models stay"),
)


@pytest.mark.slow
def test_a_path_that_cannot_be_is_a_sentence_and_the_models_stay(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "latin.toml").write_bytes(b"# \xe9\n")
    asked = [("start", {}), *((verb, given) for verb, given, _ in IMPOSSIBLE), ("undo", {})]
    answers = []

    class Both:
        recv = lambda self: asked.pop(0) if asked else (_ for _ in ()).throw(EOFError)  # noqa: E731
        send = lambda self, x: answers.append(x)  # noqa: E731

    monkeypatch.setattr(worker_module, "with_its_parent", lambda: None)
    worker_module._serve(Both(), BenchState(inputs()))
    first, *refused, last = [a for a in answers if isinstance(a, tuple)]
    assert not first[1] and len(refused) == len(IMPOSSIBLE)
    for (data, error, _), (verb, _, sentence) in zip(refused, IMPOSSIBLE, strict=True):
        assert data is None and re.search(sentence, error), (verb, error)
    assert last[0]["ladder"] and not last[1]


def test_requests_are_checked_before_they_reach_the_bench():
    assert checked_request("add", {"effect": "stribeck", "joint": ""})["joint"] == ""
    for verb, given in (("__init__", {}), ("add", {"effect": "x"}), ("undo", {"n": "1"})):
        with pytest.raises(ConfigError):
            checked_request(verb, given)
    with pytest.raises(ConfigError, match="as text"):
        checked_request("save", {"path": 3})
    assert all(hasattr(Workbench, verb) for verb in VERBS)


class Pipe:
    """Two ends of a pipe without a process."""

    def __init__(self):
        self.sent, self.answer = [], threading.Event()
        self.reply = None

    def send(self, words):
        self.sent.append(words)

    def recv(self):
        if not self.answer.wait(5.0) or self.reply is None:
            raise EOFError
        return self.reply


class Process:
    def __init__(self):
        self.killed = False

    def kill(self):
        self.killed = True


@pytest.fixture
def quiet(monkeypatch):
    made = []

    def start(self):
        self._process, self._pipe = Process(), Pipe()
        made.append((self._process, self._pipe, self._kept))

    monkeypatch.setattr(worker_module.Worker, "_start", start)
    return Worker(inputs()), made


@pytest.mark.slow
def test_the_process_imports_nothing_of_the_working_directory(tmp_path, monkeypatch):
    (tmp_path / "multiprocessing.py").write_text("open('ran', 'w')\nraise SystemExit")
    monkeypatch.chdir(tmp_path)
    before = dict(os.environ)
    worker = Worker(inputs())
    worker._start()
    worker._pipe.close()  # it ends where nobody asks any more
    worker._process.join(60.0)
    assert worker._process.exitcode is not None and not (tmp_path / "ran").exists()
    assert dict(os.environ) == before


def settled(worker):
    worker._answers.join(10.0)
    assert not worker.status()["running"]
    return worker.status()


def test_one_request_at_a_time_and_its_answer_becomes_the_state(quiet):
    worker, made = quiet
    number = worker.ask("start", {})
    with pytest.raises(ConfigError, match="start is running"):
        worker.ask("undo", {})
    _, pipe, kept = made[0]
    pipe.reply = ({"at": 0}, "", kept)
    pipe.answer.set()
    assert settled(worker) | {"seconds": 0.0} == {
        "running": "",
        "seconds": 0.0,
        "number": number,
        "doing": "",
        "share": 0.0,
        "ladder": [],
        "looked": False,
        "error": "",
        "note": "",
    }
    assert worker.state == {"at": 0}


def test_the_page_gets_the_first_look_while_the_request_runs(quiet):
    worker, made = quiet
    worker.ask("start", {})
    _, pipe, kept = made[0]
    rows = [{"label": "base model", "joints": None}]
    looked = threading.Event()
    look = {"ladder": rows, "series": {"t": []}}
    replies = [worker_module.FirstLook(look), ({"at": 0}, "", kept)]

    def recv():
        if len(replies) == 1:
            looked.set()
            pipe.answer.wait(5.0)
        return replies.pop(0)

    pipe.recv = recv
    pipe.reply = worker_module.Reached("fit", 0.1)
    pipe.answer.set()
    pipe.answer.clear()
    assert looked.wait(5.0)
    assert worker.status()["ladder"] == rows and worker.status()["running"] == "start"
    assert worker.status()["looked"] and worker.look == look
    pipe.answer.set()
    assert settled(worker)["ladder"] == []


def test_a_request_that_is_cancelled_ends_its_process_and_keeps_the_last_answer(quiet):
    worker, made = quiet
    worker.ask("start", {})
    worker.cancel()
    process, pipe, _ = made[0]
    assert process.killed and worker.status()["error"] == "cancelled"
    # an answer that comes late is not taken
    pipe.reply = ({"at": 9}, "", made[0][2])
    pipe.answer.set()
    worker.ask("undo", {})
    assert len(made) == 2
    assert worker.state is None
    made[1][1].answer.set()
    assert settled(worker)["error"] == "the computation ended before its answer"
