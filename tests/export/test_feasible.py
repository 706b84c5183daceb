"""Bodies that real masses can have: found where efforts leave them free, offered where not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plants import spatial_urdf

from hil.errors import ConfigError
from hil.export.content import Vocabulary
from hil.export.target import Job, get, within
from hil.models.bodies import infeasible, nearest_feasible
from hil.models.model import RobotModel, Use, Value
from hil.models.robots import bare_robot
from hil.record.recording import RobotSource

SOURCE = RobotSource("", spatial_urdf())


def regressor(n=300):
    rng = np.random.default_rng(1)
    robot = bare_robot(SOURCE)
    y = robot.regressor(*(rng.normal(size=(n, 3)) for _ in range(3)))
    return robot, y.reshape(-1, y.shape[-1])


def test_what_no_density_makes():
    ball = np.array([1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1])
    rod = np.array([1.0, 0, 0, 0, 0.1, 0, 0.02, 0, 0, 0.02])
    lever = np.array([1.0, 0.5, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1])
    light = np.array([-1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1])
    assert infeasible(np.array([ball, rod, lever, light, 0 * ball])) == [1, 2, 3, 4]


def test_what_the_efforts_leave_free_is_made_feasible():
    """Any shift along directions without effort is taken back without changing an effort."""
    robot, rows = regressor()
    free = np.linalg.svd(rows)[2][np.linalg.matrix_rank(rows) :]
    shifted = robot.prior + 5.0 * free.sum(axis=0)
    assert infeasible(shifted.reshape(-1, 10))
    found = nearest_feasible(shifted.reshape(-1, 10), robot.prior.reshape(-1, 10), rows)
    assert found.same and not infeasible(found.bodies)
    np.testing.assert_allclose(rows @ found.bodies.reshape(-1), rows @ shifted, atol=1e-6)


def test_the_nearest_is_better_than_the_description():
    """Where efforts must change they change less than by going back to the robot's own values."""
    robot, rows = regressor()
    wanted = robot.prior.reshape(-1, 10).copy()
    wanted[:, 1:4] *= 1.05
    wanted[2, 4:] *= -0.5
    found = nearest_feasible(wanted, robot.prior.reshape(-1, 10), rows)
    back = np.linalg.norm(rows @ (robot.prior - wanted.reshape(-1)))
    assert not infeasible(found.bodies) and not found.same
    assert found.change < 0.9 * back / np.linalg.norm(rows @ wanted.reshape(-1))


def model(bodies):
    robot = bare_robot(SOURCE)
    named = zip(robot.names, bodies.reshape(-1), strict=True)
    values = {f"rigid-body.{n}": Value(float(x), source="fit of run1") for n, x in named}
    return RobotModel(SOURCE, (Use("rigid-body", values=values),))


def test_an_infeasible_model_is_refused_with_the_nearest_one_offered():
    bodies = bare_robot(SOURCE).prior.reshape(-1, 10).copy()
    bodies[2, 4:] *= -1.0
    with pytest.raises(
        ConfigError, match=r"behind fore .*nearest .* change the efforts by .*--feas"
    ):
        within(model(bodies), Vocabulary(), [], [])
    found = within(model(bodies), Vocabulary(), [], [], mended=True)
    assert not infeasible(found.content.bodies)
    assert any("are the nearest feasible ones" in x for x in found.notes)


def test_masses_far_from_the_description_are_told():
    """A first moment of the last link that took up a spring asks for a heavy body."""
    bodies = bare_robot(SOURCE).prior.reshape(-1, 10).copy()
    described = bodies[2, 0]
    bodies[2, 3] = -10 * np.sqrt(described * bodies[2, 4:].max())  # m z of ten times the most
    found = within(model(bodies), Vocabulary(), [], [], mended=True)
    (said,) = (x for x in found.notes if "nearest feasible ones" in x)
    written = found.content.bodies[2, 0]
    assert written > 2 * described
    assert ". Masses far from those of the description: " in said
    assert f"{written:.3g} kg behind fore ({described:.3g})" in said


def test_a_preset_with_lumped_parameters_has_no_urdf():
    source = RobotSource("phantom-premium-1.5")
    values = {"j1.viscous.fv": Value(0.1)}
    premium = RobotModel(source, (Use("viscous", values=values),))
    from hil.models.model import Range

    one = (0.0, 1.0)
    premium = replace(premium, valid=tuple(Range(f"joint{k}", one, one, one) for k in (1, 2, 3)))
    with pytest.raises(ConfigError, match=r"no link has a mass|no bodies"):
        get("urdf").make(Job(premium, Path("m.toml"), "m"))
