"""Drives whose force is not what was asked for, and what rubs and springs back in a tool."""

import numpy as np
import plants
import pytest

import hil
from hil.models.sensors import OF_PLACE, OF_SPEED

TONES = 2 * np.pi * np.array([0.13, 0.31, 0.83, 1.7])
SIZES = np.array([0.6, 0.3, 0.12, 0.05])


def sign(v):
    return np.tanh(v / 2e-3)


def axis(seed, effort, seconds=25.0, rate=400.0, noise=0.004):
    """One axis whose drive needs an effort (n,) of its path and what that asks for."""
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * rate)) / rate
    q, v, a = plants.sines(t, TONES, SIZES, rng.uniform(0, 6.28, TONES.size))
    tau = effort(q, v, a)
    tau = tau + noise * np.std(tau) * rng.normal(size=t.size)
    return plants.single(f"axis{seed}", t, q + 2e-6 * rng.normal(size=t.size), tau)


def diagnosed(effort):
    run, hold = (axis(seed, effort) for seed in (1, 2))
    return hil.diagnose([run], hil.base_model(run.robot), [hold])


def names(d):
    return {f.effect for f in d.findings}


def carried(q, v, a):
    """What an arm on a level axis carries."""
    return 0.4 * a + 0.3 * v + 0.5 * sign(v)


@pytest.mark.slow
def test_a_cylinder_that_pulls_weaker_than_it_pushes():
    def weak(q, v, a):
        felt = carried(q, v, a)
        return np.where(felt > 0, felt, felt / 0.75)

    d = diagnosed(weak)
    assert names(d) == {"asymmetric-gain"}
    found = d.findings[0]
    assert found.confidence > 0.95
    # tau (1 - g sgn tau) = felt c: pulling gives 0.75 of what pushing does
    g = found.parameters["j1.asymmetric-gain.g"].value
    assert (1 + g) / (1 - g) == pytest.approx(0.75, rel=0.01)
    assert d.ladder[-1].heldout.relative[0] < 0.6


def test_an_offset_of_the_current_is_no_gain_of_one_direction():
    d = diagnosed(lambda q, v, a: carried(q, v, a) + 0.05)
    assert names(d) <= {"torque-offset"}


@pytest.mark.slow
def test_a_motor_constant_that_falls_towards_both_ends():
    """A voice coil leaves its magnet."""
    d = diagnosed(lambda q, v, a: carried(q, v, a) / (1 - 0.3 * (q / 0.9) ** 2))
    assert names(d) == {"varying-gain"}
    found = d.findings[0]
    assert found.confidence > 0.95
    assert found.parameters["j1.varying-gain.of"].value == OF_PLACE
    assert found.parameters["j1.varying-gain.g"].value == pytest.approx(0.3 / 0.81, rel=0.03)
    assert found.parameters["j1.varying-gain.q0"].value == pytest.approx(0.0, abs=0.02)
    assert d.ladder[1].heldout.relative[0] < d.ladder[0].heldout.relative[0] / 5


def test_a_motor_constant_that_swings_once_over_the_range():
    """One period is enough for a ripple: no square of the way from a place follows it."""
    d = diagnosed(lambda q, v, a: carried(q, v, a) / (1 - 0.2 * np.sin(2 * np.pi * q / 1.8)))
    assert names(d) == {"torque-ripple"}
    assert d.ladder[1].heldout.relative[0] < d.ladder[0].heldout.relative[0] / 5


@pytest.mark.slow
def test_a_motor_that_weakens_at_speed():
    """Its voltage has a limit: some of it is spent on the back EMF."""
    d = diagnosed(lambda q, v, a: (carried(q, v, a) + np.cos(q)) / (1 - 0.05 * np.abs(v)))
    assert names(d) >= {"varying-gain"}
    found = next(f for f in d.findings if f.effect == "varying-gain")
    assert found.confidence > 0.95
    assert found.parameters["j1.varying-gain.of"].value == OF_SPEED
    assert found.parameters["j1.varying-gain.g"].value == pytest.approx(0.05, rel=0.05)


@pytest.mark.slow
def test_friction_and_drag_are_no_gain_that_varies():
    for extra in (lambda v: 0.1 * v * np.abs(v), lambda v: 0.1 * np.abs(v)):
        d = diagnosed(lambda q, v, a, extra=extra: carried(q, v, a) + extra(v))
        assert names(d) <= {"quadratic-drag", "asymmetric-viscous"} and d.findings


