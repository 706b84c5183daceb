"""Elasticity, lag, ripple and a resonance, hidden in a motor with a link: named, or said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plants
import pytest
import scipy.integrate
import scipy.signal

from hil.diagnosis.engine import diagnose
from hil.diagnosis.verbs import add
from hil.models.kernels import lag, softened, sprung
from hil.models.model import base_model
from hil.record.recording import Recording


@pytest.mark.parametrize("seed", plants.seeds(1, 2))
@pytest.mark.parametrize("fast", [0.5, 1.0])
def test_a_rigid_drive_lacks_nothing(seed: int, fast: float) -> None:
    run = plants.transmission(seed, fast=fast)
    assert diagnose([run], base_model(run.robot)).verdict == "adequate"


@pytest.mark.parametrize(
    ("hidden", "effect", "parameter", "value"),
    [
        ({"lag": 0.02}, "actuator-lag", "T", 0.02),
        plants.further({"lag": 0.05}, "actuator-lag", "T", 0.05),
        plants.further({"ripple": 0.05}, "torque-ripple", "p", 9 / 6.2832),
        ({"ripple": 0.15}, "torque-ripple", "p", 9 / 6.2832),
    ],
)
def test_named(hidden: dict[str, float], effect: str, parameter: str, value: float) -> None:
    run = plants.transmission(1, **hidden)
    d = diagnose([run], base_model(run.robot))
    assert d.verdict == "missing-effect"
    assert [f.effect for f in d.findings] == [effect]
    found = d.findings[0].parameters[f"j1.{effect}.{parameter}"].value
    assert found == pytest.approx(value, rel=0.05)


def frequency_of(found, more: float = 0.0) -> float:
    """Resonance of a mode, or of the model's inertia on its spring: rotor and `more` included."""
    values = {n.rsplit(".")[-1]: v.value for n, v in found.parameters.items()}
    if found.effect == "vibration-mode":
        return values["f"]
    return float(np.sqrt(values["k"] / (plants.MOTOR + plants.LINK + more))) / (2 * np.pi)


@pytest.mark.parametrize(
    ("hidden", "resonance"),
    [plants.further({"frequency": 12.0}, 12.0), ({"mode": 0.03, "mode_hz": 15.0}, 15.0)],
)
def test_a_resonance_is_found_and_its_two_causes_are_both_said(
    hidden: dict[str, float], resonance: float
) -> None:
    run = plants.transmission(2, **hidden)
    d = diagnose([run], base_model(run.robot))
    first = d.findings[0]
    assert d.verdict == "ambiguous"
    assert {first.effect, *first.rivals} == {"elastic-transmission", "vibration-mode"}
    found = frequency_of(first, hidden.get("mode", 0.0))
    assert found == pytest.approx(resonance, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "gravity", "frequency"),
    [
        pytest.param(1, 1.0, 4.0, marks=pytest.mark.slow, id="faster"),
        pytest.param(3, 0.6, 2.5, id="slower"),
    ],
)
def test_a_weight_behind_a_soft_spring_leaves_the_spring_in_the_race(
    seed: int, gravity: float, frequency: float
) -> None:
    """Without a mode the masses make up for it: beside their load no spring was seen at all."""
    what = {"gravity": gravity, "frequency": frequency, "zeta": 0.02}
    run = plants.transmission(seed, seconds=15.0, fast=0.8, **what)
    d = diagnose([run], base_model(run.robot))
    found = [{f.effect, *f.rivals} for f in d.findings if f.confidence > 0.4]
    assert any("elastic-transmission" in names for names in found)
    assert not any("vibration-mode" in x and "elastic-transmission" not in x for x in found)


