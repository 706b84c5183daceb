"""A drive that sticks at every reversal: standstill must not imitate an effect, nor hide one."""

from __future__ import annotations

import numpy as np
import plants
import pytest

from hil.diagnosis.engine import diagnose
from hil.identify.bands import derivatives, every, standing
from hil.identify.problem import Problem
from hil.identify.slow_motion import longest_shift, slow_delay
from hil.identify.timing import fit_aligned
from hil.models.friction import Presliding
from hil.models.model import base_model
from hil.report import text as report_text
from hil.report.data import from_diagnosis


@pytest.mark.parametrize("seed", plants.seeds(1, 2, 3))
def test_sticking_alone_is_no_missing_effect_and_parameters_are_exact(seed: int) -> None:
    run = plants.stiction_axis(seed)
    out = diagnose([run], base_model(run.robot))
    assert out.verdict == "adequate", [f.effect for f in out.findings]
    values = {name: v.value for name, v in out.result.values.items()}
    assert values["rigid-body.m"] == pytest.approx(plants.STICTION_J, rel=0.02)
    assert values["j1.coulomb.fc"] == pytest.approx(plants.STICTION_FC, rel=0.01)
    assert values["j1.viscous.fv"] == pytest.approx(plants.STICTION_FV, rel=0.02)


@pytest.mark.parametrize(
    ("change", "name"),
    [({"drag": 0.15}, "quadratic-drag"), plants.further({"peak": 0.3}, "stribeck")],
)
def test_effects_beside_stiction_are_named(change: dict[str, float], name: str) -> None:
    run = plants.stiction_axis(4, **change)  # type: ignore[arg-type]
    out = diagnose([run], base_model(run.robot))
    assert [f.effect for f in out.findings] == [name]
    assert out.verdict == "missing-effect"


@pytest.mark.slow
def test_a_delay_beside_stiction_is_a_delay_or_a_lag() -> None:
    run = plants.stiction_axis(4, late=3)
    out = diagnose([run], base_model(run.robot))
    assert len(out.findings) == 1
    assert "delay" in {out.findings[0].effect, *out.findings[0].rivals}
    assert {out.findings[0].effect, *out.findings[0].rivals} <= {"delay", "actuator-lag"}


def test_standstill_is_found_and_a_smooth_reversal_is_none() -> None:
    t = np.arange(0, 4, 1e-3)
    smooth = np.sin(2 * np.pi * t)
    held = np.where((t > 1) & (t < 1.3), 0.4, smooth)
    noise = np.random.default_rng(0).normal(size=(t.size, 2)) * 1e-6
    q = np.stack([smooth, held], axis=1) + noise
    qdd = -((2 * np.pi) ** 2) * np.stack([smooth, smooth], axis=1)
    share = standing(q, np.gradient(q, 1e-3, axis=0), qdd, 1000.0, 0.03, 60.0).mean(axis=0)
    assert share[0] < 0.02
    assert share[1] == pytest.approx(0.3 / 4, abs=0.02)


def test_a_joint_that_creeps_while_it_sticks_stands_still() -> None:
    t = np.arange(0, 4, 1e-3)
    # from 1 s on it settles by a thousandth of its stroke, in a thousand of the encoder's steps
    settled = np.sin(2 * np.pi) + 1e-3 * (1 - np.exp(-(t - 1) / 0.3))
    q = np.where(t < 1, np.sin(2 * np.pi * t), settled)[:, None]
    q = q + np.random.default_rng(0).normal(size=q.shape) * 1e-6
    qd = np.where(t < 1, 2 * np.pi * np.cos(2 * np.pi * t), 0.0)[:, None]
    qdd = np.where(t < 1, -((2 * np.pi) ** 2) * np.sin(2 * np.pi * t), 0.0)[:, None]
    still = standing(q, qd, qdd, 1000.0, 0.03, 60.0)[:, 0]
    assert np.all(still[1100:]) and np.mean(still[:950]) < 0.02


