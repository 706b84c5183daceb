"""Objects at a prompt and in a notebook: tables, frames, figures, pages."""

from __future__ import annotations

from datetime import UTC, datetime

import plants
import plotly.graph_objects as go
import pytest

import hil
from hil.errors import ConfigError
from hil.report.data import from_comparison
from hil.report.effects import learnt
from hil.report.html import is_report
from hil.revision import source_revision


@pytest.fixture(scope="module")
def run():
    return plants.bench_axis("bench", 1, drag=0.05, seconds=10.0)


@pytest.fixture(scope="module")
def answer(run):
    return hil.diagnose(run, hil.base_model(run.robot))


def test_objects_of_joints_without_a_description_say_so_first():
    """A recording, a fit and a comparison at a prompt; not of one joint, nor of a described arm."""
    two = plants.joints()
    model = hil.base_model(two.robot)
    for shown in (two, hil.fit(two, model), hil.compare(two, model)):
        lines = str(shown).splitlines()
        assert lines[1].startswith("  2 joints without a robot description: "), lines[:3]
        assert str(shown).count("without a robot description") == 1
        assert "without a robot description" in shown._repr_html_()
    assert "without a robot description" not in str(plants.spatial(1))


def test_a_model_prints_its_parameters(run, answer):
    empty, fitted = hil.base_model(run.robot), answer.model
    assert "no values yet: hil.fit finds them" in str(empty) and "coulomb" in str(empty)
    lines = str(fitted).splitlines()
    assert lines[2].split() == ["parameter", "value", "standard", "error", "unit", "remarks"]
    row = next(x for x in lines if "quadratic-drag.fd" in x)
    assert float(row.split()[1]) == pytest.approx(0.05, rel=0.1)
    assert repr(fitted).startswith("RobotModel(single-axis: ") and "\n" not in repr(fitted)


def test_no_object_prints_a_urdf(run):
    from dataclasses import replace

    from hil.record.recording import RobotSource

    described = replace(run, robot=RobotSource("", "<robot>long</robot>"))
    for shown in (described, hil.base_model(described.robot)):
        assert "<robot>" not in str(shown) + repr(shown) + shown._repr_html_()


def test_a_report_goes_to_the_name_of_a_file(answer):
    with pytest.raises(ConfigError, match="report takes the name of a file, not int"):
        answer.report(5)


def test_an_answer_prints_its_verdict_and_ladder(answer):
    text = str(answer)
    assert text.startswith("Diagnosis: missing-effect. The model lacks quadratic-drag on joint1.")
    assert "base model" in text and "+ quadratic-drag on joint1" in text
    frame = answer.to_frame()
    errors = frame["held-out error %"].tolist()
    assert errors == [float(s.heldout.relative[0]) for s in answer.ladder]
    assert f"{errors[0]:.4g}" in text and f"{errors[0]:.4g}" in answer._repr_html_()


def test_a_fit_is_a_frame_of_its_values(answer):
    frame = answer.result.to_frame().set_index("parameter")
    for name, v in answer.result.values.items():
        assert frame.loc[name, "value"] == v.value
    assert "<table>" in answer.result._repr_html_()


def test_names_are_escaped_in_notebooks(run):
    from dataclasses import replace

    html = replace(run, name="<script>x</script>", joints=("<b>",))._repr_html_()
    assert "<script>" not in html and "<b>&lt;b&gt;" not in html and "&lt;b&gt;" in html


def test_every_figure_of_the_report_is_a_plotly_figure(answer, tmp_path):
    figures = answer.plot()
    place = answer.report(tmp_path / "r.html")
    page = place.read_text(encoding="utf-8")
    assert {"ladder", "views-1", "spectra-1", "candidates", "effect-1", "traces"} == set(figures)
    for name, figure in figures.items():
        assert isinstance(figure, go.Figure) and figure.data and f'<div id="{name}"' in page
        figure.to_json()
    assert is_report(place)


def test_a_report_replaces_nothing_else(answer, tmp_path):
    other = tmp_path / "thesis.html"
    other.write_text("<html>mine</html>")
    for place, sentence in (
        (other, "not a report of hil"),
        (tmp_path / "r.pdf", "must end in .html"),
        (tmp_path / "no" / "r.html", "folder does not exist"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            answer.report(place)
    assert other.read_text() == "<html>mine</html>"


def test_bad_data_says_that_there_is_nothing_to_draw(run):
    from hil.diagnosis.types import Diagnosis

    bad = Diagnosis("bad-data", warnings=[("nan", "joint1 holds NaN")])
    assert "joint1 holds NaN" in str(bad)
    with pytest.raises(ConfigError, match="nothing was fitted"):
        bad.plot()


def test_what_was_left_out_of_the_fit_is_a_gap_and_not_zero(run):
    """A joint that rests on the way has no residual there, neither as a curve nor as dots."""
    from dataclasses import replace

    import numpy as np

    q, tau = run.q.copy(), run.tau.copy()
    q[2000:2600], tau[2000:2600] = q[2000], 0.02
    answer = hil.compare(replace(run, q=q, tau=tau), hil.base_model(run.robot))
    left_out = answer.heldout.effort[0] == 0.0
    assert 0.02 < left_out.mean() < 0.5
    measured = answer.plot()["traces"].data[0]
    y = np.asarray(measured.y, dtype=float)
    assert not np.any(y == 0.0)
    m = from_comparison(answer)
    fit = learnt(m.after.result, "coulomb", "joint1")
    live = m.problem.live[0]
    assert np.array_equal(np.isnan(fit.partial), ~live) and not live.all()


def test_a_page_says_when_and_by_what_it_was_written(answer, tmp_path):
    page = answer.report(tmp_path / "r.html").read_text(encoding="utf-8")
    revision, _ = source_revision()
    assert f"{datetime.now(UTC):%Y-%m}" in page and revision[:12] in page
    assert "integrates an error of the effort twice" in page and "f<sub>d</sub> v |v|" in page


def test_the_last_bin_after_a_reversal_has_no_end(answer):
    ticks = [a.ticktext for a in answer.plot()["views-1"].select_xaxes() if a.ticktext]
    assert sum("more" in t for t in ticks) == 2
    assert not any(x.startswith("1000") for t in ticks for x in t)
