"""One source of the version, for the program and the library."""

import subprocess
import sys
from importlib.metadata import version

import hil
from hil.cli import main


def test_the_program_says_its_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"hil {version('hil-teleop')}\n"
    assert hil.__version__ == version("hil-teleop")


def test_the_package_runs_as_a_program():
    words = [sys.executable, "-m", "hil", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout == f"hil {version('hil-teleop')}\n"
