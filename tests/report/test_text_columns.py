"""Text tables within a width: no line beyond it, and nothing lost."""

from __future__ import annotations

import io
import os

import pytest

from hil.terminal import aligned, sentences

HEAD = ["model", *(f"joint{k}" for k in range(1, 8))]
ROWS = [["base model with a long name", *(f"{k}.25" for k in range(7))]] * 2


def test_a_table_that_fits_is_one_block():
    assert aligned(["a", "b"], [["x", "1"]], width=80).splitlines() == [
        "  a  b",
        "  -  -",
        "  x  1",
    ]


@pytest.mark.parametrize("width", [40, 60, 80])
def test_no_line_is_beyond_the_width_and_every_cell_is_there(width):
    text = aligned(HEAD, ROWS, width=width)
    assert max(map(len, text.splitlines())) <= width
    for cell in (*HEAD, *ROWS[0][1:]):
        assert cell in text


def test_words_break_before_columns_do():
    text = aligned(["effect", "why", "n"], [["drag", "word " * 20, "3"]], left=(0, 1), width=50)
    assert max(map(len, text.splitlines())) <= 50
    assert text.count("effect") == 1 and text.split().count("word") == 20


class _Screen(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("wide", [60, 80, 200])
def test_sentences_break_between_words_on_a_terminal_alone(monkeypatch, wide):
    said = "  note: " + "a joint " * 40 + "end"
    kept = [
        f"  hil diagnose {'run.mcap ' * 40}",
        f'{{"a": "{"b " * 200}"}}',
        f'q1 = "{"c " * 200}"',
    ]
    text = "\n".join([said, *kept])
    assert sentences(text, io.StringIO()) == text
    monkeypatch.setattr("shutil.get_terminal_size", lambda *_, **__: os.terminal_size((wide, 24)))
    assert max(map(len, sentences(f"hil import: {said}", _Screen()).split("\n"))) <= wide
    first, *lines = sentences(text, _Screen()).split("\n")
    assert lines[-3:] == kept
    broken = [first, *lines[:-3]]
    assert max(map(len, broken)) <= wide < len(said)
    assert " ".join(" ".join(broken).split()) == " ".join(said.split())
    assert all(x.startswith("    a joint") or x.startswith("    joint") for x in broken[1:-1])
