"""The operator's desk: one page commands, commands are done once, silence pauses, anybody stops."""

import contextlib
import json
import re
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hil.cli import main
from hil.commands.ui import desk_application
from hil.errors import ConfigError, DeviceError
from hil.record.mcap_read import load, read_metadata
from hil.record.schema import read_fields
from hil.rig.config import DeviceConfig, load_rig
from hil.rig.open import Rig
from hil.runtime import runner
from hil.runtime.board import SIZE, BoardWriter, read_board
from hil.runtime.commands import parse_command
from hil.signals.device import OperatingState
from hil.ui.desk import COMMAND_RATE, SILENCE_S, Desk
from hil.web.site import Hosts

TestClient = pytest.importorskip("starlette.testclient").TestClient
ONE, OTHER = "page-one-1", "page-two-2"


class Program:
    """A session that only remembers what it was told."""

    def __init__(self, words):
        self.words, self.lines, self.code, self.said = words, [], None, ["hello"]

    def write(self, line):
        self.lines.append(line)

    def snapshot(self):
        return 3, {"state": "ENABLED"}

    def end(self):
        self.code = 0

    def wait(self, seconds):
        pass


@pytest.fixture
def desk():
    made = []

    def make(words):
        made.append(Program(words))
        return made[-1]

    return Desk(["teleop"], lambda: Path("s.mcap"), make), made


def begun(desk, now=0.0):
    desk.take(ONE, now)
    desk.begin(ONE, now)
    return desk


def test_one_page_commands_and_the_others_watch(desk):
    desk, made = desk
    begun(desk)
    assert made[0].words == ["teleop", "--wait", "-o", "s.mcap"]
    with pytest.raises(ConfigError, match="another page commands"):
        desk.take(OTHER, 1.0)
    with pytest.raises(ConfigError, match="does not command"):
        desk.command(OTHER, {"number": 1, "text": "pause"}, 1.0)
    assert desk.command(ONE, {"number": 1, "text": "start"}, 1.0) == {"done": 1}
    assert made[0].lines == ["start"]
    seen = desk.view(OTHER, 1.0)
    assert (seen["commands"], seen["free"], seen["running"]) == (False, False, True)
    assert seen["session"] == {"state": "ENABLED"} and seen["said"] == ["hello"]


def test_a_command_that_arrives_twice_is_done_once(desk):
    desk, made = desk
    begun(desk)
    for _ in range(3):
        assert desk.command(ONE, {"number": 4, "text": "pause"}, 0.1) == {"done": 4}
    desk.command(ONE, {"number": 2, "text": "resume"}, 0.2)
    assert made[0].lines == ["pause"]


def test_anybody_may_stop(desk):
    desk, made = desk
    begun(desk)
    desk.command(OTHER, {"number": 1, "text": "stop"}, 0.1)
    assert made[0].lines == ["stop"]


@pytest.mark.parametrize("number", [2, 3, 0, -1, None, "2", True, 2.5])
def test_a_stop_that_arrives_late_or_again_is_carried_out(desk, number):
    """Its first try is lost, and a later command arrives before it is repeated."""
    desk, made = desk
    begun(desk)
    desk.command(ONE, {"number": 1, "text": "start"}, 0.1)
    desk.command(ONE, {"number": 3, "text": "home"}, 0.2)
    for _ in range(2):
        assert desk.command(ONE, {"number": number, "text": "stop"}, 0.3) == {"done": number}
    assert made[0].lines == ["start", "home", "stop", "stop"]
    assert desk.view(ONE, 0.4)["log"][-1] == "stop"
    # what was said before it stays undone, and where the session has ended nothing is left to do
    desk.command(ONE, {"number": 3, "text": "home"}, 0.5)
    made[0].code = 0
    desk.command(ONE, {"number": number, "text": "stop"}, 0.6)
    assert made[0].lines[2:] == ["stop", "stop"]


def test_a_stop_needs_no_more_than_its_word(desk):
    desk, made = desk
    with pytest.raises(ConfigError, match="no session is running"):
        desk.command(ONE, {"number": 1, "text": "stop"}, 0.0)
    begun(desk)
    desk.command(ONE, {"text": "stop now"}, 0.1)
    desk.command(ONE, {"number": 7, "text": "stop"}, 0.2)
    assert made[0].lines == ["stop", "stop"]
    # a command that the stop has overtaken comes too late
    assert desk.command(ONE, {"number": 6, "text": "resume"}, 0.3) == {"done": 7}
    assert made[0].lines == ["stop", "stop"]


