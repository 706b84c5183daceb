"""The compiled session is the ordinary lockstep session, only faster."""

import numpy as np
import pytest

from hil.bench import hidden
from hil.bench.diagnosis import amplitudes
from hil.bench.diagnosis.amplitudes import base_rms
from hil.controllers import joint_tracking
from hil.controllers.joint_tracking import JointTracking, JointTrackingConfig
from hil.record.mcap_read import load
from hil.record.recording import Recording
from hil.rigs import rig_path
from hil.sim_devices.fast import session
from hil.sim_devices.fast.session import HIDDEN_FORMS
from hil.sim_devices.plants import world

SECONDS = 30.0


def lockstep_reference(seed):
    """Reference of `joint-tracking` for the follower, (n, 3, 3)."""
    config = JointTrackingConfig(seed=seed)
    c = JointTracking(config, ("leader", "follower"), 1e-3)._c[1]
    t = 1e-3 * np.arange(round(SECONDS * 1e3))
    place = joint_tracking.multisine_values(c, t, config.period)
    k = 2 * np.pi / config.period * np.arange(1, c.shape[1] + 1)
    turned = np.stack([-c[..., 1] * k, c[..., 0] * k], -1)
    speed = joint_tracking.multisine_values(turned, t, config.period)
    push = joint_tracking.multisine_values(-c * (k**2)[None, :, None], t, config.period)
    ramp = np.clip(t, 0, 1)[:, None]
    rate, ramp = np.pi / 2 * np.sin(np.pi * ramp), (1 - np.cos(np.pi * ramp)) / 2
    parts = [np.array(config.center) + ramp * place, ramp * speed + rate * place, ramp * push]
    return np.ascontiguousarray(np.stack(parts, -1))


def recording(s):
    joints = ("joint1", "joint2", "joint3")
    from hil.record.recording import RobotSource

    source = RobotSource("phantom-premium-1.5")
    return Recording("fast", "arm", joints, s["t"], s["q"], s["tau"], qd=s["qd"], robot=source)


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["", "stribeck"])
def test_residuals_are_those_of_the_lockstep_session(tmp_path, effect):
    path = hidden.identification_session(rig_path("identify"), tmp_path, 3, 5, effect, "joint2")
    rows = [{"effect": effect, "joint": 1, "amplitude": 1.3}] if effect else []
    fast = recording(session.simulate(lockstep_reference(5), None, rows, "coloured", 3))
    there, here = base_rms([load(path, "follower")]), base_rms([fast])
    assert np.allclose(here, there, rtol=0.12), (here, there)


def test_same_seed_same_session():
    reference = lockstep_reference(1)[:2000]
    a, b = (session.simulate(reference, None, [], "white", 4) for _ in range(2))
    assert all(np.array_equal(a[k], b[k]) for k in a)
    other = session.simulate(reference, None, [], "white", 5)
    assert not np.array_equal(a["tau"], other["tau"])


@pytest.mark.parametrize("effect", sorted(HIDDEN_FORMS))
def test_every_effect_changes_the_session(effect):
    reference = lockstep_reference(1)[:4000]
    push = 0.2 * np.sin(0.01 * np.arange(4000))[:, None] * np.ones(3)
    row = {"effect": effect, "joint": 0, "amplitude": 1.0}
    quiet = session.simulate(reference, push, [], "white", 4)
    loud = session.simulate(reference, push, [row], "white", 4)
    assert any(not np.array_equal(quiet[k], loud[k]) for k in quiet)
    assert all(np.isfinite(x).all() for x in loud.values())


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("effect", ["friction-drift", "position-friction", "load-friction"])
def test_friction_brakes_at_any_amplitude(effect, joint):
    # what is lost of friction cannot be more than there is
    own = f"{effect}/{joint + 1}/"
    most = max(
        max(a) for name, a in amplitudes.amplitude_table("tuning").items() if name.startswith(own)
    )
    row = {"effect": effect, "joint": joint, "amplitude": most}
    p = session.plant_record([row], "white", locked=False)[0]
    x = session.start(p, np.zeros(3))
    for side in (-1.0, 1.0):
        x["vm"][0, joint], x["sm"][0, joint] = side, side
        for place in np.linspace(-0.6, 0.6, 25):
            x["qm"][0, joint] = place
            for t in (0.0, 5.0, 25.0):
                total = world.motor_side(p[0], x[0], joint, 0.02)
                total += session.motor_friction(p[0], x[0], joint, t, 0.02, 1e-4)
                assert total * side > 0


def test_a_locked_arm_is_a_single_axis():
    s = session.simulate(lockstep_reference(1)[:2000], None, [], "white", 4, locked=True)
    assert np.ptp(s["q"][:, 0]) > 0.1
    assert np.ptp(s["q"][:, 1:], axis=0).max() == 0.0
