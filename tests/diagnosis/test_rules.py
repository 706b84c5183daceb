"""Rules that no session of the quick plans needs: what each stops, and what it lets pass."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import plants
import pytest

from hil.diagnosis import rules
from hil.diagnosis.candidates import paired
from hil.diagnosis.constants import HALF, LEVEL, MATTERS, OPEN, PARTS, WORTH
from hil.diagnosis.grams import Split, levels
from hil.diagnosis.types import Candidate, CheckResult, Floor, HeldOut
from hil.identify.design import Term
from hil.identify.multistep import MultiStep
from hil.identify.problem import Problem
from hil.models import catalogue


def test_every_rule_that_is_provoked_is_one_and_its_test_is_there() -> None:
    root = Path(__file__).parents[2]
    for code, file in rules.PROVOKED.items():
        assert code in {**rules.CANDIDATE, **rules.FIT}
        assert code in (root / file).read_text("utf-8") or code == "overtone"


CORRECTION = "correction-position"


def case(effect: str, **more: Any) -> Any:
    """A candidate of an effect on the first joint."""
    term = SimpleNamespace(effect=catalogue.get(effect), joint=0, key=(effect, 0))
    c = SimpleNamespace(**({"term": term} | more))
    return SimpleNamespace(rated=SimpleNamespace(candidate=c, joint=0))


def moving(faster: float) -> Any:
    """A run of one joint on a sine, or on a chirp."""
    t = np.linspace(0.0, 60.0, 3000)
    speed = np.sin(2.0 * t * (1.0 + 0.05 * faster * t))[None]
    return SimpleNamespace(d=1, recordings=[None], run=np.zeros(t.size, dtype=int), qd=speed)


@pytest.mark.parametrize(("p_value", "stopped"), [(LEVEL / 2, False), (LEVEL * 2, True)])
def test_what_noise_does_as_well_is_not_detected(p_value: float, stopped: bool) -> None:
    reason = rules.CANDIDATE["detected"](case("stribeck", p_value=p_value))
    assert ("by chance" in reason) is stopped


@pytest.mark.parametrize(("peak", "stopped"), [(0.2, False), (-0.2, True)])
def test_friction_that_drives_is_no_physics_before_it_is_fitted(peak: float, stopped: bool) -> None:
    """What `allowed` would refuse after a fit costs none: physical."""
    run = plants.smooth_axis(1, seconds=10.0)
    problem = Problem([run], run.robot)
    law = catalogue.get("stribeck")
    shape = law.search.grid(problem.motions[0], 0)[0]
    found = Candidate(Term(law, 0, shape), 1.0, 1.0, coefficients=(peak,), errors=(0.01,))
    one: Any = SimpleNamespace(
        rated=SimpleNamespace(candidate=found), search=SimpleNamespace(problem=problem)
    )
    assert ("impossible" in rules.CANDIDATE["physical"](one)) is stopped


@pytest.mark.parametrize(
    ("stage", "kept"), [("fit", "it raised the error of j2"), ("candidate", "it was fitted and")]
)
def test_what_was_fitted_before_tells_why_it_did_not_stay(stage: str, kept: str) -> None:
    """The reason outlives that it is asked again; one from before the fit is none."""
    rated: Any = SimpleNamespace(before=2.0, after=1.0, sureness=5.0)
    first = CheckResult("risen", stage, "it raised the error of j2")
    said = rules.refused(rated, first)
    assert said.code == "refused" and said.reason.startswith(kept)
    assert rules.refused(rated, said).reason == said.reason
    assert rules.refused(rated).reason.startswith("it was fitted and")


@pytest.mark.parametrize(("blocks", "stopped"), [(30, False), (1, True)])
def test_a_fall_in_a_single_block_is_chance(blocks: int, stopped: bool) -> None:
    """Unless it takes most of what is left: paired."""
    fall = np.where(np.arange(30) < blocks, 1.0, 0.0) * np.linspace(0.5, 1.5, 30)
    one = case("stribeck", term=Term(catalogue.get("stribeck"), 0, (0.1,)))
    one.rated = SimpleNamespace(candidate=one.rated.candidate, before=1.0, after=0.8)
    one.rated.sureness = paired(fall)
    assert ("from block to block" in rules.CANDIDATE["paired"](one)) is stopped
    one.rated.after = OPEN / 2
    assert rules.CANDIDATE["paired"](one) == ""


@pytest.mark.parametrize("blind", [True, False])
@pytest.mark.parametrize(("effect", "solid"), [("spring", True), ("stribeck", False)])
def test_geometry_may_be_a_spring_where_it_is_unknown(
    blind: bool, effect: str, solid: bool
) -> None:
    """Not where it takes most of what sums of sines and cosines on its joint leave, or slides."""

    def stopped(terms: list[Any], after: float, unit: str = "rad") -> bool:
        one = case(effect)
        one.search = SimpleNamespace(
            blind=blind,
            now=SimpleNamespace(result=SimpleNamespace(terms=terms)),
            problem=SimpleNamespace(robot=SimpleNamespace(units=(unit,))),
        )
        one.rated = SimpleNamespace(candidate=one.rated.candidate, joint=0, before=1.0, after=after)
        return "unknown geometry" in rules.CANDIDATE["geometry"](one)

    gravity = [Term(catalogue.get("generic-gravity"), j) for j in (0, 1)]
    assert stopped([], 0.05) is (blind and solid)
    assert stopped(gravity[1:], 0.05) is (blind and solid)
    assert stopped(gravity[:1], OPEN) is (blind and solid)
    assert not stopped(gravity[:1], 0.05)
    assert not stopped([], 0.05, "m")


def refit(before: np.ndarray, after: np.ndarray, kind: str, effect: str = "stribeck") -> Any:
    """One joint's errors (n,) before a fit and after it."""
    one = case(effect)

    def visited(residual: np.ndarray) -> Any:
        blocks = np.arange(residual.size) // 10
        held = HeldOut(residual[None], np.ones((1, residual.size)), blocks, kind)
        errors = SimpleNamespace(power=np.array([np.mean(residual**2)]))
        result = SimpleNamespace(residual=residual, terms=[SimpleNamespace(per_run=False)])
        return SimpleNamespace(step=SimpleNamespace(heldout=held), errors=errors, result=result)

    problem = SimpleNamespace(
        holds=np.zeros(1, dtype=bool),
        effort=np.ones((1, before.size)),
        rms=lambda x: np.ones(1),
        runs=1,
        accuracy=0.0,
    )
    one.search = SimpleNamespace(
        problem=problem,
        split=Split(
            np.arange(before.size) // 10, np.zeros(before.size // 10, int), ALL, ~ALL, False
        ),
        parted=lambda fit, _: np.sum(fit.residual.reshape(PARTS, -1) ** 2, axis=1)[:, None],
    )
    one.before, one.after = visited(before), visited(after)
    return one


