"""What an answer says in words: nothing that it is not about, and everything that it is."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import plants
import pytest
from test_report import model

from hil import terminal
from hil.commands import diagnose as diagnose_command
from hil.commands.common import note_compiling
from hil.commands.compare import text as compare_text
from hil.commands.diagnose import (
    ERROR_LEGEND,
    _contribution,
    _forms,
    _telling,
    _what_is_written,
    short,
    text,
    verdict_sentence,
)
from hil.diagnosis.attribution import Named
from hil.diagnosis.engine import diagnose
from hil.diagnosis.equivalence import at_issue_of
from hil.diagnosis.residual_tests import CHANGED, CUT_THERE
from hil.diagnosis.types import (
    EITHER,
    Candidate,
    Change,
    Finding,
    Indistinguishable,
    UnnamedCorrection,
    to_try,
)
from hil.diagnosis.verbs import compare, ladder
from hil.diagnosis.verdict import NO_GEOMETRY, _weighed, effort_lateness
from hil.identify import bands
from hil.identify.design import Term
from hil.models import catalogue
from hil.models.model import Value, remark
from hil.models.parts import Trait
from hil.report.data import Files, diagnosis_json, finding_json, from_diagnosis, with_files
from hil.report.elements import items, paragraph
from hil.report.html import diagnosis_report
from hil.report.text import (
    AGAIN,
    CHECK_FIRST,
    VERDICT_CONSEQUENCES,
    _finding,
    headline,
    laws,
    next_steps,
    percent,
    remains,
)


@pytest.fixture(scope="module")
def plain():
    run = plants.tanh_axes()
    return diagnose([run], model(run))


@pytest.fixture(scope="module")
def late():
    """Two drives that are late by times of their own."""
    run = plants.late_axes((4, 12))
    return diagnose([run], model(run))


def test_what_no_motion_tells_takes_one_line_unless_asked_for(plain):
    short, long = (text(plain, ladder(plain), verbose=v) for v in (False, True))
    assert "not separable by motion alone: torque-gain from every other parameter" in short
    assert "hand force" not in short and "What these data cannot tell apart" not in short
    assert "  - torque-gain / every other parameter: " in long and "hand force" in long
    sets = diagnosis_json(plain)["indistinguishable"]
    assert [s["effects"][0] for s in sets] == ["torque-gain"]


def test_what_bears_on_the_answer_is_told_in_full(plain):
    # load-friction is mistaken for a torque gain: then the gain is at issue
    own = plain.partial
    try:
        plain.partial = [finding("load-friction")]
        sets, standing = at_issue_of(plain)
        assert [s.effects[0] for s in sets] == ["torque-gain"] and not standing
    finally:
        plain.partial = own


@pytest.mark.slow
def test_the_first_answer_is_one_screen(late):
    d = late
    files = Files(("a b.mcap",), more=("--robot", "arm.urdf"), model="")
    lines = short(d, ladder(d), files).splitlines()
    # two joints without a robot description: that is said first
    assert lines[0].startswith("2 joints without a robot description: ") and not lines[1]
    assert lines[2].startswith("Verdict: ")
    assert len(lines) <= 24
    rows = [
        line for line in lines if re.match(r"  (delay|actuator-lag) on joint\d +[01]\.\d\d ", line)
    ]
    assert len(rows) == len(d.findings) == 2
    joints = [line.split() for line in lines if line.startswith("  joint")][1:]
    assert [row[0] for row in joints] == ["joint1", "joint2"]
    for j, row in enumerate(joints):
        assert float(row[1]) == pytest.approx(d.ladder[0].heldout.relative[j], abs=0.005)
        assert float(row[2]) == pytest.approx(d.ladder[-1].heldout.relative[j], abs=0.005)
    assert "Next" in lines
    assert any("--verbose" in line for line in lines)
    assert len(text(d, ladder(d)).splitlines()) > len(lines)


@pytest.mark.slow
def test_the_next_command_adds_what_is_missing_unless_it_is_added_already():
    d = diagnose([run := plants.axis_with_stop(1.0, 1)], model(run))
    assert d.verdict == "missing-effect"
    files = Files(("a b.mcap",), model="", more=("--robot", "arm.urdf"))
    said = short(d, ladder(d), files)
    assert "    hil " in said and "'a b.mcap'" in said and "--robot arm.urdf" in said
    assert "    hil " not in short(d, ladder(d), None)


@pytest.fixture(scope="module")
def four():
    """A sure name, and three that a rival of them is likelier than."""
    stop = diagnose([run := plants.axis_with_stop(1.0, 1)], model(run))
    (sure,) = stop.findings
    doubtful = {"confidence": 0.3, "rivals": ["backlash"], "rival_weights": [0.7]}
    names = ("presliding", "spring", "cogging")
    others = [replace(sure, effect=n, parameters={}, **doubtful) for n in names]
    stop.findings = [sure, *others]
    return stop


def test_names_of_less_than_even_odds_share_a_line_where_there_are_many(four):
    lines = short(four, ladder(four), None).splitlines()
    said = (
        "  of less than even odds, see --verbose: presliding on joint1 (0.30), spring on "
        "joint1 (0.30) and cogging on joint1 (0.30)"
    )
    assert said in lines and not any("backlash" in x for x in lines)
    assert not any(x.startswith("  presliding on joint1") for x in lines)
    assert "rivals with this motion: backlash" in text(four, ladder(four), verbose=True)
    # fewer of them, or none that is sure, are in the table
    for some, said in ((slice(2), "missing-effect"), (slice(1, None), "ambiguous")):
        fewer = replace(four, findings=four.findings[some], verdict=said)
        lines = short(fewer, ladder(four), None).splitlines()
        assert any(x.startswith("  presliding on joint1, or a rival ") for x in lines)
        assert any(x.startswith("  rivals of presliding on joint1: backlash") for x in lines)


def test_values_stand_below_the_table_where_the_terminal_is_narrow(four, monkeypatch):
    sure = four.findings[0]
    wide = short(four, ladder(four), None)
    (row,) = (x for x in wide.splitlines() if x.startswith(f"  {sure.effect} on joint1 "))
    value = row.split("  ")[-1]
    monkeypatch.setattr(terminal, "width", lambda *_: 80)
    narrow = short(four, ladder(four), None)
    assert f"\n  {sure.effect} on joint1: {value}\n" in narrow
    assert "explains %  value" in wide and "explains %\n" in narrow


def test_an_adequate_model_has_one_error_and_no_command(plain):
    said = short(plain, ladder(plain), Files())
    assert "improved %" not in said
    assert "hil add" not in said and "hil improve" not in said
    assert "Use the model within the range of motion that was recorded." in said


def finding(effect, **parameters):
    values = {f"j1.{effect}.{n}": Value(*v) for n, v in parameters.items()}
    return Finding(effect, "joint1", 0.5, 2.0, 1.0, 0.1, 0.6, values, [])


NAN = float("nan")


@pytest.mark.parametrize(
    ("effect", "values", "shown"),
    [
        (
            "presliding",
            {
                **{"f0": (0.0, 8e-5, "N m"), "f1": (0.0, 3e-4, "N m")},
                **{"f2": (0.0, 8e-4, "N m"), "f3": (0.012, 5e-4, "N m")},
                **{"s": (0.0057, 1e-4, "rad"), "form": (1.0, NAN, "")},
            },
            "f3 = 0.012 +- 0.0005 N m; s = 0.0057 +- 0.0001 rad",
        ),
        (
            "cogging",
            {
                **{"a1": (0.001, 0.002, "N m"), "b1": (-0.01, 0.005, "N m")},
                **{"a2": (0.3, 0.003, "N m"), "b2": (0.4, 0.004, "N m")},
                "p": (0.8, NAN, "1/rad"),
            },
            "amplitude = 0.5 +- 0.0037 N m, period = 0.625 rad",
        ),
        (  # a share and a friction are no harmonics, though there are two of them and a frequency
            "elastic-transmission",
            {
                **{"a": (0.9, 0.06, "1"), "fl": (0.004, 0.005, "N m")},
                **{"k": (45.0, 0.2, "N m/rad"), "zeta": (0.06, NAN, "1")},
            },
            "k = 45 +- 0.2 N m/rad",
        ),
        (
            "base-tilt",
            {"rx": (0.1, 2e-3, "rad"), "ry": (-0.06, 2e-3, "rad")},
            "rx = 0.1 +- 0.002 rad, ry = -0.06 +- 0.002 rad",
        ),
        (
            "periodic-disturbance",
            {"a": (0.3, 0.03, "N m"), "b": (0.4, 0.03, "N m"), "f": (4.0, 0.01, "Hz")},
            "amplitude = 0.5 +- 0.03 N m, period = 0.25 s",
        ),
        (  # every run has its own
            "periodic-disturbance",
            {
                **{"a[mon]": (0.3, 0.03, "N m"), "b[mon]": (0.4, 0.03, "N m")},
                **{"a[tue]": (0.1, 0.03, "N m"), "b[tue]": (0.9, 0.03, "N m")},
                "f": (4.0, 0.01, "Hz"),
            },
            "amplitude[mon] = 0.5 +- 0.03 N m, period = 0.25 s",
        ),
        (
            "payload-change",
            {"m": (0.7, 0.002, "kg"), "mx": (0.0, 0.01, "kg m"), "t0": (9.7, 1e-3, "s")},
            "m = 0.7 +- 0.002 kg, t0 = 9.7 +- 0.001 s",
        ),
        (
            "missed-counts",
            {"a[mon]": (1.001, 0.002, "1"), "t0": (0.0, NAN, "s")},
            "a[mon] = 1.001 +- 0.002, at the jumps that are recorded",
        ),
        (
            "stribeck",
            {"fs": (0.9, 0.6, "N m"), "vs": (0.06, 0.001, "rad/s"), "n": (2.0, NAN, "1")},
            "fs = 0.9 +- 0.6 N m; vs = 0.06 +- 0.001 rad/s",
        ),
        (  # a level that this form has not comes before the one that it has
            "presliding",
            {
                **{"f0": (0.0, 5e-4, "N"), "f1": (0.0, 1.5e-3, "N"), "f2": (2.2, 1.6e-3, "N")},
                **{"s": (2.7e-5, 2e-8, "m"), "form": (1.0, NAN, "1"), "vs": (0.0, NAN, "m/s")},
            },
            "f2 = 2.2 +- 0.0016 N; s = 2.7e-05 +- 2e-08 m",
        ),
        (
            "friction-drift",
            {"dc": (-0.26, 0.001, "N m"), "dv": (-0.9, 0.001, "N m s/rad"), "T": (9.0, 0.1, "s")},
            "dc = -0.26 +- 0.001 N m, T = 9 +- 0.1 s",
        ),
        ("delay", {"a": (1.0, 0.01, "1"), "T": (0.012, 1e-4, "s")}, "T = 0.012 +- 0.0001 s"),
        ("load-friction", {"mu": (0.16, 0.001, "1"), "of": (0.0, NAN, "1")}, "mu = 0.16 +- 0.001"),
    ],
)
def test_the_value_shown_says_how_large_an_effect_is(effect, values, shown):
    assert _telling(finding(effect, **values)) == shown


def two_joints(low, high):
    """A turning and a sliding joint, of a range for both."""
    robot = SimpleNamespace(units=("rad", "m"))
    span = np.array([[low, high], [low, high]])
    return SimpleNamespace(joints=("joint1", "slide"), span=span, robot=robot)


@pytest.mark.parametrize(
    ("high", "shown"),
    [
        (1.0, "changes by 2 N m: least at 0 rad, most at 1 rad"),
        (2.0, "amplitude = 1 +- 0.01 N m, period = 2 rad"),
    ],
)
def test_a_change_over_less_than_a_period_is_told_as_a_change(high, shown):
    """A friction that grows along the range was told as a wave of 1.8 rad over 0.9 rad."""
    values = dict.fromkeys(("a1", "a2", "b2"), (0.0, 0.01, "N m"))
    values |= {"b1": (-1.0, 0.01, "N m"), "p": (0.5, 0.01, "1/rad")}
    assert _telling(finding("position-friction", **values), "", two_joints(0.0, high)) == shown


def test_friction_over_another_joint_is_told_over_that_ones_range():
    """Its first coefficient is negative, and the friction grows."""
    values = {"b": (-1.0, 0.1, "N m/m"), "c": (2.0, 0.1, "N m/m^2")}
    values |= {"q0": (-1.0, NAN, "m"), "joint": (2.0, NAN, "1")}
    said = _telling(finding("posture-friction", **values), "", two_joints(-1.0, 1.0))
    assert said == "changes by 6.12 N m: least at slide = -0.75 m, most at slide = 1 m"


def test_a_shape_on_its_bound_is_told_beside_the_size_that_holds_with_it():
    """A peak of friction of three times its size, at a speed that the data did not show."""
    values = {"fs": (1.67, 0.12, "N m"), "n": (0.5, 0.02, "1")}
    found = finding("stribeck", **values)
    name = "j1.stribeck.vs"
    found.parameters[name] = replace(Value(0.021, NAN, "rad/s"), at_bound=True)
    assert _telling(found).startswith("fs = 1.67 +- 0.12 N m; vs = 0.021 rad/s, on its bound")


def test_of_coefficients_in_several_units_one_that_is_well_determined_is_told():
    """Two coupled motors were told by an inertia of 2.5 standard errors."""
    values = {"i": (2e-6, 8e-7, "N m s^2/rad"), "fc": (0.01, 1e-4, "N m")}
    values |= {"fv": (0.02, 1e-3, "N m s/rad"), "joint": (2.0, NAN, "1"), "r": (1.0, NAN, "1")}
    assert _telling(finding("coupled-transmission", **values)).startswith("fc = 0.01")


@pytest.mark.parametrize(("after", "said"), [(140.0, False), (60.0, True)])
def test_a_law_in_the_place_of_a_correction_is_told_where_that_does_something(after, said):
    """Of 164 % a correction left 149, and any law would have done as much."""
    made = UnnamedCorrection(
        "correction-load", "its load", "joint2", 164.0, after, 1.0, ("spring",)
    )
    assert bool(laws([made])) == said


def test_what_one_coefficient_says_is_told_by_it():
    values = {"k": (3.0, 0.1, "N m/rad"), "t0": (0.1, 0.01, "N m")}
    assert "k = 3" in _telling(finding("spring", **values), "", two_joints(-1.0, 1.0))
    values = dict.fromkeys(("gs", "gc"), (0.3, 0.01, "N m"))
    assert "gs = 0.3" in _telling(finding("unbalance", **values), "", two_joints(-1.0, 1.0))


@pytest.mark.parametrize(
    ("effect", "values", "words"),
    [
        ("friction-drift", {"of": 0.0, "T": 9.0}, ["over time"]),
        ("friction-drift", {"of": 1.0, "T": 9.0}, ["over measured motor temperature"]),
        ("offset-drift", {"of": 1.0, "T": 9.0}, ["over measured motor temperature"]),
        ("friction-drift", {"of": 2.0, "T": 9.0}, ["warmed by the joint's own motion"]),
        ("presliding", {"form": 1.0, "vs": 0.0, "s": 0.01}, ["Dahl"]),
        ("coupled-transmission", {"joint": 2.0, "r": 0.5}, ["elbow"]),
        ("cogging", {"p": 3.0}, []),
    ],
)
def test_the_form_that_a_law_takes_is_shown_beside_its_value(effect, values, words):
    found = finding(effect, **{n: (x, NAN, "1") for n, x in values.items()})
    assert _forms(found, ("joint1", "elbow")) == words


@pytest.mark.parametrize(
    ("share", "shown"), [(0.92, "92"), (0.0103, "1"), (0.0024, "0.2"), (0.0, "0")]
)
def test_a_small_share_of_all_is_not_rounded_to_nothing(share, shown):
    assert percent(share) == shown


def test_of_rivals_only_those_are_to_be_separated_that_the_answer_lists(plain):
    sets = [
        Indistinguishable(("spring", "rigid-body"), "", "slow strokes"),
        Indistinguishable(("spring", "unbalance"), "", EITHER),
    ]
    doubtful = replace(finding("spring"), rivals=["unbalance"])
    m = replace(from_diagnosis(plain), verdict="ambiguous", findings=[doubtful], sets=sets)
    wait, either = next_steps(m)
    assert "record" not in wait and "Do not take one of the rivals for the cause" in wait
    assert either.startswith("spring or unbalance: with the sizes found here")
    assert either.endswith("For predictions use either.")
    m = replace(m, sets=[sets[0], replace(sets[1], experiment="slow strokes")])
    assert "record the motion that separates them" in next_steps(m)[0]


def test_a_sure_name_says_what_acts_like_it_in_this_motion(monkeypatch, plain):
    """A spring beside a weight had been told as a weight of 18.07 +- 0.26 N m, which was 11."""
    sets = [
        Indistinguishable(("unbalance", "spring"), "", EITHER),
        Indistinguishable(("torque-gain", "every other parameter"), "", ""),
    ]
    monkeypatch.setattr(diagnose_command, "at_issue_of", lambda d: (sets[:1], sets[1:]))
    one, other = (replace(finding(n), confidence=0.95) for n in ("unbalance", "torque-gain"))
    (line,) = diagnose_command._alike(plain, [one, other])
    assert line.strip().startswith("unbalance on joint1 acts like spring in this motion: ")
    d = replace(plain, verdict="missing-effect", findings=[one])
    assert line in diagnose_command.short(d, ladder(d), None)


@pytest.mark.parametrize(("weight", "shown"), [(0.43, True), (0.05, False)])
def test_a_name_with_a_likelier_rival_is_not_listed_as_the_missing_effect(plain, weight, shown):
    """A coupled spring at 0.07 stood there alone, its rival of 0.43 in a line below."""
    f = replace(finding("spring"), confidence=0.07, rivals=["unbalance"], rival_weights=[weight])
    table = diagnose_command._names_table(replace(plain, findings=[f]))
    assert ("spring on joint1, or a rival" in table) == shown
    sure = diagnose_command._names_table(replace(plain, findings=[finding("spring")]))
    assert "or a rival" not in sure


def test_a_name_that_is_doubtful_without_a_rival_says_why(plain):
    doubtful = replace(finding("spring"), reason="gravity acts upwards beside it")
    m = replace(from_diagnosis(plain), verdict="ambiguous", findings=[doubtful], sets=[])
    assert next_steps(m) == ["Do not rely on spring on joint1 yet: gravity acts upwards beside it."]


def test_a_value_that_is_not_determined_is_shown_only_where_there_is_no_other():
    found = finding("position-torque", t0=(0.02, NAN, "N m"), c1=(0.3, 0.01, "N m"))
    name = "j1.position-torque.t0"
    found.parameters[name] = replace(found.parameters[name], identifiable=False)
    assert _telling(found) == "c1 = 0.3 +- 0.01 N m"
    del found.parameters["j1.position-torque.c1"]
    assert _telling(found) == "t0 = 0.02 N m, undetermined"


def test_a_part_of_a_law_that_is_not_there_says_nothing_of_its_size():
    """A spring that the data hardly determine was told as "fl = 0 N m"."""
    values = {"a": (0.6, 0.1, "1"), "k": (0.01, 0.02, "N m/rad"), "fl": (0.0, NAN, "N m")}
    told = _telling(finding("elastic-transmission", **values), "0.02 N m")
    assert told == "0.02 N m rms in total; no value is determined"


def test_a_spring_that_carries_a_part_says_so_beside_its_stiffness():
    """A drive whose rotor the model counts to the link showed a stiffness a third too high."""
    values = {"a": (0.75, 2e-4, "1"), "k": (99.9, 0.02, "N m/rad"), "zeta": (0.02, NAN, "1")}
    told = _telling(finding("elastic-transmission", **values))
    assert told == "k = 99.9 +- 0.02 N m/rad, a = 0.75"
    there = {"fl": (0.0, NAN, "N m"), "i": (0.0, NAN, "kg m^2")}
    part = finding("elastic-transmission", **values, **there).parameters
    said = remark("elastic-transmission", part)
    assert "the spring's stiffness is a k = 74.93; " in said and "k / a = 133.2" in said
    values["a"] = (0.98, 2e-4, "1")
    assert _telling(finding("elastic-transmission", **values)) == "k = 99.9 +- 0.02 N m/rad"
    whole = finding("elastic-transmission", **values, **there).parameters
    assert remark("elastic-transmission", whole) == ""


@pytest.mark.parametrize(
    ("effect", "values", "said"),
    [
        (  # a speed is no size, and neither value is determined
            "stribeck",
            {"fs": (0.0245, 0.037, "N m"), "vs": (0.1162, 0.15, "rad/s"), "n": (0.5, 0.7, "1")},
            "fs = 0.0245 +- 0.037 N m, undetermined",
        ),
        (  # nor is one that is determined
            "stribeck",
            {"fs": (0.0245, 0.037, "N m"), "vs": (0.1162, 0.01, "rad/s"), "n": (0.5, 0.1, "1")},
            "fs = 0.0245 +- 0.037 N m, undetermined",
        ),
        (  # nor is a share of one
            "delay",
            {"a": (1.0, 0.001, "1"), "T": (0.002, 0.009, "s")},
            "T = 0.002 +- 0.009 s, undetermined",
        ),
        (
            "actuator-lag",
            {"a": (0.1, 0.2, "1"), "T": (0.002, 0.009, "s"), "n": (1.0, NAN, "1")},
            "T = 0.002 +- 0.009 s, undetermined",
        ),
    ],
)
def test_a_size_that_is_not_determined_is_said_to_be_none(effect, values, said):
    found = finding(effect, **values)
    assert _telling(found) == said
    assert _telling(found, "0.012 N m") == "0.012 N m rms in total; no value is determined"


def test_of_several_shapes_the_surest_is_shown():
    values = {"a": (0.9, 0.06, "1"), "b": (0.02, 0.015, "rad"), "fl": (0.4, 0.01, "N m")}
    assert _telling(finding("backlash", **values)) == "fl = 0.4 +- 0.01 N m"
    values["b"] = (0.02, 0.002, "rad")  # the play itself, once it is determined
    assert _telling(finding("backlash", **values)) == "b = 0.02 +- 0.002 rad"


@pytest.mark.slow
def test_the_contribution_is_what_the_error_falls_by(late):
    found = late.findings[0]
    j = late.result.problem.joints.index(found.joint)
    size, unit = _contribution(late, found).split(" ", 1)
    left = found.relative_after / 100 * late.ladder[0].heldout.effort_rms[j]
    whole = found.relative_before / 100 * late.ladder[0].heldout.effort_rms[j]
    assert unit == "N m" and float(size) ** 2 + left**2 == pytest.approx(whole**2, rel=0.1)
    assert _contribution(late, replace(found, joint=None)) == ""
    unsure = {n: replace(v, stderr=9 * abs(v.value)) for n, v in found.parameters.items()}
    d = replace(late, findings=[replace(found, parameters=unsure)])
    assert f"{size} N m rms in total; no value is determined" in short(d, ladder(late), None)


def test_a_lateness_is_printed_with_its_share_and_with_half_a_sample(late):
    """Share and time make up for each other; so do efforts of an instant and of a sample."""
    rows = re.findall(r"late by ([0-9.]+) \+- ([0-9.]+) ms", short(late, ladder(late), None))
    period = 1e3 * late.result.problem.recordings[0].period
    assert len(rows) == 2 and not late.result.problem.of_instants
    for (size, error), samples in zip(rows, (4, 12), strict=True):
        assert float(error) >= 0.49 * period
        assert abs(float(size) - samples * period) < 2 * float(error)
    values = {"j1.delay.a": Value(0.9, float("nan"), "1"), "j1.delay.T": Value(0.02, 1e-4, "s")}
    v = effort_lateness(replace(late.findings[0], effect="delay", parameters=values), 3e-3)
    assert v.value == pytest.approx(0.018) and v.stderr == pytest.approx(3e-3, rel=0.01)


@pytest.mark.slow
def test_a_first_error_that_is_not_the_given_model_s_is_told(late):
    """Where an effect was added beside others, two tables begin with different errors."""
    assert ERROR_LEGEND not in short(late, ladder(late), None)
    found = replace(late.findings[0], relative_before=1.01 * late.findings[0].relative_before)
    assert ERROR_LEGEND in short(replace(late, findings=[found]), ladder(late), None)


def test_degrees_taken_for_radians_are_told_before_any_value(plain, tmp_path):
    own = plain.warnings
    told = "joint1: q1 runs from 1.36 to 48.4 rad; is it in degrees? Scale it in a map"
    try:
        plain.warnings = [*own, ("unit", told), ("unit", told.replace("1.36", "1.11"))]
        said, long = short(plain, ladder(plain), Files()), text(plain, ladder(plain))
        diagnosis_report(plain, tmp_path / "r.html")
    finally:
        plain.warnings = own
    assert f"Check first: {told} (in 2 sessions)" in said and "1.11" not in said
    assert said.index("Check first") < said.index("error %")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert long.count(told) == page.count(told) == 1


def test_both_errors_have_one_name_and_a_sentence(plain, tmp_path):
    said, long = short(plain, ladder(plain), Files()), text(plain, ladder(plain))
    assert "simulated %: of the position, simulated for 0.5 s" in said
    assert "simulated error, 0.5 s" in long and "multi-step" not in said + long
    run = plants.tanh_axes()
    compared = compare_text(compare([run], plain.result.model.as_it_is()))
    assert "simulated %" in compared and "multi-step" not in compared
    assert "values of the model file; nothing was fitted; errors on these sessions" in compared


def test_what_is_to_be_accepted_is_a_command(late):
    lines = short(late, ladder(late), Files(("a.mcap",), model="m.toml")).splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("  - Accept"))
    assert lines[at].endswith("all parameters are fitted again:")
    assert lines[at + 1].startswith("    hil add ")
    assert not any("Accept" in line for line in short(late, ladder(late), None).splitlines())


def test_a_second_name_that_is_not_sure_is_neither_accepted_nor_without_its_rivals(late):
    """What is sure is accepted; the other one's rivals stand on the first screen."""
    sure, other = late.findings
    own, rivals = late.findings, ["cogging", "spring"]
    perhaps = replace(other, confidence=0.26, rivals=rivals, reason="others do as well")
    try:
        late.findings = [replace(sure, confidence=1.0), perhaps]
        said = short(late, ladder(late), Files(("a.mcap",), model="m.toml"))
    finally:
        late.findings = own
    assert f"  rivals of {other.effect} on {other.joint}: cogging, spring" in said
    assert f"Do not rely on {other.effect} on {other.joint} yet: others do as well." in said
    assert f"Confirm {sure.effect} on {sure.joint}" in said
    assert (
        said.count("    hil add ") == 1 and f"Confirm {other.effect} on {other.joint}" not in said
    )


