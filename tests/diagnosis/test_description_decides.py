"""Of laws that explain as much, the one that leaves the masses as described is named."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.attribution import Named, described_odds
from hil.record.recording import RobotSource

#: Weight times distance of its centre [N m], inertia about the pivot [kg m^2], spring [N m/rad].
WEIGHT, INERTIA, SPRING = 0.8, 0.02, 0.5


def pendulum(mass: float) -> str:
    """A pendulum whose true mass is 0.40775 kg, described with another one."""
    return (
        '<robot name="pendulum"><link name="base"/><link name="rod"><inertial>'
        f'<origin xyz="0 0 -0.2"/><mass value="{mass}"/>'
        '<inertia ixx="0.0037" iyy="0.00369" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial>'
        '</link><joint name="joint1" type="continuous"><parent link="base"/><child link="rod"/>'
        '<axis xyz="0 1 0"/></joint></robot>'
    )


def swung(mass: float = 0.40775):
    """Half a minute of a pendulum with a spring about 0.2 rad."""
    rng, t = np.random.default_rng(1), np.arange(7500) / 250
    tones = 2 * np.pi * np.array([0.11, 0.31, 0.73]), np.array([0.4, 0.25, 0.15])
    q, v, a = plants.sines(t, *tones, rng.uniform(0, 6, 3))
    tau = INERTIA * a + WEIGHT * np.sin(q) + 0.05 * np.tanh(v / 0.005) + 0.02 * v
    tau += SPRING * (q - 0.2) + 0.002 * rng.standard_normal(t.size)
    return plants.single("swing", t, q, tau, robot=RobotSource("", pendulum(mass)))


@pytest.fixture(scope="module")
def run():
    return swung()


@pytest.mark.slow
def test_a_spring_is_named_and_no_wrong_ratio_of_the_position(run):
    answer = hil.diagnose(run, hil.base_model(run.robot))
    (found,) = answer.findings
    assert (found.effect, found.rivals) == ("spring", [])
    assert found.confidence > 0.95
    assert found.parameters["j1.spring.k"].value == pytest.approx(SPRING, rel=0.02)


def test_how_much_less_the_masses_must_be_changed_is_what_counts(run):
    model = hil.base_model(run.robot)
    spring, ratio = (hil.fit(run, model + name) for name in ("spring", "joint-ratio"))
    (odds,) = described_odds(spring, [ratio])
    assert odds > 3.0
    assert described_odds(ratio, [spring]) == pytest.approx([-odds])
    # a description that neither fits says less
    other = swung(0.8)
    one, two = (hil.fit(other, hil.base_model(other.robot) + n) for n in ("spring", "joint-ratio"))
    assert abs(described_odds(one, [two])[0]) < odds - 2.0


def test_odds_weigh_the_rivals_both_ways():
    ours, one, other = (SimpleNamespace(name=n) for n in ("ours", "one", "other"))
    named = Named(ours, 0.5, [one, other], [(0.3, 0.2), (0.2, 0.1)], (0.5, 0.6))
    against = named.told([np.log(0.25), 50.0])  # one is four times as likely as before
    assert against.rivals == [one]
    # which of two is named, the search decides: a likelier rival leaves it undecided
    assert against.own == (0.5, 0.5) and against.confidence == 0.5
    assert against.odds[0] == pytest.approx((4 * 0.3 / 1.7, 4 * 0.2 / 1.5))
    # what is no listed rival keeps its weight
    alone = named.told([50.0, 50.0])
    assert not alone.rivals and alone.own == pytest.approx((1.0, 0.6 / 0.7))


def test_without_a_description_nothing_is_said(run):
    bare = replace(run, robot=RobotSource())
    model = hil.base_model(bare.robot)
    one, two = (hil.fit(bare, model + name) for name in ("spring", "unbalance"))
    assert described_odds(one, [two]) == [0.0] and described_odds(one, []) == []
