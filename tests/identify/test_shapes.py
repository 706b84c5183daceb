"""Variable projection equals refitting everything."""

from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.identify import gauss_newton, shape_search
from hil.identify.design import Term, bind, stack
from hil.identify.fit import fit
from hil.identify.problem import Problem, of_model
from hil.identify.projector import Projector
from hil.identify.shape_search import best_shape
from hil.models import catalogue
from hil.models.disturbance import CLOCK, OWN_MOTION
from hil.models.effect import continuous
from hil.models.model import RobotModel, Use, Value, base_model
from hil.record.recording import RobotSource

SOURCE = RobotSource("phantom-premium-1.5")
# without armature, which is one with pi1, pi5 and pi6
BASE = RobotModel(SOURCE, tuple(Use(name) for name in ("rigid-body", "coulomb", "viscous")))


@pytest.fixture(scope="module")
def setting() -> tuple[Problem, list[Term], np.ndarray]:
    problem = Problem([plants.slow_axes(0)], SOURCE)
    terms = [
        t if t.shape or not t.effect.shape else t.reshaped((0.02,)) for t in bind(BASE, problem)
    ]
    # small scales, so that no direction of the base is left out
    return problem, terms, 1e-4 * np.std(problem.y, axis=1)


def brute_force(problem: Problem, terms: list[Term], sigma: np.ndarray) -> tuple[float, np.ndarray]:
    x, _ = stack(problem, terms)
    w = np.repeat(1.0 / sigma, problem.n)
    size = np.linalg.norm(x * w[:, None], axis=0)
    y = problem.y.reshape(-1) * w
    theta, _, rank, _ = np.linalg.lstsq(x * w[:, None] / size, y, rcond=1e-13)
    assert rank == x.shape[1]
    r = y - x * w[:, None] / size @ theta
    return float(r @ r), theta / size


@pytest.mark.parametrize(
    ("name", "j", "shape"),
    [
        ("asymmetric-viscous", 1, ()),
        ("spring", 0, ()),
        ("stribeck", 2, (0.2, 2.0)),
        ("cogging", 1, (2.0,)),
        ("coupled-friction", 0, (2.0, 0.0)),
        ("coupled-transmission", 0, (3.0, -1.0)),
    ],
)
def test_gain_is_the_fall_of_a_complete_refit(
    setting: tuple[Problem, list[Term], np.ndarray], name: str, j: int, shape: tuple[float, ...]
) -> None:
    problem, terms, sigma = setting
    effect = catalogue.get(name)
    term = Term(effect, j, shape[: len(effect.shape)])
    projector = Projector(problem, terms, sigma)
    before, _ = brute_force(problem, terms, sigma)
    assert projector.rss == pytest.approx(before, rel=1e-9)
    after, theta = brute_force(problem, [*terms, term], sigma)
    gain, beta, inverse, qc = projector.score(term)
    assert abs(gain - (before - after)) <= 1e-9 * before
    np.testing.assert_allclose(beta, theta[-beta.size :], rtol=1e-6)
    assert inverse.shape == (beta.size, beta.size) and qc.shape[1] == beta.size


def test_gain_of_what_the_base_holds_already_is_nothing(
    setting: tuple[Problem, list[Term], np.ndarray],
) -> None:
    problem, terms, sigma = setting
    projector = Projector(problem, terms, sigma)
    again = Term(catalogue.get("viscous"), 1)
    assert abs(projector.gain(again)) < 1e-9 * projector.rss
    # the arm's eight parameters hold any mass at its tip
    assert abs(projector.gain(Term(catalogue.get("payload"), 0))) < 1e-6 * projector.rss


def test_gain_beside_no_base_is_plain_regression(
    setting: tuple[Problem, list[Term], np.ndarray],
) -> None:
    problem, _, sigma = setting
    term = Term(catalogue.get("viscous"), 0)
    projector = Projector(problem, [], sigma)
    after, _ = brute_force(problem, [term], sigma)
    assert projector.gain(term) == pytest.approx(projector.rss - after, rel=1e-9)


