"""A model knows what it was identified on, and says when a session leaves that."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.errors import ConfigError
from hil.identify.fit import identified, outside
from hil.identify.problem import Problem
from hil.models.files import read_model, write_model
from hil.models.model import Range
from hil.report.data import comparison_json, diagnosis_json


def model_of(run, folder):
    path = folder / "fitted.toml"
    write_model(hil.fit([run], hil.base_model(run.robot)).model, path)
    return read_model(path)


def codes(rows):
    return [(w["code"], w["text"]) for w in rows if w["code"] == "outside-range"]


def test_range_is_kept_in_the_file_and_holds_for_the_same_motion(tmp_path):
    run = plants.axis(1)
    model = model_of(run, tmp_path)
    (r,) = model.valid
    assert r.joint == "joint1"
    assert run.q.min() < r.position[0] < r.position[1] < run.q.max()
    assert r.speed[0] < -0.5 and r.speed[1] > 0.5 and r.load[1] > 0
    assert not codes(comparison_json(hil.compare([run], model))["warnings"])


@pytest.mark.slow
def test_wider_and_faster_motion_is_flagged_with_joint_and_size(tmp_path):
    wide = plants.axis(1)
    small = wide.slice(0, 3000)  # six of twenty seconds
    model = model_of(small, tmp_path)
    said = codes(comparison_json(hil.compare([wide], model))["warnings"])
    assert said and all("joint1" in text and "% of the time" in text for _, text in said)
    assert "position of joint1 14 %" in said[-1][1]
    d = hil.diagnose([wide], model)
    assert codes(diagnosis_json(d)["warnings"]) == said
    assert d.findings == []
    fitted = hil.fit([wide], model)
    assert [text for _, text in fitted.warnings] == [text for _, text in said]
    # a fit to the wider motion holds there
    assert not codes(comparison_json(hil.compare([wide], fitted.model))["warnings"])


def test_rare_excursions_are_one_short_line_the_farthest_first():
    run = plants.axis(1)
    problem = Problem([run], run.robot)
    (whole,) = identified(problem)
    assert outside([whole], problem) == []
    q = np.concatenate([m.q[:, 0] for m in problem.motions])
    low, high = np.quantile(q, [0.1, 0.995]).tolist()
    near = replace(whole, position=(low, high), speed=tuple(0.8 * x for x in whole.speed))
    (line,) = outside([near], problem)
    assert line.startswith("the session leaves the identified range for up to ")
    told = line.partition("by these shares of the range: ")[2].split(", ")
    sizes = [float(x.split(" ")[-2]) for x in told]
    assert {x.split(" ")[0] for x in told} == {"position", "speed"}
    assert sizes == sorted(sizes, reverse=True)
    often = replace(near, speed=tuple(0.3 * x for x in whole.speed))
    first, second = outside([often], problem)
    assert "speed range" in first and "joint1 for " in first and "position of joint1 " in second


def test_held_out_session_outside_the_fit_is_flagged():
    wide = plants.axis(1)
    found = hil.compare([wide.slice(0, 3000)], hil.base_model(wide.robot), [wide])
    assert any("held-out session" in text for _, text in codes(comparison_json(found)["warnings"]))


@pytest.mark.slow
def test_report_shades_what_is_outside(tmp_path):
    from hil.report.html import comparison_report

    wide = plants.axis(1)
    model = model_of(wide.slice(0, 3000), tmp_path)
    comparison_report(hil.compare([wide], model), tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text("utf-8")
    assert "outside the range that the given model was identified on" in page
    assert "predictions there are extrapolation" in page


def test_files_without_a_range_and_with_a_wrong_one(tmp_path):
    run = plants.axis(1)
    model = replace(hil.base_model(run.robot), valid=(Range("a joint", (0, 1), (-1, 1), (0, 2)),))
    path = tmp_path / "m.toml"
    write_model(model, path)
    assert read_model(path).valid == model.valid
    text = path.read_text("utf-8")
    path.write_text(text[: text.index("[valid")], encoding="utf-8")
    assert read_model(path).valid == ()
    path.write_text(text.replace("speed = [-1, 1]", "speed = [1, -1]"), encoding="utf-8")
    with pytest.raises(ConfigError, match="lowest, highest"):
        read_model(path)


@pytest.mark.parametrize(
    "effect", ["spring", pytest.param("position-torque", marks=pytest.mark.slow)]
)
def test_a_law_over_the_range_foretells_a_session_of_another_range(tmp_path, effect):
    """Its values refer to the range that it was fitted on, which the file keeps."""

    def cable(t, q, v, a):
        return 0.3 * (q - 0.2)

    run, path = plants.smooth_axis(3, extra=cable), tmp_path / "fitted.toml"
    write_model(hil.fit([run], hil.base_model(run.robot) + effect).model, path)
    model = read_model(path)
    half = plants.smooth_axis(3, extra=cable).slice(0, 5000)
    keep = half.q[:, 0] > np.quantile(half.q[:, 0], 0.3)
    narrow = half.slice(int(np.argmax(keep)), int(np.argmax(keep)) + 2500)
    assert np.ptp(narrow.q) < 0.8 * np.ptp(run.q)
    known = hil.compare([narrow], model.as_it_is()).heldout.relative[0]
    fitted = hil.compare([run], model.as_it_is()).heldout.relative[0]
    assert known < 1.6 * fitted
