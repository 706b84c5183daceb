"""Wavelet friction network: admissible, the Lyapunov law, structure, batch."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.errors import FitError
from hil.experiments import friction_network
from hil.experiments.friction_network import random_sines, rub


@pytest.mark.parametrize("d", [1, 2, 3])
def test_the_mother_wavelet_is_admissible(d):
    ax = np.linspace(-8, 8, 61)
    x = np.stack(np.meshgrid(*[ax] * d, indexing="ij"), -1)
    h = (ax[1] - ax[0]) ** d
    psi = friction_network.mexican_hat(x)
    assert abs(psi.sum() * h) < 1e-9
    assert (psi**2).sum() * h == pytest.approx(1.0, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.05, 1.95), st.floats(0.0, 0.2))
def test_the_dead_zone_law_never_raises_v(seed, gain, zone):
    rng = np.random.default_rng(seed)
    true, c = rng.normal(size=6), rng.normal(size=6)
    v = ((true - c) ** 2).sum()
    for _ in range(60):
        x = rng.normal(size=(1, 6))
        tau = x @ true + rng.uniform(-zone, zone, 1)
        friction_network.learn_online(x, tau, c, zone, gain, 1e-3)
        now = ((true - c) ** 2).sum()
        assert now <= v + 1e-12
        v = now


def test_without_a_dead_zone_noise_can_raise_v():
    """The dead zone is what the proof needs."""
    rng = np.random.default_rng(0)
    true = rng.normal(size=6)
    c = true.copy()
    x = rng.normal(size=(50, 6))
    friction_network.learn_online(x, x @ true + 0.1, c, 0.0, 0.6, 1e-3)
    assert ((true - c) ** 2).sum() > 1e-4


def test_structure_adaptation_does_not_jump_and_keeps_its_budget():
    qd = random_sines(4.0, 1)
    tau = rub(qd)[:, 0]
    net = friction_network.ridge_weights(friction_network.coarse_network(qd, 0), qd, tau)
    grown = friction_network.adapt_online(net, qd, add=1e-3, remove=0.0, budget=80)
    assert len(net.nodes) < len(grown.nodes) <= 80
    np.testing.assert_allclose(grown.predict(qd), net.predict(qd), atol=1e-12)
    assert grown.zone == net.zone
    cut = friction_network.adapt_online(grown, qd, add=1.0, remove=0.5)
    assert {m for m, _ in cut.nodes} == {-1}
    assert cut.zone >= grown.zone
    with pytest.raises(FitError, match="below add"):
        friction_network.adapt_online(net, qd, 0.1, 0.2)


def test_on_line_learning_approaches_the_batch_solution():
    """With the dead zone the error falls pass by pass; without it the last samples win."""
    qd = random_sines(20.0, 1)
    tau = rub(qd)[:, 1]
    batch = friction_network.relative_error(
        friction_network.ridge_weights(friction_network.coarse_network(qd, 1), qd, tau), qd, tau
    )
    last = {}
    for zone in (0.0, 0.005):
        net, errors = friction_network.coarse_network(qd, 1, zone=zone), []
        for _ in range(4):
            net = friction_network.train(net, qd, tau)
            errors.append(friction_network.relative_error(net, qd, tau))
        last[zone] = errors
    assert (np.diff(last[0.005]) < 0).all()
    assert batch <= last[0.005][-1] < 1.3 * batch
    assert last[0.0][-1] > last[0.005][-1]


def test_no_data_no_network():
    net = friction_network.Network(np.ones(3))
    with pytest.raises(FitError, match="two samples"):
        friction_network.ridge_weights(net, np.zeros((1, 3)), np.zeros(1))
