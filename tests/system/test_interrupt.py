"""Ctrl-C at any moment: one line, exit code 130, and where the record is."""

import os
import re
import signal
import subprocess
import sys
from multiprocessing import resource_tracker
from pathlib import Path
from types import SimpleNamespace

import pytest
from mcap.reader import make_reader

from hil.cli import main
from hil.interrupt import Ended, Interrupts, held_back, interrupts, saying
from hil.record.mcap_read import load

#: Runs the program and gives it Ctrl-C when it begins to import a module.
IMPORTING = """
import signal, sys
class Hook:
    def find_spec(self, name, path=None, target=None):
        if name == WHEN:
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Hook())
from hil.__main__ import program
program()
"""
#: Runs the program and gives it Ctrl-C, and two more at once, when a file has some length.
RECORDING = """
import os, signal, sys, threading, time
def watch():
    while not (os.path.exists("s.mcap") and os.path.getsize("s.mcap") > 60_000):
        time.sleep(0.005)
    for _ in range(3):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.002)
from hil.__main__ import program
threading.Thread(target=watch, daemon=True).start()
program()
"""


def run(script: str, *words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", script, *words]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=120)


@pytest.mark.parametrize("when", ["hil.cli", "hil.commands.demo", "numpy.linalg", "scipy.optimize"])
def test_during_an_import(tmp_path, when):
    done = run(f"WHEN = {when!r}\n" + IMPORTING, "demo", "-o", "demo", folder=tmp_path)
    assert done.returncode == 130
    assert done.stderr == "hil: interrupted\n" and not done.stdout


def test_before_the_handler_of_the_program_is_there(tmp_path):
    # what the program's first module imports
    script = "import sys\nsys.modules.pop('contextlib', None)\nWHEN = 'contextlib'\n" + IMPORTING
    done = run(script, "effects", folder=tmp_path)
    assert (done.returncode, done.stderr, done.stdout) == (130, "hil: interrupted\n", "")


def test_when_all_is_said_the_process_ends_with_its_own_code(tmp_path):
    script = (
        "import signal, sys, weakref\nfrom hil.__main__ import program\n"
        "class Late:\n    def __del__(self):\n        signal.raise_signal(signal.SIGINT)\n"
        "kept = Late()\nkept.circle = kept\nprogram()\n"
    )
    done = run(script, "effects", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "") and "stribeck" in done.stdout


def test_semaphores_of_pools_are_given_back_where_it_leaves_at_once(tmp_path):
    script = """
import multiprocessing, os, signal, time
from hil.interrupt import interrupts
interrupts.arm()
lock = multiprocessing.get_context("spawn").Lock()
os.kill(os.getpid(), signal.SIGINT)
time.sleep(10)
"""
    words = [sys.executable, "-c", script]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (130, "hil: interrupted\n")


def test_during_an_import_of_a_command_that_runs(tmp_path):
    script = "WHEN = 'pinocchio'\n" + IMPORTING
    (tmp_path / "one.urdf").write_text(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/></joint></robot>'
    )
    done = run(script, "excite", "one.urdf", "-o", "t.toml", folder=tmp_path)
    assert done.returncode == 130
    assert done.stderr == "hil excite: interrupted\n" and not (tmp_path / "t.toml").exists()


def test_while_a_session_is_recorded(tmp_path):
    words = ("run", "teleop", "--clock", "lockstep", "--seconds", "1000", "-o", "s.mcap")
    done = run(RECORDING, *words, folder=tmp_path)
    assert done.returncode == 130 and "Traceback" not in done.stderr
    last = done.stderr.splitlines()[-1]
    assert last == "hil run: interrupted; what was recorded until then is in s.mcap"
    assert done.stderr.count("interrupted") == 1
    found = load(tmp_path / "s.mcap", "leader")
    assert found.n > 100 and "note" not in found.metadata  # closed properly
    told = dict(line.split(maxsplit=1) for line in done.stdout.splitlines() if line[:1] in "sct")
    assert told["session"] == "s.mcap" and told["clock"] == "lockstep"
    ticks, seconds = re.fullmatch(r"(\d+) in ([\d.]+) s, then broken off", told["ticks"]).groups()
    assert int(ticks) >= found.n and float(seconds) == pytest.approx(int(ticks) / 1000)
    assert "rows dropped" in done.stdout


#: Runs the program and ends it by a signal when the loop begins, before there is a row.
BEGINNING = """
import os, signal
from hil.runtime.loop import Loop
begin = Loop.begin
def ended(self):
    begin(self)
    os.kill(os.getpid(), NUMBER)
Loop.begin = ended
from hil.__main__ import program
program()
"""


@pytest.mark.parametrize(
    ("clock", "name", "code"),
    [
        ("lockstep", "SIGTERM", 143),
        ("real", "SIGINT", 130),
        pytest.param("lockstep", "SIGINT", 130, marks=pytest.mark.slow),
        pytest.param("real", "SIGTERM", 143, marks=pytest.mark.slow),
    ],
)
def test_a_session_that_ends_before_its_first_row_leaves_no_file(tmp_path, clock, name, code):
    words = ("run", "identify", "--clock", clock, "--seconds", "9", "--plain", "-o", "s.mcap")
    script = BEGINNING.replace("NUMBER", f"signal.{name}")
    done = run(script, *words, folder=tmp_path)
    assert done.returncode == code, done.stderr
    assert done.stderr.splitlines()[-1].endswith("; it had not begun to record")
    assert not list(tmp_path.glob("*.mcap"))


@pytest.mark.parametrize("many", [1, 3])
def test_what_is_done_as_a_whole_is_not_left_half_done(many):
    interrupts, done = Interrupts(), []
    with interrupts.unwinding("run"):
        with pytest.raises(KeyboardInterrupt), interrupts:
            with interrupts:
                for _ in range(many):
                    interrupts._handle(signal.SIGINT, None)
                done.append("within")
            done.append("around")
        assert done == ["within", "around"] and interrupts.seen
        with interrupts:  # nothing waits any more
            pass


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_the_index_of_a_session_is_right_wherever_the_signal_comes(tmp_path, name):
    script = f"""
import os, signal
from hil.record import recovery
write, count = recovery.FileIO.write, []
class Raw(recovery.FileIO):
    def write(self, data):
        n = super().write(data)
        count.append(n)
        if len(count) == 20:  # written, and not yet counted
            os.kill(os.getpid(), signal.{name})
        return n
recovery.FileIO = Raw
from hil.__main__ import program
program()
"""
    words = ("run", "teleop", "--clock", "lockstep", "--seconds", "1000", "-o", "s.mcap")
    done = run(script, *words, folder=tmp_path)
    assert done.returncode == 128 + getattr(signal, name)
    found = load(tmp_path / "s.mcap", "leader")
    assert "note" not in found.metadata
    with (tmp_path / "s.mcap").open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages()))


