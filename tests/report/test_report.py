"""The HTML report, one for every verdict, from small synthetic problems."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import plants
import pytest

from hil.diagnosis.engine import diagnose
from hil.diagnosis.types import Diagnosis, Finding
from hil.diagnosis.verbs import Comparison, compare
from hil.models.model import RobotModel, Use, base_model
from hil.record.recording import Recording
from hil.report.html import comparison_report, diagnosis_report

SECTIONS = (
    "Error ladder",
    "Where the model fails",
    "Candidates",
    "Measured and predicted effort",
    "Parameters of the",
    "What these data cannot tell apart",
    "Provenance",
)


def model(recording: Recording) -> RobotModel:
    return base_model(recording.robot)


class Page(HTMLParser):
    """Tags that are open, resources that would be loaded, visible text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []
        self.words: list[str] = []
        self.scripts = 0
        self.ids: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "br", "img", "link"):
            self.open.append(tag)
        for key, value in attrs:
            if key in ("src", "href", "data", "action"):
                self.loads.append(str(value))
            if key == "id":
                self.ids.append(str(value))
        self.scripts += tag == "script"

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.words)


def check_page(path: Path) -> Page:
    """Well-formed, loads nothing, small; the parsed page."""
    source = path.read_text(encoding="utf-8")
    page = Page(source)
    assert page.open == []
    assert page.loads == []
    style = re.search(r"<style>(.*?)</style>", source, re.DOTALL)
    assert style is not None and "url(" not in style[1] and "@import" not in style[1]
    assert len(source) < 8_000_000
    assert len(page.ids) == len(set(page.ids))
    return page


def written(d: Diagnosis, folder: Path) -> Page:
    path = folder / "report.html"
    diagnosis_report(d, str(path))
    return check_page(path)


@pytest.fixture(scope="module")
def drag() -> Diagnosis:
    run = plants.tanh_axes("quadratic-drag", d=2)
    return diagnose([run], model(run))


@pytest.fixture(scope="module")
def clean() -> Comparison:
    run = plants.tanh_axes()
    return compare([run], model(run))


def test_missing_effect(drag: Diagnosis, tmp_path: Path) -> None:
    assert [f.effect for f in drag.findings] == ["quadratic-drag"]
    page = written(drag, tmp_path)
    assert "The model lacks quadratic-drag on joint2." in page.text
    assert "hil add quadratic-drag --joint joint2" in page.text
    assert "j2.quadratic-drag.fd" in page.text
    for title in (*SECTIONS, "The learnt effect over the data"):
        assert title in page.text
    assert {"ladder", "candidates", "effect-1", "traces"} <= set(page.ids)


def figures(source: str) -> list[list[Any]]:
    """Name, traces, layout and settings of every figure of a page."""
    found = re.findall(r'<script type="application/json" class="figure">(.*?)</script>', source)
    return [json.loads(f) for f in found]


def test_plotly_is_inlined_once(drag: Diagnosis, tmp_path: Path) -> None:
    path = tmp_path / "r.html"
    diagnosis_report(drag, str(path))
    source = path.read_text(encoding="utf-8")
    assert source.count("plotly.js (basic - minified) v") == 1
    assert len(source.encode()) < 1_500_000
    traces = {t["type"] for f in figures(source) for t in f[1]}
    assert traces and traces <= {"scatter", "bar"}  # all that the script for lines and bars draws
    assert "cdn.plot.ly/plotly" not in source


def test_same_diagnosis_same_file(drag: Diagnosis, tmp_path: Path) -> None:
    for name in "ab":
        diagnosis_report(drag, str(tmp_path / name))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_ambiguous(drag: Diagnosis, tmp_path: Path) -> None:
    doubtful = replace(drag.findings[0], confidence=0.5, rivals=["stribeck"])
    page = written(replace(drag, verdict="ambiguous", findings=[doubtful]), tmp_path)
    assert "most likely quadratic-drag on joint2" in page.text
    assert "Rivals with this motion: stribeck" in page.text
    assert "quadratic-drag / stribeck" in page.text
    assert "hil add" not in page.text


