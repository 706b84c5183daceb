"""Laws that scale a state of friction, or an effort, beside those that make it."""

from __future__ import annotations

import numpy as np
import plants
import pytest

import hil
from hil.record.recording import Recording


def _cable(seed: int) -> Recording:
    """A weight behind a cable round a capstan: fc + mu |tau| as a sign and by bristles."""
    t = np.arange(30 * 500) / 500.0
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.array([0.1, 0.23, 0.5, 1.1]) * rng.uniform(0.9, 1.1, 4)
    q, v, a = plants.sines(t, w, 0.5 / w, rng.uniform(0, 2 * np.pi, 4))
    side = 0.5 * np.tanh(v / 2e-3) + 0.5 * plants.stuck(q, 0.01) / 0.01
    load = 4e-3 * a + 0.4 * np.cos(q) + 4e-3 * v
    tau = load
    for _ in range(60):  # tau = load + (fc + mu |tau|) side
        tau = load + (0.018 + 0.06 * np.abs(tau)) * side
    noise = 2e-3 * rng.standard_normal(t.size)
    return plants.single(f"run{seed}", t, q, tau + noise)


def test_a_written_model_foretells_what_its_fit_says() -> None:
    """The state that load friction scales is that of the bristles in the solution, no other one."""
    run, other = _cable(1), _cable(2)
    model = hil.base_model(run.robot) + "unbalance" + "presliding" + "load-friction"
    found = hil.fit(run, model)
    as_it_is = hil.fit(run, found.model.as_it_is())
    assert as_it_is.relative[0] == pytest.approx(found.relative[0], rel=0.03)
    assert hil.fit(other, found.model.as_it_is()).relative[0] < 1.5 * found.relative[0]
    assert found.values["j1.load-friction.mu"].value == pytest.approx(0.06, rel=0.1)
