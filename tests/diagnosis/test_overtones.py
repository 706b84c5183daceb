"""A wave that repeats within another one is its harmonic, not a second effect."""

import plants
import pytest

from hil.diagnosis.engine import diagnose
from hil.models.model import base_model


@pytest.mark.slow
def test_a_third_harmonic_is_no_second_name() -> None:
    train = plants.cogging_axis(0, 0.008)
    found = diagnose([train], base_model(train.robot), [plants.cogging_axis(1, 0.008)])
    assert [f.effect for f in found.findings] == ["cogging"]
    (text,) = (text for code, text in found.warnings if code == "harmonic")
    assert "repeats 3 times in a period of its cogging" in text
    assert [c.effect for c in found.corrections] == ["correction-wave"]
    named, corrected = (step.heldout.rms[0] for step in found.ladder[-2:])
    assert corrected < 0.8 * named


@pytest.mark.slow
def test_a_wave_of_another_order_is_no_harmonic() -> None:
    train = plants.cogging_axis(0, 0.008, 2.43 * plants.COGGING_ORDER)
    found = diagnose(
        [train],
        base_model(train.robot),
        [plants.cogging_axis(1, 0.008, 2.43 * plants.COGGING_ORDER)],
    )
    assert [f.effect for f in found.findings] == ["cogging", "second-cogging"]
    second = found.findings[1].parameters["j1.second-cogging.p"].value
    assert second == pytest.approx(2.43 * plants.COGGING_ORDER, rel=1e-3)
    assert found.ladder[-1].heldout.rms[0] < 0.8 * found.ladder[1].heldout.rms[0]
    assert not any(code == "harmonic" for code, _ in found.warnings)


@pytest.mark.slow
def test_a_tight_spot_is_no_ripple_beside_its_friction() -> None:
    """Two harmonics of a period as long as the motion hardly make a step: the rest is no ripple."""
    train, other = (plants.cogging_axis(seed, 0.0, first=0.0, tight=0.6) for seed in (0, 1))
    for holdout in (None, [other]):
        found = diagnose([train], base_model(train.robot), holdout)
        assert [f.effect for f in found.findings] == ["position-friction"]
        assert any("of its position-friction" in text for _, text in found.warnings)
    most = max(found.network, key=lambda s: s.share)
    assert most.words == "its direction and its position in detail" and most.share > 0.5