@pytest.mark.slow
def test_a_link_that_rubs_behind_its_spring_is_told_from_a_mode() -> None:
    """Its friction is what a mode has not, and sticks at reversals: no sum of linear springs."""
    rub = 0.1
    runs = [plants.transmission(seed, frequency=12.0, rub=rub) for seed in (2, 3)]
    d = diagnose(runs[:1], base_model(runs[0].robot), runs[1:])
    assert [(f.effect, f.rivals) for f in d.findings] == [("elastic-transmission", [])]
    found = {n.split(".")[-1]: v.value for n, v in d.findings[0].parameters.items()}
    assert frequency_of(d.findings[0]) == pytest.approx(12.0, rel=0.02)
    assert found["a"] * found["fl"] == pytest.approx(rub, rel=0.3)
    first, last = (d.ladder[k].heldout.relative[0] for k in (0, -1))
    assert last < 0.25 * first


def sloshing_axis(seed: int, frequency: float, zeta: float, mass: float = 0.05) -> Recording:
    """Half a minute of an axis that carries a swinging mass, cut from the middle of its motion."""

    def carried(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        w = 2 * np.pi * frequency
        mode = scipy.signal.lti([2 * zeta * w, w * w], [1.0, 2 * zeta * w, w * w])
        return mass * scipy.signal.lsim(mode, a, t)[1]

    whole = plants.smooth_axis(seed, seconds=60.0, rate=200.0, extra=carried)
    late = whole.t >= 30.0
    return plants.single(
        f"tank{seed}",
        whole.t[late] - 30.0,
        whole.q[late, 0],
        whole.tau[late, 0],
        robot=plants.SINGLE,
    )


@pytest.mark.parametrize(("frequency", "zeta"), [plants.further(0.4, 0.05), (0.9, 0.01)])
def test_a_mass_that_swings_slower_than_the_motion_is_found(frequency: float, zeta: float) -> None:
    """A dozen of its swings fit into the run."""
    run = sloshing_axis(2, frequency, zeta)
    d = diagnose([run], base_model(run.robot))
    first = d.findings[0]
    assert {first.effect, *first.rivals} <= {"elastic-transmission", "vibration-mode"}
    after = add([run], base_model(run.robot), "vibration-mode")[1].step
    values = {n.split(".")[-1]: v.value for n, v in after.result.values.items()}
    assert values["f"] == pytest.approx(frequency, rel=0.03)
    assert values["m"] == pytest.approx(0.05, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "effect"),
    [
        (lambda t, q, v, a: 0.1 * q, "spring"),
        (lambda t, q, v, a: 0.15 * (1 - np.exp(-t / 15)) * np.tanh(v / 0.02), "friction-drift"),
        (lambda t, q, v, a: 0.1 * (1 - np.exp(-t / 15)), "offset-drift"),
    ],
    ids=["spring", "friction-drift", "offset-drift"],
)
def test_what_is_slow_does_not_swing(hidden, effect: str) -> None:
    """A mode below the motion is a spring, and one that hardly swings a drift."""
    run = plants.smooth_axis(2, rate=200.0, extra=hidden)
    d = diagnose([run], base_model(run.robot))
    assert d.findings[0].effect == effect
    assert not {f.effect for f in d.findings} & {"elastic-transmission", "vibration-mode"}


@pytest.mark.slow
def test_a_mass_that_is_an_eighth_of_the_link_hangs_on_it_and_is_not_the_link() -> None:
    run = plants.transmission(2, mode=0.01)
    d = diagnose([run], base_model(run.robot))
    assert [(f.effect, f.rivals) for f in d.findings] == [("vibration-mode", [])]
    assert d.findings[0].parameters["j1.vibration-mode.f"].value == pytest.approx(9.0, rel=0.02)
    assert d.findings[0].parameters["j1.vibration-mode.m"].value == pytest.approx(0.01, rel=0.2)


@pytest.mark.slow
def test_a_short_lag_may_be_a_delay_and_a_longer_one_is_none() -> None:
    run = plants.transmission(1, lag=0.003)
    d = diagnose([run], base_model(run.robot))
    assert d.verdict == "ambiguous"
    assert {d.findings[0].effect, *d.findings[0].rivals} == {"actuator-lag", "delay"}
    run = plants.transmission(1, lag=0.008)
    (found,) = diagnose([run], base_model(run.robot)).findings
    assert found.effect == "actuator-lag" and found.confidence > 0.9


