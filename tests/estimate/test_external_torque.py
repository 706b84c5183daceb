"""Force estimators: the observer is a low-pass of the true torque; inverse dynamics exact."""

import numpy as np
import plants
import pytest

from hil.errors import ConfigError
from hil.estimate import external_torque
from hil.models.phantom import Premium

PI, T, K = Premium.prior, 2e-4, 60.0


def swing(seconds=1.0):
    """Premium under torque and an external torque step, simulated with small steps."""
    arm, n = Premium(()), round(seconds / T)
    q, v = np.array([0.1, 0.4, 0.3]), np.zeros(3)
    out = []
    for k in range(n):
        t = k * T
        tau = np.array([0.02 * np.sin(7 * t), -0.02 + 0.015 * np.cos(5 * t), -0.03 * np.cos(6 * t)])
        ext = np.array([0.03, -0.02, 0.01]) * (t > 0.5)
        rest = arm.regressor(q[None], v[None], np.zeros((1, 3)))[0] @ PI
        still = arm.regressor(q[None], np.zeros((1, 3)), np.zeros((1, 3)))[0] @ PI
        m = np.stack(
            [arm.regressor(q[None], np.zeros((1, 3)), e[None])[0] @ PI - still for e in np.eye(3)],
            1,
        )
        a = np.linalg.solve(m, tau + ext - rest)
        out.append((q, v, a, tau, ext))
        v = v + T * a
        q = q + T * v
    return [np.array(x) for x in zip(*out, strict=True)]


@pytest.fixture(scope="module")
def run():
    return swing()


def test_the_momentum_observer_is_a_low_pass_of_the_external_torque(run):
    q, v, _, tau, ext = run
    m, rest = plants.premium_terms(PI, q, v)
    found = external_torque.by_momentum_observer(m, v, tau + rest, K, T)
    wanted, r = np.zeros_like(ext), np.zeros(3)
    for k in range(len(ext)):
        # r' = K (tau_s - r)
        r = (r + K * T * ext[k]) / (1 + K * T)
        wanted[k] = r
    np.testing.assert_allclose(found, wanted, atol=2e-3)
    np.testing.assert_allclose(found[-1], ext[-1], atol=2e-3)


def test_inverse_dynamics_with_true_accelerations_is_exact(run):
    q, v, a, tau, ext = run
    tau_hat = Premium(()).regressor(q, v, a) @ PI - tau
    np.testing.assert_allclose(tau_hat, ext, atol=1e-12)


def test_a_bad_gain_is_refused():
    with pytest.raises(ConfigError, match="positive"):
        external_torque.by_momentum_observer(
            np.zeros((1, 3, 3)), np.zeros((1, 3)), np.zeros((1, 3)), 0.0, T
        )


@pytest.mark.parametrize("pair", [(np.nan, T), (K, np.nan), (K, 0.0), (np.inf, T)])
def test_a_gain_or_period_that_is_no_number_is_refused(pair):
    with pytest.raises(ConfigError, match="positive"):
        external_torque.by_momentum_observer(
            np.zeros((1, 3, 3)), np.zeros((1, 3)), np.zeros((1, 3)), *pair
        )


def test_arrays_that_do_not_agree_or_hold_no_number_are_refused():
    m, v = np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 3))
    for parts in ((m, v, v[:3]), (m, v, v[:, :2]), (m[:4], v, v)):
        with pytest.raises(ConfigError, match="expected"):
            external_torque.by_momentum_observer(*parts, K, T)
    bad = v.copy()
    bad[2, 1] = np.nan
    with pytest.raises(ConfigError, match="sample 2 of 5"):
        external_torque.by_momentum_observer(m, v, bad, K, T)


def test_the_model_finds_the_force_of_a_fitted_run():
    """Any fitted model: the effort it does not explain is the external one."""
    from hil.diagnosis.verbs import fit
    from hil.models.model import base_model
    from hil.record.recording import Recording, RobotSource

    t = np.arange(8000) * 1e-3
    q = 0.4 * np.sin(2 * np.pi * 0.7 * t) + 0.2 * np.sin(2 * np.pi * 1.9 * t)
    v, a = np.gradient(q, t), np.gradient(np.gradient(q, t), t)
    tau = 0.02 * a + 0.05 * v + 0.1 * np.tanh(v / 0.01)
    ext = 0.2 * (np.sin(2 * np.pi * 0.3 * t) > 0)

    def record(name, effort):
        return Recording(
            name,
            "arm",
            ("joint1",),
            t,
            q[:, None],
            effort[:, None],
            robot=RobotSource("single-axis"),
        )

    free = record("free", tau)
    result = fit([free], base_model(free.robot))
    times, found = external_torque.by_inverse_dynamics(result, record("touch", tau - ext))
    truth = np.interp(times, t, ext)
    assert np.corrcoef(found[:, 0], truth)[0, 1] > 0.95
    assert np.median(found[truth > 0.1, 0]) == pytest.approx(0.2, abs=0.02)
    assert np.median(found[truth < 0.1, 0]) == pytest.approx(0.0, abs=0.02)
    other = Recording("two", "arm", ("a",), t, q[:, None], tau[:, None])
    with pytest.raises(ConfigError, match="joints a"):
        external_torque.by_inverse_dynamics(result, other)
