"""A user's effect from one file outside the package: loaded, checked, fitted, proposed."""

from pathlib import Path

import numpy as np
import pytest

from hil.diagnosis.evidence import gather
from hil.identify.fit import fit
from hil.identify.parallel import single_threaded
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.files import read_model, write_model
from hil.record.recording import Recording, RobotSource
from hil.testing import check_effect

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
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(catalogue, "_table", dict(catalogue.table()))
    (tmp_path / "tight.py").write_text(PLUGIN)
    (tmp_path / "base.toml").write_text(MODEL + BASE)
    (tmp_path / "full.toml").write_text(MODEL + BASE + '[[effects]]\ntype = "tight-spot"\n')
    return tmp_path


def record() -> Recording:
    rng, t = np.random.default_rng(0), np.arange(12000) / 500.0
    w, phase = 2 * np.pi * np.array([0.31, 0.73, 1.13]), rng.uniform(0, 6, 3)
    angle = t[:, None] * w + phase
    q, qd = 0.3 * np.sin(angle).sum(axis=1), 0.3 * (w * np.cos(angle)).sum(axis=1)
    qdd = -0.3 * (w**2 * np.sin(angle)).sum(axis=1)
    middle = (q.min() + q.max()) / 2
    tight = 0.4 * np.exp(-(((q - middle) / 0.15) ** 2)) * np.sign(qd)
    tau = 0.1 * qdd + 0.3 * np.sign(qd) + 0.1 * qd + tight + 0.05 * rng.normal(size=t.size)
    return Recording("run", "arm", ("x",), t, q[:, None], tau[:, None])


def test_it_is_loaded_and_passes_the_public_check(folder: Path) -> None:
    model = read_model(folder / "base.toml")
    assert model.plugins == (str(folder / "tight.py"),)
    check_effect(catalogue.get("tight-spot"))
    read_model(folder / "full.toml")  # loading the same file again is no clash


def test_it_is_fitted_and_written(folder: Path) -> None:
    model = read_model(folder / "full.toml")
    result = fit(Problem([record()], RobotSource("single-axis")), model)
    value = result.values["j1.tight-spot.f"]
    assert value.value == pytest.approx(0.4, rel=0.1) and value.unit == "N m"
    assert result.values["j1.tight-spot.w"].value == pytest.approx(0.15, rel=0.15)
    write_model(result.model, folder / "fitted.toml")
    assert read_model(folder / "fitted.toml").values()["j1.tight-spot.f"].value == value.value


def test_it_is_the_best_candidate_where_it_is_what_is_missing(folder: Path) -> None:
    model = read_model(folder / "base.toml")
    result = fit(Problem([record()], RobotSource("single-axis")), model)
    evidence = single_threaded(gather)(result)
    names = [c.name for c in evidence.candidates]
    assert "tight-spot" in names and "spring" in names
    assert names[0] == "tight-spot"
    assert evidence.candidates[0].p_value < 0.05
