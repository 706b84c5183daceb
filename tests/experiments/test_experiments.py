"""The studies run end to end and say what the thesis says."""

import json
from functools import partial

import pytest

from hil.bench import costs
from hil.cli import main
from hil.experiments import manual_excitation
from hil.experiments.elastic_transmission import record_arm


def test_elastic_ukf_as_json(capsys):
    assert main(["experiment", "elastic-ukf", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "hil.experiment.elastic-ukf/1"
    assert found["parameters"]["k1"] == pytest.approx(1.0, abs=0.05)
    assert len(found["rows"]) == 16


@pytest.mark.slow
def test_bench_ukf_agrees_with_filterpy(capsys, monkeypatch):
    # the 300 steps that are compared, and as many again to time
    monkeypatch.setattr(costs, "record_arm", lambda plant, _, seed: record_arm(plant, 0.6, seed))
    monkeypatch.setattr(costs, "measure_cost", partial(costs.measure_cost, steps=300))
    monkeypatch.setattr(costs, "_in_the_loop", partial(costs._in_the_loop, ticks=500))
    assert main(["bench", "ukf", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["worst"] < 1e-3
    assert 0 < found["compiled_us"] < found["reference_us"]


@pytest.fixture
def short(monkeypatch):
    """Sessions of ten seconds for the motors and for the hand that judges."""
    monkeypatch.setattr(manual_excitation, "_PLAYED", 10.0)
    monkeypatch.setattr(manual_excitation, "_JUDGED", 10.0)


@pytest.mark.slow
def test_manual_excitation_says_what_is_not_identifiable(capsys, monkeypatch, short):
    on_the_rig = partial(manual_excitation.on_the_rig, seconds=10.0)
    monkeypatch.setattr(manual_excitation, "on_the_rig", on_the_rig)
    assert main(["experiment", "manual-excitation"]) == 0
    said = capsys.readouterr().out
    for line in ("16 of 17", "14 of 17", "17 of 17", "only ratios are known", "dither"):
        assert line in said


@pytest.mark.slow
def test_motor_constants_come_out_of_a_session_of_the_simulated_rig(short):
    found = manual_excitation.on_the_rig(2, 25.0)
    assert all(r.found.rank == 17 for r in found)
    built, wrong = (r.found for r in found)
    for j in (1, 2, 3):
        goal = manual_excitation.HIDDEN_RATIO if j == 2 else 1.0
        assert built.values[f"j{j}.kappa"] == pytest.approx(1.0, abs=0.025)
        assert wrong.values[f"j{j}.kappa"] == pytest.approx(goal, abs=0.025)
    # the force of another hand: the more wrong the constants, the more a hand is worth
    gain = [r.error["hand and motors"] / r.error["motors"] for r in found]
    assert gain[1] < 0.7 and gain[1] < gain[0] < 1.1
    assert all(-100.0 < x["log_det"] < 0.0 for r in found for x in r.richness.values())


@pytest.mark.slow
def test_the_hand_that_swings_furthest_keeps_the_arms_in_their_range(tmp_path):
    # with 6 cm along x the follower's joint 3 left its range after 19 s
    q, *_ = manual_excitation._by_hand(tmp_path / "s.mcap", [], 6, 21.0)
    assert -0.45 < q[:, 2].min() < -0.2
