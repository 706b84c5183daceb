"""Of laws that explain as much, the one that leaves the masses as described is named."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis import naming
from hil.diagnosis.attribution import Named, described_odds
from hil.diagnosis.constants import HALF
from hil.diagnosis.remodel import Visited
from hil.diagnosis.types import Candidate, Step
from hil.identify.design import Term
from hil.models import catalogue
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


def off_by_two_percent(run):
    """The run with a description whose masses are 2 % too large and too small in turn."""
    share = itertools.cycle((1.02, 0.98))
    urdf = re.sub(
        r'mass value="([0-9.e+-]+)"',
        lambda m: f'mass value="{float(m[1]) * next(share)}"',
        run.robot.urdf,
    )
    return replace(run, robot=replace(run.robot, urdf=urdf))


@pytest.mark.slow
def test_of_two_gains_whose_ratio_alone_is_known_one_is_named():
    """Both had been named at 1.00, the one that nobody hid with 0.001."""
    runs = []
    for seed in (1, 2):
        run = off_by_two_percent(plants.planar(seed, seconds=12.0))
        tau = run.tau * [1.0, 1.15]
        noise = np.random.default_rng(seed).normal(size=tau.shape)
        runs.append(replace(run, tau=tau + 0.02 * np.std(tau, axis=0) * noise))
    answer = hil.diagnose(runs[0], hil.base_model(runs[0].robot), runs[1])
    (found,) = answer.findings
    assert (found.effect, found.joint, found.rivals) == ("torque-gain", "elbow", [])
    assert found.parameters["j2.torque-gain.g"].value == pytest.approx(0.15, abs=0.01)
    # the masses take it on its own joint, and the other one tells of it
    assert found.felt_on == "shoulder" and found.relative_after < HALF * found.relative_before


@pytest.mark.parametrize(
    ("odds", "rise", "taken"), [(-8.0, 1.0, True), (-3.0, 1.0, False), (-8.0, 1.1, False)]
)
def test_a_rival_that_leaves_the_masses_as_described_takes_the_place(
    monkeypatch, odds, rise, taken
):
    """Of two gains the one beside which a link had to be another one was named, at 0.5."""

    def candidate(j):
        term = Term(catalogue.get("torque-gain"), j, ())
        return Candidate(term, 1.0, 1.0)

    def rung(scale):
        errors = SimpleNamespace(power=scale * np.ones(2))
        held = SimpleNamespace(rms=scale * np.ones(2))
        return SimpleNamespace(errors=errors, step=SimpleNamespace(heldout=held), result=None)

    mine, rival = candidate(0), candidate(1)
    exchanged = []
    search = SimpleNamespace(now=rung(1.0), refused=set(), moves=[0, 1], problem=None)
    monkeypatch.setattr(naming, "_in_place", lambda *_: rung(rise))
    monkeypatch.setattr(naming, "described_odds", lambda *_: [odds])
    monkeypatch.setattr(naming.rules, "fails", lambda *_: None)
    monkeypatch.setattr(naming, "_exchanged", lambda *of: exchanged.append(of[2]))
    monkeypatch.setattr(naming, "physical", lambda *_: True)
    rated = [SimpleNamespace(candidate=rival, joint=1)]
    other = naming._as_described(search, Named(mine, 0.5, [rival]), rated)
    assert (other is not None) is taken is bool(exchanged)
    if taken:  # what either does is one thing, felt where it was
        assert other.term is rival.term and other.joint == mine.joint


def test_what_an_exchanged_law_explains_is_what_the_one_before_it_did(monkeypatch):
    """Load friction that had explained most counted for the little that its exchange gained."""
    names = ("spring", "unbalance", "position-torque")
    one, two, three = (Candidate(Term(catalogue.get(n), 0, ()), 1.0, 1.0) for n in names)
    problem = SimpleNamespace(joints=("joint1",))
    search = SimpleNamespace(
        found=[one], rungs=[], refused=set(), stands_for={}, problem=problem, moves=[0]
    )
    monkeypatch.setattr(naming, "renew", lambda result: None)
    for before, after in ((one, two), (two, three)):
        rung = Visited(Step("", None, None), None, ())
        naming._exchanged(search, before, after, rung)
    assert search.found == [three] and [r.added for r in search.rungs] == [(two,), (three,)]
    assert search.stands_for[three.term.key] == search.stands_for[two.term.key] == one.term.key
