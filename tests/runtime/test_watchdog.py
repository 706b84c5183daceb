"""A watchdog that is watched: isolated, proven before power, latched after a cut."""

import errno
import json
import mmap
import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hil import trusted_code
from hil.cli import main
from hil.commands.selftest import selftest
from hil.errors import ConfigError, DeviceError
from hil.record.container import read
from hil.record.recovery import recover
from hil.record.schema import decode_numbers
from hil.rig import cut
from hil.rig.config import SafetyConfig, load_rig
from hil.rig.safety import BITS, FAULTING
from hil.rigs import rig_path
from hil.runtime import guard, runner, watchdog
from hil.runtime.clock import VirtualClock
from hil.runtime.guard import guarded_session
from hil.runtime.watchdog import report_path, tripped
from hil.signals.frame import FrameLayout


def until(what, seconds=20.0):
    end = time.monotonic() + seconds
    while not what() and time.monotonic() < end:
        os.sched_yield()
    assert what()


@pytest.fixture
def state(tmp_path, monkeypatch):
    """Nothing is agreed to, nothing latched."""
    monkeypatch.setenv("HIL_STATE", str(tmp_path / "state"))
    return tmp_path / "state"


@pytest.fixture
def safe(tmp_path, state, agreed):
    """Cut by a mark on the disk, agreed to."""
    words = ("touch", str(tmp_path / "mark"))
    agreed(words)
    return SafetyConfig(watchdog=0.5, cut=words)


@pytest.fixture
def rig_file(tmp_path, safe):
    text = rig_path("teleop").read_text()
    words = json.dumps(list(safe.cut))
    (tmp_path / "rig.toml").write_text(f"{text}\n[safety]\nwatchdog = 1.0\ncut = {words}\n")
    return str(tmp_path / "rig.toml")