@pytest.mark.parametrize(
    ("frequency", "harden"),
    [
        pytest.param(15.0, 3.0, id="stiff"),
        pytest.param(6.0, 3.0, marks=pytest.mark.slow, id="soft"),
    ],
)
def test_a_cable_that_stiffens_is_named_and_its_stretch_is_found(
    frequency: float, harden: float
) -> None:
    """The plant's T = k d (1 + h |k d|) is another law: d(T) agrees where the motion was."""
    run = plants.transmission(1, frequency=frequency, harden=harden)
    d = diagnose([run], base_model(run.robot))
    (found,) = d.findings
    assert found.effect == "hardening-cable" and set(found.rivals) <= {"elastic-transmission"}
    assert found.confidence > 0.75 and found.excess_explained > 0.9
    values = {k.rsplit(".")[-1]: v.value for k, v in found.parameters.items()}
    tension = np.array([0.25, 0.5, 1.0, 2.0])
    stretch = tension / values["k0"] / (1 + tension / values["T0"])
    soft = plants.LINK * (2 * np.pi * frequency) ** 2
    true = (np.sqrt(1 + 4 * harden * tension) - 1) / (2 * harden * soft)
    np.testing.assert_allclose(stretch, true, rtol=0.5)


def test_states_follow_their_equations() -> None:
    t = np.arange(0, 2, 1e-3)
    u = np.sin(2 * np.pi * 2 * t)
    s = 2j * np.pi * 2
    w, zeta, time = 2 * np.pi * 10, 0.3, 0.03
    one = np.ones(t.size)
    for y, h in (
        (lag(u, 1e-3, time), 1 / (1 + time * s)),
        (
            sprung(u, one, 0 * one, 1e-3, w**2, zeta)[0],
            (2 * zeta * w * s + w**2) / (s**2 + 2 * zeta * w * s + w**2),
        ),
    ):
        expected = np.abs(h) * np.sin(2 * np.pi * 2 * t + np.angle(h))
        assert np.max(np.abs(y - expected)[1000:]) < 0.01


def swung(t, inertia, weight, k: float, zeta: float, start: float):
    """A load whose stretch rings from a start, exactly: p = I d', p' = load - (k + G) d - c d'."""
    load = np.sin(2 * np.pi * 0.8 * t) + 0.4 * np.sin(2 * np.pi * 1.9 * t)

    def slope(at, x):
        i, g, u = (np.interp(at, t, y) for y in (inertia, weight, load))
        rate = x[1] / i
        return [rate, u - (k + g) * x[0] - 2 * zeta * np.sqrt(k * i) * rate]

    found = scipy.integrate.solve_ivp(
        slope, (t[0], t[-1]), [load[0] / k, start], t_eval=t, rtol=1e-8, atol=1e-10, max_step=2e-3
    )
    d, rate = found.y[0], found.y[1] / inertia
    return load, k * d + 2 * zeta * np.sqrt(k * inertia) * rate, d, rate


