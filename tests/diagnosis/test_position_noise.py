"""Coarse encoders: the noise of positions in a model's load is no spring, whoever smooths it."""

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.artefacts import POSITION_NOISE
from hil.diagnosis.constants import ADEQUATE
from hil.identify import bands
from hil.models.model import Band

TRANSMISSION = {"elastic-transmission", "vibration-mode", "hardening-cable", "backlash"}


def diagnosed(*args, **more):
    r = plants.rough_encoder_axis(*args, **more)
    return hil.diagnose([r], hil.base_model(r.robot))


@pytest.mark.parametrize("noise", [1e-6, 3e-5, 1e-4])
@pytest.mark.parametrize("seed", plants.seeds(1, 2))
def test_nothing_is_hidden_behind_a_coarse_encoder(noise, seed):
    d = diagnosed(noise, seed)
    assert d.verdict == "adequate", d


@pytest.mark.parametrize("seed", plants.seeds(1, 2))
def test_nothing_is_named_behind_a_very_coarse_one(seed):
    d = diagnosed(3e-4, seed)
    assert d.verdict in ("adequate", "unexplained") and not d.findings
    assert any(code == POSITION_NOISE for code, _ in d.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("seed", plants.seeds(5, 1, 2, 3, 4, 6))
def test_a_servo_that_rings_at_its_stops_has_no_play(seed):
    """Its encoder is fine, but a small motion that is fast makes much of its counts."""
    r = plants.ringing_axis(seed)
    d = hil.diagnose([r], hil.base_model(r.robot))
    assert d.verdict == "adequate" and not d.findings
    (told,) = [text for code, text in d.warnings if code == POSITION_NOISE]
    assert "comes from the noise of the measured positions" in told


@pytest.mark.slow
def test_it_holds_on_other_data_too():
    fit, held = plants.rough_encoder_axis(1e-4, 1), plants.rough_encoder_axis(1e-4, 2)
    d = hil.diagnose([fit], hil.base_model(fit.robot), [held])
    assert not {f.effect for f in d.findings} & TRANSMISSION


def test_an_error_that_is_the_encoders_is_said_to_be():
    r = plants.rough_encoder_axis(3e-5)
    d = hil.diagnose(
        [r], hil.RobotModel(r.robot, hil.base_model(r.robot).effects, band=Band(25, 75))
    )
    assert not {f.effect for f in d.findings} & TRANSMISSION
    assert d.verdict == "adequate"
    assert any(
        code == POSITION_NOISE and "not from a missing effect" in text for code, text in d.warnings
    )


def test_the_band_is_narrower_behind_much_noise():
    fine, coarse = (
        bands.choose([plants.rough_encoder_axis(x)], Band(), True).effort for x in (1e-6, 3e-4)
    )
    assert bands.NARROWEST <= coarse < 10.0 < fine
    assert bands.shaken(plants.rough_encoder_axis(3e-4), coarse) < 0.125


@pytest.mark.parametrize(("noise", "size"), [(3e-5, 0.3), (1e-4, 1.0)])
def test_a_small_effect_has_no_rival_that_smooths_and_need_not_explain_the_noise(noise, size):
    law = lambda q, v: size * np.exp(-((v / 0.1) ** 2)) * np.tanh(v / 0.004)  # noqa: E731
    d = diagnosed(noise, law=law)
    assert d.verdict == "missing-effect"
    (finding,) = d.findings
    assert finding.effect == "stribeck" and finding.confidence > 0.8
    assert not set(finding.rivals) & TRANSMISSION
    # what is left above the floor is the noise of the positions, and is no effect's to take
    assert d.explained.result.rms[0] > ADEQUATE * d.floor[0] and finding.excess_explained > 0.7


@pytest.mark.slow
def test_an_effect_is_found_behind_it():
    stribeck = lambda q, v: 4.0 * np.exp(-((v / 0.05) ** 2)) * np.tanh(v / 0.004)  # noqa: E731
    d = diagnosed(3e-5, law=stribeck)
    assert [f.effect for f in d.findings] == ["stribeck"]


@pytest.mark.slow
def test_a_bump_that_the_floor_hides_is_unexplained_with_its_variable():
    d = diagnosed(1e-6, law=lambda q, v: 3.0 * np.exp(-(((q - 0.1) / 0.01) ** 2)))
    # without the rule on coefficients it is cogging, and nobody asks what the rest is
    assert d.verdict in ("unexplained", "missing-effect")
    if d.verdict == "unexplained":
        best = max(d.network, key=lambda s: s.share)
        assert best.words == "its position in detail" and best.share > 0.5