@pytest.mark.real_time
def test_files_in_the_working_directory_do_not_take_its_place(tmp_path, safe, monkeypatch):
    for name in ("json", "mmap", "subprocess", "sitecustomize", "hil"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit(0)")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with guarded_session(safe, tmp_path / "s.mcap") as dog:
        assert dog.alive and dog.beat(1) == 0


def test_no_rig_is_opened_without_an_answer(tmp_path, safe, monkeypatch):
    opened = []
    monkeypatch.setattr(guard, "ISOLATED", ("-c", "raise SystemExit(5)"))
    config = load_rig("teleop", {"safety": {"watchdog": 0.5, "cut": list(safe.cut)}})
    with pytest.raises(DeviceError, match=r"ended at once \(code 5\), so the rig must not be"):
        runner.run_session(
            config, 0.1, output=tmp_path / "s.mcap", opener=lambda *a: opened.append(a)
        )
    assert not opened and not (tmp_path / "s.mcap").exists()


def test_an_answer_is_to_a_number_that_is_new_each_time(tmp_path, safe, monkeypatch):
    # a process that is there and writes no answer
    monkeypatch.setattr(guard, "ISOLATED", ("-c", "import time; time.sleep(60)"))
    monkeypatch.setattr(guard, "ANSWERS", 0.2)
    monkeypatch.setattr(guard, "ENDS", 0.1)
    with pytest.raises(DeviceError, match="the watchdog does not answer"):
        with guarded_session(safe, tmp_path / "s.mcap"):
            pass


@pytest.mark.real_time
def test_a_watchdog_ends_when_the_session_does_whatever_it_is_sent(tmp_path, safe, capfd):
    with guarded_session(safe, tmp_path / "s.mcap") as dog:
        for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
            os.kill(dog.pid, number)
        time.sleep(0.15)
        assert dog.alive and dog.beat(1) == 0
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.real_time
def test_a_watchdog_that_is_gone_is_a_fault(tmp_path, safe, number):
    with guarded_session(safe, tmp_path / "s.mcap") as dog:
        assert dog.beat(1) == 0
        os.kill(dog.pid, number)
        until(lambda: dog.beat(2))
        assert dog.beat(3) == BITS["watchdog-lost"] and BITS["watchdog-lost"] & FAULTING


class Late(VirtualClock):
    """The loop holds still at tick 50, until something has happened."""

    held = None

    def wait(self, tick):
        if tick == 50:
            until(Late.held)
        return super().wait(tick)


@pytest.mark.real_time
def test_a_cut_is_a_fault_in_record_and_info_and_latched(tmp_path, rig_file, safe, capsys):
    path = tmp_path / "s.mcap"
    mark, Late.held = tmp_path / "mark", report_path(path).exists
    config, said = load_rig(rig_file), []
    # what an operator might try then
    tries = runner.Operator([(0.05, "resume"), (0.05, "start"), (0.05, "home")], said.append)
    with pytest.raises(DeviceError, match=r"tick 50: FAULT, because the watchdog cut the power \("):
        runner.run_session(config, 1.0, 1, "lockstep", path, timer=Late, operator=tries)
    assert mark.exists()
    box = read(path)
    sent = decode_numbers(box.topics["/rig/raw"]).reshape(-1, 2, FrameLayout(1, 0).words)[:, :, 3:6]
    assert len(sent) == 70 and sent[:49].any() and not sent[49:].any()
    assert any("resume: FAULT, as before" in s for s in said)
    assert any(s.startswith("start: ") and "is FAULT and cannot ENABLE" in s for s in said)
    events = [json.loads(d) for d in box.topics["/events"].data]
    assert [e["name"] for e in events][-2:] == ["power-cut", "fault"]
    found = json.loads(box.metadata["watchdog"]["report"])
    assert found["why"] == "the loop does not tick" and found["worked"] is True
    assert found["last_tick"] == 49 and found["silent_s"] > 0.5
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr().out
    assert "after tick 49, because the loop does not tick: touch returned 0" in said
    assert "STILL BE ON" not in said
    assert said.count("FAULT at ") == 1
    assert "FAULT at 0.0500 s (tick 50): the watchdog cut the power\n" in said
    assert main(["info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sessions"][0]["watchdog"] == found
    # latched, whatever the session is called, until the operator asks for a new watchdog
    again = ["run", rig_file, "--seconds", "0.05", "-o", str(tmp_path / "t.mcap")]
    assert main(again) == 3
    assert "was cut and stays off" in capsys.readouterr().err
    assert not (tmp_path / "t.mcap").exists()
    assert main(["devices", rig_file]) == 3
    assert "--rearm" in capsys.readouterr().out
    assert main([*again, "--rearm"]) == 0
    assert main([*again[:-1], str(tmp_path / "u.mcap")]) == 0


def test_a_killed_session_tells_of_its_cut_also_where_it_is_recovered(tmp_path, capsys, safe):
    path, new = tmp_path / "s.mcap", tmp_path / "new.mcap"
    runner.run_session(load_rig("identify"), 0.3, output=path)
    path.write_bytes(path.read_bytes()[:-2000])
    watchdog.write_report(
        report_path(path), {"why": "it is gone", "last_tick": 7, "cut": "x returned 1"}
    )
    assert main(["info", str(path), "--recover", str(new)]) == 0
    assert main(["info", str(new)]) == 0
    said = capsys.readouterr().out
    assert "because it is gone: x returned 1; THE POWER MAY STILL BE ON" in said


def test_a_recovered_session_keeps_the_cut_wherever_it_is_moved(tmp_path, capsys, safe):
    path, new = tmp_path / "s.mcap", tmp_path / "new.mcap"
    runner.run_session(load_rig("identify"), 0.3, output=path)
    watchdog.write_report(
        report_path(path), {"why": "it is gone", "last_tick": 7, "cut": "x returned 0"}
    )
    assert main(["info", str(path), "--recover", str(new)]) == 0
    (tmp_path / "far").mkdir()
    moved = new.rename(tmp_path / "far" / "moved.mcap")
    capsys.readouterr()
    assert main(["info", str(moved)]) == 0
    assert "because it is gone: x returned 0" in capsys.readouterr().out


def test_a_later_part_of_a_session_tells_of_its_cut(tmp_path, capsys, safe):
    first, part = tmp_path / "s.mcap", tmp_path / "s.part2.mcap"
    runner.run_session(load_rig("identify"), 0.3, output=first)
    told = {"first": "s.mcap", "number": "2", "before": "s.mcap", "why": "its size"}
    recover(first, part, {"part": told})
    watchdog.write_report(
        report_path(first), {"why": "it is gone", "last_tick": 7, "cut": "x returned 0"}
    )
    assert main(["info", str(part)]) == 0
    assert "because it is gone: x returned 0" in capsys.readouterr().out


def test_the_latch_stays_where_the_new_watchdog_does_not_answer(tmp_path, safe, monkeypatch):
    latch = guard.latch_of(cut.proven(safe))
    latch.parent.mkdir(parents=True)
    watchdog.write_report(latch, {"why": "x", "cut": "y", "time_s": 1.7e9})
    with monkeypatch.context() as patch:
        patch.setattr(guard, "ISOLATED", ("-c", "raise SystemExit(5)"))
        with pytest.raises(DeviceError, match="ended at once"):
            with guarded_session(safe, tmp_path / "s.mcap", rearm=True):
                pass
    with pytest.raises(DeviceError, match="2023-11-14 22:13:20 UTC: the watchdog cut the power"):
        with guarded_session(safe, tmp_path / "s.mcap"):
            pass
    with guarded_session(safe, tmp_path / "s.mcap", rearm=True) as dog:
        assert dog.alive
    assert not latch.exists()


def test_a_cut_that_fails_is_tried_again_and_said(tmp_path):
    script = tmp_path / "cut.sh"
    script.write_text(f"#!/bin/sh\necho >> {tmp_path}/tries\n[ $(wc -l < {tmp_path}/tries) = 3 ]\n")
    script.chmod(0o755)
    assert watchdog.run_cut_program([str(script)]) == (True, "cut.sh returned 0")
    assert watchdog.run_cut_program([str(script)]) == (False, "cut.sh returned 1")
    script.unlink()
    worked, said = watchdog.run_cut_program([str(script)])
    assert not worked and "cut.sh failed: [Errno 2]" in said
    assert not watchdog.run_cut_program([str(script), "\0"])[0]
    assert "THE POWER MAY STILL BE ON" in watchdog.report_in_words({"cut": said, "why": "x"})


def test_a_program_that_prints_into_a_closed_pipe_cuts_all_the_same(tmp_path):
    script = tmp_path / "cut.sh"
    executable(script, f"#!/bin/sh\necho off && echo off >&2 && touch {tmp_path}/mark\n".encode())
    told = {"parent": -1, "timeout": 1.0, "cut": [str(script)]}
    told |= {"latch": str(tmp_path / "l"), "report": str(tmp_path / "r")}
    ours, theirs = os.pipe()
    os.close(ours)
    with (tmp_path / "page").open("w+b") as page:
        page.truncate(mmap.PAGESIZE)
        words = [sys.executable, *guard.ISOLATED, watchdog.__file__]
        words += [str(page.fileno()), json.dumps(told)]
        subprocess.run(words, stdout=theirs, stderr=theirs, pass_fds=[page.fileno()])
    os.close(theirs)
    assert (tmp_path / "mark").exists() and tripped(tmp_path / "r")["worked"] is True


def test_a_full_disk_does_not_stop_the_cut(tmp_path, capsys):
    page = np.zeros(8, np.int64)
    told = {"cut": ["/bin/touch", str(tmp_path / "mark")]}
    told |= {"latch": str(tmp_path / "no" / "l"), "report": str(tmp_path / "no" / "r")}
    watchdog.cut_power(memoryview(page), told, "the loop does not tick")
    assert (tmp_path / "mark").exists() and page[watchdog.CUTS] == 1
    assert capsys.readouterr().err.count("cannot be written") == 3


def spellings(folder):
    """Commands that run one script."""
    script = executable(folder / "cut.sh", b"#!/bin/sh\nexit 0\n")
    (folder / "inner").mkdir()
    (folder / "link").symlink_to(script)
    others = (f"{folder}/inner/../cut.sh", f"{folder}/link", f"{folder}//./cut.sh", "./cut.sh")
    yield from ((other, "x") for other in (script, *others))


def test_a_latch_holds_for_every_spelling_of_a_path(tmp_path, state, monkeypatch):
    monkeypatch.chdir(tmp_path)
    all_words = list(spellings(tmp_path))
    latch = guard.latch_of(cut.proven(SafetyConfig(watchdog=1.0, cut=all_words[0])))
    latch.parent.mkdir(parents=True)
    watchdog.write_report(latch, {"why": "x", "cut": "y"})
    for words in all_words:
        assert guard.latched(cut.proven(SafetyConfig(watchdog=1.0, cut=words))), words
    other = cut.proven(SafetyConfig(watchdog=1.0, cut=(*all_words[0][:1], "y")))
    assert not guard.latched(other)
    # a script that an interpreter is given
    names = {guard.latch_of(("/bin/sh", words[0])) for words in all_words}
    assert len(names) == 1 and guard.latch_of(("/bin/sh", "cut.sh")) in names
    # a file that is there by chance
    (tmp_path / "OUT=0").write_text("")
    assert guard.latch_of(("/bin/true", "OUT=0")) == guard.latch_of(("/bin/true", "OUT=0"))
    before = guard.latch_of(("/bin/true", "OUT=0"))
    monkeypatch.chdir("/")
    assert guard.latch_of(("/bin/true", "OUT=0")) == before


def test_an_empty_latch_is_one(safe):
    words = cut.proven(safe)
    guard.latch_of(words).parent.mkdir(parents=True)
    guard.latch_of(words).write_text("")
    assert "is empty" in guard.latched(words)


@pytest.mark.real_time
def test_a_disk_that_fills_up_does_not_lose_the_latch(tmp_path, safe):
    path, words = tmp_path / "s.mcap", cut.proven(safe)
    with guarded_session(safe, path) as dog:
        # writes fail, as on a full disk; a new name takes no room
        guard.latch_of(words).with_name(guard.latch_of(words).name + ".new").mkdir()
        report_path(path).with_name(report_path(path).name + ".new").mkdir()
        assert dog.beat(1) == 0
        until(lambda: not dog.alive)
        told = dog.trip()
    assert (tmp_path / "mark").exists() and "no room" in told["why"]
    with pytest.raises(DeviceError, match=r"has begun; THE POWER MAY STILL BE ON\. Find out why"):
        with guarded_session(safe, path):
            pass
    assert len(list(guard.latch_of(words).parent.glob("*.reserve"))) == 0


def test_no_session_starts_without_room_for_its_latch(tmp_path, safe, monkeypatch):
    def full(path, report):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(watchdog, "write_report", full)
        with pytest.raises(ConfigError, match=r"latch cannot be prepared: .*reserve: No space"):
            with guarded_session(safe, tmp_path / "s.mcap"):
                pass
    with guarded_session(safe, tmp_path / "s.mcap") as dog:
        assert dog.alive
    assert not list(guard.latch_of(cut.proven(safe)).parent.iterdir())


@pytest.mark.parametrize(
    "text", ["", "null", "[1]", "{", '{"silent_s": "x"}', "\xff", '{"a": 1}', "[" * 10**5]
)
def test_any_report_is_read(tmp_path, text):
    (tmp_path / "r.json").write_bytes(text.encode("latin-1"))
    assert "STILL BE ON" in watchdog.report_in_words(tripped(tmp_path / "r.json"))


def executable(path, text):
    path.write_bytes(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def bad_programs(folder):
    plain = folder / "plain"
    plain.write_text("x")
    yield ["/nonexistent"], "does not exist"
    yield ["no-such-program-of-anybody"], "not found in any folder of PATH"
    yield [str(folder)], "is a folder"
    yield [str(plain)], "chmod"
    yield [executable(folder / "text", b"rm -rf x\n")], "neither a program nor a script"
    yield [executable(folder / "a", b"#!/no/interpreter -x\n")], "script for /no/interpreter"
    yield [executable(folder / "b", b"#!/usr/bin/env -S no-such-thing\n")], "script for no-such"
    yield [executable(folder / "c", b"#!\n")], "script for nothing"
    yield [executable(folder / "d", b"")], "neither"
    yield [executable(folder / "e", b"#!/bin/sh\r\ntrue\r\n")], "first line ends in CR LF"
    yield [executable(folder / "f", b"#!sh\n")], "looked for in the working directory"
    whole = Path(shutil.which("true")).read_bytes()
    yield [executable(folder / "g", b"\x7fELFgarbage")], "damaged program (its header is not whole"
    yield [executable(folder / "h", b"\x7fELF" + b"x" * 200)], "damaged program (its header"
    yield [executable(folder / "i", whole[: len(whole) // 2])], "damaged program (it is cut off)"
    yield [executable(folder / "j", whole[:64] + bytes(len(whole)))], "damaged program (nothing"
    yield ["/bin/sh", "/nonexistent"], "the script '/nonexistent', which does not exist"
    yield ["/usr/bin/env", "A=1", "no-such-thing"], "no-such-thing, which is not found"
    os.mkfifo(folder / "pipe", 0o700)
    yield [str(folder / "pipe")], "cannot be read (it is a device or a pipe"
    yield ["touch", "a\0b"], r"'a\x00b' holds a zero byte"
    yield ["touch", "x" * 2**15], "its words have 32773 bytes, at most 16384"
    yield [""], "has no program to run"
    yield [], "has no program to run"


def test_a_cut_program_that_cannot_run_is_refused_before_anything(tmp_path, rig_file, capsys):
    text = rig_path("teleop").read_text()
    for words, why in bad_programs(tmp_path):
        with open(rig_file, "w") as file:
            file.write(f"{text}\n[safety]\nwatchdog = 1.0\ncut = {json.dumps(words)}\n")
        assert main(["run", rig_file, "--seconds", "0.01", "-o", str(tmp_path / "s.mcap")]) == 2
        assert why in capsys.readouterr().err
        assert not (tmp_path / "s.mcap").exists()
    assert main(["devices", rig_file]) == 3
    found = capsys.readouterr().out
    assert "watchdog" in found.splitlines()[-1] and "has no program" in found


@pytest.mark.parametrize("seconds", [1e-3, 60.0, float("nan"), float("inf")])
def test_times_that_no_watchdog_can_keep_are_refused(seconds):
    with pytest.raises(ConfigError, match=r"0\.02 to 10 s is needed"):
        cut.proven(SafetyConfig(watchdog=seconds, cut=("touch", "x")))


@pytest.mark.real_time
def test_a_session_that_is_kept_aside_keeps_what_the_watchdog_did(tmp_path, rig_file, capsys):
    path = tmp_path / "s.mcap"
    runner.run_session(load_rig("identify"), 0.1, output=path)
    watchdog.write_report(
        report_path(path), {"why": "it is gone", "cut": "x returned 0", "worked": True}
    )
    assert main(["run", rig_file, "--seconds", "0.05", "-o", str(path)]) == 0
    capsys.readouterr()
    assert main(["info", str(path), str(tmp_path / "s.1.mcap")]) == 0
    said = capsys.readouterr().out
    assert said.count("because it is gone") == 1
    assert said.index("s.1.mcap") < said.index("because it is gone")


def test_a_folder_that_cannot_be_written_is_said(tmp_path, rig_file, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HIL_STATE", str(tmp_path / "file"))
    assert main(["trust", rig_file]) == 2
    assert "give HIL_STATE = FOLDER" in capsys.readouterr().err


def test_programs_and_scripts_are_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    executable(tmp_path / "ok", b"#!/usr/bin/env sh\n")
    for name in ("touch", "./ok", str(tmp_path / "ok")):
        words = cut.proven(SafetyConfig(watchdog=1.0, cut=(name, "x")))
        assert os.path.isabs(words[0]) and words[1:] == ("x",)
    for words in (("env", "A=1", "sh", "ok"), ("sh", "-c", "no such"), ("bash", "-o", "x", "ok")):
        assert cut.proven(SafetyConfig(watchdog=1.0, cut=words))[1:] == words[1:]
    # a script as a word, longer than a name of a file may be
    assert trusted_code.cut_program(("/bin/sh", "-c", "true;" * 100)).digest
    assert cut.proven(SafetyConfig()) == ()
    with pytest.raises(ConfigError, match="is never run, because watchdog = 0"):
        cut.proven(SafetyConfig(cut=("touch", "x")))


@pytest.mark.real_time
def test_the_self_test_fires_the_cut(tmp_path, safe):
    over = {"safety": {"watchdog": 0.5, "cut": list(safe.cut)}}
    config = load_rig("identify", over)
    steps = list(selftest(config, 0.1, lambda: True))
    first, last = steps[0], steps[-1]
    assert (first.device, first.what, first.passed) == ("watchdog", "program", True)
    assert (last.device, last.what, last.passed) == ("watchdog", "cut", True)
    assert "touch returned 0" in last.text and (tmp_path / "mark").exists()
    # asked for: nothing is latched
    assert not guard.latched(cut.proven(safe))


def test_the_self_test_drives_no_motor_without_a_program(tmp_path, state):
    # not agreed to
    over = {"safety": {"watchdog": 0.5, "cut": ["touch", str(tmp_path / "mark")]}}
    steps = list(selftest(load_rig("identify", over), 0.1, lambda: pytest.fail("asked")))
    assert not steps[0].passed and "'hil trust RIG.toml'" in steps[0].text
    assert not [s for s in steps if s.what.startswith(("joint", "cut"))]
    assert not (tmp_path / "mark").exists()


@pytest.mark.real_time
def test_the_self_test_finds_a_cut_that_fails_and_latches_it(tmp_path, state, agreed):
    agreed(["false"])
    config = load_rig("identify", {"safety": {"watchdog": 0.2, "cut": ["false"]}})
    last = list(selftest(config, 0.1, lambda: True))[-1]
    assert not last.passed and "false returned 1; THE POWER MAY STILL BE ON" in last.text
    assert "false returned 1" in guard.latched(cut.proven(config.safety))


@pytest.mark.real_time
def test_motors_that_move_after_the_cut_are_found(tmp_path, safe, monkeypatch):
    over = {"safety": {"watchdog": 0.5, "cut": list(safe.cut)}}
    config = load_rig("identify", over)
    # as on hardware, where power can be cut: the simulated rig keeps its own
    monkeypatch.setattr(type(config), "hardware", property(lambda self: True))
    monkeypatch.setattr(type(config), "clock", "lockstep")
    steps = list(selftest(config, 0.1, lambda: True))
    wrong = [s for s in steps if not s.passed]
    assert [(s.device, s.what) for s in wrong] == [(a, "cut") for a in config.controller.arms]
    assert "the motors still have power" in wrong[0].text


@pytest.mark.real_time
def test_a_cut_runs_only_where_it_was_agreed_to(tmp_path, rig_file, safe, state, capsys):
    script = tmp_path / "cut.sh"
    executable(script, b"#!/bin/sh\ntouch ran\n")
    text = rig_path("teleop").read_text()
    with open(rig_file, "w") as file:
        file.write(f"{text}\n[safety]\nwatchdog = 1.0\ncut = {json.dumps([str(script)])}\n")
    words = ["run", rig_file, "--seconds", "0.05", "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    assert f"'hil trust {rig_file}' remembers" in capsys.readouterr().err
    assert main(["devices", rig_file]) == 3
    assert main(["info", rig_file]) == 0
    assert f"cut program {script} (NOT agreed to" in capsys.readouterr().out
    assert main(["trust", rig_file]) == 0
    assert main(words) == 0
    assert main(["devices", rig_file]) == 0
    # what is changed is asked for anew
    script.write_text("#!/bin/sh\nexit 0\n")
    assert main(words) == 2
    assert main(["trust", "--forget", rig_file]) == 0
    script.write_bytes(b"#!/bin/sh\ntouch ran\n")
    assert main(["trust", "--forget", rig_file, "--json"]) == 0
    capsys.readouterr()
    assert main(words) == 2
    assert main(["trust", "--show", rig_file, "--json"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["executables"][0]["agreed"] is False
    # what a session names is told, and nothing of it runs
    assert main(["info", str(tmp_path / "s.mcap")]) == 0
    assert f"rig.toml names cut program {script}" in capsys.readouterr().out
    assert not list(tmp_path.glob("**/ran"))


def test_what_counts_of_a_cut_program(tmp_path):
    script, log = tmp_path / "cut.py", tmp_path / "cut.log"
    script.write_text("print(1)")
    log.write_text("")
    words = ["/bin/sh", str(script), str(log)]
    before = trusted_code.cut_program(words)
    log.write_text("cut")
    assert trusted_code.cut_program(words) == before
    assert trusted_code.cut_program(words[:2]).digest != before.digest
    script.write_text("print(2)")
    assert trusted_code.cut_program(words).digest != before.digest
    # a script is one by whatever name an interpreter is given it
    plain = tmp_path / "off"
    for command in (["/bin/sh", "-x", str(plain)], ["/usr/bin/env", "A=1", "python3", str(plain)]):
        plain.write_text("1")
        before = trusted_code.cut_program(command).digest
        plain.write_text("2")
        assert trusted_code.cut_program(command).digest != before


def test_what_would_run_is_shown_on_one_line_word_by_word(tmp_path, state):
    shown = trusted_code.cut_program(
        ["/bin/sh", "-c", "x\ny.toml: runs nothing\u202e", "a b", ""]
    ).text
    assert shown == r"/bin/sh -c 'x\ny.toml: runs nothing\u202e' 'a b' ''"
    assert "\n" not in trusted_code.plugin(tmp_path / "a\nb.py", b"").text


def test_agreements_are_kept_in_the_users_folder(monkeypatch, tmp_path):
    monkeypatch.delenv(trusted_code.STATE_VARIABLE)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert trusted_code.folder() == tmp_path / "hil"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert trusted_code.folder() == tmp_path / ".local" / "state" / "hil"


#: Prints what was compiled or loaded between power and the end of a session.
_COMPILED = """
import gc, sys
from numba.core.dispatcher import Dispatcher
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner

def compiled():
    return {
        f"{d.py_func.__module__}.{d.py_func.__qualname__}": len(d.signatures)
        for d in gc.get_objects() if isinstance(d, Dispatcher)
    }

def enable(self, before=runner.Session._enable):
    self.found = compiled()
    sessions.append(self)
    before(self)

sessions, runner.Session._enable = [], enable
runner.run_session(load_rig(rig_path(sys.argv[2])), 0.1, 1, "lockstep", sys.argv[1])
found = sessions[0].found
assert found["hil.rig.safety.limit"]
print(*[name for name, n in compiled().items() if found.get(name) != n])
"""


@pytest.mark.parametrize("rig", ["teleop", pytest.param("surgical", marks=pytest.mark.slow)])
def test_nothing_is_compiled_once_there_is_power(tmp_path, rig):
    # after an installation this takes seconds, and the watchdog took them for the loop's end
    words = [sys.executable, "-c", _COMPILED, str(tmp_path / "s.mcap"), rig]
    ran = subprocess.run(words, capture_output=True, text=True)
    assert ran.returncode == 0 and ran.stdout.strip() == "", ran.stdout + ran.stderr
