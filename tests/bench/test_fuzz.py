"""The fuzzer finds what it is for, and every parser stands a short turn of it."""

import os
import random
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from hil.bench import fuzz
from hil.cli import main
from hil.commands.fuzz_targets import TARGETS
from hil.errors import DataError

BY_NAME = {t.name: t for t in TARGETS}
#: Those that start a process for each input, or compile; the known attacks have own tests.
SLOW = ("npz", "mat", "parquet", "xlsx", "replay", "hdf5", "feather")
#: Inputs that were once not refused properly, by target.
SEEDS = sorted((Path(__file__).parent / "fuzz_seeds").glob("*.bin"))


def deep(data: bytes, folder: Path) -> None:
    """A parser with a fault behind two characters."""
    parse(data)


def three() -> list[bytes]:
    return [b"aaa"]


def parse(data: bytes) -> None:
    if b"[" in data:
        if b"{" in data:
            raise KeyError("found")
        return
    raise DataError("no list")


def crash(data: bytes, folder: Path) -> None:
    if b"{" in data:
        os.abort()


def hang(data: bytes, folder: Path) -> None:
    if b"{" in data:
        time.sleep(100)


def memory(data: bytes, folder: Path) -> None:
    bytearray(2**40)


@pytest.mark.slow
def test_lines_that_are_reached_lead_to_a_fault(monkeypatch):
    monkeypatch.setattr(fuzz, "_COUNTED", fuzz.re.compile("test_fuzz"))
    found = fuzz.explore_target(fuzz.Target("deep", deep, three), 2.5)
    assert [f.what for f in found.findings] == ["KeyError in ?"]
    assert set(b"[{") <= set(found.findings[0].data) and found.kept >= 2


@pytest.mark.slow
def test_a_crash_and_a_lack_of_memory_are_findings(tmp_path):
    found = fuzz.explore_guarded(fuzz.Target("crash", crash, three), 1.5)
    assert "ends the process with signal 6" in {f.what for f in found.findings}
    assert all(b"{" in f.data for f in found.findings)
    found = fuzz.explore_guarded(fuzz.Target("memory", memory, three), 0.5)
    assert any("MemoryError" in f.what for f in found.findings)
    (path, *_) = fuzz.keep([found], tmp_path / "kept")
    assert path.name.startswith("memory-") and path.read_bytes() == found.findings[0].data


def test_a_slow_input_is_a_finding(monkeypatch):
    monkeypatch.setattr(fuzz, "SLOW_S", 0.0)
    found = fuzz.explore_target(fuzz.Target("slow", deep, three), 0.05)
    assert any(f.what.startswith("takes") for f in found.findings)


def test_mutants_are_bounded_and_repeatable():
    rng, again = random.Random(3), random.Random(3)
    seeds = [b"t,q1\n0,1\n", bytes(100), b""]
    some = [fuzz.mutated(seeds[k % 3], seeds, rng) for k in range(3000)]
    assert some == [fuzz.mutated(seeds[k % 3], seeds, again) for k in range(3000)]
    assert len(set(some)) > 1000 and max(map(len, some)) <= fuzz.LONGEST_INPUT


@pytest.mark.parametrize("target", TARGETS, ids=lambda t: t.name)
def test_seeds_are_right(target, tmp_path):
    """At least one seed of every parser is taken: mutants of refused ones stay at the door."""
    taken = 0
    for data in target.seeds():
        try:
            target.use(data, tmp_path)
            taken += 1
        except Exception as error:
            assert isinstance(error, fuzz.HilError)
    assert taken


@pytest.mark.parametrize("path", SEEDS, ids=lambda p: p.stem)
def test_what_was_once_found_is_refused_now(path, tmp_path):
    assert fuzz.tried_input(BY_NAME[path.stem.split("-")[0]], path.read_bytes(), tmp_path) == ""


@pytest.mark.parametrize("name", [t.name for t in TARGETS if t.name not in SLOW])
def test_every_parser_refuses_mutants_in_its_own_words(name, tmp_path):
    target = BY_NAME[name]
    seeds = list(target.seeds())

    @settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.randoms(use_true_random=False), st.sampled_from(seeds))
    def check(rng, seed):
        assert fuzz.tried_input(target, fuzz.mutated(seed, seeds, rng), tmp_path) == ""

    check()


@pytest.mark.parametrize("name", ["map", "model", "rig", "trajectory", "urdf", "command", "csv"])
def test_any_text_is_refused_in_its_own_words(name, tmp_path):
    @settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.text(max_size=200))
    def check(text):
        assert (
            fuzz.tried_input(BY_NAME[name], text.encode("utf-8", "surrogatepass"), tmp_path) == ""
        )

    check()


@example(["\x00"])
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.lists(
        # none leads out of the folder of the test
        st.text(max_size=12).filter(lambda text: "/" not in text and ".." not in text)
        | st.sampled_from(["run", "info", "--json", "-o"]),
        max_size=5,
    )
)
def test_any_command_line_ends_with_a_code(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    try:
        code = main(["info", *words])  # reads and writes nothing of these names
    except SystemExit as left:
        code = left.code
    assert code in (0, 2)


@pytest.mark.slow
def test_the_command_reports_every_target(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["bench", "fuzz", "--minutes", "0.01", "--only", "frame", "--report", "r.md"]
    assert main(words) == 0
    assert "0 findings in 1 target" in capsys.readouterr().out
    assert "| frame |" in (tmp_path / "r.md").read_text()
    assert {p.name for p in tmp_path.iterdir()} == {"r.md"}
    assert main(["bench", "fuzz", "--only", "nothing"]) == 2
    assert "csv" in capsys.readouterr().err
