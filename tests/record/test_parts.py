"""Sessions in several files, files that two want to write, and files that vanish."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.errors import ConfigError
from hil.record.mcap_read import load, read_attachments, read_metadata
from hil.record.mcap_write import SessionWriter
from hil.record.recovery import SessionFile, in_use
from hil.record.schema import Channel
from hil.rig.config import load_rig
from hil.runtime import runner
from hil.runtime.recorder import SessionParts

STATE = Channel("/arm/measured_js", "joint_state", ("a", "b"), ("position",))
EFFORT = Channel("/arm/setpoint_jf", "joint_state", ("a", "b"), ("effort",))
RUN = ["run", "teleop", "--clock", "lockstep", "--seconds"]
TOPICS = [(STATE.topic, slice(0, 2)), (EFFORT.topic, slice(2, 4))]


def opened(path, part):
    records = {"session": {"seed": "1"}, **({"part": part} if part else {})}
    return SessionWriter(path, [STATE, EFFORT], records, {"a.toml": b"x = 1"})


def rows(first, n=10):
    ticks = np.arange(first, first + n)
    stamps = np.column_stack([ticks + 1, ticks * 10**6])
    return stamps, np.column_stack([ticks * 1.0] * 4)


def fill(parts, ticks, at=None, do=None):
    for first in range(0, ticks, 10):
        if first == at:
            do()
        parts.write_rows(TOPICS, *rows(first))


def loaded(path):
    r = load(path)
    return (r.q[:, 0] + 0.0).tolist()


def test_a_session_goes_on_in_a_new_file_after_a_time(tmp_path):
    said = []
    parts = SessionParts(tmp_path / "s.mcap", opened, seconds=1.0, say=said.append)
    fill(parts, 2500)
    parts.close()
    assert [p.name for p in parts.paths] == ["s.mcap", "s.part2.mcap", "s.part3.mcap"]
    assert [q for p in parts.paths for q in loaded(p)] == list(range(2500))
    assert [len(loaded(p)) for p in parts.paths] == [1000, 1000, 500]
    told = [read_metadata(p)["part"] for p in parts.paths]
    assert told[0] == {"number": "1"}
    assert (told[2]["first"], told[2]["before"], told[2]["why"]) == (
        "s.mcap",
        "s.part2.mcap",
        "length",
    )
    assert all(read_attachments(p) == {"a.toml": b"x = 1"} for p in parts.paths)
    assert "s.part3.mcap" in said[-1]


def test_a_session_goes_on_in_a_new_file_after_a_size(tmp_path):
    parts = SessionParts(tmp_path / "s.mcap", opened, megabytes=0.03)
    fill(parts, 3000)
    parts.close()
    assert len(parts.paths) > 2
    # index and summary come on top
    assert all(p.stat().st_size < 80_000 for p in parts.paths)
    assert [q for p in parts.paths for q in loaded(p)] == list(range(3000))


def test_a_file_that_is_deleted_is_noticed_within_a_second(tmp_path):
    path, said = tmp_path / "s.mcap", []
    parts = SessionParts(path, opened, say=said.append)
    fill(parts, 3000, at=1000, do=path.unlink)
    parts.close()
    assert not path.exists()
    assert [p.name for p in parts.paths] == ["s.mcap", "s.part2.mcap"]
    kept = loaded(parts.paths[1])
    assert kept == list(range(int(kept[0]), 3000))
    assert 1000 <= kept[0] <= 2000
    assert said[0].endswith("s.mcap is not there any more, or was shortened")
    assert "removed" in read_metadata(parts.paths[1])["part"]["why"]


def test_a_file_that_is_renamed_keeps_what_it_has(tmp_path):
    path, other = tmp_path / "s.mcap", tmp_path / "kept.mcap"
    parts = SessionParts(path, opened)
    fill(parts, 3000, at=1000, do=lambda: path.rename(other))
    parts.close()
    assert loaded(other) + loaded(parts.paths[1]) == list(range(3000))


def test_a_run_whose_output_is_deleted_goes_on(tmp_path):
    path, said = tmp_path / "s.mcap", []
    ticks = iter([path])

    def progress(done):
        for p in ticks:
            p.unlink()

    operator = runner.Operator(say=said.append)
    found = runner.run_session(
        load_rig("teleop"), 1.5, 0, "lockstep", path, progress=progress, operator=operator
    )
    assert found.parts == [str(tmp_path / "s.part2.mcap")]
    assert load(found.parts[0], "leader").n > 900
    assert any("not there any more" in text for text in said)


def test_a_file_that_another_program_shortens_is_noticed(tmp_path):
    path = tmp_path / "s.mcap"
    parts = SessionParts(path, opened)
    fill(parts, 3000, at=1000, do=lambda: os.truncate(path, 0))
    parts.close()
    assert len(parts.paths) == 2
    kept = loaded(parts.paths[1])
    assert kept == list(range(int(kept[0]), 3000)) and kept[0] <= 2000


def test_a_file_that_is_deleted_at_the_end_is_told(tmp_path):
    path, said = tmp_path / "s.mcap", []
    parts = SessionParts(path, opened, say=said.append)
    fill(parts, 400, at=300, do=path.unlink)
    parts.close()
    assert said == [f"{path} is not there any more, or was shortened"]


def at_row(monkeypatch, ticks, do):
    """Do something once, when the rows from tick `ticks` on are to be written."""
    write, todo = SessionParts.write_rows, [do]

    def wrapped(self, topics, stamps, data):
        if len(stamps) and stamps[0, 0] >= ticks and todo:
            todo.pop()()
        return write(self, topics, stamps, data)

    monkeypatch.setattr(SessionParts, "write_rows", wrapped)


def test_a_folder_that_is_deleted_is_made_anew_within_a_second(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "f" / "g"
    folder.mkdir(parents=True)
    at_row(monkeypatch, 100, lambda: shutil.rmtree(tmp_path / "f"))
    assert main([*RUN, "1.2", "-o", str(folder / "s.mcap")]) == 0
    told = capsys.readouterr()
    assert f"the folder {folder} was made anew" in told.err and "s.part2.mcap" in told.out
    assert load(folder / "s.part2.mcap", "leader").n > 600


def test_a_working_directory_that_is_deleted_is_made_anew(tmp_path, monkeypatch):
    folder, said = tmp_path / "f", []
    folder.mkdir()
    monkeypatch.chdir(folder)
    parts = SessionParts(Path("s.mcap"), opened, say=said.append)
    fill(parts, 3000, at=1000, do=lambda: shutil.rmtree(folder))
    parts.close()
    kept = loaded(folder / "s.part2.mcap")
    assert kept == list(range(int(kept[0]), 3000)) and kept[0] <= 2000


def test_a_folder_that_cannot_be_made_anew_ends_the_record_and_not_the_run(
    tmp_path, monkeypatch, capsys
):
    folder = tmp_path / "f"
    folder.mkdir()

    def harm():
        shutil.rmtree(folder)
        folder.write_text("a file in its place")

    at_row(monkeypatch, 100, harm)
    assert main([*RUN, "1.2", "-o", str(folder / "s.mcap")]) == 2
    said = capsys.readouterr().err
    assert "not recorded any more" in said and "to its end" in said and "internal" not in said


def test_the_command_ends_well_where_its_output_was_deleted(tmp_path, monkeypatch, capsys):
    path = tmp_path / "s.mcap"
    at_row(monkeypatch, 100, path.unlink)
    assert main([*RUN, "1.2", "-o", str(path)]) == 0
    told = capsys.readouterr().out
    assert f"{path} (not there any more)" in told and "s.part2.mcap" in told


def test_a_second_writer_is_refused(tmp_path):
    path = tmp_path / "s.mcap"
    with opened(path, {}) as writer:
        writer.write(STATE.topic, 1, 0, [0.0, 0.0])
        assert in_use(path)
        with pytest.raises(ConfigError, match="another process is writing"):
            opened(path, {})
        words = [*RUN, "0.1", "-o", str(path)]
        done = subprocess.run(
            [sys.executable, "-m", "hil", *words], capture_output=True, text=True, check=False
        )
        assert done.returncode == 2
        assert "another process is writing" in done.stderr
    assert not in_use(path)
    assert [p.name for p in tmp_path.iterdir()] == ["s.mcap"]


def killed(path, ticks):
    program = f"""
