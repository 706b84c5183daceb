"""An effect is known by its parts, never by its name: a user's own is treated as a built-in one."""

import ast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import plants
import pytest

from hil.diagnosis import attribution, evidence, rules
from hil.diagnosis.types import Candidate
from hil.errors import ConfigError
from hil.identify import timing
from hil.identify.design import Term
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.effect import (
    STRICT,
    Doc,
    Effect,
    Grid,
    Param,
    Relations,
    Sight,
    Trait,
    Waves,
    log_grid,
    position_orders,
    refused,
)
from hil.models.friction import Coulomb, Viscous, harmonics
from hil.models.model import RobotModel, Use
from hil.models.motion import Motion
from hil.record.recording import RobotSource
from hil.testing import ConformanceError, check_effect

ROOT = Path(__file__).parents[2] / "hil"
#: Packages that serve every effect alike, and literals in them that may be an effect's name.
SHARED, ALLOWED = ("diagnosis", "identify", "report", "excite", "estimate"), frozenset[str]()
DOC = Doc("tau = ...", signature="any", shown_by="any motion", source="this test")
AXIS = RobotSource("single-axis")


# ------------------------------------------------------------ no name in shared code


def literals(path: Path) -> list[tuple[int, str]]:
    """Lines and texts of a file's string literals."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    found = (n for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str))
    return [(n.lineno, str(n.value)) for n in found]


@pytest.mark.parametrize("package", SHARED)
def test_shared_code_names_no_effect(package: str) -> None:
    names = set(catalogue.table()) - ALLOWED
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text!r}"
        for path in sorted((ROOT / package).rglob("*.py"))
        for line, text in literals(path)
        if names & {text, text.partition(".")[0], *text.split(".")[1:2]}
    ]
    assert not found, "ask for a part or a trait of the effect instead:\n" + "\n".join(found)


@pytest.mark.parametrize("package", [p for p in SHARED if p != "estimate"])
def test_shared_code_imports_no_effect(package: str) -> None:
    """The loop alone has a kernel for one law (decision 7)."""
    kinds = {type(e).__name__ for e in catalogue.table().values()}
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {a.name}"
        for path in sorted((ROOT / package).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hil.models")
        for a in node.names
        if a.name in kinds
    ]
    assert not found


def test_the_parts_are_a_dozen() -> None:
    parts = {n for n in vars(Effect) if not n.startswith("_")} | set(Effect.__annotations__)
    assert len(parts) == 12


# ------------------------------------------------------------ a user's own effects


class BusLatency(Effect):
    """The bus delivers commands late."""

    name, family, doc = "bus-latency", "actuator", DOC
    params = (Param("a", "1", "share that is late", 0.9, 1.1),)
    shape = (Param("T", "s", "time", 0.0, size=True),)
    relations = Relations(causes=("lateness",))
    search = Grid(lambda motion, j: log_grid(5e-4, 0.06, 14))
    limits = (STRICT,)
    traits = Trait.LATE | Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Any) -> Any:
        tau = motion.tau[:, j]
        early = np.interp(motion.t - shape[0], motion.t, tau)
        return (tau - early)[:, None]


class Groove(Effect):
    """A worn groove that tilts the carriage."""

    name, family, doc = "groove", "friction", replace(DOC, shown=Sight.RANGE)
    params = tuple(Param(n, "{F}", "amplitude") for n in ("a1", "b1", "a2", "b2"))
    shape = (Param("p", "1/{x}", "periods per unit of position", 0.0, size=True),)
    search = Waves(position_orders, carrier=lambda motion, j: np.ones(motion.n))

    def columns(self, motion: Motion, j: int, shape: Any) -> Any:
        return harmonics(motion.q[:, j], shape[0])


class Dry(Coulomb):
    """Dry friction under another name."""

    name = "own-dry"


class Wet(Viscous):
    """Viscous friction under another name."""

    name = "own-wet"


OWN = (BusLatency(), Groove(), Dry(), Wet())


@pytest.fixture(autouse=True)
def own(monkeypatch: pytest.MonkeyPatch) -> None:
    known = dict(catalogue.table()) | {e.name: e for e in OWN}
    monkeypatch.setattr(catalogue, "_table", known)


def candidate(effect: Effect, shape: tuple[float, ...] = (), joint: int = 0) -> Candidate:
    return Candidate(Term(effect, joint, shape), 1.0, 1.0)


@pytest.mark.parametrize("effect", OWN, ids=lambda e: e.name)
def test_they_conform(effect: Effect) -> None:
    check_effect(effect)


@pytest.mark.parametrize("effect", [BusLatency(), catalogue.get("delay")], ids=lambda e: e.name)
def test_a_lateness_is_held_against_the_slow_motion(effect: Effect) -> None:
    model = RobotModel(AXIS, tuple(Use(n) for n in ("rigid-body", "coulomb", "viscous")))
    for late, good in ((0, False), (8, True)):
        result = fit(Problem([plants.delayed_axis(late=late)], AXIS), model)
        c = candidate(effect, (0.016,))
        case: Any = SimpleNamespace(
            rated=SimpleNamespace(candidate=c),
            search=SimpleNamespace(now=SimpleNamespace(result=result)),
        )
        c.coefficients = (1.0,)
        assert evidence.in_time(c, result) is good
        assert bool(rules.CANDIDATE["late"](case)) is not good


def test_forms_of_one_cause_are_kindred_whoever_wrote_them() -> None:
    mine, delay = candidate(BusLatency(), (0.01,)), candidate(catalogue.get("delay"), (0.01,))
    assert attribution.kindred(mine, delay) and attribution.late(mine, delay)
    assert not attribution.kindred(mine, candidate(catalogue.get("delay"), (0.01,), 1))
    assert not attribution.kindred(mine, candidate(catalogue.get("viscous")))
    case: Any = SimpleNamespace(
        rated=SimpleNamespace(candidate=mine), search=SimpleNamespace(found=[delay])
    )
    assert "same cause" in rules.CANDIDATE["kindred"](case)


def test_a_size_that_is_less_than_its_error_names_nothing() -> None:
    model = RobotModel(AXIS, tuple(Use(n) for n in ("rigid-body", "coulomb", "groove")))
    result = fit(Problem([plants.delayed_axis()], AXIS), model)
    one = next(t for t in result.terms if t.effect.name == "groove")
    case: Any = SimpleNamespace(
        after=SimpleNamespace(result=result), rated=SimpleNamespace(candidate=Candidate(one, 1, 1))
    )
    found = result.values["j1.groove.p"]
    result.values["j1.groove.p"] = replace(found, stderr=0.5 * found.value)
    assert rules.FIT["scales"](case) == ""
    result.values["j1.groove.p"] = replace(found, stderr=2.0 * found.value)
    assert "periods per unit of position is not determined" in rules.FIT["scales"](case)


def test_friction_under_another_name_is_fitted_as_the_catalogue_s() -> None:
    theirs, mine = (
        fit(Problem([plants.delayed_axis()], AXIS), RobotModel(AXIS, tuple(Use(n) for n in names)))
        for names in (("rigid-body", "coulomb", "viscous"), ("rigid-body", "own-dry", "own-wet"))
    )
    np.testing.assert_array_equal(mine.theta, theirs.theta)
    np.testing.assert_array_equal(mine.problem.motions[0].v0, theirs.problem.motions[0].v0)
    response = mine.problem.motions[0].response
    assert response is not None
    assert response.damping[0] == pytest.approx(mine.values["j1.own-wet.fv"].value, rel=1e-9)


def test_an_own_delay_takes_the_place_of_an_alignment() -> None:
    class Shift(BusLatency):
        name, traits = "own-shift", BusLatency.traits | Trait.SHIFTS

    result = fit(
        Problem([plants.delayed_axis(late=1)], AXIS),
        RobotModel(AXIS, tuple(Use(n) for n in ("rigid-body", "coulomb", "viscous"))),
    )
    assert timing.sample_shift(result)[0]
    terms = [*result.terms, Term(Shift(), 0, (0.002,))]
    assert not timing.sample_shift(replace(result, terms=terms))[0]


def test_limits_say_which_one_is_broken() -> None:
    motion = Problem([plants.delayed_axis()], AXIS).motions[0]
    assert refused(BusLatency(), motion, 0, (0.01,), (2.0,)) == "bounds"
    assert refused(BusLatency(), motion, 0, (0.01,), (1.0,)) == ""


# ------------------------------------------------------------ a file of the earlier form

OLD = '''
from hil.models.effect import Effect, Param

class Old(Effect):
    """As it was written once."""
    name, family, equation, signature = "old-one", "friction", "tau = w v", "odd"
    shown_by, source, replaced = "any", "a book", True
    params = (Param("w", "{F}", "size", 0.0),)
    shape = (Param("s", "1", "scale", 0.0),)
    replayed = True

    def columns(self, motion, j, shape):
        return motion.qd[:, j : j + 1] * shape[0]

    def grid(self, motion, j):
        return [(1.0,)]

    def credible(self, motion, j, shape, beta, error=()):
        return True

EFFECTS = (Old(),)
'''


def test_a_file_of_the_earlier_form_is_told_what_belongs_where(tmp_path: Path) -> None:
    path = tmp_path / "old.py"
    path.write_text(OLD, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        catalogue.load_plugin(path)
    said = str(caught.value)
    assert "Old is declared in the old way" in said and "own-effects.md" in said
    assert "'equation', 'signature', 'shown_by', 'source' belong into doc = Doc(" in said
    assert "'grid' belongs into search = Grid(" in said
    assert "'credible' belongs into limits" in said and "'replayed' belongs into traits" in said
    assert "old-one" not in catalogue.table()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"search": log_grid}, "expected Grid"),
        ({"traits": "late"}, "expected Trait"),
        ({"strict": True}, "'strict' belongs into limits"),
        ({"twins": lambda s, m: ()}, ""),
    ],
)
def test_a_part_that_is_none_is_named(change: dict[str, Any], said: str) -> None:
    made = type("Mine", (BusLatency,), change)()
    if not said:  # a function of its own that only has such a name
        return check_effect(made)
    with pytest.raises(ConformanceError, match=said):
        check_effect(made)
