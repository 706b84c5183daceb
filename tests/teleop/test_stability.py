"""Passivity, absolute stability and bounded environments against sampling of the boundary."""

import numpy as np
import pytest

from hil.teleop import hybrid, passivity

RNG = np.random.default_rng(7)
N = 4000


def random_hybrids(n=N):
    h = RNG.normal(size=(n, 2, 2)) + 1j * RNG.normal(size=(n, 2, 2))
    h[:, 0, 0] += 2.0 * RNG.uniform(size=n)
    h[:, 1, 1] += 2.0 * RNG.uniform(size=n)
    return h


def test_the_disc_test_agrees_with_its_boundary():
    h = random_hybrids()
    centre = RNG.uniform(0, 2, N) + 1j * RNG.uniform(-1, 1, N)
    radius = RNG.uniform(0.05, 1, N)
    found = passivity.disc(h, centre, radius)
    edge = centre[:, None] + radius[:, None] * np.exp(1j * np.linspace(0, 2 * np.pi, 721))
    sampled = hybrid.transmitted(h[:, None], edge).real.min(1)
    pole = -1 / h[:, 1, 1]
    inside = np.abs(pole - centre) < radius
    np.testing.assert_array_equal(np.isneginf(found), inside)
    clear = ~inside & (np.abs(np.abs(pole - centre) - radius) > 0.02)
    assert clear.sum() > 2000
    assert (found[clear] <= sampled[clear] + 1e-9).all()
    assert np.mean((found[clear] >= 0) == (sampled[clear] >= 0)) > 0.999


def test_an_ideal_force_channel_does_not_break_the_disc():
    h = np.array([[[1.0 + 0j, 0.5], [-1.0, 0.0]]])
    np.testing.assert_allclose(passivity.disc(h, 3.0, 1.0), [1.0 + 0.5 * 3 - 0.5])


@pytest.mark.slow
def test_the_half_disc_is_the_smallest_on_its_boundary():
    h, size = random_hybrids(), RNG.uniform(0.2, 5.0, N)
    y = np.linspace(-1, 1, 1501)
    edge = size[:, None] * np.concatenate([1j * y, np.exp(0.5j * np.pi * y)])
    sampled = hybrid.transmitted(h[:, None], edge).real.min(1)
    found = passivity.half_disc(h, size)
    pole = -1 / h[:, 1, 1]
    np.testing.assert_array_equal(np.isneginf(found), (pole.real >= 0) & (np.abs(pole) <= size))
    near = np.minimum(np.abs(pole.real), np.abs(np.abs(pole) - size))
    clear = np.isfinite(found) & (near > 0.1)
    assert clear.sum() > 2000
    assert (found[clear] <= sampled[clear] + 1e-9).all()
    np.testing.assert_allclose(found[clear], sampled[clear], atol=1e-2)


def test_llewellyn_is_the_half_disc_without_bound():
    h = random_hybrids()
    margin = passivity.llewellyn(h)
    half = passivity.half_disc(h, 1e5)
    clear = np.abs(margin) > 0.02
    assert clear.sum() > 2000
    # Re h11 >= 0 and Re h22 >= 0 belong to the criterion
    assert np.mean((margin[clear] > 0) == (half[clear] > 0)) > 0.998


def test_absolute_stability_is_reflections_below_one():
    h = random_hybrids()
    clear = np.abs(passivity.llewellyn(h)) > 1e-3
    mu = passivity.mu(h, 1.3)
    np.testing.assert_array_equal(mu[clear] >= 1, passivity.llewellyn(h)[clear] > 0)


def reflections(h, b, ge):
    s = passivity.scattering(h, b)[:, None]
    return s[..., 0, 0] + s[..., 0, 1] * s[..., 1, 0] * ge / (1 - s[..., 1, 1] * ge)


def test_mu_is_the_radius_of_the_stable_reflections():
    h, rho = random_hybrids(), RNG.uniform(0.1, 1.0, N)
    ge = rho[:, None] * np.exp(1j * np.linspace(0, 2 * np.pi, 721))
    s = passivity.scattering(h, 0.8)
    worst = np.abs(reflections(h, 0.8, ge)).max(1)
    stable = (worst <= 1) & (np.abs(s[:, 1, 1]) * rho < 1)
    mu = passivity.mu(h, 0.8)
    clear = (np.abs(mu - rho) > 0.01) & (np.abs(worst - 1) > 0.01)
    np.testing.assert_array_equal((mu >= rho)[clear], stable[clear])


def test_the_stability_circle_is_where_the_reflection_is_one():
    h = random_hybrids(300)
    centre, radius, outside = passivity.stability_circle(h, 0.8)
    edge = centre[:, None] + radius[:, None] * np.exp(1j * np.linspace(0, 6, 40))
    size = np.abs(reflections(h, 0.8, edge))
    assert np.median(np.abs(size - 1)) < 1e-9
    point = RNG.uniform(-0.5, 0.5, 300) + 1j * RNG.uniform(-0.5, 0.5, 300)
    stable = np.abs(reflections(h, 0.8, point[:, None]))[:, 0] < 1
    fine = np.array([passivity.admissible(h[i : i + 1], 0.8, point[i], 0.0)[0] for i in range(300)])
    assert outside.shape == (300,)
    np.testing.assert_array_equal(fine > 0, stable)


def test_passivity_is_the_sign_of_the_dissipated_power():
    h = random_hybrids(500)
    least = passivity.is_passive(h)
    x = RNG.normal(size=(500, 2000, 2)) + 1j * RNG.normal(size=(500, 2000, 2))
    g = ((np.abs(h[:, 1, 1]) / np.abs(h[:, 0, 0])) ** 0.25)[:, None]
    scaled = x * np.stack([g, 1 / g], -1)
    power = np.einsum("nki,nij,nkj->nk", np.conj(scaled), h, scaled).real
    power /= (np.abs(x) ** 2).sum(-1)
    assert (2 * power.min(1) >= least - 1e-9).all()
    np.testing.assert_allclose(2 * power.min(1), least, atol=0.15)


def test_two_position_controlled_masses_are_passive_and_two_channels_are_not():
    from hil.teleop import architecture

    h = hybrid.hybrid(architecture.named_design("position-error"), hybrid.jw())
    assert passivity.llewellyn(h).min() > -1e-9
    h = hybrid.hybrid(architecture.named_design("position-force"), hybrid.jw())
    assert passivity.llewellyn(h).min() < -0.1