import os, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import test_parts as t
parts = t.SessionParts(t.Path({str(path)!r}), t.opened)
t.fill(parts, {ticks})
os.kill(os.getpid(), 9)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -9


def test_what_is_killed_in_its_first_moments_is_on_record(tmp_path):
    killed(tmp_path / "a.mcap", 100)
    # all but the last drain of the ring
    assert len(loaded(tmp_path / "a.mcap")) >= 90
    killed(tmp_path / "b.mcap", 0)
    assert read_metadata(tmp_path / "b.mcap") == {"session": {"seed": "1"}}


def test_a_full_disk_leaves_no_stub(tmp_path, monkeypatch):
    path = tmp_path / "s.mcap"

    def full(self):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    flush = SessionFile.flush
    monkeypatch.setattr(SessionFile, "flush", full)
    with pytest.raises(ConfigError, match="No space left on device; no file is left"):
        opened(path, {})
    assert not path.exists()
    monkeypatch.setattr(SessionFile, "flush", flush)
    writer = opened(path, {})
    monkeypatch.setattr(SessionFile, "flush", full)
    writer.write(STATE.topic, 1, 0, [0.0, 0.0])
    with pytest.raises(OSError, match="No space"):
        writer.write(STATE.topic, 2, 10**7, [0.0, 0.0])
    writer.abandon()
    assert not path.exists()


def test_the_disk_takes_it_as_often_as_asked(tmp_path, monkeypatch):
    synced = []
    plain = os.fdatasync
    monkeypatch.setattr(os, "fdatasync", lambda fd: (synced.append(fd), plain(fd)))
    for sync, least in ((0.0, 0), (0.5, 4)):
        synced.clear()
        with SessionWriter(tmp_path / "s.mcap", [STATE, EFFORT], {}, sync=sync) as writer:
            for first in range(0, 2000, 10):
                writer.write_rows(TOPICS, *rows(first))
        assert least <= len(synced) <= 2 * least


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--split", "ten"], "a number and a unit"),
        (["--split", "5 kg"], "a number and a unit"),
        (["--split", "0.1 s"], "1 s and 1 MB at least"),
        (["--sync", "-1"], "sync = -1"),
        (["--sync", "nan"], "not a number"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, capsys, words, said):
    assert main([*RUN, "0.1", "-o", str(tmp_path / "s.mcap"), *words]) == 2
    assert said in capsys.readouterr().err


def test_the_parts_stand_in_the_closing_table(tmp_path, capsys):
    path = tmp_path / "s.mcap"
    assert main([*RUN, "2.5", "-o", str(path), "--split", "1 s"]) == 0
    told = capsys.readouterr().out
    assert "s.part2.mcap" in told and "s.part3.mcap" in told
    assert main(["info", str(tmp_path / "s.part2.mcap")]) == 0
    assert "part 2 of the session that begins in s.mcap" in capsys.readouterr().out
