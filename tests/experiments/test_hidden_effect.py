"""The circle closed: what is hidden is named, added, compensated, and felt no more."""

import json
import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest

from hil.cli import main
from hil.experiments import hidden_effect as study


def row(effect, seed, diagnosed, named="stribeck@joint2"):
    newtons = {
        m: dict.fromkeys(study.SENSOR_CASES, x)
        for m, x in zip(study.MODEL_STAGES, (0.2, 0.1, diagnosed), strict=True)
    }
    joint = "joint2" if effect else ""
    right = named == f"{effect}@{joint}" or (named == "nothing" and not effect)
    return study.CircleRow(
        effect, joint, seed, (named, named), right, (3.0, 1.0), 1.0, newtons, newtons
    )


ROWS = [
    row("stribeck", 1, 0.04),
    row("stribeck", 2, 0.06, "stribeck@joint2 + delay@joint2"),
    row("", 1, 0.05, "nothing"),
]


def test_figures_are_means_with_intervals_over_the_seeds():
    first, nothing = study.summaries(ROWS)
    assert (first.right, first.cases, nothing.right, nothing.cases) == (1, 2, 1, 1)
    mean, half = first.free["without"]["diagnosed"]
    assert mean == pytest.approx(0.05)
    # t(0.975, 1) s / sqrt(2)
    assert half == pytest.approx(12.706 * 0.0141421 / 2**0.5, rel=1e-4)
    assert nothing.free["without"]["diagnosed"][1] != nothing.free["without"]["diagnosed"][1]


def test_the_page_says_what_the_numbers_say():
    text = study.page(ROWS, "hil experiment hidden-effect --quick --report x.md", "x.svg")
    assert "| stribeck on joint2 | 1 of 2 | 3.00 -> 1.00 | with sensors | 0.200 -> 0.100" in text
    assert "0.100 N with the fitted base models and 0.050 N with the diagnosed" in text
    assert "50 % less" in text and "(x.svg)" in text
    worse = [replace(r, free={**r.free, "diagnosed": r.free["as built"]}) for r in ROWS]
    assert "100 % more" in study.page(worse, "c", "x.svg")


def test_the_figure_has_a_bar_for_every_model_of_every_effect():
    tree = ET.fromstring(study.figure(study.summaries(ROWS)))
    bars = list(tree.iter("{http://www.w3.org/2000/svg}rect"))
    # and three of the legend
    assert len(bars) == 2 * 3 + 3


@pytest.mark.slow
def test_one_effect_in_both_arms_is_found_added_and_felt_no_more(monkeypatch):
    monkeypatch.setattr(study, "IDENTIFIED_S", 10.0)
    monkeypatch.setattr(study, "SESSION_PERIODS", 2)
    found = study.circle_of("presliding", "joint2", 1)
    assert found.right, found.named
    assert found.error[1] < 1.25 < 2.0 < found.error[0]
    for law in study.SENSOR_CASES:
        built, fitted, diagnosed = (found.free[m][law] for m in study.MODEL_STAGES)
        assert diagnosed < 0.8 * fitted < 0.8 * built
        assert found.contact["diagnosed"][law] < found.contact["fitted"][law]


def test_the_command_writes_page_and_figure(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(study, "study", lambda *args: ROWS)
    page = tmp_path / "page.md"
    assert main(["experiment", "hidden-effect", "--quick", "--report", str(page)]) == 0
    assert "1 of 2" in capsys.readouterr().out
    assert page.with_suffix(".svg").read_text().startswith("<svg")
    assert main(["experiment", "hidden-effect", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert len(data["rows"]) == 3 and data["summaries"][0]["right"] == 1
    assert main(["experiment", "hidden-effect", "--workers", "0"]) == 2