def test_a_model_that_simulates_twice_as_badly_is_not_for_simulation(late):
    rungs = ladder(late)
    files = Files(("a.mcap",), model="m.toml")
    assert "not to simulate" not in short(late, rungs, files)
    first = rungs[0].multi_step
    worse = replace(first, rms=3.0 * first.rms, power=9.0 * first.power)
    assert "not to simulate" in short(
        late, [*rungs[:-1], replace(rungs[-1], multi_step=worse)], files
    )


def test_a_doubted_unit_is_to_be_checked_before_all_else(plain):
    m = replace(from_diagnosis(plain), verdict="unexplained", findings=[], sets=[])
    doubted = replace(m, warnings=[*m.warnings, ("effort-scale", "all efforts are 0.02 times")])
    assert next_steps(m)[0] != CHECK_FIRST
    assert next_steps(doubted) == [CHECK_FIRST, AGAIN]


def test_a_rig_s_arm_stands_in_the_verdict():
    run = replace(plants.tanh_axes(), arm="leader")
    d = diagnose([run], model(run))
    for said in (short(d, ladder(d), None), text(d, ladder(d))):
        assert said.splitlines()[0].endswith("down to the noise floor (arm leader).")


def test_motions_that_are_proposed_are_of_what_was_typed():
    files = Files(("Versuch 1.csv",), (), "my arm.toml", "left", ("--robot", "arm.urdf"))
    said = "hil excite a.mcap --for x --model M.toml --joint j -o next.toml"
    robot = "'Versuch 1.csv' --robot arm.urdf --arm left --model 'my arm.toml'"
    assert with_files(said, files) == f"hil excite {robot} --for x --joint j -o next.toml"
    assert with_files("hil excite RIG.toml --for x", Files(("a.mcap",), (), "m.toml")) == (
        "hil excite RIG.toml --model m.toml --for x"  # whose limits the rig file knows
    )
    assert with_files("", files) == ""
    typed = "hil add spring --joint 'j 1' --model 'my arm.toml' --arm left"
    said = with_files(to_try("spring", "j 1"), files).splitlines()
    assert said[-1] == f"{typed} --session 'Versuch 1.csv' --robot arm.urdf"
    beside = to_try("spring", "j", beside=True)  # what helps only with the named effects
    typed = "hil add spring --joint j --model {} --session a.csv"
    for written, model_ in (("", "IMPROVED.toml"), ("better.toml", "better.toml")):
        said = with_files(beside, Files(("a.csv",), model="m.toml", written=written)).splitlines()
        assert said[-1] == typed.format(model_)


