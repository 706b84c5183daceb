"""Figures of the benchmark: what counts as right, ambiguous, wrong."""

import json

import numpy as np
import pytest

from hil.bench.diagnosis import cases, runner, session, tables
from hil.errors import DataError
from hil.experiments.parallel_runs import Where


def row(kind, hidden, named, verdict, excess=2.0):
    found = {"case": f"{hidden}{named}{verdict}{excess}", "kind": kind, "robot": "arm",
             "noise": "white", "excitation": "strokes", "seed": 0, "force": False,
             "hidden": hidden, "excess": excess, "verdict": verdict, "before": 3.0, "after": 1.0,
             "cpu": [0.3, 2.0], "revision": "abc"}  # fmt: skip
    found["named"] = [
        {"effect": e, "joint": j, "confidence": c, "share": 0.9, "rivals": r}
        for e, j, c, r in named
    ]
    hid = tuple(cases.HiddenEffect(e, int(j[-1]) - 1, x) for e, j, x in hidden)
    case = cases.SessionCase(kind, "arm", hid, "white", "strokes", 0)
    return found | {"outcome": runner.outcome(case, found)}


STRIBECK = [["stribeck", "joint2", 1.5]]


@pytest.mark.parametrize(
    ("kind", "hidden", "named", "verdict", "outcome"),
    [
        ("one", STRIBECK, [("stribeck", "joint2", 0.9, [])], "missing-effect", "right"),
        ("one", STRIBECK, [("stribeck", "joint1", 0.9, [])], "missing-effect", "wrong"),
        ("one", STRIBECK, [("stribeck", "joint2", 0.5, ["x"])], "ambiguous", "ambiguous"),
        ("one", STRIBECK, [("x", "joint2", 0.5, ["stribeck"])], "ambiguous", "ambiguous"),
        ("one", STRIBECK, [("x", "joint2", 0.9, ["stribeck"])], "missing-effect", "wrong"),
        ("one", STRIBECK, [], "adequate", "missed"),
        ("none", [], [], "adequate", "right"),
        ("none", [], [("x", None, 0.9, [])], "missing-effect", "wrong"),
        ("outside", STRIBECK, [], "unexplained", "right"),
        ("outside", STRIBECK, [("stribeck", "joint2", 0.9, [])], "missing-effect", "wrong"),
    ],
)
def test_outcome(kind, hidden, named, verdict, outcome):
    assert row(kind, hidden, named, verdict)["outcome"] == outcome


def test_wilson_interval():
    low, high = tables.Proportion(9, 10).interval
    # Brown, Cai, DasGupta 2001: 0.596 to 0.982
    assert (round(low, 3), round(high, 3)) == (0.596, 0.982)
    for n in range(1, 60):
        assert tables.Proportion(0, n).interval[0] >= 0.0 and "-0" not in str(
            tables.Proportion(0, n)
        )
        assert tables.Proportion(n, n).interval[1] <= 1.0


def test_progress_is_told_in_a_file_too(capsys: pytest.CaptureFixture[str]) -> None:
    found = runner.results(abs, list(range(-25, 0)), Where(2), "session")
    assert sorted(found) == [(-k, k) for k in range(25, 0, -1)]
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 10 and lines[-1] == "25 of 25 sessions"


def test_report_and_resume(tmp_path):
    rows = [
        row("one", STRIBECK, [("x", "joint2", 0.97, [])], "missing-effect"),
        row("none", [], [], "adequate"),
    ]
    text = tables.report(rows, "hil bench diagnosis")
    assert "| stribeck" in text and "(0/1" in text
    unstable = {k: v for k, v in rows[0].items() if k not in ("excess", "before", "after")}
    text = tables.report([*rows, unstable | {"outcome": "unstable"}], "hil bench diagnosis")
    assert "1 sessions unstable: not counted." in text
    path = tmp_path / "r.jsonl"
    path.write_text("".join(json.dumps(r) + "\n" for r in rows) + '{"half')
    assert runner.read(path) == rows
    path.write_text('{"half\n' + json.dumps(rows[0]) + "\n")
    with pytest.raises(DataError):
        runner.read(path)


@pytest.mark.parametrize("kind", session.MOTION_KINDS)
def test_reference_is_consistent(kind):
    r = session.reference_motion(kind, 7)
    slope = np.gradient(r[..., 0], 1e-3, axis=0)
    assert np.abs(slope - r[..., 1])[1500:-1].max() < 5e-3
    assert np.abs(r[..., 1]).max() < 3.0
    fold = r[:, 1, 0] - r[:, 2, 0]
    assert fold.min() > -0.95 and fold.max() < 1.13


def test_plan_is_as_large_as_promised():
    plan = cases.rig_plan()
    assert len({c.name for c in plan}) == len(plan)
    assert len({h.effect for c in plan for h in c.hidden}) >= 32
    assert sum(c.kind == "none" for c in plan) >= 40
    quick = cases.rig_plan(quick=True)
    assert {c.kind for c in quick} == {"one", "two", "none", "outside"}
    assert {h.effect for c in quick for h in c.hidden} == set(session.kinds_of_plant())
    # five minutes at 20 a minute
    assert len(quick) <= 100
