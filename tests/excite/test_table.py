"""The motion as a table for a rig of one's own: from rest to rest, and for robots without a rig."""

import json
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.excite import trajectory
from hil.excite.trajectory import Trajectory, sample
from hil.models.files import write_model
from hil.models.model import Use, Value, base_model
from hil.record.recording import RobotSource

RATE = 500.0


def motion(period=4.0):
    """Two joints: a path and a series that is in full motion at t = 0."""
    series = np.zeros((2, 3, 2))
    series[0, 0], series[1, 2] = (0.3, 0.1), (0.05, 0.2)
    via = np.array([[0.1, -0.2], [0.4, 0.1], [0.1, -0.2]])
    times = np.array([0.0, period / 2, period])
    return Trajectory(("a", "b"), ("rad", "m"), period, times, via, np.full(3, 0.3), series)


def test_a_table_begins_and_ends_at_rest_and_holds_the_motion_unchanged():
    x = motion()
    p = trajectory.played_back(x, 9.0, RATE, np.full(2, 10.0))
    assert p.rounds == 2 and p.lead == 2.0
    assert p.t[-1] == pytest.approx(2 * 4.0 + 2 * 2.0)
    assert np.abs(sample(x, np.zeros(1))[1]).max() > 0.1  # in motion, had there been no lead-in
    for end in (0, -1):
        assert np.abs(p.qd[end]).max() < 1e-9 and np.abs(p.qdd[end]).max() < 1e-9
    inner = (p.t >= 2.0) & (p.t <= 10.0)
    wanted = sample(x, p.t[inner] - 2.0)
    for got, want in zip((p.q, p.qd, p.qdd), wanted, strict=True):
        np.testing.assert_allclose(got[inner], want, atol=1e-9)


def test_speed_and_acceleration_are_the_derivatives_of_position():
    p = trajectory.played_back(motion(), 4.0, RATE, np.full(2, 10.0))
    rate = np.gradient(p.q, 1 / RATE, axis=0)[5:-5]
    np.testing.assert_allclose(p.qd[5:-5], rate, atol=2e-3)
    rate = np.gradient(p.qd, 1 / RATE, axis=0)[5:-5]
    np.testing.assert_allclose(p.qdd[5:-5], rate, atol=2e-2 * np.abs(p.qdd).max())


def test_the_lead_in_keeps_to_the_speed_limits():
    via = np.array([[0.0], [1.0], [0.0]])
    x = Trajectory(
        ("a",),
        ("rad",),
        2.0,
        np.array([0.0, 1.0, 2.0]),
        via,
        np.full(3, 0.05),
        np.zeros((1, 0, 2)),
    )
    quick = trajectory.played_back(x, 4.0, RATE, np.full(1, 10.0))  # strokes at 1 rad/s
    assert quick.lead == 2.0 and np.abs(quick.qd).max() > 1.3
    slow = trajectory.played_back(x, 4.0, RATE, np.full(1, 1.1))
    assert slow.lead > quick.lead and np.abs(slow.qd).max() <= 1.1


@pytest.fixture
def session(tmp_path, monkeypatch):
    """A single axis that was pushed about, imported without a URDF."""
    t = np.arange(4000) / 500.0
    q = 0.5 * np.sin(1.3 * t) + 0.1 * np.sin(7.1 * t)
    v = np.gradient(q, t)
    tau = 0.05 * np.gradient(v, t) + 0.2 * np.tanh(v / 0.01) + 0.1 * v
    tau += 0.002 * np.random.default_rng(0).standard_normal(t.size)
    monkeypatch.chdir(tmp_path)
    rows = np.column_stack([t, q, tau])
    np.savetxt("s.csv", rows, delimiter=",", header="t,q1,tau1", comments="")
    assert main(["import", "s.csv", "-o", "s.mcap"]) == 0
    return Path("s.mcap")