def test_an_arrow_and_its_numbers_stay_on_one_line():
    assert "2.49\u00a0%\u00a0\u2192\u00a00.60\u00a0%" in paragraph("(2.49 % -> 0.60 %)")


def test_the_first_analysis_says_once_that_it_compiles(monkeypatch, capsys):
    monkeypatch.setattr(bands, "compiled", lambda: False)
    note_compiling.cache_clear()
    note_compiling()
    note_compiling()
    assert capsys.readouterr().err == "compiling (once per installation), about 15 s\n"
    note_compiling.cache_clear()
    with terminal.silent():
        note_compiling()
    assert capsys.readouterr().err == ""
    monkeypatch.undo()
    assert bands.compiled()


def test_who_lacks_the_description_is_asked_for_that_before_all_else(plain):
    """A step of all efforts is what gravity of joints that were not given looks like, too."""
    name = next(n for n, e in catalogue.table().items() if Trait.GEOMETRY in e.traits)
    stands = UnnamedCorrection(name, "gravity of an unknown geometry", "joint1", 90.0, 20.0, 1.0)
    step = f"joint1: another scale of all efforts from 3.5 s on. {CUT_THERE}."
    warnings = [(NO_GEOMETRY, "3 joints without a robot description"), (CHANGED, step)]
    d = replace(plain, verdict="unexplained", findings=[], warnings=warnings, corrections=[stands])
    m = from_diagnosis(d)
    assert next_steps(m)[0].startswith("Give the robot's description first (--robot ARM.urdf)")
    described = from_diagnosis(replace(d, warnings=warnings[1:]))
    assert next_steps(described)[0] == f"{CUT_THERE}."


