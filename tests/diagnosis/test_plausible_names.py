"""Names are physics: friction over position is no stop, and what no effect is gets no name."""

from types import SimpleNamespace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis import attribution, verdict
from hil.diagnosis.types import Candidate, HeldOut
from hil.identify.design import Term
from hil.models import catalogue


def diagnosed(extra, holdout=True, seed=1):
    runs = [plants.axis(seed + k, extra=extra) for k in range(1 + holdout)]
    return hil.diagnose(runs[:1], hil.base_model(runs[0].robot), runs[1:])


def named(d):
    return {f.effect for f in d.findings}


@pytest.mark.parametrize(
    "size",
    [
        lambda q: 0.25 * q,
        plants.further(lambda q: 0.2 * np.cos(1.5 * q + 0.4)),
        plants.further(lambda q: 0.2 * np.exp(-(q**2))),
    ],
)
def test_friction_that_varies_smoothly_over_the_range_is_named(size):
    d = diagnosed(lambda t, q, v: size(q) * np.tanh(v / 0.003))
    assert d.verdict == "missing-effect" and named(d) == {"position-friction"}
    assert d.findings[0].excess_explained > 0.9


@pytest.mark.parametrize(
    ("rubs", "size", "w"),
    [
        (lambda d, v: 0.35 * np.exp(-((d / 0.06) ** 2)) * np.tanh(v / 0.003), 0.35, 0.06),
        plants.further(lambda d, v: 0.4 * np.exp(-((d / 0.08) ** 2)) * v, 0.4, 0.08),
        # a worn spot with cosine flanks: half of its depth is left at half of its half-width
        plants.further(
            lambda d, v: -0.2 * np.cos(np.pi * np.clip(d / 0.4, -0.5, 0.5)) ** 2 * np.sign(v),
            -0.2,
            0.12,
        ),
    ],
)
def test_friction_that_is_another_one_at_one_place_is_named_with_the_place(rubs, size, w):
    d = diagnosed(lambda t, q, v: rubs(q - 0.3, v))
    assert d.verdict == "missing-effect" and named(d) == {"local-friction"}
    values = {k.rsplit(".", 1)[1]: v.value for k, v in d.findings[0].parameters.items()}
    assert values["q0"] == pytest.approx(0.3, abs=0.02)
    assert values["w"] == pytest.approx(w, rel=0.2)
    # at the mean speed over the place, which is about 1 rad/s
    assert values["fl"] + values["dl"] == pytest.approx(size, rel=0.15)
    assert d.ladder[-1].heldout.rms < 1.1 * d.noise


@pytest.mark.slow
def test_an_effort_at_one_place_that_no_speed_turns_is_no_local_friction():
    d = diagnosed(lambda t, q, v: 0.3 * np.exp(-(((q - 0.3) / 0.08) ** 2)))
    assert "local-friction" not in named(d)


@pytest.mark.slow
def test_viscous_friction_that_varies_over_the_range_has_no_name():
    d = diagnosed(lambda t, q, v: 0.25 * q * v)
    assert d.verdict == "unexplained" and not d.findings


@pytest.mark.slow
def test_names_that_together_stand_for_one_function_are_none():
    """A ripple at 1.00 and a tight spot left 2.8 %: the function itself leaves nothing."""
    run = plants.axis(1, 30.0, 0.01, extra=lambda t, q, v: (2.0 + 1.5 * q) * v)
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert d.verdict == "unexplained" and not d.findings
    assert len(d.partial) > 1
    assert all("position, by direction without a name" in f.reason for f in d.partial)
    (way,) = d.corrections
    assert "position, by direction" in way.of
    assert d.ladder[-1].heldout.relative[0] < 0.01 * d.ladder[0].heldout.relative[0]


@pytest.mark.slow
def test_a_stop_is_still_one():
    d = diagnosed(lambda t, q, v: 6.0 * max(q - 0.7, 0.0) ** 1.5)
    assert named(d) == {"end-stop"}


