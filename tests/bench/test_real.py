"""The yardstick of real recordings: a person's script, the cases, crashes, and the page."""

from __future__ import annotations

import json
import math
import os

import numpy as np
import plants
import pytest

from hil.bench import least_squares_script, real
from hil.bench.real import Ours, RealCase, RealRow, ScriptErrors
from hil.cli import main
from hil.errors import DataError
from hil.identify import bands
from hil.record import datasets
from hil.record.recording import RobotSource

needs_data = pytest.mark.skipif(
    not os.environ.get("HIL_DATA"), reason="HIL_DATA (folder of the public recordings) is not set"
)
AXIS = RobotSource("single-axis")


def test_person_finds_a_spring_and_nothing_in_a_complete_model():
    found = least_squares_script.cross_validated(
        [plants.sprung_axis(1), plants.sprung_axis(2), plants.sprung_axis(3)],
        [plants.sprung_axis(4)],
        AXIS,
    )
    assert found.chosen[0][0] in ("poly3", "poly6")
    assert found.final[0] < 0.1 * found.given[0]
    plain = least_squares_script.cross_validated(
        [plants.sprung_axis(k, spring=0.0) for k in (1, 2, 3)],
        [plants.sprung_axis(4, spring=0.0)],
        AXIS,
    )
    assert plain.chosen == ((),)
    np.testing.assert_array_equal(plain.given, plain.final)


def test_person_chooses_without_the_judged_runs():
    train = [plants.sprung_axis(1)]
    choices = {
        least_squares_script.cross_validated(train, [plants.sprung_axis(k, spring=s)], AXIS).chosen
        for k, s in ((4, 3), (5, -8))
    }
    assert len(choices) == 1


KNOWN = {
    "umn_grasper": (29.3, 5.15, [(0, 29.3, 5.15)]),
    "wam_follower": (41.34, 36.17, [(1, 6.33, 6.14), (3, 7.80, 7.03)]),
    "ur10": (14.4, 11.4, [(0, 15.8, 7.1), (5, 23.6, 18.6)]),
}


@needs_data
@pytest.mark.parametrize(
    "name",
    [*(pytest.param(x, marks=pytest.mark.slow) for x in ("umn_grasper", "wam_follower")), "ur10"],
)
def test_person_on_recordings(name, monkeypatch):
    # the published figures are of rows among which a joint that creeps while it sticks still moves
    monkeypatch.setattr("hil.identify.bands.CREEP", 0.0)
    # and whose counts are not seen in tables of rounded numbers
    monkeypatch.setattr("hil.record.jumps._multiples", lambda steps: 0.0)
    # and of speeds in whose noise the motion between two rows counts
    monkeypatch.setattr(
        "hil.identify.bands.white_noise", lambda r, most=True: bands.position_noise(r.q)
    )
    # and of no instants but the rows
    monkeypatch.setattr("hil.identify.bands.FEW", 0.0)
    # and of accelerations by differences of two neighbours
    monkeypatch.setattr("hil.identify.bands._slopes", lambda x, fs: np.gradient(x, 1 / fs, axis=0))
    train, hold = datasets.load_set(name, "train"), datasets.load_set(name, "hold")
    found = least_squares_script.cross_validated(train, hold, train[0].robot)
    given, final, joints = KNOWN[name]
    row = RealRow(name, "", False, list(train[0].joints), found.holds.tolist(), "", "", 0.0)
    assert row.whole(found.given.tolist()) == pytest.approx(given, abs=0.06)
    assert row.whole(found.final.tolist()) == pytest.approx(final, abs=0.06)
    for j, before, after in joints:
        assert found.given[j] == pytest.approx(before, abs=0.06)
        assert found.final[j] == pytest.approx(after, abs=0.06)


@needs_data
@pytest.mark.slow
def test_a_case_end_to_end():
    row = next(iter(real.examine_cases(real.cases(["a_spring"]))))
    assert isinstance(row.script, ScriptErrors)
    assert isinstance(row.ours, Ours)
    # the given spring is the same law on the same rows
    assert row.ours.ladder[0] == pytest.approx(row.script.given, rel=1e-3)
    assert row.ours.written < len(row.ours.ladder) == len(row.ours.labels)
    assert len(row.ours.floor) == len(row.joints) == 1
    assert row.mebibytes > 50


def test_cases_are_one_of_a_name_and_of_every_set():
    names = [c.name for c in real.CASES]
    assert len(set(names)) == len(names)
    assert {n.split()[0] for n in names} == set(datasets.DATASETS)
    assert next(c.name for c in real.cases(["springs", "ur10"])) == "ur10"
    assert all(c.complete for c in real.cases(["springs", "panda"]))
    with pytest.raises(DataError, match="unknown case 'ur11'"):
        real.cases(["ur11"])


def two() -> real.SessionSplit:
    return [plants.sprung_axis(1)], [plants.sprung_axis(2)]