@pytest.mark.parametrize(
    ("named", "end"), [(True, " before you rely on a name."), (False, "more.")]
)
def test_a_slow_rate_is_told_before_what_follows_from_it(plain, named, end):
    slow = ("sample-rate", "50 Hz is slow for dynamics. Record at 100 Hz or more")
    m = replace(
        from_diagnosis(plain),
        warnings=[slow, slow],
        findings=[replace(finding("spring"), confidence=1.0)] * named,
    )
    m = replace(m, verdict="missing-effect" if named else "unexplained")
    first, *rest = next_steps(m)
    assert first.startswith("50 Hz is slow") and first.endswith(end)
    assert rest == next_steps(replace(m, warnings=[]))
    assert next_steps(replace(m, verdict="adequate"))[0] == VERDICT_CONSEQUENCES["adequate"][0]


def test_rivals_are_told_with_their_weights_where_these_are_known(plain):
    """A name at 0.09 led, and nothing said that its one rival had the rest."""
    doubtful = replace(finding("unbalance"), rivals=["spring", "stribeck"])
    assert doubtful.weighed_rivals == ["spring", "stribeck"]
    doubtful = replace(doubtful, rival_weights=[0.81, 0.1])
    assert doubtful.weighed_rivals == ["spring (0.81)", "stribeck (0.10)"]
    m = replace(from_diagnosis(plain), verdict="ambiguous", findings=[doubtful])
    assert "Rivals with this motion: spring (0.81), stribeck (0.10)." in _finding(m, doubtful)
    assert finding_json(doubtful)["rival_weights"] == [0.81, 0.1]