@pytest.mark.parametrize("vs", [0.05, 0.12])
def test_stribeck_speed_is_found(vs: float) -> None:
    problem = Problem([plants.slow_axes(3, vs)], SOURCE)
    effect = catalogue.get("stribeck")
    result = fit(problem, BASE + Use("stribeck", ("joint2",)))
    term = next(t for t in result.terms if t.effect is effect)
    assert term.shape[0] == pytest.approx(vs, rel=0.35)
    # peak, its exponent and the sharpness of the sign trade off; the friction curve does not
    part = {k.removeprefix("j2."): v.value for k, v in result.values.items()}
    v = vs * np.array([1.0, 1.5, 2.0, 4.0])
    peak = part["stribeck.fs"] * np.exp(-((v / part["stribeck.vs"]) ** part["stribeck.n"]))
    found = (part["coulomb.fc"] + peak) * np.tanh(v / part["coulomb.v0"])
    true = 0.2 * np.tanh(v / 0.02) + 0.15 * np.exp(-((v / vs) ** 2))
    np.testing.assert_allclose(found, true, rtol=0.2)


def test_refinement_is_at_least_as_good_as_the_grid(
    setting: tuple[Problem, list[Term], np.ndarray],
) -> None:
    problem, terms, sigma = setting
    projector = Projector(problem, terms, sigma)
    for name in ("stribeck", "presliding", "cogging", "end-stop"):
        term = Term(catalogue.get(name), 1)
        found, gain = best_shape(projector, term)
        _, coarse = best_shape(projector, term, refine=False)
        grid = term.effect.search.grid(problem.motions[0], 1)
        low, high = min(s[0] for s in grid), max(s[0] for s in grid)
        assert gain >= coarse
        assert gain == pytest.approx(projector.gain(found))
        assert low <= found.shape[0] <= high


@pytest.mark.parametrize("by_motion", [False, True])
@pytest.mark.parametrize("time", [8.2, 10.5, 13.0])
def test_each_law_of_an_effect_is_held_against_the_others_at_its_own_maximum(
    time: float, by_motion: bool
) -> None:
    """On a grid the one that happens to have a value nearby would be taken."""
    run = plants.heated_axis(time, by_motion)
    problem = Problem([run], run.robot)
    result = fit(problem, base_model(run.robot) + Use("friction-drift", ("joint1",)))
    drift = next(t for t in result.terms if t.effect.name == "friction-drift")
    assert drift.shape[1] == (OWN_MOTION if by_motion else CLOCK)
    assert drift.shape[0] == pytest.approx(time, rel=0.05)


def test_a_wave_at_the_end_of_the_grid_gets_its_own_order() -> None:
    """Its half lies on the end of the grid, and its raster beside the order itself."""
    t = np.arange(10000) / 500.0
    w = 2 * np.pi * np.array([0.11, 0.37, 0.9])
    q, v, a = plants.sines(t, w, np.array([0.9, 0.5, 0.15]), np.array([0.0, 1.0, 2.0]))
    order = 3.37 / np.ptp(q)
    noise = 0.004 * np.random.default_rng(1).standard_normal(t.size)
    tau = 0.02 * a + 0.15 * np.tanh(v / 0.01) + 0.05 * v + 0.3 * np.sin(2 * np.pi * order * q)
    run = plants.single("run", t, q, tau + noise)
    found = fit(Problem([run], run.robot), base_model(run.robot) + "cogging").values
    assert found["j1.cogging.p"].value == pytest.approx(order, rel=0.005)
    assert not found["j1.cogging.p"].at_bound


