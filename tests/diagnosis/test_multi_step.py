"""Two errors side by side: a rise of the simulated one counts beyond one percent and chance."""

from types import SimpleNamespace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.verbs import rising, useless
from hil.identify.multistep import MultiStep
from hil.models.model import base_model
from hil.report.data import Files, add_command


def multi(power, diverged=0):
    rms = np.sqrt(np.nanmean(power, axis=0))
    return MultiStep(0.5, rms, 100 * rms, len(power), diverged, power)


def rung(label, power, relative, gain=0.0):
    heldout = SimpleNamespace(
        relative=np.array([relative]),
        rms=np.array([relative]),
        gain=lambda *_: gain,
        standard_error=lambda: np.array([0.1]),
    )
    problem = SimpleNamespace(d=1, joints=("joint1",), robot=SimpleNamespace(units=("rad",)))
    result = SimpleNamespace(problem=problem, model=SimpleNamespace(explains="motor"))
    step = SimpleNamespace(label=label, result=result, heldout=heldout)
    return SimpleNamespace(step=step, multi_step=multi(power))


@pytest.mark.parametrize(
    ("factor", "noise", "warned"),
    [(1.03, 0.0, True), (1.005, 0.0, False), (1.03, 0.8, False), (1.3, 0.3, True), (0.9, 0, False)],
)
def test_a_rise_counts_beyond_one_percent_and_its_standard_error(factor, noise, warned):
    rng = np.random.default_rng(0)
    old = 1e-4 * rng.uniform(0.5, 1.5, (60, 1))
    flip = np.where(np.arange(60) % 2, 1.0, -1.0)[:, None]
    new = old * factor**2 * (1 + noise * flip)
    sentences = rising([rung("base", old, 5.0), rung("+ x", new, 4.0)])
    assert bool(sentences) == warned
    if warned:
        assert "+ x" in sentences[0] and "%)" in sentences[0]


def test_windows_that_diverged_are_left_out_of_both():
    old = np.full((10, 1), 1e-4)
    new = old * 1.1
    new[3] = np.nan
    assert multi(new, 1).rises(multi(old), 0, 1.01)
    assert multi(np.full((10, 1), 1.0), 10).rises(multi(old), 0, 1.01)


def test_no_benefit_only_within_the_standard_error():
    power = np.full((10, 1), 1e-4)
    before = rung("base", power, 4.21)
    (said,) = useless(before, rung("+ x", power, 4.25, -0.5), [0])
    assert "4.21 -> 4.25 %" in said and "no significant benefit" in said
    assert not useless(before, rung("+ x", power, 3.0, 8.0), [0])


def test_suggested_commands_name_the_files():
    finding = SimpleNamespace(effect="stribeck", joint="joint2", confidence=1.0)
    found = SimpleNamespace(verdict="missing-effect", findings=[finding, finding], corrections=[])
    files = Files(("my runs/a.mcap", "b.mcap"), ("h.mcap",), "arm.toml", "follower")
    first, second = add_command(found, files).splitlines()
    assert first == (
        "hil add stribeck --joint joint2 --model arm.toml --arm follower "
        "--session 'my runs/a.mcap' b.mcap --holdout h.mcap -o arm.plus1.toml"
    )
    assert "--model arm.plus1.toml" in second and "-o arm.plus2.toml" in second
    found.findings[1:] = [SimpleNamespace(**{**vars(finding), "confidence": 0.26})]
    (alone,) = add_command(
        found, Files(("a.mcap",), (), "")
    ).splitlines()  # what is not sure is none
    assert alone == "hil add stribeck --joint joint2 --session a.mcap -o a.plus1.toml"
    # what has no name is written by one command only
    found.corrections = [SimpleNamespace()]
    assert add_command(found, files) == (
        "hil improve 'my runs/a.mcap' b.mcap --arm follower --model arm.toml --holdout h.mcap "
        "-o arm.plus1.toml"
    )


def test_both_simulations_of_a_sticking_drive_improve_with_the_missing_effect() -> None:

    run = plants.stiction_axis(4, drag=0.15)
    model = base_model(run.robot)
    before, after = hil.add([run], model, "quadratic-drag")
    for old, new in (
        (before.multi_step, after.multi_step),
        (before.multi_step.closed_loop, after.multi_step.closed_loop),
    ):
        assert old is not None and new is not None
        assert not new.diverged
        assert new.relative[0] < 0.5 * old.relative[0]
        assert new.relative[0] < 5.0


@pytest.mark.parametrize("late", [0.0004, 0.003])
def test_how_late_efforts_are_is_sought_anew_beside_the_added_effect(late: float) -> None:
    """Beside a model without the spring nothing of it is seen."""
    rng, t = np.random.default_rng(1), np.arange(12000) / 500
    tones = 2 * np.pi * np.array([0.31, 0.73, 1.9]), np.array([0.5, 0.3, 0.1]), rng.uniform(0, 6, 3)
    q, _, _ = plants.sines(t, *tones)
    p, v, a = plants.sines(t - late, *tones)
    tau = 0.02 * a + 0.05 * np.tanh(v / 0.01) + 0.05 * v + 1.5 * p
    run = plants.single("late", t, q, tau + 0.005 * rng.standard_normal(t.size))
    before, after = hil.add(run, base_model(run.robot), "spring")
    assert before.step.result.model.fitted.shift_s == 0.0
    assert after.step.result.model.fitted.shift_s == pytest.approx(-late, abs=1e-4)
    assert after.step.result.values["j1.spring.k"].value == pytest.approx(1.5, rel=1e-3)
    assert after.step.result.relative[0] < 0.22


@pytest.mark.slow
def test_a_model_is_compared_as_it_is_without_a_fit() -> None:
    one, other = plants.stribeck_axis(1), plants.stribeck_axis(2)
    fitted = hil.fit(one, base_model(one.robot) + "stribeck")
    kept = hil.compare(other, fitted.model, as_is=True, simulate=False)
    values = {n: v.value for n, v in fitted.values.items()}
    assert {n: v.value for n, v in kept.result.values.items()} == pytest.approx(values)
    again = hil.compare(other, fitted.model, simulate=False)
    assert again.result.relative[0] < kept.result.relative[0] < 1.5 * again.result.relative[0]
