"""What a motion could not show: computed from it, with a reason, told everywhere."""

import numpy as np
import plants
import pytest

from hil.commands.diagnose import text
from hil.diagnosis import floor
from hil.diagnosis import verdict as verdict_module
from hil.diagnosis.engine import diagnose
from hil.diagnosis.floor import HIDDEN_SHARE
from hil.diagnosis.types import Explainable
from hil.diagnosis.verbs import ladder
from hil.models.model import base_model
from hil.report.data import diagnosis_json
from hil.report.html import diagnosis_report


def answer(run):
    return diagnose([run], base_model(run.robot))


def shown(d):
    return {e for u in d.unseen for e in u.effects}


FAST = plants.axis_on_tones([0.9, 1.7], [1.2, 0.5])
SLOW = plants.axis_on_tones([0.11, 0.23], [0.3, 0.15])


@pytest.mark.slow
def test_fast_motion_hides_friction_that_rises_at_low_speed_only():
    # 50 % of Coulomb friction within 0.03 rad/s of a motion that goes to 10 rad/s
    hidden = answer(plants.axis_on_tones([0.9, 1.7], [1.2, 0.5], low=0.1, noise=0.05))
    assert hidden.verdict == "adequate"
    (line,) = [u for u in hidden.unseen if "stribeck" in u.effects]
    assert "of Coulomb friction" in line.why and "--for stribeck" in line.command
    assert "stribeck" not in shown(answer(SLOW))


@pytest.mark.slow
def test_few_reversals_hide_what_happens_behind_them():
    few = answer(plants.axis_on_tones([0.11], [0.5], seconds=14.0))
    assert {"presliding", "backlash"} <= shown(few)
    assert "backlash" not in shown(answer(FAST))


@pytest.mark.slow
def test_an_external_force_that_changes_shows_load_and_gain():
    without = answer(FAST)
    assert {"load-friction", "torque-gain", "friction-drift"} <= shown(without)
    (load,) = [u for u in without.unseen if "load-friction" in u.effects]
    assert load.command == ""  # nothing that this axis does changes its load
    pushed = shown(answer(plants.axis_on_tones([0.9, 1.7], [1.2, 0.5], ext=True)))
    assert not {"load-friction", "torque-gain"} & pushed
    assert "friction-drift" not in shown(
        answer(plants.axis_on_tones([0.9, 1.7], [1.2, 0.5], seconds=61.0))
    )


def test_it_is_told_with_an_adequate_answer_everywhere(tmp_path):
    d = answer(FAST)
    assert d.verdict == "adequate"
    lines = text(d, ladder(d))
    assert "What this motion could not show" in lines and d.unseen[0].text in lines
    data = diagnosis_json(d)
    told = {e for u in data["could_not_show"] for e in u["effects"]}
    assert told == shown(d) and all(u["why"] for u in data["could_not_show"])
    page = tmp_path / "r.html"
    diagnosis_report(d, page)
    assert "What this motion could not show" in page.read_text(encoding="utf-8")


def test_an_error_at_the_floor_is_called_no_proof():
    d = answer(FAST)
    assert d.beyond is not None and 0.0 <= d.beyond < HIDDEN_SHARE
    assert "An error at the noise floor is no proof" in text(d, ladder(d))
    assert diagnosis_json(d)["remaining"]["any_function"] == pytest.approx(d.beyond, rel=0.01)


@pytest.mark.parametrize(("size", "verdict"), [(0.9, "adequate"), (1.1, "unexplained")])
def test_of_an_error_that_a_function_foretells_its_part_counts_and_not_the_whole(
    monkeypatch, size, verdict
):
    """A function of the speed took 18 % of 1.14 % of the effort, and an effect was "missing"."""
    asked = []

    def fall(result):
        """As much as is `size` of what leaves a model adequate."""
        asked.append(result)
        (effort,) = result.problem.rms(result.problem.effort)
        return {0: (size * floor.alarming(result.problem) * effort / result.rms[0]) ** 2}

    def told(result, falls):
        return [Explainable("joint1", "", x, "", "its own speed") for x in falls.values()]

    monkeypatch.setattr(floor, "alarming", lambda problem: 1e-4)
    monkeypatch.setattr(verdict_module, "alarming", lambda problem: 1e-4)
    monkeypatch.setattr(verdict_module, "free_function_falls", fall)
    monkeypatch.setattr(verdict_module, "masked_at_floor", told)
    monkeypatch.setattr(verdict_module, "of_noise", lambda *a: np.array([False]))
    out = answer(FAST)
    assert asked and out.verdict == verdict
