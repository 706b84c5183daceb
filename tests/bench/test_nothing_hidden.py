"""Sessions of the diagnosis benchmark that once got a false name."""

import pytest

from hil.bench.diagnosis import cases, runner

NAMED = {
    # a sign so sharp that the other run's low speeds looked like presliding
    "none/axis/white/repeated/2": "presliding",
    # force and motion a part of a sample apart: half a percent of another motor's command
    "none/arm/coloured/strokes/5/force": "torque-crosstalk",
    "none/arm/white/repeated/7/force": "torque-crosstalk",
}
FIRST, SECOND, AGAIN = NAMED


@pytest.mark.parametrize(
    "name", [FIRST, *(pytest.param(x, marks=pytest.mark.slow) for x in (SECOND, AGAIN))]
)
def test_nothing_is_named_where_nothing_is_hidden(name):
    (case,) = (c for c in cases.rig_plan() if c.name == name)
    row = runner.judged_row(case)
    assert (row["outcome"], row["verdict"]) == ("right", "adequate"), row["named"]


@pytest.mark.slow
def test_a_small_load_at_the_tip_is_not_surely_an_offset():
    """What it does on one joint is an offset there, but it acts on others, too."""
    name = "payload@1x0.5/arm/white/strokes/0"
    (case,) = (c for c in cases.rig_plan() if c.name == name)
    row = runner.judged_row(case)
    assert row["outcome"] in ("right", "ambiguous"), row["named"]
