"""The simulated arms are made of other numbers than models and laws start from."""

import ast
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from hil.controllers.estimators.transmission import ROTORS
from hil.models.phantom import Premium
from hil.sim_devices.plants import truth

HOUSE = Path(__file__).parents[2]
NOMINAL = HOUSE / "sim_devices" / "plants" / "truth" / "nominal.toml"
#: Tables of the truth that models could know; what a ruler, a data sheet or a calibration tells
#: is not among them.
OWN = ("masses", "inertias", "cables")


def numbers(value):
    """All numbers in a table."""
    if isinstance(value, dict):
        return [x for v in value.values() for x in numbers(v)]
    if isinstance(value, list):
        return [x for v in value for x in numbers(v)]
    return [float(value)]


def precise(x):
    """Whether a number has three digits or more: 0.1 and 20 are nobody's."""
    return x != 0.0 and float(f"{x:.1e}") != float(f"{x:.12e}")


def test_rigid_bodies_and_drives_are_off_the_published_ones():
    facts = truth.load_truth("nominal")
    arm = np.zeros(1, truth.ARM_DTYPE)
    truth._bodies(arm, facts)
    p = arm[0]
    bodies = np.concatenate([p["m11"], [p["m22"], p["m33"]]])
    off = np.abs(bodies / Premium.prior[:6] - 1)
    assert 0.05 < off.min() and off.max() < 0.15
    gravity = np.abs(np.array([p["g2"], p["g3"]]) - Premium.prior[6:])
    assert (gravity > 0.05 * np.abs(Premium.prior[6:])).all()
    truth._drives(arm, facts)
    off = np.abs(arm["rotor"][0] / np.array(ROTORS) - 1)
    assert 0.05 < off.min() and off.max() < 0.15


@pytest.mark.parametrize("table", OWN)
def test_no_number_of_the_truth_stands_in_the_library(table):
    """Every literal of the library against the numbers of the simulator, to half a percent."""
    own = [x for x in numbers(tomllib.loads(NOMINAL.read_text())[table]) if precise(x)]
    assert own
    same = []
    for folder in ("hil/models", "hil/identify", "hil/diagnosis", "hil/teleop", "controllers"):
        for path in sorted((HOUSE / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and type(node.value) is float:
                    x = abs(node.value)
                    if precise(x):
                        same += [
                            (path.name, x, y) for y in own if math.isclose(x, abs(y), rel_tol=5e-3)
                        ]
    assert same == []
