"""Effects that take nearly the same: the search goes on from each, and held-out runs decide."""

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.candidates import Rated
from hil.diagnosis.grams import BlockErrors
from hil.diagnosis.naming import _judged_on


def _pendulum(seed, size, load=0.15, lean=0.12):
    """An axis of 0.07 kg m^2 with an eccentric mass; its friction grows with what it carries."""
    t = np.arange(5000) / 250
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * rng.uniform(0.1, 0.9, 8)
    heights = size * rng.normal(0.0, 0.5, 8) / np.sqrt(w)
    q, v, a = plants.sines(t, w, heights, rng.uniform(0.0, 2 * np.pi, 8))
    weight = 1.4 * np.sin(q)
    friction = (0.1 + load * np.abs(weight)) * np.tanh(v / 0.01) + 0.05 * v + lean * np.abs(v)
    tau = 0.07 * a + friction + weight + 0.005 * rng.normal(size=t.size)
    return plants.single(f"pendulum{seed}", t, q, tau, robot=plants.SINGLE)


def test_the_search_goes_on_from_an_effect_that_takes_nearly_as_much():
    """Over half a turn springs or stops take more at first than the mass that is there."""
    runs = [_pendulum(seed, 1.0, lean=0.0) for seed in (1, 2)]
    d = hil.diagnose(runs[:1], hil.base_model(runs[0].robot), runs[1:])
    assert d.first.candidates[0].name != "unbalance"
    assert {f.effect for f in d.findings} == {"unbalance", "load-friction"}
    assert min(f.confidence for f in d.findings) > 0.9
    values = {k: v.value for f in d.findings for k, v in f.parameters.items()}
    assert values["j1.unbalance.gs"] == pytest.approx(1.4, rel=0.02)
    assert d.ladder[-1].heldout.relative[0] < 1.0


@pytest.mark.slow
def test_held_out_runs_beyond_the_fitted_range_refute_a_law_that_only_follows_the_effect():
    runs = [_pendulum(3, 0.6, 0.0, 0.0), _pendulum(4, 1.2, 0.0, 0.0)]
    assert np.ptp(runs[1].q) > 1.9 * np.ptp(runs[0].q)
    alone = hil.diagnose(runs[:1], hil.base_model(runs[0].robot))
    beyond = hil.diagnose(runs[:1], hil.base_model(runs[0].robot), runs[1:])
    assert (
        [f.effect for f in alone.findings] == ["unbalance"] == [f.effect for f in beyond.findings]
    )
    assert not beyond.findings[0].rivals and beyond.findings[0].confidence > 0.9
    assert beyond.findings[0].confidence >= alone.findings[0].confidence


@pytest.mark.slow
def test_a_start_that_its_own_search_leaves_again_is_no_rival(monkeypatch):
    """Backward steps may take out the effect that a search started from."""
    from hil.diagnosis import search

    begun = search.Search.started

    def left(self, c, other):
        apart = begun(self, c, other)
        apart.found = [f for f in apart.found if f.name != other.name]
        return apart

    monkeypatch.setattr(search.Search, "started", left)
    run = _pendulum(1, 1.0, lean=0.0)
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert d.findings and len(d.ladder) > 1


def test_an_effect_of_the_robot_is_weighed_on_the_joint_of_its_name():
    """It takes most of the second joint's error, and nearly all of the first one's, too."""
    count = np.full((4, 2), 10.0)
    now = BlockErrors(np.array([[8.0, 4.0]] * 4), count)
    errors = BlockErrors(np.array([[1.0, 0.1]] * 4), count)
    there = Rated(
        None, now, errors, now.squared[:, 1] - errors.squared[:, 1], 0.4, 0.01, 1, len, len
    )
    here = _judged_on(there, 0)
    assert here.joint == 0 and here.removed == pytest.approx(0.7)
    assert list(here.fall) == [7.0] * 4
    assert _judged_on(there, 1) is there
