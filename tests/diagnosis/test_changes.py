"""What changes at once in a run: said with its value and its instant, and not called a hum."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.commands.diagnose import text
from hil.diagnosis.residual_tests import BENT, CHANGED, CUT_THERE, FIT_APART, changes, changes_told
from hil.diagnosis.verbs import ladder
from hil.identify.problem import Problem
from hil.identify.timing import fit_aligned
from hil.models.model import base_model
from hil.record.recording import Recording
from hil.report.html import diagnosis_report


def answer(*runs: Recording):
    return hil.diagnose(list(runs), hil.base_model(runs[0].robot))


@pytest.mark.parametrize(
    ("change", "what", "unit"),
    [
        plants.further((1.2, 0, 0), "inertia", "N m s^2/rad"),
        ((2.4, 0, 0), "inertia", "N m s^2/rad"),
        plants.further((0, 0, 3.0), "stiffness", "N m/rad"),
        plants.further((0, -0.7, 0), "Coulomb friction", "N m"),
    ],
)
@pytest.mark.parametrize("seed", plants.seeds(1, 2))
def test_what_changes_at_once_is_said_with_its_value_and_its_instant(change, what, unit, seed):
    d = answer(plants.belt(change, seed=seed))
    (found,) = changes(d.result)
    assert found.what == what and found.unit == unit
    assert found.value == pytest.approx(sum(change), rel=0.1)
    assert found.at == pytest.approx(12.5, abs=0.5)
    # friction that changes has a name of its own
    assert {f.effect for f in d.findings} <= {"friction-drift"}
    assert d.verdict == ("missing-effect" if d.findings else "unexplained")


@pytest.mark.slow
def test_it_stands_beside_the_verdict_and_in_the_report(tmp_path):
    d = answer(plants.belt((1.2, 0, 0)))
    (sentence,) = [w for code, w in d.warnings if code == CHANGED]
    shown = text(d, ladder(d))
    assert shown.count(sentence) == 1 and shown.index(sentence) < shown.index("held-out error")
    diagnosis_report(d, tmp_path / "r.html")
    assert "another inertia from 12" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_of_two_sessions_the_other_one_as_a_whole():
    other = plants.belt((0, 0, 0), seed=2, mass=9.2, name="friday")
    (found,) = changes(answer(plants.belt((0, 0, 0)), other).result)
    assert found.what == "inertia" and found.run == "friday" and found.at == 0.0
    assert found.value == pytest.approx(1.2, rel=0.1) and "in friday (+1.2 " in found.text
    ((_, told),) = changes_told([found])
    assert FIT_APART in told and CUT_THERE not in told
    ((_, told),) = changes_told([replace(found, at=3.0)])
    assert CUT_THERE in told and FIT_APART not in told


def test_how_a_run_begins_is_no_other_state_of_the_rig():
    run = plants.two_axes("", 1, "lead")
    early = 0.07 * float(run.t[-1])
    for until, expected in ((0.15, []), (early, []), (3 * early, ["effort at rest"])):
        tau = run.tau.copy()
        tau[run.t < until, 1] += 0.6
        result = fit_aligned(
            Problem([run := replace(run, tau=tau)], run.robot), base_model(run.robot)
        )
        assert [c.what for c in changes(result)] == expected


@pytest.mark.parametrize("seed", plants.seeds(1, 2, 3, 4, 5))
def test_where_nothing_changes_nothing_is_said(seed):
    d = answer(plants.belt((0, 0, 0), seed=seed))
    assert d.verdict == "adequate" and not changes(d.result)


@pytest.mark.parametrize("seed", plants.seeds(1, 2))
@pytest.mark.parametrize("phase", plants.seeds(0.4, None, 2.4))
def test_a_hum_is_one_whatever_its_phase_in_another_run(seed, phase):
    run = plants.belt((0, 0, 0), 0.5, seed)
    held = (
        [] if phase is None else [plants.belt((0, 0, 0), 0.5, seed + 9, phase=phase, name="later")]
    )
    d = hil.diagnose([run], hil.base_model(run.robot), held)
    assert [f.effect for f in d.findings] == ["periodic-disturbance"]
    assert d.ladder[-1].heldout.rms[0] < 1.2 * d.noise[0]


def lubricated(seed: int) -> Recording:
    """An axis whose viscous friction falls as oil's does, exponentially, between 25 and 45 degC."""
    rng, t = np.random.default_rng(seed), np.arange(25000) / 1000.0
    w = 2 * np.pi * np.array([0.08, 0.31, 0.9])
    q, v, a = plants.sines(t, w, np.array([0.8, 0.4, 0.1]), rng.uniform(0, 6.28, 3))
    warm = 25.0 + 20.0 * (1 - np.exp(-t / 8.0)) if seed == 1 else 45.0 - 0.8 * t
    tau = 0.5 * a + 0.3 * np.tanh(v / 1e-3) + 1.5 * np.exp(-0.06 * (warm - 25.0)) * v
    tau += 0.01 * rng.standard_normal(t.size)
    q += 1e-6 * rng.standard_normal(t.size)
    return plants.single(f"oil{seed}", t, q, tau, temperature=warm[:, None])


@pytest.mark.slow
def test_a_curve_of_the_measured_temperature_is_no_event():
    d = answer(lubricated(1), lubricated(2))
    assert [f.effect for f in d.findings] == ["friction-drift"]
    codes = [code for code, _ in d.warnings]
    assert CHANGED not in codes and codes.count(BENT) == 1
    assert "is taken as linear in the measured temperature" in text(d, ladder(d))