def test_a_second_one_does_not_disturb_what_the_first_unwinds():
    interrupts = Interrupts()
    with interrupts.unwinding("run"):
        with pytest.raises(KeyboardInterrupt):
            interrupts._handle(signal.SIGINT, None)
        interrupts._handle(signal.SIGINT, None)
    assert interrupts.seen
    assert interrupts.line("x") == "hil run: interrupted; x\n"
    assert interrupts.line("x") == ""  # said once


def test_one_between_the_end_of_a_command_and_its_line_does_not_cost_the_line(monkeypatch):
    interrupts = Interrupts()
    monkeypatch.setattr(interrupts, "leave", lambda line: sys.exit(f"left: {line}"))
    with pytest.raises(KeyboardInterrupt), interrupts.unwinding("run"):
        interrupts._handle(signal.SIGINT, None)
    interrupts._handle(signal.SIGINT, None)
    assert interrupts.line("x") == "hil run: interrupted; x\n"
    interrupts._since -= 60.0  # what hangs at the end can be left, without a second line
    with pytest.raises(SystemExit, match=r"^left: $"):
        interrupts._handle(signal.SIGINT, None)


def test_one_that_a_callback_swallows_is_given_again():
    script = (
        "import gc, sys, time\nfrom hil.interrupt import interrupts\ninterrupts.arm()\n"
        "class Swallows:\n    def __del__(self):\n"
        "        import signal\n        signal.raise_signal(signal.SIGINT)\n"
        "with interrupts.unwinding('fit'):\n"
        "    try:\n        Swallows()\n        time.sleep(90)\n"
        "    except KeyboardInterrupt:\n        print('unwound')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=15
    )
    assert done.stdout == "unwound\n" and done.stderr == ""


