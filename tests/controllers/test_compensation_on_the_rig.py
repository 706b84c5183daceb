"""Effects of the library compensated in the 1 kHz loop on the simulated rig."""

import dataclasses

import numpy as np
import pytest

from hil.controllers.lawrence import Lawrence
from hil.diagnosis.verbs import fit
from hil.models.files import write_model
from hil.models.model import Use, base_model
from hil.record.container import read
from hil.record.mcap_read import load
from hil.record.schema import decode_numbers
from hil.rig.config import ControllerConfig, load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.runtime.replay import replay
from hil.teleop import rig_designs


def residuals(hidden, model, tmp_path):
    """Force that is not there but observed [N], and tracking error of joint 2 [rad]; rms."""
    machine = {"kind": "mechanical", "frequency": 0.5, "size": [0.04, 0.04, 0.04]}
    over = {"hidden": hidden, "operator": machine, "gel": {"below_home": 1.0}}
    config = load_rig(rig_path("lawrence"), {"simulation": over})
    write_model(model, tmp_path / "m.toml")
    law = {**config.controller.parameters}
    law |= rig_designs.models({"follower": str(tmp_path / "m.toml")}, config)
    own = ControllerConfig("lawrence", config.controller.arms, law)
    path = tmp_path / "s.mcap"
    runner.run_session(dataclasses.replace(config, controller=own), 4.0, 2, "lockstep", path)
    at = Lawrence.state_names.index("follower_observed_x")
    observed = decode_numbers(read(path).topics["/controller/state"])[150:, at : at + 3]
    leader, follower = (load(path, arm).q[1500:] for arm in ("leader", "follower"))
    gap = (leader - follower)[:, 1] - (leader - follower)[:, 1].mean()
    return np.sqrt(np.mean(observed**2)), np.sqrt(np.mean(gap**2)), path


@pytest.mark.parametrize(
    "effect", ["coupled-friction", pytest.param("position-friction", marks=pytest.mark.slow)]
)
def test_a_compensated_effect_is_felt_no_more(effect, tmp_path):
    """The simulator's law differs from the library's; what is left is that difference."""
    hidden = [{"effect": effect, "arm": "follower", "joint": "joint2", "amplitude": 2.0}]
    over = {"simulation": {"hidden": hidden}}
    runner.run_session(
        load_rig(rig_path("identify"), over), 15.0, 1, "lockstep", tmp_path / "i.mcap"
    )
    run = load(tmp_path / "i.mcap", "follower")
    base = base_model(run.robot, "follower")
    without = residuals(hidden, fit([run], base).model, tmp_path)
    with_it = residuals(hidden, fit([run], base + Use(effect, ("joint2",))).model, tmp_path)
    assert with_it[0] < 0.5 * without[0]
    assert with_it[1] < 0.6 * without[1]
    again = replay(with_it[2])
    assert again.compared == 4000 and again.differ == 0
