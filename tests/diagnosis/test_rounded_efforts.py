"""Efforts that are recorded before a converter rounds them to its steps."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis import artefacts
from hil.errors import ConfigError
from hil.report import text as report_text
from hil.report.data import from_diagnosis

STEP = 0.06


def told(d):
    return [text for code, text in d.warnings if code == artefacts.ROUNDED]


def diagnosed(*runs):
    return hil.diagnose(list(runs), hil.base_model(runs[0].robot))


@pytest.mark.parametrize("seed", plants.seeds(1, 3))
@pytest.mark.slow
def test_steps_of_the_motors_effort_are_found_said_and_taken_into_account(seed, tmp_path):
    runs = [plants.stepped_axis(k, STEP) for k in (seed, seed + 10)]
    d = diagnosed(runs[0])
    assert d.verdict == "adequate" and not d.findings
    (said,) = told(d)
    assert "0.06 N m on joint1" in said and f"{said}." in report_text.details(from_diagnosis(d))
    hil.write_model(d.model, tmp_path / "m.toml")
    model = hil.read_model(tmp_path / "m.toml")
    assert model.fitted.effort_step == pytest.approx((STEP,), rel=1e-3)
    # another run, as the model is and without the steps
    before = replace(model, band=replace(model.band, effort_step=(0.0,)))
    error = [hil.fit(runs[1], m.as_it_is()).relative[0] for m in (model, before)]
    assert error[0] < 0.3 * error[1]


@pytest.mark.slow
def test_efforts_that_are_recorded_as_they_are_sent_need_no_word():
    d = diagnosed(plants.stepped_axis(1, STEP, sent=True))
    assert d.verdict == "adequate" and not told(d)


@pytest.mark.slow
def test_a_law_beside_the_steps_has_its_name_and_nothing_stands_for_the_steps():
    d = diagnosed(plants.stepped_axis(1, STEP, spring=1.5))
    assert [f.effect for f in d.findings] == ["spring"] and told(d)


@pytest.mark.slow
def test_held_out_runs_are_taken_in_the_same_steps():
    train, other = (plants.stepped_axis(k, STEP) for k in (1, 2))
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert d.verdict == "adequate" and d.ladder[-1].heldout.relative[0] < 0.5


def test_a_residual_of_another_make_is_no_rounding():
    run = plants.quick_axis(1)
    assert artefacts.converter(hil.fit([run], hil.base_model(run.robot)), np.array([True])) == ()


@pytest.mark.slow
def test_steps_that_are_stated_are_not_sought(tmp_path):
    run = plants.stepped_axis(1, STEP)
    base = hil.base_model(run.robot)
    d = hil.diagnose([run], replace(base, band=replace(base.band, effort_step=(0.0,))))
    assert not told(d) and d.verdict != "adequate"


@pytest.mark.parametrize("value", ["0.1", "[-0.1]", "[nan]", '["a"]', "[0.1, 0.1]"])
def test_steps_that_are_none_are_refused(value, tmp_path):
    path = tmp_path / "m.toml"
    hil.write_model(hil.base_model(plants.stepped_axis(1, STEP, seconds=3.0).robot), path)
    path.write_text(path.read_text() + f"\n[signal]\neffort_step = {value}\n")
    with pytest.raises(ConfigError, match="effort_step"):
        hil.fit(plants.stepped_axis(1, STEP, seconds=3.0), hil.read_model(path))


# -------------------------------------------------- what the fit's motion does not determine


def narrow_and_wide(spring=0.0):
    """A run at one speed, and another at many of a rig that may have changed."""
    runs = (
        plants.stepped_axis(1, 1e-6, speeds=(0.2, 0.202)),
        plants.stepped_axis(6, 1e-6, speeds=(0.05, 1.2), spring=spring),
    )
    rng = np.random.default_rng(1)
    return [replace(r, tau=r.tau + 0.01 * rng.normal(size=r.tau.shape)) for r in runs]


def test_a_held_out_error_that_the_standard_errors_allow_is_no_missing_effect():
    train, other = narrow_and_wide()
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert d.verdict == "adequate"
    assert any("lies within their standard errors" in text for _, text in d.warnings)


def test_a_held_out_error_of_another_make_is_one():
    train, other = narrow_and_wide(spring=0.5)
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    assert d.verdict != "adequate"
