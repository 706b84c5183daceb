"""A joint that is stopped at both ends of its range, by other laws than those of the catalogue."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import plants
import pytest

import hil

Law = Callable[[np.ndarray], np.ndarray]


def _cushions(q: np.ndarray) -> np.ndarray:
    """They stiffen exponentially from -0.3 and 0.4 on."""
    return 3.0 * np.expm1(np.maximum(0.0, q - 0.4)) - 2.1 * np.expm1(np.maximum(0.0, -0.3 - q))


def _rubber(q: np.ndarray) -> np.ndarray:
    """Spheres against a plane, from -0.7 and 0.9 on: Hertz' exponent of 1.5."""
    return 8.0 * np.maximum(0.0, q - 0.9) ** 1.5 - 4.8 * np.maximum(0.0, -0.7 - q) ** 1.5


@pytest.mark.parametrize(
    ("law", "ends"),
    [
        pytest.param(_cushions, (-0.3, 0.4), marks=pytest.mark.slow, id="cushions"),
        pytest.param(_rubber, (-0.7, 0.9), id="rubber"),
    ],
)
@pytest.mark.slow
def test_stops_at_both_ends_are_one_effect(law: Law, ends: tuple[float, float]) -> None:
    train, other = (plants.smooth_axis(k, extra=lambda t, q, v, a: law(q)) for k in (3, 4))
    d = hil.diagnose([train], hil.base_model(train.robot), [other])
    (found,) = d.findings
    assert found.effect == "two-stops" and found.confidence > 0.9
    values = {k.rsplit(".")[-1]: v.value for k, v in found.parameters.items()}
    assert (values["q1"], values["q0"]) == pytest.approx(ends, abs=0.1)
    last = d.ladder[-1].heldout.rms
    assert np.all(last < 0.015 * d.ladder[0].heldout.rms)


def test_a_stop_at_one_end_is_one() -> None:
    runs = [
        plants.smooth_axis(k, extra=lambda t, q, v, a: _rubber(np.maximum(q, 0.0))) for k in (3, 4)
    ]
    d = hil.diagnose(runs[:1], hil.base_model(runs[0].robot), runs[1:])
    assert [f.effect for f in d.findings] == ["end-stop"]