def test_a_page_that_is_silent_pauses_the_rig_and_frees_the_place(desk):
    desk, made = desk
    begun(desk)
    for k in range(10):
        desk.view(ONE, 0.5 * k)
        desk.watch(0.5 * k)
    assert made[0].lines == []
    desk.watch(4.5 + SILENCE_S + 0.1)
    desk.watch(4.5 + SILENCE_S + 0.5)
    assert made[0].lines == ["pause"]
    with pytest.raises(ConfigError, match="does not command"):
        desk.command(ONE, {"number": 9, "text": "resume"}, 7.2)
    desk.take(OTHER, 7.3)
    assert desk.view(OTHER, 7.3)["commands"]
    assert any("not heard" in line for line in desk.view(OTHER, 7.3)["log"])


def test_a_page_is_told_why_the_rig_paused_until_somebody_commands(desk):
    desk, _ = desk
    begun(desk)
    assert desk.view(OTHER, 0.1)["silent"] == ""
    desk.watch(SILENCE_S + 0.1)
    assert "was not heard for 2 s" in desk.view(OTHER, 2.2)["silent"]
    desk.take(OTHER, 2.3)
    assert desk.view(OTHER, 2.4)["silent"] == ""


def test_a_record_is_counted_with_its_parts(tmp_path):
    desk = Desk(["teleop"], lambda: tmp_path / "s[1].mcap", Program)
    assert desk.view(ONE, 0.0)["disk"] == {}
    begun(desk)
    assert desk.view(ONE, 0.1)["disk"]["record"] == 0
    for name, size in (("s[1].mcap", 10), ("s[1].part2.mcap", 5), ("s1.part2.mcap", 99)):
        (tmp_path / name).write_bytes(bytes(size))
    seen = desk.view(ONE, 0.2)["disk"]
    assert seen["record"] == 15 and seen["free"] > 0


def test_too_many_commands_are_refused(desk):
    desk, made = desk
    begun(desk)
    for k in range(COMMAND_RATE):
        desk.command(ONE, {"number": k + 1, "text": "pause"}, 0.01 * k)
    with pytest.raises(ConfigError, match="within a second"):
        desk.command(ONE, {"number": COMMAND_RATE + 1, "text": "pause"}, 0.5)
    desk.view(ONE, 1.5)
    desk.command(ONE, {"number": COMMAND_RATE + 1, "text": "pause"}, 1.6)
    assert len(made[0].lines) == COMMAND_RATE + 1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"number": 1, "text": "rm -rf"}, "command 'rm'"),
        ({"number": 1, "text": ""}, "command ''"),
        ({"number": 1, "text": "note a\nstart"}, "printable"),
        ({"number": 1, "text": "note " + "x" * 300}, "at most"),
        ({"number": "1", "text": "pause"}, "a number and a text"),
        ({"number": True, "text": "pause"}, "a number and a text"),
        ({"text": "pause"}, "a number and a text"),
    ],
)
def test_what_is_no_command_is_refused(desk, given, said):
    desk, made = desk
    begun(desk)
    with pytest.raises(ConfigError, match=re.escape(said)):
        desk.command(ONE, given, 0.1)
    assert made[0].lines == []


def test_a_session_begins_when_none_runs(desk):
    desk, made = desk
    with pytest.raises(ConfigError, match="does not command"):
        desk.begin(ONE, 0.0)
    begun(desk)
    with pytest.raises(ConfigError, match="a session is running"):
        desk.begin(ONE, 0.1)
    made[0].code = 0
    with pytest.raises(ConfigError, match="no session is running"):
        desk.command(ONE, {"number": 1, "text": "start"}, 0.2)
    desk.begin(ONE, 0.3)
    assert len(made) == 2
    desk.close()
    assert made[1].code == 0


