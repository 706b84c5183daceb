"""Effects of time and of the force sensor are named from plants of the tests' own; zero is not."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.equivalence import sets_of
from hil.errors import HilError
from hil.models.model import RobotModel, Use
from hil.record.recording import Recording, RobotSource


def named(*runs):
    d = hil.diagnose(list(runs), hil.base_model(runs[0].robot))
    return d, {(f.effect, f.joint) for f in d.findings}


def cooling(t):
    return 1 - 0.3 * (1 - np.exp(-t / 8))


def hum(f, phase=1.0):
    return lambda t, q, v: 0.08 * np.sin(2 * np.pi * f * t + phase)


def sway(t):
    return 0.5 * np.sin(2 * np.pi * 0.37 * t)


@pytest.mark.parametrize("period", [0.0, 5.0])
def test_friction_that_cools_is_drift(period):
    d, found = named(plants.axis(1, period=period, warm=cooling))
    assert found == {("friction-drift", "joint1")}
    values = d.findings[0].parameters
    assert values["j1.friction-drift.T"].value == pytest.approx(8.0, rel=0.05)
    assert values["j1.friction-drift.dc"].value == pytest.approx(-0.3 * plants.FC, rel=0.05)
    assert values["j1.friction-drift.dv"].value == pytest.approx(-0.3 * plants.FV, rel=0.05)


@pytest.mark.parametrize("step", [0.0, 0.5])
def test_friction_follows_the_measured_temperature(step):
    run = plants.axis(1, warm=cooling)
    warm = 20 + 10 * (1 - np.exp(-run.t / 8))[:, None]
    # a thermometer that rounds foretells a little less than the clock of this one run
    run = replace(run, temperature=step * np.round(warm / step) if step else warm)
    d, found = named(run)
    assert found == {("friction-drift", "joint1")}
    # time would do as well, but a warm start would not have it
    assert d.findings[0].parameters["j1.friction-drift.of"].value == 1.0


@pytest.mark.parametrize(("period", "f"), [(0.0, 7.3), (5.0, 7.33)])
def test_hum_is_a_disturbance_whether_or_not_the_motion_repeats(period, f):
    d, found = named(plants.axis(1, period=period, extra=hum(f)))
    assert found == {("periodic-disturbance", "joint1")}
    assert d.findings[0].parameters["j1.periodic-disturbance.f"].value == pytest.approx(f, abs=0.01)


def test_hum_has_its_own_phase_in_every_run():
    runs = plants.axis(1, extra=hum(7.3)), plants.axis(2, extra=hum(7.3, 2.0))
    assert named(*runs)[1] == {("periodic-disturbance", "joint1")}


@pytest.mark.slow
def test_hum_locked_to_the_motion_is_not_called_a_disturbance():
    # 3 Hz is a multiple of the motion's 0.2 Hz: it could as well come from the posture
    assert "periodic-disturbance" not in {
        n for n, _ in named(plants.axis(1, period=5.0, extra=hum(3.0)))[1]
    }


SENSORS = {
    "force-drift": (lambda t, w: w + np.array([0.0, 0.02, 0.0]) * t[:, None], "dfy", 0.02),
    "force-bias": (lambda t, w: w + np.array([0.3, 0.0, 0.0]), "bfx", 0.3),
    # g and e are shares of the reading
    "force-gain": (lambda t, w: w * np.array([1.1, 1.0, 1.0]), "gfx", 0.1 / 1.1),
    "force-crosstalk": (lambda t, w: w + 0.08 * w[:, [1]] * np.array([1, 0, 0]), "efx-fy", 0.08),
}


@pytest.mark.parametrize(
    "effect", ["force-gain", *map(plants.further, sorted(SENSORS.keys() - {"force-gain"}))]
)
@pytest.mark.slow
def test_error_of_the_force_sensor_is_named_with_its_channel(effect):
    sensor, name, value = SENSORS[effect]
    d, found = named(plants.arm(1, force=plants.hand, sensor=sensor))
    assert found == {(effect, None)}
    assert d.findings[0].parameters[f"{effect}.{name}"].value == pytest.approx(value, rel=0.03)


@pytest.mark.slow
def test_sensors_at_the_joints_cannot_be_told_from_the_motor():
    run = plants.axis(1, push=sway, sensor=lambda t, w: w + 0.1)
    d = hil.diagnose([run], hil.base_model(run.robot) - "torque-offset")
    assert d.verdict == "ambiguous"
    assert {"torque-offset", "force-bias"} <= {d.findings[0].effect, *d.findings[0].rivals}
    run = plants.axis(1, push=lambda t: 2 * sway(t) * (t > 2), sensor=lambda t, w: 1.2 * w)
    d, _ = named(run)
    assert {"torque-gain", "force-gain"} <= {d.findings[0].effect, *d.findings[0].rivals}
    assert d.verdict == "ambiguous"


@pytest.mark.slow
def test_lag_of_the_motion_differs_from_delay_only_beside_a_measured_force():
    def lagging(seconds):
        state = [None]

        def seen(t, q):
            last = q if state[0] is None else state[0]
            state[0] = last + (q - last) * (1 - np.exp(-1 / plants.RATE / seconds))
            return state[0]

        return seen

    d, _ = named(plants.axis(1, push=sway, seen=lagging(0.008)))
    assert d.verdict == "missing-effect" and d.findings[0].effect == "filter-lag"
    d, _ = named(plants.axis(1, seen=lagging(0.008)))
    assert {"delay", "actuator-lag"} & {d.findings[0].effect, *d.findings[0].rivals}
    assert (d.findings[0].effect, "filter-lag") in [s.effects for s in sets_of(d)]


@pytest.mark.slow
def test_eccentric_encoder_is_not_cogging_and_cogging_is_not_the_encoder():
    d, found = named(plants.axis(1, seen=lambda t, q: q + 1e-3 * np.sin(30 * q + 0.5)))
    assert found == {("encoder-eccentricity", "joint1")}
    e = d.findings[0].parameters
    size = np.hypot(e["j1.encoder-eccentricity.es"].value, e["j1.encoder-eccentricity.ec"].value)
    assert size == pytest.approx(1e-3, rel=0.05)
    found = named(plants.axis(1, extra=lambda t, q, v: 0.08 * np.sin(30 * q + 0.5)))[1]
    assert found == {("cogging", "joint1")}


def test_a_joints_own_disc_errs_once_a_turn_and_its_inertia_does_not_vary():
    """Over a turn and a quarter; the motion is given, and an encoder off centre sees it."""
    t = np.arange(12_000) / 500.0
    w, size = 2 * np.pi * np.array([0.13, 0.31, 0.83]), np.array([3.2, 0.9, 0.25])
    q, v, a = (
        sum(s * f**k * np.sin(f * t + k * np.pi / 2 + f) for f, s in zip(w, size, strict=True))
        for k in (0, 1, 2)
    )
    tau = 0.02 * a + 0.05 * v + 0.03 * np.tanh(v / 0.01)
    tau += 2e-4 * np.random.default_rng(7).normal(size=t.size)
    run = replace(
        plants.axis(1), t=t, q=(q + 0.006 * np.sin(q + 0.4))[:, None], tau=tau[:, None], qd=None
    )
    found = hil.diagnose([run], hil.base_model(run.robot))
    (name,) = found.findings
    assert name.effect == "encoder-eccentricity" and name.confidence > 0.95
    values = {n.rpartition(".")[2]: v.value for n, v in name.parameters.items()}
    assert 2 * np.pi * values["p"] == pytest.approx(1.0, rel=0.03)
    assert np.hypot(values["es"], values["ec"]) == pytest.approx(0.006, rel=0.1)


@pytest.mark.slow
def test_eccentric_encoder_of_an_arm():
    def disc(t, q):
        return 5e-3 * np.sin(11 * q[:, [1]] + 0.5) * np.array([0.0, 1.0, 0.0])

    assert named(plants.arm(1, noise=1e-3, joint_error=disc))[1] == {
        ("encoder-eccentricity", "joint2")
    }


def lost(start):
    return lambda t: np.clip((t - start) / 0.4, 0.0, 1.0)


@pytest.mark.slow
def test_lost_counts_show_in_gravity():
    def shift(t, q):
        return 0.05 * lost(8.3)(t)[:, None] * np.array([0.0, 0.0, 1.0])

    d, found = named(plants.arm(1, noise=1e-3, joint_error=shift))
    assert found == {("missed-counts", "joint3")}
    values = d.findings[0].parameters
    assert values["j3.missed-counts.s"].value == pytest.approx(0.05, rel=0.1)
    assert values["j3.missed-counts.t0"].value == pytest.approx(8.5, abs=0.3)


@pytest.mark.slow
def test_lost_counts_show_in_a_spring_and_not_without_one():
    def seen(t, q):
        return q + 0.03 * float(lost(7.0)(t))

    run = plants.axis(1, extra=lambda t, q, v: 5 * q, seen=seen)
    d = hil.diagnose([run], hil.base_model(run.robot) + "spring")
    assert [f.effect for f in d.findings] == ["missed-counts"]
    free = plants.axis(1, seen=seen)
    d = hil.diagnose([free], hil.base_model(free.robot))
    assert "missed-counts" in [n for n, _ in d.first.impossible]
    with pytest.raises(HilError, match="a shift has no effect"):
        hil.add([free], hil.base_model(free.robot), "missed-counts")


def jumping(t, q):
    """Counts lost at three instants, in the run's own time."""
    return q + 4e-3 * float(np.sum(t >= np.array([3.3, 7.1, 11.8])))