def test_of_a_rival_on_two_joints_the_larger_weight_is_told():
    term = Term(catalogue.get("spring"), 0, ())
    mine, other = Candidate(term, 1.0, 1.0), Candidate(replace(term, joint=1), 1.0, 1.0)
    unlike = Candidate(Term(catalogue.get("unbalance"), 0, ()), 1.0, 1.0)
    problem = SimpleNamespace(joints=("a", "b"), d=2)
    named = Named(mine, 0.5, [unlike, unlike, other], [(0.1, 0.2), (0.3, 0.1), (0.2, 0.2)])
    assert _weighed(named, problem) == {"unbalance": 0.3, "spring on b": 0.2}
    assert _weighed(replace(named, odds=[]), problem) == {"unbalance": 0.0, "spring on b": 0.0}


@pytest.mark.parametrize(("fitted", "held", "told"), [(1.84, 1.0, True), (1.05, 1.0, False)])
def test_an_error_of_the_fitted_runs_alone_is_told_as_theirs(fitted, held, told):
    """The table had 1.00 times the floor beside "an effect is missing"."""
    step = SimpleNamespace(
        heldout=SimpleNamespace(kind="holdout"),
        result=SimpleNamespace(rms=np.array([0.1, fitted])),
    )
    m = SimpleNamespace(
        verdict="unexplained",
        explained=step,
        after=step,
        ratio=lambda _: np.array([0.9, held]),
        last=SimpleNamespace(floor=SimpleNamespace(rms=np.ones(2))),
        problem=SimpleNamespace(holds=np.zeros(2, dtype=bool)),
        joints=["a", "b"],
        network=[],
    )
    text = remains(m)
    assert ("On the fitted runs the error of b is 1.84 times theirs." in text) is told
    assert bool(text) is told
    # a joint that only holds its place is not judged
    m.problem.holds[1] = True
    assert not remains(m)


