"""Values that are codes are told in words, everywhere; why a value has no error is told, too."""

import json

import plants
import pytest

from hil.commands.common import value_line
from hil.commands.fit import text
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.files import read_model, write_model
from hil.models.friction import LUGRE
from hil.models.model import Value, base_model, in_words, remark, without_error
from hil.record.recording import RobotSource
from hil.report.data import value_json
from hil.report.text import value
from hil.testing.effects import sample_motions


@pytest.mark.parametrize("name", sorted(catalogue.table()))
def test_every_choice_that_is_tried_has_words(name):
    effect = catalogue.get(name)
    for _, motion in sample_motions():
        for shape in effect.search.grid(motion, 0):
            for p, x in zip(effect.shape, shape, strict=True):
                # the number of the other joint is a joint's name
                names = tuple(f"joint{k + 1}" for k in range(motion.d))
                assert not p.choice or p.words(x, names), p.name


@pytest.mark.parametrize(
    ("name", "x", "says"),
    [
        ("j2.presliding.form", 1.0, "Dahl"),
        ("j2.presliding.vs", 0.0, "not in this form"),
        ("j2.presliding.vs", 0.3, ""),
        ("force-bias.frame", 1.0, "along the tip's axes"),
        ("j1.missed-counts.t0", 0.0, "at the jumps that are recorded"),
        ("j1.missed-counts.t0", 4.0, ""),
        ("j1.load-friction.of", 1.0, "gravity and springs only"),
        ("j1.coupled-friction.joint", 2.0, "elbow"),
        ("j1.torque-offset.t0[run 0.5]", 0.0, ""),
        ("j1.unknown.x", 0.0, ""),
    ],
)
def test_words_of_a_code(name, x, says):
    assert in_words(name, x, ("shoulder", "elbow")) == says


def test_terminal_report_json_and_file_say_the_words(tmp_path):
    name, v = "j1.presliding.form", Value(1.0, unit="1", lower=0.0, upper=2.0)
    assert value_line(name, v) == "j1.presliding.form = 1 (Dahl)"
    assert value(name, v) == "j1.presliding.form = 1 (Dahl)"
    assert value_json(name, v)["text"] == "Dahl"
    result = fit(Problem([plants.two_tone_axis()], RobotSource("single-axis")), MODEL)
    form = result.values[name].value
    said = in_words(name, form)
    assert said and said in text(result)
    data = json.loads(json.dumps(result.as_dict()))["parameters"]
    assert data[name]["text"] == said and "text" not in data["j1.presliding.s"]
    path = tmp_path / "m.toml"
    write_model(result.model, path)
    line = next(x for x in path.read_text().splitlines() if x.startswith(f'"{name}"'))
    assert line.endswith(f"# {said}")
    assert read_model(path).values()[name].value == form


MODEL = base_model(RobotSource("single-axis")) + "presliding"


def test_a_missing_error_has_a_reason():
    nan = float("nan")
    assert without_error("j1.coulomb.fc", Value(0.1, 0.01)) == ""
    assert without_error("j1.presliding.form", Value(1.0, nan)) == ""
    assert "sharpest sign" in without_error("j1.coulomb.v0", Value(1e-3, nan))
    assert "end of what was searched" in without_error(
        "j1.stribeck.vs", Value(1e-3, nan, at_bound=True)
    )
    assert "not fitted" in without_error("j1.stribeck.vs", Value(1e-3, nan, source="given"))
    assert "sharpest sign" in value_line("j1.coulomb.v0", Value(1e-3, nan, "rad/s"))


def test_lugre_without_a_rise_is_called_dahl():
    names = {n: Value(0.5, 0.01) for n in ("f0", "f1", "f2", "f3", "s", "form", "v0", "vs")}
    full = {f"j1.presliding.{n}": v for n, v in names.items()}
    full["j1.presliding.form"] = Value(LUGRE)
    assert remark("presliding", full) == ""
    full["j1.presliding.f2"] = Value(0.01, 0.02)
    assert "Dahl" in remark("presliding", full)
    full["j1.presliding.form"] = Value(1.0)
    assert remark("presliding", full) == ""
    # a displacement of nine times s had been told as s
    full["j1.presliding.f3"] = Value(0.9, 0.02)
    assert remark("presliding", full) == "f3 builds up over 9 s = 4.5, in the unit of s"
    assert remark("viscous", {}) == ""


def test_values_that_trade_off_are_said_to():
    def curve(*errors):
        values = {"fs": (0.14, errors[0]), "vs": (0.05, errors[1]), "n": (1.0, errors[2])}
        return {f"j1.stribeck.{n}": Value(v, e) for n, (v, e) in values.items()}

    assert "fs trades off with vs: sure is the law" in remark("stribeck", curve(0.11, 0.04, 0.47))
    assert remark("stribeck", curve(0.01, 0.04, 0.47)) == ""
    assert remark("stribeck", curve(0.11, 0.01, 0.1)) == ""
