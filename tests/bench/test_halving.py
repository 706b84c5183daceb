"""Decision constants halved and doubled: what follows them, who sees it, what the table says."""

import pytest

from hil.bench.diagnosis import cases, command, runner
from hil.diagnosis import constants, engine, residual_tests, rules, types
from hil.errors import ConfigError, DataError


def row(case, outcome, names=()):
    named = [{"effect": e, "joint": "joint1", "rivals": []} for e in names]
    verdict = "missing-effect" if named else "adequate"
    return {"case": case, "outcome": outcome, "named": named, "verdict": verdict, "revision": "a"}


def test_every_number_of_the_file_is_varied():
    known = command.decision_numbers()
    assert known["LEVEL"] == constants.LEVEL and known["SWINGS"] == constants.SWINGS
    # what follows from another one is not varied by itself
    assert not {"SURE", "ADEQUATE", "NEAR_FLOOR", "WHOLE", "CONFIDENT"} & set(known)
    assert {k: vars(constants)[k] for k in known} == known


def test_what_follows_from_a_number_follows_it():
    assert command.varied("TENTH", 0.5)["NEAR_FLOOR"] == pytest.approx(1.05**2)
    assert command.varied("OPEN", 2.0)["WHOLE"] == pytest.approx(0.4)
    assert command.varied("LEVEL", 0.5)["SURE"] == pytest.approx(2.5758, abs=1e-4)
    assert command.varied("DOUBT", 2.0)["CONFIDENT"] == pytest.approx(0.5)


def test_whole_numbers_stay_whole():
    assert command.varied("PARTS", 0.5)["PARTS"] == 2
    assert command.varied("PARTS", 0.01)["PARTS"] == 1


def test_every_module_sees_it_and_gets_its_own_back():
    before = [engine.ADEQUATE, types.ADEQUATE, residual_tests.SURE, rules.LEVEL]
    with pytest.raises(ZeroDivisionError), command.constant_changed("TENTH", 2.0):
        assert engine.ADEQUATE == types.ADEQUATE == constants.ADEQUATE == pytest.approx(1.2)
        assert residual_tests.TENTH == pytest.approx(0.2) and rules.LEVEL == before[3]
        raise ZeroDivisionError
    assert [engine.ADEQUATE, types.ADEQUATE, residual_tests.SURE, rules.LEVEL] == before


def test_a_number_that_is_none_is_refused():
    with pytest.raises(ConfigError, match="LEVEL"), command.constant_changed("LEVELZ", 2.0):
        pass


@pytest.mark.slow
def test_an_answer_depends_on_a_number():
    """What counts as met decides whether an effect near the floor is sought at all."""
    case = cases.single("stribeck", 1.5, "white", "repeated", 0)
    as_is = command.with_number(command.Changed(case, "WARMING", 2.0))
    blind = command.with_number(command.Changed(case, "MATTERS", 200.0))
    assert as_is["outcome"] == "right" and [f["effect"] for f in as_is["named"]] == ["stribeck"]
    assert blind["named"] == [] and blind["outcome"] == "missed"


def test_table_counts_flips_by_number_and_factor():
    rows = [row("a", "right", ["stribeck"]), row("b", "missed")]
    again = [
        row(c, *said) | {"number": number, "factor": factor}
        for c, number, factor, *said in (
            ("a", "WORTH", 0.5, "extra", ["stribeck", "cogging"]),
            ("b", "WORTH", 0.5, "right", ["delay"]),
            ("a", "WORTH", 2.0, "right", ["stribeck"]),
            ("b", "WORTH", 2.0, "missed"),
        )
    ]
    text = command.halve_page(rows, again, "hil bench diagnosis --halve")
    line = next(x for x in text.splitlines() if x.startswith("| WORTH "))
    assert [x.strip() for x in line.split("|")][1:-1] == ["WORTH", "0.03", *"211000"]
    assert "| WORTH x 0.5 | b       | missed: adequate" in text
    assert "`hil bench diagnosis --halve` at revision a; 2 sessions" in text


def test_the_small_plan_is_of_the_quick_one():
    quick = [*cases.rig_plan(True), *cases.mujoco_plan(True)]
    assert sorted(c.name for c in command.small(quick)) == sorted(command.SMALL)
    with pytest.raises(ConfigError, match="--quick"):
        command.small(cases.nothing_hidden(range(3, 4)))


def test_results_of_another_revision_are_refused(monkeypatch):
    monkeypatch.setattr(runner, "revision", lambda: "b")
    with pytest.raises(DataError, match="revision"):
        command.halve([], [row("a", "right")], 1, None)