def test_a_single_axis_gets_its_motion_from_a_session(session, capsys):
    words = ["excite", str(session), "--for", "stribeck", "--seconds", "6", "--motion", "multisine"]
    assert main([*words, "-o", "m.toml", "--csv", "m.csv", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)["table"]
    rows = np.loadtxt("m.csv", delimiter=",", skiprows=1)
    head = Path("m.csv").read_text().split("\n")[0]
    assert head == "t,q1,qd1,qdd1" == ",".join(data["columns"])
    assert rows.shape == (data["rows"], 4) and rows[-1, 0] == pytest.approx(data["seconds"])
    recorded = np.loadtxt("s.csv", delimiter=",", skiprows=1)[:, 1]
    assert recorded.min() <= rows[:, 1].min() and rows[:, 1].max() <= recorded.max()
    wanted = sample(trajectory.read_trajectory("m.toml"), rows[:, 0] - data["lead_in_s"])[0]
    middle = (rows[:, 0] > data["lead_in_s"]) & (rows[:, 0] < rows[-1, 0] - data["lead_in_s"])
    np.testing.assert_allclose(rows[middle, 1:2], wanted[middle], atol=1e-6)


def test_what_cannot_be_played_by_hil_run_is_said(session, capsys):
    words = ["excite", str(session), "--for", "stribeck", "--seconds", "6", "--motion", "multisine"]
    assert main([*words, "-o", "m.toml"]) == 0
    assert "'hil run' plays on the arms of a rig file only" in capsys.readouterr().out


@pytest.mark.slow
def test_a_motion_of_another_length_than_asked_says_so(session, capsys):
    assert main(["excite", str(session), "-o", "m.toml", "--seconds", "30"]) == 0
    assert "one round takes 10 s: 3 whole rounds in the 30 s asked for" in capsys.readouterr().out
    words = ["--for", "stribeck", "--motion", "rests", "--seconds", "5"]
    assert main(["excite", str(session), "-o", "m.toml", *words]) == 0
    assert "longer than the 5 s asked for" in capsys.readouterr().out


def test_where_no_length_was_asked_for_none_is_missed(session, capsys):
    words = ["--for", "stribeck", "--motion", "multisine", "--joint", "joint1"]
    assert main(["excite", str(session), "-o", "m.toml", "--csv", "m.csv", *words]) == 0
    out = capsys.readouterr().out
    assert "asked for" not in out and "all joints" not in out and "beside it" not in out
    assert "multisine, 30 s: many frequencies" in out and "1 round of the motion, with 2 s" in out


@pytest.mark.slow
def test_a_shape_that_the_model_has_fitted_is_taken(session, capsys):
    words = ["--for", "stribeck", "--motion", "speed-ladder", "--seconds", "10"]
    fitted = base_model(RobotSource("single-axis")) + Use(
        "stribeck",
        values={
            "j1.stribeck.fs": Value(0.3, 0.01, "N m"),
            "j1.stribeck.vs": Value(0.0123, 0.001, "rad/s"),
            "j1.stribeck.n": Value(2.0),
        },
    )
    write_model(fitted, "fitted.toml")
    assert main(["excite", str(session), "-o", "m.toml", "--model", "fitted.toml", *words]) == 0
    out = capsys.readouterr().out
    assert "of the model: stribeck with vs = 0.0123 rad/s, n = 2\n  assumed: a noise" in out
    # a model without values is fitted to the session, as the base model is
    assert main(["excite", str(session), "-o", "m.toml", "--model", "s.model.toml", *words]) == 0
    own = capsys.readouterr().out
    assert main(["excite", str(session), "-o", "m.toml", *words]) == 0
    assert capsys.readouterr().out.split("largest")[1] == own.split("largest")[1]
    assert "assumed: an effect of 0.5 %" in own


@pytest.mark.slow
def test_a_recording_is_never_replaced_by_a_table(session, capsys):
    before = Path("s.csv").read_text()
    words = ["excite", str(session), "--for", "stribeck", "--motion", "rests", "--seconds", "5"]
    assert main([*words, "-o", "m.toml", "--csv", "s.csv"]) == 2
    assert "not a table of a motion" in capsys.readouterr().err
    assert Path("s.csv").read_text() == before and not Path("m.toml").exists()
    for _ in range(2):  # an older table may be
        assert main([*words, "-o", "m.toml", "--csv", "m.csv"]) == 0