NOISE = np.random.default_rng(3).normal(size=400)
ALL, BLOCK = np.ones(NOISE.size, dtype=bool), np.arange(NOISE.size) // 10


@pytest.mark.parametrize(("factor", "stopped"), [(1 - WORTH, False), (1 - WORTH / 4, True)])
def test_an_effect_keeps_its_gain_when_all_is_fitted_again(factor: float, stopped: bool) -> None:
    """Without held-out runs nothing else keeps a ladder from rising: keeps-gain."""
    one = refit(NOISE, factor * NOISE, "folds")
    assert bool(rules.FIT["keeps-gain"](one)) is stopped
    assert rules.FIT["never-rises"](one) == ""


@pytest.mark.parametrize(("factor", "stopped"), [(0.9, False), (1.1, True)])
def test_a_ladder_never_rises_on_held_out_runs(factor: float, stopped: bool) -> None:
    reason = rules.FIT["never-rises"](refit(NOISE, factor * NOISE, "holdout"))
    assert ("held-out runs rises" in reason) is stopped


@pytest.mark.parametrize(("size", "stopped"), [(1e-3, False), (1e-2, True)])
def test_another_joint_may_rise_where_it_stays_below_the_practical_size(size, stopped) -> None:
    """Twice as much of next to nothing is no harm beside a tenth of what the joint had left."""
    before, after = ((0.1 * NOISE, size * NOISE), (0.01 * NOISE, 2 * size * NOISE))
    blocks = np.arange(NOISE.size) // 10
    one, other = (
        HeldOut(np.stack(x), np.ones((2, NOISE.size)), blocks, "holdout") for x in (before, after)
    )
    assert bool(one.risen(other, 0, [0, 1], MATTERS)) is stopped