def test_one_that_comes_while_it_is_given_again_is_not_lost(monkeypatch):
    interrupts, given = Interrupts(), []

    def again() -> None:
        given.append(len(given))
        if len(given) == 1:  # one arrives within the hook
            interrupts._handle(signal.SIGINT, sys._getframe())

    monkeypatch.setattr(interrupts, "_give_again", again)
    with interrupts.unwinding("fit"):
        interrupts._unraisable(SimpleNamespace(exc_type=KeyboardInterrupt))
        assert given == [0, 1]
        with pytest.raises(KeyboardInterrupt):  # and the next one unwinds
            interrupts._handle(signal.SIGINT, None)


def test_processes_of_a_pool_do_not_see_it():
    with held_back():
        resource_tracker.ensure_running()  # as a pool does first; it unblocks SIGINT
    with held_back():
        child = subprocess.Popen(
            [sys.executable, "-c", "input(); print('alive')"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
    os.kill(child.pid, signal.SIGINT)
    assert child.communicate("\n", timeout=20)[0] == "alive\n"
    # and the caller sees it again
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_where_the_record_is_is_asked_for_after_closing():
    closed = []
    with pytest.raises(KeyboardInterrupt, match="it is here"), saying(lambda: closed[0]):
        try:
            raise KeyboardInterrupt
        finally:
            closed.append("it is here")


def test_where_the_record_is_is_said_where_a_library_made_its_own_error_of_it(monkeypatch):
    monkeypatch.setattr(interrupts, "seen", True)
    with pytest.raises(KeyboardInterrupt, match="it is here"), saying(lambda: "it is here"):
        raise SystemError("returned a result with an exception set")


def test_an_error_without_an_interruption_stays_what_it_is(monkeypatch):
    monkeypatch.setattr(interrupts, "seen", False)
    with pytest.raises(OSError, match="no space"), saying(lambda: "it is here"):
        raise OSError("no space left")


#: A bench that works in a pool of processes and draws a bar, interrupted by the whole terminal.
POOL = """
import os, signal, sys, threading, time
from hil.interrupt import interrupts
interrupts.arm()
from tqdm import tqdm
from hil.experiments.parallel_runs import Where, spread
if __name__ == "__main__":
    os.setpgrp()
    bar = tqdm(total=1, file=open(os.devnull, "w"))
    threading.Timer(3.0, os.killpg, (os.getpgrp(), signal.SIGINT)).start()
    try:
        with interrupts.unwinding("bench"):
            for _ in spread(time.sleep, [100.0] * 4, Where(2)):
                pass
    except KeyboardInterrupt:
        sys.stderr.write(interrupts.line())
        interrupts.end()
"""


def test_a_pool_of_processes_ends_with_one_line(tmp_path):
    (tmp_path / "pool.py").write_text(POOL)
    words = [sys.executable, str(tmp_path / "pool.py")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=90)
    assert done.returncode == 130
    assert done.stderr == "hil bench: interrupted\n"


def test_the_end_by_a_signal_is_told_in_one_line_with_its_code(monkeypatch, capsys):
    def ended(args):
        with saying(lambda: "the record is in s.mcap"):
            raise Ended(signal.SIGTERM)

    monkeypatch.setattr("hil.commands.list.run", ended)
    assert main(["list", "."]) == 128 + signal.SIGTERM
    assert capsys.readouterr().err == "hil list: ended by SIGTERM; the record is in s.mcap\n"
