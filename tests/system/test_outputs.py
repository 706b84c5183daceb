"""Outputs: nothing that is not made again is written over, and trouble is told before the work."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import plants
import pytest

from hil.cli import main
from hil.record.export import write_recordings
from hil.record.mcap_read import load, read_metadata, summary
from hil.record.mcap_write import SessionWriter
from hil.record.recovery import SessionFile
from hil.userfile import open_regular, write_text

RIG = Path(__file__).parents[2] / "rigs" / "teleop.toml"
BASE = 'schema = "hil.model/1"\n[robot]\npreset = "single-axis"\n[[effects]]\ntype = "viscous"\n'


def two_tones(seconds=6.0):
    return plants.two_tone_axis(seconds, (0.3, 0.2), (3.0, 7.3), 1.0, 0.3)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A session, a table and a model, and the working directory there."""
    run = two_tones()
    t, q, tau = run.t, run.q[:, 0], run.tau[:, 0]
    write_recordings(tmp_path / "s.mcap", [replace(run, name="s")])
    rows = [f"{a!r},{b!r},{c!r}" for a, b, c in zip(*(x.tolist() for x in (t, q, tau)))]  # noqa: B905
    (tmp_path / "run.csv").write_text("\n".join(["t,q1,tau1", *rows]) + "\n")
    (tmp_path / "m.toml").write_text(BASE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(capsys, words, *says):
    before = {p: p.read_bytes() for p in Path().iterdir() if p.is_file()}
    assert main(words.split()) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and "Traceback" not in said.err
    assert {p: p.read_bytes() for p in Path().iterdir() if p.is_file()} == before
    for word in says:
        assert word in said.err


@pytest.mark.parametrize("how", ["symlink_to", "hardlink_to"])
@pytest.mark.parametrize(
    ("link", "to", "words"),
    [
        ("link.toml", "m.toml", "fit s.mcap --model m.toml -o link.toml"),
        ("link.toml", "m.toml", "improve s.mcap --model m.toml -o link.toml"),
        ("link.html", "s.mcap", "compare s.mcap --report link.html"),
        ("link.html", "s.mcap", "diagnose s.mcap --holdout link.html --report link.html"),
        ("link.mcap", "run.csv", "import run.csv -o link.mcap"),
        ("link.mcap", "map.toml", "import run.csv --map map.toml -o link.mcap"),
        ("link.mcap", "s.mcap", "info s.mcap --recover link.mcap"),
    ],
)
def test_an_input_is_no_output_not_even_by_another_name(folder, capsys, link, to, words, how):
    Path("map.toml").write_text('[columns]\nq1 = "q1"\n')
    getattr(Path(link), how)(to)
    refused(capsys, words, link, "exists" if "--recover" in words else "same file")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("rig.toml", "fit s.mcap -o rig.toml"),
        ("page.html", "diagnose s.mcap --report page.html"),
    ],
)
def test_a_file_of_another_kind_stays(folder, capsys, name, words):
    Path(name).write_text('schema = "hil.rig/1"\n')
    refused(capsys, words, name, "is not a")


@pytest.mark.slow
def test_a_model_and_a_report_are_made_again(folder, capsys):
    words = ["improve", "s.mcap", "-o", "new.toml", "--report", "r.html"]
    assert main(words) == 0 and main(words) == 0


def test_a_urdf_beside_the_model_stays(folder, capsys):
    run = two_tones(3.0)
    t, q, tau = run.t, run.q[:, 0], run.tau[:, 0]
    Path("arm.urdf").write_text(plants.ONE_JOINT)
    rows = [f"{a!r},{b!r},{c!r}" for a, b, c in zip(*(x.tolist() for x in (t, q, tau)))]  # noqa: B905
    Path("u.csv").write_text("\n".join(["t,q1,tau1", *rows]) + "\n")
    assert main(["import", "u.csv", "--robot", "arm.urdf", "-o", "u.mcap"]) == 0
    Path("other.urdf").write_text("<robot/>")
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.diagnosis.verbs.fit", lambda *_: pytest.fail("worked in vain"))
        assert main(["fit", "u.mcap", "-o", "other.toml"]) == 2
    assert "other.urdf" in capsys.readouterr().err and Path("other.urdf").read_text() == "<robot/>"


@pytest.mark.parametrize("place", ["/proc/x", "none/x", "folder"])
@pytest.mark.parametrize(
    ("words", "ending"),
    [
        ("diagnose s.mcap --report", ".html"),
        ("fit s.mcap -o", ".toml"),
        ("import run.csv -o", ".mcap"),
        ("info s.mcap --recover", ".mcap"),
        (f"run {RIG} --seconds 0.05 -o", ".mcap"),
    ],
)
def test_a_place_where_nothing_can_be_written(folder, capsys, monkeypatch, words, ending, place):
    Path(f"folder{ending}").mkdir()
    monkeypatch.setattr(
        "hil.commands.common.load_sources", lambda *_: pytest.fail("worked in vain")
    )
    refused(capsys, f"{words} {place}{ending}", f"{place}{ending}")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize(
    ("words", "name"), [("fit s.mcap -o", "full.toml"), ("compare s.mcap --report", "full.html")]
)
def test_a_full_disk_is_one_sentence(folder, capsys, words, name):
    Path(name).symlink_to("/dev/full")
    assert main([*words.split(), name]) == 2
    said = capsys.readouterr().err
    assert name in said and os.strerror(errno.ENOSPC) in said and "Traceback" not in said


