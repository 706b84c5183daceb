"""Public recordings: found, verified, converted; the real files where HIL_DATA is set."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from record_tables import needs_data

from hil.cli import main
from hil.errors import DataError
from hil.record import datasets
from hil.record.checks import check
from hil.record.mcap_read import load
from hil.record.schema import read_fields


def test_missing_variable_is_named(monkeypatch):
    monkeypatch.delenv("HIL_DATA", raising=False)
    with pytest.raises(DataError, match=r"HIL_DATA is not set.*github\.com/wmkouw/NSI-EMPS"):
        datasets.path("emps", "DATA_EMPS.mat")


def test_missing_file_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("HIL_DATA", str(tmp_path))
    with pytest.raises(DataError, match=r"is not at .*tue_1dof\.npz.*commit"):
        datasets.tue_runs()


def test_wrong_checksum(monkeypatch, tmp_path):
    monkeypatch.setenv("HIL_DATA", str(tmp_path))
    (tmp_path / "emps").mkdir()
    (tmp_path / "emps" / "DATA_EMPS.mat").write_bytes(b"other")
    with pytest.raises(DataError, match=hashlib.sha256(b"other").hexdigest()):
        datasets.load_emps()


def test_unknown_names():
    with pytest.raises(DataError, match="unknown data set"):
        datasets.path("empz", "DATA_EMPS.mat")
    with pytest.raises(DataError, match="unknown file"):
        datasets.path("emps", "DATA.mat")


def test_shorthand_without_the_data_says_where_to_get_them(monkeypatch, tmp_path, capsys):
    monkeypatch.delenv("HIL_DATA", raising=False)
    words = ["import", "emps/DATA_EMPS.mat", "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 2
    assert "HIL_DATA" in capsys.readouterr().err
    assert datasets.resolve("mine/run.csv") is None


@needs_data
def test_shorthand(tmp_path, capsys):
    assert main(["import", "emps/DATA_EMPS.mat", "-o", str(tmp_path / "s.mcap")]) == 0
    back, r = load(tmp_path / "s.mcap"), datasets.load_emps()
    np.testing.assert_array_equal(back.q, r.q)
    assert back.metadata["unit"] == "m"
    reference = read_fields(tmp_path / "s.mcap", "/extras")[1]["qg"]
    assert np.abs(reference - r.q[:, 0]).max() < 0.02
    run = ["--run", "m2_question1a_foam2", "-o", str(tmp_path / "t.mcap")]
    assert main(["import", "tue_1dof_teleop/tue_1dof.npz", *run]) == 0
    assert main(["import", "tue_1dof_teleop/tue_1dof.npz", "-o", str(tmp_path / "u.mcap")]) == 2
    assert "holds 55 runs" in capsys.readouterr().err


@needs_data
@pytest.mark.parametrize("pulses", [False, True])
def test_emps(pulses):
    r = datasets.load_emps(pulses)
    assert (r.n, r.d) == (24841, 1)
    assert r.rate == pytest.approx(1000, rel=1e-4)
    assert check(r) == []


@needs_data
def test_tue_has_no_false_alarm():
    runs = datasets.tue_runs()
    assert len(runs) == 55
    assert [f for run in runs for r in datasets.load_tue(run).values() for f in check(r)] == []


@needs_data
def test_tue_signs():
    """Only these signs give positive inertia near the rig's 1/631.36 kg m^2, and friction."""
    follower = datasets.load_tue("m2_question1f_free_motion")["follower"]
    inertia, friction = _inertia(follower.t, follower.q[:, 0], follower.tau[:, 0])
    assert inertia == pytest.approx(1 / 631.36, rel=0.1)
    assert friction > 0
    leader = datasets.load_tue("m2_question1d_foam")["leader"]
    total = leader.tau[:, 0] + leader.tau_ext[:, 0]
    inertia, friction = _inertia(leader.t, leader.q[:, 0], total)
    assert 0.3 / 631.36 < inertia < 1.5 / 631.36
    assert friction > 0


def _inertia(t, q, effort):
    from scipy.signal import butter, filtfilt

    b, a = butter(4, 20 / (0.5 / np.median(np.diff(t))))
    q = filtfilt(b, a, q)
    qd = np.gradient(q, t)
    terms = np.stack([np.gradient(qd, t), qd, np.tanh(qd / 0.01), np.ones_like(q)], axis=1)
    terms = filtfilt(b, a, terms, axis=0)[200:-200:10]
    found = np.linalg.lstsq(terms, filtfilt(b, a, effort)[200:-200:10], rcond=None)[0]
    return found[0], found[2]


@needs_data
def test_tx40():
    r = datasets.load_tx40()
    assert r.joints == tuple(f"joint_{k}" for k in range(1, 7))
    assert r.rate == pytest.approx(5000)
    assert check(r) == []
    np.testing.assert_allclose(r.q[0], 0, atol=1e-3)
    assert abs(np.corrcoef(r.q[:, 4], r.q[:, 5])[0, 1]) < 0.9


SETS = {
    "umn_grasper": (1, 10, 10),
    "wam_follower": (4, 3, 2),
    "ur10": (6, 1, 1),
    "tiago": (8, 1, 1),
    "panda_30hz": (7, 1, 1),
}


@needs_data
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name == "umn_grasper" else name
        for name in SETS
    ],
)
def test_sets_of_runs_that_fit_and_runs_that_judge(name):
    train, hold = datasets.load_set(name, "train"), datasets.load_set(name, "hold")
    d, *counts = SETS[name]
    assert [len(train), len(hold)] == counts
    assert {r.d for r in (*train, *hold)} == {d}
    assert train[0].name == datasets.DATASETS[name].tables[0].removesuffix(".npz")
    if d == 1:
        assert train[0].tau_ext is not None
    else:
        assert train[0].robot.urdf


def test_set_without_the_data_names_its_public_source(monkeypatch):
    monkeypatch.delenv("HIL_DATA", raising=False)
    with pytest.raises(DataError, match=r"github\.com/MRDLab/mis-tool-characterization"):
        datasets.load_set("umn_grasper", "train")
    with pytest.raises(DataError, match="unknown data set"):
        datasets.load_set("ur11")
    with pytest.raises(DataError, match="unknown file"):
        datasets.load_set("ur10", "test")


@needs_data
def test_shorthand_of_a_set_finds_its_robot(tmp_path):
    assert main(["import", "ur10/hold_0.npz", "-o", str(tmp_path / "s.mcap")]) == 0
    assert load(tmp_path / "s.mcap").robot.urdf == datasets.load_set("ur10", "hold")[0].robot.urdf