def test_the_page_answers_requests_with_its_secret(desk):
    desk, made = desk
    client, head = (
        TestClient(desk_application(desk, "secret", "teleop", None, Hosts("testserver"))),
        {"X-Hil-Token": "secret"},
    )
    found = client.get("/?token=secret")
    assert found.status_code == 200 and "Emergency stop" in found.text
    for name in ("ui.js", "ui.css", "base.css", "plot.js"):
        assert "http" not in client.get(f"/static/{name}").text.replace("http://www.w3.org", "")
    assert client.post("/api/take", json={"page": ONE}).status_code == 403
    assert client.get("/api/view?page=x", headers=head).status_code == 400
    half = client.post("/api/take", content=b'{"page": "\\ud800"}', headers=head)
    assert half.status_code == 400 and "half a character" in half.json()["error"]
    assert client.post("/api/take", json={"page": ONE}, headers=head).json() == {}
    assert client.post("/api/begin", json={"page": ONE}, headers=head).json() == {}
    more = {"page": ONE, "number": 1, "text": "start"}
    assert client.post("/api/command", json=more, headers=head).json() == {"done": 1}
    seen = client.get(f"/api/view?page={ONE}", headers=head).json()
    assert seen["rig"] == "teleop" and seen["commands"] and made[0].lines == ["start"]
    again = client.post("/api/take", json={"page": OTHER}, headers=head)
    assert again.status_code == 400 and "another page" in again.json()["error"]


def test_a_board_shows_the_last_whole_snapshot(tmp_path):
    path = tmp_path / "board"
    assert read_board(path) == (0, {})
    done, wrong = threading.Event(), []

    def read():
        while not done.is_set():
            number, found = read_board(path)
            if number and found["a"] != [found["a"][0]] * 500:
                wrong.append(found)

    with BoardWriter(path) as board:
        reader = threading.Thread(target=read)
        reader.start()
        for k in range(300):
            board.publish({"a": [k] * 500})
        done.set()
        reader.join()
        assert not wrong
        assert read_board(path) == (300, {"a": [299] * 500})
        board.publish({"x": float("nan"), "y": [float("inf"), 1.0]})
        assert read_board(path)[1] == {"x": None, "y": [None, 1.0]}
        board.publish({"long": "x" * SIZE})
        assert "too long" in read_board(path)[1]["error"]


def test_a_session_shows_itself_and_keeps_notes(tmp_path):
    path = tmp_path / "board"
    with BoardWriter(path) as board:
        operator = runner.Operator([(0.3, "note first touch")], board=board)
        config = load_rig("teleop")
        runner.run_session(config, 0.6, 1, "lockstep", tmp_path / "s.mcap", operator=operator)
    number, seen = read_board(path)
    assert (
        number >= 8 and seen["state"] == "ENABLED" and set(seen["arms"]) == {"leader", "follower"}
    )
    # the lamps of a rig file without thresholds are 60 and 85 % of the sensor's range [N]
    for arm, most in (("leader", 125.0), ("follower", 12.0)):
        assert seen["arms"][arm]["lamps"] == pytest.approx([0.6 * most, 0.85 * most])
        assert seen["arms"][arm]["sensed"]
    last = load(tmp_path / "s.mcap", "leader")
    k = seen["tick"] - 1
    assert np.any(
        np.all(np.isclose(last.q[k - 15 : k + 15], seen["arms"]["leader"]["position"]), 1)
    )
    assert "force_scale" in seen["settable"] and seen["record"].endswith("s.mcap")
    assert b"note first touch" in _events(tmp_path / "s.mcap")
    assert "session" in read_metadata(tmp_path / "s.mcap")


def test_an_arm_without_a_force_sensor_shows_that(tmp_path):
    seen, _ = shown(tmp_path, "arm6", 0.3)
    assert not seen["arms"]["arm"]["sensed"] and seen["arms"]["arm"]["lamps"] == [0.0, 0.0]


def shown(tmp_path, rig, seconds, over=None, schedule=()):
    """Last snapshot of a session in virtual time, and what it turned out to be."""
    path = tmp_path / "board"
    with BoardWriter(path) as board:
        operator = runner.Operator(schedule, board=board)
        config = load_rig(rig, over)
        found = None
        with contextlib.suppress(DeviceError):
            found = runner.run_session(
                config, seconds, 1, "lockstep", tmp_path / "s.mcap", operator=operator
            )
    return read_board(path)[1], found


def test_the_record_can_be_switched_off_and_on(tmp_path):
    schedule = [(0.1, "record off"), (0.2, "note unseen"), (0.3, "record on")]
    seen, found = shown(tmp_path, "teleop", 0.4, schedule=schedule)
    assert seen["recording"] and seen["left_out"] == found.left_out == 200
    ticks = np.round(1e3 * load(tmp_path / "s.mcap", "leader").t).astype(int)
    assert len(ticks) == 200 and set(np.diff(ticks)) == {1, 201}
    told = _events(tmp_path / "s.mcap")
    assert all(x in told for x in (b"record off", b"note unseen", b"record on"))


