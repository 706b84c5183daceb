"""What an answer says in words: nothing that it is not about, and everything that it is."""

import plants
import pytest
from test_report import model

from hil.commands.diagnose import text
from hil.diagnosis.engine import diagnose
from hil.diagnosis.equivalence import at_issue_of
from hil.diagnosis.verbs import ladder
from hil.report.json import diagnosis_json


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


def finding(effect):
    from hil.diagnosis.types import Finding

    return Finding(effect, "joint1", 0.5, 2.0, 1.0, 0.1, 0.6, {}, [])