@pytest.mark.parametrize(("rungs", "which"), [(1, "the model"), (2, "the improved model")])
def test_which_model_explains_the_fitted_runs_is_said(monkeypatch, rungs, which):
    """A correction had made "the model" explain them, with 19 floors left by the given one."""
    monkeypatch.setattr("hil.commands.diagnose.only_there", lambda *_: True)
    d = SimpleNamespace(verdict="unexplained", warnings=[], ladder=[1] * rungs, last=1, noise=1)
    assert verdict_sentence(d).startswith(
        f"unexplained: {which} explains the fitted data down to the noise"
    )
    monkeypatch.setattr("hil.report.text.only_there", lambda *_: True)
    monkeypatch.setattr("hil.report.text._undescribed", lambda m: False)
    monkeypatch.setattr("hil.report.text._open", lambda m: "b")
    steps = [object(), object()]
    m = SimpleNamespace(verdict="unexplained", findings=[], before=steps[0], last=1, floor=1)
    m.warnings = []
    m.after = steps[rungs - 1]
    said = f"{which.capitalize()} explains the fitted data, but not b in the held-out data."
    assert headline(m) == said


@pytest.mark.parametrize(
    ("findings", "effects", "said"),
    [
        ([1], 3, "improved model"),
        ([], 3, "improved model, what it adds has no sure name"),
        ([], 2, "model, refitted"),
    ],
)
def test_a_model_with_effects_that_have_no_name_is_not_only_refitted(findings, effects, said):
    """A model with three effects more was told to be the given one, refitted."""
    result = SimpleNamespace(model=SimpleNamespace(effects=[0, 0]))
    d = SimpleNamespace(
        findings=findings,
        ladder=[SimpleNamespace(result=result)],
        model=SimpleNamespace(effects=[0] * effects),
    )
    assert _what_is_written(d) == said