def test_an_error_of_ours_is_a_row(monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("no floor")

    monkeypatch.setattr(real, "ours", broken)
    row = real.examine_case(RealCase("axis", "drive", two))
    assert isinstance(row.script, ScriptErrors)
    assert str(row.ours).startswith("ZeroDivisionError at test_real.py:")
    assert real.INTERNAL_ERROR in real.case_line(row)


def dies(case: RealCase) -> RealRow:
    os._exit(7)


def lacks(case: RealCase) -> RealRow:
    raise DataError("get it from there")


@pytest.mark.slow
def test_a_process_that_dies_is_a_row_and_missing_data_an_error():
    case = RealCase("axis", "drive", two)
    (row,) = real.examine_cases([case], work=dies)
    assert row.ours == row.script == "its process ended with status 7"
    assert real.case_line(row)[0] == "axis"
    with pytest.raises(DataError, match="get it from there"):
        list(real.examine_cases([case], work=lacks))


def test_command_names_the_source_of_what_is_not_there(monkeypatch, capsys):
    monkeypatch.delenv("HIL_DATA", raising=False)
    assert main(["bench", "real", "--only", "ur10"]) == 2
    assert "inverse-dynamics-solver" in capsys.readouterr().err


def row(case: str, ours: Ours | str, complete: bool = False) -> RealRow:
    """A case of two joints that move and one that holds."""
    script = ScriptErrors([4.0, 4.0, 90.0], [3.0, 1.0, 90.0], [["slip"], [], []], 0.5)
    return RealRow(
        case, "arm", complete, ["a", "b", "c"], [False, False, True], script, ours, 200.0
    )


def mine(*rungs: float, written: int = 0, names: tuple[str, ...] = (), own: bool = False) -> Ours:
    """Our side with the same error on every joint that moves."""
    named = [(n, 0.9) for n in names]
    ladder = [[x, x, 70.0] for x in rungs]
    # without the judged runs the last rung is written
    blind = tuple(ladder[-1]) if ladder else ()
    labels = ["rung"] * len(rungs)
    return Ours("verdict", named, labels, ladder, written, [0.5] * 3, own, 2.0, blind)


ROWS = (
    row("good", mine(5.0, 2.0, written=1, names=("presliding on a",))),
    row("shy", mine(5.0, 2.0), complete=True),
    row("alarm", mine(5.0, 6.0, written=1, names=("cogging on b",)), complete=True),
    row("own", mine(5.0, 2.3, written=1, names=("torque-offset on a",), own=True)),
    row("bad data", mine()),
    row("crash", "ValueError at here.py:1: shapes | differ"),
)


def test_table_of_results():
    given, _, person_error, ours, blind, floor, far = real.case_line(ROWS[0])[1:8]
    assert (given, person_error, ours, blind, floor, far) == (
        "5.0",
        "2.2",
        "2.0",
        "2.0",
        "0.5",
        "0.89",
    )
    assert real.case_line(ROWS[1])[4:6] == ["5.0", "2.0"]
    assert real.case_line(ROWS[3])[7] == "1.03*"
    assert real.case_line(ROWS[4])[3:5] == ["2.2", "-"]
    assert math.isnan(real.ratio(ROWS[4])) and math.isnan(real.blind_ratio(ROWS[4]))
    assert real.blindly_worse(ROWS[2]) and not real.blindly_worse(ROWS[1])
    (line,) = (x for x in real.aims(ROWS) if "without a look" in x)
    assert line.endswith("at most 1.1 times 3, below 2, worse than the given model 1 (alarm)")
    assert real.joint_lines(ROWS[0])[0][-1] == "slip"
    assert real.joint_lines(ROWS[0])[2][1:3] == ["c (holds)", "-"]
    assert real.by_kind(ROWS) == [["arm", "6", "2", "1", "1", "2.46"]]


def test_aims_count_what_fails():
    text = "\n".join(real.aims(ROWS))
    assert "error: 2 of 6 cases (aim: all)" in text
    assert "below the person's error: 1 of 6" in text
    assert "worse than the given model: 1 (alarm)" in text
    assert "internal errors: 1 (crash)" in text
    assert "missing: 1 (alarm) of 2" in text
    assert "noise floor stated above the person's error: 0" in text
    high = row("high", Ours("adequate", [], ["rung"], [[5.0] * 3], 0, [4.0] * 3, False, 1.0))
    assert "above the person's error: 1 (high)" in "\n".join(real.aims([high]))
    assert "by itself, judged runs included: 1 (own)" in text


def test_data_are_json():
    dead = RealRow("dead", "arm", False, [], [], "gone", "gone", math.nan)
    back = json.loads(json.dumps(real.json_rows([*ROWS, dead]), allow_nan=False))
    assert back[0]["ours"]["names"] == [["presliding on a", 0.9]]
    assert back[-1]["mebibytes"] is None


def test_page():
    text = real.page(ROWS, "hil bench real", "abc123")
    assert "revision abc123" in text
    assert "crash: ValueError at here.py:1" in text
    tables = [x for x in text.splitlines() if x.startswith("|")]
    widths = {len(real.REAL_HEAD), len(real.JOINT_HEAD), len(real.KIND_HEAD)}
    assert {x.count("|") - 1 for x in tables} == widths
