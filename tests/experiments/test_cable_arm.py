"""Filters and networks together on the simulated cable-driven arm, in the loop."""

import numpy as np
import pytest

from hil.experiments import cable_arm
from hil.sim_devices.plants import truth


@pytest.mark.slow
def test_together_they_know_cables_and_friction(tmp_path):
    """Against the simulator's own cables, and against each part alone; forty seconds."""
    hidden = cable_arm.CONDITIONS["cables over other joints' pulleys, Stribeck"]
    path = cable_arm._session(tmp_path, hidden, 1, 40.0, 30.0)
    rows = {r.estimator: r for r in cable_arm.estimator_errors("", path, 30.0)}
    found = {name: rows[said] for name, said in cable_arm.SAID.items()}
    assert found["both"].free < 0.9 * found["filters"].free
    assert found["both"].free < 0.9 * found["fitted"].free
    assert found["both"].free < 0.5 * found["observer"].free
    assert found["both"].touched < 0.12 * found["both"].size
    cables = truth.load_truth("nominal")["cables"]["stiffness"]
    for name in ("filters", "both"):
        np.testing.assert_allclose(cable_arm.cables(path, name), cables, rtol=0.1)