@pytest.mark.parametrize("order", plants.seeds(9.0, 18.0))
def test_waves_over_position_have_their_own_order_not_half_of_it(order):
    d = diagnosed(lambda t, q, v: 0.15 * np.sin(order * q + 0.7), holdout=False)
    assert named(d) == {"cogging"}
    p = d.findings[0].parameters["j1.cogging.p"].value
    assert p == pytest.approx(order / 2 / np.pi, rel=0.02)


@pytest.mark.slow
def test_friction_that_rebuilds_at_rest_is_no_drift():
    level = {"last": 0.0, "value": 1.0}

    def thixotropy(t, q, v):
        h, level["last"] = max(t - level["last"], 0.0), t
        x = 1.0 if t == 0.0 else level["value"]
        level["value"] = x + h * ((1.0 - x) / 3.0 - 1.5 * abs(v) * x)
        return 0.25 * level["value"] * np.tanh(v / 0.003)

    d = diagnosed(thixotropy)
    assert "friction-drift" not in named(d)


@pytest.mark.slow
def test_the_share_is_that_on_the_held_out_recording():
    d = diagnosed(lambda t, q, v: 0.15 * np.sin(18 * q))
    first, last, floor = d.ladder[0].heldout, d.ladder[-1].heldout, d.noise[0]
    share, se = last.share(first, floor, 0)
    expected = (first.rms[0] ** 2 - last.rms[0] ** 2) / (first.rms[0] ** 2 - floor**2)
    assert share == pytest.approx(expected) and 0 < se < 0.1
    assert d.findings[0].excess_explained == pytest.approx(np.clip(expected, 0, 1), abs=1e-9)


@pytest.fixture
def nothing_relaxes(monkeypatch):
    """A catalogue without the spring that yields."""
    monkeypatch.delitem(catalogue.table(), "relaxation")


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_relaxes")
def test_a_name_that_comes_to_nothing_beside_a_correction_does_not_stand():
    """Bristles stand for a spring that yields, until a correction does."""
    first, second, other = (plants.leaking_axis(seed, 250.0, 40.0) for seed in (1, 2, 3))
    d = hil.diagnose([first, second], hil.base_model(first.robot), other)
    assert named(d) == {"spring"} and [f.effect for f in d.partial] == ["presliding"]
    assert "nothing is left of it" in d.partial[0].reason
    assert "+ presliding on joint1 (not named)" in [s.label for s in d.ladder]
    assert "presliding" not in {u.type for u in d.model.effects}
    values = d.result.values
    assert values["j1.coulomb.fc"].value == pytest.approx(15.0, rel=0.02)
    assert values["j1.spring.k"].value == pytest.approx(300.0, rel=0.02)
    assert d.ladder[-1].heldout.rms[0] < 0.5 * d.explained.heldout.rms[0]


def leaking_with_loops(seed):
    r = plants.leaking_axis(seed, 250.0, 40.0)
    loops = 12.0 * plants.stuck(r.q[:, 0], 0.01) / 0.01
    return plants.single("leaks", r.t, r.q[:, 0], r.tau[:, 0] + loops, robot=r.robot)


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_relaxes")
def test_friction_that_builds_up_keeps_its_name_beside_that_correction():
    """Both are there: each has what the other does not follow."""
    first, second, other = map(leaking_with_loops, (1, 2, 3))
    d = hil.diagnose([first, second], hil.base_model(plants.SINGLE), other)
    assert named(d) == {"spring", "presliding"} and d.corrected


@pytest.mark.slow
def test_a_spring_that_yields_is_named_beside_friction_that_builds_up():
    first, second, other = map(leaking_with_loops, (1, 2, 3))
    d = hil.diagnose([first, second], hil.base_model(plants.SINGLE), other)
    assert named(d) == {"spring", "presliding", "relaxation"}
    assert d.result.values["j1.relaxation.k"].value == pytest.approx(250.0, rel=0.05)
    assert d.result.values["j1.relaxation.T"].value == pytest.approx(0.6, rel=0.1)


