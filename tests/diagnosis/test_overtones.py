"""A wave that repeats within another one is its harmonic, not a second effect."""

import numpy as np

from hil.diagnosis.engine import diagnose
from hil.models.model import base_model
from hil.record.recording import Recording

ORDER = 1.7


def axis(
    seed: int, third: float, other: float = 3 * ORDER, first: float = 0.03, tight: float = 0.0
) -> Recording:
    """A joint with cogging of one order, its third harmonic or another wave, and noise.

    `tight`: how much larger its dry friction is at one place.
    """
    rng, t = np.random.default_rng(seed), np.arange(10000) / 500.0
    w = 2 * np.pi * np.array([0.11, 0.37, 0.9]) * (1 + 0.07 * seed)
    angle, size = np.outer(t, w) + np.array([0.0, 1.0, 2.0]), np.array([0.9, 0.5, 0.15])
    q, v, a = (
        (size * x).sum(axis=1) for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
    )
    dry = 0.15 * (1 + tight * np.exp(-(((q - 0.4) / 0.25) ** 2)))
    effort = 0.02 * a + dry * np.tanh(v / 0.01) + 0.05 * v
    wave = first * np.sin(2 * np.pi * ORDER * q) + third * np.sin(2 * np.pi * other * q + 1.0)
    effort += wave + 0.004 * rng.standard_normal(t.size)
    return Recording(f"run{seed}", "arm", ("joint1",), t, q[:, None], effort[:, None])


def test_a_third_harmonic_is_no_second_name() -> None:
    train = axis(0, 0.008)
    found = diagnose([train], base_model(train.robot), [axis(1, 0.008)])
    assert [f.effect for f in found.findings] == ["cogging"]
    (text,) = (text for code, text in found.warnings if code == "harmonic")
    assert "repeats 3 times in a period of its cogging" in text


def test_a_wave_of_another_order_is_no_harmonic() -> None:
    train = axis(0, 0.008, 2.43 * ORDER)
    found = diagnose([train], base_model(train.robot), [axis(1, 0.008, 2.43 * ORDER)])
    # a function of the position does better than the second wave's nearest law: it gets no name
    assert [f.effect for f in found.findings] == ["cogging"]
    assert found.ladder[-1].heldout.rms[0] < 0.8 * found.ladder[1].heldout.rms[0]
    assert not any(code == "harmonic" for code, _ in found.warnings)


def test_a_tight_spot_is_no_ripple_beside_its_friction() -> None:
    """Two harmonics of a period as long as the motion hardly make a bump: the rest is no ripple."""
    train, other = (axis(seed, 0.0, first=0.0, tight=0.6) for seed in (0, 1))
    for holdout in (None, [other]):
        found = diagnose([train], base_model(train.robot), holdout)
        assert [f.effect for f in found.findings] == ["position-friction"]
        assert any("of its position-friction" in text for _, text in found.warnings)
    most = max(found.network, key=lambda s: s.share)
    assert most.words == "its direction and its position in detail" and most.share > 0.5