def taken(place, data):
    """A disk that takes a hundred bytes of every file."""
    with place.open("wb") as file:
        file.write(data[:100])
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    "words",
    [
        "fit s.mcap -o m.toml",
        "compare s.mcap --model m.toml --report r.html",
        "info s.mcap --recover r.mcap",
        "import run.csv --propose-map map.toml",
        "import run.csv -o t.mcap",
        "init teleop",
    ],
)
def test_a_full_disk_leaves_no_stub_and_takes_no_file_away(folder, capsys, monkeypatch, words):
    before = {p: p.read_bytes() for p in folder.iterdir()}
    monkeypatch.setattr(Path, "write_bytes", taken)
    monkeypatch.setattr(SessionFile, "flush", lambda self: taken(self._path, self._waiting))
    assert main(words.split()) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert {p: p.read_bytes() for p in folder.iterdir()} == before


def test_a_text_file_keeps_its_mode_and_its_links_and_a_pipe_is_written_to(tmp_path):
    place, link = tmp_path / "a.toml", tmp_path / "b.toml"
    place.write_text("old")
    place.chmod(0o640)
    link.symlink_to(place)
    write_text(link, "new")
    assert link.is_symlink() and place.read_text() == "new"
    assert place.stat().st_mode & 0o777 == 0o640
    write_text("/dev/null", "x")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.toml", "b.toml"]


def test_a_name_with_a_zero_byte_is_no_files():
    with pytest.raises(OSError, match="zero byte"):
        open_regular("a\0b", 9)


def test_a_full_disk_during_a_session_tells_what_is_kept(folder, capsys, monkeypatch):
    flush, calls = SessionWriter.flush, []

    def full(self):
        calls.append(1)
        if len(calls) > 30:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(self)

    monkeypatch.setattr(SessionWriter, "flush", full)
    monkeypatch.setattr(SessionWriter, "close", lambda self: self._file.close())
    assert main(["run", str(RIG), "--seconds", "2", "--clock", "lockstep", "-o", "r.mcap"]) == 2
    said = capsys.readouterr().err
    assert "r.mcap" in said and "are kept" in said and "--recover" in said
    assert summary("r.mcap").truncated and load("r.mcap", "leader").n > 100


def test_import_keeps_what_it_did_not_make(folder, capsys):
    old = Path("s.mcap").read_bytes()
    assert main(["import", "run.csv", "-o", "s.mcap"]) == 0
    assert "kept as s.1.mcap" in capsys.readouterr().err
    assert Path("s.1.mcap").read_bytes() == old
    assert main(["import", "run.csv", "-o", "s.mcap"]) == 0  # its own: made again
    assert not Path("s.2.mcap").exists() and "kept as" not in capsys.readouterr().err
    Path("other.csv").write_text(Path("run.csv").read_text())
    assert main(["import", "other.csv", "-o", "s.mcap"]) == 0
    assert Path("s.2.mcap").exists()
    assert read_metadata("s.mcap")["import"]["table"] == "other.csv"


def test_import_again_when_the_model_is_gone_but_its_urdf_is_left(folder, capsys):
    other = plants.ONE_JOINT.replace('effort="9"', 'effort="7"')
    for name, text in (("arm.urdf", plants.ONE_JOINT), ("other.urdf", other)):
        (folder / name).write_text(text)
    words = ["import", "run.csv", "-o", "r.mcap", "--robot", "arm.urdf"]
    assert main(words) == 0
    model = (folder / "r.model.toml").read_text()
    (folder / "r.model.toml").unlink()
    assert main(words) == 0  # the same robot: the model is made again
    assert (folder / "r.model.toml").read_text() == model
    assert "hil diagnose r.mcap --model r.model.toml" in capsys.readouterr().out
    assert main([*words[:-1], "other.urdf"]) == 0
    said = capsys.readouterr().out  # no advice to diagnose it with the model of the other robot
    assert "of another robot than this session" in said and "hil diagnose r.mcap\n" in said
    assert (folder / "r.model.toml").read_text() == model
    (folder / "r.model.toml").unlink()
    refused(capsys, "import run.csv -o r.mcap --robot other.urdf", "r.model.urdf", "move that file")


def test_import_of_a_hopeless_table_says_so_last(folder, capsys):
    Path("short.csv").write_text("\n".join(Path("run.csv").read_text().split("\n")[:6]) + "\n")
    assert main(["import", "short.csv", "-o", "short.mcap"]) == 0
    out = capsys.readouterr().out
    assert "hil diagnose" not in out and "too-short" in out
    assert "cannot be fitted" in out.strip().splitlines()[-1]
    assert "1 joint (" in out


@pytest.mark.parametrize("words", ["diagnose", "improve -o b.toml", "compare", "fit"])
def test_bad_data_is_exit_2_and_leaves_no_model(folder, capsys, words):
    Path("short.csv").write_text("\n".join(Path("run.csv").read_text().split("\n")[:6]) + "\n")
    assert main(["import", "short.csv", "-o", "short.mcap"]) == 0
    name, *rest = words.split()
    capsys.readouterr()
    assert main([name, "short.mcap", *rest]) == 2
    said = capsys.readouterr()
    assert "5 samples" in said.out + said.err and not Path("b.toml").exists()
    if name != "fit":
        assert main([name, "s.mcap", *rest, "--holdout", "short.mcap"]) == 2


def test_demo_keeps_what_is_not_a_demo(folder, capsys):
    Path("demo").mkdir()
    Path("demo/improved.toml").write_text("[mine]\n")
    assert main(["demo", "-o", "demo"]) == 2
    assert "improved.toml" in capsys.readouterr().err
    assert main(["demo", "-o", "m.toml"]) == 2 and "folder" in capsys.readouterr().err
