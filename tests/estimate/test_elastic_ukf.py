"""The compiled filter against filterpy, and against a plant of its own equations."""

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from hil.bench.costs import reference_cost
from hil.errors import ConfigError
from hil.estimate import elastic_ukf
from hil.experiments import elastic_transmission
from hil.experiments.elastic_transmission import PERIOD, TwoMassPlant, record_arm

CONFIG = elastic_ukf.UkfConfig()


def test_the_reference_is_filterpy():
    assert isinstance(reference_cost(CONFIG, 0.0), UnscentedKalmanFilter)
    assert isinstance(reference_cost(CONFIG, 0.0).points_fn, MerweScaledSigmaPoints)


def test_the_compiled_filter_is_filterpys():
    run = record_arm(TwoMassPlant(), 0.6, 3)
    mine, theirs = elastic_ukf.ElasticUkf(CONFIG), reference_cost(CONFIG, 0.0)
    for k in range(600):
        innovation = mine.step(run.y[k], run.u[k], PERIOD)
        theirs.update(run.y[k])
        assert innovation == pytest.approx(float(theirs.y[0]), rel=1e-4, abs=1e-8)
        scale = np.array([1e-3, 0.1, 1e-3, 0.1, 1, 1, 1, 1, 1, 1])
        np.testing.assert_allclose(mine.state / scale, theirs.x / scale, rtol=1e-4, atol=1e-4)
        theirs.predict(u=run.u[k])
        size = np.sqrt(np.diag(theirs.P))
        np.testing.assert_allclose(
            mine.covariance / np.outer(size, size), theirs.P / np.outer(size, size), atol=1e-3
        )


def test_approximations_are_as_good_as_said():
    x = np.linspace(-12, 12, 4001)
    assert max(abs(elastic_ukf.tanh(v) - np.tanh(v)) for v in x) < 3e-7
    assert max(abs(elastic_ukf.exp(v) / np.exp(v) - 1) for v in np.linspace(-2, 2, 401)) < 2e-7


def test_parameters_within_five_percent_in_25_seconds():
    """The plant has the filter's friction law only up to the shape of its sign."""
    found, f = elastic_transmission.identify_transmission(TwoMassPlant())
    ratio = found / elastic_transmission.true_parameters(TwoMassPlant())
    np.testing.assert_allclose(ratio[:2], 1, atol=0.05)
    # only the sums are well determined: the motor's and the link's correlate with -1
    assert found[2] + found[4] == pytest.approx(0.022, rel=0.05)
    assert found[3] + found[5] == pytest.approx(0.0025, rel=0.15)
    p = f.covariance
    assert p[6, 8] / np.sqrt(p[6, 6] * p[8, 8]) < -0.8


def test_robust_to_inertia_and_linear_in_interaction():
    found = elastic_transmission.study()
    inertia = [r for r in found.rows if r.study == "link inertia"]
    assert all(r.angle < r.motor_angle for r in inertia)
    assert inertia[0].angle < 1.5e-4 < 3e-4 < inertia[0].motor_angle
    assert found.departure < 0.1
    assert found.slope != 0.0


def test_a_lost_covariance_is_not_a_number():
    f = elastic_ukf.ElasticUkf(CONFIG)
    f._f["p"][:] = -np.eye(10)
    assert np.isnan(f.step(0.0, 0.0, PERIOD))


def test_bad_configurations_are_refused():
    with pytest.raises(ConfigError, match="six positive"):
        elastic_ukf.UkfConfig(start=(1.0,) * 5)
    with pytest.raises(ConfigError, match="inertias"):
        elastic_ukf.UkfConfig(motor_inertia=0.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((n, v) for n in ("spread", "resolution", "alpha", "soft") for v in (np.nan, -1.0, 0.0)),
        ("kappa", -10.0),
        ("kappa", np.nan),
        ("beta", np.nan),
        ("link_inertia", np.inf),
        ("noise", (1e-12, np.nan, 1e-12, 1e-4, 1e-9)),
        ("start", (30.0, np.nan, 0.02, 9e-4, 0.006, 1.6e-3)),
    ],
)
def test_numbers_that_make_no_filter_are_refused(name, value):
    with pytest.raises(ConfigError, match=name):
        elastic_ukf.UkfConfig(**{name: value})


@pytest.mark.parametrize(
    ("y", "u", "says"),
    [
        (np.zeros(2000), np.zeros(5), r"y has the shape \(2000,\), u \(5,\)"),
        (np.zeros((5, 1)), np.zeros((5, 1)), "both"),
        (np.zeros(5), np.array([0.0, 0.0, np.nan, 0.0, 0.0]), "sample 2 of 5"),
        (np.array([0.0, np.inf]), np.zeros(2), "sample 1 of 2"),
    ],
)
def test_a_record_that_the_kernel_cannot_take_is_refused(y, u, says):
    with pytest.raises(ConfigError, match=says):
        elastic_ukf.ElasticUkf().run(y, u, PERIOD)


def test_a_sample_without_a_measurement_is_foretold():
    run = record_arm(TwoMassPlant(), 0.6, 3)
    whole, _ = elastic_ukf.ElasticUkf(CONFIG).run(run.y, run.u, PERIOD)
    holes = run.y.copy()
    holes[[100, 300, 301, 302]] = np.nan
    found, innovation = elastic_ukf.ElasticUkf(CONFIG).run(holes, run.u, PERIOD)
    assert np.isfinite(found).all()
    assert np.flatnonzero(np.isnan(innovation)).tolist() == [100, 300, 301, 302]
    assert np.array_equal(found[:100], whole[:100])
    assert np.abs(found[-1, :1] - whole[-1, :1]).max() < CONFIG.resolution
