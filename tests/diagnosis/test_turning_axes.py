"""Axes that turn through many revolutions: cranks, cams, and what their motors feel of them."""

import numpy as np
import plants
import pytest

import hil
from hil.models import catalogue
from hil.models.effect import refused

TURNS = np.array([6.0, 2.5, 0.9, 0.4, 0.12])
TONES = 2 * np.pi * np.array([0.05, 0.13, 0.31, 0.57, 1.1])


def turning_axis(seed, effort, seconds=20.0, rate=250.0):
    """One axis over some five turns: inertia 0.02, Coulomb 0.05, viscous 0.02; and `effort`."""
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * rate)) / rate
    q, v, a = plants.sines(t, TONES, TURNS, rng.uniform(0, 6.28, TONES.size))
    tau = 0.02 * a + 0.05 * np.tanh(v / 0.02) + 0.02 * v + effort(q, v, a)
    tau += 0.003 * rng.normal(size=t.size)
    return plants.single(f"axis{seed}", t, q, tau, robot=plants.SINGLE)


def crank(q, v, a):
    """A slider of 2 kg on a crank of 50 mm and a rod of 150 mm."""
    r, rod, m = 0.05, 0.15, 2.0

    def lever(x):
        s = np.sin(x)
        return -r * s - r * r * s * np.cos(x) / np.sqrt(rod**2 - (r * s) ** 2)

    slope = (lever(q + 1e-5) ** 2 - lever(q - 1e-5) ** 2) / 2e-5
    return m * lever(q) ** 2 * a + m * slope / 2 * v**2


def cam(q, v, a):
    """A follower's spring on a cam with a flank: many harmonics of one turn."""
    return 0.2 * np.exp(-6.0 * (1 - np.cos(q - 0.7))) * np.sin(q - 0.7) * 8.0


def diagnosed(effort):
    run, hold = (turning_axis(seed, effort) for seed in (1, 2))
    return hil.diagnose([run], hil.base_model(run.robot), [hold])


@pytest.mark.slow
def test_a_crank_has_its_name_and_its_inertia():
    d = diagnosed(crank)
    assert [f.effect for f in d.findings] == ["variable-inertia"]
    assert d.findings[0].confidence > 0.9
    values = {k.rpartition(".")[2]: v.value for k, v in d.findings[0].parameters.items()}
    assert values["p"] * 2 * np.pi == pytest.approx(1.0, abs=0.01)
    # m g^2 = m r^2 (1 - cos 2q) / 2 + ..
    assert np.hypot(values["a2"], values["b2"]) == pytest.approx(2.0 * 0.05**2 / 2, rel=0.1)
    assert d.ladder[-1].heldout.relative[0] < d.ladder[0].heldout.relative[0] / 10


@pytest.mark.slow
def test_what_a_cam_costs_is_a_function_of_the_angle_within_a_turn():
    d = diagnosed(cam)
    assert "correction-turn" in {c.effect for c in d.corrections}
    assert d.ladder[-1].heldout.relative[0] < d.ladder[0].heldout.relative[0] / 8
    # the floor does not hold the harmonics that no name has
    assert d.noise[0] < 2 * d.ladder[-1].heldout.rms[0]


@pytest.mark.parametrize("seed", [1, 2])
def test_an_axis_that_turns_and_lacks_nothing_is_adequate(seed):
    run = turning_axis(seed, lambda q, v, a: 0.0)
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert d.verdict == "adequate" and not d.findings and not d.corrections


class _Of:
    """A model whose inertia is known."""

    def __init__(self, inertia):
        self.inertia = np.full((400, 1, 1), inertia)


@pytest.mark.parametrize(("inertia", "none"), [(1.0, True), (1.3, False)])
def test_an_inertia_stays_above_zero(inertia, none):
    from hil.testing.effects import sample_motions

    motion = next(m for what, m in sample_motions(400) if "several turns" in what)
    seen = motion.with_(response=_Of(inertia))
    beta = (0.0, 1.2, 0.0, 0.0, 0.0, 0.0)
    effect = catalogue.get("variable-inertia")
    assert bool(refused(effect, seen, 0, (1 / (2 * np.pi),), beta, ())) == none


@pytest.mark.slow
def test_a_gear_that_grinds_nine_times_a_turn_is_named_over_ten_turns():
    """Ninety periods over the range, beside a weight whose rope winds up: both have their names."""
    d = diagnosed(lambda q, v, a: 0.05 * q + 0.03 * np.sin(9 * q + 1.0))
    assert d.verdict == "missing-effect"
    assert [(f.effect, f.rivals) for f in d.findings] == [("spring", []), ("cogging", [])]
    values = d.findings[1].parameters
    assert values["j1.cogging.p"].value * 2 * np.pi == pytest.approx(9.0, abs=0.01)
