"""Masses that a run hardly determines come of the robot description, if that can be trusted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import plants
import pytest
from scipy.optimize import LinearConstraint, minimize

from hil.identify.fit import fit, predict
from hil.identify.problem import Problem
from hil.identify.regression import Nearness, basis
from hil.identify.solve import Pull, serves
from hil.models.model import base_model
from hil.record.recording import RobotSource


def fitted(seconds, wrong=0, seed=13, urdf="", d=3):
    run = plants.serial_arm(d, seed, wrong=wrong, seconds=seconds)
    if urdf:
        run = replace(run, robot=RobotSource("", urdf))
    return fit(Problem([run], run.robot), base_model(run.robot))


def elsewhere(result, wrong=0, seed=113):
    """Relative error [%] over the joints on another motion of the same arm."""
    run = plants.serial_arm(result.problem.d, seed, wrong=wrong, seconds=20.0)
    run = replace(run, robot=result.problem.recordings[0].robot)
    p = result.problem
    other = Problem([run], p.source, rates=p.rates, span=p.span)
    relative = 100 * other.rms(predict(result, other)) / other.rms(other.effort)
    return float(np.sqrt(np.mean(relative**2)))


def heavier(factor):
    """The same arm, its links described with other masses."""
    text = plants.serial_urdf(3)
    for k in (1, 2, 3):
        text = text.replace(f'mass value="{4 / k}"', f'mass value="{factor**k * 4 / k}"')
    return text


@pytest.mark.parametrize("wrong", [0, 3])
def test_a_short_run_foretells_other_motions(wrong):
    # least squares alone: 23 % here (3.5 % from half a minute)
    assert elsewhere(fitted(4.0, wrong), wrong) < 5.0


@pytest.mark.parametrize(("wrong", "low", "high"), [(0, 0.0, 0.011), (3, 0.015, 0.15)])
def test_the_error_of_the_description_is_found(wrong, low, high, monkeypatch):
    """The masses, centres and inertias are 5 % wrong, or right; whether that is needed or not."""
    monkeypatch.setattr("hil.identify.solve.serves", lambda *_: True)
    for seconds in (8.0, 30.0):
        assert low < fitted(seconds, wrong).pull.error <= high


def test_a_description_that_the_data_contradict_hardly_counts():
    right, wrong = (fitted(30.0, urdf=text) for text in ("", heavier(3.0)))
    assert wrong.pull is None or wrong.pull.error > 10 * right.pull.error
    assert elsewhere(wrong) < 1.1 * elsewhere(right)
    assert np.all(wrong.rms < 1.02 * right.rms)


def test_what_the_data_determine_hardly_moves():
    """Friction and base parameters of a long run lie within their errors of what is true."""
    result = fitted(30.0, wrong=3)
    for k in (1, 2, 3):
        v = result.values[f"j{k}.viscous.fv"]
        true = 0.1 * plants.SERIAL_FC[k - 1] / 3**0.5
        assert abs(v.value - true) < 4 * v.stderr
        assert v.source.startswith("fit of")


def test_rank_and_standard_errors_are_of_the_data_alone():
    result = fitted(4.0)
    assert result.basis.rank < len(result.theta)
    some = [result.values[n] for n in result.of_description()]
    assert some and any(not v.identifiable for v in some)
    assert all(np.isnan(v.stderr) for v in some if not v.identifiable)


def test_axes_without_a_description_are_fitted_as_ever():
    run = plants.smooth_axis(1, 10.0)
    result = fit(Problem([run], run.robot), base_model(run.robot))
    assert result.pull is None and not result.of_description()
    assert result.as_dict()["description"] is None


def test_the_answer_says_what_came_of_the_description():
    from hil.commands.fit import text

    result = fitted(4.0, wrong=3)
    said = result.as_dict()["description"]
    assert said["error"] == result.pull.error and said["parameters"] == result.of_description()
    printed = text(result)
    assert "come mostly from it" in printed and "mostly the robot description's" in printed


@pytest.mark.parametrize(
    ("factor", "count", "better"), [(1, 60, True), (-5, 60, False), (1, 3, False)]
)
def test_a_description_counts_only_where_it_foretells_parts_left_out(factor, count, better):
    """Many values for little data; a wrong description; and data that need none."""
    rng = np.random.default_rng(5)
    x, true = rng.standard_normal((400, count)), rng.standard_normal(count)
    target = x @ true + rng.standard_normal(400)
    pull = Pull(20.0 * np.eye(count), factor * true, 0.05)
    problem = SimpleNamespace(memo={}, n=400, d=1)
    assert serves(problem, pull, x, target) is better
    # decided once for a problem
    assert serves(problem, Pull(pull.rows, true, 0.05), x, target) is better


def test_rich_runs_are_fitted_by_themselves():
    assert fitted(30.0).pull is None


def test_a_description_serves_where_the_data_alone_foretell_one_joint_worse_than_nothing():
    """Though another joint, whose effort is far larger, is foretold a little better without it."""
    rng = np.random.default_rng(7)
    n, wide = 80, 66
    x = np.zeros((2 * n, wide + 1))
    x[:n, :wide], x[n:, wide] = rng.standard_normal((n, wide)), 100 * rng.standard_normal(n)
    true = np.append(0.02 * rng.standard_normal(wide), 1.0)
    target = x @ true + np.append(rng.standard_normal(n), 10 * rng.standard_normal(n))
    pull = Pull(np.diag(np.append(np.full(wide, 50.0), 300.0)), np.append(true[:wide], 0.9), 0.1)
    assert serves(SimpleNamespace(memo={}, n=n, d=2), pull, x, target)
    # the first joint's rows alone do not decide where they are foretold at all
    few = np.concatenate([x[:n, :2], x[n:, :2]]), np.concatenate([x[n:, wide:]] * 2)
    more = np.concatenate([few[0], np.where(np.arange(2 * n)[:, None] < n, 0.0, few[1])], axis=1)
    known = np.array([1.0, -1.0, 1.0])
    held = more @ known + np.append(0.1 * rng.standard_normal(n), 10 * rng.standard_normal(n))
    wrong = Pull(np.diag([1.0, 1.0, 300.0]), np.array([1.0, -1.0, 0.9]), 0.1)
    assert not serves(SimpleNamespace(memo={}, n=n, d=2), wrong, more, held)


@pytest.fixture(scope="module")
def geared():
    """An arm with rotors: near its first axis masses and rotors are one."""
    run = plants.cart_arm(1, tilt=(0.0, 0.0))
    return fit(Problem([run], run.robot), base_model(run.robot))


def bodies(result):
    """Values of the bodies (links, 10), and of the description."""
    where = result.slices[0]
    return result.theta[where].reshape(-1, 10), result.problem.robot.prior.reshape(-1, 10)


def test_masses_that_no_effort_shows_alone_are_near_the_description(geared):
    """A link of 1.8 kg whose axis lies 30 mm beside the first one had 40 kg and more."""
    got, said = bodies(geared)
    assert geared.pull is None
    open_masses = [not geared.values[f"rigid-body.joint{k}.m"].identifiable for k in (1, 2, 3, 4)]
    assert all(open_masses)
    assert np.all(got[:, 0] > 0.5 * said[:, 0]) and np.all(got[:, 0] < 2.0 * said[:, 0])
    # the rotor, of which nothing is known, takes what the links need not
    assert geared.values["j1.armature.ia"].value == pytest.approx(0.2, rel=0.1)


def test_a_fit_again_from_its_own_values_is_the_same(geared):
    """What the first fit left open says nothing; values of other data stand."""
    again = fit(geared.problem, geared.model)
    np.testing.assert_allclose(bodies(again)[0], bodies(geared)[0], rtol=1e-6, atol=1e-8)
    use = geared.model.effects[0]
    other = {
        n: replace(v, source="maker", value=v.value * (1.2 if n.endswith(".m") else 1.0))
        for n, v in use.values.items()
    }
    effects = (replace(use, values=other), *geared.model.effects[1:])
    told = fit(geared.problem, replace(geared.model, effects=effects))
    assert bodies(told)[0][0, 0] == pytest.approx(1.2 * bodies(geared)[1][0, 0])
    np.testing.assert_allclose(told.rms, geared.rms, rtol=1e-4)


def nearest_by_search(theta, null, near):
    """The same by a general optimiser."""
    tied = np.isfinite(near.low)
    found = minimize(
        lambda z: np.sum((near.metric @ (theta + null @ z - near.centre)) ** 2),
        np.zeros(null.shape[1]),
        constraints=[LinearConstraint(null[tied], (near.low - theta)[tied], np.inf)]
        if tied.any()
        else [],
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    return theta + null @ found.x


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("bounded", [False, True])
def test_the_nearest_of_all_that_fit_equally_well(seed, bounded):
    """Six of nine columns are independent; the last two have no description."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(60, 6)) @ rng.normal(size=(6, 9)) * 10.0 ** rng.uniform(-2, 2, 9)
    b = basis(x)
    theta, metric = rng.normal(size=9), np.hstack([rng.normal(size=(7, 7)), np.zeros((7, 2))])
    low = np.full(9, -np.inf)
    if bounded:
        low[8] = theta[8] - 0.01
    near = Nearness(metric, rng.normal(size=9), np.ones(9, bool), low, np.full(9, np.inf))
    got = near(theta, b)
    size = np.linalg.norm(x @ theta)
    assert np.linalg.norm(x @ (got - theta)) < 1e-9 * size and np.all(got >= low)
    null = np.linalg.svd(x / b.scale)[2][6:].T / b.scale[:, None]
    best = nearest_by_search(theta, null, near)
    distance = [np.linalg.norm(metric @ (v - near.centre)) for v in (theta, got, best)]
    assert distance[1] <= distance[0]
    assert distance[1] == pytest.approx(distance[2], rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_offsets_that_only_their_sum_knows_stay_where_a_body_comes_to_its_bound(seed):
    """What is left then moves no body but for rounding."""
    rng = np.random.default_rng(seed)
    body, offset = rng.normal(size=(2, 40, 1)) * 10.0 ** rng.uniform(-1, 3, (2, 1, 1))
    x = np.hstack([body, body, offset, offset])
    metric = np.hstack([np.diag([1.0, 0.1]), np.zeros((2, 2))])
    theta, low = np.array([1.0, 0.05, 0.3, -0.2]), np.array([-np.inf, 0.0, -np.inf, -np.inf])
    near = Nearness(metric, np.array([2.0, 0, 0, 0]), np.ones(4, bool), low, np.full(4, np.inf))
    np.testing.assert_allclose(near(theta, basis(x)), [1.05, 0.0, 0.3, -0.2], rtol=1e-9, atol=1e-12)


def test_what_no_row_sees_or_has_no_description_stays():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(40, 2)) @ rng.normal(size=(2, 5))
    x[:, 4] = 0.0
    moves, far = np.array([True, True, True, False, True]), np.full(5, np.inf)
    theta = rng.normal(size=5)
    got = Nearness(np.eye(5), np.zeros(5), moves, -far, far)(theta, basis(x))
    assert got[3] == theta[3] and got[4] == theta[4] and not np.allclose(got[:3], theta[:3])
    np.testing.assert_allclose(x @ got, x @ theta, atol=1e-9)
