"""Values that trade off with each other: where one after the other ends beside the truth."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.attribution import as_use
from hil.diagnosis.grams import split
from hil.diagnosis.heldout import Examiner
from hil.diagnosis.search import Search
from hil.identify.problem import of_model
from hil.identify.shape_search import expected_sign
from hil.identify.timing import fit_aligned
from hil.models import catalogue
from hil.models.kernels import dahl_state
from hil.models.model import RobotModel


def axis(law, seed, seconds=30.0, rate=250.0, slow=1.0, noise=2e-3, counts=0.0, jumps=None):
    """One axis on five tones; `law` gives its effort from path, time step included."""
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * rate)) / rate
    w = 2 * np.pi * slow * np.array([0.09, 0.21, 0.5, 1.1, 1.9])
    q, v, a = plants.sines(t, w, np.array([0.5, 0.3, 0.12, 0.05, 0.02]), rng.uniform(0, 6.28, 5))
    tau = law(q, v, a)
    tau = tau + noise * np.std(tau) * rng.normal(size=t.size)
    q = np.round(q / counts) * counts if counts else q + 2e-6 * rng.normal(size=t.size)
    return plants.single(f"axis{seed}", t, q, tau)


def diagnosed(run):
    """Answer on one run with the base model."""
    return hil.diagnose([run], hil.base_model(run.robot))


def found(d, effect):
    """Finding of an effect."""
    return next(f for f in d.findings if f.effect == effect)


def gravity(q, v, a):
    """An axis with dry friction and a weight."""
    return 0.3 * a + 0.4 * v + 0.9 * np.tanh(v / 0.01) + 4.0 * np.sin(q)


def exponential(q, v, a):
    """Stribeck friction of the first power beside cogging under gravity."""
    turn = np.tanh(v / 0.012)
    dry = (1.0 + 1.4 * np.exp(-np.abs(v) / 0.08)) * turn
    return 0.05 * a + 0.4 * v + dry + 0.6 * np.sin(24 * q) + 9.0 * np.sin(q)


@pytest.mark.slow
def test_the_exponent_of_a_stribeck_curve_is_sought_with_the_resolution_of_the_sign():
    """One after the other they end at the second power, with 0.86 for 1.4 N m."""
    d = diagnosed(axis(exponential, 1, slow=0.6))
    values = found(d, "stribeck").parameters
    assert values["j1.stribeck.n"].value == 1.0
    assert values["j1.stribeck.fs"].value == pytest.approx(1.4, rel=0.1)
    assert values["j1.stribeck.vs"].value == pytest.approx(0.08, rel=0.1)
    assert {f.effect for f in d.findings} == {"unbalance", "cogging", "stribeck"}


def test_a_curve_does_not_follow_what_a_filter_leaves_of_reversals():
    """A slow sign with a steep long tail left less than the truth: 6.6 for 0.15 N m."""

    def peak(t, q, v, a):
        return 0.15 * np.exp(-((v / 0.4) ** 2)) * np.tanh(v / 0.02)

    values = found(diagnosed(plants.smooth_axis(2, 20.0, 250.0, peak)), "stribeck").parameters
    assert values["j1.stribeck.n"].value == 2.0
    assert values["j1.stribeck.fs"].value == pytest.approx(0.15, rel=0.05)
    assert values["j1.stribeck.vs"].value == pytest.approx(0.4, rel=0.05)


@pytest.mark.slow
def test_friction_that_builds_up_is_no_lateness():
    """Bristles bend over half a millimetre: 30 ms of lateness were undone, and a delay named."""
    rate = 500.0

    def bristles(q, v, a):
        return 0.02 * a + 0.05 * v + plants.lugre(q, v, 1 / rate)

    run = axis(bristles, 2, rate=rate, slow=2.0)
    d = diagnosed(run)
    assert abs(d.ladder[-1].result.problem.shift) < 1 / rate
    assert [f.effect for f in d.findings] == ["presliding"]


@pytest.mark.slow
def test_friction_that_is_bent_over_the_speed_is_no_lateness():
    """Eight seconds at 100 Hz: half a sample was taken out, and the Stribeck curve had no name."""

    def bent(q, v, a):
        dry = 0.1 + 0.08 * np.exp(-((v / 0.12) ** 2))
        return 0.03 * a + dry * np.tanh(v / 3e-3) + 0.02 * v + 0.02 * v * np.abs(v)

    t = np.arange(800) / 100.0
    rise = 0.2 + 1.3 * t / 8.2 / 2
    phase = 2 * np.pi * rise * t
    speed = 2 * np.pi * (0.2 + 1.3 * t / 8.2)
    q = 1.2 * np.sin(phase)
    v = 1.2 * speed * np.cos(phase)
    a = 1.2 * (2 * np.pi * 1.3 / 8.2 * np.cos(phase) - speed**2 * np.sin(phase))
    tau = bent(q, v, a)
    tau = tau + 0.01 * np.std(tau) * np.random.default_rng(0).normal(size=t.size)
    count = 2 * np.pi / 65536
    d = diagnosed(plants.single("short", t, np.round(q / count) * count, tau))
    assert abs(d.ladder[-1].result.problem.shift) < 2e-3
    assert d.findings[0].effect == "quadratic-drag"
    assert {f.effect for f in d.findings} <= {"quadratic-drag", "stribeck"}


@pytest.mark.slow
def test_the_load_of_an_axis_leaves_out_its_motor():
    """0.012 of 0.02 kg m^2 lie behind the gear: with all of it in the load mu is 0.125 for 0.18."""

    def geared(q, v, a):
        load = 0.6 * np.sin(q) + 0.012 * a
        return load + 0.008 * a + (0.02 + 0.18 * np.abs(load)) * np.tanh(v / 5e-3) + 0.03 * v

    run = axis(geared, 3, slow=2.5)
    values = found(diagnosed(run), "load-friction").parameters
    assert values["j1.load-friction.mu"].value == pytest.approx(0.18, rel=0.02)
    assert values["j1.load-friction.i"].value == pytest.approx(0.008, rel=0.05)


@pytest.mark.slow
def test_a_straight_spring_has_no_bent_rival_beside_a_small_effect():
    """What a wider law finds to go on with does not make it a rival, where it foretells no more."""

    def sprung(q, v, a):
        dry = 0.1 + 0.12 * np.exp(-((v / 0.1) ** 2))
        return 0.05 * a + 2.0 * q + dry * np.tanh(v / 4e-3) + 0.05 * v

    d = diagnosed(axis(sprung, 4, slow=0.8))
    spring = found(d, "spring")
    assert spring.confidence > 0.9
    assert spring.rivals == []


def strokes(t, seed):
    """Point-to-point strokes with rests: position, speed, acceleration."""
    rng, q = np.random.default_rng(seed), np.zeros(t.size)
    start = place = 0.0
    while start < t[-1]:
        goal, slow = rng.uniform(-0.7, 0.7), rng.uniform(0.6, 1.4)
        s = np.clip((t - start) / slow, 0.0, 1.0)
        # fifth-order profile: no jump of the acceleration
        q = np.where(t >= start, place + (goal - place) * s**3 * (10 - 15 * s + 6 * s**2), q)
        place, start = goal, start + slow + 0.3
    dt = t[1] - t[0]
    v = np.gradient(q, dt)
    return q, v, np.gradient(v, dt)


def test_strokes_with_rests_leave_the_sign_as_blunt_as_is_to_be_expected():
    """They say no more than that it is not blunter; the sharpest one foretold slow turns badly."""
    rng, t = np.random.default_rng(5), np.arange(10000) / 250.0
    q, v, a = strokes(t, 5)
    tau = 0.05 * a + 0.3 * np.tanh(v / 0.01) + 0.1 * v
    tau = tau + 1e-3 * rng.normal(size=t.size)
    d = diagnosed(plants.single("strokes", t, q + 1e-6 * rng.normal(size=t.size), tau))
    assert d.verdict == "adequate"
    value = d.ladder[-1].result.values["j1.coulomb.v0"].value
    assert value == pytest.approx(0.01, rel=0.5)
    again = expected_sign(d.ladder[-1].result, d.ladder[-1].result.problem.count)
    assert again.get(("coulomb", 0), value) < 2 * value


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4])
def test_a_lateness_that_doubles_the_error_in_the_end_is_not_taken(seed):
    """The slow motion says it, and friction that sticks at its reversals leaves more with it."""
    train, other = plants.sharp_screw(seed), plants.sharp_screw(seed + 20)
    d = diagnosed(train)
    assert d.verdict == "adequate" and not d.findings
    assert d.model.fitted.shift_s == 0.0
    late = replace(d.model.fitted, shift_s=-0.4e-3)
    error = [
        hil.fit(other, replace(d.model, fitted=band).as_it_is()).relative[0]
        for band in (d.model.fitted, late)
    ]
    assert error[0] < 0.9 * error[1]


@pytest.mark.slow
def test_a_sign_that_fast_runs_do_not_show_is_not_as_blunt_as_they_allow():
    """Of a width that may be anything up to a tenth of the speed, the middle errs least."""
    rng, t = np.random.default_rng(2), np.arange(15000) / 500.0
    q = 0.5 * np.sin(2 * np.pi * 1.3 * t) + 0.3 * np.sin(2 * np.pi * 2.9 * t + 1.0)
    v = np.gradient(q, t)
    a = np.gradient(v, t)
    tau = 0.05 * a + 0.3 * np.tanh(v / 0.02) + 0.1 * v
    tau = tau + 0.05 * np.std(tau) * rng.normal(size=t.size)
    d = diagnosed(plants.single("fast", t, q + 1e-6 * rng.normal(size=t.size), tau))
    value = d.ladder[-1].result.values["j1.coulomb.v0"].value
    assert 0.02 / 5 < value < 5 * 0.02


def test_counts_in_a_table_with_rounded_numbers_are_counts():
    """Slow strokes behind 15 bits, written with nine digits, were presliding over 1.4 counts."""
    count = 2 * np.pi / 2**15

    def plain(q, v, a):
        return 0.12 * a + 0.5 * np.tanh(v / 0.01) + 0.5 * v + 3.0 * np.sin(q)

    rng, t = np.random.default_rng(7), np.arange(10000) / 250.0
    q, v, a = strokes(t / 3.0, 7)
    tau = plain(q, v / 3.0, a / 9.0)
    tau = tau + 0.01 * np.std(tau) * rng.normal(size=t.size)
    rounded = np.array([float(f"{x:.9g}") for x in np.round(q / count) * count])
    run = plants.single("table", t, rounded, tau)
    d = hil.diagnose([run], hil.base_model(run.robot) + "unbalance")
    assert d.verdict == "adequate"
    assert not d.findings


def test_a_fit_takes_the_shift_that_its_model_states():
    """Efforts that are 12 ms late were fitted as if they were in time, though the model says so."""
    run = plants.delayed_axis(late=-6)
    late = hil.fit(run, hil.base_model(run.robot))
    model = diagnosed(run).ladder[-1].result.model
    assert isinstance(model, RobotModel)
    assert model.fitted.shift_s == pytest.approx(-0.012, abs=1e-3)
    same = hil.fit(run, model.as_it_is())
    assert same.relative[0] < late.relative[0] / 3


def test_the_number_of_a_joint_is_no_size_to_climb():
    """Its logarithm led from joint 2 of 4 to joint 5."""
    assert not catalogue.get("coupled-friction").shape[0].size
    assert catalogue.get("stribeck").shape[0].size


@pytest.mark.slow
def test_a_fit_is_led_out_of_a_local_minimum_once(monkeypatch):
    """A blunter sign may lead it back into the one that corrections have led it out of."""
    asked = []
    monkeypatch.setattr(Search, "settle", lambda search, corrections: asked.append(1) or True)
    monkeypatch.setattr(Search, "correct", lambda search, joints: [search.now])
    answer = diagnosed(axis(lambda q, v, a: 0.3 * a + 0.4 * v + np.sin(3 * q) * v, 3, seconds=12.0))
    assert len(asked) == 1
    assert answer.ladder


@pytest.mark.slow
def test_a_sign_that_turns_over_much_of_the_speed_gets_no_name():
    """Grease and seals let friction set in gradually, beyond the usual range of the sign."""
    run = axis(lambda q, v, a: 0.3 * a + 0.4 * v + 1.5 * np.tanh(v / 0.25), 5, noise=2e-3)
    d = diagnosed(run)
    assert (d.verdict, d.findings) == ("adequate", [])
    fit = d.result
    assert fit.values["j1.coulomb.v0"].value == pytest.approx(0.25, rel=0.1)
    assert fit.values["j1.coulomb.fc"].value == pytest.approx(1.5, rel=0.05)


@pytest.mark.slow
def test_a_drag_beside_bristles_is_no_part_of_lugre_s_law():
    """A level that rises over most of the speeds stood for the curve of a drag."""

    def law(q, v, a):
        z = dahl_state(np.ascontiguousarray(q), 6e-4)
        return 0.3 * a + 0.6 * v + 0.3 * np.tanh(v / 0.01) + 0.5 * z + 0.25 * v * np.abs(v)

    d = diagnosed(axis(law, 7, rate=500.0))
    assert {f.effect for f in d.findings} == {"presliding", "quadratic-drag"}
    drag = d.result.values["j1.quadratic-drag.fd"].value
    assert drag == pytest.approx(0.25, rel=0.15)


@pytest.mark.parametrize("seconds", [plants.further(8.0), 20.0])
@pytest.mark.slow
def test_an_offset_that_drifts_is_named(seconds):
    """As of an amplifier that warms up; beside it a weight keeps its name."""
    run = axis(gravity, 11, seconds=40.0)
    drift = 0.8 * (1 - np.exp(-(run.t - run.t[0]) / seconds))
    d = diagnosed(replace(run, tau=run.tau + drift[:, None]))
    assert {f.effect for f in d.findings} == {"unbalance", "offset-drift"}
    assert d.result.values["j1.offset-drift.d0"].value == pytest.approx(0.8, rel=0.1)
    assert min(f.confidence for f in d.findings) > 0.9


@pytest.mark.slow
def test_an_offset_that_jumps_is_no_drift():
    run = axis(gravity, 12, seconds=40.0)
    jump = 0.8 * (run.t - run.t[0] > 17.0)
    d = diagnosed(replace(run, tau=run.tau + jump[:, None]))
    assert all(f.confidence < 0.5 for f in d.findings if f.effect == "offset-drift")


def test_an_effect_that_only_brought_another_sign_is_taken_out() -> None:
    """The last one, too: what it came with does as well without it."""
    run = plants.smooth_axis(1)
    problem = of_model([run], hil.base_model(run.robot))
    search = Search(problem, split(problem), Examiner(problem, []))
    first = search.judged("base model", fit_aligned(problem, hil.base_model(run.robot)))
    search.rungs.append(first)
    evidence, rated = search.evidence([0])
    c = next(r.candidate for r in rated if r.candidate.name == "stribeck")
    # the base model with a sign that is too blunt: the effect's fit finds the right one
    blunt = replace(first.errors, squared=4.0 * first.errors.squared)
    search.first, search.rungs = evidence, [replace(first, errors=blunt)]
    search.rungs.append(
        search.rung("+ stribeck on joint1", first.result.model + as_use(c, problem))
    )
    search.found = [c]
    search.backward()
    assert search.found == [] and search.now.step.label == "- stribeck on joint1"


@pytest.mark.slow
def test_what_every_run_has_by_itself_is_taken_out_where_it_does_nothing() -> None:
    """It takes the place of a value for all runs, but the model holds none that would come back."""
    runs = [plants.pickup(seed, "none", f"run{seed}") for seed in (1, 2)]
    model = hil.base_model(runs[0].robot)
    problem = of_model(runs, model)
    search = Search(problem, split(problem), Examiner(problem, []))
    first = search.judged("base model", fit_aligned(problem, model))
    search.rungs.append(first)
    search.first, rated = search.evidence([1])
    names = ("missed-counts", "torque-offset")
    each = {n: next(r.candidate for r in rated if r.candidate.name == n) for n in names}
    lost, offset = (each[n] for n in names)
    assert lost.term.per_run and offset.term.per_run
    with_both = first.result.model + as_use(lost, problem) + as_use(offset, problem)
    search.rungs.append(search.rung("+ both", with_both))
    search.found = [lost, offset]
    search.backward()
    # the base model's own offset would come back for the other one
    assert search.found == [offset] and search.now.step.label == "- missed-counts on joint2"
