"""Completion: each shell reads its script, and knows commands, options and values."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from hil.cli import COMMANDS, main


def script(capsys, shell):
    assert main(["completion", shell]) == 0
    return capsys.readouterr().out


def needs(shell):
    return pytest.mark.skipif(not shutil.which(shell), reason=f"{shell} is not installed")


def bash(text, *words):
    """What bash offers for the last word."""
    quoted = " ".join(f"'{w}'" for w in words)
    ask = f"COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; _hil\n"
    ask += 'printf "%s\\n" "${COMPREPLY[@]}"'
    done = subprocess.run(
        ["bash", "--norc", "-c", f"{text}\n{ask}"], capture_output=True, text=True, check=True
    )
    assert not done.stderr
    return done.stdout.split()


@needs("bash")
def test_bash(capsys):
    text = script(capsys, "bash")
    assert bash(text, "hil", "dia") == ["diagnose"]
    assert set(COMMANDS) <= set(bash(text, "hil", ""))
    assert bash(text, "hil", "diagnose", "--hold") == ["--holdout"]
    assert "mjcf" in bash(text, "hil", "export", "m.toml", "--to", "")
    assert bash(text, "hil", "diagnose", "run") == []  # then bash completes files
    assert bash(text, "hil", "completion", "") == ["bash", "zsh", "fish"]


@needs("fish")
def test_fish(capsys, tmp_path):
    place = tmp_path / "hil.fish"
    place.write_text(script(capsys, "fish"))

    def offered(line):
        words = ["fish", "--no-config", "-c", f"source {place}; complete -C '{line}'"]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
        assert not done.stderr
        return [row.split("\t")[0] for row in done.stdout.splitlines()]

    assert offered("hil dia") == ["diagnose"]
    assert offered("hil diagnose --hold") == ["--holdout"]
    assert "mjcf" in offered("hil export m.toml --to ")


@needs("zsh")
def test_zsh_reads_its_script_without_an_error(capsys):
    start = f"autoload -Uz compinit && compinit -u -D\n{script(capsys, 'zsh')}"
    done = subprocess.run(
        ["zsh", "-f", "-c", f"{start}\nprint $_comps[hil]"], capture_output=True, text=True
    )
    assert (done.stdout.strip(), done.stderr, done.returncode) == ("_hil", "", 0)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_option_of_every_command_is_in_the_script(capsys, shell):
    text = script(capsys, shell)
    for word in ("--holdout", "--effort-topic", "--clock", "--all-runs", "quiet"):
        assert word.removeprefix("--") in text
    assert all(name in text for name in COMMANDS)
    assert "--board" not in text and "-l board" not in text  # of the program itself