def test_a_fit_keeps_the_form_of_a_file_where_it_leaves_less() -> None:
    """Beside the load that belongs to it: without, another form of hysteresis looks better."""
    run = plants.grasping_axis()
    dahl = {"s": 0.0056, "form": 1.0, "v0": 0.0087, "vs": 0.0}
    shape = {f"j1.presliding.{name}": Value(x) for name, x in dahl.items()}
    model = base_model(run.robot) + Use("presliding", ("joint1",), {}, shape) + "load-friction"
    held = replace(model.effects[-2], options={"fixed_shape": True})
    start = replace(model, effects=(*model.effects[:-2], held, model.effects[-1]))
    first = fit(Problem([run], run.robot), start)
    freed = replace(first.model, effects=tuple(replace(u, options={}) for u in first.model.effects))
    again = fit(Problem([run], run.robot), freed)
    assert again.rms[0] < 1.02 * first.rms[0]
    assert again.values["j1.presliding.form"].value == 1.0


def test_the_ratio_of_a_coupled_friction_is_found() -> None:
    """A cable that passes a pulley of another radius rubs with v + r v_k."""
    run = plants.two_axes("", 3, "cable")
    v = np.gradient(run.q, run.t, axis=0)
    tau = run.tau + 0.4 * np.tanh((v[:, 0] - 0.6 * v[:, 1]) / 0.01)[:, None] * [1.0, 0.0]
    model = base_model(run.robot) + Use("coupled-friction", ("joint1",))
    values = fit(Problem([replace(run, tau=tau)], run.robot), model).values
    assert values["j1.coupled-friction.mode"].value == pytest.approx(-0.6, abs=0.01)
    assert values["j1.coupled-friction.fk"].value == pytest.approx(0.4, rel=0.05)


@pytest.mark.parametrize("v0", [0.03, 0.08])
def test_a_sign_without_friction_of_its_own_is_resolved_as_those_that_use_it_ask_for(v0):
    """A motor that turns with two joints carries all the friction of the first."""
    run = plants.coupled_axes(v0)
    model = base_model(run.robot) + "coupled-transmission"
    result = fit(of_model([run], model), model)
    assert result.values["j1.coulomb.fc"].value == pytest.approx(0.0, abs=0.005)
    assert result.values["j1.coulomb.v0"].value == pytest.approx(v0, rel=0.1)
    assert result.values["j2.coulomb.v0"].value < 0.01
    assert np.all(result.relative < 0.1)


def test_a_sign_that_is_sought_in_few_steps_warns_of_nothing(monkeypatch):
    """Tests take warnings as errors: on a long recording the steps may run out."""
    monkeypatch.setattr(shape_search, "USER_STEPS", 2)
    run = plants.coupled_axes(0.03)
    model = base_model(run.robot) + "coupled-transmission"
    assert np.all(fit(of_model([run], model), model).relative < 0.1)


def test_the_number_of_another_joint_stays_a_whole_one() -> None:
    """The second value of three was sought between 1 and 3, and 2.02 was the joint itself."""
    assert not any(
        continuous(e) for e in catalogue.table().values() if e.shape and e.shape[0].choice
    )
    run = plants.slow_axes(1)
    load = np.abs(run.tau[:, 0] - run.tau[:, 0].mean())
    speed = np.gradient(run.q[:, 1], run.t)
    rubbed = run.tau + np.outer(0.2 * load * np.tanh(speed / 0.02), [0.0, 1.0, 0.0])
    model = base_model(run.robot) + Use("coupled-load-friction", (run.joints[1],))
    found = fit(Problem([replace(run, tau=rubbed)], run.robot), model)
    assert found.values["j2.coupled-load-friction.joint"].value in (1.0, 3.0)


def test_beyond_the_end_of_its_grid_a_shape_has_the_last_two_values_for_neighbours(setting):
    """A grid that refers to a surface ended elsewhere then, and the derivative was 0 / 0."""
    problem, terms, _ = setting
    term = next(t for t in terms if gauss_newton.searched(problem, t))
    values, rest = gauss_newton.line(problem, term), term.shape[1:]
    for beyond, ends in ((values[-1] * 2, values[-2:]), (values[0] / 2, values[:2])):
        assert gauss_newton.around(problem, term.reshaped((float(beyond), *rest))) == tuple(ends)
