"""What an answer says in words: nothing that it is not about, and everything that it is."""

import re

import plants
import pytest
from test_report import model

from hil.commands.diagnose import short, text
from hil.diagnosis.engine import diagnose
from hil.diagnosis.equivalence import at_issue_of
from hil.diagnosis.verbs import ladder
from hil.report.json import diagnosis_json
from hil.report.text import Files


@pytest.fixture(scope="module")
def plain():
    run = plants.tanh_axes()
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


def test_the_first_answer_is_one_screen():
    run = plants.late_axes((4, 12))
    d = diagnose([run], model(run))
    files = Files(("a b.mcap",), more=("--robot", "arm.urdf"), model="")
    lines = short(d, ladder(d), files).splitlines()
    assert lines[0].startswith("Verdict: ")
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


def test_the_next_command_adds_what_is_missing_unless_it_is_added_already():
    d = diagnose([run := plants.axis_with_stop(1.0, 1)], model(run))
    assert d.verdict == "missing-effect"
    files = Files(("a b.mcap",), model="", more=("--robot", "arm.urdf"))
    said = short(d, ladder(d), files)
    assert "    hil " in said and "'a b.mcap'" in said and "--robot arm.urdf" in said
    assert "    hil " not in short(d, ladder(d), None)


def test_an_adequate_model_has_one_error_and_no_command(plain):
    said = short(plain, ladder(plain), Files())
    assert "improved %" not in said
    assert "hil add" not in said and "hil improve" not in said
    assert "Use the model within the range of motion that was recorded." in said


def finding(effect):
    from hil.diagnosis.types import Finding

    return Finding(effect, "joint1", 0.5, 2.0, 1.0, 0.1, 0.6, {}, [])