def test_the_slow_motion_measures_a_delay_in_spite_of_the_loop() -> None:
    run = plants.stiction_axis(5, late=3)
    out = fit_aligned(Problem([run], run.robot), base_model(run.robot))
    late, error = slow_delay(out, 0)
    # three periods of 2 ms, and half of one for the command that is held
    assert late == pytest.approx(7e-3, abs=max(1e-3, 3 * error))
    assert late > longest_shift(out.problem)


def test_presliding_below_the_encoders_count_is_not_proposed() -> None:
    from dataclasses import replace

    run = plants.stiction_axis(6)
    count = 2 * np.pi / 8192
    coarse = replace(run, q=np.round(run.q / count) * count)
    problem = Problem([coarse], coarse.robot)
    smallest = Presliding.search.grid(problem.motions[0], 0)[0][0]
    assert smallest == pytest.approx(2 * count, rel=0.01)


def test_a_few_seconds_name_nothing() -> None:
    run = plants.stiction_axis(1, seconds=3.0)
    out = diagnose([run], base_model(run.robot))
    assert out.verdict == "not-identifiable"
    assert "Record 5 s or more" in out.warnings[0][1]


def test_an_arm_that_holds_its_place_names_nothing_and_says_so() -> None:
    """All joints moved by a few steps of their encoders: an internal error."""
    from dataclasses import replace

    run = plants.serial_arm(2, 1, noise=0.003)
    count = 2e-4
    still = replace(run, q=np.round(run.q / np.abs(run.q).max() * 2) * count)
    out = diagnose([still], base_model(run.robot))
    assert out.verdict == "not-identifiable" and not out.findings
    assert out.warnings[0][0] == "no-motion" and "holds its place" in out.warnings[0][1]
    assert "noise floor" not in report_text.headline(from_diagnosis(out))


@pytest.mark.parametrize("rests", [0.08, 0.0])
def test_a_joint_that_sticks_for_a_few_slow_rows_stands_still(rests: float) -> None:
    """Turned sharply, at a slow pace on the whole: a smooth reversal lasts some milliseconds."""
    fs, fine = 50.0, 1e-3
    v, turn = [], np.linspace(-0.15, 0.15, 300)
    for k in range(30):
        up, held = (-1.0) ** k, np.zeros(round(rests / fine))
        v += [np.full(2000, -0.15 * up), up * turn[:150], held, up * turn[150:]]
    path = np.cumsum(np.concatenate(v)) * fine
    rows = path[:: round(1 / fs / fine)][:, None]
    noise = np.random.default_rng(0).normal(size=rows.shape) * 1e-6
    q, qd, qdd = derivatives(rows + noise, fs, 17.5)
    between = every(q, 0.5)
    still = standing(rows + noise, qd, qdd, fs, 1 / 12, 17.5, between)[:, 0]
    assert len(still) == len(between)
    share = np.mean(still) * len(path) * fine / 30
    assert share > rests or share == 0.0 == rests
    assert share < rests + 0.1


@pytest.mark.parametrize(("rests", "fs", "found"), [(0.04, 100.0, True), (0.0, 100.0, False)])
def test_three_rows_on_one_count_are_a_rest_where_a_joint_is_turned_sharply(rests, fs, found):
    """Behind a filter of 20 Hz the joint swings through its stick."""
    fine, count = 1e-3, 1e-4
    v, turn = [], np.linspace(-0.6, 0.6, 60)
    for k in range(30):
        up = (-1.0) ** k
        held = np.zeros(round(rests / fine))
        v += [np.full(700 + 7 * k, -0.6 * up), up * turn[:30], held, up * turn[30:]]
    path = np.cumsum(np.concatenate(v)) * fine
    q = np.round(path[:: round(1 / fs / fine)][:, None] / count) * count
    _, qd, qdd = derivatives(q, fs, 20.0)
    still = standing(q, qd, qdd, fs, 0.5 / 6.7, 20.0)[:, 0]
    assert bool(np.mean(still) > 30 * rests / (len(path) * fine)) is found
    assert np.mean(still) < 30 * (rests + 0.1) / (len(path) * fine)