@pytest.mark.parametrize("heavy", [0.0, 20.0])
def test_a_link_whose_inertia_changes_keeps_its_momentum(heavy: float) -> None:
    """So does a link that hangs on the spring: a pendulum swings faster, one that stands slower."""
    t = np.arange(0, 6, 2e-3)
    inertia = 0.05 * (1 + 0.6 * np.sin(2 * np.pi * 0.7 * t))
    weight = heavy * np.cos(2 * np.pi * 0.3 * t)
    load, *truth = swung(t, inertia, weight, 60.0, 0.1, 0.0)
    for got, true in zip(sprung(load, inertia, weight, 2e-3, 60.0, 0.1), truth, strict=True):
        settled = slice(t.size // 4, None)  # what the start has left of itself has died out
        assert np.max(np.abs(got - true)[settled]) < 0.02 * np.max(np.abs(true))


def test_a_recording_begins_within_a_motion_and_not_at_rest() -> None:
    """Almost without damping a wrong start would ring through all of the run."""
    t = np.arange(0, 8, 2e-3)
    inertia, k = np.full(t.size, 0.05), 60.0
    none = np.zeros(t.size)
    load, *_ = swung(t, inertia, none, k, 0.003, 0.0)
    w, own = 2 * np.pi * np.array([0.8, 1.9]), k / 0.05
    sizes = np.array([1.0, 0.4]) * own / (own - w**2)
    forced = sizes @ np.sin(w[:, None] * t)
    passed, _, _ = sprung(load, inertia, none, 2e-3, k, 0.003)
    assert np.max(np.abs(passed - forced)) < 0.05 * np.max(np.abs(forced))


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_a_link_flies_through_its_play_and_hands_its_momentum_over(friction: float) -> None:
    """Pushed, then braked with -L: free flight r = (L - F) t^2 / 2 I until the other flank."""
    n, dt, inertia, width = 400, 1e-3, 0.05, 0.01
    load = np.where(np.arange(n) < 100, 1.0, -2.0)
    # stretched by half the width either way, by next to no tension
    rest, full = np.zeros(n), np.full(n, inertia)
    lag = np.full(n, 1e-3)
    passed = softened(load, rest, full, rest, dt, width / 2, 1e-4, lag, friction, 1e-3, 8)[0]
    flight = np.sqrt(2 * width * inertia / (2.0 - friction))
    meets = 100 + round(flight / dt)
    np.testing.assert_allclose(passed[10:98], 1.0, atol=0.02)
    np.testing.assert_allclose(passed[108 : meets - 3], 0.0, atol=0.05)
    np.testing.assert_allclose(passed[meets + 6 :], -2.0, atol=0.05)
    # the speed of the link at the flank, (L - F) t / I, times its inertia
    blow = np.sum(passed[meets - 3 : meets + 6]) * dt + 2.0 * 6 * dt
    assert blow == pytest.approx((friction - 2.0) * flight, rel=0.1)


@pytest.mark.parametrize("width", [0.01, plants.further(0.015)])
@pytest.mark.slow
def test_backlash_is_named(width: float) -> None:
    run = plants.transmission(3, gravity=0.6, frequency=40.0, zeta=0.3, width=width)
    d = diagnose([run], base_model(run.robot) + "position-torque")
    assert d.findings[0].effect == "backlash", [(f.effect, f.confidence) for f in d.findings]
    assert d.findings[0].parameters["j1.backlash.b"].value == pytest.approx(width, rel=0.4)


@pytest.mark.slow
@pytest.mark.parametrize("unlike", [1.0, 0.7])
def test_two_motors_of_two_joints_are_a_differential(unlike: float) -> None:
    """Cables of a wrist: seals of both motors, whose friction is an algebraic function of speed."""

    def wrist(seed: int) -> Recording:
        run = plants.serial_arm(3, seed)
        v, tau = np.gradient(run.q, run.t, axis=0), run.tau.copy()
        for side, size in ((1.0, 0.6), (-1.0, 0.6 * unlike)):
            w = v[:, 1] + side * 1.5 * v[:, 2]
            rubs = size * w / np.sqrt(w**2 + 0.02**2)
            tau[:, 1] += rubs
            tau[:, 2] += side * 1.5 * rubs
        return replace(run, tau=tau)

    train, other = wrist(1), wrist(2)
    d = diagnose([train], base_model(train.robot), [other])
    (found,) = d.findings
    assert (found.effect, found.joint) == ("differential", "joint2")
    values = {k.rsplit(".")[-1]: v.value for k, v in found.parameters.items()}
    assert values["joint"] == 3.0 and values["r"] == pytest.approx(1.5, rel=0.05)
    assert values["fcp"] == pytest.approx(0.6, rel=0.1)
    assert values["fcm"] == pytest.approx(0.6 * unlike, rel=0.1)
    assert np.all(d.ladder[-1].heldout.rms < 1.1 * d.noise)