@pytest.mark.parametrize("held_out", [False, True])
def test_recorded_jumps_are_lost_counts_where_the_effort_says_so(held_out):
    """Without gravity, too; a held-out run without jumps of its own does not refute them."""
    run = plants.axis(1, seen=jumping)
    d = hil.diagnose([run], hil.base_model(run.robot), [plants.axis(2)] if held_out else [])
    assert [(f.effect, f.joint) for f in d.findings] == [("missed-counts", "joint1")]
    share = d.findings[0].parameters["j1.missed-counts.a"]
    assert share.value == pytest.approx(1.0, abs=0.05) and share.unit == "1"
    (text,) = [text for code, text in d.warnings if code == "step"]
    assert "q1 jumps 3 times" in text and " at 3.3 s" in text


@pytest.mark.parametrize("stiffer", [0.0, 400.0])
def test_layer_below_the_surface_is_an_inclusion(stiffer):
    rng = np.random.default_rng(3)
    t = np.arange(15000) / 500
    q = 0.012 * np.abs(np.sin(0.35 * t)) * (0.7 + 0.3 * np.sin(0.13 * t)) - 0.002
    depth = np.maximum(0.0, q)
    force = -300 * depth - stiffer * np.maximum(0.0, depth - 0.005)
    noise = rng.normal(size=(2, t.size))
    run = Recording(
        "press",
        "arm",
        ("joint1",),
        t,
        (q + 1e-6 * noise[0])[:, None],
        np.zeros((t.size, 1)),
        tau_ext=(force + 0.02 * noise[1])[:, None],
        metadata={"unit": "m"},
    )
    model = RobotModel(RobotSource(), (Use("contact-stiffness"),), explains="external")
    found = {f.effect for f in hil.diagnose([run], model).findings}
    assert found == ({"contact-inclusion"} if stiffer else set())


@pytest.mark.parametrize("seed", plants.seeds(1, 2))
@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_hidden(seed):
    for run in (
        plants.axis(seed),
        plants.axis(seed, period=5.0),
        plants.axis(seed, push=sway),
        plants.arm(seed),
        plants.arm(seed, force=plants.hand),
    ):
        d, found = named(run)
        assert not found and d.verdict == "adequate"
