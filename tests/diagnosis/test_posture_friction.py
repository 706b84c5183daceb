"""Friction of one joint that follows where another one stands, or what it holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.types import Diagnosis
from hil.models.model import Use, Value
from hil.record.recording import Recording

Array = np.ndarray
TONES = 2 * np.pi * np.array([0.11, 0.27, 0.63, 1.3])
SIZES = np.array([0.5, 0.3, 0.15, 0.05])
#: Effort of the second joint by its path and the first one's: positions, speeds, accelerations.
Law = Callable[[Array, Array, Array], Array]


def dry(v: Array) -> Array:
    return np.tanh(v / 2e-3)


def wrist(seed: int, law: Law, seconds: float = 30.0, pull: float = 0.0) -> Recording:
    """Two joints without a description; `law` is what the second one needs beside its inertia.

    A spring of stiffness `pull` is on the first one.
    """
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * 250)) / 250.0
    q, v, a = plants.sines(
        t, np.stack([TONES, 1.13 * TONES]), np.tile(SIZES, (2, 1)), rng.uniform(0, 6.28, (2, 4))
    )
    tau = 0.05 * a + 0.1 * v + 0.3 * dry(v)
    tau[:, 0] += pull * q[:, 0]
    tau[:, 1] += law(q, v, a)
    tau = tau + 3e-3 * np.std(tau, axis=0) * rng.normal(size=tau.shape)
    noisy = q + 2e-6 * rng.normal(size=q.shape)
    return Recording(f"wrist{seed}", "arm", ("bend", "tool"), t, noisy, tau)


def diagnosed(law: Law) -> Diagnosis:
    run, hold = (wrist(seed, law) for seed in (1, 2))
    return hil.diagnose([run], hil.base_model(run.robot), [hold])


def bent(q: Array, v: Array, a: Array) -> Array:
    """A capstan: friction grows exponentially with the angle of the bend past 0.2 rad."""
    return 0.2 * np.expm1(0.5 * np.abs(q[:, 0] - 0.2)) * dry(v[:, 1])


@pytest.mark.slow
def test_cables_that_run_past_a_bent_joint() -> None:
    d = diagnosed(bent)
    (found,) = d.findings
    assert (d.verdict, found.effect, found.joint) == ("missing-effect", "posture-friction", "tool")
    # without a description no name is sure
    assert found.confidence > 0.9 and found.rivals == []
    values = found.parameters
    assert values["j2.posture-friction.joint"].value == 1.0
    assert values["j2.posture-friction.q0"].value == pytest.approx(0.2, abs=0.05)
    assert values["j2.posture-friction.b"].value == pytest.approx(0.1, rel=0.2)
    before, after = (rung.heldout.relative[1] for rung in (d.ladder[0], d.ladder[-1]))
    assert after < before / 10


@pytest.mark.slow
def test_a_cable_around_a_bent_joint_rubs_with_its_tension() -> None:
    """A spring loads it; the capstan's friction grows with the load and with the angle."""

    def law(q: Array, v: Array, a: Array) -> Array:
        pull = 0.8 * q[:, 1]
        return pull + np.abs(pull) * (0.15 + 0.2 * np.abs(q[:, 0])) * dry(v[:, 1])

    run, hold = (wrist(seed, law) for seed in (1, 2))
    d = hil.diagnose([run], hil.base_model(run.robot) + "spring", [hold])
    found = {f.effect: f for f in d.findings}
    assert set(found) == {"load-friction", "capstan-friction"}
    assert all(f.joint == "tool" and f.confidence > 0.9 for f in found.values())
    bend = found["capstan-friction"].parameters
    assert bend["j2.capstan-friction.joint"].value == 1.0
    assert bend["j2.capstan-friction.q0"].value == pytest.approx(0.0, abs=0.05)
    assert bend["j2.capstan-friction.b"].value == pytest.approx(0.2, rel=0.1)
    assert found["load-friction"].parameters["j2.load-friction.mu"].value == pytest.approx(
        0.15, rel=0.1
    )
    assert d.ladder[-1].heldout.relative[1] < d.ladder[0].heldout.relative[1] / 10


def test_a_cable_over_this_joints_pulley_rubs_with_the_other_ones_pull() -> None:
    """An elbow's cable around the shoulder, a slewing ring under an arm, a guide of a tool."""
    runs = [
        wrist(seed, lambda q, v, a: 0.25 * np.abs(0.8 * q[:, 0]) * dry(v[:, 1]), pull=0.8)
        for seed in (1, 2)
    ]
    d = hil.diagnose(runs[:1], hil.base_model(runs[0].robot) + "spring", runs[1:])
    (found,) = d.findings
    assert (found.effect, found.joint) == ("coupled-load-friction", "tool")
    assert found.confidence > 0.95
    values = found.parameters
    assert values["j2.coupled-load-friction.joint"].value == 1.0
    mu = values["j2.coupled-load-friction.mu"]
    assert (mu.value, mu.unit) == (pytest.approx(0.25, rel=0.1), "1")


@pytest.mark.parametrize(
    ("effect", "shape", "units"),
    [
        ("coupled-load-friction", {"joint": 1.0, "of": 0.0}, {"mu": "1/m"}),
        ("posture-friction", {"q0": 0.1, "joint": 1.0}, {"b": "N/rad", "q0": "rad"}),
    ],
)
def test_values_over_a_joint_of_the_other_kind_have_its_unit(effect, shape, units) -> None:
    """A slide beside a turning joint."""
    run = replace(wrist(1, lambda q, v, a: 0.0 * v[:, 1], 10.0), metadata={"unit": "rad m"})
    values = {f"j2.{effect}.{n}": Value(x) for n, x in shape.items()}
    fit = hil.fit([run], hil.base_model(run.robot) + Use(effect, ("tool",), {}, values))
    found = fit.model.values()
    assert {n: found[f"j2.{effect}.{n}"].unit for n in units} == units


@pytest.mark.slow
def test_an_effort_that_follows_the_other_joint_is_no_friction() -> None:
    """A hose between the two: its pull does not turn with the speed."""
    d = diagnosed(lambda q, v, a: 0.15 * q[:, 0] ** 2)
    assert "posture-friction" not in {f.effect for f in d.findings}


@pytest.mark.slow
def test_grease_that_is_thicker_in_one_place_is_no_dry_friction() -> None:
    d = diagnosed(lambda q, v, a: 0.08 * np.abs(q[:, 0]) * v[:, 1])
    assert all(f.confidence < 0.5 for f in d.findings if f.effect == "posture-friction")


@pytest.mark.slow
def test_friction_over_its_own_position_is_not_the_other_joints() -> None:
    d = diagnosed(lambda q, v, a: 0.1 * q[:, 1] ** 2 * dry(v[:, 1]))
    assert {f.effect for f in d.findings} == {"position-friction"}


@pytest.mark.slow
def test_nothing_is_named_where_friction_stays() -> None:
    d = diagnosed(lambda q, v, a: 0.0 * v[:, 1])
    assert (d.verdict, d.findings) == ("adequate", [])
