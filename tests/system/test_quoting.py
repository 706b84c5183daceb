"""Names from a user's files on the terminal and on pages: shown, never obeyed."""

import io
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.errors import ConfigError, printable
from hil.record.export import write_recordings
from hil.record.mcap_read import load
from hil.record.recording import Recording
from hil.terminal import Quoting

#: Clears the screen (ESC), the same as one C1 character, turns the text, hides in it, ends a line.
EVIL = "a\x1b[2Jb\x9b2Jc\u202edeg\u2066h\u200bi\ufeffj\rk\x07"
SHOWN = r"a\x1b[2Jb\x9b2Jc\u202edeg\u2066h\u200bi\ufeffj\x0dk\x07"
RAW = set("\x1b\x9b\u202e\u2066\u200b\ufeff\r\x07\x00")


def test_what_a_terminal_obeys_is_escaped():
    assert printable(EVIL) == SHOWN
    assert printable("plain\ttext\n, µ, é, 日本, 🙂") == "plain\ttext\n, µ, é, 日本, 🙂"
    assert printable("\ud800 \U000e0041") == r"\ud800 \U000e0041"
    every = "".join(map(chr, range(0x110000)))
    left = [c for c in printable(every) if c in RAW or 0x80 <= ord(c) < 0xA0]
    assert not left


def test_a_stream_keeps_the_returns_of_progress_bars():
    stream = io.StringIO()
    quoting = Quoting(stream)
    assert quoting.write("\r 10 %|##\x1b[A\r") == 13
    quoting.writelines(["a\rb\n", "\r"])
    assert stream.getvalue() == "\r 10 %|##\\x1b[A\r" + "a\\x0db\n" + "\r"


def test_what_the_encoding_lacks_is_escaped():
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, "ascii")
    Quoting(stream).write("µ\ud800\n")
    stream.flush()
    assert raw.getvalue() == b"\\xb5\\ud800\n"


@pytest.mark.parametrize("name", ["d\nx/s.mcap", "a\nhil: all is well.mcap", "a\nb\n.mcap"])
def test_a_file_cannot_add_lines_by_its_name(name, tmp_path, capsys):
    path, small = tmp_path / name, Path(__file__).parents[1] / "record" / "small.mcap"
    path.parent.mkdir(exist_ok=True)
    for words in (
        ["info", str(small), "--recover", str(path)],
        ["info", str(path)],
        ["replay", str(path)],
        ["list", str(path.parent)],
        ["view", str(path), "--for", "foxglove", "-o", str(path.with_suffix(".json"))],
        ["info", str(path.with_suffix(".none"))],
    ):
        main([*words])
        told = capsys.readouterr()
        shown = name.replace("\n", "\\n")
        lines = (told.out + told.err).splitlines()
        assert any(shown[:3] in line for line in lines), words
        for piece in name.removesuffix(".mcap").split("\n")[1:]:
            assert not [x for x in lines if piece and x.startswith(piece)], words


def test_a_break_at_the_end_of_a_name_is_not_taken_for_those_of_the_output(tmp_path, capsys):
    (tmp_path / "s\n").mkdir()
    assert main(["effects", "stribeck"]) == 0
    plain = capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["effects", "stribeck", "s\n"])
    capsys.readouterr()
    assert main(["effects", "stribeck"]) == 0
    assert capsys.readouterr().out == plain


@pytest.fixture
def session(tmp_path):
    t = np.arange(3000) / 500
    q = np.sin(3 * t)[:, None]
    run = Recording("s", "arm", (EVIL,), t, q, q)
    write_recordings(tmp_path / "s.mcap", [replace(run, metadata={"session.rig": EVIL})])
    return tmp_path / "s.mcap"


def test_a_joint_cannot_add_lines_to_the_output(session, capsys):
    run = replace(load(session), joints=("a\nhil: all is well",))
    write_recordings(session.with_name("t.mcap"), [run])
    assert main(["info", str(session.with_name("t.mcap"))]) == 2
    said = capsys.readouterr()
    assert not said.out and said.err.count("\n") == 1 and "without line breaks" in said.err


@pytest.mark.parametrize(
    "words",
    [
        [EVIL],
        ["info", EVIL],
        ["info", "--" + EVIL],
        ["fit", "S", "--model", EVIL],
        ["fit", "S", "--arm", EVIL],
        ["info", "S"],
        ["compare", "S"],
        ["bench", EVIL],
        ["run", EVIL, "-o", "x.mcap"],
        ["import", EVIL, "-o", "x.mcap"],
        ["effects", EVIL],
    ],
)
def test_no_command_prints_what_a_terminal_obeys(session, capsys, monkeypatch, words):
    monkeypatch.chdir(session.parent)
    try:
        code = main([str(session) if w == "S" else w for w in words])
    except SystemExit as left:  # as argparse does
        code = left.code
    assert code in (0, 2)
    said = capsys.readouterr()
    assert not RAW & set(said.out + said.err)
    assert r"\x1b[2J" in said.out + said.err
    if code == 2:
        assert said.err.count("\n") == 1


def test_streams_are_as_before_when_a_command_has_ended(capsys):
    before = sys.stdout, sys.stderr
    assert main(["--version"]) == 0
    assert (sys.stdout, sys.stderr) == before


def test_a_message_with_several_lines_stays_one(capsys, monkeypatch):
    def refuse(*_):
        raise ConfigError("topic 'a\nhil fit: done' is wrong")

    monkeypatch.setattr("hil.commands.effects.run", refuse)
    assert main(["effects"]) == 2
    assert capsys.readouterr().err == "hil effects: topic 'a\\nhil fit: done' is wrong\n"
