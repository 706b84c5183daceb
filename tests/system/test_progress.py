"""What a long command shows of its progress, and that it can be quiet."""

from __future__ import annotations

import io
import threading

import plants
import pytest
from tqdm import tqdm

from hil import terminal
from hil.cli import COMMANDS, main
from hil.record.export import write_recordings
from hil.terminal import settings, working
from hil.work import at, listening


class Terminal(io.StringIO):
    """Stream that says that it is a terminal, and on which words can be waited for."""

    def __init__(self):
        super().__init__()
        self.drawn = threading.Condition()

    def isatty(self):
        return True

    def write(self, text):
        with self.drawn:
            count = super().write(text)
            self.drawn.notify_all()
        return count

    def wait_for(self, words):
        """A thread of its own draws the line."""
        with self.drawn:
            assert self.drawn.wait_for(lambda: words in self.getvalue(), 30.0), self.getvalue()


def shown(monkeypatch, stream, work, **more):
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setattr(terminal, "_SHORT", 0.0)
    monkeypatch.setattr(terminal, "_EVERY", 0.001)
    with working(**more):
        work()
    return stream.getvalue()


def stages():
    """Work that takes until it has been drawn."""
    at("seek effects", 0.25)
    stages.stream.wait_for("25 %")


def test_a_stage_its_share_and_the_time_left_are_shown(monkeypatch):
    stages.stream = Terminal()
    text = shown(monkeypatch, stages.stream, stages)
    assert "seek effects  25 %" in text
    assert "about" in text
    assert text.endswith("\r")  # nothing of it stays


@pytest.mark.parametrize(
    "say", [terminal.out, terminal.log, lambda text: terminal.emit({"said": text})]
)
def test_what_is_written_meanwhile_begins_a_line_of_its_own(monkeypatch, say):
    """The verdict had stood behind "about 00:00 left"."""

    def told():
        stages()
        say("Verdict: adequate")

    stages.stream = screen = Terminal()
    monkeypatch.setattr("sys.stdout", screen)
    text = shown(monkeypatch, screen, told)
    before, verdict, _ = text.partition("Verdict" if say in (terminal.out, terminal.log) else "{")
    assert verdict and before.endswith("\r") and before.split("\r")[-2].strip() == ""


def test_nothing_is_shown_in_a_pipe_when_quiet_or_where_a_command_is_short(monkeypatch):
    def work():
        at("seek effects", 0.25)

    assert shown(monkeypatch, io.StringIO(), work) == ""
    assert shown(monkeypatch, Terminal(), work, shown=False) == ""
    monkeypatch.setattr(settings, "quiet", True)
    assert shown(monkeypatch, Terminal(), work) == ""


def test_work_pays_nothing_where_nobody_listens_and_listeners_leave():
    heard = []
    at("before", 0.0)
    with listening(lambda what, done: heard.append((what, done))):
        at("within", 0.5)
    at("after", 1.0)
    assert heard == [("within", 0.5)]


def test_quiet_prints_the_answer_alone(tmp_path, capsys):
    path = tmp_path / "axes.mcap"
    write_recordings(str(path), [plants.tanh_axes()])
    assert main(["compare", str(path)]) == 0
    loud = capsys.readouterr()
    assert "base model" in loud.err
    assert main(["compare", str(path), "--quiet"]) == 0
    quiet = capsys.readouterr()
    assert quiet.err == ""
    assert quiet.out == loud.out
    assert main(["--quiet", "compare", "nowhere.mcap"]) == 2
    assert "nowhere.mcap" in capsys.readouterr().err


def test_that_kernels_are_compiled_is_said_while_it_lasts(monkeypatch):
    """A kernel that nothing has kept is compiled; a second call of it says nothing."""
    import numba

    monkeypatch.setattr(settings, "quiet", False)
    stream = Terminal()

    @numba.njit
    def kernel(x):
        return x + 1.0

    def work():
        at("fit", 0.25)
        stream.wait_for("fit")
        kernel(1.0)
        kernel(2)  # another type: again
        done = stream.getvalue()
        kernel(2.0)
        assert terminal.COMPILES in done

    shown(monkeypatch, stream, work)
    before = stream.getvalue()
    shown(monkeypatch, stream, lambda: kernel(3.0))
    assert terminal.COMPILES not in stream.getvalue()[len(before) :]


def test_a_session_says_that_it_compiles_until_its_first_tick(monkeypatch, tmp_path):
    """Kernels of a stranger's arm, compiled anew, are announced; ticks take that away again."""
    import numba

    from hil.commands import run as command
    from hil.rig.config import load_rig
    from hil.runtime import runner

    heard, stream = [], Terminal()
    monkeypatch.setattr("sys.stderr", stream)

    def started(config, seconds, seed, clock, output, progress, *more, **rest):
        @numba.njit
        def kernel(x):
            return x * 2.0

        kernel(1.0)
        heard.append(stream.getvalue())
        progress(5)
        heard.append(stream.getvalue())

    monkeypatch.setattr(runner, "run_session", started)
    words = ["run", "teleop", "-o", str(tmp_path / "s.mcap"), "--clock", "lockstep"]
    args = _arguments(words)
    command._with_bar(load_rig("teleop", {}), args)
    assert terminal.COMPILES in heard[0]
    assert terminal.COMPILES not in heard[1].rpartition("\r")[2]


def _arguments(words):
    from hil import cli

    return cli.build_parser(words[0]).parse_args(words)


@pytest.mark.parametrize("words", [["info"], ["import", "--dry-run"]])
def test_reading_of_a_large_file_says_what_it_reads(tmp_path, capsys, words):
    """Ten seconds without a word, on a bag of some minutes."""
    path, heard = tmp_path / "log.csv", []
    path.write_text("t,q1,tau1\n" + "".join(f"{k / 100},{k % 7},{k % 5}\n" for k in range(300)))
    with listening(lambda what, done: heard.append(what)):
        main([words[0], str(path), *words[1:]])
    assert "read log.csv" in heard and COMMANDS[words[0]].long
    capsys.readouterr()


def test_the_line_of_progress_is_not_drawn_into_what_is_written(monkeypatch):
    """A thread of its own draws it: who writes holds the lock that it needs."""
    free = []

    def draw():
        lock = tqdm.get_lock().th_lock
        free.append(lock.acquire(blocking=False))
        if free[-1]:
            lock.release()

    class Watched(Terminal):
        """Asks, while an answer is written, whether another thread could draw."""

        def write(self, text):
            if "answer" in text:
                other = threading.Thread(target=draw)
                other.start()
                other.join()
            return super().write(text)

    stages.stream = screen = Watched()
    monkeypatch.setattr("sys.stdout", screen)

    def told():
        stages()
        terminal.out("answer")

    assert "answer\n" in shown(monkeypatch, screen, told)
    assert free == [False]
