"""The benchmark without a rule: what is repeated, what its table says, what a rule stands for."""

from types import SimpleNamespace

import pytest

from hil.bench.diagnosis import cases, command, runner, tables
from hil.diagnosis import rules
from hil.errors import ConfigError, DataError


def row(case, outcome, named=(), alone=()):
    names = [{"effect": e, "joint": "joint1", "rivals": []} for e in named]
    return {
        "case": case,
        "plant": "tuning",
        "outcome": outcome,
        "named": names,
        "verdict": "missing-effect" if named else "adequate",
        "revision": "abc",
        "fired": sorted({*alone, "detected"}),
        "alone": sorted(alone),
    }


def without(code, case, outcome, named=()):
    made = {"without": code, "again": f"{case} without {code}", "cpu": 2.0}
    return row(case, outcome, named) | made


ROWS = [
    row("a", "right", ["stribeck"], ["worth", "paired"]),
    row("b", "missed", [], ["worth"]),
    row("c", "right", ["delay"], ["worth"]),
    row("d", "unstable"),
]
AGAIN = [
    without("worth", "a", "extra", ["stribeck", "cogging"]),
    without("worth", "b", "right", ["delay"]),
    without("worth", "c", "wrong", ["presliding"]),
    without("paired", "a", "right", ["stribeck"]),
]


def test_effects_count_flips_of_stable_sessions():
    found = {e.code: e for e in command.rule_effects(ROWS, AGAIN)}
    assert list(found) == [*rules.CANDIDATE, *rules.FIT]
    worth, paired, idle = found["worth"], found["paired"], found["scales"]
    assert (worth.stage, worth.fired, worth.alone, worth.seconds) == ("candidate", 3, 3, 6.0)
    assert (worth.changed, worth.lost, worth.gained) == (3, 2, 1)
    assert (paired.alone, paired.changed, paired.lost, paired.gained) == (1, 0, 0, 0)
    assert (idle.stage, idle.fired, idle.alone, idle.changed) == ("fit", 0, 0, 0)
    assert found["detected"].fired == 3 and found["detected"].alone == 0


def test_table():
    text = command.ablate_page(ROWS, AGAIN, "hil bench diagnosis --ablate")
    lines = [line.split("|") for line in text.splitlines() if line.startswith("| worth")]
    cells = [x.strip() for x in lines[0]]
    assert cells[1:8] == ["worth", "candidate", "3", "3", "3", "2", "1"]
    assert "revision abc; 4 sessions, 4 diagnoses without a rule or several" in text
    assert "missed: adequate" in text and "wrong: presliding joint1" in text
    lines = text[text.index("## No answer changes") :].splitlines()
    idle = {line.split("|")[1].strip(): line for line in lines if line.startswith("| ")}
    assert "paired" in idle and "worth" not in idle
    assert "tests/diagnosis/test_overtones.py" in idle["overtone"]


def test_difference_of_paired_shares():
    # Newcombe 1998, table II: 36, 12, 2, 0 gives 0.0569 to 0.3404
    low, high = tables.difference(36, 2, 12, 0)
    assert (round(low, 4), round(high, 4)) == (0.0569, 0.3404)
    low, high = tables.difference(50, 0, 0, 0)
    assert low == pytest.approx(-high) and 0.05 < high < 0.1
    assert tables.difference(0, 0, 0, 0) == (-1.0, 1.0)


def test_a_rule_is_asked_again_after_an_error():
    with pytest.raises(ZeroDivisionError), rules.without("worth"):
        assert {"worth"} == rules.OFF
        raise ZeroDivisionError
    assert not rules.OFF
    with rules.without("paired"):
        with rules.without("paired"):
            pass
        assert {"paired"} == rules.OFF
    assert not rules.OFF


def candidate(p_value, after):
    """A candidate of a search that has tried nothing yet; enough for the first two rules."""
    term = SimpleNamespace(joint=0)
    rated = SimpleNamespace(
        candidate=SimpleNamespace(name="x", term=term, p_value=p_value),
        before=1.0,
        after=after,
        sureness=5.0,
    )
    search = SimpleNamespace(refused=set(), fired={})
    return SimpleNamespace(search=search, rated=rated, evidence=None)


@pytest.fixture
def two(monkeypatch):
    some = {k: rules.CANDIDATE[k] for k in ("detected", "worth")}
    monkeypatch.setattr(rules, "CANDIDATE", some)


def test_without_a_rule_what_it_alone_stopped_is_added(two):
    case = candidate(1.0, 0.1)
    assert rules.stopped(case).code == "detected" and case.search.fired == {"detected": True}
    with rules.without("worth"):
        assert rules.stopped(case).code == "detected"
    with rules.without("detected"):
        assert rules.stopped(case) is None


def test_without_a_rule_what_another_stops_too_stays_out(two):
    case = candidate(1.0, 0.99)
    assert rules.stopped(case).code == "detected" and case.search.fired == {"detected": False}
    with rules.without("detected"):
        assert rules.stopped(case).code == "worth"
    # one thing that it alone stops is enough, and what comes later does not undo it
    other = candidate(1.0, 0.1)
    other.search.fired = case.search.fired
    rules.stopped(other)
    rules.stopped(case)
    assert case.search.fired["detected"]


def test_only_cases_with_a_rule_of_their_own_are_repeated():
    case = cases.SessionCase("none", "arm", (), "white", "strokes", 0)
    other = cases.SessionCase("none", "arm", (), "white", "strokes", 1)
    rows = [row(case.name, "right", alone=["worth", "paired"]), row(other.name, "unstable")]
    assert [(a.case, a.code) for a in command.repeated([case, other], rows)] == [
        (case, "paired"),
        (case, "worth"),
    ]


def test_results_of_another_revision_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(runner, "revision", lambda: "def")
    with pytest.raises(DataError, match="results of revision abc, and this is def"):
        command.ablate([], ROWS, 1, tmp_path / "r.jsonl")


def test_only_some_sessions():
    todo = cases.nothing_hidden(range(1))
    some = command.only(todo, ["/white/"])
    assert some and {c.noise for c in some} == {"white"}
    assert command.only(todo, []) == todo
    with pytest.raises(ConfigError, match="--only stribek"):
        command.only(todo, ["stribek"])


def test_rules_that_change_nothing_alone_go_together():
    todo = [SimpleNamespace(name=name) for name in "abc"]
    rows = [r | {"fired": [*r["fired"], "worth"]} for r in ROWS[:2]]
    rows.append(row("c", "right", ["delay"], ["worth"]) | {"fired": ["worth"]})
    found = command.inactive_together(todo, rows, AGAIN)
    # "detected" fired in the first two and changes nothing; "worth" does and stays
    assert [t.case.name for t in found] == ["a", "b"]
    assert "detected" in found[0].code.split("+") and "worth" not in found[0].code.split("+")
    joint = [without(found[0].code, "a", "wrong", ["cogging"])]
    text = command.ablate_page(rows, [*AGAIN, *joint], "hil bench diagnosis --ablate")
    assert "Without all that change no answer alone: 1 sessions" in text
    assert "all of them | a" in text


def test_several_rules_are_off_for_a_while():
    with rules.without("worth", "paired"):
        assert {"worth", "paired"} == rules.OFF
    assert not rules.OFF