@pytest.mark.parametrize("effect", [CORRECTION, "stribeck"])
@pytest.mark.parametrize(("factor", "rises"), [(0.9, False), (1.1, True)])
def test_a_correction_transfers_from_part_to_part(effect: str, factor: float, rises: bool) -> None:
    """A law may; it states what it is everywhere."""
    one = refit(NOISE, factor * NOISE, "folds", effect)
    reason = rules.FIT["transfers"](one)
    assert ("from one part" in reason) is (rises and effect != "stribeck")


@pytest.mark.parametrize(("rise", "stopped"), [(1.003, False), (1.2, True)])
def test_one_part_may_lose_next_to_nothing_beside_what_all_gain(rise: float, stopped: bool) -> None:
    factor = np.full(NOISE.size, 0.6)
    factor[: NOISE.size // 5] = rise
    one = refit(NOISE, factor * NOISE, "folds", CORRECTION)
    assert ("from one part" in rules.FIT["transfers"](one)) is stopped


def test_a_correction_holds_from_one_level_of_effort_to_the_next() -> None:
    """Parts that hold both levels do not show it; runs of one alone do."""
    one = refit(NOISE, 0.9 * NOISE, "folds", CORRECTION)
    problem, run = one.search.problem, np.repeat(np.arange(4), 100)
    problem.runs, problem.run, problem.whole = 4, run, np.arange(4)
    problem.effort = np.where(run % 2, 3.0, 1.0)[None]
    assert rules.FIT["transfers"](one) == ""
    dealt = levels(problem, one.search.split)
    assert dealt is not None and dealt.fold.tolist() == np.repeat([0, 1, 0, 1], 10).tolist()

    def parted(fit: Any, dealt: Split) -> np.ndarray:
        worse = fit.residual * (2.0 if dealt.folds == 2 and fit is one.after.result else 1.0)
        power = np.add.reduceat(worse**2, np.arange(0, worse.size, 10))
        return np.bincount(dealt.fold, power)[:, None]

    one.search.parted = parted
    assert "from one level of effort to the next" in rules.FIT["transfers"](one)
    one.after.result.terms[0].per_run = True  # an offset a run, which no other run determines
    assert rules.FIT["transfers"](one) == ""


def fitted(*theta: float) -> Any:
    """A fit of a law, and of a correction where there are two coefficients."""
    keys = [("load-friction", 0), (CORRECTION, 0)][: len(theta)]
    rows = np.tile(NOISE[:, None], len(theta))
    slices = [slice(k, k + 1) for k in range(len(theta))]
    terms = [SimpleNamespace(key=key) for key in keys]
    return SimpleNamespace(terms=terms, slices=slices, x=rows, theta=np.array(theta))


@pytest.mark.parametrize(("left", "stopped"), [(1 - HALF / 2, False), (HALF / 2, True)])
def test_a_correction_robs_no_name_of_its_effort(left: float, stopped: bool) -> None:
    one = case(CORRECTION)
    one.search = SimpleNamespace(standing=[("load-friction", 0)])
    one.before = SimpleNamespace(result=fitted(1.0))
    one.after = SimpleNamespace(result=fitted(left, 1 - left))
    assert rules.FIT["robs"](one) == ("it replaces load-friction" if stopped else "")
    one.search.standing = []  # a name that does not stand has no effort to keep
    assert rules.FIT["robs"](one) == ""


@pytest.mark.parametrize(
    ("factor", "diverged", "stopped"), [(1.5, 0, False), (5.0, 0, True), (1.0, 5, False), (1, 8, 1)]
)
def test_a_correction_must_not_ruin_the_simulation(
    factor: float, diverged: int, stopped: bool
) -> None:
    """By a rise beyond chance, or in windows that leave the range: simulates."""
    power = np.random.default_rng(1).uniform(0.9, 1.1, (60, 1))

    def simulated(size: float, lost: int) -> MultiStep:
        rms = np.sqrt(power.mean(axis=0)) * size
        return MultiStep(0.5, rms, rms, 60, lost, power * size**2)

    old, new = simulated(1.0, 0), simulated(factor, diverged)
    before, after = (
        object(),
        SimpleNamespace(result=SimpleNamespace(model=SimpleNamespace(explains="motor"))),
    )
    search = SimpleNamespace(
        simulated=lambda rung: old if rung is before else new,
        problem=SimpleNamespace(holds=np.array([False])),
    )
    one: Any = SimpleNamespace(
        search=search, rated=case(CORRECTION).rated, before=before, after=after
    )
    assert bool(rules.FIT["simulates"](one)) is bool(stopped)
    one.rated = case("stribeck").rated  # a law is judged by what it says, and told to the user
    assert not rules.FIT["simulates"](one)


def _near_its_floor(effect: str, fitted: float, held: float) -> Any:
    """A candidate beside errors of the fitted and the held-out runs, in units of the floor."""
    one, one_each = case(effect), np.ones(1)
    floor = Floor(one_each, "largest-model", np.zeros((1, 10)), one_each, one_each)
    rung = SimpleNamespace(
        result=SimpleNamespace(rms=np.array([fitted])),
        step=SimpleNamespace(heldout=SimpleNamespace(kind="holdout", rms=np.array([held]))),
    )
    one.search, one.evidence = SimpleNamespace(now=rung), SimpleNamespace(floor=floor)
    return one


@pytest.mark.parametrize(
    ("fitted", "held", "stopped"), [(1.05, 1.05, True), (1.3, 1.05, False), (1.05, 1.3, False)]
)
def test_nothing_is_named_on_a_joint_at_its_floor(
    fitted: float, held: float, stopped: bool
) -> None:
    """Unless the held-out runs are above it: at-floor."""
    one = _near_its_floor("presliding", fitted, held)
    one.rated.before, one.rated.after = 1.0, 0.96**2
    assert bool(rules.CANDIDATE["at-floor"](one)) is stopped
    one.rated.after = 0.8**2  # more than a floor is known to: it holds what the model lacks
    assert not rules.CANDIDATE["at-floor"](one)
    one.rated.after = 0.96**2
    one.rated.candidate.term.effect = catalogue.get(CORRECTION)  # the verdict keeps those away
    assert not rules.CANDIDATE["at-floor"](one)


@pytest.mark.parametrize(
    ("fitted", "held", "stopped"), [(1.15, 1.15, True), (1.3, 1.15, False), (1.15, 1.3, False)]
)
def test_an_effect_at_the_tip_needs_an_error_above_the_floor(
    fitted: float, held: float, stopped: bool
) -> None:
    """By a tenth more than others, whatever it takes; held-out runs have the last word, too."""
    one = _near_its_floor("force-bias", fitted, held)
    one.rated.before, one.rated.after = 1.0, 0.8**2
    assert bool(rules.CANDIDATE["at-floor"](one)) is stopped


@pytest.mark.parametrize(("floor", "stopped"), [(0.5, False), (0.1, True)])
def test_a_wave_at_the_end_of_its_range_leaves_no_more_than_the_floor(
    floor: float, stopped: bool
) -> None:
    """Else a slower function than any that was tried is meant: scales."""
    term = Term(catalogue.get("encoder-eccentricity"), 0, (2.0,))
    (name,) = (f"j1.encoder-eccentricity.{p.name}" for p in term.effect.shape if p.size)
    value = SimpleNamespace(value=2.0, stderr=0.1, at_bound=True)
    powers = [SimpleNamespace(power=np.array([x])) for x in (1.0, 0.27)]
    one: Any = SimpleNamespace(
        rated=SimpleNamespace(candidate=Candidate(term, 1.0, 1.0), joint=0),
        before=SimpleNamespace(errors=powers[0]),
        after=SimpleNamespace(
            errors=powers[1], result=SimpleNamespace(terms=[term], values={name: value})
        ),
        search=SimpleNamespace(first=SimpleNamespace(floor=SimpleNamespace(rms=np.array([floor])))),
    )
    assert bool(rules.FIT["scales"](one)) is stopped
    one.search.first = None
    assert rules.FIT["scales"](one)


@pytest.mark.parametrize(
    ("effect", "shape", "masses", "motion", "faster", "stopped"),
    [
        ("asymmetric-coulomb", (), 1.0, 1.0, 0.0, False),
        ("asymmetric-coulomb", (), 0.0, 1.0, 0.0, True),
        ("spring", (), 1.0, 1.0, 0.0, True),
        # by the clock: what laws of the motion miss comes again with the motion
        ("offset-drift", (30.0, 0.0), 0.0, 1.0, 0.0, False),
        ("offset-drift", (30.0, 0.0), 1.0, 0.0, 0.0, True),
        ("friction-drift", (30.0, 0.0), 0.0, 1.0, 0.0, False),
        # but not with a chirp
        ("offset-drift", (30.0, 0.0), 0.0, 1.0, 1.0, True),
        # warmed by the motion
        ("friction-drift", (30.0, 2.0), 0.0, 1.0, 0.0, True),
    ],
)
def test_friction_is_no_inaccuracy_of_a_mass_nor_a_drift_of_what_moves(
    effect: str,
    shape: tuple[float, ...],
    masses: float,
    motion: float,
    faster: float,
    stopped: bool,
) -> None:
    """A hundredth of what other laws took may be what they miss; a mass misses no friction."""
    one = case(effect)
    one.rated.candidate.term.shape = shape
    one.rated.before, one.rated.removed = 0.02, 0.01
    one.search = SimpleNamespace(
        base=SimpleNamespace(errors=SimpleNamespace(power=np.array([1.02]))),
        of_conservative=lambda j: masses,
        of_motion=lambda j: motion,
        problem=moving(faster),
    )
    level = {"exceeded": lambda rms, j: rms[j] > 0.05, "rms": np.array([0.045])}
    one.evidence = SimpleNamespace(floor=SimpleNamespace(**level))
    one.rated.after = 0.01
    assert bool(rules.CANDIDATE["discrepancy"](one)) is stopped
    one.rated.after = 0.04**2  # a quarter, at its floor: no law fits so what another one misses
    assert not rules.CANDIDATE["discrepancy"](one)
    # and so does what takes nine tenths of what is above the floor, as once all is fitted with it
    one.rated.after = 0.06**2
    assert not rules.CANDIDATE["discrepancy"](one)
    one.rated.after = 0.07**2
    assert bool(rules.CANDIDATE["discrepancy"](one)) is stopped
    one.search.last = one.evidence
    one.before = SimpleNamespace(errors=SimpleNamespace(power=np.array([0.02])))
    for left, refused in ((0.06, False), (0.12, stopped)):
        one.after = SimpleNamespace(errors=SimpleNamespace(power=np.array([left**2])))
        assert bool(rules.FIT["outgrows"](one)) is refused


@pytest.mark.parametrize(("effect", "stopped"), [("spring", False), ("position-torque", True)])
def test_a_series_does_all_that_a_law_misses(effect: str, stopped: bool) -> None:
    """A polynomial over the position follows what a stop's law is off, down to the noise."""
    one = case(effect)
    one.rated.before, one.rated.removed, one.rated.after = 0.02, 0.0199, 1e-4
    one.rated.candidate.term.shape = ()
    one.search = SimpleNamespace(
        base=SimpleNamespace(errors=SimpleNamespace(power=np.array([2.02]))),
        problem=SimpleNamespace(d=1),
    )
    level = {"exceeded": lambda rms, j: rms[j] > 0.05, "rms": np.array([0.01])}
    one.evidence = one.search.last = SimpleNamespace(floor=SimpleNamespace(**level))
    assert bool(rules.CANDIDATE["discrepancy"](one)) is stopped
    one.before, one.after = (
        SimpleNamespace(errors=SimpleNamespace(power=np.array([x]))) for x in (0.02, 1e-4)
    )
    assert bool(rules.FIT["outgrows"](one)) is stopped


@pytest.mark.parametrize(("periods", "masses", "stopped"), [(6.0, 1.0, False), (2.0, 1.0, True)])
def test_a_ripple_is_no_inaccuracy_of_a_mass(periods: float, masses: float, stopped: bool) -> None:
    """Laws of posture are smooth: what turns round ten times over the range is another one."""
    one = case("cogging")
    one.rated.before, one.rated.removed, one.rated.after = 0.02, 0.01, 0.01
    one.rated.candidate.term.shape = (periods / 3.0,)
    one.search = SimpleNamespace(
        base=SimpleNamespace(errors=SimpleNamespace(power=np.array([1.02]))),
        of_conservative=lambda j: masses,
        problem=SimpleNamespace(d=1, span=np.array([[-1.0, 2.0]])),
    )
    level = {"exceeded": lambda rms, j: True, "rms": np.array([0.01])}
    one.evidence = SimpleNamespace(floor=SimpleNamespace(**level))
    assert bool(rules.CANDIDATE["discrepancy"](one)) is stopped