def test_adequate(tmp_path: Path) -> None:
    run = plants.tanh_axes()
    d = diagnose([run], model(run))
    assert d.verdict == "adequate"
    page = written(d, tmp_path)
    assert "The model is adequate" in page.text
    assert "The learnt effect over the data" not in page.text


def test_unexplained_with_partial(drag: Diagnosis, tmp_path: Path) -> None:
    partial: list[Finding] = drag.findings
    page = written(replace(drag, verdict="unexplained", findings=[], partial=partial), tmp_path)
    assert "none of the catalogue passes every test" in page.text
    assert "Best partial explanation: quadratic-drag on joint2" in page.text


def test_unexplained_by_anything(tmp_path: Path) -> None:
    run = plants.tanh_axes("unknown")
    page = written(replace(diagnose([run], model(run)), verdict="unexplained"), tmp_path)
    said = "What the model does not explain is a large part of the effort, and no sensor noise"
    assert f"{said}: 32 % on joint1" in page.text


def test_not_identifiable(tmp_path: Path) -> None:
    run = plants.tanh_axes()
    still = replace(run, q=1e-5 * np.random.default_rng(0).standard_normal(run.q.shape))
    d = diagnose([still], model(run))
    assert d.verdict == "not-identifiable"
    page = written(d, tmp_path)
    assert "Nothing can be concluded" in page.text
    assert "Move faster or wider" in page.text


def test_bad_data_has_no_figures(tmp_path: Path) -> None:
    run = plants.tanh_axes()
    tau = run.tau.copy()
    tau[100:140] = np.nan
    d = diagnose([replace(run, tau=tau)], model(run))
    assert d.verdict == "bad-data"
    page = written(d, tmp_path)
    assert "The recording or the robot description is faulty" in page.text
    assert d.warnings[0][1] in page.text
    assert "ladder" not in page.ids


def test_comparison(clean: Comparison, tmp_path: Path) -> None:
    path = tmp_path / "c.html"
    comparison_report(clean, str(path))
    page = check_page(path)
    assert "times the noise floor" in page.text
    assert "hil diagnose" in page.text
    for title in (*SECTIONS[:5], SECTIONS[-1]):
        assert title in page.text


@pytest.mark.slow
def test_seven_joints(tmp_path: Path) -> None:
    run = plants.tanh_axes("cogging", d=7)
    d = diagnose([run], model(run))
    page = written(d, tmp_path)
    assert all(f"joint{k}" in page.text for k in range(1, 8))


def test_held_out_runs_are_named(tmp_path: Path) -> None:
    run = plants.tanh_axes("cogging")
    other = replace(run, name="other day", tau=run.tau[::-1].copy(), q=run.q[::-1].copy())
    page = written(diagnose([run], model(run), [other]), tmp_path)
    assert "other day" in page.text
    assert "sessions that were not fitted" in page.text


def test_names_are_escaped(tmp_path: Path) -> None:
    run = plants.tanh_axes("cogging", joints=("</script><script>alert(1)</script>",))
    run = replace(run, name="<b>&run", metadata={"session.rig": "<img src=x>"})
    page = written(diagnose([run], model(run)), tmp_path)
    assert "alert(1)" in page.text
    assert "<b>&run" in page.text


def test_contact_law(tmp_path: Path) -> None:
    run = plants.tanh_axes()
    depth = np.maximum(run.q - 0.1, 0.0)
    rng = np.random.default_rng(1)
    v = np.gradient(run.q[:, 0], run.t)[:, None]
    push = -300 * depth - 40 * np.where(depth > 0, v, 0.0) + 0.5 * rng.standard_normal(run.q.shape)
    run = replace(run, tau_ext=push)
    law = RobotModel(run.robot, (Use("contact-stiffness"),), explains="external")
    d = diagnose([run], law)
    assert [f.effect for f in d.findings] == ["contact-damping"]
    page = written(d, tmp_path)
    assert "The model lacks contact-damping" in page.text
    assert "accuracy of the force sensor" in page.text
    assert "simulated" not in page.text
