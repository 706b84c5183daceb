"""The ladder in a notebook cell: its buttons add, undo and diagnose, and the errors fall."""

import builtins
import re

import plants
import pytest

import hil
from hil.errors import ConfigError
from hil.studio.notebook import LadderWidget, ladder_html


def percents(widget):
    return [float(x) for x in re.findall(r"([\d.]+) % \(", shown(widget))]


@pytest.fixture(scope="module")
def begun():
    fitted, held = plants.stribeck_axis(1), plants.stribeck_axis(2)
    return hil.widget(fitted, hil.base_model(fitted.robot), holdout=held)


def press(widget, name):
    button = next(b for row in widget.view.children for b in getattr(row, "children", ())
                  if getattr(b, "description", "") == name)  # fmt: skip
    assert not button.disabled, f"{name} cannot be pressed"
    button.click()


def shown(widget):
    """Text of the cell, without its marks."""
    values = [getattr(x, "value", "") for x in widget.view.children]
    return re.sub(r"<[^>]+>", " ", " ".join(v for v in values if isinstance(v, str)))


def errors(widget):
    return [float(x) for x in re.findall(r"\(([\d.]+) floors\)", shown(widget))]


@pytest.mark.slow
def test_the_chosen_candidate_is_added_and_the_errors_fall(begun):
    assert isinstance(begun, LadderWidget)
    (before,) = percents(begun)
    choice = begun.view.children[1].children[0]
    assert choice.options[0][0].startswith("stribeck on joint1: error to ")
    assert "friction" in shown(begun).lower()  # the chosen effect is explained
    press(begun, "Add")
    assert errors(begun)[1] < 1.15 < 1.5 < errors(begun)[0]
    was, now = percents(begun)
    assert was == before and now < 0.5 * was
    assert "stribeck" in begun.model.names()
    assert not any(text.startswith("stribeck on joint1") for text, _ in choice.options)
    press(begun, "Undo")
    assert "stribeck" not in begun.model.names() and len(errors(begun)) == 2
    press(begun, "Redo")
    assert "stribeck" in begun.model.names()
    assert repr(begun).startswith("LadderWidget(base model: ")


def test_a_notebook_gets_the_view_with_its_text(begun):
    bundle = begun._repr_mimebundle_()
    data = bundle[0] if isinstance(bundle, tuple) else bundle
    assert "application/vnd.jupyter.widget-view+json" in data
    assert "floors)" in begun._repr_html_()  # where widgets are not shown


def test_the_diagnosis_is_said_and_its_model_taken():
    run = plants.stribeck_axis(1)
    widget = hil.widget([run], hil.base_model(run.robot))
    with pytest.raises(ConfigError, match="press Diagnose first"):
        widget.take()
    press(widget, "Diagnose")
    assert "The model lacks stribeck on joint1" in shown(widget)
    press(widget, "Take")
    assert "stribeck" in widget.model.names()
    assert "held-out blocks of the fitted runs" in shown(widget)


def test_what_cannot_be_added_is_said_below_the_buttons_and_changes_nothing(begun, monkeypatch):
    rungs = errors(begun)
    with pytest.raises(ConfigError, match="joint9"):
        begun.add("stribeck", "joint9")
    assert errors(begun) == rungs

    def refuse(effect, joint=""):
        raise ConfigError("no <such> effect")

    monkeypatch.setattr(begun, "add", refuse)
    press(begun, "Add")
    assert "no &lt;such&gt; effect" in shown(begun)


def test_names_of_the_recording_are_text_and_no_markup():
    rung = {"label": "<b>", "joints": [{"relative": 2.0, "ratio": 20.0}]}
    state = {"joints": ["<i>"], "ladder": [rung], "at": 0, "adequate": 1.2, "holdout": ["<u>"]}
    text = ladder_html(state)
    assert not re.search(r"<[biu]>", text)
    assert "width:100%" in text and "(20.00 floors)" in text


def test_what_the_widget_lacks_is_said_with_the_command_that_installs_it(monkeypatch):
    genuine = builtins.__import__

    def without(name, *rest):
        if name == "ipywidgets":
            raise ImportError(name)
        return genuine(name, *rest)

    run = plants.stribeck_axis(1)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=r"pip install 'hil-teleop\[notebook\]'"):
        hil.widget(run, hil.base_model(run.robot))


def test_arguments_of_another_kind_are_refused_in_one_sentence():
    with pytest.raises(ConfigError, match=r"hil\.widget takes a recording"):
        hil.widget("run.mcap", None)