def test_the_headline_of_an_undecided_answer_has_what_is_sure_and_what_is_likely(plain):
    """It had led with a name at 0.09, and doubted one that was sure."""
    low = replace(finding("unbalance"), confidence=0.09, rivals=["spring"], rival_weights=[0.91])
    m = replace(from_diagnosis(plain), verdict="ambiguous", findings=[low])
    assert headline(m) == (
        "An effect is missing, most likely spring or unbalance on joint1. These data do not show "
        "which one it is."
    )
    m = replace(m, findings=[low, replace(finding("presliding"), confidence=1.0)])
    assert headline(m) == (
        "The model lacks presliding on joint1, and more, most likely spring or unbalance on "
        "joint1. These data do not show what that is."
    )


def test_a_command_of_a_step_is_on_a_line_of_its_own():
    assert items(["Record a chirp.\nhil excite a.csv --for <x>"]) == (
        "<ul><li>Record a chirp.<br><code>hil excite a.csv --for &lt;x&gt;</code></li></ul>"
    )
    assert items([]) == ""


def test_the_headline_of_runs_that_differ_says_what_differs(plain):
    """It had said that no effect of the catalogue passes, of another gain in one run."""
    change = Change("joint1", "scale of all efforts", "1", "run2", 0.0, 0.118, 0.99, 1.0)
    m = replace(from_diagnosis(plain), verdict="unexplained", findings=[])
    m = replace(m, last=replace(m.last, changes=(change,)))
    assert headline(m) == (
        "On joint1 the runs differ: another scale of all efforts in run2 (+11.8 % against the "
        "rest) explains most of the error."
    )
    m = replace(m, last=replace(m.last, changes=(replace(change, at=3.5),)))
    assert headline(m).startswith("On joint1 a value changes within a run: another scale of all")
    m = replace(m, last=replace(m.last, changes=(replace(change, share=0.3),)))
    assert "another scale" not in headline(m)
