"""What is printed of results at the prompt, and of arguments in another order."""

import plants
import pytest

import hil
from hil.commands.compare import text
from hil.errors import ConfigError


@pytest.fixture(scope="module")
def run():
    return plants.axis(1, 12.0)


@pytest.mark.slow
def test_results_print_as_one_line(run):
    model = hil.base_model(run.robot)
    printed = [run, hil.fit([run], model), hil.compare([run], model), hil.diagnose([run], model)]
    for x in map(repr, printed):
        assert "\n" not in x and len(x) < 200
    assert repr(printed[0]).startswith("Recording('axis', joint1: 1")
    assert "relative error joint1" in repr(printed[1]) and "joint1" in repr(printed[2])
    assert repr(printed[3]) == "Diagnosis(adequate)"
    before, after = map(repr, hil.add([run], model, "stribeck"))
    assert before.startswith("Rung(before: held-out error ") and "simulated error" in after
    step = repr(printed[3].ladder[0])
    assert step.startswith("Step(") and max(map(len, (before, after, step))) < 200


def test_what_was_added_prints_as_a_table(run):
    added = hil.add([run], hil.base_model(run.robot), "stribeck")
    assert repr(added).startswith("Added(+ stribeck: held-out error ") and "->" in repr(added)
    first, *rest = str(added).splitlines()
    assert first == "Added + stribeck" and "j1.stribeck.fs = " in rest[0]
    assert "error % before" in str(added) and "joint1" in rest[-1]
    assert "<table" in added._repr_html_()
    assert len(added.to_frame()) == run.d
    assert added.after.step.result.model.names()[-1] == "stribeck"


def test_compare_says_that_it_fits_again(run):
    assert "all values fitted to these data" in text(hil.compare([run], hil.base_model(run.robot)))


def test_an_effect_in_the_wrong_place_is_a_sentence(run):
    with pytest.raises(ConfigError, match=r"hil.add takes \(recordings, model, effect\)"):
        hil.add("stribeck", [run], hil.base_model(run.robot))


def test_a_fitted_model_is_compared_as_it_is(run):
    other, model = plants.axis(2, 12.0), hil.base_model(run.robot)
    fitted = hil.fit([run], model).model
    seen = hil.compare([other], fitted.as_it_is())
    assert "values of the model file" in text(seen)
    again = hil.compare([other], fitted)
    assert seen.result.values["j1.coulomb.fc"].value == fitted_value(fitted)
    assert again.result.values["j1.coulomb.fc"].value != fitted_value(fitted)
    assert seen.result.rms[0] > again.result.rms[0]
    with pytest.raises(ConfigError, match="predicts nothing as it is"):
        model.as_it_is()


def fitted_value(model):
    return next(u for u in model.effects if u.type == "coulomb").values["j1.coulomb.fc"].value


@pytest.mark.slow
def test_the_headline_keeps_apart_what_is_sure(run):
    from dataclasses import replace

    from hil.diagnosis.types import Finding
    from hil.report.data import from_diagnosis
    from hil.report.text import headline, next_steps

    d = hil.diagnose([run], hil.base_model(run.robot))
    sure = Finding("stribeck", "joint1", 0.98, 5.0, 1.0, 0.1, 0.9, {}, [])
    perhaps = replace(sure, effect="cogging", confidence=0.36, excess_explained=0.05)
    d = replace(d, verdict="missing-effect", findings=[sure, perhaps])
    m = from_diagnosis(d)
    assert headline(m) == "The model lacks stribeck on joint1, and perhaps cogging on joint1."
    assert next_steps(m)[0].startswith("Accept stribeck on joint1; all")


def test_a_model_whose_friction_was_replaced_is_compared_as_it_is(run):
    fitted = hil.fit([run], hil.base_model(run.robot) + "presliding").model
    assert not next(u for u in fitted.effects if u.type == "coulomb").values
    seen = hil.compare([run], fitted.as_it_is())
    assert seen.result.values["j1.presliding.s"].value == fitted.values()["j1.presliding.s"].value