@pytest.mark.slow
def test_a_smooth_change_over_the_position_is_no_cogging():
    """Of its period the range holds one and a third."""
    d = diagnosed(lambda q, v, a: carried(q, v, a) + 0.4 * np.sin(2 * np.pi * 0.8 * q + 1.0))
    assert "cogging" not in names(d)
    assert d.ladder[-1].heldout.relative[0] < d.ladder[0].heldout.relative[0] / 5


@pytest.mark.slow
def test_a_second_ripple_of_another_period_has_a_name():
    def stepper(q, v, a):
        return carried(q, v, a) + 0.3 * np.sin(50 * q) + 0.12 * np.sin(17 * q + 1)

    d = diagnosed(stepper)
    assert names(d) == {"cogging", "second-cogging"}
    orders = [f.parameters[f"j1.{f.effect}.p"].value for f in d.findings]
    assert sorted(orders) == pytest.approx([17 / 2 / np.pi, 50 / 2 / np.pi], rel=1e-3)


def dahl(q, length):
    """State of a bristle that has no break-away: dz = dq (1 - z sgn dq) / length."""
    z = np.zeros(q.size)
    for k, step in enumerate(np.diff(q)):
        goal = 1.0 if step > 0 else -1.0
        z[k + 1] = goal + (z[k] - goal) * np.exp(-abs(step) / length)
    return z


def test_hysteresis_that_has_no_break_away_is_found_in_its_own_form():
    d = diagnosed(lambda q, v, a: 0.3 * a + 0.2 * v + 1.5 * dahl(q, 0.006))
    assert names(d) == {"presliding"}
    assert d.ladder[-1].heldout.relative[0] < 0.2


@pytest.mark.slow
def test_a_spring_beside_a_soft_hysteresis_has_its_name():
    """Beside the shape that hysteresis has without it a spring seems too small to be named."""
    d = diagnosed(lambda q, v, a: carried(q, v, a) + 1.2 * dahl(q, 0.25) + q)
    assert names(d) == {"presliding", "spring"}
    spring = next(f for f in d.findings if f.effect == "spring")
    assert spring.parameters["j1.spring.k"].value == pytest.approx(1.0, rel=0.05)


def jaw(seed):
    """A gripper under control that closes on something soft: Hertz' contact beyond 22 mm."""
    rng, dt = np.random.default_rng(seed), 2e-4
    t = np.arange(100_000) * dt
    sizes = np.array([8.0, 5.0, 2.5, 1.5]) * 1e-3
    swung = plants.sines(
        t, 2 * np.pi * np.array([0.09, 0.23, 0.6, 1.0]), sizes, rng.uniform(0, 6.28, 4)
    )[0]
    ramps = 0.033 / np.pi * np.arcsin(np.sin(2 * np.pi * t / 6.6))
    wanted = 0.017 + (swung if seed % 2 else ramps)
    speed = np.gradient(wanted, dt)
    q, v, held, u, rows = wanted[0], 0.0, 0.0, 0.0, []
    for k in range(t.size):
        if k % 5 == 0:
            seen = 5e-6 * round(q / 5e-6)
            held += 28.1 * (wanted[k] - seen)
            u = 2250.0 * (wanted[k] - seen) + 90.0 * (speed[k] - v) + held
            rows.append((seen, u))
        pressed = 5200.0 * max(q - 0.022, 0.0) ** 1.5 * (1 + 1.2 * v)
        free = v + dt * (u - 9.0 * v - pressed) / 0.9
        v = np.copysign(max(abs(free) - dt * 1.6 / 0.9, 0.0), free)
        q += dt * v
    seen, u = np.array(rows[::2]).T
    return plants.single(f"jaw{seed}", t[::10], seen, u + 0.05 * rng.normal(size=seen.size))


@pytest.mark.slow
def test_a_jaw_that_closes_on_something_soft_has_an_end_stop_alone():
    """What a contact of another exponent leaves is no spring beside it."""
    runs = [jaw(seed) for seed in (1, 2)]
    d = hil.diagnose(runs, hil.base_model(runs[0].robot))
    assert names(d) == {"end-stop"} and d.ladder[-1].heldout.relative[0] < 1.0