def test_a_fault_is_recorded_also_while_the_record_is_off(tmp_path):
    over = {"arms": {"leader": {"speed_limit": [0.5, 0.5, 0.5]}}}
    seen, _ = shown(tmp_path, "identify", 3.0, over, [(0.0, "record off")])
    assert seen["state"] == "FAULT" and not seen["recording"]
    assert 150 < seen["left_out"] < 250
    last = read_fields(tmp_path / "s.mcap", "/loop/timing")[1]
    assert last["state"][-1] == OperatingState.FAULT


@pytest.mark.parametrize("text", ["record", "record perhaps", "record on now"])
def test_what_is_neither_on_nor_off_is_refused(text):
    with pytest.raises(ConfigError, match=r"one of on, off is needed; usage: record on\|off"):
        parse_command(text, None)


def test_every_device_shows_its_state_and_why_it_failed(tmp_path):
    seen, _ = shown(tmp_path, "teleop", 0.2)
    states = {d["name"]: (d["driver"], d["state"], d["reason"]) for d in seen["devices"]}
    assert states["leader-arm"] == ("premium", "ENABLED", "")
    assert states["follower-force"][0] == "ft-sensor"
    over = {"arms": {"leader": {"speed_limit": [0.5, 0.5, 0.5]}}}
    seen, _ = shown(tmp_path, "identify", 3.0, over)
    assert seen["reason"] == "a joint passed its speed_limit"
    states = {d["name"]: (d["state"], d["reason"]) for d in seen["devices"]}
    assert states["leader-arm"] == ("FAULT", "a joint passed its speed_limit")


def test_a_box_that_is_lost_is_the_reason_of_the_devices_that_hang_on_it():
    rig = Rig({"arm": Program([]), "sensor": Program([])}, [], None)
    for device in rig.devices.values():
        device.state = OperatingState.FAULT
    rig.boxes = {"quad": SimpleNamespace(trouble="no answer for 3 ticks."), "ft": object()}
    tables = {
        "arm": DeviceConfig("premium", "leader", channels={"encoders": ("quad/0", "-quad/1")}),
        "sensor": DeviceConfig("ft-sensor", "leader", channels={"gauges": ("ft/0",)}),
    }
    told = {r["name"]: (r["state"], r["reason"]) for r in rig.states(tables, "the encoders")}
    assert told == {
        "arm": ("FAULT", "no answer for 3 ticks"),
        "sensor": ("FAULT", "the encoders"),
        "quad": ("LOST", "no answer for 3 ticks"),
        "ft": ("ANSWERS", ""),
    }


def _events(path):
    from hil.record.container import read

    return b"".join(read(path).topics["/events"].data)


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--output", "file"], "a folder is needed"), (["--port", "70000"], "from 0 to 65535")],
)
def test_what_cannot_be_served_is_said(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert main(["ui", "teleop", "--no-browser", *words]) == 2
    assert said in capsys.readouterr().err


def test_the_folder_of_the_sessions_is_made(tmp_path, monkeypatch):
    """The first command of the operator's page names one that is not there yet."""
    monkeypatch.chdir(tmp_path)
    assert main(["ui", "teleop", "--no-browser", "-o", "new/sessions", "--port", "70000"]) == 2
    assert (tmp_path / "new" / "sessions").is_dir()


@pytest.mark.real_time
def test_a_session_of_the_page_runs_and_pauses_when_nobody_writes_any_more(tmp_path):
    desk = Desk(["teleop", "--clock", "real", "--seconds", "60"], lambda: tmp_path / "s.mcap")
    desk.take(ONE, 0.0)
    desk.begin(ONE, 0.0)

    def until(state):
        for _ in range(600):
            seen = desk.view(ONE, 0.1)
            if seen["session"].get("state") == state or (state == "ended" and not seen["running"]):
                return seen
            time.sleep(0.05)
        raise AssertionError(json.dumps(seen))

    until("DISABLED")
    desk.command(ONE, {"number": 1, "text": "start"}, 0.1)
    until("ENABLED")
    program = desk._program
    program._process.stdin.close()  # as if the page's program had been killed
    until("PAUSED")
    # nobody can command it any more: it ends, and its devices are free
    seen = until("ended")
    assert seen["code"] == 0
    assert seen["disk"]["record"] == (tmp_path / "s.mcap").stat().st_size
    desk.close()
    assert not program.board.parent.exists()
    assert load(tmp_path / "s.mcap", "leader").n > 100
