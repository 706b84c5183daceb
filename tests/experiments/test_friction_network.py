"""The friction experiment says what theory and thesis say."""

import pytest

from hil.experiments import friction_network


@pytest.mark.slow
def test_a_network_alone_extrapolates_worse_than_on_a_backbone(monkeypatch):
    monkeypatch.setattr(friction_network, "random_sines", _short)
    rows = {r.model: r for r in friction_network.study(1)}
    plain, alone = rows["Coulomb + viscous"], rows["network alone, batch"]
    both = rows["network on Coulomb + viscous"]
    assert max(both.train) < 0.75 * min(plain.train)
    assert min(alone.validation) > max(plain.validation)
    assert max(both.validation) < min(alone.validation)


_full = friction_network.random_sines


def _short(seconds, seed, size=0.5):
    return _full(seconds / 3, seed, size)
