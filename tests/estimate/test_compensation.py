"""What the loop compensates, from fitted models of any effects."""

import numpy as np
import pytest

from hil.errors import ConfigError
from hil.estimate import compensation
from hil.models.model import RobotModel, Use, Value
from hil.models.phantom import Premium
from hil.record.recording import RobotSource

ROBOT = RobotSource("phantom-premium-1.5")
RIGID = Use("rigid-body", values={
    f"rigid-body.{n}": Value(float(v)) for n, v in zip(Premium.names, Premium.prior, strict=True)
})  # fmt: skip


def use(name, at, **values):
    return Use(name, (f"joint{at}",), {}, {
        f"j{at}.{name}.{k}": Value(v) for k, v in values.items()
    })  # fmt: skip


def test_friction_is_the_sum_of_the_fitted_effects():
    effects = (RIGID, use("coulomb", 2, fc=0.01, v0=0.02), use("viscous", 2, fv=0.002),
               use("viscous", 3, fv=0.001))  # fmt: skip
    model = RobotModel(ROBOT, effects)
    np.testing.assert_allclose(compensation.rigid_parameters(model), Premium.prior)
    v = compensation.SPEEDS
    found = compensation.friction_tables(model)
    assert np.all(found[0] == 0.0)
    np.testing.assert_allclose(found[1], 0.01 * np.tanh(v / 0.02) + 0.002 * v, atol=1e-12)
    np.testing.assert_allclose(found[2], 0.001 * v, atol=1e-12)


def test_what_is_no_function_of_the_own_speed_is_refused_by_name():
    coupled = use("coupled-friction", 2, fk=0.01, vk=0.0, joint=1.0, mode=0.0)
    with pytest.raises(ConfigError, match=r"'coupled-friction'.*more than the own"):
        compensation.friction_tables(RobotModel(ROBOT, (RIGID, coupled)))


def test_a_model_without_values_or_of_another_robot_is_refused():
    with pytest.raises(ConfigError, match="hil fit"):
        compensation.rigid_parameters(RobotModel(ROBOT, (Use("rigid-body"),)))
    with pytest.raises(ConfigError, match="single-axis"):
        compensation.rigid_parameters(RobotModel(RobotSource("single-axis"), (RIGID,)))
