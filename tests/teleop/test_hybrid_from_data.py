"""Estimated hybrid matrix against the analytic one; a session of the rig too."""

import numpy as np
import pytest
from teleop_designs import anchor

from hil.errors import DataError
from hil.experiments import transparency
from hil.teleop import architecture, hybrid, sampled_loop
from hil.teleop.architecture import Realisation
from hil.teleop.hybrid import Experiment, Impedance
from hil.teleop.sampled_loop import Axis, SampledLoop

T, PERIODS, N = 1e-3, 6, 1000
HARMONICS = (1, 2, 5)
LOOP = SampledLoop(anchor(), Realisation(80, 30, 60))


def run(ze, seed, noise=1.0):
    """Sampled loop under a multisine of operator's force, after its transient, with noise."""
    axis = Axis(LOOP, Impedance(0.4, 6.0, 150.0), ze, T)
    a, b = axis.matrix(), axis.advance(np.zeros(axis.size), 1.0)
    t = np.arange((PERIODS + 4) * N) * T
    push = sum(np.sin(2 * np.pi * h * t + h) for h in HARMONICS)
    z, out = np.zeros(axis.size), []
    for k in range(t.size):
        vm, vs = axis.speeds(z)
        out.append([vm, axis.ports(z, push[k])[0], vs, axis.ports(z, push[k])[1]])
        z = a @ z + b * push[k]
    signals = np.array(out[-PERIODS * N :])
    rng = np.random.default_rng(seed)
    signals += noise * rng.normal(size=signals.shape) * [2e-3, 0.02, 2e-3, 0.02]
    return Experiment(*signals.T, PERIODS, T)


@pytest.fixture(scope="module")
def clean():
    return [run(z, 0, 0.0) for z in (Impedance(), Impedance(0, 1.5, 300), Impedance(0, 3, 600))]


def noisy(clean, seed):
    rng = np.random.default_rng(seed)
    out = []
    for e in clean:
        parts = np.stack([e.vm, e.fm, e.vs, e.fs], 1)
        parts = parts + rng.normal(size=parts.shape) * [2e-3, 0.02, 2e-3, 0.02]
        out.append(Experiment(*parts.T, PERIODS, T))
    return out


@pytest.mark.parametrize("harmonic", HARMONICS)
def test_without_noise_it_is_the_analytic_matrix(clean, harmonic):
    found = hybrid.estimate_hybrid(clean, harmonic)
    goal = sampled_loop.hybrid_at(LOOP, np.array([found.w]), T)[0]
    # a sampled loop is a two-port but for the hold of its terminations: a percent or so
    np.testing.assert_allclose(found.h, goal, atol=5e-3 * np.abs(goal).max())
    assert (np.abs(found.h - goal) < 0.02 * np.maximum(np.abs(goal), [[1, 1], [1, 0.01]])).all()


def test_with_noise_the_error_is_what_the_uncertainty_says(clean):
    scores, goal = [], hybrid.estimate_hybrid(clean, 2).h
    for seed in range(30):
        found = hybrid.estimate_hybrid(noisy(clean, seed), 2)
        scores.append(np.abs(found.h - goal) / found.std)
    scores = np.array(scores)
    # |error|^2 / variance has mean 1
    assert 0.6 < np.mean(scores**2) < 1.8
    assert np.mean(scores < 3) > 0.97


def test_one_environment_does_not_determine_h(clean):
    with pytest.raises(DataError, match="not identifiable; add a run"):
        hybrid.estimate_hybrid([clean[1], clean[1]])
    with pytest.raises(DataError, match="not identifiable"):
        hybrid.estimate_hybrid([clean[1]])
    with pytest.raises(DataError, match="whole periods"):
        Experiment(*np.zeros((4, 1001)), 2, T)


def test_sessions_of_the_rig_show_the_predicted_matrix(tmp_path):
    """Published parameters, friction not compensated: it stays within h11."""
    given, axes = transparency.arm_parameters({}, {})
    wish = {"stiffness": 300.0, "damping": 1.2, "share": 0.5, "master_damping": 0.5}
    from hil.teleop import law_parameters, rig_designs

    law = given | law_parameters.law_table(rig_designs.axis_designs("position-force", wish, axes))
    assert "position-force" in architecture.DESIGNS
    rows = {r.entry: r for r in transparency.compare_hybrid("pf", law, (2.0,), tmp_path, 1)}
    assert rows["h12"].error < 0.05
    assert rows["h21"].error < 0.05
    assert rows["h22"].error < 0.05
    assert rows["h11"].error < 0.3


def test_data_that_are_no_experiment_are_told():
    rows = dict.fromkeys(("vm", "fm", "vs", "fs"), np.arange(100.0))
    with pytest.raises(DataError, match=r"fm has shape \(80,\) and vm \(100,\)"):
        Experiment(**{**rows, "fm": np.ones(80)}, periods=2, period=1e-3)
    with pytest.raises(DataError, match="vs has 100 of 100 samples that are no finite number"):
        Experiment(**{**rows, "vs": np.full(100, np.nan)}, periods=2, period=1e-3)
    with pytest.raises(DataError, match="no experiment: two at least"):
        hybrid.estimate_hybrid([])
