"""The speed benchmark on six seconds: it runs, finds the floor, and keeps its JSON contract."""

import importlib.util
import json

import numpy as np
import pytest

from hil.bench import identify

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def report() -> identify.Report:
    return identify.run_benchmark(seconds=6.0, repeats=1, lengths=(6.0,))


def test_parameters_predict_the_other_motion_down_to_the_noise(report: identify.Report) -> None:
    for peer in (identify.REFERENCE, "hil.fit"):
        (row,) = [r for r in report.rows if r.peer == peer and r.data == "complete"]
        assert np.all(np.abs(np.array(row.floor) - 1) < 0.03), row
        (row,) = [r for r in report.rows if r.peer == peer and r.data != "complete"]
        assert max(row.floor) > 1.05, row


def test_json_contract(report: identify.Report) -> None:
    out = json.loads(json.dumps(identify.report_data(report), allow_nan=False))
    assert {"machine", "recorded_s", "repeats", "rows", "lengths"} == set(out)
    assert {"peer", "data", "seconds", "wall", "ratio", "floor", "note"} == set(out["rows"][0])
    keys = {"recorded", "data", "seconds", "wall", "peak_mib", "verdict", "joints"}
    assert keys == set(out["lengths"][0])
    assert sorted(x["joints"] for x in out["lengths"]) == [3, 3, 7, 7]
    assert out["lengths"][0]["peak_mib"] > 50
    diagnosed = [r for r in out["rows"] if r["peer"] == "hil diagnose"]
    assert all("candidates" in r["note"] for r in diagnosed)
    text = identify.text(report)
    assert all(r["peer"] in text for r in out["rows"])


@pytest.mark.skipif(importlib.util.find_spec("figaroh") is not None, reason="FIGAROH is here")
def test_a_missing_peer_is_said_and_no_error(report: identify.Report) -> None:
    rows = [r for r in report.rows if r.peer.startswith("FIGAROH")]
    assert rows and all("not installed" in r.note and np.isnan(r.seconds) for r in rows)


def test_data_are_the_same_every_time() -> None:
    a, b = (identify.simulate_run(1.0, 3, True) for _ in range(2))
    np.testing.assert_array_equal(a.tau, b.tau)
    plain = identify.simulate_run(1.0, 3, False)
    np.testing.assert_array_equal(a.q, plain.q)
    # the missing effect is at most half of Coulomb friction
    assert np.all(np.abs(a.tau - plain.tau) <= identify.PEAK * identify.THREE_JOINT_ARM.fc + 1e-12)


def test_page_says_which_goals_hold():
    rows = [
        identify.IdentifyRow(peer, identify.DATA[missing], 1.0, 1.0, ratio)
        for peer, missing, ratio in (
            ("hil.fit", False, 0.7),
            ("hil.fit", True, 0.9),
            ("hil diagnose", False, 5.0),
            ("hil diagnose", True, 16.0),
        )
    ]
    length = identify.Length(600.0, 1.0, 1.0, 1000.0, "adequate", "complete")
    told = identify.goals(identify.Report(60.0, 3, rows, [length])).splitlines()[2:]
    assert [line.rpartition(": ")[2] for line in told] == ["met", "missed", "met", "missed", "met"]
    more = [
        identify.Length(60.0, s, s, 500.0, "adequate", "complete", d) for d, s in ((3, 2), (7, 7))
    ]
    told = identify.goals(identify.Report(60.0, 3, rows, [length, *more])).splitlines()
    assert told[-1] == "- seven joints, complete: 3.50 times three, goal 3: missed"
