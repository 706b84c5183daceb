"""A user's effect from one file outside the package: loaded, checked, fitted, proposed."""

import importlib.util
import py_compile
from pathlib import Path

import plants
import pytest

from hil.cli import main
from hil.diagnosis.evidence import gather
from hil.errors import ConfigError
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.files import read_model, write_model
from hil.record.export import write_recordings
from hil.record.recording import RobotSource
from hil.testing import check_effect
from hil.work import single_threaded

PLUGIN = '''
"""A cable that tightens towards the middle of its travel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.models.effect import Doc, Effect, Grid, Param, log_grid


def bulge(q, middle, width):
    """exp(-((q - middle) / width)^2)."""
    return np.exp(-(((q - middle) / width) ** 2))


def widths(motion, j):
    """A twentieth to two fifths of the span."""
    span = float(np.ptp(motion.span[j])) or 1.0
    return log_grid(0.05 * span, 0.4 * span, 6)


@dataclass(frozen=True)
class TightSpot(Effect):
    name, family = "tight-spot", "friction"
    doc = Doc(
        equation="tau = f exp(-((q - q_mid) / w)^2) tanh(v / v0)",
        signature="friction peak at mid-range",
        shown_by="slow strokes over the whole range",
        source="workshop notes",
    )
    params = (Param("f", "{F}", "additional friction at mid-range", 0.0),)
    shape = (Param("w", "{x}", "width", 0.0, size=True),)
    search = Grid(widths)

    def columns(self, motion, j, shape):
        middle = motion.span[j].mean()
        return (bulge(motion.q[:, j], middle, shape[0]) * motion.sign(j))[:, None]

EFFECTS = (TightSpot(),)
'''
MODEL = """schema = "hil.model/1"
plugins = ["./tight.py"]
[robot]
preset = "single-axis"
"""
BASE = "".join(f'[[effects]]\ntype = "{name}"\n' for name in ("rigid-body", "coulomb", "viscous"))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, agreed) -> Path:
    monkeypatch.setattr(catalogue, "_table", dict(catalogue.table()))
    (tmp_path / "tight.py").write_text(PLUGIN)
    agreed(tmp_path / "tight.py")
    (tmp_path / "base.toml").write_text(MODEL + BASE)
    (tmp_path / "full.toml").write_text(MODEL + BASE + '[[effects]]\ntype = "tight-spot"\n')
    return tmp_path


def test_it_is_loaded_and_passes_the_public_check(folder: Path) -> None:
    model = read_model(folder / "base.toml")
    assert model.plugins == (str(folder / "tight.py"),)
    check_effect(catalogue.get("tight-spot"))
    read_model(folder / "full.toml")  # loading the same file again is no clash


def test_it_is_fitted_and_written(folder: Path) -> None:
    model = read_model(folder / "full.toml")
    result = fit(Problem([plants.tight_axis()], RobotSource("single-axis")), model)
    value = result.values["j1.tight-spot.f"]
    assert value.value == pytest.approx(0.4, rel=0.1) and value.unit == "N m"
    assert result.values["j1.tight-spot.w"].value == pytest.approx(0.15, rel=0.15)
    write_model(result.model, folder / "fitted.toml")
    assert read_model(folder / "fitted.toml").values()["j1.tight-spot.f"].value == value.value


def test_it_is_the_best_candidate_where_it_is_what_is_missing(folder: Path) -> None:
    model = read_model(folder / "base.toml")
    result = fit(Problem([plants.tight_axis()], RobotSource("single-axis")), model)
    evidence = single_threaded(gather)(result)
    names = [c.name for c in evidence.candidates]
    assert "tight-spot" in names and "spring" in names
    assert names[0] == "tight-spot"
    assert evidence.candidates[0].p_value < 0.05


@pytest.fixture
def foreign(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A model of somebody else, whose plugin leaves a trace where it runs."""
    monkeypatch.setenv("HIL_STATE", str(folder / "state"))
    (folder / "tight.py").write_text(PLUGIN + "open('ran', 'w').close()\n")
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ["fit", "s.mcap", "--model", "base.toml"],
        ["compare", "s.mcap", "--model", "base.toml"],
        ["diagnose", "s.mcap", "--model", "base.toml"],
        ["add", "stribeck", "s.mcap", "--model", "base.toml", "-o", "x.toml"],
        ["improve", "s.mcap", "--model", "base.toml", "-o", "x.toml"],
    ],
    ids=lambda words: words[0],
)
def test_no_command_runs_a_plugin_because_it_read_a_model(foreign: Path, capsys, words) -> None:
    write_recordings(foreign / "s.mcap", [plants.tight_axis()])
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "tight.py would run with your rights" in said and "'hil trust base.toml'" in said
    assert not (foreign / "ran").exists()


def test_a_plugin_runs_as_it_was_agreed_to(foreign: Path, capsys) -> None:
    assert main(["info", "base.toml"]) == 0
    assert "plugin" in (listed := capsys.readouterr().out) and "NOT agreed to" in listed
    assert not (foreign / "ran").exists()
    assert main(["trust", "base.toml"]) == 0
    assert not (foreign / "ran").exists()
    read_model(foreign / "base.toml")
    (foreign / "ran").unlink()
    with (foreign / "tight.py").open("a") as file:
        file.write("# changed\n")
    with pytest.raises(ConfigError, match="have not agreed to it as it is now"):
        read_model(foreign / "base.toml")
    assert not (foreign / "ran").exists()


def test_what_was_compiled_before_does_not_run(foreign: Path, agreed) -> None:
    # a compiled file that Python takes without looking at the text
    agreed(foreign / "tight.py")
    other = foreign / "other.py"
    other.write_text(PLUGIN + "open('taken', 'w').close()\n")
    cached = importlib.util.cache_from_source(str(foreign / "tight.py"))
    unchecked = py_compile.PycInvalidationMode.UNCHECKED_HASH
    py_compile.compile(str(other), cached, invalidation_mode=unchecked)
    read_model(foreign / "base.toml")
    assert (foreign / "ran").exists() and not (foreign / "taken").exists()
