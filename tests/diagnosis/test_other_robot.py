"""A model of another robot than the session's is told; a very short run is judged."""

import re
from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.diagnosis.engine import diagnose
from hil.diagnosis.preconditions import GRAVITY_WARNING, OTHER_ROBOT, contradicted, other_robot
from hil.diagnosis.verbs import compare, fit
from hil.models.model import base_model
from hil.record.recording import RobotSource

PHANTOM, AXES = RobotSource("phantom-premium-1.5"), RobotSource("single-axis")
URDF = RobotSource("", "<robot/>")


@pytest.mark.parametrize("robot", [PHANTOM, URDF, AXES, RobotSource("")])
@pytest.mark.parametrize("model", [PHANTOM, URDF, AXES])
def test_only_another_kind_than_the_session_names_is_told(
    model: RobotSource, robot: RobotSource
) -> None:
    found = other_robot(base_model(model), [plants.three_joints(robot)])
    named = robot in (PHANTOM, URDF)
    assert bool(found) == (named and model != robot)
    assert all(code == OTHER_ROBOT and "session run" in text for code, text in found)


@pytest.mark.slow
def test_every_answer_tells_it() -> None:
    given, own = plants.three_joints(PHANTOM), base_model(AXES)
    wanted = other_robot(own, [given])
    assert wanted[0] in fit([given], own).warnings
    assert wanted[0][1] in [f.sentence for f in compare([given], own).faults]
    assert wanted[0] in diagnose([given], own).warnings
    assert OTHER_ROBOT not in dict(diagnose([replace(given, robot=AXES)], own).warnings)


def test_a_run_too_short_to_simulate_has_no_multi_step_error() -> None:
    short = plants.three_joints(AXES, 0.7)
    found = compare([short], base_model(AXES))
    assert found.multi_step.lost and found.multi_step.windows == 0
    assert np.isfinite(found.heldout.rms).all()


@pytest.mark.slow
def test_a_run_of_fewer_instants_than_coefficients_has_noise() -> None:
    """The largest model follows all of it: its residual is no noise band."""
    found = compare([plants.three_joints(AXES, 0.7)], base_model(AXES))
    floor = found.evidence.floor
    assert (floor.scale > 0.1 * floor.rms).all()
    strengths = [x.strength for regions in found.where.values() for x in regions]
    assert max(strengths, default=0.0) < 100


@pytest.mark.slow
def test_gravity_by_the_data_is_set_against_the_description() -> None:
    """A link drawn 40 % too heavy is said on the joints that carry it; a right one is not."""
    run = plants.spatial(1)
    wrong = RobotSource("", plants.spatial_urdf((3.0, 1.6, 1.4 * 0.8)))
    assert contradicted(fit([run], base_model(run.robot))) == []
    ((code, told),) = contradicted(fit([run], base_model(wrong)))  # the same is said once
    assert code == GRAVITY_WARNING and told.startswith("gravity of upper, fore: ")
    assert "Check the masses" in told
    left = contradicted(fit([run], base_model(wrong)), np.array([1.0, 1.1, 3.0]))
    assert "Check the masses" in left[0][1] and "Check the masses" not in left[1][1]
    assert "leaves 3.0 times the noise floor on fore: what it lacks may act over" in left[1][1]
    ratio = float(re.search(r"give [0-9.]+, ([0-9.]+) times", told)[1])
    assert ratio == pytest.approx(1 / 1.4, abs=0.02)
    seen = compare([run], base_model(wrong), simulate=False)
    assert GRAVITY_WARNING in {f.code for f in seen.faults}
