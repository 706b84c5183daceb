"""The live screen: what it shows of a session, and how a typed line reaches it."""

from __future__ import annotations

from collections import deque

import pytest
from prompt_toolkit.application import create_app_session
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput

from hil.ui import desk as screen

ARM = {"position": [0.1, 0.2], "effort": [0.0, None], "force": [3.0, 4.0, 0.0], "lamps": [4, 6]}
SNAPSHOT = {
    "state": "ENABLED",
    "why": "",
    "tick": 1530,
    "seconds": 1.53,
    "arms": {
        "leader": ARM,
        "follower": {**ARM, "position": [0.1, 0.25], "force": [0, 0, 0], "lamps": [0, 0]},
    },
    "late_p99_us": 5.0,
    "missed": 2,
    "dropped": 0,
    "ring": 19,
    "winding": 25.2,
    "record": "nowhere.mcap",
    "unwritten": 0,
    "controller": "position-force",
    "settable": {"force_scale": {"low": 0.0, "high": 2.0, "unit": "", "entries": 1}},
}


def words(snapshot):
    return ["".join(text for _, text in row) for row in screen.screen_lines(snapshot)]


def styles(snapshot):
    """Style of each text that has one."""
    return {
        text.strip(): style for row in screen.screen_lines(snapshot) for style, text in row if style
    }


def test_state_forces_tracking_loop_and_record_have_a_line_each():
    text = words(SNAPSHOT)
    assert text[0].split() == ["ENABLED", "1.5", "s", "law", "position-force"]
    assert text[1].startswith("leader") and "5.00 N" in text[1] and "nan" in text[1]
    assert "error 0.0500, largest of joint 2" in text[3]
    assert "late p99 5.0 us   missed 2   dropped 0   not written 0   ring 19" in text[4]
    assert "nowhere.mcap" in text[5]
    assert len(text) == 7 and max(map(len, text)) < 100


def test_lamps_and_what_must_be_zero_have_colours():
    found = styles(SNAPSHOT)
    assert found["5.00 N"] == "ansiyellow"
    assert found["missed 2"] == "ansired"
    assert "dropped 0" not in found
    for limits, colour in (([6, 8], "ansigreen"), ([1, 5], "ansired")):
        arms = {"leader": {**SNAPSHOT["arms"]["leader"], "lamps": limits}}
        assert styles({**SNAPSHOT, "arms": arms})["5.00 N"] == colour
    assert (
        styles({**SNAPSHOT, "state": "FAULT", "why": "encoder"})["FAULT  encoder"] == "bold ansired"
    )


def test_before_the_first_snapshot_it_is_starting():
    assert words({}) == ["starting ... (compiling for up to a minute, once per installation)"]


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("pa", ["pause"]),
        ("he", ["help"]),
        ("set fo", ["force_scale"]),
        ("note x", []),
        ("set force_scale 1", []),
    ],
)
def test_words_are_completed(typed, offered):
    assert screen.completions(typed, SNAPSHOT) == offered


def test_help_tells_commands_and_ranges():
    text = screen.command_lines(SNAPSHOT)
    assert "  pause" in text
    assert "  set force_scale: 0 to 2" in text


class Program:
    """A session that ends when it is told to stop."""

    def __init__(self, words):
        self.words, self.heard, self.said = words, [], deque(["1 W of power"])
        self.code = None

    def snapshot(self):
        return 1, SNAPSHOT

    def write(self, line):
        self.heard.append(line)
        if line == "stop" and self.code is None:
            self.code = 4
            self.said.append("session  s.mcap")

    def end(self):
        self.code = 4 if self.code is None else self.code

    def wait(self, seconds):
        assert self.code is not None


@pytest.mark.parametrize("last", ["stop\r", "\x03", "\x04"], ids=["stop", "Ctrl-C", "Ctrl-D"])
def test_lines_reach_the_session_and_every_ending_prints_its_summary(monkeypatch, capsys, last):
    made = []
    monkeypatch.setattr(screen, "EVERY", 0.001)
    monkeypatch.setattr(screen, "SessionProgram", lambda w: made.append(Program(w)) or made[0])
    with create_pipe_input() as keys, create_app_session(input=keys, output=DummyOutput()):
        keys.send_text("pause\rhelp\r" + last)
        assert screen.run_behind_screen(["teleop", "-o", "s.mcap"]) == 4
    (program,) = made
    assert program.words == ["teleop", "-o", "s.mcap"]
    assert program.heard[0] == "pause"
    assert "stop" in program.heard and "help" not in program.heard
    assert "session  s.mcap" in capsys.readouterr().out


def test_a_session_that_ends_by_itself_leaves_the_line(monkeypatch, capsys):
    monkeypatch.setattr(screen, "EVERY", 0.001)

    class Ended(Program):
        def snapshot(self):
            self.code = 0
            return 1, SNAPSHOT

        def wait(self, seconds):
            self.said.append("session  s.mcap")  # what it printed last

    monkeypatch.setattr(screen, "SessionProgram", Ended)
    with create_pipe_input() as keys, create_app_session(input=keys, output=DummyOutput()):
        assert screen.run_behind_screen([]) == 0
    assert "session  s.mcap" in capsys.readouterr().out