@pytest.mark.parametrize(("p", "open_"), [(0.8, True), (6.0, False)])
def test_that_a_wave_of_one_turn_fits_by_little_better_is_no_evidence(monkeypatch, p, open_):
    """A gas spring over 1.4 rad had been a ripple of the motor at 1.00, with no rival."""
    problem = SimpleNamespace(runs=1, span=np.array([[-0.7, 0.7]]))
    ripple, torque = (catalogue.get(n) for n in ("torque-ripple", "position-torque"))
    wave = Candidate(Term(ripple, 0, (p,)), 1.0, 1.0, 8700.0, 5, 46.0, missed=1.0)
    smooth = Candidate(Term(torque, 0, ()), 1.0, 1.0, 8670.0, 7, 64.0, missed=1.0)
    for name in ("twins", "mirrored", "begins"):
        monkeypatch.setattr(attribution, name, lambda *_: False)
    share = attribution.weights(wave, [smooth], SimpleNamespace(problem=problem))
    assert (share[1] > 0.3) is open_ and (share[0] > 0.95) is not open_


@pytest.mark.parametrize(
    ("effect", "after", "last", "hardly"),
    [
        ("spring", 0.499, 0.4, True),
        # it removes much, or the held-out run is at its floor with all others beside it
        ("spring", 0.2, 0.2, False),
        ("spring", 0.499, 0.105, False),
        # an instant of a fitted run is none of theirs
        ("payload-change", 0.499, 0.4, False),
    ],
)
def test_a_second_law_shows_on_held_out_runs_by_more_than_the_first_may_miss(
    effect, after, last, hardly
):
    """Of an error of 1 the first law leaves 0.5."""
    rng = np.random.default_rng(1)
    noise, blocks = rng.normal(size=(1, 4000)), np.arange(4000) // 100

    def rung(size, *laws):
        held = HeldOut(size * noise, np.ones((1, 4000)), blocks, "holdout")
        terms = [SimpleNamespace(key=(name, 0)) for name in laws]
        step = SimpleNamespace(heldout=held, result=SimpleNamespace(terms=terms))
        return SimpleNamespace(step=step, errors=SimpleNamespace(power=np.array([size**2])))

    term = Term(catalogue.get(effect), 0, catalogue.get(effect).variation.single or (0.0,))
    problem = SimpleNamespace(robot=None)
    search = SimpleNamespace(base=rung(1.0), now=rung(last), problem=problem)
    candidate = Candidate(term, 1.0, 1.0)
    steps = (rung(0.5, "delay"), rung(after, "delay", effect))
    assert verdict._hardly_there(search, candidate, steps, 0, np.array([0.1])) is hardly
    assert not verdict._hardly_there(search, candidate, steps, 0, None)
    first = (search.base, rung(after, effect))
    assert not verdict._hardly_there(search, candidate, first, 0, np.array([0.1]))
    # what took the place of another law has done what that one did
    instead = (rung(0.5, "delay"), rung(after, effect))
    assert not verdict._hardly_there(search, candidate, instead, 0, np.array([0.1]))


@pytest.mark.parametrize(
    ("width", "sum_of_loops", "known", "rival"),
    [
        (0.5, 1.0, True, True),
        (1e-7, 1.0, False, True),
        (0.5, -1.0, False, False),
        (1e-7, -1.0, False, False),
    ],
)
def test_what_is_too_small_to_be_told_is_a_rival_and_no_name(width, sum_of_loops, known, rival):
    """Bristles of a tenth of a milliradian were refused, and a soft shaft named at 1.00."""
    run = plants.axis(1)
    problem = hil.fit([run], hil.base_model(run.robot)).problem
    effect = catalogue.get("presliding")
    grid = [s for s in problem.grid(effect, 0) if s[1] == 0.0]
    shape = (width * grid[-1][0], *grid[-1][1:])
    beta = sum_of_loops * np.array([0.1, 0.3, 0.3, 0.3])
    errors = tuple(1e-3 * np.abs(beta))
    c = Candidate(Term(effect, 0, shape), 1.0, 1.0, coefficients=tuple(beta), errors=errors)
    assert attribution.physical(c, problem) is known
    assert attribution.may_be(c, problem) is rival
